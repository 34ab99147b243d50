"""Measures: quantities of a state, `measure(lattice, y, t=0.0)`, and of recorded histories.

What a measure is given decides its units: SI in, SI out. Space first, lanes last: lanes pass through everything.
"""

from .contacts import contact_force, overlap, strain
from .energies import energy, kinetic_energy, momentum, potential_energy, site_energy, species_energy
