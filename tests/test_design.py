"""Design by gradients: closed forms that the best parameters must meet, bounds, and how it says that it cannot."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax.fit.design import (
    CONVERGED,
    NO_GRADIENT,
    NO_START,
    NOT_FINITE,
    SPENT,
    STALLED,
    design,
    smooth_peak,
)

K2 = 1.5  # of Hertz contacts with A = F0 = 1


def bowl(parameters):
    return (parameters["x"] - 1.5) ** 2


@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_a_defect_whose_mode_has_the_wanted_frequency(mode):
    def misfit(p):
        chain = gx.scenes.defects(41, {20: p["mass"]}, precompression=1.0)
        return (gx.linear.normal_modes(chain).omega[-1] - 2.6) ** 2

    bounds = {"mass": (0.1, 1.0)}
    found = design(misfit, {"mass": 0.8}, bounds=bounds, tolerance=1e-9, mode=mode)
    mass = float(found.parameters["mass"])
    assert found.code == CONVERGED
    # the tails of the mode at the walls of 41 beads are below 1e-8
    assert 4 * K2 / (mass * (2 - mass)) == pytest.approx(2.6**2, abs=1e-7)


def test_the_place_of_a_bump_is_a_continuous_parameter():
    # of a harmonic chain the lowest mode is heaviest in the middle, between two sites, by symmetry
    def lowest(p):
        mass = 1 + jnp.exp(-((jnp.arange(10.0) - p["place"]) ** 2) / 2)
        return gx.linear.normal_modes(gx.scenes.monomer(10, mass=mass, precompression=1.0)).omega[0]

    found = design(lowest, {"place": 3.2}, tolerance=1e-9)
    assert found.parameters["place"] == pytest.approx(4.5, abs=1e-6)
    assert found.value < found.start_value


def test_a_simulation_is_maximised():
    # harmonic chain of two free beads, the first struck: energy goes to and fro
    half = np.pi / np.sqrt(2)
    bond = gx.Bond(gx.Shift(1, "free"), gx.Linear())

    def passed(p):
        chain = gx.Lattice(jnp.stack([jnp.ones(()), p["mass"]]), bond)
        how = dict(step=0.05, adjoint=diffrax.ForwardMode())
        return gx.simulate(chain, gx.states.impact(chain), half, **how).final.v[1] ** 2 * p["mass"]

    found = design(passed, {"mass": 1.6}, bounds={"mass": (0.2, 5)}, maximise=True)
    # equal masses pass all of the energy on after half a period
    assert found.parameters["mass"] == pytest.approx(1, abs=1e-4)
    assert found.value == pytest.approx(1, abs=1e-7) and found.value > found.start_value
    assert_allclose(np.nanmax(found.history), found.value, rtol=1e-12)


def test_bounds_are_kept():
    found = design(bowl, {"x": 0.5}, bounds={"x": (0.0, 1.0)})
    assert 0.99 < found.parameters["x"] <= 1
    assert found.value == pytest.approx(0.25, abs=1e-2)


def test_a_valley_that_bends():
    def rosenbrock(p):
        x = p["x"]
        return jnp.sum(100 * (x[1:] - x[:-1] ** 2) ** 2 + (1 - x[:-1]) ** 2)

    found = design(rosenbrock, {"x": np.array([-1.2, 1.0, -1.2, 1.0])}, tolerance=1e-9)
    assert found.code == CONVERGED and found.iterations < 100
    assert_allclose(found.parameters["x"], 1, atol=1e-6)


@pytest.mark.parametrize(
    "optimiser", [optax.adam(optax.cosine_decay_schedule(0.1, 200)), optax.lbfgs()]
)
def test_any_optimiser_of_optax(optimiser):
    found = design(bowl, {"x": 1.0}, optimiser=optimiser, tolerance=1e-12)
    assert found.parameters["x"] == pytest.approx(1.5, abs=1e-4)
    assert found.history[0] == 0.25 and found.history.shape == found.gradient_norm.shape == (201,)


@pytest.mark.slow
def test_a_gradient_that_is_zero_is_said():
    def never(p):
        chain = gx.scenes.monomer(6, boundary="free")
        return gx.simulate(chain, gx.states.impact(chain, p["v"]), 0.5, step=0.1).final.v[-1]

    # the first bead flies away from the others: no contact closes
    with pytest.raises(RuntimeError, match="exactly zero at the start"):
        design(never, {"v": -1.0})
    found = design(never, {"v": -1.0}, throw=False)
    assert found.code == NO_GRADIENT and found.parameters["v"] == -1


def test_one_parameter_without_effect_is_said():
    found = design(lambda p: bowl(p) + 0 * p["idle"], {"x": 1.0, "idle": 2.0})
    assert found.code == CONVERGED and "does not feel idle" in found.outcome
    assert found.parameters["idle"] == 2


@pytest.mark.parametrize("size", [1e4, 1e8])
def test_a_parameter_that_matters_little_is_found(size):
    found = design(lambda p: bowl(p) + size * (p["steep"] - 2) ** 2, {"x": 1.0, "steep": 1.0})
    assert found.code == CONVERGED
    assert found.parameters["x"] == pytest.approx(1.5, abs=1e-6)


def test_what_is_not_finite_is_said():
    with pytest.raises(RuntimeError, match="start is not finite.*in x"):
        design(lambda p: jnp.sqrt(p["x"] - 2), {"x": 1.0})
    assert design(lambda p: jnp.sqrt(p["x"] - 2), {"x": 1.0}, throw=False).code == NO_START
    for count, words in ((2, "x and y"), (3, "x, y and z")):
        with pytest.raises(RuntimeError, match=rf"not finite in {words}\."):
            design(lambda p: sum(jnp.sqrt(p[n] - 2) for n in p), dict.fromkeys("xyz"[:count], 1.0))
    # at a fixed rate over the edge of the domain; the default shortens the step there
    edge = lambda p: jnp.sqrt(p["x"]) + p["x"]
    found = design(edge, {"x": 0.3}, optimiser=optax.sgd(1.0))
    assert found.code == NOT_FINITE and np.isfinite(found.value) and "not finite" in found.outcome
    assert design(edge, {"x": 0.3}).value < 1e-3


def test_steps_that_are_spent_and_a_kink():
    found = design(bowl, {"x": 10.0}, optimiser=optax.sgd(1e-4), max_steps=5)
    assert found.code == SPENT and found.iterations == 5 and "5 steps are spent" in found.outcome
    kink = design(lambda p: jnp.abs(p["x"] - 1) + p["x"] / 2, {"x": 3.0})
    assert kink.code == STALLED and kink.parameters["x"] == pytest.approx(1, abs=1e-5)


def test_several_starts_find_the_deeper_valley():
    def two(p):
        return (p["x"] ** 2 - 1) ** 2 + 0.3 * p["x"]

    one = design(two, {"x": 0.8})
    assert one.parameters["x"] > 0
    many = design(two, {"x": 0.8}, starts=[{"x": -0.5}])
    assert many.parameters["x"] < 0 and many.every.shape == (2,)
    assert many.value == many.every.min() < one.value == many.every[0]
    drawn = design(two, {"x": 0.8}, starts=6, seed=1)
    assert drawn.value == pytest.approx(float(many.value), rel=1e-9) and drawn.every.shape == (7,)


def test_a_smooth_peak_is_a_mean_power():
    frames, push = np.random.default_rng(0).uniform(-1, 3, (2, 200, 4))
    top = frames.max(0)
    for power in (20, 100):
        peak = smooth_peak(frames, power, axis=0)
        assert_allclose(peak, (np.maximum(frames, 0) ** power).mean(0) ** (1 / power), rtol=1e-12)
        assert (peak <= top).all() and (peak > top / 200 ** (1 / power)).all()
    assert_allclose(smooth_peak(7e9 * frames), 7e9 * smooth_peak(frames), rtol=1e-12)
    # its derivative is that of its values, and zero where nothing happens
    slope = jax.jvp(smooth_peak, (frames,), (push,))[1]
    difference = (smooth_peak(frames + 1e-6 * push) - smooth_peak(frames - 1e-6 * push)) / 2e-6
    assert slope == pytest.approx(float(difference), rel=1e-6)
    assert smooth_peak(jnp.zeros(5)) == 0 and (jax.grad(smooth_peak)(jnp.zeros(5)) == 0).all()


def test_refusals():
    with refused("objective: expected a function that gives one real number"):
        design(lambda p: p["x"], {"x": np.ones(2)})
    with refused("x: expected a start below its bound"):
        design(bowl, {"x": 1.0}, bounds={"x": (0, 1)})
    with refused("start: expected a value for 'x', which the objective looks up, got 'a'"):
        design(bowl, {"a": 0.0})
    with refused("starts: expected dicts of x, got {'a': 1.0}"):
        design(bowl, {"x": 1.0}, starts=[{"a": 1.0}])
    for how in ({"starts": 2.5}, {"max_steps": 2.5}):
        with refused("expected a whole number not below 0, got 2.5"):
            design(bowl, {"x": 1.0}, **how)
    with refused("values: expected at least one number, got none"):
        smooth_peak([])


@pytest.mark.slow
def test_the_mass_ratio_that_lets_a_pulse_through():
    # first anti-resonance 0.342846, the zero of the asymptotic decay rate; here of contacts 40 -> 80
    peak = gx.Peak(lambda t, y, chain: gx.measures.contact_force(chain, y)[jnp.array([40, 80])])
    how = dict(step=0.05, record={"peak": peak}, adjoint=diffrax.ForwardMode())

    def kept(p):
        chain = gx.scenes.dimer(92, p["ratio"], boundary="free")
        run = gx.simulate(chain, gx.states.impact(chain), 140.0, **how)
        return jnp.log(run.recorded["peak"][1] / run.recorded["peak"][0])

    bounds = {"ratio": (0.05, 1.0)}
    found = design(kept, {"ratio": 0.36}, bounds=bounds, maximise=True, tolerance=1e-4)
    assert found.parameters["ratio"] == pytest.approx(0.342846, abs=2e-5)
    assert abs(found.value) < 1e-5
