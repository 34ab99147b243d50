"""Kinks against the continuum, against SciPy, and against the limit of zero coupling."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import fsolve
from scipy.special import gamma

import granjax as gx

N = 80


def double_well(coupling):
    return gx.scenes.klein_gordon(N, coupling, stiffness=2.0, alpha=3.0, beta=1.0)


def pendula(coupling):
    return gx.scenes.sine_gordon(N, coupling)


@pytest.mark.slow
def test_kinks_have_the_energies_of_the_continuum():
    for make, right, exact in ((pendula, 2 * np.pi, 8.0), (double_well, -2.0, 2 * np.sqrt(2) / 3)):
        off = []
        for h in (0.8, 0.4):
            found = gx.kinks.kink(make(1 / h**2), right)
            off.append(float(found.energy) * h - exact)
            assert found.residual < 1e-10 and np.isfinite(found.energy_error)
        assert abs(off[1]) < 0.01 * exact and off[0] / off[1] == pytest.approx(4, rel=0.15)


def test_a_kink_is_that_of_an_independent_root():
    def rest(u):
        return 0.3 * np.diff(np.diff(u, prepend=u[0], append=u[-1])) - np.sin(u)

    found = gx.kinks.kink(pendula(0.3), 2 * np.pi, centre=39)
    u = fsolve(
        rest,
        np.where(np.arange(N) == 39, np.pi, np.where(np.arange(N) < 39, 0, 2 * np.pi)),
        xtol=1e-13,
    )
    np.testing.assert_allclose(found.state.u, u, atol=1e-11)
    assert found.verdict == "unstable" and found.growth > 0
    energy = np.sum(1 - np.cos(u)) + 0.15 * np.sum(np.diff(u) ** 2)
    assert float(found.energy) == pytest.approx(energy, rel=1e-12)


def test_between_a_site_and_a_bond_it_is_the_nearest():
    for centre, place in ((30.2, 30.0), (30.3, 30.5)):
        u = np.asarray(gx.kinks.kink(pendula(1.0), 2 * np.pi, centre=centre).state.u)
        assert np.sum(1 - u / (2 * np.pi)) - 0.5 == pytest.approx(place, abs=1e-9)


def test_the_barrier():
    # weakly coupled the one on a site has a pendulum upside down, and the other has none
    weak = gx.kinks.peierls_nabarro(pendula(1e-4), 2 * np.pi)
    assert float(weak.barrier) == pytest.approx(2, abs=2e-3) and float(weak.omega) == pytest.approx(
        1, abs=1e-3
    )
    barriers = [gx.kinks.peierls_nabarro(pendula(c), 2 * np.pi) for c in (0.5, 1.0, 2.0)]
    assert np.all(np.diff([float(b.barrier) for b in barriers]) < 0)
    assert all(b.error < 1e-12 and "rests on a bond" in b.outcome for b in barriers)
    # softer than its error in the continuum
    assert "below its error" in gx.kinks.peierls_nabarro(pendula(12.0), 2 * np.pi).outcome


def test_an_antikink_is_the_mirrored_kink():
    there, here = (gx.kinks.kink(pendula(0.5), way * 2 * np.pi) for way in (-1, 1))
    np.testing.assert_allclose(-there.state.u, here.state.u, atol=1e-11)
    np.testing.assert_allclose(there.omega, here.omega, rtol=1e-9)


@pytest.mark.slow
def test_a_kink_moves_at_its_speed():
    lattice = gx.scenes.sine_gordon(161, 4.0)
    start = gx.kinks.moving(lattice, 1.0, 2 * np.pi, centre=40.0)
    x, stretch = np.arange(161) - 40.0, 1 / np.sqrt(1 - 0.25)
    np.testing.assert_allclose(start.u, 4 * np.arctan(np.exp(stretch * x / 2)), atol=0.05)
    run = gx.simulate(lattice, start, 60.0)
    u = np.asarray(run.final.u)
    place = np.interp(np.pi, u, np.arange(161))
    assert place == pytest.approx(100, rel=0.03)


def test_what_is_no_well_is_refused():
    for make, words in (
        (lambda: gx.kinks.kink(pendula(0.5), 3.0), "right: .*a well"),
        (lambda: gx.kinks.kink(pendula(0.5), 0.0), "another well"),
        (lambda: gx.kinks.kink(pendula(0.5), np.pi), "right: .*barrier"),
        (lambda: gx.kinks.kink(gx.scenes.sine_gordon(N, 0.5, boundary="fixed"), 2 * np.pi), "free"),
        (
            lambda: gx.kinks.moving(pendula(0.25), 0.6, 2 * np.pi),
            "velocity: .*0.5, that of long waves",
        ),
        (lambda: gx.kinks.kink(gx.scenes.toda(9, boundary="free"), 1.0), "force on the sites"),
    ):
        with pytest.raises(ValueError, match=words):
            make()
    with pytest.raises(RuntimeError, match="the ends are too near"):
        gx.kinks.kink(gx.scenes.sine_gordon(12, 9.0), 2 * np.pi, centre=4.5)
    # no other centre is better than the middle
    with pytest.raises(RuntimeError, match="free ends.$"):
        gx.kinks.kink(gx.scenes.sine_gordon(12, 9.0), 2 * np.pi)


def free_couplings(weights):
    """The stiffness of springs to all neighbours of a free chain, as a matrix."""
    apart = np.abs(np.subtract.outer(np.arange(len(weights) + 1), np.arange(len(weights) + 1)))
    K = -np.concatenate([[0.0], weights])[apart]
    return K - np.diag(K.sum(1))


class Pendulum(gx.Law):
    """A law as a user writes it, of wells at 0 and 2 pi/q, the field's own unit of length."""

    q: float

    def force(self, e):
        return jnp.sin(self.q * e) + jnp.sin(2 * self.q * e) / 4

    def energy(self, e):
        return (1 - jnp.cos(self.q * e)) / self.q + (1 - jnp.cos(2 * self.q * e)) / (8 * self.q)


def fractional_kernel(s, count):
    m = np.arange(1, count + 1)
    size = 4**s * gamma(0.5 + s) / np.sqrt(np.pi) / abs(gamma(-s))
    return size * gamma(m - s) / gamma(m + 1 + s)


@pytest.mark.parametrize(
    "case",
    [
        "fractional",
        pytest.param("two harmonics", marks=pytest.mark.slow),
        pytest.param("double well", marks=pytest.mark.slow),
        pytest.param("heavy", marks=pytest.mark.slow),
    ],
)
def test_kinks_of_long_range_chains_against_dense_matrices(case):
    if case == "fractional":  # 12 sites, as named in the literature
        chain = gx.scenes.fractional_sine_gordon(12, 0.7, 0.1, boundary="free")
        weights, own, slope, right = 0.1 * fractional_kernel(0.7, 11), np.sin, np.cos, 2 * np.pi
    elif case == "two harmonics":
        law = Pendulum(100.0)
        chain = gx.scenes.fractional(14, 0.4, law=gx.Linear(80.0), on_site=law, boundary="free")
        weights, right = 80 * fractional_kernel(0.4, 13), 2 * np.pi / 100
        own = lambda u: np.sin(100 * u) + np.sin(200 * u) / 4
        slope = lambda u: 100 * np.cos(100 * u) + 50 * np.cos(200 * u)
    elif case == "double well":
        kernel = np.arange(1.0, 16) ** -2.5
        term = gx.LongRange(kernel, gx.Linear(0.3), "free")
        chain = gx.Lattice(1.0, (term, gx.OnSite(gx.Polynomial(2.0, 3.0, 1.0))), sites=16)
        weights, right = 0.3 * kernel, -2.0
        own, slope = lambda u: 2 * u + 3 * u**2 + u**3, lambda u: 2 + 6 * u + 3 * u**2
    else:
        kernel = np.exp(-0.5 * np.arange(1.0, 13))
        term = gx.LongRange(kernel, gx.Linear(0.2), "free")
        chain = gx.Lattice(np.linspace(1.0, 2.0, 13), (term, gx.OnSite(gx.Sine(1.0))), sites=13)
        weights, own, slope, right = 0.2 * kernel, np.sin, np.cos, 2 * np.pi
    K = free_couplings(weights)
    found = gx.kinks.kink(chain, right)
    half = np.arange(len(K)) > (len(K) - 1) // 2
    u = fsolve(
        lambda u: K @ u + own(u),
        np.where(half, right, 0.0),
        fprime=lambda u: K + np.diag(slope(u)),
        xtol=1e-13,
    )
    np.testing.assert_allclose(found.state.u, u, rtol=0, atol=1e-11 * abs(right))
    root = np.sqrt(np.broadcast_to(chain.mass, len(K)))
    squares = np.linalg.eigvalsh((K + np.diag(slope(u))) / root / root[:, None])
    np.testing.assert_allclose(found.omega, np.sqrt(np.maximum(squares, 0)), rtol=1e-8)
    assert float(found.growth) == pytest.approx(np.sqrt(max(-squares[0], 0)), rel=1e-8)
    assert found.verdict == ("stable" if squares[0] > 0 else "unstable")
