"""Runs of first-order lattices, each with its error."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import positive, refuse, show, traced
from ..base.checks import tolerance as checked_tolerance
from ..base.programs import compiled
from ..base.types import Amplitudes, Count, Flags, Number, Numbers, Parameter, Scalar, Times
from ..flow import Flow
from ..results import Result, array, note
from .equations import Equation, check_shape, density, field
from .split_step import SplitStep

# the first run's step times the fastest rate, with SplitStep and with other solvers
BEGIN = {True: 1.0, False: 0.3}
# the most halvings of the step
HALVINGS = 6
# power iterations for the fastest rate
ITERATIONS = 30
# rounding error of a step, in units in the last place
ROUNDED = 4


class Evolution(Result):
    """A run of a first-order lattice, from `gx.first_order.evolve`."""

    ts: Times = array("The times.", "s", "time", name="time")
    psis: Amplitudes = array("The amplitudes psi.", axes="time site", name="psi")
    error: Numbers = array(
        "The largest distance of any site to a run with twice the step, an upper bound if "
        "steps are short enough, plus the growth of rounding errors at the start, which "
        "chaos amplifies.",
        axes="time",
    )
    norm: Numbers = array("The norm.", axes="time")
    energy: Numbers = array("The energy H.", axes="time")
    norm_error: Numbers = note("The largest change of the norm, over the norm.")
    energy_error: Numbers = note(
        "The largest change of the energy, over max(|H|, sum |psi| |dH/dpsi*|)."
    )
    step: Number = array("The time step.", "s")
    tolerance: Number = array("The requested tolerance.")
    solver: str = array("The name of the solver.", static=True)

    @property
    def final(self) -> Amplitudes:
        """psi at the last time."""
        return self.psis[-1]

    @property
    def densities(self) -> Numbers:
        """|psi_n|^2 (T, N, *lanes)."""
        return density(self.psis)

    @property
    def completed(self) -> Flags:
        """Whether the error is below the tolerance times the root of the norm, in every lane."""
        return (self.error <= self.tolerance * self.norm[0] ** 0.5).all()

    @property
    def outcome(self) -> str:
        if traced((self.psis, self.error)):
            return "Not known while traced."
        if not np.isfinite(np.asarray(self.error)).all():
            return "The state is not finite: the motion left the equation's domain, or the step is too long."
        t, worst, asked = (float(np.max(x)) for x in (self.ts, self.error, self.tolerance))
        if bool(self.completed):
            return f"Completed at t = {t:g}, known to {worst:.1e}."
        return (
            f"Reached t = {t:g}, known to {worst:.1e} and not to {asked:.1e} times the root of "
            "the norm: the motion is unstable or not smooth, or the steps are too long."
        )


def evolve(
    equation: Equation,
    psi: Amplitudes,
    t1: Scalar,
    *,
    save_at: Count | Parameter | None = None,
    solver: diffrax.AbstractSolver | None = None,
    step: Scalar | None = None,
    tolerance: Scalar = 1e-10,
) -> Evolution:
    """Integrate psi from 0 to t1, by fixed steps that are halved until two runs agree.

    **Arguments:**

    - `equation`: `DNLS`, `DpS` or one of your own. `psi`: the start (N, *lanes), real or complex.
    - `save_at`: `None` for the end alone, a number of frames, or increasing times within [0, t1].
    - `solver`: any diffrax solver; `None` takes `SplitStep`, which keeps the norm, if the equation
      has its flows, else `diffrax.Dopri8`.
    - `step`: the longest step of the first run; a second run halves it once. `None` chooses it by
      the fastest rate at the start and halves it until the tolerance is met, at most six times.
    - `tolerance`: of |psi_n|, relative to the root of the norm.

    **Returns:** `Evolution`; its `outcome` gives the accuracy. With `step` given, it differentiates
    in both modes in the start and in the numbers of the equation.
    **Raises** ValueError for another shape, times out of order, a step that is not above zero.

    **Example:**

    >>> chain = gx.first_order.DNLS(20, coupling=1.0, nonlinearity=0.0)
    >>> run = gx.first_order.evolve(chain, np.eye(20)[10], 1.0, save_at=5)
    >>> round(float(abs(run.final[10])), 6)  # J_0(2)
    0.223891
    """
    psi = _start(equation, psi)
    times, first = _times(t1, save_at)
    checked_tolerance("tolerance", tolerance)
    solver = solver or (SplitStep() if equation.has_flows else diffrax.Dopri8())
    halve = step is None
    step = _step(equation, psi, solver, times[-1]) if halve else positive("step", step)
    counts = np.maximum(np.ceil(np.diff(times) / float(step) * (1 - 1e-12)), 1).astype(int)
    run = lambda counts, psi=psi: _run(solver, equation, psi, times, counts)
    before = run(counts)
    now = run(2 * counts)
    halvings = 1
    turned = _turned(psi, jnp.asarray(int(counts.sum())))
    rounding = jnp.abs(run(counts, turned) - before)
    far = _apart(before, now) if halve else 0.0
    while far > float(tolerance) and halvings < HALVINGS:
        after = run(2 ** (halvings + 1) * counts)
        closer = _apart(now, after)
        if not closer < far:  # rounding or chaos limits the agreement
            break
        before = now
        now = after
        halvings = halvings + 1
        far = closer
    taken = float(np.max(np.diff(times) / counts)) / 2**halvings
    error = jnp.max(jnp.abs(before - now) + 2**halvings * rounding, axis=1)
    norms, energies, scale = _measured(equation, now)
    moved = lambda x, size: jnp.max(jnp.abs(x - x[0]), axis=0) / jnp.where(size > 0, size, 1.0)
    return Evolution(
        jnp.asarray(times)[first:],
        now[first:],
        error[first:],
        norms[first:],
        energies[first:],
        moved(norms, norms[0]),
        moved(energies, scale),
        taken,
        tolerance,
        type(solver).__name__,
        # without units, with the lanes of a batch
        _mark=jnp.full((1, *now.shape[2:]), jnp.nan),
        _space=(1, 0),
    )


def _start(equation, psi):
    psi = jnp.asarray(psi)
    psi = psi.astype(jnp.result_type(psi, jnp.complex64))
    check_shape(psi, equation)
    lanes = "Give the initial state the equation's lanes, on its last axis."
    try:
        found = jax.eval_shape(equation.rate, psi)
    except (TypeError, ValueError) as error:  # JAX reports shapes that do not fit
        refuse(
            "psi", "an initial state that fits the equation", f"shape {psi.shape}: {error}", lanes
        )
    if found.shape != psi.shape:
        wanted = f"shape {found.shape}, with the lanes of the equation"
        refuse("psi", wanted, f"shape {psi.shape}", lanes)
    return psi.astype(found.dtype)


def _times(t1, save_at):
    t1 = float(t1)
    if not t1 > 0:
        refuse("t1", "a time above zero", f"{t1}")
    if save_at is None or np.ndim(save_at) == 0 and save_at <= 1:
        return np.array([0.0, t1]), 1
    if np.ndim(save_at) == 0:
        return np.linspace(0.0, t1, int(save_at)), 0
    times = np.asarray(save_at, float)
    if not (times.size and np.all(np.diff(times) > 0)):
        refuse("save_at", "increasing times", show(times))
    if times[0] < 0 or times[-1] > t1:
        refuse("save_at", f"times within [0, {t1}]", f"{times[0]} ... {times[-1]}")
    return (times, 0) if times[0] == 0 else (np.concatenate([[0.0], times]), 1)


def _step(equation, psi, solver, longest):
    if traced((equation, psi)):
        refuse(
            "step",
            "a step where numbers are traced, since their fastest rate is not known",
            "None",
            "Give step=, such as 0.5 over the fastest rate.",
        )
    rate = float(fastest_rate(equation, psi))
    return BEGIN[isinstance(solver, SplitStep)] / rate if rate > 0 else longest


@compiled
def fastest_rate(equation: Equation, psi: Amplitudes) -> Number:
    """Return the fastest rate at psi in all lanes."""
    # By power iteration on the linearisation.
    along = jnp.exp(1j * _angles(psi))

    def improve(_, carry):
        along, _ = carry
        along = jax.jvp(equation.rate, (psi,), (along,))[1]
        size = jnp.sqrt(jnp.sum(jnp.abs(along) ** 2))
        return along / jnp.where(size > 0, size, 1.0), size

    return jax.lax.fori_loop(0, ITERATIONS, improve, (along, jnp.zeros((), jnp.real(psi).dtype)))[1]


def _angles(psi):
    # Return angles from the golden angle, to which no mode is orthogonal.
    n = jnp.arange(psi.size, dtype=jnp.real(psi).dtype).reshape(psi.shape)
    return 2.399963 * n**2


@compiled
def _turned(psi, steps):
    # Return the start with phases moved by the rounding of that many steps, which has one sign.
    return psi * jnp.exp(1j * steps * ROUNDED * jnp.finfo(psi.dtype).eps * jnp.cos(_angles(psi)))


def _run(solver, equation, psi, times, counts):
    ends = jnp.asarray(times, jnp.real(psi).dtype)
    if traced((equation, psi)):  # reverse mode needs a known number of steps
        frames = [psi]
        for a, b, count in zip(ends[:-1], ends[1:], counts):
            frames.append(Flow(int(count), solver, field)(frames[-1], a, b, equation))
        return jnp.stack(frames)
    return _marched(solver, equation, psi, ends, jnp.asarray(counts))


@compiled
def _marched(solver, equation, psi, ends, counts):
    def span(psi, x):
        a, b, count = x
        psi = Flow(count, solver, field)(psi, a, b, equation)
        return psi, psi

    return jnp.concatenate([psi[None], jax.lax.scan(span, psi, (ends[:-1], ends[1:], counts))[1]])


def _apart(before, now):
    # Return the largest distance of two runs over the root of the norm; huge if not finite.
    before = np.asarray(before)
    now = np.asarray(now)
    norm = np.sum(np.abs(now[0]) ** 2, axis=0)
    apart = np.max(np.abs(before - now), axis=(0, 1))
    found = np.max(apart / np.sqrt(np.where(norm > 0, norm, 1.0)))
    return float(found) if np.isfinite(found) else np.finfo(float).max


@compiled
def _measured(equation, psis):
    norms, energies = jax.lax.map(lambda psi: (equation.norm(psi), equation.energy(psi)), psis)
    size = jnp.sum(jnp.abs(psis[0]) * jnp.abs(equation.gradient(psis[0])), axis=0)
    return norms, energies, jnp.maximum(jnp.abs(energies[0]), size)
