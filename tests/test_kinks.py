"""Kinks against the continuum, against SciPy, and against the limit of zero coupling."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from scipy.optimize import fsolve

import granjax as gx

N = 80
TURN = 2 * np.pi


def double_well(coupling):
    return gx.scenes.klein_gordon(N, coupling, stiffness=2.0, alpha=3.0, beta=1.0)


def pendula(coupling):
    return gx.scenes.sine_gordon(N, coupling)


@pytest.mark.slow
def test_kinks_have_the_energies_of_the_continuum():
    for make, right, exact in ((pendula, TURN, 8.0), (double_well, -2.0, 2 * np.sqrt(2) / 3)):
        off = []
        for h in (0.8, 0.4):
            found = gx.kinks.kink(make(1 / h**2), right)
            off.append(float(found.energy) * h - exact)
            assert found.residual < 1e-10 and np.isfinite(found.energy_error)
        assert abs(off[1]) < 0.01 * exact and off[0] / off[1] == pytest.approx(4, rel=0.15)


@pytest.mark.slow
def test_a_kink_on_a_site_is_that_of_an_independent_root_and_mirrors_the_antikink():
    def rest(u):
        return 0.3 * np.diff(np.diff(u, prepend=u[0], append=u[-1])) - np.sin(u)

    found = gx.kinks.kink(pendula(0.3), TURN, centre=39)
    u = fsolve(rest, np.pi * (1 + np.sign(np.arange(N) - 39)), xtol=1e-13)
    assert_allclose(found.state.u, u, atol=1e-11)
    assert found.verdict == "unstable" and found.growth > 0
    energy = np.sum(1 - np.cos(u)) + 0.15 * np.sum(np.diff(u) ** 2)
    assert float(found.energy) == pytest.approx(energy, rel=1e-12)
    mirrored = gx.kinks.kink(pendula(0.3), -TURN, centre=39)
    assert_allclose(mirrored.state.u, -u, atol=1e-11)
    assert_allclose(mirrored.omega, found.omega, rtol=1e-9)


def test_between_a_site_and_a_bond_it_is_the_nearest():
    for centre, place in ((30.2, 30.0), (30.3, 30.5)):
        u = np.asarray(gx.kinks.kink(pendula(1.0), TURN, centre=centre).state.u)
        assert np.sum(1 - u / TURN) - 0.5 == pytest.approx(place, abs=1e-9)


def test_the_barrier_falls_with_the_width_of_the_kink():
    # weakly coupled the one on a site has a pendulum upside down, and the other has none
    weak = gx.kinks.peierls_nabarro(pendula(1e-4), TURN)
    assert float(weak.barrier) == pytest.approx(2, abs=2e-3)
    assert float(weak.omega) == pytest.approx(1, abs=1e-3)
    barriers = [gx.kinks.peierls_nabarro(pendula(c), TURN) for c in (0.5, 1.0, 2.0)]
    assert np.all(np.diff([float(b.barrier) for b in barriers]) < 0)
    assert all(b.error < 1e-12 and "rests on a bond" in b.outcome for b in barriers)
    # softer than its error in the continuum
    assert "below its error" in gx.kinks.peierls_nabarro(pendula(12.0), TURN).outcome


@pytest.mark.slow
def test_a_kink_moves_at_its_speed():
    lattice = gx.scenes.sine_gordon(161, 4.0)
    start = gx.kinks.moving(lattice, 1.0, TURN, centre=40.0)
    x = np.arange(161) - 40.0
    stretch = 1 / np.sqrt(1 - 0.25)
    assert_allclose(start.u, 4 * np.arctan(np.exp(stretch * x / 2)), atol=0.05)
    assert_allclose(start.v, -stretch / np.cosh(stretch * x / 2), atol=0.05)
    run = gx.simulate(lattice, start, 60.0)
    place = np.interp(np.pi, np.asarray(run.final.u), np.arange(161))
    assert place == pytest.approx(100, rel=0.03)


def test_what_is_no_well_is_refused():
    kink = gx.kinks.kink
    walls = gx.scenes.sine_gordon(N, 0.5, boundary="fixed")
    for call, words in (
        (lambda: kink(pendula(0.5), 3.0), "right: .*a well"),
        (lambda: kink(pendula(0.5), 0.0), "a well other than"),
        (lambda: kink(pendula(0.5), np.pi), "right: .*barrier"),
        (lambda: kink(walls, TURN), "free"),
        (lambda: gx.kinks.moving(pendula(0.25), 0.6, TURN), "velocity: .*0.5, that of long waves"),
        (lambda: kink(gx.scenes.toda(9, boundary="free"), 1.0), "force on the sites"),
        (
            lambda: jax.grad(lambda c: kink(pendula(c), TURN).energy)(1.0),
            "lattice: .*known numbers",
        ),
    ):
        with refused(words):
            call()
    short = gx.scenes.sine_gordon(12, 9.0)
    with pytest.raises(RuntimeError, match="the ends are too near"):
        kink(short, TURN, centre=4.5)
    # no other centre is better than the middle
    with pytest.raises(RuntimeError, match="free ends.$"):
        kink(short, TURN)
    # half a site away rests the kink of the other kind, which was not asked for
    for centre in (None, 9.5):
        with pytest.raises(RuntimeError, match="the ends are too near"):
            kink(gx.scenes.sine_gordon(21, 9.0), TURN, centre=centre)


class Pendulum(gx.Law):
    """A law as a user writes it, of wells at 0 and 2 pi/q, the field's own unit of length."""

    q: float

    def force(self, e):
        return jnp.sin(self.q * e) + jnp.sin(2 * self.q * e) / 4

    def energy(self, e):
        return (1 - jnp.cos(self.q * e)) / self.q + (1 - jnp.cos(2 * self.q * e)) / (8 * self.q)


@pytest.mark.slow
def test_a_kink_of_a_long_range_chain_against_dense_matrices():
    kernel = np.asarray(gx.fractional.kernel(0.4, 13))
    right = TURN / 100
    term = gx.LongRange(kernel, gx.Linear(80.0), "free")
    law = Pendulum(100.0)
    chain = gx.Lattice(np.linspace(1.0, 2.0, 14), (term, gx.OnSite(law)), sites=14)
    sites = np.arange(14)
    K = -80 * np.append(0.0, kernel)[np.abs(np.subtract.outer(sites, sites))]
    K -= np.diag(K.sum(1))
    force = lambda u: K @ u + np.sin(100 * u) + np.sin(200 * u) / 4
    stiffness = lambda u: K + np.diag(100 * np.cos(100 * u) + 50 * np.cos(200 * u))
    found = gx.kinks.kink(chain, right)
    u = fsolve(force, np.where(sites > 6, right, 0.0), fprime=stiffness, xtol=1e-13)
    assert_allclose(found.state.u, u, rtol=0, atol=1e-11 * right)
    root = np.sqrt(chain.mass)
    squares = np.linalg.eigvalsh(stiffness(u) / root / root[:, None])
    assert_allclose(found.omega, np.sqrt(np.maximum(squares, 0)), rtol=1e-8)
    assert float(found.growth) == pytest.approx(np.sqrt(max(-squares[0], 0)), rel=1e-8)
    assert found.verdict == ("stable" if squares[0] > 0 else "unstable")


class Uneven(gx.Law):
    """The on-site force of phi^6: the wells 0 and 1 have the curvatures 1 and 4."""

    def force(self, e):
        return e * (1 - e**2) * (1 - 3 * e**2)

    def energy(self, e):
        return 0.5 * e**2 * (1 - e**2) ** 2


class Ratchet(gx.Law):
    """A ratchet with the wells 0 and 2 pi."""

    def force(self, e):
        return jnp.sin(e) + 0.6 * (jnp.cos(2 * e) - jnp.cos(e))

    def energy(self, e):
        return 1 - jnp.cos(e) + 0.3 * jnp.sin(2 * e) - 0.6 * jnp.sin(e)


@pytest.mark.parametrize(
    "law, coupling, right",
    [(Uneven(), 0.02, 1.0), (Uneven(), 0.3, 1.0), (Ratchet(), 0.2, TURN)],
)
def test_between_wells_that_are_no_mirror_images_two_kinks_rest_in_a_cell(law, coupling, right):
    lattice = gx.scenes.klein_gordon(41, coupling, law=law)
    K = coupling * (np.diag([1.0] + 39 * [2.0] + [1.0]) - np.eye(41, k=1) - np.eye(41, k=-1))
    force = lambda u: K @ u + np.asarray(law.force(u))
    # from several displacements of one site between the wells
    energies = {}
    for share in np.linspace(0, 1, 9):
        guess = right * np.where(np.arange(41) == 20, share, np.arange(41) > 20)
        u, _, code, _ = fsolve(force, guess, xtol=1e-13, full_output=True)
        slope = jax.vmap(jax.grad(law.force))(jnp.asarray(u))
        down = np.sum(np.linalg.eigvalsh(K + np.diag(slope)) < 0)
        energy = float(u @ K @ u / 2 + np.sum(law.energy(u)))
        if code == 1 and np.ptp(u) > 0.9 * right:
            energies[down] = min(energy, energies.get(down, np.inf))
    found = gx.kinks.peierls_nabarro(lattice, right)
    wanted = energies[0], energies[1]
    assert_allclose(sorted((float(found.site), float(found.bond))), wanted, rtol=1e-9)
    assert float(found.barrier) == pytest.approx(wanted[1] - wanted[0], rel=1e-8)
    assert found.higher == "unstable"


SHORT = """
import granjax as gx, jax.numpy as jnp, numpy as np
found = gx.kinks.peierls_nabarro(gx.scenes.sine_gordon(31), 2 * np.pi)
print(float(found.barrier), float(found.error))
found = gx.first_order.soliton(gx.first_order.DNLS(20), omega=-1.0)
print(float(found.psi[10]), float(found.norm))
wells = gx.OnSite(gx.Polynomial(-1.0, 0.0, 1.0))
pair = gx.Lattice(1.0, (wells, gx.Bond(gx.Shift(1, "free"), gx.Linear(0.2))), sites=2)
guess = gx.State(jnp.array([0.5, 0.2]), jnp.zeros(2))
found = gx.orbits.find_all(gx.orbits.problem(pair), [guess])
print(*(float(one.state.u[0]) for one in found.solutions))
"""


@pytest.mark.slow
def test_kinks_solitons_and_all_equilibria_in_float32():
    own = os.environ | {"JAX_ENABLE_X64": "0"}
    done = subprocess.run(
        [sys.executable, "-c", SHORT], env=own, capture_output=True, text=True, check=True
    )
    (barrier, error), soliton, rest = (
        [float(x) for x in line.split()] for line in done.stdout.splitlines()
    )
    # the numbers of float64
    assert abs(barrier - 0.0253641556) < error < 1e-4
    assert_allclose(soliton, [1.44082628, 3.12220627], rtol=1e-6)
    assert_allclose(rest, [0.864, 0.0, 1.0, 0.6**0.5], atol=1e-4)
