"""scipy with a right-hand side compiled by numba: DOP853 and LSODA of `solve_ivp`, and the compiled `ode` dop853."""

import numba
import numpy as np
from scipy.integrate import ode, solve_ivp

from .rates import compiled_rates

PARAMETER = "tolerance"
MOST_STEPS = 10**8
# what solve_ivp takes
LEAST = 3e-14


def calls(chain):
    """Three integrators of scipy; both tolerances alike."""
    into = compiled_rates(chain, "scipy")

    @numba.njit
    def rates(t, y):
        out = np.empty_like(y)
        into(y, out)
        return out

    N = chain.u.size
    y0 = np.concatenate([chain.u, chain.v])

    def ivp(method):
        def call(tolerance):
            run = solve_ivp(
                rates,
                (0.0, chain.t1),
                y0,
                method=method,
                rtol=max(tolerance, LEAST),
                atol=tolerance,
            )
            if not run.success:
                raise RuntimeError(run.message)
            return run.y[:N, -1], run.y[N:, -1]

        return call

    def compiled(tolerance):
        integrator = ode(rates).set_integrator(
            "dop853", rtol=tolerance, atol=tolerance, nsteps=MOST_STEPS
        )
        y = integrator.set_initial_value(y0, 0.0).integrate(chain.t1)
        if not integrator.successful():
            raise RuntimeError("dop853 did not arrive")
        return y[:N], y[N:]

    return {
        "scipy DOP853": ivp("DOP853"),
        "scipy LSODA": ivp("LSODA"),
        "scipy ode dop853": compiled,
    }
