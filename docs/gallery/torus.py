"""A torus of two frequencies in a Toda ring

Two modes of a ring of four sites have different amplitudes. The torus is computed as a circle of states that turns by
an angle while one mode completes a period. The ring is integrable, so a run stays on the torus for ever. The error
decreases geometrically with the number of angles K.

:systems: Toda chain
:part: Breathers
:number: distance of a run from the torus after 10 000 periods
:expected: 0
:within: 1e-7
:source: fixed steps of order 14, 60 in a period
"""

import time

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

ring = gx.scenes.toda(4, boundary="periodic")
best = gx.orbits.torus(ring, (1, 3), (0.8, 0.5), tolerance=1e-10)
start = best.state(0.4)
later = best.state(0.4, 10_000)
flow = gx.Flow(60 * 10_000)
end = flow(gx.State(*map(jnp.asarray, start)), 0.0, 1e4 * best.period, ring)
number = float(np.max(np.abs(np.asarray(end.u) - later.u)))

figure, (left, right) = plt.subplots(1, 2, figsize=(8.0, 3.2), layout="constrained")
run = gx.simulate(ring, start, 300 * best.period, save_at=9001)
left.plot(run.us[:, 0], run.us[:, 1], lw=0.2, label="run")
circle = np.array([best.state(a).u for a in np.linspace(0, 2 * np.pi, 400)])
left.plot(circle[:, 0], circle[:, 1], lw=2, label="the circle at one phase")
left.set(xlabel="first site (scaled)", ylabel="second site (scaled)")
left.legend(loc="upper right")
for angles in (7, 9, 13, 17, 21, 27, 35):
    for _ in range(2):  # nothing is compiled in the second pass, which is the one that is timed
        before = time.perf_counter()
        found = gx.orbits.torus(ring, (1, 3), (0.8, 0.5), angles=angles)
        took = time.perf_counter() - before
    error = abs(found.rotation - best.rotation)
    right.semilogy(angles, error, "C0o")
    right.semilogy(angles, found.rotation_error, "C1x")
    right.annotate(f"{took:.2f} s", (angles, error), fontsize=7)
right.legend(["error", "its estimate"])
right.set(xlabel="number of angles K", ylabel="error of the rotation angle (rad)")
ax = figure
