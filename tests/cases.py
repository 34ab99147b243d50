"""The kinds that the invariant tests run over. A new law, strain map, term, lattice or solver is one line here."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import granjax as gx
from granjax import (
    Bond,
    Damping,
    Dashpot,
    Drive,
    Hertz,
    Linear,
    OnSite,
    Pairs,
    Polynomial,
    PowerLaw,
    Shift,
    Sine,
    Stretch,
    Toda,
    Wall,
)
from granjax.laws import Scaled, Strained
from granjax.strains import BOUNDARIES, StrainMap

EPS = float(np.finfo(float).eps)

SPLITTING = (
    gx.VelocityVerlet,
    gx.SRKN6b,
    gx.ABA864,
    gx.SRKN11b,
    gx.SRKN14a,
    gx.KahanLi8,
    gx.SofroniouSpaletta10,
)
NYSTROM = (gx.RKN86, gx.RKN1210)
ALL_SOLVERS = SPLITTING + NYSTROM


def ended(field, t1, start):
    """Where y' = field(t, y) has come to at t1, by SciPy."""
    return solve_ivp(field, (0, t1), start, "DOP853", rtol=1e-13, atol=1e-15).y[:, -1]


class Turning(gx.Term):
    """Gyroscopes, rate (v_y, -v_x), and a force that is odd between neighbours, odd (v_{n+1} - v_{n-1})."""

    rate: jax.Array
    odd: float = 0.0

    def force(self, t, u, v, mass):
        sideways = jnp.stack([v[..., 1], -v[..., 0]], -1)
        return self.rate * sideways + self.odd * (jnp.roll(v, -1, 0) - jnp.roll(v, 1, 0))


class Mirrored(gx.Law):
    """F(e) = -F_law(-e): what compresses the one stretches the other."""

    law: gx.Law

    def force(self, e):
        return -self.law.force(-e)

    def energy(self, e):
        return self.law.energy(-e)


def over(cases):
    """Parametrise a test over cases, each under its name."""
    return pytest.mark.parametrize("case", cases, ids=lambda case: case.name)


# the names of the programs that JAX says it compiles, in their order
heard = []


def _hear(event, seconds, **named):
    if event == "/jax/core/compile/backend_compile_duration":
        heard.append(named.get("fun_name", "a program"))


jax.monitoring.register_event_duration_secs_listener(_hear)


def legend(ax):
    """What the legend of a plot says, line by line."""
    return [text.get_text() for text in ax.get_legend().get_texts()]


def by_dop853(speed, t1, damping=0.0, dashpot=0.0, n=20):
    """Dense output (u, v) of n unit beads between rigid walls, d0 = 1, the first one struck, and the strains of u."""

    def strains(u):
        return np.concatenate([-u[:1], u[:-1] - u[1:], u[-1:]])

    def motion(t, y):
        f = np.maximum(1 + strains(y[:n]), 0) ** 1.5 - 1 + dashpot * strains(y[n:])
        return np.concatenate([y[n:], f[:-1] - f[1:] - damping * y[n:]])

    start = np.r_[np.zeros(n), speed, np.zeros(n - 1)]
    how = dict(method="DOP853", rtol=1e-10, atol=1e-12, dense_output=True)
    return solve_ivp(motion, (0, t1), start, **how).sol, strains


def assert_ulps(got, want, ulps, scale=None):
    """Equal to some units in the last place of a scale: the largest entry of `want` unless given."""
    got_leaves = jax.tree.leaves(got)
    want_leaves = jax.tree.leaves(want)
    assert jax.tree.structure(got) == jax.tree.structure(want)
    for g, w in zip(got_leaves, want_leaves):
        g = np.asarray(g)
        w = np.asarray(w)
        assert g.shape == w.shape
        size = np.max(np.abs(w), initial=0.0) if scale is None else scale
        np.testing.assert_allclose(g, w, rtol=0, atol=ulps * EPS * size)


def scaled_leaves(tree, factor):
    """Every floating parameter times a factor: another scene of the same structure."""
    return jax.tree.map(lambda x: x * factor, tree)


def random_like(tree, seed, size=0.1):
    """Random arrays of the shapes of a tree of shapes, arrays or `ShapeDtypeStruct`s."""
    rng = np.random.default_rng(seed)
    return jax.tree.map(
        lambda x: jnp.asarray(size * rng.normal(size=getattr(x, "shape", x))),
        tree,
        is_leaf=_is_shape,
    )


def _is_shape(x):
    return isinstance(x, tuple) and all(isinstance(n, int) for n in x)


# ---------------------------------------------------------------------------------------------------------------- laws


class LawCase(NamedTuple):
    """A law and compressions at which it is looked at, open and closed."""

    name: str
    law: gx.laws.Law
    strains: tuple = (-3.0, -0.5, -1e-3, 0.0, 1e-3, 0.3, 2.0, 50.0)


_SMOOTH = (-3.0, -0.5, -1e-3, 0.0, 1e-3, 0.3, 2.0, 5.0)
_MAGNETS = (-50.0, -3.0, -0.5, -1e-3, 0.0, 1e-3, 0.3, 0.6)

EXPONENTS = (1.0, 1.5, 2.0, 2.5, 3.0, 0.5, 1.37)

ALL_LAWS = (
    LawCase("hertz", Hertz()),
    LawCase("hertz_F0", Hertz(1.7, 0.9)),
    *(LawCase(f"power_{p}", PowerLaw(1.3, p)) for p in (1.5, 2.0, 0.5)),
    LawCase("power_1.37_F0", PowerLaw(1.3, 1.37, 0.7)),
    LawCase("power_array", PowerLaw(1.3, jnp.asarray(1.5))),
    LawCase("power_array_F0", PowerLaw(1.3, jnp.asarray(1.37), 0.7)),
    LawCase("magnets_-3", PowerLaw(1.3, -3.0, 0.7), _MAGNETS),
    LawCase("magnets_-1", PowerLaw(1.3, -1.0, 0.7), _MAGNETS),
    LawCase("magnets_array_-3", PowerLaw(1.3, jnp.asarray(-3.0), 0.7), _MAGNETS),
    LawCase("magnets_array_-1", PowerLaw(1.3, jnp.asarray(-1.0), 0.7), _MAGNETS),
    LawCase("polynomial_alpha", Polynomial(1.0, 0.25), _SMOOTH),
    LawCase("polynomial_full", Polynomial(1.1, -0.4, 0.3), _SMOOTH),
    LawCase("polynomial_cubic_alone", Polynomial(0.0, 0.0, 0.3), _SMOOTH),
    LawCase("toda", Toda(0.8, 1.3), _SMOOTH),
    LawCase("linear", Linear(1.3), _SMOOTH),
    LawCase("sine", Sine(0.9, 1.7), _SMOOTH),
    LawCase(
        "spline", gx.laws.Spline([-1.0, -0.3, 0.2, 1.0], [0.0, 0.7, 1.3, 1.1, 2.0], 0.4), _SMOOTH
    ),
    LawCase("sum_hertz_power", Hertz(1.0, 0.3) + PowerLaw(0.2, 2.5)),
    LawCase("sum_linear_sine", Linear(0.4) + Sine(0.9, 1.7), _SMOOTH),
    LawCase("scaled", Scaled(Hertz(1.0, 0.3), jnp.asarray(1.7))),
    LawCase("strained", Strained(Hertz(1.0, 0.3), jnp.asarray(0.4))),
    LawCase("strained_alike", Strained(Hertz(1.0, 0.3), jnp.asarray(0.4), jnp.asarray(0.4))),
    LawCase("yielding", gx.Yielding(Hertz(), 2.0)),
    LawCase("yielding_F0", gx.Yielding(Hertz(1.7, 0.9), 2.0)),
)

# --------------------------------------------------------------------------------------------------------- strain maps


class MapCase(NamedTuple):
    """A strain map and the shape of the displacements that it reads (a dict of shapes for fields)."""

    name: str
    map: StrainMap
    shape: object


class OwnMap(StrainMap):
    """A map of one's own that writes `strain` alone: everything else comes from the base class."""

    def strain(self, u):
        return u[:-1] - u[1:]


_TWO = {"bead": (6,), "resonator": (6,)}
_RING = (0, 1, 2, 3, 4, 5), (1, 2, 3, 4, 5, 0)
_VECTORS = np.array([[1.0, 0.0], [0.9, 0.3], [1.1, -0.2], [0.8, 0.5], [1.0, 0.1]])

ALL_STRAIN_MAPS = (
    *(MapCase(f"shift_{k}_{b}", Shift(k, b), (6,)) for k in (1, 2, -1) for b in BOUNDARIES),
    *(MapCase(f"shift_1_{b}_lanes", Shift(1, b), (6, 3)) for b in BOUNDARIES),
    MapCase("shift_grid_fixed_periodic", Shift((1, 1), ("fixed", "periodic")), (4, 5)),
    MapCase("shift_grid_periodic_free", Shift((1, 1), ("periodic", "free")), (4, 5)),
    MapCase("shift_grid_fixed_free", Shift((1, -1), ("fixed", "free")), (4, 5, 2)),
    MapCase("shift_grid_fixed_fixed", Shift((-1, 2), ("fixed", "fixed")), (4, 5)),
    MapCase("shift_own_field", Shift(1, "fixed", "bead"), _TWO),
    MapCase("shift_within_cell", Shift(0, "free", ("bead", "resonator")), _TWO),
    MapCase("shift_between_fields_free", Shift(1, "free", ("bead", "resonator")), _TWO),
    MapCase("shift_between_fields_fixed", Shift(1, "fixed", ("bead", "resonator")), _TWO),
    MapCase("pairs_graph", Pairs([0, 0, 3, 2], [1, 3, 2, 1]), (4,)),
    MapCase("pairs_walls", Pairs([-1, 0, 1, 2, 0], [0, 1, 2, -1, 2]), (3,)),
    MapCase("pairs_isolated_last_sites", Pairs([0, 1], [1, 2], sites=6), (6, 2)),
    MapCase(
        "pairs_fields",
        Pairs([0, 2, -1], [1, 3, 0], sites=(6, 6), fields=("bead", "resonator")),
        _TWO,
    ),
    MapCase("stretch_shift_free", Stretch(Shift(1, "free"), [0.8, 0.6]), (6, 2)),
    MapCase("stretch_shift_fixed_lanes", Stretch(Shift(1, "fixed"), [1.0, 0.0]), (6, 2, 3)),
    MapCase(
        "stretch_shift_periodic_space",
        Stretch(Shift(1, "periodic"), [0.2, 1.0, -0.4]),
        (5, 3),
    ),
    MapCase("stretch_grid", Stretch(Shift((1, 1), ("periodic", "free")), [-0.5, 0.8]), (4, 5, 2)),
    MapCase(
        "stretch_pairs_own_vectors",
        Stretch(Pairs([0, 1, 2, 3, 4], [1, 2, 3, 4, 5]), _VECTORS),
        (6, 2),
    ),
    MapCase("stretch_pairs_space_lanes", Stretch(Pairs(*_RING), [0.0, 0.6, 0.8]), (6, 3, 2)),
    MapCase("stretch_of_beads_that_turn", Stretch(Shift(1, "fixed"), [0.8, 0.6]), (6, 3)),
    MapCase("slip", gx.strains.Slip(Shift((1, -1), ("free", "periodic")), [0.8, 0.6]), (4, 5, 3)),
    MapCase("along", gx.strains.Along(Shift(1, "fixed"), [0.8, -0.6]), (6, 2)),
    MapCase("along_lanes", gx.strains.Along(Pairs(*_RING), [0.0, 0.0, 1.0]), (6, 3, 2)),
    MapCase(
        "pairs_weights",
        Pairs([0, 1, 1], [1, 2, 3], sites=5, weights=([0.5, 1.0, 2.0], 1.5)),
        (5, 2),
    ),
    MapCase("own_map", OwnMap(), (6,)),
)

LINEAR_MAPS = tuple(case for case in ALL_STRAIN_MAPS if hasattr(case.map, "gather"))

# ------------------------------------------------------------------------------------------------- terms and lattices


class LatticeCase(NamedTuple):
    """A lattice; `inner` says that only forces between its own sites act, so that momentum is kept."""

    name: str
    lattice: gx.Lattice
    inner: bool = False


_MASSES = np.array([1.0, 0.5, 1.0, 0.7, 1.2, 0.9])
_CELL = {"bead": _MASSES, "resonator": np.full(6, 0.3)}
_WAVE = gx.Harmonic(0.3, 1.7, phase=0.4)
_TURNING = Stretch(Shift(1, "free"), [1.0, 0.0])
_ALGEBRAIC = np.arange(1.0, 13) ** -3
_GRID = np.linspace(0.8, 1.3, 20).reshape(4, 5)


def _at_rest(t):
    return 0.1 * jnp.sin(t)


def _case(name, *terms, mass=_MASSES, inner=False, **how):
    return LatticeCase(name, gx.Lattice(mass, terms, **how), inner)


ALL_TERMS = (
    _case("bond_hertz_fixed", Bond(Shift(1, "fixed"), Hertz())),
    _case("bond_F0_periodic", Bond(Shift(1, "periodic"), Hertz(1.2, 0.8)), inner=True),
    _case("bond_second_neighbour_free", Bond(Shift(2, "free"), Toda()), inner=True),
    _case("bond_disorder", Bond(Shift(1, "fixed"), Hertz(np.linspace(1, 2, 7), 0.5))),
    _case("bond_own_map", Bond(OwnMap(), Hertz(1.2, 0.8)), inner=True),
    _case(
        "grip",
        Bond(_TURNING, Hertz(1.0, 0.2)),
        gx.terms.Grip(
            gx.strains.Slip(_TURNING.pairs, _TURNING.vector),
            Linear(0.7),
            Bond(_TURNING, Hertz(1.0, 0.2)),
        ),
        dimension=3,
    ),
    _case("bond_magnets", Bond(Shift(1, "fixed"), PowerLaw(1.0, -3.0, 1.0))),
    _case(
        "bond_exponents",
        Bond(Shift(1, "free"), PowerLaw(1.0, np.linspace(1.2, 3, 5), 1.0)),
        inner=True,
    ),
    _case(
        "long_range_ring",
        gx.LongRange(_ALGEBRAIC, Polynomial(1.0, 0.3, 0.2), "periodic"),
        inner=True,
    ),
    _case(
        "long_range_magnets",
        gx.LongRange(_ALGEBRAIC, PowerLaw(1.0, -3.0, 1.0), "fixed", takes="strain"),
    ),
    _case("onsite_sine", OnSite(Sine(1.0, 2.0))),
    _case("damping_per_site", Damping(np.linspace(0, 1, 6))),
    _case("dashpot_fixed", Dashpot(Shift(1, "fixed"), np.linspace(0, 1, 7))),
    _case(
        "dashpot_plane",
        Dashpot(Stretch(Shift(1, "free"), [0.8, 0.6]), 0.3),
        dimension=2,
        inner=True,
    ),
    _case("viscous_contact", gx.ViscousContact(Shift(1, "free"), 0.3, overlap=0.2), inner=True),
    _case("drag", gx.Drag(np.linspace(0.1, 1, 6))),
    _case("drive", Drive(_WAVE, 2)),
    _case("wall_left", Wall(Hertz(1.2, 0.8), "left")),
    _case("wall_driven_right", Wall(Hertz(1.2), "right", motion=_WAVE)),
    _case("wall_yielding", Wall(Hertz(1.2, 0.8), "right", support=3.0)),
    _case(
        "modulated_bond",
        gx.Modulated(
            Bond(Shift(1, "periodic"), Hertz(1.0, 0.5)),
            gx.Harmonic(0.1, 2.0, np.linspace(0, 3, 6), mean=1.0),
        ),
        inner=True,
    ),
    _case("modulated_onsite", gx.Modulated(OnSite(Linear()), _at_rest)),
)

_TRIANGULAR = tuple(
    Bond(
        Stretch(Shift(offset, "periodic"), vector),
        Polynomial(1.0, 0.3) + Hertz(0.5, 0.2),
    )
    for offset, vector in (
        ((1, 0), [1.0, 0.0]),
        ((0, 1), [0.5, 0.75**0.5]),
        ((-1, 1), [-0.5, 0.75**0.5]),
    )
)

MASS_IN_MASS = gx.Lattice(
    _CELL,
    (
        Bond(Shift(1, "fixed", "bead"), Hertz(1.0, 0.4)),
        Bond(Shift(0, "free", ("bead", "resonator")), Linear(0.7)),
        Damping(0.05, "resonator"),
        Drive(_WAVE, 0, "bead"),
        OnSite(Linear(0.2), "resonator"),
    ),
)

SCENES = (
    _case(
        "composed",
        Bond(Shift(1, "free"), Hertz(1.0, 0.4)),
        Bond(Shift(2, "free"), Linear(0.1)),
        Wall(Hertz(1.4, 0.4), "left", motion=_WAVE),
        Wall(Hertz(1.4, 0.4), "right", support=5.0),
        OnSite(Sine(0.1)),
        Damping(0.02),
        Dashpot(Shift(1, "free"), 0.01),
        Drive(_WAVE, 3),
    ),
    _case("triangular", *_TRIANGULAR, mass=_GRID, dimension=2, inner=True),
    _case(
        "grid_scalar",
        Bond(Shift((1, 0), "free"), Hertz()),
        Bond(Shift((0, 1), "periodic"), Toda()),
        mass=_GRID,
        inner=True,
    ),
    _case(
        "helix_in_space",
        Bond(Stretch(Shift(1, "fixed"), [1.0, 0.0, 0.0]), Hertz(1.0, 0.4)),
        mass=1.0,
        sites=6,
        dimension=3,
    ),
    LatticeCase("mass_in_mass", MASS_IN_MASS),
)

ALL_LATTICES = ALL_TERMS + SCENES
# every one runs code of its own
DISTINCT = ALL_LATTICES
