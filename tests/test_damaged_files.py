"""Damaged files are read right or refused in a sentence: no other error, no crash, no hang, no flood of memory.

Right is what an independent look at the damaged file finds: all numbers that are returned stand in it, and no line of
a text file that came through whole is lost.
"""

import itertools
import json
import math
import os
import re
import signal
import threading
import time
import zlib
from typing import ClassVar

import damaged
import h5py
import jax
import numpy as np
import pytest
from scipy.io import savemat

import granjax as gx
from granjax.reading import reader
from granjax.results import Held, Result
from granjax.work_precision import WorkPrecision

# seconds that a damaged file may take
PATIENCE = 30
TYPES = ("<f8", ">f8", "<f4", ">f4", *(f"{order}{kind}" for order in "<>" for kind in ("i2", "i4", "i8", "u2", "u4")),
         "i1", "u1")


class Kept(Result):
    held: ClassVar = {"ts": Held("time", "s", "time"), "us": Held("time site", "m", "u"), "kinds": Held("site"),
                      "open": Held("site")}
    ts: object
    us: object
    kinds: object
    open: object
    outcome: str = "Completed."
    count: int = 3


KEPT = Kept(damaged.T, damaged.VOLTS, np.array(["bead", "wall"]), np.array([True, False]))
TABLE = WorkPrecision(
    method=("SRKN6b",) * 3 + ("default",), parameter=("step",) * 4, value=np.array([0.2, 0.1, 0.05, np.nan]),
    error=np.array([1e-3, 6e-5, 4e-6, 1e-7]), seconds=np.array([1e-3, 2e-3, 4e-3, 5e-3]), fastest=np.full(4, 1e-3),
    evaluations=np.array([30.0, 60, 120, 240]), steps=np.array([5.0, 10, 20, np.nan]), drawn=np.array([True] * 4),
    note=("", "", "", "below"), methods=("SRKN6b", "default"), compile_seconds=np.array([0.5, np.nan]),
    limit=np.array([0.9, np.inf]), floor=1e-12, repeats=3, reference_note="two runs", machine={"cores": 2, "os": "x"},
)


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    """{(format, variant): bytes} of all formats."""
    path = tmp_path_factory.mktemp("valid") / "kept.nc"
    found = damaged.valid() | {("json", "table"): TABLE.to_json().encode()}
    for kind, ending, version in (("nc", "nc", None), ("npz", "npz", None), ("kept 5", "mat", "5"),
                                  ("kept 7.3", "mat", "7.3"), ("kept csv", "csv", None)):
        found[kind, ending] = KEPT.save(path.with_suffix(f".{ending}"), version=version).read_bytes()
    return found


def blocks(data):
    """A file's bytes, and whatever in it can be inflated."""
    yield data
    for found in re.finditer(b"\x78", data):
        try:
            yield zlib.decompressobj().decompress(data[found.start() :], 100_000)
        except zlib.error:
            pass


def stands_in(x, data):
    """Whether the numbers of an array stand in a file, in pieces of at least three as chunks are, NaN anywhere."""
    found = list(blocks(data))

    def pieces(x, kind):
        at = 0
        while at < len(x):
            left = [x[at:stop].astype(kind).tobytes() for stop in range(len(x), at, -1)]
            size = next((len(x) - at - k for k, piece in enumerate(left) if any(piece in b for b in found)), 0)
            if not size or size < min(3, len(x)) and at + size < len(x):
                return False
            at += size
        return True

    with np.errstate(all="ignore"):
        kinds = [kind for kind in TYPES if np.array_equal(x.astype(kind).astype(float), x, equal_nan=True)]
        return any(pieces(y[~np.isnan(y)], kind) for kind in kinds for y in (x.ravel("F"), x.ravel("C")))


def rows_stand_in(times, data, text, original):
    """Whether times and data are the last lines of a text, read in one way, and no line of the original is lost."""
    lines = [x.strip() for x in re.split("[\r\n]+", text) if x.strip(" \t\r\n,;\x1a\x0b\x0c\x1c\x1d\x1e\x1f\x85\xa0")]
    lines = [x for x in lines if not x.startswith(("#", "%", "//"))]
    if len(lines) < len(times) or {*lines[: -len(times)]} & {*original}:
        return False
    rows = np.column_stack([times, data])

    def word(field, decimal):
        try:
            x = float(field.strip("\"' ").replace(",", ".") if decimal == "," else field.strip("\"' "))
        except ValueError:
            return math.nan
        return x if abs(x) < 9.9e37 else math.nan

    for sign, decimal in itertools.product(("\t", ";", ",", None), ".,"):
        read = [[word(field, decimal) for field in line.split(sign)] + [math.nan] * 3 for line in lines[-len(times) :]]
        if np.array_equal([row[:3] for row in read], rows, equal_nan=True):
            return True
    return False


def looked_at(key, data, path, valid):
    """What became of a damaged file: "same", "different" where it says so itself, "refused"; else an assertion."""
    kept = key[0] in ("nc", "npz") or key[0].startswith("kept")
    path = path.with_suffix(f".{key[1] if kept else key[0]}")
    path.write_bytes(data)
    began = time.monotonic()
    try:
        if key[0] == "csv":
            traces = gx.Traces.from_csv(path, velocity=[1, 2], sites=[0, 1], gain=1.0)
            times, volts = np.asarray(traces.times), np.asarray(traces.data)
            wide = data[:2] in (b"\xff\xfe", b"\xfe\xff")
            text, whole = (x.decode("utf-16" if wide else "latin-1", "replace") for x in (data, valid[key]))
            if times.shape == damaged.T.shape and np.allclose(times, damaged.T, 1e-8, 0):
                if np.allclose(volts, damaged.VOLTS, 1e-8, 1e-8):
                    return "same"
            assert rows_stand_in(times, volts, text, [x for x in re.split("[\r\n]+", whole) if re.match(r"[\d]", x)])
        elif key[0] == "mat":
            traces = gx.Traces.from_mat(path, time="t", velocity="data", sites=[0, 1])
            times, volts = np.asarray(traces.times), np.asarray(traces.data)
            if np.array_equal(times, damaged.T) and np.array_equal(volts, damaged.VOLTS):
                return "same"
            assert stands_in(times, data) and stands_in(volts, data)
        elif kept:
            found = Result.load(path)
            whole = KEPT.to_xarray()
            if key[0] in ("nc", "npz", "kept 7.3"):
                # what is read later is the same, or is refused
                later = Result.load(path, lazy=True).load()
                assert key[0] == "npz" or later.identical(found)
            if found.identical(whole):
                return "same"
            if key[0] == "kept csv":
                fields = re.split("[,\n]", data.decode())
                numbers = {float(x) for x in fields if re.fullmatch(r"[-+.\de]+|nan|inf", x.strip())}
                for name, x in found.variables.items():
                    beside = np.isin(x.values.astype(float), whole[name]) if x.dtype.kind != "O" else True
                    assert np.all(beside | np.isin(x.values, [*numbers])), x
                return "different"
            for x in found.variables.values():
                known = any(np.array_equal(x.values, y.values) for y in whole.variables.values())
                if x.dtype.kind in "OSUT":
                    assert known or all(w.encode() in data for w in x.values.ravel()), x
                else:
                    assert known or stands_in(np.asarray(x.values, float), data), x
        else:
            table = WorkPrecision.from_json(data)
            again, told = json.loads(table.to_json()), json.loads(data)
            assert str(table) and table.outcome
            assert again["points"] == [{k: point[k] for k in again["points"][0]} for point in told["points"]]
            return "same" if again == json.loads(valid[key]) else "different"
        return "different"
    except ValueError as error:
        assert re.search("expected .*, got ", str(error), re.S), error
        assert key[0] == "json" or path.name in str(error), error
        return "refused"
    finally:
        assert time.monotonic() - began < PATIENCE


def tried(count, tmp_path, valid):
    """{(format, what became of it): how many} of so many damaged files."""
    keys, found = list(valid), {}
    for k in range(count):
        key, rng = keys[k % len(keys)], np.random.default_rng([13, k])
        data = damaged.mutant(rng, valid[key], key[0] in ("csv", "json", "kept csv"))
        try:
            name = key[0], looked_at(key, data, tmp_path / f"damaged {k}", valid)
        finally:
            for path in tmp_path.glob("damaged*"):
                if not os.environ.get("KEEP_DAMAGED"):
                    path.unlink()
        found[name] = found.get(name, 0) + 1
    return found


def test_valid_files_are_read_right(valid, tmp_path):
    for key, data in valid.items():
        assert looked_at(key, data, tmp_path / "whole", valid) == "same", key


@pytest.mark.study
def test_damaged_files_are_read_right_or_refused_in_a_sentence(valid, tmp_path):
    found = tried(300, tmp_path, valid)
    kinds = {"csv", "mat", "nc", "json", "npz", "kept 5", "kept 7.3", "kept csv"}
    assert sum(found.values()) == 300 and {kind for kind, _ in found} == kinds
    assert all(found[kind, "refused"] > 5 for kind in kinds), found


TIMED = "0.0,1.0\n0.1,2.0\n0.2,3.5\n0.3,4.0\n"


@pytest.mark.parametrize(("text", "asked", "times", "samples", "remark"), [
    # decimal commas
    ("0,12\n0,13\n", {"velocity": 0, "sampling": 10, "decimal": ","}, [0, 0.1], [0.12, 0.13], ""),
    ("0,12\n0,13\n", {"velocity": 1, "sampling": 10}, [0, 0.1], [12, 13], ""),
    ("0,512\n1,498\n2,497\n", {}, [0, 1, 2], [512, 498, 497], ""),
    ('"0,001","0,52"\n"0,002","0,53"\n', {}, [0.001, 0.002], [0.52, 0.53], ""),
    ("t;v\r\n0,1;1,5\r\n0,2;2\r\n", {"velocity": "v"}, [0.1, 0.2], [1.5, 2], "1 line of header"),
    # what is missing or beyond a range
    ("0.0,OVER\n0.1,2\n", {}, [0, 0.1], [np.nan, 2], "1 missing sample ('OVER')"),
    ("0.0,9.9E+37\n0.1,2\n0.2,-inf\n", {}, [0, 0.1, 0.2], [np.nan, 2, np.nan], "2 missing samples ('9.9E+37', '-inf')"),
    ("0.0,1,\n0.1,2,7\n", {}, [0, 0.1], [1, 2], "1 missing sample"),
    # ends of lines, columns and files; comments
    (TIMED.replace("\n", ",\n") + ",,\n", {}, [0, 0.1, 0.2, 0.3], [1, 2, 3.5, 4], ""),
    (TIMED.replace("\n", "\r"), {}, [0, 0.1, 0.2, 0.3], [1, 2, 3.5, 4], ""),
    (TIMED + "\x1a", {}, [0, 0.1, 0.2, 0.3], [1, 2, 3.5, 4], ""),
    ("0.0,1\n# pause\n\n0.1,2\n", {}, [0, 0.1], [1, 2], "1 comment between rows"),
    # headers with numbers; a header that is told
    ("X,CH1,Start\nSequence,Volt,-6e-4\n0,1,\n1,2,\n", {}, [0, 1], [1, 2], "2 lines of header"),
    ("Length,2500\nSecond,Volt\n-3,1\n-2,2\n", {}, [-3, -2], [1, 2], "2 lines of header"),
    ("0,1,2\n0.1,1.0,5\n0.2,2.0,6\n", {"header": 1}, [0.1, 0.2], [1, 2], "1 line of header"),
    ("Length,25,0.0,1.0\n,,0.1,2.0\n", {"header": 0, "time": 2, "velocity": 3}, [0, 0.1], [1, 2], "3 missing"),
])
def test_how_a_text_is_written_is_decided_by_all_of_it(tmp_path, text, asked, times, samples, remark):
    path = tmp_path / "scan.csv"
    path.write_text(text, newline="")
    traces = gx.Traces.from_csv(path, **{"velocity": 1, "sites": 3, "gain": 1.0} | asked)
    np.testing.assert_allclose(traces.times, times, rtol=1e-15)
    np.testing.assert_array_equal(traces.data[:, 0], samples)
    assert remark in traces.origin.remark and bool(remark) == bool(traces.origin.remark)
    assert traces.origin.file == str(path)


@pytest.mark.parametrize(("text", "asked", "message"), [
    ("0,12\n0,13\n", {"velocity": 0, "sampling": 10},
     "one column with decimal=',' .first 0.12. or 2 columns with delimiter=','.*Say which by delimiter= or decimal="),
    ("0.0,1.0\n0.1,2.0,7\n0.2,3.0,8\n", {}, "line 1, '0.0,1.0', has 2 fields where others have 3"),
    ("0.0,1.0,7\n0.1,2.0\n0.2,3.0,8\n", {}, "line 2, '0.1,2.0', has 2 fields where others have 3"),
    ("0.0,1.0,7\n0.1,2.0,8\n0.2,3.0\n", {}, "line 3, '0.2,3.0', has 2 fields where others have 3"),
    ("0.0,BEYOND\n0.1,2\n", {}, "line 1 is '0.0,BEYOND', which may be a row.*header="),
    ("BEYOND,1.0\n0.1,2\n", {"velocity": [0, 1], "sampling": 10, "sites": [0, 1]}, "line 1 .*, which may be a row"),
    ('"0.0,1.0\n0.1,2.0\n0.2,3.0\n', {}, "line 1 is .*, which may be a row"),
    ("time,v\nx.0,1.0\n0.1,2\n0.2,3\n", {"velocity": "v"}, "line 2 is 'x.0,1.0', which may be a row"),
    ("0.0,1_0\n0.1,2\n0.2,3\n", {}, "line 1 .*, which may be a row"),
    ("0,1,2\n0.0,1.0,5\n0.1,2.0,6\n", {}, "line 1 is '0,1,2'.*header=1 to pass over it, header=0 where it is a sample"),
    ("0,1,2\n0.1,1.0,5\n0.2,2.0,6\n0.3,2.0,6\n", {}, "line 1 is '0,1,2'"),
    ("7,90\n10.0,1.5\n10.1,2\n10.2,3\n", {}, "line 1 is '7,90'"),
    (TIMED + "time,one\n" + TIMED, {}, "line 5 is 'time,one', no row"),
    (TIMED + TIMED, {}, "times that rise.*scan.csv"),
    ("0.0,1\n,2\n0.2,3\n", {}, "a time in every row, got none in 1 of 3.*scan.csv"),
    (TIMED + "End of data\n", {}, "ends with 'End of data'.*cut what follows"),
    (TIMED.replace("2", "\0", 1), {}, "a zero byte in line 2"),
    ("", {}, "which is empty"), ("\n \n", {}, "which is blank"), ("# a\n", {}, "line 1 says '# a'"),
    (TIMED, {"delimiter": "0"}, "delimiter: expected one character that is part of no number"),
    (TIMED, {"decimal": ";"}, "decimal: expected one of '.', ','"),
    (TIMED, {"header": 99}, "without a row below line 99"),
    (TIMED, {"velocity": []}, "velocity: expected one column or more"),
    ("0.0," + "1" * 1_000_000 + "x\n0.1,2\n", {}, "which may be a row"),
])
def test_what_may_be_a_sample_is_not_passed_over(tmp_path, text, asked, message):
    path = tmp_path / "scan.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"(?s){message}"):
        gx.Traces.from_csv(path, **{"velocity": 1, "sites": 3, "gain": 1.0} | asked)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_letters_beyond_ascii_are_read_in_all_encodings(tmp_path, encoding):
    path = tmp_path / "scan.csv"
    path.write_text("t [µs],v [V]\n" + TIMED, encoding=encoding)
    assert gx.Traces.from_csv(path, time="T", velocity="v", gain=1.0, sites=3).origin.header == ("t [µs],v [V]",)


def test_what_is_no_file_is_refused(tmp_path):
    (tmp_path / "scan.csv").touch()
    for path, message in (
        (tmp_path / "scam.csv", "where there is nothing. Did you mean 'scan.csv'"), (tmp_path, "a folder"),
        (tmp_path / "no" / "scan.csv", "There is no folder"), ("/dev/zero", "a device or pipe"), ("a\0b", "null"),
        ("x" * 5000, "too long"), (3, "3"), (tmp_path / "scan.csv", "which is empty"),
    ):
        for read in (
            lambda: gx.Traces.from_csv(path, velocity=1, sites=0), lambda: Result.load(path),
            lambda: gx.Traces.from_mat(path, velocity="v", time="t", sites=0),
        ):
            with pytest.raises(ValueError, match=f"path: expected .*{message}"):
                read()


def test_variables_that_are_no_numbers_are_called_what_they_are(valid, tmp_path):
    path = tmp_path / "scan.mat"
    words = {"note": "steel", "z": np.ones(3) * 1j, "none": np.zeros((0, 0)), "Fs": np.array([1.0, 2.0])}
    savemat(path, {"data": damaged.VOLTS} | words)
    for name, asked, message in (
        ("note", {"sampling": 1.0}, "a variable of real numbers, got 'note', which is char"),
        ("z", {"sampling": 1.0}, "which is complex"), ("none", {"sampling": 1.0}, "none of shape .0, 0."),
        ("data", {"sampling": "Fs"}, "sampling: expected one number, got Fs of shape .2,"),
    ):
        with pytest.raises(ValueError, match=f"{message}.*scan.mat"):
            gx.Traces.from_mat(path, velocity=name, sites=[0, 1], **asked)


def test_sizes_that_no_file_holds_are_refused_before_they_are_taken(tmp_path):
    path = tmp_path / "scan.mat"
    with h5py.File(path, "w") as file:
        file.create_dataset("data", (2**20, 2**20), "f8")
        file.create_dataset("half", (4000, 2), "f8", chunks=(1000, 2))[:1000] = 1.0
    for name, message in (("data", "it states 8.39e\\+06 MiB"), ("half", "numbers of '/half' are not there")):
        with pytest.raises(ValueError, match=message):
            gx.Traces.from_mat(path, velocity=name, sampling=1.0, sites=[0, 1])


def test_a_reader_that_breaks_down_hangs_or_is_interrupted_is_replaced(valid, tmp_path, monkeypatch):
    path = tmp_path / "scan.mat"
    path.write_bytes(valid["mat", "5"])
    running = reader._Running

    def read():
        return gx.Traces.from_mat(path, velocity="data", time="t", sites=[0, 1])

    read()
    running.process.kill()
    running.process.wait()
    read()
    first = running.process
    # one that dies of the file, twice: the second was fresh
    asked = reader._exchanged
    monkeypatch.setattr(reader, "_exchanged", lambda request: running.process.kill() or asked(request))
    with pytest.raises(ValueError, match="scan.mat', at which reading broke down .exit code"):
        read()
    # an interrupt while an answer is waited for, also where the tests were started with Ctrl-C ignored
    monkeypatch.setattr(reader, "_bytes", lambda count: signal.raise_signal(signal.SIGINT))
    monkeypatch.setattr(reader, "_exchanged", asked)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            read()
    finally:
        signal.signal(signal.SIGINT, before)
    monkeypatch.undo()
    assert running.process is None and first.poll() is not None
    np.testing.assert_array_equal(read().data, damaged.VOLTS)
    # one that hangs
    monkeypatch.setattr(reader, "SECONDS", 0.2)
    os.kill(running.process.pid, signal.SIGSTOP)
    resume = threading.Timer(0.6, os.kill, (running.process.pid, signal.SIGKILL))
    resume.start()
    with pytest.raises(ValueError, match="scan.mat', which is not read within 0.2 s"):
        read()


@pytest.mark.parametrize(("field", "value"), [
    ("value", -0.1), ("value", 0), ("value", "0.1"), ("steps", 0), ("seconds", 1e308), ("error", float("nan")),
    ("drawn", 1), ("method", "other"), ("parameter", "size"), ("note", None), ("evaluations", 10**400),
])
def test_a_table_of_what_nobody_measures_is_refused(field, value):
    data = TABLE.to_dict()
    data["points"][0][field] = value
    with pytest.raises(ValueError, match="text: expected a table that `to_json` has written, got something else"):
        WorkPrecision.from_json(data)
    with pytest.raises(ValueError, match="RecursionError"):
        WorkPrecision.from_json("[" * 1_000_000)


def test_traces_of_two_files_are_compiled_once(tmp_path):
    paths = [tmp_path / name for name in ("a.csv", "b.csv")]
    for path in paths:
        path.write_text(TIMED)
    one, two = (jax.tree.structure(gx.Traces.from_csv(path, velocity=1, sites=3)) for path in paths)
    assert one == two and hash(one) == hash(two)


@pytest.mark.study
def test_ten_thousand_damaged_files_are_read_right_or_refused_in_a_sentence(valid, tmp_path):
    found = tried(10_000, tmp_path, valid)
    assert sum(found.values()) == 10_000
    print(found)
