"""What every call of `simulate` asks of a lattice: facts that are found once."""

import weakref
from typing import NamedTuple

from ..checks import traced
from ..lattice import Lattice
from ..terms.tracing import reads


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
