"""Toda, KdV and compactons in closed form: against their equations, published numbers and simulations."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, mark, param
from refusals import refused

import granjax as gx
from granjax.theory import compacton, kdv, toda

SITES = jnp.arange(-9.0, 9.0)
T = 0.43
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
    "overtaking": lambda n, t: toda.two_solitons(
        n, t, 1.0, 0.5, centre1=-3.0, centre2=2.0, **SCALED
    ),
    "periodic": lambda n, t: toda.periodic_wave(
        n, t, -1.37, -0.4, 0.26, 1.85, centre=0.2, **SCALED
    ),
    "to the left": lambda n, t: toda.soliton(n, t, 0.8, direction="left", centre=0.3, **SCALED),
    "head-on": lambda n, t: toda.two_solitons(
        n, t, 0.7, 0.9, centre1=-3.0, centre2=2.0, head_on=True, **SCALED
    ),
    "nearly solitons": lambda n, t: toda.periodic_wave(n, t, -1.0, 0.5, 1.3, 1.3000001, **SCALED),
    "uniform": lambda n, t: toda.periodic_wave(n, t, -1.0, 0.3, 0.3, 1.3, **SCALED),
    "deep": lambda n, t: toda.periodic_wave(n, t, -1.0, -0.99, 0.99, 1.0, **SCALED),
}


@mark.slow
@mark.parametrize(
    "name", [*list(WAVES)[:2], *(param(name, marks=mark.slow) for name in list(WAVES)[2:])]
)
def test_toda_waves_solve_the_equations_of_the_chain(name):
    assert np.all(defects(lambda t: tuple(WAVES[name](SITES, t))) < 3e-14)


@mark.slow
def test_numbers_of_a_toda_soliton():
    found = toda.speed(1.0), toda.amplitude(1.0), toda.energy(1.0)
    assert_allclose(found, [np.sinh(1), 2 * np.log(np.cosh(1)), np.sinh(2) - 2], rtol=1e-15)
    k = np.array([1e-3, 0.5, 1.0, 4.0])
    for name, own, within in (
        ("speed", SCALED, 1e-9),
        ("amplitude", ["rate"], 1e-14),
        ("energy", ["strength", "rate"], 1e-14),
    ):
        value = getattr(toda, name)(k, **{key: SCALED[key] for key in own})
        assert_allclose(toda.wavenumber(**{name: value}, **SCALED), k, rtol=within)
    # cosh k = exp(5000) is beyond the largest number
    assert_allclose(toda.wavenumber(amplitude=1e4), 5e3 + np.log(2), rtol=1e-15)
    wave = toda.soliton(np.arange(-40, 41), 0.0, 1.0)
    assert_allclose([wave.strain.sum(), wave.displacement[0]], 2, rtol=1e-14)
    energy = np.sum(wave.velocity**2 / 2 + np.expm1(wave.strain) - wave.strain)
    assert_allclose(energy, toda.energy(1.0), rtol=1e-13)


def test_phase_shifts():
    behind = -2.360539341283469
    ahead = 1.180269670641735
    assert_allclose(toda.phase_shifts(1.0, 0.5), [ahead, behind], rtol=1e-15)
    assert_allclose(toda.phase_shifts(0.5, 1.0), [behind, ahead], rtol=1e-15)
    head_on = toda.phase_shifts(1.0, 0.5, head_on=True)
    assert_allclose(head_on, [0.2273362938026457, -0.4546725876052915], rtol=1e-14)
    # two that hardly move against each other exchange their places
    assert_allclose(toda.phase_shifts(1.0, 1.0 - 1e-9)[0], np.log(2e9 * np.sinh(1)), rtol=1e-7)


def crest(strain, k, near):
    """Where the crest of a soliton is, from the strain of the bond nearest to a place, on its flank."""
    n = int(near) - 2
    return n + np.arccosh(np.sinh(k) / np.sqrt(np.expm1(strain[n]))) / k


@mark.slow
@mark.parametrize("head_on", [False, True])
def test_solitons_of_a_simulation_are_shifted_and_keep_their_eigenvalues(head_on):
    k = np.array([1.0, 0.5])
    sign = np.array([1, -1 if head_on else 1])
    centre2, t1 = (100.0, 60.0) if head_on else (64.0, 370.0)
    ring = gx.scenes.toda(540, boundary="free")
    wave = toda.two_solitons(
        np.arange(540), 0.0, *k, centre1=40.0, centre2=centre2, head_on=head_on
    )
    start = wave.displacement, wave.velocity
    run = gx.simulate(ring, start, t1, step=0.05, solver=gx.SRKN14a())
    strain = np.asarray(gx.measures.strain(ring, run.final))
    alone = np.array([40.0, centre2]) + sign * np.asarray(toda.speed(k)) * t1
    shifts = np.array(toda.phase_shifts(*k, head_on=head_on))
    seen = [crest(strain, *own) for own in zip(k, alone + shifts)]
    assert_allclose(seen - alone, shifts, rtol=0, atol=1e-8)
    first, last = (
        np.asarray(toda.lax_eigenvalues(gx.measures.strain(ring, y), y[1]))
        for y in (start, run.final)
    )
    assert_allclose(first, last, rtol=0, atol=1e-11)
    beyond = np.sort(last[np.abs(last) > 1])
    assert_allclose(beyond, np.sort(sign * np.cosh(k)), rtol=1e-12)


@mark.slow
def test_a_ring_keeps_all_eigenvalues_of_any_state():
    ring = gx.scenes.toda(24, boundary="periodic")
    start = 0.4 * np.random.default_rng(3).normal(size=(2, 24))
    run = gx.simulate(ring, tuple(start), 50.0, step=0.02, solver=gx.SRKN14a(), save_at=4)
    strains = jnp.stack([gx.measures.strain(ring, y) for y in zip(run.us, run.vs)], -1)
    at = [toda.lax_eigenvalues(y, v, boundary="periodic") for y, v in zip(strains.T, run.vs)]
    assert_allclose(at, [at[0]] * len(at), rtol=0, atol=1e-11)
    # a batch of states, lanes last
    batch = toda.lax_eigenvalues(strains, run.vs.T, boundary="periodic")
    assert_allclose(batch, np.array(at).T, atol=1e-13)


@mark.slow
def test_periodic_waves_of_any_numbers_reach_their_limits():
    one, two, _, four = np.sort(np.random.default_rng(5).uniform(-2, 2, (40, 4)), 1).T
    # a linear wave: omega = 2 exp(y/2) sin(k/2) and an amplitude that vanishes as E3 - E2 does
    gap = 1e-8 * (four - one)
    low = toda.periodic_numbers(one, two, two + gap, four)
    density = np.exp(low.mean_strain / 2)
    k = 2 * np.pi / low.wavelength
    assert_allclose(2 * np.pi / low.period, 2 * density * np.sin(k / 2), rtol=1e-6)
    assert_allclose((low.crest - low.trough) / gap, 4 / (four - one), rtol=1e-6)
    # a soliton on a strain of the sound (E2 - E1)/2, in a frame of velocity E1 + E2
    sound = (two - one) / 2
    k = np.arccosh((2 * four - one - two) / (two - one))
    front = toda.periodic_numbers(one, two, four, four)
    assert np.all(np.isinf(front.wavelength))
    assert_allclose(front.mean_strain, 2 * np.log(sound), rtol=1e-12, atol=1e-15)
    assert_allclose(front.speed, sound * toda.speed(k), rtol=1e-12)
    height = front.crest - 2 * np.log(sound)
    assert_allclose(height, toda.amplitude(k), rtol=1e-10, atol=1e-13)
    wave = toda.periodic_wave(SITES, T, -1.0, 1.0, np.cosh(0.8), np.cosh(0.8))
    alone = toda.soliton(SITES, T, 0.8)
    assert_allclose(wave[:2], alone[:2], atol=1e-14)


@mark.slow
def test_periodic_waves_have_the_means_and_extrema_of_their_numbers():
    E = -1.37, -0.4, 0.26, 1.85
    numbers = toda.periodic_numbers(*E)
    wave = toda.periodic_wave(0.0, np.arange(64) / 64 * numbers.period, *E)
    means = wave.strain.mean(), wave.velocity.mean()
    assert_allclose(means, [numbers.mean_strain, numbers.mean_velocity], rtol=1e-12)
    assert wave.strain.max() <= numbers.crest + 1e-14
    assert wave.strain.min() >= numbers.trough - 1e-14


def test_laws_are_matched():
    hertz = gx.laws.taylor(gx.Hertz(1.0, 1.0))
    a, b = toda.matched(hertz.K2, hertz.K3)
    assert (a, b) == (approx(3.0), approx(0.5))
    assert_allclose(gx.laws.taylor(gx.Toda(a, b))[:2], hertz[:2], rtol=1e-14)
    # a law that softens in compression has waves of rarefaction
    a, b = toda.matched(1.0, -0.3)
    wave = toda.soliton(0.0, 0.0, 0.5, strength=a, rate=b)
    assert wave.strain < 0
    assert_allclose(toda.wavenumber(amplitude=wave.strain, strength=a, rate=b), 0.5)


# ----------------------------------------------------------------------------------------------------------------- KdV

K2 = 1.5
K3 = 0.375
MASS = 2.0


@mark.parametrize("name", ["soliton", param("cnoidal", marks=mark.slow)])
def test_kdv_waves_solve_their_equation(name):
    wave = {
        "soliton": lambda x, t: kdv.soliton(x, t, K2, K3, amplitude=0.1, mass=MASS),
        "cnoidal": lambda x, t: kdv.cnoidal(x, t, -0.004, 0.008, 0.012, K2, K3, mass=MASS),
    }[name]
    sound, unit = kdv.scales(K2, K3, MASS)
    assert (sound, unit) == (approx(np.sqrt(0.75)), approx(4.0))
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


@mark.slow
def test_kdv_soliton_and_its_limits():
    sound = kdv.scales(K2, K3, MASS).sound
    y, v, u = kdv.soliton(SITES, T, K2, K3, speed=1.01 * sound, mass=MASS, centre=0.5)
    x = SITES - 0.5 - 1.01 * sound * T
    assert_allclose(y, 0.12 / np.cosh(np.sqrt(0.06) * x) ** 2, rtol=1e-13)
    assert_allclose(kdv.amplitude(1.01 * sound, K2, K3, MASS), 0.12, rtol=1e-13)
    assert_allclose(kdv.speed(0.12, K2, K3, MASS), 1.01 * sound, rtol=1e-15)
    long = kdv.cnoidal(SITES, T, 0.0, 0.015, 0.015, K2, K3, mass=MASS, centre=0.5)
    assert_allclose(long[:2], [y, v], atol=1e-16)
    # a weak soliton of Toda's chain is one of KdV
    one = toda.soliton(SITES, T, 1e-3)
    other = kdv.soliton(SITES, T, 1.0, 0.5, speed=toda.speed(1e-3))
    assert_allclose(one[:2], other[:2], rtol=2e-6)
    # to the left it is its mirror image
    left = kdv.soliton(SITES, T, K2, K3, amplitude=0.1, direction="left")
    right = kdv.soliton(-SITES, T, K2, K3, amplitude=0.1)
    assert_allclose(left.strain, right.strain, rtol=1e-14)


# ----------------------------------------------------------------------------------------------------------- compactons


def test_compactons_of_hertz():
    crests = [wave(0.0).strain for wave in (compacton.nesterenko, compacton.ahnert_pikovsky)]
    assert_allclose(crests, [25 / 16, 36 / 25], rtol=1e-15)
    # over the exact wave
    exact = 1.48735937434940207
    assert_allclose(np.array(crests) / exact - 1, [0.05052, -0.03184], atol=5e-6)
    x = np.array([0.7, 2.4, 2.6, -5.0])
    found = compacton.nesterenko(x, speed=1.3, stiffness=2.0, mass=3.0)
    want = (1.3**2 * 1.5) ** 2 * 25 / 16 * np.cos(np.sqrt(0.4) * x) ** 4
    assert_allclose(found.strain, np.where(np.abs(x) < found.half_width, want, 0), rtol=1e-13)


def test_fast_solitons_have_a_wave_number():
    speeds = np.array([1.0 + 1e-9, 1.5, 1e20, 1e300, 1e308])
    k = np.asarray(toda.wavenumber(speed=speeds))
    # ln(sinh k/k), where sinh k is exp(k)/2, overflows last
    assert_allclose((k - np.log(2 * k))[2:], np.log(speeds[2:]), rtol=1e-14)
    assert_allclose(np.sinh(k[:2]) / k[:2], speeds[:2], rtol=1e-14)
    assert_allclose(jax.grad(lambda s: toda.wavenumber(speed=s))(1e300) * 1e300, 1, rtol=2e-3)


@mark.parametrize(
    "call, said",
    [
        (
            lambda: toda.two_solitons(0.0, 0.0, 1.0, 1.0, centre1=0.0, centre2=5.0),
            "^k1, k2: expected two that differ",
        ),
        (lambda: toda.wavenumber(speed=0.9), "^speed: expected numbers above 1.0"),
        (lambda: toda.wavenumber(speed=2.0, energy=1.0), "one of these, got speed, energy"),
        (lambda: toda.wavenumber(amplitude=-1.0), "^amplitude: expected strains of the sign"),
        (
            lambda: toda.soliton(0.0, 0.0, 1.0, strength=1.0, rate=-1.0),
            "^strength, rate: .* one sign",
        ),
        (lambda: toda.matched(0.0, 0.5), "^K2: expected numbers above zero"),
        (lambda: toda.periodic_wave(0.0, 0.0, 1.0, 0.0, 2.0, 3.0), "^E1, E2, E3, E4: .* E1 < E2"),
        (lambda: kdv.soliton(0.0, 0.0, 1.0, -0.5, amplitude=0.1), "^amplitude: .* sign of K3"),
        (lambda: kdv.scales(0.0, 0.0), "^K2: .*without linear stiffness has no sound"),
        (lambda: kdv.cnoidal(0.0, 0.0, 0.2, 0.1, 0.3, 1.0, 0.5), "^r1, r2, r3: expected r1 <= r2"),
        (lambda: compacton.nesterenko(0.0, 1.0), r"^p: expected numbers in \(1"),
    ],
)
def test_what_is_no_wave_is_refused(call, said):
    with refused(said):
        call()


@mark.slow
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

    x = jnp.array([1.0, 1.2, 1.7])
    h = 1e-5
    f = jax.jit(numbers)
    slopes = [(f(x + h * e) - f(x - h * e)) / (2 * h) for e in np.eye(3)]
    assert_allclose(jax.jit(jax.jacrev(numbers))(x), slopes, rtol=1e-6)
