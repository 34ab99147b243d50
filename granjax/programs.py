"""Compiled programs: found quickly where they are called again, and waited for in a way that Ctrl-C reaches."""

import inspect
import sys
import time
import weakref
from collections.abc import Callable
from contextlib import nullcontext
from functools import wraps
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.layout import Layout, with_layout_constraint
from jax.extend.core import ClosedJaxpr, Jaxpr

from .checks import traced
from .tuning import wide_vectors
from .types import Pytree

_ARRAYS = (jax.Array, np.ndarray, np.generic)
# seconds for which an array is asked again and again; then pauses, of a share of what has passed, and the longest
EAGER, SHARE, LONGEST = 5e-4, 0.02, 0.02
# Vectors of 512 bits: without the option XLA takes half of them, and a run 1.5 times as long on AMD's Zen 5.
WIDE = {"xla_cpu_prefer_vector_width": "512"}
# jaxlib 0.10.2 gets this operation wrong with them (jax issue 39352), and no other one of 80 that were tried
WRONG = "atan"


def compiled(function: Callable) -> Callable:
    """`jax.jit` of a function of pytrees, in which everything but arrays is static.

    As `equinox.filter_jit`, for arguments that may be given by position, with less to do at each call, and with wide
    vectors where the processor has them.
    """

    def flat(static, arrays):
        return function(*joined(static, arrays))

    plain = jax.jit(flat, static_argnums=0)
    wide = jax.jit(flat, static_argnums=0, compiler_options=WIDE)
    ordered, is_wide = _ordered(function), {}

    def call_flat(static, arrays):
        found = is_wide.get(static)
        if found is None:
            found = wide_vectors() and not holds(plain.trace(static, arrays).jaxpr, WRONG)
            is_wide[static] = found
        if found and not traced(arrays):
            try:
                return wide(static, arrays)
            except ValueError as error:
                # of known numbers in a program that is traced: JAX takes options of the outermost one alone
                if "compiler_options" not in str(error):
                    raise
        return plain(static, arrays)

    @wraps(function)
    def call(*arguments, **named):
        return call_flat(*parted(ordered(arguments, named)))

    call.lower = lambda *arguments: plain.lower(*parted(arguments))
    call.cache_clear = is_wide.clear
    return call


def holds(jaxpr: Any, operation: str) -> bool:
    """Whether a traced program has an operation of this name, in its loops and branches too."""
    parameters = jax.tree.leaves([list(equation.params.values()) for equation in jaxpr.eqns])
    inner = [getattr(x, "jaxpr", x) for x in parameters if isinstance(x, (ClosedJaxpr, Jaxpr))]
    own = any(equation.primitive.name == operation for equation in jaxpr.eqns)
    return own or any(holds(part, operation) for part in inner)


def by_rows(transform: Callable, x: Any, *length: int, axis: int = -1) -> jax.Array:
    """A Fourier transform along one axis of `x`, such as `jnp.fft.rfft`, in any program.

    XLA's transforms on the CPU work row by row in memory. What follows in the same program, such as LAPACK on the
    Jacobian of a force, may ask for columns, and XLA then fails. So the layout is fixed on both sides.
    """

    def kept(x):
        return with_layout_constraint(x, Layout(tuple(range(x.ndim))))

    return jnp.moveaxis(kept(transform(kept(jnp.moveaxis(x, axis, -1)), *length)), -1, axis)


def _ordered(function):
    """What is given to a function, in the order of its arguments."""
    signature = inspect.signature(function)

    def ordered(arguments, named):
        if not named:
            return arguments
        bound = signature.bind(*arguments, **named)
        bound.apply_defaults()
        return bound.args

    return ordered


def parted(tree: Pytree) -> tuple:
    """What is static in a pytree, hashable, and a list of its arrays.

    Of the first of several arguments that is `settled`, as most lattices are, they are kept while it lives.
    """
    if type(tree) is tuple and tree and getattr(tree[0], "settled", False):
        (first, own), (rest, more) = _settled(tree[0]), _parted(tree[1:])
        return (first, rest), own + more
    static, arrays = _parted(tree)
    return (None, static), arrays


def _parted(tree):
    leaves, treedef = jax.tree.flatten(tree)
    is_array = [isinstance(leaf, _ARRAYS) for leaf in leaves]
    rest = tuple([_ARRAYS if own else leaf for own, leaf in zip(is_array, leaves)])
    return (treedef, rest), [leaf for own, leaf in zip(is_array, leaves) if own]


class Kept:
    """What was found of objects, kept for each while it lives, by identity. `gx.clear` lets go of it."""

    def __init__(self):
        self._held = {}
        self.cache_clear = self._held.clear

    def __len__(self):
        return len(self._held)

    def get(self, x: Any) -> Any:
        """What was kept of x, or `None`."""
        owner, found = self._held.get(id(x), _NOBODY)
        return found if owner() is x else None

    def put(self, x: Any, found: Any) -> Any:
        """Keep what was found of x, and return it."""
        key, held = id(x), self._held
        held[key] = weakref.ref(x, lambda _: held.pop(key, None)), found
        return found


_NOBODY = (lambda: None), None


def once(function: Callable) -> Callable:
    """A function of one object whose answer is kept while that object lives."""
    kept = Kept()

    @wraps(function)
    def call(x):
        found = kept.get(x)
        return kept.put(x, (function(x),))[0] if found is None else found[0]

    call.cache_clear = kept.cache_clear
    return call


@once
def _settled(x):
    return _parted(x)


def joined(static: tuple, arrays: list) -> Pytree:
    """The pytree that `parted` took apart."""
    first, rest = static
    arrays = iter(arrays)
    return (
        _joined(rest, arrays) if first is None else (_joined(first, arrays), *_joined(rest, arrays))
    )


def _joined(static, arrays):
    treedef, rest = static
    return jax.tree.unflatten(treedef, [next(arrays) if leaf is _ARRAYS else leaf for leaf in rest])


def is_untraced() -> bool:
    """Whether nothing at all is traced here, whatever the arguments are."""
    return not isinstance(jax.device_put(0.0), jax.core.Tracer)


def concretely(function: Callable, *arguments: Any) -> Any:
    """The result of a compiled function of known arguments, as NumPy arrays, in a program that is traced too.

    There it is computed one operation at a time, each of which compiles.
    """
    with nullcontext() if is_untraced() else jax.ensure_compile_time_eval():
        return jax.tree.map(np.asarray, function(*arguments))


def in_numpy(tree: Pytree) -> Pytree:
    """A tree whose known arrays are NumPy's, of which an operation is no program to compile."""
    return jax.tree.map(lambda x: x if isinstance(x, jax.core.Tracer) else np.asarray(x), tree)


def library(*values: Any) -> Any:
    """NumPy where all values are known, so that nothing is compiled; else `jax.numpy`."""
    return jnp if traced(values) else np


def shared_size(n: int) -> int:
    """A size rounded up to one of 8, 9, ..., 15, 16, 18, ..., 30, 32, ...: arrays of near-by sizes are one program."""
    unit = 1 << max(n.bit_length() - 4, 0)
    return -(-n // unit) * unit


def wait(tree: Any) -> Any:
    """What a compiled program returns, when all of it is there. Nothing happens to what is traced.

    JAX itself waits in a way that no signal reaches, so that Ctrl-C would be answered only at the program's end.
    """
    arrays = [x for x in jax.tree.leaves(tree) if hasattr(x, "is_ready")]
    begin = time.perf_counter()
    while not all(x.is_ready() for x in arrays):
        passed = time.perf_counter() - begin
        time.sleep(0 if passed < EAGER else min(SHARE * passed, LONGEST))
    return tree


def bar(total: int, unit: str, name: str, shown: bool = True, done: int = 0) -> Any:
    """A bar with the time left, after two seconds, on a terminal or in a notebook: `update(n)`, a context manager."""
    from tqdm import tqdm

    shown = shown and (getattr(sys.stderr, "isatty", bool)() or "ipykernel" in sys.modules)
    return tqdm(
        total=total, initial=done, unit=unit, desc=name, delay=2, leave=False, disable=not shown
    )
