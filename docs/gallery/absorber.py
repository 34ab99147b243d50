"""A shock absorber: a tapered chain spreads a blow

A blow travels along twenty beads to a wall. In a tapered chain the beads shrink, and a small bead follows every large
one. The pulse breaks into many pulses, and the largest force on the wall is a fraction of the force behind equal beads.

:systems: shock absorber
:part: Devices
:number: largest force on the wall over that of equal beads, taper of 5 %, small beads of half the radius
:expected: 0.491635
:within: 0.01 %
:source: SciPy's DOP853 with forces of its own; Doney, Sen, Phys. Rev. Lett. 97, 155502 (2006)
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx


def absorber(R):
    inner = gx.Hertz(jnp.sqrt(2 * R[:-1] * R[1:] / (R[:-1] + R[1:])))
    return gx.Lattice(
        R**3, (gx.Bond(gx.Shift(1, "free"), inner), gx.Wall(gx.Hertz(jnp.sqrt(2 * R[-1])), "right"))
    )


def on_wall(t, y, lattice):
    return gx.measures.contact_force(lattice, y, t, bond=1)[0]


n = np.arange(20)
chains = jax.vmap(absorber, out_axes=-1)(
    np.array([np.ones(20), 0.95 ** (n // 2) * np.where(n % 2, 0.5, 1.0)])
)
run = gx.simulate(
    chains,
    gx.states.impact(chains),
    60.0,
    step=0.01,
    save_at=601,
    record={"peak": gx.Peak(on_wall)},
)
number = float(run.recorded["peak"][1] / run.recorded["peak"][0])
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
force = gx.measures.along(lambda lattice, y, t: on_wall(t, y, lattice), chains, run)
ax.plot(run.ts, force, label=["equal beads", "decorated taper"])
ax.set(xlabel="time (scaled)", ylabel="force on the wall (scaled)")
ax.legend()
