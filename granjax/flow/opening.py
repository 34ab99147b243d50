"""Whether a contact opened, where the ends of steps leave that open: the closest approach, by two finer runs."""

from typing import Any

import diffrax
import jax
import jax.numpy as jnp

from ..lattice import Lattice, State
from ..types import Number, Numbers, Scalar, StateLike
from .control import tighter
from .integrate import smallest_overlap
from .march import march
from .record import Peak

_FORWARD = diffrax.ForwardMode()
# a tolerance so many times smaller confirms
TIGHTER = 32
# over the gap between steps of two lengths, of a method of order 2: contacts that touch leave no higher one
COVER = 2.0


def approach(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    dt: Number | None,
    tolerance: Number | None,
    solver: diffrax.AbstractSolver,
) -> tuple[Numbers, Numbers]:
    """The smallest overlap of a run, found between steps [m], and its error, each of the shape of the lanes.

    Two runs, by steps of the same length and of half of it (or a tolerance 32 times smaller); the error is twice what
    they differ by, and infinite where one of them did not complete.
    """
    finer = (
        (dt / 2, None) if tolerance is None else (dt, tighter(tolerance, TIGHTER, lattice.dtype))
    )
    (first, good), (second, better) = (
        _closest(lattice, state, t0, t1, *how, solver) for how in ((dt, tolerance), finer)
    )
    error = COVER * jnp.abs(first - second) + 8 * jnp.finfo(second.dtype).eps * _rest(lattice, t0)
    return second, jnp.where(good & better & jnp.isfinite(error), error, jnp.inf)


def _closest(lattice, state, t0, t1, dt, tolerance, solver):
    record = {"deepest": Peak(_deepest)}
    run = march(
        lattice, state, t0, t1, dt, tolerance, None, record, solver, _FORWARD, None, False, False
    )
    deepest = run.recorded["deepest"]
    return -jnp.max(deepest, axis=tuple(range(deepest.ndim - len(lattice.lanes)))), run.completed


def _deepest(t: Any, y: Any, lattice: Any) -> jax.Array:
    return -smallest_overlap(t, y, lattice)


def _rest(lattice, t0):
    return jnp.max(jnp.abs(smallest_overlap(t0, State(lattice.zeros(), None), lattice)))
