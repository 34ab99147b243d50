"""Error against time: the measure, the table, its orders, its advice, on plain functions and on scenes."""

import math

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes
from cases import SPLITTING, ended
from numpy.testing import assert_array_equal
from refusals import refused

import granjax as gx
from granjax.work_precision import (
    Ladder,
    distance,
    find_reference,
    measure,
    observed_order,
    sensible_solvers,
)

END = 2.0
EXACT = np.array([math.cos(END)]), np.array([-math.sin(END)])
FLOOR = 1e-13


def verlet(step):
    """u'' = -u from (1, 0) to t = 2."""
    count = math.ceil(END / step)
    h = END / count
    u = 1.0
    v = 0.0
    for _ in range(count):
        v -= h / 2 * u
        u += h * v
        v -= h / 2 * u
    return (np.array([u]), np.array([v])), count, count


def runge_kutta(step):
    """The same by the classical method of order 4, which does not count its forces."""
    count = math.ceil(END / step)
    h = END / count
    y = np.array([1.0, 0.0])
    A = np.array([[0.0, 1.0], [-1.0, 0.0]])
    for _ in range(count):
        y = y + h * A @ (y + h / 2 * A @ (y + h / 3 * A @ (y + h / 4 * A @ y)))
    return (y[:1], y[1:]), None


def crude(value):
    return verlet(0.5)


STEPS = tuple(0.4 / 2.0 ** np.arange(8))
VERLET = Ladder("verlet", "step", STEPS, verlet)
RK4 = Ladder("rk4", "step", STEPS, runge_kutta)
STOPS = RK4._replace(stops=True)
DEFAULT = Ladder("default", "step", (math.nan,), crude)


@pytest.fixture(scope="module")
def table():
    return measure([VERLET, RK4, DEFAULT], EXACT, FLOOR, repeats=2, note="closed form")


# --------------------------------------------------------------------------------------------------------- the measure


def test_the_distance_takes_each_part_by_its_own_scale():
    u = np.array([1.0, -4.0])
    v = np.array([0.1, 0.0])
    assert distance((np.array([1.4, -4.0]), v), (u, v)) == pytest.approx(0.1)
    assert distance((u, np.array([0.1, 0.02])), (u, v)) == pytest.approx(0.2)
    fields = {"a": np.array([1.0, 0.0]), "b": np.array([8.0])}
    other = {"a": np.array([1.0, 2.0]), "b": np.array([8.0])}
    assert distance(gx.State(other, fields), gx.State(fields, fields)) == 0.25
    assert distance(np.ones((2, 3)), 2 * np.ones((2, 3))) == 0.5
    assert distance((np.ones(2), np.full(2, 1e-3)), (np.ones(2), np.zeros(2))) == 1e-3
    lost = np.array([1.0, np.nan])
    one = np.ones(2)
    assert math.isnan(distance((lost, one), (one, 2 * one)))
    assert math.isnan(distance((one, lost), (one, 2 * one)))


# ----------------------------------------------------------------------------------------------------------- measuring


def test_a_table_has_every_point_in_order(table):
    assert table.methods == ("verlet", "rk4", "default")
    assert table.method == ("verlet",) * 8 + ("rk4",) * 8 + ("default",)
    assert_array_equal(table.value[:8], STEPS)
    assert_array_equal(table.evaluations[:8], [math.ceil(END / h) for h in STEPS])
    assert np.isnan(table.evaluations[8:16]).all()
    assert table.drawn.all() and not any(table.note)
    for point, step in zip((0, 3), STEPS[::3]):
        assert table.error[point] == distance(verlet(step)[0], EXACT)
    # 1/32 of the step: 32 times the loop, whatever else the machine does
    assert table.fastest[7] > table.fastest[2] > 0
    assert np.all(table.seconds[:16] >= table.fastest[:16])
    for name, expected in (("verlet", 2), ("rk4", 4)):
        order, uncertain = table.orders[name]
        assert order == pytest.approx(expected, abs=0.05) and 0 < uncertain < 0.05
    assert all(math.isnan(x) for x in table.orders["default"])


def test_a_ladder_stops_at_the_floor_and_at_the_longest_call():
    fine = measure([STOPS], EXACT, 1e-6, repeats=1)
    assert fine.error[-1] < 4e-6 <= fine.error[-2]
    assert not fine.drawn[-1] and "Below 4 times" in fine.note[-1] and math.isnan(fine.seconds[-1])
    assert fine.drawn[:-1].all() and len(fine.value) < len(STEPS)
    assert len(measure([STOPS], EXACT, repeats=1, longest=1e-9).value) == 1
    assert len(measure([RK4], EXACT, 1e-6, repeats=1, longest=1e-9).value) == len(STEPS)


def test_a_ladder_stops_where_the_error_falls_no_more():
    def values(error):
        call = lambda step: ((EXACT[0] + error(step), EXACT[1]), None)
        return measure([STOPS._replace(call=call)], EXACT, repeats=1).value

    # rounding from the first step on; an error that is large yet; one that falls
    assert len(values(lambda step: 1e-6 / step)) == 5
    assert len(values(lambda step: 0.3)) == len(values(lambda step: step**2)) == len(STEPS)


def test_failures_stay_with_a_sentence():
    def call(step):
        if step > 0.3:
            raise ValueError("step: too long.")
        if step > 0.07:
            return (np.array([np.nan if step > 0.15 else 9.0]), np.ones(1)), 1
        return verlet(step)

    wp = measure([Ladder("fragile", "step", STEPS, call)], EXACT, FLOOR, repeats=1)
    for note, said in zip(wp.note, ("step: too long.", "not finite", "above 1")):
        assert said in note
    assert_array_equal(wp.drawn, [False] * 3 + [True] * 5)
    assert math.isnan(wp.error[0]) and math.isnan(wp.seconds[2])
    assert wp.orders["fragile"][0] == pytest.approx(2, abs=0.05)
    assert "step: too long." in str(wp)
    nothing = measure([Ladder("broken", "step", (0.4,), call)], EXACT, FLOOR, repeats=1)
    with refused("error: expected a table with points"):
        nothing.advice(1e-3)


# -------------------------------------------------------------------------------------------------------------- orders


def test_the_order_leaves_out_what_rounding_has_spoilt():
    h = 0.1 * 2.0 ** -np.arange(12)
    law = 3 * h**4
    assert observed_order(h, law, np.nan) == pytest.approx((4, 0), abs=1e-10)
    # the same from the finest step on, and with an order that no fit through the rounding would give
    spoilt = law + 1e-11 * 2.0 ** np.arange(12) / 2**6
    order, uncertain = observed_order(h[::-1], spoilt[::-1], np.nan)
    assert order == pytest.approx(4, abs=0.1) and uncertain < 0.1
    # an error that the reference may have
    order, _ = observed_order(h, np.maximum(law, 2e-10), 1e-10)
    assert order == pytest.approx(4, abs=1e-10)
    order, _ = observed_order(h, np.hypot(law, 2e-10), 1e-10)
    assert order == pytest.approx(4, abs=0.05)


def test_the_order_says_how_sure_it_is():
    # residuals +-s about a line through four points at x = -3, -1, 1, 3: s^2 4/(2 20)
    h = np.exp([-3.0, -1.0, 1.0, 3.0])
    s = 0.2
    errors = 1e-6 * h**2 * np.exp(s * np.array([1, -1, -1, 1]))
    assert observed_order(h, errors, np.nan) == pytest.approx((2.0, s * math.sqrt(0.1)))


# -------------------------------------------------------------------------------------------------------------- advice


def test_advice_is_what_a_run_gives(table):
    advice = table.advice(1e-8)
    assert advice.method == "rk4" and advice.value in STEPS
    assert distance(runge_kutta(advice.value)[0], EXACT) == advice.error <= 1e-8
    # all the digits are in the sentence
    assert f"rk4, step {advice.value!r}," in str(advice)
    assert advice.default_error == distance(crude(None)[0], EXACT)
    assert "the default would give 0.0" in str(advice)
    assert advice.keywords == {"step": advice.value}


def test_no_other_point_is_as_good_as_the_advice_and_faster():
    errors = 10.0 ** np.random.default_rng(0).uniform(-6, -1, (3, len(STEPS)))
    at = lambda errors: lambda h: ((EXACT[0] + errors[STEPS.index(h)], EXACT[1]), None)
    ladders = [Ladder(name, "step", STEPS, at(x)) for name, x in zip("abc", errors)]
    wp = measure(ladders, EXACT, repeats=1)
    for asked in (3e-1, 3e-2, 3e-3):
        advice = wp.advice(asked)
        assert advice.error <= asked
        assert advice.seconds == wp.seconds[wp.error <= asked].min()


def test_advice_below_the_floor_or_below_all_errors_is_refused(table):
    with refused("error: expected at least 4e-13, four times the floor"):
        table.advice(1e-13)
    with refused("The best point: rk4, step 0.0031"):
        table.advice(table.error[15] / 2)


# ------------------------------------------------------------------------------------------------------------- picture


def test_the_chart_shows_what_is_drawn(table, ax):
    assert gx.plots.work_precision(table, ax) is ax
    assert [line.get_label() for line in ax.lines] == ["verlet", "rk4", "default"]
    assert_array_equal(ax.lines[0].get_xdata(), table.seconds[:8])
    assert_array_equal(ax.lines[1].get_ydata(), table.error[8:16])
    assert ax.get_ylim()[0] < FLOOR and any("uncertainty" in text.get_text() for text in ax.texts)
    # points below the floor are left out, and methods that do not count their forces
    ax.clear()
    wp = measure([VERLET, RK4], EXACT, 1e-4, repeats=1)
    gx.plots.work_precision(wp, ax, against="evaluations")
    (line,) = ax.lines
    drawn = wp.error[:8] >= 4e-4
    assert_array_equal(line.get_data(), (wp.evaluations[:8][drawn], wp.error[:8][drawn]))
    assert 0 < np.count_nonzero(drawn) < 8


# -------------------------------------------------------------------------------------------------------------- scenes

CHAIN = gx.scenes.monomer(6, precompression=1.0)
STATE = gx.states.random(CHAIN, 1, displacement=0.1)
REST = np.zeros(6), np.ones(6)


def with_terms(*terms):
    return gx.Lattice(CHAIN.mass, (*CHAIN.terms, *terms), sites=6)


def test_sensible_solvers():
    splitting = {solver.__name__ for solver in SPLITTING}
    assert set(sensible_solvers(CHAIN)) == splitting | {"RKN86", "RKN1210", "Tsit5", "Dopri8"}
    assert set(sensible_solvers(with_terms(gx.Damping(0.1)))) == splitting | {"Tsit5", "Dopri8"}
    dashpot = with_terms(gx.Dashpot(gx.Shift(1, "free"), 0.1))
    assert set(sensible_solvers(dashpot)) == {"Tsit5", "Dopri8"}


def test_input_that_cannot_be_meant():
    twice = [VERLET, VERLET]
    negative = [VERLET._replace(values=(0.1, -0.1))]
    for call, message in (
        (lambda: measure(twice, EXACT), "'verlet' twice"),
        (lambda: measure(negative, EXACT), "steps of verlet: expected finite numbers above zero"),
    ):
        with refused(message):
            call()
    for arguments, keywords, message in (
        ((1.0, [gx.RKN86]), {}, "got RKN86. Solvers are instances"),
        ((1.0, [gx.RKN86(), gx.RKN86()]), {}, "'RKN86' twice. Give a dict"),
        ((1.0, [gx.RKN86()], {"RKN68": [1e-3]}), {}, "Did you mean 'RKN86'"),
        ((1.0,), {"reference": (REST[0][1:], REST[1])}, "reference: expected arrays of the shapes"),
        ((1.0,), {"reference": REST, "uncertainty": 0.1}, "uncertainty: expected a number from 0"),
    ):
        with refused(message):
            gx.work_precision(CHAIN, STATE, *arguments, **keywords)
    with refused("lattice: expected one without heat baths, got one with Langevin"):
        gx.work_precision(with_terms(gx.Langevin(0.1, 1.0, seed=1)), STATE, 1.0, gx.ABA864())


@pytest.mark.slow
def test_steps_of_ones_own_and_a_reference_of_ones_own():
    reference = gx.simulate(CHAIN, STATE, 4.0, tolerance=1e-13).final
    steps = {"mine": [0.1, 0.2, 3.0], "RKN86": [1e-4, 1e-8]}
    solvers = {"mine": gx.VelocityVerlet(), "RKN86": gx.RKN86()}
    wp = gx.work_precision(CHAIN, STATE, 4.0, solvers, steps, reference=reference, repeats=1)
    assert wp.method == ("mine",) * 3 + ("RKN86",) * 2 + ("default",)
    assert_array_equal(wp.value[:5], [3.0, 0.2, 0.1, 1e-4, 1e-8])
    assert wp.note[0].startswith("step: expected at most") and math.isnan(wp.floor)
    assert wp.error[1] / wp.error[2] == pytest.approx(4, rel=0.1)
    end = gx.simulate(CHAIN, STATE, 4.0, step=0.1, solver=gx.VelocityVerlet())
    assert wp.error[2] == distance(end.final, reference) and wp.steps[2] == 40 == wp.evaluations[2]
    assert "unknown uncertainty; floor not known" in str(wp)


@pytest.mark.slow
def test_orders_of_a_smooth_scene_down_to_the_floor_of_its_reference():
    chain = gx.scenes.disordered(16, 0.2, 3, precompression=1.0)
    state = gx.states.random(chain, 5, displacement=0.1)
    solvers = [gx.SRKN6b(), gx.KahanLi8()]
    # a processor that is busy otherwise must not end a ladder early
    wp = gx.work_precision(chain, state, 12.0, solvers, repeats=1, longest=2.0)
    for solver in solvers:
        order, uncertain = wp.orders[type(solver).__name__]
        assert order == pytest.approx(solver.table().order, abs=0.2)
        assert uncertain < 0.1
    assert 10 * wp.floor < 1e-11
    assert wp.error[wp.drawn].min() >= 4 * wp.floor
    assert "RKN1210" in wp.reference_note and "RKN86" in wp.reference_note


@pytest.mark.slow
def test_the_floor_is_above_the_error_of_the_reference():
    # against a reference in extended precision; others are in benchmarks/long
    scene = scenes.scene("light_dimer")
    end, floor, _ = find_reference(scene.lattice, scene.state, scene.t0, scene.t1)
    assert distance(end, scene.reference) < 2 * floor < 1e-10


@pytest.mark.slow
def test_contact_loss_makes_every_fixed_step_five_halves():
    chain = gx.scenes.monomer(6)
    solvers = [gx.SRKN11b(), gx.KahanLi8()]
    wp = gx.work_precision(chain, gx.states.impact(chain), 12.0, solvers, repeats=1)
    for order, uncertain in list(wp.orders.values())[:2]:
        assert abs(order - 2.5) < 0.5 and uncertain < 0.3


@pytest.mark.slow
def test_a_chaotic_scene_is_refused():
    chain = gx.scenes.monomer(16)
    state = gx.states.random(chain, 1, velocity=1.0)
    with pytest.raises(RuntimeError, match="No reference exists at t1 = 1000.*chaos"):
        gx.work_precision(chain, state, 1000.0, [gx.RKN86()], repeats=1)


def written_out(masses, F0, gamma, state, t1):
    """The damped Hertz chain between walls once more, by SciPy."""
    d0 = F0 ** (2 / 3)

    def rates(t, y):
        u, v = np.split(y, 2)
        e = -np.diff(u, prepend=0.0, append=0.0)
        return np.concatenate([v, -np.diff(np.maximum(d0 + e, 0) ** 1.5) / masses - gamma * v])

    return tuple(np.split(ended(rates, t1, np.concatenate(state)), 2))


@pytest.mark.slow
def test_advice_on_a_damped_trimer_holds_when_followed():
    F0 = 0.7
    gamma = 0.1
    t1 = 20.0
    chain = gx.scenes.trimer(16, (0.4, 0.7), precompression=F0)
    chain = gx.Lattice(chain.mass, (*chain.terms, gx.Damping(gamma)))
    state = gx.states.random(chain, 0, displacement=0.3, velocity=0.2)
    wp = gx.work_precision(chain, state, t1, [gx.SRKN11b(), diffrax.Dopri8()], repeats=2)
    exact = written_out(np.asarray(chain.mass), F0, gamma, state, t1)
    assert distance(wp.reference, exact) < 1e-9 and wp.floor < 1e-10
    for asked in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7):
        advice = wp.advice(asked)
        error = distance(gx.simulate(chain, state, t1, **advice.keywords).final, exact)
        assert advice.error / 3 < error < 3 * advice.error
        assert error < 1.01 * asked


@pytest.mark.slow
def test_fields_lanes_and_dashpots_have_a_reference():
    def cell(kappa):
        beads = gx.scenes.mass_in_mass(5, 0.3, kappa, precompression=0.4)
        drag = gx.Dashpot(gx.Shift(1, "free", "bead"), 0.05)
        return gx.Lattice(beads.mass, (*beads.terms, drag), sites=5)

    chain = jax.vmap(cell, out_axes=-1)(jnp.array([0.5, 0.9]))
    state = gx.states.random(chain, 2, displacement=0.1)
    wp = gx.work_precision(chain, state, 5.0, repeats=1)
    assert wp.methods == ("Tsit5", "Dopri8", "default") and wp.floor < 1e-11
    assert wp.drawn[-1] and wp.error[-1] < 1e-5


@pytest.mark.slow
def test_a_single_precision_scene_is_measured_in_double():
    chain = CHAIN.astype("float32")
    state = jax.tree.map(lambda x: x.astype("float32"), STATE)
    wp = gx.work_precision(chain, state, 4.0, [gx.RKN86()], repeats=1)
    assert wp.floor < 1e-12
    assert 1e-8 < wp.error[wp.drawn].min() < 1e-5
