"""Topology and flat bands: whole numbers, closed forms, states that stay where they are."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

import granjax as gx
from granjax import scenes, topology

RNG = np.random.default_rng(11)


def test_the_chain_of_su_schrieffer_and_heeger():
    for k1, k2, phase, turns in ((1.0, 2.0, np.pi, 1), (2.0, 1.0, 0.0, 0), (0.3, 0.31, np.pi, 1)):
        chain = scenes.ssh(8, k1, k2, boundary="periodic")
        found = topology.zak(chain)
        assert (
            np.abs(np.abs(found.phase) - phase).max() < 1e-10
            and abs(abs(found.below[0]) - phase) < 1e-10
        )
        assert topology.winding(chain) == turns
    with refused("touch"):
        topology.winding(scenes.ssh(8, 1.0, 1.0, boundary="periodic"))


def haldane(k, mass=0.2, second=0.1):
    f = 1 + jnp.exp(-1j * k[0]) + jnp.exp(-1j * k[1])
    s = 2 * second * (jnp.sin(k[0]) - jnp.sin(k[1]) + jnp.sin(k[1] - k[0]))
    return jnp.array([[mass + s, f], [jnp.conj(f), -mass - s]])


def test_chern_numbers_are_whole():
    found = [topology.berry_curvature(haldane, band).chern for band in (0, 1)]
    assert np.abs(np.abs(found) - 1).max() < 1e-10 and abs(sum(found)) < 1e-10
    trivial = lambda k: haldane(k, mass=2.0)
    assert topology.chern(trivial) == 0
    crystal = scenes.honeycomb(6, mass={"a": 1.0, "b": 1.2}, out_of_plane=True, boundary="periodic")
    assert abs(topology.berry_curvature(crystal).chern) < 1e-10
    with refused("touch"):
        topology.chern(scenes.honeycomb(6, out_of_plane=True, boundary="periodic"))


def test_valleys_have_half_a_number_as_their_gap_closes():
    def numbers(step):
        crystal = scenes.honeycomb(
            6, mass={"a": 1.0, "b": 1 + step}, out_of_plane=True, boundary="periodic"
        )
        return [topology.valley_chern(crystal, valley=valley) for valley in ("K", "K'")]

    for step, least in ((0.2, 0.35), (0.02, 0.46)):
        at, other = numbers(step)
        assert abs(at + other) < 1e-10 and least < abs(at) < 0.5
    assert numbers(-0.02)[0] * numbers(0.02)[0] < 0


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
    "bonds, points",
    [
        ((1, 0.8, 0.9), 24),
        ((1, 0.8, 0.9), 25),
        ((1, 0.7, 0.55), 7),
        ((1.9, 1, 1.05), 31),
        ((1, 1, 1), 10),
    ],
)
def test_bands_that_touch_at_any_k_have_no_number(bonds, points):
    place = dirac_point(*bonds)
    found = topology.berry_curvature(three_ways(bonds), points=points)
    assert np.isnan(found.flux).all() and np.isnan(found.chern) and found.gap < 1e-9
    off = np.abs(np.exp(1j * found.nearest) - np.exp(1j * np.array([place, -place]))).max(1).min()
    assert off < 1e-6 and "touches others at k = " in found.outcome
    assert np.isnan(topology.valley_chern(three_ways(bonds), valley=place, points=points))
    with refused("touches others at k = "):
        topology.chern(three_ways(bonds), points=points)
    # along the line through that point, and beside it
    loops = topology.zak(three_ways(bonds), k=[place[1], place[1] + 0.1], points=points)
    assert np.isnan(loops.phase[:, 0]).all() and not np.isnan(loops.phase[:, 1]).any()
    assert f"At k = {place[1]:.6g}" in loops.outcome


def sense(bonds):
    """+-1 of the lower band for mass > 0: half the solid angle of d, H = d . sigma, which turns by d(d_x, d_y)/dk."""
    k = dirac_point(*bonds)
    slopes = -1j * bonds[1] * np.exp(-1j * k[0]), -1j * bonds[2] * np.exp(-1j * k[1])
    return -np.sign((slopes[0].conj() * slopes[1]).imag)


@pytest.mark.parametrize("bonds", [(1, 1, 1), (1, 0.8, 0.9), (1, 0.7, 0.55), (1.9, 1, 1.05)])
def test_a_gap_as_small_as_the_limit_has_its_half_number(bonds):
    # the gap is 2 mass, and the largest of omega^2 the sum of the bonds
    for share, points in ((2e-9, 7), (2e-9, 24), (1e-6, 25), (1e-4, 13)):
        for sign in (1, -1):
            matrix = three_ways(bonds, sign * share * sum(bonds) / 2)
            number = topology.valley_chern(matrix, valley=dirac_point(*bonds), points=points)
            assert abs(number - sign * sense(bonds) * 0.5) < 3e-4
    closed = topology.berry_curvature(three_ways(bonds, 0.9e-9 * sum(bonds) / 2), points=13)
    assert closed.fault


def fukui(matrices, bands):
    """Chern number by the sum over a plain mesh of matrices (n, n, P, P)."""
    q = np.linalg.eigh(matrices)[1][..., bands]
    one, two = (np.linalg.det(q.conj().swapaxes(-1, -2) @ np.roll(q, -1, axis)) for axis in (0, 1))
    return -np.angle(one * np.roll(two, -1, 0) * (np.roll(one, -1, 1) * two).conj()).sum() / (
        2 * np.pi
    )


@pytest.mark.parametrize("points", [7, 24, 25])
def test_chern_numbers_beside_a_transition(points):
    # at one valley the two masses cancel for mass = 3 3^{1/2} second: the gap is 2 share there
    for share in (1e-2, 1e-5, 3e-8):
        mass = 3 * 3**0.5 * 0.1
        assert topology.chern(lambda k: haldane(k, mass + share), points=points) == 0
        assert abs(topology.chern(lambda k: haldane(k, mass - share), points=points)) == 1


@pytest.mark.slow
@pytest.mark.parametrize("seed, size", [(0, 2), (1, 3), (2, 4), (3, 3), (4, 5), (6, 2)])
def test_chern_numbers_of_random_bands_on_coarse_meshes(seed, size):
    random = np.random.default_rng(seed)
    parts = random.normal(size=(3, 3, size, size)) + 1j * random.normal(size=(3, 3, size, size))
    way = np.arange(-1, 2)

    def matrix(k, xp=jnp):
        one, two = (xp.exp(1j * k[..., i, None] * way) for i in (0, 1))
        half = xp.einsum("...a,...b,abpq->...pq", one, two, parts)
        return half + half.conj().swapaxes(-1, -2)

    k = 2 * np.pi * np.arange(300) / 300
    mesh = np.stack(np.meshgrid(k + 0.1, k + 0.2, indexing="ij"), -1)
    for bands in ([0], list(range(size // 2 + 1))[: size - 1]):
        whole = fukui(matrix(mesh, np), bands)
        found = topology.berry_curvature(matrix, bands, points=5 + seed)
        assert abs(found.chern - whole) < 1e-9, (found.gap, bands)


@pytest.mark.slow
def test_bands_that_cross_or_all_but_touch_along_a_curve_have_no_number():
    def matrix(k, coupling):
        one, two = (
            2 - jnp.cos(k[0]) - jnp.cos(k[1]),
            1.3 + 0.2 * jnp.cos(k[0] + 0.3) * jnp.cos(k[1]),
        )
        c = coupling * (0.3 + jnp.exp(1j * k[0]))
        return jnp.array([[one, c], [jnp.conj(c), two]])

    crossing = topology.berry_curvature(lambda k: matrix(k, 0.0))
    assert "touches others" in crossing.outcome and np.isnan(crossing.chern)
    one, two = np.diag(np.asarray(matrix(jnp.asarray(crossing.nearest), 0.0)).real)
    assert abs(one - two) < 1e-8
    near = topology.berry_curvature(lambda k: matrix(k, 1e-6))
    assert "too close over too much of the zone" in near.outcome and np.isnan(near.chern)
    assert topology.chern(lambda k: matrix(k, 0.1)) == 0
    # all of the zone at one small distance is no trouble
    small = lambda k: (2 - jnp.cos(k[0])) * jnp.eye(2) + 1e-5 * haldane(k)
    assert abs(topology.chern(small)) == 1


def test_chains_whose_bands_touch_at_any_k():
    def chain(a, b, c, mass=0.0):
        def matrix(k):
            h = a + b * jnp.exp(1j * k[0]) + c * jnp.exp(2j * k[0])
            return jnp.array([[mass, h], [jnp.conj(h), -mass]])

        return matrix

    for b in (0.3, 1.1, 1.7):
        # a + b z + c z^2 has both roots on the unit circle for a = c, |b| < 2
        found = topology.zak(chain(1, b, 1), points=16)
        assert np.isnan(found.phase).all() and f"{np.arccos(-b / 2):.6g}" in found.outcome
        with refused("touches others at k = "):
            topology.winding(chain(1, b, 1))
        for share in (1e-2, 1e-8):
            assert topology.winding(chain(1 + share, b, 1), points=9) == 0
            assert topology.winding(chain(1 - share, b, 1), points=9) == -2
            inside = topology.zak(chain(1 - share, b, 1, 1e-3), points=16)
            # by the closed form: half of the angle that the vector encloses, on a dense mesh
            k = np.linspace(0, 2 * np.pi, 200001)[:-1]
            h = 1 - share + b * np.exp(1j * k) + np.exp(2j * k)
            turned = np.angle(np.roll(h, -1) / h)
            weight = (1 + 1e-3 / np.sqrt(1e-6 + np.abs(h) ** 2)) / 2
            exact = (turned * (weight + np.roll(weight, -1)) / 2).sum()
            assert abs(np.exp(1j * inside.phase[0]) - np.exp(1j * exact)) < inside.error < 0.02


def quadrupole(k, inner=0.5, outer=1.0):
    x, y = inner + outer * jnp.exp(1j * k[0]), inner + outer * jnp.exp(1j * k[1])
    D = jnp.zeros((4, 4), complex).at[0, 1].set(x).at[2, 3].set(x).at[0, 2].set(y).at[1, 3].set(-y)
    return D + D.conj().T


def quadrupole_closed(k):
    """The gap closes at k = (pi, pi), moved to where no mesh has a point."""
    return quadrupole(k + jnp.array([0.2, 0.3]), 1.0)


def test_the_quadrupole():
    assert topology.quadrupole(quadrupole) == (0.5, 0.5)
    assert topology.quadrupole(lambda k: quadrupole(k, 1.0, 0.5)) == (0.0, 0.0)
    for points in (6, 7):
        assert topology.quadrupole(lambda k: quadrupole(k, 1 - 1e-8), points=points) == (0.5, 0.5)
        assert topology.quadrupole(lambda k: quadrupole(k, 1 + 1e-8), points=points) == (0.0, 0.0)
        assert np.isnan(topology.quadrupole(quadrupole_closed, points=points)).all()


@pytest.mark.parametrize(
    "name, sites", [("sawtooth", 3), ("stub", 3), ("diamond", 2), ("kagome", 6), ("lieb", 4)]
)
def test_flat_bands_and_their_compact_states(name, sites):
    plane = name in ("kagome", "lieb")
    options = {"out_of_plane": True, "boundary": "periodic"} if plane else {}
    lattice = getattr(scenes, name)(6 if plane else 8, **options, ground=0.3)
    found = gx.linear.flat_bands(lattice)
    assert len(found.omega) == 1 and found.support[0] == sites and found.width[0] < 1e-13 * 10
    state = found.state(lattice)
    acceleration = lattice.acceleration(0.0, state.u, state.v)
    for field, u in state.u.items():
        assert np.abs(acceleration[field] + found.omega_squared[0] * u).max() < 1e-13
    assert sum(int((np.abs(np.asarray(u)) > 0).sum()) for u in state.u.values()) == sites


@pytest.mark.slow
def test_a_compact_state_keeps_its_support_and_is_lost_without_equal_sites():
    chain = scenes.diamond(8, ground=0.5, on_site=gx.Polynomial(0.0, 0.0, 0.4))
    found = gx.linear.flat_bands(chain)
    start = found.state(chain)
    run = gx.simulate(chain, gx.State(start.u, start.v), 1000 * 2 * np.pi / float(found.omega[0]))
    outside = {
        name: np.asarray(u)[np.asarray(start.u[name]) == 0] for name, u in run.final.u.items()
    }
    assert max(np.abs(u).max() for u in outside.values()) < 1e-14
    lost = scenes.stub(8, equal=False)
    assert not len(gx.linear.flat_bands(lost).omega)


@pytest.mark.slow
def test_edge_bands_of_a_strip():
    strip = gx.linear.ribbon(
        scenes.honeycomb(6, 14, out_of_plane=True, boundary=("periodic", "free"), ground=0.0)
    )
    assert strip.omega.shape == (121, 28)
    plain = gx.linear.dispersion(
        scenes.honeycomb(6, 14, out_of_plane=True, boundary="periodic"), [0.0, 0.0]
    )
    assert abs(float(strip.omega[60].max()) - float(plain.omega.max())) < 0.1
    bound = np.asarray(strip.participation).min(-1)
    assert bound.min() < 2.0
    with refused("periodic"):
        gx.linear.ribbon(scenes.square(6, 6, boundary="free"), axis=0)


def strip_by_hand(width, k):
    """D of a strip of a honeycomb, K = m = 1, between fixed rows: a is bound to two b of its row and one below."""
    D = np.zeros((len(k), 2 * width, 2 * width), complex)
    for n in range(width):
        D[:, 2 * n, 2 * n + 1] = -1 - np.exp(-1j * k)
        if n:
            D[:, 2 * n, 2 * n - 1] = -1
    return D + D.conj().swapaxes(1, 2) + 3 * np.eye(2 * width)


@pytest.mark.parametrize("width", [15, 16])
def test_the_two_edges_of_a_symmetric_strip_are_told_apart(width):
    strip = scenes.honeycomb(5, width, out_of_plane=True, boundary=("periodic", "fixed"))
    k = np.array([3.0, 2.9, 2.6, 0.4])
    found = gx.linear.ribbon(strip, k)
    D = strip_by_hand(width, k)
    assert np.abs(np.linalg.eigvalsh(D) - found.omega_squared).max() < 1e-12
    edge, spread = np.asarray(found.edge), np.asarray(found.participation)
    # half way up the spectrum the strip has one state at each edge
    middle = [width - 1, width]
    for i in (0, 1, 2):
        assert sorted(np.sign(edge[i, middle])) == [-1, 1] and np.abs(edge[i, middle]).min() > 0.75
    assert spread[0, middle].max() < 1.1
    # they still solve the strip, but for what they were taken to be together by
    q = np.stack([np.asarray(found.modes[name]) for name in "ab"], -2).reshape(4, 2 * width, -1)
    left = np.abs(D @ q - q * np.asarray(found.omega_squared)[:, None]).max()
    assert left < 1e-4 * np.abs(D).max()
    assert np.abs(q.conj().swapaxes(1, 2) @ q - np.eye(2 * width)).max() < 1e-12
    # a fifth of the width
    few = int((spread < 0.2 * width).any(0).sum())
    assert (
        found.outcome
        == f"{2 * width} bands at 4 wave numbers; {few} within a fifth of the width at some of them."
    )
    assert 2 <= few < width


def test_the_edges_of_a_free_triangular_strip_are_told_apart():
    strip = scenes.triangular(5, 24, boundary=("periodic", "free"))
    found = gx.linear.ribbon(strip, [2.5, -2.5])
    # Rayleigh waves are the lowest pair: one each side, the same modes in sum as without combining
    edge, spread = np.asarray(found.edge), np.asarray(found.participation)
    assert np.abs(np.abs(edge[:, :2]) - 1).max() < 0.15 and np.abs(edge[:, :2].sum(1)).max() < 1e-6
    assert spread[:, :2].max() < 4 and (spread[:, 5:] > 4).all()
    ring = gx.linear.normal_modes(scenes.triangular(5, 24, boundary=("periodic", "free")))
    near = gx.linear.ribbon(strip, [2 * np.pi / 5])
    assert all(
        np.abs(np.asarray(ring.omega_squared) - x).min() < 1e-12 for x in near.omega_squared[0]
    )


# cells of three fields, by hand: D(k) of masses, with springs (field, field, cell of the second, stiffness) and grounds
def by_hand(k, masses, springs, ground):
    D = np.diag(np.asarray(ground, complex)) + 0 * k[0]
    for i, j, R, K in springs:
        D[i, i] += K
        D[j, j] += K
        D[i, j] -= K * np.exp(1j * np.dot(k, R))
        D[j, i] -= K * np.exp(-1j * np.dot(k, R))
    return D / np.sqrt(np.outer(masses, masses))


KAGOME = [
    (0, 1, (0, 0), 1.0),
    (0, 2, (0, 0), 1.3),
    (1, 2, (0, 0), 0.7),
    (1, 0, (1, 0), 0.4),
    (2, 0, (0, 1), 0.5),
    (1, 2, (1, -1), 0.6),
]
LIEB = [(0, 1, (0, 0), 1.0), (0, 2, (0, 0), 1.3), (1, 0, (1, 0), 0.4), (2, 0, (0, 1), 0.5)]
NESTED = [(0, 0, (1,), 1.0), (0, 1, (0,), 0.6), (1, 2, (0,), 0.3)]


def built(masses, springs, ground, sites):
    """The same as a Lattice of fields a, b, c."""
    bonds = [
        gx.Bond(
            gx.Shift(R, "periodic", ("abc"[i], "abc"[j]))
            if i != j
            else gx.Shift(1, "periodic", "abc"[i]),
            gx.Linear(K),
        )
        for i, j, R, K in springs
    ]
    held = [gx.OnSite(gx.Linear(g), name) for name, g in zip("abc", ground)]
    return gx.Lattice({name: np.full(sites, m) for name, m in zip("abc", masses)}, (*bonds, *held))


@pytest.mark.parametrize("springs", [KAGOME, LIEB])
def test_three_fields_of_the_plane_against_matrices_by_hand(springs):
    masses, ground = (1.0, 1.4, 0.8), (0.2, 0.9, 0.5)
    crystal = built(masses, springs, ground, (5, 5))
    k = RNG.uniform(-np.pi, np.pi, (7, 2))
    exact = np.array([by_hand(x, masses, springs, ground) for x in k])
    assert (
        np.abs(gx.linear.dispersion(crystal, k).omega_squared - np.linalg.eigvalsh(exact)).max()
        < 1e-12
    )
    mesh = 2 * np.pi * np.arange(60) / 60
    dense = np.array([[by_hand((x, y), masses, springs, ground) for y in mesh] for x in mesh])
    q = np.linalg.eigh(dense)[1]
    for band in range(3):
        assert topology.chern(crystal, band, points=9) == 0 == round(fukui(dense, [band]))
    # the phases along one axis by plain products of overlaps, at a wave number of the mesh along the other
    loop = topology.zak(crystal, k=mesh[[7, 30]], points=60)
    for i, j in enumerate((7, 30)):
        links = (q[:, j].conj() * np.roll(q[:, j], -1, 0)).sum(1)
        plain = -np.angle(np.prod(links, axis=0))
        assert (
            np.abs(np.exp(1j * plain) - np.exp(1j * loop.phase[:, i])).max() < 3 * loop.error + 1e-9
        )


def test_a_mass_in_a_mass_in_a_mass_against_matrices_by_hand():
    masses, ground = (1.0, 0.5, 0.3), (0.0, 0.0, 0.1)
    chain = built(masses, NESTED, ground, 9)
    k = np.linspace(-3, 3, 11)
    exact = np.array([by_hand((x,), masses, NESTED, ground) for x in k])
    assert (
        np.abs(gx.linear.dispersion(chain, k).omega_squared - np.linalg.eigvalsh(exact)).max()
        < 1e-12
    )
    # one field alone moves along the chain: D is real, and so no phase is turned
    assert np.abs(topology.zak(chain).phase).max() < 1e-12


def test_a_path_and_the_density_of_states():
    crystal = scenes.triangular(6, 6, boundary="periodic")
    found = gx.linear.path(crystal, "GKMG", count=40)
    at = np.asarray(found.omega_squared)[found.marks]
    assert np.abs(at - [[0, 0], [4.5, 4.5], [2, 6], [0, 0]]).max() < 1e-12
    # the group velocity is the slope of the curve
    slope = np.gradient(np.asarray(found.omega)[:, 1], np.asarray(found.distance))
    inner = np.arange(3, found.marks[1] - 3)
    assert np.abs(slope[inner] - np.asarray(found.slope)[inner, 1]).max() < 5e-3
    chain = scenes.monomer(20, precompression=1.0, boundary="periodic")
    density = gx.linear.density_of_states(chain, 50)
    top = 2 * np.sqrt(1.5)
    edges = np.linspace(0, top, 51)
    exact = 2 / np.pi * np.diff(np.arcsin(np.minimum(edges / top, 1))) / np.diff(edges)
    assert (np.abs(density.density - exact) < density.error + 1e-9).all()
    with refused("points: expected names among"):
        gx.linear.path(crystal, "GQ")


def test_corners_of_the_quadrupole_lattice():
    crystal = scenes.quadrupole(6, k1=0.5, k2=2.0, ground=0.5, boundary="periodic")
    assert topology.quadrupole(crystal) == (0.5, 0.5)
    assert topology.quadrupole(scenes.quadrupole(6, k1=2.0, k2=0.5, boundary="periodic")) == (
        0.0,
        0.0,
    )
    modes = gx.linear.normal_modes(scenes.quadrupole(6, k1=0.5, k2=2.0, ground=0.5))
    squared = np.asarray(modes.omega_squared)
    held = np.flatnonzero(np.abs(squared - 5.5) < 0.2)
    assert len(held) == 4
    share = sum(np.asarray(x)[..., held] ** 2 for x in modes.modes.values())
    corners = share[[0, 0, -1, -1], [0, -1, 0, -1]].sum(0)
    assert corners.min() > 0.8


@pytest.mark.slow
def test_a_wall_between_two_valley_phases_carries_one_mode_for_each_valley():
    width, cells = 24, (6, 24)
    mass = np.broadcast_to(np.where(np.arange(width) < width // 2, 1.25, 1.0), cells)
    strip = scenes.honeycomb(
        *cells,
        mass={"a": mass, "b": 2.25 - mass},
        out_of_plane=True,
        boundary=("periodic", "fixed"),
    )
    k = np.linspace(-np.pi, np.pi, 161)
    found = gx.linear.ribbon(strip, k)
    squared = np.asarray(found.omega_squared)
    share = sum(np.abs(np.asarray(x)) ** 2 for x in found.modes.values())
    # the gap is 3/1.25 ... 3; what crosses its middle, where along k, which way, and how much of it is at the wall
    above = squared > 3 / 1.125
    at, band = np.nonzero(above[1:] != above[:-1])
    assert len(at) == 2 and k[at[0]] < -2 and k[at[1]] > 2
    rising = squared[at + 1, band] > squared[at, band]
    assert rising[0] != rising[1]
    wall = share[at, width // 2 - 4 : width // 2 + 4, band].sum(-1) / share[at, :, band].sum(-1)
    assert wall.min() > 0.9


def edges(spread, even, samples=1000, cells=10):
    """Middle pair of omega^2 of chains k, 2k, ... of random springs; `even`: whether every site is held alike."""

    def modes(key):
        k = jnp.where(jnp.arange(2 * cells + 1) % 2 == 1, 1.0, 2.0)
        k = k * (1 + spread * jax.random.uniform(key, k.shape, minval=-1.0))
        rest = 4.0 - k[1:] - k[:-1]
        held = gx.OnSite(gx.Linear(rest if even else 1.0))
        chain = gx.Lattice(
            1.0, (gx.Bond(gx.Shift(1, "fixed"), gx.Linear(k)), held), sites=2 * cells
        )
        return gx.linear.normal_modes(chain).omega_squared[cells - 1 : cells + 1]

    return np.asarray(jax.vmap(modes)(jax.random.split(jax.random.key(3), samples)))


def test_disorder_that_keeps_sites_alike_keeps_the_edge_frequency():
    alike, generic = edges(0.2, True), edges(0.2, False)
    # the spectrum mirrors about the springs' sum in each sample; the pair's splitting is that of ten cells
    assert np.abs(alike.mean(1) - 4).max() < 1e-12
    assert np.ptp(alike, axis=1).max() < 0.05
    off = generic.mean(1) - 4
    # to first order an end follows its own two springs and what it weighs of the next: of order the disorder
    assert 0.1 < off.std() < 0.4


@pytest.mark.slow
def test_the_quasi_periodic_chain_of_aubry_and_andre():
    for V, gamma in ((3.0, np.log(1.5)), (5.0, np.log(2.5))):
        chain = scenes.aubry_andre(377, V, ground=V)
        omega = np.asarray(gx.linear.normal_modes(chain).omega)[20:360:40]
        # at the frequencies of any of its modes waves fall off alike
        found = gx.linear.localisation_length(scenes.aubry_andre(17711, V, ground=V), omega)
        assert np.abs(np.asarray(found.gamma) / gamma - 1).max() < 0.01
    wide = gx.linear.normal_modes(scenes.aubry_andre(377, 1.0))
    share = 1 / (np.asarray(wide.modes) ** 4).sum(0)
    assert np.median(share) > 80
    # a third of a turn each site: the bands of Hofstadter's lattice
    third = lambda k: (
        jnp.diag(3 + 0.8 * jnp.cos(2 * jnp.pi * jnp.arange(3) / 3 + k[1])).astype(complex)
        - (hop(k[0]) + hop(k[0]).conj().T)
    )
    hop = lambda k: jnp.eye(3, k=1, dtype=complex).at[2, 0].set(jnp.exp(1j * k))
    numbers = [topology.chern(third, band) for band in range(3)]
    assert sorted(map(abs, numbers)) == [1, 1, 2] and sum(numbers) == 0


def test_disorder_of_sites_broadens_a_flat_band_linearly():
    def width(W):
        rng = np.random.default_rng(5)
        chain = scenes.stub(40, ground=0.5)
        more = [gx.OnSite(gx.Linear(W * rng.uniform(-0.5, 0.5, 40)), name) for name in "abc"]
        chain = gx.Lattice(chain.mass, (*chain.terms, *more), sites=40)
        squared = np.asarray(gx.linear.normal_modes(chain).omega_squared)
        return np.ptp(squared[40:80])

    narrow, wide = width(0.01), width(0.02)
    assert abs(wide / narrow - 2) < 0.02 and 0.003 < narrow < 0.01


def breathing(k1, k2, cells=6, **options):
    return scenes.kagome(cells, out_of_plane=True, stiffness=(k1, k1, k1, k2, k2, k2), **options)


def test_the_wilson_loops_of_a_breathing_kagome_give_a_third():
    """The polarisation of the bands, by loops on a mesh whose error falls with the square of the mesh."""

    def polarisation(matrix, bands, n):
        k = 2 * np.pi * np.arange(n) / n
        points = np.stack(np.meshgrid(k, k, indexing="ij"), -1).reshape(-1, 2)
        q = np.linalg.eigh(np.asarray(jax.vmap(matrix)(points)))[1][..., bands]
        q = q.reshape(n, n, *q.shape[1:])
        link = np.linalg.det(q.conj().mT @ np.roll(q, -1, 0))
        return np.unwrap(-np.angle(link.prod(0))).mean() / (2 * np.pi)

    for k1, k2, third in ((1.0, 0.3, 0), (0.3, 1.0, 2), (0.2, 2.0, 2)):
        cell = gx.linear.unit_cell(breathing(k1, k2, boundary="periodic"))
        for bands, expected in (([0], third), ([1, 2], -third)):
            coarse, fine = (polarisation(cell.dynamical_matrix, bands, n) for n in (24, 48))
            off = (4 * fine - coarse) / 3 - expected / 3
            assert abs(off - np.round(off)) < 1e-5


def test_a_triangle_of_breathing_kagome_has_a_state_at_each_corner():
    inside = lambda p: p[..., 0] + p[..., 1] / 3**0.5 < 2 * 6 - 0.5

    def near(k1, k2, **options):
        crystal = breathing(k1, k2, outline=inside, **options)
        modes = gx.linear.normal_modes(crystal)
        squared = np.asarray(modes.omega_squared)
        held = np.flatnonzero(np.abs(squared - 2 * (k1 + k2)) < 0.3)
        share = np.concatenate([np.asarray(modes.modes[name])[:, held] ** 2 for name in "abc"])
        places = np.concatenate([np.asarray(crystal.positions[name]) for name in "abc"])
        return squared[held] - 2 * (k1 + k2), share, places

    off, share, places = near(0.2, 1.0)
    assert len(off) == 3 and np.abs(off).max() < 2e-4
    middle = places.mean(0)
    corners = np.argsort(-np.linalg.norm(places - middle, axis=1))[:3]
    assert (share[corners].sum(0) > 0.85).all()
    # the gap of the bulk, in which they lie
    bulk = np.asarray(
        gx.linear.dispersion(
            breathing(0.2, 1.0, boundary="periodic"),
            np.random.default_rng(1).uniform(-np.pi, np.pi, (200, 2)),
        ).omega_squared
    )
    assert bulk[:, 0].max() < 2.4 - 0.4 and bulk[:, 1].min() > 2.4 + 0.4
    assert not len(near(1.0, 0.2)[0])
    # sites of a free edge are held by less
    loose, share, _ = near(0.2, 1.0, boundary="free")
    assert share[corners].max() < 0.85 or len(loose) != 3


def test_a_lattice_without_a_flat_band_has_no_compact_state():
    chain = gx.scenes.monomer(8, precompression=1.0, boundary="periodic")
    with refused("a flat band"):
        gx.linear.flat_bands(chain).state(chain)
