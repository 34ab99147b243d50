"""A quadrupole lattice holds a state in each corner

The lattice consists of squares of four sites, each with one negative spring; the springs between the squares are
stiffer than those within them. The bulk and the edges have gaps. Four states remain in the middle of the gap, one in
each corner. The nested Zak phases (1/2, 1/2) predict them.

:systems: corner states
:part: Topology and flat bands
:number: square of the frequency of a corner state, springs 0.5 and 2, ground 0.5 (k/m)
:expected: 5.5
:within: 0.001
:source: 2 (k1 + k2) + ground, of a corner alone (6 cells: to k2 (k1/k2)^6); Benalcazar et al., Science 357, 61 (2017)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

lattice = gx.scenes.quadrupole(6, k1=0.5, k2=2.0, ground=0.5)
modes = gx.linear.normal_modes(lattice)
squared = np.asarray(modes.omega_squared)
corner = np.flatnonzero(np.abs(squared - 5.5) < 0.2)
number = float(squared[corner[0]])
share = {name: (np.asarray(x)[..., corner] ** 2).sum(-1) for name, x in modes.modes.items()}
ring = gx.scenes.quadrupole(6, k1=0.5, k2=2.0, boundary="periodic")
figure, (left, ax) = plt.subplots(1, 2, figsize=(5.4, 2.7), layout="constrained")
left.plot(squared, ".", ms=3, color="0.5")
left.plot(corner, squared[corner], "o", ms=4, color="C3")
left.set(
    xlabel="mode", ylabel=r"$\omega^2$ (scaled)", title=f"Zak phases {gx.topology.quadrupole(ring)}"
)
gx.plots.beads(lattice, share, ax, label="four states", radius=0.3)
