"""The kinds that the invariant tests run over. A new law, strain map, term, lattice or solver is one line here."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import granjax as gx
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


class Mirrored(gx.Law):
    """F(e) = -F_law(-e): what compresses the one stretches the other."""

    law: gx.Law

    def force(self, e):
        return -self.law.force(-e)

    def energy(self, e):
        return self.law.energy(-e)


def few(values, *kept):
    """Values of a parameter of slow tests: those in `kept`, by their place, run in every CI, all of them in a study."""
    chosen = {i % len(values) for i in kept}
    return [
        v
        if i in chosen
        else pytest.param(*v if type(v) is tuple else (v,), marks=pytest.mark.study)
        for i, v in enumerate(values)
    ]


def over(cases, repeated=()):
    """Parametrise a test over cases, each under its name; those that `repeated` names are a study."""
    marked = [
        pytest.param(case, id=case.name, marks=[pytest.mark.study] * (case.name in repeated))
        for case in cases
    ]
    return pytest.mark.parametrize("case", marked)


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
    got_leaves, want_leaves = jax.tree.leaves(got), jax.tree.leaves(want)
    assert jax.tree.structure(got) == jax.tree.structure(want)
    for g, w in zip(got_leaves, want_leaves):
        g, w = np.asarray(g), np.asarray(w)
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
    LawCase("hertz", gx.Hertz()),
    LawCase("hertz_F0", gx.Hertz(1.7, 0.9)),
    *(LawCase(f"power_{p}", gx.PowerLaw(1.3, p)) for p in EXPONENTS),
    *(LawCase(f"power_{p}_F0", gx.PowerLaw(1.3, p, 0.7)) for p in EXPONENTS),
    LawCase("power_array", gx.PowerLaw(1.3, jnp.asarray(1.5))),
    LawCase("power_array_F0", gx.PowerLaw(1.3, jnp.asarray(1.37), 0.7)),
    LawCase("magnets_-3", gx.PowerLaw(1.3, -3.0, 0.7), _MAGNETS),
    LawCase("magnets_-1", gx.PowerLaw(1.3, -1.0, 0.7), _MAGNETS),
    LawCase("magnets_array_-3", gx.PowerLaw(1.3, jnp.asarray(-3.0), 0.7), _MAGNETS),
    LawCase("magnets_array_-1", gx.PowerLaw(1.3, jnp.asarray(-1.0), 0.7), _MAGNETS),
    LawCase("polynomial_alpha", gx.Polynomial(1.0, 0.25), _SMOOTH),
    LawCase("polynomial_beta", gx.Polynomial(1.0, 0.0, 0.7), _SMOOTH),
    LawCase("polynomial_full", gx.Polynomial(1.1, -0.4, 0.3), _SMOOTH),
    LawCase("polynomial_cubic_alone", gx.Polynomial(0.0, 0.0, 0.3), _SMOOTH),
    LawCase("toda", gx.Toda(0.8, 1.3), _SMOOTH),
    LawCase("linear", gx.Linear(1.3), _SMOOTH),
    LawCase("sine", gx.Sine(0.9, 1.7), _SMOOTH),
    LawCase(
        "spline", gx.laws.Spline([-1.0, -0.3, 0.2, 1.0], [0.0, 0.7, 1.3, 1.1, 2.0], 0.4), _SMOOTH
    ),
    LawCase("sum_hertz_power", gx.Hertz(1.0, 0.3) + gx.PowerLaw(0.2, 2.5)),
    LawCase("sum_linear_sine", gx.Linear(0.4) + gx.Sine(0.9, 1.7), _SMOOTH),
    LawCase("scaled", Scaled(gx.Hertz(1.0, 0.3), jnp.asarray(1.7))),
    LawCase("strained", Strained(gx.Hertz(1.0, 0.3), jnp.asarray(0.4))),
    LawCase("strained_alike", Strained(gx.Hertz(1.0, 0.3), jnp.asarray(0.4), jnp.asarray(0.4))),
    LawCase("yielding", gx.Yielding(gx.Hertz(), 2.0)),
    LawCase("yielding_F0", gx.Yielding(gx.Hertz(1.7, 0.9), 2.0)),
    LawCase("yielding_stiff", gx.Yielding(gx.Hertz(), 1e12)),
)

# those whose code another case runs with other numbers
SAME_LAWS = {
    *(f"power_{p}" for p in (1.0, 2.5, 3.0, 1.37)),
    *(f"power_{p}_F0" for p in (1.0, 1.5, 2.0, 2.5, 3.0, 0.5)),
    "magnets_-1",
    "magnets_array_-1",
    "polynomial_alpha",
    "polynomial_beta",
    "strained_alike",
    "yielding_stiff",
}

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
    *(MapCase(f"shift_{k}_{b}", gx.Shift(k, b), (6,)) for k in (1, 2, -1) for b in BOUNDARIES),
    *(MapCase(f"shift_1_{b}_lanes", gx.Shift(1, b), (6, 3)) for b in BOUNDARIES),
    MapCase("shift_grid_fixed_periodic", gx.Shift((1, 1), ("fixed", "periodic")), (4, 5)),
    MapCase("shift_grid_periodic_free", gx.Shift((1, 1), ("periodic", "free")), (4, 5)),
    MapCase("shift_grid_fixed_free", gx.Shift((1, -1), ("fixed", "free")), (4, 5, 2)),
    MapCase("shift_grid_fixed_fixed", gx.Shift((-1, 2), ("fixed", "fixed")), (4, 5)),
    MapCase("shift_own_field", gx.Shift(1, "fixed", "bead"), _TWO),
    MapCase("shift_within_cell", gx.Shift(0, "free", ("bead", "resonator")), _TWO),
    MapCase("shift_between_fields_free", gx.Shift(1, "free", ("bead", "resonator")), _TWO),
    MapCase("shift_between_fields_fixed", gx.Shift(1, "fixed", ("bead", "resonator")), _TWO),
    MapCase("pairs_graph", gx.Pairs([0, 0, 3, 2], [1, 3, 2, 1]), (4,)),
    MapCase("pairs_walls", gx.Pairs([-1, 0, 1, 2, 0], [0, 1, 2, -1, 2]), (3,)),
    MapCase("pairs_isolated_last_sites", gx.Pairs([0, 1], [1, 2], sites=6), (6, 2)),
    MapCase(
        "pairs_fields",
        gx.Pairs([0, 2, -1], [1, 3, 0], sites=(6, 6), fields=("bead", "resonator")),
        _TWO,
    ),
    MapCase("stretch_shift_free", gx.Stretch(gx.Shift(1, "free"), [0.8, 0.6]), (6, 2)),
    MapCase("stretch_shift_fixed_lanes", gx.Stretch(gx.Shift(1, "fixed"), [1.0, 0.0]), (6, 2, 3)),
    MapCase(
        "stretch_shift_periodic_space",
        gx.Stretch(gx.Shift(1, "periodic"), [0.2, 1.0, -0.4]),
        (5, 3),
    ),
    MapCase(
        "stretch_grid", gx.Stretch(gx.Shift((1, 1), ("periodic", "free")), [-0.5, 0.8]), (4, 5, 2)
    ),
    MapCase(
        "stretch_pairs_own_vectors",
        gx.Stretch(gx.Pairs([0, 1, 2, 3, 4], [1, 2, 3, 4, 5]), _VECTORS),
        (6, 2),
    ),
    MapCase("stretch_pairs_space_lanes", gx.Stretch(gx.Pairs(*_RING), [0.0, 0.6, 0.8]), (6, 3, 2)),
    MapCase("stretch_of_beads_that_turn", gx.Stretch(gx.Shift(1, "fixed"), [0.8, 0.6]), (6, 3)),
    MapCase(
        "slip", gx.strains.Slip(gx.Shift((1, -1), ("free", "periodic")), [0.8, 0.6]), (4, 5, 3)
    ),
    MapCase("along", gx.strains.Along(gx.Shift(1, "fixed"), [0.8, -0.6]), (6, 2)),
    MapCase("along_lanes", gx.strains.Along(gx.Pairs(*_RING), [0.0, 0.0, 1.0]), (6, 3, 2)),
    MapCase(
        "pairs_weights",
        gx.Pairs([0, 1, 1], [1, 2, 3], sites=5, weights=([0.5, 1.0, 2.0], 1.5)),
        (5, 2),
    ),
    MapCase("own_map", OwnMap(), (6,)),
)

LINEAR_MAPS = tuple(case for case in ALL_STRAIN_MAPS if hasattr(case.map, "gather"))
STRETCHES = tuple(case for case in ALL_STRAIN_MAPS if isinstance(case.map, gx.Stretch))

# ------------------------------------------------------------------------------------------------- terms and lattices


class LatticeCase(NamedTuple):
    """A lattice; `inner` says that only forces between its own sites act, so that momentum is kept."""

    name: str
    lattice: gx.Lattice
    inner: bool = False


_MASSES = np.array([1.0, 0.5, 1.0, 0.7, 1.2, 0.9])
_CELL = {"bead": _MASSES, "resonator": np.full(6, 0.3)}
_WAVE = gx.Harmonic(0.3, 1.7, phase=0.4)
_TURNING = gx.Stretch(gx.Shift(1, "free"), [1.0, 0.0])
_ALGEBRAIC = np.arange(1.0, 13) ** -3
_GRID = np.linspace(0.8, 1.3, 20).reshape(4, 5)


def _at_rest(t):
    return 0.1 * jnp.sin(t)


def _chain(*terms, mass=_MASSES, **how):
    return gx.Lattice(mass, terms, **how)


ALL_TERMS = (
    *(
        LatticeCase(f"bond_hertz_{b}", _chain(gx.Bond(gx.Shift(1, b), gx.Hertz())), b != "fixed")
        for b in BOUNDARIES
    ),
    *(
        LatticeCase(
            f"bond_F0_{b}", _chain(gx.Bond(gx.Shift(1, b), gx.Hertz(1.2, 0.8))), b != "fixed"
        )
        for b in BOUNDARIES
    ),
    *(
        LatticeCase(
            f"bond_second_neighbour_{b}", _chain(gx.Bond(gx.Shift(2, b), gx.Toda())), b != "fixed"
        )
        for b in BOUNDARIES
    ),
    LatticeCase(
        "bond_disorder", _chain(gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(np.linspace(1, 2, 7), 0.5)))
    ),
    LatticeCase("bond_own_map", _chain(gx.Bond(OwnMap(), gx.Hertz(1.2, 0.8))), True),
    LatticeCase(
        "grip",
        _chain(
            gx.Bond(_TURNING, gx.Hertz(1.0, 0.2)),
            gx.terms.Grip(
                gx.strains.Slip(_TURNING.pairs, _TURNING.vector),
                gx.Linear(0.7),
                gx.Bond(_TURNING, gx.Hertz(1.0, 0.2)),
            ),
            dimension=3,
        ),
    ),
    LatticeCase("bond_magnets", _chain(gx.Bond(gx.Shift(1, "fixed"), gx.PowerLaw(1.0, -3.0, 1.0)))),
    LatticeCase(
        "bond_exponents",
        _chain(gx.Bond(gx.Shift(1, "free"), gx.PowerLaw(1.0, np.linspace(1.2, 3, 5), 1.0))),
        True,
    ),
    LatticeCase(
        "long_range_ring",
        _chain(gx.LongRange(_ALGEBRAIC, gx.Polynomial(1.0, 0.3, 0.2), "periodic")),
        True,
    ),
    LatticeCase(
        "long_range_magnets",
        _chain(gx.LongRange(_ALGEBRAIC, gx.PowerLaw(1.0, -3.0, 1.0), "fixed", takes="strain")),
    ),
    LatticeCase("onsite_linear", _chain(gx.OnSite(gx.Linear(np.linspace(1, 2, 6))))),
    LatticeCase("onsite_sine", _chain(gx.OnSite(gx.Sine(1.0, 2.0)))),
    LatticeCase("damping", _chain(gx.Damping(0.1))),
    LatticeCase("damping_per_site", _chain(gx.Damping(np.linspace(0, 1, 6)))),
    LatticeCase("dashpot", _chain(gx.Dashpot(gx.Shift(1, "free"), 0.3)), True),
    LatticeCase("dashpot_fixed", _chain(gx.Dashpot(gx.Shift(1, "fixed"), np.linspace(0, 1, 7)))),
    LatticeCase(
        "dashpot_plane",
        _chain(gx.Dashpot(gx.Stretch(gx.Shift(1, "free"), [0.8, 0.6]), 0.3), dimension=2),
        True,
    ),
    LatticeCase(
        "viscous_contact", _chain(gx.ViscousContact(gx.Shift(1, "free"), 0.3, overlap=0.2)), True
    ),
    LatticeCase("drag", _chain(gx.Drag(np.linspace(0.1, 1, 6)))),
    LatticeCase("drive", _chain(gx.Drive(_WAVE, 2))),
    LatticeCase("drive_last", _chain(gx.Drive(_at_rest, -1))),
    *(
        LatticeCase(f"wall_{side}", _chain(gx.Wall(gx.Hertz(1.2, 0.8), side)))
        for side in ("left", "right")
    ),
    *(
        LatticeCase(f"wall_driven_{side}", _chain(gx.Wall(gx.Hertz(1.2), side, motion=_WAVE)))
        for side in ("left", "right")
    ),
    LatticeCase("wall_yielding", _chain(gx.Wall(gx.Hertz(1.2, 0.8), "right", support=3.0))),
    LatticeCase(
        "modulated_bond",
        _chain(
            gx.Modulated(
                gx.Bond(gx.Shift(1, "periodic"), gx.Hertz(1.0, 0.5)),
                gx.Harmonic(0.1, 2.0, np.linspace(0, 3, 6), mean=1.0),
            )
        ),
        True,
    ),
    LatticeCase("modulated_onsite", _chain(gx.Modulated(gx.OnSite(gx.Linear()), _at_rest))),
)

_TRIANGULAR = tuple(
    gx.Bond(
        gx.Stretch(gx.Shift(offset, "periodic"), vector),
        gx.Polynomial(1.0, 0.3) + gx.Hertz(0.5, 0.2),
    )
    for offset, vector in (
        ((1, 0), [1.0, 0.0]),
        ((0, 1), [0.5, 0.75**0.5]),
        ((-1, 1), [-0.5, 0.75**0.5]),
    )
)

MASS_IN_MASS = _chain(
    gx.Bond(gx.Shift(1, "fixed", "bead"), gx.Hertz(1.0, 0.4)),
    gx.Bond(gx.Shift(0, "free", ("bead", "resonator")), gx.Linear(0.7)),
    gx.Damping(0.05, "resonator"),
    gx.Drive(_WAVE, 0, "bead"),
    gx.OnSite(gx.Linear(0.2), "resonator"),
    mass=_CELL,
)

SCENES = (
    LatticeCase("monomer", _chain(gx.Bond(gx.Shift(1, "fixed"), gx.Hertz()), mass=1.0, sites=6)),
    LatticeCase(
        "composed",
        _chain(
            gx.Bond(gx.Shift(1, "free"), gx.Hertz(1.0, 0.4)),
            gx.Bond(gx.Shift(2, "free"), gx.Linear(0.1)),
            gx.Wall(gx.Hertz(1.4, 0.4), "left", motion=_WAVE),
            gx.Wall(gx.Hertz(1.4, 0.4), "right", support=5.0),
            gx.OnSite(gx.Sine(0.1)),
            gx.Damping(0.02),
            gx.Dashpot(gx.Shift(1, "free"), 0.01),
            gx.Drive(_WAVE, 3),
        ),
    ),
    LatticeCase("triangular", _chain(*_TRIANGULAR, mass=_GRID, dimension=2), True),
    LatticeCase(
        "grid_scalar",
        _chain(
            gx.Bond(gx.Shift((1, 0), "free"), gx.Hertz()),
            gx.Bond(gx.Shift((0, 1), "periodic"), gx.Toda()),
            mass=_GRID,
        ),
        True,
    ),
    LatticeCase(
        "helix_in_space",
        _chain(
            gx.Bond(gx.Stretch(gx.Shift(1, "fixed"), [1.0, 0.0, 0.0]), gx.Hertz(1.0, 0.4)),
            mass=1.0,
            sites=6,
            dimension=3,
        ),
    ),
    LatticeCase("mass_in_mass", MASS_IN_MASS),
)

ALL_LATTICES = ALL_TERMS + SCENES

# of lattices that differ in their ends, or in one number for several, all but the one whose program does most
SAME_LATTICES = {
    "bond_hertz_free",
    "bond_hertz_periodic",
    "bond_F0_free",
    "bond_F0_fixed",
    "bond_second_neighbour_free",
    "bond_second_neighbour_fixed",
    "onsite_linear",
    "damping",
    "dashpot",
    "drive_last",
    "wall_left",
    "wall_driven_left",
    "monomer",
}
DISTINCT = tuple(case for case in ALL_LATTICES if case.name not in SAME_LATTICES)
