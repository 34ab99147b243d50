"""heyoka: Taylor integration with the series compiled by LLVM, for chains whose contacts stay closed.

The series of s^{3/2} knows nothing of a contact that opens: such chains are refused. The order follows from the
tolerance, so every tolerance compiles an integrator of its own, quickly in the compact mode. The power makes one series
where s sqrt(s) makes two, and what the forces on a bead have in common is left out.
"""

from functools import cache

import heyoka as hy
import numpy as np

from .chain import Unfit

PARAMETER = "tolerance"


def calls(chain):
    """The adaptive Taylor integrator with `fast_math`, as its documentation advises for speed, in both modes."""
    if not chain.closed:
        raise Unfit(
            "a Taylor series does not see a contact that opens: heyoka would be silently wrong"
        )
    c = chain.single("heyoka")
    return {"heyoka": _mode(c, compact_mode=False), "heyoka compact": _mode(c, compact_mode=True)}


def _mode(c, **mode):
    N = c.u.size
    equations = _equations(c)
    start = np.concatenate([c.u, c.v])

    @cache
    def integrator(tolerance):
        return hy.taylor_adaptive(equations, start, tol=tolerance, fast_math=True, **mode)

    def call(tolerance):
        taylor = integrator(tolerance)
        taylor.time = 0.0
        taylor.state[:] = start
        outcome = taylor.propagate_until(c.t1)[0]
        if outcome != hy.taylor_outcome.time_limit:
            raise RuntimeError(f"heyoka: {outcome}")
        return taylor.state[:N].copy(), taylor.state[N:].copy()

    return call


def _equations(c):
    N = c.u.size
    u = hy.make_vars(*[f"u{i}" for i in range(N)])
    v = hy.make_vars(*[f"v{i}" for i in range(N)])
    overlaps = [
        c.overlap - u[0],
        *(c.overlap + u[i - 1] - u[i] for i in range(1, N)),
        c.overlap + u[N - 1],
    ]
    forces = [c.stiffness * s**1.5 for s in overlaps]
    rates = [(u[i], v[i]) for i in range(N)]
    return rates + [(v[i], c.inverse_mass * (forces[i] - forces[i + 1])) for i in range(N)]
