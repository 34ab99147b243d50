"""Forces that jump in time: steps end at the breaks and see them from one side, so that methods keep their order."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused
from scipy.linalg import expm

import granjax as gx

slow = pytest.mark.slow

N = 4
T = 1.1
PUSH = 1.7
DUTY = 0.4 * T
FREE, RING, FIXED = (
    gx.Bond(gx.Shift(1, boundary), gx.Linear()) for boundary in ("free", "periodic", "fixed")
)
START = gx.State(jnp.asarray([0.3, -0.2, 0.1, 0.4]), jnp.asarray([0.0, 0.1, 0.0, -0.2]))


class Square(eqx.Module):
    """1 and 1.6 in turn."""

    period: jax.Array

    def __call__(self, t):
        return jnp.where(jnp.mod(t, self.period) < 0.4 * self.period, 1.0, 1.6)


def push(t):
    return jnp.where(t < PUSH, 0.0, 0.5)


def make(told=True, period=T):
    """Linear springs that jump with a period, a wall and a push that jump once."""
    period = jnp.asarray(period)
    stiff = gx.Breaks(jnp.stack([0 * period, 0.4 * period]), period=period)
    once = [PUSH] if told else None
    terms = (
        gx.Modulated(FREE, Square(period), stiff if told else None),
        gx.Wall(gx.Linear(0.7), "left", motion=push, breaks=once),
        gx.OnSite(gx.Linear(0.3)),
        gx.Drive(push, 2, breaks=once),
    )
    return gx.Lattice(1.0, terms, sites=N)


def matrix(factor, pushed):
    """y' = A y for y = (u, v, 1)."""
    d = np.eye(N - 1, N) - np.eye(N - 1, N, 1)
    K = factor * d.T @ d + 0.3 * np.eye(N)
    K[0, 0] += 0.7
    A = np.zeros((2 * N + 1, 2 * N + 1))
    A[:N, N : 2 * N], A[N : 2 * N, :N] = np.eye(N), -K
    A[N, -1], A[N + 2, -1] = 0.7 * pushed, pushed
    return A


def exact(t1, period=T):
    """The state at t1 by matrix exponentials, stretch by stretch."""
    cuts = sorted({0.0, PUSH, t1, *(k * period + x for k in range(9) for x in (0.0, 0.4 * period))})
    cuts = [t for t in cuts if t <= t1]
    y = np.concatenate([START.u, START.v, [1.0]])
    for a, b in zip(cuts, cuts[1:]):
        middle = (a + b) / 2
        y = expm((b - a) * matrix(float(Square(period)(middle)), float(push(middle)))) @ y
    return y[:-1]


def error(state, t1=4.0):
    return np.abs(np.concatenate(state) - exact(t1)).max()


def orders(errors):
    return np.log2(np.asarray(errors[:-1]) / errors[1:])


@slow
def test_a_splitting_method_keeps_its_order():
    """SRKN11b, order 6: errors 1e-4 of those without breaks and less."""
    run = lambda told, h: gx.simulate(make(told), START, 4.0, step=h, solver=gx.SRKN11b())
    without, found = (
        [error(run(told, h).final) for h in (0.22, 0.11, 0.055)] for told in (False, True)
    )
    assert orders(without).mean() < 2.2 and min(without) > 1e-4
    assert orders(found).mean() > 5 and found[0] < 1e-8


def test_a_flow_keeps_its_order_and_runs_back():
    flow = jax.jit(lambda n, y, a, b: gx.flow.Flow(n, gx.SRKN11b())(y, a, b, make()))
    ends = [flow(n, START, 0.0, 4.0) for n in (20, 40, 80)]
    assert orders([error(end) for end in ends]).min() > 5
    back = flow(40, ends[1], 4.0, 0.0)
    np.testing.assert_allclose(back.u, START.u, atol=1e-14)


def test_steps_that_fit_between_breaks_are_equal():
    # velocity Verlet with steps h from rest: u = cos(n phi), cos(phi) = 1 - h^2/2
    still = gx.Drive(lambda t: 0 * t, 0, breaks=[1.0])
    pair = gx.Lattice(1.0, (gx.OnSite(gx.Linear(1.0)), still), sites=2)
    end = gx.flow.Flow(6, gx.VelocityVerlet())(gx.State(jnp.ones(2), jnp.zeros(2)), 0.0, 3.0, pair)
    assert_allclose(end.u, np.cos(6 * np.arccos(1 - 0.5**2 / 2)), rtol=1e-13)


@slow
def test_adaptive_steps_land_on_breaks():
    how = dict(tolerance=1e-8, solver=gx.RKN86())
    run = gx.simulate(make(), START, 4.0, save_at="steps", **how)
    assert error(run.final) < 1e-7 and int(run.stats["rejected"]) < 6
    for t in (DUTY, T, T + DUTY, PUSH, 3 * T):
        assert np.abs(np.asarray(run.ts) - t).min() < 1e-12
    blind = gx.simulate(make(False), START, 4.0, **how)
    assert int(blind.stats["steps"]) > 5 * int(run.stats["steps"])


@slow
def test_frames_and_records_between_breaks():
    times = (0.7, 2.3, 4.0)
    record = {"way": gx.Integral(lambda t, y, lattice: y.v)}
    run = gx.simulate(make(), START, 4.0, step=0.11, save_at=times, record=record)
    for t, u, v in zip(times, run.us, run.vs):
        assert error((u, v), t) < 1e-7
    np.testing.assert_allclose(run.recorded["way"], run.final.u - START.u, atol=1e-9)


@slow
def test_the_derivative_with_respect_to_the_period():
    """The breaks move, and the steps with them."""

    def last(period):
        return gx.simulate(make(period=period), START, 4.0, step=0.1).final.u[2]

    h = 1e-4
    want = (exact(4.0, T + h)[2] - exact(4.0, T - h)[2]) / (2 * h)
    assert float(jax.jit(jax.jacfwd(last))(T)) == pytest.approx(want, abs=1e-6)


def test_a_recorded_function_of_time_is_seen_from_within_each_step():
    def power(t, y, lattice):
        return jnp.where(t < 1.0, y.v[0], 0.0)

    push = gx.Drive(lambda t: jnp.where(t < 1.0, 1.0, 0.0), site=0, breaks=1.0)
    chain = gx.Lattice(1.0, (FREE, push), sites=2)
    record = {"work": gx.Integral(power), "most": gx.Peak(power)}
    found = gx.simulate(chain, gx.states.rest(chain), 3.0, step=0.05, record=record).recorded
    # the displacement and the velocity of the pushed site at the end of the push
    turn = np.sqrt(2)
    assert_allclose(found["work"], 1 / 4 + (1 - np.cos(turn)) / 4, atol=1e-9)
    assert_allclose(found["most"], 1 / 2 + np.sin(turn) / (2 * turn), atol=1e-9)


@slow
def test_records_beside_breaks_keep_their_places_in_single_precision():
    wave = gx.Square(0.3, 2.0, mean=1.0)
    bond = gx.Modulated(gx.Bond(gx.Shift(1, "fixed"), gx.Linear()), wave)
    record = {"moved": gx.Integral(lambda t, y, lattice: y.v)}
    chain = gx.Lattice(1.0, bond, sites=6).astype("float32")
    start = gx.states.impact(chain, velocity=0.3)
    run = gx.simulate(chain, start, 305.0, t0=300.0, step=0.05, record=record)
    assert run.final.u.dtype == jnp.float32
    assert_allclose(run.recorded["moved"], run.final.u, rtol=0, atol=2e-7)


def pushed_until(end, **how):
    """The momentum of a free chain that a force 0.5 pushes until `end`: 0.5 end."""
    push = gx.Drive(lambda t: jnp.where(t < end, 0.5, 0.0), site=0, breaks=end)
    chain = gx.Lattice(1.0, (FREE, gx.Dashpot(gx.Shift(1, "free"), 0.2), push), sites=3)
    return gx.simulate(chain, gx.states.rest(chain), 3.0, **how).final.v.sum()


@slow
def test_the_derivative_with_respect_to_the_end_of_a_push():
    assert float(jax.jvp(pushed_until, (1.1,), (1.0,))[1]) == pytest.approx(0.5, abs=1e-12)


@slow
def test_adaptive_steps_follow_moving_breaks_in_both_modes():
    def end(share):
        wave = gx.Square(0.4, 2.0, mean=1.0, share=share)
        chain = gx.Lattice(1.0, gx.Modulated(FIXED, wave), sites=3)
        return gx.simulate(chain, gx.states.impact(chain), 7.0, tolerance=1e-10).final.u[0]

    def along(share):
        return jax.jvp(end, (share,), (1.0,))[1]

    h = 1e-4
    want = (end(0.3 + h) - end(0.3 - h)) / (2 * h)
    first, second = jax.jvp(along, (0.3,), (1.0,))
    assert_allclose([first, jax.grad(end)(0.3)], want, atol=1e-6)
    assert_allclose(second, (along(0.3 + h) - along(0.3 - h)) / (2 * h), atol=1e-4)
    assert float(jax.grad(pushed_until)(1.1)) == pytest.approx(0.5, abs=1e-12)


def test_multipliers_of_a_lattice_whose_stiffness_jumps():
    lattice = gx.Lattice(1.0, tuple(t for i, t in enumerate(make().terms) if i in (0, 2)), sites=N)
    found = gx.floquet.floquet(lattice, gx.states.rest(lattice), T)
    wall = np.zeros((2 * N, 2 * N))
    wall[N, 0] = 0.7
    one, two = (matrix(f, 0.0)[:-1, :-1] + wall for f in (1.0, 1.6))
    want = np.linalg.eigvals(expm((T - DUTY) * two) @ expm(DUTY * one))
    gap = np.abs(np.asarray(found.multipliers)[:, None] - want).min(1)
    assert gap.max() < 1e-9 and (gap <= np.asarray(found.error) + 1e-13).all()


@slow
def test_breaks_in_lanes():
    periods = jnp.asarray([T, 1.3])
    both = jax.vmap(lambda period: make(period=period), out_axes=-1)(periods)
    run = gx.simulate(both, jax.tree.map(lambda x: jnp.stack([x, x], -1), START), 4.0, step=0.11)
    for lane, period in enumerate((T, 1.3)):
        got = np.concatenate(run.final)[:, lane]
        assert np.abs(got - exact(4.0, period)).max() < 1e-7


def test_a_plain_function_declares_its_breaks():
    def push(t):
        return jnp.where(t < PUSH, 0.0, 0.5)

    push.breaks = [PUSH]
    chain = gx.Lattice(1.0, (FIXED, gx.Drive(push, 2)), sites=N, units="SI")
    told = gx.Lattice(1.0, (FIXED, gx.Drive(push, 2, breaks=[PUSH])), sites=N, units="SI")
    found, want = (gx.simulate(x, START, 2.5, step=0.1) for x in (chain, told))
    assert_array_equal(found.final.u, want.final.u)
    scaled, _ = gx.scenes.scaled(chain, units=gx.Units(mass=0.7, length=2.0, time=3.0))
    assert_allclose(scaled.breaks[0].times, [PUSH / 3], rtol=1e-15)


def test_what_no_break_can_be():
    for breaks, said in (([np.nan], "expected finite"), ("a", "expected real numbers")):
        with refused(f"breaks: {said}"):
            gx.Modulated(FREE, push, breaks=breaks)
    with refused("period: expected numbers above zero"):
        gx.Breaks([0.1], period=0.0)
    with refused("breaks, at which steps end"):
        gx.simulate(make(), START, 1.0, step=0.1, adjoint=gx.Reversible())


WIDTH = 1e-2
WHEN = 2.03


def pulse(t):
    """A push of area one, short against any step."""
    return jnp.exp(-(((t - WHEN) / WIDTH) ** 2)) / (WIDTH * jnp.sqrt(jnp.pi))


def swinging(t):
    return 0.3 * jnp.cos(1.7 * t)


def driven(f):
    return RING, gx.Drive(f, 1)


# (terms of a chain, the one that has a pulse shorter than a step)
PULSES = {
    "on a swing": (driven(lambda t: swinging(t) + pulse(t) / 50), "Drive"),
    "wall": ((FREE, gx.Wall(gx.Linear(), "left", motion=pulse)), "Wall"),
    "stiffness": (gx.Modulated(RING, lambda t: 1.0 + 0.02 * pulse(t)), "Modulated"),
    "a swing alone": (driven(swinging), None),
    "a long pulse": (driven(lambda t: jnp.exp(-((t - 2.0) ** 2))), None),
    "a jump": (driven(push), None),
}


@pytest.mark.parametrize("case", PULSES)
def test_a_pulse_between_the_ends_of_steps_is_named(case):
    terms, name = PULSES[case]
    run = gx.simulate(gx.Lattice(1.0, terms, sites=N), START, 4.0, step=0.2)
    assert ("has a pulse" in run.outcome) == (name is not None)
    assert (f"({name}) has a pulse that is shorter than the steps" in run.outcome) == bool(name)


# a chain between walls
K = 2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)


@slow
def test_records_of_a_run_that_may_have_missed_a_pulse_are_not_known_and_breaks_cure_it():
    """Against the response to a blow, a matrix exponential."""
    record = {"peak": gx.Peak(lambda t, y, lattice: y.u[2])}

    def run(breaks, **how):
        chain = gx.Lattice(1.0, (FIXED, gx.Drive(pulse, 1, breaks=breaks)), sites=N)
        return gx.simulate(chain, gx.states.rest(chain), 8.0, record=record, confirm=True, **how)

    A = np.kron([[0, 1], [0, 0]], np.eye(N)) - np.kron([[0, 0], [1, 0]], K)
    blow = np.eye(2 * N)[N + 1]
    want = expm((8.0 - WHEN) * A) @ blow
    highest = max((expm(s * A) @ blow)[2] for s in np.linspace(0, 8.0 - WHEN, 2001))
    gap = lambda run: np.abs(np.concatenate(run.final) - want).max()
    for how in ({"step": 0.1}, {"tolerance": 1e-9}):
        told = run(WHEN + WIDTH * np.linspace(-5, 5, 9), **how)
        error = told.error.records["peak"]
        # the blow has a width: second order in it
        assert abs(told.recorded["peak"] - highest) <= error + WIDTH**2 and np.isfinite(error)
        assert "has a pulse" not in told.outcome and gap(told) < WIDTH**2
    missed = run(None, step=0.1)
    assert "has a pulse" in missed.outcome and np.isinf(missed.error.records["peak"])
    assert gap(missed) > WIDTH**2


@slow
def test_what_is_at_rest_does_not_step_over_what_is_to_come():
    """An adaptive step is never long against the lattice's own period where something drives it."""
    width = 0.15
    when = 50.1
    t1 = 100.0
    drive = gx.Drive(lambda t: jnp.exp(-(((t - when) / width) ** 2)), 1)
    chain = gx.Lattice(1.0, (FIXED, drive), sites=N)
    run = gx.simulate(chain, gx.states.rest(chain), t1, tolerance=1e-8)
    squared, modes = np.linalg.eigh(K)
    # u(t) = sum of modes sin(omega (t - s))/omega over the pulse, whose transform is a Gaussian
    omega = np.sqrt(squared)
    area = width * np.sqrt(np.pi)
    swings = area * np.exp(-squared * width**2 / 4) * np.sin(omega * (t1 - when)) / omega
    assert np.abs(run.final.u - modes @ (modes[1] * swings)).max() < 1e-7


def test_the_jumps_of_a_square_wave_are_where_it_jumps():
    # high while (4 t + pi/2)/(2 pi) is within a quarter of a whole number: from -pi/8 to 0
    wave = gx.Square(1.0, 4.0, phase=np.pi / 2, share=0.25)
    assert_allclose(wave.breaks.times, [-np.pi / 8, 0], atol=1e-15)
    assert_allclose(wave.breaks.period, np.pi / 2, rtol=1e-15)
    assert [float(wave(t)) for t in (-0.4, -0.38, -0.01, 0.01)] == [-1, 1, 1, -1]
