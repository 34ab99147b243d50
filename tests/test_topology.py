"""Topology and flat bands: whole numbers, closed forms, states that stay where they are."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax import linear, scenes, topology
from granjax.linear.zone import named_points

RNG = np.random.default_rng(11)


def off(found, want):
    """The largest difference."""
    return np.abs(np.asarray(found) - want).max()


def fukui(q):
    """Chern number of vectors (n, n, P, bands) on a plain mesh."""
    one, two = (np.linalg.det(q.conj().mT @ np.roll(q, -1, axis)) for axis in (0, 1))
    around = one * np.roll(two, -1, 0) * (np.roll(one, -1, 1) * two).conj()
    return -np.angle(around).sum() / (2 * np.pi)


# ---------------------------------------------------------------------------------------------------------- chains


def test_the_chain_of_su_schrieffer_and_heeger_has_states_where_its_phase_is_pi():
    for k1, k2, phase, turns in ((1.0, 2.0, np.pi, 1), (2.0, 1.0, 0.0, 0), (0.3, 0.31, np.pi, 1)):
        chain = scenes.ssh(8, k1, k2, boundary="periodic")
        found = topology.zak(chain)
        assert off(np.abs([*found.phase, found.below[0]]), phase) < 1e-10
        assert topology.winding(chain) == turns
        assert "+-" not in found.outcome
    assert "-0.424987 pi, +- 0.004 rad." in topology.zak(scenes.sawtooth(8, tooth=1.0)).outcome
    for k1, want in ((1.0, [2.99853515, 3.00146485]), (2.0, [])):
        squared = linear.normal_modes(scenes.ssh(10, k1, 3 - k1)).omega_squared
        inside = squared[(squared > 2) & (squared < 4)]
        np.testing.assert_allclose(inside, want, atol=5e-9)
    with refused("touch"):
        topology.winding(scenes.ssh(8, 1.0, 1.0, boundary="periodic"))


@pytest.mark.parametrize("b", [0.3, 1.7])
def test_chains_whose_bands_touch_at_any_k(b):
    def chain(a, mass=0.0):
        def matrix(k):
            h = a + b * jnp.exp(1j * k[0]) + jnp.exp(2j * k[0])
            return jnp.array([[mass, h], [jnp.conj(h), -mass]])

        return matrix

    # a + b z + z^2 has both roots on the unit circle for a = 1, |b| < 2
    found = topology.zak(chain(1), points=16)
    assert np.isnan(found.phase).all() and f"{np.arccos(-b / 2):.6g}" in found.outcome
    with refused("touches others at k = "):
        topology.winding(chain(1))
    for share in (1e-2, 1e-8):
        assert topology.winding(chain(1 + share), points=9) == 0
        assert topology.winding(chain(1 - share), points=9) == -2
        inside = topology.zak(chain(1 - share, 1e-3), points=16)
        # by the closed form: half of the angle that the vector encloses, on a dense mesh
        k = np.linspace(0, 2 * np.pi, 200001)[:-1]
        h = 1 - share + b * np.exp(1j * k) + np.exp(2j * k)
        weight = (1 + 1e-3 / np.sqrt(1e-6 + np.abs(h) ** 2)) / 2
        exact = (np.angle(np.roll(h, -1) / h) * (weight + np.roll(weight, -1)) / 2).sum()
        assert abs(np.exp(1j * inside.phase[0]) - np.exp(1j * exact)) < inside.error < 0.02


def test_disorder_that_keeps_sites_alike_keeps_the_edge_frequency():
    def middle(alike, cells=10):
        """The middle pair of omega^2 of chains k, 2k, ... of random springs."""

        def modes(key):
            k = jnp.where(jnp.arange(2 * cells + 1) % 2 == 1, 1.0, 2.0)
            k = k * (1 + 0.2 * jax.random.uniform(key, k.shape, minval=-1.0))
            held = gx.OnSite(gx.Linear(4.0 - k[1:] - k[:-1] if alike else 1.0))
            bond = gx.Bond(gx.Shift(1, "fixed"), gx.Linear(k))
            chain = gx.Lattice(1.0, (bond, held), sites=2 * cells)
            return linear.normal_modes(chain).omega_squared[cells - 1 : cells + 1]

        return np.asarray(jax.vmap(modes)(jax.random.split(jax.random.key(3), 400)))

    alike = middle(True)
    generic = middle(False)
    # the spectrum mirrors about the springs' sum in each sample; the pair's splitting is that of ten cells
    assert off(alike.mean(1), 4) < 1e-12 and np.ptp(alike, axis=1).max() < 0.05
    # to first order an end follows its own two springs and what it weighs of the next: of order the disorder
    assert 0.1 < generic.mean(1).std() < 0.4


def test_wells_follow_the_golden_mean_unless_asked_otherwise():
    # the mean b, which solves b^2 + b = 1, is 2 sin 18 degrees
    (own,) = (x for x in scenes.aubry_andre(9, 0.7).terms if isinstance(x, gx.OnSite))
    turns = 2 * np.sin(np.pi / 10) * np.arange(9)
    assert_allclose(own.law.stiffness, 2 + 0.7 * np.cos(2 * np.pi * turns), rtol=1e-13)


def test_the_quasi_periodic_chain_of_aubry_and_andre():
    """The length of its modes is that of the gallery's example; here its extended phase and its bands."""
    modes = linear.normal_modes(scenes.aubry_andre(377, 1.0)).modes
    assert np.median(1 / (modes**4).sum(0)) > 80
    # a third of a turn each site: the bands of Hofstadter's lattice
    site = 2 * jnp.pi * jnp.arange(3) / 3

    def third(k):
        hop = jnp.eye(3, k=1, dtype=complex).at[2, 0].set(jnp.exp(1j * k[0]))
        return jnp.diag(3 + 0.8 * jnp.cos(site + k[1])) - hop - hop.conj().T

    numbers = [topology.chern(third, band) for band in range(3)]
    assert sorted(map(abs, numbers)) == [1, 1, 2] and sum(numbers) == 0


# ---------------------------------------------------------------------------------------------------- Chern numbers


def haldane(k, mass=0.2, second=0.1):
    f = 1 + jnp.exp(-1j * k[0]) + jnp.exp(-1j * k[1])
    s = 2 * second * (jnp.sin(k[0]) - jnp.sin(k[1]) + jnp.sin(k[1] - k[0]))
    return jnp.array([[mass + s, f], [jnp.conj(f), -mass - s]])


def unlike(b):
    """A honeycomb of masses 1 and b."""
    masses = {"a": 1.0, "b": b}
    return scenes.honeycomb(6, mass=masses, out_of_plane=True, boundary="periodic")


def test_chern_numbers_are_whole():
    found = np.array([topology.berry_curvature(haldane, band).chern for band in (0, 1)])
    assert off(np.abs(found), 1) < 1e-10 and abs(found.sum()) < 1e-10
    assert topology.chern(lambda k: haldane(k, mass=2.0)) == 0
    assert abs(topology.berry_curvature(unlike(1.2)).chern) < 1e-10
    with refused("touch"):
        topology.chern(unlike(1.0))


@pytest.mark.parametrize("points, share", [(7, 3e-8), (24, 1e-5), (25, 1e-2)])
def test_chern_numbers_beside_a_transition(points, share):
    # at one valley the two masses cancel for mass = 3 3^{1/2} second: the gap is 2 share there
    mass = 3 * 3**0.5 * 0.1
    assert topology.chern(lambda k: haldane(k, mass + share), points=points) == 0
    assert abs(topology.chern(lambda k: haldane(k, mass - share), points=points)) == 1


def test_valleys_have_half_a_number_as_their_gap_closes():
    at, other = (topology.valley_chern(unlike(1.02), valley=valley) for valley in ("K", "K'"))
    assert abs(at + other) < 1e-10 and 0.46 < abs(at) < 0.5
    assert topology.valley_chern(unlike(0.98)) * at < 0


@pytest.mark.parametrize("more, k", [(-1, (4, 2)), (1, (2, 6))])
def test_valleys_are_those_of_the_crystal_whatever_its_axes(more, k):
    # the second axis of the honeycomb, less the first one (at 120 degrees to it) or with it
    r = 3**0.5
    tie = scenes.Tie
    ties = tie("a", "b", (0, 0)), tie("b", "a", (1, 0)), tie("b", "a", (-more, 1))
    places = {"a": (0.0, 0.0), "b": (r / 2, 0.5)}
    cell = scenes.CrystalCell(((r, 0.0), (r / 2 + more * r, 1.5)), places, ties)
    masses = {"a": 1.0, "b": 3.0}
    crystal = scenes.crystal(cell, 6, mass=masses, out_of_plane=True, boundary="periodic")
    ways = ("K", "K'") if more < 0 else (np.pi / 3 * np.array(k), -np.pi / 3 * np.array(k))
    at, other = (topology.valley_chern(crystal, valley=k, points=48) for k in ways)
    want = topology.valley_chern(unlike(3.0), points=48)
    assert abs(at + other) < 1e-10 and abs(at - want) < 2e-4


def three_ways(bonds, mass=0.0):
    """A honeycomb of one hopping for each way, on the two kinds +-mass."""

    def matrix(k):
        h = bonds[0] + bonds[1] * jnp.exp(-1j * k[0]) + bonds[2] * jnp.exp(-1j * k[1])
        return jnp.array([[mass, h], [jnp.conj(h), -mass]])

    return matrix


def dirac_point(a, b, c):
    """Where a + b exp(-ik0) + c exp(-ik1) = 0: the angles of a triangle of sides a, b, c."""
    first = np.pi - np.arccos((a * a + b * b - c * c) / (2 * a * b))
    return np.array([first, np.pi + np.arccos((a * a + c * c - b * b) / (2 * a * c))])


@pytest.mark.parametrize(
    "bonds, points", [((1, 0.8, 0.9), 24), ((1.9, 1, 1.05), 31), ((1, 0.7, 0.55), 7)]
)
def test_bands_that_touch_at_any_k_have_no_number(bonds, points):
    place = dirac_point(*bonds)
    found = topology.berry_curvature(three_ways(bonds), points=points)
    assert np.isnan(found.flux).all() and np.isnan(found.chern) and found.gap < 1e-9
    away = np.abs(np.exp(1j * found.nearest) - np.exp(1j * np.array([place, -place]))).max(1).min()
    assert away < 1e-6 and "touches others at k = " in found.outcome
    assert np.isnan(topology.valley_chern(three_ways(bonds), valley=place, points=points))
    with refused("touches others at k = "):
        topology.chern(three_ways(bonds), points=points)
    # along the line through that point, and beside it
    loops = topology.zak(three_ways(bonds), k=[place[1], place[1] + 0.1], points=points)
    assert np.isnan(loops.phase[:, 0]).all() and not np.isnan(loops.phase[:, 1]).any()
    assert f"At k = {place[1]:.6g}" in loops.outcome


def test_below_an_open_gap_bands_that_touch_have_a_phase_together():
    def matrix(k):
        h = 1 + 2 * jnp.exp(-1j * k[0])
        crossing = jnp.diag(2 - jnp.cos(k[0] + jnp.array([0, 1.3])))
        dimers = jnp.array([[9, h], [jnp.conj(h), 9]])
        return jax.scipy.linalg.block_diag(crossing, dimers)

    found = topology.zak(matrix)
    np.testing.assert_allclose(
        np.abs(found.phase), [np.nan, np.nan, np.pi, np.pi], rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(np.abs(found.below), [np.nan, 0, np.pi], rtol=0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("bonds", [(1, 1, 1), (1.9, 1, 1.05)])
def test_a_gap_as_small_as_the_limit_has_its_half_number(bonds):
    k = dirac_point(*bonds)
    # half the solid angle of d, H = d . sigma, which turns by d(d_x, d_y)/dk
    slopes = -1j * bonds[1] * np.exp(-1j * k[0]), -1j * bonds[2] * np.exp(-1j * k[1])
    half = -np.sign((slopes[0].conj() * slopes[1]).imag) / 2
    # the gap is 2 mass, and the largest of omega^2 the sum of the bonds
    for share, points in ((2e-9, 7), (-2e-9, 24), (1e-6, 25), (-1e-4, 13)):
        matrix = three_ways(bonds, share * sum(bonds) / 2)
        number = topology.valley_chern(matrix, valley=k, points=points)
        assert abs(number - np.sign(share) * half) < 3e-4
    closed = topology.berry_curvature(three_ways(bonds, 0.9e-9 * sum(bonds) / 2), points=13)
    assert closed.fault


@pytest.mark.slow
@pytest.mark.parametrize("seed, size", [(1, 3), (2, 4), (6, 2)])
def test_chern_numbers_of_random_bands_on_coarse_meshes(seed, size):
    random = np.random.default_rng(seed)
    parts = random.normal(size=(3, 3, size, size)) + 1j * random.normal(size=(3, 3, size, size))
    way = np.arange(-1, 2)

    def matrix(k, xp=jnp):
        one, two = (xp.exp(1j * k[..., i, None] * way) for i in (0, 1))
        half = xp.einsum("...a,...b,abpq->...pq", one, two, parts)
        return half + half.conj().swapaxes(-1, -2)

    k = 2 * np.pi * np.arange(300) / 300
    q = np.linalg.eigh(matrix(np.stack(np.meshgrid(k + 0.1, k + 0.2, indexing="ij"), -1), np))[1]
    for bands in ([0], list(range(size // 2 + 1))[: size - 1]):
        found = topology.berry_curvature(matrix, bands, points=5 + seed)
        assert abs(found.chern - fukui(q[..., bands])) < 1e-9, (found.gap, bands)


@pytest.mark.slow
def test_bands_that_cross_or_all_but_touch_along_a_curve_have_no_number():
    def matrix(k, coupling):
        one = 2 - jnp.cos(k[0]) - jnp.cos(k[1])
        two = 1.3 + 0.2 * jnp.cos(k[0] + 0.3) * jnp.cos(k[1])
        c = coupling * (0.3 + jnp.exp(1j * k[0]))
        return jnp.array([[one, c], [jnp.conj(c), two]])

    crossing = topology.berry_curvature(lambda k: matrix(k, 0.0))
    assert "touches others" in crossing.outcome and np.isnan(crossing.chern)
    one, two = np.diag(matrix(jnp.asarray(crossing.nearest), 0.0).real)
    assert abs(one - two) < 1e-8
    near = topology.berry_curvature(lambda k: matrix(k, 1e-6))
    assert "too close over too much of the zone" in near.outcome and np.isnan(near.chern)
    assert topology.chern(lambda k: matrix(k, 0.1)) == 0
    # all of the zone at one small distance is no trouble
    small = lambda k: (2 - jnp.cos(k[0])) * jnp.eye(2) + 1e-5 * haldane(k)
    assert abs(topology.chern(small)) == 1


class Gyroscopes(gx.Term):
    rate: float

    def force(self, t, u, v, mass):
        return {n: self.rate * jnp.stack([x[..., 1], -x[..., 0]], -1) for n, x in v.items()}


@pytest.mark.slow
def test_a_gyroscopic_honeycomb_is_a_chern_insulator():
    """Between the two valleys' gaps: as many one-way edge modes as the Chern numbers below sum to."""

    def crystal(*size, boundary):
        found = scenes.honeycomb(*size, boundary=boundary)
        held = (gx.OnSite(gx.Linear(0.2), field=name) for name in "ab")
        return eqx.tree_at(lambda x: x.terms, found, (*found.terms, *held, Gyroscopes(0.3)))

    lattice = crystal(6, 6, boundary="periodic")
    numbers = [topology.chern(lattice, band) for band in range(4)]
    cell = linear.cell.turning_cell(lattice)
    k = 2 * np.pi * np.arange(24) / 24
    states = np.empty((24, 24, 4, 4), complex)
    for i, j in np.ndindex(24, 24):
        at = jnp.array([k[i], k[j]])
        # q'' = -D q - G q' by the companion matrix
        D = cell.dynamical_matrix(at)
        G = np.asarray(cell.gyration(at))
        values, q = np.linalg.eig(np.block([[np.zeros((4, 4)), np.eye(4)], [-D, -G]]))
        states[i, j] = q[:4, np.argsort(-values.imag)[4:]]
    by_hand = [fukui(states[..., [n]]) for n in range(4)]
    assert numbers == np.round(by_hand).astype(int).tolist() == [-1, 0, 0, 1]
    assert np.isfinite(topology.valley_chern(lattice, 3, points=24))
    strip = linear.ribbon(crystal(4, 14, boundary=("periodic", "free")))
    middle = np.mean(linear.bands(lattice).gaps[1])
    crossed = np.diff(np.sign(strip.omega - middle), axis=0) != 0
    assert sorted(np.sign(strip.edge[:-1][crossed])) == [-1, 1]


# three fields, by hand: springs (field, field, cell of the second, stiffness)
SPRINGS = [
    (0, 1, (0, 0), 1.0),
    (0, 2, (0, 0), 1.3),
    (1, 2, (0, 0), 0.7),
    (1, 0, (1, 0), 0.4),
    (2, 0, (0, 1), 0.5),
    (1, 2, (1, -1), 0.6),
    (0, 0, (1, 0), 0.3),
]


@pytest.mark.slow
def test_three_fields_of_the_plane_against_matrices_by_hand():
    masses = np.array([1.0, 1.4, 0.8])
    ground = np.array([0.2, 0.9, 0.5])
    bonds = [
        gx.Bond(gx.Shift(R, "periodic", ("abc"[i], "abc"[j])), gx.Linear(K))
        for i, j, R, K in SPRINGS
    ]
    held = [gx.OnSite(gx.Linear(g), name) for name, g in zip("abc", ground)]
    sites = {name: np.full((5, 5), m) for name, m in zip("abc", masses)}
    crystal = gx.Lattice(sites, (*bonds, *held))

    def by_hand(k):
        D = np.diag(ground).astype(complex)
        for i, j, R, K in SPRINGS:
            D[i, i] += K
            D[j, j] += K
            D[i, j] -= K * np.exp(1j * np.dot(k, R))
            D[j, i] -= K * np.exp(-1j * np.dot(k, R))
        return D / np.sqrt(np.outer(masses, masses))

    k = RNG.uniform(-np.pi, np.pi, (7, 2))
    exact = np.linalg.eigvalsh([by_hand(x) for x in k])
    assert off(linear.dispersion(crystal, k).omega_squared, exact) < 1e-12
    mesh = 2 * np.pi * np.arange(60) / 60
    q = np.linalg.eigh([[by_hand((x, y)) for y in mesh] for x in mesh])[1]
    for band in range(3):
        assert topology.chern(crystal, band, points=9) == 0 == round(fukui(q[..., [band]]))
    # the phases along one axis by plain products of overlaps, at a wave number of the mesh along the other
    at = [7, 30]
    loop = topology.zak(crystal, k=mesh[at], points=60)
    links = (q[:, at].conj() * np.roll(q[:, at], -1, 0)).sum(2)
    plain = -np.angle(np.prod(links, axis=0)).T
    assert off(np.exp(1j * loop.phase), np.exp(1j * plain)) < 3 * loop.error + 1e-9


# ------------------------------------------------------------------------------------------------- corners and edges


def quadrupole(k, inner=0.5, outer=1.0):
    x = inner + outer * jnp.exp(1j * k[0])
    y = inner + outer * jnp.exp(1j * k[1])
    D = jnp.zeros((4, 4), complex).at[0, 1].set(x).at[2, 3].set(x).at[0, 2].set(y).at[1, 3].set(-y)
    return D + D.conj().T


@pytest.mark.slow
def test_the_quadrupole_and_its_corners():
    assert topology.quadrupole(quadrupole) == (0.5, 0.5)
    # the gap closes at k = (pi, pi), moved to where no mesh has a point
    closed = lambda k: quadrupole(k + jnp.array([0.2, 0.3]), 1.0)
    for points in (6, 7):
        assert topology.quadrupole(lambda k: quadrupole(k, 1 - 1e-8), points=points) == (0.5, 0.5)
        assert topology.quadrupole(lambda k: quadrupole(k, 1 + 1e-8), points=points) == (0.0, 0.0)
        assert np.isnan(topology.quadrupole(closed, points=points)).all()
    for k1, k2, want in ((0.5, 2.0, (0.5, 0.5)), (2.0, 0.5, (0.0, 0.0))):
        lattice = scenes.quadrupole(6, k1=k1, k2=k2, ground=0.5, boundary="periodic")
        assert topology.quadrupole(lattice) == want
    modes = linear.normal_modes(scenes.quadrupole(6, k1=0.5, k2=2.0, ground=0.5))
    held = np.flatnonzero(np.abs(modes.omega_squared - 5.5) < 0.2)
    share = sum(x[..., held] ** 2 for x in modes.modes.values())
    assert len(held) == 4 and share[[0, 0, -1, -1], [0, -1, 0, -1]].sum(0).min() > 0.8


def breathing(k1, k2, cells=6, **options):
    return scenes.kagome(cells, out_of_plane=True, stiffness=(k1, k1, k1, k2, k2, k2), **options)


@pytest.mark.slow
@pytest.mark.parametrize("k1, k2, third", [(1.0, 0.3, 0), (0.3, 1.0, 2)])
def test_the_polarisation_of_a_breathing_kagome_is_a_third(k1, k2, third):
    lattice = breathing(k1, k2, boundary="periodic")

    def polarisation(n):
        """Of the lowest band."""
        loops = topology.zak(lattice, k=2 * np.pi * np.arange(n) / n, points=n)
        return np.unwrap(loops.phase[0]).mean() / (2 * np.pi)

    # the error falls with the square of the mesh
    left = (4 * polarisation(48) - polarisation(24)) / 3 - third / 3
    assert abs(left - np.round(left)) < 1e-5


@pytest.mark.slow
def test_a_triangle_of_breathing_kagome_has_a_state_at_each_corner():
    inside = lambda p: p[..., 0] + p[..., 1] / 3**0.5 < 2 * 6 - 0.5

    def near(k1, k2, **options):
        crystal = breathing(k1, k2, outline=inside, **options)
        modes = linear.normal_modes(crystal)
        away = modes.omega_squared - 2 * (k1 + k2)
        # nothing else lies in the gap of the bulk
        held = np.abs(away) < 0.4
        share = np.concatenate([modes.modes[name][:, held] ** 2 for name in "abc"])
        places = np.concatenate([crystal.positions[name] for name in "abc"])
        return away[held], share, places

    away, share, places = near(0.2, 1.0)
    assert len(away) == 3 and np.abs(away).max() < 2e-4
    corners = np.argsort(-np.linalg.norm(places - places.mean(0), axis=1))[:3]
    assert (share[corners].sum(0) > 0.85).all()
    assert not len(near(1.0, 0.2)[0])
    # sites of a free edge are held by less
    loose, share, _ = near(0.2, 1.0, boundary="free")
    assert share[corners].max() < 0.85 or len(loose) != 3


@pytest.mark.slow
@pytest.mark.parametrize("width", [15, 16])
def test_the_two_edges_of_a_symmetric_strip_are_told_apart(width):
    strip = scenes.honeycomb(5, width, out_of_plane=True, boundary=("periodic", "fixed"))
    k = np.array([3.0, 2.9, 2.6, 0.4])
    found = linear.ribbon(strip, k)
    # by hand: a is bound to two b of its row and one below
    D = np.zeros((4, 2 * width, 2 * width), complex)
    for n in range(width):
        D[:, 2 * n, 2 * n + 1] = -1 - np.exp(-1j * k)
        D[:, 2 * n, 2 * n - 1] = -1 if n else 0
    D = D + D.conj().mT + 3 * np.eye(2 * width)
    assert off(found.omega_squared, np.linalg.eigvalsh(D)) < 1e-12
    edge = np.asarray(found.edge)
    spread = np.asarray(found.participation)
    # half way up the spectrum the strip has one state at each edge
    middle = [width - 1, width]
    for i in (0, 1, 2):
        assert sorted(np.sign(edge[i, middle])) == [-1, 1] and np.abs(edge[i, middle]).min() > 0.75
    assert spread[0, middle].max() < 1.1
    # they still solve the strip, but for what they were taken to be together by
    q = np.stack([found.modes[name] for name in "ab"], -2).reshape(4, 2 * width, -1)
    left = np.abs(D @ q - q * found.omega_squared[:, None]).max()
    assert left < 1e-4 * np.abs(D).max() and off(q.conj().mT @ q, np.eye(2 * width)) < 1e-12
    few = int((spread < 0.2 * width).any(0).sum())
    assert found.outcome.startswith(f"{2 * width} bands at 4 wave numbers; {few} within a fifth")
    assert 2 <= few < width


@pytest.mark.slow
def test_the_edges_of_a_free_triangular_strip_are_told_apart():
    strip = scenes.triangular(5, 16, boundary=("periodic", "free"))
    found = linear.ribbon(strip, [2.5, -2.5, 2 * np.pi / 5])
    # Rayleigh waves are the lowest pair: one each side
    edge = found.edge[:2]
    spread = found.participation[:2]
    assert off(np.abs(edge[:, :2]), 1) < 0.15 and np.abs(edge[:, :2].sum(1)).max() < 1e-6
    assert spread[:, :2].max() < 4 and (spread[:, 5:] > 4).all()
    ring = linear.normal_modes(strip).omega_squared
    assert all(np.abs(ring - x).min() < 1e-12 for x in found.omega_squared[2])
    assert linear.ribbon(strip).omega.shape == (121, 32)
    with refused("periodic"):
        linear.ribbon(scenes.square(6, 6, boundary="free"), axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("axis", [2, -1, 0.5])
def test_a_strip_runs_along_one_of_two_axes(axis):
    strip = scenes.square(4, 4, boundary=("periodic", "free"))
    with refused("axis: expected 0 or 1"):
        linear.ribbon(strip, [1.0], axis=axis)


@pytest.mark.parametrize("axis, boundary", [(0, ("periodic", "free")), (1, ("free", "periodic"))])
def test_a_strip_may_name_its_axis(axis, boundary):
    found = linear.ribbon(scenes.square(4, 4, boundary=boundary), [1.0], axis=axis)
    # springs that do not resist shear: four chains along the strip, and chains of four across
    across = 2 - 2 * np.cos(np.pi * np.arange(4) / 4)
    want = np.sort(np.append(across, 4 * [2 - 2 * np.cos(1.0)]))
    assert off(found.omega_squared[0], want) < 1e-12


# ------------------------------------------------------------------------------------------- flat bands, paths, density


@pytest.mark.parametrize(
    "name, sites", [("sawtooth", 3), ("stub", 3), ("diamond", 2), ("kagome", 6), ("lieb", 4)]
)
def test_flat_bands_and_their_compact_states(name, sites):
    plane = name in ("kagome", "lieb")
    options = {"out_of_plane": True, "boundary": "periodic"} if plane else {}
    lattice = getattr(scenes, name)(6 if plane else 8, **options, ground=0.3)
    found = linear.flat_bands(lattice)
    assert len(found.omega) == 1 and found.support[0] == sites and found.width[0] < 1e-13 * 10
    state = found.state(lattice)
    acceleration = lattice.acceleration(0.0, state.u, state.v)
    for field, u in state.u.items():
        assert off(acceleration[field], -found.omega_squared[0] * u) < 1e-13
    assert sum(np.count_nonzero(u) for u in state.u.values()) == sites


def test_a_flat_band_of_zero_frequency_is_told_from_rounding():
    # in the plane a honeycomb is floppy, and its other flat band is 3 K/m
    crystal = scenes.honeycomb(6, stiffness=3e7, mass=2e-3, boundary="periodic")
    found = linear.flat_bands(crystal)
    assert found.omega[0] == 0 and off(found.omega[1] / np.sqrt(3 * 3e7 / 2e-3), 1) < 1e-14
    assert "omega = 0 (on 10 degrees of freedom), 2" in found.outcome


def test_lattices_without_a_flat_band_have_no_compact_state():
    assert not len(linear.flat_bands(scenes.stub(8, equal=False)).omega)
    chain = scenes.monomer(8, precompression=1.0, boundary="periodic")
    with refused("a flat band"):
        linear.flat_bands(chain).state(chain)


def test_disorder_of_sites_broadens_a_flat_band_linearly():
    def width(W):
        rng = np.random.default_rng(5)
        chain = scenes.stub(40, ground=0.5)
        more = [gx.OnSite(gx.Linear(W * rng.uniform(-0.5, 0.5, 40)), name) for name in "abc"]
        chain = gx.Lattice(chain.mass, (*chain.terms, *more), sites=40)
        return np.ptp(linear.normal_modes(chain).omega_squared[40:80])

    narrow = width(0.01)
    wide = width(0.02)
    assert abs(wide / narrow - 2) < 0.02 and 0.003 < narrow < 0.01


def test_the_density_of_states_of_a_plane():
    """Of omega^2 = 4 - 2 cos a - 2 cos b: omega/pi^2 K(m), m = 1 - (1 - omega^2/4)^2."""
    bonds = [gx.Bond(gx.Shift(way, "periodic"), gx.Linear()) for way in ((1, 0), (0, 1))]
    found = linear.density_of_states(gx.Lattice(1.0, bonds, sites=(4, 4)), 40)
    width = found.omega[1] - found.omega[0]
    omega = found.omega[:, None] + width * ((np.arange(200) + 0.5) / 200 - 0.5)
    exact = omega / np.pi**2 * scipy.special.ellipk(1 - (1 - omega**2 / 4) ** 2)
    assert (np.abs(found.density - exact.mean(1)) < found.error).all()


@pytest.mark.slow
def test_the_points_of_a_hexagonal_zone_in_space():
    height = 1.3
    vectors = np.array([[1, 0, 0], [0.5, np.sqrt(3) / 2, 0], [0, 0, height]])
    known = named_points(vectors, 3)
    for name, length in (("G", 0), ("M", 2 / np.sqrt(3)), ("K", 4 / 3)):
        for point, up in ((name, 0), ({"G": "A", "M": "L", "K": "H"}[name], 1 / height)):
            k = np.linalg.solve(vectors, known[point]) / np.pi
            assert_allclose([np.hypot(*k[:2]), k[2]], [length, up], atol=1e-14)


@pytest.mark.slow
def test_a_path_and_the_density_of_states():
    crystal = scenes.triangular(6, 6, boundary="periodic")
    found = linear.path(crystal, "GKMG", count=40)
    want = [[0, 0], [4.5, 4.5], [2, 6], [0, 0]]
    assert off(found.omega_squared[found.marks], want) < 1e-12
    # the group velocity is the slope of the curve
    slope = np.gradient(found.omega[:, 1], found.distance)
    inner = np.arange(3, found.marks[1] - 3)
    assert off(slope[inner], found.slope[inner, 1]) < 5e-3
    chain = scenes.monomer(20, precompression=1.0, boundary="periodic")
    density = linear.density_of_states(chain, 50)
    edges = np.linspace(0, 1, 51)
    exact = np.diff(np.arcsin(edges)) / np.diff(edges) / (np.pi * np.sqrt(1.5))
    assert (np.abs(density.density - exact) < density.error + 1e-9).all()
    # bins narrower than the mesh, and the edge of the band
    for points, bins in ((512, 2000), (64, 100), (64, 400), (16, 100), (8, 50), (8, 64)):
        found = linear.density_of_states(chain, bins, points)
        edges = np.linspace(0, 1, bins + 1)
        exact = np.diff(np.arcsin(edges)) / np.diff(edges) / (np.pi * np.sqrt(1.5))
        assert (np.abs(found.density - exact) < found.error + 1e-9).all()
    # the edge of a band and the inside of one, on coarse meshes
    on_site = scenes.klein_gordon(20, coupling=0.5)
    for points, bins in ((8, 64), (8, 40), (64, 200)):
        found = linear.density_of_states(on_site, bins, points)
        edges = np.linspace(0, np.sqrt(3), bins + 1)
        k = np.arccos(np.clip(2 - edges**2, -1, 1))  # omega^2 = 1 + 2 C (1 - cos k)
        exact = np.diff(k) / np.diff(edges) / np.pi
        assert (np.abs(found.density - exact) < found.error + 1e-9).all()
    with refused("bins: expected at most 8 for each of 16 points, got 200"):
        linear.density_of_states(chain, 200, 16)
    with refused("points: expected names among"):
        linear.path(crystal, "GQ")
    with refused("points: expected at least two points, none twice in a row"):
        linear.path(crystal, "GKKM")


@pytest.mark.slow
@pytest.mark.parametrize("compute", [linear.bands, lambda x: linear.dispersion(x, np.ones(3))])
def test_bands_that_are_not_along_a_path_are_not_drawn(compute):
    chain = scenes.monomer(20, precompression=1.0, boundary="periodic")
    with refused("record: expected bands along a path .*gx.linear.path.*gx.plots.dispersion"):
        gx.plots.bands(compute(chain))
