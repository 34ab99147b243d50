"""Conical diffraction: a ring from a Dirac point

At the corner K of a honeycomb's Brillouin zone two bands meet in a cone. A wave packet at this point spreads as a ring
of constant width, because all its waves have the same speed in every direction.

:systems: conical diffraction
:part: The plane
:number: speed of the ring, by the second difference of r^2 over time (bond lengths per time, scaled)
:expected: 0.4330127
:within: 3 %
:source: slope of the cone, omega^2 = 3 + 1.5 |q|: 1.5/(2 3^(1/2)); Ablowitz, Nixon, Zhu, Phys. Rev. A 79, 053830 (2009)
"""

import numpy as np

import granjax as gx

lattice = gx.scenes.honeycomb(54, out_of_plane=True, boundary="periodic")
packet = gx.states.bloch_packet(lattice, "K", 4.0, polarisation={"a": 1.0, "b": 0.0})
run = gx.simulate(lattice, packet, 54.0, save_at=[30.0, 42.0, 54.0])
squared = np.asarray(gx.measures.along(gx.measures.energy_radius, lattice, run)) ** 2
number = float((squared[0] - 2 * squared[1] + squared[2]) / 2) ** 0.5 / 12.0
ax = gx.plots.beads(lattice, gx.measures.site_energy(lattice, run.final), label="energy")
ax.figure.set_size_inches(5.4, 3.4)
