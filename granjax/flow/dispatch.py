"""What every call of `simulate` asks of a lattice: facts that are found once."""

import math
from typing import NamedTuple

import jax

from ..checks import traced
from ..lattice import Lattice
from ..programs import once
from ..terms.base import memory_of
from ..terms.tracing import reads


class Facts(NamedTuple):
    """What every call asks of a lattice, and what only its terms and shapes decide.

    `template`: arrays of the shape of its displacements, of type `dtype`; `space`: the axes of its sites and the
    components of a vector; `numbers`: how many displacements there are; `lanes`: of a batch. `traced`: whether a
    parameter is. `reads_velocity`: whether some force does; `splits`: whether none does but linear damping;
    `remembers`: whether some force reads the past; `has_breaks`: whether some force jumps in time. `known`: a dict for
    what others work out when they first ask for it.
    """

    template: object
    dtype: object
    space: tuple[int, int]
    numbers: int
    lanes: tuple[int, ...]
    traced: bool
    reads_velocity: bool
    splits: bool
    remembers: bool
    has_breaks: bool
    known: dict


@once
def facts(lattice: Lattice) -> Facts:
    """The `Facts` of a lattice, kept while it lives: its parameters never change."""
    velocity = [term for term in lattice.terms if reads(term, lattice).velocity]
    template = lattice.template()
    return Facts(
        template=template,
        dtype=lattice.dtype,
        space=lattice.space,
        numbers=sum(math.prod(x.shape) for x in jax.tree.leaves(template)),
        lanes=lattice.lanes,
        traced=traced(lattice),
        reads_velocity=bool(velocity),
        splits=all(term.exact_damping() is not None for term in velocity),
        remembers=any(memory_of(term) for term in lattice.terms),
        has_breaks=bool(lattice.breaks),
        known={},
    )
