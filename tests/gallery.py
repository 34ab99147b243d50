"""Scripts of the gallery, each run once for all tests that check what it leaves."""

import functools
import runpy
from pathlib import Path
from types import SimpleNamespace

FOLDER = Path(__file__).parents[1] / "docs" / "gallery"


@functools.cache
def left_by(name):
    """The names that a script leaves."""
    return SimpleNamespace(**runpy.run_path(str(FOLDER / f"{name}.py")))
