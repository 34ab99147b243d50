"""Foam and tensegrity: sound slows down as the load grows

Open-cell foam and tensegrity prisms can soften under compression, F = A d^p with p < 1. The larger the load on such a
chain, the slower its sound, c = (p/m)^(1/2) A^(1/2p) F0^((1 - 1/p)/2). In a chain of beads the opposite holds.

:systems: foam, tensegrity
:part: Beyond the granular chain
:number: exponent of the time of arrival over the load, p = 1/2
:expected: 0.5
:within: 1e-3
:source: (1/p - 1)/2; Herbold, Nesterenko, PRL 110, 144101 (2013); Fraternali et al., APL 105, 201903 (2014)
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx


def front(t, y, lattice):
    return y.v[-1]


loads = np.geomspace(0.1, 1.0, 6)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for make, p, name in ((gx.scenes.tensegrity, 0.7, "tensegrity"), (gx.scenes.foam, 0.5, "foam")):
    chains = jax.vmap(lambda F0: make(24, p, precompression=F0, boundary="free"), out_axes=-1)(
        loads
    )
    record = {"arrival": gx.Arrival(front, threshold=1e-7)}
    run = gx.simulate(
        chains, gx.states.impact(chains, velocity=1e-6), 45.0, step=0.2, record=record
    )
    times = np.asarray(run.recorded["arrival"])
    number = float(np.polyfit(np.log(loads), np.log(times), 1)[0])
    ax.plot(loads, 23 / times, "o", label=f"{name}, p = {p}")
    fine = np.linspace(0.1, 1.0, 100)
    ax.plot(fine, 23 / times[-1] * fine ** ((1 - 1 / p) / 2), "k-", lw=1, zorder=0)
ax.set(xlabel="load $F_0$ (scaled)", ylabel="speed of a weak pulse (sites/time)")
ax.legend()
