"""Files are there whole or not at all; a result is told where it cannot be written."""

import contextlib
import resource
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import granjax as gx
from granjax import files, plots
from granjax.cli import main
from granjax.results import Result, array

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
    x: np.ndarray = array("The places.", "m", "x")

    @property
    def outcome(self):
        return "A sample."


SMALL, LARGE = Sample(np.arange(3.0)), Sample(np.random.default_rng(0).normal(size=2000))


def complaints(captured):
    return [line for line in captured.err.splitlines() if "JAX has started" not in line]


def test_a_file_is_replaced_whole(tmp_path):
    path = files.write(tmp_path / "a.json", "first")
    with open(path) as held:
        assert files.write(path, b"second") == path
        assert held.read() == "first", "who has it open reads on"
    assert path.read_text() == "second" and names(tmp_path) == ["a.json"]


def test_a_full_disk_leaves_what_was_there(tmp_path):
    for name in ("a.nc", "a.mat"):
        SMALL.save(tmp_path / name)
    plots.save(plots.figure(1, 1), tmp_path / "a.png", dpi=20)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with full_disk():
        for name in ("a.nc", "a.mat"):
            with pytest.raises(OSError, match="File too large"):
                LARGE.save(tmp_path / name)
        with pytest.raises(OSError, match="File too large"):
            plots.save(plots.figure(9, 9), tmp_path / "a.png")
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


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
    theirs, ours = (
        xr.load_dataset(tmp_path / f"{name}.nc", engine="h5netcdf") for name in ("theirs", "ours")
    )
    xr.testing.assert_identical(theirs, ours)


@pytest.mark.parametrize(
    "path, said", [(".", "which is a folder"), ("none/a.nc", "Make the folder 'none' first")]
)
def test_what_cannot_be_written_is_refused(path, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=said):
        SMALL.save(path)
    with pytest.raises(ValueError, match=said):
        plots.save(plots.figure(1, 1), path)
    assert not names(tmp_path)


def test_endings_of_pictures(tmp_path):
    for name in ("a.txt", "a"):
        with pytest.raises(ValueError, match="ending: expected one of"):
            plots.save(plots.figure(1, 1), tmp_path / name)
    assert plots.save(plots.figure(1, 1), tmp_path / "a.SVG").read_bytes().startswith(b"<?xml")


@pytest.mark.parametrize("out", ["FILE/below", "/proc/none", "NONE/x.nc/FOLDER.png"])
def test_the_place_is_looked_at_before_anything_is_computed(out, tmp_path, capsys, monkeypatch):
    def never(*arguments, **keywords):
        raise AssertionError

    monkeypatch.setattr(gx.resonance, "transmission", never)
    monkeypatch.chdir(tmp_path)
    Path("FILE").write_text("")
    Path("NONE/x.nc/FOLDER.png").mkdir(parents=True)
    assert main([*ARGUMENTS, "--out", out]) == 2
    (line,) = complaints(capsys.readouterr())
    assert line.startswith("granjax: --out: expected")
