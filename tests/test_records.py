"""Records: as accurate as the run, of any quantity in either order of arguments, each with its error."""

import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import granjax as gx
from granjax.base.arrays import cubic_top
from granjax.flow.within import crossing, guesses, lobatto, mean, series, tops

pytestmark = pytest.mark.slow

T1 = 30.0


def place(t, y, lattice):
    return y.u[0]


def thrice(t, y, lattice):
    return jnp.stack([y.u[0]] * 3)


def square(t, y, lattice):
    return y.u[0] ** 2


@pytest.fixture(scope="module")
def site():
    """A site that moves as -sin t, beside one at rest."""
    lattice = gx.Lattice(1.0, (gx.OnSite(gx.Linear(1.0)),), sites=2)
    return lattice, gx.State(jnp.zeros(2), jnp.array([-1.0, 0.0]))


THRESHOLDS = np.array([0.9, 0.99, 0.9999])


@pytest.mark.parametrize(
    ("method", "within"),
    [({}, 1e-6), (dict(solver=gx.RKN1210(), tolerance=1e-9), 1e-9)],
    ids=["default", "1e-9"],
)
def test_a_crossing_that_rises_and_falls_within_one_step_is_found(site, method, within):
    """Thresholds that are passed twice within a step, a peak and an integral are known to their stated errors."""
    record = {
        "arrival": gx.Arrival(thrice, THRESHOLDS),
        "peak": gx.Peak(place),
        "integral": gx.Integral(square),
    }
    run = gx.simulate(*site, T1, record=record, confirm=True, **method)
    true = {
        "arrival": np.pi + np.arcsin(THRESHOLDS),
        "peak": 1.0,
        "integral": T1 / 2 - np.sin(2 * T1) / 4,
    }
    for name, expected in true.items():
        gap = np.abs(run.recorded[name] - expected)
        error = run.error.records[name]
        most = within * (100 if name == "arrival" else 1)
        assert np.all(gap < error) and np.all(error < most), (name, gap, error)


def test_a_threshold_within_the_error_of_the_top_is_open(site):
    # Verlet's amplitude is 1/sqrt(1 - h^2/4) = 1.005 for 1: what lies between may be passed or not
    wait = {"arrival": gx.Arrival(thrice, np.array([0.9, 1.006, 1.2]))}
    run = gx.simulate(*site, T1, solver=gx.VelocityVerlet(), step=0.2, record=wait, confirm=True)
    found = run.recorded["arrival"]
    error = run.error.records["arrival"]
    assert np.isfinite(found[0]) and np.isnan(found[1:]).all()
    assert error[0] < 0.1 and error[1] == np.inf and np.isnan(error[2])


def test_every_measure_is_recordable_in_either_order(site):
    measures = {
        "kinetic": gx.measures.kinetic_energy,
        "own": lambda lattice, y: y.v,
        "jump": lambda lattice, y: jnp.sign(y.u[0] - 0.3),
        "kink": lambda lattice, y: -(jnp.maximum(0.1 - y.u[0], 0) ** 1.5),
        "plain": lambda t, y, lattice: y.v + 0 * t,
        "species": lambda lattice, y, t=0.0: dict(
            zip("ab", gx.measures.site_energy(lattice, y, t))
        ),
    }
    record = {name: gx.Peak(q) for name, q in measures.items()}
    run = gx.simulate(*site, 4.0, step=0.2, record=record, confirm=True)
    top = run.recorded
    error = run.error.records
    assert top["kinetic"].shape == () and abs(top["kinetic"] - 0.5) < 1e-7
    assert top["own"].shape == (2,) and np.array_equal(top["own"], top["plain"])
    # what jumps or has a kink has no top above its samples
    assert top["jump"] == 1 and top["kink"] == 0
    # a tree is followed array by array, and its errors with it
    assert set(top["species"]) == {"a", "b"} == set(error["species"])
    assert abs(top["species"]["a"] - 0.5) < 1e-7
    assert error["own"].shape == (2,) and abs(top["own"][0] - 1) < error["own"][0] < 1e-6


def test_errors_pass_through_transformations(site):
    lattice, state = site
    record = {"when": gx.Arrival(place, 0.5), "never": gx.Arrival(place, 2.0)}

    def run(speed):
        start = gx.State(state.u, speed * state.v)
        found = gx.simulate(lattice, start, 5.0, step=0.5, record=record, confirm=True)
        return found, found.error.records

    one, error = run(1.0)
    assert np.isnan(one.recorded["never"]) and np.isnan(error["never"]) and 0 < error["when"] < 1e-5
    assert one.to_xarray().attrs["error_when"] == float(error["when"])
    after, within = jax.jit(jax.vmap(run))(jnp.array([1.0, 1.3]))
    for errors in (within, after.error.records):
        assert_allclose(errors["when"][0], error["when"], rtol=1e-3, atol=1e-14)

    # u = -s sin t reaches 1/2 at pi + arcsin(1/(2 s)); an error is a fact, without a derivative
    def both(speed):
        found, errors = run(speed)
        return found.recorded["when"], errors["when"]

    assert_allclose(jax.jacfwd(both)(1.0), (-0.5 / np.sqrt(0.75), 0.0), atol=1e-6)


def test_derivatives_of_records_in_both_modes(site):
    lattice, state = site
    record = {"peak": gx.Peak(place), "when": gx.Arrival(place, 0.9), "work": gx.Integral(square)}

    def records(speed):
        start = gx.State(state.u, speed * state.v)
        found = gx.simulate(lattice, start, 7.0, step=0.5, record=record).recorded
        return jnp.stack([found["peak"], found["when"], found["work"]])

    # u = -s sin t: the top is s, 0.9 is reached at pi + arcsin(0.9/s), the integral is s^2 (t/2 - sin(2 t)/4)
    s = 1.05
    bend = np.sqrt(s**2 - 0.81)
    first = np.array([1.0, -0.9 / (s * bend), 2 * s * (3.5 - np.sin(14) / 4)])
    second = np.array([0.0, 0.9 * (2 * s**2 - 0.81) / (s**2 * bend**3), 2 * (3.5 - np.sin(14) / 4)])
    found = jax.jit(lambda s: jax.jvp(jax.jacfwd(records), (s,), (1.0,)))(s)
    assert_allclose(found[0], first, rtol=2e-6)
    assert_allclose(found[1], second, rtol=1e-5, atol=1e-6)
    assert_allclose(jax.jit(jax.jacrev(records))(s), first, rtol=2e-6)


def test_the_time_of_a_peak_has_derivatives_in_both_modes(site):
    _, state = site
    record = {"when": gx.PeakTime(place)}

    def when(stiffness, t1):
        lattice = gx.Lattice(1.0, (gx.OnSite(gx.Linear(stiffness)),), sites=2)
        return gx.simulate(lattice, state, t1, step=0.5, record=record).recorded["when"]

    # u = -sin(w t)/w is largest at 3 pi/(2 w), with w^2 = k, whenever the run ends
    k = 1.1
    t = 1.5 * np.pi / np.sqrt(k)
    forward = jax.jit(lambda k: jax.jvp(jax.jacfwd(when, (0, 1)), (k, 7.0), (1.0, 0.0)))(k)
    assert_allclose(forward[0], [-t / (2 * k), 0.0], rtol=1e-5, atol=1e-5)
    assert_allclose(forward[1][0], 3 * t / (4 * k**2), rtol=1e-4)
    assert_allclose(jax.jit(jax.value_and_grad(when))(k, 7.0), [t, -t / (2 * k)], rtol=1e-5)


def test_records_of_lanes_in_float32():
    make = lambda k: gx.scenes.monomer(4, stiffness=k, precompression=1.0)
    chains = jax.vmap(make, out_axes=-1)(jnp.array([1.0, 2.0]))
    scene = chains, gx.states.impact(chains, velocity=0.1)
    small = jax.tree.map(lambda x: x.astype(jnp.float32), scene)
    kinds = {"force": gx.Peak, "low": gx.Lowest}
    record = {name: kind(gx.measures.contact_force) for name, kind in kinds.items()}
    run = gx.simulate(*scene, 3.0, step=0.2, record=record)
    single = gx.simulate(*small, 3.0, step=0.2, record=record, confirm=True)
    for name in record:
        found = single.recorded[name]
        error = single.error.records[name]
        assert found.shape == error.shape == (5, 2)
        assert error.dtype == found.dtype == jnp.float32
        assert np.all(np.abs(found - run.recorded[name]) < error + 2e-6)
    assert np.all(run.recorded["low"] <= 1) and np.all(run.recorded["force"] >= 1)


def test_a_run_with_records_is_pickled(site):
    run = gx.simulate(*site, 2.0, step=0.5, record={"peak": gx.Peak(place)}, confirm=True)
    back = pickle.loads(pickle.dumps(run))
    assert back.recorded == run.recorded and back.error.records == run.error.records


def test_samples_of_a_step_give_tops_crossings_and_a_mean():
    x = lobatto(14).x
    waves = [
        lambda x: np.sin(3 * x + 0.3),
        lambda x: np.exp(x) * np.cos(3 * x),
        lambda x: -((x + 0.97) ** 2),
    ]
    q = jnp.asarray(np.stack([wave(x) for wave in waves], 1))
    fine = np.linspace(-1, 1, 200001)
    found = tops(q, guesses(q, 2))
    height = np.maximum(*(np.asarray(top.height) for top in found))
    true = np.array([wave(fine).max() for wave in waves])
    assert_allclose(np.maximum(height, q.max(0)), true, atol=2e-9)
    # of three, two are tops and the last lies between the end and the sample beside it
    assert_allclose(found[0].place[2], -0.97, atol=1e-9)
    there = jnp.array([True, True, False])
    ends = jnp.array([-0.5, -0.5, 0.0]), jnp.array([0.3, 0.05, 0.0])
    at = crossing(series(q), jnp.array([0.5, 0.8, 9.0]), *ends, there)
    assert_allclose([waves[0](at[0]), waves[1](at[1])], [0.5, 0.8], atol=1e-9)
    assert_allclose(mean(q)[0], np.sin(0.3) * np.sin(3) / 3, atol=1e-13)


@pytest.mark.parametrize(
    "edge",
    [
        lambda x: np.sign(x - 0.3),
        lambda x: np.maximum(x - 0.1, 0) ** 1.5,
        lambda x: -(np.maximum(0.1 - x, 0) ** 1.5),
    ],
)
@pytest.mark.parametrize("count", [6, 8, 14])
def test_a_jump_or_a_kink_has_no_top_above_its_samples(edge, count):
    q = jnp.asarray(edge(lobatto(count).x))[:, None]
    assert all(top.height[0] <= q.max() for top in tops(q, guesses(q, 2)))


def test_the_highest_value_of_a_cubic_also_where_it_begins_by_falling():
    """Against dense sampling; its derivative by the slopes is finite where the top lies at an end."""
    random = np.random.default_rng(0)
    ends = [np.append(random.normal(size=200), x) for x in (-0.541, 0.5, -0.0119, -1.204)]
    found = cubic_top(*ends)
    x0, x1, d0, d1 = ends
    s = np.linspace(0, 1, 2001)[:, None]
    c = 3 * (x1 - x0) - 2 * d0 - d1
    sampled = x0 + s * (d0 + s * (c + s * (2 * (x0 - x1) + d0 + d1)))
    assert_allclose(found, sampled.max(0), atol=1e-6)
    slope = jax.grad(cubic_top, (0, 1, 2, 3))(1.0, 1.0, 0.0, 0.0)
    assert np.isfinite(slope).all()
