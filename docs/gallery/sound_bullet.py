"""Sound bullets: five delays that meet at one site

Five sites at an edge of a square lattice are pushed with different delays, which depend on the distance to the focus,
so that all pulses arrive there together. In a linear lattice their heights add up.

:systems: sound bullets
:part: The plane
:number: height at the focus over the sum of what each channel gives alone
:expected: 1
:within: 0.0001
:source: superposition; Spadoni, Daraio, Proc. Natl. Acad. Sci. USA 107, 7230 (2010)
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx


class Pulse(eqx.Module):
    """A push F sin^2(pi (t - start)/T) along a direction, for a time T."""

    force: jax.Array
    duration: jax.Array
    start: jax.Array
    direction: float | tuple = eqx.field(static=True)

    def __call__(self, t):
        phase = jnp.clip((t - self.start) / self.duration, 0, 1)
        return jnp.multiply.outer(
            np.array(self.direction), self.force * jnp.sin(jnp.pi * phase) ** 2
        )


class Bullet(NamedTuple):
    alone: np.ndarray  # crest at the focus of each channel alone, and its time
    arrival: np.ndarray
    together: np.ndarray  # crest of the first 1, 2, ... channels with delays
    at_once: float  # crest of all channels without delays
    error: float  # the error of all these heights


def bullet(lattice, channels, focus, t1, force, duration, direction=1.0):
    """Fire every channel alone, then 1, 2, ... of them, delayed so that all arrive with the last one."""
    n = len(channels)
    along = np.array(direction)
    velocity = lambda t, y, lattice: jnp.tensordot(along, y.v[focus], along.ndim)
    record = {"height": gx.Peak(velocity), "when": gx.PeakTime(velocity)}

    def pushed(start, weight):
        pulses = [
            gx.Drive(Pulse(force * weight[i], jnp.asarray(duration), start[i], direction), site)
            for i, site in enumerate(channels)
        ]
        return eqx.tree_at(lambda c: c.terms, lattice, (*lattice.terms, *pulses))

    def crests(start, weight, end):
        lanes = jax.vmap(pushed, out_axes=-1)(jnp.asarray(start), jnp.asarray(weight))
        run = gx.simulate(lanes, gx.states.rest(lanes), end, record=record, confirm=True)
        return [np.asarray(x) for x in (*run.recorded.values(), run.error.records["height"])]

    alone, when, error = crests(np.zeros((n + 1, n)), np.vstack([np.eye(n), np.ones(n)]), t1)
    delay = when[:n].max() - when[:n]
    together, _, more = crests(
        np.tile(delay, (n + 1, 1)),
        np.vstack([np.tril(np.ones((n, n))), np.ones(n)]),
        t1 + delay.max(),
    )
    return Bullet(alone[:n], when[:n], together[:n], alone[n], max(error.max(), more.max()))


square = gx.scenes.square(15, out_of_plane=True)
found = bullet(square, [(0, j) for j in range(1, 14, 3)], (7, 7), 18.0, 0.7, 7.0)
number = float(found.together[-1] / found.alone.sum())
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.plot(range(1, 6), found.together / found.alone.max(), "o", label="with delays")
ax.plot(range(1, 6), found.alone.cumsum() / found.alone.max(), "k:", label="if pulses add up")
ax.plot(5, found.at_once / found.alone.max(), "s", label="all at once")
ax.set(xlabel="channels", ylabel="gain at the focus", ylim=(0, None))
ax.legend()
