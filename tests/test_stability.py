"""Linear stability: limits against the steps that solvers take, runs on either side, what `simulate` refuses."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ALL_SOLVERS, SPLITTING
from refusals import refused

import granjax as gx
from granjax.solvers import stability
from granjax.solvers.stability import (
    GROWTH,
    RUNAWAY,
    growth,
    one_step,
    refused_from,
    stability_limit,
    windows,
)
from granjax.solvers.tables import Splitting


def over(*solvers):
    return pytest.mark.parametrize("solver", solvers, ids=lambda s: s.__name__)


def oscillator(t, y, z):
    return gx.State(y[1], -z * z * y[0])


def taken(solver):
    """The matrix of one step, taken: a function of h omega for (u, v/omega)."""
    term = diffrax.ODETerm(oscillator)

    @jax.jit
    def step(z):
        method = solver()
        columns = []
        for u, v in ((1.0, 0.0), (0.0, 1.0)):
            y = gx.State(jnp.full_like(z, u), v * z)
            kept = method.init(term, 0.0, 1.0, y, z)
            times = jnp.asarray(0.0), jnp.asarray(1.0)
            end = method.step(term, *times, y, z, kept, made_jump=False)[0]
            columns.append(jnp.stack([end.u, end.v / z], -1))
        return jnp.stack(columns, -1)

    return lambda z: np.asarray(step(jnp.asarray(z)))


@pytest.mark.slow
@over(gx.VelocityVerlet, gx.SRKN11b, gx.RKN86, diffrax.Euler, diffrax.Dopri8)
def test_limit_is_that_of_the_steps_that_are_taken(solver):
    matrix = taken(solver)
    until = 10.0
    count = 20_001
    z = np.linspace(0.01, 3, count)
    assert np.abs(matrix(z) - one_step(solver, z)).max() < 3e-12
    low = 1e-9
    high = until
    # a grid finer than the narrowest window, then the cell where the spectral radius first passes exp(GROWTH z)
    for _ in range(3):
        z = np.linspace(low, high, count)
        rho = np.abs(np.linalg.eigvals(matrix(z))).max(-1)
        first = np.argmax(np.log(rho) > GROWTH * z)
        assert first > 0
        low = z[first - 1]
        high = z[first]
    assert stability_limit(solver) == pytest.approx(high, rel=1e-7)


@pytest.mark.slow
@over(gx.VelocityVerlet, diffrax.LeapfrogMidpoint, diffrax.ReversibleHeun)
def test_runs_grow_outside_alone_and_as_computed(solver):
    z = np.array([0.99, 1.01]) * stability_limit(solver)
    found = diffrax.diffeqsolve(
        diffrax.ODETerm(oscillator),
        solver(),
        0.0,
        400.0,
        1.0,
        gx.State(jnp.ones(2), 0.3 * jnp.asarray(z)),
        args=jnp.asarray(z),
        saveat=diffrax.SaveAt(ts=jnp.arange(401.0)),
    ).ys
    inside, outside = np.hypot(found.u, found.v / z).T
    assert inside.max() < 30
    measured = np.log(outside[-1] / outside[200]) / (200 * z[1])
    assert measured == pytest.approx(growth(solver, z[1]), rel=0.02) and measured > GROWTH


@pytest.mark.slow
@over(gx.SRKN11b, gx.RKN86, diffrax.Tsit5)
def test_simulate_takes_just_inside_and_refuses_just_outside(solver):
    chain = gx.scenes.monomer(4, precompression=1.0)
    state = gx.State(jnp.array([0.01, 0.0, -0.01, 0.02]), jnp.zeros(4))
    limit = refused_from(solver)
    step = limit / float(gx.linear.normal_modes(chain).omega[-1])
    assert gx.simulate(chain, state, 8 * step, solver=solver(), step=0.999 * step).completed
    with refused(f"where {solver.__name__} is stable.*limit h omega < {limit:.4g}"):
        gx.simulate(chain, state, 1.0, solver=solver(), step=1.001 * step)


@pytest.mark.parametrize(
    "solver, value",
    (
        (gx.VelocityVerlet, 2.0),
        (diffrax.Bosh3, 3**0.5),
        (diffrax.LeapfrogMidpoint, 1.0),
        (diffrax.ReversibleHeun, 1.0),
        (diffrax.Heun, (8 * GROWTH) ** (1 / 3)),
        (diffrax.Euler, 2 * GROWTH),
        (diffrax.ImplicitEuler, np.inf),
        (diffrax.Kvaerno3, np.inf),
    ),
)
def test_limits_in_closed_form(solver, value):
    # Verlet |1 - z^2/2| < 1; order 3 in three stages z < sqrt 3; Heun log(1 + z^4/4)/(2 z); Euler log(1 + z^2)/(2 z)
    assert stability_limit(solver) == stability_limit(solver()) == pytest.approx(value, rel=1e-4)


def test_what_is_refused():
    # granjax's own from their limit on; Heun log(1 + z^4/4)/(2 z) = RUNAWAY
    for solver in ALL_SOLVERS:
        assert refused_from(solver) == solver.stability_limit() == stability_limit(solver)
    z = refused_from(diffrax.Heun)
    assert np.log(1 + z**4 / 4) / (2 * z) == pytest.approx(RUNAWAY, rel=1e-6)
    assert refused_from(diffrax.Tsit5) > stability_limit(diffrax.Tsit5)


def test_first_windows_of_symplectic_methods():
    # all but Verlet pass through a window at phase pi and are stable again beyond it
    known = [5.07e-3, 3.16e-2, 8.87e-4, 1.19e-3, 4.37e-2, 7.58e-4]
    for solver, wide in zip(SPLITTING[1:], known, strict=True):
        window = windows(solver, 6.0)[0]
        assert 3.09 < window.start < window.end < 3.18
        middle = (window.start + window.end) / 2
        width = window.end - window.start
        assert width == pytest.approx(wide, rel=5e-3)
        assert growth(solver, middle) > 0.9 * window.growth
        beside = np.array([window.start - 0.1 * width, window.end + 0.1 * width])
        assert np.abs(growth(solver, beside)).max() < 1e-10


def two_verlets(difference):
    """Two steps of Verlet as one, of unequal lengths."""

    class Uneven:
        @staticmethod
        def table():
            a = np.array([1 + difference, 1 - difference]) / 2
            return Splitting(a, np.array([a[0], 1.0, a[1]]) / 2, 2, "")

    return Uneven


def test_a_window_is_found_however_narrow():
    # two equal steps pass phase pi, at sqrt 8, without a window, and end at 4; unequal ones open one there
    assert stability_limit(two_verlets(0.0)) == pytest.approx(4.0, rel=1e-6)
    (window, *_) = windows(two_verlets(1e-4), 8.0)
    assert window.start == pytest.approx(8**0.5, rel=1e-4)
    assert 0 < window.end - window.start < stability.SPACING / 10 and window.growth > GROWTH
    (window, *_) = windows(two_verlets(1e-6), 8.0, growth=1e-9)
    assert window.start == pytest.approx(8**0.5, rel=1e-6) and window.end - window.start < 1e-5
    assert stability_limit(two_verlets(1e-6)) == pytest.approx(4.0, rel=1e-6)


@pytest.mark.parametrize(
    "solver, kind, interval",
    (
        (gx.SRKN11b, "keeps", 3.14143),
        (gx.RKN1210, "damps", 3.14159),
        (diffrax.Dopri5, "damps", 0.99719),
        (diffrax.Dopri8, "amplifies", 0.0),
    ),
)
def test_strict_interval(solver, kind, interval):
    line = stability.stability(solver)
    assert line.near_zero == kind and line.interval == pytest.approx(interval, abs=1e-5)
    assert line.interval <= line.limit and line.per_evaluation == line.limit / line.evaluations
    assert stability.amplification(solver, 0.3) == pytest.approx(1.0, abs=2e-3)


def test_evaluations_are_those_of_the_solvers():
    count = stability.evaluations
    for solver in ALL_SOLVERS:
        assert count(solver) == count(solver()) == solver.evaluations()
    for solver, known in (
        (diffrax.Euler, 1),
        (diffrax.Tsit5, 6),
        (diffrax.Dopri8, 13),
        (diffrax.LeapfrogMidpoint, 1),
    ):
        assert count(solver) == known
    assert np.isnan(count(diffrax.Kvaerno5))


def test_what_is_not_known_has_no_limit():
    unknown = diffrax.HalfSolver(diffrax.Tsit5())
    assert stability_limit(unknown) is None
    with refused("expected granjax's, or one of diffrax's with a tableau, got HalfSolver"):
        one_step(unknown, 1.0)
