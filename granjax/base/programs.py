"""Compiled programs: cached for quick calls, and waited for so that Ctrl-C works."""

import inspect
import sys
import time
import weakref
from collections.abc import Callable, Iterable
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
# An array is polled without a pause for this time [s].
EAGER = 5e-4
# Each pause after that is this share of the elapsed time.
SHARE = 0.02
# The longest pause [s].
LONGEST = 0.02
# Vectors of 512 bits. Without this option XLA uses 256 bits, and a run on AMD's Zen 5 takes 1.5
# times as long.
WIDE = {"xla_cpu_prefer_vector_width": "512"}
# With wide vectors jaxlib 0.10.2 computes this operation wrongly (jax issue 39352), and no other of
# 80 that were tried.
WRONG = "atan"


def compiled(function: Callable) -> Callable:
    """Compile a function of pytrees with `jax.jit`; everything but arrays is static.

    It is like `equinox.filter_jit`, for arguments that may be given by position, but faster to
    call, and it uses wide vectors where the processor has them.
    """

    def flat(static, arrays):
        return function(*joined(static, arrays))

    plain = jax.jit(flat, static_argnums=0)
    wide = jax.jit(flat, static_argnums=0, compiler_options=WIDE)
    signature = inspect.signature(function)
    is_wide = {}

    def call_flat(static, arrays):
        found = is_wide.get(static)
        if found is None:
            found = wide_vectors() and not holds(plain.trace(static, arrays).jaxpr, WRONG)
            is_wide[static] = found
        if found and not traced(arrays):
            try:
                return wide(static, arrays)
            except ValueError as error:
                # Within a traced program JAX accepts options of the outermost program only.
                if "compiler_options" not in str(error):
                    raise
        return plain(static, arrays)

    @wraps(function)
    def call(*arguments, **named):
        if named:
            bound = signature.bind(*arguments, **named)
            bound.apply_defaults()
            arguments = bound.args
        return call_flat(*parted(arguments))

    call.lower = lambda *arguments: plain.lower(*parted(arguments))
    call.cache_clear = is_wide.clear
    return call


def holds(jaxpr: Any, operation: str) -> bool:
    """Return whether a traced program contains an operation, also in loops and branches."""
    parameters = jax.tree.leaves([list(equation.params.values()) for equation in jaxpr.eqns])
    inner = [getattr(x, "jaxpr", x) for x in parameters if isinstance(x, (ClosedJaxpr, Jaxpr))]
    own = any(equation.primitive.name == operation for equation in jaxpr.eqns)
    return own or any(holds(part, operation) for part in inner)


def by_rows(transform: Callable, x: Any, *length: int, axis: int = -1) -> jax.Array:
    """Apply a Fourier transform, such as `jnp.fft.rfft`, along one axis of `x`.

    XLA's transforms on the CPU need rows in memory. Later operations in the same program, such as
    LAPACK on a Jacobian, may ask for columns, and XLA then fails. So the layout is fixed on both
    sides.
    """

    def kept(x):
        return with_layout_constraint(x, Layout(tuple(range(x.ndim))))

    # Under `jax.grad` NumPy's arrays would reach the layout as they are.
    x = jnp.moveaxis(jnp.asarray(x), axis, -1)
    return jnp.moveaxis(kept(transform(kept(x), *length)), -1, axis)


def parted(tree: Pytree) -> tuple:
    """Return the static part of a pytree, hashable, and a list of its arrays.

    If the first of several arguments is `settled`, as most lattices are, its parts are cached while
    it lives.
    """
    if type(tree) is tuple and tree and getattr(tree[0], "settled", False):
        first, own = _settled(tree[0])
        rest, more = _parted(tree[1:])
        return (first, rest), own + more
    static, arrays = _parted(tree)
    return (None, static), arrays


def _parted(tree):
    leaves, treedef = jax.tree.flatten(tree)
    is_array = [isinstance(leaf, _ARRAYS) for leaf in leaves]
    rest = tuple([_ARRAYS if own else leaf for own, leaf in zip(is_array, leaves)])
    return (treedef, rest), [leaf for own, leaf in zip(is_array, leaves) if own]


_NOBODY = (lambda: None), None


def once(function: Callable) -> Callable:
    """Cache the result of a function of one object while the object lives, or until `gx.clear`."""
    held = {}

    @wraps(function)
    def call(x):
        key = id(x)
        owner, found = held.get(key, _NOBODY)
        if owner() is not x:
            found = function(x)
            held[key] = weakref.ref(x, lambda _: held.pop(key, None)), found
        return found

    call.cache_clear = held.clear
    return call


@once
def _settled(x):
    return _parted(x)


def joined(static: tuple, arrays: Iterable) -> Pytree:
    """Return the pytree that `parted` took apart."""
    first, rest = static
    arrays = iter(arrays)
    return (
        _joined(rest, arrays) if first is None else (_joined(first, arrays), *_joined(rest, arrays))
    )


def _joined(static, arrays):
    treedef, rest = static
    return jax.tree.unflatten(treedef, [next(arrays) if leaf is _ARRAYS else leaf for leaf in rest])


def is_untraced() -> bool:
    """Return whether nothing is being traced here, whatever the arguments are."""
    return not isinstance(jax.device_put(0.0), jax.core.Tracer)


def concretely(function: Callable, *arguments: Any) -> Any:
    """Return the result of a compiled function of known arguments as NumPy arrays.

    Within a traced program it is computed one operation at a time, and each compiles.
    """
    with nullcontext() if is_untraced() else jax.ensure_compile_time_eval():
        return jax.tree.map(np.asarray, function(*arguments))


def in_numpy(tree: Pytree) -> Pytree:
    """Return a tree with JAX's known arrays as NumPy's, whose operations compile nothing."""
    known = lambda x: isinstance(x, jax.Array) and not isinstance(x, jax.core.Tracer)
    return jax.tree.map(lambda x: np.asarray(x) if known(x) else x, tree)


def library(*values: Any) -> Any:
    """Return NumPy if all values are known, so that nothing is compiled; else `jax.numpy`."""
    return jnp if traced(values) else np


def shared_size(n: int) -> int:
    """Round a size up to one of 8, 9, ..., 15, 16, 18, ..., 30, 32, ..., to share programs."""
    unit = 1 << max(n.bit_length() - 4, 0)
    return -(-n // unit) * unit


def wait(tree: Any) -> Any:
    """Wait for the result of a compiled program and return it. Traced values pass.

    JAX's own wait blocks signals, so that Ctrl-C would work only at the end of the program.
    """
    arrays = [x for x in jax.tree.leaves(tree) if hasattr(x, "is_ready")]
    begin = time.perf_counter()
    while not all(x.is_ready() for x in arrays):
        passed = time.perf_counter() - begin
        time.sleep(0 if passed < EAGER else min(SHARE * passed, LONGEST))
    return tree


def bar(total: int, unit: str, name: str, shown: bool = True, done: int = 0) -> Any:
    """Return a progress bar with the time left, shown after two seconds in a terminal or notebook.

    It is a context manager with `update(n)`.
    """
    from tqdm import tqdm

    shown = shown and (getattr(sys.stderr, "isatty", bool)() or "ipykernel" in sys.modules)
    return tqdm(
        total=total, initial=done, unit=unit, desc=name, delay=2, leave=False, disable=not shown
    )
