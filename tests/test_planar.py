"""Planar equations y'' = f(y) fitted to waves: against waves whose equation is known."""

import functools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

import granjax as gx
from granjax.identify import planar_ode


@functools.cache
def solved(y0, drift=0.0, places=161, end=20.0):
    """Places and strains of y'' = y - y^2 + drift y' from a crest or trough."""
    x = np.linspace(0, end, places)
    run = solve_ivp(
        lambda t, s: [s[1], s[0] - s[0] ** 2 + drift * s[1]],
        (0, end),
        [y0, 0.0],
        t_eval=x,
        rtol=1e-13,
        atol=1e-14,
        method="DOP853",
    )
    return x, run.y[0]


def apart(found, orbit):
    """Rms of the data about their highest crest less an orbit, at the best place, and that place."""
    top = found.xi[np.argmax(found.strains)]
    near = np.abs(found.xi - top) <= found.wavelength / 2
    x, y = found.xi[near], found.strains[near]
    ends = top + np.array([-0.25, 0.25]) * found.wavelength
    squares = lambda shift: np.mean((y - orbit.strain(x - shift)) ** 2)
    best = minimize_scalar(squares, bounds=ends, method="bounded", options={"xatol": 1e-10})
    return np.sqrt(best.fun), best.x


def test_the_equation_of_data_that_obey_one():
    x, y = solved(0.3)
    found = planar_ode(x, y, degree=2)
    assert np.abs(found.coefficients - [0, 1, -1]).max() < 1e-10 and found.misfit < 1e-12
    assert [
        (point.kind, round(point.strain, 8), round(point.rate, 8)) for point in found.equilibria
    ] == [("saddle", 0.0, 1.0), ("centre", 1.0, 1.0)]
    # one power more is found to be none
    assert np.abs(planar_ode(x, y, degree=3).coefficients - [0, 1, -1, 0]).max() < 1e-9
    homoclinic = found.homoclinic()
    places = np.linspace(-60, 60, 41)
    assert np.abs(homoclinic.strain(places) - 1.5 / np.cosh(places / 2) ** 2).max() < 1e-10
    assert (
        abs(homoclinic.decay - 1) < 1e-10
        and homoclinic.wavelength == np.inf
        and apart(found, homoclinic)[0] > 0.01
    )
    periodic = found.periodic()
    distance, shift = apart(found, periodic)
    assert distance < 1e-7 and abs(periodic.trough - 0.3) < 1e-10
    assert np.abs(periodic.strain(x - shift) - y).max() < 1e-6
    assert abs(periodic.energy - (0.3**3 / 3 - 0.3**2 / 2)) < 1e-10
    for other in (found.periodic(crest=periodic.crest), found.periodic(energy=periodic.energy)):
        assert np.abs(other.strain(places) - periodic.strain(places)).max() < 1e-8
    small = found.periodic(crest=1.001)
    assert abs(small.wavelength / (2 * np.pi) - 1) < 1e-6
    assert np.abs(found.bend([0.0, 0.5]) - [0, 0.25]).max() < 1e-10


@pytest.mark.slow
def test_uneven_places_several_trains_and_a_drift():
    rng = np.random.default_rng(3)
    (x, y), (_, z) = solved(0.3), solved(0.6)
    some = np.sort(rng.choice(len(x), 100, replace=False))
    found = planar_ode([x[some], x + 7.0], [y[some], z], degree=2)
    assert np.abs(found.coefficients - [0, 1, -1]).max() < 1e-10 and len(found.xi) == 100 + len(x)
    x, y = solved(0.8, 0.03, 240, 40.0)
    found = planar_ode(x, y, degree=2, drift=True)
    assert abs(found.drift - 0.03) < 1e-10 and np.abs(found.coefficients - [0, 1, -1]).max() < 1e-9
    assert planar_ode(x, y, degree=2).misfit > 1e3 * found.misfit


def test_the_wave_of_korteweg_and_de_vries():
    r, x = (0.0, 0.02, 0.03), np.linspace(-15, 15, 241)
    y = np.asarray(gx.theory.kdv.cnoidal(x, 0.0, *r, 1.3, 0.5).strain)
    found = planar_ode(x, y, degree=2)
    # Y = B + 2 D dn^2(2 D^{1/2} x), D = r3 - r1: y'' of w = dn^2 is 2 (-3 w^2 + 2 (2 - m) w - (1 - m)) per unit of u
    D, B, m, unit = r[2] - r[0], r[0] + r[1] - r[2], (r[1] - r[0]) / (r[2] - r[0]), 1.3 / 0.5

    def bend(y):
        w = (y / unit - B) / (2 * D)
        return unit * 2 * D * 4 * D * 2 * (-3 * w**2 + 2 * (2 - m) * w - (1 - m))

    places = np.linspace(y.min(), y.max(), 9)
    assert np.abs(found.bend(places) - bend(places)).max() < 1e-8 * np.abs(bend(places)).max()
    assert abs(found.coefficients[2] + 12 / unit) < 1e-7


@pytest.mark.slow
def test_a_wave_of_todas_chain_and_a_solitary_one():
    wave, x = gx.travelling.periodic_wave(gx.Toda(), 8.0, amplitude=0.2), np.linspace(-12, 12, 121)
    misfits = [
        planar_ode(x, np.asarray(wave.strain(x)), degree=k).misfit / wave.amplitude
        for k in (2, 3, 4)
    ]
    assert misfits[0] < 1e-2 and misfits[1] < misfits[0] / 5 and misfits[2] < misfits[1] / 5
    found = planar_ode(x, np.asarray(wave.strain(x)), degree=4)
    orbit = found.periodic()
    assert abs(orbit.wavelength - 8) < 1e-2 and apart(found, orbit)[0] < 1e-3 * wave.amplitude
    assert found.correlation > 0.5 and "no noise" in found.outcome
    k = 0.8
    x = np.linspace(-6, 6, 121)
    soliton = planar_ode(x, np.log1p(np.sinh(k) ** 2 / np.cosh(k * x) ** 2), degree=4)
    assert apart(soliton, soliton.homoclinic())[0] < 1e-3 * 2 * np.log(np.cosh(k))
    assert abs(soliton.homoclinic().decay / (2 * k) - 1) < 0.02


@pytest.mark.slow
def test_the_interior_of_a_shock():
    x = np.arange(70.0, 108.0)
    y = np.asarray(gx.theory.toda.shock_wave(x, 100.0, 0.3).strain)
    found = planar_ode(x, y, degree=3)
    assert found.misfit < 0.1 * np.ptp(y) and any(
        point.kind == "centre" for point in found.equilibria
    )


@pytest.mark.study
def test_noise_gives_its_size_and_error_bars_that_hold():
    x, y = solved(0.3)
    rng, off = np.random.default_rng(5), []
    for _ in range(12):
        found = planar_ode(x, y + 0.01 * rng.normal(size=len(x)), degree=2)
        off.append((found.coefficients - [0, 1, -1]) / found.errors)
        assert abs(found.misfit - 0.01) < 4 * found.misfit_error
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.6 and np.abs(off).max() < 4.5


def test_slopes_keep_the_energy_of_the_equation():
    found = planar_ode(*solved(0.3), degree=2)
    np.testing.assert_allclose(
        found.slopes**2 / 2 - found.fitted**2 / 2 + found.fitted**3 / 3, -0.036, atol=1e-10
    )


X = np.linspace(0, 10, 50)


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: planar_ode(X, X), "rise and fall"),
        (lambda: planar_ode(X[:4], np.sin(X[:4])), "five or more"),
        (lambda: planar_ode(X[::4], np.sin(X[::4]), degree=9), "points or more"),
        (lambda: planar_ode(X[::-1], np.sin(X)), "increase"),
        (
            lambda: planar_ode(*solved(0.3), degree=2).periodic(crest=2.0),
            "crest: expected one of a periodic orbit",
        ),
        (lambda: planar_ode(*solved(0.3), degree=2).periodic(crest=1.2, energy=0.0), "got both"),
    ],
)
def test_what_has_no_planar_equation(call, words):
    with pytest.raises(ValueError, match=words):
        call()
