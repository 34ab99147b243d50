"""The review's figures, docs/review: each number is the known one, and every axis of the picture says what it shows."""

import json
from importlib import import_module
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "review"
FIGURES = sorted(path.stem for path in FOLDER.glob("*_*.py"))


@pytest.fixture(autouse=True)
def neighbours(monkeypatch):
    """The scripts import one another, as from the command line."""
    monkeypatch.syspath_prepend(FOLDER)


def test_all_sixteen_are_made_and_stored():
    from all import FIGURES as made

    assert len(made) == 16 and sorted(made) == FIGURES
    stored = json.loads((FOLDER / "made.json").read_text())
    assert list(stored) == list(made) and all(
        row[-1] == "agrees" for rows in stored.values() for row in rows
    )
    for name in made:
        text = (FOLDER / f"{name}.py").read_text().splitlines()
        assert len(text) < 80 and max(map(len, text)) <= 100, name
        assert (FOLDER / f"{name}.webp").stat().st_size > 1e4


@pytest.mark.slow
@pytest.mark.usefixtures("optimised")
@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_has_its_numbers_and_labels(name):
    rows = import_module(name).make()
    assert rows
    for row, (value, expected, within) in rows.items():
        assert abs(value - expected) <= within, row
    axes = plt.gcf().axes
    bars = [image.colorbar.ax for ax in axes for image in ax.images]
    plt.gcf().draw_without_rendering()
    for ax in axes:
        assert ax.has_data() and ax.get_ylabel() and (ax.get_xlabel() or ax in bars), ax
