"""The errors of a run, from a second run with finer steps."""

import diffrax
import jax
import jax.numpy as jnp

from ..base.checks import traced
from ..base.programs import compiled
from ..base.types import Flags, Number, StateLike
from ..lattice import Lattice, State, vector_field
from ..terms.reach import per_lane
from .arguments import least_tolerance
from .batching import batched
from .integrate import Plan, overlaps
from .march import march
from .run import Errors, Found

# The factor by which the tolerance of the second run is smaller.
TIGHTER = 100
# The factors by which fixed steps of the second run are shorter: the last one for runs in which
# contacts opened, whose errors are of order 5/2 and vary with the steps, so that two runs may agree
# by chance.
SHORTER = 2, 4
# The factor on the gap between both runs where contacts opened: twice that of order 1, as errors
# vary with the steps.
OPENED = 4.0
# From this gap on, relative to the motion, both runs have diverged, and the gap of a single entry
# says nothing.
APART = 0.1
# The factor on the gap between the smallest overlaps of both runs.
COVER = 2.0
# The rounding units within which a number is known at best, times the square root of the number of
# steps, over which rounding accumulates.
ROUNDED = 8


def confirmed(
    lattice: Lattice,
    state: StateLike,
    t0: Number,
    t1: Number,
    plan: Plan,
    first: Found,
    good: Flags,
) -> Errors:
    """Return the errors of what a run found; infinite where the run is not `good`.

    An error covers the integration, the dense output and the records. It is the sum of:

    - twice the gap between both runs, extrapolated to vanishing steps with the solver's order (2 at
      most, 1 where contacts opened);
    - the largest extrapolated gap over all entries and times so far, since a gap may vanish by
      chance (more where both runs have diverged);
    - rounding.
    """
    own = plan.step, plan.tolerance, plan.save_ts, plan.records
    lattice, state, t0, t1, first, good, own = jax.lax.stop_gradient(
        (lattice, state, t0, t1, first, good, own)
    )
    step, tolerance, save_ts, records = own
    if tolerance is not None:
        # Where the floating type cannot hold a smaller tolerance, the second run has a larger one.
        less = tolerance / TIGHTER
        more = tolerance * TIGHTER
        tolerance = jnp.where(less >= least_tolerance(lattice.dtype), less, more)
        how = f"a second run with a tolerance {TIGHTER} times smaller"
    else:
        opened = jnp.any(first.margin < 0)
        step = step / jnp.where(opened, *SHORTER[::-1]).astype(step.dtype)
        how = "a second run with shorter steps"
    forward = diffrax.ForwardMode()
    finer = Plan(plan.solver, step, tolerance, save_ts, records, forward, between=True)
    begin = lattice, state, t0, t1, finer
    if traced((begin, first, good)):
        second = batched(*begin, own_step=True)
    else:
        second = march(*begin)
    order = min(plan.solver.order(diffrax.ODETerm(vector_field)), 2)
    found = _errors(lattice, state, t0, first, second, good, 2 / (1 - 0.5**order))
    return Errors(
        *found,
        how=how,
        _space=lattice.space,
        _mark=lattice._mark,
    )


@compiled
def _errors(lattice, state, t0, first, second, good, factor):
    # The fields of `Errors`.
    lanes = len(lattice.lanes)
    good = good & second.completed
    opened = (first.margin < 0) | (second.margin < 0)
    factor = jnp.where(opened, jnp.maximum(OPENED, factor), factor)
    steps = jnp.maximum(jnp.maximum(first.stats["accepted"], second.stats["accepted"]), 1)
    units = ROUNDED * jnp.finfo(lattice.dtype).eps * jnp.sqrt(steps)

    def saved(x, finer):
        # The error of an array (T, sites..., lanes...).
        gap = jnp.abs(x - finer)
        over = tuple(range(1, x.ndim - lanes))
        known = jnp.where(jnp.isfinite(gap), gap, 0)
        largest = jax.lax.cummax(jnp.max(known, axis=over, keepdims=True), axis=0)
        size = jnp.where(jnp.isfinite(x), jnp.abs(x), 0)
        scale = jnp.max(size, axis=(0, *over), keepdims=True)
        # A run that never moves is apart from any that does, in every unit.
        reach = jnp.maximum(largest, APART * scale)
        lost = largest / jnp.where(reach > 0, reach, 1)
        error = factor * (known + (0.5 + lost) * largest) + units * scale
        return jnp.where(jnp.isfinite(gap) & good, error, jnp.inf)

    def recorded(x, finer, short, finer_short):
        # The error of a record, whose axes are its own.
        gap = jnp.abs(x - finer)
        known = jnp.where(jnp.isfinite(gap), gap, 0)
        over = tuple(range(max(x.ndim - lanes, 0)))
        largest = jnp.max(known, axis=over, keepdims=True, initial=0)
        rounding = units * jnp.where(jnp.isnan(x), 0, jnp.abs(x))
        error = factor * (known + largest / 2) + rounding
        error = jnp.where(jnp.isfinite(gap) & good, error, jnp.inf)
        # An arrival that neither run saw has no time that could be wrong, if the quantity missed
        # the threshold by more than its error.
        missed = finer_short > factor * jnp.abs(short - finer_short)
        return jnp.where(jnp.isnan(x) & jnp.isnan(finer) & good & missed, jnp.nan, error)

    us, vs = (jax.tree.map(saved, getattr(first, x), getattr(second, x)) for x in ("us", "vs"))
    at_end = jax.tree.map(lambda x, y: saved(x[None], y[None])[0], first.final, second.final)

    def energies(found):
        frames = found.ts, found.us, found.vs
        return jax.lax.map(lambda frame: lattice.energy(*frame), frames)

    def moves(frame):
        # How far the errors of a state move its energy, if they are independent.
        t, u, v, *apart = frame
        slopes = jax.grad(lambda y: jnp.sum(lattice.energy(t, *y)))([u, v])
        squares = jax.tree.map(lambda slope, error: (slope * error) ** 2, slopes, apart)
        return jnp.sqrt(per_lane(squares, lanes))

    own = energies(first)
    energy = saved(own, energies(second))
    if lattice.conserves:
        energy = jnp.maximum(energy, jnp.abs(own - lattice.energy(t0, state.u, state.v)))
    else:
        # Where contacts opened, the energies of both runs may agree by chance.
        moved = jax.lax.map(moves, (first.ts, first.us, first.vs, us, vs))
        energy = jnp.where(opened, jnp.fmax(energy, moved), energy)
    records = {
        name: jax.tree.map(
            recorded, x, second.recorded[name], first.short[name], second.short[name]
        )
        for name, x in first.recorded.items()
    }
    closest = second.closest
    there = jnp.isfinite(closest) & jnp.isfinite(first.closest)
    missed = COVER * jnp.where(there, jnp.abs(closest - first.closest), 0)
    for overlap in overlaps(lattice, t0, lattice.zeros()):
        missed += ROUNDED * jnp.finfo(missed.dtype).eps * jnp.max(jnp.abs(overlap))
    missed = jnp.where(good & ~jnp.isnan(closest + first.closest), missed, jnp.inf)
    return us, vs, State(*at_end), energy, closest, missed, records
