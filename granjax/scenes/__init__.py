"""Ready scenes: functions that return a `Lattice`.

A batch of scenes is `jax.vmap(lambda ratio: scenes.dimer(60, ratio), out_axes=-1)(ratios)`: its lanes are trailing.
"""

from .bead_chain import beads
from .chains import defects, dimer, disordered, fput, monomer, n_to_one, pattern, taper, toda, trimer
from .units import ScaledLattice, Units, scaled

__all__ = [
    "ScaledLattice", "Units", "beads", "defects", "dimer", "disordered", "fput", "monomer", "n_to_one", "pattern",
    "scaled", "taper", "toda", "trimer",
]
