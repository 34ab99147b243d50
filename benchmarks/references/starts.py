"""Where the scenes start that do not start from exact numbers; made once, in extended precision, and stored."""

import numpy as np
from scenes import BREATHER_FREQUENCY, HEAVY, LIGHT

from .equations import Tangents
from .integrators import EXTENDED, extrapolation

SEED = 1
BEADS = 81
CENTRE = 40
AMPLITUDES = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
CLOSED = 1e-15
MOST_STEPS = 20
PI = 4 * np.arctan(EXTENDED(1))


def starts(name):
    """Displacements and velocities at t0 as float64, a dict `start_u`, `start_v`; empty for a scene that needs none."""
    if name not in _STARTS:
        return {}
    u = _STARTS[name]()
    u, v = u if isinstance(u, tuple) else (u, np.zeros_like(u))
    return {"start_u": u.astype(float), "start_v": v.astype(float)}


def sine(sites, k, amplitude):
    """Sine k between fixed ends."""
    return EXTENDED(amplitude) * np.sin(PI * k * np.arange(1, sites + 1) / (sites + 1))


def soliton(t, sites=100, centre=27):
    """(u, v) of a Toda soliton with k = 1: u_n = ln(cosh(x - k)/cosh x) + k, x = k (n - centre) - t sinh k.

    Compression exp(y_n) = 1 + sinh^2 k sech^2 x. Source: M. Toda, J. Phys. Soc. Japan 22, 431 (1967).
    """
    k = EXTENDED(1)
    x = k * (np.arange(sites) - centre) - EXTENDED(t) * np.sinh(k)
    ahead = np.log1p(np.exp(2 * k - 2 * x)) - np.log1p(np.exp(-2 * x))
    behind = 2 * k + np.log1p(np.exp(2 * x - 2 * k)) - np.log1p(np.exp(2 * x))
    return np.where(2 * x > k, ahead, behind), np.sinh(k) ** 2 / (np.cosh(x) * np.cosh(x - k))


def breather():
    """Displacements of the gap breather at rest, the last bead's zero.

    Newton's method on v(T/2) = 0 for the strains, which are at rest at t = 0: from the lowest optical mode along
    growing strains behind the middle bead, the frequency free, and then at the frequency wanted.
    """
    mass = np.where(np.arange(BEADS) % 2 == 0, LIGHT, HEAVY)
    rise = np.triu(np.ones((BEADS, BEADS)))[:, : BEADS - 1]
    strain, omega = _optical_mode(mass)
    for amplitude in (*AMPLITUDES, None):
        if amplitude is None:
            omega = BREATHER_FREQUENCY
            free = np.ones(BEADS - 1, bool)
        else:
            strain = strain * amplitude / strain[CENTRE]
            free = np.arange(BEADS - 1) != CENTRE
        strain, omega = _newton(mass, rise, strain, omega, free)
    return rise @ strain


def _optical_mode(mass):
    """Strains and frequency of the lowest mode above the gap of the linear chain with free ends."""
    spring = np.diff(np.eye(BEADS), axis=0)
    squares, modes = np.linalg.eigh(1.5 * spring.T @ spring / np.sqrt(np.outer(mass, mass)))
    optical = np.argmax(squares > 0.99 * 1.5 * 2 / LIGHT)
    return -spring @ (modes[:, optical] / np.sqrt(mass)), np.sqrt(squares[optical])


def _newton(mass, rise, strain, omega, free):
    """Strains and frequency of a breather; of the frequency and the strains those vary that are `free`."""
    equation = Tangents(mass)
    for _ in range(MOST_STEPS):
        lanes = np.concatenate([(rise @ strain)[:, None], rise[:, free]], 1).astype(EXTENDED)
        half = np.pi / omega
        u, v = extrapolation(equation, 0, half, lanes, np.zeros_like(lanes), CLOSED, together=True)
        left = -v[:, 0]
        slope = v[:, 1:]
        if not free.all():
            slope = np.concatenate([slope, -half / omega * equation(half, u, v)[:, :1]], 1)
        step = np.linalg.lstsq(slope.astype(float), left.astype(float), rcond=1e-13)[0]
        strain = strain.copy()
        strain[free] += step[: free.sum()]
        omega = omega if free.all() else omega + step[-1]
        if np.abs(step).max() < 1e-12:
            return strain, omega
    raise RuntimeError(
        f"Newton's method for the breather has not converged: last step {np.abs(step).max():.1e}"
    )


_STARTS = {
    "smooth": lambda: np.random.default_rng(SEED).uniform(-0.1, 0.1, 128),
    "monodromy": breather,
    "toda_soliton": lambda: soliton(0),
    "fput": lambda: sine(31, 1, 1),
    "light_dimer": lambda: sine(61, 3, 0.5),
    "modulated": lambda: sine(63, 16, 0.02),
}
