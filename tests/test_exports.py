"""Results go to xarray and to files of every format, and come back as the same Dataset."""

import dataclasses
import functools
import importlib
import pkgutil
import re
import typing

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from refusals import refused
from scipy.io import loadmat

import granjax as gx
from granjax import linear, measures
from granjax.continuation.newton import newton
from granjax.flow.run import Errors
from granjax.results import Result, array
from granjax.work_precision import Ladder, measure

N = 5
T = np.linspace(0.0, 2.0, 33)


@functools.cache
def chain():
    return gx.scenes.pattern(N, (1.0, 2.96), precompression=1.0, boundary="free")


def ring():
    return gx.scenes.monomer(N, precompression=1.0)


@functools.cache
def run():
    record = {
        "peak": gx.Peak(measures.contact_force),
        "ends": gx.Integral(lambda t, y, lattice: {"left": y.v[0]}),
    }
    return gx.simulate(
        chain(), gx.states.impact(chain(), velocity=0.1), 2.0, step=0.1, save_at=33, record=record
    )


@functools.cache
def fitted():
    def scene(p):
        return gx.scenes.monomer(N, stiffness=p["stiffness/A"], precompression=1.0)

    traces = gx.Traces(T, velocity=np.outer(np.sin(T), [1.0, 2.0]), sites=[1, 3], sigma=0.1)
    return gx.fit(
        scene,
        {"stiffness/A": 1.0},
        traces,
        state=lambda p, chain: gx.states.impact(chain),
        step=0.1,
        max_steps=2,
        throw=False,
    )


@functools.cache
def orbit():
    return gx.breathers.breather(chain(), 0.99 * 3**0.5, check=False)


def table():
    def call(step):
        return (np.array([1 + step**2]), np.ones(1)), 1 / step, 1 / step

    return measure(
        [Ladder("method", "step", [0.08, 0.01, 0.001], call)], (np.ones(1), np.ones(1)), 1e-12, 1
    )


# of different shapes, made in less than a second, or once for several
MAKERS = {
    "Run": run,
    "Fit": fitted,
    "Orbit": orbit,
    "WorkPrecision": table,
    "Floquet": lambda: orbit().floquet(steps=64),
    "NormalModes": lambda: linear.normal_modes(chain()),
    "Dispersion": lambda: linear.dispersion(ring(), np.linspace(0.1, 3.0, 4)),
    "ZoneMap": lambda: linear.zone_map(gx.scenes.square(5, boundary="periodic"), 8),
    "ComplexBands": lambda: linear.complex_bands(ring(), [0.4, 9.0]),
    "Spectrum": lambda: measures.spectrum(np.ones((33, N)), 0.1),
    "Derivative": lambda: gx.derivative(
        lambda x, step: {"a": x["a"] ** 2, "b": x["a"].sum()}, {"a": jnp.ones(2)}, 0.1
    ),
    "Root": lambda: newton(lambda x, _: x**2 - 2, np.ones(1)),
}
made = functools.cache(lambda name: MAKERS[name]())


def legible(text):
    """That a text is one for reading."""
    for ugly in ("f64", "Array(", "array(", "<function", "object at 0x", "np.float64(", "dtype"):
        assert ugly not in text, text
    assert 5 < len(text) < 2500 and len(text.splitlines()) < 30, text


def comes_back(path, data):
    """That a netCDF file holds a dataset, and a file of MATLAB its arrays."""
    if path.suffix == ".nc":
        again = xr.load_dataset(path)
        kinds = [
            {key: x.dtype.kind.replace("U", "O") for key, x in d.variables.items()}
            for d in (again, data)
        ]
        return again.identical(data) and kinds[0] == kinds[1]
    found = loadmat(path)
    numbers = {
        name: x.values
        for name, x in data.variables.items()
        if x.dtype.kind in "biufc" and name in found
    }
    return all(
        np.array_equal(np.ravel(found[name]), np.ravel(x), equal_nan=True)
        for name, x in numbers.items()
    )


def both_formats_hold(data, result, folder, **how):
    for ending in ("nc", "mat"):
        assert comes_back(result.save(folder / f"result.{ending}", **how), data), ending


# those that take a solved problem to make
LONG = {"Run", "Fit", "Orbit", "Floquet"}


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=[pytest.mark.slow] * (x in LONG)) for x in MAKERS]
)
def test_a_result_goes_out_and_comes_back(name, tmp_path):
    result = made(name)
    assert isinstance(result, Result) and type(result).__name__ == name
    legible(repr(result))
    data = result.to_xarray()
    for axis in data.dims:
        assert axis.partition("_")[0] != "site" or data[axis].values.tolist() == list(
            range(data.sizes[axis])
        )
    both_formats_hold(data, result, tmp_path)


def kinds():
    """Every class of results whose fields say what they are."""
    for module in pkgutil.walk_packages(gx.__path__, "granjax."):
        if "plots" not in module.name and not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    found = set()
    inner = [Result]
    while inner:
        inner = [kind for one in inner for kind in one.__subclasses__()]
        found |= {
            kind for kind in inner if kind.__module__.startswith("granjax") and kind._described
        }
    return sorted(found, key=lambda kind: f"{kind.__module__}.{kind.__name__}")


def known_alone(kind):
    """Whether a result itself says what a file holds of it, rather than its class."""
    return issubclass(kind, gx.Run) or {"_fields", "_held"} & {*vars(kind)}


def blank(kind):
    """A result of a class, with arrays that have the axes that its fields tell."""
    sizes = {}

    def value(hint, axes):
        own = [word for word in (axes or "").split() if word != "..."]
        shape = [3 if x == "site" else sizes.setdefault(x, len(sizes) + 4) for x in own]
        if hint in (str, int, float, bool):
            return hint(1)
        if hint is gx.State:
            return gx.State(np.ones(shape), np.full(shape, 2.0))
        if isinstance(hint, type) and issubclass(hint, Result):
            return None if known_alone(hint) else blank(hint)
        if typing.get_origin(hint) is tuple:
            words = typing.get_args(hint)[0] is str
            return tuple(f"word{k}" for k in range(*shape or (2,))) if words else ()
        known = [
            x
            for x in map(value, typing.get_args(hint), [axes] * 9)
            if isinstance(x, (Result, gx.State))
        ]
        whole = "int64" in str(getattr(hint, "dtypes", ""))
        x = np.arange(np.prod(shape, dtype=int), dtype=int if whole else float).reshape(shape)
        return known[0] if known else x

    told = kind._described
    made = {x.name: (x.type, told.get(x.name)) for x in dataclasses.fields(kind)}
    made |= {name: (object, held) for name, held in kind.exported.items()}
    values = {
        name: {} if held.named else value(hint, held.axes)
        for name, (hint, held) in made.items()
        if held
    }
    whole = type(
        kind.__name__, (kind,), {"__annotations__": {}, **{x: None for x in kind.exported}}
    )
    whole = type(kind.__name__, (whole,), {"outcome": "Found."})
    result = object.__new__(whole)
    for name, x in (dict.fromkeys(made) | values | {"outcome": "Found."}).items():
        if name in kind.exported or name == "outcome":
            type.__setattr__(whole, name, x)
        else:
            object.__setattr__(result, name, x)
    return result


@pytest.mark.parametrize("kind", kinds(), ids=lambda kind: kind.__name__)
def test_every_kind_of_result_goes_out_and_comes_back(kind, tmp_path):
    assert all(x.doc for name, x in kind._described.items() if name not in kind.exported)
    if known_alone(kind):
        return  # what a file holds of it is no list of its fields: among those that are made
    result = blank(kind)
    legible(repr(result))
    data = result.to_xarray()
    for name, _, held in result._fields():
        wanted = [x for x in (held.axes or "").split() if x != "..."]
        x = next((data.get(y) for y in (held.name or name, f"{name}_real") if y in data), None)
        if wanted and x is not None:
            assert {x.split("_")[0] for x in wanted} <= {axis.split("_")[0] for axis in x.dims}
            assert name in kind.exported or x.attrs["description"] == held.doc
    assert comes_back(result.save(tmp_path / "result.nc"), data)


def batch(ts, us, lanes, space=(1, 0), **recorded):
    """A run of such arrays, as `simulate` returns it."""
    return gx.Run(
        ts=ts,
        us=us,
        vs=us,
        final=gx.State(us, us),
        recorded=recorded,
        energy_error=np.full(lanes, 0.5),
        _margin=np.ones(lanes),
        _t1=1.0,
        code=np.zeros((), int),
        stats={"steps": np.full(lanes, 9), "rejected": np.zeros((), int)},
        solver="SRKN6b",
        _space=space,
        _mark=mark_of(np.shape(ts)[:-1], lanes, space),
    )


def mark_of(first, lanes, space):
    """What a batch's lattice says of units: one number for all sites, with the lanes before or behind."""
    ones = (1,) * (space[0] + (space[1] > 0))
    return np.ones((*lanes, *ones) if first == lanes else (*ones, *lanes))


RATIOS = np.array([0.2, 0.5, 1.0])
BY_RATIO = {"ratio": RATIOS}
LOADS = np.array([1.0, 2.0, 4.0])
NAMES_ = ["PTFE", "brass", "steel 316"]
F = 4
TIMES = np.arange(float(F))


@pytest.mark.slow
@pytest.mark.parametrize(
    "lanes, named, wanted",
    [
        ((3,), {"bead": NAMES_}, ("bead",)),
        ((3,), {"ratio": RATIOS, "load": LOADS}, ("lane",)),
        ((3, 2), {"ratio": RATIOS, "load": [1, 2]}, ("ratio", "load")),
        ((3, 2), {"ratio": RATIOS[:, None] * [1, 2]}, ("lane", "lane_1")),
    ],
    ids=str,
)
@pytest.mark.parametrize("first", [False, True])
def test_lanes_are_called_by_what_was_swept(lanes, named, wanted, first, tmp_path):
    shape = (N, *lanes)
    if first:
        us = np.ones((*lanes, F, N))
        ts = np.broadcast_to(TIMES, (*lanes, F))
    else:
        us = np.ones((F, *shape))
        ts = TIMES
    peak = np.ones((*lanes, N + 1) if first else (N + 1, *lanes))
    run = batch(ts, us, lanes, peak=peak, last=np.ones(lanes), site=np.ones(lanes))
    errors = {"site": np.ones(lanes), "last": np.ones(lanes), "peak": peak}
    energy = np.ones((*lanes, F) if first else (F, *lanes))
    each = np.ones(lanes)
    error = Errors(
        us,
        us,
        gx.State(us[..., 0, :], us[..., 0, :]) if first else gx.State(us[0], us[0]),
        energy,
        each,
        each,
        errors,
        how="a second run",
        _space=(1, 0),
    )
    run = dataclasses.replace(run, error=error)
    data = run.to_xarray(lanes=named)
    assert data.error_u.dims == data.u.dims and data.error_last.dims == wanted
    assert data.u.dims == ("time", "site", *wanted)
    assert np.all(data.u == 1.0) and np.array_equal(data.time, TIMES)
    assert (
        data.energy_error.dims
        == data["last"].dims
        == data.sites.dims
        == data.stats_steps.dims
        == wanted
    )
    assert data.time.dims == ("time",) and data.attrs["stats_rejected"] == 0
    assert data.peak.dims == ("peak_0", *wanted)
    for name, values in (named or {}).items():
        assert np.array_equal(data[name], values) and name in data.coords
    both_formats_hold(data, run, tmp_path, lanes=named)
    assert run.in_units("ms", lanes=named).u.dims == data.u.dims


def test_times_of_their_own_of_each_lane_are_kept():
    run = batch(np.outer([1.0, 2.0], np.arange(F)), np.ones((2, F, N)), (2,))
    data = run.to_xarray(lanes={"speed": [1.0, 2.0]})
    assert data.times.dims == ("time", "speed") and "time" not in data.variables
    behind = batch(np.outer(np.arange(F), [1.0, 2.0]), np.ones((F, N, 2)), (2,)).to_xarray()
    assert behind.times.dims == ("time", "lane") and behind.u.dims == ("time", "site", "lane")


@pytest.mark.parametrize(
    "lanes, said",
    [
        ({"ratio": [1.0]}, "lanes: expected names and values of 3 lanes, got ratio of shape (1,)"),
        ({}, "got none"),
        ({"ratio": RATIOS, "load": [1.0]}, "load of shape (1,)"),
        ({"u": RATIOS}, "lanes: expected names that nothing"),
        ({"time": RATIOS}, "expected names that nothing"),
    ],
)
def test_lanes_that_do_not_fit_are_refused(lanes, said, tmp_path):
    run = batch(TIMES, np.ones((F, N, 3)), (3,))
    with refused(re.escape(said)):
        run.to_xarray(lanes=lanes)
    with refused(re.escape(said)):
        run.save(tmp_path / "run.nc", lanes=lanes)
    assert not [*tmp_path.iterdir()]


@functools.cache
def mapped():
    """Runs of as many frames as lanes."""

    def confirmed(ratio):
        chain = gx.scenes.dimer(6, ratio=ratio, precompression=1.0)
        record = {"peak": gx.Peak(measures.contact_force)}
        start = gx.states.impact(chain, velocity=0.1)
        return gx.simulate(chain, start, 1.0, step=0.1, save_at=3, record=record, confirm=True)

    return jax.vmap(confirmed, out_axes=-1)(RATIOS)


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, -1])
def test_mapped_runs_and_their_errors_have_named_lanes(axis, tmp_path):
    run = jax.tree.map(lambda x: np.moveaxis(np.asarray(x), -1, axis), mapped())
    data = run.to_xarray(lanes=BY_RATIO)
    for name in ("u", "v", "error_u", "error_v"):
        assert data[name].dims == ("time", "site", "ratio"), name
    for name in ("error_final_u", "error_final_v"):
        assert data[name].dims == ("site", "ratio"), name
    assert data.error_energy.dims == ("time", "ratio")
    assert data.peak.dims == data.error_peak.dims == ("peak_0", "ratio")
    for name in ("energy_error", "contact_opened", "completed", "error_overlap", "stats_steps"):
        assert data[name].dims == ("ratio",), name
    assert data.time.dims == ("time",)
    for k, ratio in enumerate(RATIOS):
        alone = jax.tree.map(lambda x, k=k: x.take(k, axis), (run.us, run.error.us))
        np.testing.assert_array_equal(data.u.sel(ratio=ratio), alone[0])
        np.testing.assert_array_equal(data.error_u.sel(ratio=ratio), alone[1])
    assert comes_back(run.save(tmp_path / "run.nc", lanes=BY_RATIO), data)


@pytest.mark.parametrize("first", [True, False])
def test_a_batch_of_one_lane_has_that_lane(first):
    """The axes of sites and of lanes of the lattice's mark are both of length one: the arrays tell which is which."""
    us = np.ones((F, N, 1))
    ts = TIMES[:, None]
    run = batch(ts.T, us.transpose(2, 0, 1), (1,)) if first else batch(ts, us, (1,))
    data = run.to_xarray()
    assert data.u.dims == ("time", "site", "lane") and data.time.dims == ("time",)


def test_what_is_no_batch_has_no_lanes():
    one = batch(TIMES, np.ones((F, N)), ())
    with refused("lanes: expected a result of a batch"):
        one.to_xarray(lanes=BY_RATIO)
    assert one.to_xarray().u.dims == ("time", "site")


def stacked(name, count):
    """A batch whose lanes are one result, again and again."""
    return jax.tree.map(lambda *x: np.stack(x), *[made(name)] * count)


@pytest.mark.slow
def test_batches_of_other_results_are_named_too():
    modes = stacked("NormalModes", 3).to_xarray(lanes=BY_RATIO)
    assert modes.omega.dims == ("mode", "ratio") and modes.modes.dims == ("site", "mode", "ratio")
    chains = jax.vmap(lambda r: gx.scenes.dimer(6, ratio=r, precompression=1.0), out_axes=-1)(
        RATIOS
    )
    first, last = (
        jax.vmap(linear.normal_modes, in_axes=-1, out_axes=axis)(chains).to_xarray(lanes=BY_RATIO)
        for axis in (0, -1)
    )
    assert first.equals(last) and last.modes.dims == ("site", "mode", "ratio")
    waves = stacked("Dispersion", 3).to_xarray(lanes=BY_RATIO)
    assert waves.omega.dims == ("wave", "band", "ratio") and waves.k.dims == ("wave", "ratio")
    peaks = measures.Peaks(np.ones((N, 3)), np.ones((N, 3)))
    assert peaks.to_xarray(lanes=BY_RATIO).heights.dims == ("site", "ratio")
    front = measures.Front(np.ones(3), np.ones(3), np.ones((N, 3))).to_xarray(lanes=BY_RATIO)
    assert front.arrivals.dims == ("site", "ratio") and front.speed.dims == ("ratio",)
    orbit = stacked("Orbit", 2).to_xarray(lanes={"load": [1.0, 2.0]})
    assert orbit.state_u.dims == orbit.error_state_u.dims == (
        "site",
        "load",
    ) and orbit.omega.dims == ("load",)


def test_vectors_of_the_plane_and_fields_of_a_cell_are_named(tmp_path):
    plane = batch(TIMES, np.ones((F, 3, 4, 2, 3)), (3,), (2, 2))
    data = plane.to_xarray(lanes=BY_RATIO)
    assert data.u.dims == ("time", "site", "site_1", "component", "ratio")
    assert data.component.values.tolist() == ["x", "y"] and data.u.sel(
        component="y", site=1
    ).shape == (F, 4, 3)
    space = batch(TIMES, np.ones((F, N, 3)), (), (1, 3)).to_xarray()
    assert space.u.dims == ("time", "site", "component") and space.component.values.tolist() == [
        "x",
        "y",
        "z",
    ]
    cell = {"bead": np.ones((F, N, 2)), "core": np.zeros((F, N, 2))}
    data = batch(TIMES, cell, (2,)).to_xarray()
    assert (
        data.u.dims == ("time", "field", "site", "lane")
        and float(data.u.sel(field="core").max()) == 0
    )
    uneven = batch(TIMES, {"bead": np.ones((F, N)), "core": np.ones((F, N - 1))}, ())
    data = uneven.to_xarray()
    assert data.u_core.dims == ("time", "site_core") and data.site_core.size == N - 1
    for run in (plane, uneven):
        both_formats_hold(run.to_xarray(), run, tmp_path)


class Named(Result):
    values: object = array(axes="site")
    words: object = array(axes="word")
    parameters: object
    outcome: str = "Found."


def test_names_that_files_do_not_have(tmp_path):
    odd = {"a/b": 1.0, "2nd": np.ones(2), "\u00b5 [m]": 4.0, "outcome": "none"}
    result = Named(np.zeros(0), ["a", "", "\u00e9\u00df"], odd)
    again = xr.load_dataset(result.save(tmp_path / "odd.nc"))
    assert again.identical(result.to_xarray()) and again.words.values.tolist() == [
        "a",
        "",
        "\u00e9\u00df",
    ]
    assert loadmat(result.save(tmp_path / "odd.mat"))["parameters_2nd"].tolist() == [[1.0, 1.0]]
