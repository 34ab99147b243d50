"""What a call of `simulate` costs beside the run: compiled functions that are found quickly, and facts found once."""

import inspect
import weakref
from collections.abc import Callable
from functools import partial, wraps
from typing import NamedTuple

import jax
import numpy as np

from ..checks import traced
from ..lattice import Lattice
from ..terms.tracing import reads
from ..types import Pytree

_ARRAYS = (jax.Array, np.ndarray, np.generic)


def compiled(function: Callable) -> Callable:
    """`jax.jit` of a function of pytrees, in which everything but arrays is static.

    As `equinox.filter_jit`, for arguments that may be given by position, with less to do at each call.
    """

    @partial(jax.jit, static_argnums=0)
    def flat(static, arrays):
        return function(*joined(static, arrays))

    signature = inspect.signature(function)

    @wraps(function)
    def call(*arguments, **named):
        if named:
            arguments = signature.bind(*arguments, **named)
            arguments.apply_defaults()
            arguments = arguments.args
        return flat(*parted(arguments))

    call.lower = lambda *arguments: flat.lower(*parted(arguments))
    return call


def parted(tree: Pytree) -> tuple:
    """What is static in a pytree, hashable, and a list of its arrays."""
    leaves, treedef = jax.tree.flatten(tree)
    is_array = [isinstance(leaf, _ARRAYS) for leaf in leaves]
    rest = tuple([_ARRAYS if own else leaf for own, leaf in zip(is_array, leaves)])
    return (treedef, rest), [leaf for own, leaf in zip(is_array, leaves) if own]


def joined(static: tuple, arrays: list) -> Pytree:
    """The pytree that `parted` took apart."""
    treedef, rest = static
    arrays = iter(arrays)
    return jax.tree.unflatten(treedef, [next(arrays) if leaf is _ARRAYS else leaf for leaf in rest])


def shared_size(n: int) -> int:
    """A size rounded up to one of 8, 9, ..., 15, 16, 18, ..., 30, 32, ...: arrays of near-by sizes are one program."""
    unit = 1 << max(n.bit_length() - 4, 0)
    return -(-n // unit) * unit


class Facts(NamedTuple):
    """What every call asks of a lattice, and what only its terms and shapes decide.

    `traced`: whether a parameter is; `reads_velocity`: whether some force does; `splits`: whether none does but linear
    damping; `outside`: what functions of the user's read; `known`: a dict for what is worked out when it is first asked
    for.
    """

    template: object
    dtype: object
    traced: bool
    reads_velocity: bool
    splits: bool
    outside: tuple
    known: dict


_FACTS = {}


def facts(lattice: Lattice) -> Facts:
    """The `Facts` of a lattice, kept while it lives and its functions read the same: its parameters never change."""
    key = id(lattice)
    owner, found, readers = _FACTS.get(key, _NOBODY)
    # a lattice without functions of the user's, which is most, is known by itself
    if owner() is lattice and (not readers or found.outside == lattice._outside.values()):
        return found
    found = _found(lattice)
    _FACTS[key] = weakref.ref(lattice, lambda _: _FACTS.pop(key, None)), found, lattice._outside.readers
    return found


_NOBODY = (lambda: None), None, ()


facts.cache_clear = _FACTS.clear


def _found(lattice):
    velocity = [term for term in lattice.terms if reads(term, lattice).velocity]
    return Facts(
        lattice.template(), lattice.dtype, traced(lattice), bool(velocity),
        all(term.exact_damping() is not None for term in velocity), lattice._outside.values(), {},
    )
