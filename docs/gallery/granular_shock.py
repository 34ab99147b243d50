"""A dispersive shock of a granular chain between its edges

Two halves of a precompressed chain collide. Whitham's modulation equations of the chain's own periodic waves predict
where the oscillation begins and ends (lines) and the plateau that it leaves behind. Dispersive-shock fitting, which
needs only the speed of sound on either side, predicts nearly the same edges (dashed).

:systems: granular dispersive shock
:part: Shocks
:number: mean strain of the plateau at c = 0.3, overlap 1/2, sound 1
:expected: 0.54047944
:within: 1e-7
:source: a simulation by another method until t = 8000; El, Hoefer, Physica D 333, 11 (2016) on fitting
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

law = gx.Hertz(2 * 2**0.5 / 3, precompression=1 / 3)
chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), law), sites=340)
shock = gx.shocks.space_time(gx.shocks.velocity_shock(chain, 0.3), 130.0, frames=101)
edges = gx.shocks.whitham(law, 0.3)
fit = gx.theory.shock_edges(law, 0.3)
number = edges.mean
plateau = np.average(shock.strain[-1, 120:220], weights=np.hanning(100))
assert abs(plateau - number) < 1e-4
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.space_time(shock.strain, ax, ts=shock.ts, sites=shock.places, label="strain (scaled)")
for found, line in ((edges, "w-"), (fit, "w--")):
    for speed in (found.trailing_speed, found.leading_speed):
        ax.plot(speed * shock.ts, shock.ts, line, lw=1.0)
ax.set(xlim=shock.places[[0, -1]], xlabel="bond from the step $n$", ylabel="time (scaled)")
