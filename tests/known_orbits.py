"""Periodic orbits that granjax did not compute: where they were made, and the lattices they belong to.

`benchmarks/references/orbits.py` makes `known_orbits.json`: SciPy's DOP853 (rtol 1e-13, restarted where a contact
opens or closes), tangents by the variational equation, Newton's method in NumPy, and a correction by an extrapolation
method in 80-bit numbers, whose size is the stated error. All contacts have A = F0 = 1.

| name | what | known from elsewhere |
|---|---|---|
| light_centred | breather of the review's dimer at 0.92 omega_2, 41 beads, free ends, contacts open | E = 2.341574 |
| family | the same at 0.985 omega_2, 25 beads, contacts closed: a point of its family | |
| hard_pair | u'' = -u - u^3 + C D2 u, C = 0.02, omega = 3, sites 3 and 4 of 7 in antiphase | multiplier 1.260834 |
| defect | light bead of mass 1/2 in the middle of 15 between walls, omega = 2.6, contacts open | |
| forced_opening | 6 beads, the left wall shaken by 0.9 cos 1.2 t, damping 0.1, contacts open | |
| forced_branch | 3 beads, both walls by 0.03 in antiphase at 1.68, damping 0.02: the lower, stable orbit | |
| forced_branch_upper | the same on the upper fold, unstable, contacts open | |

Below them are driven oscillators that several files use, with their orbits by SciPy.
"""

import json
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import granjax as gx

HEAVY = 2.957949


class Reference(NamedTuple):
    """An orbit at t = 0 of a lattice, (u, v) known to `error`, energy and multipliers (2N,) to theirs."""

    lattice: gx.Lattice
    omega: float
    u: np.ndarray
    v: np.ndarray
    error: float
    energy: float
    energy_error: float
    multipliers: np.ndarray
    multiplier_errors: np.ndarray
    opened: bool

    @property
    def state(self):
        return gx.State(jnp.asarray(self.u), jnp.asarray(self.v))

    @property
    def period(self):
        return 2 * np.pi / self.omega

    def ask(self, **how):
        """The orbit by granjax, beginning at this one."""
        if self.lattice.reads_time:
            return gx.forced.forced_orbit(self.lattice, self.period, self.state, **how)
        return gx.breathers.breather(self.lattice, self.omega, self.state, check=False, **how)


def dimer(sites, centre="light"):
    """The review's: masses 1 and 2.957949, A = d0 = 1; Theocharis et al., Phys. Rev. E 82, 056604 (2010)."""
    light = (np.arange(sites) - sites // 2) % 2 == (centre == "heavy")
    return gx.Lattice(
        np.where(light, 1.0, HEAVY), (gx.Bond(gx.Shift(1, "free"), gx.Hertz(1.0, 1.0)),)
    )


def hard(sites=7, coupling=0.02):
    """u'' = -u - u^3 + C D2 u with free ends."""
    terms = (
        gx.Bond(gx.Shift(1, "free"), gx.Linear(coupling)),
        gx.OnSite(gx.Polynomial(1.0, 0.0, 1.0)),
    )
    return gx.Lattice(np.ones(sites), terms)


def shaken(sites, amplitude, omega, damping, **keywords):
    """Beads between walls that move."""
    chain = gx.scenes.monomer(sites, precompression=1.0)
    return gx.driven.driven_chain(chain, amplitude, omega, damping=damping, **keywords)


LATTICES = {
    "light_centred": lambda: dimer(41),
    "family": lambda: dimer(25),
    "hard_pair": hard,
    "defect": lambda: gx.scenes.defects(15, {7: 0.5}, precompression=1.0),
    "forced_opening": lambda: shaken(6, 0.9, 1.2, 0.1, ends="left"),
    "forced_branch": lambda: shaken(3, 0.03, 1.68, 0.02, phase=(0.0, np.pi)),
    "forced_branch_upper": lambda: shaken(3, 0.03, 1.68, 0.02, phase=(0.0, np.pi)),
}


def reference(name):
    """The `Reference` of that name."""
    data = json.loads(Path(__file__).with_suffix(".json").read_text())[name]
    for key in ("u", "v", "multiplier_errors"):
        data[key] = np.array(data[key])
    data["multipliers"] = np.array(data["multipliers"]) @ [1, 1j]
    return Reference(LATTICES[name](), **data)


def covers(orbit, known):
    """Every displacement, velocity and the energy lie within the stated error of the truth."""
    for x, error, truth in zip(orbit.state, orbit.error.state, (known.u, known.v)):
        assert np.all(np.abs(x - truth) <= error + 2 * known.error)
    assert abs(orbit.energy - known.energy) <= orbit.error.energy + known.energy_error


# driven oscillators ---------------------------------------------------------------------------------------------------


def duffing(force, omega=1.2, K2=-1.0, K4=1.0, damping=0.3):
    """x'' + gamma x' + K2 x + K4 x^3 = f cos(omega t) on site 0, unforced on site 1.

    By default between two wells, with the textbook cascade of period doublings (Jordan and Smith, Nonlinear Ordinary
    Differential Equations, 2007).
    """
    law = gx.Polynomial(K2, 0.0, K4)
    terms = gx.OnSite(law), gx.Damping(damping), gx.Drive(gx.Harmonic(force, omega), 0)
    return gx.Lattice(jnp.ones(2), terms)


def flowed(y, periods, force, omega=1.2, K2=-1.0, K4=1.0, damping=0.3):
    """Site 0 of `duffing` by SciPy, with the derivative in the start (columns)."""

    def field(t, x):
        u = x[0]
        v = x[1]
        M = x[2:].reshape(2, 2)
        slope = np.array([[0.0, 1.0], [-K2 - 3 * K4 * u**2, -damping]])
        push = force * np.cos(omega * t) - damping * v - K2 * u - K4 * u**3
        return [v, push, *(slope @ M).ravel()]

    span = 0.0, periods * 2 * np.pi / omega
    end = solve_ivp(field, span, [*y, 1, 0, 0, 1], method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return end[:2], end[2:].reshape(2, 2)


def shooting(y, periods, force, **others):
    """The orbit of site 0 of `duffing` by SciPy and Newton's method, and its multipliers."""
    for _ in range(8):
        end, M = flowed(y, periods, force, **others)
        y = y - np.linalg.solve(M - np.eye(2), end - y)
    return y, np.linalg.eigvals(M)


def pair(omega, force=0.1, damping=0.05):
    """Two sites that move alike: x'' + gamma x' + x + x^3/10 = f cos(omega t)."""
    drive = gx.Harmonic(force, omega)
    law = gx.Polynomial(1.0, 0.0, 0.1)
    bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(0.3))
    terms = bond, gx.OnSite(law), gx.Damping(damping), gx.Drive(drive, 0), gx.Drive(drive, 1)
    return gx.Lattice(jnp.ones(2), terms)


def shaken_bond(strength, omega, damping=0.02):
    """Masses 1 and 2.3 on springs, at rest whatever is the strength at which the bond between them is modulated."""
    bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(1.0))
    bond = gx.Modulated(bond, gx.Harmonic(strength, omega, mean=1.0))
    return gx.Lattice(jnp.array([1.0, 2.3]), (bond, gx.OnSite(gx.Linear(1.0)), gx.Damping(damping)))


# the stiffness of `shaken_bond` over its masses, and its two frequencies
STIFFNESS = np.array([[2.0, -1.0], [-1.0 / 2.3, 2.0 / 2.3]])
MODES = np.sqrt(np.sort(np.linalg.eigvals(STIFFNESS)))


def period_of(omega, *_):
    return 2 * jnp.pi / omega
