"""Resonance: how much of a pulse a 1:1 dimer chain without precompression lets through, over the mass ratio.

Heavy beads of mass 1 and light ones of mass epsilon in turn, the heavy one first, Hertz contacts with A = 1 and
F0 = 0, bead 0 struck with v = 1. At some ratios (anti-resonances) a pulse travels without loss, as in the monomer
chain; between them (resonances) it decays fast. `oscillations` counts how often a light bead swings meanwhile,
`resonance_map` looks at larger cells over two parameters. Mass, stiffness and striker's velocity only set the units:
forces scale as A^(2/5) (m v^2)^(3/5).

Transmissions and contact forces are one sweep with other numbers, on every core.
"""

from .decay import anti_resonance, contact_forces, decay_rate
from .finite import Extrema, Transmission, refine, transmission
from .maps import ResonanceMap, resonance_map
from .oscillations import Oscillations, oscillations, squeeze_count

# asymptotic anti-resonances and the first resonance: Jayaprakash, Starosvetsky, Vakakis, Phys. Rev. E 83, 036606 (2011)
ANTI_RESONANCES = (1.0, 0.3428, 0.1548, 0.0901)
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
