"""Driven chains: moving walls, what a run settles to, how slowly, and the jumps of response curves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import MASS_IN_MASS
from known_orbits import duffing, period_of, shooting
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax.driven import Jump, ResponseCurve, driven_chain, response, settle

RNG = np.random.default_rng(5)


def moving(lattice, size=0.3):
    """A state of random displacements and velocities."""
    rng = np.random.default_rng(1)
    rest = gx.State(lattice.template(), lattice.template())
    return jax.tree.map(lambda x: jnp.asarray(rng.normal(0, size, x.shape)), rest)


def spring(damping=0.02):
    """An oscillator, with or without nonlinearity, driven by a hundredth, over its frequency."""
    return lambda omega, K4=0.0: duffing(0.01, omega, 1.0, K4, damping)


# moving walls ---------------------------------------------------------------------------------------------------------


def test_moving_walls_are_the_ends_of_the_chain():
    N = 5
    F0 = 0.6
    A = RNG.uniform(0.5, 2, N + 1)
    m = RNG.uniform(0.5, 1, N)
    chain = gx.scenes.monomer(N, mass=m, stiffness=A, precompression=F0)
    lattice = driven_chain(chain, 0.2, 1.7, damping=0.3, phase=(0.4, 1.1))
    y = moving(chain)
    t = 2.3
    u = np.concatenate([[0.2 * np.cos(1.7 * t + 0.4)], y.u, [0.2 * np.cos(1.7 * t + 1.1)]])
    F = A * np.maximum((F0 / A) ** (2 / 3) + u[:-1] - u[1:], 0) ** 1.5
    expected = (F[:-1] - F[1:]) / m - 0.3 * np.asarray(y.v)
    assert_allclose(lattice.acceleration(t, *y), expected, rtol=0, atol=1e-14)


# of a cell the walls touch the beads, and not what is in them
@pytest.mark.parametrize(
    "chain, keywords, size",
    [
        (
            gx.scenes.beads(["steel 316", "aluminium 6061-T6"], 9.53e-3, 20.0, cells=3),
            dict(ends="right"),
            1e-7,
        ),
        (MASS_IN_MASS, dict(field="bead"), 0.1),
    ],
    ids=["one end in SI", "resonators"],
)
def test_walls_that_do_not_move_leave_the_chain_as_it_was(chain, keywords, size):
    lattice = driven_chain(chain, 0.0, 1.0, **keywords)
    y = moving(chain, size)
    if "ends" in keywords:
        assert lattice.terms[1].motion is None and lattice.terms[1].side == "left"
    force, pull = (jax.tree.leaves(c.force(0.2, *y)) for c in (lattice, chain))
    for own, expected in zip(force, pull):
        assert_allclose(own, expected, rtol=1e-12, atol=1e-15 * (size == 0.1))
    energy, expected = (float(c.energy(0.2, *y)) for c in (lattice, chain))
    assert energy == pytest.approx(expected, rel=1e-13)


@pytest.mark.slow
def test_batches_take_moving_walls_and_amplitudes_have_derivatives():
    chain = lambda r: gx.scenes.dimer(4, r, precompression=1.0)
    batch = jax.vmap(chain, out_axes=-1)(jnp.array([0.4, 0.7]))
    lanes = driven_chain(batch, 0.2, 2.0, damping=0.1)
    y = moving(chain(0.7))

    @jax.jit
    def first(a):
        return driven_chain(chain(0.7), a, 2.0, damping=0.1).acceleration(0.3, *y)

    many = gx.State(*(jnp.stack([x, x], -1) for x in y))
    assert_allclose(lanes.acceleration(0.3, *many)[:, 1], first(0.2), rtol=1e-13)
    change = (first(0.2 + 1e-5) - first(0.2 - 1e-5)) / 2e-5
    assert_allclose(jax.jacfwd(first)(0.2), change, rtol=0, atol=1e-9)


HERTZ = gx.Bond(gx.Shift(1), gx.Hertz())
LANES = jax.vmap(lambda r: gx.scenes.dimer(4, r, precompression=1.0), out_axes=-1)(
    jnp.array([0.4, 0.7])
)
STILL = gx.State(LANES.zeros(), LANES.zeros())
VACUUM = driven_chain(gx.scenes.monomer(3), 0.1, 1.0, damping=0.1)
# in SI too, where the forces of a displacement of a metre drown those of the drive
STEEL = gx.scenes.monomer(3, 28.2e-3, 1.0114e10, precompression=10.0)
DRIVEN = driven_chain(STEEL, 0.05e-6, 2 * np.pi * 6740.0, damping=200.0)
FAR = gx.State(jnp.ones(3), jnp.zeros(3))
REFUSED = [
    ("boundary='fixed'", lambda: driven_chain(gx.scenes.monomer(4, boundary="free"), 0.1, 1.0)),
    (
        "terms\\[1\\]",
        lambda: driven_chain(
            gx.Lattice(np.ones(4), (HERTZ, gx.Bond(gx.Shift(2), gx.Linear()))), 0.1, 1.0
        ),
    ),
    (
        "Dashpot",
        lambda: driven_chain(
            gx.Lattice(np.ones(4), (HERTZ, gx.Dashpot(gx.Shift(1), 1.0))), 0.1, 1.0
        ),
    ),
    ("sonic vacuum", lambda: settle(VACUUM, gx.states.rest(VACUUM), 1.0)),
    ("one Lattice, got a batch", lambda: settle(LANES, STILL, 1.0)),
    ("one Lattice, got a batch", lambda: gx.chaos.lyapunov(LANES, STILL, 1.0)),
    (
        "one Lattice, got a batch",
        lambda: gx.forced.forced_branch(lambda p: LANES, 0.0, 1.0, period=1.0),
    ),
    (
        "known numbers",
        lambda: jax.jit(lambda m: gx.breathers.family(gx.scenes.toda(3, mass=m)).p)(1.0),
    ),
    (
        "known numbers",
        lambda: jax.jit(lambda m: settle(gx.scenes.toda(3, mass=m), STILL, 1.0).state)(1.0),
    ),
    (
        "known numbers",
        lambda: jax.jit(lambda m: response(lambda _: gx.scenes.toda(3, mass=m), [0, 1], 1.0))(1.0),
    ),
    ("forces repeat", lambda: settle(DRIVEN, FAR, 1.0001 / 6740.0)),
    ("forces repeat", lambda: gx.chaos.lyapunov(DRIVEN, FAR, 0.5 / 6740.0)),
    (
        "forces repeat",
        lambda: response(lambda a: driven_chain(STEEL, a, 1e4), [1e-8, 2e-8], 1e-4),
    ),
]


@pytest.mark.parametrize("words, ask", REFUSED)
def test_what_cannot_be_driven_or_settle_is_refused(words, ask):
    with refused(words):
        ask()


# runs that settle -----------------------------------------------------------------------------------------------------


def springs(N, amplitude, omega, damping):
    chain = gx.Lattice(np.ones(N), gx.Bond(gx.Shift(1, "fixed"), gx.Linear(1.0)))
    return driven_chain(chain, amplitude, omega, damping=damping)


def test_a_linear_chain_settles_to_its_linear_response():
    N = 6
    omega = 1.3
    gamma = 0.2
    a = 0.3
    lattice = springs(N, a, omega, gamma)
    found = settle(lattice, gx.states.rest(lattice), 2 * np.pi / omega)
    K = 2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
    pull = np.zeros(N)
    pull[[0, -1]] = a
    u = np.linalg.solve(K + (1j * omega * gamma - omega**2) * np.eye(N), pull)
    assert found.multiple == 1 and found.change < 1e-8 and "every period" in found.outcome
    # 3.5e-10, at h omega_max = 0.4 and a tolerance of 1e-8; largest speeds by a parabola through 24 steps, 1.4e-4
    assert_allclose(found.state.u, u.real, rtol=0, atol=1e-8)
    assert_allclose(found.amplitude, omega * np.abs(u), rtol=2e-4)
    wave = np.real(u * np.exp(1j * omega * found.ts)[:, None])
    assert_allclose(found.us, wave, rtol=0, atol=1e-8)
    assert found.peak_force.shape == (N + 1,)


def test_an_error_is_not_absurd_where_the_modes_beat():
    # the ratio of the largest changes over 8 periods and the 8 before is above 1
    omega = 1.5589385644803304
    gamma = 0.011680119498728615
    lattice = springs(2, 0.01, omega, gamma)
    found = settle(lattice, gx.states.rest(lattice), 2 * np.pi / omega, steps=64)
    # both walls drive the mode of frequency 1 alone
    u = np.real(0.01 / (1 - omega**2 + 1j * omega * gamma))
    assert np.all(np.abs(found.state.u - u) <= found.state_error.u)
    # the tolerance over gamma T/2 is what may be left
    left = 1e-8 * np.abs(u) / (gamma * np.pi / omega)
    assert found.state_error.u.max() < 20 * left and found.energy_error < 1e-5 * found.energy


@pytest.mark.slow
def test_a_decay_to_rest_is_told_and_is_no_hysteresis():
    lattice = springs(2, 0.0, 1.0, 0.2)
    settled = lambda periods: settle(lattice, moving(lattice), 2 * np.pi, steps=32, periods=periods)
    found = settled(400)
    assert found.multiple == 1 and "decays to rest" in found.outcome and found.periods < 200
    for size, error in [*zip(found.state, found.state_error), (found.energy, found.energy_error)]:
        assert np.all(np.abs(size) <= error) and np.all(error < 1e-20)
    assert not settled(40).settled and "decays to rest" in settled(40).outcome
    make = lambda a: springs(2, a, 0.5, 0.5)
    curve = response(make, [0.0, 0.01, 0.02], 4 * np.pi, steps=32)
    assert curve.hysteresis == [] and 0 == curve.up.response[0] < curve.down.response[0] < 1e-20


WELL = gx.State(jnp.array([1.0, 1.0]), jnp.zeros(2))
T = 2 * np.pi / 1.2


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
def test_period_doubling_is_told_and_an_unstable_orbit_left(force, multiple, word):
    # at 0.2 site 1 starts on the ridge between its two wells, where it would stay for ever
    start = gx.State(jnp.array([1.0, 0.0]), jnp.zeros(2)) if multiple == 1 else WELL
    found = settle(duffing(jnp.asarray(force)), start, T, steps=48, periods=1500)
    assert (found.multiple, found.settled) == (multiple, multiple > 0) and word in found.outcome
    assert len(found.ts) == 48 * (multiple or 16)
    assert multiple != 1 or abs(float(found.state.u[1])) == pytest.approx(1.0, abs=1e-7)


@pytest.mark.slow
def test_what_settles_slowly_is_not_called_chaotic_nor_doubled():
    # the orbit of one period is all but doubled
    force = 0.265575837
    orbit, multipliers = shooting([0.7, 0.2], 1, force)
    rho = multipliers.real.min()
    assert -1 < rho < -0.9985
    lattice = duffing(jnp.asarray(force))
    # half-way between what one and what two periods change by falls below their bounds
    near = gx.State(jnp.array([orbit[0] + 6e-6, 1.0]), jnp.array([orbit[1], 0.0]))
    for start, periods in ((WELL, 400), (near, 300)):
        found = settle(lattice, start, T, steps=48, periods=periods)
        assert found.multiple == 0 and "Undecided" in found.outcome
        assert f"{rho:.5g}"[:7] in found.outcome
    chaos = gx.chaos.lyapunov(lattice, WELL, T, steps=48, periods=200)
    assert chaos.verdict in ("periodic", "undecided")


@pytest.mark.slow
@pytest.mark.parametrize("damping", [1e-4, 0.0])
def test_a_linear_chain_of_little_damping_settles_slowly_if_at_all(damping):
    lattice = springs(3, 0.1, 1.1, damping)
    period = 2 * np.pi / 1.1
    found = settle(lattice, moving(lattice), period, periods=200, steps=32)
    # of every multiplier, whatever the springs
    takes = f"a disturbance takes {2 / (damping * period):.2g} periods" if damping else ""
    assert found.multiple == 0 and (takes or "quasi-periodic or chaotic") in found.outcome
    assert ("Undecided" in found.outcome) == (damping > 0)


def test_a_budget_that_is_too_small_is_told():
    start = gx.State(jnp.array([1.0, 0.0]), jnp.zeros(2))
    how = dict(periods=600, steps=24, tolerance=1e-12)
    found = settle(spring(1e-3)(1.0), start, 2 * np.pi, **how)
    assert not found.settled and found.periods == 600 and "Still settling" in found.outcome


@pytest.mark.slow
def test_what_has_settled_states_its_error_where_contacts_open():
    chain = gx.scenes.monomer(4, precompression=0.05**1.5)
    lattice = driven_chain(chain, 0.065, 1.2, damping=0.15)
    settled = lambda steps, **how: settle(lattice, gx.states.rest(lattice), T, steps=steps, **how)
    found = settled(24)
    true = settled(512, tolerance=1e-11)
    assert found.settled and true.settled
    for name in ("amplitude", "peak_force", "energy"):
        off = np.abs(getattr(found, name) - getattr(true, name))
        assert np.all(off <= getattr(found, f"{name}_error")), name
    assert np.all(np.abs(found.state.u - true.state.u) <= found.state_error.u)
    assert found.state_error.u.max() < 1e-5 and found.energy_error < 1e-6 < found.energy
    assert found.amplitude_error.max() < 1e-3 * found.amplitude.max()
    assert np.isnan(settled(24, periods=8).energy_error)


# response curves ------------------------------------------------------------------------------------------------------


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
    found = response(lambda w: spring()(w, 0.4), values, period_of, accuracy=1e-4)
    (up,) = found.up.jumps
    (down,) = found.down.jumps
    (lower, upper), speeds = folds(0.01, 0.02, 0.4)
    # 1.02601 and 1.03516 with one harmonic; found 1.02602 and 1.03524
    assert isinstance(up, Jump) and up.value == pytest.approx(upper, rel=1e-4)
    assert down.value == pytest.approx(lower, rel=1e-5)
    assert up.before > 3 * up.after and down.before < down.after / 1.6
    assert_allclose([down.before, up.before], speeds, rtol=3e-2)
    assert found.hysteresis == [(down.value, up.value)]
    assert (found.up.multiple == 1).all() and found.up.velocity.shape == (17, 2)
    outside = (values < down.value) | (values > up.value)
    assert_allclose(found.up.response[outside], found.down.response[outside], rtol=1e-4)


# in the second most of the change from 1.2 down is not the jump
@pytest.mark.slow
@pytest.mark.parametrize(
    "end, K4, differ", [(1.05, 0.4, "1.02602 ... 1.03524"), (1.2, 0.2, "1.01897 ... 1.01947")]
)
def test_a_hysteresis_between_two_values_is_told(end, K4, differ):
    found = response(lambda w: spring()(w, K4), [1.0, end], period_of, accuracy=1e-4)
    (up,) = found.up.jumps
    (down,) = found.down.jumps
    (lower, upper), _ = folds(0.01, 0.02, K4)
    assert_allclose(found.up.response, found.down.response, rtol=1e-4)
    assert_allclose([down.value, up.value], [lower, upper], rtol=1e-4)
    assert found.hysteresis == [(down.value, up.value)]
    assert found.outcome.endswith(f"They differ {differ}.")


@pytest.mark.slow
def test_values_far_apart_still_find_the_jumps_at_the_folds():
    # from 1.3 the first run at 1.5 falls off the upper branch, which goes on to the fold
    def make(omega):
        site = gx.OnSite(gx.Polynomial(1.0, 0.0, 1.0))
        bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(0.05))
        drive = gx.Drive(gx.Harmonic(0.2, omega), 0)
        return gx.Lattice(jnp.ones(2), (site, bond, gx.Damping(0.1), drive), sites=2)

    found = response(make, np.linspace(0.9, 1.9, 6), period_of)
    upper, lower = gx.forced.forced_branch(make, 0.9, 1.9, period=period_of).folds
    assert [upper, lower] == pytest.approx([1.53254118, 1.27304037], abs=1e-8)
    (up,) = found.up.jumps
    (down,) = found.down.jumps
    assert [up.value, down.value] == pytest.approx([upper, lower], rel=1e-3)
    assert found.hysteresis == [(down.value, up.value)]
    # the sweep up stays above at 1.5
    assert up.before > found.up.response[3] > 7 * found.down.response[3]


@pytest.mark.slow
def test_a_period_doubling_is_located_from_either_side():
    forces = [0.24, 0.27, 0.282]
    period = lambda force: 2 * jnp.pi / 1.2
    found = response(duffing, forces, period, state=WELL, steps=48)
    (up,) = found.up.bifurcations
    (down,) = found.down.bifurcations
    assert (up.before, up.behind) == (1, 2) and (down.before, down.behind) == (2, 1)
    # Newton's method puts a multiplier at -1 at 0.2655818; found within the accuracy, 1e-3
    assert [up.p, down.p] == pytest.approx([0.2655818] * 2, rel=1e-3)
    assert found.up.jumps == found.down.jumps == () and found.hysteresis == []
    data = found.to_xarray()
    assert data.up_bifurcations_p.values.tolist() == [up.p]
    assert data.down_bifurcations_kind.values.tolist() == [up.kind]
    assert data.up_jumps_value.shape == (0,)
    assert data.up_response.dims == data.down_response.dims == ("value",)
    alone = ResponseCurve(found.values, found.up, None, [])
    assert "down" not in repr(alone).lower() and "down_response" not in alone.to_xarray()


@pytest.mark.slow
@pytest.mark.parametrize("values, damping", [([0.95, 1.01], 0.01), ([0.9, 0.97, 0.998], 0.004)])
def test_neither_a_steep_flank_nor_slow_settling_is_a_jump(values, damping):
    # an oscillator without nonlinearity has one attractor, which moves steadily; the budget is too small for the second
    found = response(spring(damping), values, period_of, accuracy=1e-2, periods=800)
    w = np.asarray(values)
    # of two sites one moves; mean square of a cosine
    speed = 0.01 * w / np.hypot(1 - w**2, damping * w) / 2
    for way in (found.up, found.down):
        assert way.jumps == way.bifurcations == () and (way.multiple == 1).all()
        assert_allclose(way.response, speed, rtol=2e-4)
        assert np.all(np.abs(way.response - speed) <= way.response_error)
        assert np.all(way.response_error < 0.02 * speed)
