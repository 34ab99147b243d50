"""An acoustic lens: loads that make pulses meet

Eleven chains are struck at once and end at a medium. The travel time of a pulse scales as F0^(-1/6), so the loads of
the chains can compensate for the different distances from their ends to a focus. The pulses meet at the focus, and the
pressure there rises.

:systems: acoustic lens
:part: Devices
:number: exponent of the time of arrival over the load
:expected: -0.1666667
:within: 1e-3
:source: c ~ F0^(1/6); Spadoni, Daraio, PNAS 107, 7230 (2010)
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx


def end(t, y, lattice):
    return y.v[-1]


distance = np.hypot(9.0 * np.arange(-5, 6), 40.0)
late = (distance - 40.0) / 3.0
loads = np.concatenate([np.full(11, 0.5), 0.5 * (1 - late / 24) ** -6])
chains = jax.vmap(
    lambda F0: gx.scenes.monomer(25, precompression=F0, boundary="free"), out_axes=-1
)(loads)
run = gx.simulate(
    chains,
    gx.states.impact(chains, velocity=1e-5),
    50.0,
    step=0.1,
    save_at=501,
    record={"arrival": gx.Arrival(end, threshold=1e-6)},
)
number = float(np.polyfit(np.log(loads), np.log(run.recorded["arrival"]), 1)[0])
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for pulses, name in ((run.vs[:, -1, :11], "equal loads"), (run.vs[:, -1, 11:], "lens")):
    parts = [
        np.interp(run.ts - t, run.ts, v, left=0) * 40 / r
        for t, v, r in zip(late, pulses.T, distance)
    ]
    ax.plot(run.ts, 1e5 * np.sum(parts, axis=0), label=name)
ax.set(xlabel="time (scaled)", ylabel="pressure at the focus (scaled)", xlim=(10, 50))
ax.legend()
