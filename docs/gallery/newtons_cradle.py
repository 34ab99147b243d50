"""Newton's cradle: a breather that travels along hanging beads

Beads on strings touch without load. A blow creates a travelling packet of oscillating beads: a breather. Oscillations
of small amplitude obey the discrete p-Schroedinger equation. Its one constant tau_0 determines how contacts raise the
frequency of two beads that oscillate against each other, omega = 1 + sqrt(a)/tau_0.

:systems: Newton's cradle
:part: Beyond the granular chain
:number: sqrt(a)/(omega - 1) of the orbit of two beads at omega = 1.0002
:expected: 1.54506223
:within: 0.1 %
:source: tau_0 = 2^(-1/2) pi^(1/2) Gamma(9/4)/Gamma(7/4); James, Kevrekidis, Cuevas, Physica D 251, 39 (2013)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

omega = 1.0002
pair = gx.scenes.cradle(2)
swing = (1.5 * (omega - 1)) ** 2 * np.array([1.0, -1.0])
orbit = gx.breathers.breather(pair, omega, gx.State(swing, 0 * swing))
number = float(np.sqrt(np.ptp(orbit.state.u) / 2) / (omega - 1))
cradle = gx.scenes.cradle(40)
run = gx.simulate(cradle, gx.states.impact(cradle, velocity=1.2), 200.0, save_at=401)
energy = gx.measures.along(gx.measures.site_energy, cradle, run)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.space_time(energy, ax, ts=run.ts, label="energy (scaled)", limit=0.35)
