"""diffrax's own explicit pairs through `diffeqsolve`, jitted, on granjax's vector field and with its XLA flags."""

import diffrax
import jax
import numpy as np

import granjax as gx

PARAMETER = "tolerance"


@jax.jit
def _solved(lattice, state, t1, tolerance, solver):
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(gx.vector_field),
        solver,
        0.0,
        t1,
        None,
        state,
        args=lattice,
        max_steps=None,
        throw=False,
        stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        adjoint=diffrax.ForwardMode(),
    )
    return solution.ys, diffrax.is_successful(solution.result)


def calls(chain):
    """Tsit5 and Dopri8; both tolerances alike."""

    def of(solver):
        def call(tolerance):
            (u, v), success = jax.block_until_ready(
                _solved(chain.lattice, chain.state, chain.t1, tolerance, solver)
            )
            if not success:
                raise RuntimeError("diffrax did not arrive")
            return np.asarray(u[0]), np.asarray(v[0])

        return call

    return {f"diffrax {kind.__name__}": of(kind()) for kind in (diffrax.Tsit5, diffrax.Dopri8)}
