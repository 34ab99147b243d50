"""Solitary waves against known values, closed forms, other methods, and runs; and their stability."""

import pickle
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from scipy.optimize import brentq

import granjax as gx
from granjax.travelling import periodic_wave, solitary_wave

near = partial(assert_allclose, rtol=0)

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
STEEP = gx.Linear() + gx.PowerLaw(1.0, 7.0)
SOFT = gx.PowerLaw(1.0, 0.5, 1.0)


@pytest.fixture(scope="module")
def hertz():
    return solitary_wave(gx.Hertz(), speed=1.0)


@pytest.fixture(scope="module")
def toda():
    return solitary_wave(gx.Toda(), speed=np.sinh(1))


def test_the_hertz_wave_is_the_known_fixed_point(hertz):
    for place, value in HERTZ.items():
        near(hertz.strain([place, -place]), value, atol=1e-14)
    assert_allclose(hertz.strain([*FAR]), [*FAR.values()], rtol=1e-12)
    # a bead is fastest midway between the contacts' peaks
    near(hertz.velocity(0.5), 1.62494411458652483, atol=1e-14)
    near(hertz.energy, 2.82348668842275840, atol=1e-13)
    near(hertz.compression, 2.71360995307778758, atol=1e-13)
    near(hertz.width, 1.72571266900516663, atol=1e-9)
    assert hertz.error < 1e-14 and hertz.residual < 1e-12


def test_the_tail_falls_as_the_inequality_says(hertz):
    x = np.linspace(2, 5, 31)
    for n in range(1, 6):
        assert np.all(np.log(hertz.strain(x + n)) <= 1.5**n * np.log(hertz.strain(x)))
    assert 0 < hertz.strain(10.0) < 1e-140


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "ratio", "peak"),
    [
        (gx.Hertz(1.0, 1.0), 1.05, 0.653311577638),
        (gx.Hertz(1.0, 1.0), 1.2, 3.346111173809),
        (gx.Hertz(1.0, 1.0), 2, 49.4301641677),
        (gx.PowerLaw(1.0, -3.0, 1.0), 1.05, 0.069221794600),
    ],
)
def test_precompressed_peaks_and_tails(law, ratio, peak):
    wave = solitary_wave(law, speed=ratio * law.derivative(0.0) ** 0.5)
    near(wave.amplitude, peak, atol=1e-10)
    # kappa from sinh(kappa/2) = (c/c0) kappa/2, seen far out
    far = np.log(wave.strain([100.0, 101.0]))
    half = wave.decay / 2
    assert_allclose(far[0] - far[1], wave.decay, rtol=1e-12)
    assert_allclose(np.sinh(half) / half, ratio, rtol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("k", [1e-3, 0.1, 3.0, 10.0])
def test_the_toda_soliton_is_the_closed_form_within_its_error(k):
    wave = solitary_wave(gx.Toda(), speed=np.sinh(k) / k)
    exact = lambda x: np.log1p(np.sinh(k) ** 2 / np.cosh(k * x) ** 2)
    x = np.linspace(0, 8 / k, 101)
    off = np.abs(wave.strain(x) - exact(x)).max()
    assert off <= wave.error < 1e-7 * wave.amplitude
    if 0.1 <= k <= 3:
        assert_allclose(wave.strain(-8 * x), exact(8 * x), rtol=1e-11)
        assert_allclose(wave.energy, np.sinh(2 * k) - 2 * k, rtol=1e-11)
        assert_allclose(wave.compression, 2 * k, rtol=1e-12)
        assert_allclose(wave.momentum, 2 * np.sinh(k), rtol=1e-12)


@pytest.mark.slow
def test_one_wave_of_steel_beads_by_speed_amplitude_or_energy():
    R = 2.38e-3
    chain = gx.scenes.beads("steel 316", R, cells=20, boundary="free")
    speed = 600.0 / (2 * R)
    mass = chain.mass
    wave = solitary_wave(chain, speed=-speed)
    assert wave.units == "SI" and wave.momentum < 0 and wave.speed == -speed
    # the wave of c = 1 scales with the fourth power of the speed
    A = gx.materials.hertz_coefficient("steel 316", R)
    assert_allclose(wave.amplitude, HERTZ[0] * (speed * (mass / A) ** 0.5) ** 4, rtol=1e-12)
    for given in ("amplitude", "energy"):
        one = solitary_wave(chain, **{given: getattr(wave, given)})
        assert_allclose(one.speed, speed, rtol=1e-12)
        assert_allclose(one.strains, wave.strains, rtol=1e-11)
    u, v = wave.state(20, 9.25)
    strain = wave.strain(np.arange(19) - 9.25)
    assert_allclose(-np.diff(u), strain, atol=1e-13 * float(wave.compression))
    assert np.all(v < 0)
    assert pickle.loads(pickle.dumps(wave)).strain(0.3) == wave.strain(0.3)


@pytest.mark.slow
def test_the_peak_has_its_derivative_by_the_speed_in_reverse():
    slope = jax.grad(lambda R: solitary_wave(gx.Hertz(), speed=1.0 / R).amplitude)(2.0)
    assert_allclose(slope, -4 * HERTZ[0] / 2**5, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["energy", "speed", "amplitude"])
def test_derivatives_by_the_implicit_function_theorem(name):
    def found(x):
        wave = solitary_wave(gx.Hertz(x[0], x[1]), **{name: x[2]}, mass=x[3])
        numbers = wave.speed, wave.amplitude, wave.energy, wave.width
        return jnp.stack([*numbers, wave.strain(2.3), wave.velocity(-0.4)])

    x = np.array([1.1, 0.9, 2.1, 1.3])
    w = np.array([0.3, -0.2, 0.5, 0.4])
    slope = jax.jvp(found, (x,), (w,))[1]
    difference = (found(x + 1e-5 * w) - found(x - 1e-5 * w)) / 2e-5
    assert_allclose(slope, difference, rtol=1e-6)


@pytest.mark.slow
def test_the_energy_of_the_soliton_of_toda_has_its_second_derivative():
    # cosh(k) sinh(k) - k doubled, c = sinh(k)/k
    energy = lambda k: 2 * (jnp.cosh(k) * jnp.sinh(k) - k)
    speed = lambda k: jnp.sinh(k) / k
    k = brentq(lambda k: float(speed(k)) - 1.5, 1.0, 2.0, xtol=1e-14)
    by_speed = lambda k: jax.grad(energy)(k) / jax.grad(speed)(k)
    wave = lambda c: solitary_wave(gx.Toda(), speed=c).energy
    exact = jax.grad(by_speed)(k) / jax.grad(speed)(k)
    assert_allclose(jax.hessian(wave)(1.5), exact, rtol=1e-9)


@pytest.mark.slow
def test_the_energy_in_tension_has_its_derivative_by_the_amplitude():
    energy = lambda k, a: solitary_wave(gx.Polynomial(1.0, 0.3, k), amplitude=a).energy
    # By central differences of both.
    assert_allclose(jax.grad(energy, (0, 1))(1.0, -1.0), (0.17571831, -3.67005314), rtol=2e-8)


@pytest.mark.slow
def test_towards_the_speed_of_sound_it_is_the_soliton_of_korteweg_and_de_vries():
    law = gx.Hertz(1.0, 1.0)
    sigma = 1.5**0.5
    excess = np.array([1e-3, 1e-2])
    K2, K3, _ = gx.laws.taylor(law)
    errors = []
    for e in excess:
        wave = solitary_wave(law, speed=sigma * (1 + e))
        x = np.linspace(0, 6, 200) / np.sqrt(6 * e)
        soliton = 3 * K2 / K3 * e / np.cosh(np.sqrt(6 * e) * x) ** 2
        errors.append(np.abs(wave.strain(x) - soliton).max() / wave.amplitude)
    near(np.log10(errors[1] / errors[0]), 1.0, atol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "speed"),
    [
        (gx.PowerLaw(1.0, 1.05), 1.0),
        (gx.PowerLaw(1.0, 10.0), 1.3),
        # where Petviashvili's factor goes astray
        (gx.Polynomial(1.0, 0.5, -0.1), 1.23),
    ],
)
def test_the_tent_equation_holds_by_another_rule(law, speed):
    wave = solitary_wave(law, speed=speed)
    z, w = np.polynomial.legendre.leggauss(300)
    for x in (0.0, 1.7, 3.3):
        force = sum(law.force(wave.strain(x + side * (1 + z) / 2)) for side in (1, -1))
        tent = np.asarray(force) * (1 - z) / 2 @ w / 2
        assert_allclose(tent, speed**2 * wave.strain(x), rtol=1e-9)


@pytest.mark.slow
def test_strains_of_a_power_scale_with_the_speed():
    wave, faster = (solitary_wave(gx.PowerLaw(1.0, 3.0), speed=c) for c in (1.0, 1.3))
    x = [0.0, 1.1, 2.3]
    assert_allclose(faster.strain(x), 1.3 * wave.strain(x), rtol=1e-9)


class LennardJones(gx.Law):
    def force(self, e):
        return ((1 - e) ** -13 - (1 - e) ** -7) / 6

    def energy(self, e):
        return (((1 - e) ** -12 - 1) / 12 - ((1 - e) ** -6 - 1) / 6) / 6


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "peak"), [(1.1, 0.0259590494), (3.0, 0.2282256949)])
def test_a_law_as_a_user_writes_it(speed, peak):
    wave = solitary_wave(LennardJones(), speed=speed)
    near(wave.amplitude, peak, atol=6e-11)
    assert wave.error < 1e-12


def by_newton(force, slope, speed, guess, half=24.0, n=600):
    """(x, phi) of c^2 phi = tent * F(phi), an even Fourier series in a box, unit mass."""
    x = np.linspace(0, half, n + 1)
    k = np.pi / half * np.arange(n + 1)
    ends = np.where(np.isin(np.arange(n + 1), [0, n]), 0.5, 1.0)
    waves = np.cos(np.outer(k, x))
    back = waves * ends * 2 / n
    tent = (waves * (np.sinc(k / 2 / np.pi) ** 2 * ends)[:, None]).T @ back / speed**2
    phi = guess(x)
    for _ in range(12):
        phi = phi - np.linalg.solve(np.eye(n + 1) - tent * slope(phi), phi - tent @ force(phi))
    return x, phi


@pytest.mark.slow
def test_the_error_covers_the_truth_where_a_contact_all_but_opens():
    speed = 0.825
    wave = solitary_wave(SOFT, speed=speed)
    guess = lambda x: np.asarray(wave.strain(x))
    x, phi = by_newton(lambda y: np.sqrt(1 + y) - 1, lambda y: 0.5 / np.sqrt(1 + y), speed, guess)
    assert np.abs(phi - guess(x)).max() < wave.error + 1e-10 < 2e-10


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "peak"), [(0.84, -1.0109305), (0.86, -1.0847036)])
def test_the_error_covers_the_truth_where_a_contact_opens(speed, peak):
    """Peaks by Newton's method on a Fourier series of 2^15 terms, good to 1e-5."""
    wave = solitary_wave(SOFT, speed=speed)
    assert abs(wave.amplitude - peak) < wave.error < 2e-3 and wave.residual > 1e-6


# ----------------------------------------------------------------------------------------------------------- stability


def energy_of_steep_wave(speed, guess):
    """int (phi F/2 + W) of c^2 phi = tent * F(phi), F = e + e^7."""
    x, phi = by_newton(lambda e: e + e**7, lambda e: 1 + 7 * e**6, speed, guess, half=32.0)
    return 2 * np.trapezoid(phi * (phi + phi**7) / 2 + phi**2 / 2 + phi**8 / 8, x)


@pytest.fixture(scope="module")
def slow():
    """The wave of the steep law at 1.02, whose energy falls with its speed, and what ring and held ends say."""
    wave = solitary_wave(STEEP, speed=1.02)
    return wave, wave.floquet(), wave.floquet(ends="held")


@pytest.mark.slow
@pytest.mark.parametrize("speed", [1.02, -1.05])
def test_a_wave_is_unstable_where_its_energy_falls_with_its_speed(slow, speed):
    """Friesecke and Pego: a pair of multipliers leaves +1 where dE/dc = 0, near 1.035; nothing else does here."""
    wave, found, _ = slow
    if speed < 0:
        wave = solitary_wave(STEEP, speed=speed)
        found = wave.floquet()
    shape = lambda x: np.asarray(wave.strain(x))
    energies = [energy_of_steep_wave(abs(speed) + d, shape) for d in (-1e-3, 0, 1e-3)]
    slope = np.diff(energies)
    assert_allclose(wave.energy, energies[1], rtol=1e-6)
    assert slope[0] * slope[1] > 0
    assert found.verdict == ("unstable" if slope[0] < 0 else "stable")
    assert len(found.unstable) == (slope[0] < 0) == (speed > 0)
    assert f"ring of {len(found.state.u)} sites" in found.outcome
    assert speed > 0 or "run round the ring" in found.outcome


@pytest.mark.slow
def test_ring_and_held_ends_agree(slow):
    wave, ring, held = slow
    assert ring.verdict == held.verdict == "unstable"
    near(ring.multipliers[0], held.multipliers[0], atol=2e-4)
    assert np.isfinite(ring.krein).all()
    # the wave's own pair is known, whatever the ring does to the others
    inverse = np.abs(ring.multipliers - 1 / ring.multipliers[0]).argmin()
    assert ring.error[[0, inverse]].max() < 1e-6 < 1e-3 < ring.error.max()
    assert f"chain of {len(held.state.u)} sites with held ends" in held.outcome
    # what grows is the wave's own, and so are its place and its speed
    assert held.point[0] == held.multipliers[0]
    assert (np.abs(held.point - 1) < 0.1).sum() >= 3 and (np.abs(ring.point) > 1).sum() >= 1
    # far away exp(i (k - omega/c)), omega = 2 sin(k/2), at k + i decay/2: its largest modulus is at k = 0
    a = float(wave.decay) / 2
    largest = np.exp(-a + 2 * np.sinh(a / 2) / 1.02)
    assert_allclose(np.abs(held.essential).max(), largest, rtol=1e-12)
    assert_allclose(np.abs(ring.essential), 1, rtol=1e-12)


@pytest.mark.slow
def test_an_unstable_wave_grows_as_its_multiplier_says(slow):
    """What two runs from either side of a wave differ by, in a long chain, over 400 sites: to 1e-6 of the rate."""
    wave, _, found = slow
    N = 650
    places = np.arange(100, 501, 50)
    vector = found.vectors[:, 0].real
    sites = len(found.state.u)
    at = (sites - 2) / 2
    first = wave.state(N, at)
    change = np.zeros((2, N))
    change[:, :sites] = 1e-6 / np.abs(vector).max() * vector.reshape(2, -1)
    change[0, sites:] = change[0, sites - 1]
    chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), STEEP), sites=N)
    ts = places / float(wave.speed)
    starts = [gx.State(first.u + s * change[0], first.v + s * change[1]) for s in (1, -1)]
    runs = [gx.simulate(chain, y, ts[-1], tolerance=1e-12, save_at=ts).vs for y in starts]
    apart = np.abs(np.asarray(runs[0] - runs[1]))
    size = [row[int(at) + n - 20 : int(at) + n + 20].max() for n, row in zip(places, apart)]
    rate = np.polyfit(places, np.log(size), 1)[0]
    assert_allclose(rate, np.log(found.multipliers[0].real), rtol=1e-6)


@pytest.mark.slow
def test_the_toda_soliton_and_the_hertz_wave_are_stable(toda, hertz):
    found = toda.floquet()
    assert found.verdict == "stable" and found.expected == 4 and set(found.krein) == {-1, 0, 1}
    held = hertz.floquet()
    assert held.verdict == "stable" and held.expected == 2
    assert held.bound < 1 and f"are below {held.bound:.4g} in modulus" in held.outcome
    # what is left of a perturbation in the wave, per contact, whatever the length of the chain
    assert_allclose(hertz.floquet(16).multipliers[2:5], held.multipliers[2:5], atol=1e-5)


@pytest.mark.slow
def test_a_wave_with_second_neighbours_comes_by_newtons_method_from_one_without(toda):
    lattice, state = gx.travelling.ring(toda)
    second = gx.Bond(gx.Shift(2, "periodic"), gx.Linear(0.02))
    more = gx.Lattice(lattice.mass, (*lattice.terms, second), sites=lattice.sites)
    found = gx.travelling.wave_orbit(more, state, toda.speed)
    assert found.converged and 1e-3 < jnp.abs(found.state.u - state.u).max() < 0.3
    run = gx.simulate(more, found.state, 5 / float(toda.speed), tolerance=1e-11)
    assert_allclose(run.final.u, jnp.roll(found.state.u, 5), atol=1e-7)


@pytest.mark.slow
def test_a_family_knows_where_its_energy_turns(slow):
    waves = gx.travelling.family(STEEP, speed=[1.02, 1.03, 1.04])
    (turn,) = waves.turns
    shape = lambda x: np.asarray(slow[0].strain(x))
    before, there, after = (energy_of_steep_wave(turn + d, shape) for d in (-1e-3, 0, 1e-3))
    assert there < min(before, after)
    # the same wave to the left, and none between the two directions
    left = gx.travelling.family(STEEP, speed=[1.02, -1.02, -1.04])
    assert_allclose(left.turns, -gx.travelling.family(STEEP, speed=[1.02, 1.04]).turns, rtol=1e-12)
    by_energy = gx.travelling.family(gx.Hertz(), energy=[1.0])
    assert_allclose(by_energy.energy_slope, 10 * by_energy.energy / by_energy.speed, rtol=1e-8)


# ------------------------------------------------------------------------------------------------------------ refusals


def batch():
    return jax.vmap(lambda m: gx.scenes.monomer(9, mass=m), out_axes=-1)(jnp.ones(2))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("call", "why"),
    [
        (lambda: solitary_wave(gx.Hertz(1.0, 1.0), speed=1.2), "above that of sound, 1.22474"),
        (lambda: solitary_wave(gx.Linear(), speed=2.0), "does not stiffen"),
        (lambda: solitary_wave(gx.PowerLaw(1.0, 0.5), speed=2.0), "infinitely stiff at rest"),
        (lambda: solitary_wave(SOFT, speed=0.9), "one below 0.866025"),
        (lambda: solitary_wave(gx.Hertz()), "exactly one of them"),
        (lambda: gx.travelling.family(gx.Toda(), speed=[]), "speed: expected one number or a row"),
        (lambda: solitary_wave(gx.scenes.dimer(9, ratio=0.5), speed=1.0), "all masses alike"),
        (lambda: solitary_wave(gx.scenes.klein_gordon(5, 0.02), speed=2.0), "OnSite"),
        (lambda: solitary_wave(batch(), speed=1.0), "a batch"),
        (lambda: jax.jit(lambda c: solitary_wave(gx.Hertz(), speed=c))(1.0), "jax.jit or jax.vmap"),
        (lambda: periodic_wave(gx.Toda(), 8.0, speed=0.9), "above that of small waves"),
        (lambda: periodic_wave(gx.Hertz(), 8.0, amplitude=0.1), "the law is stiff"),
        (lambda: periodic_wave(gx.Linear(), 8.0, amplitude=0.1), "not linear"),
        (lambda: periodic_wave(gx.Toda(), 1e3, amplitude=0.3), "wavelength: .* wave is found, got"),
        (lambda: jax.jit(lambda c: periodic_wave(gx.Toda(), 6.0, speed=c))(0.97), "jax.jit"),
        (lambda: solitary_wave(gx.Hertz(1.0, 1.0), speed=1.225).floquet(), "more than 200"),
    ],
)
def test_a_wave_that_does_not_exist_is_refused_with_the_reason(call, why):
    with refused(why):
        call()


@pytest.fixture
def restricted():
    jax.config.update("jax_enable_x64", False)
    yield
    jax.config.update("jax_enable_x64", True)


@pytest.mark.parametrize(
    "search",
    [
        lambda: gx.states.solitary_wave(gx.scenes.monomer(9, boundary="free"), 4, speed=1.0),
        lambda: gx.travelling.family(gx.Toda(), speed=[1.2]),
        lambda: periodic_wave(gx.Toda(), 8.0, speed=1.2),
        lambda: gx.travelling.cell_wave(gx.Toda(), [1.0, 0.5], speed=1.4),
        lambda: gx.shocks.dissipative_front(gx.Toda(), 1.0, dashpot=2.0),
    ],
    ids=["solitary", "family", "periodic", "cell", "front"],
)
def test_shapes_of_waves_are_refused_where_jax_is_restricted_to_float32(search, restricted):
    with refused("jax_enable_x64: .* leave JAX_ENABLE_X64 unset"):
        search()


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
        v = norm * new / np.linalg.norm(new)
        c = np.sqrt(np.linalg.norm(new) / norm)
    assert np.all(np.diff(stored) > -1e-13 * stored[-1])
    return c, x, mean(v)


@pytest.mark.slow
@pytest.mark.parametrize("load", [0.0, 1.0])
def test_a_second_method_gives_the_same(load):
    law = gx.Hertz(1.0, load)
    c, x, strain = by_constraint(law, 20.0)
    wave = solitary_wave(law, speed=c)
    assert_allclose(wave.strain(x), strain, atol=1e-10 * float(wave.amplitude), rtol=0)


@pytest.mark.slow
def test_second_derivatives_of_a_wave_in_a_sonic_vacuum():
    """Strains grow as the fourth power of the speed, energies as the tenth."""

    def found(c):
        wave = solitary_wave(gx.Hertz(), speed=c)
        return jnp.stack([wave.energy, wave.strain(0.7), wave.strain(2.5), wave.strain(6.0)])

    power = np.array([10, 4, 4, 4])
    exact = power * (power - 1) * found(1.0)
    assert_allclose(jax.jacrev(jax.jacfwd(found))(1.0), exact, rtol=1e-10)
