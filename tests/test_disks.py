"""Files are there whole or not at all; a result is told where it cannot be written."""

import numpy as np
import pytest
from refusals import refused

from granjax import plots
from granjax.base import files
from granjax.results import Result, array


def names(folder):
    return sorted(path.name for path in folder.iterdir())


class Sample(Result):
    x: np.ndarray = array("The places.", "m", "x")

    @property
    def outcome(self):
        return "A sample."


SMALL = Sample(np.arange(3.0))


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
