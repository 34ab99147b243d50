"""What computes lanes: a function of the user's, as a compiled program of many lanes or called lane by lane."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..flow.lifted import lifting, quietly
from ..flow.run import COMPLETED, WHY
from ..outside import Outside
from ..printing import told as _told
from ..programs import joined as whole_of
from ..programs import parted, wait
from . import function as called
from .chunk import Chunk

LANES, VMAP, EACH = "lanes", "vmap", "each"


class How(NamedTuple):
    """How a function is computed.

    - `kind`: `"lanes"`, compiled, the lanes of runs last; `"vmap"`, compiled by `jax.vmap` alone; `"each"`, called for
      one lane after another.
    - `static`: names of parameters that are no arrays in the program, which is another one for each of their values.
    - `errors`: whether the errors of records are computed with them. `apart`: lanes that are called by themselves.
    - `shared`: names of parameters that are one number for all lanes, such as the time at which all runs end.
    """

    kind: str
    static: tuple[str, ...] = ()
    errors: bool = False
    apart: tuple[int, ...] = ()
    shared: tuple[str, ...] = ()
    __repr__ = _told


class _Known(NamedTuple):
    """What is static in a program: the function, how it is called, `How.kind`, errors, values of static parameters."""

    function: Callable
    keywords: bool
    kind: str
    errors: bool
    static: tuple[tuple[str, Any], ...]


class _Itself:
    """A function that cannot be hashed, as itself."""

    def __init__(self, function):
        self.function = function
        self.__name__ = getattr(function, "__name__", "")

    def __call__(self, *arguments, **named):
        return self.function(*arguments, **named)

    def __eq__(self, other):
        return isinstance(other, _Itself) and self.function is other.function

    def __hash__(self):
        return id(self.function)


def hashable(function: Callable) -> Callable:
    """The function as a key."""
    try:
        hash(function)
    except TypeError:
        return _Itself(function)
    return function


class _Rest:
    """What is no array of what a function returns: a pytree without leaves."""

    def __init__(self, value):
        self.value = value


jax.tree_util.register_pytree_node(_Rest, lambda x: ((), x.value), lambda value, _: _Rest(value))


@partial(jax.jit, static_argnums=0)
def program(known: _Known, outside: Outside, values: dict) -> tuple:
    """Arrays of what the function returns, lanes first; the rest of it; codes of its runs (lanes, runs)."""

    def one(values):
        arguments = {**dict(known.static), **values}
        with lifting(known.errors, known.kind == LANES) as seen:
            arrays, rest = _apart(called.call(known.function, arguments, known.keywords))
        codes = [jnp.max(code) for code in seen.codes]
        return arrays, rest, jnp.stack(codes) if codes else jnp.zeros((0,), int)

    return jax.vmap(one, in_axes=({name: 0 if jnp.ndim(x) else None for name, x in values.items()},))(values)


def _apart(found):
    """Arrays and the rest; a dict keeps its order, which JAX would sort."""
    named = isinstance(found, Mapping)
    static, arrays = parted(list(found.values()) if named else found)
    return arrays, _Rest((static, tuple(found) if named else None))


def _together_again(arrays, rest):
    static, names = rest.value
    found = whole_of(static, arrays)
    return found if names is None else dict(zip(names, found))


class Task:
    """A function with all that a worker needs to compute lanes of it: `task(values) -> Chunk`, values by name (n,).

    `width`: lanes of a compiled program, to which fewer are filled up.
    """

    def __init__(self, function: Callable, names: tuple[str, ...], how: How, width: int, devices: tuple = ()):
        self.function, self.names, self.how, self.width = hashable(function), names, how, width
        self.keywords = called.by_keywords(function, names)
        self.name = called.name_of(function)

    def known(self, values: dict[str, np.ndarray]) -> _Known:
        """What is static in the program for lanes that share their static parameters."""
        static = tuple((name, values[name][0].item()) for name in self.how.static)
        return _Known(self.function, self.keywords, self.how.kind, self.how.errors, static)

    def __call__(self, values: dict[str, np.ndarray]) -> Chunk:
        values = dict(values)
        apart = values.pop("", None)
        count = len(next(iter(values.values())))
        alone = np.full(count, self.how.kind == EACH) if apart is None else apart
        if alone.all():
            return self._each(values, count)
        return self._together(values, count)

    def _each(self, values, count):
        parts, reasons = [], []
        for lane in range(count):
            part, reason = self._one({name: x[lane].item() for name, x in values.items()})
            parts.append(part)
            reasons.append(reason)
        columns, told = called.stacked(parts)
        return Chunk(columns, reasons, told)

    def _one(self, values):
        """Columns of one lane and "", or `None` and why it failed."""
        try:
            with quietly():
                found = called.columns(called.call(self.function, values, self.keywords), self.name, None)
        except Exception as error:
            return None, said(error)
        return found, not_finite({name: x for name, (x, _) in found.items()})

    def _together(self, values, count):
        """All lanes by one program; where it fails they are called one by one, each with a reason of its own."""
        fill = self.width - count
        known = self.known(values)
        arrays = {name: np.concatenate([x, np.repeat(x[-1:], max(fill, 0))]) for name, x in values.items()
                  if name not in self.how.static}
        arrays |= {name: arrays[name][0] for name in self.how.shared}
        arrays, rest, codes = wait(program(known, Outside((self.function,)), arrays))
        found = _together_again([np.asarray(x) for x in arrays], rest)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            found = called.columns(found, self.name, count + max(fill, 0))
        codes = np.asarray(codes)[:count].max(axis=1, initial=COMPLETED)
        columns, reasons = {}, []
        for lane in range(count):
            here = {name: x[lane : lane + 1] for name, (x, _) in found.items()}
            reasons.append(WHY[int(codes[lane])] if codes[lane] else not_finite(here))
        for name, (x, _) in found.items():
            kept = [None if codes[lane] else x[lane : lane + 1] for lane in range(count)] if codes.any() else None
            columns[name] = np.array(x[:count]) if kept is None else _kept(kept, x)
        return Chunk(columns, reasons, {name: told for name, (_, told) in found.items()})


def _kept(parts, x):
    """Rows of lanes that have completed; NaN, or "", for the others."""
    if all(part is None for part in parts):
        return np.full((len(parts), *x.shape[1:]), "" if x.dtype.kind == "U" else np.nan)
    return called.joined(parts, [1] * len(parts))


def said(error: BaseException) -> str:
    """Why a lane failed, in a sentence."""
    text = " ".join(str(error).split())[:400]
    return text if isinstance(error, ValueError | RuntimeError) and text else f"{type(error).__name__}: {text}"


def not_finite(columns: dict[str, np.ndarray | np.generic]) -> str:
    """The names of columns of a lane that are not finite, as a sentence; "" where all are."""
    bad = [name for name, x in columns.items() if x.dtype.kind == "f" and not np.isfinite(x).all()]
    return f"Not finite: {', '.join(bad[:4])}{', ...' if len(bad) > 4 else ''}." if bad else ""


def groups(values: dict[str, np.ndarray], static: tuple[str, ...], lanes: np.ndarray) -> Iterator[np.ndarray]:
    """Lanes that share their static parameters, in the order in which they come."""
    if not static:
        yield lanes
        return
    keys = list(zip(*(values[name][lanes].tolist() for name in static)))
    for key in dict.fromkeys(keys):
        yield lanes[[k == key for k in keys]]
