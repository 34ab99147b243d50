"""Resonance: transmission of a pulse by 1:1 dimer chains without precompression.

The chain alternates heavy beads of mass 1 and light ones of mass epsilon, the heavy one first, with
Hertz contacts A = 1, F0 = 0. Bead 0 is struck with v = 1. At anti-resonances a pulse travels
without loss, as in the monomer chain; at resonances between them it decays fast. `oscillations`
counts the swings of a light bead; `resonance_map` treats larger cells over two parameters. Mass,
stiffness and impact velocity only set the units: forces scale as A^(2/5) (m v^2)^(3/5). All runs
use every core.
"""

from .decay import anti_resonance, contact_forces, decay_rate
from .finite import Extrema, Transmission, refine, transmission
from .maps import ResonanceMap, resonance_map
from .oscillations import Oscillations, oscillations, squeeze_count

# mass ratios of the asymptotic anti-resonances:
# Jayaprakash, Starosvetsky, Vakakis, Phys. Rev. E 83, 036606 (2011)
ANTI_RESONANCES = (1.0, 0.3428, 0.1548, 0.0901)
# mass ratio of the first resonance, from the same article
FIRST_RESONANCE = 0.59

__all__ = [
    "ANTI_RESONANCES",
    "FIRST_RESONANCE",
    "Extrema",
    "Oscillations",
    "ResonanceMap",
    "Transmission",
    "anti_resonance",
    "contact_forces",
    "decay_rate",
    "oscillations",
    "refine",
    "resonance_map",
    "squeeze_count",
    "transmission",
]
