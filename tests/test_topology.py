"""Topology and flat bands: whole numbers, closed forms, states that stay where they are."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx
from granjax import scenes, topology

RNG = np.random.default_rng(11)


def test_the_chain_of_su_schrieffer_and_heeger():
    for k1, k2, phase, turns in ((1.0, 2.0, np.pi, 1), (2.0, 1.0, 0.0, 0), (0.3, 0.31, np.pi, 1)):
        chain = scenes.ssh(8, k1, k2, boundary="periodic")
        found = topology.zak(chain)
        assert np.abs(np.abs(found.phase) - phase).max() < 1e-10 and abs(abs(found.below[0]) - phase) < 1e-10
        assert topology.winding(chain) == turns
    with pytest.raises(ValueError, match="touch"):
        topology.winding(scenes.ssh(8, 1.0, 1.0, boundary="periodic"), cell=None)


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
    with pytest.raises(ValueError, match="touch"):
        topology.chern(scenes.honeycomb(6, out_of_plane=True, boundary="periodic"))


def test_valleys_have_half_a_number_as_their_gap_closes():
    def numbers(step):
        crystal = scenes.honeycomb(6, mass={"a": 1.0, "b": 1 + step}, out_of_plane=True, boundary="periodic")
        return [topology.valley_chern(crystal, valley=valley) for valley in ("K", "K'")]

    for step, least in ((0.2, 0.35), (0.02, 0.46)):
        at, other = numbers(step)
        assert abs(at + other) < 1e-10 and least < abs(at) < 0.5
    assert numbers(-0.02)[0] * numbers(0.02)[0] < 0


def quadrupole(k, inner=0.5, outer=1.0):
    x, y = inner + outer * jnp.exp(1j * k[0]), inner + outer * jnp.exp(1j * k[1])
    D = jnp.zeros((4, 4), complex).at[0, 1].set(x).at[2, 3].set(x).at[0, 2].set(y).at[1, 3].set(-y)
    return D + D.conj().T


def test_the_quadrupole():
    assert topology.quadrupole(quadrupole) == (0.5, 0.5)
    assert topology.quadrupole(lambda k: quadrupole(k, 1.0, 0.5)) == (0.0, 0.0)


@pytest.mark.parametrize("name, sites", [("sawtooth", 3), ("stub", 3), ("diamond", 2), ("kagome", 6), ("lieb", 4)])
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
    outside = {name: np.asarray(u)[np.asarray(start.u[name]) == 0] for name, u in run.final.u.items()}
    assert max(np.abs(u).max() for u in outside.values()) < 1e-14
    lost = scenes.stub(8, equal=False)
    assert not len(gx.linear.flat_bands(lost).omega)


@pytest.mark.slow
def test_edge_bands_of_a_strip():
    strip = gx.linear.ribbon(scenes.honeycomb(6, 14, out_of_plane=True, boundary=("periodic", "free"), ground=0.0))
    assert strip.omega.shape == (121, 28)
    plain = gx.linear.dispersion(scenes.honeycomb(6, 14, out_of_plane=True, boundary="periodic"), [0.0, 0.0])
    assert abs(float(strip.omega[60].max()) - float(plain.omega.max())) < 0.1
    bound = np.asarray(strip.participation).min(-1)
    assert bound.min() < 2.0
    with pytest.raises(ValueError, match="periodic"):
        gx.linear.ribbon(scenes.square(6, 6, boundary="free"), axis=0)


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
    for wrong in ("GQ", "G"):
        with pytest.raises(ValueError, match="points"):
            gx.linear.path(crystal, wrong)


def test_corners_of_the_quadrupole_lattice():
    crystal = scenes.quadrupole(6, k1=0.5, k2=2.0, ground=0.5, boundary="periodic")
    assert topology.quadrupole(crystal) == (0.5, 0.5)
    assert topology.quadrupole(scenes.quadrupole(6, k1=2.0, k2=0.5, boundary="periodic")) == (0.0, 0.0)
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
    strip = scenes.honeycomb(*cells, mass={"a": mass, "b": 2.25 - mass}, out_of_plane=True,
                             boundary=("periodic", "fixed"))
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
        chain = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "fixed"), gx.Linear(k)), held), sites=2 * cells)
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
    third = lambda k: jnp.diag(3 + 0.8 * jnp.cos(2 * jnp.pi * jnp.arange(3) / 3 + k[1])).astype(complex) - (
        hop(k[0]) + hop(k[0]).conj().T)
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


def test_the_polarisation_of_a_breathing_kagome_is_a_third():
    for k1, k2, third in ((1.0, 0.3, 0), (0.3, 1.0, 2), (0.2, 2.0, 2)):
        for bands, expected in ((0, third), ((1, 2), -third % 3)):
            found = topology.polarisation(breathing(k1, k2, boundary="periodic"), bands)
            assert np.abs(found.polarisation - expected / 3).max() < 1e-10 and found.error < 1e-7
            assert found.centres.shape == (2, 48, np.size(bands))
    with pytest.raises(ValueError, match="touch"):
        topology.polarisation(breathing(1.0, 1.0, boundary="periodic"))


def test_the_polarisation_without_symmetry_and_its_error():
    def matrix(k):
        h = 0.5 + jnp.exp(1j * k[0]) + 0.2 * jnp.exp(1j * k[1])
        return jnp.array([[0.2, h], [jnp.conj(h), -0.2]])

    fine = topology.polarisation(matrix, points=128)
    assert fine.error < 1e-12 and np.abs(fine.polarisation * 6 % 1 - 0.5).max() < 0.499
    for points in (12, 24, 48):
        found = topology.polarisation(matrix, points=points)
        assert np.abs(found.polarisation - fine.polarisation).max() <= found.error
    # both bands together are a cell's two sites
    both = topology.polarisation(lambda k: matrix(k), (0, 1), points=8)
    assert np.abs(both.polarisation).max() < 1e-10
    # by the Berry connection on a dense mesh, in a gauge that is smooth: the vector of the lower band in closed form
    k = 2 * np.pi * np.arange(256) / 256
    x, y = np.meshgrid(k, k, indexing="ij")
    h = 0.5 + np.exp(1j * x) + 0.2 * np.exp(1j * y)
    size = np.sqrt(0.04 + np.abs(h) ** 2)
    weight = (1 + 0.2 / size) / 2  # of the second site, in the gauge where the first component is real
    for axis, slope in enumerate((1j * np.exp(1j * x), 0.2j * np.exp(1j * y))):
        # q = (a, -b exp(-i arg h)): i <q|dq> = b^2 d(arg h)
        mean = (weight * (slope * h.conj()).imag / np.abs(h) ** 2).mean()
        assert abs((fine.polarisation[axis] - mean + 0.5) % 1 - 0.5) < 1e-10
    with pytest.raises(ValueError, match="Chern"):
        topology.polarisation(haldane)


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
    bulk = np.asarray(gx.linear.dispersion(breathing(0.2, 1.0, boundary="periodic"),
                                           np.random.default_rng(1).uniform(-np.pi, np.pi, (200, 2))).omega_squared)
    assert bulk[:, 0].max() < 2.4 - 0.4 and bulk[:, 1].min() > 2.4 + 0.4
    assert not len(near(1.0, 0.2)[0])
    # sites of a free edge are held by less
    loose, share, _ = near(0.2, 1.0, boundary="free")
    assert share[corners].max() < 0.85 or len(loose) != 3


def linked(found, masses):
    """<q_j|q_{j+1}> of the vectors of a path, (K - 1, bands)."""
    vectors = found.vectors if isinstance(found.vectors, dict) else {"": found.vectors}
    flat = [np.asarray(x).reshape(len(x), -1, x.shape[-1]) * np.sqrt(masses[name]) for name, x in vectors.items()]
    q = np.concatenate(flat, 1)
    return (q[:-1].conj() * q[1:]).sum(1), q


def test_the_vectors_of_a_path_follow_their_bands():
    crystal = scenes.honeycomb(6, mass={"a": 1.0, "b": 1.4}, out_of_plane=True, boundary="periodic", ground=0.3)
    found = gx.linear.path(crystal, "GKMG", count=60)
    overlap, q = linked(found, {"a": 1.0, "b": 1.4})
    assert np.abs(overlap.imag).max() < 1e-14 and overlap.real.min() > 0.9
    assert np.abs(np.linalg.norm(q, axis=1) - 1).max() < 1e-12
    # they are those of the bands
    for k, squared, x in zip(found.k[::7], found.omega_squared[::7], q[::7]):
        D = np.asarray(gx.linear.unit_cell(crystal).dynamical_matrix(jnp.asarray(k)))
        assert np.abs(D @ x - x * np.asarray(squared)).max() < 1e-12
    # two polarisations that are together at G and K and cross between: each continues one of those before
    _, q = linked(gx.linear.path(scenes.triangular(6, 6, boundary="periodic"), "GKMG", count=60), {"": 1.0})
    links = np.einsum("kpm,kpn->kmn", q[:-1].conj(), q[1:])
    best = np.take_along_axis(links, np.abs(links).argmax(1)[:, None], 1)
    assert np.abs(best.imag).max() < 1e-14 and best.real.min() > 0.7


@pytest.mark.study
def test_the_vectors_of_a_path_in_float32_and_their_derivative():
    make = lambda m: gx.linear.path(
        scenes.honeycomb(6, mass={"a": 1.0, "b": m}, out_of_plane=True, boundary="periodic", ground=0.3), "KM", 3)
    small = gx.linear.path(scenes.triangular(6, 6, boundary="periodic").astype(np.float32), "GK", count=8)
    assert small.vectors.dtype == np.complex64
    slope = jax.jvp(lambda m: make(m).vectors["a"], (1.4,), (1.0,))[1]
    step = (make(1.4 + 1e-5).vectors["a"] - make(1.4 - 1e-5).vectors["a"]) / 2e-5
    assert np.abs(slope - step).max() < 1e-7


@pytest.mark.slow
def test_a_smooth_gauge_is_closed_up_to_the_zak_phase():
    k = 2 * np.pi * np.arange(64) / 64
    shifted = lambda k: jnp.array([[0.3, 0.4 + jnp.exp(1j * k[0])], [0.4 + jnp.exp(-1j * k[0]), -0.3]])
    own = np.linalg.eigh(np.stack([np.asarray(shifted(jnp.array([x]))) for x in k]))[1]
    dimer = scenes.dimer(12, 0.4, precompression=1.0, boundary="periodic")
    ssh = scenes.ssh(8, 1.0, 2.0, boundary="periodic")
    for lattice, vectors, mass in ((shifted, own, 1.0), (dimer, gx.linear.dispersion(dimer, k).vectors, [1.0, 0.4]),
                                   (ssh, gx.linear.dispersion(ssh, k).vectors, {"a": 1.0, "b": 1.0})):
        found = gx.linear.smooth_gauge(vectors, mass)
        apart = np.angle(np.exp(1j * (found.phase - topology.zak(lattice).phase)))
        assert np.abs(apart).max() < 1e-10 and found.overlap.min() > 0.99
        for q, phase in ((found.vectors, 0 * found.phase), (found.periodic, found.phase / 64)):
            if isinstance(q, dict):
                q = np.concatenate([np.sqrt(mass[name]) * x for name, x in q.items()], 1)
            else:
                q = np.asarray(q) * np.sqrt(np.broadcast_to(mass, 2))[:, None]
            links = (q.conj() * np.roll(q, -1, 0)).sum(1)
            assert np.abs(np.angle(links[:-1]) + phase).max() < 1e-12
        assert np.abs(np.angle(links * np.exp(1j * phase))).max() < 1e-10
    coarse = gx.linear.smooth_gauge(RNG.normal(size=(8, 3, 3)))
    assert "hardly overlap" in coarse.outcome
    with pytest.raises(ValueError, match="four wave numbers"):
        gx.linear.smooth_gauge(own[:3])
    with pytest.raises(ValueError, match="shape"):
        gx.linear.smooth_gauge(own, [1.0, 1.0, 1.0])
