"""Aubry and Andre: a quasi-periodic chain localises all at once

The stiffness of the springs to the ground varies as a cosine whose period is incommensurate with the lattice. Below V =
2K every mode extends over the whole chain. Above it every mode is localised, all with the same length 1/log(V/2K),
without any disorder.

:systems: quasi-periodic chain (Aubry-Andre)
:part: Topology and flat bands
:number: inverse localisation length at V = 3K, by transfer matrices of 10946 sites (1/site)
:expected: 0.4054651
:within: 0.2 %
:source: log(V/2K); Aubry, Andre, Ann. Israel Phys. Soc. 3, 133 (1980)
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

V = np.linspace(0.5, 4.0, 71)
modes = jax.vmap(lambda v: gx.linear.normal_modes(gx.scenes.aubry_andre(89, v, ground=4.0)))(V)
sites = gx.measures.participation(modes.modes**2, axis=1)
middle = float(gx.linear.normal_modes(gx.scenes.aubry_andre(89, 3.0, ground=3.0)).omega[30])
number = float(
    gx.linear.localisation_length(gx.scenes.aubry_andre(10946, 3.0, ground=3.0), [middle]).gamma[0]
)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
x = np.broadcast_to(V[:, None], sites.shape)
dots = ax.scatter(x, modes.omega, c=np.log10(sites), s=3, cmap="viridis")
plt.colorbar(dots, label="log$_{10}$ of sites that share a mode")
ax.axvline(2.0, color="C3", ls="--")
ax.set(xlabel="modulation V (K)", ylabel=r"$\omega$ (scaled)")
