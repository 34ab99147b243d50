"""Isofrequency contours: where energy goes straight ahead

The figure shows contours of constant frequency of a square lattice over its Brillouin zone, with the group velocity at
right angles to them. At omega^2 = 4K/m (orange) the contour is a square, and all its waves carry energy along the
diagonals.

:systems: isofrequency contours
:part: The plane
:number: direction of the group velocity at k = (0.3 pi, 0.7 pi) (degrees)
:expected: 45
:within: 1e-8
:source: omega^2 = 4 - 2 cos k1 - 2 cos k2: d omega/dk is along (sin k1, sin k2), equal where k1 + k2 = pi
"""

import numpy as np

import granjax as gx

square = gx.scenes.square(6, out_of_plane=True, boundary="periodic")
velocity = gx.linear.dispersion(square, [0.3 * np.pi, 0.7 * np.pi]).group_velocity[0]
number = float(np.degrees(np.arctan2(velocity[1], velocity[0])))
zone = gx.linear.zone_map(square)
ax = gx.plots.zone(zone, velocity=True, levels=8)
ax.contour(
    *np.moveaxis(zone.q, -1, 0), zone.omega[..., 0], levels=[2.0], colors="C1", linewidths=2.5
)
ax.figure.set_size_inches(5.0, 4.0)
