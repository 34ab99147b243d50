"""Sweeps: the same numbers as one scene after another, whatever way they are computed."""

import random
import warnings
from collections import namedtuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import granjax as gx
from granjax.flow.lifted import lifting, scene_of
from granjax.sweeps.plan import planned
from granjax.sweeps.points import points_of

FORCE = gx.Peak(gx.measures.contact_force)


def wall(ratio, beads=7):
    chain = gx.scenes.dimer(beads, ratio=ratio)
    run = gx.simulate(chain, gx.states.impact(chain), 12.0, step=0.02, record={"force": FORCE})
    return {"wall": run.recorded["force"][-1], "speed": run.final.v[0]}


def sweep(function, parameters, **keywords):
    return gx.sweep(function, parameters, progress=False, **keywords)


RATIOS = np.linspace(0.2, 1.0, 9)


@pytest.fixture(scope="module")
def walls():
    return sweep(wall, {"ratio": RATIOS, "beads": [7, 5]}, units={"wall": "N", "ratio": "1"})


def how_of(function, parameters):
    return planned(function, points_of(parameters), None, None).how


@pytest.mark.study
def test_lanes_are_what_single_runs_give(walls):
    assert how_of(wall, {"ratio": RATIOS, "beads": [7, 5]})[:2] == ("lanes", ("beads",))
    for beads in (5, 7):
        for ratio in RATIOS[::4]:
            here, one = walls.sel(ratio=ratio, beads=beads), wall(float(ratio), beads)
            assert float(here.wall) == pytest.approx(float(one["wall"]), rel=1e-9)
            assert float(here.speed) == pytest.approx(float(one["speed"]), rel=1e-9, abs=1e-12)
    assert walls.sizes == {"ratio": 9, "beads": 2} and (walls.reason == "").all()


def test_it_is_a_dataset_with_units_and_its_origin(walls):
    assert isinstance(walls, xarray.Dataset) and walls.wall.attrs["units"] == "N"
    assert walls.ratio.attrs["units"] == "1" and list(walls.data_vars) == ["wall", "speed", "reason"]
    assert {"granjax", "jax", "numpy", "commit", "cite", "outcome", "function", "scene"} <= walls.attrs.keys()
    assert "7 sites" in walls.attrs["scene"] or "7" in walls.attrs["scene"]
    assert walls.outcome == "18 lanes over ratio (9), beads (2)."
    plain = walls.to_xarray()
    assert type(plain) is xarray.Dataset and plain.attrs == walls.attrs
    assert all(plain[name].identical(walls[name]) for name in walls.variables)
    assert "wall [N]" in walls.table(4)


@pytest.mark.slow
def test_a_lane_is_run_again(walls):
    scene = walls.scene(ratio=RATIOS[3] * (1 + 1e-13), beads=5)
    lattice, state = scene
    assert lattice.shape == (5,) and scene.t1 == 12.0 and "dimer" not in repr(scene)
    run = scene.run(save_at=13)
    assert run.us.shape == (13, 5)
    assert float(run.recorded["force"][-1]) == pytest.approx(float(walls.wall.sel(ratio=RATIOS[3], beads=5)), rel=1e-9)
    assert float(walls.scene(ratio=0.33, beads=7).lattice.mass[1]) == 0.33
    with pytest.raises(ValueError, match="beads: expected a value of each parameter"):
        walls.scene(ratio=0.5)
    with pytest.raises(ValueError, match="Did you mean 'ratio'"):
        walls.scene(ration=0.5, beads=5)
    with pytest.raises(ValueError, match="made of another by xarray"):
        walls.isel(ratio=0).scene(beads=5)


@pytest.mark.slow
def test_runs_within_have_their_lanes_last():
    """The compiled program is that of one lattice with lanes last, to the last bit."""
    def peak(ratio):
        chain = gx.scenes.dimer(7, ratio=ratio)
        return gx.simulate(chain, gx.states.impact(chain), 12.0, record={"force": FORCE}).recorded["force"]

    @jax.jit
    def by_hand(ratios):
        chains = jax.vmap(lambda ratio: gx.scenes.dimer(7, ratio=ratio), out_axes=-1)(ratios)
        return gx.simulate(chains, gx.states.impact(chains), 12.0, record={"force": FORCE}).recorded["force"]

    def lifted(ratios):
        with lifting():
            return jax.vmap(peak)(ratios)

    ratios = jnp.asarray(RATIOS)
    np.testing.assert_allclose(jax.jit(lifted)(ratios), by_hand(ratios).T, rtol=1e-14)


@pytest.mark.slow
def test_a_lane_that_goes_wrong_says_why_and_the_others_stand():
    def softening(K3):
        chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Polynomial(1.0, K3, 0.0)), sites=7)
        run = gx.simulate(chain, gx.states.impact(chain), 30.0, step=0.1, record={"force": FORCE})
        return jnp.where(run.completed, run.recorded["force"][0], 1e9)

    data = sweep(softening, {"K3": [0.1, 0.2, 3.0, 0.25]})
    assert data.reason.values.tolist()[2].startswith("The state is not finite") and (data.reason != "").sum() == 1
    assert np.isnan(data.softening[2]) and (data.softening[[0, 1, 3]] < 2).all()
    assert "K3 = 3" in data.outcome and "1 marked" in data.outcome
    alone = sweep(softening, {"K3": [0.1, 0.2, 0.25]})
    np.testing.assert_allclose(data.softening[[0, 1, 3]], alone.softening, rtol=1e-12)


@pytest.mark.slow
def test_a_lane_that_is_refused_says_why():
    data = sweep(wall, {"ratio": [0.5, 1.5, 0.7]})
    assert "ratio: expected numbers in (0, 1], got 1.5" in str(data.reason[1].values)
    assert np.isfinite(data.wall[[0, 2]]).all() and np.isnan(data.wall[1])

    def stiff(alpha):
        chain = gx.scenes.fput(7, alpha=alpha)
        return gx.simulate(chain, gx.states.impact(chain), 5.0).final.v[0]

    data = sweep(stiff, {"alpha": [0.1, 50.0]})
    assert "steps of" in str(data.reason[1].values) and data.reason[0] == ""


def test_where_every_lane_fails_it_is_raised():
    with pytest.raises(RuntimeError, match="^Every lane failed. The first: ratio: expected numbers"):
        sweep(wall, {"ratio": [1.5, 2.5]})
    with pytest.raises(RuntimeError, match="NameError: name 'missing' is not defined"):
        sweep(lambda x: missing * x, {"x": [1.0, 2.0]})  # noqa: F821


def test_what_is_not_finite_is_named():
    data = sweep(lambda x: {"a": 1 / x, "b": jnp.stack([x, jnp.log(x)])}, {"x": [-1.0, 1.0, 0.0]})
    assert data.reason.values.tolist() == ["Not finite: b.", "", "Not finite: a, b."]
    assert data.a.values.tolist() == [-1.0, 1.0, np.inf] and data.b.shape == (3, 2)


@pytest.mark.slow
def test_ways_of_computing_agree():
    parameters = {"ratio": RATIOS, "beads": [7]}
    each = sweep(wall, parameters, lanes=False)
    chunks = sweep(wall, parameters, chunk=4, devices=1)
    devices = sweep(wall, parameters, devices=jax.devices())
    for other in (chunks, devices):
        np.testing.assert_allclose(other.wall, each.wall, rtol=1e-9)
        np.testing.assert_allclose(other.speed, each.speed, rtol=1e-8, atol=1e-11)


@pytest.mark.study
def test_records_have_errors_within_lanes():
    def peak(ratio):
        chain = gx.scenes.dimer(5, ratio=ratio)
        run = gx.simulate(chain, gx.states.impact(chain), 6.0, record={"force": FORCE})
        return {"force": run.recorded["force"][-1], "force_error": run.record_error["force"][-1]}

    assert how_of(peak, {"ratio": RATIOS})[:3] == ("lanes", (), True)
    data = sweep(peak, {"ratio": [0.4, 0.8]})
    fine = [gx.simulate(c, gx.states.impact(c), 6.0, tolerance=1e-12, record={"force": FORCE}).recorded["force"][-1]
            for c in (gx.scenes.dimer(5, ratio=0.4), gx.scenes.dimer(5, ratio=0.8))]
    assert (np.abs(data.force - np.array(fine)) <= data.force_error).all() and (data.force_error < 1e-3).all()


@pytest.mark.slow
def test_adaptive_runs_have_steps_of_their_own():
    def peak(ratio):
        chain = gx.scenes.dimer(5, ratio=ratio)
        run = gx.simulate(chain, gx.states.impact(chain), 6.0, tolerance=1e-8, record={"force": FORCE})
        return {"force": run.recorded["force"], "steps": run.stats["steps"]}

    data, one = sweep(peak, {"ratio": [0.1, 0.8]}), peak(0.8)
    assert data.steps[0] > data.steps[1] == int(one["steps"]) and data.force.dims == ("ratio", "force_0")
    np.testing.assert_allclose(data.force[1], one["force"], rtol=1e-12)


@pytest.mark.slow
def test_a_law_of_ones_own_and_times_of_a_lane():
    class Cubic(gx.Law):
        k: jax.Array

        def force(self, e):
            return e + self.k * e**3

        def energy(self, e):
            return e**2 / 2 + self.k * e**4 / 4

    def over(k):
        chain = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "fixed"), Cubic(k)), gx.Damping(0.1)), sites=4)
        return gx.simulate(chain, gx.states.impact(chain), 3.0 / k, step=0.01).final.u

    data = sweep(over, {"k": [0.5, 1.0, 2.0]})
    for k in (0.5, 2.0):
        np.testing.assert_allclose(data.over.sel(k=k), over(jnp.asarray(k)), rtol=1e-9)


def test_what_cannot_be_traced_is_called_lane_by_lane():
    def gap(F0, kind):
        chain = gx.scenes.dimer(6, ratio=0.5, precompression=F0, boundary="free")
        bands = gx.linear.bands(chain) if kind == "bands" else None
        return {"kind": kind, "many": bands is not None, "cut": float(F0) ** (1 / 6) * 2}

    assert how_of(gap, {"F0": [1.0], "kind": ["bands", "none"]}).kind == "each"
    data = sweep(gap, {"F0": [1.0, 64.0], "kind": ["bands", "none"]})
    assert data.kind_found.values.tolist() == [["bands", "none"]] * 2 and data.many.dtype == bool
    assert data.cut.sel(F0=64.0, kind="none") == 4.0
    with pytest.raises(ValueError, match="lanes: expected None or False"):
        sweep(gap, {"F0": [1.0], "kind": ["bands"]}, lanes=True)


@pytest.mark.slow
def test_results_become_their_variables():
    def whole(ratio):
        chain = gx.scenes.dimer(4, ratio=ratio)
        return gx.simulate(chain, gx.states.impact(chain), 2.0, step=0.01, save_at=3)

    Pair = namedtuple("Pair", "modes, multipliers")
    data = sweep(whole, {"ratio": [0.5, 0.9]})
    assert data.u.dims == ("ratio", "time", "site") and data.time.values.tolist() == [0.0, 1.0, 2.0]
    assert (data.completed == 1).all() and data.solver.values.tolist() == ["SRKN11b"] * 2
    each = sweep(whole, {"ratio": [0.5, 0.9]}, lanes=False)
    np.testing.assert_allclose(each.u, data.u, rtol=1e-9, atol=1e-12)
    assert each.outcome.startswith("2 lanes") and each.u.attrs == data.u.attrs
    data = sweep(lambda x: Pair(jnp.arange(3.0) * x, jnp.exp(1j * x)), {"x": [0.0, np.pi]})
    np.testing.assert_allclose(data.multipliers_real, [1, -1], rtol=1e-15)
    assert data.multipliers_imag.shape == (2,) and data.modes.dims == ("x", "modes_0")


def test_arrays_of_several_lengths_are_filled_up():
    data = sweep(lambda n, x: jnp.arange(n) * x, {"n": [2, 4], "x": [1.0, 2.0]})
    assert data.value.shape == (2, 2, 4) and np.isnan(data.value.sel(n=2)[:, 2:]).all()
    assert data.value.sel(n=4, x=2.0).values.tolist() == [0.0, 2.0, 4.0, 6.0] and (data.reason == "").all()


def test_designs():
    pairs = sweep(lambda x, y: x - y, gx.sweeps.paired({"x": [1.0, 2.0, 3.0], "y": [4.0, 3.0, 2.0]}))
    rows = sweep(lambda p: p["x"] - p["y"], [{"x": 1.0, "y": 4.0}, {"x": 2.0, "y": 3.0}, {"x": 3.0, "y": 2.0}])
    assert pairs.value.values.tolist() == [-3.0, -1.0, 1.0] == rows.value.values.tolist()
    assert pairs.value.dims == ("lane",) and pairs.x.dims == ("lane",)
    points = gx.sweeps.random({"a": (0.1, 1.0), "b": (1.0, 1e4, "log"), "n": (2, 5)}, 64, seed=3)
    again = gx.sweeps.random({"a": (0.1, 1.0), "b": (1.0, 1e4, "log"), "n": (2, 5)}, 64, seed=3)
    a, b, n = points.axes.values()
    assert all(np.array_equal(x, y) for x, y in zip(points.axes.values(), again.axes.values()))
    assert (np.histogram(a, 4, (0.1, 1.0))[0] == 16).all() and (np.histogram(np.log10(b), 4, (0, 4))[0] == 16).all()
    assert set(n.tolist()) == {2, 3, 4, 5} and n.dtype.kind == "i"


@pytest.mark.parametrize("parameters, said", [
    ({}, "names and values"), ({"x": []}, r"parameters\['x'\]: expected a row"), ({"x": 1.0}, "a row of numbers"),
    ({"x": [np.nan]}, "finite numbers"), ({"x": [[1.0]]}, "row"), ({"lane": [1.0]}, "other names"),
    ({"a b": [1.0]}, "names that a function"), ([{"x": 1.0}, {"y": 1.0}], "x in every dict"),
    ({"x": [object()]}, "row"),
])
def test_bad_parameters_meet_a_sentence(parameters, said):
    with pytest.raises(ValueError, match=said):
        sweep(lambda x: x, parameters)


@pytest.mark.parametrize("bounds, said", [
    ({"x": (1.0, 0.5)}, "low below high"), ({"x": (0.0, 1.0, "log")}, "above zero|positive|x"), ({}, "name"),
    ({"x": (0.0, 1.0, "lin")}, "log"), ({"x": (0.0, np.inf)}, "finite"),
])
def test_bad_bounds_meet_a_sentence(bounds, said):
    with pytest.raises(ValueError, match=said):
        gx.sweeps.random(bounds, 4)


def test_bad_functions_meet_a_sentence():
    with pytest.raises(ValueError, match="function: expected a function of x, y, or of one dict"):
        sweep(lambda x, z: x, {"x": [1.0], "y": [1.0]})
    with pytest.raises(RuntimeError, match="one that returns numbers or words"):
        sweep(lambda x: None, {"x": [1.0, 2.0]})
    with pytest.raises(ValueError, match=r"units\['x'\]: expected a string"):
        sweep(lambda x: x, {"x": [1.0]}, units={"x": 3})
    with pytest.raises(ValueError, match="devices: expected"):
        sweep(lambda x: x, {"x": [1.0]}, devices=0)


def test_what_a_sweep_is_not_for_is_told():
    with pytest.raises(RuntimeError, match="given a dict of all; called 'ratio' it is given numbers"):
        sweep(lambda r: 2 * r, {"ratio": [0.5, 0.6]})
    with pytest.raises(ValueError, match="reads numbers that are known, got scale, which is traced"):
        jax.grad(lambda scale: sweep(lambda x: x * scale, {"x": [1.0, 2.0]}).value.values.sum())(2.0)
    with pytest.raises(ValueError, match=r"parameters\['x'\]: expected a row of numbers or words, got a traced"):
        jax.jit(lambda x: sweep(lambda x: x, {"x": x}).value.values)(jnp.arange(3.0))


def test_parameters_are_known_by_name_and_have_defaults():
    assert sweep(lambda x, scale=2.0: scale * x, {"x": [1.0, 2.0]}).value.values.tolist() == [2.0, 4.0]
    assert sweep(lambda **p: p["x"] + p["y"], {"x": [1.0], "y": [2.0]}).value.item() == 3.0


def test_a_scene_is_asked_for_without_a_run():
    lattice, state, t1, keywords = scene_of(wall, 0.5)
    assert lattice.shape == (7,) and t1 == 12.0 and keywords["step"] == 0.02
    assert scene_of(lambda: 3.0) is None


def test_stiff_lanes_come_first_and_shapes_are_chunks():
    plan = planned(wall, points_of({"ratio": [1.0, 0.2, 0.6]}), None, None)
    assert plan.order is None  # a given step costs every lane the same

    def own_step(ratio):
        chain = gx.scenes.dimer(7, ratio=ratio)
        return gx.simulate(chain, gx.states.impact(chain), 12.0).final.v[0]

    plan = planned(own_step, points_of({"ratio": [1.0, 0.2, 0.6]}), None, None)
    assert plan.order.tolist() == [1, 2, 0] and plan.chunk == 8
    assert planned(own_step, points_of({"ratio": np.linspace(0.1, 1, 1000)}), None, None).chunk == 64


def test_no_warning_is_left(walls):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sweep(wall, {"ratio": RATIOS, "beads": [7, 5]})


@pytest.mark.slow
def test_many_lanes_are_kept_in_one_file(tmp_path):
    """More parameters than an attribute of a netCDF file holds, and a list that the function reads."""
    shifts = [0.1 * i for i in range(5000)]

    def shifted(x, y):
        return {"sum": x + y + shifts[3], "reason": x}

    points = gx.sweeps.random({"x": (0.0, 1.0), "y": (0.0, 1.0)}, 5000)
    data = sweep(shifted, points, store=tmp_path / "many.nc")
    again = sweep(shifted, points, store=tmp_path / "many.nc")
    assert again.identical(data) and (data.reason == "").all() and (data.reason_found == data.x).all()
    with pytest.raises(ValueError, match=r"x: 5000 values, .*, the store has 5000 values"):
        sweep(shifted, gx.sweeps.random({"x": (0.0, 1.0), "y": (0.0, 1.0)}, 5000, seed=1), store=tmp_path / "many.nc")
    shifts[3] = 7.0
    with pytest.raises(ValueError, match="function: it reads shifts = 5000 values"):
        sweep(shifted, points, store=tmp_path / "many.nc")


RNG = np.random.default_rng(1)


def _disordered(k, masses):
    chain = gx.Lattice(masses, gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(k, 1.0)))
    return {"v": gx.simulate(chain, gx.states.impact(chain), 1.0, step=0.1).final.v[0]}


def _seeded(k):
    np.random.seed(3)
    return {"v": k * np.random.rand()}


DRAWS = {
    "masses of the global state": lambda k: _disordered(k, 1 + 0.1 * np.random.rand(4)),
    "a generator of its own": lambda k: {"v": k * np.random.default_rng().normal(size=3)},
    "a generator from outside": lambda k: {"v": k * RNG.normal()},
    "Python's": lambda k: {"v": k + random.gauss(0.0, 1.0)},
    "a place": lambda k: {"v": jnp.arange(1e6).at[random.randrange(10**6)].set(k).sum()},
    "within a loop": lambda k: {"v": jax.lax.fori_loop(0, 3, lambda i, x: x + np.random.rand() * k, 0.0)},
    "beside what is traced": lambda k: {"v": k, "noise": np.random.rand()},
    "a JAX key": lambda k: {"v": k * jax.random.normal(jax.random.key(np.random.randint(2**31)))},
}


@pytest.mark.parametrize("draw", DRAWS)
def test_random_numbers_that_lanes_would_share_are_refused(draw):
    for _ in range(2):  # and again, when the function is known
        with pytest.raises(ValueError, match=r"function: .*jax.random.key\(seed\).* lanes=False"):
            gx.sweep(DRAWS[draw], {"k": [1.0, 2.0, 3.0]}, progress=False)


def test_random_numbers_of_a_lane_s_own():
    """Drawn anew for each lane that is called by itself, and the same in every process from a parameter `seed`."""
    data = gx.sweep(DRAWS["Python's"], {"k": [1.0, 1.0, 1.0]}, lanes=False, progress=False)
    assert len(set(data.v.values.tolist())) == 3
    data = gx.sweep(lambda k: {"v": float(k) * np.random.rand()}, {"k": [1.0, 1.0]}, progress=False)
    assert data.v.values[0] != data.v.values[1]
    seeds = [0, 1, 5]
    data = gx.sweep(lambda seed: {"v": jax.random.normal(jax.random.key(seed))}, {"seed": seeds}, progress=False)
    assert data.v.values.tolist() == [float(jax.random.normal(jax.random.key(seed))) for seed in seeds]


@pytest.mark.slow
def test_equal_draws_are_no_draws():
    fixed = lambda k: _disordered(k, 1 + 0.1 * np.random.default_rng(0).random(4))
    data = gx.sweep(fixed, {"k": [1.0, 2.0]}, progress=False)
    np.testing.assert_allclose(data.v.values, [float(fixed(k)["v"]) for k in (1.0, 2.0)], rtol=1e-12)
    data = gx.sweep(_seeded, {"k": [1.0, 2.0]}, progress=False)
    np.testing.assert_allclose(data.v.values, np.random.RandomState(3).rand() * np.array([1.0, 2.0]), rtol=1e-12)


def test_what_computes_the_same_each_time_is_looked_for_once():
    calls = []

    def counted(k):
        calls.append(k)
        return {"v": 2 * k}

    gx.sweep(counted, {"k": [1.0, 2.0]}, chunk=2, progress=False)
    first = len(calls)
    gx.sweep(counted, {"k": [3.0, 4.0]}, chunk=2, progress=False)
    assert len(calls) - first <= first - 2
