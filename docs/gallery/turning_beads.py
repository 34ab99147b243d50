"""Beads that turn: three bands of a hexagonal packing

If the contacts have a tangential stiffness, beads rotate as well as move. A third band appears, and long shear waves
are faster than those of beads that do not turn (dashed).

:systems: beads that turn
:part: The plane
:number: m omega^2 / K2 of the rotation at k = 0, of spheres with Mindlin's stiffness
:expected: 24.705882
:within: 1e-5
:source: 12 k_t/(K2 I/(m R^2)), k_t = 2 (1 - nu)/(2 - nu) K2, nu = 0.3, I = 0.4 m R^2; Tournat et al., NJP 13, 073042
"""

import matplotlib.pyplot as plt

import granjax as gx

load = {"exponent": 1.5, "precompression": 1e-3, "boundary": "periodic"}
turning = gx.linear.path(gx.scenes.triangular(8, rotation=True, **load), "GKMG")
still = gx.linear.path(gx.scenes.triangular(8, **load), "GKMG")
number = float(turning.omega_squared[0, 2]) / (1.5 * 1e-3 ** (1 / 3))
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.bands(turning, ax)
ax.plot(still.distance, still.omega, "k--", lw=1)
ax.lines[0].set_label("beads that turn")
ax.lines[-1].set_label("beads that do not")
ax.legend(loc="upper center", frameon=False)
ax.set_title(f"rotation at $k = 0$: $m\\omega^2/K_2$ = {number:.4f}")
