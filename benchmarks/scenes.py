"""Canonical scenes: a test set of lattice problems with references far below the error of any run in double precision.

    from scenes import scene
    impact = scene("impact")
    run = gx.simulate(impact.lattice, impact.state, impact.t1, t0=impact.t0)
    error = impact.error(run.final)

Every reference was calculated twice, by two unrelated methods in 80-bit numbers; `make_references.py` makes them again
and writes them to `references/data`.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import granjax as gx

DATA = Path(__file__).parent / "references" / "data"
LIGHT = 1.0
HEAVY = 2.957949
BREATHER_FREQUENCY = 0.985 * np.sqrt(3.0)
RATIOS = np.linspace(0.2, 1.0, 256)
SHOCK = 0.5


class Stored(NamedTuple):
    """What a data file holds.

    `start_u`, `start_v`: where the scene starts, if that is not a matter of exact numbers. `u`, `v`: the reference at
    `t1`, `matrix` for a map of tangents. `uncertainty`, `growth`: see `Scene`. `method`, `date`: how and when it was
    made.
    """

    start_u: np.ndarray | None = None
    start_v: np.ndarray | None = None
    u: np.ndarray | None = None
    v: np.ndarray | None = None
    matrix: np.ndarray | None = None
    t1: float = np.nan
    uncertainty: float = np.nan
    growth: float = np.nan
    method: str = ""
    date: str = ""


@cache
def read(name: str) -> Stored:
    """Read the data of a scene; its arrays cannot be written to."""
    with np.load(DATA / f"{name}.npz") as data:
        arrays = {key: data[key] for key in data.files}
    for x in arrays.values():
        x.flags.writeable = False
    return Stored(**{key: x if x.ndim else x.item() for key, x in arrays.items()})


def unfolded(data: Stored, sites: int) -> tuple[np.ndarray, np.ndarray]:
    """Give displacements and velocities of all sites.

    A window shorter than the chain is the half right of the middle of an odd motion, u(-n) = -u(n); further out all
    moves with the velocity it started with.
    """
    if data.u.shape[0] == sites:
        return data.u, data.v
    inner = data.u.shape[0]
    half = sites // 2
    out = []
    for x, far in ((data.u, data.v[-1] * data.t1), (data.v, data.v[-1])):
        right = np.full(half, far)
        right[:inner] = x
        out.append(np.concatenate([-right[::-1], right]))
    return tuple(out)


class Scene(NamedTuple):
    """One canonical scene.

    - `name`; `title`; `note`: what it is for, its horizon, its source.
    - `lattice`, `state`: where it starts; `t0`, `t1`: from when to when.
    - `reference`: the state at t1, a `State` of NumPy arrays in float64. Where `tangents`: the map of tangents from
      t0 to t1, a NumPy array (2N, 2N), whose rows are (u, v) at t1 and whose columns (u, v) at t0.
    - `uncertainty`: by how much two unrelated calculations of the reference differ, in the measure of `error`.
    - `growth`: how much a disturbance of the start has grown at t1 (noise on every site, 1e-12 of the largest
      displacement and velocity); of a map of tangents its largest entry. A run in double precision cannot do much
      better than 1e-16 times it, times the root of the number of its steps.
    - `smooth`: whether the force is smooth all along: no contact opens or closes.
    """

    name: str
    title: str
    note: str
    lattice: gx.Lattice
    state: gx.State
    t0: float
    t1: float
    reference: gx.State | np.ndarray
    uncertainty: float
    growth: float
    smooth: bool
    tangents: bool

    def error(self, final: Any) -> float:
        """max(max|du|/max|u|, max|dv|/max|v|) of a final state against the reference; max|dM|/max|M| of a map."""
        return measure(final, self.reference)


def measure(found: Any, reference: Any) -> float:
    """The relative difference of two states, or of two maps of tangents, as in `Scene.error`."""
    pairs = ((found, reference),) if isinstance(reference, np.ndarray) else zip(found, reference)
    return max(float(np.abs(np.asarray(x) - y).max() / np.abs(y).max()) for x, y in pairs)


class Recipe(NamedTuple):
    """How a scene is composed: `build(start)` gives lattice and state; `start` is what the data file holds, if any."""

    title: str
    note: str
    build: Callable[[Stored], tuple[gx.Lattice, gx.State]]
    t1: float
    smooth: bool = True
    tangents: bool = False


def names() -> tuple[str, ...]:
    """Give the names of the canonical scenes."""
    return tuple(RECIPES)


def scene(name: str) -> Scene:
    """Build a canonical scene by its name."""
    recipe = RECIPES[name]
    data = read(name)
    lattice, state = recipe.build(data)
    reference = data.matrix if recipe.tangents else gx.State(*unfolded(data, lattice.shape[0]))
    horizon = f"Horizon: t = {recipe.t1:g}, where a disturbance of the start is {data.growth:.2g} times what it was."
    return Scene(
        name,
        recipe.title,
        f"{recipe.note} {horizon}",
        lattice,
        state,
        0.0,
        recipe.t1,
        reference,
        data.uncertainty,
        data.growth,
        recipe.smooth,
        recipe.tangents,
    )


def _struck(lattice, velocity=1.0):
    return lattice, gx.states.impact(lattice, velocity=velocity)


def _started(lattice, data):
    return lattice, gx.State(jax.numpy.asarray(data.start_u), jax.numpy.asarray(data.start_v))


def _sweep():
    chains = jax.vmap(lambda ratio: gx.scenes.dimer(60, ratio=ratio), out_axes=-1)(RATIOS)
    return _struck(chains)


def _shock(sites):
    chain = gx.scenes.toda(sites)
    return chain, gx.states.velocity_step(chain, SHOCK)


def _driven():
    mass = np.where(np.arange(41) % 2 == 0, 1.0, 0.338)
    contact = gx.Hertz(1.0, 1.0)
    # a cosine a quarter of a period late: the wall starts from rest position
    motion = gx.Harmonic(0.1, 1.0, -np.pi / 2)
    terms = (
        gx.Bond(gx.Shift(1, "free"), contact),
        gx.Wall(contact, "left", motion=motion),
        gx.Wall(contact, "right"),
        gx.Damping(0.02),
        gx.Dashpot(gx.Shift(1, "free"), 0.05),
    )
    lattice = gx.Lattice(mass, terms)
    return lattice, gx.states.rest(lattice)


def _modulated(data):
    bond = gx.Modulated(
        gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(1.0, 1.0)), gx.Harmonic(0.1, 1.875, mean=1.0)
    )
    return _started(gx.Lattice(1.0, (bond,), sites=63), data)


_IMPACT = (
    "Contacts open and close all the time, so that the force is only once differentiable: every fixed step has order "
    "about 5/2, whatever its name. Source: Nesterenko, J. Appl. Mech. Tech. Phys. 24, 733 (1983)."
)
_SHOCK_NOTE = (
    "c = 1/2, sites at the middle collide with 2c each; the rest of the chain moves as a whole until the front comes, "
    "which is stored for the middle alone. Source: Venakides, Deift, Oba, Comm. Pure Appl. Math. 44, 1171 (1991)."
)

RECIPES = {
    "impact": Recipe(
        "Impact on 100 beads between walls, no precompression",
        "Bead 0 is struck with v = 1. " + _IMPACT,
        lambda data: _struck(gx.scenes.monomer(100)),
        120.0,
        smooth=False,
    ),
    "impact_free": Recipe(
        "Impact on 100 beads with free ends, no precompression",
        "Bead 0 is struck with v = 1; at the far end beads fly off. " + _IMPACT,
        lambda data: _struck(gx.scenes.monomer(100, boundary="free")),
        120.0,
        smooth=False,
    ),
    "smooth": Recipe(
        "Precompressed random chain, 128 beads",
        "Displacements uniform in +-0.1 of the static overlap, at rest, rigid walls: no contact opens, so that every "
        "method has its full order, and a long run shows what rounding leaves.",
        lambda data: _started(gx.scenes.monomer(128, precompression=1.0), data),
        2000.0,
    ),
    "dimer_sweep": Recipe(
        "Impact on 256 dimers of 60 beads as lanes, mass ratios 0.2 ... 1",
        "Heavy bead 0 struck with v = 1, no precompression, rigid walls: the sweep for resonances and anti-resonances, "
        "until the pulse is about two thirds down the chain. Light beads rattle, each lane at its own times. Source: "
        "Jayaprakash, Starosvetsky, Vakakis, Phys. Rev. E 83, 036606 (2011).",
        lambda data: _sweep(),
        40.0,
        smooth=False,
    ),
    "monodromy": Recipe(
        "Monodromy of a gap breather in a dimer of 81 beads",
        "One period of the breather of frequency 0.985 sqrt(3) centred on the light bead 40, unstable with a real "
        "multiplier 1.1266; masses 1 and 2.957949, precompressed, constant force at both ends. Source: Theocharis et "
        "al., Phys. Rev. E 82, 056604 (2010).",
        lambda data: _started(
            gx.scenes.pattern(81, (LIGHT, HEAVY), precompression=1.0, boundary="free"), data
        ),
        float(2 * np.pi / BREATHER_FREQUENCY),
        tangents=True,
    ),
    "toda_soliton": Recipe(
        "One Toda soliton, 100 sites",
        "k = 1, from site 27 to 74; the reference is the closed form. Source: Toda, J. Phys. Soc. Japan 22, 431 "
        "(1967).",
        lambda data: _started(gx.scenes.toda(100), data),
        40.0,
    ),
    "toda_shock_1e4": Recipe(
        "Toda velocity shock, ten thousand sites", _SHOCK_NOTE, lambda data: _shock(10000), 200.0
    ),
    "toda_shock_1e5": Recipe(
        "Toda velocity shock, a hundred thousand sites",
        _SHOCK_NOTE,
        lambda data: _shock(100000),
        50.0,
    ),
    "fput": Recipe(
        "Recurrence of Fermi, Pasta, Ulam and Tsingou",
        "31 moving masses, alpha = 1/4, first mode with a = 1, until 98.13 % of the energy is back in it. Long and "
        "nearly regular: phase errors show. Source: Los Alamos report LA-1940 (1955).",
        lambda data: _started(gx.scenes.fput(31), data),
        9376.5,
    ),
    "driven": Recipe(
        "Damped chain driven by a wall, 41 beads",
        "Dimer of mass ratio 0.338, precompressed, left wall at 0.1 sin t, damping 0.02 of each bead and dashpots "
        "0.05 between them, from rest: forces that read the velocity, which splitting methods do not take. Source: "
        "Hoogeboom et al., EPL 101, 44003 (2013), for the setting.",
        lambda data: _driven(),
        100.0,
    ),
    "light_dimer": Recipe(
        "Dimer of mass ratio 0.01, 61 beads",
        "Precompressed, rigid walls, a long wave of three half waves and amplitude 1/2: the light beads follow, their "
        "own frequency 17.4 paces the step, ten times that of all that moves much.",
        lambda data: _started(gx.scenes.dimer(61, ratio=0.01, precompression=1.0), data),
        100.0,
    ),
    "softening": Recipe(
        "Impact on a softening chain, exponent 1/2, 100 beads",
        "Precompressed, free ends, bead 0 struck with v = 0.5. Contacts stay closed; where one opened it would be "
        "infinitely stiff. Source: Herbold, Nesterenko, Phys. Rev. Lett. 110, 144101 (2013).",
        lambda data: _struck(
            gx.scenes.monomer(100, exponent=0.5, precompression=1.0, boundary="free"), 0.5
        ),
        100.0,
    ),
    "magnets": Recipe(
        "Impact on a chain of repelling magnets, exponent -3, 100 sites",
        "Static force 1, free ends, site 0 struck with v = 1. Source: Mehrem, Jimenez, Salmeron-Contreras et al., "
        "Phys. Rev. E 96, 012208 (2017), for the setting.",
        lambda data: _struck(
            gx.scenes.monomer(100, exponent=-3, precompression=1.0, boundary="free"), 1.0
        ),
        50.0,
    ),
    "modulated": Recipe(
        "Chain with contacts modulated in time, 63 beads",
        "Precompressed, rigid walls; all stiffnesses times 1 + 0.1 cos(1.875 t), twice the frequency of the sixteenth "
        "sine, from which it starts with amplitude 0.02 and which grows.",
        _modulated,
        100.0,
    ),
}
