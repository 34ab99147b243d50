"""Forces that jump in time: steps end at the breaks, and each sees the force from its own side."""

from collections.abc import Callable

import diffrax
import equinox as eqx
import jax.numpy as jnp

from ..lattice import Lattice
from ..solvers.wrapped import Wrapped
from ..terms import Term
from ..terms.base import Altered
from ..terms.waveforms import ULPS, count_breaks, next_break
from ..types import Number, Scalar

# a step that would end so near before its goal ends there
NEARLY = 1e-9


class Held(Altered):
    """A term for the times from `low` to `high` alone: beyond them it is what it is there."""

    term: Term
    low: Number
    high: Number

    def _within(self, t):
        return jnp.clip(t, self.low, self.high)

    def force(self, t, u, v, mass):
        return self.term.force(self._within(t), u, v, mass)

    def energy(self, t, u):
        return self.term.energy(self._within(t), u)

    def compressions(self, t, u):
        return self.term.compressions(self._within(t), u)

    def linearised(self, lattice, t, u, v):
        return self.term.linearised(lattice, self._within(t), u, v)


class OneSided(Wrapped):
    """A solver whose steps see a lattice as it is inside of them, and start with a force of their own."""

    def init(self, terms, t0, t1, y0, args):
        return None

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        args = inside(args, t0, t1)
        own = self.solver.init(terms, t0, t1, y0, args)
        y1, error, dense, _, result = self.solver.step(terms, t0, t1, y0, args, own, made_jump)
        return y1, error, dense, None, result


def inside(lattice: Lattice, t0: Number, t1: Number) -> Lattice:
    """A lattice as it is inside of a step, at its ends too."""
    slack = (
        2 * ULPS * jnp.finfo(jnp.result_type(t0, t1)).eps * jnp.maximum(jnp.abs(t0), jnp.abs(t1))
    )
    low, high = jnp.minimum(t0, t1) + slack, jnp.maximum(t0, t1) - slack
    held = tuple(Held(term, low, high) if term.jumps() else term for term in lattice.terms)
    return eqx.tree_at(lambda x: x.terms, lattice, held)


def one_sided(solver: diffrax.AbstractSolver, lattice: Lattice) -> diffrax.AbstractSolver:
    """The solver itself where nothing breaks."""
    return OneSided(solver) if lattice.breaks else solver


def breaks_of(field: Callable, args: object) -> tuple:
    """The `Breaks` of a vector field with these arguments; none of one that says nothing of them."""
    found = getattr(field, "breaks", None)
    return () if found is None else found(args)


def landing(breaks: tuple, t: Number, step: Number, end: Scalar) -> Number:
    """The end of a step from t: equal steps, none longer than `step`, up to the next break, or to `end`."""
    goal = jnp.minimum(next_break(breaks, t), end)
    count = jnp.maximum(jnp.ceil((goal - t) / step * (1 - NEARLY)), 1)
    return jnp.where(count == 1, goal, t + (goal - t) / count)


def shared_out(breaks: tuple, t: Number, left: Number, end: Number, sign: Number) -> Number:
    """The end of a step from t, where `left` steps lead to `end`, through all breaks: each stretch has its share."""
    goal = jnp.minimum(next_break(breaks, t, sign), end)
    beyond = jnp.where(goal < end, 1 + count_breaks(breaks, goal, end, sign), 0)
    share = jnp.round(left * (goal - t) / jnp.where(end > t, end - t, 1))
    count = jnp.clip(share, 1, jnp.maximum(left - beyond, 1))
    return jnp.where(left == 1, end, jnp.where(count == 1, goal, t + (goal - t) / count))


class Landing(diffrax.AbstractStepSizeController):
    """Fixed steps that end at breaks; none is longer than `step`."""

    breaks: tuple
    step: Number
    end: Number

    def wrap(self, direction):
        return self

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        return landing(self.breaks, t0, self.step, self.end), None

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        return (
            True,
            t1,
            landing(self.breaks, t1, self.step, self.end),
            False,
            None,
            diffrax.RESULTS.successful,
        )


def cut(breaks: tuple, t: Number, step: Number) -> tuple:
    """(the end of a step from t, the length that a break has cut short, or zero)."""
    goal = next_break(breaks, t)
    short = t + step * (1 + NEARLY) > goal
    return jnp.where(short, goal, t + step), jnp.where(short, step, 0).astype(jnp.result_type(step))
