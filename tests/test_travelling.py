"""Travelling waves against known values."""

import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from scipy.special import ellipe, ellipj, ellipk

import granjax as gx
from granjax.travelling import solitary_wave

# tent integral by Newton's method with quadruple quadrature, and by Fourier series; both agree to all digits
HERTZ = {
    0: 1.48735937434940207,
    0.5: 1.18075956495107221,
    1: 0.583929165288747316,
    1.5: 0.173535703605945646,
    2: 0.0290981220754717273,
    3: 9.79950180919572e-5,
}
FAR = {4: 6.98188008742393e-9, 5: 1.66653015582526e-15}


@pytest.fixture(scope="module")
def hertz():
    return solitary_wave(gx.Hertz(), speed=1.0)


def test_the_hertz_wave_is_the_known_fixed_point(hertz):
    for place, value in HERTZ.items():
        assert (
            float(hertz.strain(place))
            == float(hertz.strain(-place))
            == pytest.approx(value, abs=1e-14, rel=0)
        )
    for place, value in FAR.items():
        assert float(hertz.strain(place)) == pytest.approx(value, rel=1e-12)
    # a bead is fastest midway between the contacts' peaks
    assert float(hertz.velocity(0.5)) == pytest.approx(1.62494411458652483, abs=1e-14)
    assert float(hertz.energy) == pytest.approx(2.82348668842275840, abs=1e-13)
    assert float(hertz.compression) == pytest.approx(2.71360995307778758, abs=1e-13)
    assert float(hertz.width) == pytest.approx(1.72571266900516663, abs=1e-9)
    assert float(hertz.error) < 1e-14 and float(hertz.residual) < 1e-12


def test_the_tail_falls_as_the_inequality_says(hertz):
    x = np.linspace(2, 5, 31)
    for n in range(1, 6):
        assert np.all(np.log(hertz.strain(x + n)) <= 1.5**n * np.log(hertz.strain(x)))
    assert 0 < float(hertz.strain(10.0)) < 1e-140


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ratio", "peak"), [(1.05, 0.653311577638), (1.2, 3.346111173809), (2, 49.4301641677)]
)
def test_precompressed_peaks(ratio, peak):
    wave = solitary_wave(gx.Hertz(1.0, 1.0), speed=ratio * 1.5**0.5)
    assert float(wave.amplitude) == pytest.approx(peak, abs=1e-10)
    # kappa from sinh(kappa/2) = (c/c0) kappa/2, seen far out
    far = np.log(wave.strain([100.0, 101.0]))
    assert far[0] - far[1] == pytest.approx(float(wave.decay), rel=1e-12)
    assert np.sinh(wave.decay / 2) / (wave.decay / 2) == pytest.approx(ratio, rel=1e-13)


@pytest.mark.slow
def test_magnets():
    wave = solitary_wave(gx.PowerLaw(1.0, -3.0, 1.0), speed=1.05 * 3**0.5)
    assert float(wave.amplitude) == pytest.approx(0.069221794600, abs=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("k", [0.1, 3.0])
def test_the_toda_soliton_everywhere(k):
    wave = solitary_wave(gx.Toda(), speed=np.sinh(k) / k)
    x = np.linspace(-60 / k, 60 / k, 201)
    exact = np.log1p(np.sinh(k) ** 2 / np.cosh(k * x) ** 2)
    assert_allclose(wave.strain(x), exact, rtol=1e-11)
    assert float(wave.energy) == pytest.approx(np.sinh(2 * k) - 2 * k, rel=1e-11)
    assert float(wave.compression) == pytest.approx(2 * k, rel=1e-12)


@pytest.mark.slow
def test_one_wave_by_speed_amplitude_or_energy_in_any_units():
    scene = gx.Lattice(
        0.03, gx.Bond(gx.Shift(1, "free"), gx.Hertz(9.8e9, 5.0)), sites=20, units="SI"
    )
    wave = solitary_wave(scene, speed=-60e3)
    assert wave.units == "SI" and "J" in repr(wave) and float(wave.momentum) < 0
    for one in (
        solitary_wave(scene, amplitude=wave.amplitude),
        solitary_wave(scene, energy=wave.energy),
    ):
        assert float(one.speed) == pytest.approx(60e3, rel=1e-12)
        assert_allclose(one.strains, wave.strains, rtol=1e-11)
    u, v = wave.state(20, 9.25)
    assert_allclose(
        u[:-1] - u[1:], wave.strain(np.arange(19) - 9.25), atol=1e-13 * float(wave.compression)
    )
    assert np.all(np.asarray(v) < 0)
    again = pickle.loads(pickle.dumps(wave))
    assert float(again.strain(0.3)) == float(wave.strain(0.3))


@pytest.mark.study
@pytest.mark.parametrize(
    "name", ["energy", *(pytest.param(x, marks=pytest.mark.slow) for x in ("speed", "amplitude"))]
)
def test_derivatives_by_the_implicit_function_theorem(name):
    def found(x):
        wave = solitary_wave(gx.Hertz(x[0], x[1]), **{name: x[2]}, mass=x[3])
        return jnp.stack(
            [
                wave.speed,
                wave.amplitude,
                wave.energy,
                wave.width,
                wave.strain(2.3),
                wave.velocity(-0.4),
            ]
        )

    x, w = np.array([1.1, 0.9, 2.1, 1.3]), np.array([0.3, -0.2, 0.5, 0.4])
    slope = jax.jvp(found, (x,), (w,))[1]
    difference = (found(x + 1e-5 * w) - found(x - 1e-5 * w)) / 2e-5
    assert_allclose(slope, difference, rtol=1e-6)


def test_a_search_is_not_traced():
    with refused("jax.jit or jax.vmap"):
        jax.jit(lambda c: solitary_wave(gx.Hertz(), speed=c).energy)(1.0)


def by_constraint(law, norm, half=16.0, points=512, steps=200):
    """(c, x, strain): the potential energy at its largest, sum W(A v), among velocities v of one norm (unit mass).

    v <- A F(A v) over its norm, A the mean over a contact, raises it at every step: Friesecke and Wattis, Commun. Math.
    Phys. 161, 391 (1994); Herrmann, Proc. R. Soc. Edinb. A 140, 753 (2010).
    """
    x = (np.arange(points) - points // 2) * 2 * half / points
    box = np.sinc(np.fft.rfftfreq(points, 2 * half / points))
    mean = lambda f: np.fft.irfft(box * np.fft.rfft(f), points)
    v = norm * (w := np.exp(-(x**2))) / np.linalg.norm(w)
    stored = []
    for _ in range(steps):
        strain = mean(v)
        new = mean(np.asarray(law.force(strain)))
        stored.append(float(law.energy(strain).sum()))
        v, c = norm * new / np.linalg.norm(new), np.sqrt(np.linalg.norm(new) / norm)
    assert np.all(np.diff(stored) > -1e-13 * stored[-1])
    return c, x, mean(v)


@pytest.mark.parametrize("load", [0.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_second_method_gives_the_same(load):
    law = gx.Hertz(1.0, load)
    c, x, strain = by_constraint(law, 20.0)
    wave = solitary_wave(law, speed=c)
    assert_allclose(wave.strain(x), strain, atol=1e-10 * float(wave.amplitude), rtol=0)


@pytest.mark.slow
def test_launched_on_a_lattice_it_stays_as_it_is():
    lattice = gx.scenes.monomer(1040, boundary="free")
    state = gx.states.solitary_wave(lattice, 15.0, speed=1.0)
    run = gx.simulate(lattice, state, 1000.0, step=0.08, solver=gx.SRKN14a())
    strain = gx.measures.strain(lattice, run.final)
    exact = solitary_wave(gx.Hertz(), speed=1.0).strain(np.arange(1039) - 1015.0)
    assert_allclose(strain, exact, atol=1e-9, rtol=0)


@pytest.mark.slow
def test_towards_the_speed_of_sound_it_is_the_soliton_of_korteweg_and_de_vries():
    law, sigma, excess = gx.Hertz(1.0, 1.0), 1.5**0.5, np.array([1e-3, 1e-2])
    K2, K3, _ = gx.laws.taylor(law)
    errors = []
    for e in excess:
        wave = solitary_wave(law, speed=sigma * (1 + e))
        x = np.linspace(0, 6, 200) / np.sqrt(6 * e)
        soliton = 3 * K2 / K3 * e / np.cosh(np.sqrt(6 * e) * x) ** 2
        errors.append(float(np.abs(wave.strain(x) - soliton).max() / wave.amplitude))
    assert np.diff(np.log(errors)) / np.diff(np.log(excess)) == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "p", [3.0, *(pytest.param(x, marks=pytest.mark.study) for x in (1.05, 10.0))]
)
def test_powers_scale_and_sum(p):
    wave, faster = (solitary_wave(gx.PowerLaw(1.0, p), speed=c) for c in (1.0, 1.3))
    scale = 1.3 ** (2 / (p - 1))
    assert_allclose(faster.strain([0.0, 1.1, 2.3]), scale * wave.strain([0.0, 1.1, 2.3]), rtol=1e-9)
    # the tent integral itself, by another rule
    z, w = np.polynomial.legendre.leggauss(200)
    for x in (0.0, 1.7, 3.3):
        parts = [wave.strain(x + side * (1 + z) / 2) ** p * (1 - z) / 2 @ w / 2 for side in (1, -1)]
        assert float(sum(parts)) == pytest.approx(float(wave.strain(x)), rel=1e-9)


STEEP = gx.Linear() + gx.PowerLaw(1.0, 7.0)


@pytest.mark.study
@pytest.mark.parametrize("speed", [1.02, pytest.param(1.2, marks=pytest.mark.slow)])
def test_a_wave_whose_energy_falls_with_its_speed_is_unstable(speed):
    """dE/dc changes its sign between, near 1.035, and one pair of multipliers leaves +1."""
    slope = jax.jvp(lambda c: solitary_wave(STEEP, speed=c).energy, (speed,), (1.0,))[1]
    found = solitary_wave(STEEP, speed=speed).floquet(ends="held")
    assert (
        found.verdict
        == ("unstable" if slope < 0 else "stable")
        == ("unstable" if speed < 1.03 else "stable")
    )


def energy_of_wave(force, speed, power, length=64, points=4096):
    """int (phi F/2 + W) of m c^2 phi = tent * F(phi), m = 1, by Petviashvili's iteration in Fourier space."""
    x = length * (np.arange(points) / points - 0.5)
    kernel = np.sinc(np.fft.rfftfreq(points, length / points)) ** 2
    phi = 0.5 / np.cosh(x) ** 2
    for _ in range(4000):
        rest = lambda f: np.fft.irfft(kernel * np.fft.rfft(f), points)
        linear, bent = speed**2 * phi - rest(phi), rest(force(phi) - phi)
        after = (phi @ linear / (phi @ bent)) ** (power / (power - 1)) * np.fft.irfft(
            kernel * np.fft.rfft(force(phi) - phi) / (speed**2 - kernel), points
        )
        phi, moved = after, np.abs(after - phi).max()
        if moved < 1e-13:
            break
    nodes, weights = np.polynomial.legendre.leggauss(40)
    stored = phi * sum(w / 2 * force((1 + z) / 2 * phi) for z, w in zip(nodes, weights))
    return float(np.sum(phi * force(phi) / 2 + stored) * length / points)


class Stiffens(gx.Law):
    """F(e) = e + e^3/2 + e^9, as a user writes it."""

    def force(self, e):
        return e + 0.5 * e**3 + e**9

    def energy(self, e):
        return e**2 / 2 + e**4 / 8 + e**10 / 10


# law, force, the leading power, speed
JUDGED = [
    pytest.param(STEEP, lambda e: e + e**7, 7, 1.1, id="7-1.1"),
    pytest.param(STEEP, lambda e: e + e**7, 7, 1.02, id="7-1.02"),
    *(
        pytest.param(*case, id=f"{case[2]}-{case[3]}", marks=pytest.mark.study)
        for case in (
            (STEEP, lambda e: e + e**7, 7, -1.05),
            (gx.Linear() + gx.PowerLaw(1.0, 5.0), lambda e: e + e**5, 5, 1.1),
            (gx.Linear() + gx.PowerLaw(2.0, 9.0), lambda e: e + 2 * e**9, 9, 1.03),
            (gx.Linear() + gx.PowerLaw(2.0, 9.0), lambda e: e + 2 * e**9, 9, 1.15),
            (Stiffens(), lambda e: e + 0.5 * e**3 + e**9, 3, 1.12),
            (gx.Toda(), np.expm1, 2, 1.1),
        )
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("law", "force", "power", "speed"), JUDGED)
def test_a_wave_is_unstable_where_its_energy_falls_with_its_speed_whatever_the_ring(
    law, force, power, speed
):
    """Friesecke and Pego: a pair of multipliers leaves +1 where dE/dc = 0; nothing else does here."""
    wave, c = solitary_wave(law, speed=speed), abs(speed)
    slope = np.diff([energy_of_wave(force, x, power) for x in (c - 1e-3, c, c + 1e-3)])
    assert float(wave.energy) == pytest.approx(energy_of_wave(force, c, power), rel=1e-6)
    assert slope[0] * slope[1] > 0
    found = wave.floquet()
    sites = len(found.state.u)
    assert (
        found.verdict == ("unstable" if slope[0] < 0 else "stable")
        and f"ring of {sites} sites" in found.outcome
    )
    assert len(found.unstable) == (slope[0] < 0)
    if np.abs(found.multipliers).max() - 1 > 1e-4:
        # what lets small waves round, and what does not
        assert f"chain of {sites} sites with held ends" in found.outcome
        assert "run round the ring" in found.outcome or slope[0] < 0


@pytest.mark.slow
def test_ring_and_held_ends_agree():
    wave = solitary_wave(STEEP, speed=1.02)
    ring, held = (wave.floquet(ends=ends) for ends in ("ring", "held"))
    assert ring.verdict == "unstable" and ring.multipliers[0] == pytest.approx(
        held.multipliers[0], abs=2e-4
    )
    assert np.isfinite(ring.krein).all()
    # what grows is the wave's own, and so are its place and its speed
    assert np.abs(held.point[0] - held.multipliers[0]) == 0
    assert (np.abs(held.point - 1) < 0.1).sum() >= 3 and (np.abs(ring.point) > 1).sum() >= 1
    # far away exp(i (k - omega/c)), omega = 2 sin(k/2), at k + i decay/2: its largest modulus is at k = 0
    a = float(wave.decay) / 2
    assert np.abs(held.essential).max() == pytest.approx(
        np.exp(-a + 2 * np.sinh(a / 2) / 1.02), rel=1e-12
    )
    assert np.abs(ring.essential) == pytest.approx(1, rel=1e-12)


@pytest.mark.slow
def test_an_unstable_wave_grows_as_its_multiplier_says():
    """What two runs from either side of a wave differ by, in a long chain, over 1000 sites: to 1e-6 of the rate."""
    wave, N, at, places = solitary_wave(STEEP, speed=1.02), 1250, 68, np.arange(200, 1001, 100)
    found = wave.floquet(ends="held")
    first = wave.state(N, centre=at)
    vector, sites = found.vectors[:, 0].real, len(found.state.u)
    off = np.argmax(-np.diff(first.u)) - np.argmax(-np.diff(found.state.u))
    du, dv = np.zeros((2, N))
    du[off : off + sites], dv[off : off + sites] = (
        1e-6 / np.abs(vector).max() * vector.reshape(2, -1)
    )
    du[:off], du[off + sites :] = du[off], du[off + sites - 1]
    chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), STEEP), sites=N)
    pair = gx.State(*(np.stack([x + dx, x - dx]) for x, dx in zip(first, (du, dv))))
    ts = places / float(wave.speed)
    runs = [
        gx.simulate(chain, gx.State(u, v), ts[-1], tolerance=1e-12, save_at=ts).vs
        for u, v in zip(*pair)
    ]
    apart = np.abs(np.asarray(runs[0] - runs[1]))
    size = [row[at + n - 20 : at + n + 20].max() for n, row in zip(places, apart)]
    rate = np.polyfit(places, np.log(size), 1)[0]
    assert rate == pytest.approx(np.log(found.multipliers[0].real), rel=1e-6)


@pytest.mark.slow
def test_the_toda_soliton_and_the_hertz_wave_are_stable(hertz):
    found = solitary_wave(gx.Toda(), speed=np.sinh(1)).floquet()
    assert found.verdict == "stable" and found.expected == 4 and set(found.krein) == {-1, 0, 1}
    held = hertz.floquet()
    assert held.verdict == "stable" and held.expected == 2
    # what is left of a perturbation in the wave, per contact, whatever the length of the chain
    assert_allclose(hertz.floquet(16).multipliers[2:5], held.multipliers[2:5], atol=1e-5)


@pytest.mark.study
def test_a_wave_with_second_neighbours_by_newtons_method_from_one_without():
    wave = solitary_wave(gx.Toda(), speed=np.sinh(1))
    lattice, state = gx.travelling.ring(wave)
    second = gx.Bond(gx.Shift(2, "periodic"), gx.Linear(0.02))
    more = gx.Lattice(lattice.mass, (*lattice.terms, second), sites=lattice.sites)
    found = gx.travelling.wave_orbit(more, state, wave.speed)
    assert found.converged and 1e-3 < float(jnp.abs(found.state.u - state.u).max()) < 0.3
    run = gx.simulate(more, found.state, 5 / float(wave.speed), tolerance=1e-11)
    assert_allclose(run.final.u, jnp.roll(found.state.u, 5), atol=1e-7)


@pytest.mark.parametrize(("m", "length"), [(0.3, 5.0), (0.99, 17.5)])
def test_the_cnoidal_wave_of_toda(m, length):
    K, E = ellipk(m), ellipe(m)
    frequency = 1 / (2 * K) / np.sqrt(1 / ellipj(2 * K / length, m)[0] ** 2 - 1 + E / K)

    def exact(x):
        return np.log1p((2 * K * frequency) ** 2 * (ellipj(2 * K / length * x, m)[2] ** 2 - E / K))

    x = np.arange(512) * length / 512
    mean = exact(x).mean()
    wave = gx.travelling.periodic_wave(gx.Toda(), length, speed=frequency * length, mean=mean)
    assert_allclose(wave.strain(x), exact(x), atol=1e-12)
    again = gx.travelling.periodic_wave(gx.Toda(), length, amplitude=wave.amplitude, mean=mean)
    assert float(again.speed) == pytest.approx(frequency * length, rel=1e-12)
    u, v = wave.state(9, 3.3)
    assert_allclose(u[:-1] - u[1:], exact(np.arange(8) - 3.3), atol=1e-12)
    assert np.isfinite(v).all() and float(wave.error) < 1e-10


@pytest.mark.slow
def test_a_periodic_wave_runs_around_a_ring():
    wave = gx.travelling.periodic_wave(gx.Hertz(), 9.0, amplitude=0.3, mean=0.5)
    u, v = wave.state(18)
    ring = gx.Lattice(
        1.0, gx.Bond(gx.Shift(1, "periodic"), gx.laws.Strained(wave.law, wave.mean)), sites=18
    )
    run = gx.simulate(
        ring, (u + wave.mean * np.arange(18), v), 18 / float(wave.speed), tolerance=1e-12
    )
    assert_allclose(run.final.v, v, atol=1e-8)


@pytest.mark.study
def test_a_family_and_where_its_energy_turns():
    waves = gx.travelling.family(STEEP, speed=[1.03, 1.035, 1.04])
    ends = [float(solitary_wave(STEEP, speed=waves.turns[0] + d).energy) for d in (-1e-3, 0, 1e-3)]
    assert waves.turns.shape == (1,) and ends[1] < min(ends[0], ends[2])
    by_energy = gx.travelling.family(gx.Hertz(), energy=[1.0, 2.0])
    assert_allclose(by_energy.energy_slope, 10 * by_energy.energy / by_energy.speed, rtol=1e-8)


@pytest.mark.study
@pytest.mark.parametrize("k", [1e-3, 0.03, 0.3, 10.0, 30.0])
def test_the_error_is_no_less_than_what_it_is_off(k):
    wave = solitary_wave(gx.Toda(), speed=np.sinh(k) / k)
    x = np.linspace(0, 8 / k, 101)
    off = np.abs(wave.strain(x) - np.log1p(np.sinh(k) ** 2 / np.cosh(k * x) ** 2)).max()
    assert off <= float(wave.error) < 1e-7 * float(wave.amplitude)


@pytest.mark.study
@pytest.mark.parametrize(
    ("law", "speed"),
    [
        (gx.PowerLaw(1.0, -3.0, 1.0), 17.3),
        (gx.Polynomial(1.0, 0.5, -0.1), 1.23),
        (gx.PowerLaw(1.0, 0.5, 1.0), 0.8),
    ],
)
def test_where_the_factor_goes_astray_or_the_law_nearly_ends(law, speed):
    wave = solitary_wave(law, speed=speed)
    z, w = np.polynomial.legendre.leggauss(300)
    parts = [
        np.asarray(law.force(wave.strain(side * (1 + z) / 2))) * (1 - z) / 2 @ w / 2
        for side in (1, -1)
    ]
    assert sum(parts) == pytest.approx(speed**2 * float(wave.amplitude), rel=1e-7)


class Tanh(gx.Law):
    def force(self, e):
        return e * (1 + jnp.tanh(e) ** 2)

    def energy(self, e):
        return e**2 - e * jnp.tanh(e) + jnp.log(jnp.cosh(e))


class LennardJones(gx.Law):
    def force(self, e):
        return ((1 - e) ** -13 - (1 - e) ** -7) / 6

    def energy(self, e):
        return (((1 - e) ** -12 - 1) / 12 - ((1 - e) ** -6 - 1) / 6) / 6


class Exponential(gx.Law):
    def force(self, e):
        return jnp.exp(e) - 1 + 0.1 * e**2

    def energy(self, e):
        return jnp.exp(e) - 1 - e + 0.1 * e**3 / 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "speed", "peak"),
    [
        (Tanh(), 1.05, 0.465468743865),
        (Tanh(), 1.2, 1.16419279186),
        (Tanh(), 1.35, 2.67361194064),
        (LennardJones(), 1.1, 0.0259590494),
        (LennardJones(), 1.5, 0.0987909641),
        (LennardJones(), 3.0, 0.2282256949),
    ],
)
def test_laws_as_a_user_writes_them(law, speed, peak):
    wave = solitary_wave(law, speed=speed)
    assert float(wave.amplitude) == pytest.approx(peak, abs=6e-11) and float(wave.error) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("energy", [0.1, 1.0, 10.0])
def test_a_wave_of_fput_beta_by_its_energy(energy):
    wave = solitary_wave(gx.Polynomial(1.0, 0.0, 0.1), energy=energy)
    x = np.linspace(-1, 1, 40001) * 36 / float(wave.decay)
    e = np.asarray(wave.strain(x))
    density = e * (e + 0.1 * e**3) / 2 + e**2 / 2 + 0.1 * e**4 / 4
    assert np.sum(density) * (x[1] - x[0]) == pytest.approx(energy, rel=1e-9)


@pytest.mark.slow
def test_the_front_of_a_shock_of_a_law_of_ones_own():
    edges = gx.theory.shock_edges(Exponential(), 0.2, wave=True)
    wave = solitary_wave(Exponential(), speed=edges.wave_speed)
    assert float(wave.velocity(0.5)) == pytest.approx(0.8, rel=1e-9)
    assert abs(float(edges.wave_speed / edges.leading_speed) - 1) < 1e-3


def by_newton(force, slope, speed, guess, half=24.0, n=600):
    """(x, phi) of c^2 phi = tent * F(phi), an even Fourier series in a box, unit mass."""
    x, k = np.linspace(0, half, n + 1), np.pi / half * np.arange(n + 1)
    ends = np.where(np.isin(np.arange(n + 1), [0, n]), 0.5, 1.0)
    waves = np.cos(np.outer(k, x))
    tent = (
        (waves * (np.sinc(k / 2 / np.pi) ** 2 * ends)[:, None]).T
        @ (waves * ends * 2 / n)
        / speed**2
    )
    phi = guess(x)
    for _ in range(12):
        phi = phi - np.linalg.solve(np.eye(n + 1) - tent * slope(phi), phi - tent @ force(phi))
    return x, phi


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.8, 0.82, 0.825])
def test_the_error_covers_the_truth_where_a_contact_all_but_opens(speed):
    wave = solitary_wave(gx.PowerLaw(1.0, 0.5, 1.0), speed=speed)
    guess = lambda x: np.asarray(wave.strain(x))
    x, phi = by_newton(lambda y: np.sqrt(1 + y) - 1, lambda y: 0.5 / np.sqrt(1 + y), speed, guess)
    assert np.abs(phi - guess(x)).max() < float(wave.error) + 1e-10
    assert float(wave.error) < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize(
    ("speed", "peak"), [(0.84, -1.0109305), (0.85, -1.0370327), (0.86, -1.0847036)]
)
def test_and_where_it_opens(speed, peak):
    """Peaks by Newton's method on a Fourier series of 2^15 terms, good to 1e-5."""
    wave = solitary_wave(gx.PowerLaw(1.0, 0.5, 1.0), speed=speed)
    assert (
        abs(float(wave.amplitude) - peak) < float(wave.error) < 2e-3 and float(wave.residual) > 1e-6
    )


BOND = gx.Bond(gx.Shift(1, "free"), gx.Toda())
REFUSED = [
    (lambda: solitary_wave(gx.Hertz(1.0, 1.0), speed=1.2), "above that of sound, 1.22474"),
    (lambda: solitary_wave(gx.Linear(), speed=2.0), "does not stiffen"),
    (lambda: solitary_wave(gx.PowerLaw(1.0, 0.5), speed=2.0), "infinitely stiff at rest"),
    (lambda: solitary_wave(gx.PowerLaw(1.0, 0.5, 1.0), speed=0.9), "one below 0.866025"),
    (lambda: solitary_wave(gx.Hertz(), amplitude=-1.0), "does not stiffen in tension"),
    (lambda: solitary_wave(gx.Hertz()), "exactly one of them"),
    (
        lambda: solitary_wave(gx.scenes.dimer(9, ratio=0.5), speed=1.0),
        "a uniform chain, all masses alike",
    ),
    (
        lambda: solitary_wave(
            gx.Lattice(1.0, (BOND, gx.OnSite(gx.Linear(0.1))), sites=9), speed=2.0
        ),
        "OnSite",
    ),
    (
        lambda: gx.travelling.periodic_wave(gx.Toda(), 8.0, speed=0.9),
        "one above that of small waves of this length",
    ),
    (lambda: gx.travelling.periodic_wave(gx.Hertz(), 8.0, amplitude=0.1), "the law is stiff"),
    (lambda: gx.travelling.periodic_wave(gx.Linear(), 8.0, amplitude=0.1), "not linear"),
    (lambda: solitary_wave(gx.Hertz(1.0, 1.0), speed=1.225).floquet(), "more than 200"),
    (
        lambda: solitary_wave(
            jax.vmap(lambda m: gx.scenes.monomer(9, mass=m), out_axes=-1)(jnp.ones(2)), speed=1.0
        ),
        "a batch",
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("call", "why"), REFUSED, ids=[why for _, why in REFUSED])
def test_refused_with_the_reason(call, why):
    with refused(why.replace("(", r"\(")):
        call()


def test_speeds_in_metres_per_second_by_the_diameter_of_a_bead():
    """Steel beads at 600 m/s, beside the wave of c = 1, whose strain scales with the fourth power of the speed."""
    R = 2.38e-3
    chain = gx.scenes.beads("steel 316", R, cells=20, boundary="free")
    wave = gx.travelling.solitary_wave(chain, speed=600.0 / (2 * R))
    assert float(wave.speed) == pytest.approx(600.0 / (2 * R), rel=1e-14)
    A, m = float(gx.materials.hertz_coefficient("steel 316", R)), float(chain.mass)
    # the wave of c = 1 scales as the fourth power of c (m/A)^(1/2), with its peak in closed numbers
    peak = 1.48735937434940207 * (float(wave.speed) * (m / A) ** 0.5) ** 4
    assert float(wave.amplitude) == pytest.approx(peak, rel=1e-12)
    left = gx.travelling.solitary_wave(chain, speed=-600.0 / (2 * R))
    assert float(left.speed) == -float(wave.speed)
    slope = jax.grad(lambda R: gx.travelling.solitary_wave(gx.Hertz(), speed=1.0 / R).amplitude)(
        2.0
    )
    assert float(slope) == pytest.approx(-4 * 1.48735937434940207 / 2**5, rel=1e-9)
