"""Derivative rules of any order, within any loop."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

from .checks import traced
from .types import AnyArray, Number

# `jax.custom_jvp` does not suffice. Where a `scan` is differentiated in reverse and then once more,
# as by `jax.hessian`, JAX (0.7 to 0.10) replaces such a function by its body: second derivatives of
# a run were NaN at open contacts, or wrong without a word. A primitive keeps its rule.
_ruled = Primitive("ruled")
# Products of matrices, entry by entry, where zero times NaN is zero, in derivatives too.
_times = Primitive("times")
# Numbers that have no reverse mode, and say so.
_forward = Primitive("forward")
# Eigenvalues of a Hermitian matrix closer than this are equal, in units of eps times the largest.
EQUAL = 64


def with_rule(function: Callable, rule: Callable, *arrays: Number | AnyArray) -> AnyArray:
    """Return `function(*arrays)`, an array, with the derivatives of `rule`.

    `rule(arrays, changes)` returns the value, by `with_rule` again, and its change.
    """
    if not traced(arrays):
        return function(*arrays)
    return _ruled.bind(*arrays, jaxpr=jax.make_jaxpr(function)(*arrays), rule=rule)


def changed(function: Callable, arrays: tuple, changes: tuple) -> tuple:
    """Return `function(*arrays)` and its change; `None` among `changes` is zero."""
    moving = [i for i, change in enumerate(changes) if change is not None]

    def at(*moved):
        now = dict(enumerate(arrays)) | dict(zip(moving, moved))
        return function(*now.values())

    return jax.jvp(at, *(tuple(x[i] for i in moving) for x in (arrays, changes)))


def with_slope(function: Callable, x: Number | AnyArray) -> tuple:
    """Return a function's value at x, and its derivative by x, entry by entry."""
    return jax.jvp(function, (x,), (jnp.ones_like(x),))


def once(tree: Any, refused: Callable) -> Any:
    """Return the numbers; a second derivative calls `refused()`."""

    def rule(arrays, changes):
        if traced(arrays):
            refused()
        return arrays[0], changes[0]

    return jax.tree.map(lambda x: with_rule(lambda x: x, rule, x) if traced(x) else x, tree)


def forward_only(tree: Any, refused: Callable) -> Any:
    """Return the numbers; reverse mode calls `refused()`."""
    return jax.tree.map(lambda x: _forward.bind(x, refused=refused) if traced(x) else x, tree)


def eigenvalues(M: AnyArray) -> AnyArray:
    """Return the eigenvalues of a square matrix, complex, in the order of LAPACK."""
    return with_rule(jnp.linalg.eigvals, partial(_values_and_change, jnp.linalg.eig), M)


def eigvalsh(M: AnyArray) -> AnyArray:
    """Return the eigenvalues of a Hermitian matrix, rising."""
    rule = partial(_values_and_change, jnp.linalg.eigh)
    return with_rule(jnp.linalg.eigvalsh, rule, (M + M.conj().T) / 2)


def eigh(M: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return `jnp.linalg.eigh(M)` with derivatives beside equal eigenvalues.

    Those of vectors of equal ones have a meaning in sums alone.
    """
    found = _eigen(jnp.linalg.eigh, (M + M.conj().T) / 2)
    return found[0].real, found[1:]


def _values_and_change(find, arrays, changes):
    # Vectors are found where derivatives need them.
    values, moved = (x[0] for x in _eigen_and_change(find, arrays, changes))
    return (values.real, moved.real) if find is jnp.linalg.eigh else (values, moved)


def _eigen(find, M):
    # Return eigenvalues, and below them the vectors. In JAX those of `eig` have no second
    # derivatives, and those of `eigh` no finite ones where any eigenvalues are equal. Here vectors
    # of equal eigenvalues do not turn into each other.
    return with_rule(lambda M: jnp.vstack(find(M)), partial(_eigen_and_change, find), M)


def _eigen_and_change(find, arrays, changes):
    found, moved, same = _coupled(find, arrays, changes)
    values, vectors = found[0], found[1:]
    turned = jnp.where(same, 0, moved / jnp.where(same, 1, values - values[:, None]))
    slopes = jnp.diag(moved) + jnp.sum(_times.bind(moved, _mixed(find, *arrays)), 1)
    return found, jnp.vstack([slopes, vectors @ turned])


def _coupled(find, arrays, changes):
    # Return eigenvalues and vectors, the change between vectors, and which eigenvalues are equal.
    found = _eigen(find, *arrays)
    values, vectors = found[0], found[1:]
    moved = changes[0] @ vectors
    apart = values - values[:, None]
    if find is jnp.linalg.eigh:
        least = EQUAL * jnp.finfo(values.dtype).eps * jnp.abs(values).max()
        return found, vectors.conj().T @ moved, jnp.abs(apart) <= least
    return found, jnp.linalg.solve(vectors, moved), apart == 0


def _mixed(find, M):
    # Zeros whose change is NaN between equal eigenvalues that the change of the matrix splits at
    # first order: these have first derivatives as a sum alone, and no second ones. What a change
    # splits at second order is not seen here; there the sum alone is right.
    return with_rule(jnp.zeros_like, partial(_mixed_and_change, find), M)


def _mixed_and_change(find, arrays, changes):
    _, moved, same = _coupled(find, arrays, changes)
    unknown = jnp.where(same & ~jnp.eye(len(same), dtype=bool), jnp.nan, 0)
    return _mixed(find, *arrays), _times.bind(moved, unknown.astype(moved.dtype))


def _product(x, y):
    # x y, where NaN in y marks what is not known: it has no part where x is zero within rounding.
    # Changes of second order in the root of rounding are rounding.
    size = jnp.abs(x)
    least = jnp.sqrt(jnp.finfo(x.dtype).eps) * jnp.max(size, (-2, -1), keepdims=True)
    return jnp.where(size <= least, 0, x * y)


def _product_over_lanes(xs, axes):
    (count,) = {x.shape[i] for x, i in zip(xs, axes) if i is not None}
    xs = (
        jnp.broadcast_to(x, (count, *x.shape)) if i is None else jnp.moveaxis(x, i, 0)
        for x, i in zip(xs, axes)
    )
    return _times.bind(*xs), 0


def _evaluate(*arrays, jaxpr, rule):
    return jaxpr_as_fun(jaxpr)(*arrays)[0]


def _derivative(arrays, changes, *, jaxpr, rule):
    known = tuple(None if type(change) is ad.Zero else change for change in changes)
    return rule(tuple(arrays), known)


def _over_lanes(arrays, axes, *, jaxpr, rule):
    def rule_over_lanes(arrays, changes):
        moved = tuple(None if change is None else axis for change, axis in zip(changes, axes))
        return jax.vmap(rule, (tuple(axes), moved))(arrays, changes)

    over_lanes = jax.vmap(partial(_evaluate, jaxpr=jaxpr, rule=rule), axes)
    return with_rule(over_lanes, rule_over_lanes, *arrays), 0


_ruled.def_impl(_evaluate)
_ruled.def_abstract_eval(lambda *_, jaxpr, rule: jaxpr.out_avals[0])
mlir.register_lowering(_ruled, mlir.lower_fun(_evaluate, multiple_results=False))
ad.primitive_jvps[_ruled] = _derivative
batching.primitive_batchers[_ruled] = _over_lanes

_times.def_impl(_product)
_times.def_abstract_eval(lambda x, y: x)
mlir.register_lowering(_times, mlir.lower_fun(_product, multiple_results=False))
ad.defbilinear(_times, lambda ct, x, y: _times.bind(ct, y), lambda ct, x, y: _times.bind(x, ct))
batching.primitive_batchers[_times] = _product_over_lanes

_forward.def_impl(lambda x, refused: x)
_forward.def_abstract_eval(lambda x, refused: x)
mlir.register_lowering(_forward, lambda _, x, refused: [x])
ad.deflinear2(_forward, lambda ct, x, refused: refused())
batching.defvectorized(_forward)
