"""A breather in two dimensions, from the limit of no coupling

In the limit of no coupling, one site of a square lattice of hardening oscillators oscillates and all others are at
rest. When the coupling is increased, the breather stays on this site, at a frequency above those of all waves, and its
neighbours move in the opposite direction.

:systems: breathers in two dimensions
:part: The plane
:number: displacement of the middle site at omega = 1.6 and the coupling C = 0.05 (scaled)
:expected: 1.358283
:within: 0.01 %
:source: one site, u'' = -w^2 u - u^3 with w^2 = 1 + 4C + 4C^2/(omega^2 - 1 - 4C), second order in C
"""

import matplotlib.pyplot as plt

import granjax as gx


def scene(coupling):
    return gx.scenes.square(
        5,
        law=gx.Linear(coupling),
        out_of_plane=True,
        boundary="free",
        ground=1.0,
        on_site=gx.Polynomial(0.0, 0.0, 1.0),
    )


branch = gx.breathers.anticontinuous(scene, 0.05, 1.6, (2, 2), points=8)
u = branch.orbit(-1).state.u
number = float(u[2, 2])
figure, (ax, right) = plt.subplots(1, 2, figsize=(5.4, 2.8), layout="constrained")
gx.plots.beads(scene(0.05), u, ax, label="displacement", limit=0.1)
right.plot(branch.p, branch.amplitude, "o-")
right.set(
    xlabel="coupling C",
    ylabel="amplitude (scaled)",
    title=f"{branch.verdict[-1]} at C = {branch.p[-1]:g}",
)
