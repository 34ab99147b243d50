"""Lattices of the plane by name, and chains whose cells have several sites."""

from .build import crystal
from .cells import Cell, Tie
from .chains import aubry_andre, diamond, sawtooth, ssh, stub
from .lattices import hexagon, honeycomb, kagome, lieb, quadrupole, square, triangular
from .networks import junction, network
from .packing import packing
from .rotating import rotating_chain
