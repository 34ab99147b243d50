"""Time at equal error on the impact scene: granjax's adaptive pair, a numba loop with fixed steps, scipy's DOP853."""

import time

import numpy as np
import peers
from cases import TABLE
from scipy.integrate import solve_ivp

import granjax as gx

SITES, END = 100, 120.0
TOLERANCES = (1e-5, 1e-7)
REFERENCE = 1e-12


def _seconds(call, rounds):
    taken = []
    for _ in range(rounds):
        start = time.perf_counter()
        call()
        taken.append(time.perf_counter() - start)
    return float(np.median(taken))


def _ladder(run, settings, reference, rounds):
    """Errors and times [s] of one method over its settings."""
    points = []
    for setting in settings:
        error = np.abs(run(setting) - reference).max()
        points.append((float(error), _seconds(lambda s=setting: run(s), rounds)))
    return points


def _at_error(points, error):
    """Time at an error, log-log between the points; `None` outside of them."""
    e, t = np.array(sorted(points)).T
    return None if not e[0] <= error <= e[-1] else float(np.exp(np.interp(np.log(error), np.log(e), np.log(t))))


def impact(rounds, quick=False):
    """A chain of 100 beads between walls, no precompression, first bead hit with v = 1, until t = 120."""
    chain = gx.scenes.monomer(SITES)
    state = gx.states.impact(chain, velocity=1.0, site=0)
    u0, v0 = np.asarray(state.u), np.asarray(state.v)

    def pair(tolerance, solver=None):
        return np.asarray(gx.simulate(chain, state, END, tolerance=tolerance, solver=solver).final.u)

    def fixed(steps):
        u, v = u0.copy(), v0.copy()
        peers.hertz(u, v, steps, END / steps, 1.0, 0.0, 0.0, 1.5, 1.0, TABLE.a, TABLE.b)
        return u

    def scipys(tolerance):
        return solve_ivp(
            lambda t, y: peers.hertz_rates(y, 1.0, 1.0), (0.0, END), np.concatenate([u0, v0]), method="DOP853",
            rtol=0.0, atol=tolerance,
        ).y[:SITES, -1]

    reference, other = pair(REFERENCE), pair(REFERENCE, gx.RKN1210())
    steps = [400 * 2**k for k in range(4 if quick else 8)]
    numba = _ladder(fixed, steps, reference, 1 if quick else 3)
    scipy = _ladder(scipys, [1e-3] if quick else [10.0**-k for k in range(3, 11)], reference, 1)
    rows = []
    for tolerance in TOLERANCES[: 1 if quick else None]:
        error = float(np.abs(pair(tolerance) - reference).max())
        seconds = {"RKN86": _seconds(lambda t=tolerance: pair(t), rounds)}
        seconds |= {"numba SRKN11b": _at_error(numba, error), "scipy DOP853": _at_error(scipy, error)}
        rows.append({"tolerance": tolerance, "error": error, "seconds": seconds})
    ours, theirs = rows[-1]["seconds"]["RKN86"], rows[-1]["seconds"]["numba SRKN11b"]
    return {
        "ratio": None if theirs is None else ours / theirs, "rows": rows, "numba": numba, "scipy": scipy,
        "reference_uncertainty": float(np.abs(reference - other).max()),
    }
