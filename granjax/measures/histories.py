"""Measures of histories: a measure frame by frame, and means over all frames."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ..base.types import Displacements, Number, Numbers, Pytree
from ..flow import RunWithMemory
from ..flow.memory import recalled
from ..lattice import Lattice, State


def along(measure: Callable, lattice: Lattice, run: Any, **options: Any) -> Pytree:
    """Return a measure of every frame of a run, `measure(lattice, State(u, v), t, **options)`.

    **Arguments:** `measure`: such as `contact_force`, or a function of (lattice, y, t); `run`:
    anything with `ts`, `us`, `vs`, such as the result of `simulate`; `options`: keywords of the
    measure, such as `bond=1`. Where forces remember, the lattice holds what the run had in memory
    at each frame.
    **Returns:** what the measure returns, each array with T in front. All frames are held at once;
    to keep less, record the quantity while simulating.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=51)
    >>> gx.measures.along(gx.measures.contact_force, chain, run).shape
    (51, 21)
    """

    def of_frame(t, u, v, memory):
        now = lattice if memory is None else recalled(lattice, memory)
        return measure(now, State(u, v), t, **options)

    memory = run.by_term if isinstance(run, RunWithMemory) and run.memory else None
    return jax.vmap(of_frame)(run.ts, run.us, run.vs, memory)


def rms_velocity(lattice: Lattice, u: Displacements, v: Displacements, t: Numbers) -> Number:
    """Return the r.m.s. of all velocities in a history, a response for sweeps and branches."""
    return jnp.sqrt(jnp.mean(ravel_pytree(v)[0] ** 2))
