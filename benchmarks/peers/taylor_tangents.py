"""heyoka's Taylor series for the map of tangents of an `Orbit` whose contacts stay closed, in two ways.

`variational` is what its documentation offers: `var_ode_sys` writes all 2N (2N + 1) equations of state and tangents.
`batch` has the state and some tangents written by hand, and integrates as many copies of them at a time as a vector
instruction has lanes: the state is repeated, but all arithmetic is vectorised. Both use the compact mode; without it
one tangent alone takes 40 s to compile for 81 beads.

The order follows from the tolerance, so every tolerance compiles an integrator of its own: `call.build(tolerance)` does
that once and keeps it, `call(tolerance)` returns the matrix (2N, 2N), rows and columns (u, v). The series knows nothing
of a contact that opens, and nobody looks here: the caller has to know that none does.
"""

from functools import cache

import heyoka as hy
import numpy as np

PARAMETER = "tolerance"
# of tangents in a lane: 14 in four lanes go three times into the 162 of 81 beads; 14 to 41 are equally fast
TANGENTS = 14


def calls(orbit):
    """{name: (parameter, call)} of both ways."""
    found = {"heyoka var_ode_sys": variational(orbit), "heyoka batch": batch(orbit)}
    return {name: (PARAMETER, call) for name, call in found.items()}


def variational(orbit):
    """`var_ode_sys`, first order in all initial conditions."""
    size = 2 * orbit.u.size
    start = np.concatenate([orbit.u, orbit.v])

    @cache
    def build(tolerance):
        equations = hy.var_ode_sys(_state(orbit), hy.var_args.vars, order=1)
        taylor = hy.taylor_adaptive(
            equations, start, tol=tolerance, compact_mode=True, fast_math=True
        )
        return taylor, taylor.state.copy()

    def call(tolerance):
        taylor, first = build(tolerance)
        taylor.time = 0.0
        taylor.state[:] = first
        _arrived(taylor.propagate_until(orbit.period)[0])
        return taylor.state[size:].reshape(size, size).copy()

    call.build = build
    return call


def batch(orbit, tangents=TANGENTS, lanes=None):
    """The state and `tangents` in each of `lanes` (as many as vector instructions have), again and again."""
    lanes = hy.recommended_simd_size() if lanes is None else lanes
    size = 2 * orbit.u.size
    start = np.concatenate([orbit.u, orbit.v])
    runs = -(-size // (tangents * lanes))

    @cache
    def build(tolerance):
        equations = _state(orbit) + [x for k in range(tangents) for x in _tangent(orbit, k)]
        none = np.zeros((len(equations), lanes))
        return hy.taylor_adaptive_batch(
            equations, none, tol=tolerance, compact_mode=True, fast_math=True
        )

    def call(tolerance):
        taylor = build(tolerance)
        columns = np.eye(size, runs * tangents * lanes).reshape(size, runs, tangents, lanes)
        for run in range(runs):
            taylor.set_time(0.0)
            taylor.state[:size] = start[:, None]
            taylor.state[size:] = columns[:, run].swapaxes(0, 1).reshape(-1, lanes)
            taylor.propagate_until(orbit.period)
            _arrived(*(result[0] for result in taylor.propagate_res))
            columns[:, run] = taylor.state[size:].reshape(tangents, size, lanes).swapaxes(0, 1)
        return columns.reshape(size, -1)[:, :size]

    call.build = build
    return call


def _arrived(*outcomes):
    if any(outcome != hy.taylor_outcome.time_limit for outcome in outcomes):
        raise RuntimeError(f"heyoka: {outcomes}")


def _names(orbit, *letters):
    return [[hy.expression(f"{letter}{n}") for n in range(orbit.u.size)] for letter in letters]


def _strains(orbit, u):
    """u_{n-1} - u_n of all N+1 contacts, `None` at free ends."""
    inner = [left - right for left, right in zip(u, u[1:])]
    return [-u[0], *inner, u[-1]] if orbit.walls else [None, *inner, None]


def _motion(orbit, u, v, forces):
    rates = [(x, y) for x, y in zip(u, v)]
    return rates + [(y, (f - g) / m) for y, f, g, m in zip(v, forces, forces[1:], orbit.mass)]


def _state(orbit):
    """The equations of motion; a free end has the static force."""
    u, v = _names(orbit, "u", "v")
    A = orbit.stiffness
    d0 = orbit.overlap
    rest = A * d0**1.5
    forces = [rest if e is None else A * (d0 + e) ** 1.5 for e in _strains(orbit, u)]
    return _motion(orbit, u, v, forces)


def _tangent(orbit, k):
    """The equations of tangent k."""
    u, U, V = _names(orbit, "u", f"U{k}_", f"V{k}_")
    A = orbit.stiffness
    d0 = orbit.overlap
    pairs = zip(_strains(orbit, u), _strains(orbit, U))
    forces = [0.0 if e is None else 1.5 * A * (d0 + e) ** 0.5 * y for e, y in pairs]
    return _motion(orbit, U, V, forces)
