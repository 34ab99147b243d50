"""Strain maps: from displacements to the compression of every bond, and back by the transpose.

Compression is positive: the bond between a tail and a head site has e = u_tail - u_head. `Shift`
joins each site to one at a fixed offset, `Stencil` is a weighted sum of sites, `Pairs` a list of
bonds on any graph, `Stretch` a distance in the plane or in space, `Along` the component of a vector
along a direction, `Slip` the slip of two rotating beads. A user-defined map needs only `strain`.
"""

from .maps import BOTH, BOUNDARIES, End, LinearMap, Sites, StrainMap
from .pairs import WALL, Pairs
from .stencil import Shift, Stencil
from .stretch import Along, Slip, Stretch
