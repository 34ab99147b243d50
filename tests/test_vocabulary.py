"""One word for one thing, and a type on each: the table of CONTRIBUTING.md against all public signatures."""

import importlib
import inspect
import pkgutil
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

import granjax
from granjax import base
from granjax.base.units import Units
from granjax.results import Result

TABLE = Path(__file__).parents[1] / "CONTRIBUTING.md"
# whose functions are called with a lattice elsewhere than first, and why
ORDER = {
    "vector_field": "what diffrax calls",
    "variational": "what diffrax calls",
    "Record.value": "as vector_field",
    "along": "a measure leads",
    "history": "a flow leads",
}
# whose results count time steps
TIME_STEPS = (
    "linear.floquet_bands",
    "orbits.floquet",
    "orbits.gap_breather",
    "work_precision",
)


# what the folders hold beside what their own names show
WITHIN = ["continuation.equilibria", "fit.descent", "fit.design", "fit.parameters"]


def faces(package):
    """Modules under a package that are public: its own, and those that their `__all__` names."""
    for m in pkgutil.iter_modules(package.__path__):
        if not m.name.startswith("_"):
            module = importlib.import_module(f"{package.__name__}.{m.name}")
            yield module
            yield from (getattr(module, name) for name in getattr(module, "__all__", ()))


SHOWN = [*faces(granjax), *faces(base), *(getattr(granjax, name) for name in granjax.__all__)]
NAMES = [x.__name__.removeprefix("granjax.") for x in SHOWN if inspect.ismodule(x)]
NAMES = list(dict.fromkeys(NAMES + WITHIN))


class Signature(NamedTuple):
    """A public function or method, or the fields of a class: its module, its name, names and annotations."""

    module: str
    name: str
    arguments: dict
    result: object
    described: bool


def rows():
    """(word, banned words, modules that may use them) of each row of the table."""
    for line in TABLE.read_text().splitlines():
        if line.startswith("| `"):
            word, _, banned, modules = (
                re.findall(r"`([\w.]+)`", cell) for cell in line.strip("|").split("|")
            )
            yield word[0], banned, modules


def public(module):
    """Functions and classes of granjax's own that a module shows."""
    for name, value in vars(importlib.import_module(f"granjax.{module}")).items():
        if not name.startswith("_") and str(getattr(value, "__module__", "")).startswith("granjax"):
            yield value


def signature(module, name, function):
    found = inspect.signature(function)
    arguments = {
        p.name: p.annotation for p in found.parameters.values() if p.name not in ("self", "cls")
    }
    described = bool(inspect.getdoc(function)) or name.endswith("__init__")
    return Signature(module, name, arguments, found.return_annotation, described)


def signatures():
    """Every public signature, once. A method that overrides one takes its types from the one it overrides."""
    seen = set()
    for module in NAMES:
        for value in public(module):
            where = value.__module__
            name = getattr(value, "__qualname__", "")
            if (where, name) in seen or not name:
                continue
            seen.add((where, name))
            if not inspect.isclass(value):
                if callable(value):
                    yield signature(where, name, value)
                continue
            fields = {
                k: v
                for c in reversed(value.__mro__)
                if c.__module__.startswith("granjax")
                for k, v in vars(c).get("__annotations__", {}).items()
                if not k.startswith("_")
            }
            yield Signature(where, name, fields, None, bool(vars(value).get("__doc__")))
            inherited = {k for c in value.__mro__[1:] for k in vars(c)} - {
                "__init__"
            } | fields.keys()
            for k, v in vars(value).items():
                own = (
                    k == "__init__"
                    and inspect.isfunction(v)
                    and "granjax" in inspect.unwrap(v).__code__.co_filename
                )
                if own or inspect.isfunction(v) and not k.startswith("_") and k not in inherited:
                    yield signature(where, f"{name}.{k}", v)


ALL = list(signatures())


def test_the_walk_finds_the_library():
    found = {(s.module, s.name) for s in ALL}
    assert {
        ("granjax.flow.simulate", "simulate"),
        ("granjax.flow.run", "Run"),
        ("granjax.laws.contact", "Hertz.__init__"),
        ("granjax.measures.fronts", "front_speed"),
        ("granjax.orbits.guesses", "single_site"),
        ("granjax.theory.nls", "bright_profile"),
    } <= found
    assert len(ALL) > 350 and len(list(rows())) > 10


def test_one_word_for_one_thing():
    wrong = [
        f"{s.module}: {s.name}({name}), say {word}"
        for word, banned, modules in rows()
        for s in ALL
        for name in s.arguments
        if name in banned and not any(s.module.startswith(f"granjax.{m}") for m in modules)
    ]
    assert not wrong, "\n".join(wrong)


def test_a_lattice_is_called_lattice_and_comes_first():
    wrong = []
    elsewhere = set()
    for s in ALL:
        names = list(s.arguments)
        lattices = [name for name, hint in s.arguments.items() if hint is granjax.Lattice]
        if s.result is None or s.name.endswith("__init__"):  # fields of a class
            continue
        wrong += [
            f"{s.module}: {s.name}({name}) is a Lattice" for name in lattices if name != "lattice"
        ]
        if "lattice" in names[1:]:
            elsewhere.add(s.name)
    assert not wrong, "\n".join(wrong)
    assert elsewhere == ORDER.keys()


def test_every_public_argument_field_and_result_has_its_type():
    empty = inspect.Parameter.empty
    wrong = [
        f"{s.module}: {s.name}({name})"
        for s in ALL
        for name, hint in s.arguments.items()
        if hint is empty
    ]
    wrong += [
        f"{s.module}: {s.name} -> ?"
        for s in ALL
        if s.result is empty and not s.name.endswith("__init__")
    ]
    assert not wrong, "\n".join(wrong)


def test_every_public_class_function_and_method_says_what_it_is():
    bare = [f"{s.module}: {s.name}" for s in ALL if not s.described]
    assert not bare, "\n".join(bare)


def test_the_examples_of_the_table_s_page_run():
    space = {}
    for block in re.findall(r"```python\n(.*?)```", TABLE.read_text(), re.S):
        exec(block, space)
    assert space["run"].completed and space["run"].energy_error < 1e-6
    assert space["shear"].strain({"u": np.ones(4), "theta": np.full(4, 2.0)}).tolist() == [2.0] * 4
    law = space["Adhesive"](np.asarray(0.8), np.asarray(1.3))
    assert law.in_units(Units(2.0, 3.0, 5.0)).rate == 3 * 1.3


def test_outcomes_are_sentences_and_verdicts_words():
    for s in ALL:
        if s.result is None and "outcome" in s.arguments:
            assert s.arguments["outcome"] in (str, "str") or "AbstractVar" in str(
                s.arguments["outcome"]
            ), s
    kinds = [value for module in NAMES for value in public(module) if inspect.isclass(value)]
    results = {kind for kind in kinds if issubclass(kind, Result)}
    assert len(results) > 20
    wrong = [
        kind
        for kind in results
        if "steps" in vars(kind).get("__annotations__", {})
        and not any(kind.__module__.startswith(f"granjax.{m}") for m in TIME_STEPS)
    ]
    assert not wrong, f"{wrong}: steps are time steps, say iterations"
