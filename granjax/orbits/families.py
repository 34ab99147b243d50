"""Families of breathers by continuation from a linear mode or from a breather."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from ..checks import refuse, traced
from ..continuation import Curve
from ..flow import Flow
from ..lattice import Lattice
from ..linear import NormalModes, normal_modes
from ..solvers import KahanLi8
from ..tuning import one_thread
from ..types import Count, Counts, Scalar, StateLike
from .branch import Branch, special_of
from .confirm import BRANCH, LEFT_ON_BRANCH, newtons
from .examined import branch_of, examined, examined_along
from .orbit import Orbit
from .problems import Family, Shooting, over_omega
from .repeats import checked_lattice, largest
from .scales import nonlinear_length
from .steps import default_steps

# change of the tangent map between two step sizes that is let pass
LET_PASS = 1e-8
# a doubling that lowers this change by less has met a contact that opens
SLOW = 20
# how often the steps are doubled
DOUBLINGS = 8
# the first step along the branch, in the lattice's own length and the first frequency, the longest over it, and that
# to the first orbit beside a linear mode
ARCLENGTH = 0.05
LONGEST = 7.5
FIRST = 0.1
# points by which the way of a family is told
PROBE = 4
# of the largest entry of a mode, by which another one is as large
EQUAL = 1e-6


@one_thread
def family(
    lattice: Lattice,
    until: Scalar | None = None,
    *,
    guess: Orbit | None = None,
    amplitude: Scalar | None = None,
    mode: Count | None = None,
    arclength: Scalar | None = None,
    longest_arclength: Scalar | None = None,
    points: Count = 200,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
    tolerance: Scalar = BRANCH,
    stability: bool = True,
    stop: Callable[[Any, Any], Any] | None = None,
) -> Branch:
    r"""A family of time-reversible breathers, followed in (u, omega) with its stability.

    Without a `guess` it begins at a linear mode (a Lyapunov family): amplitude zero, the mode's frequency. The branch
    is followed by pseudo-arclength through folds. Modes are waves but for those of defects: between walls or free ends
    their families localise as they grow, on a ring they may stay waves, which `gx.breathers.localisation` tells; a
    `guess` from `gx.breathers.breather` begins at a localised one.

    **Arguments:**

    - `lattice`: a conservative, autonomous `Lattice`; bright families need a gap, and a mode that shifts into it.
    - `until`: the frequency at which to end; `amplitude`: the largest |u| at which to end. One of them, or `points`.
    - `guess`: a breather (an `Orbit`) to begin at. `mode`: index of the linear mode; `None` takes the one next to
      `until` whose frequency moves towards it, and without `until` the highest.
    - `arclength`, `longest_arclength`: steps along the branch, first and longest (7.5 times the first), in (u, omega)
      with omega in units of the first frequency and u in those of `scales.nonlinear_length`: the amplitude at which
      a contact's stiffness has changed by a half (3/8 of the overlap for Hertz and neighbours in opposite phase).
    - `points`: the most breathers. `steps`: time steps in a period, an even number; `None` begins at h omega_max = 0.3
      and doubles them until the largest breather is known to `tolerance`, relative to its amplitude, and its tangent
      map to 1e-8, or as well as contacts that open allow.
    - `stability`: also the multipliers. `stop(u, omega)`: a reason to end the family there, or `None`.

    **Returns:** `Branch`. **Raises** ValueError for lattices that are damped, driven or in lanes, a mode that is not
    there, and both `mode` and `guess`; RuntimeError where the first breather is not found.
    Source: Flach, Gorbach, Phys. Rep. 467, 1 (2008); Theocharis et al., Phys. Rev. E 82, 056604 (2010).

    **Example:**

    >>> chain = gx.scenes.klein_gordon(5, 0.02)
    >>> branch = gx.breathers.family(chain, points=3, arclength=0.3, steps=64, stability=False)
    >>> branch.outcome
    'The 3 points that were asked for.'
    >>> branch.omega.round(4).tolist()
    [1.0356, 1.0356, 1.0357]
    """
    checked_lattice(lattice)
    if guess is not None and mode is not None:
        refuse("mode", "a mode or a guess", "both", "A guess says where the family begins.")
    modes = normal_modes(lattice) if guess is None else None
    ways = [_from(guess, until)] if guess is not None else _modes(lattice, modes, until, mode)
    arclength = ARCLENGTH if arclength is None else arclength
    longest_arclength = LONGEST * arclength if longest_arclength is None else longest_arclength

    def follow(way, count, most=points):
        problem = over_frequency(lattice, count, solver, way.length, way.omega, tolerance)
        free, direction = np.zeros(problem.shooting.moves.shape[1]), way.direction
        if np.ndim(direction):
            direction = np.concatenate([direction, free, [0.0]])
        return problem, problem.follow(
            np.append(way.x, free),
            1.0,
            until=None if until is None else until / way.omega,
            direction=direction,
            points=most,
            arclength=arclength if guess is not None else FIRST * arclength,
            longest_arclength=longest_arclength,
            least_arclength=1e-6 * arclength,
            stop=_ends(problem, amplitude, stop),
        )

    count = half_steps(lattice, 2 * np.pi / ways[0].omega, steps or ways[0].steps)
    chosen = (
        ways[0]
        if len(ways) == 1
        else _towards(ways, until, lambda way: follow(way, count, PROBE)[1])
    )
    return confirmed_branch(
        lambda count: follow(chosen, count), count, steps is None, tolerance, stability
    )


def confirmed_branch(
    follow: Callable[[int], tuple[Family, Curve]],
    count: Count,
    refine: bool,
    tolerance: Scalar,
    stability: bool,
) -> Branch:
    """The breathers that `follow(count)` finds by so many steps of half a period, or by enough of them."""
    problem, curve = follow(count)
    enough = _enough_steps(problem, curve, count, tolerance, stability) if refine else count
    if enough > count:
        problem, curve = follow(enough)
    along = examined_along(problem, curve, stability=stability)
    return branch_of(problem, curve, along, special_of(problem, curve))


def _enough_steps(problem, curve, count, tolerance, stability):
    """Steps for which the largest breather is known well enough, and its tangent map too, or more would help little."""
    before, i = np.inf, np.argmax(np.abs(curve.x).max(1))
    z, size = np.append(curve.x[i], curve.p[i]), np.abs(curve.x[i]).max()
    for doubled in count * 2 ** np.arange(DOUBLINGS):
        found = examined(problem.with_steps(doubled), z)
        error = found.step_error
        passes = not stability or error <= LET_PASS or error > before / SLOW
        if passes and found.changes.max() <= tolerance * size:
            break
        before = error
    return int(doubled)


class _Way(NamedTuple):
    """Where a family begins: beside a linear mode, or at a breather.

    `omega`, `length`: its units. `x`: displacements at rest over the length. `direction`: +1 or -1, the way the
    frequency goes, or displacements. `steps`: of a period, where they are known.
    """

    omega: float
    length: float
    x: np.ndarray
    direction: np.ndarray | float
    steps: int | None = None


def _from(guess, until):
    omega, u, size = float(guess.omega), guess.state.u, float(largest(guess.state.u))
    length = nonlinear_length(guess.lattice, u)
    length = max(size, length) if np.isfinite(length) else size
    x, direction = np.asarray(ravel_pytree(u)[0]) / length, np.sign((until or np.inf) - omega)
    return _Way(omega, length, x, direction or 1.0, even_steps(guess))


def _modes(lattice, modes, until, mode):
    """Ways to begin at a linear mode, those to try in their order."""
    omega = np.asarray(modes.omega)
    shapes = flat_modes(modes)
    if mode is not None:
        chosen = [mode]
    elif until is None:
        chosen = [len(omega) - 1]
    else:
        above, below = np.flatnonzero(omega > until), np.flatnonzero((omega < until) & (omega > 0))
        chosen = [*above[:1], *below[-1:]]
        chosen.sort(key=lambda i: abs(omega[i] - until))
    if not chosen or not omega[chosen[0]] > 0:
        refuse(
            "lattice",
            "a linear mode that oscillates",
            "none (a sonic vacuum?)",
            "Give guess=, from gx.breathers.breather.",
        )
    return [
        _beside(
            lattice, float(omega[i]), shapes[:, i], jax.tree.map(lambda x: x[..., i], modes.modes)
        )
        for i in chosen
    ]


def flat_modes(modes: NormalModes) -> Float[np.ndarray, "n modes"]:
    """The shapes of normal modes over the raveled displacements, as columns."""
    leaves = jax.tree.leaves(modes.modes)
    return np.concatenate([np.asarray(x).reshape(-1, len(modes.omega)) for x in leaves])


def _beside(lattice, omega, shape, mode):
    # the first of equal ones, whichever rounding makes the largest
    peak = shape[np.argmax(np.abs(shape) > (1 - EQUAL) * np.abs(shape).max())]
    length = nonlinear_length(lattice, jax.tree.map(lambda w: w / peak, mode))
    if not 0 < length < np.inf:
        refuse(
            "lattice",
            "a mode that is neither linear to all amplitudes nor without any stiffness at rest",
            f"one of length {length}",
            "Give guess=, from gx.breathers.breather.",
        )
    return _Way(omega, length, 0 * shape, shape / peak)


def _towards(ways, until, probe):
    """The first way whose frequency moves towards `until`."""
    said = []
    for way in ways:
        try:
            found = probe(way)
        except RuntimeError as failed:
            said.append(f"the family from the mode at {way.omega:.6g} was not found ({failed})")
            continue
        if (found.p[-1] - found.p[0]) * (
            until / way.omega - found.p[0]
        ) > 0 or "reached" in found.outcome:
            return way
        said.append(
            f"the frequency of the mode at {way.omega:.6g} moves away from it with amplitude"
        )
    refuse(
        "until",
        "a frequency that a family moves to",
        f"{until:.6g}",
        f"Give mode= or guess=: {'; '.join(said)}.",
    )


def _ends(problem, amplitude, stop):
    """Why a family ends before its time, asked in the lattice's own units."""
    half = problem.shooting

    def why(x, q):
        u = half.state(jnp.asarray(x)).u
        if amplitude is not None and float(largest(u)) >= amplitude:
            return f"the amplitude is {float(largest(u)):.4g}"
        return None if stop is None else stop(u, float(problem.value(q)))

    return None if amplitude is None and stop is None else why


def even_steps(orbit: Orbit) -> int:
    """Steps of an orbit's period, rounded up to an even number."""
    return 2 * -(-int(orbit.flow.steps) // 2)


def half_steps(
    lattice: Lattice,
    period: Scalar,
    steps: Count | Counts | None = None,
    guess: StateLike | None = None,
) -> Count:
    """Steps of half a period, from those of a whole one or by default; `guess`: as in `default_steps`."""
    if traced(steps):
        return steps // 2
    steps = default_steps(lattice, period, 2, doubled=True, guess=guess) if steps is None else steps
    if steps % 2:
        refuse("steps", "an even number, of which half a period takes half", repr(steps))
    return steps // 2


def over_frequency(
    lattice: Lattice,
    steps: Count,
    solver: AbstractSolver | None,
    length: Scalar,
    omega: Scalar,
    tolerance: Scalar,
) -> Family:
    """The breathers of a lattice over its frequency in units of omega, their displacements in units of a length.

    The steps of half a period may change without compiling anew.
    """
    half = Shooting.half(
        lattice, Flow(jnp.asarray(steps, int), solver or KahanLi8()), length=length, omega=omega
    )
    left = newtons(tolerance, lattice.dtype, LEFT_ON_BRANCH)
    return Family(half, lattice, over_omega, jnp.zeros(()), jnp.asarray(omega), left)
