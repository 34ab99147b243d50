"""A struck hexagonal packing: the front spreads and falls

One bead in the middle of a hexagon of beads that just touch is struck to the right. A pulse that would stay together in
a chain spreads here: forces (lines) propagate along the rows, and the velocity of the front decays as a power of the
distance.

:systems: hexagonal packing
:part: The plane
:number: exponent with which the peak velocity falls with distance
:expected: -0.5
:within: 0.06
:source: energy that spreads over a ring, v^2 r constant
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt

import granjax as gx

packing = gx.scenes.hexagon(12, exponent=1.5)
middle = packing.shape[0] // 2
run = gx.simulate(
    packing,
    gx.states.impact(packing, [0.3, 0.0], site=middle),
    40.0,
    save_at=[12.0, 40.0],
    record={"peak": gx.Peak(lambda t, y, lattice: jnp.linalg.norm(y.v, axis=-1))},
)
decay = gx.measures.front_decay(packing, run.recorded["peak"], middle)
number = float(decay.exponent)
figure, (ax, right) = plt.subplots(1, 2, figsize=(5.6, 2.8), layout="constrained")
half = gx.State(run.us[0], run.vs[0])
gx.plots.beads(packing, ax=ax, network=gx.measures.force_network(packing, half))
right.plot(decay.distance, decay.amplitude, "o", ms=4)
right.plot(
    decay.distance, decay.amplitude[5] * (decay.distance / decay.distance[5]) ** number, "k-", lw=1
)
right.set(
    xlabel="distance (bead diameters)",
    ylabel="peak velocity (scaled)",
    title=f"exponent {number:.2f}",
)
