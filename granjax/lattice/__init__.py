"""The lattice, its equation of motion and its split form."""

from .blocks import in_blocks
from .linearised import linearised
from .model import Lattice, State, spread_mass
from .split import split_system, vector_field
from .tangents import variational
from .uniform import uniform_moves

__all__ = [
    "Lattice",
    "State",
    "in_blocks",
    "linearised",
    "split_system",
    "spread_mass",
    "uniform_moves",
    "variational",
    "vector_field",
]
