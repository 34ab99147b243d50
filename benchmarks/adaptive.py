"""Time at equal error on the impact scene: granjax's adaptive pair, a numba loop with fixed steps, scipy's DOP853."""

import numpy as np
import peers
from cases import TABLE, alternate
from scipy.integrate import solve_ivp

import granjax as gx

SITES = 100
END = 120.0
TOLERANCES = (1e-5, 1e-7, 1e-8, 1e-9, 1e-10)
REFERENCE = 1e-13


def _ladder(calls, reference, rounds):
    """[error, wall, cpu] of every call; the calls take turns, so that a drift of the machine touches all alike."""
    errors = {name: float(np.abs(call() - reference).max()) for name, call in calls.items()}
    times = alternate(calls, rounds)
    return {name: [errors[name], times[name]["wall"], times[name]["cpu"]] for name in calls}


def _at_error(points, error, column):
    """Time at an error, log-log between the points, which must bracket it; `None` where they do not."""
    e, t = np.array(sorted((p[0], p[column]) for p in points)).T
    return (
        None
        if not e[0] <= error <= e[-1]
        else float(np.exp(np.interp(np.log(error), np.log(e), np.log(t))))
    )


def impact(rounds, quick=False):
    """A chain of 100 beads between walls, no precompression, first bead hit with v = 1, until t = 120."""
    chain = gx.scenes.monomer(SITES)
    state = gx.states.impact(chain, velocity=1.0, site=0)
    u0 = np.asarray(state.u)
    v0 = np.asarray(state.v)

    def pair(tolerance, solver=None):
        return np.asarray(
            gx.simulate(chain, state, END, tolerance=tolerance, solver=solver).final.u
        )

    def fixed(steps):
        u = u0.copy()
        v = v0.copy()
        peers.hertz(u, v, steps, END / steps, 1.0, 0.0, 0.0, 1.5, 1.0, TABLE.a, TABLE.b)
        return u

    def scipys(tolerance):
        return solve_ivp(
            lambda t, y: peers.hertz_rates(y, 1.0, 1.0),
            (0.0, END),
            np.concatenate([u0, v0]),
            method="DOP853",
            rtol=0.0,
            atol=tolerance,
        ).y[:SITES, -1]

    reference = pair(REFERENCE)
    other = pair(REFERENCE, gx.RKN1210())
    uncertain = float(np.abs(reference - other).max())
    calls = {("RKN86", x): lambda x=x: pair(x) for x in TOLERANCES[: 1 if quick else None]}
    calls |= {
        ("numba SRKN11b", x): lambda x=x: fixed(x)
        for x in [400 * 2**k for k in range(3 if quick else 8)]
    }
    calls |= {
        ("scipy DOP853", x): lambda x=x: scipys(x)
        for x in [10.0**-k for k in range(5, 6 if quick else 14)]
    }
    ladder = _ladder(calls, reference, rounds)
    # an error that the reference itself may have says nothing
    known = {key: point for key, point in ladder.items() if point[0] > 4 * uncertain}
    rows = []
    for (method, tolerance), (error, *own) in known.items():
        if method != "RKN86":
            continue
        row = {"tolerance": tolerance, "error": error}
        for column, clock in ((1, "wall"), (2, "cpu")):
            row[clock] = {"RKN86": own[column - 1]}
            for peer in ("numba SRKN11b", "scipy DOP853"):
                points = [point for key, point in known.items() if key[0] == peer]
                row[clock][peer] = _at_error(points, error, column)
        rows.append(row)
    ratios = {clock: _ratio(rows[-1][clock]) if rows else None for clock in ("wall", "cpu")}
    return {
        "ratio": ratios["wall"],
        "cpu_ratio": ratios["cpu"],
        "rows": rows,
        "reference_uncertainty": uncertain,
        "ladder": [[*key, *point] for key, point in ladder.items()],
    }


def _ratio(seconds):
    theirs = seconds["numba SRKN11b"]
    return None if theirs is None else seconds["RKN86"] / theirs
