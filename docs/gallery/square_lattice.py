"""A planar front in a square packing is the solitary wave of a chain

One side of a square packing of beads that just touch is struck. The rows do not push each other sideways, so the front
is the solitary wave of a single chain and keeps its height.

:systems: square lattice
:part: The plane
:number: peak velocity of bead 20 of a row over that of the strike
:expected: 0.68163155
:within: 1.5e-6
:source: leading solitary wave of a Hertz chain whose first bead is struck, by two methods
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

packing = gx.scenes.square(30, 6, exponent=1.5, boundary=("fixed", "periodic"))
struck = gx.State(packing.zeros(), packing.zeros().at[0, :, 0].set(1e-2))
chain = gx.scenes.monomer(30)
run = gx.simulate(
    packing, struck, 66.0, record={"peak": gx.Peak(lambda t, y, lattice: y.v[..., 0])}
)
line = gx.simulate(chain, gx.states.impact(chain, 1e-2), 66.0)
vx = np.asarray(run.final.v)[..., 0]
number = float(run.recorded["peak"][20, 0]) / 1e-2
figure, (ax, below) = plt.subplots(
    2, 1, figsize=(5.4, 3.2), height_ratios=(3, 2), layout="constrained", sharex=True
)
network = gx.measures.force_network(packing, run.final)
gx.plots.beads(packing, vx, ax, label="velocity", colour_bar=False, network=network)
ax.set(xlabel="", ylabel="")
below.plot(vx[:, 0], "o", ms=4, label="row of the packing")
below.plot(line.final.v, "k-", lw=1, label="chain")
below.set(xlabel="x (bead diameters)", ylabel="velocity (scaled)")
below.legend()
