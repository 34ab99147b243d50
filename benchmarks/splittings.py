"""Which splitting is the fastest on smooth chains with a tangent? `python benchmarks/splittings.py [--quick]`

The question of C. Danieli, B. Many Manda, T. Mithun, C. Skokos, Mathematics in Engineering 1, 447 (2019), asked again
of two chains with one tangent vector, as for the largest Lyapunov exponent: alpha-FPUT, and a disordered Klein-Gordon
chain. The error is the largest relative change of the energy over the run; of every method the time at an error is read
off its points. Beside granjax's `Flow.tangents` stand a numba loop of the same tables and heyoka's Taylor series.

Writes splittings.json and splittings.png beside this file; `--quick` is a smoke test that everything runs and agrees,
and writes nothing unless `--out` names a folder. Needs `pip install granjax[bench]`; who is not installed is left out.
"""

import argparse
import json
import os
import statistics
import time
from functools import cache
from pathlib import Path
from typing import NamedTuple

if hasattr(os, "sched_setaffinity"):
    # before JAX starts, so that its pools have one thread
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

import jax
import jax.numpy as jnp
import numpy as np
from curves import time_at
from machine import machine

import granjax as gx
from granjax.plots.style import figure, save, style
from granjax.solvers import tables

HERE = Path(__file__).parent
METHODS = ("VelocityVerlet", "SRKN6b", "ABA864", "SRKN11b", "SRKN14a", "KahanLi8")
SITES = 1024
SEED = 0
# of a run: some sixty periods of the fastest mode
END = 400.0
# into which a run is cut, at whose ends the energy is looked at
PARTS = 8
# times at these are the answer; a point below the second one is rounding
ERRORS = (1e-5, 1e-9)
ROUNDING = 1e-12
LONGEST = 1.0
RUNG = 0.8
RUNGS = 18
TOLERANCES = 10.0 ** -np.arange(4.0, 15.0, 2.0)
# energies and tangents of two programs that should do the same
AGREEMENT = 1e-8


class Chain(NamedTuple):
    """u_n'' = K2 d + K3 d^2 of both neighbours, less k_n u_n + u_n^3 where there is an on-site force; fixed ends."""

    name: str
    t1: float
    linear: float
    cubic: float
    on_site: np.ndarray | None
    u: np.ndarray
    v: np.ndarray
    tangent: tuple

    def lattice(self):
        """The same as a `Lattice`."""
        law = gx.Polynomial(self.linear, self.cubic)
        terms = (gx.Bond(gx.Shift(1, "fixed"), law),)
        if self.on_site is not None:
            terms += (gx.OnSite(gx.Polynomial(self.on_site, 0.0, 1.0)),)
        return gx.Lattice(1.0, terms, sites=self.u.size)

    def energy(self, u, v):
        """The energy, by NumPy."""
        e = -np.diff(u, prepend=0.0, append=0.0)
        total = (v * v).sum() / 2 + (self.linear * e**2 / 2 + self.cubic * e**3 / 3).sum()
        if self.on_site is not None:
            total += (self.on_site * u**2 / 2 + u**4 / 4).sum()
        return total


def chains():
    """Both chains: energies per site of 0.01 and 0.1, all of it kinetic at the start."""
    draw = np.random.default_rng(SEED)

    def start(density):
        v, tangent = draw.normal(size=(2, SITES))
        return np.zeros(SITES), v * np.sqrt(2 * density / np.mean(v * v)), tangent

    for name, density, linear, cubic, on_site in (
        ("alpha-FPUT", 0.01, 1.0, -0.25, None),
        ("disordered Klein-Gordon", 0.1, 0.25, 0.0, draw.uniform(0.5, 1.5, SITES)),
    ):
        u, v, tangent = start(density)
        size = np.linalg.norm(tangent)
        yield Chain(name, END, linear, cubic, on_site, u, v, (tangent / size, 0 * tangent))


def own(chain, name):
    """granjax's: `Flow.tangents`, the steps a number that compiles nothing anew."""
    lattice = chain.lattice()
    solver = getattr(gx, name)()
    begin = gx.State(jnp.asarray(chain.u), jnp.asarray(chain.v))
    vectors = gx.State(*(jnp.asarray(x)[:, None] for x in chain.tangent))
    part = chain.t1 / PARTS

    @jax.jit
    def run(steps, y, tangents):
        def go(carry, _):
            carry = gx.Flow(steps, solver).tangents(*carry, 0.0, part, lattice)
            return carry, carry[0]

        (_, moved), frames = jax.lax.scan(go, (y, tangents), None, length=PARTS)
        return frames, moved

    def call(steps):
        frames, moved = jax.block_until_ready(run(jnp.asarray(steps), begin, vectors))
        return np.asarray(frames.u), np.asarray(frames.v), np.asarray(moved.u)[:, 0]

    return call


@cache
def _loop():
    """A fused loop of numba: state and tangent go through a stage together."""
    import numba

    @numba.njit(fastmath=True)
    def run(u, v, U, V, a, b, h, steps, linear, cubic, on_site, quartic):
        n = u.size
        for step in range(steps):
            for i in range(b.size):
                # the kick that ends a step and the one that opens the next are one
                kick = b[i] * h
                if i == 0 and step > 0:
                    kick = 0.0
                if i == b.size - 1 and step < steps - 1:
                    kick += b[0] * h
                if kick != 0.0:
                    left = dleft = 0.0
                    before = dbefore = 0.0
                    for j in range(n + 1):
                        now = u[j] if j < n else 0.0
                        dnow = U[j] if j < n else 0.0
                        e = before - now
                        de = dbefore - dnow
                        force = e * (linear + cubic * e)
                        dforce = de * (linear + 2 * cubic * e)
                        if j > 0:
                            p = before
                            dp = dbefore
                            v[j - 1] += kick * (
                                left - force - p * (on_site[j - 1] + quartic * p * p)
                            )
                            V[j - 1] += kick * (
                                dleft - dforce - dp * (on_site[j - 1] + 3 * quartic * p * p)
                            )
                        left = force
                        dleft = dforce
                        before = now
                        dbefore = dnow
                if i < a.size:
                    for j in range(n):
                        u[j] += a[i] * h * v[j]
                        U[j] += a[i] * h * V[j]

    return run


def numbas(chain, name):
    """The same tables in the loop of numba."""
    run = _loop()
    table = tables.splitting(name)
    on_site = np.zeros(SITES) if chain.on_site is None else chain.on_site
    force = chain.linear, chain.cubic, on_site, 0.0 if chain.on_site is None else 1.0

    def call(steps):
        u, v, U, V = (x.copy() for x in (chain.u, chain.v, *chain.tangent))
        frames = []
        for _ in range(PARTS):
            h = chain.t1 / PARTS / steps
            run(u, v, U, V, table.a, table.b, h, steps, *force)
            frames.append((u.copy(), v.copy()))
        return *map(np.array, zip(*frames)), U

    return call


def taylor(chain):
    """heyoka's Taylor series of state and tangent, in compact mode; each tolerance compiles one of its own."""
    import heyoka as hy

    names = [[f"{x}{n}" for n in range(SITES)] for x in ("u", "v", "U", "V")]
    u, v, U, V = (hy.make_vars(*x) for x in names)
    equations = []
    ends = lambda x, n: x[n] if 0 <= n < SITES else 0.0
    for n in range(SITES):
        force = 0.0
        change = 0.0
        for sign, i, j in ((1, n - 1, n), (-1, n, n + 1)):
            e = ends(u, i) - ends(u, j)
            de = ends(U, i) - ends(U, j)
            force += sign * e * (chain.linear + chain.cubic * e)
            change += sign * de * (chain.linear + 2 * chain.cubic * e)
        if chain.on_site is not None:
            force -= u[n] * (chain.on_site[n] + u[n] ** 2)
            change -= U[n] * (chain.on_site[n] + 3 * u[n] ** 2)
        equations += [(u[n], v[n]), (v[n], force), (U[n], V[n]), (V[n], change)]
    start = np.stack([chain.u, chain.v, *chain.tangent], 1).ravel()

    @cache
    def build(tolerance):
        return hy.taylor_adaptive(
            equations, start, tol=tolerance, compact_mode=True, fast_math=True
        )

    def call(tolerance):
        flow = build(tolerance)
        frames = []
        flow.time = 0.0
        flow.state[:] = start
        for k in range(PARTS):
            flow.propagate_until(chain.t1 * (k + 1) / PARTS)
            frames.append(flow.state.reshape(SITES, 4).T[:2].copy())
        return *np.swapaxes(frames, 0, 1), flow.state.reshape(SITES, 4)[:, 2].copy()

    return call


def measured(chain, quick, repeats):
    """The points of every method: value, error of the energy, seconds (median over rounds in turn); who is left out."""
    counts = np.unique(np.ceil(chain.t1 / PARTS / (LONGEST * RUNG ** np.arange(RUNGS)))).astype(int)
    ladders = {f"granjax {x}": (own(chain, x), counts) for x in METHODS}
    left_out = {}
    try:
        ladders |= {f"numba {x}": (numbas(chain, x), counts) for x in METHODS}
    except ImportError as error:
        left_out["numba"] = str(error)
    try:
        ladders["heyoka"] = taylor(chain), TOLERANCES
    except ImportError as error:
        left_out["heyoka"] = str(error)
    begin = chain.energy(chain.u, chain.v)
    found = {}
    ends = {}
    for name, (call, values) in ladders.items():
        points = []
        for value in values[-3:-2] if quick else values:
            # the first call of a program compiles, and is not timed
            us, vs, ends[name] = call(value)
            # the coarsest steps may be unstable
            with np.errstate(over="ignore", invalid="ignore"):
                energies = np.array([chain.energy(u, v) for u, v in zip(us, vs)])
            error = float(np.max(np.abs(energies / begin - 1)))
            good = np.isfinite(error) and error > ROUNDING
            step = chain.t1 / PARTS / value if name != "heyoka" else value
            points.append({"value": float(step), "error": error, "drawn": bool(good), "times": []})
        found[name] = points
    for _ in range(repeats):
        for name, (call, values) in ladders.items():
            for point, value in zip(found[name], values[-3:-2] if quick else values):
                if point["drawn"]:
                    since = time.perf_counter()
                    call(value)
                    point["times"].append(time.perf_counter() - since)
    for point in (point for points in found.values() for point in points):
        times = point.pop("times")
        point["seconds"] = statistics.median(times) if times else None
    return {"name": chain.name, "left_out": left_out, "points": found}, ends


def answers(result):
    """At both errors the seconds of every method, the fastest of each of those who answer, and granjax over numba."""
    found = {}
    for error in ERRORS:
        seconds = {name: time_at(x, error, "seconds") for name, x in result["points"].items()}
        seconds = {name: x for name, x in seconds.items() if x is not None}
        first = {}
        for who in ("granjax", "numba", "heyoka"):
            own = [name for name in seconds if name.startswith(who)]
            if own:
                first[who] = min(own, key=seconds.get)
        found[f"{error:.0e}"] = {
            "seconds": seconds,
            "first": first,
            "granjax_over": {x: seconds[first["granjax"]] / seconds[y] for x, y in first.items()},
        }
    return found


def drawn(results, path):
    """Error against time, a panel for each chain."""
    with style():
        made = figure(7.2, 3.6)
        axes = made.subplots(1, 2, sharey=True)
        for ax, result in zip(axes, results):
            for i, name in enumerate((*METHODS, "heyoka")):
                kinds = (
                    {name: "-"}
                    if name == "heyoka"
                    else {f"granjax {name}": "-", f"numba {name}": ":"}
                )
                for method, line in kinds.items():
                    points = [p for p in result["points"].get(method, ()) if p["drawn"]]
                    xy = [[p[k] for p in points] for k in ("seconds", "error")]
                    label = None if line == ":" else name
                    ax.plot(*xy, line, color=f"C{i}", label=label, lw=1.2)
            ax.set(xscale="log", yscale="log", title=result["name"], xlabel="time of a run (s)")
        axes[0].set_ylabel("largest relative error of the energy")
        axes[0].plot([], [], ":", color="0.3", label="the same, numba")
        made.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
    save(made, path)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one point a method, nothing written")
    parser.add_argument("--out", type=Path, help="folder for splittings.json and the chart")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    folder = options.out or (None if options.quick else HERE)
    results = []
    for chain in chains():
        result, ends = measured(chain, options.quick, 1 if options.quick else options.repeats)
        for name, end in ends.items():
            # at the finest step all agree, heyoka with the most accurate method
            other = "SRKN14a" if name == "heyoka" else name.split()[1]
            known = ends[f"granjax {other}"]
            apart = np.abs(end - known).max() / np.abs(known).max()
            if not apart < AGREEMENT:
                raise SystemExit(f"{chain.name}: the tangents of {name} differ by {apart:.1g}.")
        if not options.quick:
            result["answers"] = answers(result)
            for error, row in result["answers"].items():
                print(chain.name, error, {k: f"{v:.3g} s" for k, v in row["seconds"].items()})
                print("   first", row["first"], row["granjax_over"])
        results.append(result)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps({**machine(), "load": os.getloadavg(), "chains": results}, indent=1)
        (folder / "splittings.json").write_text(text + "\n")
        drawn(results, folder / "splittings.png")


if __name__ == "__main__":
    main()
