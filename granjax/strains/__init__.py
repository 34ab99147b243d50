"""Strain maps: from displacements to the compression of every bond, and back by the transpose.

Compression is positive: the bond between a tail and a head site has e = u_tail - u_head. A map is a sum of sites of a
field, each at an offset and with a weight; `Shift` is the normal form, `Stencil` the general one, `Pairs` a list of
bonds on any graph, `Stretch` a distance in the plane or in space, `Along` the part of a vector along a direction,
`Slip` how far two beads that turn have slipped. A user-defined map needs `strain` alone.
"""

from .maps import BOTH, BOUNDARIES, End, LinearMap, Sites, StrainMap
from .pairs import WALL, Pairs
from .stencil import Shift, Stencil
from .stretch import Along, Slip, Stretch

__all__ = [
    "Along",
    "BOTH",
    "BOUNDARIES",
    "End",
    "LinearMap",
    "Pairs",
    "Shift",
    "Sites",
    "Slip",
    "Stencil",
    "StrainMap",
    "Stretch",
    "WALL",
]
