"""Work and precision: the error of many methods against their time, on any scene.

`work_precision` measures solvers on a lattice; `measure` measures any `Ladder`.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import ClassVar, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from .base.checks import one_of, positive, real, refuse, show, whole
from .base.types import Count, Parameter, Pytree, Scalar, StateLike
from .flow import frequency_bound, linear_frequency, simulate
from .flow.arguments import checked_state, checked_times, facts
from .flow.bath import baths
from .lattice import Lattice
from .results import SI, Result, array, hidden
from .solvers import (
    ABA864,
    RKN86,
    RKN1210,
    KahanLi8,
    SofroniouSpaletta10,
    SRKN6b,
    SRKN11b,
    SRKN14a,
    VelocityVerlet,
)
from .solvers.stability import stability_limit

__all__ = ["Advice", "Ladder", "WorkPrecision", "distance", "measure", "work_precision"]

DEFAULT = "default"
SPLITTING = (VelocityVerlet, SRKN6b, ABA864, SRKN11b, SRKN14a, KahanLi8, SofroniouSpaletta10)
NYSTROM = (RKN86, RKN1210)
DIFFRAX = (diffrax.Tsit5, diffrax.Dopri8)

# the error falls by about this factor from one value of a ladder to the next
RUNG = 10.0
# the first tolerance of a ladder
FIRST_TOLERANCE = 1e-2
# the first step of a ladder over the longest stable step
FIRST_STEP = 0.95
# largest number of values of a ladder
MOST_VALUES = 48
# smallest number of steps of a run
LEAST_INTERVALS = 4
# assumed order of a solver without a table
ORDER = 4
# the smallest tolerance in rounding units; references at 16 are worse than at 20
ROUNDINGS = 20

# Errors below this many floors are neither drawn nor used; the floor is the uncertainty of the
# reference.
DRAWN = 4.0
# the largest floor of a useful reference
LARGEST_FLOOR = 1e-3
# below this error the error is assumed to be a power of the step
ASYMPTOTIC = 1e-2
# above this many floors the reference does not affect an error
CLEAR = 10.0
# a ladder ends after this many values without a smaller error, because rounding dominates
STALLED = 4
# total time of the timed calls of a point [s]
ENOUGH = 3.0
# a ladder ends where a call takes this many times as long as that of the coarsest value ...
LONGER = 10.0
# ... and at least this long [s]
AT_LEAST = 0.2

# tolerances of the reference; that with the smallest distance between two runs is used
REFERENCE_TOLERANCES = 10.0 ** -np.arange(9, 15)
# tolerance of the confirming runs over that of the runs that they confirm
OTHER_MESH = 1.3


class Ladder(NamedTuple):
    """One method and the values of its step or tolerance, for `measure`.

    - `name`: of the method; the advice compares with a ladder called `"default"`, a run without
      options.
    - `parameter`: `"step"` or `"tolerance"`; `values`: its values.
    - `call(value)`: returns `(state, evaluations)` or `(state, evaluations, steps)`: the final
      state, a pair (u, v) or any tree of arrays like the reference, and two counts, numbers or
      `None`. It may compile on its first call. A ValueError or RuntimeError fails this point only.
    - `stops`: whether the ladder ends where its error reaches the floor or has not fallen for four
      values, or where one call takes too long; otherwise every value is tried.
    - `limit`: the longest stable step; the order is fitted below half of it.
    - `solver`: for the advice, the solver of `gx.simulate`, if there is one.
    """

    name: str
    parameter: str
    values: Parameter
    call: Callable[[float], tuple]
    stops: bool = False
    limit: float = np.inf
    solver: diffrax.AbstractSolver | None = None


# the result of one value of a ladder, and why it is not meaningful
class _Point(NamedTuple):
    value: float
    error: float = math.nan
    evaluations: float = math.nan
    steps: float = math.nan
    note: str = ""


class Advice(Result):
    """A method and its step or tolerance for an error; `str` of it is a sentence."""

    _else: ClassVar[str | None] = SI
    asked: float = array("The error that was asked for")
    method: str = array('The method; `"default"` for `simulate` without options', static=True)
    parameter: str = array('`"step"` or `"tolerance"`', static=True)
    value: float = array("Its value; NaN for the default")
    error: float = array("The measured error")
    seconds: float = array("The measured wall time", "s")
    evaluations: float = array("Evaluations of the force; NaN if unknown")
    default_error: float = array("The error of the default; NaN if unknown", default=math.nan)
    default_seconds: float = array("The wall time of the default", "s", default=math.nan)
    solver: diffrax.AbstractSolver | None = array(
        "The solver, if it is one of `gx.simulate`", default=None
    )

    @property
    def keywords(self) -> dict[str, object]:
        """For `gx.simulate(lattice, state, t1, **advice.keywords)`; empty for the default."""
        if self.method == DEFAULT:
            return {}
        solver = {} if self.solver is None else {"solver": self.solver}
        return {**solver, self.parameter: self.value}

    @property
    def outcome(self) -> str:
        cost = f"{self.seconds:.3g} s (error {self.error:.3g})"
        if self.method == DEFAULT:
            return f"For {self.asked:.3g}: the default, {cost}."
        sentence = f"For {self.asked:.3g}: {self.method}, {self.parameter} {self.value!r}, {cost}"
        if math.isfinite(self.default_error):
            sentence += f"; the default would give {self.default_error:.3g}"
            sentence += f" in {self.default_seconds:.3g} s"
        return sentence + "."

    def __repr__(self) -> str:
        return self.outcome


class WorkPrecision(Result):
    """Error, time and force evaluations of many methods at many steps and tolerances.

    **Example:**

    >>> chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Linear()), sites=2)
    >>> state = gx.State(jnp.ones(2), jnp.ones(2))
    >>> table = gx.work_precision(chain, state, 2 * np.pi, gx.SRKN6b(), [0.1, 0.05],
    ...                           reference=state, repeats=1)
    >>> table.methods, table.value[:2]
    (('SRKN6b', 'default'), array([0.1 , 0.05]))
    """

    _else: ClassVar[str | None] = SI
    method: tuple[str, ...] = array(
        "The method; `default` is `gx.simulate` without options", axes="point", static=True
    )
    parameter: tuple[str, ...] = array("`step` or `tolerance`", axes="point", static=True)
    value: Float[np.ndarray, " point"] = array("Its value; NaN for the default")
    error: Float[np.ndarray, " point"] = array("Error, dimensionless, see `distance`")
    seconds: Float[np.ndarray, " point"] = array("Median wall time of a call, compiled", "s")
    fastest: Float[np.ndarray, " point"] = array("Shortest wall time of a call", "s")
    evaluations: Float[np.ndarray, " point"] = array("Evaluations of the force; NaN if unknown")
    steps: Float[np.ndarray, " point"] = array("Steps; NaN if unknown")
    drawn: Bool[np.ndarray, " point"] = array("Whether the point is meaningful")
    note: tuple[str, ...] = array(
        "Why it is not: refused, failed, below the floor", axes="point", static=True
    )
    methods: tuple[str, ...] = array(
        "Names of the methods", axes="method_name", name="method_name", static=True
    )
    compile_seconds: Float[np.ndarray, " method_name"] = array(
        "Extra time of the first call over the second", "s"
    )
    order: Float[np.ndarray, " method_name"] = array("Observed order, see `observed_order`")
    order_error: Float[np.ndarray, " method_name"] = array("Its standard error")
    floor: float = array(
        "Uncertainty of the reference, the distance of two independent runs; errors below four "
        "floors are not drawn; NaN if unknown"
    )
    repeats: int = array("Timed calls of a point", static=True)
    reference_note: str = array("The origin of the reference", name="reference", static=True)
    reference: Pytree = hidden("The state from which errors are measured", default=None)
    solvers: tuple = hidden("The solvers, for the advice", static=True, default=())

    @property
    def outcome(self) -> str:
        return (
            f"{np.count_nonzero(self.drawn)} of {len(self.drawn)} points of {len(self.methods)} "
            f"methods say something; reference: {self.reference_note or 'given'}."
        )

    @property
    def orders(self) -> dict[str, tuple[float, float]]:
        """Dict from method to (observed order, its standard error)."""
        return dict(zip(self.methods, zip(self.order.tolist(), self.order_error.tolist())))

    def advice(self, error: Scalar) -> Advice:
        """Return the fastest point of the table whose error is at most `error`.

        The error is in the measure of `distance`. For a finer choice give `work_precision` more
        steps.

        **Returns:** `Advice`, for `gx.simulate(..., **advice.keywords)`.

        **Raises** ValueError for an error below four floors or below all measured errors.
        """
        asked = float(positive("error", error))
        if asked < DRAWN * self.floor:
            least = f"at least {DRAWN * self.floor:.3g}, four times the floor"
            refuse("error", least, f"{asked:.3g}", "The reference itself is no better.")
        known = np.flatnonzero(self.drawn)
        if not known.size:
            got = "one where nothing is drawn"
            refuse("error", "a table with points to choose from", got, "The notes say why.")
        good = known[self.error[known] <= asked]
        if not good.size:
            i = known[np.argmin(self.error[known])]
            least = f"at least {self.error[i]:.3g}, the smallest in the table"
            best = f"{self.method[i]}, {self.parameter[i]} {self.value[i]:.3g}"
            refuse("error", least, f"{asked:.3g}", f"The best point: {best}.")
        best = good[np.argmin(self.seconds[good])]
        default = [i for i in known if self.method[i] == DEFAULT]
        numbers = [(float(self.error[i]), float(self.seconds[i])) for i in (best, *default)]
        return Advice(
            asked,
            self.method[best],
            self.parameter[best],
            float(self.value[best]),
            *numbers[0],
            float(self.evaluations[best]),
            *numbers[-1] if default else (math.nan, math.nan),
            dict(zip(self.methods, self.solvers)).get(self.method[best]),
        )

    def __repr__(self) -> str:
        import pandas

        known = f"floor {self.floor:.3g}" if math.isfinite(self.floor) else "floor not known"
        orders = [
            f"{k} {x:.2f} +- {e:.2f}" for k, (x, e) in self.orders.items() if math.isfinite(x)
        ]
        names = ("method", "parameter", "value", "error", "seconds", "evaluations", "note")
        table = pandas.DataFrame({name: getattr(self, name) for name in names})
        rows = table.to_string(index=False, na_rep="", float_format="{:.3g}".format)
        said = f"reference: {self.reference_note or 'given'}; {known}"
        return "\n".join([said, f"orders: {', '.join(orders) or 'none'}", rows])


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
) -> WorkPrecision:
    r"""Measure the error at t1 against the time and the force evaluations of `simulate`.

    The error is dimensionless: the maximum over sites of |u - u_ref| / max |u_ref| and
    |v - v_ref| / max |v_ref|.

    **Arguments:**

    - `lattice`, `state`, `t1`, `t0`: as for `simulate`.
    - `solvers`: list of solvers, granjax's or diffrax's, or a dict from names to them. `None`: all
      splitting methods of granjax if the scene splits, RKN86 and RKN1210 if no force reads the
      velocity, and diffrax's Tsit5 and Dopri8.
    - `steps`: one list for all solvers (steps or, if they are adaptive, tolerances), or a dict from
      a solver's name to its list. `None`, or a missing name: steps from the stability limit down in
      ratios of 10^(1/order), or tolerances from 1e-2 down in decades, until the error reaches the
      floor or stops falling, or a call takes longer than `longest`.
    - `reference`: the final state, a `State` or a pair. `None`: two independent runs of high order,
      refined until their distance is smallest; that distance is the floor.
    - `uncertainty`: of a given reference, in the measure of the error; with `None` no point is
      withheld.
    - `repeats`: timed calls of each point, in turns; the median counts. There are fewer where they
      add up to more than 3 s.
    - `longest` [s]: `None`: ten times the time of the solver's coarsest value, at least 0.2 s.

    **Returns:** `WorkPrecision`: print it, `.advice(error)`, `.orders`, `.floor`, `.to_xarray()`;
    `gx.plots.work_precision` draws it. Errors below four floors are neither drawn nor used. Refused
    and failed points stay, with a note.

    **Raises** ValueError for invalid input; RuntimeError if two runs of high order differ by more
    than 1e-3. Then no reference exists at t1, as in chains without precompression, which amplify
    rounding.

    Typical: eleven solvers compile in a minute; 100 beads then take some ten seconds.

    **Example:**

    >>> chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Linear()), sites=2)
    >>> state = gx.State(jnp.ones(2), jnp.ones(2))
    >>> table = gx.work_precision(chain, state, 2 * np.pi, gx.SRKN6b(), [0.1, 0.05],
    ...                           reference=state, repeats=1)
    >>> round(table.error[0] / table.error[1])
    16
    """
    if baths(lattice):
        remedy = "Each run draws forces of its own, which no reference has: compare averages."
        refuse("lattice", "one without heat baths", "one with Langevin", remedy)
    state = checked_state(lattice, state)
    t0, t1 = (float(t) for t in checked_times(t0, t1))
    solvers = sensible_solvers(lattice) if solvers is None else _named(solvers)
    if not isinstance(steps, Mapping):
        steps = {} if steps is None else dict.fromkeys(solvers, steps)
    steps = {one_of("steps", name, solvers): _values(name, x) for name, x in steps.items()}
    if reference is None:
        reference, uncertainty, note = find_reference(lattice, state, t0, t1)
    else:
        reference = tuple(reference)
        distance(state, reference)  # refuses other shapes before anything runs
        note = "given, of unknown uncertainty" if uncertainty is None else "given"
    omega = highest_frequency(lattice, state, t0, t1)

    def final(solver, parameter, value):
        chosen = {} if parameter is None else {parameter: value}
        run = simulate(lattice, state, t1, t0=t0, solver=solver, **chosen)
        return run.final, *_counts(run)

    ladders = []
    for name, solver in solvers.items():
        adaptive = isinstance(solver, diffrax.AbstractAdaptiveSolver)
        parameter = "tolerance" if adaptive else "step"
        limit = stable_step(solver, omega)
        values = steps.get(name) or _sensible_values(solver, limit, t1 - t0, lattice.dtype)
        own = partial(final, solver, parameter)
        ladders.append(Ladder(name, parameter, values, own, name not in steps, limit, solver))
    ladders.append(Ladder(DEFAULT, "step", (math.nan,), partial(final, None, None)))
    return measure(ladders, reference, uncertainty, repeats, longest=longest, note=note)


def measure(
    ladders: Sequence[Ladder],
    reference: Pytree,
    uncertainty: Parameter | None = None,
    repeats: Count = 5,
    *,
    longest: Scalar | None = None,
    note: str = "",
) -> WorkPrecision:
    """Measure error, time and evaluations of every value of every ladder against one reference.

    First every ladder is called for its compile time, errors and counts. Then all points are timed
    in turns (A B C A B C); the median of `repeats` calls counts.

    **Arguments:**

    - `ladders`: list of `Ladder`.
    - `reference`: what all ladders approximate, a tree like their states: a pair (u, v), or any
      tuple of arrays.
    - `uncertainty`: of the reference, in the measure of `distance`: the floor of the table; `None`
      or NaN if unknown.
    - `repeats`, `longest`: as for `work_precision`. `note`: a sentence on the reference.

    **Returns:** `WorkPrecision`.

    **Raises** ValueError for two ladders of one name, an uncertainty above 1e-3, and a state of
    other shapes than the reference.
    """
    repeats = whole("repeats", repeats, 1)
    floor = math.nan if uncertainty is None else float(np.max(uncertainty))
    if floor < 0 or floor > LARGEST_FLOOR:
        remedy = "A worse reference is of no use; end the run earlier."
        refuse("uncertainty", f"a number from 0 to {LARGEST_FLOOR:g}", f"{floor:g}", remedy)
    ladders = tuple(x._replace(values=_values(x.name, x.values)) for x in ladders)
    names = tuple(ladder.name for ladder in ladders)
    if not names:
        refuse("ladders", "one Ladder or more", "none")
    _refuse_twice("ladders", names)
    compiling, found = zip(*(_climb(ladder, reference, floor, longest) for ladder in ladders))
    points = [(ladder, one) for ladder, own in zip(ladders, found) for one in own]
    drawn = np.array([not one.note for _, one in points])
    seconds = np.full((2, len(points)), math.nan)
    calls = [(ladder.call, one.value) for ladder, one in points if not one.note]
    seconds[:, drawn] = _in_turns(calls, repeats)
    numbers = ("value", "error", "evaluations", "steps")
    order, order_error = np.transpose([_order(*one, floor) for one in zip(ladders, found)])
    return WorkPrecision(
        method=tuple(ladder.name for ladder, _ in points),
        parameter=tuple(ladder.parameter for ladder, _ in points),
        **{name: np.array([getattr(one, name) for _, one in points]) for name in numbers},
        seconds=seconds[0],
        fastest=seconds[1],
        drawn=drawn,
        note=tuple(one.note for _, one in points),
        methods=names,
        compile_seconds=np.array(compiling),
        order=order,
        order_error=order_error,
        floor=floor,
        repeats=repeats,
        reference_note=note,
        reference=reference,
        solvers=tuple(ladder.solver for ladder in ladders),
    )


def distance(state: Pytree, reference: Pytree) -> float:
    r"""Return the largest error of a state, each of its parts relative to its own scale.

        error = max over parts x of  max |x - x_ref| / max |x_ref|

    Parts are u and v of a pair; a dict of fields, or an array outside a tuple, is one part. A part
    that passes through zero at the final time has a large error: end the run at another time.

    **Arguments:** two trees of arrays of equal shapes. **Returns:** a float; NaN where the state is
    not finite. **Raises** ValueError where shapes differ.
    """
    state = _parts("state", state)
    reference = _parts("reference", reference)
    shapes, wanted = ([[x.shape for x in part] for part in y] for y in (reference, state))
    if shapes != wanted:
        refuse("reference", f"arrays of the shapes {wanted}, those of the state", f"{shapes}")
    errors = []
    for part, exact in zip(state, reference):
        apart = np.max([np.max(np.abs(x - y), initial=0.0) for x, y in zip(part, exact)])
        scale = np.max([np.max(np.abs(y), initial=0.0) for y in exact])
        errors.append(apart / scale if scale > 0 else apart)
    # NumPy's maximum keeps a NaN; Python's may lose it
    return float(np.max(errors))


def _parts(argument, tree):
    parts = tree if isinstance(tree, (tuple, list)) else (tree,)
    return [[real(argument, x) for x in jax.tree.leaves(part)] for part in parts]


def observed_order(steps: Parameter, errors: Parameter, floor: Scalar) -> tuple[float, float]:
    r"""Return the least-squares slope of log(error) over log(step), and its standard error.

    Only errors below 1e-2 and above ten floors count. If the error rises again towards the shortest
    steps, because of rounding, only errors before the minimum and above ten times the minimum
    count.

    **Arguments:** `steps`, `errors` (P,); `floor`: uncertainty of the reference, or NaN.

    **Returns:** (order, standard error), NaN for fewer than three points.
    """
    along = np.argsort(steps)[::-1]
    steps = np.asarray(steps)[along]
    errors = np.asarray(errors)[along]
    keep = np.isfinite(errors) & (errors > 0) & (errors < ASYMPTOTIC)
    if np.isfinite(floor):
        keep &= errors > CLEAR * floor
    if keep.any():
        least = int(np.argmin(np.where(keep, errors, np.inf)))
        if keep[least + 1 :].any():
            keep &= (errors > CLEAR * errors[least]) & (np.arange(len(errors)) < least)
    if np.count_nonzero(keep) < 3:
        return math.nan, math.nan
    line, covariance = np.polyfit(np.log(steps[keep]), np.log(errors[keep]), 1, cov=True)
    return float(line[0]), float(np.sqrt(covariance[0, 0]))


# uses points between half the stability limit and the floor
def _order(ladder, points, floor):
    if ladder.parameter != "step":
        return math.nan, math.nan
    points = [one for one in points if not one.note and one.value <= ladder.limit / 2]
    counts = np.array([one.steps for one in points])
    # steps may be shortened to fit the run, so the number of steps gives the actual length
    steps = 1 / counts if np.all(np.isfinite(counts)) else [one.value for one in points]
    return observed_order(steps, [one.error for one in points], floor)


# the result of a call, or the message of its ValueError or RuntimeError; and its wall time [s]
def _once(call, value):
    start = time.perf_counter()
    try:
        found = jax.block_until_ready(call(value))
    except (ValueError, RuntimeError) as error:
        found = str(error)
    return found, time.perf_counter() - start


# the `_Point` of a value, and the wall time [s] of its call
def _tried(ladder, value, reference, floor):
    found, seconds = _once(ladder.call, value)
    if isinstance(found, str):
        return _Point(value, note=found), seconds
    state, *counts = found
    counts = [math.nan if x is None else float(np.max(x)) for x in (*counts, None)[:2]]
    error = distance(state, reference)
    why = ""
    if not math.isfinite(error):
        why = "The state is not finite."
    elif error < DRAWN * floor:
        why = f"Below {DRAWN:g} times the reference's uncertainty."
    elif error > 1:
        why = "An error above 1: everything is wrong."
    return _Point(value, error, *counts, why), seconds


# seconds of compiling, and the points up to where the ladder ends
def _climb(ladder, reference, floor, longest):
    compiling = 0.0
    points = []
    smallest = math.inf
    waited = 0
    for value in ladder.values:
        point, seconds = _tried(ladder, value, reference, floor)
        # a successful first call compiles; the second one gives the time without it
        if smallest == math.inf:
            _, again = _once(ladder.call, value)
            compiling = max(compiling, seconds - again)
            seconds = again
            limit = max(AT_LEAST, LONGER * seconds) if longest is None else longest
        points.append(point)
        waited = 0 if point.error < smallest else waited + 1
        smallest = np.fmin(smallest, point.error)
        if not ladder.stops:
            continue
        if point.error < DRAWN * floor or smallest < ASYMPTOTIC and waited == STALLED:
            break
        # a single long call may be due to another process on the processor
        if seconds > limit and _once(ladder.call, value)[1] > limit:
            break
    return compiling, points


# Median and shortest wall times (2, calls) [s] of (call, value) pairs in turns. Each is called
# `repeats` times, or until its times add up to `ENOUGH`.
def _in_turns(calls, repeats):
    spent = [[] for _ in calls]
    for _ in range(repeats):
        for (call, value), times in zip(calls, spent):
            if sum(times) < ENOUGH:
                times.append(_once(call, value)[1])
    return np.array([[np.median(times), min(times)] for times in spent]).reshape(-1, 2).T


def _values(name, values):
    array = np.atleast_1d(real(f"steps of {name}", values))
    if name != DEFAULT and not (array.size and np.all(np.isfinite(array) & (array > 0))):
        expected = "finite numbers above zero, such as [0.1, 0.05]"
        refuse(f"steps of {name}", expected, show(array))
    return tuple(float(x) for x in np.unique(array)[::-1])


def _refuse_twice(argument, names, remedy=""):
    for name in names:
        if names.count(name) > 1:
            refuse(argument, "a different name for each", f"{name!r} twice", remedy)


def _named(solvers):
    if isinstance(solvers, diffrax.AbstractSolver):
        solvers = [solvers]
    if not isinstance(solvers, Mapping):
        names = [getattr(x, "__name__", type(x).__name__) for x in solvers]
        _refuse_twice("solvers", names, "Give a dict from names to solvers.")
        solvers = dict(zip(names, solvers))
    for name, solver in solvers.items():
        if not isinstance(solver, diffrax.AbstractSolver):
            remedy = "Solvers are instances: write the brackets."
            refuse("solvers", "solvers, such as gx.SRKN11b()", name, remedy)
    return solvers


def sensible_solvers(lattice: Lattice) -> dict[str, diffrax.AbstractSolver]:
    """Return all solvers that take the lattice, and diffrax's Tsit5 and Dopri8, by name."""
    known = facts(lattice)
    kinds = SPLITTING if known.splits else ()
    kinds += () if known.reads_velocity else NYSTROM
    return {kind.__name__: kind() for kind in kinds + DIFFRAX}


def highest_frequency(lattice: Lattice, state: Pytree, t0: Scalar, t1: Scalar) -> float:
    """Return the highest linear frequency, or if it is zero the bound at this energy, or 0."""
    omega = float(np.max(linear_frequency(lattice)))
    if omega > 0:
        return omega
    try:
        return float(np.max(frequency_bound(lattice, state, t0, t1)))
    except ValueError:
        return 0.0


def stable_step(solver: diffrax.AbstractSolver, omega: Scalar) -> float:
    """Return the longest stable step of a solver; infinity if it is unknown or has no limit."""
    limit = stability_limit(solver)
    return limit / omega if limit and omega > 0 else math.inf


def _least(dtype):
    return ROUNDINGS * float(jnp.finfo(dtype).eps)


# tolerances, or steps, between which the error falls by about `RUNG`
def _sensible_values(solver, limit, span, dtype):
    down = RUNG ** -np.arange(MOST_VALUES)
    if isinstance(solver, diffrax.AbstractAdaptiveSolver):
        values = FIRST_TOLERANCE * down
        values = values[values > _least(dtype)]
    else:
        table = getattr(type(solver), "table", None)
        order = ORDER if table is None else table().order
        values = min(FIRST_STEP * limit, span / LEAST_INTERVALS) * down ** (1 / order)
    return tuple(float(f"{x:.3g}") for x in values)


# force evaluations and steps of a run, averaged over lanes
def _counts(run):
    stats = jax.tree.map(np.mean, run.stats)
    kind = getattr(diffrax, run.solver, None)
    forces = stats["force_evaluations"]
    if isinstance(kind, type) and issubclass(kind, diffrax.AbstractERK):
        # diffrax's explicit methods do not count evaluations
        forces = stats["steps"] * (kind.tableau.num_stages - bool(kind.tableau.fsal))
    return forces, stats["steps"]


def find_reference(
    lattice: Lattice, state: Pytree, t0: Scalar, t1: Scalar
) -> tuple[Pytree, float, str]:
    r"""Return the final state on which two adaptive methods of high order agree best.

    RKN1210 and RKN86, or Dopri8 and Tsit5 where a force reads the velocity, run at finer and finer
    tolerances. The closest pair runs again at another tolerance, to exclude a chance agreement. The
    floor is the largest distance of the other three runs from the first. The runs are in float64
    unless JAX is restricted to float32.

    **Returns:** (final state, floor, what the runs were).

    **Raises** RuntimeError where they differ by more than 1e-3 or one does not complete.
    """
    wide = jnp.zeros(()).dtype
    lattice = lattice.astype(wide)
    state = jax.tree.map(lambda x: jnp.asarray(x, wide), state)
    kinds = (diffrax.Dopri8, diffrax.Tsit5) if facts(lattice).reads_velocity else (RKN1210, RKN86)

    def ends(tolerance):
        runs = [
            simulate(lattice, state, t1, t0=t0, solver=kind(), tolerance=tolerance)
            for kind in kinds
        ]
        return [jax.tree.map(np.asarray, run.final) for run in runs]

    found = []
    try:
        for tolerance in REFERENCE_TOLERANCES[REFERENCE_TOLERANCES > _least(wide)]:
            first, second = ends(tolerance)
            found.append((distance(second, first), tolerance, first))
    except RuntimeError as error:
        # a finer run may fail after a coarser one succeeded
        if not found:
            raise RuntimeError(f"No reference: a run of high order fails. {error}") from None
    apart, tolerance, final = min(found, key=lambda x: x[0])
    floor = max(apart, *(distance(end, final) for end in ends(OTHER_MESH * tolerance)))
    names = f"{kinds[0].__name__} and {kinds[1].__name__} at tolerance {tolerance:.0e}"
    if not floor <= LARGEST_FLOOR:
        raise RuntimeError(
            f"No reference exists at t1 = {t1:g}: {names} differ by {floor:.3g}, and finer ones no "
            "less. Such a trajectory amplifies rounding (chaos), or an unstable scene its errors: "
            "end the run earlier, or compare averages."
        )
    return final, floor, names
