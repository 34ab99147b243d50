"""What tells one sweep from another, in any process: its function, its parameters, the versions."""

import functools
import hashlib
import types
from collections.abc import Callable, Iterator

import equinox as eqx
import jax
import numpy as np

from ..outside import of_library, plain, reads_of

# what is chosen for a sweep and not asked for: a store keeps its own
CHOSEN = ("chunk", "order", "how", "scene")
DEPTH = 6
# letters of a value that are written out, and entries of a list; digits of a digest
LONG, MANY, DIGITS = 60, 16, 20


def function_identity(function: Callable) -> dict:
    """The name of a function, a digest of what it does, and what it reads from outside, the same in every process.

    What it does is its code without its place, and that of the user's functions that it calls; libraries count by
    their names, for which the versions stand.
    """
    reads, code = {}, hashlib.sha256()
    name = getattr(function, "__name__", type(function).__name__)
    _tell(function, "", reads, code, set(), DEPTH)
    return {"name": name, "code": code.hexdigest()[:DIGITS], "reads": reads}


def _tell(function, path, reads, code, seen, depth):
    """Add what a callable does to the digest `code`, and the values that it reads to `reads`."""
    if isinstance(function, functools.partial):
        _tell(function.func, path, reads, code, seen, depth)
        for name, x in [*enumerate(function.args), *function.keywords.items()]:
            _value(x, f"{path}{name}", reads, code, seen, depth - 1)
        return
    if isinstance(function, types.MethodType):
        _value(function.__self__, f"{path}self", reads, code, seen, depth - 1)
    inner = plain(function)
    if not isinstance(inner, types.FunctionType):
        code.update(f"{type(function).__module__}.{type(function).__qualname__}".encode())
        call = plain(getattr(type(function), "__call__", None))
        if isinstance(call, types.FunctionType) and not of_library(function):
            _tell(call, path, reads, code, seen, depth)
            _value(vars(function) if hasattr(function, "__dict__") else {}, path, reads, code, seen, depth - 1)
        # of the library, such as the function of a file
        for key, x in getattr(function, "reads", {}).items() if of_library(function) else ():
            _value(x, f"{path}{key}", reads, code, seen, depth - 1)
        return
    if inner.__code__ in seen or not depth:
        return
    seen.add(inner.__code__)
    for part in _code(inner.__code__):
        code.update(part)
    for name, x in reads_of(inner):
        _value(x, f"{path}{name}", reads, code, seen, depth - 1)
    _value(inner.__defaults__ or (), f"{path}defaults of {inner.__name__}", reads, code, seen, depth - 1)
    _value(inner.__kwdefaults__ or {}, f"{path}defaults of {inner.__name__}", reads, code, seen, depth - 1)


def _code(code) -> Iterator[bytes]:
    """What a code does, without where it stands."""
    yield code.co_code
    yield repr((code.co_names, code.co_varnames, code.co_freevars)).encode()
    for x in code.co_consts:
        if isinstance(x, types.CodeType):
            yield from _code(x)
        else:
            yield repr(sorted(map(repr, x)) if isinstance(x, frozenset) else x).encode()


def _value(x, path, reads, code, seen, depth, within=False):
    """What is read from outside: numbers and words written out, arrays by a digest, functions by what they do."""
    if x is None or isinstance(x, (bool, int, float, complex, str, bytes, np.generic)):
        text = repr(x.item() if isinstance(x, np.generic) else x)
        reads[path] = text if len(text) <= LONG else _digest(text.encode())
    elif isinstance(x, (np.ndarray, jax.Array)):
        array = np.asarray(x)
        held = array.tobytes() if array.dtype != object else repr(array.tolist()).encode()
        reads[path] = f"{array.dtype} of shape {array.shape}, {_digest(held)}"
    elif isinstance(x, (tuple, list, set, frozenset, dict)) and depth and len(x) > MANY and not within:
        inner = {}
        _value(x, "", inner, code, seen, depth, within=True)
        reads[path] = f"{len(x)} values, {_digest(repr(sorted(inner.items())).encode())}"
    elif isinstance(x, (tuple, list, set, frozenset, dict)) and depth:
        parts = x.items() if isinstance(x, dict) else enumerate(sorted(map(repr, x)) if isinstance(x, set) else x)
        for key, part in parts:
            _value(part, f"{path}[{key!r}]", reads, code, seen, depth - 1)
    elif isinstance(x, eqx.Module) and depth:
        code.update(type(x).__qualname__.encode())
        for name, part in vars(x).items():
            if name != "_outside":
                _value(part, f"{path}.{name}", reads, code, seen, depth - 1)
        _methods(type(x), path, reads, code, seen, depth)
    elif isinstance(x, type):
        code.update(f"{x.__module__}.{x.__qualname__}".encode())
        _methods(x, path, reads, code, seen, depth)
    elif callable(x):
        if of_library(x):
            code.update(f"{getattr(x, '__module__', '')}.{getattr(x, '__qualname__', type(x).__qualname__)}".encode())
        else:
            _tell(x, f"{path}: ", reads, code, seen, depth)
    elif depth and hasattr(x, "__dict__") and not of_library(x):
        code.update(type(x).__qualname__.encode())
        _value(dict(vars(x)), path, reads, code, seen, depth - 1)
    else:
        code.update(type(x).__qualname__.encode())


def _methods(kind, path, reads, code, seen, depth):
    for own in kind.__mro__:
        if not of_library(own):
            for name, x in vars(own).items():
                if isinstance(plain(x), types.FunctionType):
                    _tell(x, f"{path}.{name}: ", reads, code, seen, depth - 1) if depth else None


def _digest(held):
    return hashlib.sha256(held).hexdigest()[:DIGITS]


def differences(stored: dict, asked: dict) -> list[str]:
    """In words, in what a sweep that is asked for is another than a stored one; what is chosen by itself left out."""
    found = []
    for key in ("format", "design", "float", "platform"):
        if stored.get(key) != asked.get(key):
            found.append(f"{key}: {asked.get(key)}, the store has {stored.get(key)}")
    found += _of_parameters(stored["parameters"], asked["parameters"])
    found += _of_functions(stored["function"], asked["function"])
    for name, version in asked["versions"].items():
        if stored["versions"].get(name) != version:
            found.append(f"{name} {version}, the store was begun with {stored['versions'].get(name)}")
    return found


def _of_parameters(stored, asked):
    for name in asked.keys() - stored.keys():
        yield f"parameter {name}: not in the store, which has {', '.join(stored)}"
    for name in stored.keys() - asked.keys():
        yield f"parameter {name}: only in the store"
    if list(stored) != list(asked) and stored.keys() == asked.keys():
        yield f"parameters in the order {', '.join(asked)}, the store has {', '.join(stored)}"
    for name in (name for name in asked if name in stored):
        old, new = stored[name], asked[name]
        if old["values"] != new["values"]:
            yield f"{name}: {_row(new['values'])}, the store has {_row(old['values'])}"
        elif old["dtype"] != new["dtype"]:
            yield f"{name}: of {new['dtype']}, in the store of {old['dtype']}"
        elif old["units"] != new["units"]:
            yield f"{name}: in {new['units'] or 'no unit'}, in the store {old['units'] or 'none'}"


def _row(values):
    ends = f"{values[0]!r} to {values[-1]!r}" if len(values) > 1 else repr(values[0])
    return f"{len(values)} value{'s' * (len(values) > 1)}, {ends}"


def _of_functions(stored, asked):
    old, new = stored["reads"], asked["reads"]
    if stored["name"] != asked["name"]:
        yield f"function: {asked['name']}, the store has {stored['name']}"
    for name in sorted(old.keys() | new.keys()):
        if old.get(name) != new.get(name) and name in old and name in new:
            yield f"function: it reads {name} = {new[name]}, in the store {old[name]}"
    if stored["code"] != asked["code"] or old.keys() != new.keys():
        yield "function: what it does has changed since"
