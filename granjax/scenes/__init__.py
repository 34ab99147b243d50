"""Ready-made scenes: functions that return a `Lattice`.

For a batch use `jax.vmap(lambda ratio: scenes.dimer(60, ratio), out_axes=-1)(ratios)`; its lanes
are trailing.
"""

from .bead_chain import beads, struck
from .chains import (
    chain,
    defects,
    dimer,
    fput,
    modulated,
    monomer,
    n_to_one,
    pattern,
    plastic,
    taper,
    toda,
    trimer,
)
from .disorder import disordered
from .fractional import fractional, fractional_fput, fractional_sine_gordon
from .long_range import long_range, magnets
from .on_site import cradle, klein_gordon, sine_gordon
from .plane.build import crystal
from .plane.cells import CrystalCell, Tie
from .plane.chains import aubry_andre, diamond, rotating_chain, sawtooth, ssh, stub
from .plane.lattices import (
    cubic,
    fcc,
    hcp,
    hexagon,
    honeycomb,
    kagome,
    lieb,
    quadrupole,
    square,
    triangular,
)
from .plane.networks import junction, network
from .plane.packing import packing
from .resonators import mass_in_mass, mass_with_mass, woodpile
from .softening import alternating, foam, hollow_cylinders, origami, tensegrity
from .units import ScaledLattice, Units, scaled
