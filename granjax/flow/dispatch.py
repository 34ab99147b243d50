"""What every call of `simulate` asks of a lattice: facts that are found once."""

from typing import NamedTuple

from ..checks import traced
from ..lattice import Lattice
from ..programs import Kept
from ..terms.tracing import reads


class Facts(NamedTuple):
    """What every call asks of a lattice, and what only its terms and shapes decide.

    `traced`: whether a parameter is; `reads_velocity`: whether some force does; `splits`: whether none does but linear
    damping; `known`: a dict for what is worked out when it is first asked
    for. `remembers`: whether some force reads the past.
    """

    template: object
    dtype: object
    traced: bool
    reads_velocity: bool
    splits: bool
    known: dict
    remembers: bool


_FACTS = Kept()


def facts(lattice: Lattice) -> Facts:
    """The `Facts` of a lattice, kept while it lives: its parameters never change."""
    found = _FACTS.get(lattice)
    return _FACTS.put(lattice, _found(lattice)) if found is None else found


def _found(lattice):
    velocity = [term for term in lattice.terms if reads(term, lattice).velocity]
    return Facts(
        lattice.template(),
        lattice.dtype,
        traced(lattice),
        bool(velocity),
        all(term.exact_damping() is not None for term in velocity),
        {},
        any(term.remembers() for term in lattice.terms),
    )
