"""Families of breathers by continuation from a linear mode or from a breather, and what is computed at each member."""

from collections.abc import Callable, Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree
from jaxtyping import Complex, Float, Inexact

from ..checks import refuse, whole
from ..continuation import continuation
from ..flow import Flow
from ..lattice import Lattice, spread_mass
from ..linear import normal_modes
from ..solvers import KahanLi8
from ..tuning import one_thread
from ..types import Count, Numbers, Scalar
from .branch import Branch, special_of, verdicts_of
from .orbit import Orbit
from .problems import Family, Shooting, over_omega
from .spectrum import reversible_multipliers
from .steps import default_steps

# the error of half a period that is let pass, and how often the steps are doubled for it
LET_PASS, DOUBLINGS = 1e-8, 5
TOLERANCE = 1e-11
# of the first orbit beside a linear mode, in units of the largest amplitude that a step may add
FIRST = 0.1
PROBE = 4
# a doubling that lowers the error by less has met a contact that opens
SLOW = 20


@one_thread
def family(
    lattice: Lattice, until: Scalar | None = None, *, guess: Orbit | None = None, amplitude: Scalar | None = None,
    mode: Count | None = None, arclength: Scalar | None = None, longest_arclength: Scalar | None = None,
    points: Count = 200, steps: Count | None = None, solver: AbstractSolver | None = None,
    tolerance: Scalar = TOLERANCE, stability: bool = True, veto: Callable | None = None, stop: Callable | None = None,
) -> Branch:
    r"""A family of time-reversible breathers, followed in (u, omega) with its stability.

    Without a `guess` it begins at a linear mode (a Lyapunov family): amplitude zero, the mode's frequency. The branch
    is followed by pseudo-arclength through folds.

    **Arguments:**

    - `lattice`: a conservative, autonomous `Lattice`; bright families need a gap, and a mode that shifts into it.
    - `until`: the frequency at which to end; `amplitude`: the largest |u| at which to end. One of them, or `points`.
    - `guess`: a breather (an `Orbit`) to begin at. `mode`: index of the linear mode; `None` takes the one next to
      `until` whose frequency moves towards it, and without `until` the highest.
    - `arclength`, `longest_arclength`: steps along the branch in (u, omega), in the unit of u; first 0.02 and at most
      7.5 times the first.
    - `points`: the most breathers. `steps`: time steps in a period, an even number; `None` takes h omega_max = 0.3 and
      doubles them where the tangent map at the end still changes by more than 1e-8.
    - `tolerance`: of max |v(T/2)|. `stability`: also the multipliers. `veto`, `stop`: as in `continuation`, on
      (x, omega).

    **Returns:** `Branch`. **Raises** ValueError for lattices that are damped, driven or in lanes, a mode that is not
    there, and both `mode` and `guess`; RuntimeError where the first breather is not found.
    Source: Flach, Gorbach, Phys. Rep. 467, 1 (2008); Theocharis et al., Phys. Rev. E 82, 056604 (2010).
    """
    checked_lattice(lattice)
    if guess is not None and mode is not None:
        refuse("mode", "a mode or a guess", "both", "A guess says where the family begins.")
    if guess is not None and not isinstance(guess, Orbit):
        refuse("guess", "a breather, an Orbit", f"a {type(guess).__name__}", "gx.breathers.breather finds one.")
    modes = normal_modes(lattice) if guess is None else None
    ways = [_from(guess)] if guess is not None else _modes(modes, until, mode)
    unit = 1.0 if arclength is None else arclength / 0.02
    arclength = 0.02 * unit
    longest_arclength = 0.15 * unit if longest_arclength is None else longest_arclength

    def follow(way, count, most):
        problem = over_frequency(lattice, count, solver)
        x0, omega, direction = way(problem.shooting)
        grown = None if amplitude is None else _grown(problem.shooting, amplitude)
        return problem, continuation(
            problem.residual, x0, omega, until=until, direction=direction(until), points=most,
            arclength=arclength if guess is not None else FIRST * arclength, longest_arclength=longest_arclength,
            least_arclength=1e-6 * arclength, linearise=problem.linearise, tolerance=tolerance, veto=veto,
            stop=_both(grown, stop))

    count = half_steps(lattice, 2 * np.pi / ways[0](over_frequency(lattice, 8).shooting)[1], steps, doubled=True)
    chosen = ways[0] if len(ways) == 1 else _towards(ways, until, lambda way: follow(way, count, PROBE)[1])
    problem, curve = follow(chosen, count, points)
    enough = count if steps else _enough(problem, curve, count)
    if enough > count:
        problem, curve = follow(chosen, enough, points)
    return _branch(problem, curve, stability)


def _enough(problem, curve, count):
    """Steps for which the last tangent map is known well enough, or from which on more help little (open contacts)."""
    before = np.inf
    for doubled in count * 2 ** np.arange(DOUBLINGS):
        problem = eqx.tree_at(lambda p: p.shooting.flow.steps, problem, jnp.asarray(doubled, int))
        error = next(spectra_of(problem, curve.x[-1:], curve.p[-1:])).step_error
        if error <= LET_PASS or error > before / SLOW:
            break
        before = error
    return int(doubled)


def _from(guess):
    def way(half):
        x0 = np.asarray(half.guess(guess.state))
        return x0, float(guess.omega), lambda until: np.sign((until or np.inf) - float(guess.omega)) or 1.0

    return way


def _modes(modes, until, mode):
    """Ways to begin at a linear mode, those to try in their order."""
    omega = np.asarray(modes.omega)
    shapes = np.concatenate([np.asarray(x).reshape(-1, len(omega)) for x in jax.tree.leaves(modes.modes)])
    if mode is not None:
        if not 0 <= mode < len(omega) or not omega[mode] > 0:
            refuse("mode", f"a mode that oscillates, of {len(omega)}", repr(mode))
        chosen = [mode]
    elif until is None:
        chosen = [len(omega) - 1]
    else:
        above, below = np.flatnonzero(omega > until), np.flatnonzero((omega < until) & (omega > 0))
        chosen = [*above[:1], *below[-1:]]
        chosen.sort(key=lambda i: abs(omega[i] - until))
    if not chosen or not omega[chosen[0]] > 0:
        refuse("lattice", "a linear mode that oscillates", "none (a sonic vacuum?)",
               "Give guess=, from gx.breathers.breather.")
    return [_beside(float(omega[i]), shapes[:, i]) for i in chosen]


def _beside(omega, shape):
    peak = np.argmax(np.abs(shape))
    shape = shape / shape[peak]

    def way(half):
        free = half.moves.shape[1]
        tangent = np.concatenate([shape, np.zeros(free + 1)])
        return np.zeros(len(shape) + free), omega, lambda until: tangent

    return way


def _towards(ways, until, probe):
    """The first way whose frequency moves towards `until`."""
    for way in ways:
        try:
            found = probe(way)
        except RuntimeError:
            continue
        if (found.p[-1] - found.p[0]) * (until - found.p[0]) > 0 or "reached" in found.outcome:
            return way
    refuse("until", "a frequency that a family moves to", f"{until:.6g}",
           "The linear modes next to it shift away from it with amplitude: give mode= or guess=.")


def _grown(half, amplitude):
    def stop(x, omega):
        size = float(np.abs(x[: half.size]).max())
        return f"the amplitude is {size:.4g}" if size >= amplitude else None

    return stop


def _both(first, second):
    if first is None or second is None:
        return first or second
    return lambda x, omega: first(x, omega) or second(x, omega)


def _branch(problem, curve, stability):
    states, energy = _states(problem, jnp.asarray(curve.x))
    found = list(spectra_of(problem, curve.x, curve.p)) if stability else []
    none = np.full((len(curve.p), 2 * problem.shooting.count), np.nan)
    multipliers, error, verdict = none.astype(complex), none, np.array([""] * len(curve.p))
    if stability:
        multipliers, error, verdict = verdicts_of([(s.multipliers, s.error) for s in found], found[0].expected, True)
    step_error = np.array([s.step_error for s in found]) if found else none[:, 0]
    half = problem.shooting.flow
    return Branch(
        curve.p, 2 * np.pi / curve.p, jax.tree.map(np.asarray, states), np.asarray(energy), None, multipliers, error,
        step_error, verdict, tuple(special_of(problem, curve)), curve.outcome, 0.0, Flow(2 * half.steps, half.solver),
        problem, curve)


def checked_lattice(lattice: Lattice) -> Lattice:
    """A lattice that has time-reversible, isolated families: single, conservative, autonomous."""
    if not isinstance(lattice, Lattice):
        refuse("lattice", "a Lattice", f"a {type(lattice).__name__}")
    if lattice.lanes:
        remedy = "Use jax.vmap(function, in_axes=-1)(lattice) for gx.breathers.breather with a guess."
        refuse("lattice", "one lattice", f"a batch with lanes {lattice.lanes}", remedy)
    if not lattice.conserves:
        names = ", ".join(lattice.unkept())
        remedy = "Orbits of damped or driven chains: gx.forced.forced_orbit."
        refuse("lattice", "forces that depend on positions alone", names, remedy)
    return lattice


def half_steps(lattice: Lattice, period: Scalar, steps: Count | None = None, *, doubled: bool = False) -> Count:
    """Steps of half a period, from those of a whole one or by default; `doubled`: as in `default_steps`."""
    steps = default_steps(lattice, period, 2, doubled=doubled) if steps is None else whole("steps", steps, 2)
    if steps % 2:
        refuse("steps", "an even number, of which half a period takes half", repr(steps))
    return steps // 2


def over_frequency(lattice: Lattice, steps: Count, solver: AbstractSolver | None = None) -> Family:
    """The breathers of a lattice over omega; the steps of half a period may change without compiling anew."""
    return Family(Shooting.half(lattice, Flow(jnp.asarray(steps, int), solver or KahanLi8())), lattice, over_omega)


@eqx.filter_jit
def _states(problem, xs):
    """States and energies of several unknowns along a leading axis."""
    states = jax.vmap(problem.shooting.state)(xs)
    return states, jax.lax.map(lambda y: problem.make.energy(0.0, y.u, y.v), states)


@eqx.filter_jit
def energy_slope(problem: Family, z: Numbers, tangent: Numbers) -> Numbers:
    """dE/ds along a tangent (x, omega) of a branch."""
    total = lambda x: (lambda y: problem.make.energy(0.0, y.u, y.v))(problem.shooting.state(x))
    return jax.jvp(total, (z[:-1],), (tangent[:-1],))[1]


@eqx.filter_jit
def _half_maps(problem, x, omega):
    """Tangent maps over half a period by the problem's flow and by twice its steps, in (u, m v)."""
    y, flow, lattice = problem.shooting.state(x), problem.shooting.flow, problem.make
    mass = ravel_pytree(spread_mass(lattice))[0]
    weight = jnp.concatenate([jnp.ones_like(mass), mass])

    def scaled(steps):
        _, map_ = Flow(steps, flow.solver, flow.field).derivative(y, 0.0, jnp.pi / omega, lattice)
        return map_ * weight[:, None] / weight

    return jax.lax.map(scaled, flow.steps * jnp.array([1, 2]))


class Spectrum(eqx.Module):
    """Half-traces (n,), multipliers (2n,) and their errors, the error of a step, the symmetries' multipliers."""

    half_traces: Inexact[np.ndarray, " n"]
    multipliers: Complex[np.ndarray, " two_n"]
    error: Float[np.ndarray, " two_n"]
    step_error: float
    expected: int


def spectra_of(problem: Family, xs: np.ndarray, omegas: np.ndarray) -> Iterator[Spectrum]:
    """The `Spectrum` of each of several orbits, from half a period with the problem's steps and with twice as many.

    While one is decomposed the next one's maps are on their way.
    """
    expected = 2 + 2 * problem.shooting.moves.shape[1]

    def launched(i):
        return _half_maps(problem, jnp.asarray(xs[i]), jnp.asarray(omegas[i]))

    coming = launched(0)
    for i in range(len(xs)):
        maps, coming = coming, launched(i + 1) if i + 1 < len(xs) else None
        coarse, fine = np.asarray(maps)
        traces, multipliers, error = reversible_multipliers(fine, coarse)
        yield Spectrum(traces, multipliers, error, float(np.abs(fine - coarse).max()), expected)
