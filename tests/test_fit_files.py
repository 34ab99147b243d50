"""Traces from files: columns, units, triggers and windows come out as they were recorded."""

import h5py
import numpy as np
import pytest
import xarray as xr
from scipy.io import savemat

from granjax import exchange
from granjax.fit import Traces, waveforms
from granjax.fit.files import read_arrays, read_csv

T = np.arange(40) * 1e-4
VOLTS = np.stack([np.sin(900 * T), np.cos(700 * T)], axis=1)
SIGNALS = VOLTS * [0.125, 0.025]
# at rest until 2 ms, then a rise; the trigger channel passes 2.5 V halfway between samples 19 and 20
NOISE = 0.01 * np.random.default_rng(0).normal(size=(40, 2))
BURST = NOISE + 0.3 + np.where(T > 1.95e-3, np.sin(3000 * (T - 1.95e-3)), 0.0)[:, None]
GATE = np.where(np.arange(40) < 20, 0.0, 5.0)


def write(path, head, columns, delimiter=",", decimal="."):
    rows = [delimiter.join(f"{x:.17g}" if np.isfinite(x) else "" for x in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([*head, *rows]).replace(".", decimal) + "\n")
    return path


@pytest.mark.parametrize("head, delimiter, decimal", [
    ([], ",", "."),
    (["time,one,two"], ",", "."),
    (["# Vibrometer 7", "# 3 averages", "", "# time\tone\ttwo"], "\t", "."),
    (["Model,XY 12", "Samples,40,", "time,one,two", "s,V,V"], ",", "."),
    (['"Time [ s ]";"One [ V ]";"Two [ V ]"'], ";", ","),
    (["% oscilloscope", "time one two"], " ", "."),
])
def test_headers_delimiters_and_decimal_commas_are_recognised(tmp_path, head, delimiter, decimal):
    path = write(tmp_path / "scan.csv", head, [T, VOLTS], delimiter, decimal)
    traces = read_csv(path, velocity=[1, 2], sites=[2, 5], gain=1.0)
    np.testing.assert_array_equal(traces.times, T)
    np.testing.assert_array_equal(traces.data, VOLTS)
    assert (traces.kind, traces.places, traces.sigma) == ("velocity", ((2,), (5,)), None)
    if head:
        named = read_csv(path, time="time", displacement=["two"], sites=5, gain=1.0)
        np.testing.assert_array_equal(named.data, VOLTS[:, 1:])
        assert named.kind == "displacement"


def test_sampling_gain_and_missing_samples(tmp_path):
    broken = VOLTS.copy()
    broken[3, 1] = np.nan
    path = write(tmp_path / "scan.csv", ["one,two"], [broken])
    traces = read_csv(path, velocity=["one", "two"], sites=[2, 5], sampling=1e4, gain=[0.125, 0.025], sigma=1e-3)
    np.testing.assert_allclose(traces.times, T, rtol=1e-15)
    np.testing.assert_array_equal(traces.data[:, 0], SIGNALS[:, 0])
    assert np.isnan(traces.data[3, 1]) and np.isnan(traces.data).sum() == 1
    assert float(traces.weights[3, 1]) == 0.0
    fitted = read_csv(path, force="one", contacts=0, sampling=1e4, gain="amplifier")
    assert fitted.gain == "amplifier"
    np.testing.assert_array_equal(fitted.data[:, 0], VOLTS[:, 0])


def test_time_is_counted_from_the_trigger_and_the_noise_is_what_came_before(tmp_path):
    path = write(tmp_path / "scan.csv", ["time,gate,one,two"], [T, GATE, BURST])
    traces = read_csv(path, velocity=["one", "two"], sites=[2, 5], trigger=("gate", 2.5), stop=1e-3, gain=2.0)
    np.testing.assert_allclose(traces.times, T[20:30] - 1.95e-3, atol=1e-18)
    np.testing.assert_array_equal(traces.data, 2 * BURST[20:30])
    np.testing.assert_allclose(traces.sigma, 2 * BURST[:18].std(axis=0, ddof=1), rtol=1e-12)
    still = read_csv(path, velocity=["one", "two"], sites=[2, 5], trigger=1.95e-3, start=-1e-3, baseline=True)
    np.testing.assert_allclose(still.times, T[10:] - 1.95e-3, atol=1e-18)
    np.testing.assert_allclose(still.data, BURST[10:] - BURST[:18].mean(axis=0), atol=1e-15)


@pytest.mark.parametrize("version", [5, 7.3])
def test_both_kinds_of_matlab_files(tmp_path, version):
    path = tmp_path / "scan.mat"
    if version == 5:
        savemat(path, {"t": T, "data": VOLTS, "Fs": 1e4, "note": "steel", "scan": {"gate": GATE, "flipped": VOLTS.T}})
    else:
        # what MATLAB writes: 512 bytes in front, arrays with columns first, a struct as a group
        with h5py.File(path, "w", userblock_size=512) as file:
            file["t"], file["data"], file["Fs"] = T[None], VOLTS.T, [[1e4]]
            file["scan/gate"], file["scan/flipped"] = GATE[None], VOLTS
            file["note"] = "steel"
        path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + path.read_bytes()[512:])
    both = read_arrays(path, velocity="data", time="t", sites=[2, 5], gain=[0.125, 0.025])
    np.testing.assert_array_equal(both.times, T)
    np.testing.assert_array_equal(both.data, SIGNALS)
    one = read_arrays(path, velocity=("scan.flipped", 1), sampling="Fs", sites=5, trigger=("scan.gate", 2.5))
    np.testing.assert_allclose(one.times, T[20:] - 1.95e-3, atol=1e-18)
    np.testing.assert_array_equal(one.data, VOLTS[20:, 1:])
    with pytest.raises(ValueError, match="time: expected where the times are"):
        read_arrays(path, velocity="data", sites=[2, 5])
    with pytest.raises(ValueError, match="velocity: expected one of .*'data'"):
        read_arrays(path, velocity="dat", sampling=1e4, sites=[2, 5])
    with pytest.raises(ValueError, match="velocity: expected a column from 0 to 1, got 2"):
        read_arrays(path, velocity=("data", 2), sampling=1e4, sites=[2, 5])


@pytest.mark.parametrize("message, keywords", [
    ("velocity: expected one of 'time', 'gate', 'one', 'two', got 'ones'. Did you mean 'one'", {"velocity": "ones"}),
    ("velocity: expected a column from 0 to 3", {"velocity": 4}),
    ("data: expected one of velocity=, displacement=, force=, got none", {}),
    ("data: expected one of", {"velocity": 2, "force": 3}),
    ("gain: expected a number, or one for each of 1 sensors", {"velocity": 2, "gain": [1.0, 2.0]}),
    ("trigger: expected a level that 'gate' crosses, from 0 to 5, got 7", {"velocity": 2, "trigger": ("gate", 7.0)}),
    (r"trigger: expected .*, got \('gate', 2.5, 1\)", {"velocity": 2, "trigger": ("gate", 2.5, 1)}),
    ("baseline: expected at least 16 samples before a trigger", {"velocity": 2, "baseline": True}),
    ("sigma: expected noise before the trigger", {"velocity": "gate", "trigger": 1.9e-3}),
    ("start: expected a window with two samples, within 0 ... 0.0039 s, got 1 ... inf s", {"velocity": 2, "start": 1}),
    ("time: expected times that rise, got .*Give sampling=", {"velocity": 2, "time": "two"}),
])
def test_what_cannot_be_meant_is_refused(tmp_path, message, keywords):
    path = write(tmp_path / "scan.csv", ["time,gate,one,two"], [T, GATE, BURST])
    with pytest.raises(ValueError, match=message):
        read_csv(path, sites=3, **keywords)


def test_files_without_numbers_and_with_broken_lines_are_refused(tmp_path):
    path = tmp_path / "scan.csv"
    path.write_text("time,one\nnothing,here\n")
    with pytest.raises(ValueError, match="path: expected a text file of numbers .*, got '.*scan.csv', that ends"):
        read_csv(path, velocity=1, sites=3)
    path.write_text("0.0,1.0\n0.1,x\n0.2,3.0\n")
    with pytest.raises(ValueError, match="got '.*scan.csv', whose line 2 is '0.1,x', no row of numbers"):
        read_csv(path, velocity=1, sites=3)
    path.write_text("0.0,1.0\n0.1,2.0\n0.2,3.0\n")
    with pytest.raises(ValueError, match="velocity: expected an index, for the file has no line of names"):
        read_csv(path, velocity="one", sites=3)


def test_the_remedy_of_a_text_file_helps(tmp_path):
    """Stamps of time are passed over where the header's lines are told; a reading that was dropped says why."""
    path = tmp_path / "scan.csv"
    path.write_text("stamp,v\n" + "".join(f"2020-01-01T00:00:{i:02d},{i / 10}\n" for i in range(6)))
    with pytest.raises(ValueError, match="path: expected .*, got .*Give header=, .* columns by index where"):
        read_csv(path, velocity=1, sites=[1], sampling=1.0)
    np.testing.assert_allclose(
        read_csv(path, velocity=1, sites=[1], sampling=1.0, header=1).data[:, 0], np.arange(6) / 10)
    path.write_text("t,v\n0,0\n1,05\n2,10\n")
    for column in ("v", 1):
        with pytest.raises(ValueError, match="decimal commas between commas. Say delimiter=',' and decimal='.'"):
            read_csv(path, velocity=column, sites=[1])


def test_a_sensor_that_is_silent_before_the_trigger_or_overflows_is_refused(tmp_path):
    silent = np.where(np.arange(40) < 20, np.nan, 1.0)
    path = write(tmp_path / "scan.csv", ["time,gate,one,two"], [T, GATE, silent, BURST[:, 0]])
    asked = {"velocity": ["one", "two"], "sites": [2, 5], "trigger": ("gate", 2.5)}
    with pytest.raises(ValueError, match="baseline: expected samples of every sensor before the trigger"):
        read_csv(path, **asked, baseline=True)
    with pytest.raises(ValueError, match="sigma: expected noise before the trigger"):
        read_csv(path, **asked)
    with pytest.raises(ValueError, match="gain: expected numbers that keep the data finite.*scan.csv"):
        read_csv(path, **asked | {"velocity": ["two", "two"]}, gain=[1.0, 1.7e308])


@pytest.mark.slow
@pytest.mark.parametrize("block", [3, 2**20])
def test_every_format_gives_the_same_window(tmp_path, monkeypatch, block):
    """Whatever is read at once, and however it is stored: short blocks, samples in rows or columns, deflated."""
    monkeypatch.setattr(waveforms, "BLOCK", block)
    data = xr.Dataset({"v": (("t", "site"), 1e3 * BURST, {"units": "mm/s"}), "gate": ("t", GATE)},
                      {"t": ("t", 1e3 * T, {"units": "ms"})})
    matrix = {"v_mm_s": 1e3 * BURST, "gate": GATE, "t_ms": 1e3 * T}
    savemat(tmp_path / "a.mat", matrix)
    np.savez_compressed(tmp_path / "b.npz", **matrix | {"v_mm_s": np.asfortranarray(1e3 * BURST)})
    np.savez(tmp_path / "c.npz", **matrix | {"v_mm_s": np.asfortranarray(1e3 * BURST)})
    write(tmp_path / "d.csv", ["t (ms),gate,a (mm/s),b (mm/s)"], [1e3 * T, GATE, 1e3 * BURST])
    for name, version in (("e.nc", None), ("f.npz", None), ("g.mat", "7.3"), ("h.mat", "5")):
        exchange.save(data, tmp_path / name, version=version)
    asked = {"trigger": ("gate", 2.5), "start": -2e-4, "stop": 1e-3, "baseline": True, "sites": [0, 1]}
    found = [Traces.from_csv(tmp_path / "d.csv", velocity=["a", "b"], time="t", **asked)]
    for name in "abcefgh":
        (path,) = tmp_path.glob(f"{name}.*")
        bare = name in "abc"
        found.append({".nc": Traces.from_netcdf, ".npz": Traces.from_npz, ".mat": Traces.from_mat}[path.suffix](
            path, velocity="v_mm_s" if bare else "v", time="t_ms" if bare else "t", **asked))
    for traces in found:
        np.testing.assert_array_equal(traces.times, found[0].times)
        np.testing.assert_array_equal(traces.data, found[0].data)
        np.testing.assert_array_equal(traces.sigma, found[0].sigma)
    assert len(found[0].times) == 12
    np.testing.assert_allclose(found[0].data, BURST[18:30] - BURST[:18].mean(axis=0), rtol=1e-12)
    sampled = read_arrays(tmp_path / "c.npz", velocity=("v_mm_s", 1), sampling=1e4, start=5e-4, stop=1e-3, sites=1)
    np.testing.assert_array_equal(sampled.times, np.arange(5, 11) / 1e4)
    rare = np.where(np.arange(40) == 30, 1.0, np.nan)
    rare[2] = 0.0
    np.savez(tmp_path / "i.npz", gate=rare, v=BURST)
    asked = {"velocity": "v", "sampling": 1e4, "sites": [0, 1]}
    crossed = read_arrays(tmp_path / "i.npz", trigger=("gate", 0.5), sigma=1.0, **asked)
    np.testing.assert_allclose(crossed.times, np.arange(16, 40) / 1e4 - 1.6e-3, atol=1e-15)
    with pytest.raises(ValueError, match="trigger: expected a level that 'gate' crosses, from 0 to 1, got 3"):
        read_arrays(tmp_path / "i.npz", trigger=("gate", 3.0), **asked)
    np.savez(tmp_path / "i.npz", t=np.where(np.arange(40) == 33, T[20], T), v=BURST)
    with pytest.raises(ValueError, match="time: expected times that rise.*i.npz"):
        read_arrays(tmp_path / "i.npz", velocity="v", time="t", sites=[0, 1])


def test_a_short_run_of_many_sites_is_not_taken_for_a_long_one_of_few(tmp_path):
    u = np.random.default_rng(1).normal(size=(4, 9))
    data = xr.Dataset({"u": (("time", "site"), u, {"units": "scaled"})}, {"time": ("time", np.arange(4.0))})
    for ending, version in (("nc", None), ("npz", None), ("mat", "7.3"), ("mat", "5")):
        path = exchange.save(data, tmp_path / f"a.{ending}", version=version)
        traces = Traces.from_mat(path, displacement=[("u", 7), ("u", 2)], time="time", sites=[7, 2])
        np.testing.assert_array_equal(traces.data, u[:, [7, 2]])
        assert "taken" in traces.origin.units
    whole = data.assign_coords(site=np.arange(9))
    part = whole.isel(site=[2, 5, 7])
    for ending, version in (("nc", None), ("npz", None), ("mat", "7.3"), ("mat", "5")):
        path = exchange.save(whole, tmp_path / f"a.{ending}", version=version)
        for sites in ([7, 2], np.array([2, 2]), 5, [-1, 0], list(range(9))):
            traces = Traces.from_mat(path, displacement="u", time="time", sites=sites)
            np.testing.assert_array_equal(traces.data, u[:, np.atleast_1d(sites)])
        with pytest.raises(ValueError, match="sites: expected sites of the file, .0 1 ... 7 8., got 9"):
            Traces.from_mat(path, displacement="u", time="time", sites=[9])
        path = exchange.save(part, path, version=version)
        traces = Traces.from_mat(path, displacement="u", time="time", sites=[7, 2])
        np.testing.assert_array_equal(traces.data, u[:, [7, 2]])
