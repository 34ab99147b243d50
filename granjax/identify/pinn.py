"""A physics-informed network: motion and parameters of a lattice from a few sensors, without integrating it.

Six damped Hertz contacts, three sensors and 1 % of noise, on the same data: the network takes 34 s and misses the
damping by 0.9 %, the stiffness by 2e-4; `granjax.fit` takes 0.4 s (30 s with its compilation) and misses them by
2e-4 and 4e-5, from a stiffness three times too small or too large as well, with a covariance. So fit where the initial
state is known or has few unknowns; the network is for short records whose initial state is not known.
"""

import math
import time
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Float

from ..checks import non_negative, parameter, positive, refuse, whole
from ..fit.problem import checked_scene
from ..flow.stiffness import linear_frequency
from ..parameters import Bounds, Coordinates
from ..printing import told
from ..programs import shared_size
from ..results import Held, Result
from ..types import AnyArray, Count, Numbers, Parameter, Scalar, Scene, Times


class Motion(eqx.Module):
    """Displacements u(t) (N,) of a chain as a network: `motion(t)`; `motion.state(t)` gives (u, v, a) at one time.

    u(t) = s net(t/T, sin(omega_k t), cos(omega_k t)), the omega_k even up to a little above the lattice's band.

    **Example:**

    >>> import equinox as eqx
    >>> net = eqx.nn.MLP(3, 1, 4, 1, key=jax.random.key(0))   # of t/T, sin(omega t), cos(omega t), for one site
    >>> motion = gx.identify.Motion(net, jnp.array([2.0]), jnp.asarray(1.0), jnp.asarray(0.5))
    >>> [x.shape for x in motion.state(0.3)]                  # displacement, velocity, acceleration
    [(1,), (1,), (1,)]
    """

    net: eqx.nn.MLP
    frequencies: Float[AnyArray, " count"]
    span: Float[AnyArray, ""]
    scale: Float[AnyArray, ""]
    __repr__ = told

    def __call__(self, t: Float[AnyArray, ""]) -> Float[AnyArray, " N"]:
        phase = self.frequencies * t
        return self.scale * self.net(
            jnp.concatenate([t[None] / self.span, jnp.sin(phase), jnp.cos(phase)])
        )

    def state(
        self, t: Scalar
    ) -> tuple[Float[AnyArray, " N"], Float[AnyArray, " N"], Float[AnyArray, " N"]]:
        """Displacements, velocities and accelerations at one time."""
        t = jnp.asarray(t, self.span.dtype)
        one = jnp.ones_like(t)
        velocity = lambda t: jax.jvp(self.__call__, (t,), (one,))[1]
        return self(t), *jax.jvp(velocity, (t,), (one,))


class PhysicsInformed(Result):
    """What `physics_informed` returns.

    - `parameters`: dict of what was found; `motion`: `Motion`. `loss` (max_steps + refine,): of every step.
    - `misfit`: rms of the data less the motion, over the rms of the data; `residual`: rms of a - F/m at the
      collocation points, over the rms of a. `seconds`: of the training, compilation included. `outcome`: a sentence.

    **Example:**

    >>> scene = lambda p: gx.Lattice(np.ones(2), gx.OnSite(gx.Linear(p["stiffness"])))
    >>> ts = np.linspace(0.0, 3.0, 31)
    >>> v = np.cos(ts)[:, None] * np.ones(2)
    >>> sizes = {"points": 16, "width": 8, "depth": 1, "max_steps": 2000, "rate": 0.02, "refine": 0}
    >>> found = gx.identify.physics_informed(scene, {"stiffness": 1.4}, ts, v, **sizes)
    >>> found.loss.shape, bool(found.misfit < 1e-2)
    ((2000,), True)
    """

    held: ClassVar[dict[str, Held]] = {"loss": Held("step", "1"), "seconds": Held(unit="s")}
    parameters: dict[str, Numbers]
    motion: Motion
    loss: Float[np.ndarray, " steps"]
    misfit: float
    residual: float
    seconds: float
    outcome: str = eqx.field(static=True)


def physics_informed(
    scene: Scene,
    start: dict[str, Parameter],
    times: Times,
    velocity: Float[AnyArray, "T sensors"],
    *,
    sites: Parameter | None = None,
    state: tuple | None = None,
    bounds: Bounds = None,
    weight: Scalar = 1.0,
    points: Count | None = None,
    width: Count = 48,
    depth: Count = 2,
    max_steps: Count = 4000,
    refine: Count = 1000,
    rate: Scalar = 3e-3,
    seed: Count = 0,
) -> PhysicsInformed:
    r"""Parameters of a chain by a physics-informed network.

    A network u(t) (N,) and the parameters theta minimise together

    mean over data of |u'_s(t) - v_s(t)|^2 + weight/omega^2 mean over collocation of |u'' - F(t, u, u'; theta)/m|^2

    and, where the initial state is known, the mean of omega^2 |u(0) - u_0|^2 + |u'(0) - v_0|^2; omega is the highest
    linear frequency at the start. First by Adam with a rate that falls as a cosine, then by L-BFGS. For short records
    of small chains; a fit of trajectories is quicker and surer where the initial state is known.

    **Arguments:**

    - `scene`: function of a dict of parameters that returns a `Lattice`, a chain with scalar displacements; `start`:
      that dict; `bounds`: dict from names to (low, high), `None` for no bound.
    - `times` (T,), `velocity` (T, sensors) [m/s]: even or not, from t >= 0 on; `sites`: of the sensors, `None` all.
    - `state`: the `State` at t = 0 where it is known, of the chain's shape; with few sensors it is needed.
    - `weight`: of the physics; `points`: number of collocation points, `None` for 16 a shortest period, or up to an
      eighth more; `width`, `depth`: of the network; `max_steps`, `rate`: of Adam; `refine`: steps of L-BFGS; `seed`: of
      the first weights.

    **Returns:** `PhysicsInformed`. **Raises** ValueError for shapes that do not fit, no velocity at all, bounds that
    do not hold the start, or a lattice without linear frequency (a sonic vacuum).
    Source: Raissi, Perdikaris, Karniadakis, J. Comput. Phys. 378, 686 (2019).

    **Example:**

    >>> scene = lambda p: gx.Lattice(np.ones(2), gx.OnSite(gx.Linear(p["stiffness"])))
    >>> ts = np.linspace(0.0, 3.0, 31)
    >>> v = np.cos(ts)[:, None] * np.ones(2)
    >>> sizes = {"points": 16, "width": 8, "depth": 1, "max_steps": 2000, "rate": 0.02, "refine": 0}
    >>> found = gx.identify.physics_informed(scene, {"stiffness": 1.4}, ts, v, **sizes)
    >>> round(float(found.parameters["stiffness"]), 1)
    1.0
    """
    coordinates = Coordinates(start, bounds)
    lattice = checked_scene(scene, jax.tree.map(jnp.asarray, start))
    times, velocity, sites = _checked(lattice, times, velocity, sites)
    weight, rate = non_negative("weight", weight), float(positive("rate", rate))
    max_steps, refine = whole("max_steps", max_steps, 0), whole("refine", refine, 0)
    began = time.perf_counter()
    omega, span = float(linear_frequency(lattice)), float(times[-1])
    if not omega > 0:
        refuse(
            "start", "a lattice with a linear frequency", "a sonic vacuum", "Give a precompression."
        )
    size = jnp.mean(velocity**2)
    periods = omega * span / (2 * math.pi)
    points = (
        shared_size(max(16, math.ceil(16 * periods)))
        if points is None
        else whole("points", points, 2)
    )
    collocation = jnp.asarray(np.linspace(0.0, span, points))
    count = shared_size(max(4, math.ceil(2 * periods)))
    net = eqx.nn.MLP(
        2 * count + 1, lattice.shape[0], width, depth, jnp.tanh, key=jax.random.key(seed)
    )
    frequencies = jnp.asarray(1.2 * omega / count * np.arange(1.0, count + 1))
    omega, span, weight = (jnp.asarray(x) for x in (omega, span, weight))
    motion = Motion(net, frequencies, span, jnp.sqrt(size) / omega)
    state = None if state is None else tuple(parameter("state", x) for x in state)
    training = _Training(
        scene,
        coordinates,
        times,
        velocity,
        tuple(map(int, sites)),
        state,
        collocation,
        omega,
        size,
        weight,
    )
    model, history = training.trained(
        (motion, jnp.zeros(coordinates.size)), max_steps, refine, jnp.asarray(rate)
    )
    motion = model[0]
    data, physics, accelerations, _ = map(float, _parts(training, model))
    found = jax.tree.map(np.asarray, coordinates.parameters(model[1]))
    misfit, residual = math.sqrt(data), math.sqrt(physics / accelerations)
    seconds = time.perf_counter() - began
    outcome = (
        f"The data are met to {misfit:.2g}, the equation of motion to {residual:.2g} of their rms."
    )
    if not math.isfinite(misfit + residual):
        outcome = "The training left the numbers: lower rate=."
    return PhysicsInformed(found, motion, history, misfit, residual, seconds, outcome)


def _checked(lattice, times, velocity, sites):
    times, velocity = parameter("times", times), parameter("velocity", velocity)
    if isinstance(lattice.shape, dict) or len(lattice.shape) != 1:
        refuse("scene", "a chain with scalar displacements", f"a lattice of shape {lattice.shape}")
    N = lattice.shape[0]
    sites = np.arange(N) if sites is None else np.atleast_1d(sites)
    if not (np.abs(sites + 0.5) < N).all():
        refuse("sites", f"indices of the {N} sites", repr(sites.tolist()))
    if times.ndim != 1 or len(times) < 2 or not (np.diff(times) > 0).all() or times[0] < 0:
        refuse("times", "increasing times, from t >= 0 on", f"shape {times.shape}")
    if velocity.shape != (len(times), len(sites)):
        refuse(
            "velocity and sites",
            f"a velocity of shape {(len(times), len(sites))}, times and sensors",
            f"{velocity.shape}",
        )
    if not velocity.any():
        refuse("velocity", "some motion", "none")
    return times, velocity, sites


class _Training(eqx.Module):
    """What a model (motion, free coordinates of the parameters) is compared with; equal ones compile once."""

    scene: Scene
    coordinates: Coordinates
    times: Times
    velocity: AnyArray
    sites: tuple[int, ...] = eqx.field(static=True)
    state: tuple | None
    collocation: AnyArray
    omega: AnyArray
    size: AnyArray
    weight: AnyArray

    def parts(self, model):
        """Mean squares: of the data's misfit, of the residual, of the accelerations, and of what the start is off."""
        now, x = model
        seen = jax.vmap(lambda t: now.state(t)[1])(self.times)[:, np.asarray(self.sites)]
        u, v, a = jax.vmap(now.state)(self.collocation)
        lattice = self.scene(self.coordinates.parameters(x))
        residual = a - jax.vmap(lattice.acceleration)(self.collocation, u, v)
        u0, v0 = (
            (0.0, 0.0)
            if self.state is None
            else (now.state(0.0)[i] - self.state[i] for i in range(2))
        )
        first = jnp.mean(self.omega**2 * u0**2 + v0**2)
        return (
            jnp.mean((seen - self.velocity) ** 2) / self.size,
            jnp.mean(residual**2),
            jnp.mean(a**2),
            first / self.size,
        )

    def loss(self, model):
        data, physics, _, first = self.parts(model)
        return data + self.weight * physics / (self.omega**2 * self.size) + first

    def trained(self, model, max_steps, refine, rate):
        """The model after Adam and L-BFGS, and the loss at every step."""
        model, first = _by_adam(self, model, max_steps, rate) if max_steps else (model, np.zeros(0))
        model, then = _by_search(self, model, refine) if refine else (model, np.zeros(0))
        return model, np.concatenate([first, then])


_parts = eqx.filter_jit(_Training.parts)


def _moving(training, model):
    """The cost of what moves in a model, that, and the model of it: the network and the coordinates."""
    moves = jax.tree.map(lambda _: False, model)
    moves = eqx.tree_at(
        lambda m: (m[0].net, m[1]),
        moves,
        jax.tree.map(eqx.is_inexact_array, (model[0].net, model[1])),
    )
    free, fixed = eqx.partition(model, moves)
    return (
        lambda free: training.loss(eqx.combine(free, fixed)),
        free,
        lambda free: eqx.combine(free, fixed),
    )


@eqx.filter_jit
def _by_adam(training, model, max_steps, rate):
    cost, free, whole = _moving(training, model)
    optimiser = optax.adam(optax.cosine_decay_schedule(rate, max_steps))

    def step(carry, _):
        free, state = carry
        now, slope = jax.value_and_grad(cost)(free)
        updates, state = optimiser.update(slope, state, free)
        return (optax.apply_updates(free, updates), state), now

    (free, _), history = jax.lax.scan(step, (free, optimiser.init(free)), length=max_steps)
    return whole(free), history


@eqx.filter_jit
def _by_search(training, model, max_steps):
    cost, free, whole = _moving(training, model)
    optimiser = optax.lbfgs()

    def step(carry, _):
        free, state = carry
        now, slope = optax.value_and_grad_from_state(cost)(free, state=state)
        updates, state = optimiser.update(slope, state, free, value=now, grad=slope, value_fn=cost)
        return (optax.apply_updates(free, updates), state), now

    (free, _), history = jax.lax.scan(step, (free, optimiser.init(free)), length=max_steps)
    return whole(free), history
