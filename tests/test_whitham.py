"""Shocks by Whitham's modulation equations: against Toda's closed form, simulated plateaus and fronts, and refusals."""

import jax
import numpy as np
import pytest
from refusals import refused

import granjax as gx
from granjax.theory import toda

A = 2 * 2**0.5 / 3
HERTZ = gx.Hertz(A, A * 0.5**1.5)


def test_it_is_the_closed_form_of_toda():
    found, want = gx.shocks.whitham(gx.Toda(), 0.5), toda.velocity_shock(0.5)
    for name in ("trailing_speed", "leading_speed", "mean", "amplitude"):
        assert abs(getattr(found, name) - getattr(want, name)) < found.error < 1e-7, name
    inside = slice(1, -1)
    m = toda.modulus(found.s[inside], 0.5)
    wave = toda.modulation(m, 0.5)
    for name, other in (
        ("means", "mean"),
        ("crests", "crest"),
        ("troughs", "trough"),
        ("wavelengths", "wavelength"),
    ):
        # near the leading edge all come to the speed of the solitary wave like exp(-1/k)
        ours, theirs = getattr(found, name)[inside][:50], getattr(wave, other)[:50]
        np.testing.assert_allclose(ours, theirs, atol=1e-6, rtol=1e-6)
    assert found.wavelengths[-1] == np.inf and "Solved" in found.outcome
    # a frequency is the speed of a crest times the wave number
    assert found.omegas[0] == pytest.approx(3.0 * np.sin(np.pi / found.wavelengths[0]), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("c", [0.1, 0.9])
def test_other_speeds_of_toda_in_si(c):
    """Masses of a gram, contacts of a micrometre."""
    units = gx.Units(mass=1e-3, length=1e-6, time=1e-4)
    speed = float(units.length / units.time)
    law = gx.Toda(float(units.force), 1e6)
    found = gx.shocks.whitham(law, c * speed, mass=1e-3)
    want = toda.velocity_shock(c)
    assert found.trailing_speed * 1e-4 == pytest.approx(float(want.trailing_speed), abs=1e-7)
    assert found.leading_speed * 1e-4 == pytest.approx(float(want.leading_speed), abs=1e-7)
    assert found.mean / 1e-6 == pytest.approx(float(want.mean), rel=1e-7)
    assert found.amplitude / 1e-6 == pytest.approx(float(want.amplitude), rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    "law, c, mean, leading, digits",
    [
        # plateaus of runs until t = 2000 and 8000, which agree to 2e-8; crests until t = 1000, extrapolated by 1/t
        (HERTZ, 0.1, 0.19157239, None, 2e-8),
        (HERTZ, 0.3, 0.54047944, None, 2e-8),
        (HERTZ, 0.5, 0.86141893, 1.1933, 4e-8),
        (gx.Polynomial(1.0, 0.5), 0.3, 0.53385, 1.1570, 6e-6),
        (gx.PowerLaw(1.0, -3.0, 1.0), 0.3, 0.25779, 2.5856, 2e-5),
        (gx.PowerLaw(1.0, 0.5, 1.0), -0.1, -0.27234, 0.7459, 6e-6),
    ],
    ids=["weak", "middle", "strong", "FPUT", "magnets", "softening"],
)
def test_the_lattice_comes_to_it(law, c, mean, leading, digits):
    found = gx.shocks.whitham(law, c)
    assert found.mean == pytest.approx(mean, abs=digits)
    assert found.error < 1e-6
    assert np.all(np.diff(found.s) > -1e-6) and np.all(np.diff(found.wavelengths) > 0)
    if leading is not None:
        assert found.leading_speed == pytest.approx(leading, abs=6e-5)
    # the leading wave is the solitary wave of its speed
    wave = gx.travelling.solitary_wave(law, speed=found.leading_speed)
    assert found.amplitude == pytest.approx(float(wave.strain(0.0)), rel=1e-6)


@pytest.mark.slow
def test_what_is_measured_extrapolates_to_it():
    """Crests and windows of two runs: what they are off falls like 1/t."""
    found, seen = gx.shocks.whitham(HERTZ, 0.5), []
    for t in (500.0, 1000.0):
        sites = int(1.24 * t)
        chain = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "free"), HERTZ),), sites=sites)
        seen.append(gx.shocks.measure(gx.shocks.piston(chain, 1.0).run(t)))
    early, late = seen
    assert 2 * late.leading_speed - early.leading_speed == pytest.approx(
        found.leading_speed, abs=1e-5
    )
    assert 2 * late.amplitude - early.amplitude == pytest.approx(found.amplitude, abs=3e-4)
    assert late.mean == pytest.approx(found.mean, abs=1e-6)
    core = slice(2, -1)
    own = np.interp(late.s, found.s, found.crests - found.troughs)
    off = [
        np.abs(x.amplitudes - np.interp(x.s, found.s, found.crests - found.troughs)) for x in seen
    ]
    assert off[1][core].max() < 0.01 * own.max() and off[1][core].mean() < 0.6 * off[0][core].mean()


@pytest.mark.slow
def test_a_strain_ahead_and_what_is_refused():
    strained = gx.shocks.whitham(gx.laws.Strained(HERTZ, 0.1), 0.2)
    ahead = gx.shocks.whitham(HERTZ, 0.2, ahead=0.1)
    assert ahead.mean == pytest.approx(strained.mean + 0.1, abs=1e-7)
    assert ahead.leading_speed == pytest.approx(strained.leading_speed, abs=1e-7)
    assert ahead.troughs[-1] == pytest.approx(0.1, abs=1e-8)
    with refused("c: expected a shock with a trailing edge"):
        gx.shocks.whitham(gx.Hertz(), 0.5)
    with refused("c: expected a shock with a trailing edge"):
        gx.shocks.whitham(gx.Toda(), 1.5)
    with refused("no derivatives"):
        jax.grad(lambda c: gx.shocks.whitham(gx.Toda(), c).mean)(0.1)
    with refused("c: expected"):
        gx.shocks.whitham(HERTZ, -0.1)
