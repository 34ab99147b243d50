"""Mass-in-mass: a solitary wave that leaves its resonators at rest

A mass on a spring inside every bead takes energy from a pulse, unless it oscillates exactly once while the pulse passes
by one bead. Left: a spring that is softer by 30 %. Right: the spring of the exact condition, for which nothing
oscillates behind the pulse. The colours are the velocities of the resonators.

:systems: mass-in-mass chain
:part: Travelling waves
:number: largest strain of the tail-free wave of speed 1, mass ratio 0.1
:expected: 1.799176764595
:within: 1e-9
:source: Xu, Kevrekidis, Stefanov, J. Phys. A 48, 195204 (2015); the value by the tent integral in other code
"""

import matplotlib.pyplot as plt

import granjax as gx

kappa = float(gx.travelling.tail_free_stiffness(1.0, 0.1))
wave = gx.travelling.solitary_wave(gx.Hertz(), speed=1.0, resonator=gx.Resonator(0.1, kappa))
number = float(wave.strain(0.0))
ax, axes = plt.subplots(1, 2, figsize=(5.4, 3.2), layout="constrained")
for i, (axis, share) in enumerate(zip(axes, (0.7, 1.0))):
    chain = gx.scenes.mass_in_mass(36, 0.1, share * kappa, boundary="free")
    run = gx.simulate(chain, wave.state(36, 8.0), 20.0, save_at=101)
    gx.plots.space_time(
        run.vs["resonator"],
        axis,
        ts=run.ts,
        scale="log",
        limit=1.5,
        colour_bar=i > 0,
        label="velocity (scaled)",
    )
    axis.set(title=f"stiffness {share * kappa:.3f}", ylabel="")
axes[0].set_ylabel("time (scaled)")
