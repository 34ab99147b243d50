"""`simulate`: what it chooses, saves and refuses, and what it says about a run."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import OwnMap, ended
from numpy.testing import assert_allclose
from refusals import refused
from scipy.integrate import solve_ivp

import granjax as gx
from granjax.flow.arguments import facts

slow = pytest.mark.slow


@pytest.fixture(scope="module")
def closed():
    chain = gx.scenes.monomer(12, precompression=1.0)
    return chain, gx.states.random(chain, 1, displacement=0.1)


@pytest.mark.parametrize(
    "own",
    [
        lambda chain, y, t: y.u,
        lambda chain, y: y.u,
        lambda y, lattice: y.u,
        lambda lattice, y, t, more: y.u,
    ],
)
def test_a_record_of_a_function_with_other_arguments_is_refused_in_a_sentence(closed, own):
    expected = r"record: expected a function \(t, y, lattice\) or a measure \(lattice, y, t\), got"
    with refused(expected):
        gx.simulate(*closed, 0.2, step=0.1, record={"own": gx.Peak(own)})


# the step ----------------------------------------------------------------------------------------------------------


def test_default_step_comes_from_the_energy():
    # at energy E no Hertz contact is compressed by more than (5E/(2A))^{2/5}; omega^2 <= 4 F'(x)/m
    chain = gx.scenes.monomer(20, boundary="free")
    bound = np.sqrt(4 * 1.5 * (5 * 0.5 / 2) ** 0.2)
    run = gx.simulate(chain, gx.states.impact(chain), 30.0)
    # a chain of 20 ends a little below the band's edge, which the bound sees; then the step is shortened to fit
    assert 0.5 / bound * 0.98 < float(run.stats["step"]) <= 0.5 / bound * 1.01
    assert run.solver == "SRKN11b" and "default" in run.choice
    assert bool(run.contact_opened) and run.outcome.startswith("Completed")
    assert float(run.energy_error) < 1e-5


@slow
@pytest.mark.parametrize("ratio", [0.1, 1.0])
def test_frequency_bound_is_the_dimers_own_in_the_linear_limit(ratio):
    # dimer of infinitesimal amplitude: omega^2 <= 2 K2 (1/m + 1/M), reached by a long chain
    chain = gx.scenes.dimer(41, ratio=ratio, precompression=1.0)
    bound = float(gx.flow.linear_frequency(chain))
    assert bound == pytest.approx(np.sqrt(3 * (1 + 1 / ratio)), rel=2e-2)
    assert float(gx.linear.normal_modes(chain).omega.max()) <= bound * (1 + 1e-12)


def test_each_power_step_sharpens_the_bound():
    # three sites between walls: the largest quotient of (|K|/m)^{n+1} (1, 1, 1) and (|K|/m)^n (1, 1, 1)
    chain = gx.Lattice(2.0, gx.Bond(gx.Shift(1, "fixed"), gx.Linear(1.0)), sites=3)
    found = [float(gx.flow.linear_frequency(chain, n)) for n in (0, 1, 2)]
    assert_allclose(np.square(found), [4 / 2, 14 / 4 / 2, 48 / 14 / 2], rtol=1e-8)


@slow
def test_a_large_lattice_of_a_map_of_ones_own_has_a_bound():
    # too large for a dense matrix: by power iteration, which may lack a tenth
    chain = gx.Lattice(1.0, gx.Bond(OwnMap(), gx.Hertz(1.0, 1.0)), sites=4100)
    omega_max = 2 * 1.5**0.5
    assert omega_max <= float(gx.flow.linear_frequency(chain)) < 1.15 * omega_max


@slow
def test_a_bond_without_a_floor_has_a_step_until_the_energy_leaves_none():
    # a cubic bond has no floor beyond its barrier, which the energy of the whole chain passes, but not a neighbour's
    chain = gx.scenes.fput(200, alpha=0.25)
    slow, fast = (gx.states.random(chain, 0, displacement=0.0, velocity=v) for v in (0.5, 50.0))
    run = gx.simulate(chain, slow, 100.0)
    assert run.completed and float(run.energy_error) < 1e-8
    with refused("step: expected a time step.*no useful one"):
        gx.simulate(chain, fast, 100.0)


@slow
@pytest.mark.parametrize("t1", [1.0, 40.0])
def test_a_short_run_of_a_bond_without_a_floor_takes_few_steps(t1):
    chain = gx.scenes.fput(16, alpha=0.25)
    start = gx.states.sine_mode(chain, 1, 8.0)
    run = gx.simulate(chain, start, t1, save_at=41)
    same = gx.simulate(chain, start, t1, save_at=41, step=0.02)
    assert run.stats["steps"] < 400 and np.abs(run.us - same.us).max() < 1e-8
    damped = gx.Lattice(1.0, (*chain.terms, gx.CaputoDamping(0.05, 0.5)), sites=16)
    assert gx.simulate(damped, start, t1).stats["steps"] < 1e4
    bond = lambda k: gx.Bond(gx.Shift(1, "fixed"), gx.Polynomial(k, 0.25, 0.0))
    traces = gx.Traces(run.ts, velocity=run.vs[:, [3]], sites=[3], sigma=1e-3)
    scene = lambda p: gx.Lattice(1.0, (bond(p["k"]),), sites=16)
    assert abs(gx.fit(scene, {"k": 1.02}, traces, state=start).parameters["k"] - 1) < 1e-6


class Spring(gx.Term):
    """A force on each site."""

    k: jax.Array

    def force(self, t, u, v, mass):
        return -self.k * u


@slow
def test_a_term_of_ones_own_gets_a_step():
    chain = gx.Lattice(np.ones(4), (gx.Bond(gx.Shift(1), gx.Linear(0.01)), Spring(jnp.array(50.0))))
    run = gx.simulate(chain, gx.states.impact(chain), 20.0)
    assert 0.25 < float(run.stats["step"]) * 50.0**0.5 <= 0.5 and np.max(np.abs(run.final.v)) < 2


@slow
def test_the_default_step_of_a_solver_without_an_error_estimate_is_one_that_is_not_refused():
    chain = gx.scenes.monomer(4, precompression=1.0)
    state = gx.State(jnp.asarray([0.01, 0.0, 0.0, 0.0]), jnp.zeros(4))
    run = gx.simulate(chain, state, 0.1, solver=diffrax.Euler())
    assert run.completed and "0.02" in run.choice


@slow
def test_a_tolerance_with_a_longest_step(closed):
    how = dict(tolerance=1e-6, save_at="steps")
    free = gx.simulate(*closed, 10.0, **how)
    bound = gx.simulate(*closed, 10.0, step=0.2, **how)
    gaps = np.diff(np.asarray(bound.ts))
    assert np.diff(np.asarray(free.ts)).max() > 0.25 and gaps.max() <= 0.2 + 1e-12 and gaps[0] < 0.1
    assert "none longer than 0.2" in bound.choice
    np.testing.assert_allclose(bound.final.u, free.final.u, atol=1e-4)


# what is saved -----------------------------------------------------------------------------------------------------


@slow
def test_saved_times_leave_the_step_alone(closed):
    ends, frames, times, every = (
        gx.simulate(*closed, 4.0, step=0.1, save_at=save_at)
        for save_at in (None, 9, [0.0, 1.0, 1.237, 4.0], "steps")
    )
    assert ends.us.shape == (1, 12) and np.allclose(ends.ts, [4.0])
    assert np.allclose(frames.ts, np.linspace(0, 4, 9), atol=1e-12)
    assert every.us.shape == (41, 12)
    assert np.allclose(every.us[::5], frames.us, rtol=0, atol=1e-13)
    assert np.allclose(frames.us[-1], ends.final.u, rtol=0, atol=1e-13)
    assert np.allclose(times.us[1], every.us[10], rtol=0, atol=1e-13)
    for t1, uneven, steps in ((1.0, [0.0, 1e-4, 1.0], 20), (0.3, 0.1 * np.arange(4), 6)):
        assert gx.simulate(*closed, t1, step=0.05, save_at=uneven).stats["steps"] == steps
    fine = gx.simulate(*closed, 1.237, step=0.02)
    # the quintic between steps of 0.1: h^6 omega^6/46080 of 0.1
    assert np.max(np.abs(times.us[2] - fine.final.u)) < 1e-8
    assert np.max(np.abs(times.vs[2] - fine.final.v)) < 1e-7


@slow
def test_the_outcome_and_the_final_state_are_those_of_the_end_not_of_the_last_saved_time(closed):
    run = gx.simulate(*closed, 6.0, step=0.05, save_at=[1.0, 2.0])
    assert run.outcome.startswith("Completed at t = 6 after")
    end = gx.simulate(*closed, 6.0, step=0.05).final.u
    assert_allclose(run.final.u, end, rtol=0, atol=1e-14)


@slow
def test_steps_that_are_saved_are_counted_and_stay_where_the_lattice_was_put(closed):
    put = jax.device_put(closed, jax.devices()[0])
    for scene, how in ((closed, {"tolerance": 1e-8}), (put, {"step": 0.1, "max_steps": 500})):
        run = gx.simulate(*scene, 3.0, save_at="steps", **how)
        assert 0 <= float(run.energy_error) < 1e-6
        assert len(run.ts) == int(run.stats["accepted"]) + 1
        assert all(x.committed == (scene is put) for x in (run.ts, run.us, run.vs))


# methods -----------------------------------------------------------------------------------------------------------


@slow
def test_a_dashpot_takes_a_general_method_and_an_implicit_one_serves(closed):
    assert gx.simulate(WITH_DASHPOT, MOVING, 1.0).solver == "Dopri8"
    damped = gx.Lattice(1.0, (*SCENE.terms, gx.Damping(0.1)), sites=6)
    run = gx.simulate(damped, MOVING, 1.0)
    implicit = gx.simulate(damped, MOVING, 1.0, solver=diffrax.Kvaerno5(), tolerance=1e-8)
    assert np.max(np.abs(implicit.final.u - run.final.u)) < 1e-6 and np.isnan(run.energy_error)


def test_facts_of_a_lattice_are_found_once_are_its_own_and_tell_traced_ones():
    chain = gx.scenes.monomer(5)
    traced = []
    assert facts(chain) is facts(chain) and not facts(chain).traced
    for sites in (5, 6, 7, 8):  # each may lie where the one before lay
        assert facts(gx.scenes.monomer(sites)).template.shape == (sites,)
    jax.jit(lambda k: traced.append(facts(gx.scenes.monomer(5, stiffness=k)).traced))(1.0)
    assert traced == [True]


# refusals and failures ---------------------------------------------------------------------------------------------

SCENE = gx.scenes.monomer(6, precompression=1.0)
WITH_DASHPOT = gx.Lattice(1.0, (*SCENE.terms, gx.Dashpot(gx.Shift(1, "fixed"), 0.1)), sites=6)
LANES = jax.vmap(lambda r: gx.scenes.dimer(5, ratio=r), out_axes=-1)(jnp.array([0.5, 1.0]))
AT_REST = np.zeros(6)
MOVING = gx.states.impact(SCENE, velocity=0.1)
SMALL = jax.tree.map(lambda x: x.astype("float32"), (SCENE, MOVING))
SMALL_FAR = dict(lattice=SMALL[0], state=SMALL[1], t0=-1e6, t1=5.0 - 1e6)
BAD = [
    ("t1: expected a time after t0", dict(t1=-1.0)),
    ("step: expected one finite number above zero", dict(step=0.0)),
    ("step: expected at most .* SRKN11b is stable", dict(step=2.0)),
    ("tolerance: expected below 1", dict(tolerance=1.0)),
    ("save_at: expected finite times, each after", dict(save_at=[0.5, 0.2])),
    ("save_at: expected finite times.*without repeats", dict(save_at=[0.5, 0.5])),
    ("save_at: expected times within", dict(save_at=[0.5, 7.0])),
    ("save_at: expected one of 'steps'", dict(save_at="step")),
    ("solver: expected one for a single", dict(solver=diffrax.SemiImplicitEuler(), step=0.1)),
    ("Dashpot", dict(lattice=WITH_DASHPOT, solver=gx.SRKN6b(), step=0.1)),
    ("Dashpot", dict(lattice=WITH_DASHPOT, solver=gx.RKN86(), tolerance=1e-8)),
    ("record: expected names other than", dict(record={"error_x": None})),
    ("record: expected a dict of records", dict(record=gx.Peak(gx.measures.energy))),
    ("record: expected a dict of records", dict(record={"energy": gx.measures.energy})),
    ("adjoint: expected one of Reversible", dict(adjoint=diffrax.BacksolveAdjoint())),
    ("state.v: expected floating numbers", dict(state=(AT_REST, AT_REST * 1j))),
    ("state.u: expected finite numbers", dict(state=(AT_REST * np.nan, AT_REST))),
    ("state.u: expected float64", dict(state=(np.zeros(6, np.float32), AT_REST))),
    ("state.u: expected shape", dict(state=(np.zeros(5), AT_REST))),
    ("gaps between numbers of float64 .* Count time from t0=0", dict(t0=1e14, t1=1e14 + 5.0)),
    ("gaps between numbers of float64", dict(t0=1e14, t1=1e14 + 5.0, step=0.05)),
    ("gaps between numbers of float32", {**SMALL_FAR, "tolerance": 1e-4}),
    ("Lanes come last", dict(lattice=LANES, state=(np.zeros((2, 5)), np.zeros((2, 5))))),
]


@pytest.mark.parametrize(("sentence", "given"), BAD)
def test_bad_input_is_refused_in_a_sentence(sentence, given):
    with refused(sentence):
        gx.simulate(**{"lattice": SCENE, "state": MOVING, "t1": 1.0, **given})


@slow
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
    last = lambda v: gx.simulate(chain, state._replace(v=v * state.v), 10.0, step=0.3).final.u[0]
    with pytest.raises(RuntimeError, match="not finite .first between t = .* at sites .0"):
        jax.grad(last)(1.0)


@slow
def test_traced_sizes_that_make_no_run_complete_nothing(closed):
    """What cannot be refused while it is traced is said by the outcome, and by it alone."""
    run = jax.jit(lambda t1, step: gx.simulate(*closed, t1, step=step))
    for given in ((np.nan, 0.1), (-1.0, 0.1), (0.0, 0.1), (np.inf, 0.1), (0.4, np.nan), (0.4, 0.0)):
        found = run(*given)
        assert not found.completed and "Nothing was integrated" in found.outcome
    assert run(0.4, 0.1).completed
    run = jax.jit(lambda tolerance: gx.simulate(*closed, 0.2, tolerance=tolerance, max_steps=200))
    assert [x for x in (1e-6, -1e-6, 0.0, np.inf, np.nan) if run(x).completed] == [1e-6]
    run = jax.jit(lambda ts: gx.simulate(*closed, 0.4, step=0.1, save_at=ts))
    for ts in ([0.3, 0.1], [0.1, 0.5], [-0.1, 0.3], [0.1, np.nan]):
        found = run(jnp.array(ts))
        assert not found.completed and not np.isfinite(found.us).any()
    found = run(jnp.array([0.1, 0.3]))
    assert found.completed and np.isfinite(found.us).all()


@slow
def test_the_last_of_equal_frames_is_not_rounded_beyond_the_end(closed):
    t0, t1 = 0.20007002630130422, 2.52395183883715
    assert (t0 + (t1 - t0) * np.linspace(0.0, 1.0, 5))[-1] > t1
    run = gx.simulate(*closed, t1, t0=t0, step=0.05, save_at=5)
    assert run.completed and float(run.ts[-1]) == t1
    assert_allclose(run.us[-1], run.final.u, rtol=0, atol=1e-14)


# remarks -----------------------------------------------------------------------------------------------------------


@slow
def test_a_step_past_stability_at_this_energy_is_remarked_upon():
    # below the linear limit, so that it is not refused; far above it where contacts are pressed
    chain = gx.scenes.monomer(8, precompression=1.0)
    hit = gx.states.impact(chain, velocity=100.0)
    run = gx.simulate(chain, hit, 100.0, step=1.04)
    assert float(run.energy_error) > 0.02 and "past stability" in run.outcome
    assert "past stability" not in gx.simulate(chain, hit, 100.0, step=0.05).outcome


@slow
def test_a_loose_tolerance_and_the_energy_lost_by_it_are_said():
    chain = gx.scenes.monomer(20)
    run = gx.simulate(chain, gx.states.impact(chain), 30.0, tolerance=0.99)
    lost = float(run.energy_error)
    assert lost > 0.1 and "loose" in run.outcome and f"{lost:.2g} of it" in run.outcome
    fine = gx.simulate(chain, gx.states.impact(chain), 30.0, tolerance=1e-5)
    assert float(fine.energy_error) < 1e-3 and "energy" not in fine.outcome


class Rounded(gx.Law):
    """A law whose energy is a difference of large numbers, and which tells no overlap."""

    def force(self, e):
        return ((1 + e) ** 3 - 1) / 3

    def energy(self, e):
        return ((1 + e) ** 4 - 1 - 4 * e) / 12

    def overlap(self, e):
        return None


@slow
def test_an_energy_of_rounding_is_not_called_lost():
    lattice = gx.Lattice(np.ones(4), gx.Bond(gx.Shift(1, "fixed"), Rounded()))
    run = gx.simulate(lattice, gx.states.impact(lattice, velocity=1e-9), 5.0)
    assert run.energy_error > 0.02
    assert "does not resolve" in run.outcome and "was lost" not in run.outcome
    assert run.opening == "unknown"


@slow
def test_an_energy_beyond_the_largest_number_is_said_to_be_one():
    chain = gx.scenes.fput(6, 0.0)
    run = gx.simulate(chain, gx.states.impact(chain, velocity=1e155, site=2), 1.0, step=0.1)
    assert np.isnan(run.energy_error) and "slope" not in run.outcome
    assert "The energy is larger than any number of float64" in run.outcome


# contacts that open ------------------------------------------------------------------------------------------------


@slow
def test_a_contact_with_a_wall_opens_too():
    law = gx.Hertz(1.0, 1.0)
    walls = gx.Wall(law, "left"), gx.Wall(law, "right")
    chain = gx.Lattice(np.ones(2), (gx.Bond(gx.Shift(1, "free"), law), *walls))
    for speed, opens in ((2.0, True), (0.1, False)):
        run = gx.simulate(chain, (np.zeros(2), np.full(2, -speed)), 1.0, step=0.05)
        assert bool(run.contact_opened) == opens


@slow
def test_an_opening_that_no_law_tells_of_is_unknown():
    def opening(law):
        lattice = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "periodic"), law), sites=6)
        state = gx.states.impact(lattice, velocity=0.1)
        return gx.simulate(lattice, state, 0.5, step=0.1).opening

    spline = gx.laws.Spline([-1.0, 0.0, 1.0], [0.5, 1.0, 1.0, 1.5])
    unknown = spline, gx.Hertz(1.0, 0.5) + spline, gx.Yielding(spline, 2.0)
    assert [law.opens for law in unknown] == [None] * 3
    assert opening(unknown[1]) == "unknown" and opening(gx.Toda()) == "no"
    assert opening(gx.Hertz(1.0, 0.0) + spline) == "yes"


@slow
@pytest.mark.parametrize("how", [{}, {"tolerance": 1e-5}], ids=["default", "tolerance"])
def test_a_contact_that_opens_between_steps_is_seen(how):
    """Two beads between walls in opposite motion, u = (x, -x), whose energy V(x) + v^2 is a little off V(-1/2)."""
    chain = gx.scenes.monomer(2, precompression=1.0)
    V = lambda x: 0.4 * (2 * (1 - x) ** 2.5 + (1 + 2 * x) ** 2.5)
    opposite = jnp.array([1.0, -1.0])
    confirmed = lambda state: gx.simulate(chain, state, 4.0, confirm=True, **how)
    traced = jax.jit(lambda state: confirmed(state).contact_opened)
    missed = 0
    for start in (0.0, 0.1, 0.3):
        for off in (-2e-3, 2e-3):
            speed = np.sqrt((1 + off) * V(-0.5) - V(start))
            state = gx.State(start * opposite, speed * opposite)
            opens = off > 0
            run = confirmed(state)
            assert bool(traced(state)) == bool(run.contact_opened) == opens
            assert run.opening == ("yes" if opens else "no") and "smallest overlap" in repr(run)
            missed += opens and not bool(gx.simulate(chain, state, 4.0, **how).contact_opened)
    assert missed > 0  # by the ends of the steps alone


@slow
def test_an_opening_within_the_error_is_unsure(closed):
    """A single spring-like contact whose least overlap is zero to rounding: u = sin t about d0 = 1."""
    wall = gx.Wall(gx.PowerLaw(1.0, 1.0, 1.0), "left")
    lattice = gx.Lattice(1.0, (wall, gx.OnSite(gx.Linear(1e-9))), sites=2)
    state = gx.State(jnp.zeros(2), jnp.asarray([1.0, 0.0]))
    run = gx.simulate(lattice, state, 3.0, step=0.3, confirm=True)
    assert run.opening == "unsure" and "contact opened unsure" in repr(run)
    assert jax.tree.map(lambda x: x, run).opening == "unsure"  # what a transformation leaves
    far = gx.simulate(*closed, 2.0)
    assert far.opening == "no" and far.error is None


@slow
def test_a_long_given_step_is_always_looked_between():
    """Its ends keep 1.013 of how far they came, and between them the contact is 0.24 to 0.33 open."""
    lattice = gx.scenes.monomer(2, precompression=1.0)
    speed = 0.55 * 1.1 * float(np.max(gx.linear.normal_modes(lattice).omega))
    state = gx.State(np.zeros(2), speed * np.array([1.0, -1.0]))
    ends = gx.simulate(lattice, state, 2.9, step=1.45)
    assert ends._margin > 1 and ends.opening == "unsure"
    assert gx.simulate(lattice, state, 2.9, step=1.45, confirm=True).opening == "yes"


@slow
def test_the_errors_of_a_run_that_missed_all_motion_are_the_same_in_every_unit():
    """A pulse too short to be seen, midway in a step, where the second run alone has an end of one."""

    def errors_of(force):
        pulse = lambda t: jnp.where(abs(t - 0.5) < 1e-4, force, 0.0)
        terms = gx.Bond(gx.Shift(1, "fixed"), gx.Linear()), gx.Drive(pulse)
        chain = gx.Lattice(1.0, terms, sites=3)
        how = dict(solver=gx.VelocityVerlet(), step=1.0, confirm=True)
        run = gx.simulate(chain, gx.states.rest(chain), 3.0, **how)
        assert not np.any(run.us)
        return run.error

    one, small = errors_of(1.0), errors_of(2.0**-20)
    assert 0 < one.us[-1].max() < np.inf and one.energy[-1] > 0
    assert_allclose(small.us * 2.0**20, one.us, rtol=1e-14)
    assert_allclose(small.energy * 2.0**40, one.energy, rtol=1e-14)


@slow
def test_the_error_of_an_energy_that_two_runs_share_by_chance():
    """At this step both runs lose the same energy in a contact that opens, though not the true one."""

    def motion(t, y):
        overlap, rate = -np.diff(y[:3]), -np.diff(y[3:])
        push = np.maximum(overlap, 0) ** 0.5 * (np.maximum(overlap, 0) + 0.3 * rate)
        return np.concatenate([y[3:], -np.diff(push, prepend=0, append=0)])

    free = gx.Shift(1, "free")
    chain = gx.Lattice(1.0, (gx.Bond(free, gx.Hertz()), gx.ViscousContact(free, 0.3)), sites=3)
    run = gx.simulate(chain, gx.states.impact(chain), 7.0, step=0.0492, confirm=True)
    how = dict(method="DOP853", rtol=1e-11, atol=1e-13, max_step=0.01)
    end = solve_ivp(motion, (0, 7), [0, 0, 0, 1, 0, 0], **how).y[:, -1]
    energy = np.sum(end[3:] ** 2) / 2 + 0.4 * np.sum(np.maximum(-np.diff(end[:3]), 0) ** 2.5)
    off = abs(chain.energy(7.0, *run.final) - energy)
    assert 4e-6 < off < run.error.energy[-1] < 1e-4


# far times ---------------------------------------------------------------------------------------------------------


@slow
def test_far_times_of_a_traced_run_are_an_outcome_and_of_a_flow_refused():
    chain, state = SMALL
    found = jax.jit(lambda v: gx.simulate(chain, (state.u, v), 1e6 + 5.0, t0=1e6))(state.v)
    assert not found.completed and "does not resolve" in found.outcome
    with refused("gaps between numbers of float64"):
        gx.Flow(20)(MOVING, 1e15, 1e15 + 4.0, SCENE)


@slow
@pytest.mark.parametrize("t0", [-3e4, 1e6])
def test_times_that_are_far_but_told_apart_are_those_of_the_drive(t0):
    """A driven oscillator pair, whose drive counts from zero, against SciPy with time from t0."""
    drive = gx.Drive(gx.Harmonic(0.3, 1.7), 0)
    chain = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "fixed"), gx.Linear()), drive), sites=2)
    run = gx.simulate(chain, gx.states.rest(chain), t0 + 4.0, t0=t0, step=0.05)
    K = np.array([[2.0, -1.0], [-1.0, 2.0]])
    phase = np.mod(1.7 * t0, 2 * np.pi)

    def field(s, y):
        return np.concatenate([y[2:], -K @ y[:2] + [0.3 * np.cos(1.7 * s + phase), 0.0]])

    want = ended(field, 4.0, np.zeros(4))
    assert np.abs(np.concatenate(run.final) - want).max() < 3e-9
