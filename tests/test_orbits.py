"""Orbits as roots of shooting problems: free displacements, half and whole periods, segments, and symmetries."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from scipy.special import ellipe, ellipj, ellipk

import granjax as gx
from granjax.continuation.newton import newton
from granjax.orbits import Mirror, Shooting, Sign, Symmetry, Translation, orbit
from granjax.orbits.asked import checked_symmetry, default_steps, shifts

pytestmark = pytest.mark.slow
N = 5
RNG = np.random.default_rng(4)


# free displacements -------------------------------------------------------------------------------------------------


def bond(boundary="free", law=gx.Hertz(1.0, 1.0), **fields):
    return gx.Bond(gx.Shift(1, boundary, **fields), law)


def in_time(term):
    return gx.Modulated(term, gx.Harmonic(0.1, 1.0, mean=1.0))


INNER = gx.Bond(gx.Shift(0, fields=("bead", "resonator")), gx.Linear(0.5))
MASS_IN_MASS = gx.Lattice(
    {"bead": 1.0, "resonator": 0.3}, (bond(fields=("bead", "bead")), INNER), sites=3
)
FREE = {
    "ring": ((bond("periodic"),), 1),
    "walls": ((bond("fixed"),), 0),
    "one wall": ((bond(), gx.Wall(gx.Hertz(), "left")), 0),
    "driven": ((bond(), gx.Damping(0.1), gx.Drive(gx.Harmonic(0.1, 1.0), 0)), 1),
    "modulated site": ((bond(), in_time(gx.OnSite(gx.Linear(1.0)))), 0),
    "dashpots to walls": ((bond(), gx.Dashpot(gx.Shift(1, "fixed"), 0.1)), 0),
}


@pytest.mark.parametrize("case", [*FREE, "resonators"])
def test_free_displacements_cost_no_force(case):
    terms, count = FREE.get(case, (None, 1))
    lattice = MASS_IN_MASS if terms is None else gx.Lattice(1.0, terms, sites=4)
    zero = lattice.zeros()
    moves = np.asarray(shifts(lattice))
    assert moves.shape == (sum(x.size for x in jax.tree.leaves(zero)), count)
    if count:
        assert np.all(moves == 1)
        moved = jax.tree.map(lambda x: x + 0.7, zero)
        forces = [jax.tree.leaves(lattice.acceleration(0.3, u, zero)) for u in (zero, moved)]
        assert max(np.abs(a - b).max() for a, b in zip(*forces)) < 1e-14


def test_free_displacements_in_the_plane_and_of_a_traced_lattice():
    u = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.75**0.5]])
    stretch = gx.Stretch(gx.Pairs([0, 1, 2], [1, 2, 0], sites=3), u[[1, 2, 0]] - u)
    lattice = gx.Lattice(1.0, gx.Bond(stretch, gx.Linear(1.0)), sites=3, dimension=2)
    assert np.array_equal(shifts(lattice), np.tile(np.eye(2), (3, 1)))
    count = jax.eval_shape(lambda r: shifts(gx.scenes.dimer(4, ratio=r, boundary="free")), 0.5)
    assert count.shape == (4, 1)


# half and whole periods ---------------------------------------------------------------------------------------------


# the phase is free, and between free ends where the chain stands
@pytest.mark.parametrize(
    "ends, share, segments, free", [("free", 0.975, 3, 2), ("fixed", 0.99, 1, 1)]
)
def test_an_orbit_over_half_a_period_is_one_over_a_whole(ends, share, segments, free):
    lattice = gx.scenes.dimer(N, ratio=0.5, precompression=1.0, boundary=ends)
    omega = share * float(gx.linear.normal_modes(lattice).omega[-1])
    family = gx.breathers.family(lattice, until=omega, stability=False)
    found = gx.breathers.breather(lattice, omega, family.orbit(-1), tolerance=1e-12, check=False)
    assert np.abs(found.state.u).max() > 0.2
    state = found.state
    scene = (lattice, found.period)
    flow = gx.Flow(60 // segments, gx.KahanLi8())
    full = Shooting.of(lattice, flow, reference=state, segments=segments)
    residual = jax.jit(lambda x: full.residual(x, scene))
    exact = full.guess(state, scene)
    assert exact.shape == (segments * 2 * N + free,)
    assert np.abs(residual(exact)).max() < 1e-11
    value, jacobian = jax.jit(lambda x: full.linearise(x, scene))(exact + 0.01)
    assert_allclose(value, residual(exact + 0.01), rtol=0, atol=1e-14)
    assert_allclose(jacobian, jax.jacfwd(residual)(exact + 0.01), rtol=0, atol=1e-13)
    assert np.linalg.cond(jacobian) < 100

    # from a guess that is perturbed in every direction, also that of the symmetries
    guess = exact + 0.01 * RNG.normal(size=exact.shape)
    how = dict(linearise=full.linearise, throw=False, tolerance=1e-15)
    roots = [newton(full.residual, guess, scene, max_steps=k, **how).x for k in range(1, 6)]
    errors = np.array([np.abs(root - exact).max() for root in roots])
    assert errors[0] > 1e-2 and errors[4] < 1e-11
    if ends == "free":
        assert errors[2] < 3 * errors[1] ** 2 and errors[3] < 3 * errors[2] ** 2 + 1e-11
    assert np.abs(roots[-1][-free:]).max() < 1e-12
    assert np.array_equal(full.state(roots[-1]).u, roots[-1][:N])


# orbits modulo a symmetry -------------------------------------------------------------------------------------------


def cnoidal(sites, m):
    """Toda's wave of one crest on a ring whose mean compression is zero, and the time in which it moves on by a site.

    With rate^-2 = 1/sn^2(2K/N) - 1 + E/K the wave exp(e) - 1 = rate^2 (dn^2(2K n/N - rate t) - E/K) solves Toda's
    equations; a uniform compression c more stretches time by exp(c/2). Source: Toda, Phys. Rep. 18, 1 (1975).
    """
    K = ellipk(m)
    E = ellipe(m)
    rate = (1 / ellipj(2 * K / sites, m)[0] ** 2 - 1 + E / K) ** -0.5
    sn, cn, dn, _ = ellipj(2 * K * np.arange(sites) / sites, m)
    force = rate**2 * (dn**2 - E / K)
    e = np.log1p(force)
    slope = 2 * m * rate**3 * sn * cn * dn / (1 + force)
    pace = np.exp(-e.mean() / 2)
    u, v = (-np.cumsum(x - x.mean()) for x in (e, slope * pace))
    return gx.State(np.roll(u - u.mean(), 1), np.roll(v - v.mean(), 1)), 2 * K / rate / sites / pace


RING = gx.scenes.toda(6, boundary="periodic")


@pytest.fixture(scope="module")
def rotating():
    """A rotating wave from a guess that is off by some per cent."""
    exact, period = cnoidal(6, 0.9)
    guess = gx.State(1.03 * exact.u, 0.99 * exact.v + 0.002 * RNG.normal(size=6))
    return exact, orbit(RING, guess, period, symmetry=Translation(1), segments=2)


def test_a_rotating_wave_of_a_toda_ring_is_the_cnoidal_one(rotating):
    exact, wave = rotating
    end = gx.Flow(64)(exact, 0.0, wave.period, RING)
    assert_allclose(end.u, np.roll(exact.u, 1), rtol=0, atol=1e-14)
    energy = float(RING.energy(0.0, *exact))
    assert wave.converged and float(wave.energy) == pytest.approx(energy, rel=1e-11)
    # the same wave, later or earlier by a while
    flow = gx.Flow(4)
    u = wave.state.u
    apart = [np.abs(flow(exact, 0.0, s, RING).u - u).max() for s in np.linspace(-0.1, 0.1, 41)]
    assert min(apart) < 0.02 and np.abs(u).max() > 0.25
    # a site ago it stood one site before
    with refused(r"orbit: expected one that returns itself after T, .* Translation\(1\)"):
        _ = wave.amplitude


def test_a_wave_modulo_a_shift_is_an_orbit_of_the_whole_ring_with_a_derivative(rotating):
    _, wave = rotating
    whole = orbit(RING, wave.state, 6 * wave.period, steps=42)
    assert whole.root.iterations == 1 and whole.residual < 1e-10
    turned = wave.floquet()
    full = whole.floquet()
    assert turned.expected == full.expected == 4 and turned.verdict == full.verdict == "stable"
    power = turned.multipliers**6
    assert np.abs(power[:, None] - full.multipliers).min(1).max() < 1e-6

    how = dict(symmetry=Translation(1), steps=24, throw=False, tolerance=1e-13)
    energy = jax.jit(lambda T: orbit(RING, wave.state, T, **how).energy)
    slope = (energy(wave.period + 1e-5) - energy(wave.period - 1e-5)) / 2e-5
    assert float(jax.jacfwd(energy)(wave.period)) == pytest.approx(float(slope), rel=1e-6)


def test_half_a_period_of_an_odd_lattice_is_an_orbit_modulo_its_sign():
    chain = gx.scenes.fput(5, alpha=0.0, beta=1.0)
    omega = 1.05 * float(gx.linear.normal_modes(chain).omega[-1])
    b = gx.breathers.breather(chain, omega, check=False)
    half = orbit(chain, b.state, b.period / 2, symmetry=Sign())
    assert half.floquet().expected == 2
    # and of an odd number of sites its own mirror image, which is the same here
    mirrored = orbit(chain, b.state, b.period, symmetry=Mirror() @ Sign())
    for found in (half, mirrored):
        assert_allclose(found.state.u, b.state.u, rtol=0, atol=1e-9)


def test_symmetries_compose_and_what_is_none_of_the_lattice_is_refused():
    u = jnp.arange(4.0)
    for a, b in ((Translation(1), Mirror()), (Mirror(), Translation(1)), (Sign(), Translation(-1))):
        assert np.array_equal((a @ b)(u), a(b(u)))
    wave = gx.State(np.sin(np.arange(6.0)), np.zeros(6))
    for chain, asked in ((gx.scenes.toda(6, boundary="free"), Translation(1)), (RING, Sign())):
        with refused("symmetry: expected a symmetry of the lattice"):
            orbit(chain, wave, 1.0, symmetry=asked)
    # sin(t) turns its sign after half of its period, not after all of it
    sine = gx.Drive(gx.Harmonic(0.1, 1.0, phase=-np.pi / 2), 0)
    driven = gx.Lattice(1.0, (bond("fixed", gx.Linear(1.0)), sine), sites=3)
    assert checked_symmetry(driven, Sign(), REST, 0.0, np.pi) == Sign()
    for asked, period in ((Sign(), 2 * np.pi), (Sign(), np.nan), (Symmetry(), 6.0)):
        with refused("period: expected" if asked.trivial else "symmetry: expected"):
            checked_symmetry(driven, asked, REST, 0.0, period)


REST = gx.State(jnp.zeros(3), jnp.zeros(3))


# the first two have a length of their own, 1e-12, that no displacement may exceed by much
@pytest.mark.parametrize("law", [gx.PowerLaw(1e48, -4.0, 1.0), gx.Toda(1.0, 1e12), gx.Linear(1.0)])
def test_a_modulation_is_seen_at_rest_whatever_the_unit_of_length(law):
    wave = gx.Harmonic(0.1, 2 * np.pi, mean=1.0)
    chain = gx.Lattice(1.0, gx.Modulated(bond("fixed", law), wave), sites=3)
    for period in (1.0, 3.0):
        assert checked_symmetry(chain, Symmetry(), REST, 0.0, period) == Symmetry()
    with refused("period: expected one after which the forces repeat, got 1.37"):
        checked_symmetry(chain, Symmetry(), REST, 0.0, 1.37)


def test_a_guess_that_falls_to_rest_is_no_orbit():
    ask = RING, gx.State(1e-3 * np.sin(np.arange(6.0)), np.zeros(6)), 0.7
    with pytest.raises(RuntimeError, match="The guess fell to rest, where every time is a period"):
        orbit(*ask, symmetry=Translation(1))
    found = orbit(*ask, symmetry=Translation(1), throw=False)
    assert not found.converged and np.abs(found.state.u).max() < 1e-9


GRAINS = gx.scenes.monomer(4, precompression=1.0)
GRANULAR_RING = gx.scenes.monomer(3, precompression=1.0, boundary="periodic")
HARDENING = gx.scenes.fput(4, alpha=0.0, beta=1.0)


# Hertz softens and hardening springs do not, so that periods are longer or shorter than the mode's; a guess that is too
# small leads from either side to a state on the surface of equal energy across from its image
@pytest.mark.parametrize(
    "lattice, mode, size, share, returns",
    [
        (GRAINS, 0, 0.14, 0.97, False),
        (HARDENING, 0, 0.14, 1.03, False),
        (HARDENING, 0, 0.14, 0.97, False),
        (HARDENING, 0, 0.3, 0.97, True),
        (GRANULAR_RING, -1, 0.05, 1.01, False),
        (GRANULAR_RING, -1, 0.4, 1.01, True),
    ],
)
def test_a_state_whose_energy_alone_returns_is_no_orbit(lattice, mode, size, share, returns):
    modes = gx.linear.normal_modes(lattice)
    w = float(modes.omega[mode])
    shape = np.asarray(modes.modes[:, 0])
    guess = gx.State(*(size * np.outer([1, w], shape / np.abs(shape).max())))
    symmetry = Symmetry()
    if lattice is GRANULAR_RING:
        phase = 2 * np.pi * np.arange(3) / 3
        guess = gx.State(size * np.cos(phase), size * w * np.sin(phase))
        symmetry = Translation(1)
    period = share * 2 * np.pi / w / (3 if lattice is GRANULAR_RING else 1)
    ask = lambda **how: orbit(lattice, guess, period, symmetry=symmetry, **how)
    found = ask(throw=False)
    end = gx.simulate(lattice, found.state, period, tolerance=1e-12, save_at=2).final
    gap = np.abs(end.u - symmetry(found.state.u)).max() / np.abs(found.state.u).max()
    assert (gap < 1e-8) == returns == bool(found.converged) == bool(found.residual < 1e-11)
    if not returns:
        assert gap > 4e-3 and np.isnan(found.error.energy)
        words = "after one period the energy is the same, but not the state"
        with pytest.raises(RuntimeError, match=words):
            ask()


def test_an_orbit_of_few_steps_is_one_and_its_error_covers_the_truth():
    """Two sites in phase are one Duffing oscillator, u'' = -u - u^3, of period 4K(m)/(1 + A^2)^{1/2}."""
    A = 1.3
    period = 4 * ellipk(A**2 / 2 / (1 + A**2)) / np.sqrt(1 + A**2)
    guess = gx.State(*np.outer([0.6, 0.9], [A, A]))
    # with 4 steps the energy itself does not return, by far more than rounding
    found = orbit(gx.scenes.fput(2, alpha=0.0, beta=1.0), guess, period, steps=4)
    away = abs(float(found.energy) - (A**2 + A**4 / 2))
    assert found.converged and 1e-3 < away < float(found.error.energy) < 4 * away


# Newton's method and its derivatives --------------------------------------------------------------------------------


def test_newton_over_half_a_period_is_quadratic_and_differentiable():
    make = lambda ratio: gx.scenes.dimer(N, ratio=ratio, precompression=1.0, boundary="free")
    dimer = make(0.5)
    half = Shooting.half(dimer, gx.Flow(40, gx.KahanLi8()))
    period = 2 * np.pi / (0.97 * float(gx.linear.normal_modes(dimer).omega[-1]))
    begin = half.guess(gx.breathers.breather(dimer, 2 * np.pi / period, check=False).state)

    def solve(x, lattice, most, tolerance=1e-14):
        how = dict(linearise=half.linearise, throw=False, max_steps=most, tolerance=tolerance)
        return newton(half.residual, x, (lattice, period), **how)

    exact = solve(begin, dimer, 20).x
    guess = begin + 0.02 * jnp.asarray(RNG.normal(size=N + 1))
    errors = [np.abs(solve(guess, dimer, k).x[:N] - exact[:N]).max() for k in range(1, 6)]
    assert errors[0] > 1e-2 and errors[-1] < 1e-11
    assert errors[2] < 3 * errors[1] ** 2 and errors[3] < 3 * errors[2] ** 2 + 1e-11

    # d u/d ratio by the implicit function theorem, within one compiled function
    u = jax.jit(lambda ratio: solve(begin, make(ratio), 20, 1e-13).x)
    slope = jax.jit(jax.jacfwd(u))(0.5)
    assert_allclose(slope, (u(0.5 + 1e-5) - u(0.5 - 1e-5)) / 2e-5, rtol=2e-8, atol=1e-9)
    assert np.abs(slope).max() > 0.5


def test_a_forced_orbit_has_derivatives_in_both_modes():
    bond = gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(1.0, 1.0))
    omega = 1.5
    drive = gx.Drive(gx.Harmonic(0.4, omega), 0)
    make = lambda rate: gx.Lattice(1.0, (bond, gx.Damping(rate), drive), sites=N)
    full = Shooting.of(make(0.3), gx.Flow(18))
    begin = full.guess(gx.State(jnp.zeros(N), jnp.zeros(N)), (make(0.3), 1.0))
    how = dict(linearise=full.linearise, tolerance=1e-13)
    u = jax.jit(lambda rate: newton(full.residual, begin, (make(rate), 2 * np.pi / omega), **how).x)
    slope = jax.jit(jax.jacfwd(u))(0.3)
    assert_allclose(slope, (u(0.3 + 1e-5) - u(0.3 - 1e-5)) / 2e-5, rtol=0, atol=1e-9)
    assert_allclose(slope, jax.jit(jax.jacrev(u))(0.3), rtol=0, atol=1e-12)
    assert np.abs(slope).max() > 0.05


# steps ------------------------------------------------------------------------------------------------------------


def test_default_steps_resolve_the_highest_frequency():
    """Of sites that oscillate alike, omega T = 20: 20/0.3 = 66.7 steps, in whole segments."""
    alone = lambda K: gx.Lattice(1.0, gx.OnSite(gx.Linear(K)), sites=3)
    assert default_steps(alone(4.0), 10.0) == 67
    assert default_steps(alone(4.0), 10.0, 7) == 70
    assert default_steps(alone(4.0), 10.0, fineness=0.12) == 167
    # never fewer than 16
    assert default_steps(alone(4.0), 0.1) == 16 and default_steps(alone(4.0), 0.1, 3) == 18
    traced = jax.jit(lambda K, T: default_steps(alone(K), T, 7))
    assert traced(4.0, 10.0) == 70 and traced(4.0, 0.1) == 21


def test_default_steps_of_a_sonic_vacuum_are_those_at_the_energy_of_a_guess():
    vacuum = gx.scenes.monomer(5)
    with refused("steps: expected steps per period, got None"):
        default_steps(vacuum, 10.0)
    assert default_steps(vacuum, 10.0, 3, doubled=True) == 18
    # frequencies grow with the fifth root of the speed
    slow, fast = (
        default_steps(vacuum, 100.0, guess=gx.states.impact(vacuum, v)) for v in (1.0, 32.0)
    )
    assert abs(fast - 2 * slow) <= 1
