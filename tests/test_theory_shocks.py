"""Dispersive shocks of Toda and KdV by modulation theory: published numbers, formulas in 60 digits, equations."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
from numpy.testing import assert_allclose
from pytest import mark
from refusals import refused
from scipy.integrate import quad

import granjax as gx
from granjax.theory import kdv, toda

# sigma = 1, K2 = 1, K3 = 1/2: the Toda chain of strength, rate and mass 1; a law that softens
NORMAL = (1.0, 0.5)
SOFT = (1.5, -0.4, 2.0)
M = np.array([0.0, 1e-9, 0.2, 0.5, 0.8, 0.95, 1 - 2.0**-30, 1.0])
C = np.array([1e-6, 0.1, 0.5, 0.9])


def toda_speed(m, c):
    """s(m) as it is printed, in 60 digits; at the ends the limits."""
    with mp.workdps(60):
        m = mp.mpf(float(m))
        c = mp.mpf(float(c))
        if m == 0 or m == 1:
            return float(
                1 - c if m == 0 else mp.sqrt(c * (c + 1)) / mp.log(mp.sqrt(c) + mp.sqrt(c + 1))
            )
        K = mp.ellipk(m)
        E = mp.ellipe(m)
        share = 1 + c * (1 - m)
        third = (c + 1) * K - share * mp.ellippi(c * m / (c + 1), m)
        return float(c * (c + 1) / share * (share * E - (c + 1) * (1 - m) * K) / third)


def test_edges_of_the_toda_shock():
    published = [
        [0.9, 0.5],
        [1.06581768, 1.31519072],
        [0.19062036, 0.81093022],
        [0.36464311, 1.38629436],
    ]
    assert_allclose(toda.velocity_shock(np.array([0.1, 0.5])), published, rtol=0, atol=5.1e-9)
    # what the modulation has at its ends
    back = toda.modulation(0.0, C)
    front = toda.modulation(1.0, C)
    ends = back.speed, front.speed, back.mean, front.amplitude
    assert_allclose(ends, toda.velocity_shock(C), rtol=4e-15)
    assert not np.any([back.amplitude, front.trough, front.mean])
    assert np.all(np.isinf(front.wavelength))


@mark.slow
def test_speed_inside_the_toda_shock():
    speed = toda.modulation([0.2, 0.5, 0.8, 0.95], 0.5).speed
    assert_allclose(speed, [0.607509, 0.803701, 1.063430, 1.237004], rtol=0, atol=5.1e-7)
    m, c = np.meshgrid(M, C, indexing="ij")
    speed = toda.modulation(m, c).speed
    assert_allclose(speed, np.vectorize(toda_speed)(m, c), rtol=0, atol=2e-15)
    # and back; a weak shock is as narrow as its c
    assert np.all(np.abs(toda.modulus(speed, c) - m) < 2e-15 / c)
    far = np.where(m < 0.5, -3.0 * m, 2 + m)
    np.testing.assert_array_equal(toda.modulus(far, c), m >= 0.5)


@mark.slow
def test_the_modulated_wave_of_toda_is_the_periodic_wave_of_its_numbers():
    """Of a law of negative constants, whose waves are rarefactions, in no particular units."""
    own = dict(strength=-0.7, rate=-1.3, mass=2.1)
    unit = np.sqrt(0.7 * 1.3 / 2.1)
    m = np.array([0.1, 0.5, 0.9])
    c = 0.4 * unit / own["rate"]
    t = 2000.0
    at = toda.modulation(m, c, **own)
    E = at.E1, at.E2, at.E3, at.E4
    same = toda.periodic_numbers(*E, **own)
    numbers = same.mean_strain, same.wavelength, same.crest, same.trough
    assert_allclose([at.mean, at.wavelength, at.crest, at.trough], numbers, rtol=1e-13)
    assert_allclose(at.amplitude, at.crest - at.trough, rtol=1e-13)
    assert_allclose(at.speed, [unit * toda_speed(x, 0.4) for x in m], rtol=1e-14)
    # far behind, inside, ahead
    n = np.array([0.1 * unit * t, *at.speed * t, 2 * unit * t])
    shock = toda.shock_wave(n, t, c, phase=0.0, **own)
    assert_allclose(shock.m, [0, *m, 1], atol=1e-13)
    assert_allclose(shock.mean[1:4], at.mean, rtol=1e-13)
    assert_allclose(shock.strain[np.array([0, 4])], [2 * np.log(1.4) / own["rate"], 0], atol=1e-14)
    wave = toda.periodic_wave(n[1:4], t, *E, **own)
    assert_allclose(shock.strain[1:4], wave.strain, rtol=1e-10)
    # a phase of its own at each place; a whole wave changes nothing
    turned = toda.shock_wave(n, t, c, phase=jnp.array([0, 2, 4, 6, 0]) * jnp.pi, **own)
    assert_allclose(turned.strain, shock.strain, rtol=1e-10, atol=1e-15)


@mark.slow
def test_waves_are_conserved():
    """s = d omega/dk: crests neither begin nor end inside."""

    def frequencies(m):
        at = toda.modulation(m, 0.5)
        own = toda.periodic_numbers(at.E1, at.E2, at.E3, at.E4)
        return 2 * jnp.pi / own.wavelength, 2 * jnp.pi / own.period

    m = jnp.array([0.05, 0.5, 0.95])
    (k, _), (dk, domega) = jax.jit(lambda m: jax.jvp(frequencies, (m,), (jnp.ones(3),)))(m)
    assert_allclose(domega / dk, toda.modulation(m, 0.5).speed, rtol=1e-12)
    assert np.all(dk < 0) and np.all(k > 0)


def exact_phase(m, c):
    """pi less the ratio of the two integrals, by quadrature in the angle of each band."""
    E1, E2, E3, E4 = (float(E) for E in toda.modulation(m, c)[1:5])
    chi = lambda x: np.log((x * x - E2**2) * (E4**2 - x * x)) / 2 - np.log(c * x)
    inside = lambda a, b, x: (
        2 * quad(lambda q: x(a + (b - a) * np.sin(q) ** 2), 0, np.pi / 2, epsabs=1e-13)[0]
    )
    over = inside(E3, E4, lambda x: chi(x) / np.sqrt((x - E1) * (x - E2)))
    return np.pi - over / inside(E2, E3, lambda x: 1 / np.sqrt((x - E1) * (E4 - x)))


@mark.slow
def test_the_phase_is_that_of_two_integrals():
    m = np.array([0.05, 0.5, 0.95])
    for c in (0.1, 0.9):
        assert_allclose(toda.modulation(m, c).phase, [exact_phase(x, c) for x in m], rtol=1e-11)
    weak = toda.modulation(m, 1e-7).phase
    assert_allclose(kdv.modulation(m, 0.1, *NORMAL).phase, weak, rtol=1e-6)
    front = toda.modulation([1 - 2.0**-50, 1.0], 0.5).phase
    assert_allclose(front, 1.5 * np.pi, rtol=0.05)


def simulated(c, times, step):
    """A velocity shock: time, places, strain, where in the fan that is, 0 to 1, and how far off the theory is."""
    sites = 501
    n = np.arange(sites) - sites // 2
    start = np.zeros(sites), -2 * c * np.sign(n)
    how = dict(step=step, solver=gx.SRKN11b(), save_at=times)
    run = gx.simulate(gx.scenes.toda(sites, boundary="free"), start, times[-1], **how)
    x = np.abs(n[:-1] + 0.5)
    (back, front, *_) = toda.velocity_shock(c)
    for t, u in zip(times, np.asarray(run.us)):
        apart = np.abs(-np.diff(u) - toda.shock_wave(x, t, c).strain)
        yield t, x, -np.diff(u), np.asarray((x / t - back) / (front - back)), np.asarray(apart)


@mark.slow
def test_a_simulated_shock_is_that_of_the_theory():
    """Without anything fitted: the error in the middle falls like 1/t, the plateau is the mean."""
    middle = []
    worst = []
    for t, x, strain, part, apart in simulated(0.5, [40.0, 80.0, 160.0], 0.1):
        middle.append(t * apart[(part > 0.4) & (part < 0.6)].max())
        worst.append(apart[(part > 0.1) & (part < 0.9)].max())
    assert_allclose(middle, 1.2, rtol=0.1)
    assert worst[-1] < 0.05 and worst[-1] < 0.6 * worst[0]
    weight = np.where(x < 40, np.cos(np.pi * x / 80) ** 2, 0)
    assert_allclose(np.average(strain, weights=weight), 2 * np.log(1.5), rtol=0, atol=2e-4)


@mark.slow
def test_a_shock_beyond_c_of_one_has_a_binary_oscillation():
    """Neighbours swing against each other behind the fan, exactly as the wave of two sites of the theory does."""
    c = 2.0
    for t, x, strain, part, apart in simulated(c, [40.0, 80.0, 105.0], 0.04):
        assert t * apart[(part > 0.1) & (part < 0.6)].max() < 1.0
    assert apart[(part > -0.19) & (part < -0.15)].max() < 1e-5
    at = toda.modulation(1 - 1 / c**2, c)
    edges = toda.velocity_shock(c)
    assert_allclose([at.wavelength, at.E3], [2, c - 1], rtol=1e-14)
    assert at.speed == edges.trailing_speed and at.mean == edges.mean
    behind = strain[(part > -0.22) & (part < -0.15)]
    assert np.all((behind > at.trough) & (behind < at.crest)) and np.ptp(behind) > 0.3
    # at c = 1 both sides meet
    ends = np.array(toda.velocity_shock(1 + np.array([-1e-9, 0.0, 1e-9])))
    assert_allclose(ends, ends[:, [1]] * np.ones(3), rtol=0, atol=1e-7)
    m = toda.modulus(toda.modulation([0.76, 0.9, 1.0], c).speed, c)
    assert_allclose([toda.modulus(0.1, c), *m], [0.75, 0.76, 0.9, 1.0], rtol=1e-13)
    assert_allclose(jax.grad(lambda c: toda.modulus(0.1, c))(c), 2 / c**3)


@mark.slow
def test_a_shock_differentiates():
    """In both modes, and where c alone moves at the edges too."""
    f = lambda x: (
        toda.shock_wave(80 * x[0], 80.0, x[1], phase=x[2]).strain + toda.modulus(x[0], x[1])
    )
    x = jnp.array([0.9, 0.5, 0.3])
    way = jnp.array([1.0, -2.0, 0.7])
    h = 1e-5
    back, along = jax.jit(lambda x: (jax.grad(f)(x), jax.jvp(f, (x,), (way,))[1]))(x)
    assert_allclose(back @ way, along, rtol=1e-12)
    want = [(f(x + h * e) - f(x - h * e)) / (2 * h) for e in np.eye(3)]
    assert_allclose(back, want, rtol=1e-6)
    numbers = lambda m, c: jnp.stack(toda.modulation(m, c)[:7])
    assert np.all(np.isfinite(jax.jit(jax.jacfwd(numbers, 1))(jnp.array([0.0, 1.0]), 0.5)))
    slopes = jax.jit(jax.jacfwd(numbers))
    assert slopes(1.0, 0.5)[0] == np.inf and slopes(1.0, 0.5)[5] == -np.inf
    assert np.all(np.isfinite(slopes(0.0, 0.5)))
    # nowhere a NaN: behind, at both edges, ahead
    t = 80.0
    speeds = toda.velocity_shock(0.5)
    n = t * jnp.array([0.1, speeds.trailing_speed, 0.9, speeds.leading_speed, 1.4])
    strong = lambda x: jnp.stack(toda.shock_wave(n + x[0], t + x[1], 0.5 + x[2]))
    weak = lambda x: jnp.stack(kdv.shock_wave(n + x[0], t + x[1], 0.1 + x[2], *NORMAL))
    for wave in (strong, weak):
        assert np.all(np.isfinite(jax.jit(jax.jacrev(wave))(jnp.zeros(3))))


# ----------------------------------------------------------------------------------------------------------------- KdV


def S(m):
    """As it is printed, in 60 digits; at m = 0 and 1 the limits."""
    with mp.workdps(60):
        m = mp.mpf(float(m))
        if m == 0 or m == 1:
            return -1.0 if m == 0 else 2 / 3
        K = mp.ellipk(m)
        E = mp.ellipe(m)
        return float((1 + m) / 3 - 2 * m * (1 - m) * K / (E - (1 - m) * K) / 3)


@mark.slow
def test_the_shock_of_kdv():
    edges = kdv.velocity_shock(C, *NORMAL)
    ends = kdv.modulation([[0.0], [1.0]], C, *NORMAL)
    assert_allclose(edges, [1 - C, 1 + 2 * C / 3, 2 * C, 4 * C], atol=1e-15)
    assert_allclose([*ends.speed, ends.mean[0], ends.amplitude[1]], edges, atol=1e-15)
    assert not np.any([ends.mean[1], ends.amplitude[0]])
    speed = kdv.modulation(M, 0.5, *NORMAL).speed
    assert_allclose((speed - 1) / 0.5, np.vectorize(S)(M), atol=1e-15)
    assert_allclose(kdv.modulus(speed, 0.5, *NORMAL), M, atol=2e-15)


@mark.slow
def test_kdv_is_the_toda_chain_of_weak_shocks():
    """What is left of the edges is the next term of their series, with its factor."""
    names = ("mean", "crest", "trough", "amplitude", "wavelength", "phase")
    faint = toda.modulation(M, 1e-13)
    other = kdv.modulation(M, 1e-13, *NORMAL)
    for name in names:
        assert_allclose(getattr(faint, name), getattr(other, name), rtol=1e-12)
    c = 1e-4
    left = np.array(toda.velocity_shock(c)) - np.array(kdv.velocity_shock(c, *NORMAL))
    assert_allclose(left / c**2, [0, -4 / 45, -1, -4], rtol=1e-3, atol=1e-7)
    m = M[2:6]
    inside = toda.modulation(m, c)
    other = kdv.modulation(m, c, *NORMAL)
    assert_allclose((inside.speed - 1) / c, np.vectorize(S)(m), atol=1e-4)
    for name in names[:5]:
        assert_allclose(getattr(inside, name), getattr(other, name), rtol=2 * c)
    n = 1e6 * (1 + c * np.linspace(-1.2, 0.8, 9))
    t = 1e6
    strains = [wave.strain for wave in (toda.shock_wave(n, t, c), kdv.shock_wave(n, t, c, *NORMAL))]
    assert_allclose(*strains, atol=0.2 * c)


@mark.slow
def test_the_modulated_wave_of_kdv_is_the_cnoidal_wave_of_its_numbers():
    """Of a law that softens it is a wave of rarefaction."""
    c = -0.08
    m = np.array([0.1, 0.5, 0.9])
    t = 3000.0
    sound, unit = kdv.scales(*SOFT)
    at = kdv.modulation(m, c, *SOFT)
    cnoidal = lambda n, t: kdv.cnoidal(n, t, at.r1, at.r2, at.r3, *SOFT[:2], mass=SOFT[2]).strain
    n = np.array([0.5 * sound * t, *at.speed * t, 2 * sound * t])
    shock = kdv.shock_wave(n, t, c, *SOFT[:2], mass=SOFT[2], phase=0.0)
    assert_allclose(shock.m, [0, *m, 1], atol=1e-12)
    assert_allclose(shock.strain[1:4], cnoidal(n[1:4], t), atol=1e-10)
    assert_allclose(shock.mean[1:4], at.mean, rtol=1e-10)
    assert_allclose(shock.strain[np.array([0, 4])], [unit * at.r3[0], 0], atol=1e-14)
    assert unit < 0 and np.all(at.crest < at.mean) and np.all(at.mean < at.trough)
    # the mean over a wavelength, and as many crests come as go
    x = np.linspace(0, 1, 64, endpoint=False)[:, None] * at.wavelength
    assert_allclose(at.mean, cnoidal(x, 0.0).mean(0), rtol=1e-10)

    def frequencies(m):
        at = kdv.modulation(m, c, *SOFT)
        k = 2 * jnp.pi / at.wavelength
        return k, k * sound * (1 + (at.r1 + at.r2 + at.r3) / 3)

    _, (dk, domega) = jax.jit(lambda m: jax.jvp(frequencies, (m,), (jnp.ones(3),)))(jnp.asarray(m))
    assert_allclose(domega / dk, at.speed, rtol=1e-12)


@mark.parametrize(
    "call, said",
    [
        (lambda: kdv.velocity_shock(-0.1, *NORMAL), "^c: .*a rarefaction"),
        (lambda: kdv.velocity_shock(1.0, *NORMAL), "^c: .*no long, weak wave"),
        (lambda: toda.modulation(0.7, 2.0), r"^m: expected numbers from 1 - 1/C\^2 on"),
        (lambda: toda.velocity_shock(-0.1), "^c: .*pulled apart"),
        (lambda: toda.modulation(1.1, 0.5), r"^m: expected numbers in \[0, 1\]"),
        (lambda: toda.shock_wave(1.0, 0.0, 0.5), "^t: expected numbers above zero"),
    ],
)
def test_what_is_no_shock_is_refused(call, said):
    with refused(said):
        call()
