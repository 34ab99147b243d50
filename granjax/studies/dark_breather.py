"""A dark breather from rest: two waves from shaking walls that cancel in the middle of a steel chain."""

import math
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from ..checks import positive, refuse
from ..checks import tolerance as checked_tolerance
from ..driven import Attractor, driven_chain, settle
from ..lattice import Lattice, State
from ..linear import normal_modes
from ..materials import Material, hertz_coefficient
from ..orbits.attractors import largest
from ..results import SI, Held, Result
from ..scenes import monomer
from ..states import places
from ..types import Count, Parameter, Scalar

YOUNG, POISSON, MASS, RADIUS = 200e9, 0.3, 28.2e-3, 9.53e-3
PRECOMPRESSION, DAMPING_TIME = 10.0, 5e-3
STEPS, HARMONICS = 48, 6


def steel_chain(sites: Count = 21, precompression: Scalar = PRECOMPRESSION) -> Lattice:
    """Precompressed steel beads between walls that are felt as beads, in SI: 28.2 g, 9.53 mm, E = 200 GPa, nu = 0.3.

    **Returns:** a `Lattice` without damping; A = 1.0114e10 N/m^{3/2}, d0 = 0.992 um and cut-off 7369 Hz at F0 = 10 N.
    Source: Chong, Li, Yang, Williams, Kevrekidis, Kevrekidis, Daraio, Phys. Rev. E 89, 032924 (2014).

    **Example:**

    >>> chain = gx.studies.steel_chain()
    >>> round(float(gx.linear.bands(chain).upper[0]) / (2 * np.pi))  # Hz
    7369
    """
    steel = Material("steel", YOUNG, POISSON, MASS / (4 / 3 * math.pi * RADIUS**3))
    return monomer(sites, MASS, hertz_coefficient(steel, RADIUS), precompression=precompression).counted_in("SI")


class DarkBreather(Result):
    """What `dark_by_interference` returns, in SI.

    - `attractor`: where the chain has settled. `lattice`: the driven chain. `frequency`, `highest_mode` of
      the chain between its walls [Hz].
    - `velocity` (N,): largest speed of each bead [m/s]. `strain` (N + 1,): largest compression |u_n - u_{n+1}| of each
      contact, walls included [m].
    - `background`: mean largest speed of the beads further than a quarter of the chain from the middle. `depth`:
      1 - v_middle/background, 1 where the middle is at rest. `width`: sites between the two places where the speed
      reaches half of the background, by interpolation.
    - `staggering`: mean correlation of neighbours' velocities outside of the middle, -1 for an alternating chain.
    - `harmonics` (6, N): amplitudes of the velocities at 1 ... 6 times the frequency [m/s].

    **Example:**

    >>> found = gx.studies.dark_by_interference(gx.studies.steel_chain(5), periods=8)
    >>> found.velocity.shape, found.harmonics.shape
    ((5,), (6, 5))
    """

    _else: ClassVar[str | None] = SI
    held: ClassVar[dict[str, Held]] = {
        "velocity": Held("site", "m/s"), "strain": Held("contact", "m"), "harmonics": Held("harmonic site", "m/s"),
        "frequency": Held(unit="Hz"), "highest_mode": Held(unit="Hz"), "background": Held(unit="m/s"),
    }
    attractor: Attractor
    lattice: Lattice
    frequency: float
    highest_mode: float
    velocity: Float[np.ndarray, " N"]
    strain: Float[np.ndarray, " contacts"]
    background: float
    depth: float
    width: float
    staggering: float
    harmonics: Float[np.ndarray, "harmonics N"]

    @property
    def outcome(self) -> str:
        """What became of the motion, a sentence."""
        return self.attractor.outcome


def dark_by_interference(
    lattice: Lattice | None = None, *, amplitude: Scalar = 0.2e-6, frequency: Scalar = 7290.0,
    damping_time: Scalar = DAMPING_TIME, phase: Parameter = (0.0, math.pi), periods: Count = 8000,
    tolerance: Scalar = 1e-8,
) -> DarkBreather:
    r"""Drive both walls of a precompressed chain just below its cut-off, from rest, until it settles.

    The walls push towards the chain at the same time, u_0 = a cos(omega t) and u_{N+1} = -a cos(omega t), as two
    actuators that face each other do with one signal; by the mirror symmetry of the chain the two waves then cancel at
    the middle bead of an odd chain. Walls that move in the same direction, phase = (0, 0), make an antinode there.

    **Arguments:** `lattice`: an odd number of beads between fixed walls, by default `steel_chain()`; `amplitude` [m];
    `frequency` [Hz]; `damping_time`: tau [s]; `phase`: of the left and right wall; `periods`, `tolerance`: as in
    `settle`.

    **Returns:** `DarkBreather`. **Raises** ValueError as `driven_chain` and `settle` do.
    Measured: settled after 3112 periods, middle bead at rest to 2e-8, background 11 mm/s, 3.7 sites wide, the ends
    at 0.89 of the largest speed; 0.02 um makes the arches of a sine instead (0.38). From 0.20324 um on (at 7290 Hz) the
    orbit is unstable by a Neimark-Sacker bifurcation; at 0.3 um the motion is chaotic, its exponent 0.065 a period.
    Source: as `steel_chain`.

    **Example:**

    >>> found = gx.studies.dark_by_interference(gx.studies.steel_chain(5), periods=8)
    >>> bool(found.velocity[2] < 1e-5 * found.velocity.max())  # the middle bead is at rest
    True
    """
    tolerance = checked_tolerance("tolerance", tolerance)
    lattice = steel_chain() if lattice is None else lattice
    sites = places.chain_only(lattice, "a dark breather")
    if sites < 5:
        refuse("lattice", "a chain of at least five beads", f"one of {sites}")
    frequency, damping_time = float(positive("frequency", frequency)), positive("damping_time", damping_time)
    omega = 2 * math.pi * frequency
    if not omega < math.inf:
        refuse("frequency", "one whose 2 pi fold is a number", f"{frequency:g}")
    driven = driven_chain(lattice, amplitude, omega, damping=1 / damping_time, phase=phase)
    highest = float(normal_modes(lattice).omega[-1]) / (2 * math.pi)
    rest = State(lattice.zeros(), lattice.zeros())
    found = settle(driven, rest, 2 * math.pi / omega, periods=periods, tolerance=tolerance, steps=STEPS)
    u, v = np.asarray(found.us), np.asarray(found.vs)
    left, right = phase if isinstance(phase, (tuple, list)) else (phase, phase)
    walls = [amplitude * np.cos(omega * np.asarray(found.ts) + p)[:, None] for p in (left, right)]
    strain = np.asarray(largest(np.abs(np.diff(np.concatenate([walls[0], u, walls[1]], 1), axis=1))))
    speed, middle = np.asarray(found.amplitude), sites // 2
    away = np.abs(np.arange(sites) - middle)
    background = speed[away > sites // 4].mean()
    neighbours = (v[:, :-1] * v[:, 1:]).mean(0) / np.sqrt((v[:, :-1] ** 2).mean(0) * (v[:, 1:] ** 2).mean(0))
    outer = np.minimum(away[:-1], away[1:]) > 0
    spectrum = 2 * np.abs(np.fft.rfft(v, axis=0)) / len(v)
    repeats = len(v) // STEPS
    return DarkBreather(
        found, driven, float(frequency), highest, speed, strain, float(background),
        float(1 - speed[middle] / background), _width(speed, middle, background / 2), float(neighbours[outer].mean()),
        spectrum[repeats : (HARMONICS + 1) * repeats : repeats],
    )


def _width(speed, middle, level):
    """Sites between the places left and right of the middle where the speed first passes a level; 0 without a dip."""
    total = 0.0
    for side in (speed[middle:], speed[middle::-1]):
        above = np.flatnonzero(side > level)
        if not len(above) or above[0] == 0:
            return 0.0
        n = above[0]
        total += n - 1 + (level - side[n - 1]) / (side[n] - side[n - 1])
    return float(total)
