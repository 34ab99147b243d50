"""A pulse at a Y-junction divides

The last bead of a chain touches the first beads of two branches. The pulse continues into both branches and a part is
reflected. If the branches leave at an angle, each pulse has less than half of the force. Two branches straight ahead
are equivalent to one chain of twice the mass and twice the stiffness.

:systems: networks of chains
:part: The plane
:number: largest difference of displacements from those of the chain 2m, 2A, over the largest
:expected: 0
:within: 1e-11
:source: two equal branches at angle zero move as one; Daraio et al., Phys. Rev. E 82, 036603 (2010)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

straight = gx.scenes.junction(10, (12, 12))
mass = np.repeat([1.0, 2.0], [10, 12])
A = np.repeat([1.0, 2.0], [10, 13])
chain = gx.scenes.monomer(22, mass=mass, stiffness=A)
both, one = (
    np.asarray(gx.simulate(x, gx.states.impact(x, 0.3), 25.0, step=0.05).final.u)
    for x in (straight, chain)
)
number = float(np.abs(both[:22] - one).max() / one.max())
fork = gx.scenes.junction(10, (12, 12), angles=(0.6, -0.6))
run = gx.simulate(fork, gx.states.impact(fork, 0.3), 25.0)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.beads(
    fork, run.final.v, ax, label="velocity", network=gx.measures.force_network(fork, run.final)
)
