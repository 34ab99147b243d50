import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import MASS_IN_MASS, ended
from refusals import refused

import granjax as gx
from granjax import driven
from granjax.orbits import attractors

RNG = np.random.default_rng(5)


def state(lattice, size=0.3, seed=1):
    rng = np.random.default_rng(seed)
    return gx.State(*(jnp.asarray(x) for x in rng.normal(0, size, (2, *lattice.shape))))


def rest(lattice):
    return gx.State(lattice.zeros(), lattice.zeros())


def duffing(force, omega, K2=1.0, K4=0.0, damping=0.02):
    """x'' + gamma x' + K2 x + K4 x^3 = f cos(omega t) on site 0, unforced on site 1."""
    law = gx.Polynomial(K2, 0.0, K4)
    terms = gx.OnSite(law), gx.Damping(damping), gx.Drive(gx.Harmonic(force, omega), 0)
    return gx.Lattice(jnp.ones(2), terms)


# --------------------------------------------------------------------------------------------------------- driven_chain


def test_moving_walls_are_the_ends_of_the_chain():
    N, F0 = 5, 0.6
    A, m = RNG.uniform(0.5, 2, N + 1), RNG.uniform(0.5, 1, N)
    chain = gx.scenes.monomer(N, mass=m, stiffness=A, precompression=F0)
    lattice = driven.driven_chain(chain, 0.2, 1.7, damping=0.3, phase=(0.4, 1.1))
    y, t = state(chain), 2.3
    u = np.concatenate([[0.2 * np.cos(1.7 * t + 0.4)], y.u, [0.2 * np.cos(1.7 * t + 1.1)]])
    d0 = (F0 / A) ** (2 / 3)
    F = A * np.maximum(d0 + u[:-1] - u[1:], 0) ** 1.5
    expected = (F[:-1] - F[1:]) / m - 0.3 * np.asarray(y.v)
    np.testing.assert_allclose(
        jax.jit(lambda c: c.acceleration(t, *y))(lattice), expected, rtol=0, atol=1e-14
    )


def test_an_end_that_is_not_driven_keeps_its_wall():
    chain = gx.scenes.beads(["steel 316", "aluminium 6061-T6"], 9.53e-3, 20.0, cells=3)
    lattice = driven.driven_chain(chain, 0.0, 1.0, ends="right")
    y = state(chain, 1e-7)
    assert lattice.terms[1].motion is None and lattice.terms[1].side == "left"
    totals = jax.jit(lambda a, b: [(c.energy(0.0, *y), c.force(0.0, *y)) for c in (a, b)])
    (energy, force), (expected, pull) = totals(lattice, chain)
    np.testing.assert_allclose(force, pull, rtol=1e-12)
    assert float(energy) == pytest.approx(float(expected), rel=1e-13)


@pytest.mark.slow
def test_batches_take_moving_walls_and_amplitudes_have_derivatives():
    chain = lambda r: gx.scenes.dimer(4, r, precompression=1.0)
    lanes = driven.driven_chain(
        jax.vmap(chain, out_axes=-1)(jnp.array([0.4, 0.7])), 0.2, 2.0, damping=0.1
    )
    y = state(chain(0.7))

    @jax.jit
    def first(a):
        one = driven.driven_chain(chain(0.7), a, 2.0, damping=0.1)
        return one.acceleration(0.3, *y)

    many = gx.State(*(jnp.stack([x, x], -1) for x in y))
    np.testing.assert_allclose(
        jax.jit(lambda c: c.acceleration(0.3, *many))(lanes)[:, 1], first(0.2), rtol=1e-13
    )
    change = (first(0.2 + 1e-5) - first(0.2 - 1e-5)) / 2e-5
    np.testing.assert_allclose(jax.jacfwd(first)(0.2), change, rtol=0, atol=1e-9)


def test_walls_touch_the_beads_of_a_cell_and_not_what_is_in_them():
    lattice = driven.driven_chain(MASS_IN_MASS, 0.0, 1.0, field="bead")
    y = jax.tree.map(
        lambda shape: jnp.asarray(np.random.default_rng(2).normal(0, 0.1, shape.shape)),
        gx.State(lattice.template(), lattice.template()),
    )
    force, expected = jax.jit(lambda a, b: (a.force(0.2, *y), b.force(0.2, *y)))(
        lattice, MASS_IN_MASS
    )
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=0, atol=1e-15), force, expected)


@pytest.mark.parametrize(
    "chain, keywords, word",
    [
        (gx.scenes.monomer(4, boundary="free"), {}, "boundary='fixed'"),
        (
            gx.Lattice(
                np.ones(4), (gx.Bond(gx.Shift(1), gx.Hertz()), gx.Bond(gx.Shift(2), gx.Linear()))
            ),
            {},
            "terms\\[1\\]",
        ),
        (
            gx.Lattice(
                np.ones(4), (gx.Bond(gx.Shift(1), gx.Hertz()), gx.Dashpot(gx.Shift(1), 1.0))
            ),
            {},
            "Dashpot",
        ),
    ],
)
def test_what_cannot_be_driven_is_refused(chain, keywords, word):
    with refused(word):
        driven.driven_chain(chain, 0.1, 1.0, **keywords)


# --------------------------------------------------------------------------------------------------------------- settle


def test_a_linear_chain_settles_to_its_linear_response():
    N, omega, gamma, a = 6, 1.3, 0.2, 0.3
    chain = gx.Lattice(np.ones(N), gx.Bond(gx.Shift(1, "fixed"), gx.Linear(1.0)))
    found = driven.settle(
        driven.driven_chain(chain, a, omega, damping=gamma), rest(chain), 2 * np.pi / omega
    )
    K = 2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
    pull = np.zeros(N)
    pull[[0, -1]] = a
    u = np.linalg.solve(K - (omega**2 + 0j) * np.eye(N) + 1j * omega * gamma * np.eye(N), pull)
    assert found.multiple == 1 and found.change < 1e-8 and "every period" in found.outcome
    # 3.5e-10, at h omega_max = 0.4 and a tolerance of 1e-8; largest speeds by a parabola through 24 steps, 1.4e-4
    np.testing.assert_allclose(found.state.u, u.real, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.amplitude, omega * np.abs(u), rtol=2e-4)
    np.testing.assert_allclose(
        found.us, np.real(u * np.exp(1j * omega * found.ts)[:, None]), rtol=0, atol=1e-8
    )
    assert found.peak_force.shape == (N + 1,)


# x'' + 0.3 x' - x + x^3 = f cos 1.2 t: the textbook cascade (Jordan and Smith, Nonlinear Ordinary Differential
# Equations, 2007)
DOUBLE_WELL = dict(omega=1.2, K2=-1.0, K4=1.0, damping=0.3)
WELL = gx.State(jnp.array([1.0, 1.0]), jnp.zeros(2))


@pytest.mark.slow
@pytest.mark.parametrize(
    "force, multiple, word",
    [
        (0.20, 1, "every period"),
        (0.28, 2, "period-doubled"),
        (0.29, 4, "doubled twice"),
        (0.50, 0, "Not periodic"),
    ],
)
def test_period_doubling_is_told(force, multiple, word):
    lattice = duffing(jnp.asarray(force), **DOUBLE_WELL)
    found = driven.settle(lattice, WELL, 2 * np.pi / 1.2, steps=48, periods=1500)
    assert (found.multiple, found.settled) == (multiple, multiple > 0) and word in found.outcome
    assert len(found.ts) == 48 * (multiple or 16)


def multiplier(x, v, force, omega, K2, K4, damping):
    """The most negative multiplier of the T-periodic orbit of site 0, by SciPy: Newton's method, tangents by DOP853."""

    def field(t, y):
        x, v, *tangents = y
        pull = force * np.cos(omega * t) - damping * v - K2 * x - K4 * x**3
        a, b, c, d = tangents
        return [
            v,
            pull,
            c,
            d,
            *(-damping * w - (K2 + 3 * K4 * x**2) * q for q, w in ((a, c), (b, d))),
        ]

    y = np.array([x, v])
    for _ in range(8):
        end = ended(field, 2 * np.pi / omega, [*y, 1, 0, 0, 1])
        M = end[2:].reshape(2, 2)
        y = y - np.linalg.solve(M - np.eye(2), end[:2] - y)
    return np.linalg.eigvals(M).real.min(), y


# forces at which the orbit of one period is all but doubled
SLOW = [
    pytest.param(0.265575837, DOUBLE_WELL, id="-0.99985"),
    pytest.param(0.2655768, DOUBLE_WELL, id="-0.99986", marks=pytest.mark.study),
    pytest.param(0.26556, DOUBLE_WELL, id="-0.9995", marks=pytest.mark.study),
]


@pytest.mark.slow
@pytest.mark.parametrize(("force", "well"), SLOW)
def test_what_settles_slowly_is_not_called_chaotic_nor_doubled(force, well):
    rho, orbit = multiplier(0.7, 0.2, force, **well)
    assert -1 < rho < -0.9985
    lattice, T = duffing(jnp.asarray(force), **well), 2 * np.pi / well["omega"]
    # half-way between what one and what two periods change by falls below their bounds
    near = gx.State(jnp.array([orbit[0] + 6e-6, 1.0]), jnp.array([orbit[1], 0.0]))
    for start, periods in ((WELL, 400), (near, 300)):
        found = driven.settle(lattice, start, T, steps=48, periods=periods)
        assert (
            found.multiple == 0
            and "Undecided" in found.outcome
            and f"{rho:.5g}"[:7] in found.outcome
        )
    assert gx.chaos.lyapunov(lattice, WELL, T, steps=48, periods=200).verdict in (
        "periodic",
        "undecided",
    )


@pytest.mark.slow
@pytest.mark.parametrize("damping", [1e-4, 0.0])
def test_a_linear_chain_of_little_damping_settles_slowly_if_at_all(damping):
    N, T = 3, 2 * np.pi / 1.1
    lattice = driven.driven_chain(
        gx.Lattice(np.ones(N), gx.Bond(gx.Shift(1, "fixed"), gx.Linear(1.0))),
        0.1,
        1.1,
        damping=damping,
    )
    found = driven.settle(lattice, state(lattice), T, periods=200, steps=32)
    # of every multiplier, whatever the springs
    said = (
        f"a disturbance takes {2 / (damping * T):.2g} periods"
        if damping
        else "quasi-periodic or chaotic"
    )
    assert (
        found.multiple == 0
        and said in found.outcome
        and ("Undecided" in found.outcome) == (damping > 0)
    )


def test_a_budget_that_is_too_small_is_told():
    lattice = duffing(0.01, 1.0, damping=1e-3)
    found = driven.settle(
        lattice,
        gx.State(jnp.array([1.0, 0.0]), jnp.zeros(2)),
        2 * np.pi,
        periods=600,
        steps=24,
        tolerance=1e-12,
    )
    assert not found.settled and found.periods == 600 and "Still settling" in found.outcome


def test_an_unstable_orbit_is_left():
    # site 1 starts on the ridge between its two wells, where it would stay for ever
    lattice = duffing(jnp.asarray(0.2), **DOUBLE_WELL)
    start = gx.State(jnp.array([1.0, 0.0]), jnp.zeros(2))
    found = driven.settle(lattice, start, 2 * np.pi / 1.2, steps=48, periods=1500)
    assert found.multiple == 1 and abs(float(found.state.u[1])) == pytest.approx(1.0, abs=1e-7)


def test_a_sonic_vacuum_asks_for_steps():
    lattice = driven.driven_chain(gx.scenes.monomer(3), 0.1, 1.0, damping=0.1)
    with refused("sonic vacuum"):
        driven.settle(lattice, rest(lattice), 1.0)


@pytest.mark.study
def test_a_period_that_is_not_the_drive_s_is_refused():
    # in SI too, where the forces of a displacement of a metre drown those of the drive
    chain = gx.scenes.monomer(3, 28.2e-3, 1.0114e10, precompression=10.0)
    lattice, period = (
        driven.driven_chain(chain, 0.05e-6, 2 * np.pi * 6740.0, damping=200.0),
        1 / 6740.0,
    )
    far = gx.State(jnp.ones(3), jnp.zeros(3))
    for wrong in (
        1.37 * period,
        0.5 * period,
        period / (2 * np.pi),
        1e-3 * period,
        1.0001 * period,
        0.50001,
    ):
        for ask in (driven.settle, gx.chaos.lyapunov, gx.floquet.floquet):
            for start in (rest(lattice), far):
                with refused("period: expected one after which the forces repeat"):
                    ask(lattice, start, wrong)
        with refused("period: expected one after which the forces repeat"):
            gx.forced.forced_orbit(lattice, wrong, far)
    with refused("period: expected one after which"):
        driven.response(lambda a: driven.driven_chain(chain, a, 1e4), [1e-8, 2e-8], 1e-4)
    wave = gx.Modulated(
        gx.Bond(gx.Shift(1, "fixed"), gx.Linear(1.0)), gx.Harmonic(0.2, 2.0, mean=1.0)
    )
    with refused("period: expected one after which"):
        gx.floquet.floquet(gx.Lattice(np.ones(3), (wave,)), rest(lattice), 3.0)


def test_a_batch_is_not_taken_for_one_lattice():
    lanes = jax.vmap(lambda r: gx.scenes.dimer(4, r, precompression=1.0), out_axes=-1)(
        jnp.array([0.4, 0.7])
    )
    for ask in (driven.settle, gx.chaos.lyapunov):
        with refused("lattice: expected one Lattice, got a batch with lanes"):
            ask(lanes, rest(lanes), 1.0)


# ---------------------------------------------------------------------------------------------------------------- sweep


def folds(force, damping, K4):
    """Where the curve of one harmonic, [(1 + 3 K4 a^2/4 - w^2)^2 + g^2 w^2] a^2 = f^2, turns back: its right branch.

    Frequencies and, for two sites of which one moves, root mean square velocities.
    """
    a = np.linspace(0.05, force / damping, 400001)
    stiff = 1 + 0.75 * K4 * a**2
    middle = stiff - damping**2 / 2
    squared = middle**2 - stiff**2 + (force / a) ** 2
    real = squared > 0
    right = np.sqrt(middle[real] + np.sqrt(squared[real]))
    turns = np.flatnonzero(np.diff(np.sign(np.diff(right)))) + 1
    return right[turns], right[turns] * a[real][turns] / 2


@pytest.mark.slow
def test_jumps_and_hysteresis_of_a_duffing_oscillator():
    values = np.linspace(0.98, 1.06, 17)
    found = driven.response(
        lambda w: duffing(0.01, w, K4=0.4), values, lambda w: 2 * jnp.pi / w, accuracy=1e-4
    )
    (up,), (down,) = found.up.jumps, found.down.jumps
    (lower, upper), speeds = folds(0.01, 0.02, 0.4)
    # 1.02601 and 1.03516 with one harmonic; found 1.02602 and 1.03524
    assert (
        isinstance(up, driven.Jump)
        and up.value == pytest.approx(upper, rel=1e-4)
        and up.before > 3 * up.after
    )
    assert down.value == pytest.approx(lower, rel=1e-5) and down.before < down.after / 1.6
    np.testing.assert_allclose([down.before, up.before], speeds, rtol=3e-2)
    assert found.hysteresis == [(down.value, up.value)]
    assert (found.up.multiple == 1).all() and found.up.velocity.shape == (17, 2)
    outside = (values < down.value) | (values > up.value)
    np.testing.assert_allclose(found.up.response[outside], found.down.response[outside], rtol=1e-4)


@pytest.mark.study
def test_a_period_doubling_is_located_from_either_side():
    make = lambda force: duffing(force, **DOUBLE_WELL)
    found = driven.response(
        make, [0.24, 0.27, 0.282], lambda force: 2 * jnp.pi / 1.2, state=WELL, steps=48
    )
    (up,), (down,) = found.up.bifurcations, found.down.bifurcations
    assert (up.before, up.behind) == (1, 2) and (down.before, down.behind) == (2, 1)
    # Newton's method puts a multiplier at -1 at 0.2655818; found within the accuracy, 1e-3
    assert up.p == pytest.approx(0.2655818, rel=1e-3) and down.p == pytest.approx(
        0.2655818, rel=1e-3
    )
    assert found.up.jumps == found.down.jumps == () and found.hysteresis == []
    data = found.to_xarray()
    assert data.up_bifurcations_p.values.tolist() == [
        up.p
    ] and data.down_bifurcations_kind.values.tolist() == [up.kind]
    assert data.up_jumps_value.shape == (
        0,
    ) and data.up_response.dims == data.down_response.dims == ("value",)
    alone = driven.ResponseCurve(found.values, found.up, None, [])
    assert "down" not in repr(alone).lower() and "down_response" not in alone.to_xarray()


@pytest.mark.slow
@pytest.mark.parametrize("values, damping", [([0.95, 1.01], 0.01), ([0.9, 0.97, 0.998], 0.004)])
def test_neither_a_steep_flank_nor_slow_settling_is_a_jump(values, damping):
    # an oscillator without nonlinearity has one attractor, which moves steadily; the budget is too small for the second
    found = driven.response(
        lambda w: duffing(0.01, w, damping=damping),
        values,
        lambda w: 2 * jnp.pi / w,
        accuracy=1e-2,
        periods=800,
    )
    for way in (found.up, found.down):
        assert way.jumps == way.bifurcations == () and (way.multiple == 1).all()
    w = np.asarray(values)
    speed = (
        0.01 * w / np.hypot(1 - w**2, damping * w) / 2
    )  # of two sites one moves; mean square of a cosine
    for way in (found.up, found.down):
        np.testing.assert_allclose(way.response, speed, rtol=2e-4)
        assert np.all(np.abs(way.response - speed) <= way.response_error) and np.all(
            way.response_error < 0.02 * speed
        )


@pytest.mark.study
def test_what_has_settled_states_its_error_where_contacts_open():
    chain = gx.scenes.monomer(4, precompression=0.05**1.5)
    lattice = driven.driven_chain(chain, 0.065, 1.2, damping=0.15)
    settled = lambda steps, **options: driven.settle(
        lattice, rest(lattice), 2 * np.pi / 1.2, steps=steps, **options
    )
    found, true = settled(24), settled(512, tolerance=1e-11)
    assert found.settled and true.settled
    for name in ("amplitude", "peak_force", "energy"):
        off = np.abs(getattr(found, name) - getattr(true, name))
        assert np.all(off <= getattr(found, f"{name}_error")), name
    assert (
        np.all(np.abs(found.state.u - true.state.u) <= found.state_error.u)
        and found.state_error.u.max() < 1e-5
    )
    assert (
        found.energy_error < 1e-6 < found.energy
        and found.amplitude_error.max() < 1e-3 * found.amplitude.max()
    )
    assert np.isnan(settled(24, periods=8).energy_error)


@pytest.mark.slow
def test_the_double_well_is_chaotic_where_it_does_not_repeat():
    """0.104 +- 0.004; over 1000 periods 0.097 ... 0.114, by what is rounded."""
    found = gx.chaos.lyapunov(
        duffing(0.5, **DOUBLE_WELL), WELL, 2 * np.pi / 1.2, steps=48, number=4, periods=16_000
    )
    assert found.chaotic and abs(found.exponents[0] - 0.104) < 3 * found.uncertainty[0] < 0.02
    assert found.exponents.sum() == pytest.approx(-0.6, abs=1e-12)


@pytest.mark.slow
def test_the_top_of_samples_is_traced_and_differentiated():
    """Of a + b cos(t - c) it is a + b."""
    ts = 2 * np.pi * np.arange(64) / 64
    wave = lambda x: x[0] + x[1] * jnp.cos(ts[:, None] - x[2] * jnp.array([0.3, 1.7]))
    x = jnp.array([0.2, 1.5, 1.0])
    own = attractors.largest(np.asarray(wave(x)))
    assert isinstance(own, np.ndarray)
    np.testing.assert_allclose(own, x[0] + x[1], rtol=1e-5)
    np.testing.assert_allclose(jax.jit(attractors.largest)(wave(x)), own, rtol=1e-15)
    slope = jax.jacrev(lambda x: attractors.largest(wave(x)))(x)
    np.testing.assert_allclose(slope, [[1, 1, 0]] * 2, atol=5e-4)
