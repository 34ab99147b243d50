"""The time steps of a period: how many, the flow over it, and the motion along it."""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver, Dopri8

from ..checks import concrete, described, refuse, traced, whole
from ..flow import Flow, frequency_bound, linear_frequency
from ..flow.dispatch import facts
from ..lattice import Lattice, State
from ..types import Count, Counts, Numbers, Scalar, StateLike, Times

# h omega of a step, with omega the highest linear frequency: of orbits, and of runs that settle
FINE = 0.3
COARSE = 0.4
# the fewest steps of a period
LEAST_STEPS = 16


def fixed_step_solver(
    lattice: Lattice, solver: AbstractSolver | None, otherwise: AbstractSolver
) -> AbstractSolver:
    """The solver that is given; else `otherwise`, a splitting one, where the lattice splits, and Dopri8 where not."""
    if solver is not None:
        return solver
    return otherwise if facts(lattice).splits else Dopri8()


def default_steps(
    lattice: Lattice,
    period: Scalar,
    multiple: Count = 1,
    *,
    fineness: Scalar = FINE,
    doubled: bool = False,
    guess: StateLike | None = None,
) -> Scalar:
    """Steps of a period such that h omega_max <= fineness, with omega_max the highest linear frequency; at least 16.

    A multiple of `multiple`; a number, or an array where the lattice or the period is traced. In a sonic vacuum, where
    that frequency is zero, omega_max is the bound at the energy of a `guess`. **Raises** ValueError there without one,
    unless the steps are `doubled` by the caller as need be.
    """
    turned = period * linear_frequency(lattice)
    known = concrete(turned)
    least = -(-LEAST_STEPS // multiple)
    if known is None:
        return multiple * jnp.maximum(jnp.ceil(turned / fineness / multiple).astype(int), least)
    if not known > 0 and guess is not None:
        known = np.asarray(period * frequency_bound(lattice, guess, 0.0, period))
    elif not (doubled or known > 0):
        refuse(
            "steps",
            "steps per period",
            "None",
            "Nothing is stiff at rest (a sonic vacuum): give steps=.",
        )
    return multiple * max(math.ceil(float(known) / fineness / multiple), least)


def flow_over(
    lattice: Lattice,
    period: Scalar,
    steps: Count | Counts | None,
    solver: AbstractSolver,
    multiple: Count = 1,
    guess: StateLike | None = None,
) -> Flow:
    """The flow over a period; a given number of steps is static, the default one an array.

    `multiple`: segments that must divide them.
    """
    if steps is None:
        return Flow(jnp.asarray(default_steps(lattice, period, multiple, guess=guess)), solver)
    if traced(steps):
        return Flow(steps, solver)
    if whole("steps", steps, multiple) % multiple:
        refuse("steps", f"a multiple of the {multiple} segments", repr(steps))
    return Flow(int(steps), solver)


def answered(response: Callable, lattice: Lattice, ys: State, ts: Times) -> Numbers:
    """The number that a response gives of a history."""
    found = response(lattice, ys.u, ys.v, ts)
    if np.ndim(found):
        refuse(
            "response",
            "a function (lattice, u, v, t) that gives one number",
            f"one that gives {described(found)}",
        )
    return jnp.asarray(found)


def history(
    flow: Flow,
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    period: Scalar,
    frames: Count,
    periods: Count = 1,
) -> tuple[State, Times, State]:
    """`periods` periods from t0 on in `frames` equal parts each: (the state at the end, times, states).

    Times and states have a leading axis and leave the end out; `flow` has the steps of one period. Every period begins
    at the same phase, so that what is periodic does not drift by the rounding of the time.
    """
    between = Flow(-(-flow.steps // frames), flow.solver)
    length = period / frames
    ts = t0 + length * jnp.arange(frames)

    def one(y, t):
        return between(y, t, t + length, lattice), y

    end, states = jax.lax.scan(one, State(*state), jnp.tile(ts, periods))
    return end, t0 + length * jnp.arange(frames * periods), states
