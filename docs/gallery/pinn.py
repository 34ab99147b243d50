"""A physics-informed network: stiffness and damping from two sensors

A network learns the motion of four beads from the velocities of two of them, with 1 % of noise. It also has to obey the
equation of motion, whose stiffness and damping are learned at the same time. equinox builds the network, optax trains
it, and the residual is that of the library's own lattice. If the initial state is known, as here, `gx.fit` is more
reliable and gives a covariance.

:systems: physics-informed networks
:part: Data
:number: stiffness of the contacts (scaled)
:expected: 1.0
:within: 1 %
:source: what the data were made with; Raissi, Perdikaris, Karniadakis, J. Comput. Phys. 378, 686 (2019)
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import optax

import granjax as gx

SENSORS = np.array([1, 3])
T = 6.0
STEPS = 600


def scene(stiffness, damping):
    contacts = gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(stiffness, 1.0))
    return gx.Lattice(np.ones(4), (contacts, gx.Damping(damping)))


chain = scene(1.0, 0.08)
state = gx.states.impact(chain, velocity=0.3)
run = gx.simulate(chain, state, T, save_at=61)
seen = np.asarray(run.vs)[:, SENSORS]
seen = seen + 0.01 * np.sqrt(np.mean(seen**2)) * np.random.default_rng(0).normal(size=seen.shape)

# inputs of the network: the time, and waves up to slightly above the highest linear frequency
highest = float(gx.linear.normal_modes(chain).omega[-1])
count = int(np.ceil(highest * T / np.pi))
frequencies = 1.2 * highest / count * jnp.arange(1.0, count + 1)
network = eqx.nn.MLP(2 * count + 1, 4, 24, 2, jnp.tanh, key=jax.random.key(0))
size = np.sqrt(np.mean(seen**2))
collocation = jnp.linspace(0.0, T, max(16, int(8 * highest * T / np.pi)))


def motion(network, t):
    phase = frequencies * t
    inputs = jnp.concatenate([jnp.array([t / T]), jnp.sin(phase), jnp.cos(phase)])
    return size / highest * network(inputs)


def moved(network, t):
    """Return displacements, velocities and accelerations at one time."""
    velocity = lambda t: jax.jvp(lambda t: motion(network, t), (t,), (1.0,))
    (u, v), (_, a) = jax.jvp(velocity, (t,), (1.0,))
    return u, v, a


def loss(model):
    network, logs = model
    _, v, _ = jax.vmap(lambda t: moved(network, t))(run.ts)
    u, now, a = jax.vmap(lambda t: moved(network, t))(collocation)
    lattice = scene(*jnp.exp(logs))
    residual = a - jax.vmap(lattice.acceleration)(collocation, u, now)
    u0, v0, _ = moved(network, 0.0)
    start = highest**2 * (u0 - state.u) ** 2 + (v0 - state.v) ** 2
    data = jnp.mean((v[:, SENSORS] - seen) ** 2)
    return (data + jnp.mean(residual**2) / highest**2 + jnp.mean(start)) / size**2


def trained(model, optimiser, steps):
    """Return the model after some steps of an optax optimiser."""
    free, fixed = eqx.partition(model, eqx.is_inexact_array)
    cost = lambda free: loss(eqx.combine(free, fixed))

    def step(carry, _):
        free, memory = carry
        value, slope = jax.value_and_grad(cost)(free)
        more = {"value": value, "grad": slope, "value_fn": cost}
        updates, memory = optax.with_extra_args_support(optimiser).update(
            slope, memory, free, **more
        )
        return (optax.apply_updates(free, updates), memory), value

    run_all = jax.jit(lambda x: jax.lax.scan(step, (x, optimiser.init(x)), length=steps))
    return eqx.combine(run_all(free)[0][0], fixed)


model = network, jnp.log(jnp.array([1.4, 0.2]))
model = trained(model, optax.adam(optax.cosine_decay_schedule(3e-3, STEPS)), STEPS)
model = trained(model, optax.lbfgs(), STEPS // 2)
number = float(jnp.exp(model[1][0]))
u = jax.vmap(lambda t: motion(model[0], t))(run.ts)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for n, name in ((1, "seen"), (2, "never seen")):
    line = ax.plot(run.ts, run.us[:, n], "o", ms=4, label=f"bead {n + 1}, {name}")[0]
    ax.plot(run.ts, u[:, n], color=line.get_color())
ax.set(xlabel="time (scaled)", ylabel="displacement u (scaled)")
ax.legend()
