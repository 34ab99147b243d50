"""Sweeps: the same numbers as one scene after another, kept, resumed, on executors that die."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import warnings
from collections import namedtuple
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
import zarr
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax.sweeps.function import _corners, program
from granjax.sweeps.points import points_of

FORCE = gx.Peak(gx.measures.contact_force)
RATIOS = np.linspace(0.2, 1.0, 9)


def struck(chain, t1, velocity=1.0, **how):
    """A run of a chain whose first site moves."""
    return gx.simulate(chain, gx.states.impact(chain, velocity=velocity), t1, **how)


def test_each_result_has_a_name_of_its_own_that_a_store_takes(tmp_path):
    halves = lambda a: {"peak/half": a / 2}
    data = gx.sweep(halves, {"a": [1.0, 2.0]}, store=tmp_path / "halves.zarr")
    assert data.peak_half.values.tolist() == [0.5, 1.0]
    with refused("function: .* got 'a_found' twice"):
        gx.sweep(lambda a: {"a": 2 * a, "a_found": 3 * a}, {"a": [1.0, 2.0]})


def wall(ratio, beads=7):
    chain = gx.scenes.dimer(beads, ratio=ratio)
    run = struck(chain, 12.0, step=0.02, record={"force": FORCE})
    return {"wall": run.recorded["force"][-1], "speed": run.final.v[0]}


def squared(x, y=0.0):
    return {"z": x**2 + y}


def in_python(x):
    return {"z": float(x) ** 2, "word": "small" if x < 2 else "large"}


def sweep(function, parameters, **keywords):
    return gx.sweep(function, parameters, progress=False, **keywords)


@pytest.fixture(scope="module")
def walls(tmp_path_factory):
    store = tmp_path_factory.mktemp("walls") / "walls.zarr"
    parameters = {"ratio": RATIOS, "beads": [7, 5]}
    return sweep(wall, parameters, units={"wall": "N", "ratio": "1"}, store=store, chunk=4), store


# ------------------------------------------------------------------------------------------------ what is computed


@pytest.mark.slow
def test_lanes_are_what_single_runs_give(walls):
    data, _ = walls
    for beads in (5, 7):
        for ratio in RATIOS[::4]:
            here = data.sel(ratio=ratio, beads=beads)
            one = wall(float(ratio), beads)
            assert float(here.wall) == pytest.approx(float(one["wall"]), rel=1e-9)
            assert float(here.speed) == pytest.approx(float(one["speed"]), rel=1e-9, abs=1e-12)
    assert data.sizes == {"ratio": 9, "beads": 2} and (data.reason == "").all()


def test_it_is_a_dataset_with_units_and_its_origin(walls):
    data, store = walls
    assert type(data) is xarray.Dataset and data.wall.units == "N" and data.ratio.units == "1"
    assert list(data.data_vars) == ["wall", "speed", "reason"]
    assert {"granjax", "jax", "numpy", "function"} <= data.attrs.keys()
    assert data.outcome == "18 points over ratio (9), beads (2)."
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = xarray.open_zarr(store).load()
    assert set(found.variables) == set(data.variables) and found.wall.identical(data.wall)
    assert (found.reason.values.astype(object) == "").all() and found.attrs["function"] == "wall"
    # four ratios a chunk, and one number of beads, since each needs a program of its own
    assert zarr.open_group(store, mode="r")["wall"].chunks == (4, 1)


@pytest.mark.slow
def test_chunks_and_executors_agree(walls):
    data, _ = walls
    with ThreadPoolExecutor(2) as executor:
        other = sweep(wall, {"ratio": RATIOS, "beads": [7]}, chunk=4, executor=executor)
    assert np.array_equal(other.wall, data.wall.sel(beads=[7]))
    alone = sweep(wall, {"ratio": RATIOS, "beads": [7]}, chunk=9)
    assert_allclose(alone.wall, data.wall.sel(beads=[7]), rtol=1e-9)


def test_functions_that_hold_python_are_called_point_by_point():
    data = sweep(in_python, {"x": [1.0, 2.0, 3.0]})
    assert data.z.values.tolist() == [1.0, 4.0, 9.0] and data.word.values.tolist() == [
        "small",
        "large",
        "large",
    ]
    data = sweep(
        lambda F0, kind: {"kind": kind, "cut": float(F0) ** 0.5},
        {"F0": [1.0, 64.0], "kind": ["a", "bb"]},
    )
    assert (
        data.kind_found.values.tolist() == [["a", "bb"]] * 2
        and data.cut.sel(F0=64.0, kind="a") == 8.0
    )


def test_words_and_sizes_are_programs_of_their_own():
    function = lambda x, kind, n: {
        "y": x * {"one": 1, "two": 2}[kind] + jnp.ones(n).sum(),
        "same": kind,
    }
    parameters = {"kind": ["two", "one"], "x": [1.0, 2.0, 3.0], "n": [3, 2]}
    data = sweep(function, parameters)
    assert (
        program.__wrapped__
        and data.y.sel(kind="two", x=3.0, n=2) == 8.0
        and data.same[0, 0, 0] == "two"
    )
    listed = sweep(
        function,
        [{"kind": k, "x": x, "n": n} for k in ("two", "one") for x in (1.0, 2.0) for n in (3, 2)],
    )
    assert listed.y.values.tolist() == [5, 4, 7, 6, 4, 3, 5, 4]
    # words as a column of a dataset
    column = xarray.DataArray(["a", "b"])
    assert points_of({"kind": column}).axes["kind"].tolist() == ["a", "b"]


def test_whole_numbers_have_negative_powers():
    """Also of numbers that index, seed or size something, and products that only Python's numbers hold."""
    row = jnp.arange(1.0, 5.0)
    made = lambda seed: jax.random.normal(jax.random.key(seed))
    alone = {
        "power": lambda n: 10 ** (n - 2),
        "of two": lambda n: 2**-n,
        "large": lambda n: n * 10**20,
        "index": lambda n: row[n] * 10**-n,
        "seed": lambda n: made(n) * 10**-n,
        "size": lambda n: jnp.ones(n).sum() * 10**-n,
        "python": lambda n: int(n) * 10**20,
    }
    for name, one in alone.items():
        data = sweep(lambda n, one=one: {"z": one(n)}, {"n": [1, 2, 3]})
        assert_allclose(data.z, [float(one(n)) for n in (1, 2, 3)], rtol=1e-14, err_msg=name)
        assert data.n.dtype == int
    both = sweep(lambda seed, k: {"z": made(seed) * 10**-k}, {"seed": [0, 1], "k": [0, 1]})
    assert_allclose(both.z[:, 1], both.z[:, 0] / 10, rtol=1e-15)


def test_one_program_serves_whole_numbers_that_set_no_size():
    row = jnp.arange(8.0)
    draw = lambda n: jax.random.uniform(jax.random.key(n)) * n
    for one in (lambda n: row[n] + 2 * n, lambda n: row.at[n].set(n), draw, lambda n: n % 2 > 0):
        calls = []
        data = sweep(lambda n, one=one: [calls.append(n), {"z": one(n)}][1], {"n": range(1, 7)})
        assert_allclose(data.z, [one(n) for n in range(1, 7)], rtol=1e-14)
        assert len(calls) <= 10


def test_tuples_may_hold_dicts():
    data = sweep(lambda x: (1.0, {"u": x * jnp.ones(2)}), {"x": [1.0, 2.0]})
    assert data.value_0.values.tolist() == [1, 1]
    assert data.value_1_u.values.tolist() == [[1, 1], [2, 2]]


def test_designs(tmp_path):
    parameters = gx.sweeps.paired({"x": [1.0, 2.0, 3.0], "y": [4.0, 3.0, 2.0]})
    pairs = sweep(lambda x, y: x - y, parameters)
    kept = sweep(lambda x, y: x - y, parameters, store=tmp_path / "kept.zarr")
    assert kept.drop_attrs().identical(pairs.drop_attrs())
    rows = sweep(
        lambda p: p["x"] - p["y"],
        [{"x": 1.0, "y": 4.0}, {"x": 2.0, "y": 3.0}, {"x": 3.0, "y": 2.0}],
    )
    assert pairs.value.values.tolist() == [-3.0, -1.0, 1.0] == rows.value.values.tolist()
    assert pairs.value.dims == ("lane",) and pairs.x.dims == ("lane",)
    same = sweep(squared, gx.sweeps.paired({"x": [2.0, 2.0], "y": [1.0, 1.0]}))
    assert same.z.values.tolist() == [5.0, 5.0]
    assert sweep(lambda x, scale=2.0: scale * x, {"x": [1.0, 2.0]}).value.values.tolist() == [
        2.0,
        4.0,
    ]


@pytest.mark.slow
def test_results_become_their_variables(tmp_path):
    def whole(ratio):
        return struck(gx.scenes.dimer(4, ratio=ratio), 2.0, step=0.01, save_at=3)

    data = sweep(whole, {"ratio": [0.5, 0.9]}, store=tmp_path / "whole.zarr")
    assert data.u.dims == ("ratio", "time", "site") and data.u.shape == (2, 3, 4)
    assert (data.completed == 1).all() and data.solver.values.tolist() == ["SRKN11b"] * 2
    one = whole(0.9)
    assert_allclose(data.u[1], one.us, rtol=1e-9, atol=1e-12)
    Pair = namedtuple("Pair", "modes, multipliers")
    data = sweep(
        lambda x: Pair(jnp.arange(3.0) * x, jnp.exp(1j * x)),
        {"x": [0.0, np.pi]},
        store=tmp_path / "c.zarr",
    )
    assert_allclose(data.multipliers, [1, -1], atol=1e-15)
    assert data.modes.dims == ("x", "modes_0")


@pytest.mark.slow
def test_records_have_errors_and_laws_of_ones_own_keep_lanes_apart():
    class Cubic(gx.Law):
        k: jax.Array

        def force(self, e):
            return e + self.k * e**3

        def energy(self, e):
            return e**2 / 2 + self.k * e**4 / 4

    def made(k):
        return gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "fixed"), Cubic(k)), gx.Damping(0.1)), sites=4)

    def over(k):
        # the largest of all sites: behind them it would be that of all lanes
        record = {
            "top": gx.Peak(lambda t, y, lattice: jnp.max(y.u)),
            "part": gx.Peak(lambda t, y, l: y.v / y.v.std()),
        }
        run = struck(made(k), 3.0, step=0.01, record=record, confirm=True)
        return {
            "top": run.recorded["top"],
            "part": run.recorded["part"],
            "error": run.error.records["top"],
        }

    data = sweep(over, {"k": [0.5, 1.0, 2.0]})
    for k in (0.5, 2.0):
        one = over(k)
        assert_allclose(data.top.sel(k=k), one["top"], rtol=1e-9)
        assert_allclose(data.part.sel(k=k), one["part"], rtol=1e-7)
        assert 0 < data.error.sel(k=k) < 1e-3


# ------------------------------------------------------------------------------------------------ what fails


@pytest.mark.slow
def test_a_lane_that_goes_wrong_says_why_and_the_others_stand():
    def softening(K3):
        chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Polynomial(1.0, K3, 0.0)), sites=7)
        return struck(chain, 30.0, step=0.1, record={"force": FORCE}).recorded["force"][0]

    data = sweep(softening, {"K3": [0.1, 0.2, 3.0, 0.25]})
    assert (
        str(data.reason[2].values).startswith("The state is not finite")
        and (data.reason != "").sum() == 1
    )
    assert np.isnan(data.softening[2]) and (data.softening[[0, 1, 3]] < 2).all()
    assert "K3 = 3" in data.outcome and "1 marked" in data.outcome
    alone = sweep(softening, {"K3": [0.1, 0.2, 0.25]})
    assert_allclose(data.softening[[0, 1, 3]], alone.softening, rtol=1e-12)


@pytest.mark.slow
def test_runs_that_stop_and_scenes_that_are_refused_say_why():
    def stopped(ratio):
        chain = gx.scenes.dimer(5, ratio=ratio)
        run = struck(chain, 6.0, tolerance=1e-8, max_steps=100, record={"force": FORCE})
        return run.recorded["force"].max()

    data = sweep(stopped, {"ratio": [0.01, 1.0]})
    assert (
        "Stopped after" in str(data.reason[0].values)
        and np.isnan(data.stopped[0])
        and data.stopped[1] > 0
    )
    data = sweep(wall, {"ratio": [0.5, 1.5, 0.7]})
    assert "ratio: expected numbers in (0, 1], got 1.5" in str(data.reason[1].values)
    assert np.isfinite(data.wall[[0, 2]]).all() and np.isnan(data.wall[1])

    def stiff(alpha):
        return struck(gx.scenes.fput(7, alpha=alpha), 5.0).final.v[0]

    data = sweep(stiff, {"alpha": [0.1, 50.0]})
    assert "steps of" in str(data.reason[1].values) and data.reason[0] == ""


def test_a_scene_that_is_refused_at_a_corner_alone_says_why():
    def light(a, b):
        return gx.scenes.dimer(5, ratio=(a + b) / 3).mass[1]

    data = sweep(light, {"a": [1.0, 2.0], "b": [0.2, 1.5]})
    assert "ratio: expected" in str(data.reason[1, 1].values) and (data.reason != "").sum() == 1
    assert_allclose(data.light, [[0.4, 2.5 / 3], [2.2 / 3, np.nan]])
    # more parameters than signs: the first and the last vary together
    rows = np.array([[0, 0], [1, 0], [0, 1], [0.9, 0.9]])[:, [0, 1, 1, 1, 1, 1, 0, 1]]
    assert 3 in _corners([*rows.T]) and _corners([np.ones(4)]) == set()


def test_what_is_not_finite_is_named_and_where_all_fails_it_is_raised():
    data = sweep(lambda x: {"a": 2 * x, "b": jnp.stack([x, jnp.log(x)])}, {"x": [-1.0, 1.0]})
    assert data.reason.values.tolist() == ["Not finite: b.", ""] and data.a.values.tolist() == [
        -2.0,
        2.0,
    ]
    data = sweep(lambda x: {"y": np.ones(int(x))}, {"x": [2.0, 3.0]})
    assert (
        "Return the same names and shapes" in str(data.reason[1].values)
        and np.isnan(data.y[1]).all()
    )
    with pytest.raises(
        RuntimeError, match="^Every point failed. The first: ratio: expected numbers"
    ):
        sweep(wall, {"ratio": [1.5, 2.5]})
    with pytest.raises(RuntimeError, match="given one dict, since no argument is named ratio"):
        sweep(lambda r: {"y": gx.scenes.dimer(5, ratio=r).mass}, {"ratio": [0.5, 0.6]})
    with pytest.raises(RuntimeError, match="NameError: name 'missing' is not defined"):
        sweep(lambda x: missing * x, {"x": [1.0, 2.0]})  # noqa: F821


@pytest.mark.parametrize(
    "go, said",
    [
        (lambda: points_of({}), "names and values"),
        (lambda: points_of({"x": []}), r"parameters\['x'\]: expected a row"),
        (lambda: points_of({"x": [np.nan]}), "finite numbers"),
        (lambda: points_of({"x": [0.01, np.nan]}), r"finite numbers, got \[0.01  nan\]"),
        (lambda: points_of({"x": ["a", 1]}), "numbers or words, got both"),
        (lambda: points_of([{"x": 1}, {"x": "a"}]), "numbers or words, got both"),
        (lambda: points_of({"lane": [1.0]}), "other names"),
        # 2^64 points, which whole numbers of 64 bits count as none
        (lambda: points_of(dict.fromkeys("abcd", np.arange(2**16))), "got 18446744073709551616"),
        (lambda: points_of({"a b": [1.0]}), "names that a function"),
        (lambda: points_of([{"x": 1.0}, {"y": 1.0}]), "x in every dict"),
        (
            lambda: sweep(lambda x, z: x, {"x": [1.0], "y": [1.0]}),
            "function: expected a function of x, y, or of one dict",
        ),
        (lambda: sweep(squared, {"x": [1.0]}, executor=4), "executor: expected an executor"),
        (
            lambda: sweep(squared, {"x": [1.0]}, units={"zz": "m"}),
            "units: expected one of 'x', 'z'",
        ),
        (
            lambda: sweep(
                squared,
                {"x": [1.0]},
                executor=ProcessPoolExecutor(1, multiprocessing.get_context("fork")),
            ),
            "spawn",
        ),
    ],
)
def test_mistakes_meet_a_sentence(go, said):
    with refused(said):
        go()


RNG = np.random.default_rng(1)
DRAWS = {
    "a generator from outside": lambda k: {"v": k * RNG.normal()},
    "within a loop": lambda k: {
        "v": jax.lax.fori_loop(0, 3, lambda i, x: x + np.random.rand() * k, 0.0)
    },
    "a JAX key": lambda k: {"v": k * jax.random.normal(jax.random.key(np.random.randint(2**31)))},
}


@pytest.mark.parametrize("draw", DRAWS)
def test_random_numbers_that_points_would_share_are_refused(draw):
    with refused(r"function: .*jax.random.normal\(jax.random.key\(seed\)"):
        sweep(DRAWS[draw], {"k": [1.0, 2.0, 3.0]})


def test_random_numbers_from_a_seed():
    data = sweep(lambda seed: {"v": jax.random.normal(jax.random.key(seed))}, {"seed": [0, 1, 5]})
    assert data.v.values.tolist() == [
        float(jax.random.normal(jax.random.key(seed))) for seed in (0, 1, 5)
    ]
    fixed = sweep(
        lambda k: {"v": k * jnp.asarray(np.random.default_rng(0).random(4))}, {"k": [1.0, 2.0]}
    )
    assert_allclose(fixed.v[1], 2 * np.random.default_rng(0).random(4), rtol=1e-15)


# ------------------------------------------------------------------------------------------------ stores


def test_another_sweep_is_refused_and_a_changed_source_warns(tmp_path):
    store = tmp_path / "map.zarr"
    first = sweep(squared, {"x": [1.0, 2.0]}, store=store)
    assert sweep(squared, {"x": [1.0, 2.0]}, store=str(store)).identical(first)
    with refused(r"which holds x 1, 2 instead of 1, 3\. Give another store"):
        sweep(squared, {"x": [1.0, 3.0]}, store=store)
    with refused("the parameters x instead of x, y"):
        sweep(squared, {"x": [1.0], "y": [2.0]}, store=store)
    with refused(r"chunk \[2\] instead of \[1\]"):
        sweep(squared, {"x": [1.0, 2.0]}, store=store, chunk=1)
    with pytest.warns(UserWarning, match="source of the function has changed"):
        assert sweep(lambda x: {"z": 2 * x}, {"x": [1.0, 2.0]}, store=store).z.values.tolist() == [
            1.0,
            4.0,
        ]
    zarr.open_group(tmp_path / "other.zarr", mode="w", zarr_format=2).create_array(
        "a", shape=(2,), dtype=float
    )
    (tmp_path / "file").write_text("x")
    for other in ("other.zarr", "file"):
        with refused("store: expected a new path"):
            sweep(squared, {"x": [1.0]}, store=tmp_path / other)
    assert list(zarr.open_group(tmp_path / "other.zarr", mode="r")) == ["a"]


def test_a_resumed_store_tells_what_computed_its_points(tmp_path, monkeypatch):
    store = tmp_path / "map.zarr"
    ask = lambda function=squared: sweep(function, {"x": [1.0, 2.0]}, store=store, chunk=1)
    first = ask()
    version = gx.__version__
    monkeypatch.setattr(gx, "__version__", "later")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert ask().attrs == first.attrs
    zarr.open_array(store / "done")[1] = False
    with pytest.warns(UserWarning, match=f"map.zarr was begun with granjax {version}. The points"):
        assert ask().identical(first)
    with pytest.warns(UserWarning, match="source of the function has changed"):
        assert ask(lambda x: {"z": x**3}).identical(first)


def test_units_are_given_to_what_a_store_holds(tmp_path):
    ask = lambda **units: sweep(squared, {"x": [1.0]}, store=tmp_path / "map.zarr", units=units)
    assert "units" not in ask().z.attrs
    data = ask(z="m^2", x="m")
    assert (data.z.units, data.x.units) == ("m^2", "m")
    with refused("units: expected one of 'x', 'z', got 'zz'"):
        ask(zz="m")


def test_a_store_may_be_a_url():
    parameters = {"x": np.arange(5.0), "y": [1.0, 2.0]}
    data = sweep(squared, parameters, store="memory://swept.zarr", chunk=4)
    assert np.array_equal(data.z, np.arange(5.0)[:, None] ** 2 + [1.0, 2.0])
    again = sweep(squared, parameters, store="memory://swept.zarr")
    assert again.identical(data)


def test_an_unfinished_store_is_begun_again(tmp_path):
    attributes = {
        "sweep": json.dumps({"chunk": [1], "parameters": {"x": [1.0]}, "design": "grid"}),
        "source": "",
    }
    group = zarr.open_group(tmp_path / "a.zarr", mode="w", zarr_format=2, attributes=attributes)
    group.create_array("z", shape=(3,), dtype=float)
    zarr.open_group(tmp_path / "b.zarr", mode="w", zarr_format=2)
    for name in ("a.zarr", "b.zarr"):
        assert sweep(
            squared, {"x": [1.0, 2.0]}, store=tmp_path / name, chunk=1
        ).z.values.tolist() == [1.0, 4.0]


KILLED = """
import time
import sys
import numpy as np
import granjax as gx
import jax.numpy as jnp

def slow(a, b):
    print("begun", flush=True)
    time.sleep(0.05)
    return {"z": np.sin(float(a) * b), "w": np.cos(np.arange(3.0) * float(b))}

gx.sweep(slow, {"a": np.arange(1.0, 25.0), "b": [0.5, 1.0]}, store=sys.argv[1], chunk=2, progress=False)
"""


@pytest.mark.slow
def test_killed_three_times_and_resumed_to_the_same_bits(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(KILLED)
    call = [sys.executable, str(script)]
    subprocess.run([*call, str(tmp_path / "whole.zarr")], check=True, capture_output=True)
    store = tmp_path / "killed.zarr"
    there = []
    # the first time before the store is whole
    for count in (1, 6, 12):
        with subprocess.Popen([*call, str(store)], stdout=subprocess.PIPE) as process:
            for _ in range(count):
                process.stdout.readline()
            process.kill()
        assert process.returncode == -signal.SIGKILL
        if (store / ".zmetadata").exists():
            reasons = xarray.open_zarr(store).reason.values.astype(object)
            there.append(int((reasons == "").sum()))
    assert there == sorted(there) and 0 < there[-1] < 48
    subprocess.run([*call, str(store)], check=True)
    whole, resumed = (xarray.open_zarr(x).load() for x in (tmp_path / "whole.zarr", store))
    assert (
        whole.drop_attrs().identical(resumed.drop_attrs())
        and (resumed.reason.values.astype(object) == "").all()
    )


@pytest.mark.slow
def test_memory_is_flat(tmp_path):
    code = """
import resource, sys
import numpy as np
import granjax as gx
import jax.numpy as jnp
count = int(sys.argv[1])
data = gx.sweep(lambda x: {"y": x * jnp.arange(2.0**12)}, {"x": np.arange(count) / count}, store=sys.argv[2], chunk=64,
                progress=False)
assert float(data.y[count // 2, 2]) == 1.0
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""
    used = [
        int(
            subprocess.run(
                [sys.executable, "-c", code, str(n), str(tmp_path / f"{n}.zarr")],
                check=True,
                text=True,
                capture_output=True,
            ).stdout
        )
        for n in (256, 4096)
    ]
    # kilobytes; all values of the long one are 134 MB
    assert used[1] - used[0] < 60_000


# ------------------------------------------------------------------------------------------------ executors that die


def dying(x, marker):
    """Ends its process at x = 3, once."""
    if float(x) == 3.0 and not os.path.exists(str(marker)):
        open(str(marker), "w").close()
        os.kill(os.getpid(), signal.SIGKILL)
    return {"z": float(x) ** 2}


@pytest.mark.slow
def test_a_process_that_is_killed_is_told_and_a_rerun_goes_on(tmp_path):
    parameters = {"x": np.arange(6.0), "marker": [str(tmp_path / "marker")]}
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, spawn) as executor:
        with pytest.raises(RuntimeError, match="A process of the executor died.*call again"):
            sweep(dying, parameters, store=tmp_path / "s.zarr", chunk=1, executor=executor)
    there = xarray.open_zarr(tmp_path / "s.zarr")
    assert 0 < np.isfinite(there.z).sum() < 6
    with ProcessPoolExecutor(2, spawn) as executor:
        data = sweep(dying, parameters, store=tmp_path / "s.zarr", executor=executor)
    assert (
        data.z[:, 0].values.tolist() == [0.0, 1.0, 4.0, 9.0, 16.0, 25.0]
        and (data.reason == "").all()
    )


@pytest.mark.slow
def test_a_worker_of_dask_is_killed_and_the_sweep_goes_on(tmp_path):
    distributed = pytest.importorskip("distributed")
    parameters = {"x": np.arange(6.0), "marker": [str(tmp_path / "marker")]}
    with distributed.LocalCluster(
        2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        with distributed.Client(cluster) as client:
            data = sweep(dying, parameters, chunk=1, executor=client)
            again = sweep(wall, {"ratio": RATIOS[:4]}, chunk=2, executor=client.get_executor())
    assert (tmp_path / "marker").exists() and (data.reason == "").all()
    assert data.z[:, 0].values.tolist() == [0.0, 1.0, 4.0, 9.0, 16.0, 25.0]
    assert np.array_equal(again.wall, sweep(wall, {"ratio": RATIOS[:4]}, chunk=2).wall)


def test_a_program_is_traced_once():
    calls = []

    def counted(k):
        calls.append(k)
        return {"v": 2 * k}

    sweep(counted, {"k": [1.0, 2.0]}, chunk=2)
    first = len(calls)
    sweep(counted, {"k": [3.0, 4.0]}, chunk=2)
    # what is refused is looked for at both ends
    assert len(calls) - first <= 2


def test_a_program_has_at_most_twice_as_many_lanes_as_points():
    lanes = []

    def counted(k):
        jax.debug.callback(lanes.append, k)
        return {"v": 2 * k}

    sweep(counted, {"k": [1.0, 2.0, 3.0]}, chunk=64)
    jax.effects_barrier()
    assert sorted(lanes) == [1.0, 2.0, 3.0, 3.0]


@pytest.mark.slow
def test_a_batch_of_simulate_has_its_lanes_last():
    """`jax.vmap` of runs is one lattice with lanes last, to the last bit; derivatives are those of single runs."""

    def peak(ratio):
        chain = gx.scenes.dimer(7, ratio=ratio)
        return struck(chain, 12.0, record={"force": FORCE}).recorded["force"]

    @jax.jit
    def by_hand(ratios):
        chains = jax.vmap(lambda ratio: gx.scenes.dimer(7, ratio=ratio), out_axes=-1)(ratios)
        return struck(chains, 12.0, record={"force": FORCE}).recorded["force"]

    ratios = jnp.asarray(RATIOS)
    assert_allclose(jax.jit(jax.vmap(peak))(ratios), by_hand(ratios).T, rtol=1e-14)

    def last(ratio, velocity):
        chain = gx.scenes.dimer(5, ratio=ratio, precompression=1.0)
        return struck(chain, 4.0, velocity, step=0.05).final.v[2]

    few = jnp.asarray([0.4, 0.8])
    speeds = jnp.asarray([0.5, 1.0, 2.0])
    grid = jax.vmap(jax.vmap(last, (None, 0)), (0, None))(few, speeds)
    assert_allclose(grid, [[last(float(r), float(v)) for v in speeds] for r in few], rtol=1e-9)
    slope = jax.grad(last)(0.4, 1.0)
    for found in (
        jax.jacfwd(last)(0.4, 1.0),
        jax.vmap(jax.grad(last), (0, None))(few, 1.0)[0],
        jax.grad(lambda r: jax.vmap(last, (0, None))(r, 1.0).sum())(few)[0],
    ):
        assert float(found) == pytest.approx(float(slope), rel=1e-9)
    step = 1e-4
    second = (jax.grad(last)(0.4 + step, 1.0) - jax.grad(last)(0.4 - step, 1.0)) / (2 * step)
    assert float(jax.hessian(last)(0.4, 1.0)) == pytest.approx(float(second), rel=1e-5)


@pytest.mark.slow
def test_breathers_over_mass_ratios_and_why_the_last_has_none(tmp_path):
    """Near a ratio of 0.6 the gap is too narrow for a breather of 21 beads."""

    def breather(ratio):
        chain = gx.scenes.dimer(21, ratio, precompression=1.0, boundary="free")
        orbit = gx.breathers.breather(chain, 0.988 * (3 / ratio) ** 0.5)
        return {"energy": orbit.energy, "verdict": orbit.floquet().verdict}

    data = sweep(breather, {"ratio": [0.3, 0.4, 0.5, 0.6]}, store=tmp_path / "breathers.zarr")
    good = (data.reason == "").values
    assert good.tolist() == [True, True, True, False]
    assert np.isfinite(data.energy.values[good]).all()
    assert set(data.verdict.values[good]) == {"stable", "unstable"}
    assert str(data.reason.values[3]).startswith("Not localised")


@pytest.mark.slow
def test_fits_of_traces_that_are_files(tmp_path):
    """The stiffness of each chain rises by 0.1 from one file to the next."""
    times = np.linspace(0.0, 12.0, 97)
    draw = np.random.default_rng(0)
    for k in range(4):
        chain = gx.scenes.monomer(8, stiffness=1.0 + 0.1 * k, precompression=0.1)
        vs = np.asarray(struck(chain, 12.0, save_at=97).vs)
        noisy = vs[:, [3, 6]] + 0.01 * draw.standard_normal((97, 2))
        table = np.column_stack([times, noisy])
        header = "Time (s),a (m/s),b (m/s)"
        np.savetxt(tmp_path / f"trace{k}.csv", table, delimiter=",", header=header, comments="")

    def fitted(trace):
        scene = lambda p: gx.scenes.monomer(8, stiffness=p["stiffness"], precompression=0.1)
        path = tmp_path / f"trace{trace}.csv"
        measured = gx.Traces.from_csv(path, velocity=[1, 2], sites=[3, 6], sigma=0.01)
        begin = lambda p, chain: gx.states.impact(chain)
        fit = gx.fit(scene, {"stiffness": 1.2}, measured, state=begin)
        return {"stiffness": fit.parameters["stiffness"], "error": fit.covariance[0, 0] ** 0.5}

    data = sweep(fitted, {"trace": range(4)})
    off = (data.stiffness - 1.0 - 0.1 * data.trace) / data.error
    assert (data.reason == "").all() and np.abs(off).max() < 4
