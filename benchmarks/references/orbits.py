"""Makes the references of periodic orbits, tests/known_orbits.json, in ten seconds: `python -m references.orbits`.

Nothing of the library's orbits, flows or laws is in it: forces in NumPy, time by SciPy's DOP853 (rtol 1e-13, restarted
where a contact opens or closes), tangents by the variational equation, orbits by Newton's method on half a period
between two rests or on a whole one. The orbit is then run once more by extrapolation in 80-bit numbers, which knows
nothing of DOP853: what it leaves open, times the inverse Jacobian, is the stated error, and the orbit is corrected by
it.
"""

import json
import logging
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq

from .integrators import EXTENDED, extrapolation

RTOL = 1e-13
EXACT = 1e-17
HEAVY = 2.957949
OUT = Path(__file__).parents[2] / "tests" / "known_orbits.json"
log = logging.getLogger(__name__)


class Beads:
    """m u'' = f(e_left) - f(e_right) - gamma m v, f(e) = (1 + e)_+^{3/2} - 1: contacts of A = F0 = 1.

    Ends are free under the static force, or have walls at a cos(omega t + phase), one (a, phase) for each.
    """

    def __init__(self, mass, walls=None, omega=0.0, damping=0.0):
        self.mass = np.asarray(mass, float)
        self.omega = omega
        self.damping = damping
        self.walls = walls

    def compressions(self, t, u):
        """Of every contact, over the leading axis."""
        if self.walls is None:
            return u[:-1] - u[1:]
        left, right = (a * np.cos(self.omega * t + phase) + 0 * u[:1] for a, phase in self.walls)
        u = np.concatenate([left, u, right])
        return u[:-1] - u[1:]

    def gather(self, f):
        """From contacts to sites."""
        if self.walls is not None:
            return f[:-1] - f[1:]
        return np.concatenate([-f[:1], f[:-1] - f[1:], f[-1:]])

    def acceleration(self, t, u, v):
        """In the numbers that come in."""
        s = np.maximum(1 + self.compressions(t, u), 0)
        mass = self.mass.reshape((-1,) + (1,) * (u.ndim - 1))
        return self.gather(s * np.sqrt(s) - 1) / mass - self.damping * v

    def linearised(self, t, u, v, du, dv):
        """Of tangents in columns."""
        k = 1.5 * np.sqrt(np.maximum(1 + self.compressions(t, u), 0))
        de = (
            -np.diff(du, axis=0)
            if self.walls is None
            else -np.diff(np.pad(du, ((1, 1), (0, 0))), axis=0)
        )
        return self.gather(k[:, None] * de) / self.mass[:, None] - self.damping * dv

    def overlaps(self, t, u):
        """What changes sign where a contact opens."""
        return 1 + self.compressions(t, u)

    def energy(self, t, u, v):
        """From rest, walls at rest."""
        s = 1 + self.compressions(t, u)
        return np.sum(0.4 * (np.maximum(s, 0) ** 2.5 - 1) - (s - 1)) + np.sum(self.mass * v**2) / 2


class Hard:
    """u'' = -u - u^3 + C (differences of neighbours), free ends."""

    damping = 0.0

    def __init__(self, sites, coupling):
        self.mass = np.ones(sites)
        self.coupling = coupling

    def acceleration(self, t, u, v):
        """In the numbers that come in."""
        f = self.coupling * (u[:-1] - u[1:])
        return np.concatenate([-f[:1], f[:-1] - f[1:], f[-1:]]) - u - u**3

    def linearised(self, t, u, v, du, dv):
        """Of tangents in columns."""
        f = self.coupling * (du[:-1] - du[1:])
        return np.concatenate([-f[:1], f[:-1] - f[1:], f[-1:]]) - (1 + 3 * u**2)[:, None] * du

    def overlaps(self, t, u):
        """Nothing opens."""
        return np.ones(1)

    def energy(self, t, u, v):
        """Of all sites."""
        return np.sum(u**2 / 2 + u**4 / 4 + v**2 / 2) + self.coupling * np.sum(np.diff(u) ** 2) / 2


class Orbit(NamedTuple):
    """An orbit that is sought: `free` from rest to rest in half a period, or over a whole one of what drives it.

    `guess`: u, or (u, v); two digits are enough.
    """

    name: str
    scene: object
    omega: float
    guess: np.ndarray
    free: bool = True


def flow(scene, t0, t1, u, v, tangents=None, rtol=RTOL):
    """(u, v, tangents) at t1, tangents (2n, k) or `None`, by DOP853 restarted where a contact opens or closes."""
    n = len(u)
    k = 0 if tangents is None else tangents.shape[1]

    def field(t, y):
        u = y[:n]
        v = y[n : 2 * n]
        rates = [v, scene.acceleration(t, u, v)]
        if k:
            moved = y[2 * n :].reshape(2 * n, k)
            rates += [moved[n:].ravel(), scene.linearised(t, u, v, moved[:n], moved[n:]).ravel()]
        return np.concatenate(rates)

    def run(t, y, end, first=None):
        return DOP853(field, t, y, end, rtol=rtol, atol=rtol * 1e-2, first_step=first)

    t = t0
    y = np.concatenate([u, v] + ([tangents.ravel()] if k else []))
    while t < t1:
        solver = run(t, y, t1)
        closed = None
        while solver.status == "running":
            before = solver.t
            y_before = solver.y
            if solver.step():
                raise RuntimeError("DOP853 failed")
            now = scene.overlaps(solver.t, solver.y[:n]) > 0
            changed = [] if closed is None else np.flatnonzero(now != closed)
            closed = now
            if not len(changed):
                continue
            dense = solver.dense_output()
            gaps = [lambda s, j=j: scene.overlaps(s, dense(s)[:n])[j] for j in changed]
            roots = [
                brentq(g, before, solver.t, xtol=1e-15) for g in gaps if g(before) * g(solver.t) < 0
            ]
            roots = [r for r in roots if before < r < solver.t]
            if not roots:
                continue
            short = run(before, y_before, min(roots), first=min(roots) - before)
            while short.status == "running":
                short.step()
            solver = short
            break
        t = solver.t
        y = solver.y
    return y[:n], y[n : 2 * n], y[2 * n :].reshape(2 * n, k) if k else None


def gap(orbit, x, u, v):
    """What must vanish at the end, with the mean displacement of free ends."""
    n = len(orbit.scene.mass)
    if not orbit.free:
        return np.concatenate([u - x[:n], (v - x[n:]) / orbit.omega])
    held = getattr(orbit.scene, "walls", 0) is None
    return np.concatenate(
        [v / orbit.omega, [orbit.scene.mass @ x / orbit.scene.mass.sum()] if held else []]
    )


def slope(orbit, moved):
    """Derivative of `gap` in the unknowns, from tangents at the end."""
    n = len(orbit.scene.mass)
    if not orbit.free:
        return np.concatenate([moved[:n], moved[n:] / orbit.omega]) - np.diag(
            [1.0] * n + [1 / orbit.omega] * n
        )
    held = getattr(orbit.scene, "walls", 0) is None
    mean = orbit.scene.mass[None] / orbit.scene.mass.sum()
    return np.concatenate([moved[n:] / orbit.omega] + ([mean] if held else []))


def parts(orbit, x):
    """(u, v) of the unknowns."""
    n = len(orbit.scene.mass)
    return (x, np.zeros(n)) if orbit.free else (x[:n], x[n:])


def solved(orbit):
    """Unknowns, their error and the Jacobian."""
    n = len(orbit.scene.mass)
    period = 2 * np.pi / orbit.omega
    end = period / 2 if orbit.free else period
    unit = np.eye(2 * n)[:, : n if orbit.free else 2 * n]
    x = np.asarray(orbit.guess, float).ravel()
    for _ in range(12):
        u, v, moved = flow(orbit.scene, 0.0, end, *parts(orbit, x), unit, rtol=1e-10)
        jacobian = slope(orbit, moved)
        u, v, _ = flow(orbit.scene, 0.0, end, *parts(orbit, x))
        change = np.linalg.lstsq(jacobian, gap(orbit, x, u, v), rcond=1e-9)[0]
        x = x - change
        log.info("%-22s Newton: %.1e", orbit.name, np.abs(change).max())
        if np.abs(change).max() < 3e-12:
            break
    else:
        raise RuntimeError(f"{orbit.name}: Newton's method did not converge")
    u, v = (np.asarray(y, EXTENDED)[:, None] for y in parts(orbit, x))
    u, v = extrapolation(orbit.scene.acceleration, 0, EXTENDED(end), u, v, EXACT)
    left = gap(orbit, np.asarray(x, EXTENDED), u[:, 0], v[:, 0]).astype(float)
    change = np.linalg.lstsq(jacobian, left, rcond=1e-9)[0]
    log.info("%-22s 80-bit: %.1e", orbit.name, np.abs(change).max())
    return x - change, np.abs(change).max()


def made(orbit):
    """The entry of the table."""
    x, error = solved(orbit)
    n = len(orbit.scene.mass)
    period = 2 * np.pi / orbit.omega
    u, v = parts(orbit, x)
    found = [
        np.linalg.eigvals(flow(orbit.scene, 0.0, period, u, v, np.eye(2 * n), rtol)[2])
        for rtol in (RTOL, 1e-12)
    ]
    # 2n against 2n: those at one, which split like the root of the error, have a large one
    apart = np.abs(found[0][:, None] - found[1]).min(1)
    y = (u, v)
    ts = np.linspace(0, period, 201)
    opened = False
    for a, b in zip(ts, ts[1:]):
        y = flow(orbit.scene, a, b, *y, rtol=1e-9)[:2]
        opened = opened or bool((orbit.scene.overlaps(b, y[0]) <= 0).any())
    error = max(2 * error, 1e-13)
    energy = orbit.scene.energy(0.0, u, v)
    rate = np.abs(
        np.concatenate(
            [orbit.scene.mass * orbit.scene.acceleration(0.0, u, v), orbit.scene.mass * v]
        )
    ).sum()
    log.info(
        "%-22s E = %.12f  |rho| = %.9f  opened: %s",
        orbit.name,
        energy,
        np.abs(found[0]).max(),
        opened,
    )
    return {
        "omega": orbit.omega,
        "u": u.tolist(),
        "v": v.tolist(),
        "error": error,
        "energy": energy,
        "energy_error": max(rate * error, 1e-13),
        "multipliers": np.stack([found[0].real, found[0].imag], -1).tolist(),
        "multiplier_errors": np.maximum(4 * apart, 1e-10).tolist(),
        "opened": opened,
    }


def dimer(sites):
    """Light beads of mass 1 and heavy ones in turn, a light one in the middle."""
    return Beads(np.where((np.arange(sites) - sites // 2) % 2 == 0, 1.0, HEAVY))


def orbits():
    """The orbits of the table."""
    edge = 3**0.5
    intruder = np.ones(15)
    intruder[7] = 0.5
    walls = ((0.9, 0.0), (0.0, 0.0))
    three = ((0.03, 0.0), (0.03, np.pi))
    deep = [
        -0.333,
        -0.325,
        -0.333,
        -0.333,
        -0.31,
        -0.318,
        -0.378,
        -0.353,
        -0.199,
        -0.259,
        -0.636,
        -0.443,
        1.126,
        0.129,
        -0.013,
        0.387,
        0.452,
        0.302,
        0.278,
        0.338,
        0.347,
        0.324,
        0.323,
        0.331,
        0.324,
    ]
    shallow = [
        -0.257,
        -0.222,
        -0.285,
        -0.258,
        -0.116,
        -0.208,
        -0.45,
        -0.26,
        0.165,
        -0.137,
        -0.717,
        -0.139,
        0.79,
        0.053,
        -0.438,
        0.237,
        0.572,
        0.184,
        0.006,
        0.261,
        0.357,
        0.218,
        0.193,
        0.256,
        0.221,
    ]
    defect = [
        -0.037,
        -0.055,
        -0.12,
        -0.087,
        -0.243,
        -0.028,
        -0.494,
        0.843,
        -0.136,
        0.344,
        0.079,
        0.173,
        0.076,
        0.076,
        0.028,
    ]
    return [
        Orbit("light_centred", dimer(41), 0.92 * edge, np.pad(deep, 8, mode="edge")),
        Orbit("family", dimer(25), 0.985 * edge, shallow),
        Orbit("hard_pair", Hard(7, 0.02), 3.0, [0, 0, -0.008, 3.32, -3.32, 0.008, 0]),
        Orbit("defect", Beads(intruder, ((0.0, 0.0),) * 2), 2.6, defect),
        Orbit(
            "forced_opening",
            Beads(np.ones(6), walls, 1.2, 0.1),
            1.2,
            [[0.05, -0.88, -0.65, 0.06, 0.77, 0.86], [0.39, 0.44, -0.06, -0.07, -0.25, -0.33]],
            False,
        ),
        Orbit(
            "forced_branch",
            Beads(np.ones(3), three, 1.68, 0.02),
            1.68,
            [[0.251, 0, -0.251], [0.083, 0, -0.083]],
            False,
        ),
        Orbit(
            "forced_branch_upper",
            Beads(np.ones(3), three, 1.68, 0.02),
            1.68,
            [[0.547, 0, -0.547], [1.624, 0, -1.624]],
            False,
        ),
    ]


def main():
    """Write the table."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    table = {orbit.name: made(orbit) for orbit in orbits()}
    lines = json.dumps(table).replace('}, "', '},\n"').replace('], "', '],\n "')
    OUT.write_text(lines + "\n")


if __name__ == "__main__":
    main()
