"""`fit`: parameters from traces that SciPy made, their errors, what is not determined, what is refused."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from cases import by_dop853
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused
from scipy.integrate import solve_ivp

import granjax as gx
from granjax.fit.parameters import Coordinates
from granjax.fit.problem import prepared
from granjax.fit.solve import STALLED, least_squares
from granjax.fit.windows import cut

N, SITES = 20, [2, 7, 12, 17]
TIMES = np.linspace(0.1, 40.0, 400)
TRUTH = {"stiffness": 1.0, "exponent": 1.5, "damping": 0.05, "precompression": 1.0}
START = {"stiffness": 1.15, "exponent": 1.4, "damping": 0.03, "precompression": 0.85}


def scipy_motion(
    times, velocity, sites=N, stiffness=1.0, exponent=1.5, damping=0.05, precompression=1.0
):
    """(u, v) of a chain between walls after an impact, by DOP853."""
    d0 = (precompression / stiffness) ** (1 / exponent)

    def rate(t, y):
        u, v = y[:sites], y[sites:]
        e = np.concatenate([[-u[0]], u[:-1] - u[1:], [u[-1]]])
        force = stiffness * (np.maximum(d0 + e, 0) ** exponent - d0**exponent)
        return np.concatenate([v, force[:-1] - force[1:] - damping * v])

    start = np.zeros(2 * sites)
    start[sites] = velocity
    y = solve_ivp(
        rate, (0, times[-1]), start, method="DOP853", rtol=1e-11, atol=1e-13, t_eval=times
    ).y
    return y[:sites].T, y[sites:].T


def scene(p):
    law = gx.PowerLaw(p["stiffness"], p["exponent"], p["precompression"])
    return gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "fixed"), law), gx.Damping(p["damping"])), sites=N)


def struck(p, chain):
    return gx.states.impact(chain, 1.0)


def tapped(p, chain):
    return gx.states.impact(chain, 1e-3)


def noisy(clean, seed, share=0.01):
    sigma = share * np.abs(clean).max()
    return clean + sigma * np.random.default_rng(seed).normal(size=clean.shape), sigma


@pytest.fixture(scope="module")
def velocities():
    return scipy_motion(TIMES, 1.0)[1][:, SITES]


def traced(velocities, seed):
    data, sigma = noisy(velocities, seed)
    return gx.Traces(TIMES, velocity=data, sites=SITES, sigma=sigma)


@pytest.mark.study
def test_each_parameter_is_within_two_deviations_in_most_of_many_draws(
    velocities, draws=100, least=88, most=99
):
    inside = {name: 0 for name in TRUTH}
    for seed in range(draws):
        fit = gx.fit(scene, START, traced(velocities, seed), state=struck)
        assert fit.converged and not fit.undetermined
        for name, true in TRUTH.items():
            inside[name] += abs(float(fit.parameters[name]) - true) < 2 * float(
                fit.deviations[name]
            )
    assert all(least <= count <= most for count in inside.values()), inside


@pytest.mark.slow
def test_a_fit_of_noisy_traces(velocities, tmp_path):
    fit = gx.fit(scene, START, traced(velocities, 1), state=struck)
    assert tuple(START) == fit.names == tuple(fit.parameters)
    errors = np.array([float(fit.parameters[name]) - TRUTH[name] for name in fit.names])
    pull = errors / np.sqrt(np.diag(fit.covariance))
    assert np.allclose(list(fit.deviations.values()), np.sqrt(np.diag(fit.covariance)))
    assert np.abs(pull).max() < 3
    # stiffness and precompression go together along A p d0^(p-1)
    assert np.allclose(np.diag(fit.correlations), 1) and fit.correlations[0, 3] < -0.9
    assert fit.reduced_chi_square == pytest.approx(1.0, abs=4 * np.sqrt(2 / fit.samples))
    assert fit.samples == 1600 and (fit.whiteness()[0] > 1e-3).all()
    assert fit.step_error < 1e-3 and fit.return_error < 1e-10
    assert "Converged" in fit.outcome and fit.lattice.sites == (N,)
    assert np.abs(np.asarray(fit.signals[0]) - velocities).max() < 0.01 * np.abs(velocities).max()
    kept = xr.load_dataset(fit.save(tmp_path / "fit.nc"))
    assert kept.data_0.attrs == {"units": "scaled", "si_units": "m/s"}
    assert kept.parameter.values.tolist() == list(START) and kept.attrs["outcome"] == fit.outcome
    assert kept.signal_0.dims == kept.data_0.dims == ("time_0", "sensor_0")
    assert (
        kept.attrs["deviations_damping"] == fit.deviations["damping"]
        and "stiffness" in repr(fit).splitlines()[0]
    )


@pytest.mark.study
def test_small_strains_determine_the_linear_stiffness_alone():
    data, sigma = noisy(scipy_motion(TIMES, 1e-3)[1][:, SITES], 0)
    fit = gx.fit(
        scene,
        START,
        gx.Traces(TIMES, velocity=data, sites=SITES, sigma=sigma),
        state=tapped,
        throw=False,
    )
    said = " ".join(fit.undetermined)
    assert "A p d0^(p-1)" in said
    assert (
        all(name in said for name in ("stiffness", "exponent", "precompression"))
        and "damping" not in said
    )
    p = {name: float(x) for name, x in fit.parameters.items()}
    linear = (
        p["exponent"]
        * p["stiffness"] ** (1 / p["exponent"])
        * p["precompression"] ** (1 - 1 / p["exponent"])
    )
    assert linear == pytest.approx(1.5, rel=1e-3)
    assert "A p d0" in fit.outcome


def power(p, exponent=1.5):
    law = gx.PowerLaw(p["A"], exponent, p["F0"])
    return gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), law), sites=5)


def magnets(p):
    return power(p, -4.0)


def quintic(p):
    return power(p, 2.5)


def quadratic(p):
    return gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Polynomial(1.0, p["alpha"])), sites=5)


def linear(p):
    return gx.Lattice(p["m"], gx.Bond(gx.Shift(1, "fixed"), gx.Linear(p["K"])), sites=5)


def kicked(p, chain):
    return gx.states.impact(chain, p["v"])


# u -> lambda u: the start, what is measured there (SciPy), and what no trace of a sensor without a gain tells apart
SCALINGS = {
    "Hertz": (
        power,
        {"A": 1.3, "F0": 0.8, "v": 0.5, "gain": 1.2},
        lambda e: (1 + e) ** 1.5 - 1,
        ["A^0.50 F0^-1.00 v^-1.00 gain"],
    ),
    "another power": (
        quintic,
        {"A": 0.9, "F0": 1.2, "v": 0.35, "gain": 0.9},
        lambda e: (1 + e) ** 2.5 - 1,
        ["A F0^-0.67 v^-0.67 gain^0.67"],
    ),
    "magnets": (
        magnets,
        {"A": 1.1, "F0": 0.9, "v": 0.3, "gain": 1.4},
        lambda e: (1 - e) ** -4.0 - 1,
        ["A F0^0.20 v^0.20 gain^-0.20"],
    ),
    "FPUT": (
        quadratic,
        {"alpha": 0.4, "v": 0.6, "gain": 0.7},
        lambda e: e + 0.6 * e * e,
        ["alpha v^-1.00 gain"],
    ),
    "two at once": (
        linear,
        {"K": 1.4, "m": 1.2, "v": 0.2, "gain": 1.5},
        lambda e: e,
        ["K m", "v gain^-1.00"],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", SCALINGS)
def test_exponents_of_what_is_not_determined_are_those_of_a_scaling(case):
    make, start, force, expected = SCALINGS[case]
    times, sites = np.linspace(0.1, 12.0, 60), 5

    def rate(t, y):
        u = np.concatenate([[0.0], y[:sites], [0.0]])
        bonds = force(u[:-1] - u[1:])
        return np.concatenate([y[sites:], bonds[:-1] - bonds[1:]])

    struck_at = np.zeros(2 * sites)
    struck_at[sites] = 0.4
    y = solve_ivp(rate, (0, 12.0), struck_at, "DOP853", times, rtol=1e-10, atol=1e-12).y
    traces = gx.Traces(
        times, velocity=y[[sites + 1, sites + 3]].T, sites=[1, 3], sigma=1e-3, gain="gain"
    )
    fit = gx.fit(make, start, traces, state=kicked)
    assert fit.reduced_chi_square < 1e-2
    # the start was not the truth, and the search ends elsewhere on the line
    assert abs(fit.parameters["gain"] - 1) > 0.03
    said = " ".join(fit.undetermined)
    assert all(f"{words} is known not at all" in said for words in expected), said
    assert said.count("known not at all") == len(expected)


@pytest.mark.slow
def test_a_parameter_that_is_zero_is_determined():
    """A chain without the quadratic term: its relative error is large, its error is not."""
    times = np.linspace(0.1, 12.0, 60)
    omega = 2 * np.sin(np.arange(1, 6) * np.pi / 12)
    shapes = np.sin(np.pi / 6 * np.outer(np.arange(1, 6), np.arange(1, 6)))
    clean = (
        0.4
        / 3
        * np.einsum("kt,k,ks->ts", np.cos(np.outer(omega, times)), shapes[:, 0], shapes)[:, [1, 3]]
    )
    data, sigma = noisy(clean, 3)
    fit = gx.fit(
        quadratic,
        {"alpha": 0.3, "v": 0.5},
        gx.Traces(times, velocity=data, sites=[1, 3], sigma=sigma),
        state=kicked,
    )
    assert (
        abs(fit.parameters["alpha"]) < 4 * fit.deviations["alpha"] < 0.02 and not fit.undetermined
    )


@pytest.mark.slow
def test_a_residue_beyond_noise_is_said():
    """Traces of contacts, which springs and a parabola do not have, with and without noise, of a known size or not."""
    times, sites = np.linspace(0.1, 20.0, 150), [1, 4]
    clean = scipy_motion(times, 0.6, 6, damping=0.0)[1][:, sites]
    law = lambda p: gx.Polynomial(p["K2"], p["K3"])
    chain = lambda p: gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), law(p)), sites=6)
    contacts = lambda p: gx.Lattice(
        1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(p["A"], 1.0)), sites=6
    )
    state = gx.states.impact(chain({"K2": 1.5, "K3": 0.3}), 0.6)
    for size, sigma in ((0.0, None), (1e-4, None), (1e-4, 1e-4)):
        data = clean + size * np.random.default_rng(2).normal(size=clean.shape)
        traces = gx.Traces(times, velocity=data, sites=sites, sigma=sigma)
        wrong = gx.fit(chain, {"K2": 1.4, "K3": 0.2}, traces, state=state, throw=False)
        assert "A residue beyond noise is left" in wrong.outcome
        right = gx.fit(contacts, {"A": 0.95}, traces, state=state)
        assert "residue" not in right.outcome


def spring(p):
    law = gx.Hertz(p["stiffness"], 1.0)
    return gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "fixed"), law), gx.Damping(0.05)), sites=6)


def flicked(p, chain):
    return gx.states.impact(chain, p["velocity"])


@pytest.fixture(scope="module")
def short():
    times = np.linspace(0.0, 15.0, 151)
    return times, *scipy_motion(times, 0.4, sites=6)


@pytest.mark.study
def test_several_kinds_with_gain_offset_and_unknown_impact(short):
    times, u, v = short
    late = times[:120]  # a recorder that was started at 1.3
    chain = spring({"stiffness": 1.0})
    fine = scipy_motion(late + 1.3, 0.4, sites=6)
    force = np.stack([gx.measures.contact_force(chain, (u, v)) for u, v in zip(*fine)])[:, [1, 4]]
    traces = [
        gx.Traces(
            late,
            displacement=2.5 * fine[0][:, [2]],
            sites=2,
            sigma=1e-3,
            gain="gain",
            offset="offset",
        ),
        gx.Traces(late, force=force, contacts=[1, 4], sigma=1e-3, offset="offset"),
        gx.Traces(late, velocity=fine[1][:, [-1]], sites=[-1], sigma=1e-3, offset="offset"),
    ]
    start = {"stiffness": 1.1, "velocity": 0.35, "gain": 2.0, "offset": 1.0}
    fit = gx.fit(
        spring, start, traces, state=flicked, bounds={"stiffness": (0, None), "gain": (1.0, 4.0)}
    )
    for name, true in {"stiffness": 1.0, "velocity": 0.4, "gain": 2.5, "offset": 1.3}.items():
        assert float(fit.parameters[name]) == pytest.approx(true, rel=2e-5)


def per_bond(p):
    return gx.scenes.monomer(6, mass=p["mass"], stiffness=p["stiffness"], precompression=1.0)


@pytest.mark.study
def test_a_parameter_of_every_bond_and_missing_samples():
    stiffness = np.array([1.0, 1.2, 0.9, 1.1, 1.3, 0.8, 1.0])
    chain = per_bond({"mass": 1.0, "stiffness": stiffness})
    state = gx.states.impact(chain, 0.3)
    run = gx.simulate(chain, state, 20.0, step=0.01, save_at=200)
    data = np.array(run.us)
    data[30:60, 2] = np.nan
    traces = gx.Traces(run.ts, displacement=data, sites=range(6), sigma=1e-3)
    start = {"mass": 1.0, "stiffness": np.full(7, 1.05)}
    fit = gx.fit(per_bond, start, traces, state=state)
    assert fit.names[1:3] == ("stiffness[0]", "stiffness[1]") and fit.samples == 200 * 6 - 30
    assert np.allclose(fit.parameters["stiffness"], stiffness, rtol=1e-4)
    assert float(fit.parameters["mass"]) == pytest.approx(1.0, rel=1e-4)


@pytest.mark.slow
def test_several_starts_and_an_unknown_noise(short):
    times, _, v = short
    data, sigma = noisy(v[:, [1, 4]], 3)
    traces = gx.Traces(times, velocity=data, sites=[1, 4])
    fit = gx.fit(
        spring,
        {"stiffness": 1.0},
        traces,
        state=gx.states.impact(spring({"stiffness": 1.0}), 0.4),
        starts=4,
    )
    assert len(fit.starts) == 4 and "4 of 4 starts" in fit.outcome
    assert fit.noise == pytest.approx(sigma, rel=0.1)
    assert abs(float(fit.parameters["stiffness"]) - 1) < 3 * float(fit.deviations["stiffness"])


@pytest.mark.study
def test_an_offset_that_grows_and_a_bound_that_holds(short):
    times, _, v = short
    moved = np.linspace(0.0, 9.0, 91)
    late = scipy_motion(moved + 5.1, 0.4, sites=6)[1][:, [1, 4]]
    traces = gx.Traces(moved, velocity=late, sites=[1, 4], sigma=1e-3, offset="offset")
    state = gx.states.impact(spring({"stiffness": 1.0}), 0.4)
    fit = gx.fit(spring, {"stiffness": 1.0, "offset": 4.1}, traces, state=state)
    assert float(fit.parameters["offset"]) == pytest.approx(5.1, rel=1e-5)
    assert float(fit.parameters["stiffness"]) == pytest.approx(1.0, rel=1e-5)
    traces = gx.Traces(times, velocity=v[:, [1]], sites=1, sigma=1e-3)
    for bounds in ((0.5, 0.9), (None, 0.9)):
        held = gx.fit(
            spring,
            {"stiffness": 0.8},
            traces,
            state=state,
            bounds={"stiffness": bounds},
            throw=False,
        )
        assert "At its bound" in held.outcome and float(held.parameters["stiffness"]) <= 0.9


class Edge(eqx.Module):
    """Residuals x - 2 and 0.1, NaN beyond x = 1."""

    traces: tuple = ()
    dtype = jnp.dtype("float64")

    def linearise(self, x):
        ahead = jnp.where(x[0] > 1, jnp.nan, x[0] - 2)
        return jnp.stack([ahead, jnp.asarray(0.1)]), jnp.array([[1.0], [0.0]]), ()


def test_the_edge_of_what_is_finite_is_no_minimum(capsys):
    found = least_squares(Edge(), np.zeros(1), 1e-8, 100, delay=0)
    assert "fit:" in capsys.readouterr().err  # a bar of the steps that are left
    assert found.code == STALLED and 0.999 < found.x[0] <= 1


@pytest.mark.slow
def test_another_minimum_than_the_one_sought_says_so():
    """A cosine beside one of another frequency explains none of it; where noise is most of the trace none does."""
    scene = lambda p: gx.Lattice(
        1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Linear(p["stiffness"])), sites=2
    )
    state = gx.State(np.ones(2), np.zeros(2))
    times, noise = np.linspace(0, 60, 121), np.random.default_rng(0).normal(size=121)

    def outcome(start, deviation, sigma):
        traces = gx.Traces(
            times, displacement=np.cos(1.2**0.5 * times) + deviation * noise, sites=0, sigma=sigma
        )
        return gx.fit(scene, {"stiffness": start}, traces, state=state, throw=False).outcome

    assert "unless noise" in outcome(3.0, 0.01, None)
    said = outcome(3.0, 0.01, 0.01)
    assert "another minimum" in said and "unless" not in said
    assert "minimum" not in outcome(1.1, 0.01, 0.01) + outcome(3.0, 3.0, 3.0)


@pytest.mark.study
def test_descent_reaches_what_least_squares_reach(short):
    times, _, v = short
    traces = gx.Traces(times, velocity=noisy(v[:, [1, 4]], 3)[0], sites=[1, 4], sigma=1e-3)
    how = {"state": flicked, "bounds": {"stiffness": (0, None)}}
    start = {"stiffness": 1.1, "velocity": 0.38}
    wanted = gx.fit(spring, start, traces, **how)
    assert wanted.adjoint == "forward mode"
    found = gx.fit(spring, start, traces, method="gradient", **how)
    assert found.adjoint == "Reversible" and found.return_error < 1e-12
    later = gx.Traces(times, velocity=traces.data, sites=[1, 4], sigma=1e-3, offset="offset")
    moved = gx.fit(spring, {**start, "offset": 1e-3}, later, method="gradient", **how)
    assert moved.adjoint == "RecursiveCheckpointAdjoint"
    for name in start:
        near = 0.02 * wanted.deviations[name]
        assert abs(float(found.parameters[name]) - float(wanted.parameters[name])) < near


@pytest.mark.study
def test_the_jacobian_of_windows_is_put_together_rightly(short):
    times, _, v = short
    state = gx.states.impact(spring({"stiffness": 1.0}), 0.4)
    traces = gx.Traces(times, velocity=v, sites=range(6), sigma=0.01)
    windows = cut(prepared(spring, {"stiffness": 1.1}, traces, state=state), 4)
    x = jnp.full(1 + windows.starts.size, 0.01)
    value, blocks, _ = jax.jit(lambda x: windows.linearise(x))(x)
    whole = jax.jit(jax.jacfwd(lambda x: windows.linearise(x)[0]))(x)
    assert blocks.shape == whole.shape == (4 * 38 * 6 + 3 * 12, 1 + 3 * 12)
    assert np.allclose(blocks, whole, rtol=0, atol=1e-11 * np.abs(whole).max())


@pytest.mark.slow
def test_what_cannot_be_meant_is_refused(short):
    times, _, v = short
    chain = spring({"stiffness": 1.0})
    state = gx.states.impact(chain)
    good = gx.Traces(times, velocity=v[:, [1]], sites=1, sigma=0.01)

    def wrong(match, *, scene=spring, start={"stiffness": 1.0}, traces=good, **how):
        with refused(match):
            gx.fit(scene, start, traces, **{"state": state, **how})

    wrong("bounds: expected one of 'stiffness'", bounds={"stifness": (0, None)})
    wrong("stiffness: expected a start above its bound", bounds={"stiffness": (2.0, None)})
    wrong(
        "sites: expected indices within",
        traces=gx.Traces(times, velocity=v[:, [1]], sites=6, sigma=0.01),
    )
    wrong(
        "offset: expected one of",
        traces=gx.Traces(times, velocity=v[:, [1]], sites=1, offset="delay"),
    )
    wrong(
        "times: expected samples from t0", traces=gx.Traces(times - 1, velocity=v[:, [1]], sites=1)
    )
    wrong(
        "sigma: expected one for each", traces=[good, gx.Traces(times, velocity=v[:, [1]], sites=1)]
    )
    wrong("windows: expected", windows=100)
    wrong(
        "gain: expected one number",
        traces=gx.Traces(times, velocity=v[:, [1]], sites=1, gain="gain"),
        start={"stiffness": 1.0, "gain": np.ones(2)},
    )
    wrong(
        "field: expected None", traces=gx.Traces(times, velocity=v[:, [1]], sites=1, field="bead")
    )
    wrong(
        "sigma: expected a number for windows",
        traces=gx.Traces(times, velocity=v[:, [1]], sites=1),
        windows=3,
    )
    assert gx.Traces(times, velocity=v[:, [1, 2]], sites=np.array([1, 2])).places == ((1,), (2,))
    assert gx.Traces(times, velocity=v[:, [1, 2]], sites=((0, 1), (2, 3))).places == (
        (0, 1),
        (2, 3),
    )
    with refused("velocity: expected shape"):
        gx.Traces(times, velocity=v, sites=[1])
    with refused("rising times"):
        gx.Traces(times[::-1], velocity=v, sites=range(6))


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


@pytest.mark.parametrize("tolerance", [-1, 0.5])
def test_a_tolerance_that_every_start_meets_is_refused(tolerance):
    with refused("tolerance: expected"):
        gx.fit(lambda p: None, {"k": 1.0}, [], state=lambda p, lattice: None, tolerance=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1e7, 1e-9])
def test_a_record_in_another_unit_of_time_is_refused_at_once(factor):
    traces = gx.Traces(factor * TIMES, velocity=np.ones((400, 1)), sites=[2], sigma=1.0)
    for state in (struck, tapped):
        with refused("traces: expected times in the lattice's unit of time"):
            gx.fit(scene, START, traces, state=state)
    # without a precompression from its energy
    sonic = lambda p: gx.scenes.monomer(N, stiffness=p["stiffness"]).counted_in("SI")
    with refused("traces: expected times in seconds"):
        gx.fit(sonic, {"stiffness": 1.0}, traces, state=struck)


CSV = """\
# recorder 7
Time (us),Bead 3 [mm/s],Bead 7 [V],Load
0,0,0.1,1
5,20,0.3,
15,60,-0.2,3
"""


def read(tmp_path, **keywords):
    (tmp_path / "a.csv").write_text(CSV)
    return gx.Traces.from_csv(tmp_path / "a.csv", read={"comment": "#"}, **keywords)


def test_columns_of_a_table_are_read_in_si(tmp_path):
    traces = read(
        tmp_path, velocity=["Bead 3", "Bead 7"], sites=[3, 7], units={"Bead 7": 0.025}, sigma=1e-3
    )
    assert_allclose(traces.times, [0, 5e-6, 15e-6], rtol=1e-15)
    assert_allclose(traces.data, [[0, 0.0025], [0.02, 0.0075], [0.06, -0.005]], rtol=1e-15)
    assert (
        traces.kind == "velocity" and traces.places == ((3,), (7,)) and float(traces.sigma) == 1e-3
    )
    force = read(tmp_path, time=0, force=3, contacts=0, units={3: "kN"}, offset="delay")
    assert_array_equal(force.data[:, 0], [1e3, np.nan, 3e3])
    assert force.offset == "delay" and float(force.weights[1, 0]) == 0.0
    moved = read(tmp_path, displacement="Load", sites=0, units={"Load": "\u00b5m", "Time": 2.0})
    assert_allclose(moved.data[::2, 0], [1e-6, 3e-6], rtol=1e-15)
    assert_array_equal(moved.times, [0, 10, 30])


@pytest.mark.parametrize(
    "keywords, said",
    [
        (
            {"velocity": "Bead 7"},
            r"the unit of 'Bead 7 \[V\]', such as m/s, or its size in m/s, got 'V'",
        ),
        ({"velocity": "Load"}, "got None. Give units={'Load': 'm/s'}"),
        ({"velocity": "Bead 33"}, r"velocity: expected one of .*Did you mean 'Bead 3 \[mm/s\]'"),
        (
            {"velocity": "Bead 3", "units": {"bead 3": "m/s"}},
            "units: expected columns that are read",
        ),
        (
            {"velocity": "Bead 3", "force": "Load", "units": {"Load": "N"}},
            "data: expected one of velocity=",
        ),
    ],
)
def test_a_column_that_is_not_understood_is_refused(keywords, said, tmp_path):
    with refused(said):
        read(tmp_path, sites=0, **keywords)


def test_text_among_numbers_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("Time (s),v [m/s]\n0,0\n1,over\n2,1\n")
    with refused("'v .m/s.', which holds text"):
        gx.Traces.from_csv(tmp_path / "a.csv", velocity="v", sites=0)
    traces = gx.Traces.from_csv(
        tmp_path / "a.csv", velocity="v", sites=0, read={"na_values": ["over"]}
    )
    assert_array_equal(traces.data[:, 0], [0, np.nan, 1])


def test_dates_and_time_differences_are_seconds(tmp_path):
    dates = np.datetime64("2026-01-01T12:00") + np.arange(3) * np.timedelta64(250, "us")
    for times in (dates, dates - dates[0], dates.tolist(), (dates - dates[0]).tolist()):
        traces = gx.Traces(times, velocity=np.zeros(3), sites=0)
        assert_allclose(traces.times, [0, 2.5e-4, 5e-4], rtol=1e-12)
    (tmp_path / "a.csv").write_text("when,v [m/s]\n2026-01-01 12:00:00,0\n2026-01-01 12:00:02,1\n")
    traces = gx.Traces.from_csv(
        tmp_path / "a.csv", time="when", velocity="v", sites=0, read={"parse_dates": ["when"]}
    )
    assert traces.times.tolist() == [0.0, 2.0]


@pytest.mark.slow
def test_a_law_of_free_shape_is_found_from_traces():
    """A spline finds the force of Hertz contacts to 1 % of its largest over the strains visited, with 1 % of noise.

    The record is taken up in parts that double, so that no phase is lost by a whole turn on the way.
    """
    sensors, (path, strains) = [1, 4, 7, 10, 13, 16], by_dop853(1.5, TIMES[-1], 0.02)
    seen = strains(path(np.linspace(0, TIMES[-1], 8001))[:N])
    low, high = seen.min(), seen.max()
    velocity = path(TIMES)[N:][sensors].T
    sigma = 0.01 * np.abs(velocity).max()
    velocity = velocity + sigma * np.random.default_rng(0).normal(size=velocity.shape)
    knots, names = np.linspace(1.2 * low, 1.2 * high, 7), [f"c{i}" for i in range(8)]

    def law(p):
        return gx.Spline(knots, jnp.stack([p[name] for name in names]))

    def scene(p):
        bond = gx.Bond(gx.Shift(1, "fixed"), law(p))
        return gx.Lattice(1.0, (bond, gx.Damping(0.02)), sites=N)

    state = gx.State(np.zeros(N), np.r_[1.5, np.zeros(N - 1)])
    start = dict.fromkeys(names, 1.8)
    for part in (50, 100, 200, 400):
        traces = gx.Traces(TIMES[:part], velocity=velocity[:part], sites=sensors, sigma=sigma)
        bounds = dict.fromkeys(names, (0.0, None))
        found = gx.fit(scene, start, traces, state=state, bounds=bounds, throw=part == 400)
        # a number that a part does not see may have come to its bound, where no search can begin
        start = {name: x + 1e-3 * (1.8 - x) for name, x in found.parameters.items()}
    e = np.linspace(low, high, 301)
    true = np.maximum(1 + e, 0) ** 1.5 - 1
    assert np.abs(law(found.parameters).force(e) - true).max() < 0.01 * np.abs(true).max()
    assert abs(found.reduced_chi_square - 1) < 0.1


def struck_dimer(p):
    return gx.scenes.dimer(12, ratio=0.5, stiffness=p["stiffness"])


def test_a_fit_through_adaptive_runs():
    """Of a struck sonic vacuum: the truth within its deviations, which are those of a short fixed step."""
    times = np.linspace(0.5, 20.0, 79)
    start = lambda p, chain: gx.states.impact(chain, velocity=p["velocity"])
    truth = {"stiffness": 1.3, "velocity": 0.8}
    chain = struck_dimer(truth)
    v = gx.simulate(chain, start(truth, chain), 20.0, save_at=times, tolerance=1e-11).vs
    noise = 1e-3 * np.random.default_rng(0).normal(size=(79, 2))
    traces = gx.Traces(times, velocity=v[:, [3, 7]] + noise, sites=[3, 7], sigma=1e-3)
    guess = {"stiffness": 1.0, "velocity": 0.75}
    found = gx.fit(struck_dimer, guess, traces, state=start, run_tolerance=1e-8)
    for name, value in truth.items():
        assert abs(found.parameters[name] - value) < 4 * found.deviations[name]
    assert found.step_error < 1e-2 and "adaptive, tolerance 1e-08" in repr(found)
    plain = gx.fit(struck_dimer, guess, traces, state=start, step=0.02)
    np.testing.assert_allclose(found.covariance, plain.covariance, rtol=1e-2)
    for options in ({"windows": 2}, {"method": "gradient"}, {"step": 0.1}):
        with refused("run_tolerance"):
            gx.fit(struck_dimer, guess, traces, state=start, run_tolerance=1e-8, **options)


def test_a_fit_in_the_plane():
    """Of a struck packing, with sensors that see one component each."""
    scene = lambda p: gx.scenes.triangular(4, 5, stiffness=p["stiffness"], precompression=p["load"])
    truth = {"stiffness": 1.2, "load": 0.4}
    lattice, times = scene(truth), np.linspace(0.2, 12.0, 60)
    state = gx.State(lattice.zeros(), lattice.zeros().at[1, 2].set(jnp.array([0.1, 0.05])))
    v = np.asarray(gx.simulate(lattice, state, 12.0, save_at=times, step=0.05).vs)
    rng = np.random.default_rng(0)
    traces = [
        gx.Traces(
            times,
            velocity=v[:, 2, 3, i] + 3e-4 * rng.normal(size=60),
            sites=[(2, 3)],
            component=i,
            sigma=3e-4,
        )
        for i in (0, 1)
    ]
    found = gx.fit(scene, {"stiffness": 1.0, "load": 0.5}, traces, state=state, step=0.1)
    for name, value in truth.items():
        assert abs(found.parameters[name] - value) < 4 * found.deviations[name]


def planned(p, frequency=None):
    drive = () if frequency is None else (gx.Drive(lambda t: 0.01 * jnp.sin(frequency * t), 0),)
    bond = gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(p["stiffness"], p["load"]))
    return gx.Lattice(1.0, (bond, gx.Damping(p["rate"]), *drive), sites=7)


PLANNED = {"stiffness": 1.0, "load": 0.5, "rate": 0.05}
EVERYWHERE = gx.Traces(
    np.linspace(0, 20, 101), velocity=np.zeros((101, 7)), sites=range(7), sigma=1e-3
)


def test_information_is_that_of_the_fit_and_its_best_sensors_are_the_best_of_all():
    struck = lambda p, chain: gx.states.impact(chain, velocity=0.1)
    found = gx.information(planned, PLANNED, EVERYWHERE, state=struck, step=0.1)
    chain = planned(PLANNED)
    v = gx.simulate(chain, struck(None, chain), 20.0, step=0.1, save_at=EVERYWHERE.times).vs
    traces = gx.Traces(EVERYWHERE.times, velocity=v, sites=range(7), sigma=1e-3)
    fitted = gx.fit(planned, PLANNED, traces, state=struck, step=0.1)
    order = [found.names.index(name) for name in fitted.names]
    np.testing.assert_allclose(
        np.asarray(found.covariance)[np.ix_(order, order)], fitted.covariance, rtol=1e-6
    )
    size = np.asarray(found.values)
    each = np.asarray(found.matrix) * size[:, None] * size
    for count in (1, 2, 3):
        worth = {
            some: np.linalg.slogdet(each[list(some)].sum(0))[1]
            for some in itertools.combinations(range(7), count)
        }
        best = found.best(count)
        assert worth[best.places] == max(worth.values())
        assert float(best.log_det) == pytest.approx(max(worth.values()), rel=1e-10)
    assert found.best(7).places == tuple(range(7)) and found.best(2).determined
    assert "would determine stiffness = 1 +-" in found.outcome
    with refused("at most 7"):
        found.best(8)
    one = gx.Traces(EVERYWHERE.times, velocity=np.zeros(101), sites=3, sigma=1e-3)
    still = gx.information(planned, PLANNED, one, state=gx.states.rest(chain), step=0.1)
    assert not still.determined and "do not determine" in still.outcome


def test_a_drive_is_designed_for_the_information_that_it_brings():
    chain = planned(PLANNED, 1.0)

    def worth(p):
        scene = lambda q: planned(q, p["frequency"])
        rest = gx.states.rest(chain)
        found = gx.information(scene, PLANNED, EVERYWHERE, state=rest, step=0.2)
        return found.log_det

    bounds = {"frequency": (0.4, 1.2)}
    found = gx.design(worth, {"frequency": 0.8}, bounds=bounds, maximise=True, max_steps=20)
    ends = [float(worth({"frequency": x})) for x in (0.8 - 1e-4, 0.8 + 1e-4)]
    slope = jax.grad(lambda x: worth({"frequency": x}))(0.8)
    assert_allclose(slope, np.diff(ends)[0] / 2e-4, rtol=1e-5)
    assert found.value > found.start_value + 1
