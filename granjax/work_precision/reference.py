"""A reference of one's own: two independent methods of high order that must agree."""

import math
from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..flow import simulate
from ..solvers import RKN86, RKN1210, SofroniouSpaletta10
from .errors import distance
from .solvers import highest_frequency, least_tolerance, reads_velocity, splits, stable_step
from .table import LARGEST_FLOOR
from .words import number

FIRST_TOLERANCE = 1e-9
# of the stability limit, then shorter by this each time
FIRST_STEP, SHORTER = 0.25, 2.0**-0.5
MOST_LEVELS = 14
# levels without gain before the search ends, twice as many where nothing agrees yet; what counts as gain
PATIENCE, GAIN = 2, 0.7
# steps and tolerances of the confirming runs, over those that they confirm
OTHER_MESH = 1.3


class Reference(NamedTuple):
    """The final state of a run that others have confirmed; `floor`: their distance; `note`: what they were."""

    state: object
    floor: float
    note: str


def find_reference(lattice, state, t0, t1):
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
            step = min(FIRST_STEP * stable_step(second, highest_frequency(lattice, state, t0, t1)), (t1 - t0) / 4)
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
    floor = max([smallest] + [distance(run(solver, x).final, state) for solver, x in zip(solvers, others)])
    note = " and ".join(_named(solver, x) for solver, x in zip(solvers, how))
    return Reference(jax.tree.map(np.asarray, state), floor, note)


def _chosen(level, step, least):
    """What the two solvers are given at a level: a tolerance, and another or a step."""
    tolerance = {"tolerance": max(FIRST_TOLERANCE * 10.0**-level, least)}
    return tolerance, tolerance if step is None else {"step": step * SHORTER**level}


def _named(solver, how):
    ((parameter, value),) = how.items()
    return f"{type(solver).__name__} at {parameter} {number(value)}"
