"""numbalsoda: the Fortran codes DOP853 and LSODA, called without Python on a right-hand side compiled by numba."""

import numba
import numpy as np
from numbalsoda import dop853, lsoda, lsoda_sig

from .rates import compiled_rates

PARAMETER = "tolerance"
MOST_STEPS = 10**8


def calls(chain):
    """Both integrators; both tolerances alike."""
    into = compiled_rates(chain, "numbalsoda")
    N = chain.u.size
    y0 = np.concatenate([chain.u, chain.v])
    times = np.array([0.0, chain.t1])

    @numba.cfunc(lsoda_sig)
    def rates(t, y, out, data):
        into(numba.carray(y, (2 * N,)), numba.carray(out, (2 * N,)))

    nothing = np.zeros(1)

    def of(integrator):
        def call(tolerance):
            ys, success = integrator(
                rates.address, y0.copy(), times, nothing, tolerance, tolerance, MOST_STEPS
            )
            if not success:
                raise RuntimeError("numbalsoda did not arrive")
            return ys[-1, :N], ys[-1, N:]

        return call

    return {"numbalsoda DOP853": of(dop853), "numbalsoda LSODA": of(lsoda)}
