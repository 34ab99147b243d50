"""The function `simulate`, which integrates a lattice in time with diffrax."""

import math

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import refuse, show, traced, whole
from ..base.programs import shared_size, wait
from ..base.types import Count, Parameter, Scalar, StateLike
from ..lattice import Lattice, State
from .arguments import (
    checked_method,
    checked_records,
    checked_save_at,
    checked_state,
    checked_times,
    facts,
    held_frames,
    number,
)
from .batching import TRACED_STEPS, batched, without_the_lost
from .bath import baths, refuse_unfit
from .confirmation import confirmed
from .integrate import BothModes, Plan, integrate
from .lanes import apart
from .march import march, refuse_endless
from .memory import with_memory
from .record import Record
from .remarks import doubts, meeting, missed, passing, unseen
from .reversible import Reversible, checked_reversible, refuse_forward_mode, reversible
from .run import NOT_FINITE, STEP_TOO_SMALL, Run, failed, run_of
from .steps import Steps, fixed_step, linear_bound, refuse_far

# The bound on the steps of a run that saves each of them, where their number is not known.
SAVED_STEPS = 2**16
# The margin of a contact is its smallest overlap at the ends of steps, divided by the distance that
# it moved from rest to get there. At the default step, a contact with a larger margin than this did
# not open between the ends. At that step the overlap may dip by 1/32 of that distance; the rest
# covers the integration error.
NEAR = 0.25
# The same for a given step or tolerance.
FAR = 1.0
# From this h omega of a given step on, the ends of steps say nothing about the times between them.
COARSE = 1.5
# Built once, because making a module takes longer than a short run.
_ADJOINTS = (diffrax.DirectAdjoint, diffrax.ForwardMode, diffrax.RecursiveCheckpointAdjoint)
_LANES_LAST = (diffrax.DirectAdjoint, diffrax.ForwardMode)
_FORWARD = diffrax.ForwardMode()
_BOTH_MODES = BothModes()


def simulate(
    lattice: Lattice,
    state: StateLike,
    t1: Scalar,
    *,
    t0: Scalar = 0.0,
    solver: diffrax.AbstractSolver | None = None,
    step: Scalar | None = None,
    tolerance: Scalar | None = None,
    save_at: Parameter | str | None = None,
    record: dict[str, Record] | None = None,
    confirm: bool = False,
    adjoint: diffrax.AbstractAdjoint | Reversible | None = None,
    progress: bool = False,
    throw: bool | None = None,
    max_steps: Count | None = None,
) -> Run:
    r"""Integrate the equation of motion m a = F(t, u, v) from t0 to t1.

    **Arguments:**

    - `lattice`: a `Lattice`, or a batch with lanes last. `state`: a `State(u, v)` or a pair, of
      shape `lattice.shape` (then lanes), in the floating type of the lattice.
    - `t1` > `t0`: the end and the start.
    - `solver`: any solver of granjax or diffrax. `None` chooses SRKN11b at a fixed step, RKN86 with
      a `tolerance`, and diffrax's Dopri8 where a force reads the velocity (other than `Damping` at
      a fixed step).
    - `step`: the longest fixed step. It is shortened to divide t1 - t0, and the spacing of the
      saved times where that is even; states at other times are read off the dense output. `None`
      takes h omega_max = 1/2, with omega_max a bound on the frequencies that the lattice can reach
      at its energy (not the linear ones, which are zero in a sonic vacuum). It assumes that a bond
      gathers at most the energy that four neighbours held at the start; a run that passed the bound
      (`stats["omega"]`) is repeated with a shorter step. Under a transformation nothing is checked,
      and sixteen neighbours count.
    - `tolerance`: adaptive steps, each with a local error below `tolerance` times the velocity
      scale of the lattice (over omega_max for displacements), in the maximum norm over sites. A
      `step` given as well is the longest one. The outcome warns of a tolerance above 0.01; from 1
      on it is refused. Steps follow the state, not its tangents: for derivatives of a smooth orbit
      (a monodromy) give `step` alone. Each lane of a batch has its own adaptive steps, whereas a
      fixed `step` is shared.
    - `save_at`: `None` for the end only; a whole number of frames from t0 to t1; an array of times;
      or `"steps"` for the end of every step (of one lattice, or of lanes that share a fixed step).
    - `record`: a dict of `Peak`, `PeakTime`, `Lowest`, `Arrival`, `Integral`: quantities reduced
      along the run, also between steps. They take functions `(t, y, lattice)` and measures
      `(lattice, y, t)`.
    - `confirm`: run again with steps of half the length (a quarter where contacts opened; or with a
      tolerance 100 times smaller). This gives `run.error`, the errors of the saved states, records
      and energy, and finds contacts that open between steps. It takes 8 to 25 times as long. The
      error has no derivative.
    - `adjoint`: `None` for derivatives in both modes; diffrax's `ForwardMode`, `DirectAdjoint` or
      `RecursiveCheckpointAdjoint` (reverse mode only, cheaper); or `Reversible()` (reverse mode
      only, memory independent of the number of steps, for motion that can be integrated back to its
      start). A value that a plain function of a drive or a record encloses has derivatives in
      forward mode alone, unless `DirectAdjoint` is given.
    - `progress`: show a progress bar. `throw`: raise if the run, or a lane, does not complete;
      `None` raises outside of transformations, and inside sets the numbers of that run or lane to
      NaN. `max_steps`: the most steps per lane; given, runs may exceed a day.

    Under `jax.vmap` lanes are moved last and share the default step of the stiffest, as in a batch.
    A differentiated run keeps its lanes first, each with its own step.

    A derivative is that of the discrete steps. Where the slope of a force jumps (a bilinear spring,
    an exponent 1), it converges erratically, with the first power of the step. At the default step
    it may silently be wrong by tens of per cent; `gx.derivative(function, x, step)` gives its
    error.

    Forces that read the past have their own solvers, without `solver`, `record` and
    `save_at="steps"`, and return a `RunWithMemory`. `PlasticContact` takes adaptive steps that
    carry internal variables, shared by all lanes (tolerance 1e-11 by default), with derivatives in
    forward mode. `CaputoDamping` takes equal steps with the whole history (h omega = 1/50 by
    default).

    **Returns:** `Run`.

    **Raises** ValueError for invalid input; RuntimeError if `throw` and the run does not complete.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=11)
    >>> run.vs.shape, run.outcome
    ((11, 20), 'Completed at t = 5 after 100 steps.')
    >>> round(float(run.final.v[0]), 4)
    -0.0711
    """
    about = facts(lattice)

    # Check the arguments.
    state = checked_state(lattice, state)
    t0, t1 = checked_times(t0, t1)
    unknown = about.traced or traced((state, t0, t1, step, tolerance, save_at, record))
    if throw and unknown:
        remedy = "What becomes of a traced run is not known yet."
        refuse("throw", "None or False under a transformation", "True", remedy)
    backwards = adjoint if isinstance(adjoint, Reversible) else None
    if confirm and (about.remembers or backwards is not None):
        without = "forces that read the past" if about.remembers else "Reversible"
        remedy = "Compare runs by two steps yourself."
        refuse("confirm", f"False with {without}", "True", remedy)
    save_ts, frames, every = checked_save_at(save_at, t0, t1, state)
    if about.remembers:
        how = every, solver, step, tolerance, record, adjoint, progress, throw, max_steps
        return with_memory(lattice, state, t0, t1, save_ts, *how)
    solver, step, tolerance = checked_method(lattice, solver, step, tolerance)
    if every and tolerance is not None and about.lanes:
        remedy = "Give times, or step= for steps that lanes share."
        refuse("save_at", "times, where each lane has steps of its own", "'steps'", remedy)
    if every and confirm and unknown:
        remedy = "Steps of two lengths end at other times: give times."
        refuse("confirm", "False under a transformation with save_at='steps'", "True", remedy)
    records = checked_records(record)
    if baths(lattice):
        between = save_ts is not None and frames == 1 and not traced(save_ts)
        even = not between or set(np.asarray(save_ts)).issubset((t0, t1))
        sampled = any(one.sampled for one in records.values())
        refuse_unfit(solver, tolerance, confirm, backwards is not None, even, sampled)

    # Choose the steps.
    if tolerance is None:
        steps = fixed_step(lattice, state, t0, t1, step, solver, frames)
    else:
        refuse_far(lattice, state, t0, t1)
        bound = "" if step is None else f", none longer than {show(step)}"
        choice = f"adaptive steps, tolerance {show(tolerance)}{bound}"
        steps = Steps(step, None, choice, "", None)
    adjoint = _FORWARD if backwards is not None else _adjoint(adjoint, unknown)
    plan = Plan(
        solver,
        # As the lattice's type, since diffrax promotes the state to the type of the times.
        None if steps.size is None else number(steps.size, about.dtype),
        tolerance,
        None if save_ts is None else jnp.asarray(save_ts, about.dtype),
        records,
        adjoint,
        _most_steps(adjoint, unknown, every, steps.count, max_steps),
        every,
        progress,
        steps.allowed is not None and not unknown,
        confirm,
    )
    refuse_endless(lattice, plan, steps.count, max_steps, unknown)
    if backwards is not None:
        checked_reversible(lattice, plan)
    if every:
        argument = "save_at" if max_steps is None else "max_steps"
        held_frames(argument, plan.max_steps, state, "steps")

    # Integrate.
    begin = lattice, state, number(t0, about.dtype), number(t1, about.dtype)
    try:
        # `Reversible` matters only where something is traced, that is, may be differentiated.
        if backwards is not None and (unknown or traced(backwards)):
            found = reversible((lattice, state, backwards, (begin[2:], plan)))
            wait(found.code)
        elif not unknown:
            found = march(*begin, plan)
        elif progress or not isinstance(adjoint, _LANES_LAST):
            found = integrate(*begin, plan)
        else:
            found = batched(*begin, plan, own_step=step is None)
    except TypeError as error:
        refuse_forward_mode(backwards or adjoint, error)
    known = not isinstance(found.code, jax.core.Tracer)
    reached = np.asarray(found.stats["omega"]).item() if known and plan.watch else 0.0
    if reached and backwards is None and plan.step * reached > steps.allowed:
        steps = fixed_step(lattice, state, t0, t1, None, solver, frames, reached)
        again = ", taken again: energy gathered beyond the bound at the start"
        steps = steps._replace(choice=steps.choice + again)
        limit = None if plan.max_steps is None else max(plan.max_steps, steps.count)
        plan = plan._replace(step=number(steps.size, about.dtype), max_steps=limit)
        found = march(*begin, plan)
    if unknown and throw is None:
        found = without_the_lost(found)

    # Describe the outcome.
    if every and known:
        found = _cut(found)
        plan = plan._replace(save_ts=found.ts)
    remark = steps.remark
    hidden = ""
    more = {"_t1": begin[3]}
    if known and not unknown:
        hidden = missed(lattice, t0, t1, found.stats["step"], tolerance)
        said = doubts(lattice, state, t0, t1, step, tolerance, solver, found)
        met = passing(lattice, found.ts, found.us, found.final.u)
        remark = " ".join(filter(None, (remark, hidden, said, met)))
        more["started"] = lattice, state
    if confirm:
        # Lanes of `jax.vmap` may have taken a shorter step than their own.
        shared = unknown and tolerance is None
        taken = plan._replace(step=found.stats["step"]) if shared else plan
        more["error"] = confirmed(*begin, taken, found, found.completed & (not hidden))
    lost = known and failed(found)
    if lost and np.asarray(found.code).max() in (NOT_FINITE, STEP_TOO_SMALL):
        more |= _located(*jax.lax.stop_gradient((found, begin)), plan)
    zone = _zone(lattice, plan, step, unknown)
    names = type(solver).__name__, steps.choice, remark, unseen(lattice), zone
    return run_of(Run, found, lattice, names, more, lost and (throw is None or throw))


def _zone(lattice, plan, step, unknown):
    if plan.tolerance is None and step is not None and not unknown:
        if plan.step * linear_bound(lattice) > COARSE:
            return math.inf
    return NEAR if plan.tolerance is None and step is None else FAR


def _adjoint(adjoint, unknown):
    if adjoint is None:
        return _BOTH_MODES if unknown else _FORWARD
    if not isinstance(adjoint, _ADJOINTS):
        known = ", ".join(["Reversible()", *(f"diffrax.{kind.__name__}()" for kind in _ADJOINTS)])
        refuse("adjoint", f"one of {known}", repr(adjoint), "None serves both derivative modes.")
    return adjoint


def _most_steps(adjoint, unknown, every, steps, max_steps):
    # `None` is a loop without a bound, which has no reverse mode.
    if max_steps is not None:
        return whole("max_steps", max_steps, 1)
    if isinstance(adjoint, diffrax.ForwardMode) and not every:
        return None
    if steps is None:
        return SAVED_STEPS if every else TRACED_STEPS
    # Under a transformation the saved array keeps its length.
    if every and unknown:
        return steps
    # Rounded up, so that many lattices share one program: a little for the buffer of saved steps,
    # more for a mere bound on the loop.
    return shared_size(steps) if every else 1 << (steps - 1).bit_length()


def _cut(run):
    used = np.isfinite(np.asarray(run.ts))
    count = int(np.count_nonzero(used))
    # With NumPy, since JAX compiles a new program for a slice of another length.
    where = lambda x: x.sharding if x.committed else None
    ts, us, vs = jax.tree.map(
        lambda x: jax.device_put(np.asarray(x)[:count], where(x)), (run.ts, run.us, run.vs)
    )
    return run._replace(ts=ts, us=us, vs=vs)


def _located(found, begin, plan):
    # Runs again with frames, refined twice.
    # Only one piece of the run is repeated; of lanes with their own steps only the first one with
    # the largest code.
    lattice, state, *span = begin if found.last is None else (begin[0], *found.last)
    code = np.asarray(found.code)
    worst = code.argmax()
    size = float(np.broadcast_to(found.stats["step"], code.shape).flat[worst])
    if lattice.lanes and plan.tolerance is not None:
        parts, build = apart(lattice, state)
        lattice, state = build([x[..., worst] for x in parts])
        worst = 0
    plan = Plan(plan.solver, plan.step, plan.tolerance, None, {}, _FORWARD)
    if code.max() == STEP_TOO_SMALL:
        again = integrate(lattice, state, *span, plan)
        t = float(again.ts[-1])
        return {"failed_at": (t, t, ()), "met": meeting(lattice, again.final, t, 0.0)}
    low, high = map(float, span)
    last = state
    for _ in range(2):
        ts = jnp.linspace(low, high, 65, dtype=lattice.dtype)[1:]
        again = integrate(lattice, state, *span, plan._replace(save_ts=ts))
        wait(again.code)
        # The shape is (times, sites, components) of this lane.
        lost = [
            ~np.isfinite(u).reshape(len(ts), u.shape[1], -1, math.prod(lattice.lanes))[..., worst]
            for u in jax.tree.leaves(again.us)
        ]
        first = int(np.argmax(np.any([x.any((1, 2)) for x in lost], axis=0)))
        sites = tuple(int(i) for x in lost for i in np.flatnonzero(x[first].any(1))[:4])
        high = float(ts[first])
        low = float(ts[first - 1]) if first else low
        last = jax.tree.map(lambda x: x[first - 1], State(again.us, again.vs)) if first else last
    met = meeting(lattice, last, low, high - low + 2 * size)
    return {"failed_at": (low, high, sites), "met": met}
