"""`simulate`: what it chooses, saves, records, differentiates and refuses."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ended
from refusals import refused

import granjax as gx


def force_of(t, y, lattice):
    return gx.measures.contact_force(lattice, y)


PEAK = gx.Peak(force_of)


@pytest.fixture(scope="module")
def struck():
    chain = gx.scenes.monomer(20, boundary="free")
    return chain, gx.states.impact(chain)


@pytest.fixture(scope="module")
def closed():
    chain = gx.scenes.monomer(12, precompression=1.0)
    return chain, gx.states.random(chain, 1, displacement=0.1)


def test_default_step_comes_from_the_energy(struck):
    # at energy E no Hertz contact is compressed by more than (5E/(2A))^{2/5}; omega^2 <= 4 F'(x)/m
    chain, state = struck
    bound = np.sqrt(4 * 1.5 * (5 * 0.5 / 2) ** 0.2)
    run = gx.simulate(chain, state, 30.0)
    # a chain of 20 ends a little below the band's edge, which the bound sees; then the step is shortened to fit
    assert 0.5 / bound * 0.98 < float(run.stats["step"]) <= 0.5 / bound * 1.01
    assert run.solver == "SRKN11b" and "default" in run.choice
    assert bool(run.contact_opened) and run.outcome.startswith("Completed")
    assert float(run.energy_error) < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.1, 0.5, 1.0])
def test_frequency_bound_is_the_dimers_own_in_the_linear_limit(ratio):
    # dimer of infinitesimal amplitude: omega^2 <= 2 K2 (1/m + 1/M), reached by a long chain
    from granjax.flow import linear_frequency

    chain = gx.scenes.dimer(41, ratio=ratio, precompression=1.0)
    assert float(linear_frequency(chain)) == pytest.approx(np.sqrt(3 * (1 + 1 / ratio)), rel=2e-2)
    exact = float(gx.linear.normal_modes(chain).omega.max())
    assert exact <= float(linear_frequency(chain)) * (1 + 1e-12)


@pytest.mark.study
def test_saved_times(closed):
    chain, state = closed
    end = gx.simulate(chain, state, 4.0, step=0.1)
    frames = gx.simulate(chain, state, 4.0, step=0.1, save_at=9)
    times = gx.simulate(chain, state, 4.0, step=0.1, save_at=[0.0, 1.0, 1.237, 4.0])
    every = gx.simulate(chain, state, 4.0, step=0.1, save_at="steps")
    assert end.us.shape == (1, 12) and np.allclose(end.ts, [4.0])
    assert np.allclose(frames.ts, np.linspace(0, 4, 9), atol=1e-12)
    assert every.us.shape == (41, 12)
    assert np.allclose(every.us[::5], frames.us, rtol=0, atol=1e-13)
    assert np.allclose(frames.us[-1], end.final.u, rtol=0, atol=1e-13)
    assert np.allclose(times.us[1], every.us[10], rtol=0, atol=1e-13)
    fine = gx.simulate(chain, state, 1.237, step=0.02)
    # the quintic between steps of 0.1: h^6 omega^6/46080 of 0.1
    assert np.max(np.abs(times.us[2] - fine.final.u)) < 1e-8
    assert np.max(np.abs(times.vs[2] - fine.final.v)) < 1e-7


@pytest.mark.study
def test_frames_of_an_adaptive_run_are_as_good_as_its_end(closed):
    chain, state = closed
    fine = gx.simulate(chain, state, 8.0, step=0.01, save_at=33)
    for solver in (None, gx.RKN1210(), diffrax.Dopri8()):
        run = gx.simulate(chain, state, 8.0, tolerance=1e-10, solver=solver, save_at=33)
        assert np.max(np.abs(run.us - fine.us)) < 2e-9, run.solver
        assert np.max(np.abs(run.vs - fine.vs)) < 2e-9, run.solver


@pytest.mark.slow
def test_what_is_saved_at_every_step_stays_where_the_lattice_was_put(closed):
    chain, state = closed
    for scene, stays in (
        (jax.device_put((chain, state), jax.devices()[0]), True),
        ((chain, state), False),
    ):
        run = gx.simulate(*scene, 1.0, step=0.1, save_at="steps")
        assert len(run.ts) == 11 and all(x.committed == stays for x in (run.ts, run.us, run.vs))


@pytest.mark.slow
def test_peak_between_steps_and_arrival_and_integral(struck):
    chain, state = struck
    record = {"peak": PEAK, "arrival": gx.Arrival(force_of, 0.3), "impulse": gx.Integral(force_of)}
    coarse = gx.simulate(chain, state, 12.0, step=0.1, record=record)
    fine = gx.simulate(chain, state, 12.0, step=0.1 / 16, record=record)
    at_steps = gx.simulate(chain, state, 12.0, step=0.1, save_at="steps")
    seen = jax.vmap(lambda u, v: force_of(0.0, gx.State(u, v), chain))(
        at_steps.us, at_steps.vs
    ).max(0)
    peak, true = coarse.recorded["peak"][:8], fine.recorded["peak"][:8]
    assert np.max(np.abs(peak - true)) < 2e-6
    assert np.max(np.abs(seen[:8] - true)) > 1e-4, (
        "the largest value at the ends of steps is not the largest value"
    )
    assert np.max(np.abs(coarse.recorded["arrival"][:8] - fine.recorded["arrival"][:8])) < 2e-6
    assert np.isnan(coarse.recorded["arrival"][-1])
    # the impulse of the first contact is the momentum that bead 1 has lost
    lost = 1.0 - fine.final.v[0]
    assert float(fine.recorded["impulse"][0]) == pytest.approx(float(lost), abs=1e-7)


@pytest.mark.study
def test_a_chain_in_its_working_layout_is_the_plain_one(closed):
    from granjax.lattice.split import ChainSplit, PlainSplit

    chain, state = closed
    pairs = gx.Pairs([-1, *range(12)], [*range(12), -1])
    plain = gx.Lattice(1.0, gx.Bond(pairs, gx.Hertz(1.0, 1.0)), sites=12)
    assert isinstance(gx.vector_field.split_system(chain), ChainSplit)
    assert isinstance(gx.vector_field.split_system(plain), PlainSplit)
    for rate in (None, 0.1):
        damping = () if rate is None else (gx.Damping(rate),)
        runs = [
            gx.simulate(gx.Lattice(1.0, (*c.terms, *damping), sites=12), state, 20.0, step=0.1)
            for c in (chain, plain)
        ]
        assert np.allclose(runs[0].final.u, runs[1].final.u, rtol=0, atol=1e-13)
        assert np.allclose(runs[0].final.v, runs[1].final.v, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_derivatives_in_both_modes_through_the_default():
    def last_velocity(stiffness):
        chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), gx.Hertz(stiffness)), sites=8)
        return gx.simulate(chain, gx.states.impact(chain), 8.0).final.v[6]

    forward = jax.jvp(last_velocity, (1.0,), (1.0,))[1]
    reverse = jax.grad(last_velocity)(1.0)
    compiled = jax.jit(jax.grad(last_velocity))(1.0)
    assert float(forward) == pytest.approx(float(reverse), rel=1e-9)
    assert float(compiled) == pytest.approx(float(reverse), rel=1e-3), (
        "a traced default step may differ by one step"
    )


@pytest.mark.slow
def test_damping_is_exact_and_a_dashpot_is_refused(closed):
    chain, state = closed
    damped = gx.Lattice(1.0, (*chain.terms, gx.Damping(0.3)), sites=12)
    coarse, fine = (gx.simulate(damped, state, 10.0, step=h) for h in (0.2, 0.01))
    # order 6 at h omega_max = 0.5
    assert np.max(np.abs(coarse.final.u - fine.final.u)) < 1e-9
    assert np.isnan(coarse.energy_error)
    dashpot = gx.Lattice(1.0, (*chain.terms, gx.Dashpot(gx.Shift(1, "fixed"), 0.1)), sites=12)
    with refused("Dashpot"):
        gx.simulate(dashpot, state, 1.0, solver=gx.SRKN6b(), step=0.1)
    with refused("Dashpot"):
        gx.simulate(dashpot, state, 1.0, solver=gx.RKN86(), tolerance=1e-8)
    assert gx.simulate(dashpot, state, 1.0).solver == "Dopri8"


@pytest.mark.study
def test_float32_runs_stay_float32(struck):
    chain, state = struck
    small = jax.tree.map(lambda x: x.astype("float32"), state)
    run = gx.simulate(chain.astype("float32"), small, 10.0, record={"peak": PEAK})
    reference = gx.simulate(chain, state, 10.0, record={"peak": PEAK})
    assert run.final.u.dtype == jnp.float32 and run.recorded["peak"].dtype == jnp.float32
    assert np.max(np.abs(run.final.u - reference.final.u)) < 1e-4
    adaptive = gx.simulate(chain.astype("float32"), small, 10.0, tolerance=1e-5)
    assert adaptive.final.u.dtype == jnp.float32


@pytest.mark.slow
def test_non_finite_states_are_located():
    # a bond that hardens so much that one step overshoots by more at each turn
    chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Polynomial(1.0, 0.0, 50.0)), sites=10)
    state = gx.states.impact(chain, velocity=50.0)
    with pytest.raises(RuntimeError, match="not finite .first between t = .* at sites .0"):
        gx.simulate(chain, state, 10.0, step=0.3)
    run = gx.simulate(chain, state, 10.0, step=0.3, throw=False)
    before, after, sites = run.failed_at
    assert 0 <= before < after <= 3.0 and 0 in sites
    assert not bool(run.completed)


@pytest.mark.slow
def test_stopped_runs_say_so(struck):
    chain, state = struck
    with pytest.raises(RuntimeError, match="Stopped after 5 steps"):
        gx.simulate(chain, state, 10.0, tolerance=1e-9, max_steps=5)


@pytest.mark.slow
def test_softening_contacts_have_no_step_bound():
    chain = gx.scenes.monomer(6, exponent=0.5, precompression=1.0)
    run = gx.simulate(chain, gx.states.impact(chain, velocity=0.01), 1.0)
    assert "no step bound" in run.outcome


@pytest.mark.study
def test_any_diffrax_solver_and_a_bare_diffeqsolve(closed):
    chain, state = closed
    fine = gx.simulate(chain, state, 3.0, step=0.01)
    tsit = gx.simulate(chain, state, 3.0, solver=diffrax.Tsit5(), tolerance=1e-9)
    implicit = gx.simulate(chain, state, 3.0, solver=diffrax.Kvaerno5(), tolerance=1e-8)
    assert np.max(np.abs(implicit.final.u - fine.final.u)) < 1e-6
    bare = diffrax.diffeqsolve(
        diffrax.ODETerm(gx.vector_field),
        gx.KahanLi8(),
        0.0,
        3.0,
        0.05,
        state,
        args=chain,
        max_steps=100,
    )
    assert np.max(np.abs(tsit.final.u - fine.final.u)) < 1e-7
    assert np.max(np.abs(bare.ys.u[0] - fine.final.u)) < 1e-10


SCENE = gx.scenes.monomer(6, precompression=1.0)
AT_REST = np.zeros(6)
MOVING = gx.states.impact(SCENE, velocity=0.1)
BAD = {
    "t1 before t0": (dict(t1=-1.0), "t1: expected a time after t0"),
    "step zero": (dict(step=0.0), "step: expected one finite number above zero"),
    "tolerance negative": (
        dict(tolerance=-1e-9),
        "tolerance: expected one finite number above zero",
    ),
    "a tolerance of all there is": (dict(tolerance=1.0), "tolerance: expected below 1"),
    "step unstable": (dict(step=2.0), "step: expected at most .* SRKN11b is stable"),
    "adaptive splitting": (
        dict(solver=gx.SRKN6b(), tolerance=1e-6),
        "tolerance: expected a fixed step with SRKN6b",
    ),
    "save_at unsorted": (dict(save_at=[0.5, 0.2]), "save_at: expected finite times, each after"),
    "save_at outside": (dict(save_at=[0.5, 7.0]), "save_at: expected times within"),
    "save_at word": (
        dict(save_at="step"),
        "save_at: expected one of 'steps'.*Did you mean 'steps'",
    ),
    "solver of two terms": (
        dict(solver=diffrax.SemiImplicitEuler(), step=0.1),
        "solver: expected one for a single",
    ),
    "record of a taken name": (dict(record={"u": PEAK}), "record: expected names other than"),
    "adjoint backwards": (
        dict(adjoint=diffrax.BacksolveAdjoint()),
        "adjoint: expected one of Reversible",
    ),
    "state complex": (dict(state=(AT_REST, AT_REST * 1j)), "state.v: expected floating numbers"),
    "state not finite": (
        dict(state=(AT_REST * np.nan, AT_REST)),
        "state.u: expected finite numbers",
    ),
    "state float32": (dict(state=(np.zeros(6, np.float32), AT_REST)), "state.u: expected float64"),
    "state shape": (dict(state=(np.zeros(5), AT_REST)), "state.u: expected shape"),
}


@pytest.mark.slow
@pytest.mark.parametrize("bad", BAD, ids=str)
def test_bad_input_is_refused_in_a_sentence(bad):
    given, sentence = BAD[bad]
    given = {"state": MOVING, "t1": 1.0} | given
    with refused(sentence) as caught:
        gx.simulate(SCENE, given.pop("state"), given.pop("t1"), **given)
    assert "granjax" in str(caught.traceback[-1].path)


@pytest.mark.slow
def test_energy_error_of_every_saved_step(closed):
    chain, state = closed
    for how in ({"tolerance": 1e-8}, {"step": 0.1, "max_steps": 500}):
        run = gx.simulate(chain, state, 3.0, save_at="steps", **how)
        assert 0 <= float(run.energy_error) < 1e-6
        assert len(run.ts) == int(run.stats["accepted"]) + 1


@pytest.mark.slow
def test_a_contact_with_a_wall_opens_too():
    law = gx.Hertz(1.0, 1.0)
    walls = gx.Wall(law, "left"), gx.Wall(law, "right")
    chain = gx.Lattice(np.ones(2), (gx.Bond(gx.Shift(1, "free"), law), *walls))
    assert bool(gx.simulate(chain, (np.zeros(2), np.full(2, -2.0)), 1.0, step=0.05).contact_opened)
    assert not bool(
        gx.simulate(chain, (np.zeros(2), np.full(2, -0.1)), 1.0, step=0.05).contact_opened
    )


@pytest.mark.slow
def test_a_piston_does_not_collapse_the_default_step():
    # the wall has gone 50 by the end, at a speed of 0.5: bonds are pushed by the speed and not by the way
    chain = gx.scenes.toda(20, boundary="free")
    pushed = gx.Lattice(
        1.0, (*chain.terms, gx.Wall(gx.Toda(), "left", motion=lambda t: 0.5 * t)), sites=20
    )
    assert float(gx.simulate(pushed, gx.states.rest(pushed), 15.0).stats["step"]) > 0.01
    # a cubic bond has no floor beyond its barrier, which the energy of the whole chain passes, but not a neighbour's
    alpha = gx.scenes.fput(200, alpha=0.25)
    run = gx.simulate(alpha, gx.states.random(alpha, 0, displacement=0.0, velocity=0.5), 100.0)
    assert run.completed and float(run.energy_error) < 1e-8
    with refused("step: expected a time step.*no useful one"):
        gx.simulate(alpha, gx.states.random(alpha, 0, displacement=0.0, velocity=50.0), 100.0)


@pytest.mark.slow
def test_a_term_of_ones_own_gets_a_step():
    class Spring(gx.Term):
        k: jax.Array

        def force(self, t, u, v, mass):
            return -self.k * u

    chain = gx.Lattice(np.ones(4), (gx.Bond(gx.Shift(1), gx.Linear(0.01)), Spring(jnp.array(50.0))))
    state = gx.states.impact(chain)
    run = gx.simulate(chain, state, 20.0)
    assert 0.25 < float(run.stats["step"]) * 50.0**0.5 <= 0.5 and np.max(np.abs(run.final.v)) < 2
    assert np.max(np.abs(gx.simulate(chain, state, 20.0, step=0.05).final.v)) < 2


@pytest.mark.slow
def test_uneven_times_leave_the_step_alone(closed):
    chain, state = closed
    run = gx.simulate(chain, state, 1.0, step=0.05, save_at=[0.0, 1e-4, 1.0])
    assert int(run.stats["steps"]) == 20
    run = gx.simulate(chain, state, 0.3, step=0.05, save_at=0.1 * np.arange(4))
    assert int(run.stats["steps"]) == 6


@pytest.mark.slow
def test_a_law_of_ones_own_may_hold_plain_numbers():
    class Cubic(gx.Law):
        k: float

        def force(self, e):
            return self.k * e**3

        def energy(self, e):
            return self.k * e**4 / 4

    chain = gx.Lattice(np.ones(6), gx.Bond(gx.Shift(1), Cubic(2.0)))
    run = gx.simulate(chain, gx.states.impact(chain), 5.0)
    assert float(run.energy_error) < 1e-6


def test_nothing_stiff_asks_for_a_step():
    chain = gx.scenes.monomer(6)
    with refused("step: expected a time step"):
        gx.simulate(chain, (AT_REST, AT_REST), 1.0)


@pytest.mark.study
def test_a_step_past_stability_at_this_energy_is_remarked_upon():
    # below the linear limit, so that it is not refused; far above it where contacts are pressed
    chain = gx.scenes.monomer(8, precompression=1.0)
    hit = gx.states.impact(chain, velocity=100.0)
    run = gx.simulate(chain, hit, 100.0, step=1.04)
    assert float(run.energy_error) > 0.02 and "past stability" in run.outcome
    assert "past stability" not in gx.simulate(chain, hit, 100.0, step=0.05).outcome


class OwnMap(gx.StrainMap):
    """A map that writes `strain` alone."""

    def strain(self, u):
        return u[:-1] - u[1:]


@pytest.mark.study
def test_a_large_lattice_of_a_map_of_ones_own_has_a_bound():
    # too large for a dense matrix: by power iteration, which may lack a tenth
    chain = gx.Lattice(1.0, (gx.Bond(OwnMap(), gx.Hertz(1.0, 1.0)),), sites=4100)
    run = gx.simulate(chain, gx.State(chain.zeros(), chain.zeros()), 0.2, step=0.1)
    assert run.completed
    omega_max = 2 * 1.5**0.5
    omega = 0.5 / float(
        gx.simulate(chain, gx.State(chain.zeros(), chain.zeros()), 200.0).stats["step"]
    )
    assert omega_max <= omega < 1.15 * omega_max


@pytest.mark.slow
def test_the_default_step_is_one_that_is_not_refused():
    chain = gx.scenes.monomer(4, precompression=1.0)
    state = gx.State(jnp.asarray([0.01, 0.0, 0.0, 0.0]), jnp.zeros(4))
    run = gx.simulate(chain, state, 0.1, solver=diffrax.Euler())
    assert run.completed and "0.02" in run.choice


def test_traced_times_that_span_nothing_complete_nothing(closed):
    """What cannot be refused while it is traced is said by the outcome, and by it alone."""
    chain, state = closed

    run, nan = jax.jit(lambda t1, step: gx.simulate(chain, state, t1, step=step)), np.nan
    for t1, step in (
        (nan, 0.1),
        (-1.0, 0.1),
        (0.0, 0.1),
        (np.inf, 0.1),
        (0.4, nan),
        (0.4, -0.1),
        (0.4, 0.0),
    ):
        found = run(t1, step)
        assert not found.completed and "Nothing was integrated" in found.outcome
    assert run(0.4, 0.1).completed


@pytest.mark.slow
def test_a_traced_tolerance_below_zero_completes_nothing(closed):
    chain, state = closed
    run = jax.jit(
        lambda tolerance: gx.simulate(chain, state, 0.2, tolerance=tolerance, max_steps=200)
    )
    assert [bool(run(x).completed) for x in (1e-6, -1e-6, 0.0, np.inf, np.nan)] == [
        True,
        False,
        False,
        False,
        False,
    ]


@pytest.mark.slow
def test_a_tolerance_with_a_longest_step(closed):
    chain, state = closed
    how = dict(tolerance=1e-6, save_at="steps")
    free, bound = (
        gx.simulate(chain, state, 10.0, **how),
        gx.simulate(chain, state, 10.0, step=0.2, **how),
    )
    gaps = np.diff(np.asarray(bound.ts))
    assert np.diff(np.asarray(free.ts)).max() > 0.25 and gaps.max() <= 0.2 + 1e-12 and gaps[0] < 0.1
    assert "none longer than 0.2" in bound.choice
    np.testing.assert_allclose(bound.final.u, free.final.u, atol=1e-4)


@pytest.mark.slow
def test_a_loose_tolerance_is_said():
    chain = gx.scenes.monomer(20)
    run = gx.simulate(chain, gx.states.impact(chain), 30.0, tolerance=0.99)
    lost = float(run.energy_error)
    assert lost > 0.1 and "loose" in run.outcome and f"{lost:.2g} of it" in run.outcome
    fine = gx.simulate(chain, gx.states.impact(chain), 30.0, tolerance=1e-5)
    assert (
        float(fine.energy_error) < 1e-3
        and fine.outcome == f"Completed at t = 30 after {fine.stats['steps']} steps."
    )


@pytest.mark.slow
def test_an_opening_that_no_law_tells_of_is_unknown():
    def ring(law):
        lattice = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "periodic"), law),), sites=6)
        return gx.simulate(lattice, gx.states.impact(lattice, velocity=0.1), 0.5, step=0.1)

    spline = gx.laws.Spline([-1.0, 0.0, 1.0], [0.5, 1.0, 1.0, 1.5])
    unknown = (spline, gx.Hertz(1.0, 0.5) + spline, gx.Yielding(spline, 2.0))
    assert [law.opens for law in unknown] == [None] * 3
    assert not (gx.Toda() + gx.Linear()).opens and (gx.Toda() + gx.Hertz()).opens
    run = ring(unknown[1])
    assert run.opening == "unknown" and "contact opened unknown (Bond)" in repr(run)
    assert ring(gx.Toda()).opening == "no" and ring(gx.Hertz(1.0, 0.0) + spline).opening == "yes"


def test_a_state_with_lanes_first_is_told_where_they_belong():
    lattice = jax.vmap(lambda r: gx.scenes.dimer(5, ratio=r), out_axes=-1)(jnp.array([0.5, 1.0]))
    with refused("state.u: expected shape .* Lanes come last"):
        gx.simulate(lattice, (np.zeros((2, 5)), np.zeros((2, 5))), 1.0)


def deepest(chain, state, t1):
    """The smallest overlap of a chain between walls, d0 = 1, from many frames of a run at 1e-12."""
    u = np.pad(gx.simulate(chain, state, t1, tolerance=1e-12, save_at=2001).us, ((0, 0), (1, 1)))
    return (1 + u[:, :-1] - u[:, 1:]).min()


@pytest.mark.study
def test_a_contact_that_opens_between_steps_is_seen(seeds=5):
    """Random starts, scaled until the closest approach is a little off zero; default step and a loose tolerance."""
    chain = gx.scenes.monomer(4, precompression=1.0)
    traced = jax.jit(lambda state: gx.simulate(chain, state, 4.0, confirm=True).contact_opened)
    missed = 0
    for seed in range(seeds):
        start = gx.states.random(chain, seed, velocity=1.0)
        low, high = 0.01, 3.0
        for _ in range(14):
            middle = (low + high) / 2
            opens = deepest(chain, gx.State(start.u, middle * start.v), 4.0) < 0
            low, high = (low, middle) if opens else (middle, high)
        for off in (-2e-3, 2e-3):
            state = gx.State(start.u, (1 + off) * middle * start.v)
            want = deepest(chain, state, 4.0) < 0
            assert bool(traced(state)) == want
            for how in ({}, {"tolerance": 1e-5}):
                run = gx.simulate(chain, state, 4.0, confirm=True, **how)
                missed += want and not bool(gx.simulate(chain, state, 4.0, **how).contact_opened)
                assert bool(run.contact_opened) == want and run.opening == ("yes" if want else "no")
                assert "smallest overlap" in repr(run)
    assert missed > seeds / 2  # by the ends of the steps alone


@pytest.mark.slow
def test_an_opening_within_the_error_is_unsure(closed):
    """A single spring-like contact whose least overlap is zero to rounding: u = sin t about d0 = 1."""
    lattice = gx.Lattice(
        1.0, (gx.Wall(gx.PowerLaw(1.0, 1.0, 1.0), "left"), gx.OnSite(gx.Linear(1e-9))), sites=2
    )
    state = gx.State(jnp.zeros(2), jnp.asarray([1.0, 0.0]))
    run = gx.simulate(lattice, state, 3.0, step=0.3, confirm=True)
    assert run.opening == "unsure" and "contact opened unsure" in repr(run)
    far = gx.simulate(*closed, 2.0)
    assert far.opening == "no" and far.error is None
    assert jax.tree.map(lambda x: x, run).opening == "unsure"  # what a transformation leaves


@pytest.mark.slow
def test_a_long_given_step_is_always_looked_between():
    """Its ends keep 1.013 of how far they came, and between them the contact is 0.24 to 0.33 open."""
    lattice = gx.scenes.monomer(2, precompression=1.0)
    speed = 0.55 * 1.1 * float(np.max(gx.linear.normal_modes(lattice).omega))
    state = gx.State(np.zeros(2), speed * np.array([1.0, -1.0]))
    ends = gx.simulate(lattice, state, 2.9, step=1.45)
    assert ends._margin > 1 and ends.opening == "unsure"
    assert gx.simulate(lattice, state, 2.9, step=1.45, confirm=True).opening == "yes"


class Rounded(gx.Law):
    def force(self, e):
        return ((1 + e) ** 3 - 1) / 3

    def energy(self, e):
        return ((1 + e) ** 4 - 1 - 4 * e) / 12


class Wrapper(gx.Law):
    """A law that answers by another, which has no overlap."""

    law: gx.Law

    def force(self, e):
        return self.law.force(e)

    def energy(self, e):
        return self.law.energy(e)

    def overlap(self, e):
        return self.law.overlap(e)


@pytest.mark.slow
def test_an_energy_of_rounding_is_not_called_lost_and_a_wrapped_law_may_not_know():
    lattice = gx.Lattice(np.ones(4), gx.Bond(gx.Shift(1, "fixed"), Wrapper(Rounded())))
    run = gx.simulate(lattice, gx.states.impact(lattice, velocity=1e-9), 5.0)
    assert (
        run.energy_error > 0.02
        and "does not resolve" in run.outcome
        and "was lost" not in run.outcome
    )
    assert run.opening == "unknown"


def test_an_energy_beyond_the_largest_number_is_said_to_be_one():
    chain = gx.scenes.fput(6, 0.0)
    run = gx.simulate(chain, gx.states.impact(chain, velocity=1e155, site=2), 1.0, step=0.1)
    assert (
        np.isnan(run.energy_error)
        and "The energy is larger than any number of float64" in run.outcome
    )
    assert "slope" not in run.outcome


def as_type(dtype, *trees):
    return [jax.tree.map(lambda x: x.astype(dtype), tree) for tree in trees]


FAR = {
    "float32": (np.float32, 1e6, {}),
    "float32, a step": (np.float32, 1e6, {"step": 0.05}),
    "float32, a tolerance": (np.float32, -1e6, {"tolerance": 1e-4}),
    "float64": (np.float64, 1e14, {}),
    "float64, a tolerance": (np.float64, 1e14, {"tolerance": 1e-8}),
}


@pytest.mark.parametrize("case", FAR)
def test_times_that_steps_do_not_tell_apart_are_refused(case):
    dtype, t0, how = FAR[case]
    chain, state = as_type(dtype, SCENE, MOVING)
    with refused(f"gaps between numbers of {np.dtype(dtype)} .* Count time from t0=0"):
        gx.simulate(chain, state, t0 + 5.0, t0=t0, **how)


@pytest.mark.slow
def test_far_times_of_a_traced_run_are_an_outcome_and_of_a_flow_refused():
    chain, state = as_type(np.float32, SCENE, MOVING)
    found = jax.jit(lambda v: gx.simulate(chain, (state.u, v), 1e6 + 5.0, t0=1e6))(state.v)
    assert not found.completed and "does not resolve" in found.outcome
    with refused("gaps between numbers of float64"):
        gx.Flow(20)(MOVING, 1e15, 1e15 + 4.0, SCENE)


@pytest.mark.parametrize("t0", [0.0, -3e4, 1e6])
def test_times_that_are_far_but_told_apart_are_those_of_the_drive(t0):
    """A driven oscillator pair, whose drive counts from zero, against SciPy with time from t0."""
    chain = gx.Lattice(
        1.0,
        (gx.Bond(gx.Shift(1, "fixed"), gx.Linear()), gx.Drive(gx.Harmonic(0.3, 1.7), 0)),
        sites=2,
    )
    run = gx.simulate(chain, gx.states.rest(chain), t0 + 4.0, t0=t0, step=0.05)
    K, phase = np.array([[2.0, -1.0], [-1.0, 2.0]]), np.mod(1.7 * t0, 2 * np.pi)

    def field(s, y):
        return np.concatenate([y[2:], -K @ y[:2] + [0.3 * np.cos(1.7 * s + phase), 0.0]])

    want = ended(field, 4.0, np.zeros(4))
    assert np.abs(np.concatenate(run.final) - want).max() < 3e-9


@pytest.mark.slow
def test_a_run_of_plain_numbers_inside_jit(closed):
    chain, state = closed
    for how in ({}, {"step": 0.1}, {"step": 0.1, "save_at": 5}, {"tolerance": 1e-9}):
        inside = jax.jit(lambda x, how=how: x * gx.simulate(chain, state, 2.0, **how).final.u)(2.0)
        assert np.allclose(
            inside, 2 * gx.simulate(chain, state, 2.0, **how).final.u, rtol=0, atol=1e-13
        )


@pytest.mark.study
def test_gradient_of_a_recorded_peak(struck):
    def peak(v):
        chain = gx.scenes.monomer(8, boundary="free")
        run = gx.simulate(
            chain, gx.states.impact(chain, velocity=v), 8.0, step=0.05, record={"peak": PEAK}
        )
        return run.recorded["peak"][4]

    # every force of a sonic vacuum goes with v^{6/5}
    assert float(jax.grad(peak)(1.0)) == pytest.approx(1.2 * float(peak(1.0)), rel=1e-4)
