"""Kagome and Lieb lattices: a flat band in the plane

Both lattices have a band at one frequency for every wave vector. It consists of states that never leave their sites. In
the kagome lattice such a state occupies the six sites of a hexagon, with alternating signs.

:systems: kagome and Lieb lattices
:part: Topology and flat bands
:number: square of the frequency of the kagome lattice's flat band (k/m)
:expected: 6
:within: 1e-12
:source: Omega^2 - K E with E = -2, Omega^2 = 4K; Leykam, Andreanov, Flach, Adv. Phys. X 3, 1473052 (2018)
"""

import matplotlib.pyplot as plt

import granjax as gx

kagome = gx.scenes.kagome(4, out_of_plane=True, boundary="periodic")
lieb = gx.scenes.lieb(6, boundary="periodic")
flat = gx.linear.flat_bands(kagome)
number = float(flat.omega_squared[0])
figure, axes = plt.subplot_mosaic(
    "AC;BC", figsize=(5.4, 3.2), width_ratios=(1, 1.2), layout="constrained"
)
gx.plots.bands(gx.linear.path(kagome, "GKMG"), axes["A"]).set_title("kagome")
gx.plots.bands(gx.linear.path(lieb, "GXMG"), axes["B"]).set_title("Lieb")
gx.plots.beads(kagome, flat.state(kagome).u, axes["C"], label="displacement", colour_bar=False)
for name in "AB":
    axes[name].set_ylabel(r"$\omega$")
axes["C"].set_title(f"stays on {flat.support[0]} sites")
ax = figure
