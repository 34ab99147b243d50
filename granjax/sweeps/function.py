"""The swept function: compiled for many points at once if possible, else called one by one."""

import inspect
import itertools
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
import xarray
from jax.typing import ArrayLike

from ..base.checks import described, refuse
from ..base.programs import compiled
from ..results import Result

# the remark on a point whose results have other shapes
ODD = "The function returned shapes {} here, but {} before. Return the same names and shapes."
# the number of failed points of a chunk that are computed again alone, to get their error messages
ASKED = 4
# the parameters whose signs differ in the corners of a chunk that are traced, at most 2^6 of them
SIGNS = 6
# attributes of a result that are not its data
KNOWN = ("granjax", "jax", "result", "units", "cite")
# JAX takes a power of whole numbers by shifts of the exponent: a negative one gives garbage
POWER = ("shift_right_logical", "i", ())
DRAWS = (
    "It is compiled once for many points, which would share what NumPy's or Python's random draws. Draw from a "
    "parameter: jax.random.normal(jax.random.key(seed), shape), with one seed for each point."
)


class Task(NamedTuple):
    """How points are computed.

    - `function`: a `Called`, pickled.
    - `static`: parameters that are not arrays in the program; `None` if it cannot be traced.
    - `shared`: parameters with one value for all points.
    - `width`: points at a time.
    """

    function: bytes
    static: tuple[str, ...] | None
    shared: tuple[str, ...]
    width: int


class Chunk(NamedTuple):
    """Results of n points: {name: (n, ...)}, and the reason of each failure, "" for success."""

    columns: dict[str, xarray.Variable]
    reasons: np.ndarray


class Called(NamedTuple):
    """A function that is called at a point: by the names of parameters, or with one dict."""

    function: Callable
    by_names: bool

    def __call__(self, point: Mapping[str, Any]) -> Any:
        return self.function(**point) if self.by_names else self.function(dict(point))


def called(function: Callable, names: tuple[str, ...]) -> Called:
    """Return how a function takes its parameters."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return Called(function, True)
    own = [*signature.parameters]
    by_names = _binds(signature, **dict.fromkeys(names))
    if by_names or _binds(signature, {}) and own[0] not in names:
        return Called(function, by_names)
    got = f"{getattr(function, '__name__', 'one')}({', '.join(own)})"
    remedy = "Parameters are given by their names."
    refuse("function", f"a function of {', '.join(names)}, or of one dict with these", got, remedy)


def _binds(signature, *arguments, **named):
    try:
        signature.bind(*arguments, **named)
    except TypeError:
        return False
    return True


def packed(function: Called) -> bytes:
    """Pickle a function; cloudpickle, if installed, also takes lambdas and notebook functions."""
    try:
        import cloudpickle as by
    except ImportError:
        by = pickle
    try:
        return by.dumps(function)
    except Exception as error:
        remedy = "pip install 'granjax[cluster]' sends lambdas; open files and locks within the function."
        refuse(
            "function",
            "one that can be sent to another process",
            f"one that cannot ({error})",
            remedy,
        )


# The cache returns the same function in a process, so that it compiles once.
unpacked = lru_cache(maxsize=8)(pickle.loads)


def computed(task: Task, function: Called | None, values: dict[str, np.ndarray]) -> Chunk:
    """Compute the results at points (n,). `function` is `None` in another process."""
    function = unpacked(task.function) if function is None else function
    count = len(next(iter(values.values())))
    rows = [None] * count
    reasons = np.full(count, "", object)
    points = [{name: x[i].item() for name, x in values.items()} for i in range(count)]
    if task.static is not None:
        refused = _refused(function, values, points)
        reasons[list(refused)] = list(refused.values())
        together = np.setdiff1d(np.arange(count), list(refused))
        _by_program(task, function, values, points, together, rows)
    asked = 0
    for i in range(count):
        if rows[i] is None and not reasons[i]:
            rows[i], reasons[i] = _alone(function, points[i])
        elif rows[i] is not None:
            reasons[i] = _not_finite(rows[i])
            if reasons[i] and asked < ASKED:
                asked += 1
                alone, error = _alone(function, points[i])
                if alone is None:
                    rows[i] = None
                    reasons[i] = error
    return _stacked(rows, reasons)


def _by_program(task, function, values, points, together, rows):
    key = lambda i: tuple(points[i][name] for name in task.static)
    for _, group in itertools.groupby(sorted(together, key=key), key):
        group = list(group)
        try:
            known = tuple((name, points[group[0]][name]) for name in task.static)
            run, rest, order = program(function, known, task.shared, kinds(values))
        except Exception:
            continue
        size = min(task.width, 1 << (len(group) - 1).bit_length())
        filled = group + group[-1:] * (size - len(group))
        arrays = {
            name: x[0] if name in task.shared else x[filled]
            for name, x in values.items()
            if name not in task.static
        }
        found = jax.device_get(run(np.arange(size), arrays))
        for row, i in enumerate(group):
            whole = eqx.combine(jax.tree.map(lambda x, row=row: x[row], found), rest)
            whole = {name: whole[name] for name in order} if order else whole
            rows[i] = columns(whole, name_of(function), values)


def kinds(values: dict[str, np.ndarray]) -> tuple:
    """Return the names and types of the parameters."""
    return tuple((name, x.dtype.str) for name, x in values.items())


@lru_cache(maxsize=64)
def program(function: Called, static: tuple, shared: tuple, kinds: tuple) -> tuple:
    """Return a compiled function of many points, its non-array results, and the order of names.

    **Raises** errors of tracing, and ValueError for a function that differs when traced again.
    """
    kept = []
    known = dict(static)
    whole = any(np.dtype(kind).kind == "i" and name not in known for name, kind in kinds)

    def one(values):
        found = function(known | values)
        arrays, rest = eqx.partition(found, eqx.is_array)
        kept[:] = [rest, tuple(found) if isinstance(found, Mapping) else ()]
        return arrays

    def numbers():
        shapes = {name: jax.ShapeDtypeStruct((), kind) for name, kind in kinds if name not in known}
        # A new lambda each time, or JAX would reuse the first trace.
        traced = jax.make_jaxpr(lambda values: one(values))(shapes)
        found = [*_numbers(traced), *_numbers(jax.tree.leaves(kept[0]))]
        if whole and POWER in found:
            raise TypeError("a power of a traced whole number")
        return found

    if numbers() != numbers():
        refuse(
            "function",
            "a function that gives the same numbers at each call",
            "other numbers at a second call",
            DRAWS,
        )
    axes = {name: None if name in shared else 0 for name, _ in kinds if name not in known}
    # The unused indices give `vmap` an axis even if all parameters are shared or static.
    return compiled(jax.vmap(lambda _, values: one(values), (0, axes))), *kept


def _numbers(x):
    # Yield the primitives and constants of a traced program and its nested ones, in order.
    if isinstance(x, (tuple, list)):
        for part in x:
            yield from _numbers(part)
    elif hasattr(x, "consts"):
        yield from _numbers([*x.consts, x.jaxpr])
    elif hasattr(x, "eqns"):
        for equation in x.eqns:
            name = equation.primitive.name
            at = equation.invars[0].aval if name == POWER[0] else None
            yield name if at is None else (name, at.dtype.kind, at.shape)
            yield from _numbers([*equation.invars, *equation.params.values()])
    elif hasattr(x, "val"):
        yield from _numbers([x.val])
    elif isinstance(x, ArrayLike) and not isinstance(x, jax.core.Tracer):
        # Python's whole numbers may be too large for NumPy.
        yield x if isinstance(x, int) else np.asarray(x).tobytes()


def _refused(function, values, points):
    """Return {point: message} for invalid scenes, which a program does not notice.

    It checks corners, and all points if one fails.
    """
    numbers = [x.astype(float) for x in values.values() if x.dtype.kind != "U"]
    ends = {int(pick(x)) for x in numbers for pick in (np.argmin, np.argmax)} | _corners(numbers)
    found = {i: _refusal(function, points[i]) for i in sorted(ends)}
    if any(found.values()):
        found = {i: _refusal(function, point) for i, point in enumerate(points)}
    return {i: said for i, said in found.items() if said}


def _corners(numbers):
    # Return the points that lie farthest along each diagonal of the box around all points.
    along = [(x - x.min()) / np.ptp(x) for x in numbers if np.ptp(x) > 0]
    signs = [[1 - 2 * (k >> i % SIGNS & 1) for i in range(len(along))] for k in range(1 << SIGNS)]
    return {int(np.argmax(np.array(row) @ along)) for row in signs} if along else set()


def _refusal(function, point):
    # Return the error message of a scene, found by tracing.
    try:
        jax.make_jaxpr(lambda: eqx.filter(function(point), eqx.is_array))()
    except ValueError as error:
        return said(error)
    except Exception:
        pass
    return ""


def _alone(function, point):
    try:
        row = columns(function(point), name_of(function), point)
    except Exception as error:
        return None, said(error)
    return row, _not_finite(row)


def said(error: BaseException) -> str:
    """Return an error message on one line."""
    text = " ".join(str(error).split())[:400]
    return (
        text
        if isinstance(error, (ValueError, RuntimeError)) and text
        else f"{type(error).__name__}: {text}"
    )


def _not_finite(row):
    own = {name: x.values for name, x in row.items()}
    bad = [name for name, x in own.items() if x.dtype.kind in "fc" and not np.isfinite(x).all()]
    return f"Not finite: {', '.join(bad[:4])}{', ...' if len(bad) > 4 else ''}." if bad else ""


def _stacked(rows, reasons):
    # Stack rows to a `Chunk`, with NaN or "" for failures and for other names or shapes.
    shapes = lambda row: {name: x.shape for name, x in row.items()}
    first = next((row for row in rows if row), {})
    for i, row in enumerate(rows):
        if row is not None and shapes(row) != shapes(first):
            reasons[i] = ODD.format(shapes(row), shapes(first))
            rows[i] = None
    found = {}
    for name, x in first.items():
        blank = np.full(x.shape, "" if x.dtype.kind == "U" else np.nan, x.dtype)
        values = np.stack([blank if row is None else row[name].values for row in rows])
        found[name] = xarray.Variable(("point of the chunk", *x.dims), values, x.attrs)
    return Chunk(found, reasons)


def name_of(called: Called) -> str:
    """Return the name for the result of a function that returns one number."""
    name = getattr(called.function, "__name__", "")
    return name if name.isidentifier() else "value"


def columns(value: Any, name: str, taken: Iterable[str]) -> dict[str, xarray.Variable]:
    """Return the results at one point by name, with real numbers as floats.

    A name that is taken by a parameter gets the ending `_found`.

    **Raises** ValueError for anything but a number, word, array, dict of them or result.
    """
    found = {}
    for key, x in _entries(value, ""):
        # A store makes groups of names with a slash.
        key = key.replace("/", "_") or name
        key += "_found" * (key in (*taken, "reason", "done"))
        if not isinstance(x, xarray.Variable):
            x = np.asarray(float(x) if isinstance(x, int) else x)
            x = xarray.Variable([f"{key}_{k}" for k in range(x.ndim)], x)
        if x.dtype.kind not in "biufcU":
            got = f"{key} of {described(value)}"
            refuse(
                "function", "one that returns numbers, words, arrays, dicts of them or results", got
            )
        if key in found:
            refuse("function", "one with a name for each result", f"{key!r} twice")
        found[key] = x if x.dtype.kind in "fcU" else x.astype(float)
    if not found:
        refuse(
            "function", "one that returns numbers or words", f"one that returns {described(value)}"
        )
    return found


def _entries(value, name) -> Iterator[tuple[str, Any]]:
    value = value._asdict() if hasattr(value, "_asdict") else value
    value = value.to_xarray() if isinstance(value, Result) else value
    called = lambda key: f"{name}_{key}" if name else str(key)
    if isinstance(value, xarray.Dataset):
        for key, x in value.variables.items():
            if x.dtype.kind != "O" and key not in ("site", "component", "field"):
                yield called(key), _with_unit(x.dims, x.values, x.attrs.get("units"))
        for key, x in value.attrs.items():
            own = key not in KNOWN and not key.endswith("_units")
            if own and isinstance(x, (bool, int, float, str, np.number)):
                yield called(key), _with_unit((), x, value.attrs.get(f"{key}_units"))
    elif isinstance(value, Mapping):
        for key, x in value.items():
            yield from _entries(x, called(key))
    elif isinstance(value, xarray.DataArray):
        x = _with_unit(value.dims, value.values, value.attrs.get("units"))
        yield name or str(value.name or ""), x
    elif isinstance(value, (tuple, list)) and not all(
        isinstance(x, str | ArrayLike) and np.ndim(x) == 0 for x in value
    ):
        for i, x in enumerate(value):
            yield from _entries(x, f"{name or 'value'}_{i}")
    elif value is not None:
        yield name, value


def _with_unit(dims, values, unit):
    return xarray.Variable(dims, values, None if unit is None else {"units": unit})
