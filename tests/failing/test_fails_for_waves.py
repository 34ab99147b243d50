"""Travelling waves: where the plain fixed point, the Fourier form and compactons fail."""

import numpy as np
import pytest

import granjax as gx

HALF = 16.0
POINTS = 512
X = (np.arange(POINTS) - POINTS // 2) * 2 * HALF / POINTS
BOX = np.sinc(np.fft.rfftfreq(POINTS, 2 * HALF / POINTS)) ** 2
PHI_5 = 1.66653015582526e-15
PHI_6 = 8.06238434e-26


def tent(f):
    return np.fft.irfft(BOX * np.fft.rfft(f), POINTS)


@pytest.fixture(scope="module")
def wave():
    return gx.travelling.solitary_wave(gx.Hertz(), speed=1.0)


@pytest.mark.slow
def test_the_plain_fixed_point_diverges_along_the_amplitude(wave):
    """phi <- tent * phi^(3/2), as printed: an error of the amplitude grows by 3/2 each time, either way."""
    exact = np.asarray(wave.strain(X))
    for error in (1e-4, -1e-4):
        phi = (1 + error) * exact
        sizes = []
        for _ in range(8):
            phi = np.maximum(tent(np.maximum(phi, 0) ** 1.5), 0)
            sizes.append(phi.max() / exact.max() - 1)
        np.testing.assert_allclose(np.array(sizes[1:]) / sizes[:-1], 1.5, atol=5e-3)
    for _ in range(12):
        phi = np.maximum(tent(phi**1.5), 0)
    assert phi.max() < 0.8 * exact.max()
    # Petviashvili's factor turns 3/2 into 0
    for _ in range(60):
        g = np.maximum(tent(phi**1.5), 0)
        phi = (phi @ phi / (phi @ g)) ** 3 * g
    np.testing.assert_allclose(phi, exact, atol=1e-13)


@pytest.mark.slow
def test_the_fourier_form_has_a_floor_in_the_tail(wave):
    """Its sums have both signs and round at 1e-16 of the peak; the tent integral's terms are all positive."""
    phi = tent(np.asarray(wave.strain(X)) ** 1.5)
    at = {place: int(np.argmin(np.abs(X - place))) for place in (4, 5, 6, 7)}
    assert abs(phi[at[4]] / float(wave.strain(4.0)) - 1) < 1e-6
    assert abs(phi[at[5]] / PHI_5 - 1) > 1e-3 and abs(phi[at[6]]) > 1e5 * PHI_6
    assert float(wave.strain(5.0)) == pytest.approx(PHI_5, rel=1e-12)
    assert float(wave.strain(6.0)) == pytest.approx(PHI_6, rel=1e-8)


def compacton(x, top, rate):
    inside = np.abs(rate * x) < np.pi / 2
    return np.where(inside, top * np.cos(np.where(inside, rate * x, 0)) ** 4, 0.0)


@pytest.mark.slow
def test_compactons_as_initial_data_shed_what_the_wave_does_not():
    """Nesterenko's and Ahnert and Pikovsky's at c = 1, set on the lattice, and the wave itself."""
    sites = 60
    centre = 12.0
    travel = 30
    lattice = gx.scenes.monomer(sites, boundary="free")
    # v(x) = int_{x-1}^x phi^(3/2), by Gauss and Legendre
    t, w = np.polynomial.legendre.leggauss(40)
    x = np.arange(sites) - centre
    states = [gx.states.solitary_wave(lattice, centre, speed=1.0)]
    for shape in ((25 / 16, 0.4**0.5), (36 / 25, 3**-0.5)):
        u = np.cumsum(compacton(x, *shape)[::-1])[::-1].copy()
        v = compacton(x[:, None] - (1 + t) / 2, *shape) ** 1.5 @ w / 2
        states.append(gx.State(u, v))
    runs = [gx.simulate(lattice, state, float(travel), step=0.05) for state in states]
    # well behind the wave
    behind = slice(int(centre) - 5, int(centre) + travel - 10)
    left = [float(np.abs(np.asarray(run.final.v)[behind]).max()) for run in runs]
    assert left[0] < 1e-9 and min(left[1:]) > 1e-4
    there = gx.states.solitary_wave(lattice, centre + travel, speed=1.0)
    np.testing.assert_allclose(runs[0].final.v, there.v, atol=1e-9, rtol=0)
