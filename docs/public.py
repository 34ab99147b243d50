"""The public names of granjax: what the reference lists, and of which docstrings the examples run."""

import inspect
from collections.abc import Iterator
from types import ModuleType
from typing import Any


def names_of(module: ModuleType) -> list[str]:
    """Public names of a module: its `__all__`; else the classes and functions of granjax that it shows."""
    if hasattr(module, "__all__"):
        return list(module.__all__)
    package = hasattr(module, "__path__")
    own = {name: x for name, x in vars(module).items() if not name.startswith("_")}
    return [
        name
        for name, x in own.items()
        if (inspect.isclass(x) or inspect.isfunction(x))
        and (
            x.__module__.startswith(module.__name__) if package else x.__module__ == module.__name__
        )
    ]


def modules(
    module: ModuleType, name: str = "gx", known: set | None = None
) -> Iterator[tuple[str, ModuleType]]:
    """(name, module) of a public module and of all public ones within it, each once."""
    known = set() if known is None else known
    known.add(module.__name__)
    yield name, module
    for inner in names_of(module):
        x = getattr(module, inner)
        if inspect.ismodule(x) and x.__name__.startswith("granjax") and x.__name__ not in known:
            yield from modules(x, f"{name}.{inner}", known)


def objects(module: ModuleType) -> list[tuple[str, str, Any]]:
    """(page, name, object) of every public class and function, each once, where a user meets it first."""
    found = []
    seen = set()
    for page, where in modules(module):
        for name in names_of(where):
            x = getattr(where, name)
            if (
                callable(x)
                and getattr(x, "__module__", "").startswith("granjax")
                and id(x) not in seen
            ):
                seen.add(id(x))
                found.append((page, name, x))
    return found
