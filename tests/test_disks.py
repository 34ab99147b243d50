"""Files are there whole or not at all; a result is told where it cannot be written."""

import contextlib
import json
import os
import re
import resource
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import granjax as gx
from granjax import files, plots
from granjax.cli import UNREAD, main
from granjax.results import Held, Result
from granjax.studies.reproduce import Figure

ARGUMENTS = ["resonance", "--beads", "11", "--ratios", "12"]


@contextlib.contextmanager
def full_disk(size=4096):
    """No file may grow beyond `size` bytes, as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


class Sample(Result):
    held = {"x": Held("x", "m")}
    x: np.ndarray

    @property
    def outcome(self):
        return "A sample."


SMALL, LARGE = Sample(np.arange(3.0)), Sample(np.random.default_rng(0).normal(size=2000))


@pytest.fixture
def computed(monkeypatch):
    """`granjax resonance` without its computation."""
    from granjax.studies.resonance.finite import Extrema, Transmission

    ratios = np.linspace(0.05, 1, 13)[1:]
    sweep = Transmission(ratios, ratios, ratios, 1.0, 11, 20.0)
    extrema = Extrema(*(np.array([x]) for x in (0.4, 0.7, 0.9, 1.0)))
    monkeypatch.setattr(gx.resonance, "transmission", lambda *arguments, **keywords: sweep)
    monkeypatch.setattr(gx.resonance, "refine", lambda *arguments, **keywords: extrema)
    return monkeypatch


def complaints(captured):
    return [line for line in captured.err.splitlines() if "JAX has started" not in line]


def test_a_file_is_replaced_whole(tmp_path):
    path, link = tmp_path / "a.json", tmp_path / "link.json"
    files.write(path, "first")
    path.chmod(0o640)
    link.symlink_to(path)
    with open(path) as held:
        assert files.write(link, b"second") == link
        assert held.read() == "first", "who has it open reads on"
    assert path.read_text() == link.read_text() == "second" and link.is_symlink()
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert names(tmp_path) == ["a.json", "link.json"]


def test_files_are_written_in_one_place():
    root = Path(gx.__file__).parent
    writes = re.compile(r"write_text|write_bytes|to_netcdf|np\.save|json\.dump\(|open\([^)]*[\"'][wax]b?[\"']")
    # examples in docstrings are a reader's
    nowhere = re.compile(r"open\(os\.devnull|np\.savez\(buffer|>>> .*")
    found = {path.name for path in root.rglob("*.py") if writes.search(nowhere.sub("", path.read_text()))}
    assert found == {"files.py"}


def test_rights_of_a_new_file_are_those_of_any(tmp_path):
    (tmp_path / "plain").write_text("")
    files.write(tmp_path / "new", "")
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_full_disk_leaves_what_was_there(tmp_path):
    for name in ("a.nc", "a.mat"):
        SMALL.save(tmp_path / name)
    plots.save(plots.figure(1, 1), tmp_path / "a.png", dpi=20)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with full_disk():
        for name in ("a.nc", "a.mat"):
            with pytest.raises(OSError, match=rf"{name}' could not be written \(File too large\); what was there"):
                LARGE.save(tmp_path / name)
        with pytest.raises(OSError, match="could not be written"):
            plots.save(plots.figure(9, 9), tmp_path / "a.png")
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("size", [0, 100])
def test_what_a_full_disk_lost_is_said_to_be_lost(size, tmp_path):
    with full_disk(size):
        kept, said = files.rescue(tmp_path / "a.nc", bytes(1000))
    assert kept is None and "nor into a temporary folder" in said and not names(tmp_path)


def test_a_folder_that_is_gone_when_it_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(files.tempfile, "tempdir", str(tmp_path))
    kept, said = files.rescue(tmp_path / "gone" / "a.nc", b"content")
    assert kept.read_bytes() == b"content" and kept.name == "a.nc"
    assert "No such file or directory" in said and said.endswith(f"it is at {str(kept)!r} instead.")


def test_a_file_that_is_open_elsewhere_is_written_again(tmp_path):
    path = SMALL.save(tmp_path / "a.nc")
    with xr.open_dataset(path, engine="h5netcdf") as held:
        LARGE.save(path)
        np.testing.assert_array_equal(held["x"], SMALL.x)
    np.testing.assert_array_equal(xr.load_dataset(path)["x"], LARGE.x)


def test_netcdf_from_memory_is_what_xarray_writes(tmp_path):
    data = SMALL.to_xarray().assign_attrs(words=["a", "é"], n=3).assign(name=("x", ["a", "bé", ""]))
    data.to_netcdf(tmp_path / "theirs.nc", engine="h5netcdf")
    files.write(tmp_path / "ours.nc", files.netcdf(data))
    theirs, ours = (xr.load_dataset(tmp_path / f"{name}.nc", engine="h5netcdf") for name in ("theirs", "ours"))
    xr.testing.assert_identical(theirs, ours)


@pytest.mark.parametrize("path, said", [
    (".", "It is a folder: add a name"), ("none/a.nc", "There is no folder"), ("pipe.nc", "It is no ordinary file"),
    ("a" * 300 + ".nc", "File name too long"), ("a\0.nc", "path: expected a file's path"),
    ("", "expected a file's path"), ("/proc/a.nc", "path: expected a file that can be written"),
])
def test_what_cannot_be_written_is_refused(path, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe.nc")
    with pytest.raises(ValueError, match=said):
        SMALL.save(path)
    with pytest.raises(ValueError, match=said):
        plots.save(plots.figure(1, 1), path)
    assert names(tmp_path) == ["pipe.nc"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_the_right_to_write(tmp_path):
    (tmp_path / "shut").mkdir(mode=0o500)
    with pytest.raises(ValueError, match="Permission denied"):
        SMALL.save(tmp_path / "shut" / "a.nc")
    (tmp_path / "a.nc").touch(mode=0o400)
    with pytest.raises(ValueError, match="protected"):
        SMALL.save(tmp_path / "a.nc")


def test_endings_of_pictures(tmp_path):
    for name in ("a.txt", "a"):
        with pytest.raises(ValueError, match="path: expected one of"):
            plots.save(plots.figure(1, 1), tmp_path / name)
    assert plots.save(plots.figure(1, 1), tmp_path / "a.SVG").read_bytes().startswith(b"<?xml")


@pytest.mark.parametrize("out", ["FILE", "/proc/none", "NONE/x.nc/FOLDER.png", "a\0b"])
@pytest.mark.parametrize("command", [ARGUMENTS, ["reproduce", "fig1.3"]])
def test_the_place_is_looked_at_before_anything_is_computed(command, out, tmp_path, capsys, monkeypatch):
    def never(*arguments, **keywords):
        raise AssertionError

    for module, name in ((gx.resonance, "transmission"), (Figure, "number")):
        monkeypatch.setattr(module, name, never, raising=False)
    monkeypatch.chdir(tmp_path)
    Path("FILE").write_text("")
    for ending in ("resonance.png", "fig1.3.png", "FOLDER.png"):
        Path("NONE/x.nc", ending).mkdir(parents=True)
    if "NONE" in out:
        out = out if command is ARGUMENTS else "NONE/x.nc"
    assert main([*command, "--out", out]) == 2
    (line,) = complaints(capsys.readouterr())
    assert line.startswith(("granjax: --out: expected", "granjax: out: expected"))


def test_a_full_disk_costs_no_table(tmp_path, capsys, computed):
    assert main([*ARGUMENTS, "--out", str(tmp_path)]) == 0
    whole = capsys.readouterr().out
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with full_disk():
        assert main([*ARGUMENTS, "--out", str(tmp_path)]) == 1
    captured = capsys.readouterr()
    assert captured.out == "".join(line for line in whole.splitlines(True) if not line.startswith("Written"))
    assert [f"resonance{end}' could not be written (File too large)" in line
            for end, line in zip((".nc", ".png"), complaints(captured), strict=True)] == [True, True]
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_folder_that_goes_while_computing(tmp_path, capsys, computed):
    computed.setattr(files.tempfile, "tempdir", str(tmp_path))
    out, refine = tmp_path / "out", gx.resonance.refine
    computed.setattr(gx.resonance, "refine", lambda *x, **k: (out.rmdir(), refine())[1])
    assert main([*ARGUMENTS, "--out", str(out), "--json"]) == 1
    captured = capsys.readouterr()
    assert json.loads(captured.out)["resonances"] == [0.4]
    places = [line.split(" it is at ")[1].split("'")[1] for line in complaints(captured)]
    assert [Path(place).name for place in places] == ["resonance.nc", "resonance.png"]
    assert all(Path(place).stat().st_size > 1000 for place in places)


def test_two_commands_write_one_file(tmp_path, capsys, computed):
    assert main([*ARGUMENTS, "--out", str(tmp_path)]) == 0
    with xr.open_dataset(tmp_path / "resonance.nc", engine="h5netcdf"):
        assert main([*ARGUMENTS, "--out", str(tmp_path)]) == 0
    assert names(tmp_path) == ["resonance.nc", "resonance.png"]
    assert not complaints(capsys.readouterr())


def test_a_figure_on_a_full_disk(tmp_path, monkeypatch):
    from granjax.studies.reproduce import figure, making, run

    plain = figure("fig1.3")
    data = xr.Dataset({"x": ("x", np.random.default_rng(0).normal(size=2000))})
    made = plain.__class__(**{**vars(plain), "compute": lambda **_: data.copy(), "number": lambda d: plain.expected,
                              "draw": lambda plots, canvas, d: canvas.subplots().plot(d.x)})
    monkeypatch.setattr(making, "figure", lambda label: made)
    with full_disk():
        (result,) = run("fig1.3", tmp_path, check=True, plots=plots)
    assert result.passed and result.picture is None and result.data is None
    assert "agrees" in result.outcome and "File too large" in result.unwritten and result.unwritten in result.outcome
    assert not names(tmp_path)


@pytest.mark.parametrize("error, code, said", [
    (BrokenPipeError(32, "Broken pipe"), UNREAD, []),
    (OSError(28, "No space left on device"), 1,
     ["granjax: standard output could not be written (No space left on device)"]),
])
def test_standard_output_that_takes_nothing(error, code, said, tmp_path, capsys, computed):
    class Closed:
        def write(self, text):
            raise error

        flush = write

    computed.setattr(sys, "stdout", Closed())
    assert main([*ARGUMENTS, "--out", str(tmp_path)]) == code
    assert names(tmp_path) == ["resonance.nc", "resonance.png"], "the files are there all the same"
    assert complaints(capsys.readouterr()) == said


def test_standard_streams_that_are_not_there(tmp_path, capsys, computed):
    stdout = sys.stdout
    computed.setattr(sys, "stdout", None)
    assert main([*ARGUMENTS, "--out", str(tmp_path)]) == 1
    assert complaints(capsys.readouterr()) == ["granjax: standard output is closed: results are not printed"]
    computed.setattr(sys, "stdout", stdout)
    computed.setattr(sys, "stderr", None)
    assert main(["resonance", "--beads", "2"]) == 2
    assert "--beads: expected" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a shell's redirections")
def test_closed_streams_of_a_process(tmp_path):
    """Without standard error a sentence goes to standard output, and no file takes the place of a stream."""
    command = f"exec {sys.executable} -m granjax reproduce fig1.33 <&- 2>&-"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 2 and "Did you mean" in done.stdout
    assert done.stdout.count("\n") == 1 and not names(tmp_path)
