"""Lattices of the plane by name, and chains whose cells have several sites."""

from .chains import aubry_andre, diamond, sawtooth, ssh, stub
from .lattices import hexagon, honeycomb, kagome, lieb, quadrupole, square, triangular
from .networks import junction
from .packing import packing

__all__ = [
    "aubry_andre", "diamond", "hexagon", "honeycomb", "junction", "kagome", "lieb", "packing", "quadrupole",
    "sawtooth", "square", "ssh", "stub", "triangular",
]
