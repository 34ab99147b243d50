"""Disordered chains: energy spreads between diffusion and flight

A kick spreads freely in an ordered chain, its second moment growing as t^2. Disorder stops all but the long waves,
which carry a share that falls with time: the moment grows as t^(3/2). The inset shows the exponent as it settles.

:systems: superdiffusive transport
:part: Disorder and losses
:number: exponent of the second moment of energy, 50 < t < 200, 192 chains
:expected: 1.5
:within: 0.06
:source: Datta, Kundu, Phys. Rev. B 51, 6287 (1995), for long times, which is approached from above
"""
import jax.numpy as jnp
import matplotlib.pyplot as plt

import granjax as gx


def ordered_below_1000(seed):
    return gx.scenes.disordered(600, jnp.where(seed < 1000, 0.0, 0.8), seed, law=gx.Linear, distribution="binary")


ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for seed, samples, name in ((0, 2, "ordered"), (1000, 192, "disordered")):
    found = gx.studies.spreading(ordered_below_1000, 200.0, samples=samples, seed=seed, step=0.5, chunk=samples // 2,
                                 window=(50.0, 200.0), progress=False)
    gx.plots.spreading(found, ax, label=f"{name}: $t^{{{float(found.exponent.value):.2f}}}$")
number = float(found.exponent.value)
