import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused
from scipy.special import ellipe, ellipj, ellipk

import granjax as gx
from granjax.continuation import continuation
from granjax.continuation.newton import newton
from granjax.orbits import Mirror, Shooting, Sign, Symmetry, Translation, orbit
from granjax.orbits.asked import checked_symmetry, shifts

N = 5
RNG = np.random.default_rng(4)


def flat(y):
    return jnp.concatenate([y[0], y[1]])


# free displacements -------------------------------------------------------------------------------------------------


def bond(boundary, law=gx.Hertz(1.0, 1.0)):
    return gx.Bond(gx.Shift(1, boundary), law)


MASS_IN_MASS = gx.Lattice(
    {"bead": 1.0, "resonator": 0.3},
    (
        gx.Bond(gx.Shift(1, "free", fields=("bead", "bead")), gx.Hertz(1.0, 1.0)),
        gx.Bond(gx.Shift(0, fields=("bead", "resonator")), gx.Linear(0.5)),
    ),
    sites=3,
)
FREE = {
    "free": (gx.Lattice(1.0, (bond("free"),), sites=4), 1),
    "ring": (gx.Lattice(1.0, (bond("periodic"),), sites=4), 1),
    "walls": (gx.Lattice(1.0, (bond("fixed"),), sites=4), 0),
    "one wall": (gx.Lattice(1.0, (bond("free"), gx.Wall(gx.Hertz(), "left")), sites=4), 0),
    "sites": (gx.Lattice(1.0, (bond("free"), gx.OnSite(gx.Sine(1.0))), sites=4), 0),
    "damped, driven": (
        gx.Lattice(
            1.0, (bond("free"), gx.Damping(0.1), gx.Drive(gx.Harmonic(0.1, 1.0), 0)), sites=4
        ),
        1,
    ),
    "modulated bond": (
        gx.Lattice(1.0, (gx.Modulated(bond("free"), gx.Harmonic(0.1, 1.0, mean=1.0)),), sites=4),
        1,
    ),
    "modulated site": (
        gx.Lattice(
            1.0,
            (
                bond("free"),
                gx.Modulated(gx.OnSite(gx.Linear(1.0)), gx.Harmonic(0.1, 1.0, mean=1.0)),
            ),
            sites=4,
        ),
        0,
    ),
    "dashpots": (gx.Lattice(1.0, (bond("free"), gx.Dashpot(gx.Shift(1, "free"), 0.1)), sites=4), 1),
    "dashpots to walls": (
        gx.Lattice(1.0, (bond("free"), gx.Dashpot(gx.Shift(1, "fixed"), 0.1)), sites=4),
        0,
    ),
    "resonators": (MASS_IN_MASS, 1),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", FREE)
def test_free_displacements_cost_no_force(case):
    lattice, count = FREE[case]
    moves = np.asarray(shifts(lattice))
    size = len(np.concatenate([np.ravel(x) for x in jax.tree.leaves(lattice.zeros())]))
    assert moves.shape == (size, count)
    if count:
        assert np.array_equal(moves[:, 0], np.ones(size))
        u = jax.tree.map(lambda x: x + 0.7, lattice.zeros())
        zero = lattice.zeros()
        at, moved = lattice.acceleration(0.3, zero, zero), lattice.acceleration(0.3, u, zero)
        assert (
            max(np.abs(a - b).max() for a, b in zip(jax.tree.leaves(at), jax.tree.leaves(moved)))
            < 1e-14
        )


def test_free_displacements_in_the_plane_and_of_a_traced_lattice():
    u = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.75**0.5]])
    pairs = gx.Pairs([0, 1, 2], [1, 2, 0], sites=3)
    lattice = gx.Lattice(
        1.0,
        (gx.Bond(gx.Stretch(pairs, u[[1, 2, 0]] - u[[0, 1, 2]]), gx.Linear(1.0)),),
        sites=3,
        dimension=2,
    )
    moves = np.asarray(shifts(lattice))
    assert np.array_equal(moves, np.tile(np.eye(2), (3, 1)))
    count = []
    jax.jit(
        lambda r: count.append(shifts(gx.scenes.dimer(4, ratio=r, boundary="free")).shape) or r
    )(0.5)
    assert count == [(4, 1)]


# half periods -------------------------------------------------------------------------------------------------------

DIMER = gx.scenes.dimer(N, ratio=0.5, precompression=1.0, boundary="free")
WALLS = gx.scenes.dimer(N, ratio=0.5, precompression=1.0, boundary="fixed")
STEPS = 20


def half_of(lattice, steps=STEPS):
    return Shooting.half(lattice, gx.Flow(steps, gx.KahanLi8()))


@pytest.fixture(scope="module")
def breather():
    """An orbit of the free dimer beside its highest mode: amplitude 0.59, with its frequency; all contacts closed."""
    half = half_of(DIMER)
    modes = gx.linear.normal_modes(DIMER)
    shape = np.asarray(modes.modes)[:, -1]
    tangent = np.concatenate([shape / np.abs(shape).max(), np.zeros(2)])
    curve = continuation(
        lambda x, p, a: half.residual(x, (a, 2 * jnp.pi / p)),
        np.zeros(N + 1),
        float(modes.omega[-1]),
        args=DIMER,
        direction=tangent,
        arclength=0.05,
        points=8,
        linearise=lambda x, p, a: half.linearise(x, (a, 2 * jnp.pi / p)),
        tolerance=1e-12,
    )
    assert np.abs(curve.x[-1]).max() > 0.5 and curve.p[-1] < 0.98 * modes.omega[-1]
    return half.state(jnp.asarray(curve.x[-1])), 2 * np.pi / curve.p[-1]


@pytest.mark.study
@pytest.mark.parametrize(
    "case",
    (
        "free",
        pytest.param("walls", marks=pytest.mark.slow),
        pytest.param("resonators", marks=pytest.mark.slow),
    ),
)
def test_the_half_periods_linearisation(case):
    lattice = {"free": DIMER, "walls": WALLS, "resonators": MASS_IN_MASS}[case]
    half = half_of(lattice, 6)
    x = jnp.asarray(RNG.normal(0, 0.1, half.size + half.moves.shape[1]))
    value, jacobian = half.linearise(x, (lattice, 2.0))
    np.testing.assert_allclose(value, half.residual(x, (lattice, 2.0)), rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        jacobian, jax.jacfwd(half.residual)(x, (lattice, 2.0)), rtol=0, atol=1e-13
    )


@pytest.mark.slow
def test_the_orbit_is_at_rest_twice_and_retraces_its_path(breather):
    state, period = breather
    assert gx.measures.overlap(DIMER, state).min() > 0.05
    run = gx.simulate(DIMER, state, period, solver=gx.SRKN14a(), step=period / 64, save_at=3)
    assert np.abs(run.vs[1]).max() < 1e-10 and np.abs(run.us[1] - run.us[0]).max() > 0.5
    assert np.abs(run.us[2] - run.us[0]).max() < 1e-10 and np.abs(run.vs[2]).max() < 1e-10
    assert abs(np.sum(DIMER.mass * state.u)) < 1e-13


def test_a_half_periods_unknowns_and_state(breather):
    state, _ = breather
    half = half_of(DIMER)
    x = half.guess(gx.State(state.u, state.u + 3))
    assert x.shape == (N + 1,) and x[-1] == 0
    again = half.state(x)
    assert np.array_equal(again.u, state.u) and not np.any(again.v)
    fields = half_of(MASS_IN_MASS).state(jnp.arange(7.0))
    assert {name: u.shape for name, u in fields.u.items()} == {"bead": (3,), "resonator": (3,)}
    assert np.array_equal(half_of(MASS_IN_MASS).guess(fields)[:6], np.arange(6.0))


@pytest.mark.slow
def test_newton_over_a_half_period_is_quadratic_and_differentiable(breather):
    state, period = breather
    half = half_of(DIMER)
    solve = lambda x, lattice, most, tolerance=1e-14: newton(
        half.residual,
        x,
        (lattice, period),
        linearise=half.linearise,
        throw=False,
        max_steps=most,
        tolerance=tolerance,
    )
    guess = half.guess(state) + 0.02 * jnp.asarray(RNG.normal(size=N + 1))
    errors = [np.abs(solve(guess, DIMER, k).x[:N] - state.u).max() for k in range(1, 6)]
    assert errors[0] > 1e-2 and errors[-1] < 1e-11
    assert errors[2] < 3 * errors[1] ** 2 and errors[3] < 3 * errors[2] ** 2 + 1e-11

    # d u/d ratio by the implicit function theorem, within one compiled function
    make = lambda ratio: gx.scenes.dimer(N, ratio=ratio, precompression=1.0, boundary="free")
    u = jax.jit(lambda ratio: solve(half.guess(state), make(ratio), 20, 1e-13).x)
    slope = jax.jit(jax.jacfwd(u))(0.5)
    np.testing.assert_allclose(slope, (u(0.5 + 1e-5) - u(0.5 - 1e-5)) / 2e-5, rtol=2e-8, atol=1e-9)
    assert np.abs(slope).max() > 0.5


# whole periods ------------------------------------------------------------------------------------------------------


@pytest.mark.study
@pytest.mark.parametrize("segments", (pytest.param(1, marks=pytest.mark.slow), 3))
def test_an_orbit_over_half_a_period_is_one_over_a_whole(breather, segments):
    state, period = breather
    scene = DIMER, period
    full = Shooting.of(
        DIMER, gx.Flow(42 // segments, gx.KahanLi8()), reference=state, segments=segments
    )
    exact = full.guess(state, scene)
    assert exact.shape == (segments * 2 * N + 2,)
    assert np.abs(full.residual(exact, scene)).max() < 1e-11
    value, jacobian = full.linearise(exact + 0.01, scene)
    np.testing.assert_allclose(value, full.residual(exact + 0.01, scene), rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        jacobian, jax.jacfwd(full.residual)(exact + 0.01, scene), rtol=0, atol=1e-13
    )
    assert np.linalg.cond(jacobian) < 100

    # quadratic convergence back, from a guess that is perturbed in every direction, also that of the symmetries
    guess = exact + 0.01 * RNG.normal(size=exact.shape)
    roots = [
        newton(
            full.residual,
            guess,
            scene,
            linearise=full.linearise,
            throw=False,
            max_steps=k,
            tolerance=1e-15,
        )
        for k in range(1, 6)
    ]
    errors = np.array([np.abs(r.x - exact).max() for r in roots])
    assert errors[0] > 1e-2 and errors[4] < 1e-11
    assert errors[2] < 3 * errors[1] ** 2 and errors[3] < 3 * errors[2] ** 2 + 1e-11
    assert np.abs(roots[-1].x[-2:]).max() < 1e-12  # the multipliers
    assert np.array_equal(full.state(roots[-1].x).u, roots[-1].x[:N])


@pytest.mark.slow
def test_the_reference_fixes_the_phase(breather):
    state, period = breather
    later = gx.Flow(16, gx.KahanLi8())(state, 0.0, period / 5, DIMER)
    full = Shooting.of(DIMER, gx.Flow(42, gx.KahanLi8()), reference=later)
    scene = DIMER, period
    # the guess: another phase of the orbit, displaced as a whole
    guess = gx.Flow(16, gx.KahanLi8())(state, 0.0, period / 5 + 0.03, DIMER)
    root = newton(
        full.residual, full.guess(gx.State(guess.u + 0.01, guess.v), scene), scene, tolerance=1e-13
    )
    np.testing.assert_allclose(flat(full.state(root.x)), flat(later), rtol=0, atol=1e-10)


@pytest.mark.slow
def test_between_walls_nothing_but_the_phase_is_free():
    half, modes = half_of(WALLS), gx.linear.normal_modes(WALLS)
    period = 2 * np.pi / (0.99 * float(modes.omega[-1]))
    shape = np.asarray(modes.modes)[:, -1]
    found = newton(
        half.residual, 0.45 * shape / np.abs(shape).max(), (WALLS, period), linearise=half.linearise
    )
    state = half.state(found.x)
    assert np.abs(state.u).max() > 0.2 and found.x.shape == (N,)
    full = Shooting.of(WALLS, gx.Flow(21, gx.KahanLi8()), reference=state, segments=2)
    guess = full.guess(gx.State(state.u * 1.02, state.v + 0.01), (WALLS, period))
    assert guess.shape == (4 * N + 1,)
    root = newton(full.residual, guess, (WALLS, period), linearise=full.linearise, tolerance=1e-13)
    np.testing.assert_allclose(full.state(root.x).u, state.u, rtol=0, atol=1e-9)


OMEGA = 1.5
FORCED = gx.Lattice(
    1.0,
    (
        gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(1.0, 1.0)),
        gx.Damping(0.3),
        gx.Drive(gx.Harmonic(0.4, OMEGA), 0),
    ),
    sites=N,
)


@pytest.mark.study
@pytest.mark.parametrize("segments, t0", (pytest.param(1, 0.0, marks=pytest.mark.slow), (3, 0.4)))
def test_a_forced_damped_orbit_is_where_a_long_run_settles(segments, t0):
    period, scene = 2 * np.pi / OMEGA, (FORCED, 2 * np.pi / OMEGA)
    full = Shooting.of(FORCED, gx.Flow(36 // segments), t0=t0, segments=segments)
    rest = gx.State(jnp.zeros(N), jnp.zeros(N))
    guess = full.guess(rest, scene)
    assert guess.shape == (2 * N * segments,)
    np.testing.assert_allclose(
        full.linearise(guess, scene)[1], jax.jacfwd(full.residual)(guess, scene), rtol=0, atol=1e-13
    )
    root = newton(full.residual, guess, scene, linearise=full.linearise, tolerance=1e-13)
    state = full.state(root.x)
    assert isinstance(state, gx.State) and np.abs(state.u).max() > 0.1
    # gamma t/2 = 34: the start is forgotten
    settled = gx.Flow(36 * 55)(rest, t0, t0 + 55 * period, FORCED)
    np.testing.assert_allclose(flat(state), flat(settled), rtol=0, atol=1e-12)


@pytest.mark.slow
def test_a_forced_orbits_derivative():
    full = Shooting.of(FORCED, gx.Flow(18))
    start = full.guess(gx.State(jnp.zeros(N), jnp.zeros(N)), (FORCED, 1.0))

    @jax.jit
    def orbit(rate):
        lattice = gx.Lattice(1.0, (FORCED.terms[0], gx.Damping(rate), FORCED.terms[2]), sites=N)
        return newton(
            full.residual,
            start,
            (lattice, 2 * np.pi / OMEGA),
            linearise=full.linearise,
            tolerance=1e-13,
        ).x

    slope = jax.jit(jax.jacfwd(orbit))(0.3)
    np.testing.assert_allclose(
        slope, (orbit(0.3 + 1e-5) - orbit(0.3 - 1e-5)) / 2e-5, rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(slope, jax.jit(jax.jacrev(orbit))(0.3), rtol=0, atol=1e-12)
    assert np.abs(slope).max() > 0.05


# orbits modulo a symmetry -------------------------------------------------------------------------------------------


def cnoidal(sites, m):
    """Toda's wave of one crest on a ring whose mean compression is zero, and the time in which it moves on by a site.

    With rate^-2 = 1/sn^2(2K/N) - 1 + E/K the wave exp(e) - 1 = rate^2 (dn^2(2K n/N - rate t) - E/K) solves Toda's
    equations; a uniform compression c more stretches time by exp(c/2). Source: Toda, Phys. Rep. 18, 1 (1975).
    """
    K, E = ellipk(m), ellipe(m)
    rate = (1 / ellipj(2 * K / sites, m)[0] ** 2 - 1 + E / K) ** -0.5
    sn, cn, dn, _ = ellipj(2 * K * np.arange(sites) / sites, m)
    force = rate**2 * (dn**2 - E / K)
    e, slope = np.log1p(force), 2 * m * rate**3 * sn * cn * dn / (1 + force)
    pace = np.exp(-e.mean() / 2)
    u, v = (-np.cumsum(x - x.mean()) for x in (e, slope * pace))
    return gx.State(np.roll(u - u.mean(), 1), np.roll(v - v.mean(), 1)), 2 * K / rate / sites / pace


RING = gx.scenes.toda(6, boundary="periodic")


@pytest.fixture(scope="module")
def rotating():
    """A rotating wave from a guess that is off by some per cent."""
    exact, period = cnoidal(6, 0.9)
    guess = gx.State(1.03 * exact.u, 0.99 * exact.v + 0.002 * RNG.normal(size=6))
    return exact, orbit(RING, guess, period, symmetry=Translation(1))


@pytest.mark.slow
def test_a_rotating_wave_of_a_toda_ring_is_the_cnoidal_one(rotating):
    exact, wave = rotating
    end = gx.Flow(64)(exact, 0.0, wave.period, RING)
    np.testing.assert_allclose(end.u, np.roll(exact.u, 1), rtol=0, atol=1e-14)
    assert wave.converged and float(wave.energy) == pytest.approx(
        float(RING.energy(0.0, *exact)), rel=1e-11
    )
    # the same wave, later or earlier by a while: a site ago it stood one site before
    with refused(r"orbit: expected one that returns itself after T, .* Translation\(1\)"):
        _ = wave.amplitude
    state, best = (
        wave.state,
        min(np.linspace(-0.1, 0.1, 41), key=lambda s: apart(exact, wave.state, s)),
    )
    assert apart(exact, state, best) < 0.02 and np.abs(state.u).max() > 0.25


def apart(exact, state, time):
    return float(jnp.abs(gx.Flow(4)(exact, 0.0, time, RING).u - state.u).max())


@pytest.mark.slow
def test_a_wave_modulo_a_shift_is_an_orbit_of_the_whole_ring(rotating):
    _, wave = rotating
    whole = orbit(RING, wave.state, 6 * wave.period, steps=42)
    assert whole.root.iterations == 1 and whole.residual < 1e-10
    turned, full = wave.floquet(), whole.floquet()
    assert turned.expected == full.expected == 4 and turned.verdict == full.verdict == "stable"
    power = turned.multipliers**6
    assert np.abs(power[:, None] - full.multipliers).min(1).max() < 1e-6


@pytest.mark.study
def test_a_travelling_wave_of_steel_beads():
    ring = gx.scenes.monomer(
        8, mass=28.2e-3, stiffness=9.76e9, precompression=20.0, boundary="periodic"
    )
    scaled = gx.scenes.scaled(ring).lattice
    k = 2 * np.pi / 8
    period = 0.985 * k / (6**0.5 * np.sin(k / 2))  # faster than the linear wave
    n = np.arange(8)
    guess = gx.State(0.6 * np.cos(k * n), 0.6 * k / period * np.sin(k * n))
    wave = orbit(scaled, guess, period, symmetry=Translation(1), segments=2)
    assert 0.5 < np.abs(wave.state.u).max() < 0.7
    whole = orbit(scaled, wave.state, 8 * period)
    np.testing.assert_allclose(whole.state.u, wave.state.u, rtol=0, atol=1e-8)
    # d energy/d T through the root, against a difference
    energy = jax.jit(
        lambda T: (
            orbit(
                scaled,
                wave.state,
                T,
                symmetry=Translation(1),
                steps=24,
                throw=False,
                tolerance=1e-13,
            ).energy
        )
    )
    slope = (energy(period + 1e-5) - energy(period - 1e-5)) / 2e-5
    assert float(jax.jacfwd(energy)(period)) == pytest.approx(float(slope), rel=1e-6)


@pytest.mark.study
def test_half_a_period_of_an_odd_lattice_is_an_orbit_modulo_its_sign():
    chain = gx.scenes.fput(5, alpha=0.0, beta=1.0)
    b = gx.breathers.breather(
        chain, 1.05 * float(gx.linear.normal_modes(chain).omega[-1]), check=False
    )
    half = orbit(chain, b.state, b.period / 2, symmetry=Sign())
    np.testing.assert_allclose(half.state.u, b.state.u, rtol=0, atol=1e-9)
    assert half.floquet().expected == 2
    # and of an odd number of sites its own mirror image, which is the same here
    mirrored = orbit(chain, b.state, b.period, symmetry=Mirror() @ Sign())
    np.testing.assert_allclose(mirrored.state.u, b.state.u, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_symmetries_compose_and_what_is_none_of_the_lattice_is_refused():
    u = jnp.arange(4.0)
    for a, b in ((Translation(1), Mirror()), (Mirror(), Translation(1)), (Sign(), Translation(-1))):
        assert np.array_equal((a @ b)(u), a(b(u)))
    chain = gx.scenes.toda(6, boundary="free")
    with refused("symmetry: expected a symmetry of the lattice"):
        orbit(chain, gx.State(np.sin(np.arange(6.0)), np.zeros(6)), 1.0, symmetry=Translation(1))
    with refused("symmetry: expected a symmetry"):
        orbit(RING, gx.State(np.sin(np.arange(6.0)), np.zeros(6)), 1.0, symmetry=Sign())
    # sin(t) turns its sign after half of its period, not after all of it
    sine = gx.Drive(gx.Harmonic(0.1, 1.0, phase=-np.pi / 2), 0)
    driven = gx.Lattice(1.0, (bond("fixed", gx.Linear(1.0)), sine), sites=3)
    rest = gx.State(jnp.zeros(3), jnp.zeros(3))
    assert checked_symmetry(driven, Sign(), rest, 0.0, np.pi) == Sign()
    for asked, period in ((Sign(), 2 * np.pi), (Sign(), np.nan), (Symmetry(), 6.0)):
        with refused("period: expected" if asked.trivial else "symmetry: expected"):
            checked_symmetry(driven, asked, rest, 0.0, period)


@pytest.mark.parametrize(
    "law", [gx.PowerLaw(1e48, -4.0, 1.0), gx.Toda(1.0, 1e12), gx.Linear(1.0)], ids=repr
)
def test_a_modulation_is_seen_at_rest_whatever_the_unit_of_length(law):
    # the first two have a length of their own, 1e-12, that no displacement may exceed by much
    chain = gx.Lattice(
        1.0, (gx.Modulated(bond("fixed", law), gx.Harmonic(0.1, 2 * np.pi, mean=1.0)),), sites=3
    )
    rest = gx.State(jnp.zeros(3), jnp.zeros(3))
    for period in (1.0, 3.0):
        assert checked_symmetry(chain, Symmetry(), rest, 0.0, period) == Symmetry()
    with refused("period: expected one after which the forces repeat, got 1.37"):
        checked_symmetry(chain, Symmetry(), rest, 0.0, 1.37)


def test_a_guess_that_falls_to_rest_is_no_orbit():
    guess = gx.State(1e-3 * np.sin(np.arange(6.0)), np.zeros(6))
    with pytest.raises(
        RuntimeError, match="The guess fell to rest, where every time is a period: Converged"
    ):
        orbit(RING, guess, 0.7, symmetry=Translation(1))
    found = orbit(RING, guess, 0.7, symmetry=Translation(1), throw=False)
    assert not found.converged and np.abs(found.state.u).max() < 1e-9
