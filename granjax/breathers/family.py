"""Families of breathers by continuation from a linear mode or from a breather."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import refuse
from ..continuation import continuation
from ..floquet import decide
from ..linear import normal_modes
from ..tuning import one_thread
from .branch import Branch, Breather
from .problem import (
    DOUBLINGS,
    LET_PASS,
    TOLERANCE,
    by_frequency,
    checked_lattice,
    half_steps,
    spectra_of,
    spectrum_of,
    states_of,
)

# of the first orbit beside a linear mode, in units of the largest amplitude that a step may add
FIRST = 0.1
PROBE = 4
# a doubling that lowers the error by less has met a contact that opens
SLOW = 20


@one_thread
def family(lattice, until=None, *, guess=None, amplitude=None, mode=None, arclength=None, longest_arclength=None,
           points=200, steps=None, solver=None, tolerance=TOLERANCE, stability=True,
           veto=None, stop=None):
    r"""A family of time-reversible breathers, followed in (u, omega) with its stability.

    Without a `guess` it begins at a linear mode (a Lyapunov family): amplitude zero, the mode's frequency. The branch
    is followed by pseudo-arclength through folds.

    **Arguments:**

    - `lattice`: a conservative, autonomous `Lattice`; bright families need a gap, and a mode that shifts into it.
    - `until`: the frequency at which to end; `amplitude`: the largest |u| at which to end. One of them, or `points`.
    - `guess`: a `Breather` to begin at. `mode`: index of the linear mode; `None` takes the one next to `until` whose
      frequency moves towards it, and without `until` the highest.
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
    if guess is not None and not isinstance(guess, Breather):
        refuse("guess", "a Breather", f"a {type(guess).__name__}", "gx.breathers.breather finds one.")
    modes = normal_modes(lattice) if guess is None else None
    ways = [_from(guess)] if guess is not None else _modes(modes, until, mode)
    unit = 1.0 if arclength is None else arclength / 0.02
    arclength = 0.02 * unit
    longest_arclength = 0.15 * unit if longest_arclength is None else longest_arclength

    def follow(way, count, most):
        problem = by_frequency(lattice, count, solver)
        x0, omega, direction = way(problem.half)
        grown = None if amplitude is None else _grown(problem.half, amplitude)
        return problem, continuation(
            problem.residual, x0, omega, args=lattice, until=until, direction=direction(until), points=most,
            arclength=arclength if guess is not None else FIRST * arclength, longest_arclength=longest_arclength,
            least_arclength=1e-6 * arclength, linearise=problem.linearise, tolerance=tolerance, veto=veto,
            stop=_both(grown, stop))

    count = half_steps(lattice, 2 * np.pi / ways[0](by_frequency(lattice, 8).half)[1], steps)
    chosen = ways[0] if len(ways) == 1 else _towards(ways, until, lambda way: follow(way, count, PROBE)[1])
    problem, curve = follow(chosen, count, points)
    enough = count if steps else _enough(problem, lattice, curve, count)
    if enough > count:
        problem, curve = follow(chosen, enough, points)
    return _branch(problem, lattice, curve, stability)


def _enough(problem, lattice, curve, count):
    """Steps for which the last tangent map is known well enough, or from which on more help little (open contacts)."""
    before = np.inf
    for doubled in count * 2 ** np.arange(DOUBLINGS):
        problem = eqx.tree_at(lambda p: p.half.flow.steps, problem, jnp.asarray(doubled, int))
        error = spectrum_of(problem, lattice, curve.x[-1], curve.p[-1]).step_error
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


def _branch(problem, lattice, curve, stability):
    states, energy = states_of(problem, lattice, jnp.asarray(curve.x))
    found = list(spectra_of(problem, lattice, curve.x, curve.p)) if stability else []
    verdicts = [decide(s.multipliers, s.error, s.expected, True)[0] for s in found]
    size = 2 * problem.half.size
    none = np.full((len(curve.p), size), np.nan)
    return Branch(
        curve.p, np.asarray(energy), np.abs(curve.x[:, : problem.half.size]).max(1),
        jax.tree.map(np.asarray, states.u),
        np.stack([s.multipliers for s in found]) if found else none.astype(complex),
        np.stack([s.error for s in found]) if found else none,
        np.array(verdicts if found else [""] * len(curve.p)),
        np.array([s.step_error for s in found]) if found else np.full(len(curve.p), np.nan),
        curve.folds, curve.branch_points, curve.outcome, curve.x, curve.tangents, curve, problem, lattice,
    )
