"""Datasets in files of every format: what other programs find in them, what comes back, what is read of others."""

import io
import json
import re
import struct
import subprocess
import sys
import zipfile

import h5netcdf
import h5py
import jax
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.io import loadmat, savemat

import granjax as gx
from granjax import exchange
from granjax.exchange import by_name, csv_table, structure
from granjax.files import real_parts
from granjax.reading import reader

FORMATS = (("nc", None), ("npz", None), ("mat", "5"), ("mat", "7.3"), ("csv", None))
over = pytest.mark.parametrize("ending, version", FORMATS, ids=lambda x: str(x))
RNG = np.random.default_rng(3)
F, N = 7, 3
HARD = np.array([0.1, -0.0, np.nan, np.inf, -np.inf, 5e-324, 1.7976931348623157e308])


def trajectory(dims=("time", "site"), **lanes):
    """Times, displacements, velocities and what a run says of itself."""
    shape = {"time": F, "site": N, **{name: len(x) for name, x in lanes.items()}}
    arrays = {name: (dims, RNG.normal(size=[shape[axis] for axis in dims]), {"units": unit})
              for name, unit in (("u", "m"), ("v", "m/s"))}
    coords = {"time": ("time", np.arange(F) * 0.1, {"units": "s"}), "site": np.arange(N), **lanes}
    return xr.Dataset(arrays, coords, {"units": "SI", "outcome": "Completed; \u00e9, 'so'.", "count": 3})


def rich():
    """Every type that is kept, complex numbers, words with delimiters, nothing, a number alone."""
    data = trajectory()
    more = {
        "hard": ("time", HARD), "whole": ("time", np.arange(F) - 2**62), "far": ("time", np.full(F, 2**64 - 1, "u8")),
        "small": ("time", RNG.normal(size=F).astype("f4")), "half": ("time", np.arange(F, dtype="f2") / 3),
        "open": ("time", np.arange(F) > 3), "words": ("time", np.array(["a,b", '"', "\n", "#c", "", "\u00b5", "nan"])),
        "rho": (("time", "multiplier"), RNG.normal(size=(F, 2)) * np.exp(1j)), "peak": ("peak_0", np.arange(4.0)),
        "none": ("empty", np.zeros(0)), "alone": ((), 0.1), "big": ("time", np.arange(F, dtype=">f8") / 3),
    }
    more["rho"][1][0, 0] = complex(np.inf, -0.0)
    return data.assign(more).assign_attrs(root=1 - 2j, list=np.array([1.0, 2.0]), none=np.nan)


@over
def test_what_is_saved_comes_back_bit_by_bit(ending, version, tmp_path):
    data = rich()
    path = exchange.save(data, tmp_path / f"a.{ending}", version=version)
    again = exchange.load(path)
    if ending == "csv":
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
        assert exchange.load(path).identical(again)
        exchange.save(data, path)
    assert again.identical(real_parts(data)) and again.rho_real.dims == ("time", "multiplier")
    assert again.attrs["root_imag"] == -2 and again.attrs["outcome"] == data.outcome
    for name, x in real_parts(data).variables.items():
        # netCDF has no big-endian numbers here, nor zeros' signs in words
        same = again[name].values.astype(x.dtype) if x.dtype.kind in "biuf" else x.values
        assert same.tobytes() == np.ascontiguousarray(x.values).tobytes(), name
    joined = exchange.load(path, complex=True)
    assert joined.rho.values.tobytes() == data.rho.values.tobytes() and joined.attrs["root"] == 1 - 2j
    assert exchange.load(exchange.save(joined, path, version=version)).identical(again)


def test_numpy_reads_an_npz_file_without_pickles(tmp_path):
    data = rich()
    path = exchange.save(data, tmp_path / "a.npz")
    with np.load(path, allow_pickle=False) as file:
        assert np.array_equal(file["u"], data.u) and file["words"].tolist() == data.words.values.tolist()
        told = json.loads(str(file["granjax_structure"]))
    assert told["variables"]["u"]["axes"] == ["time", "site"] and told["variables"]["v"]["told"] == {"units": "m/s"}
    assert told["attributes"]["outcome"] == data.outcome
    assert path.read_bytes() == exchange.save(data, tmp_path / "b.npz").read_bytes()


def test_a_trajectory_is_a_table_that_others_read(tmp_path):
    data = trajectory()
    path = exchange.save(data, tmp_path / "a.csv")
    head, *_, last = path.read_text().splitlines()
    assert head == "time (s),u_0 (m),u_1 (m),u_2 (m),v_0 (m/s),v_1 (m/s),v_2 (m/s)"
    assert last.startswith("# granjax_structure: ") and '# "count": 3' in path.read_text()
    frame = pd.read_csv(path, comment="#")
    assert frame.columns.tolist() == head.split(",")
    np.testing.assert_allclose(frame["u_1 (m)"], data.u[:, 1], rtol=1e-15)
    array = np.genfromtxt(path, delimiter=",", names=True)
    assert np.array_equal(array["v_2_ms"], data.v[:, 2]) and array.shape == (F,)
    traces = gx.Traces.from_csv(path, velocity=["v_0", "v_2"], time="time", sites=[0, 2])
    assert np.array_equal(traces.data, data.v[:, [0, 2]]) and np.array_equal(traces.times, data.time)
    assert traces.origin.units == "time in s (header), v_0 in m/s (header), v_2 in m/s (header)"
    scaled = trajectory()
    for x in (scaled.u, scaled.v, scaled.time):
        x.attrs = {"units": "scaled", "si_units": "m"}
    path = exchange.save(scaled, path)
    assert path.read_text().startswith("time,u_0,u_1") and exchange.load(path).identical(scaled)
    traces = gx.Traces.from_csv(path, displacement="u_1", sites=1)
    assert np.array_equal(traces.data[:, 0], scaled.u[:, 1]) and "taken" in traces.origin.units


def test_a_batch_or_a_sweep_is_a_row_for_each_lane(tmp_path):
    ratios = np.array([0.2, 0.5])
    data = trajectory(("time", "site", "ratio"), ratio=ratios).assign(energy=("ratio", [1.0, 2.0]))
    path = exchange.save(data, tmp_path / "a.csv")
    lines = path.read_text().splitlines()
    assert lines[0].startswith("ratio,time (s),u_0 (m)") and lines[0].endswith(",energy")
    assert lines[8].startswith("0.5,0.")
    assert lines[1].startswith(f"0.2,0.0,{float(data.u[0, 0, 0])!r},") and exchange.load(path).identical(data)
    over = "ratio", "load"
    grid = xr.Dataset({"decay": (over, RNG.normal(size=(2, 3))), "reason": (over, [["", "a,b", ""]] * 2)},
                      {"ratio": ratios, "load": ("load", [1.0, 2.0, 4.0], {"units": "N"})})
    lines = exchange.save(grid, path).read_text().splitlines()
    assert lines[0] == "ratio,load (N),decay,reason" and lines[2] == f'0.2,2.0,{float(grid.decay[0, 1])!r},"a,b"'
    assert exchange.load(path).identical(grid)
    paired = xr.Dataset({"decay": ("lane", [1.0, 2.0])}, {"ratio": ("lane", ratios)})
    assert exchange.save(paired, path).read_text().startswith("ratio,decay\n0.2,1.0\n")
    bare = xr.Dataset({"u": (("lane", "time", "site"), np.ones((2, F, N)))})
    assert exchange.save(bare, path).read_text().startswith("lane,frame,u_0,u_1,u_2\n0,0,1.0,1.0,1.0\n0,1")
    assert exchange.load(path).identical(bare)


def test_what_no_table_holds_is_refused(tmp_path, monkeypatch):
    data = trajectory().assign(modes=(("mode", "mode_1"), np.ones((300, 300))))
    with pytest.raises(ValueError, match=r"a table over time, got modes over mode and mode_1 too.*data\[\['modes'\]\]"):
        exchange.save(data, tmp_path / "a.csv")
    monkeypatch.setattr(csv_table, "MOST", 10)
    with pytest.raises(ValueError, match="at most 10 numbers in a .csv file"):
        exchange.save(trajectory(), tmp_path / "a.csv")
    days = xr.Dataset({"day": ("day", np.array(["2020-01-01"], "M8[ns]"))})
    for ending in ("csv", "npz", "mat"):
        with pytest.raises(ValueError, match="variables of numbers or words, got day of type datetime64"):
            exchange.save(days, tmp_path / f"a.{ending}")
    odd = xr.Dataset({"x": ("x", [1.0])})
    stacked = xr.Dataset({"y": (("a", "b"), np.ones((2, 2)))}, {"a": [1, 2], "b": [3, 4]}).stack(ab=("a", "b"))
    mixed = {"a": [np.int64(3), 4.5], "b": (True, False), "c": np.bool_(True), "d": jax.numpy.ones(2),
             "e": np.str_("x")}
    bad = object(), None, {"a": 1}, [1, [2]], 10**40
    for ending, version in FORMATS:
        for data, said in (
            *((odd.assign_attrs(what=x), "attributes that are numbers") for x in bad),
            (odd.assign(y=odd.x.assign_attrs(why=None)), "attributes that are numbers"),
            (odd.rename(x="a/b"), "names that are words"), (odd.assign_attrs({3: 4}), "names that are words"),
            (stacked, "coordinates of one level, got 'ab'"),
            (odd.assign(y=odd.x.assign_attrs(why=1j)), "attributes that are numbers"),
        ):
            with pytest.raises(ValueError, match=said):
                exchange.save(data, tmp_path / f"a.{ending}", version=version)
        path = exchange.save(odd.assign_attrs(mixed), tmp_path / f"a.{ending}", version=version)
        assert exchange.load(path).identical(odd.assign_attrs({key: np.asarray(x) for key, x in mixed.items()}))
        path.unlink()
    taken = xr.Dataset({"z": ("x", [1j]), "z_real": ("x", [1.0])})
    for ending in ("nc", "csv"):
        with pytest.raises(ValueError, match="data: expected no other 'z_real' beside the complex 'z'"):
            exchange.save(taken, tmp_path / f"a.{ending}")
    for keywords, path, said in (
        ({}, "a.txt", "ends in .nc, .npz, .mat or .csv"),
        ({"version": "6"}, "a.mat", "version: expected one of '5', '7.3'"),
        ({"version": "7.3"}, "a.nc", "version: expected a name that ends in .mat"),
    ):
        with pytest.raises(ValueError, match=said):
            exchange.save(odd, tmp_path / path, **keywords)
    for told in ({"scale_factor": 2.0}, {"_FillValue": 1.0}, {"units": "days since 2000-01-01"}):
        with pytest.raises(ValueError, match="attributes that do not change numbers in a .nc file, got y with"):
            exchange.save(odd.assign(y=("x", [1.0], told)), tmp_path / "a.nc")
    with pytest.raises(ValueError, match="data: expected what netCDF holds, got .*reserved"):
        exchange.save(odd.assign_attrs(_NCProperties="mine"), tmp_path / "a.nc")
    with pytest.raises(ValueError, match="data: expected an xarray.Dataset, got ndarray"):
        exchange.save(np.ones(3), tmp_path / "a.nc")
    assert not [*tmp_path.iterdir()]


def test_version_7_3_is_laid_out_as_matlab_does(tmp_path, monkeypatch):
    data = rich()
    path = exchange.save(data, tmp_path / "a.mat", version="7.3")
    head = path.read_bytes()[:512]
    assert head.startswith(b"MATLAB 7.3 MAT-file") and head[124:128] == b"\x00\x02IM"
    with h5py.File(path) as file:
        assert file.userblock_size == 512
        assert file["u"].shape == (N, F) and file["peak"].shape == (4, 1)
        assert file["u"].attrs["MATLAB_class"] == b"double"
        assert file["open"].dtype == "u1" and file["open"].attrs["MATLAB_int_decode"] == 1
        assert file["attributes"].attrs["MATLAB_class"] == b"struct"
        outcome = file["attributes/outcome"]
        assert outcome.attrs["MATLAB_class"] == b"char" and outcome[()].T.tobytes().decode("utf-16-le") == data.outcome
        fields = [b"".join(x).decode() for x in file["attributes"].attrs["MATLAB_fields"]]
        assert fields[:3] == ["units", "outcome", "count"] and len(fields) == len(file["attributes"])
        word = file[file["words"][0, 0]]
        assert word.attrs["MATLAB_class"] == b"char" and word[()].tobytes().decode("utf-16-le") == "a,b"
        assert file["none"].attrs["MATLAB_empty"] == 1
    five = exchange.save(trajectory(), tmp_path / "b.mat")
    assert not h5py.is_hdf5(five) and np.array_equal(loadmat(five)["time"], [np.arange(F) * 0.1])
    monkeypatch.setattr(by_name, "MOST", 8 * F * N)
    assert h5py.is_hdf5(exchange.save(trajectory(), five))


def of_matlab(path, arrays):
    """A file as MATLAB 7.3 writes it: a char array, a cell, complex, logical, a struct, an empty matrix, deflated."""
    with h5py.File(path, "w", userblock_size=512) as file:
        def put(name, x, kind, **more):
            file[name] = x
            file[name].attrs["MATLAB_class"] = np.bytes_(kind)
            for key, value in more.items():
                file[name].attrs[key] = value

        pair = np.zeros((2, 4), [("real", "f8"), ("imag", "f8")])
        pair["real"], pair["imag"] = arrays["z"].T.real, arrays["z"].T.imag
        put("z", pair, "double")
        put("note", np.frombuffer("stål".encode("utf-16-le"), "<u2")[:, None], "char", MATLAB_int_decode=2)
        put("lines", np.array([[97, 98], [99, 100]], "<u2").T, "char", MATLAB_int_decode=2)
        put("open", np.array([[1, 0, 1]], "u1").T, "logical", MATLAB_int_decode=1)
        put("gone", np.array([0, 3], "u8"), "double", MATLAB_empty=1)
        file.create_dataset("u", data=arrays["u"].T, chunks=(1, 4), compression="gzip")
        put("count", np.array([[7]], "i4"), "int32")
        put("scan/gate", arrays["u"][:, :1].T, "double")
        file["scan"].attrs["MATLAB_class"] = np.bytes_("struct")
        put("#refs#/b", np.frombuffer("PTFE".encode("utf-16-le"), "<u2")[:, None], "char")
        put("#refs#/c", np.ones((1, 1)), "double")
        file.create_dataset("names", data=np.array([[file["#refs#/b"].ref]] * 2, h5py.ref_dtype))
        file.create_dataset("mixed", data=np.array([[file["#refs#/c"].ref]], h5py.ref_dtype))
        for name in ("names", "mixed"):
            file[name].attrs["MATLAB_class"] = np.bytes_("cell")
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM".ljust(388) + path.read_bytes()[512:])


def test_arrays_of_a_user_s_own_files(tmp_path):
    u, z = RNG.normal(size=(6, 2)), RNG.normal(size=(4, 2)) * np.exp(2j)
    of_matlab(tmp_path / "a.mat", {"u": u, "z": z})
    savemat(tmp_path / "b.mat", {
        "u": u, "z": z, "note": "stål", "open": np.array([[True, False, True]]), "count": np.int32(7),
        "scan": {"gate": u[:, :1]}, "names": np.array([["PTFE", "PTFE"]], object)})
    names = "u", "z", "note", "open", "count", "scan.gate", "names"
    for path in ("a.mat", "b.mat"):
        found = exchange.arrays(tmp_path / path, *names)
        assert [*found] == [*found] and np.array_equal(found["u"], u) and found["z"].tobytes("F") == z.tobytes("F")
        assert found["note"] == "stål"
        assert found["open"].tolist() == [[True, False, True]] and found["open"].dtype == bool
        assert found["count"].item() == 7 and np.array_equal(found["scan.gate"], u[:, :1])
        assert found["names"].ravel().tolist() == ["PTFE", "PTFE"]
        with pytest.raises(ValueError, match="names: expected one of .*'count'"):
            exchange.arrays(tmp_path / path, "counts")
    assert exchange.arrays(tmp_path / "a.mat", "gone", "lines")["lines"].tolist() == ["ab", "cd"]
    (tmp_path / "e.csv").write_text("t [ms],a,a\n0,1,2\n1,3,5\n")
    assert exchange.arrays(tmp_path / "e.csv", "T")["T"].tolist() == [0, 1]
    found = exchange.arrays(tmp_path / "e.csv")
    assert [*found][:2] == ["t [ms]", "a"] and [x.tolist() for x in found.values()] == [[0, 1], [1, 3], [2, 5]]
    (tmp_path / "e.txt").write_text("0 1.5\n1 2.5\n2 3.5\n")
    assert exchange.arrays(tmp_path / "e.txt")["1"].tolist() == [1.5, 2.5, 3.5]
    with pytest.raises(ValueError, match="names: expected one of .*, got 'b'"):
        exchange.arrays(tmp_path / "e.csv", "b")
    with pytest.raises(ValueError, match="mixed.* that are no words"):
        exchange.arrays(tmp_path / "a.mat")
    with pytest.raises(ValueError, match="velocity: expected a variable of real numbers, got 'z', which is complex"):
        gx.Traces.from_mat(tmp_path / "a.mat", velocity="z", sampling=1.0, sites=[0, 1])
    np.savez_compressed(tmp_path / "c.npz", u=u, z=z, note="stål")
    found = exchange.arrays(tmp_path / "c.npz")
    assert np.array_equal(found["u"], u) and np.array_equal(found["z"], z) and found["note"] == "stål"
    xr.Dataset({"u": (("t", "n"), u)}).to_netcdf(tmp_path / "d.nc", engine="h5netcdf")
    assert np.array_equal(exchange.arrays(tmp_path / "d.nc")["u"], u)


class Trap:
    """What runs code where a pickle is read."""

    def __reduce__(self):
        return (open, ("caught", "w"))


def test_no_pickle_is_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez("a.npz", trap=np.array([Trap()], object), u=np.ones(3))
    assert [*exchange.arrays("a.npz")] == ["u"]
    for ask in (lambda: exchange.arrays("a.npz", "trap"), lambda: exchange.load("a.npz")):
        with pytest.raises(ValueError, match="a pickled object, which is not read|granjax did not write it"):
            ask()
    good = exchange.save(trajectory(), "b.npz")
    with zipfile.ZipFile(good) as file, zipfile.ZipFile("c.npz", "w") as other:
        for name in file.namelist():
            kept = zipfile.ZipFile("a.npz").read("trap.npy") if name == "u.npy" else file.read(name)
            other.writestr(name, kept)
    with pytest.raises(ValueError, match="path: expected an .npz file that `save` wrote"):
        exchange.load("c.npz")
    assert not (tmp_path / "caught").exists()


# ------------------------------------------------------------------------------------------------ a run that was saved


@pytest.mark.slow
def test_a_run_that_was_saved_is_drawn_and_goes_on(tmp_path):
    import matplotlib.pyplot as plt

    chain = gx.scenes.monomer(N, precompression=1.0).counted_in("SI")
    run = gx.simulate(chain, gx.states.impact(chain, velocity=0.1), 1.0, step=0.05, save_at=F)
    for ending, version in FORMATS:
        data = gx.Result.load(run.save(tmp_path / f"a.{ending}", version=version), lazy=ending == "nc")
        y = gx.states.stored(chain, data)
        np.testing.assert_array_equal(y.u, run.us[-1])
        np.testing.assert_array_equal(y.v, run.vs[-1])
    np.testing.assert_array_equal(gx.states.stored(chain, data, 2).v, run.vs[2])
    on = gx.simulate(chain, y, 1.0, step=0.05)
    whole = gx.simulate(chain, gx.states.impact(chain, velocity=0.1), 2.0, step=0.05)
    np.testing.assert_allclose(on.us[-1], whole.us[-1], atol=1e-14)
    ax, same = gx.plots.space_time(data), gx.plots.space_time(run)
    assert ax.get_ylabel() == same.get_ylabel() == "time (s)"
    np.testing.assert_array_equal(ax.images[0].get_array(), same.images[0].get_array())
    assert gx.plots.space_time(data, quantity="u", units="ms").get_ylabel() == "time (ms)"
    plt.close("all")
    with pytest.raises(ValueError, match="run_or_array: expected a run with u"):
        gx.plots.space_time(data.drop_vars("u"), quantity="u")
    for wrong, chain_, frame, said in (
        (data.drop_vars("v"), chain, -1, "data: expected a dataset with v over time, got .*u"),
        (data, chain, F, f"frame: expected one of {F} frames"),
        (data, gx.scenes.monomer(N + 1).counted_in("SI"), -1, "data.u"),
        (data, gx.scenes.monomer(N).counted_in("scaled"), 0, "numbers in scaled, as those of the lattice, got .* SI"),
        (3, chain, -1, "data: expected a dataset with u over time, got int"),
    ):
        with pytest.raises(ValueError, match=said):
            gx.states.stored(chain_, wrong, frame)


def test_fields_vectors_and_lanes_come_back_as_states():
    cell = gx.Lattice({"bead": 1.0, "core": 0.5}, (gx.Bond(gx.Shift(1, "periodic", "bead"), gx.Linear(1.0)),), sites=4)
    y = gx.states.random(cell, 2)
    data = xr.Dataset({name: (("time", "field", "site"), np.stack([np.stack([*x.values()])] * 2)) for name, x in (
        ("u", y.u), ("v", y.v))}, {"field": [*y.u]})
    again = gx.states.stored(cell, data)
    assert again.u.keys() == y.u.keys() and all(np.array_equal(again.v[key], y.v[key]) for key in y.v)
    u = RNG.normal(size=(3, F, N))
    chains = jax.vmap(lambda k: gx.scenes.monomer(N, stiffness=k), out_axes=-1)(np.ones(3))
    data = xr.Dataset({name: (("ratio", "time", "site"), u) for name in "uv"})
    np.testing.assert_array_equal(gx.states.stored(chains, data, 1).u, u[:, 1].T)


# --------------------------------------------------------------------------------------------------------------- lazily


LAZY = (("nc", None), ("npz", None), ("mat", "7.3"))


@pytest.mark.slow
@pytest.mark.parametrize("ending, version", LAZY)
def test_what_is_read_lazily_is_what_is_there(ending, version, tmp_path):
    data = trajectory(("time", "site", "lane"), lane=np.arange(4)).assign(
        rho=(("site", "lane"), RNG.normal(size=(N, 4)) * 1j), words=("site", ["a", "b", "c"]),
        open=("lane", [True] * 4),
        alone=((), 2.5), none=("empty", np.zeros(0)))
    path = exchange.save(data, tmp_path / f"a.{ending}", version=version)
    found = exchange.load(path, lazy=True, complex=True)
    assert not any(found[name].variable._in_memory for name in ("u", "v", "rho"))
    rng = np.random.default_rng(5)
    for _ in range(40):
        key = []
        for n in data.u.shape:
            at = int(rng.integers(-n, n))
            key.append([at, slice(None), slice(None, None, -1), slice(at, None, 2), rng.integers(0, n, 3),
                        np.arange(n) > 1, slice(2, 2)][rng.integers(7)])
        np.testing.assert_array_equal(found.u[tuple(key)].values, data.u[tuple(key)].values, strict=True)
        one = dict(zip(("site", "lane"), key[1:]))
        np.testing.assert_array_equal(found.rho.isel(one).values, data.rho.isel(one).values, strict=True)
    assert found.sel(time=0.3, method="nearest").u.load().identical(data.sel(time=0.3, method="nearest").u)
    assert float(found.u.mean()) == float(data.u.mean()) and found.load().identical(data)
    found = exchange.load(path, lazy=True)
    reader._Running.process.kill()
    assert np.array_equal(found.v, data.v)
    exchange.save(data.isel(time=slice(3)), path, version=version)
    with pytest.raises(ValueError, match="it is no longer the file that was opened"):
        found.u.values
    found = exchange.load(path, lazy=True)
    path.unlink()
    with pytest.raises(ValueError, match="path: expected an? .* file that `save` wrote"):
        found.u.values
    for ending, said in (("csv", "a text, which is read whole"), ("mat", "of an older version, which is read whole")):
        whole = exchange.save(data, tmp_path / f"b.{ending}")
        with pytest.raises(ValueError, match=f"lazy: expected a .nc, .npz or .mat file.*{said}"):
            exchange.load(whole, lazy=True)


def sparse(folder):
    """Files of 3 GiB each of which little is on the disk: a waveform `v` of two sensors, its times in the first."""
    count = 2**27
    with h5netcdf.File(folder / "a.nc", "w") as file:
        file.dimensions = {"time": count, "site": 2}
        for name, axes in (("v", ("time", "site")), ("time", ("time",))):
            file.create_variable(name, axes, "f8")[-4:] = np.ones((4, 2)[: len(axes)])
    with h5py.File(folder / "a.mat", "w", userblock_size=512) as file:
        file.create_dataset("v", (2, count), "f8")[:, -4:] = 1.0
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (count, 2)})
    size = len(head.getvalue()) + 16 * count
    with (folder / "a.npz").open("wb") as file:
        file.write(struct.pack("<4s5H3I2H", b"PK\3\4", 20, 0, 0, 0, 33, 0, size, size, 5, 0))
        file.write(b"v.npy" + head.getvalue())
        file.seek(16 * count - 32, 1)
        file.write(np.ones(4).tobytes())
        place = file.tell()
        file.write(struct.pack("<4s6H3I5H2I", b"PK\1\2", 20, 20, 0, 0, 0, 33, 0, size, size, 5, 0, 0, 0, 0, 0, 0))
        file.write(b"v.npy")
        file.write(struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 1, 1, file.tell() - place, place, 0))
    assert all(path.stat().st_blocks * 512 < 2**26 for path in folder.iterdir())


MEASURED = """
import resource, sys
import granjax as gx
from granjax import exchange
from granjax.reading import reader

folder, before = sys.argv[1], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
data = exchange.load(folder + "/a.nc", lazy=True)
assert data.sizes["time"] == 2**27 and data.v[-3:].values.tolist() == [[1, 1]] * 3, data
assert data.v[::2**25, 1].values.tolist() == [0] * 4 and float(data.time[-1]) == 1
for read, ending in ((gx.Traces.from_netcdf, "nc"), (gx.Traces.from_npz, "npz"), (gx.Traces.from_mat, "mat")):
    end = (2**27 - 4) / 1e6
    traces = read(f"{folder}/a.{ending}", velocity=("v", 1), sites=3, sampling=1e6, start=end - 5e-7)
    assert traces.data.tolist()[-2:] == [[1], [1]] and 4 <= len(traces.times) <= 5, traces
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
with open(f"/proc/{reader._Running.process.pid}/status") as file:
    other = next(int(line.split()[1]) for line in file if line.startswith("VmHWM"))
print((after - before) / 1024, other / 1024)
"""


@pytest.mark.study
@pytest.mark.skipif(sys.platform != "linux", reason="sparse files, and what a process has held")
def test_a_waveform_of_gigabytes_costs_what_is_looked_at(tmp_path):
    sparse(tmp_path)
    ran = subprocess.run([sys.executable, "-c", MEASURED, str(tmp_path)], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    ours, reader = map(float, ran.stdout.split())
    assert ours < 100 and reader < 400, ran.stdout


# ------------------------------------------------------------------------------------------------------- any dataset

AXES = {"time": 3, "site": 2, "ratio": 2, "lane": 1, "field": 2, "peak_0": 4, "empty": 0, "component": 3}


def any_dataset(rng):
    """A dataset of some axes, types, words, coordinates and attributes."""
    def array(axes, kinds=("f8", "f8", "f4", "f2", "i8", "u1", "?", "c16", "U")):
        shape = tuple(AXES[axis] for axis in axes)
        kind = str(rng.choice(kinds))
        if kind == "U":
            return np.array([str(rng.choice(WORDS)) for _ in range(int(np.prod(shape)))], object).reshape(shape)
        x = rng.normal(size=shape) * 10.0 ** rng.integers(-20, 20) if kind in ("f8", "c16") else 99 * rng.random(shape)
        x = np.where(rng.random(shape) < 0.1, rng.choice([np.nan, np.inf, -0.0]), x) if kind == "f8" else x
        return (x * (1 - 2j) if kind == "c16" else x).astype(kind)

    data = xr.Dataset()
    for k in range(rng.integers(1, 6)):
        axes = [str(axis) for axis in rng.permutation(list(AXES))[: rng.integers(0, 4)]]
        data[f"x{k}"] = axes, array(axes), {"units": "m"} if rng.integers(2) else {}
    for axis in data.dims:
        kind = rng.integers(4)
        if kind:
            data.coords[axis if kind > 1 else f"of {axis}"] = (axis, array([axis], ("f8", "i8", "c16", "U")))
    return data.assign_attrs({"a b": str(rng.choice(WORDS)), "n": float(rng.normal()), "many": rng.normal(size=3)})


WORDS = ["", "a", "a,b", '"', "'", "\n", "\r\n", "\r", "#", "# granjax_structure: {}", "\u00b5", "nan", "1.5", " "]


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [range(8), pytest.param(range(8, 400), marks=pytest.mark.study)])
def test_any_dataset_goes_through_every_format(tmp_path, seeds):
    for seed in seeds:
        data = any_dataset(np.random.default_rng([7, seed]))
        for ending, version in FORMATS:
            path = exchange.save(data, tmp_path / f"a.{ending}", version=version)
            assert exchange.load(path, complex=True).identical(data), (seed, ending, version)
            if (ending, version) in LAZY:
                assert exchange.load(path, lazy=True, complex=True).load().identical(data), (seed, ending)


def leaves(x, place=()):
    """Places of all that a structure says."""
    for key, inside in (x.items() if isinstance(x, dict) else enumerate(x) if isinstance(x, list) else ()):
        yield (*place, key)
        yield from leaves(inside, (*place, key))


NASTY = (None, -1, 0, 2**70, 1e308, float("nan"), "", "u", "O", "M8[ns]", "<U99999999", "time", [], [3], [10**12], {},
         {"u": 1}, True)


@pytest.mark.slow
@pytest.mark.parametrize("count", [150, pytest.param(5000, marks=pytest.mark.study)])
def test_a_structure_that_somebody_made_up_gives_a_dataset_or_a_sentence(tmp_path, count):
    """What a file says of itself may be anything, with the right sum: no other error, no flood of memory, no code."""
    data = trajectory().assign(words=("site", ["a", "b", "c"]), peak=("peak_0", np.ones(2)))
    whole = {path.suffix: path for path in (
        exchange.save(data, tmp_path / f"a.{ending}", version=version) for ending, version in (
            ("npz", None), ("mat", "7.3"), ("csv", None)))}
    refused = 0
    for k in range(count):
        rng = np.random.default_rng([11, k])
        ending = list(whole)[k % 3]
        path, content = tmp_path / f"b{ending}", whole[ending].read_bytes()
        if ending == ".csv":
            head, _, last = content.decode().rpartition(csv_table.LAST)
        else:
            last = exchange.arrays(whole[ending], "granjax_structure")["granjax_structure"]
        told = json.loads(last)
        told.pop("digest")
        *place, key = list(leaves(told))[rng.integers(len(list(leaves(told))))]
        inside = told
        for step in place:
            inside = inside[step]
        inside[key] = NASTY[rng.integers(len(NASTY))]
        said = structure.text(told)
        if ending == ".csv":
            path.write_text(head + csv_table.LAST + said + "\n")
        elif ending == ".npz":
            with zipfile.ZipFile(whole[ending]) as file, zipfile.ZipFile(path, "w") as other:
                for name in file.namelist():
                    member = io.BytesIO()
                    np.save(member, np.array(said))
                    other.writestr(name, member.getvalue() if name == "granjax_structure.npy" else file.read(name))
        else:
            path.write_bytes(content)
            with h5py.File(path, "a") as file:
                del file["granjax_structure"]
                by_name._put(file, file, "granjax_structure", said)
        for lazy in (False, True)[: 1 + (ending != ".csv")]:
            try:
                assert isinstance(exchange.load(path, lazy=lazy).load(), xr.Dataset)
            except ValueError as error:
                assert re.match("path: expected .*, got ", str(error), re.S), (k, error)
                refused += 1
    assert refused > count / 3
