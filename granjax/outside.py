"""What functions of the user's read from outside: closures and globals, whose values a compiled program has kept."""

import dis
import functools
import hashlib
import os
import sys
import types
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

# what changes as a function runs, such as a list that counts its calls, is its own affair
MUTATORS = {"append", "add", "extend", "update", "insert", "setdefault", "pop", "remove"}
DEPTH = 6
SMALL = 4096
# bytes from which on a digest stands for an array
LONG = 256
LIBRARIES = frozenset(sys.stdlib_module_names) - {"__main__"} | {
    "granjax", "jax", "jaxlib", "jaxtyping", "numpy", "scipy", "equinox", "diffrax", "optimistix", "lineax", "optax",
    "beartype",
}
STANDARD = Path(os.__file__).resolve().parent


class Outside:
    """A pytree without leaves whose structure holds what some functions read from outside, as it stands now.

    JAX compiles anew where the structure of its arguments is another. A function in that structure counts as the same
    for ever, though a global number that it reads may have changed: with this beside it, another number is another
    program. Where nothing is a function of the user's, there is nothing to look at.
    """

    def __init__(self, tree: Any = (), readers: tuple | None = None):
        self.readers = tuple(dict.fromkeys(_readers(tree, DEPTH))) if readers is None else readers

    def values(self) -> tuple:
        """What is read, hashable: equal as long as it means the same."""
        return tuple(_read(function, frozenset(), DEPTH) for function in self.readers) if self.readers else ()


jax.tree_util.register_pytree_node(
    Outside, lambda x: ((), (x.readers, x.values())), lambda known, _: Outside(readers=known[0])
)


def _readers(x, depth) -> Iterator[Any]:
    """What reads, of the user's, in a tree of modules: their classes with all methods, and functions that they hold."""
    if not depth or isinstance(x, (str, int, float, type(None), jax.Array, np.ndarray, type)):
        return
    if isinstance(x, (tuple, list)):
        for part in x:
            yield from _readers(part, depth - 1)
    elif isinstance(x, dict):
        yield from _readers(list(x.values()), depth - 1)
    elif isinstance(x, eqx.Module):
        yield from _methods(type(x))
        if not _known(type(x).__module__):
            yield type(x)
        yield from _readers(list(vars(x).values()), depth - 1)
    elif isinstance(x, functools.partial) or callable(x) and not of_library(x):
        yield x


@lru_cache(maxsize=1024)
def _methods(kind):
    """The functions that a class of the user's is made of, inherited ones included."""
    own = [klass for klass in kind.__mro__ if not _known(klass.__module__)]
    found = [plain(x) for klass in own for x in vars(klass).values()]
    return tuple(x for x in found if isinstance(x, types.FunctionType) and not of_library(x))


def plain(x: Any) -> Any:
    """The function in a method, a property or a wrapper."""
    for name in ("fget", "method", "__func__", "__wrapped__"):
        inner = getattr(x, name, None) if not isinstance(x, type) else None
        if isinstance(inner, types.FunctionType):
            return plain(inner)
    return x


@lru_cache(maxsize=1024)
def _known(module):
    top = str(module).partition(".")[0]
    if top not in LIBRARIES or top not in sys.stdlib_module_names:
        return top in LIBRARIES
    # a file of the user's may be called wave.py
    file = getattr(sys.modules.get(top), "__file__", None)
    return not file or Path(file).resolve().is_relative_to(STANDARD)


@lru_cache(maxsize=1024)
def is_library(module: str) -> bool:
    """Whether a module is one of those, or of any other package that is installed, by its name."""
    if module == "__main__":
        return False
    file = getattr(sys.modules.get(str(module).partition(".")[0]), "__file__", None)
    return _known(module) or bool(file) and bool({"site-packages", "dist-packages"} & set(Path(file).parts))


def of_library(x: Any) -> bool:
    """Whether it is of the standard library, of granjax, or of what it is made with."""
    return _known(getattr(x, "__module__", None) or getattr(type(x), "__module__", ""))


def _read(function, seen, depth):
    """What a callable reads from outside, hashable."""
    if isinstance(function, functools.partial):
        return tuple(_value(x, seen, depth - 1) for x in (function.func, function.args, function.keywords))
    if isinstance(function, type):  # constants of a class of the user's, its methods read them by `self`
        own = [vars(kind) for kind in function.__mro__ if not _known(kind.__module__)]
        return tuple((name, _value(x, seen, 0)) for names in own for name, x in names.items() if _is_number(x))
    if isinstance(function, types.MethodType):
        own = _own(function.__self__, plain(function.__func__))
        return _read(function.__func__, seen, depth), _value(own, seen, max(depth - 1, 1))
    function = plain(function)
    if not isinstance(function, types.FunctionType):
        own = _value(_own(function), seen, max(depth - 1, 1))
        return own, *(_read(method, seen, depth - 1) for method in _methods(type(function)))
    code = function.__code__
    if code in seen or not depth:
        return ()
    seen = seen | {code}
    found = [_value(x, seen, depth - 1) for _, x in reads_of(function) if not isinstance(x, types.ModuleType)]
    return tuple(found) + ((_value(function.__defaults__, seen, depth - 1),) if function.__defaults__ else ())


def reads_of(function: types.FunctionType) -> Iterator[tuple[str, Any]]:
    """Dotted names and present values of what a plain function reads from outside.

    What it reads of a library counts as its module: that is the same whether it was loaded before or not.
    """
    code = function.__code__
    cells = dict(zip(code.co_freevars, function.__closure__ or ()))
    for name, *attributes in _names(code):
        try:
            x = cells[name].cell_contents if name in cells else function.__globals__[name]
        except (KeyError, ValueError):  # a builtin, or not bound yet
            continue
        path = name
        for attribute in attributes:
            if isinstance(x, types.ModuleType) and _known(x.__name__):
                break
            if isinstance(x, types.ModuleType) or _holds(x, attribute):
                x, path = vars(x).get(attribute), f"{path}.{attribute}"
            elif isinstance(x, type) and not _known(x.__module__):
                x = next((vars(kind)[attribute] for kind in x.__mro__ if attribute in vars(kind)), x)
                path = f"{path}.{attribute}"
        yield path, x


def _is_number(x):
    return isinstance(x, (int, float, complex, np.generic, np.ndarray, jax.Array))


def _holds(x, attribute):
    return not isinstance(x, (type, types.FunctionType)) and attribute in getattr(x, "__dict__", ())


def _own(x, method=None):
    """The attributes of an object, less those that its call, or a method of it, writes itself."""
    code = getattr(method or plain(getattr(type(x), "__call__", None)), "__code__", None)
    own = None if isinstance(x, type) else getattr(x, "__dict__", None)
    written = _stored(code)[0] if own and code else ()
    left = {path[1] for path in written if path[1:] and path[:1] == code.co_varnames[:1]}
    return {name: part for name, part in own.items() if name not in left} if left else own


@lru_cache(maxsize=1024)
def _stored(code):
    """{(name, attribute, ...)} that a code stores into, as `x[i] = ...` or `x.a += ...`, and where these begin.

    The whole of `x` counts as written by `x[i] = ...`. In the source the load of its name begins where that does.
    """
    found, at, places = set(), {}, set()
    for step in dis.get_instructions(code):
        place = _place(step)
        if place is None:
            continue
        path, whole = at.get(place, ((), False))
        attribute = step.opname in ("LOAD_ATTR", "LOAD_METHOD")
        mutates = attribute and step.argval in MUTATORS and path[:1] == code.co_varnames[:1]
        if step.opname in ("STORE_SUBSCR", "STORE_ATTR") or mutates:
            if path:
                found.add(path + (step.argval,) if step.opname == "STORE_ATTR" and not whole else path)
                places.add(place)
        elif attribute and path and not whole:
            at[place] = path + (step.argval,), False
        elif step.opname.startswith(("LOAD_GLOBAL", "LOAD_NAME", "LOAD_DEREF", "LOAD_FAST")):
            at[place] = (step.argval,), False
        elif step.opname.startswith(("BINARY_SUBSCR", "BINARY_OP", "BINARY_SLICE")):
            at[place] = path, True
        elif step.opname.startswith("CALL"):
            at.pop(place, None)
    return frozenset(found), frozenset(places)


def _place(step):
    """(line, column) where the source of an instruction begins, or `None`."""
    where = step.positions
    return (where.lineno, where.col_offset) if where and where.col_offset is not None else None


@lru_cache(maxsize=1024)
def _names(code):
    """(name, attribute, ...) of all that a code, and what is defined in it, reads from outside and does not write."""
    found, written, path = [], set(), None
    stored, places = _stored(code)
    own = set(code.co_varnames) | set(code.co_cellvars)
    for step in dis.get_instructions(code):
        if step.opname in ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_DEREF", "LOAD_CLASSDEREF") and step.argval not in own:
            path = None if _place(step) in places else [step.argval]
            found += [path] if path else []
        elif step.opname in ("LOAD_ATTR", "LOAD_METHOD") and path:
            path.append(step.argval)
        elif step.opname in ("STORE_GLOBAL", "STORE_DEREF"):
            written.add(step.argval)
        elif step.opname not in ("CACHE", "PUSH_NULL", "PRECALL", "COPY_FREE_VARS"):
            path = None
    for inner in code.co_consts:
        if isinstance(inner, types.CodeType):
            found += [names for names in _names(inner) if names[0] not in own]
    kept = dict.fromkeys(tuple(names) for names in found if names[0] not in written and not MUTATORS & set(names))
    return tuple(path for path in kept if not any(path[: len(into)] == into for into in stored))


class _Same:
    """Something that is equal to itself alone; it is kept alive, so that nothing else takes its place."""

    def __init__(self, x):
        self.x = x

    def __eq__(self, other):
        return isinstance(other, _Same) and self.x is other.x

    def __hash__(self):
        return id(self.x)


def _value(x, seen, depth):
    """A value, hashable and equal as long as it means the same."""
    if x is None or isinstance(x, (bool, int, str, bytes)):
        return type(x), x
    if isinstance(x, (float, complex, np.generic)):
        return type(x), x if x == x else "nan"
    if isinstance(x, np.ndarray):
        held = x.tobytes()
        return x.shape, x.dtype, held if len(held) <= LONG else hashlib.blake2b(held, digest_size=16).digest()
    if isinstance(x, jax.Array):
        tiny = not isinstance(x, jax.core.Tracer) and x.size <= SMALL and x.dtype.kind in "fiubc"
        return _value(np.asarray(x), seen, depth) if tiny else _Same(x)
    if not depth or isinstance(x, (type, types.ModuleType)):
        return _Same(x)
    if isinstance(x, (tuple, list)):
        if len(x) * 8 > LONG and set(map(type, x)) == {float}:
            return type(x), _value(np.asarray(x), seen, depth)
        return type(x), *(_value(part, seen, depth - 1) for part in x)
    if isinstance(x, dict):
        return dict, *((_value(k, seen, depth - 1), _value(part, seen, depth - 1)) for k, part in x.items())
    if callable(x) and of_library(x) and not isinstance(x, (eqx.Module, functools.partial)):
        return _Same(x)
    if isinstance(x, (types.FunctionType, types.MethodType, functools.partial)) or hasattr(x, "__wrapped__"):
        # a function that is made anew is another one for JAX, whatever it reads
        return _Same(plain(x)), _read(x, seen, depth)
    own = _own(x)
    return _Same(x) if own is None else (type(x), _value(own, seen, depth - 1))
