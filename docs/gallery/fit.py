"""A fit of measured traces: stiffness and load of a chain

A simulation is fitted, with its derivatives, to two noisy velocities of a chain that was struck. Weak waves determine
only a combination of stiffness and load. A blow that is strong enough to be nonlinear determines both.

:systems: fits of measured traces
:part: Data
:number: stiffness of the contacts, with 2 % of noise (scaled)
:expected: 1.3
:within: 1 %
:source: what the data were made with, by another integrator; three standard deviations
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx


def scene(p):
    return gx.scenes.monomer(12, stiffness=p["stiffness"], precompression=p["load"])


chain = scene({"stiffness": 1.3, "load": 0.4})
struck = gx.states.impact(chain, velocity=0.8)
run = gx.simulate(chain, struck, 25.0, tolerance=1e-9, save_at=201)
data = np.asarray(run.vs)[:, [3, 8]]
sigma = 0.02 * np.abs(data).max()
data = data + sigma * np.random.default_rng(1).normal(size=data.shape)
traces = gx.Traces(run.ts, velocity=data, sites=[3, 8], sigma=sigma)
found = gx.fit(
    scene,
    {"stiffness": 1.0, "load": 0.6},
    traces,
    state=struck,
    bounds={"stiffness": (0, None), "load": (0, None)},
)
number = float(found.parameters["stiffness"])
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.plot(run.ts, data, ".", ms=4)
ax.plot(run.ts, found.signals[0], "k-", lw=1)
error = float(found.deviations["stiffness"])
ax.set(
    xlabel="time (scaled)",
    ylabel="velocity (scaled)",
    title=f"stiffness {number:.3f} $\\pm$ {error:.3f}",
)
