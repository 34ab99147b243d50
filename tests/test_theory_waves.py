"""Toda, KdV and compactons in closed form: against their equations, published numbers and simulations."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import granjax as gx
from granjax.theory import compacton, elliptic, kdv, toda

SITES, T = jnp.arange(-9.0, 9.0), 0.43
# a, b, m in no particular units
SCALED = dict(strength=0.7, rate=1.3, mass=2.1)


@partial(jax.jit, static_argnums=0)
def defects(wave):
    """How far velocity and strain are from the displacement, and what the equation of motion leaves (scaled)."""
    (y, v, u), (_, a, ut) = jax.jvp(wave, (T,), (1.0,))
    gap = jnp.diff(-u) - y[:-1]
    force = SCALED["strength"] * jnp.exp(SCALED["rate"] * y)
    return jnp.stack(
        [jnp.abs(x).max() for x in (gap, v - ut, a[1:] * SCALED["mass"] - (force[:-1] - force[1:]))]
    )


WAVES = {
    "soliton": lambda n, t: toda.soliton(n, t, 0.8, centre=0.3, **SCALED),
    "to the left": lambda n, t: toda.soliton(n, t, 0.8, direction="left", **SCALED),
    "overtaking": lambda n, t: toda.two_solitons(
        n, t, 1.0, 0.5, centre1=-3.0, centre2=2.0, **SCALED
    ),
    "head-on": lambda n, t: toda.two_solitons(
        n, t, 0.7, 0.9, centre1=-3.0, centre2=2.0, head_on=True, **SCALED
    ),
    "periodic": lambda n, t: toda.periodic_wave(
        n, t, -1.37, -0.4, 0.26, 1.85, centre=0.2, **SCALED
    ),
    "nearly solitons": lambda n, t: toda.periodic_wave(n, t, -1.0, 0.5, 1.3, 1.3000001, **SCALED),
    "soliton on a strain": lambda n, t: toda.periodic_wave(n, t, -1.0, 0.5, 1.3, 1.3, **SCALED),
    "uniform": lambda n, t: toda.periodic_wave(n, t, -1.0, 0.3, 0.3, 1.3, **SCALED),
    "deep": lambda n, t: toda.periodic_wave(n, t, -1.0, -0.99, 0.99, 1.0, **SCALED),
}


@pytest.mark.parametrize(
    "name",
    [
        "soliton",
        "overtaking",
        "periodic",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in WAVES
            if name not in ("soliton", "overtaking", "periodic")
        ),
    ],
)
def test_toda_waves_solve_the_equations_of_the_chain(name):
    assert np.all(defects(lambda t: tuple(WAVES[name](SITES, t))) < 3e-14)


def test_numbers_of_a_toda_soliton():
    k = np.array([1e-3, 0.5, 1.0, 4.0])
    assert toda.speed(1.0) == pytest.approx(np.sinh(1), rel=1e-15)
    assert toda.amplitude(1.0) == pytest.approx(2 * np.log(np.cosh(1)), rel=1e-15)
    assert toda.energy(1.0) == pytest.approx(np.sinh(2) - 2, rel=1e-15)
    for name in ("speed", "amplitude", "energy"):
        own = {"speed": SCALED, "amplitude": ["rate"], "energy": ["strength", "rate"]}[name]
        constants = {key: SCALED[key] for key in own}
        found = toda.wavenumber(**{name: getattr(toda, name)(k, **constants)}, **SCALED)
        assert_allclose(found, k, rtol=1e-9 if name == "speed" else 1e-14)
    wave = toda.soliton(np.arange(-40, 41), 0.0, 1.0)
    assert wave.strain.sum() == pytest.approx(2, rel=1e-14) and wave.displacement[
        0
    ] == pytest.approx(2, rel=1e-14)
    energy = np.sum(wave.velocity**2 / 2 + np.expm1(wave.strain) - wave.strain)
    assert energy == pytest.approx(float(toda.energy(1.0)), rel=1e-13)


def test_phase_shifts():
    assert_allclose(
        toda.phase_shifts(1.0, 0.5), [1.180269670641735, -2.360539341283469], rtol=1e-15
    )
    assert_allclose(
        toda.phase_shifts(0.5, 1.0), [-2.360539341283469, 1.180269670641735], rtol=1e-15
    )
    assert_allclose(
        toda.phase_shifts(1.0, 0.5, head_on=True),
        [0.2273362938026457, -0.4546725876052915],
        rtol=1e-14,
    )
    # two that hardly move against each other exchange their places
    assert toda.phase_shifts(1.0, 1.0 - 1e-9)[0] == pytest.approx(
        np.log(2e9 * np.sinh(1)), rel=1e-7
    )


def crest(strain, k, near):
    """Where the crest of a soliton is, from the strain of the bond nearest to a place, on its flank."""
    n = int(near) - 2
    return n + np.arccosh(np.sinh(k) / np.sqrt(np.expm1(strain[n]))) / k


@pytest.mark.study
@pytest.mark.parametrize("head_on", [pytest.param(False, marks=pytest.mark.slow), True])
def test_solitons_of_a_simulation_are_shifted_and_keep_their_eigenvalues(head_on):
    """Shifts to 1e-8, eigenvalues of the ring to 1e-11."""
    k1, k2 = 1.0, 0.5
    size, centre1, centre2, t1 = 540, 40.0, *((100.0, 60.0) if head_on else (64.0, 370.0))
    n = np.arange(size)
    wave = toda.two_solitons(n, 0.0, k1, k2, centre1=centre1, centre2=centre2, head_on=head_on)
    ring = gx.scenes.toda(size, boundary="free")
    run = gx.simulate(
        ring, (wave.displacement, wave.velocity), t1, step=0.05, solver=gx.SRKN14a(), save_at=3
    )
    strain = np.asarray(gx.measures.strain(ring, run.final))
    speeds = float(toda.speed(k1)), float(toda.speed(k2)) * (-1 if head_on else 1)
    shifts = toda.phase_shifts(k1, k2, head_on=head_on)
    for k, start, speed, shift in zip((k1, k2), (centre1, centre2), speeds, shifts):
        alone = start + speed * t1
        assert crest(strain, k, alone + float(shift)) - alone == pytest.approx(
            float(shift), abs=1e-8
        )
    first, last = (
        toda.lax_eigenvalues(gx.measures.strain(ring, y), y[1])
        for y in ((wave.displacement, wave.velocity), run.final)
    )
    assert_allclose(first, last, rtol=0, atol=1e-11)
    beyond = np.sort(np.asarray(last)[np.abs(last) > 1])
    want = np.sort([np.cosh(k1), (-1 if head_on else 1) * np.cosh(k2)])
    assert_allclose(beyond, want, rtol=1e-12)


@pytest.mark.slow
def test_a_ring_keeps_all_eigenvalues_of_any_state():
    rng = np.random.default_rng(3)
    ring = gx.scenes.toda(24, boundary="periodic")
    state = gx.State(rng.normal(size=24) * 0.4, rng.normal(size=24) * 0.4)
    run = gx.simulate(ring, state, 50.0, step=0.02, solver=gx.SRKN14a(), save_at=4)
    strains = jnp.stack([gx.measures.strain(ring, (u, v)) for u, v in zip(run.us, run.vs)], -1)
    at = [toda.lax_eigenvalues(y, v, boundary="periodic") for y, v in zip(strains.T, run.vs)]
    assert_allclose(at, [at[0]] * len(at), rtol=0, atol=1e-11)
    # a batch of states, lanes last
    assert_allclose(
        toda.lax_eigenvalues(strains, run.vs.T, boundary="periodic"), np.array(at).T, atol=1e-13
    )


def test_periodic_waves_reach_their_limits():
    # long: the soliton of the eigenvalue beyond the band [-1, 1]
    wave, alone = (
        toda.periodic_wave(SITES, T, -1.0, 1.0, np.cosh(0.8), np.cosh(0.8)),
        toda.soliton(SITES, T, 0.8),
    )
    assert_allclose(wave.strain, alone.strain, atol=1e-14)
    assert_allclose(wave.velocity, alone.velocity, atol=1e-14)
    numbers = toda.periodic_numbers(-1.0, 1.0, np.cosh(0.8), np.cosh(0.8))
    assert numbers.wavelength == np.inf and numbers.mean_strain == pytest.approx(0, abs=1e-15)
    assert numbers.speed == pytest.approx(float(toda.speed(0.8)), rel=1e-14)


@pytest.mark.slow
def test_periodic_waves_and_their_numbers():
    # low: sound of the dispersion relation
    low = toda.periodic_numbers(-1.0, 0.2, 0.2 + 1e-9, 1.0)
    k, density = 2 * np.pi / low.wavelength, np.exp(low.mean_strain / 2)
    assert 2 * np.pi / low.period == pytest.approx(2 * density * np.sin(k / 2), rel=1e-8)
    # means of one wavelength
    E = -1.37, -0.4, 0.26, 1.85
    numbers = toda.periodic_numbers(*E)
    t = np.arange(64) / 64 * numbers.period
    wave = toda.periodic_wave(0.0, t, *E)
    assert wave.strain.mean() == pytest.approx(float(numbers.mean_strain), rel=1e-12)
    assert wave.velocity.mean() == pytest.approx(float(numbers.mean_velocity), rel=1e-12)
    assert (
        wave.strain.max() <= numbers.crest + 1e-14 and wave.strain.min() >= numbers.trough - 1e-14
    )


def test_laws_are_matched():
    hertz = gx.laws.taylor(gx.Hertz(1.0, 1.0))
    a, b = toda.matched(hertz.K2, hertz.K3)
    assert (a, b) == (pytest.approx(3.0), pytest.approx(0.5))
    assert_allclose(gx.laws.taylor(gx.Toda(a, b))[:2], hertz[:2], rtol=1e-14)
    # a law that softens in compression has waves of rarefaction
    a, b = toda.matched(1.0, -0.3)
    wave = toda.soliton(0.0, 0.0, 0.5, strength=a, rate=b)
    assert wave.strain < 0 and toda.wavenumber(
        amplitude=wave.strain, strength=a, rate=b
    ) == pytest.approx(0.5)


# ----------------------------------------------------------------------------------------------------------------- KdV

K2, K3, MASS = 1.5, 0.375, 2.0


@pytest.mark.parametrize("name", ["soliton", pytest.param("cnoidal", marks=pytest.mark.slow)])
def test_kdv_waves_solve_their_equation(name):
    wave = {
        "soliton": lambda x, t: kdv.soliton(x, t, K2, K3, amplitude=0.1, mass=MASS),
        "cnoidal": lambda x, t: kdv.cnoidal(x, t, -0.004, 0.008, 0.012, K2, K3, mass=MASS),
    }[name]
    sound, unit = kdv.scales(K2, K3, MASS)
    assert (sound, unit) == (pytest.approx(np.sqrt(0.75)), pytest.approx(4.0))
    s = lambda x, t: wave(x, t).strain / unit

    @jax.jit
    def residual(x):
        first = jax.grad(s)
        third = jax.grad(jax.grad(first))
        return jax.grad(s, 1)(x, T) + sound * (
            first(x, T) + third(x, T) / 24 + s(x, T) * first(x, T)
        ), first(x, T)

    left, size = residual(1.7)
    assert abs(left) < 1e-13 * abs(size)
    y, v, u = wave(SITES, T)
    assert_allclose(y[:-1], u[:-1] - u[1:], rtol=0, atol=1e-7 * np.abs(y).max())


def test_kdv_soliton_and_its_limits():
    sound = kdv.scales(K2, K3, MASS).sound
    y, v, u = kdv.soliton(SITES, T, K2, K3, speed=1.01 * sound, mass=MASS, centre=0.5)
    x = SITES - 0.5 - 1.01 * sound * T
    assert_allclose(y, 0.12 / np.cosh(np.sqrt(0.06) * x) ** 2, rtol=1e-13)
    assert kdv.amplitude(1.01 * sound, K2, K3, MASS) == pytest.approx(0.12, rel=1e-13)
    assert kdv.speed(0.12, K2, K3, MASS) == pytest.approx(1.01 * float(sound), rel=1e-15)
    r = 0.015
    long = kdv.cnoidal(SITES, T, 0.0, r, r, K2, K3, mass=MASS, centre=0.5)
    assert_allclose(long.strain, y, atol=1e-16)
    assert_allclose(long.velocity, v, atol=1e-16)
    # a weak soliton of Toda's chain is one of KdV
    small = 1e-3
    one, other = (
        toda.soliton(SITES, T, small),
        kdv.soliton(SITES, T, 1.0, 0.5, speed=toda.speed(small)),
    )
    for a, b in zip(one[:2], other[:2]):
        assert_allclose(a, b, rtol=2e-6)
    # to the left it is its mirror image
    left = kdv.soliton(SITES, T, K2, K3, amplitude=0.1, direction="left")
    right = kdv.soliton(-SITES, T, K2, K3, amplitude=0.1)
    assert_allclose(left.strain, right.strain, rtol=1e-14)


# ----------------------------------------------------------------------------------------------------------- compactons


def test_compactons_of_hertz():
    one, other = compacton.nesterenko(0.0), compacton.ahnert_pikovsky(0.0)
    assert one.strain == pytest.approx(25 / 16, rel=1e-15) and other.strain == pytest.approx(
        36 / 25, rel=1e-15
    )
    # over the exact wave
    assert_allclose(
        np.array([one.strain, other.strain]) / 1.48735937434940207 - 1,
        [0.05052, -0.03184],
        atol=5e-6,
    )
    x = np.array([0.7, 2.4, 2.6, -5.0])
    found = compacton.nesterenko(x, speed=1.3, stiffness=2.0, mass=3.0)
    want = (1.3**2 * 1.5) ** 2 * 25 / 16 * np.cos(np.sqrt(0.4) * x) ** 4
    assert_allclose(found.strain, np.where(np.abs(x) < found.half_width, want, 0), rtol=1e-13)


@pytest.mark.parametrize(
    "call, said",
    [
        (
            lambda: toda.two_solitons(0.0, 0.0, 1.0, 1.0, centre1=0.0, centre2=5.0),
            "^k1, k2: expected two that differ",
        ),
        (
            lambda: toda.wavenumber(speed=0.9),
            "^speed: expected numbers above 1.0, the speed of sound",
        ),
        (
            lambda: toda.wavenumber(speed=2.0, energy=1.0),
            "expected one of these, got speed, energy",
        ),
        (lambda: toda.wavenumber(amplitude=-1.0), "^amplitude: expected strains of the sign"),
        (
            lambda: toda.soliton(0.0, 0.0, 1.0, strength=1.0, rate=-1.0),
            "^strength, rate: expected two numbers of one sign",
        ),
        (lambda: toda.matched(0.0, 0.5), "^K2: expected numbers above zero"),
        (
            lambda: toda.periodic_wave(0.0, 0.0, 1.0, 0.0, 2.0, 3.0),
            "^E1, E2, E3, E4: expected E1 < E2",
        ),
        (
            lambda: kdv.soliton(0.0, 0.0, 1.0, -0.5, amplitude=0.1),
            "^amplitude: expected strains of the sign of K3",
        ),
        (
            lambda: kdv.scales(0.0, 0.0),
            "^K2: expected numbers above zero, got .*without linear stiffness has no sound",
        ),
        (lambda: kdv.cnoidal(0.0, 0.0, 0.2, 0.1, 0.3, 1.0, 0.5), "^r1, r2, r3: expected r1 <= r2"),
        (lambda: compacton.nesterenko(0.0, 1.0), r"^p: expected numbers in \(1"),
    ],
)
def test_what_is_no_wave_is_refused(call, said):
    with pytest.raises(ValueError, match=said):
        call()


@pytest.mark.slow
def test_waves_differentiate_in_their_numbers():
    def numbers(x):
        k, E, p = x
        return (
            toda.two_solitons(0.3, 2.0, k, 0.5, centre1=-3.0, centre2=2.0).velocity
            + toda.periodic_wave(0.3, 2.0, -1.0, 0.1, 0.4, E).displacement
            + toda.wavenumber(speed=E)
            + compacton.nesterenko(0.3, p).strain
            + kdv.cnoidal(0.3, 2.0, 0.0, 0.01, 0.01 * E, 1.0, 0.5).displacement
        )

    x, h = jnp.array([1.0, 1.2, 1.7]), 1e-5
    slopes = jax.jit(jax.jacrev(numbers))(x)
    f = jax.jit(numbers)
    for i in range(3):
        assert slopes[i] == pytest.approx(
            float(f(x.at[i].add(h)) - f(x.at[i].add(-h))) / (2 * h), rel=1e-6
        )


def test_waves_are_read():
    assert "strain" in repr(toda.soliton(SITES, 0.0, 1.0)) and "half_width" in repr(
        compacton.nesterenko(0.0)
    )
    assert elliptic.K(toda.periodic_numbers(-1.0, 0.2, 0.4, 1.0).m1) > 1
