"""A wall between two valley phases carries one wave for each valley

A honeycomb with a heavy and a light mass in each cell has a gap. The two orders of the masses are two phases, whose
Berry curvature near each corner of the Brillouin zone has opposite sign. Where the phases meet, one band of waves bound
to the wall crosses the gap at each valley, with opposite velocities.

:systems: valley edge modes
:part: Topology and flat bands
:number: waves of the wall that cross the gap upwards minus downwards, at the valley k > 0
:expected: -1
:within: 0.001
:source: difference of the valley Chern numbers, +-1/2 on either side; Ma, Shvets, New J. Phys. 18, 025012 (2016)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

width = 20
heavy = np.broadcast_to(np.where(np.arange(width) < width // 2, 1.25, 1.0), (6, width))
strip = gx.scenes.honeycomb(
    6,
    width,
    mass={"a": heavy, "b": 2.25 - heavy},
    out_of_plane=True,
    boundary=("periodic", "fixed"),
)
bands = gx.linear.ribbon(strip)
share = sum(np.abs(np.asarray(x)) ** 2 for x in bands.modes.values())
at_wall = share[:, width // 2 - 3 : width // 2 + 3].sum(1) / share.sum(1)
above = np.asarray(bands.omega_squared) > 3 / 1.125  # the middle of the gap
crossing = above[1:].sum(1) - above[:-1].sum(1).astype(int)
number = float(crossing[bands.k[1:] > 0].sum())
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
k = np.broadcast_to(np.asarray(bands.k)[:, None], at_wall.shape)
dots = ax.scatter(k, bands.omega, c=at_wall, s=4, cmap="viridis_r", vmin=0, vmax=1)
plt.colorbar(dots, label="energy at the wall / all")
ax.set(xlabel="wave number along the wall (rad/cell)", ylabel=r"$\omega$ (scaled)")
