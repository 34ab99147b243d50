"""A physics-informed network: stiffness and damping from three sensors

A network learns the motion of four beads from the velocities of two of them, with 1 % of noise, while it has to obey
the equation of motion, whose stiffness and damping are learned beside it.

:systems: physics-informed networks
:part: Data
:number: stiffness of the contacts (scaled)
:expected: 1.0
:within: 1 %
:source: what the data were made with; Raissi, Perdikaris, Karniadakis, J. Comput. Phys. 378, 686 (2019)
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx


def scene(p):
    contacts = gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(p["stiffness"], 1.0))
    return gx.Lattice(np.ones(4), (contacts, gx.Damping(p["damping"])))


chain = scene({"stiffness": 1.0, "damping": 0.08})
state = gx.states.impact(chain, velocity=0.3)
run = gx.simulate(chain, state, 6.0, save_at=61)
seen = np.asarray(run.vs)[:, [1, 3]]
seen = seen + 0.01 * np.sqrt(np.mean(seen**2)) * np.random.default_rng(0).normal(size=seen.shape)
found = gx.identify.physics_informed(
    scene,
    {"stiffness": 1.4, "damping": 0.2},
    run.ts,
    seen,
    sites=[1, 3],
    state=state,
    width=24,
    max_steps=600,
    refine=300,
)
number = float(found.parameters["stiffness"])
u = jax.vmap(found.motion)(run.ts)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for n, name in ((1, "seen"), (2, "never seen")):
    line = ax.plot(run.ts, run.us[:, n], "o", ms=4, label=f"bead {n + 1}, {name}")[0]
    ax.plot(run.ts, u[:, n], color=line.get_color())
ax.set(xlabel="time (scaled)", ylabel="displacement u (scaled)")
ax.legend()
