"""A shaken chain: the resonance leans over and folds

Five precompressed, damped beads lie between two walls, one of which is driven near the highest mode. Hertz contacts
soften, so the resonance bends towards lower frequencies. Between its two folds there are three periodic motions, and
the middle one is unstable (crosses). On a short piece of the upper branch the period has doubled.

:systems: driven and damped chain
:part: Breathers
:number: angular frequency of the lower fold
:expected: 2.26441879
:within: 2e-7
:source: shooting with SciPy's DOP853 and the condition det(M - 1) = 0
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt

import granjax as gx

chain = gx.scenes.monomer(5, precompression=1.0)


def shaken(omega):
    return gx.driven.driven_chain(chain, 0.15, omega, ends="left", damping=0.03)


branch = gx.forced.forced_branch(
    shaken, 2.45, 2.2, period=lambda omega: 2 * jnp.pi / omega, steps=64
)
number = float(min(branch.folds))
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for verdict, dash in (("stable", "o"), ("unstable", "x")):
    own = branch.verdict == verdict
    ax.plot(branch.p[own], branch.response[own], dash, ms=4, label=verdict)
ax.set(xlabel=r"angular frequency of the wall (scaled)", ylabel="rms velocity (scaled)")
ax.legend()
