"""Stores of sweeps: killed and resumed, full disks, other sweeps, damaged and foreign files, two at one store."""

import builtins
import contextlib
import hashlib
import io
import json
import os
import pickle
import random
import resource
import runpy
import shutil
import signal
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray
from cases import few

import granjax as gx
from granjax.sweeps.chunk_file import MAGIC, unpacked
from granjax.sweeps.manifest import digest
from granjax.sweeps.store import Store

SCRIPT = """
import sys, time
import numpy as np
import granjax as gx

PAUSE = 0.0

def f(a, b):
    time.sleep(0.01)
    if a > 3 and b > 1:
        raise ValueError("Too much.")
    return {{"s": np.sin(a * b), "row": np.arange(3) * a, "word": "w" * int(a)}}

def compiled(a, b):
    chain = gx.scenes.dimer(5, ratio=1 / a)
    return {{"v": gx.simulate(chain, gx.states.impact(chain), b, step=0.01).final.v}}

each = {function} is f
gx.sweep({function}, {{"a": np.arange(1.0, {last}), "b": [0.5, 1.0, 1.5, 2.0]}}, store=sys.argv[1], chunk=2,
         progress=False, lanes=False if each else None, units={{"a": "m"}})
"""


@pytest.fixture
def script(tmp_path):
    def write(function, last=6.0):
        (tmp_path / "script.py").write_text(SCRIPT.format(function=function, last=last))
        return tmp_path / "script.py"

    return write


def started(script, store):
    env = {**os.environ, "PYTHONPATH": str(Path(gx.__file__).parents[1]), "PYTHONHASHSEED": "random"}
    return subprocess.Popen([sys.executable, script, store], env=env, stderr=subprocess.PIPE, text=True)


def here(script, store):
    """The same in this process, in which the script has another name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["script.py", str(store)])
        runpy.run_path(str(script), run_name="pulses")


def chunks(store):
    folder = store.with_name(store.name + ".chunks") if store.suffix else store
    return sorted(p.name for p in folder.glob("chunk-*"))


def killed(script, store, after):
    """Whether a run was killed so many seconds after its first new chunk."""
    process, before, ends = started(script, store), chunks(store), time.monotonic() + 60
    while process.poll() is None and chunks(store) == before and time.monotonic() < ends:
        time.sleep(0.001)
    time.sleep(after)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    return process.returncode == -signal.SIGKILL


def agree(one, other):
    assert one.attrs.get("outcome") == other.attrs.get("outcome")
    assert list(one.variables) == list(other.variables)
    for name in one.variables:
        a, b = one[name], other[name]
        assert a.dtype == b.dtype and a.shape == b.shape and a.attrs == b.attrs
        assert a.values.tobytes() == b.values.tobytes()


def killed_and_resumed(script, tmp_path, name, seconds):
    here(script, tmp_path / f"whole{name}")
    store, number = tmp_path / f"killed{name}", 0
    for after in seconds:
        number += killed(script, store, after)
        if number and not chunks(store):
            break
        if name:
            assert not store.exists() or not chunks(store)
        kept = gx.sweeps.read(store)
        whole = gx.sweeps.read(tmp_path / f"whole{name}")
        there = kept["reason"].values != "not computed yet"
        numbers = next(x for x in ("s", "v") if x in kept)
        assert there.any() and (kept[numbers].values[there].tobytes() == whole[numbers].values[there].tobytes())
    here(script, store)
    agree(gx.sweeps.read(store), gx.sweeps.read(tmp_path / f"whole{name}"))
    assert number
    return number


@pytest.mark.study
@pytest.mark.parametrize("name", ["", pytest.param(".nc", marks=pytest.mark.slow)])
def test_killed_and_resumed_gives_the_same_bits(script, tmp_path, name):
    killed_and_resumed(script("f"), tmp_path, name, [0.02, 0.05] if name else [0.01])
    assert [p for p in tmp_path.iterdir() if p.name.endswith(".chunks")] == []


@pytest.mark.study
@pytest.mark.parametrize("function, name", few([("compiled", ".nc"), ("compiled", ""), ("f", ".nc"), ("f", "")], 0))
def test_killed_at_ten_moments(script, tmp_path, name, function):
    moments = np.random.default_rng(len(name)).uniform(0, 0.01, 10)
    assert killed_and_resumed(script(function, 41.0), tmp_path, name, moments) == 10


K = 2.0


def plain(a, b=1.0):
    return {"p": a * K + b, "row": np.arange(3) * a, "word": "w" * int(a)}


def sweep(parameters, function=plain, **keywords):
    keywords = {"lanes": False, "chunk": 2, "progress": False, **keywords}
    return gx.sweep(function, parameters, **keywords)


VALUES = {"a": [1.0, 2.0, 3.0, 4.0, 5.0], "b": [0.5, 1.5]}


def half(store, values=VALUES, stop=3):
    """A store whose run was interrupted after some chunks."""
    count = 0

    def plain(a, b=1.0):
        nonlocal count
        count += 1
        if count > 2 * stop:
            raise KeyboardInterrupt
        return {"p": a * K + b, "row": np.arange(3) * a, "word": "w" * int(a)}

    with pytest.raises(KeyboardInterrupt):
        sweep(values, plain, store=store)


def stored(folder, values=VALUES):
    """A store in a folder with its chunks."""
    return sweep(values, store=folder)


@contextlib.contextmanager
def small_disk(folder, size):
    folder.mkdir()
    found = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)], capture_output=True)
    try:
        yield found.returncode == 0
    finally:
        if found.returncode == 0:
            subprocess.run(["umount", "-l", str(folder)], capture_output=True)


def large(a):
    return {"x": np.full(2000, a)}


def test_a_full_disk_is_told_and_what_was_done_stays(tmp_path):
    disk = tmp_path / "disk"
    with small_disk(disk, "160k") as made:
        if not made:
            pytest.skip("no small disk can be made here: mounting takes rights")
        store = disk / "store"
        with pytest.raises(RuntimeError, match=r"store: .* could not be written \(No space left on device.*goes on"):
            sweep({"a": np.arange(1.0, 21.0)}, large, store=store)
        kept = chunks(store)
        assert kept and not [p for p in store.iterdir() if p.name.endswith(".part")]
        here = gx.sweeps.read(store)
        assert (here["reason"].values == "").sum() == 2 * len(kept)
        subprocess.run(["mount", "-o", "remount,size=4m", str(disk)], check=True)
        times = [(store / name).stat().st_mtime_ns for name in kept]
        found = sweep({"a": np.arange(1.0, 21.0)}, large, store=store)
        assert [(store / name).stat().st_mtime_ns for name in kept] == times
        agree(found, sweep({"a": np.arange(1.0, 21.0)}, large))


def test_a_file_that_may_not_grow_is_told(tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8192, before[1]))
    try:
        with pytest.raises(RuntimeError, match=r"could not be written \(File too large"):
            sweep({"a": [1.0, 2.0]}, large, store=tmp_path / "store.nc")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not (tmp_path / "store.nc").exists()
    assert len(sweep({"a": [1.0, 2.0]}, large, store=tmp_path / "store.nc").a) == 2


def never(a, b=1.0):
    raise AssertionError("computed")


@pytest.mark.parametrize("name", ["file/store", "file/store.nc", "/proc/store", "/proc/store.nc", "n" * 300, "a.txt",
                                  "n" * 300 + ".nc", "file", "nul\0"])
def test_what_cannot_be_written_is_refused_before_anything_is_computed(tmp_path, name):
    (tmp_path / "file").write_text("mine")
    calls = []
    with pytest.raises(ValueError, match="store: expected"):
        sweep(VALUES, lambda a, b: calls.append(a), store=os.path.join(tmp_path, name))
    assert not calls and (tmp_path / "file").read_text() == "mine"


OTHERS = {
    "values": (dict(parameters={**VALUES, "a": [1.0, 2.5, 3.0, 4.0, 5.0]}), "a: 5 values, .*number 1 is 2.5, there 2"),
    "fewer": (dict(parameters={"a": [1.0, 2.0], "b": [0.5, 1.5]}), "a: 2 values, 1.0 to 2.0, the store has 5 values"),
    "sign of zero": (dict(parameters={**VALUES, "b": [0.5, -1.5]}), "b: 2 values"),
    "dtype": (dict(parameters={**VALUES, "a": [1, 2, 3, 4, 5]}), "a: of int64, in the store of float64"),
    "units": (dict(units={"a": "m"}), "a: in m, in the store none"),
    "missing": (dict(parameters={"a": VALUES["a"]}), "parameter b: only in the store"),
    "order": (dict(parameters=dict(reversed(VALUES.items()))), "parameters in the order b, a, the store has a, b"),
    "design": (dict(parameters=[{"a": 1.0, "b": 0.5}]), "design: list, the store has grid"),
    "chunk": (dict(chunk=3), "chunk: expected 2, with which the store was begun, got 3"),
    "name": (dict(function=never), "function: never, the store has plain"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("stores")
    stored(place / "store")
    stored(place / "store.nc")
    return place


@pytest.mark.parametrize("kind", OTHERS)
@pytest.mark.parametrize("name", ["store", "store.nc"])
def test_another_sweep_is_refused_with_the_difference(folder, kind, name, monkeypatch):
    keywords, words = OTHERS[kind]
    before = {p.name: p.read_bytes() for p in folder.rglob("*") if p.is_file() and p.name != "lock"}
    with pytest.raises(ValueError, match=words):
        sweep(**{"parameters": VALUES, "store": folder / name, **keywords})
    assert before == {p.name: p.read_bytes() for p in folder.rglob("*") if p.is_file() and p.name != "lock"}


def test_what_a_function_reads_and_versions_are_named(folder, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "K", 3.0)
    with pytest.raises(ValueError, match="function: it reads K = 3.0, in the store 2.0"):
        sweep(VALUES, store=folder / "store")
    monkeypatch.undo()
    monkeypatch.setattr(np, "__version__", "9.9.9")
    with pytest.raises(ValueError, match="numpy 9.9.9, the store was begun with"):
        sweep(VALUES, store=folder / "store.nc")


@pytest.mark.parametrize("keywords", [dict(devices=2), dict(executor=1), dict(progress=True)], ids=str)
@pytest.mark.parametrize("name", ["store", "store.nc"])
def test_the_same_sweep_is_not_computed_again(folder, keywords, name, monkeypatch):
    monkeypatch.setattr("granjax.sweeps.task.Task._one", never)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        agree(sweep(VALUES, store=folder / name, **keywords), gx.sweeps.read(folder / name))


def damage(folder, kind):
    """Damage a store, and the words in which that is told."""
    place, other = folder / "chunk-000003", folder / "chunk-000004"
    held = bytearray(place.read_bytes())
    if kind == "truncated":
        place.write_bytes(held[:-7])
    elif kind == "flipped":
        held[-20] ^= 4
        place.write_bytes(held)
    elif kind == "foreign":
        place.write_bytes(b"something else")
    elif kind == "pickle":
        place.write_bytes(pickle.dumps({"a": 1}))
    elif kind == "emptied":
        place.write_bytes(b"")
    elif kind == "swapped":
        place.write_bytes(other.read_bytes())
    elif kind == "exchanged":
        other.write_bytes(held)
        return "of another part of the sweep"
    elif kind == "of another sweep":
        stored(folder.with_name("other"), {"a": [9.0, 8.0, 7.0, 6.0, 5.0], "b": [0.5, 1.5]})
        place.write_bytes((folder.with_name("other") / place.name).read_bytes())
        return "of another sweep"
    elif kind == "link":
        place.unlink()
        place.symlink_to(other)
    elif kind == "folder":
        place.unlink()
        place.mkdir()
    elif kind == "pipe":
        place.unlink()
        os.mkfifo(place)
    elif kind == "huge":
        os.truncate(place, 2**40)
    return "is not to be trusted"


KINDS = ["truncated", "flipped", "foreign", "pickle", "emptied", "swapped", "exchanged", "of another sweep", "link",
         "folder", "pipe", "huge"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_chunk_that_is_damaged_is_named_and_computed_anew(folder, tmp_path, kind):
    store, whole = tmp_path / "store", gx.sweeps.read(folder / "store")
    shutil.copytree(folder / "store", store)
    words = damage(store, kind)
    assert words in gx.sweeps.read(store).outcome and "1 marked" not in whole.outcome
    if kind in ("folder",):  # which cannot be replaced by a file
        with pytest.warns(UserWarning, match=words), pytest.raises(RuntimeError, match="could not be written"):
            sweep(VALUES, store=store)
        return
    with pytest.warns(UserWarning, match=words):
        found = sweep(VALUES, store=store)
    found = found.assign_attrs(outcome=whole.outcome)
    agree(found, whole)
    agree(gx.sweeps.read(store), whole)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", "null", '{"identity": "{}", "sha256": ""}', "[" * 100000])
def test_a_manifest_that_is_damaged_is_refused(folder, tmp_path, text):
    store = tmp_path / "store"
    shutil.copytree(folder / "store", store)
    (store / "sweep.json").write_text(text)
    for go in (lambda: sweep(VALUES, store=store), lambda: gx.sweeps.read(store)):
        with pytest.raises(ValueError, match="store: expected the manifest of a sweep"):
            go()
    (store / "sweep.json").unlink()
    with pytest.raises(ValueError, match="store: expected"):
        sweep(VALUES, store=store)
    os.mkfifo(store / "sweep.json")
    with pytest.raises(ValueError, match="no ordinary file"):
        sweep(VALUES, store=store)


def test_a_file_of_another_kind_is_not_overwritten(tmp_path):
    for name, held in (("text.nc", b"mine"), ("empty.nc", b"")):
        (tmp_path / name).write_bytes(held)
        with pytest.raises(ValueError, match="store: expected the file of a sweep, or a free name"):
            sweep(VALUES, store=tmp_path / name)
        assert (tmp_path / name).read_bytes() == held
    xarray.Dataset({"p": ("a", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match="something else"):
        sweep(VALUES, store=tmp_path / "other.nc")
    (tmp_path / "folder.nc").mkdir()
    with pytest.raises(ValueError, match="store: expected"):
        sweep(VALUES, store=tmp_path / "folder.nc")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("mine")
    with pytest.raises(ValueError, match="letter.txt"):
        sweep(VALUES, store=tmp_path / "mine")


def test_a_file_whose_numbers_were_changed_is_not_trusted(folder, tmp_path):
    held = bytearray((folder / "store.nc").read_bytes())
    at = held.index(np.float64(gx.sweeps.read(folder / "store.nc")["p"].values[1, 1]).tobytes())
    held[at + 3] ^= 1
    (tmp_path / "store.nc").write_bytes(held)
    for go in (lambda: sweep(VALUES, store=tmp_path / "store.nc"), lambda: gx.sweeps.read(tmp_path / "store.nc")):
        with pytest.raises(ValueError, match="could not be read"):
            go()
    assert (tmp_path / "store.nc").read_bytes() == held


def test_chunks_left_by_a_kill_after_the_file_are_removed(folder, tmp_path):
    store = tmp_path / "store.nc"
    shutil.copy(folder / "store.nc", store)
    shutil.copytree(folder / "store", tmp_path / "store.nc.chunks")
    agree(sweep(VALUES, store=store), gx.sweeps.read(folder / "store.nc"))
    assert not (tmp_path / "store.nc.chunks").exists()


def test_a_worker_that_died_for_good_is_tried_again(tmp_path, monkeypatch):
    from granjax.sweeps import workers

    deaths = [1]

    def dying(task, values):
        if deaths and 3.0 in values["a"]:
            deaths.pop()
            return workers.given_up(values, "A worker died.")
        return task(values)

    monkeypatch.setattr(workers, "attempt", dying)
    first = sweep(VALUES, store=tmp_path / "store.nc")
    assert "A worker died." in first["reason"].values and not (tmp_path / "store.nc").exists()
    second = sweep(VALUES, store=tmp_path / "store.nc")
    agree(second, sweep(VALUES))
    assert (tmp_path / "store.nc").exists()


def test_two_at_one_store(tmp_path):
    begun, go = threading.Event(), threading.Event()

    def slow(a, b):
        begun.set()
        go.wait(20)
        return a * b

    first = threading.Thread(target=lambda: sweep(VALUES, slow, store=tmp_path / "store.nc"))
    first.start()
    begun.wait(20)
    try:
        with pytest.raises(ValueError, match="which another sweep writes now"):
            sweep(VALUES, slow, store=tmp_path / "store.nc")
    finally:
        go.set()
        first.join()
    assert sweep(VALUES, slow, store=tmp_path / "store.nc")["slow"].shape == (5, 2)


def test_half_a_sweep_can_be_read(folder, tmp_path):
    half(tmp_path / "store")
    found = gx.sweeps.read(tmp_path / "store")
    there = found["reason"].values.ravel() == ""
    assert there.sum() == 6 and set(found["reason"].values.ravel()[~there]) == {"not computed yet"}
    whole = gx.sweeps.read(folder / "store")
    assert (found["p"].values.ravel()[there] == whole["p"].values.ravel()[there]).all()
    assert np.isnan(found["p"].values.ravel()[~there]).all()


def test_the_file_says_what_it_is(tmp_path):
    sweep(VALUES, store=tmp_path / "store.nc", units={"a": "m", "p": "N"})
    place = tmp_path / "store.nc"
    data = xarray.load_dataset(place)
    assert data["a"].attrs["units"] == "m" and data["p"].attrs["units"] == "N"
    assert data["p"].dims == ("a", "b") and set(data["row"].dims) == {"a", "b", "row_0"}
    assert {"granjax", "jax", "numpy", "python", "commit", "cite", "function", "sweep"} <= set(data.attrs)


class CodeRun(BaseException):
    pass


@contextlib.contextmanager
def nothing_runs():
    """What would run code of a file fails."""
    with pytest.MonkeyPatch.context() as patch:
        def fail(*_, **__):
            raise CodeRun

        for name in ("loads", "load", "Unpickler"):
            patch.setattr(pickle, name, fail)
        for name in ("eval", "exec"):
            patch.setattr(builtins, name, fail)
        yield


def mutated(held, chance):
    held = bytearray(held)
    for _ in range(chance.choice((1, 1, 2, 8))):
        kind, at = chance.randrange(6), chance.randrange(max(len(held), 1))
        if kind == 0 and held:
            held[at] ^= 1 << chance.randrange(8)
        elif kind == 1:
            del held[at:]
        elif kind == 2:
            held[at:at] = chance.randbytes(chance.randrange(40))
        elif kind == 3:
            del held[at : at + chance.randrange(40)]
        elif kind == 4:
            held[at : at + 8] = chance.randbytes(8)
        else:
            held = bytearray(chance.randbytes(chance.randrange(300)))
    return bytes(held)


ODD = [None, True, -1, 0, 7, 1e300, "", "x", [], [0], [[]], {}, {"a": 1}, 2**70, "O", "float64", "<U9", float("nan")]


def changed(tree, chance):
    """A tree of JSON with one thing in it replaced."""
    if isinstance(tree, (dict, list)) and tree and chance.random() < 0.85:
        key = chance.choice(list(tree) if isinstance(tree, dict) else range(len(tree)))
        found = tree.copy()
        if chance.random() < 0.1:
            del found[key]
        else:
            found[key] = changed(tree[key], chance)
        return found
    return chance.choice(ODD)


def forged(place, kept, chance):
    """A file with something else in it, whose digests are right."""
    if place.name == "sweep.json":
        text = json.dumps(changed(json.loads(json.loads(place.read_text())["identity"]), chance))
        return json.dumps({"identity": text, "sha256": digest(text.encode())}).encode()
    begin = len(MAGIC) + 32 + 8 + 64
    chunk, number = unpacked(place.read_bytes()[begin:])
    if chance.random() < 0.5:
        told = changed({"reasons": chunk.reasons, "told": chunk.told, "number": number}, chance)
        told = json.dumps(told | {"names": list(chunk.columns)} if isinstance(told, dict) else told)
        buffer = io.BytesIO()
        np.savez(buffer, told=np.frombuffer(told.encode(), np.uint8),
                 **{f"x{i}": x for i, x in enumerate(chunk.columns.values())})
        inner = buffer.getvalue()
    else:
        inner = mutated(place.read_bytes()[begin:], chance)
    content = kept._key().encode() + inner
    content = (8 + len(content)).to_bytes(8, "big") + content
    return MAGIC + hashlib.sha256(content).digest() + content


def fuzz(folder, tmp_path, count, seed):
    chance = random.Random(seed)
    store, kept = tmp_path / "store", Store.opened(folder / "store")
    whole = gx.sweeps.read(folder / "store.nc")
    shutil.copytree(folder / "store", store)
    file = tmp_path / "store.nc"
    real = {p: p.read_bytes() for p in store.iterdir() if p.name != "lock"} | {file: (folder / "store.nc").read_bytes()}
    refused = trusted = 0
    sweep(VALUES, store=store), repr(whole)
    for n in range(count):
        place = file if n % 10 == 0 else chance.choice([p for p in real if p != file] + [store / "sweep.json"])
        forge = place != file and chance.random() < 0.4
        place.write_bytes(forged(place, kept, chance) if forge else mutated(real[place], chance))
        try:
            with nothing_runs(), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = gx.sweeps.read(place if place == file else store)
                if n % 7 == 0:
                    sweep(VALUES, store=place if place == file else store)
            trusted += 1
            assert repr(found) and found.outcome is not None
            if not forge:
                there = found["reason"].values != "not computed yet"
                assert (found["p"].values[there] == whole["p"].values[there]).all()
        except (ValueError, RuntimeError) as error:
            refused += 1
            assert str(error).startswith(("store: ", "chunk: ")), error
        place.write_bytes(real[place])
        if n % 7 == 0:
            for other, held in real.items():
                other.write_bytes(held)
    return refused, trusted


@pytest.mark.slow
def test_files_of_any_content_are_refused_or_right(folder, tmp_path):
    refused, trusted = fuzz(folder, tmp_path, 200, 0)
    assert refused > 20 and trusted > 20


@pytest.mark.study
def test_ten_thousand_files(folder, tmp_path):
    print(fuzz(folder, tmp_path, 10000, 1))


def cheap(x):
    return {"s": float(np.sin(float(x)))}


def swept(store, function=cheap):
    return gx.sweep(function, {"x": np.linspace(0, 1, 6)}, store=store, lanes=False, chunk=2, progress=False)


@pytest.mark.filterwarnings("ignore:os.fork")
def test_a_forked_process_keeps_no_lock(tmp_path):
    """A worker that was forked may live on where the process that had the store was killed."""
    fcntl = pytest.importorskip("fcntl")
    begun = Store(tmp_path / "map", {"format": 1})
    (inward, outward), (told, tells) = os.pipe(), os.pipe()
    child = os.fork()
    if not child:
        os.write(tells, b"x")
        os.read(inward, 1)
        os._exit(0)
    os.read(told, 1)
    try:
        with open(tmp_path / "map" / "lock", "ab") as again:
            with pytest.raises(BlockingIOError):
                fcntl.flock(again, fcntl.LOCK_EX | fcntl.LOCK_NB)
            begun.close()
            fcntl.flock(again, fcntl.LOCK_EX | fcntl.LOCK_NB)
    finally:
        os.write(outward, b"x")
        os.waitpid(child, 0)


@pytest.mark.parametrize("name", ["map", "map.nc"])
def test_what_a_killed_process_left_half_written_is_removed(tmp_path, name):
    folder = tmp_path / (name if name == "map" else f"{name}.chunks")
    folder.mkdir()
    left = [folder / ".chunk-000000.0123456789ab.part"]
    left += [tmp_path / ".map.nc.0123456789ab.part"] if name == "map.nc" else []
    other = tmp_path / ".other.nc.0123456789ab.part"
    for place in (*left, other):
        place.write_bytes(b"half")
    swept(tmp_path / name)
    assert not any(place.exists() for place in left) and other.exists()


def test_a_file_that_comes_to_be_meanwhile_is_left_alone(tmp_path):
    def writes(x):
        (tmp_path / "map.nc").write_text("mine")
        return {"s": float(x)}

    with pytest.raises(ValueError, match="which has come to be meanwhile"):
        swept(tmp_path / "map.nc", writes)
    assert (tmp_path / "map.nc").read_text() == "mine"
    assert len(list((tmp_path / "map.nc.chunks").glob("chunk-*"))) == 3
