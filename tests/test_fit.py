"""`fit`: parameters from traces that SciPy made, their errors, what is not determined, what is refused."""

import itertools
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import by_dop853
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

import granjax as gx
from granjax.fit.fitted import Fit, _ljung_box
from granjax.fit.parameters import Coordinates
from granjax.fit.problem import prepared
from granjax.fit.solve import STALLED, least_squares
from granjax.fit.windows import cut

N = 20
SITES = [2, 7, 12, 17]
TIMES = np.linspace(0.1, 40.0, 400)
TRUTH = {"stiffness": 1.0, "exponent": 1.5, "damping": 0.05, "precompression": 1.0}
START = {"stiffness": 1.15, "exponent": 1.4, "damping": 0.03, "precompression": 0.85}


def measured(times, velocity, sites=N, damping=0.05):
    """Displacements and velocities (T, sites) of a chain between walls after an impact, by DOP853."""
    y = by_dop853(velocity, times[-1], damping, n=sites)[0](times).T
    return y[:, :sites], y[:, sites:]


def scene(p, sites=N):
    """A chain of the parameters that are given, and the true others."""
    p = TRUTH | p
    law = gx.PowerLaw(p["stiffness"], p["exponent"], p["precompression"])
    terms = gx.Bond(gx.Shift(1, "fixed"), law), gx.Damping(p["damping"])
    return gx.Lattice(1.0, terms, sites=sites)


def short_chain(p):
    return scene(p, 6)


def struck(p, chain):
    return gx.states.impact(chain, p.get("velocity", 1.0))


def noisy(clean, seed, share=0.01):
    sigma = share * np.abs(clean).max()
    return clean + sigma * np.random.default_rng(seed).normal(size=clean.shape), sigma


def traced(clean, seed):
    data, sigma = noisy(clean, seed)
    return gx.Traces(TIMES, velocity=data, sites=SITES, sigma=sigma)


def off(fit, truth):
    """The largest error of the parameters, in standard deviations."""
    return max(abs(fit.parameters[x] - true) / fit.deviations[x] for x, true in truth.items())


@pytest.fixture(scope="module")
def velocities():
    return measured(TIMES, 1.0)[1][:, SITES]


@pytest.mark.slow
def test_each_parameter_is_within_two_deviations_in_most_of_many_draws(velocities, optimised):
    inside = dict.fromkeys(TRUTH, 0)
    for seed in range(100):
        fit = gx.fit(scene, START, traced(velocities, seed), state=struck)
        assert fit.converged and not fit.undetermined
        for name, true in TRUTH.items():
            inside[name] += off(fit, {name: true}) < 2
    assert all(88 <= count <= 99 for count in inside.values()), inside


@pytest.mark.slow
def test_a_fit_of_noisy_traces(velocities):
    fit = gx.fit(scene, START, traced(velocities, 1), state=struck)
    assert tuple(START) == fit.names == tuple(fit.parameters) and off(fit, TRUTH) < 3
    assert_allclose(list(fit.deviations.values()), np.sqrt(np.diag(fit.covariance)), rtol=1e-5)
    # stiffness and precompression go together along A p d0^(p-1)
    assert np.allclose(np.diag(fit.correlations), 1) and fit.correlations[0, 3] < -0.9
    assert fit.reduced_chi_square == pytest.approx(1.0, abs=4 * np.sqrt(2 / fit.samples))
    assert fit.samples == 1600 and (fit.whiteness()[0] > 1e-3).all()
    assert fit.step_error < 1e-3 and fit.return_error < 1e-10
    assert "Converged" in fit.outcome and fit.lattice.sites == (N,)
    assert fit.to_xarray().data_0.attrs == {"units": "scaled", "si_units": "m/s"}
    assert np.abs(np.asarray(fit.signals[0]) - velocities).max() < 0.01 * np.abs(velocities).max()


def test_what_is_not_determined_is_correlated_with_nothing():
    """Of four numbers, two are known."""
    known = np.array([[4.0, 3.0], [3.0, 9.0]])
    matrix = block_diag(known, np.diag([np.inf, np.inf]))
    found = Fit.correlations.fget(SimpleNamespace(covariance=matrix))
    assert_allclose(found[:2, :2], [[1, 0.5], [0.5, 1]], rtol=1e-15)
    assert np.isnan(found[2:]).all() and np.isnan(found[:, 2:]).all()


@pytest.mark.slow
def test_small_strains_determine_the_linear_stiffness_alone():
    small = traced(measured(TIMES, 1e-3)[1][:, SITES], 0)
    tapped = lambda p, chain: gx.states.impact(chain, 1e-3)
    fit = gx.fit(scene, START, small, state=tapped, throw=False)
    said = " ".join(fit.undetermined)
    assert "A p d0^(p-1)" in said and "A p d0" in fit.outcome and "damping" not in said
    assert all(name in said for name in ("stiffness", "exponent", "precompression"))
    A, p, _, F0 = (float(x) for x in fit.parameters.values())
    assert p * A ** (1 / p) * F0 ** (1 - 1 / p) == pytest.approx(1.5, rel=1e-3)


FEW = np.linspace(0.1, 12.0, 60)
WALLS = gx.Shift(1, "fixed")


def magnets(p):
    return gx.Lattice(1.0, gx.Bond(WALLS, gx.PowerLaw(p["A"], -4.0, p["F0"])), sites=5)


def contacts(p):
    return gx.Lattice(1.0, gx.Bond(WALLS, gx.Hertz(p["A"], p["F0"])), sites=5)


def springs(p):
    law = gx.Polynomial(p.get("K", 1.0), p.get("alpha", 0.0))
    return gx.Lattice(p.get("m", 1.0), gx.Bond(WALLS, law), sites=5)


def swung(force):
    """Velocities (T, 2) of five beads after a blow of 0.4, by DOP853."""

    def rate(t, y):
        bonds = force(-np.diff(y[:5], prepend=0.0, append=0.0))
        return np.concatenate([y[5:], bonds[:-1] - bonds[1:]])

    struck_at = 0.4 * np.eye(10)[5]
    return solve_ivp(rate, (0, 12.0), struck_at, "DOP853", FEW, rtol=1e-10, atol=1e-12).y[[6, 8]].T


# u -> lambda u: the start, what is measured there, and what no trace of a sensor without a gain tells apart
SCALINGS = {
    "Hertz": (
        contacts,
        {"A": 1.3, "F0": 0.8, "velocity": 0.5, "gain": 1.2},
        lambda e: (1 + e) ** 1.5 - 1,
        ["A^0.50 F0^-1.00 velocity^-1.00 gain"],
    ),
    "magnets": (
        magnets,
        {"A": 1.5, "F0": 0.95, "velocity": 0.32, "gain": 1.3},
        lambda e: (1 - e) ** -4.0 - 1,
        ["A F0^0.20 velocity^0.20 gain^-0.20"],
    ),
    "two at once": (
        springs,
        {"K": 1.4, "m": 1.2, "velocity": 0.2, "gain": 1.5},
        lambda e: e,
        ["K m", "velocity gain^-1.00"],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", SCALINGS)
def test_exponents_of_what_is_not_determined_are_those_of_a_scaling(case):
    make, start, force, expected = SCALINGS[case]
    traces = gx.Traces(FEW, velocity=swung(force), sites=[1, 3], sigma=1e-3, gain="gain")
    fit = gx.fit(make, start, traces, state=struck)
    assert fit.reduced_chi_square < 1e-2 and np.isinf(np.diag(fit.covariance)).all()
    # a perfect fit, with parameters that mean nothing: the search ends elsewhere on the line than at the truth
    assert abs(fit.parameters["gain"] - 1) > 0.03
    said = " ".join(fit.undetermined)
    assert all(f"{words} is known not at all" in said for words in expected), said
    assert said.count("known not at all") == len(expected)


@pytest.mark.slow
def test_a_parameter_that_is_zero_is_determined():
    """A chain without the quadratic term: its relative error is large, its error is not."""
    data, sigma = noisy(swung(lambda e: e), 3)
    traces = gx.Traces(FEW, velocity=data, sites=[1, 3], sigma=sigma)
    fit = gx.fit(springs, {"alpha": 0.3, "velocity": 0.5}, traces, state=struck)
    assert abs(fit.parameters["alpha"]) < 4 * fit.deviations["alpha"] < 0.02
    assert not fit.undetermined


@pytest.mark.slow
def test_what_starts_at_zero_and_is_zero_has_the_deviation_of_its_derivatives():
    """Springs, struck at one site: v(t) = sum of modes cos(w t), with noise and without."""
    squares, modes = np.linalg.eigh(2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))

    def seen(K, v):
        turned = np.cos(np.sqrt(K * squares) * FEW[:, None])
        return (modes @ (turned * (modes.T @ v)).T)[[1, 3]].T

    chain = lambda p: gx.Lattice(1.0, gx.Bond(WALLS, gx.Linear(p["K"])), sites=4)
    struck = lambda p, _: gx.State(jnp.zeros(4), jnp.append(p["first"], p["last"]))
    start = {"K": 1.0, "first": np.array([0.9, 0.0, 0.0]), "last": 0.0}
    clean = seen(1.3, np.eye(4)[0])
    slopes = [(seen(1.3 + 1e-6, np.eye(4)[0]) - seen(1.3 - 1e-6, np.eye(4)[0])) / 2e-6]
    columns = np.stack([*slopes, *(seen(1.3, own) for own in np.eye(4))], -1).reshape(-1, 5)
    deviations = 1e-3 * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    for size in (0.0, 1e-3):
        data = clean + size * np.random.default_rng(0).normal(size=clean.shape)
        traces = gx.Traces(FEW, velocity=data, sites=[1, 3], sigma=1e-3)
        for begin in (start, start | {"K": 1.3, "first": np.eye(3)[0]}):
            fit = gx.fit(chain, begin, traces, state=struck, step=0.02)
            assert_allclose(np.sqrt(np.diag(fit.covariance)), deviations, rtol=0.01)
            assert not fit.undetermined


@pytest.mark.slow
def test_a_residue_beyond_noise_is_said():
    """Traces of contacts, which springs and a parabola do not have, with and without noise, of a known size or not."""
    times = np.linspace(0.1, 20.0, 150)
    clean = measured(times, 0.6, 5, damping=0.0)[1][:, [1, 4]]
    hit = lambda p, chain: gx.states.impact(chain, 0.6)
    loaded = lambda p: contacts(p | {"F0": 1.0})
    for size, sigma in ((0.0, None), (1e-4, None), (1e-4, 1e-4)):
        data = clean + size * np.random.default_rng(2).normal(size=clean.shape)
        traces = gx.Traces(times, velocity=data, sites=[1, 4], sigma=sigma)
        wrong = gx.fit(springs, {"K": 1.4, "alpha": 0.2}, traces, state=hit, throw=False)
        assert "A residue beyond noise is left" in wrong.outcome
        right = gx.fit(loaded, {"A": 0.95}, traces, state=hit)
        assert "residue" not in right.outcome


@pytest.fixture(scope="module")
def short():
    times = np.linspace(0.0, 15.0, 151)
    return times, *measured(times, 0.4, 6)


FLICKED = gx.states.impact(short_chain({}), 0.4)


@pytest.mark.slow
def test_several_kinds_with_gain_offset_and_unknown_impact():
    late = np.linspace(0.0, 12.0, 121)  # a recorder that was started at 1.3
    u, v = measured(late + 1.3, 0.4, 6)
    force = jax.vmap(lambda *y: gx.measures.contact_force(short_chain({}), y))(u, v)[:, [1, 4]]
    common = dict(sigma=1e-3, offset="offset")
    traces = [
        gx.Traces(late, displacement=2.5 * u[:, [2]], sites=2, gain="gain", **common),
        gx.Traces(late, force=force, contacts=[1, 4], **common),
        gx.Traces(late, velocity=v[:, [-1]], sites=[-1], **common),
    ]
    start = {"stiffness": 1.1, "velocity": 0.35, "gain": 2.0, "offset": 1.0}
    bounds = {"stiffness": (0, None), "gain": (1.0, 4.0)}
    fit = gx.fit(short_chain, start, traces, state=struck, bounds=bounds)
    assert_allclose([*fit.parameters.values()], [1.0, 0.4, 2.5, 1.3], rtol=2e-5)


@pytest.mark.slow
def test_a_stiffness_from_the_force_at_sensor_beads(short):
    """A bead with a sensor reads the mean of its two contacts' forces, (1 + e)_+^{3/2} each."""
    times, u, v = short
    walls = np.pad(u, ((0, 0), (1, 1)))
    contacts = np.maximum(1 - np.diff(walls), 0) ** 1.5
    force = (contacts[:, :-1] + contacts[:, 1:])[:, [1, 4]] / 2
    traces = gx.Traces(times, force=force, sites=[1, 4], sigma=1e-3)
    assert traces.sensors == ["force of site 1", "force of site 4"]
    found = gx.fit(short_chain, {"stiffness": 1.1}, traces, state=FLICKED)
    assert_allclose(found.parameters["stiffness"], 1.0, rtol=1e-5)


def per_bond(p):
    return gx.scenes.monomer(6, mass=p["mass"], stiffness=p["stiffness"], precompression=1.0)


@pytest.mark.slow
def test_a_parameter_of_every_bond_and_missing_samples():
    stiffness = np.array([1.0, 1.2, 0.9, 1.1, 1.3, 0.8, 1.0])
    chain = per_bond({"mass": 1.0, "stiffness": stiffness})
    state = gx.states.impact(chain, 0.3)
    run = gx.simulate(chain, state, 20.0, step=0.01, save_at=200)
    data = np.array(run.us)
    data[30:60, 2] = np.nan
    traces = gx.Traces(run.ts, displacement=data, sites=range(6), sigma=1e-3)
    fit = gx.fit(per_bond, {"mass": 1.0, "stiffness": np.full(7, 1.05)}, traces, state=state)
    assert fit.names[1:3] == ("stiffness[0]", "stiffness[1]") and fit.samples == 200 * 6 - 30
    assert_allclose(fit.parameters["stiffness"], stiffness, rtol=1e-4)
    assert_allclose(fit.parameters["mass"], 1.0, rtol=1e-4)


@pytest.mark.slow
def test_several_starts_and_an_unknown_noise(short):
    times, _, v = short
    data, sigma = noisy(v[:, [1, 4]], 3)
    traces = gx.Traces(times, velocity=data, sites=[1, 4])
    fit = gx.fit(short_chain, {"stiffness": 1.0}, traces, state=FLICKED, starts=4)
    assert len(fit.starts) == 4 and "4 of 4 starts" in fit.outcome
    # each in units of the noise that is found
    assert_allclose(fit.starts, fit.chi_square, rtol=1e-3)
    assert fit.noise == pytest.approx(sigma, rel=0.1) and off(fit, {"stiffness": 1.0}) < 3


@pytest.mark.slow
def test_noise_and_step_have_units():
    spring = lambda p: gx.Lattice(0.02, gx.OnSite(gx.Linear(p["stiffness"])), sites=2, units="SI")
    times = np.linspace(0.0, 0.1, 81)
    clean = 1e-3 * np.cos(np.sqrt(500.0 / 0.02) * times)
    errors = 2e-6 * np.random.default_rng(1).normal(size=times.size)
    # the standard deviation of the errors [um] over the 80 degrees of freedom that are left
    spread = 1e6 * np.sqrt(np.sum(errors**2) / 80)
    for sigma, noise, unit in ((None, spread, "um"), (2e-6, 1.0, None)):
        traces = gx.Traces(times, displacement=clean + errors, sites=0, sigma=sigma)
        state = gx.State(np.array([1e-3, 0.0]), np.zeros(2))
        fit = gx.fit(spring, {"stiffness": 490.0}, traces, state=state)
        data = fit.in_units("us", "um").attrs
        assert (data["step_units"], data.get("noise_units")) == ("us", unit)
        assert_allclose(data["step"], 1e6 * fit.step, rtol=1e-15)
        assert_allclose(data["noise"], noise, rtol=0.03)


@pytest.mark.slow
def test_an_offset_that_grows_and_a_bound_that_holds(short):
    times, _, v = short
    moved = np.linspace(0.0, 9.0, 91)
    late = measured(moved + 5.1, 0.4, 6)[1][:, [1, 4]]
    traces = gx.Traces(moved, velocity=late, sites=[1, 4], sigma=1e-3, offset="offset")
    fit = gx.fit(short_chain, {"stiffness": 1.0, "offset": 4.1}, traces, state=FLICKED)
    assert_allclose([*fit.parameters.values()], [1.0, 5.1], rtol=1e-5)
    traces = gx.Traces(times, velocity=v[:, [1]], sites=1, sigma=1e-3)
    for low in (0.5, None):
        how = dict(state=FLICKED, bounds={"stiffness": (low, 0.9)}, throw=False)
        held = gx.fit(short_chain, {"stiffness": 0.8}, traces, **how)
        assert "At its bound" in held.outcome and held.parameters["stiffness"] <= 0.9


@pytest.mark.slow
@pytest.mark.parametrize("bounds", [(1.1, 1.5), (1.1, None), (0.5, 0.9), (None, 0.9)])
def test_a_gain_at_its_bound_has_the_deviation_that_the_data_give_it(bounds):
    """Two springs that swing alike: d = g cos w t, w^2 = K, whose true gain of 1 lies beyond the bound."""
    d = np.cos(1.2**0.5 * FEW) + 1e-3 * np.random.default_rng(0).normal(size=60)
    pair = lambda p: gx.Lattice(1.0, gx.Bond(WALLS, gx.Linear(p["K"])), sites=2)
    traces = gx.Traces(FEW, displacement=d, sites=0, sigma=1e-3, gain="gain")
    how = dict(state=gx.State(np.ones(2), np.zeros(2)), bounds={"gain": bounds}, throw=False)
    start = {"K": 1.1, "gain": 1.2 if bounds[0] == 1.1 else 0.8}
    fit = gx.fit(pair, start, traces, **how)
    K, gain = (float(x) for x in fit.parameters.values())
    assert min(abs(gain - 1.1), abs(gain - 0.9)) < 1e-9
    assert fit.at_bounds == ("gain",) and not fit.undetermined
    w = K**0.5
    columns = np.stack([-gain * FEW / (2 * w) * np.sin(w * FEW), np.cos(w * FEW)], -1)
    deviations = 1e-3 * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    assert_allclose([*fit.deviations.values()], deviations, rtol=1e-3)


THREE = 2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
HELD = gx.State(np.array([1.0, 0, 0]), np.zeros(3))


def damped(p):
    """Three beads between walls: linear springs k, damping at the rate g."""
    return gx.Lattice(1.0, (gx.Bond(WALLS, gx.Linear(p["k"])), gx.Damping(p["g"])), sites=3)


def plucked(k, g, times):
    """Its first bead, let go at 1: a sum over modes of exp(-g t/2) (cos W t + g/(2 W) sin W t)."""
    squares, shapes = np.linalg.eigh(k * THREE)
    w = np.sqrt(squares - g**2 / 4)
    waves = np.cos(w * times[:, None]) + g / (2 * w) * np.sin(w * times[:, None])
    return np.exp(-g * times / 2) * (waves @ shapes[0] ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("true, bounds, seed", [(0, (0, None), 7), (0.05, (0.08, None), 1)])
def test_an_optimum_at_a_bound_on_one_side_is_reached(true, bounds, seed):
    times = np.linspace(0, 20, 201)
    data = plucked(1.3, true, times) + 0.01 * np.random.default_rng(seed).normal(size=201)
    traces = gx.Traces(times, displacement=data, sites=0, sigma=0.01)
    found = gx.fit(damped, {"k": 1.0, "g": 0.1}, traces, state=HELD, bounds={"g": bounds})
    chi = lambda k: np.sum((plucked(k, bounds[0], times) - data) ** 2) / 1e-4
    best = minimize_scalar(chi, bracket=(1.29, 1.31), tol=1e-10)
    assert "Converged" in found.outcome and "At its bound" in found.outcome
    assert_allclose(found.parameters["k"], best.x, rtol=1e-6)
    assert_allclose(found.chi_square, best.fun, rtol=1e-5)


@pytest.mark.slow
def test_a_fit_that_leaves_what_the_scene_allows_says_where():
    times = np.linspace(0, 20, 201)
    data = plucked(1.3, 0.0, times) + 0.01 * np.random.default_rng(7).normal(size=201)
    traces = gx.Traces(times, displacement=data, sites=0, sigma=0.01)
    for step in (None, 0.02):
        with refused(r"a fit that ends at k = 1\.30\d*, g = -.*rate: expected .* not below zero"):
            gx.fit(damped, {"k": 1.0, "g": 0.1}, traces, state=HELD, step=step, throw=False)


class Edge(eqx.Module):
    """Residuals x - 2 and 0.1, times `size`, NaN beyond x = 1."""

    size: float = 1.0
    traces: tuple = ()
    dtype = jnp.dtype("float64")

    def linearise(self, x):
        ahead = jnp.where(x[0] > 1, jnp.nan, x[0] - 2)
        value, matrix = jnp.stack([ahead, jnp.asarray(0.1)]), jnp.array([[1.0], [0.0]])
        return self.size * value, self.size * matrix, ()


# nor where a large sigma makes all misfits small
@pytest.mark.parametrize("size", [1.0, 1e-5])
def test_the_edge_of_what_is_finite_is_no_minimum(size, capsys):
    found = least_squares(Edge(size), np.zeros(1), 1e-8, 100, delay=0)
    assert "fit:" in capsys.readouterr().err  # a bar of the steps that are left
    assert found.code == STALLED and 0.999 < found.x[0] <= 1


@pytest.mark.slow
def test_another_minimum_than_the_one_sought_says_so():
    """A cosine beside one of another frequency explains none of it; where noise is most of the trace none does."""
    pair = lambda p: gx.Lattice(1.0, gx.Bond(WALLS, gx.Linear(p["stiffness"])), sites=2)
    state = gx.State(np.ones(2), np.zeros(2))
    times = np.linspace(0, 60, 121)
    noise = np.random.default_rng(0).normal(size=121)

    def outcome(start, deviation, sigma):
        data = np.cos(1.2**0.5 * times) + deviation * noise
        traces = gx.Traces(times, displacement=data, sites=0, sigma=sigma)
        return gx.fit(pair, {"stiffness": start}, traces, state=state, throw=False).outcome

    assert "unless noise" in outcome(3.0, 0.01, None)
    said = outcome(3.0, 0.01, 0.01)
    assert "another minimum" in said and "unless" not in said
    assert "minimum" not in outcome(1.1, 0.01, 0.01) + outcome(3.0, 3.0, 3.0)


@pytest.mark.slow
def test_descent_reaches_what_least_squares_reach(short):
    times, _, v = short
    data = noisy(v[:, [1, 4]], 3)[0]

    def found(start, offset=0.0, **how):
        traces = gx.Traces(times, velocity=data, sites=[1, 4], sigma=1e-3, offset=offset)
        how |= dict(state=struck, bounds={"stiffness": (0, None)})
        return gx.fit(short_chain, start, traces, **how)

    start = {"stiffness": 1.1, "velocity": 0.38}
    wanted = found(start)
    descent = found(start, method="gradient")
    assert wanted.adjoint == "forward mode"
    assert descent.adjoint == "Reversible" and descent.return_error < 1e-12
    moved = found({**start, "offset": 1e-3}, "offset", method="gradient")
    assert moved.adjoint == "RecursiveCheckpointAdjoint"
    for name in start:
        near = 0.02 * wanted.deviations[name]
        assert abs(float(descent.parameters[name]) - float(wanted.parameters[name])) < near


@pytest.mark.slow
def test_the_jacobian_of_windows_is_put_together_rightly(short):
    times, _, v = short
    traces = gx.Traces(times, velocity=v, sites=range(6), sigma=0.01)
    windows = cut(prepared(short_chain, {"stiffness": 1.1}, traces, state=FLICKED), 4)
    x = jnp.full(1 + windows.starts.size, 0.01)
    value, blocks, _ = jax.jit(lambda x: windows.linearise(x))(x)
    whole = jax.jit(jax.jacfwd(lambda x: windows.linearise(x)[0]))(x)
    assert blocks.shape == whole.shape == (4 * 38 * 6 + 3 * 12, 1 + 3 * 12)
    assert np.allclose(blocks, whole, rtol=0, atol=1e-11 * np.abs(whole).max())


def test_arrays_that_say_another_unit_are_not_read_as_si():
    xarray = pytest.importorskip("xarray")
    said = lambda unit: xarray.DataArray(np.ones(3), dims="time", attrs={"units": unit})
    with refused("velocity: expected numbers in m/s, got numbers in 'mm/s'"):
        gx.Traces(np.arange(3.0), velocity=said("mm/s"), sites=0)
    with refused("times: expected numbers in s, got numbers in 'us'"):
        gx.Traces(said("us"), velocity=np.ones(3), sites=0)
    for unit in ("m/s", "m s^-1", "scaled", "", "meters a second", None):
        assert_array_equal(gx.Traces(np.arange(3.0), velocity=said(unit), sites=0).data, 1)


def test_a_scene_that_jax_cannot_trace_is_told_why():
    traces = gx.Traces(FEW, velocity=np.zeros((len(FEW), 1)), sites=1, sigma=0.01)
    with refused("scene: expected a function that returns a Lattice, got None"):
        gx.fit(lambda p: None, {"stiffness": 1.0}, traces, state=FLICKED)
    with pytest.raises(jax.errors.TracerArrayConversionError) as caught:
        gx.fit(
            lambda p: short_chain({"stiffness": np.sqrt(p["stiffness"])}),
            {"stiffness": 1.0},
            traces,
            state=FLICKED,
        )
    assert any("write jax.numpy for numpy" in note for note in caught.value.__notes__)


@pytest.mark.slow
def test_what_cannot_be_meant_is_refused(short):
    times, _, v = short

    def seen(times=times, **how):
        return gx.Traces(times, **{"velocity": v[:, [1]], "sites": 1, **how})

    good = seen(sigma=0.01)
    alone = {"stiffness": 1.0}
    for words, traces, start, how in (
        ("bounds: expected one of 'stiffness'", good, alone, {"bounds": {"stifness": (0, None)}}),
        ("expected a start above its bound", good, alone, {"bounds": {"stiffness": (2.0, None)}}),
        ("tolerance: expected", good, alone, {"tolerance": -1}),
        ("tolerance: expected", good, alone, {"tolerance": 0.5}),
        ("sites: expected indices within", seen(sites=6), alone, {}),
        ("offset: expected one of", seen(offset="delay"), alone, {}),
        ("gain: expected one number", seen(gain="gain"), alone | {"gain": np.ones(2)}, {}),
        ("field: expected None", seen(field="bead"), alone, {}),
        ("times: expected samples from t0", seen(times - 1), alone, {}),
        ("sigma: expected one for each", [good, seen()], alone, {}),
        ("sigma: expected a number for windows", seen(), alone, {"windows": 3}),
        ("windows: expected", good, alone, {"windows": 100}),
        ("windows: expected a whole number not below 1", good, alone, {"windows": 2.5}),
        ("starts: expected a whole number not below 1, got 0", good, alone, {"starts": 0}),
        ("starts: expected a whole number", good, alone, {"starts": 2.5}),
        ("max_steps: expected a whole number", good, alone, {"max_steps": 2.5}),
        ("max_steps: expected a whole number not below 1", good, alone, {"max_steps": 0}),
        ("traces: expected Traces, or a list of them, got none", [], alone, {}),
        (r"bounds\['stiffness'\]: expected \(low", good, alone, {"bounds": {"stiffness": 0.5}}),
        (r"got \(0, None, 1\)", good, alone, {"bounds": {"stiffness": (0, None, 1)}}),
        (
            "a value for 'speed', which the state looks up, got 'stiffness'",
            good,
            alone,
            {"state": lambda p, chain: gx.states.impact(chain, p["speed"])},
        ),
        # in another unit of time
        ("expected times in the lattice's unit", seen(1e7 * times), alone, {}),
        ("expected times in the lattice's unit", seen(1e-9 * times), alone, {}),
    ):
        with refused(words):
            gx.fit(short_chain, start, traces, **{"state": FLICKED, **how})
    # without a precompression the unit of time follows from the energy
    sonic = lambda p: gx.scenes.monomer(6, stiffness=p["stiffness"]).counted_in("SI")
    for factor in (1e7, 1e-9):
        with refused("traces: expected times in seconds"):
            gx.fit(sonic, alone, seen(factor * times), state=FLICKED)
    with refused("velocity: expected shape"):
        seen(velocity=v)
    with refused(r"write sites=\[0, 2\]"):
        seen(velocity=v[:, [0, 2]], sites=(0, 2))
    with refused("sites= of sensor beads or contacts=, where the force was measured, got none"):
        seen(velocity=None, force=v[:, [1]], sites=None)
    with refused("rising times"):
        seen(times[::-1])
    two = v[:, [1, 2]]
    assert seen(velocity=two, sites=np.array([1, 2])).places == ((1,), (2,))
    assert seen(velocity=two, sites=((0, 1), (2, 3))).places == ((0, 1), (2, 3))


def test_coordinates_keep_bounds_and_know_their_slopes():
    start = {"a": np.array([1.0, 0.0]), "b": 2.0, "c": -1.0, "d": 0.3}
    at = Coordinates(start, {"b": (0, None), "c": (None, 0.0), "d": (0.0, 1.0)})
    assert at.names == ["a[0]", "a[1]", "b", "c", "d"] and at.size == 5
    begin = at.parameters(jnp.zeros(5))
    assert all(np.allclose(begin[name], start[name], rtol=0, atol=1e-15) for name in start)
    for x in (jnp.full(5, 9.0), jnp.full(5, -9.0)):
        p = at.parameters(x)
        assert p["b"] > 0 and p["c"] < 0 and 0 < p["d"] < 1
    x = jnp.array([0.3, -0.2, 0.5, -0.4, 0.1])
    slopes = jnp.diag(jax.jacfwd(lambda x: at.flat(at.parameters(x)))(x))
    assert np.allclose(at.slopes(x), slopes, rtol=1e-14)


CSV = """\
# recorder 7
Time (us),Bead 3 [mm/s],Bead 7 [V],Load,Note,When
0,0,0.1,1,0,2026-01-01 12:00:00
5,20,0.3,,over,2026-01-01 12:00:02
15,60,-0.2,3,1,2026-01-01 12:00:03
"""


@pytest.fixture
def read(tmp_path):
    def read(read={}, sites=0, **how):
        (tmp_path / "a.csv").write_text(CSV)
        how |= {"read": {"comment": "#", **read}} | ({} if "contacts" in how else {"sites": sites})
        return gx.Traces.from_csv(tmp_path / "a.csv", **how)

    return read


def test_columns_of_a_table_are_read_in_si(read):
    two = ["Bead 3", "Bead 7"]
    traces = read(velocity=two, sites=[3, 7], units={"Bead 7": 0.025}, sigma=1e-3)
    assert_allclose(traces.times, [0, 5e-6, 15e-6], rtol=1e-15)
    assert_allclose(traces.data, [[0, 0.0025], [0.02, 0.0075], [0.06, -0.005]], rtol=1e-15)
    assert traces.kind == "velocity" and traces.places == ((3,), (7,)) and traces.sigma == 1e-3
    force = read(time=0, force=3, contacts=0, units={3: "kN"}, offset="delay")
    assert_array_equal(force.data[:, 0], [1e3, np.nan, 3e3])
    assert force.offset == "delay" and float(force.weights[1, 0]) == 0.0
    moved = read(displacement="Load", units={"Load": "\u00b5m", "Time": 2.0})
    assert_allclose(moved.data[::2, 0], [1e-6, 3e-6], rtol=1e-15)
    assert_array_equal(moved.times, [0, 10, 30])
    noted = read({"na_values": ["over"]}, velocity="Note", units={"Note": "m/s"})
    assert_array_equal(noted.data[:, 0], [0, np.nan, 1])
    dated = read({"parse_dates": ["When"]}, time="When", velocity="Bead 3")
    assert dated.times.tolist() == [0.0, 2.0, 3.0]


@pytest.mark.parametrize("kind", [np.float32, np.int64, np.asarray, jnp.asarray])
def test_columns_and_units_are_numbers_of_any_kind(read, kind):
    for column in (1, np.int64(1), np.arange(1, 2), [1]):
        traces = read(velocity=column, time=np.int64(0), units={1: kind(2)}, sites=[3])
        assert_array_equal(traces.data[:, 0], [0, 40, 120])


@pytest.mark.parametrize(
    "keywords, said",
    [
        ({"velocity": "Bead 7"}, r"unit of 'Bead 7 \[V\]', such as m/s, or its size .*got 'V'"),
        ({"velocity": "Load"}, "got None. Give units={'Load': 'm/s'}"),
        ({"velocity": "Bead 33"}, r"velocity: expected one of .*Did you mean 'Bead 3 \[mm/s\]'"),
        ({"velocity": "Bead 3", "units": {"bead 3": "m/s"}}, "expected columns that are read"),
        ({"velocity": "Bead 3", "force": 3, "units": {3: "N"}}, "data: expected one of velocity="),
        ({"velocity": "Note"}, "'Note', which holds text"),
    ],
)
def test_a_column_that_is_not_understood_is_refused(keywords, said, read):
    with refused(said):
        read(**keywords)


def test_dates_and_time_differences_are_seconds():
    dates = np.datetime64("2026-01-01T12:00") + np.arange(3) * np.timedelta64(250, "us")
    for times in (dates, dates - dates[0], dates.tolist(), (dates - dates[0]).tolist()):
        traces = gx.Traces(times, velocity=np.zeros(3), sites=0)
        assert_allclose(traces.times, [0, 2.5e-4, 5e-4], rtol=1e-12)


@pytest.mark.slow
def test_a_law_of_free_shape_is_found_from_traces():
    """A spline finds the force of Hertz contacts to 1 % of its largest over the strains visited, with 1 % of noise.

    The record is taken up in parts that double, so that no phase is lost by a whole turn on the way.
    """
    sensors = [1, 4, 7, 10, 13, 16]
    path, strains = by_dop853(1.5, TIMES[-1], 0.02)
    seen = strains(path(np.linspace(0, TIMES[-1], 8001))[:N])
    low = seen.min()
    high = seen.max()
    velocity, sigma = noisy(path(TIMES)[N:][sensors].T, 0)
    knots = np.linspace(1.2 * low, 1.2 * high, 7)
    names = [f"c{i}" for i in range(8)]
    law = lambda p: gx.Spline(knots, jnp.stack([p[name] for name in names]))
    free = lambda p: gx.Lattice(1.0, (gx.Bond(WALLS, law(p)), gx.Damping(0.02)), sites=N)
    state = gx.State(np.zeros(N), np.r_[1.5, np.zeros(N - 1)])
    start = dict.fromkeys(names, 1.8)
    bounds = dict.fromkeys(names, (0.0, None))
    for part in (50, 100, 200, 400):
        data = np.where(TIMES[:, None] < TIMES[part - 1] + 1e-9, velocity, np.nan)
        traces = gx.Traces(TIMES, velocity=data, sites=sensors, sigma=sigma)
        found = gx.fit(free, start, traces, state=state, bounds=bounds, throw=part == 400)
        # a number that a part does not see may have come to its bound, where no search can begin
        start = {name: x + 1e-3 * (1.8 - x) for name, x in found.parameters.items()}
    e = np.linspace(low, high, 301)
    true = np.maximum(1 + e, 0) ** 1.5 - 1
    assert np.abs(law(found.parameters).force(e) - true).max() < 0.01 * np.abs(true).max()
    assert abs(found.reduced_chi_square - 1) < 0.1


def struck_dimer(p):
    return gx.scenes.dimer(12, ratio=0.5, stiffness=p["stiffness"])


@pytest.mark.slow
def test_a_fit_through_adaptive_runs():
    """Of a struck sonic vacuum: the truth within its deviations, which are those of a short fixed step."""
    times = np.linspace(0.5, 20.0, 79)
    truth = {"stiffness": 1.3, "velocity": 0.8}
    guess = {"stiffness": 1.0, "velocity": 0.75}
    chain = struck_dimer(truth)
    v = gx.simulate(chain, struck(truth, chain), 20.0, save_at=times, tolerance=1e-11).vs
    noise = 1e-3 * np.random.default_rng(0).normal(size=(79, 2))
    traces = gx.Traces(times, velocity=v[:, [3, 7]] + noise, sites=[3, 7], sigma=1e-3)
    fit = lambda **how: gx.fit(struck_dimer, guess, traces, state=struck, **how)
    found = fit(run_tolerance=1e-8)
    assert off(found, truth) < 4
    assert found.step_error < 1e-2 and "adaptive, tolerance 1e-08" in repr(found)
    assert_allclose(found.covariance, fit(step=0.02).covariance, rtol=1e-2)
    for options in ({"windows": 2}, {"method": "gradient"}, {"step": 0.1}):
        with refused("run_tolerance"):
            fit(run_tolerance=1e-8, **options)


@pytest.mark.slow
def test_a_fit_through_adaptive_runs_with_damping():
    """Two beads that move alike: v = e^(-g t/2) (cos w t - g/(2 w) sin w t), w^2 = K - g^2/4."""
    rate, K = 0.2, 1.3
    times = np.linspace(0, 6, 61)
    w = np.sqrt(K - rate**2 / 4)
    v = np.exp(-rate * times / 2) * (np.cos(w * times) - rate / (2 * w) * np.sin(w * times))
    traces = gx.Traces(times, velocity=v, sites=0, sigma=1e-3)
    terms = lambda p: (gx.Bond(WALLS, gx.Linear(p["K"])), gx.Damping(p["rate"]))
    pair = lambda p: gx.Lattice(1.0, terms(p), sites=2)
    state = gx.State(np.zeros(2), np.ones(2))
    found = gx.fit(pair, {"K": 1.0, "rate": 0.1}, traces, state=state, run_tolerance=1e-9)
    assert_allclose([*found.parameters.values()], [K, rate], rtol=1e-6)


@pytest.mark.slow
def test_a_fit_in_the_plane():
    """Of a struck packing, with sensors that see one component each."""
    scene = lambda p: gx.scenes.triangular(4, 5, stiffness=p["stiffness"], precompression=p["load"])
    truth = {"stiffness": 1.2, "load": 0.4}
    lattice = scene(truth)
    times = np.linspace(0.2, 12.0, 60)
    state = gx.State(lattice.zeros(), lattice.zeros().at[1, 2].set(jnp.array([0.1, 0.05])))
    v = np.asarray(gx.simulate(lattice, state, 12.0, save_at=times, step=0.05).vs)[:, 2, 3]
    v = v + 3e-4 * np.random.default_rng(0).normal(size=(2, 60)).T
    sensor = lambda i: dict(velocity=v[:, i], sites=[(2, 3)], component=i, sigma=3e-4)
    traces = [gx.Traces(times, **sensor(i)) for i in (0, 1)]
    found = gx.fit(scene, {"stiffness": 1.0, "load": 0.5}, traces, state=state, step=0.1)
    assert off(found, truth) < 4


def test_sensors_are_told_apart_by_specimen_component_and_bond():
    times, zeros = np.arange(3.0), np.zeros(3)
    traces = lambda **how: gx.Traces(times, sigma=1.0, **how).sensors
    names = [
        *(traces(velocity=zeros, sites=2, field=field) for field in (None, "soft", "hard")),
        *(traces(velocity=zeros, sites=(2, 3), component=i) for i in (0, 1)),
        traces(velocity=zeros, sites=2, field="bead", component=2),
        *(traces(force=zeros, contacts=2, bond=bond) for bond in (0, 1)),
    ]
    assert [name for (name,) in names] == [
        "velocity of site 2",
        "velocity of site 2, soft",
        "velocity of site 2, hard",
        "velocity of site (2, 3), x",
        "velocity of site (2, 3), y",
        "velocity of site 2, bead, z",
        "force of contact 2",
        "force of contact 2, bond 1",
    ]


PLANNED = {"stiffness": 1.0, "precompression": 0.5, "damping": 0.05}
EVERYWHERE = gx.Traces(
    np.linspace(0, 20, 101), velocity=np.zeros((101, 7)), sites=range(7), sigma=1e-3
)


@pytest.mark.slow
def test_information_is_that_of_the_fit_and_its_best_sensors_are_the_best_of_all():
    planned = lambda p: scene(p, 7)
    chain = planned(PLANNED)
    tapped = gx.states.impact(chain, velocity=0.1)
    found = gx.information(planned, PLANNED, EVERYWHERE, state=tapped, step=0.1)
    v = gx.simulate(chain, tapped, 20.0, step=0.1, save_at=EVERYWHERE.times).vs
    traces = gx.Traces(EVERYWHERE.times, velocity=v, sites=range(7), sigma=1e-3)
    fitted = gx.fit(planned, PLANNED, traces, state=tapped, step=0.1)
    assert found.names == fitted.names
    assert_allclose(found.covariance, fitted.covariance, rtol=1e-6)
    size = np.asarray(found.values)
    each = np.asarray(found.matrix) * size[:, None] * size
    value = lambda some: np.linalg.slogdet(each[list(some)].sum(0))[1]
    for count in (1, 2, 3):
        most = max(map(value, itertools.combinations(range(7), count)))
        best = found.best(count)
        assert value(best.places) == most and float(best.log_det) == pytest.approx(most, rel=1e-10)
    assert found.best(7).places == tuple(range(7)) and found.best(2).determined
    assert "would determine stiffness = 1 +-" in found.outcome
    with refused("at most 7"):
        found.best(8)
    still = gx.information(planned, PLANNED, EVERYWHERE, state=gx.states.rest(chain), step=0.1)
    assert "1 sensor does not determine" in still.best(1).outcome
    assert not still.determined and "do not determine" in still.outcome


@pytest.mark.slow
def test_what_sensors_determine_does_not_depend_on_the_unit_of_a_parameter():
    """A chain of steel in SI: a stiffness of 1e10, and a delay of 0 or 1e-12 s, whose size says nothing."""
    law = lambda p: gx.Hertz(p["stiffness"], p["load"])
    chain = lambda p: gx.Lattice(0.029, gx.Bond(WALLS, law(p)), sites=10, units="SI")
    hit = gx.State(np.zeros(10), 0.02 * np.eye(10)[0])
    times = np.linspace(0, 1e-3, 301)
    where = dict(velocity=np.zeros((301, 10)), sites=range(10), sigma=1e-5, offset="delay")
    start = {"stiffness": 9.8e9, "load": 10.0, "delay": 1e-12}
    found = gx.information(chain, start, gx.Traces(times, **where), state=hit)
    # singular values of columns of unit length, instead of the inverse of a matrix
    columns = np.linalg.cholesky(np.asarray(found.matrix.sum(0))).T
    lengths = np.linalg.norm(columns, axis=0)
    inverse = np.linalg.pinv(columns / lengths) / lengths[:, None]
    each = np.asarray(found.matrix) / lengths[:, None] / lengths
    value = lambda some: np.linalg.slogdet(each[list(some)].sum(0))[1]
    for delay in (1e-12, 0.0, 1.0):
        same = eqx.tree_at(lambda i: i.values, found, jnp.array([9.8e9, 10.0, delay]))
        assert same.determined and "would determine" in same.outcome
        assert_allclose([*same.deviations.values()], np.linalg.norm(inverse, axis=1), rtol=1e-6)
        assert same.best(2).places == max(itertools.combinations(range(10), 2), key=value)


@pytest.mark.slow
def test_a_drive_is_designed_for_the_information_that_it_brings():
    times = np.linspace(0, 20, 41)
    traces = gx.Traces(times, velocity=np.zeros((41, 4)), sites=range(4), sigma=1e-3)

    def worth(frequency):
        drive = gx.Drive(lambda t: 0.01 * jnp.sin(frequency * t), 0)
        driven = lambda q: gx.Lattice(1.0, (*scene(q, 4).terms, drive), sites=4)
        rest = gx.states.rest(scene({}, 4))
        how = dict(state=rest, step=0.1, solver=gx.VelocityVerlet())
        return gx.information(driven, PLANNED, traces, **how).log_det

    how = dict(bounds={"frequency": (0.4, 1.2)}, maximise=True, mode="reverse", max_steps=8)
    found = gx.design(lambda p: worth(p["frequency"]), {"frequency": 0.8}, **how)
    ends = [float(worth(x)) for x in (0.8 - 1e-4, 0.8 + 1e-4)]
    # of the free coordinate, by which the frequency changes as (0.8 - 0.4) (1.2 - 0.8)/0.8 there
    slope = 0.2 * np.diff(ends)[0] / 2e-4
    assert_allclose(np.abs(found.start_gradient[0]), np.abs(slope), rtol=1e-5)
    assert found.value > found.start_value + 1


@pytest.mark.slow
def test_information_has_derivatives_outside_a_compiled_program():
    """By the stiffness of a ground spring: they are those of differences, and a step is asked for."""
    times = np.linspace(0, 6, 31)
    seen = gx.Traces(times, velocity=np.zeros((31, 2)), sites=[0, 2], sigma=1e-2)
    begin = gx.State(np.zeros(3), np.eye(3)[0])

    def worth(spring, step=0.1):
        bond = lambda p: gx.Bond(WALLS, gx.Polynomial(p["K"], 0.0, p["beta"]))
        on_site = gx.OnSite(gx.Linear(spring))
        held = lambda p: gx.Lattice(1.0, (bond(p), on_site), sites=3)
        start = {"K": 1.0, "beta": 0.4}
        return gx.information(held, start, seen, state=begin, step=step).log_det

    ends = [float(worth(x)) for x in (0.3 - 1e-4, 0.3 + 1e-4)]
    slope = np.diff(ends)[0] / 2e-4
    assert_allclose([jax.grad(worth)(0.3), jax.jacfwd(worth)(0.3)], slope, rtol=1e-6)
    assert_allclose(jax.vmap(worth)(jnp.array([0.3 - 1e-4, 0.3 + 1e-4])), ends, rtol=1e-12)
    with refused("step: expected a time step within"):
        jax.grad(lambda x: worth(x, None))(0.3)


def test_the_whiteness_of_residuals_is_that_of_ljung_and_box_by_hand():
    """Five residuals and one lag: r_1 = -3/4 of 1, -1, 1, -1, 0, and n (n + 2) r_1^2/(n - 1) of chi^2_1."""
    x = np.array([1.0, -1.0, 1.0, -1.0, 0.0])
    r = -3 / 4
    assert _ljung_box(x) == pytest.approx(chi2.sf(5 * 7 * r**2 / 4, 1), rel=1e-12)
