"""What `stability.py` measures, one function a question; every function returns plain numbers for the JSON."""

import itertools

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import granjax as gx
from granjax.solvers import stability

SYMPLECTIC = (
    gx.VelocityVerlet,
    gx.SRKN6b,
    gx.SRKN11b,
    gx.SRKN14a,
    gx.KahanLi8,
    gx.SofroniouSpaletta10,
)
PAIRS = (gx.RKN86, gx.RKN1210)
RUNGE_KUTTA = (diffrax.Heun, diffrax.Bosh3, diffrax.Tsit5, diffrax.Dopri5, diffrax.Dopri8)
OTHERS = (
    diffrax.Euler,
    diffrax.Midpoint,
    diffrax.Ralston,
    diffrax.LeapfrogMidpoint,
    diffrax.ReversibleHeun,
)
EVERY = SYMPLECTIC + PAIRS + RUNGE_KUTTA + OTHERS


@eqx.filter_jit
def energies(lattice, state, solver, t1, step, times):
    """Total energy at some times, at a fixed step that nothing refuses: (times, lanes)."""
    total = lambda t, y, lattice: lattice.energy(t, y.u, y.v)
    return _solve(lattice, state, solver, t1, step, diffrax.SaveAt(ts=times, fn=total))


@eqx.filter_jit
def states(lattice, state, solver, t1, step, times):
    """The same for the state."""
    return _solve(lattice, state, solver, t1, step, diffrax.SaveAt(ts=times))


def _solve(lattice, state, solver, t1, step, saveat):
    return diffrax.diffeqsolve(
        diffrax.ODETerm(gx.vector_field),
        solver,
        0.0,
        t1,
        step,
        state,
        args=lattice,
        saveat=saveat,
        max_steps=None,
        adjoint=diffrax.ForwardMode(),
        throw=False,
    ).ys


def in_lanes(make, ratios):
    """Scenes whose frequencies are `ratios` times those of make(1.0), by their mass: a lane each, at one step."""
    return jax.vmap(make, out_axes=-1)(jnp.asarray(1 / np.asarray(ratios) ** 2))


# the table, and a run on either side of every limit --------------------------------------------------------------


def table(solvers, phase=1e5, sites=16, max_steps=400_000):
    """Lines of `granjax.solvers.stability`, each confirmed on a linear chain by growth just inside and just outside.

    Outside is 1 % beyond the limit, or the middle of the first window of instability where that is narrower. Growth is
    per radian, of the mode of highest frequency, which alone is beyond the limit. `refused`: what `simulate` says of a
    step just below and just above where it refuses, `None` where it takes it.
    """
    chain = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "fixed"), gx.Linear(1.0)),), sites=sites)
    modes = gx.linear.normal_modes(chain)
    top = np.asarray(modes.modes)[:, -1]
    omega = float(modes.omega[-1])
    rows = []
    for solver in solvers:
        line = stability.stability(solver)
        first = line.windows[0]
        outside = min(1.01 * line.limit, (first.start + first.end) / 2)
        row = {**line._asdict(), "windows": [w._asdict() for w in line.windows[:4]]}
        for name, z in (("inside", 0.99 * line.limit), ("outside", outside)):
            row[name] = _confirmed(chain, top, omega, solver, z, phase, max_steps)
        row["refused"] = [
            _refusal(chain, omega, solver, part * line.refused_from) for part in (0.999, 1.001)
        ]
        rows.append(row)
    return rows


def _confirmed(chain, top, omega, solver, z, phase, max_steps):
    rate = float(stability.growth(solver, z))
    step = z / omega
    # no overflow, and a decay that stays far above rounding
    steps = int(min(phase, 200 / max(rate, 1e-12), 15 / max(-rate, 1e-12)) / z)
    steps = min(max(steps, 200), max_steps)
    state = gx.State(jnp.asarray(0.01 * top), jnp.asarray(0.003 * top))
    chosen = np.unique(np.random.default_rng(0).integers(1, steps, 600))
    ys = states(chain, state, solver(), steps * step, step, jnp.asarray(chosen * step))
    amplitude = np.hypot(omega * np.asarray(ys.u) @ top, np.asarray(ys.v) @ top)
    early = chosen < steps // 3
    late = chosen >= steps - steps // 3
    ends = [(chosen[k][np.argmax(amplitude[k])], amplitude[k].max()) for k in (early, late)]
    measured = np.log(ends[1][1] / ends[0][1]) / ((ends[1][0] - ends[0][0]) * z)
    return {
        "h_omega": z,
        "steps": steps,
        "growth": rate,
        "measured_growth": float(measured),
        "largest_ratio": float(amplitude.max() / amplitude[:1].max()),
    }


def _refusal(chain, omega, solver, z):
    step = z / omega
    try:
        gx.simulate(
            chain, gx.State(chain.zeros(), chain.zeros()), 2 * step, solver=solver(), step=step
        )
    except ValueError as error:
        return str(error)


# finite amplitude ------------------------------------------------------------------------------------------------

FRACTIONS = (
    (0.6, 0.65, 0.7, 0.725, 0.75),
    (0.8, 0.85, 0.9, 0.94, 0.97),
    (0.99, 1.01, 1.03, 1.1, 1.2),
    (1.4, 1.6, 1.8, 2.2, 3.0),
)
AMPLITUDES = (0.01, 0.03, 0.1, 0.2)
LOST = 10.0


def smooth_chain(sites):
    """A Hertz chain with d0 = 1."""
    return lambda mass=1.0: gx.scenes.monomer(sites, mass=mass, precompression=1.0)


def toda_chain(sites):
    """A Toda chain, which opens nowhere."""
    return lambda mass=1.0: gx.scenes.toda(sites, mass=mass, boundary="fixed")


def finite_amplitude(make, solver, sites, t1, groups=FRACTIONS, amplitudes=AMPLITUDES):
    """Largest energy error up to t1 by solver, amplitude of random displacements and fraction of the linear limit.

    `lost_at`: the lowest fraction at which the energy grew tenfold; `lost`: every such fraction.
    """
    omega = float(np.max(np.asarray(gx.linear.normal_modes(make()).omega)))
    shape = np.random.default_rng(0).uniform(-1, 1, sites)
    limit = stability.stability_limit(solver)
    errors = []
    for group in groups:
        size, fraction = np.meshgrid(amplitudes, group, indexing="ij")
        ratios = fraction.ravel() * limit / omega
        state = gx.State(jnp.asarray(shape[:, None] * size.ravel()), jnp.zeros((sites, size.size)))
        steps = float(np.ceil(t1 / ratios.min()))
        times = np.linspace(0, steps, 301)
        E = np.asarray(
            energies(in_lanes(make, ratios), state, solver(), steps, 1.0, jnp.asarray(times))
        )
        error = np.abs(E / E[0] - 1)
        error = np.where(np.isfinite(error), error, np.inf)
        counted = times[:, None] * ratios <= t1 * (1 + 1e-12)
        errors.append(np.where(counted, error, 0).max(0).reshape(size.shape))
    errors = np.concatenate(errors, 1)
    fractions = np.concatenate(groups)
    lost = [[float(f) for f in fractions[row >= LOST]] for row in errors]
    return {
        "solver": solver.__name__,
        "limit": limit,
        "fractions": fractions.tolist(),
        "amplitudes": list(amplitudes),
        "error": errors.tolist(),
        "lost": lost,
        "lost_at": [min(row) if row else None for row in lost],
    }


# energy over long times ------------------------------------------------------------------------------------------

COSTS = (7.0, 14.0, 28.0, 56.0)
BLOCKS = 25


def long_energy(solver, amplitude, sites, t1, costs=COSTS, starts=3, frames=1001):
    """Drift and band of the energy against force evaluations per unit time, for random starts of a precompressed chain.

    `drift`: slope of a straight line through E/E0 times t1, its mean over the starts; `drift_error`: its standard
    error, the larger of two, from the scatter of the starts and from that of block means about each line; `band`: the
    standard deviation about the line. `outcome` says why there is none.
    """
    lattice = smooth_chain(sites)()
    shapes = amplitude * np.random.default_rng(1).uniform(-1, 1, (starts, sites))
    rows = []
    for cost in costs:
        step = stability.evaluations(solver) / cost
        row = {"solver": solver.__name__, "cost": cost, "step": step}
        try:
            runs = [
                gx.simulate(
                    lattice,
                    gx.State(jnp.asarray(u), jnp.zeros(sites)),
                    t1,
                    solver=solver(),
                    step=step,
                    save_at=frames,
                    throw=True,
                )
                for u in shapes
            ]
            E = np.stack([_total_energy(lattice, gx.State(run.us, run.vs)) for run in runs], 1)
            row |= trend(np.asarray(runs[0].ts), E / E[0] - 1)
            row["opened"] = [bool(run.contact_opened) for run in runs]
        except (ValueError, RuntimeError) as error:
            row["outcome"] = str(error)
        rows.append(row)
    return rows


_total_energy = jax.jit(jax.vmap(gx.measures.energy, in_axes=(None, 0)))


def trend(ts, error, blocks=BLOCKS):
    """Straight line through (T, starts) relative energy errors: see `long_energy`."""
    used = (len(ts) - 1) // blocks * blocks
    t = ts[-used:].reshape(blocks, -1).mean(1)
    e = error[-used:].reshape(blocks, -1, error.shape[1]).mean(1)
    x = t - t.mean()
    slope = x @ e / (x @ x)
    about = e - e.mean(0) - x[:, None] * slope
    fit = np.sqrt((about**2).sum(0) / (blocks - 2) / (x @ x))
    span = ts[-1] - ts[0]
    rest = error - e.mean(0) - (ts - t.mean())[:, None] * slope
    errors = slope.std(ddof=1), np.sqrt((fit**2).mean())
    return {
        "drift": float(slope.mean() * span),
        "drift_error": float(max(errors) * span / np.sqrt(error.shape[1])),
        "drifts": (slope * span).tolist(),
        "band": float(np.sqrt((rest**2).mean())),
        "largest": float(np.abs(error).max()),
    }


# resonances of the step ------------------------------------------------------------------------------------------

HIGHEST_ORDER = 8
START = (0.03, -0.08)


def resonances(solver, low, count, steps, blocks=24, per=256):
    """Energy error of two precompressed beads against h omega_max, and where resonances of the step are expected.

    `largest`: max |E/E0 - 1|. `slow`: the range of its means over `per` steps, in which oscillations at the modes' own
    frequencies cancel. `expected`: h omega_max where sum c_k theta_k = 2 pi n, with theta_k(h) the phase that one step
    gives the linear mode k (cos theta = trace R/2) and integers c of order |c_1| + |c_2|. `peaks`: maxima of `slow`
    that stand out fivefold, each with the expected place next to it.
    """
    make = smooth_chain(2)
    omega = np.sort(np.asarray(gx.linear.normal_modes(make()).omega))
    z = np.linspace(low, stability.stability_limit(solver) * (1 - 1e-4), count)
    state = gx.State(jnp.asarray(np.array(START)[:, None] * np.ones(count)), jnp.zeros((2, count)))
    starts = np.linspace(0, steps - per, blocks).astype(int)
    times = (starts[:, None] + np.arange(per)).ravel().astype(float)
    lattice = in_lanes(make, z / omega[-1])
    E = np.asarray(energies(lattice, state, solver(), float(steps), 1.0, jnp.asarray(times)))
    e = E / E[0] - 1
    weight = np.hanning(per + 2)[1:-1]
    means = np.einsum("p,bpz->bz", weight / weight.sum(), e.reshape(blocks, per, -1))
    largest = np.abs(e).max(0)
    slow = np.ptp(means, axis=0)
    found = expected(solver, z, omega / omega[-1])
    return {
        "solver": solver.__name__,
        "h_omega": z.tolist(),
        "largest": _listed(largest),
        "slow": _listed(slow),
        "expected": found,
        "peaks": peaks(z, slow, found),
    }


def expected(solver, z, ratios):
    """Places h omega_max of the resonances up to HIGHEST_ORDER; the linear limit is the one of order 2."""
    R = stability.one_step(solver, z[:, None] * ratios)
    theta = np.arccos(np.clip((R[..., 0, 0] + R[..., 1, 1]) / 2, -1, 1))
    limit = stability.stability_limit(solver)
    rows = [{"order": 2, "c": [0] * (len(ratios) - 1) + [2], "n": 1, "h_omega": limit}]
    for c in itertools.product(range(-HIGHEST_ORDER, HIGHEST_ORDER + 1), repeat=len(ratios)):
        order = sum(map(abs, c))
        if not 3 <= order <= HIGHEST_ORDER:
            continue
        total = theta @ np.array(c) / (2 * np.pi)
        for n in range(1, HIGHEST_ORDER):
            past = total - n
            for k in (
                np.flatnonzero(past[:-1] * past[1:] < 0) if np.gcd.reduce([*c, n]) == 1 else ()
            ):
                place = z[k] + (z[k + 1] - z[k]) * past[k] / (past[k] - past[k + 1])
                rows.append({"order": order, "c": list(c), "n": n, "h_omega": float(place)})
    return sorted(rows, key=lambda row: row["h_omega"])


def peaks(z, slow, found, half=0.06, factor=5.0, apart=0.006, near=0.002):
    """Local maxima that exceed the median of their neighbourhood; where runs were lost, the middle of the gap.

    `expected`: the resonance of lowest order within `near` (or within the gap), `None` where there is none.
    """
    lost = ~np.isfinite(slow)
    values = np.where(lost, 0, slow)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], lost, [False]]).astype(int)))
    rows = [
        {
            "h_omega": float((z[i] + z[j - 1]) / 2),
            "height": None,
            "gap": [float(z[i]), float(z[j - 1])],
        }
        for i, j in zip(edges[::2], edges[1::2])
    ]
    for k in np.flatnonzero(~lost):
        beside = np.abs(z - z[k]) <= apart
        base = np.median(values[np.abs(z - z[k]) <= half])
        if (
            values[k] == values[beside].max()
            and values[k] > factor * base
            and not lost[beside].any()
        ):
            rows.append({"h_omega": float(z[k]), "height": float(values[k] / base)})
    for row in rows:
        low, high = row.get("gap", [row["h_omega"]] * 2)
        next_to = [e for e in found if low - near <= e["h_omega"] <= high + near]
        row["expected"] = min(
            next_to, key=lambda e: (e["order"], abs(e["h_omega"] - row["h_omega"])), default=None
        )
    return sorted(rows, key=lambda row: row["h_omega"])


def _listed(x):
    return [float(v) if np.isfinite(v) else None for v in x]
