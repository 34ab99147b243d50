"""Files are there whole or not at all; a result is told where it cannot be written."""

from pathlib import Path

import numpy as np
import pytest
from refusals import refused

import granjax as gx
from granjax import files, plots
from granjax.cli import main
from granjax.results import Result, array

ARGUMENTS = ["resonance", "--beads", "11", "--ratios", "12"]


def names(folder):
    return sorted(path.name for path in folder.iterdir())


class Sample(Result):
    x: np.ndarray = array("The places.", "m", "x")

    @property
    def outcome(self):
        return "A sample."


SMALL = Sample(np.arange(3.0))


def complaints(captured):
    return [line for line in captured.err.splitlines() if "JAX has started" not in line]


def test_a_file_is_replaced_whole(tmp_path):
    path = files.write(tmp_path / "a.json", "first")
    with open(path) as held:
        assert files.write(path, b"second") == path
        assert held.read() == "first", "who has it open reads on"
    assert path.read_text() == "second" and names(tmp_path) == ["a.json"]


@pytest.mark.parametrize(
    "path, said", [(".", "which is a folder"), ("none/a.nc", "Make the folder 'none' first")]
)
def test_what_cannot_be_written_is_refused(path, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with refused(said):
        SMALL.save(path)
    with refused(said):
        plots.save(plots.figure(1, 1), path)
    assert not names(tmp_path)


def test_endings_of_pictures(tmp_path):
    for name in ("a.txt", "a"):
        with refused("ending: expected one of"):
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
