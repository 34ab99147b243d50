"""Lattices of the plane by name, and chains whose cells have several sites."""

from .chains import diamond, sawtooth, ssh, stub
from .lattices import hexagon, honeycomb, kagome, lieb, square, triangular

__all__ = ["diamond", "hexagon", "honeycomb", "kagome", "lieb", "sawtooth", "square", "ssh", "stub", "triangular"]
