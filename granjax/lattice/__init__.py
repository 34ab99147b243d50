"""The lattice, its equation of motion, and its split form."""

from .model import Lattice, State
from .split import acceleration_only, split_system, vector_field

__all__ = ["Lattice", "State", "acceleration_only", "split_system", "vector_field"]
