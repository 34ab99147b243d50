"""What `import granjax as gx` shows: `help(gx)`, `dir(gx)` and `__all__` say the same, each name once."""

import pydoc
import re
import types
from functools import reduce
from pathlib import Path

import granjax as gx


def listed():
    """(name, what is said of it) of each line of the module's docstring."""
    return re.findall(r"^    (\w+) +(\S.*)$", gx.__doc__[gx.__doc__.index("Contents") :], re.M)


def test_help_lists_the_face_once():
    names = [name for name, _ in listed()]
    assert sorted(names) == sorted(gx.__all__) == dir(gx) and len(set(names)) == len(names)
    assert not [name for name in dir(gx) if name.startswith("_")]
    text = pydoc.plain(pydoc.render_doc(gx))
    for name, said in listed():
        assert getattr(gx, name) is not None and f"{name:<19} {said}" in text


def test_nothing_public_is_missing_from_the_list():
    shown = {name for name in vars(gx) if not name.startswith("_")}
    # what is left are parts of the package that nobody calls by its face
    assert all(isinstance(getattr(gx, name), types.ModuleType) for name in shown - {*gx.__all__})


def test_all_of_it_is_imported_by_a_star():
    space = {}
    exec("from granjax import *", space)
    assert space.keys() >= {*gx.__all__} and space["simulate"] is gx.simulate


def test_every_name_in_the_readme_and_the_docstrings_exists():
    root = Path(__file__).parents[1]
    texts = [x.read_text() for x in (root / "README.md", *(root / "granjax").rglob("*.py"))]
    names = {name for text in texts for name in re.findall(r"\bgx\.([A-Za-z_][\w.]*\w)", text)}
    for name in sorted(names):
        assert reduce(getattr, name.split("."), gx) is not None
    assert "units.BOLTZMANN" in names and gx.units.BOLTZMANN == 1.380649e-23
