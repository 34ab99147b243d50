"""Checks of arguments, which raise a `ValueError` with argument, expected, got and remedy.

Only concrete values are checked. Traced values pass, since they are not known yet.
"""

import difflib
import os
import reprlib
from collections.abc import Callable, Iterable
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np

PLAIN = (str, int, float, complex, tuple, list, dict)


def refuse(argument: str, expected: str, got: str, remedy: str = "") -> NoReturn:
    """Raise the ValueError of granjax for invalid input.

    Its text is `argument: expected ..., got .... remedy`.
    """
    raise ValueError(
        f"{argument}: expected {expected}, got {got}." + (f" {remedy}" if remedy else "")
    ) from None


def concrete(x: Any) -> np.ndarray | None:
    """Return `x` as a NumPy array, or `None` if it is traced."""
    return None if isinstance(x, jax.core.Tracer) else np.asarray(x)


def known_value(x: Any) -> np.ndarray | None:
    """Return `x` without derivatives as a NumPy array, or `None` under `jit` and `vmap`."""
    return concrete(jax.lax.stop_gradient(x))


def plain_zero(x: Any) -> bool:
    """Return whether `x` is a plain number zero; arrays and traced zeros are not."""
    return isinstance(x, (int, float)) and bool(x == 0)


def traced(tree: Any) -> bool:
    """Return whether some leaf of a pytree is traced."""
    # A loop takes half as long as `any` of a generator, and `simulate` asks five times.
    for x in jax.tree.leaves(tree):
        if isinstance(x, jax.core.Tracer):
            return True
    return False


def show(x: Any) -> str:
    """Return a value as short text for an error message."""
    x = concrete(x)
    if x is None:
        return "traced"
    return np.array2string(x, threshold=6, edgeitems=2, precision=6) if x.ndim else repr(x.item())


def described(x: Any) -> str:
    """Return a short description of a value."""
    if isinstance(x, jax.core.Tracer):
        return f"a traced value of type {x.dtype} and shape {x.shape}"
    if isinstance(x, (np.ndarray, jax.Array)):
        return f"an array of {x.dtype}, shape {x.shape}" if np.ndim(x) else f"{x}, an array"
    if isinstance(x, type):
        return f"the class {x.__name__}"
    text = reprlib.repr(x)
    return text if isinstance(x, (*PLAIN, type(None))) else f"{text} of type {type(x).__name__}"


def letter(x: Any) -> str:
    """Return NumPy's letter of an array's type, "" if it is no array.

    K stands for JAX's keys, V for the shorter floats.
    """
    return getattr(x.dtype, "kind", "K") if hasattr(x, "dtype") else ""


def real(argument: str, x: Any, expected: str = "real numbers") -> np.ndarray:
    """Return `x` as a floating NumPy array of any shape, in which NaN marks missing numbers.

    Complex and masked arrays are refused.
    """
    return np.asarray(_real(argument, x, expected), dtype=float)


def _real(argument, x, expected="real numbers"):
    # Keeps an array of JAX.
    try:
        array = x if isinstance(x, jax.Array) else np.asarray(x)
        kind = letter(array)
    except (TypeError, ValueError, RuntimeError):
        kind = ""
    if np.ma.is_masked(x):  # Its values would be read all the same.
        missing = f"{np.ma.count_masked(x)} of {x.size} masked"
        remedy = "Use .filled(np.nan) where NaN may stand for a missing value."
        refuse(argument, "numbers without a mask", missing, remedy)
    if kind == "c":
        refuse(
            argument,
            "real numbers",
            f"{array.dtype}",
            "Take the real part or abs(), whichever you mean.",
        )
    if kind not in "fiu" or not kind:
        refuse(argument, expected, described(x), "Give a number or an array of numbers.")
    return array


def parameter(argument: str, x: Any) -> jax.Array:
    """Return `x` as a floating array of finite real numbers, of any shape.

    A NumPy or Python number takes the default type; a floating JAX array keeps its own.
    """
    if isinstance(x, jax.Array) and jnp.issubdtype(x.dtype, jnp.floating):
        # A plain number that is differentiated has no shape once its derivatives are stopped.
        array = jnp.asarray(x) if isinstance(x, jax.core.Tracer) else x
    else:
        raw = _real(argument, x)
        # A plain number stays concrete while tracing, so that it is checked there too.
        with jax.ensure_compile_time_eval():
            own = isinstance(raw, jax.Array)
            # `jnp.asarray` of NumPy's array would compile a program for each shape. The copy
            # protects against later changes of the array.
            array = raw.astype(float) if own else jax.device_put(np.array(raw, float))
    value = concrete(array)
    if value is not None and not np.all(np.isfinite(value)):
        refuse(
            argument, "finite numbers", show(value), "Look for NaN or infinity in what you pass."
        )
    return array


def require(argument: str, x: Any, passes: Callable, expected: str, remedy: str = "") -> Any:
    """Return an array whose known numbers pass a test."""
    value = concrete(x)
    if value is not None and not np.all(passes(value)):
        refuse(argument, expected, show(value), remedy)
    return x


def positive(argument: str, x: Any, remedy: str = "") -> jax.Array:
    """Return a parameter that is finite and above zero."""
    x = parameter(argument, x)
    return require(argument, x, lambda value: value > 0, "numbers above zero", remedy)


def non_negative(argument: str, x: Any, remedy: str = "") -> jax.Array:
    """Return a parameter that is finite and not below zero."""
    x = parameter(argument, x)
    return require(argument, x, lambda value: value >= 0, "numbers not below zero", remedy)


def within(
    argument: str,
    x: Any,
    low: float,
    high: float,
    *,
    open_low: bool = False,
    open_high: bool = False,
    remedy: str = "",
) -> jax.Array:
    """Return a parameter inside an interval; an open bracket excludes its end."""

    def passes(value):
        above = value > low if open_low else value >= low
        return above & (value < high if open_high else value <= high)

    interval = f"{'(' if open_low else '['}{low}, {high}{')' if open_high else ']'}"
    return require(argument, parameter(argument, x), passes, f"numbers in {interval}", remedy)


def broadcast(**arrays: Any) -> None:
    """Refuse named arrays whose shapes do not broadcast."""
    shapes = {name: np.shape(x) for name, x in arrays.items()}
    try:
        np.broadcast_shapes(*shapes.values())
    except ValueError:
        refuse(
            " and ".join(shapes), "shapes that broadcast", " and ".join(map(str, shapes.values()))
        )


def per_lane(
    argument: str, x: Any, lanes: tuple[int, ...], check: Callable = parameter
) -> jax.Array:
    """Return a parameter of a whole lattice: one number, or one per lane, each passing `check`."""
    array = check(argument, x)
    if array.shape not in ((), lanes):
        wanted = "one number" + (f", or one per lane, shape {lanes}" if lanes else "")
        remedy = (
            "For many at once: jax.vmap(lambda x: ..., out_axes=-1)(values), or a batch of lattices. What "
            "differs from site to site is written into the state."
        )
        refuse(argument, wanted, f"shape {array.shape}", remedy)
    return array


def tolerance(argument: str, x: Any, most: float = 0.1, typical: float = 1e-8) -> Any:
    """Return a relative tolerance: one number above zero and below `most`."""
    if isinstance(x, jax.core.Tracer) or type(x) is float and 0 < x < most:
        return x
    value = _real(argument, x)
    if value.ndim or not 0 < value < most:
        refuse(
            argument,
            f"one number above 0 and below {most:g}",
            show(value),
            f"Typical: {typical:g}.",
        )
    return float(value)


def nearest(name: str, options: Iterable, most: int = 1) -> str:
    """Return a question for the options closest to a misspelt name; empty if none is close."""
    lowered = {str(option).lower(): option for option in options}
    near = [
        lowered[n] for n in difflib.get_close_matches(name.lower(), lowered, n=most, cutoff=0.6)
    ]
    return f"Did you mean {' or '.join(map(repr, near))}?" if near else ""


def one_of(argument: str, name: Any, options: Iterable) -> Any:
    """Return `name` if it is among the options; otherwise suggest the nearest."""
    options = tuple(options)
    # Objects of other types, such as arrays, may define comparison differently.
    if isinstance(name, tuple(map(type, options))) and name in options:
        return name
    remedy = nearest(described(name).strip("'"), options, 3)
    refuse(argument, "one of " + ", ".join(map(repr, options)), described(name), remedy)


def is_whole(x: Any) -> bool:
    """Return whether `x` is a whole number of Python or NumPy, but not a boolean."""
    return isinstance(x, (int, np.integer)) and not isinstance(x, bool)


def is_site(index: tuple, shape: tuple[int, ...]) -> bool:
    """Return whether an index lies within a shape, counted from either end."""
    # A boolean would be a mask.
    number = lambda i: hasattr(i, "__index__") and not isinstance(i, (bool, np.bool_))
    whole = len(index) == len(shape) and all(map(number, index))
    return whole and all(-n <= i < n for i, n in zip(index, shape))


def whole(argument: str, x: Any, at_least: int = 0, remedy: str = "") -> int:
    """Return a Python integer that is not below a least value."""
    if not is_whole(x) or x < at_least:
        refuse(argument, f"a whole number not below {at_least}", described(x), remedy)
    return int(x)


def several(argument: str, x: Any, expected: str) -> tuple:
    """Return a sequence as a tuple."""
    try:
        return tuple(x)
    except TypeError:
        refuse(argument, expected, described(x))


def held_in_memory(argument: str, count: int, each: int = 16, what: str = "sites") -> None:
    """Refuse `count` things of `each` bytes, a state by default, that memory cannot hold."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # The system does not tell.
        return
    if count * each > memory:
        most = f"at most {memory // each:.3g} {what}, which {memory / 1e9:.0f} GB of memory hold"
        refuse(argument, most, described(count))


def random_key(seed: Any, remedy: str = "Equal seeds give equal draws.") -> jax.Array:
    """Return a JAX key from a whole number, traced or not, or from a key of either kind."""
    if is_whole(seed):
        return jax.random.key(int(seed))
    if isinstance(seed, jax.Array):
        if jnp.issubdtype(seed.dtype, jax.dtypes.prng_key) and seed.ndim == 0:
            return seed
        if jnp.issubdtype(seed.dtype, jnp.integer) and seed.ndim == 0:
            return jax.random.key(seed)
        if seed.dtype == jnp.uint32 and seed.shape == (2,):
            return jax.random.wrap_key_data(seed)
    refuse("seed", "one whole number or one JAX key", described(seed), remedy)
