"""Runs that take long: in pieces, between which Ctrl-C is heard."""

import itertools
import math
import time
import warnings
from functools import cache, lru_cache
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import refuse, traced
from ..lattice import Lattice
from ..programs import compiled, wait
from ..types import Number, Scalar, StateLike, Times
from .dispatch import facts
from .integrate import Part, integrate, own_records, part_of, reduced
from .lanes import apart, refuse_lanes_within, together
from .record import Record
from .run import COMPLETED, NOT_FINITE, TOO_MANY_STEPS, Found

# seconds that an evaluation of the forces takes, and more for each number of a state: about, and at the least
TAKES, LEAST = (5e-8, 1e-9), (2e-8, 2e-11)
# evaluations a step of a solver that does not say
EVALUATIONS = 10
# seconds of a piece; and from which on a run has pieces, and from which on it is waited for in a way that hears Ctrl-C
PIECE, LONG, SHORT = 0.5, 2.0, 0.05
# lanes of an adaptive run in one program, at most; and steps that one of them may well take
ABREAST, EXPECTED = 16, 4096
# what one loop counts; and steps that no lattice takes a day for
COUNTED, FEW = 2**31 - 1, 1e6
DAY = 86400.0
# seconds from which on it is said how long a run will take
TOLD = 10.0
_FORWARD = diffrax.ForwardMode()


def march(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    dt: Number | None,
    tolerance: Number | None,
    save_ts: Times | None,
    records: dict[str, Record],
    solver: diffrax.AbstractSolver,
    adjoint: diffrax.AbstractAdjoint,
    max_steps: int | None,
    every: bool,
    progress: bool,
    watch: bool = False,
    dips: bool | None = False,
) -> Found:
    """`integrate`, and where nothing is traced what takes long in pieces, between which Ctrl-C is heard.

    Where the pieces end follows from the number of steps and the size of the lattice alone, so that a run is the same
    wherever it is computed. An adaptive run has pieces from where its first one, of so many steps, does not suffice.
    """
    arguments = lattice, state, t0, t1, dt, tolerance, save_ts, records, solver, adjoint
    rest = every, progress, watch, dips
    if traced((t0, t1, dt)):
        return integrate(*arguments, max_steps, *rest)
    known = facts(lattice).known
    if "lanes" not in known:
        known["lanes"] = lattice.lanes
    if tolerance is not None and known["lanes"]:
        return (_lane_by_lane if _is_untraced() else integrate)(*arguments, max_steps, *rest)
    forward = in_pieces(adjoint, every) and not dips
    takes, ends, budget = seconds_a_step(lattice, solver, TAKES), [], None
    span = float(t1) - float(t0)
    if tolerance is None:
        steps = _steps(span / float(dt), facts(lattice).dtype)
        long, alone = steps * takes > SHORT, steps * takes > LONG
        if steps * takes > LONG and forward and (max_steps is None or max_steps >= steps):
            ends = [*range(0, steps, max(min(int(PIECE / takes), COUNTED), 1)), steps]
    else:
        # what an adaptive run takes is known from the one before
        pace = "pace", type(solver), float(tolerance)
        long, alone = not forward or known.get(pace, math.inf) * span > SHORT, not forward
        budget = 1 << int(LONG / takes).bit_length() if forward else None
    # in a program that somebody else traces, constants too become its values
    if (long or budget) and not _is_untraced():
        return integrate(*arguments, max_steps, *rest)
    if not ends:
        least = steps * seconds_a_step(lattice, solver) if tolerance is None else 0
        if least > TOLD and not progress:
            _warn(f"{steps} steps, which take {_spoken(least)} at the least")
        since = time.perf_counter()
        limit = max_steps if budget is None else min(budget, max_steps or budget)
        sizes = [
            _number(x, x.dtype) if isinstance(x, np.generic) else x for x in (t0, t1, dt, tolerance)
        ]
        run = (_alone if alone else integrate)(lattice, state, *sizes, *arguments[6:], limit, *rest)
        if long:
            wait(run.code)
            if tolerance is not None:
                known[pace] = (time.perf_counter() - since) / span
        if limit == max_steps or np.asarray(run.code) != TOO_MANY_STEPS:
            return run
    begin, how = (state, t0, t1), (dt, tolerance, save_ts, records, solver)
    return _in_pieces(lattice, begin, ends, budget, max_steps, *how, progress, watch, dips)


def _steps(count, dtype):
    """Steps in a run that is `count` of them long, as well as the type knows it."""
    known = max(4 * float(jnp.finfo(dtype).eps), 1e-12) * count
    return round(count) if abs(count - round(count)) <= known else math.ceil(count)


def _is_untraced():
    """Whether nothing at all is traced here, whatever the arguments are."""
    return not traced(-_number(1.0, np.dtype(float)))


@lru_cache(maxsize=256)
def _number(x, dtype):
    """A number as JAX's array, which a program takes more quickly than NumPy's, and which takes longer to make."""
    with jax.ensure_compile_time_eval():
        return jnp.asarray(x, dtype)


def in_pieces(adjoint: Any, every: bool) -> bool:
    """Whether a run may have pieces: one that is not saved at each step, and whose adjoint keeps nothing of it."""
    return isinstance(adjoint, diffrax.ForwardMode) and not every


def seconds_a_step(
    lattice: Lattice, solver: diffrax.AbstractSolver, takes: tuple[float, float] = LEAST
) -> float:
    """What a step of a lattice costs about, or at the least [s]."""
    found = facts(lattice)
    known = found.known
    if "numbers" not in known:
        known["numbers"] = sum(math.prod(x.shape) for x in jax.tree.leaves(found.template))
    return _evaluations(type(solver)) * (takes[0] + takes[1] * known["numbers"])


@cache
def _evaluations(kind):
    return kind.evaluations() if hasattr(kind, "evaluations") else EVALUATIONS


def refuse_endless(
    lattice: Lattice,
    solver: diffrax.AbstractSolver,
    steps: int | None,
    max_steps: int | None,
    one_loop: bool,
) -> None:
    """Refuse steps beyond what a day could do, where nobody says by `max_steps` that so many are meant.

    `one_loop`: whether the run cannot have pieces, so that one loop must count its steps.
    """
    if steps is None or steps < FEW:
        return
    remedy = "Give an earlier t1, a longer step= or tolerance="
    if one_loop and min(steps, max_steps or steps) > COUNTED:
        refuse(
            "t1",
            f"at most {COUNTED} steps under a transformation, with an adjoint, or where each is saved",
            f"{steps:.2g}",
            f"{remedy}.",
        )
    seconds = min(steps, max_steps or steps) * seconds_a_step(lattice, solver)
    if seconds > DAY and max_steps is None:
        refuse(
            "t1",
            "a run of a day at most",
            f"{steps:.2g} steps, which take {_spoken(seconds)} at the least",
            f"{remedy}; or max_steps={steps} if you mean it.",
        )


def _lane_by_lane(
    lattice,
    state,
    t0,
    t1,
    dt,
    tolerance,
    save_ts,
    records,
    solver,
    adjoint,
    max_steps,
    every,
    progress,
    *rest,
):
    """The lanes of an adaptive run: some in each program as long as none of them takes long, then one by one."""
    parts, build = apart(lattice, state, records)
    count, forward = parts[0].shape[-1], in_pieces(adjoint, every)
    takes = seconds_a_step(lattice, solver, TAKES) / count
    width, limit = min(count, ABREAST), max_steps
    if forward:
        width = min(width, max(int(LONG / (EXPECTED * takes)), 1))
        limit = min(int(LONG / takes) // width, max_steps or COUNTED)
    if width == 1:  # a program of several does so itself, as it is traced
        refuse_lanes_within(
            t0, build([jnp.asarray(x[..., 0]) for x in parts]), (lattice, state, records)
        )

    def run(go, some, limit):
        one, y, own = build(some)
        return go(
            one, y, t0, t1, dt, tolerance, save_ts, own, solver, adjoint, limit, every, False, *rest
        )

    runs, done, bar = [], 0, _bar(progress, count, "lanes")
    try:
        while done < count:
            # a whole program that overlaps the one before, rather than another one
            first = min(done, count - width)
            if width > 1:
                found = wait(run(integrate, [x[..., first : first + width] for x in parts], limit))
                if limit != max_steps and (np.asarray(found.code) == TOO_MANY_STEPS).any():
                    width = 1
                    continue
                ts = np.repeat(np.asarray(found.ts)[:, None], width, 1)
                found = found._replace(ts=ts)
                found = jax.tree.map(lambda x, skip=done - first: np.asarray(x)[..., skip:], found)
            else:
                found = wait(run(march, [x[..., first] for x in parts], max_steps))
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


def _in_pieces(
    lattice,
    begin,
    ends,
    budget,
    max_steps,
    dt,
    tolerance,
    save_ts,
    records,
    solver,
    progress,
    watch,
    dips,
):
    """Pieces between `ends`, numbers of steps; or where these are none as many as it takes, of `budget` steps each."""
    number = facts(lattice).dtype.type
    state, t0, t1 = begin = begin[0], *(number(float(t)) for t in begin[1:])
    records = own_records(lattice, state, t0, records, watch, dips)
    wanted, width = None if save_ts is None else np.asarray(save_ts), 0
    if wanted is not None:
        places = [number(t0 + (t1 - t0) * (k / ends[-1])) for k in ends[1:-1]]
        width = np.diff(np.searchsorted(wanted, [*places, t1], side="right"), prepend=0).max()
    t, carried, counts, kept, taken, since = t0, None, np.zeros(3, np.int64), [], 0, None
    bar = _bar(progress)
    try:
        for k in itertools.count(1):
            last = state, t, number(t0 + (t1 - t0) * (ends[k] / ends[-1])) if ends[k + 1 :] else t1
            size = number((last[-1] - t) / (ends[k] - ends[k - 1])) if ends else dt
            window, limit = None, budget
            if wanted is not None:
                window = wanted[taken : taken + width]
                window = np.minimum(np.append(window, np.full(width - len(window), t1)), last[-1])
            # the first piece is compiled, the second one measured
            since = time.perf_counter() if k == 2 and not progress else None
            if budget and max_steps:
                limit = int(min(budget, max_steps - counts[0]))
            part = wait(
                _piece(
                    lattice, begin, *last, size, tolerance, window, records, carried, solver, limit
                )
            )
            if since is not None:
                _tell_long(
                    float(t), float(part.t), float(t1), int(part.steps), time.perf_counter() - since
                )
            state, t, carried, code = (
                part.final,
                np.asarray(part.t)[()],
                part.carried or None,
                np.asarray(part.code),
            )
            counts += np.array([part.steps, part.accepted, part.rejected], np.int64)
            if wanted is not None:
                new = np.count_nonzero(wanted[taken : taken + width] <= t)
                kept.append(jax.tree.map(lambda x, new=new: np.asarray(x[:new]), part.ys))
                taken += new
            bar.update(100 * float((t - t0) / (t1 - t0)) - bar.n)
            spent = budget and max_steps and counts[0] >= max_steps
            if t >= t1 or spent or not np.isin(code, (COMPLETED, TOO_MANY_STEPS)).all():
                break
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"simulate was interrupted at t = {t:g} of {t1:g}; nothing is kept"
        ) from None
    finally:
        bar.close()
    # of what is not finite any more every time is one at which it is not
    lost = bool((code == NOT_FINITE).any())
    if wanted is None:
        ts, ys = np.asarray([t1 if lost else t]), jax.tree.map(lambda x: x[None], state)
    else:
        ts, ys = _filled(wanted, kept, taken, lost)
    part = Part(ts, ys, t, state, carried or {}, *counts, code)
    found = _reduced(lattice, begin, dt, tolerance, records, solver, watch, part)
    # where it may be looked for what went wrong
    return found._replace(last=last)


def _tell_long(begin, t, t1, steps, seconds):
    """Warn of what will take long, by what a piece from `begin` to t took."""
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
    """A time in words, to two digits."""
    for unit, size in (("years", 365 * DAY), ("days", DAY), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds:.2g} seconds"


def _filled(wanted, kept, taken, lost):
    """The times and states that were saved, infinite where a run did not come so far, NaN where it is `lost`."""
    left, none = len(wanted) - taken, np.nan if lost else np.inf
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


# what cannot go in pieces and takes long
_alone = eqx.filter_jit(integrate.__wrapped__)


@compiled
def _piece(lattice, begin, state, t0, t1, dt, tolerance, save_ts, records, carried, solver, budget):
    return part_of(
        lattice,
        begin,
        state,
        t0,
        t1,
        dt,
        tolerance,
        save_ts,
        records,
        carried,
        solver,
        _FORWARD,
        budget,
    )


@compiled
def _reduced(lattice, begin, dt, tolerance, records, solver, watch, part):
    return reduced(lattice, begin, dt, tolerance, records, solver, watch, part)
