"""The map of tangents of a run, d(u, v)(t1)/d(u, v)(t0), in place of its final state."""

import diffrax
import jax
from jax.flatten_util import ravel_pytree

from ..flow import simulate
from ..lattice import State


def tangent_call(lattice, state, t0, t1, solver, parameter):
    """A function of the step or tolerance that returns the map (2N, 2N) and the run's `stats`.

    By forward differentiation through the solver: for adaptive ones through their mesh, which follows the state alone.
    """
    start, restore = ravel_pytree(tuple(state))

    @jax.jit
    def call(value):
        chosen = {} if parameter is None else {parameter: value}

        def flow(y):
            run = simulate(
                lattice, State(*restore(y)), t1, t0=t0, solver=solver, adjoint=diffrax.ForwardMode(), **chosen
            )
            return ravel_pytree(tuple(run.final))[0], run.stats

        return jax.jacfwd(flow, has_aux=True)(start)

    return call
