"""The compiled part of `simulate`."""

from collections.abc import Callable
from functools import partial, reduce
from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.arrays import most, trailing
from ..base.programs import compiled
from ..base.types import Displacements, Flags, Number, Numbers, Pytree, Scalar, StateLike, Times
from ..lattice import Lattice, State, vector_field
from ..solvers import AbstractNystrom
from ..terms import energies
from .bath import Bathed, baths
from .control import Landing, Scales, StepControl, both_modes, largest, one_sided
from .lanes import by_groups, each_lane
from .record import CLOSEST, EXTREMES, AtEnds, Lowest, Record, Recorded, leaf_by_leaf
from .run import (
    COMPLETED,
    FAILED,
    NOT_FINITE,
    NOTHING,
    STEP_TOO_SMALL,
    TOO_MANY_STEPS,
    UNRESOLVED,
    Found,
    finite,
)
from .steps import (
    MOST_STEPS,
    STEP_FRACTION,
    chosen,
    compressions,
    gathered_frequency,
    largest_excitation,
    least_step,
    reached_frequency,
    sampled_times,
)

# A force may differ from the slope of its energy by this many square roots of the rounding unit.
KEPT = 100
# omega times the longest adaptive step of a driven lattice.
QUIET = 2.0

# The most iterations of each of the nested loops around a step. More of them make fewer loops, and
# so smaller programs, but the innermost loop of a gradient stores all its steps.
LOOP = 64


class Plan(NamedTuple):
    """How a run is integrated; its arrays are `step`, `tolerance`, `save_ts` and `records`.

    - `step` [s]: the fixed step; with a `tolerance` the longest step, or `None`
    - `save_ts`: times to save, `None` for the end only; `every`: save the end of each step
    - `max_steps`: `None` for a loop without a bound, which has no reverse mode
    - `watch`: follow all compressions, for the highest frequency that the run reaches
    - `between`: seek contacts that open also between the ends of steps
    """

    solver: diffrax.AbstractSolver
    step: Number | None
    tolerance: Number | None
    save_ts: Times | None
    records: dict[str, Record]
    adjoint: diffrax.AbstractAdjoint
    max_steps: int | None = None
    every: bool = False
    progress: bool = False
    watch: bool = False
    between: bool = False

    @property
    def has_pieces(self) -> bool:
        """Whether a run may be split: not every step is saved, and the adjoint stores nothing."""
        return isinstance(self.adjoint, diffrax.ForwardMode) and not self.every


@compiled
def integrate(lattice: Lattice, state: StateLike, t0: Scalar, t1: Scalar, plan: Plan) -> Found:
    """Integrate and reduce the records, with checked arguments.

    Each lane has its own adaptive steps.
    """

    def run(lattice, state, records):
        own = planned(lattice, state, t0, plan._replace(records=records))
        begin = state, t0, t1
        part = part_of(lattice, begin, state, t0, t1, own)
        return reduced(lattice, begin, own, part)

    if plan.tolerance is not None and lattice.lanes:
        plan = plan._replace(progress=False)
        return each_lane(run, lattice, state, plan.records, t0)
    return run(lattice, state, plan.records)


def planned(lattice: Lattice, state: StateLike, t0: Scalar, plan: Plan) -> Plan:
    """Return the plan with the internal records of a run added."""
    records = dict(plan.records)
    if overlaps(lattice, t0, state.u):
        records[CLOSEST] = (Lowest if plan.between else AtEnds)(smallest_overlap)
    if plan.watch:
        records[EXTREMES] = AtEnds(_compressions)
    return plan._replace(records=records)


class Part(NamedTuple):
    """A part of a run: saved states, final time and state, records, step counts and code."""

    ts: Times
    ys: State
    t: Number
    final: State
    carried: dict
    steps: Number
    accepted: Number
    rejected: Number
    code: Number


def part_of(
    lattice: Lattice,
    begin: tuple,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    plan: Plan,
    carried: dict | None = None,
) -> Part:
    """Integrate the part from t0 to t1 of a run that begins with `begin` = (state, t0, t1).

    `carried`: what the records carry at t0.
    """

    def some(lattice, state, carried):
        return _parted(lattice, begin, state, t0, t1, plan, carried)

    found = None
    own = {CLOSEST, EXTREMES}.issuperset(plan.records)
    # With heat baths groups of lanes would draw the same noise.
    alone = plan.every or plan.progress or baths(lattice)
    if plan.tolerance is None and own and not alone:
        found = by_groups(some, lattice, state, carried)
    if found is None:
        found = some(lattice, state, carried)
    (ys, final, carried, code), (ts, t, *counts) = found
    return Part(ts, ys, t, final, carried, *counts, code)


def _parted(lattice, begin, state, t0, t1, plan, carried):
    # Returns what each lane has, and what all lanes share.
    solver = plan.solver
    records = plan.records
    # Diffrax sets this for its Runge-Kutta methods, but not through a wrapper.
    if isinstance(plan.adjoint, diffrax.DirectAdjoint):
        solver = both_modes(solver)
    solver = one_sided(solver, lattice)
    solver = Bathed(solver) if baths(lattice) else solver
    solver = Recorded(solver, records, carried) if records else solver
    if plan.tolerance is not None:
        controller = _controller(lattice, *begin, plan)
    elif lattice.breaks:
        controller = Landing(lattice.breaks, plan.step, t1)
    else:
        controller = _FixedStep(plan.step)
    own, shared = solved(vector_field, solver, controller, lattice.for_run(), state, t0, t1, plan)
    ys, final, carried, code = own
    return (ys, final, carried[1] if records else {}, code), shared


def solved(
    field: Callable,
    solver: diffrax.AbstractSolver,
    controller: diffrax.AbstractStepSizeController,
    lattice: Lattice,
    y: Pytree,
    t0: Scalar,
    t1: Scalar,
    plan: Plan,
) -> tuple[tuple, tuple]:
    """Integrate a vector field with diffrax.

    **Returns:** (saved states, final state, solver state, code) of each lane, and what lanes share:
    (saved times, final time, numbers of all, accepted and rejected steps).
    """
    subs = [diffrax.SubSaveAt(t1=True)]
    adjoint = plan.adjoint
    sound = True
    if plan.every:
        subs.append(diffrax.SubSaveAt(t0=True, steps=True))
    elif plan.save_ts is not None:
        sound = ordered(plan.save_ts, t0, t1)
        subs.append(diffrax.SubSaveAt(ts=plan.save_ts))
        # Nothing is saved at NaN.
        adjoint = _Saving(adjoint, jnp.where(sound, plan.save_ts, jnp.nan))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        solver,
        t0,
        t1,
        None,
        y,
        args=lattice,
        saveat=diffrax.SaveAt(subs=subs, solver_state=bool(plan.records)),
        stepsize_controller=controller,
        adjoint=adjoint,
        max_steps=plan.max_steps,
        throw=False,
        progress_meter=diffrax.TqdmProgressMeter() if plan.progress else diffrax.NoProgressMeter(),
    )
    final = jax.tree.map(lambda x: x[0], solution.ys[0])
    counts = (solution.stats[f"num_{kind}steps"] for kind in ("", "accepted_", "rejected_"))
    code = jnp.where(sound, _code(solution.result, final, lattice.lanes), NOTHING)
    own = solution.ys[-1], final, solution.solver_state, code
    return own, (solution.ts[-1], solution.ts[0][0], *counts)


def ordered(ts: Times, t0: Scalar, t1: Scalar) -> Flags:
    """Return whether times increase from t0 to t1, for those that were traced and not checked."""
    return jnp.all((ts >= t0) & (ts <= t1)) & jnp.all(ts[1:] >= ts[:-1])


def reduced(lattice: Lattice, begin: tuple, plan: Plan, part: Part) -> Found:
    """Return the results of a run from those of all its parts."""
    state, t0, t1 = begin
    records = plan.records
    ts, ys, _, final, carried, steps, accepted, rejected, code = part
    recorded = {name: leaf_by_leaf(records[name].finish, carried[name]) for name in records}
    short = {name: leaf_by_leaf(records[name].short, carried[name]) for name in records}
    closest = recorded.pop(CLOSEST, None)
    extremes = recorded.pop(EXTREMES, None)
    margin = least = jnp.full(lattice.lanes, jnp.inf)
    if closest is not None:
        margin = _margin(lattice, t0, closest)
        least = _least(lattice, closest)
    kind = type(plan.solver)
    stats = {
        "steps": steps,
        "accepted": accepted,
        "rejected": rejected,
        "step": (t1 - t0) / jnp.maximum(accepted, 1),
        "force_evaluations": steps
        * (kind.evaluations() if hasattr(kind, "evaluations") else jnp.nan),
    }
    if plan.watch:
        low, less_high = extremes
        high = jax.tree.map(jnp.negative, less_high)
        stats["omega"] = reached_frequency(lattice, low, high, t0, t1, final.u)
    # Traced times were not checked, and may not be in order.
    size = plan.step if plan.tolerance is None else plan.tolerance
    meant = (t1 > t0) & (size > 0) & jnp.isfinite(t1 - t0) & jnp.isfinite(size)
    code = jnp.where(meant, code, NOTHING)
    if plan.tolerance is None:
        resolved = plan.step >= least_step(t0, t1, lattice.dtype)
        code = jnp.where(resolved | (code != COMPLETED), code, UNRESOLVED)
    # A gradient computes these energies again, rather than keep and compile all numbers in them.
    energy_error = jax.checkpoint(_energy_error)(lattice, state, t0, ts, ys)
    if lattice.conserves:
        still, t, u = jax.tree.map(chosen, (lattice, t1, final.u))
        gaps = (energies.energy_gap(term, still, t, u) for term in still.terms)
        gap = jax.lax.stop_gradient(sum(gaps, jnp.zeros(lattice.lanes, lattice.dtype)))
        other = gap > KEPT * jnp.sqrt(jnp.finfo(gap.dtype).eps)
        energy_error = jnp.where(other, jnp.nan, energy_error)
    return Found(ts, ys.u, ys.v, final, recorded, energy_error, margin, least, short, code, stats)


def overlaps(lattice, t, u):
    """Return the overlaps of the contacts of bonds and walls that can open."""
    found = [
        c.overlap for term in lattice.terms for c in term.compressions(t, u) if c.place != "site"
    ]
    return [overlap for overlap in found if overlap is not None]


def smallest_overlap(t: Number, y: StateLike, lattice: Lattice) -> Numbers:
    """Return the overlaps of all contacts that can open, as one array."""
    # Arguments without derivatives keep those of the overlaps out of the program of a gradient.
    found = jax.lax.stop_gradient(overlaps(*jax.tree.map(chosen, (lattice, t, y.u))))
    if len(found) == 1:
        return found[0]
    lanes = len(lattice.lanes)
    return jnp.concatenate([s.reshape((-1,) + s.shape[s.ndim - lanes :]) for s in found])


def least_overlap(lattice: Lattice, t: Number, u: Displacements) -> Numbers:
    """Return the least overlap of all contacts that can open, per lane; infinite without any."""
    found = [_least(lattice, overlap) for overlap in overlaps(lattice, t, u)]
    return reduce(jnp.minimum, found, jnp.full(lattice.lanes, jnp.inf, lattice.dtype))


def _compressions(t, y, lattice):
    # The compressions and their negatives, whose smallest values are the extremes of the
    # compressions.
    found = jax.lax.stop_gradient(compressions(*jax.tree.map(chosen, (lattice, t, y.u))))
    return found, jax.tree.map(jnp.negative, found)


def _margin(lattice, t0, smallest):
    # The least overlap, divided by the distance that it moved from rest, over all contacts, per
    # lane. It is negative where a contact opened.
    moved = smallest_overlap(t0, State(lattice.zeros(), None), lattice) - smallest
    margin = jnp.where(
        moved > 0, smallest / jnp.where(moved > 0, moved, 1), jnp.where(smallest < 0, -1.0, jnp.inf)
    )
    return _least(lattice, margin)


def _least(lattice, x):
    return jnp.min(x, axis=tuple(range(x.ndim - len(lattice.lanes))), initial=jnp.inf)


def _code(result, final, lanes):
    known = diffrax.RESULTS
    code = jnp.where(result == known.successful, COMPLETED, FAILED)
    code = jnp.where(result == known.max_steps_reached, TOO_MANY_STEPS, code)
    code = jnp.where(result == known.dt_min_reached, STEP_TOO_SMALL, code)
    return jnp.where(finite((final.u, final.v), lanes), code, NOT_FINITE)


def _energy_error(lattice, state, t0, ts, ys):
    if not lattice.conserves:
        return jnp.full(lattice.lanes, jnp.nan)
    start = lattice.energy(t0, state.u, state.v)
    # Some of the buffer is unused.
    used = trailing(jnp.isfinite(ts), 1 + len(lattice.lanes))
    energies = jax.lax.map(lambda ty: lattice.energy(ty[0], ty[1].u, ty[1].v), (ts, ys))
    scale = jnp.maximum(jnp.abs(start), lattice.kinetic_energy(state.v))
    errors = jnp.where(used, jnp.abs(energies - start), 0)
    # XLA's maximum over a long array may lose a NaN
    largest = jnp.where(jnp.any(jnp.isnan(errors), axis=0), jnp.nan, jnp.max(errors, axis=0))
    return largest / jnp.where(scale > 0, scale, 1)


# Diffrax checks its arguments `dt0` and `ts` with Python callbacks at run time, and JAX cannot keep
# such programs in its compilation cache. So both are held in fields, and the checks are not used.


class _Saving(diffrax.AbstractAdjoint):
    """An adjoint that saves at times which are known to increase."""

    adjoint: diffrax.AbstractAdjoint
    ts: Times

    def loop(self, *, saveat, **kwargs):
        saveat = eqx.tree_at(lambda saveat: saveat.subs[-1].ts, saveat, self.ts)
        return self.adjoint.loop(saveat=saveat, **kwargs)


class BothModes(diffrax.DirectAdjoint):
    """Diffrax's adjoint of both modes, with fewer loops around a step.

    Each loop puts one more copy of the step into the program of a gradient.
    """

    @property
    def _loop(self):
        loop = super()._loop

        def shallow(*, inner_while_loop, outer_while_loop, **kwargs):
            inner = partial(_few_loops, inner_while_loop)
            outer = partial(_few_loops, outer_while_loop)
            return loop(inner_while_loop=inner, outer_while_loop=outer, **kwargs)

        return shallow


def _few_loops(while_loop, *args, max_steps, **kwargs):
    loops = 1
    while LOOP**loops < max_steps:
        loops += 1
    base = 2
    while base**loops < max_steps:
        base += 1
    return while_loop(*args, max_steps=max_steps, base=base, **kwargs)


class _FixedStep(diffrax.ConstantStepSize):
    """A fixed step."""

    step: jax.Array

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        return super().init(terms, t0, t1, y0, self.step, args, func, error_order)


def _controller(lattice, state, t0, t1, plan):
    # Steps end at the breaks also under derivatives, but their sizes have none.
    breaks = lattice.breaks
    lattice, state, t0, t1 = jax.tree.map(chosen, (lattice, state, t0, t1))
    omega = gathered_frequency(lattice, state, t0, t1)[0]
    # A law without a floor has a bound so high that displacements would be resolved for nothing;
    # the errors of velocities suffice then, as where nothing is stiff.
    known = (omega > 0) & (omega * (t1 - t0) < STEP_FRACTION * MOST_STEPS)
    omega = jnp.where(known, omega, 1 / (t1 - t0))
    # Lattices also start at rest, moved by their forces, drives or walls.
    pulled = largest(lattice.acceleration(t0, *state)) / omega
    velocity = jnp.maximum(jnp.maximum(largest(state.v), omega * largest(state.u)), pulled)
    longest = plan.step
    if lattice.reads_time:
        driven = largest_excitation(lattice, sampled_times(lattice, t0, t1))
        pushed = driven.force / (most(lattice.mass) * omega)
        velocity = jnp.maximum(velocity, jnp.maximum(driven.speed, pushed))
        # A lattice at rest would otherwise take a step so long that it misses the drive.
        longest = QUIET / omega if longest is None else jnp.minimum(longest, QUIET / omega)
    velocity = jnp.where(velocity > 0, velocity, 1.0)
    scales = Scales(velocity / omega, velocity)
    controller = StepControl(plan.tolerance, scales, 1 / omega, longest, breaks)
    if plan.save_ts is not None and not isinstance(plan.solver, AbstractNystrom):
        controller = diffrax.ClipStepSizeController(controller, step_ts=plan.save_ts)
    return controller
