"""Long runs, split into pieces so that Ctrl-C works in between."""

import itertools
import math
import time
import warnings
from functools import cache, lru_cache

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import refuse, traced
from ..base.programs import compiled, is_untraced, wait
from ..base.types import Scalar, StateLike
from ..lattice import Lattice
from .arguments import facts, rounding_unit
from .integrate import Part, Plan, integrate, part_of, planned, reduced
from .lanes import apart, refuse_lanes_within, together
from .run import COMPLETED, NOT_FINITE, TOO_MANY_STEPS, Found

# An estimate of the time per evaluation of the forces, and of that per number of a state [s].
TAKES = (5e-8, 1e-9)
# Lower bounds on these two times [s].
LEAST = (2e-8, 2e-11)
# Evaluations per step of a solver that does not declare them.
EVALUATIONS = 10
# The estimated time that a piece of a run takes [s].
PIECE = 0.5
# A run that is estimated to take longer than this is split into pieces [s].
LONG = 2.0
# The wait for a run that is estimated to take longer than this reacts to Ctrl-C [s].
SHORT = 0.05
# The most lanes of an adaptive run in one program.
ABREAST = 16
# A typical number of steps of a lane of an adaptive run.
EXPECTED = 4096
# The most iterations of one loop.
COUNTED = 2**31 - 1
# Fewer steps than this take less than a day for any lattice.
FEW = 1e6
# A day [s]. A run that takes longer is refused, unless `max_steps` is given.
DAY = 86400.0
# From this many seconds on, a warning says how long a run will take.
TOLD = 10.0
_FORWARD = diffrax.ForwardMode()


def march(lattice: Lattice, state: StateLike, t0: Scalar, t1: Scalar, plan: Plan) -> Found:
    """Integrate as `integrate` does, in pieces if nothing is traced and the run takes long.

    The ends of pieces depend only on the number of steps and the size of the lattice, so that a run
    is the same on all machines. An adaptive run gets further pieces where the first does not
    suffice.
    """
    # Within the trace of another program, the step of known inputs is traced.
    if traced(plan.step):
        return integrate(lattice, state, t0, t1, plan)
    about = facts(lattice)
    if plan.tolerance is not None and about.lanes:
        return (_lane_by_lane if is_untraced() else integrate)(lattice, state, t0, t1, plan)
    takes = seconds_a_step(lattice, plan.solver, TAKES)
    ends = []
    budget = None
    span = float(t1) - float(t0)
    if plan.tolerance is None:
        steps = _steps(span / float(plan.step), about.dtype)
        long = steps * takes > SHORT
        enough = plan.max_steps is None or plan.max_steps >= steps
        if steps * takes > LONG and plan.has_pieces and enough:
            ends = [*range(0, steps, max(min(int(PIECE / takes), COUNTED), 1)), steps]
    else:
        # The length of an adaptive run is not known in advance.
        long = True
        budget = 1 << int(LONG / takes).bit_length() if plan.has_pieces else None
    # While another program is traced, constants too become traced values.
    if (long or budget) and not is_untraced():
        return integrate(lattice, state, t0, t1, plan)
    if not ends:
        least = steps * seconds_a_step(lattice, plan.solver) if plan.tolerance is None else 0
        if least > TOLD and not plan.progress:
            _warn(f"{steps} steps, which take {_spoken(least)} at the least")
        limit = plan.max_steps if budget is None else min(budget, plan.max_steps or budget)
        own = plan._replace(
            step=_number(plan.step), tolerance=_number(plan.tolerance), max_steps=limit
        )
        run = integrate(lattice, state, _number(t0), _number(t1), own)
        if long:
            wait(run.code)
        if limit == plan.max_steps or np.asarray(run.code) != TOO_MANY_STEPS:
            return run
    return _in_pieces(lattice, (state, t0, t1), ends, budget, plan)


def _steps(count, dtype):
    # Allows for the rounding of times in the floating type.
    known = max(4 * rounding_unit(dtype), 1e-12) * count
    return round(count) if abs(count - round(count)) <= known else math.ceil(count)


def _number(x):
    # A JAX array is passed to a program more quickly than a NumPy one, but takes longer to make.
    return _kept_number(x, x.dtype) if isinstance(x, np.generic) else x


@lru_cache(maxsize=256)
def _kept_number(x, dtype):
    with jax.ensure_compile_time_eval():
        # `jnp.asarray` would compile a program.
        return jax.device_put(np.asarray(x, dtype))


def seconds_a_step(
    lattice: Lattice, solver: diffrax.AbstractSolver | None, takes: tuple[float, float] = LEAST
) -> float:
    """Return the estimated time of a step, or a lower bound with `LEAST` [s]."""
    return _evaluations(type(solver)) * (takes[0] + takes[1] * facts(lattice).numbers)


@cache
def _evaluations(kind):
    return kind.evaluations() if hasattr(kind, "evaluations") else EVALUATIONS


def refuse_endless(
    lattice: Lattice, plan: Plan, steps: int | None, max_steps: int | None, unknown: bool
) -> None:
    """Refuse more steps than a day could do, unless `max_steps` allows them."""
    if steps is None or steps < FEW:
        return
    remedy = "Give an earlier t1, a longer step= or tolerance="
    most = min(steps, max_steps or steps)
    if (unknown or not plan.has_pieces) and most > COUNTED:
        refuse(
            "t1",
            f"at most {COUNTED} steps under a transformation, with an adjoint, or where each is saved",
            f"{steps:.2g}",
            f"{remedy}.",
        )
    seconds = most * seconds_a_step(lattice, plan.solver)
    if seconds > DAY and max_steps is None:
        refuse(
            "t1",
            "a run of a day at most",
            f"{steps:.2g} steps, which take {_spoken(seconds)} at the least",
            f"{remedy}; or max_steps={steps} if you mean it.",
        )


def _lane_by_lane(lattice, state, t0, t1, plan):
    # Runs some lanes in each program as long as none of them takes long, then one at a time.
    parts, build = apart(lattice, state, plan.records)
    count = parts[0].shape[-1]
    progress = plan.progress
    takes = seconds_a_step(lattice, plan.solver, TAKES) / count
    plan = plan._replace(progress=False)
    width = min(count, ABREAST)
    several = plan
    if plan.has_pieces:
        width = min(width, max(int(LONG / (EXPECTED * takes)), 1))
        limit = min(int(LONG / takes) // width, plan.max_steps or COUNTED)
        several = plan._replace(max_steps=limit)
    if width == 1:  # A program of several lanes checks this itself, while it is traced.
        refuse_lanes_within(
            t0,
            build([jnp.asarray(x[..., 0]) for x in parts]),
            (lattice, state, plan.records),
        )

    def run(go, some, plan):
        one, y, own = build(some)
        return go(one, y, t0, t1, plan._replace(records=own))

    runs = []
    done = 0
    bar = _bar(progress, count, "lanes")
    try:
        while done < count:
            # The last group overlaps the one before, so that no program of another width is
            # compiled.
            first = min(done, count - width)
            if width > 1:
                some = [x[..., first : first + width] for x in parts]
                found = wait(run(integrate, some, several))
                spent = (np.asarray(found.code) == TOO_MANY_STEPS).any()
                if spent and several.max_steps != plan.max_steps:
                    width = 1
                    continue
                ts = np.repeat(np.asarray(found.ts)[:, None], width, 1)
                found = found._replace(ts=ts)
                found = jax.tree.map(lambda x, skip=done - first: np.asarray(x)[..., skip:], found)
            else:
                # Where its last piece began is known of a lane in pieces alone, and all lanes have the
                # same fields.
                found = wait(run(march, [x[..., first] for x in parts], plan))._replace(last=None)
                found = jax.tree.map(lambda x: np.asarray(x)[..., None], found)
            runs.append(found)
            bar.update(first + width - done)
            done = first + width
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"simulate was interrupted at lane {done} of {count}; nothing is kept"
        ) from None
    finally:
        bar.close()
    shape = lattice.lanes
    whole = jax.tree.map(lambda *x: np.concatenate(x, -1).reshape(x[0].shape[:-1] + shape), *runs)
    return jax.tree.map(jnp.asarray, together(whole))


def _in_pieces(lattice, begin, ends, budget, plan):
    # Pieces lie between `ends`, numbers of steps. Without `ends` there are as many pieces as it
    # takes, of `budget` steps each.
    number = facts(lattice).dtype.type
    state, t0, t1 = begin = begin[0], *(number(float(t)) for t in begin[1:])
    most = plan.max_steps
    plan = planned(lattice, state, t0, plan)
    wanted = None
    stops = [*(number(t0 + (t1 - t0) * (k / ends[-1])) for k in ends[1:-1]), t1]
    counted = [b - a for a, b in itertools.pairwise(ends)]
    if plan.save_ts is not None:
        wanted = np.asarray(plan.save_ts)
        width = np.diff(np.searchsorted(wanted, stops, side="right"), prepend=0).max()
    t = t0
    carried = None
    named = None
    counts = np.zeros(3, np.int64)
    kept = []
    taken = 0
    own = plan._replace(adjoint=_FORWARD, max_steps=budget, progress=False)
    bar = _bar(plan.progress)
    try:
        pieces = zip(stops, counted) if ends else itertools.repeat((t1, None))
        for k, (stop, steps) in enumerate(pieces, 1):
            piece = state, t, stop
            if steps:
                own = own._replace(step=number((stop - t) / steps))
            if wanted is not None:
                window = wanted[taken : taken + width]
                window = np.append(window, np.full(width - len(window), t1))
                own = own._replace(save_ts=np.minimum(window, stop))
            if budget and most:
                own = own._replace(max_steps=int(min(budget, most - counts[0])))
            since = time.perf_counter()
            part = wait(_piece(lattice, begin, *piece, own, carried))
            # The first piece includes the compilation, so the second one is timed.
            if k == 2 and not plan.progress:
                seconds = time.perf_counter() - since
                _tell_long(float(t), float(part.t), float(t1), int(part.steps), seconds)
            state = part.final
            carried = part.carried or None
            code = np.asarray(part.code)
            lost = code == NOT_FINITE
            # The outcome names the first lane that was lost.
            first = int(lost.argmax()) if lost.any() else None
            if first is None or first != named:
                last = piece
            named = first
            t = np.asarray(part.t)[()]
            counts += np.array([part.steps, part.accepted, part.rejected], np.int64)
            if wanted is not None:
                new = np.count_nonzero(wanted[taken : taken + width] <= t)
                kept.append(jax.tree.map(lambda x, new=new: np.asarray(x[:new]), part.ys))
                taken += new
            bar.update(100 * float((t - t0) / (t1 - t0)) - bar.n)
            spent = budget and most and counts[0] >= most
            going = np.isin(code, (COMPLETED, TOO_MANY_STEPS))
            if t >= t1 or spent or lost.all() or not (going | lost).all():
                break
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"simulate was interrupted at t = {t:g} of {t1:g}; nothing is kept"
        ) from None
    finally:
        bar.close()
    # A run that is not finite any more has this state at all later times.
    lost = lost.all()
    if wanted is None:
        ts = np.asarray([t1 if lost else t])
        ys = jax.tree.map(lambda x: x[None], state)
    else:
        ts, ys = _filled(wanted, kept, taken, lost)
    part = Part(ts, ys, t, state, carried or {}, *counts, code)
    # `last` is the piece in which to look for the cause of a failure.
    return _reduced(lattice, begin, plan._replace(save_ts=None), part)._replace(last=last)


def _tell_long(begin, t, t1, steps, seconds):
    # Estimates the time from that of the piece from `begin` to t.
    pieces = (t1 - t) / (t - begin) if t > begin else 0.0
    if pieces * seconds > TOLD:
        _warn(
            f"about {pieces * steps:.2g} more steps to t = {t1:g}, which take about {_spoken(pieces * seconds)} at "
            f"the pace of the last {steps}"
        )


def _warn(steps):
    warnings.warn(
        f"The run takes {steps}. An earlier t1, a longer step= or a larger tolerance= makes it shorter; "
        "progress=True shows how far it is.",
        stacklevel=6,
    )


def _spoken(seconds):
    for unit, size in (("years", 365 * DAY), ("days", DAY), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds:.2g} seconds"


def _filled(wanted, kept, taken, lost):
    # Times and states that the run did not reach are infinite, or NaN where it was `lost`.
    left = len(wanted) - taken
    none = np.nan if lost else np.inf
    ts = wanted if lost else np.append(wanted[:taken], np.full(left, np.inf, wanted.dtype))
    join = lambda *x: np.concatenate([*x, np.full((left, *x[0].shape[1:]), none, x[0].dtype)])
    return ts, jax.tree.map(join, *kept)


def _bar(progress, total=100, unit="%"):
    from tqdm import tqdm

    return tqdm(
        total=total,
        unit=unit,
        bar_format="{l_bar}{bar}| {elapsed}<{remaining}",
        disable=not progress,
    )


_piece = compiled(part_of)
_reduced = compiled(reduced)
