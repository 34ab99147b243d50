"""Branches of forced orbits over a parameter, with their stability and bifurcations."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver

from ..checks import positive, refuse
from ..flow import Flow
from ..lattice import State
from ..measures import rms_velocity
from ..solvers import SRKN14a
from ..tuning import one_thread
from ..types import Count, Scalar, StateLike
from .bifurcations import along_forced
from .branch import Branch
from .confirm import BRANCH, DOUBLINGS, LEFT_ON_BRANCH, newtons
from .examined import branch_of, examined, examined_along
from .orbit import checked_free, prepared
from .problems import Family, made
from .repeats import checked_state, checked_symmetry
from .steps import fixed_step_solver, flow_over
from .symmetry import Symmetry

# of dp along the first tangent, so that a branch that begins near a fold does not count as endlessly steep
LEAST_SLOPE = 1e-2
# of two doublings of the steps, the least that they must lower an error by
HELPS = 4


@one_thread
def forced_branch(
    make: Callable[[Any], Any],
    start: Scalar,
    until: Scalar,
    *,
    period: Callable[[Any], Any] | Scalar,
    guess: StateLike | None = None,
    transient: Count = 0,
    t0: Scalar = 0.0,
    steps: Count | None = None,
    segments: Count = 1,
    solver: AbstractSolver | None = None,
    tolerance: Scalar = BRANCH,
    arclength: Scalar = 0.02,
    longest_arclength: Scalar | None = None,
    points: Count = 400,
    response: Callable[[Any, Any, Any, Any], Any] = rms_velocity,
) -> Branch:
    r"""Follow the periodic orbits of a forced lattice over a parameter, through folds, stable or not.

    Pseudo-arclength continuation of y(t0 + T; p) = y(t0). Stability at every point by the multipliers of the same
    flow; where their number outside the unit circle changes, the bifurcation between is located by Brent's method on
    the modulus that passes 1, folds by continuation itself. Two bifurcations within one step whose changes cancel
    are not seen: shorten `longest_arclength`.

    **Arguments:**

    - `make(p)`: the lattice at a value of the parameter, traced: `lambda f: driven_chain(chain, 0.1, 2 * jnp.pi * f)`.
      The same function again compiles nothing; a Module with arrays may change them too.
    - `start`, `until`: the branch begins at p = `start` towards `until`, and ends at either.
    - `period`: T, a number, or a function of p such as `lambda f: 1 / f`.
    - `guess`, `transient`, `t0`, `segments`, `solver`: of the first orbit, as in `forced_orbit`.
    - `steps`: per period, the same all along; `None` begins with the most that `start` or `until` asks for, and doubles
      them until half as many confirm every orbit to `tolerance`, relative to its size.
    - `arclength`, `longest_arclength`: first and longest (5 arclength) step along the branch, in which the
      way from `start` to `until` counts 1, and so does a change of the state by the first orbit's size, or by what its
      slope in p makes over the whole way, if that is more.
    - `points`: the most points. `response(lattice, u, v, t)`: a number from one period u, v (F, N), t (F,); by
      default the root mean square of all velocities.

    **Returns:** `Branch`. **Raises** ValueError for `until` equal to `start`, no forcing, and as `forced_orbit`;
    RuntimeError where the first orbit does not converge.
    Source: Doedel, Keller, Kernevez, Int. J. Bifurcation Chaos 1, 493 and 745 (1991); Kuznetsov, Elements of Applied
    Bifurcation Theory.

    **Example:**

    >>> chain = gx.scenes.monomer(3, precompression=1.0)
    >>> make = lambda a: gx.driven.driven_chain(chain, a, 0.5, damping=0.5)
    >>> branch = gx.forced.forced_branch(make, 0.01, 0.02, period=2 * np.pi / 0.5, steps=64, arclength=0.5)
    >>> branch.outcome
    'p reached 0.02.'
    >>> round(float(branch.response[-1] / branch.response[0]), 3)
    2.0
    """
    start, until = float(start), float(until)
    if start == until:
        refuse("until", "another value than start", repr(until))
    period = period if callable(period) else positive("period", period)
    longest_arclength = 5 * arclength if longest_arclength is None else longest_arclength
    scenes = [made(make, period, p) for p in (start, until)]
    solver = fixed_step_solver(scenes[0][0], solver, SRKN14a())
    lattice, T = scenes[0]
    guess = (
        State(lattice.zeros(), lattice.zeros())
        if guess is None
        else checked_state(lattice, guess, "guess")
    )
    flows = [flow_over(lattice, T, steps, solver, segments, guess) for lattice, T in scenes]
    # an array, whose value compiles nothing anew
    flow = Flow(jnp.asarray(max(int(f.steps) for f in flows)), solver)
    for lattice, T in scenes[::-1]:
        if checked_free(lattice):
            refuse(
                "make",
                "a lattice under forcing",
                "none",
                "Breathers over their frequency: gx.breathers.family.",
            )
        checked_symmetry(lattice, Symmetry(), guess, t0, T)
    shooting, x = prepared(
        lattice, T, guess, flow, jnp.asarray(t0, lattice.dtype), segments, jnp.asarray(transient)
    )
    left = newtons(tolerance, lattice.dtype, LEFT_ON_BRANCH)
    family = Family(shooting, make, period, jnp.asarray(start), jnp.asarray(until - start), left)
    first = family.follow(x, 0.0, points=1)
    # the unit of length: the first orbit, or where its slope over the whole way leads, if that is more
    slope = np.linalg.norm(first.tangents[0, :-1]) / max(abs(first.tangents[0, -1]), LEAST_SLOPE)
    unit = max(np.linalg.norm(first.x[0]), slope) or 1.0
    family = eqx.tree_at(lambda f: f.shooting.scale, family, unit * shooting.scale)
    x, most = first.x[0] / unit, 2**DOUBLINGS * int(flow.steps)
    while True:
        curve = family.follow(
            x,
            0.0,
            until=(0.0, 1.0),
            arclength=arclength,
            longest_arclength=longest_arclength,
            points=points,
            find=("fold",),
        )
        along = examined_along(family, curve, response)
        if steps is not None:
            break
        finer = _enough(family, curve, along[0], response, tolerance, most)
        if finer is family:
            break
        family, x = finer, curve.x[0]
    found = along_forced(family, curve, [multipliers for multipliers, *_ in along[1]], response)
    return branch_of(family, curve, along, found)


def _enough(family, curve, looked, response, tolerance, most):
    """The family by steps for which the branch is known well enough where it is known worst.

    What moves an orbit along the branch does not count: at a fold that is all.
    """
    scale = np.asarray(family.shooting.scale)

    def share(found, i):
        changes, along = np.asarray(found.changes) / scale, curve.tangents[i, : len(scale)]
        # of an orbit at rest neither is there
        changes = changes - (changes @ along)[:, None] * along / (along @ along or 1)
        return np.abs(changes).max() / (np.abs(curve.x[i, : len(scale)]).max() or 1)

    shares = [share(found, i) for i, found in enumerate(looked)]
    worst = int(np.argmax(shares))
    known, z = [shares[worst]], np.append(curve.x[worst], curve.p[worst])
    # where two doublings help little it is not the steps: another branch crosses there
    while (
        known[-1] > tolerance
        and 2 * family.shooting.whole.steps <= most
        and not (len(known) > 2 and known[-1] > known[-3] / HELPS)
    ):
        family = family.with_steps(2 * family.shooting.flow.steps)
        known.append(share(examined(family, z, response), worst))
    return family
