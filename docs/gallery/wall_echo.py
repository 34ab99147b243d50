"""The modulus of a wall from one echo

A wave travels down a chain of steel beads that leans on a wall, for example bone or a polymer. The softer the wall, the
later and flatter is the reflected wave. The wall's Young's modulus is fitted to one trace of one bead with 2 % of
noise; the model is a chain with a wall. Some starts of the fit end where the echo meets another pulse of the trace; the
best start counts.

:systems: quality of a wall by one echo
:part: Devices
:number: Young's modulus of the wall, GPa, from a start three times too high
:expected: 3.3
:within: 1 %
:source: what the trace was made with; Yang, Sangiorgio et al., J. Biomech. Eng. 134, 101001 (2012)
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

radius = 9.525e-3
chain = gx.scenes.beads("steel 316", radius, cells=12, boundary="free")


def leaning(p):  # Poisson's ratio of the wall is known, its modulus is not
    wall = gx.materials.Material("wall", p["modulus"], 0.35, 1200.0)
    contact = gx.Hertz(gx.materials.hertz_coefficient("steel 316", radius, wall, jnp.inf))
    return gx.Lattice(chain.mass, (*chain.terms, gx.Wall(contact, "right")), sites=12, units="SI")


struck = gx.states.impact(chain, velocity=0.4)
run = gx.simulate(leaning({"modulus": 3.3e9}), struck, 1e-3, tolerance=1e-8, save_at=401)
seen = np.asarray(run.vs)[:, 7]
seen = seen + 0.02 * seen.max() * np.random.default_rng(0).normal(size=seen.size)
found = gx.fit(
    leaning,
    {"modulus": 10e9},
    gx.Traces(run.ts, velocity=seen, sites=7),
    state=struck,
    bounds={"modulus": (0, None)},
    starts=5,
    spread=1.0,
)
number = float(found.parameters["modulus"]) / 1e9
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.plot(1e3 * run.ts, seen, ".", ms=3, color="0.6")
ax.plot(1e3 * run.ts, found.signals[0], "C3")
ax.set(xlabel="time (ms)", ylabel="velocity of bead 8 (m/s)", title=f"E = {number:.2f} GPa")
