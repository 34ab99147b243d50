"""Work and precision of solvers on a scene, against a reference of its own: two methods of high order that agree."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import non_negative, positive, refuse, whole
from ..flow import simulate
from ..flow.inputs import checked_state, checked_times
from ..lattice import Lattice
from ..printing import told
from ..solvers import RKN86, RKN1210, SofroniouSpaletta10
from ..types import Count, Parameter, Pytree, Scalar, StateLike
from .ladder import distance, number, warmed
from .measuring import measure
from .solvers import (
    checked_solvers,
    checked_steps,
    default_ladder,
    highest_frequency,
    least_tolerance,
    reads_velocity,
    solver_ladders,
    splits,
    stable_step,
)
from .table import LARGEST_FLOOR, WorkPrecision

# a ladder ends where a call takes this many times as long as a coarse one; where that is slow [s], fewer times
LONGER, LITTLE_LONGER = 20.0, 4.0
AT_LEAST, SLOW = 0.1, 1.0
FIRST_TOLERANCE = 1e-9
# of the stability limit, then shorter by this each time
FIRST_STEP, SHORTER = 0.25, 2.0**-0.5
MOST_LEVELS = 14
# levels without gain before the search ends, twice as many where nothing agrees yet; what counts as gain
PATIENCE, GAIN = 2, 0.7
# steps and tolerances of the confirming runs, over those that they confirm
OTHER_MESH = 1.3


def work_precision(
    lattice: Lattice,
    state: StateLike,
    t1: Scalar,
    solvers: diffrax.AbstractSolver | Sequence | Mapping[str, diffrax.AbstractSolver] | None = None,
    steps: Parameter | Mapping[str, Parameter] | None = None,
    *,
    t0: Scalar = 0.0,
    reference: Pytree = None,
    uncertainty: Parameter | None = None,
    repeats: Count = 5,
    longest: Scalar | None = None,
    tangents: bool = False,
) -> WorkPrecision:
    r"""Error at t1 against the time of `simulate`, and against force evaluations, for many solvers.

    The error is dimensionless: the largest over sites of |u - u_ref| / max |u_ref| and |v - v_ref| / max |v_ref|.

    **Arguments:**

    - `lattice`, `state`, `t1`, `t0`: the scene, as for `simulate`.
    - `solvers`: list of solvers, granjax's or diffrax's, or a dict from names of yours to them. `None`: VelocityVerlet,
      SRKN6b, SRKN11b, SRKN14a, KahanLi8, SofroniouSpaletta10 where the scene splits, RKN86 and RKN1210 where no force
      reads the velocity, diffrax's Tsit5 and Dopri8 always.
    - `steps`: what they are tried with: one list for all (steps for solvers of fixed step, tolerances for adaptive
      ones), a list of lists, or a dict from a solver's name to its list. `None`, or a name that is not in the dict:
      steps from the stability limit down in ratios of 10^(1/order), tolerances in decades from 1e-2, until the error
      reaches the floor or falls no more, or a call takes longer than `longest`.
    - `reference`: the final state, a `State` or a pair; `uncertainty`: its, in the measure of the error; `None` if not
      known, and then nothing is held back. `None`: two independent runs of high order, refined until their distance
      stops falling; that is the floor.
    - `repeats`: timed calls of each point, of which the median counts (fewer where they add up to more than 3 s);
      solvers take turns. `longest` [s]; `None`: 20 times what solvers take at their coarsest, but at least 0.1 s, and
      where that is more than 1 s four times.
    - `tangents`: measure the map of tangents d(u, v)(t1)/d(u, v)(t0), (2N, 2N), in place of the final state; it then
      needs a `reference` of that shape.

    **Returns:** `WorkPrecision`: print it, `.advice(error)`, `.orders`, `.floor`, `.to_xarray()`, `.to_json()`;
    `gx.plots.work_precision` draws it. Nothing below four floors is drawn or used. Refused and failed points stay,
    with a sentence.

    **Raises** ValueError for input that cannot be meant; RuntimeError where two runs of high order do not agree to
    1e-3, so that the scene has no reference at t1: chains without precompression amplify rounding until nothing is
    left of it.

    Typical: ten solvers compile in 10 s; then a chain of 100 beads takes some seconds.

    **Example:**

    >>> chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Linear()), sites=2)
    >>> state = gx.State(jnp.ones(2), jnp.ones(2))
    >>> table = gx.work_precision(chain, state, 2 * np.pi, gx.SRKN6b(), [0.1, 0.05], reference=state, repeats=1)
    >>> round(table.error[0] / table.error[1])
    16
    """
    state = checked_state(lattice, state)
    t0, t1 = (float(t) for t in checked_times(t0, t1))
    repeats = whole("repeats", repeats, 1)
    longest = None if longest is None else float(positive("longest", longest))
    solvers = checked_solvers(solvers, lattice)
    steps = checked_steps(steps, solvers)
    given = _given(reference, uncertainty, state, tangents)
    warm = [
        warmed(ladder)
        for ladder in solver_ladders(lattice, state, t0, t1, solvers, steps, tangents)
    ]
    ladders = [ladder for ladder, _ in warm] + [default_ladder(lattice, state, t0, t1, tangents)]
    longest = _longest([seconds for _, seconds in warm]) if longest is None else longest
    found = find_reference(lattice, state, t0, t1) if given is None else given
    return measure(ladders, found.state, found.floor, repeats, longest=longest, note=found.note)


def _longest(coarsest):
    """The longest call of a ladder [s], from the times that the solvers take at their coarsest (NaN: none works)."""
    known = [seconds for seconds in coarsest if math.isfinite(seconds)]
    usual = float(np.median(known)) if known else 0.0
    return max(AT_LEAST, min(LONGER * usual, SLOW), LITTLE_LONGER * usual)


def _given(reference, uncertainty, state, tangents):
    """The reference that was given, or `None`."""
    if reference is None and not tangents:
        if uncertainty is not None:
            refuse(
                "uncertainty",
                "a reference beside it",
                f"reference=None, uncertainty={uncertainty!r}",
            )
        return None
    size = sum(x.size for x in jax.tree.leaves(state))
    if tangents and np.shape(reference) != (size, size):
        refuse(
            "reference", f"a map of tangents, shape {(size, size)}", f"shape {np.shape(reference)}"
        )
    reference = np.asarray(reference) if tangents else tuple(reference)
    if not math.isfinite(distance(np.zeros((size, size)) if tangents else state, reference)):
        refuse("reference", "finite numbers", "some that are not", "Look for NaN or infinity.")
    if uncertainty is None:
        return Reference(reference, math.nan, "given, of unknown uncertainty")
    uncertainty = float(np.max(non_negative("uncertainty", uncertainty)))
    if uncertainty > LARGEST_FLOOR:
        refuse(
            "uncertainty",
            f"at most {LARGEST_FLOOR:g}",
            f"{uncertainty:g}",
            "A worse reference tells nothing.",
        )
    return Reference(reference, uncertainty, "given")


class Reference(NamedTuple):
    """The final state of a run that others have confirmed; `floor`: their distance; `note`: what they were."""

    state: Pytree
    floor: float
    note: str
    __repr__ = told


def find_reference(lattice: Lattice, state: Pytree, t0: Scalar, t1: Scalar) -> Reference:
    r"""Two runs by methods of high order, refined until their distance stops falling.

    The first is RKN1210, or Dopri8 where a force reads the velocity. The second is of another family:
    SofroniouSpaletta10 at fixed steps, where the lattice splits and no contact opens; elsewhere, as every fixed step
    has order 5/2 at contact opening, another adaptive pair: RKN86, or Tsit5 where a force reads the velocity.
    Then both run once more on another mesh, so that no chance agreement passes: the floor is the largest distance of
    the other three from the first. In float64, whatever the type of the lattice, unless JAX is held to float32.

    **Returns:** `Reference`. **Raises** RuntimeError where they do not agree to 1e-3, or one does not complete.
    """
    wide = jnp.zeros(()).dtype
    lattice, state = lattice.astype(wide), jax.tree.map(lambda x: jnp.asarray(x, wide), state)
    velocity = reads_velocity(lattice)

    def run(solver, how):
        return simulate(lattice, state, t1, t0=t0, solver=solver, **how)

    first = diffrax.Dopri8() if velocity else RKN1210()
    second = diffrax.Tsit5() if velocity else RKN86()
    step = None
    try:
        trial = run(first, {"tolerance": FIRST_TOLERANCE})
        if splits(lattice) and not np.any(trial.contact_opened):
            second = SofroniouSpaletta10()
            step = min(
                FIRST_STEP * stable_step(second, highest_frequency(lattice, state, t0, t1)),
                (t1 - t0) / 4,
            )
        found = _refined(run, (first, second), step, least_tolerance(lattice))
    except RuntimeError as error:
        raise RuntimeError(f"No reference: a run of high order fails. {error}") from None
    if not found.floor <= LARGEST_FLOOR:
        raise RuntimeError(
            f"No reference exists at t1 = {t1:g}: {found.note} differ by {number(found.floor)}, and finer ones no "
            "less. Such a trajectory amplifies rounding (chaos), or an unstable scene its errors: end the run "
            "earlier, or compare averages."
        )
    return found


def _refined(run, solvers, step, least):
    """The pair of runs with the smallest distance among ever finer ones, confirmed on another mesh."""
    smallest, best, waited = math.inf, None, 0
    for level in range(MOST_LEVELS):
        how = _chosen(level, step, least)
        try:
            ends = [run(solver, x).final for solver, x in zip(solvers, how)]
        except RuntimeError:
            if best is None:
                raise
            break
        apart = distance(ends[1], ends[0])
        waited = 0 if apart < GAIN * smallest else waited + 1
        if apart < smallest:
            smallest, best = apart, (ends[0], how)
        if waited == (PATIENCE if smallest <= LARGEST_FLOOR else 2 * PATIENCE):
            break
    state, how = best
    others = [{name: OTHER_MESH * x for name, x in own.items()} for own in how]
    floor = max(
        [smallest] + [distance(run(solver, x).final, state) for solver, x in zip(solvers, others)]
    )
    note = " and ".join(_named(solver, x) for solver, x in zip(solvers, how))
    return Reference(jax.tree.map(np.asarray, state), floor, note)


def _chosen(level, step, least):
    """What the two solvers are given at a level: a tolerance, and another or a step."""
    tolerance = {"tolerance": max(FIRST_TOLERANCE * 10.0**-level, least)}
    return tolerance, tolerance if step is None else {"step": step * SHORTER**level}


def _named(solver, how):
    ((parameter, value),) = how.items()
    return f"{type(solver).__name__} at {parameter} {number(value)}"
