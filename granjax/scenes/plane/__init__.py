"""Lattices of the plane by name, and chains whose cells have several sites."""

from .chains import aubry_andre, diamond, sawtooth, ssh, stub
from .lattices import hexagon, honeycomb, kagome, lieb, quadrupole, square, triangular
from .networks import junction, network
from .packing import packing
from .rotating import rotating_chain

__all__ = [
    "aubry_andre",
    "diamond",
    "hexagon",
    "honeycomb",
    "junction",
    "kagome",
    "lieb",
    "network",
    "packing",
    "quadrupole",
    "rotating_chain",
    "sawtooth",
    "square",
    "ssh",
    "stub",
    "triangular",
]
