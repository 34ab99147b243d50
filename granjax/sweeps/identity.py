"""What tells one sweep from another, in any process: its function, its parameters, the versions."""

import dis
import functools
import hashlib
import importlib.util
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ..checks import refuse
from ..outside import is_library, reads_of

# what is chosen for a sweep and not asked for: a store keeps its own
CHOSEN = ("chunk", "order", "how", "scene")
DEPTH = 60
# letters of a value that are written out, and entries of a list; digits of a digest
LONG, MANY, DIGITS = 60, 16, 20
# what a wrapper of a library holds of the user's; what is kept in a class or an object for other ends than its own
HELD = ("__wrapped__", "fun", "jvp", "fwd", "bwd", "func", "args", "keywords", "pyfunc", "py_func")
ASIDE = {"_outside", "_cache", "__dict__", "__weakref__", "__doc__", "__module__", "__wrapped__", "_abc_impl",
         "__annotations__", "__dataclass_fields__", "__dataclass_params__", "__qualname__", "__firstlineno__",
         "__static_attributes__", "__slots__", "__match_args__", "__abstractmethods__", "__orig_bases__",
         "__parameters__", "__annotate__", "__annotate_func__", "__annotations_cache__"}
# what belongs to a process: how it stands is no part of what is computed
OF_PROCESS = {"threading", "multiprocessing", "concurrent", "asyncio", "queue", "logging", "io", "contextvars"}
PLAIN = (type(None), bool, int, float, complex, str, bytes)


def function_identity(function: Callable) -> dict:
    """The name of a function, a digest of what it does, and what it reads from outside, the same in every process.

    What it does is its code without its place, that of the user's functions and classes that it uses, and the modules
    that it imports; libraries count by their names, for which the versions stand.
    """
    told = _Telling()
    told.add(function, "", DEPTH)
    name = getattr(function, "__name__", type(function).__name__)
    return {"name": name, "code": told.code.hexdigest()[:DIGITS], "reads": told.reads}


class _Telling:
    """A digest `code` of what is done, and `reads`, the values that are read, by their names."""

    def __init__(self):
        self.reads, self.code, self.seen, self.above = {}, hashlib.sha256(), {}, set()

    def say(self, *words):
        """Add to the digest what cannot be taken for anything else that is added."""
        self.code.update(repr(words).encode() + b"\n")

    def add(self, x: Any, path: str, depth: int) -> None:
        """Numbers and words are written out, arrays by a digest, functions and objects by what they do and hold."""
        if isinstance(x, PLAIN) or isinstance(x, np.generic):
            text = f"{x.dtype} {x.item()!r}" if isinstance(x, np.generic) else repr(x)
            self.reads[path] = text if len(text) <= LONG else _digest(text.encode())
        elif isinstance(x, jax.core.Tracer):
            refuse("function", "one that reads numbers that are known", f"{path or 'one'}, which is traced",
                   "A sweep has no derivative and is not compiled: take the derivative within the function.")
        elif isinstance(x, (np.ndarray, jax.Array)):
            self.reads[path] = array_digest(x)
        elif isinstance(x, types.ModuleType):
            self.say("module", x.__name__ if is_library(x.__name__) else "")
        elif not depth or id(x) in self.above:
            self.say("and so on")
        elif isinstance(x, (tuple, list, set, frozenset, dict, types.MappingProxyType)):
            self.above.add(id(x))
            self._many(x, path, depth)
            self.above.discard(id(x))
        elif id(x) in self.seen:
            # which of those before: two functions may be of one code
            self.say("again", self.seen[id(x)][0])
        else:
            self.seen[id(x)] = len(self.seen), x
            self._thing(x, path, depth)

    def _many(self, x, path, depth, within=False):
        self.say(type(x).__name__, len(x))
        plain = all(isinstance(part, PLAIN) for part in (x.values() if hasattr(x, "values") else x))
        if len(x) > MANY and not within:
            if plain and isinstance(x, (tuple, list)):
                self.reads[path] = f"{len(x)} values, {_digest(repr(x).encode())}"
                return
            inner = _Telling()
            inner.seen, inner.above = self.seen, self.above
            inner._many(x, "", depth, True)
            inner.say(sorted(inner.reads.items()))
            self.reads[path] = f"{len(x)} values, {inner.code.hexdigest()[:DIGITS]}"
            return
        if isinstance(x, (set, frozenset)):
            parts = enumerate(sorted(x, key=_key))
        elif isinstance(x, (tuple, list)):
            parts = enumerate(x)
        else:
            parts = sorted(x.items(), key=lambda pair: _key(pair[0]))
        for key, part in parts:
            self.add(part, f"{path}[{_key(key)}]", depth - 1)
        if isinstance(x, tuple) and type(x) is not tuple:
            self.add(type(x), f"{path}.", depth - 1)

    def _thing(self, x, path, depth):
        """A function, a class, an object."""
        if isinstance(x, functools.partial):
            self.say("partial")
            self.add((x.func, x.args, x.keywords), path, depth - 1)
        elif isinstance(x, types.MethodType):
            self.say("method", x.__func__.__name__)
            self.add(x.__self__, f"{path}self", depth - 1)
            self.add(x.__func__, path, depth - 1)
        elif isinstance(x, types.FunctionType):
            self._function(x, path, depth)
        elif isinstance(x, type):
            self._class(x, path, depth)
        elif isinstance(x, (property, staticmethod, classmethod, functools.cached_property)):
            held = [getattr(x, name, None) for name in ("fget", "fset", "__func__", "func")]
            self.say(type(x).__name__)
            self.add([part for part in held if part is not None], path, depth - 1)
        else:
            self._object(x, path, depth)

    def _function(self, x, path, depth):
        if is_library(x.__module__ or "") and "<locals>" not in x.__qualname__:
            self.say("library", x.__module__, x.__qualname__)
            return
        home = x.__globals__.get("__name__", "")
        cells = {name: cell for name, cell in zip(x.__code__.co_freevars, x.__closure__ or ())}
        if is_library(home):
            # what a library has wrapped, as jax.grad does, has all that is the user's in its closure
            self.say("library", home, x.__code__.co_qualname)
            for name in sorted(cells):
                part = _held(cells[name])
                if isinstance(part, PLAIN + (tuple, list)) or callable(part):
                    self.add(part, f"{path}{name}", depth - 1)
        else:
            for part in _code(x.__code__):
                self.say(part)
            for name, part in sorted(reads_of(x), key=lambda pair: pair[0]):
                named = isinstance(part, (types.FunctionType, type, types.MethodType))
                self.add(part, f"{path}{name}: " if named else f"{path}{name}", depth - 1)
            for name in _imported(x.__code__, x.__globals__.get("__package__") or ""):
                self._import(name, path)
        defaults = {f"defaults of {x.__name__}": x.__defaults__ or (), f"words of {x.__name__}": x.__kwdefaults__ or {}}
        for name, part in defaults.items():
            self.add(part, f"{path}{name}", depth - 1)
        if getattr(x, "__wrapped__", None) is not None:
            self.add(x.__wrapped__, path, depth - 1)

    def _import(self, name, path):
        """A module that is imported within a function: all that is in it, if it is the user's."""
        if is_library(name):
            return
        try:
            place = importlib.util.find_spec(name).origin
            held = Path(place).read_bytes()
            parts = "".join(map(repr, _code(compile(held, "", "exec")))) if place.endswith(".py") else held.hex()
        except (ImportError, AttributeError, TypeError, ValueError, OSError, SyntaxError):
            return
        self.reads[f"{path}module {name}"] = _digest(parts.encode())

    def _class(self, x, path, depth):
        if is_library(x.__module__):
            self.say("class", x.__module__, x.__qualname__)
            return
        self.say("class", x.__name__)
        self.add(list(x.__bases__), f"{path}bases", depth - 1)
        for name, part in sorted(vars(x).items()):
            library = isinstance(part, types.FunctionType) and is_library(part.__globals__.get("__name__", ""))
            wrapped = getattr(part, "__wrapped__", None) is not None
            described = type(part).__name__ in ("member_descriptor", "getset_descriptor")
            if name not in ASIDE and not described and (not library or wrapped):
                self.say("of the class", name)
                self.add(part, f"{path}{x.__name__}.{name}: " if callable(part) else f"{path}{x.__name__}.{name}",
                         depth - 1)

    def _object(self, x, path, depth):
        kind = type(x)
        if is_library(kind.__module__):
            self._of_library(x, path, depth)
            return
        self.say("object", kind.__name__)
        own = dict(vars(x)) if hasattr(x, "__dict__") else {}
        for slots in (klass.__dict__.get("__slots__", ()) for klass in kind.__mro__):
            for name in (slots,) if isinstance(slots, str) else slots:
                if hasattr(x, name):
                    own[name] = getattr(x, name)
        for name in sorted(own.keys() - ASIDE):
            self.add(own[name], f"{path}.{name}" if path else name, depth - 1)
        self.add(kind, f"{path}: " if path else "", depth - 1)

    def _of_library(self, x, path, depth):
        """What a library has made: a wrapper of the user's functions, or what holds data, such as a spline."""
        kind = type(x)
        named = getattr(x, "__qualname__", None) or getattr(x, "__name__", "")
        self.say("made by", kind.__module__, kind.__qualname__, str(named).rpartition(".")[2])
        inner = [part for name in HELD if (part := getattr(x, name, None)) is not None and callable(x)]
        if isinstance(getattr(x, "reads", None), dict):
            # the function of a file
            for name, part in x.reads.items():
                self.add(part, f"{path}{name}", depth - 1)
        elif inner:
            self.add(inner, path, depth - 1)
        elif isinstance(x, (types.BuiltinFunctionType, np.ufunc)):
            own = getattr(x, "__self__", None)
            if own is not None and not isinstance(own, (types.ModuleType, type)):
                self.add(own, path, depth - 1)
        elif hasattr(x, "__dict__") and kind.__module__.partition(".")[0] in ("granjax", "equinox"):
            for name in sorted(vars(x).keys() - ASIDE):
                self.add(vars(x)[name], f"{path}.{name}", depth - 1)
        elif kind.__module__.partition(".")[0] not in OF_PROCESS:
            try:
                made = x.__reduce_ex__(4)
            except (TypeError, ValueError, AttributeError, RuntimeError, NotImplementedError, LookupError, OSError):
                # locks, files, what belongs to a process
                return
            if isinstance(made, tuple):
                made = [list(part) if isinstance(part, Iterator) else part for part in made]
            # kept, so that no other takes its number
            self.seen[id(made)] = len(self.seen), made
            self.add(made, path, depth - 1)


def _held(cell):
    try:
        return cell.cell_contents
    except ValueError:
        return None


def _key(x):
    """A name for a key of a dict, or a part of a set, that is the same in every process."""
    if isinstance(x, (tuple, frozenset)):
        inner = map(_key, x)
        return f"({', '.join(sorted(inner) if isinstance(x, frozenset) else inner)})"
    return repr(x) if isinstance(x, PLAIN + (np.generic,)) else getattr(x, "__name__", type(x).__name__)


def array_digest(x: Any) -> str:
    """Type, shape and a digest of an array or a number, JAX's keys among them."""
    if isinstance(x, jax.Array) and jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key):
        return f"{x.dtype} of shape {x.shape}, {_digest(np.asarray(jax.random.key_data(x)).tobytes())}"
    array = np.asarray(x)
    held = array.tobytes() if not array.dtype.hasobject else repr(list(map(_key, array.reshape(-1).tolist()))).encode()
    return f"{array.dtype} of shape {array.shape}, {_digest(held)}"


def _code(code) -> Iterator[tuple]:
    """What a code does, without where it stands."""
    counts = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
    yield code.co_code, getattr(code, "co_exceptiontable", b""), counts
    yield code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
    for x in code.co_consts:
        if isinstance(x, types.CodeType):
            yield ("code", x.co_name)
            yield from _code(x)
        else:
            yield "constant", _constant(x)


def _constant(x):
    if isinstance(x, (tuple, frozenset)):
        inner = list(map(_constant, x))
        return f"{type(x).__name__} {sorted(inner) if isinstance(x, frozenset) else inner}"
    return repr(x)


def _imported(code, package) -> Iterator[str]:
    """Names of the modules that a code, and what is defined in it, imports."""
    before = []
    for step in dis.get_instructions(code):
        if step.opname == "IMPORT_NAME":
            levels = [x for x in before[-2:] if type(x) is int]
            base = package.rsplit(".", levels[0] - 1)[0] if levels and levels[0] else ""
            yield f"{base}.{step.argval}".strip(".") if base else step.argval
        before.append(step.argval)
    for inner in code.co_consts:
        if isinstance(inner, types.CodeType):
            yield from _imported(inner, package)


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
        if old["values"] != new["values"] and repr(old["values"]) != repr(new["values"]):
            yield f"{name}: {_row(new['values'])}, the store has {_row(old['values'])}{_first(old, new)}"
        elif old["dtype"] != new["dtype"]:
            yield f"{name}: of {new['dtype']}, in the store of {old['dtype']}"
        elif repr(old["values"]) != repr(new["values"]):
            yield f"{name}: {_row(new['values'])}, the store has {_row(old['values'])}{_first(old, new)}"
        elif old["units"] != new["units"]:
            yield f"{name}: in {new['units'] or 'no unit'}, in the store {old['units'] or 'none'}"


def _first(old, new):
    """Where two rows that look alike differ first."""
    old, new = old["values"], new["values"]
    if _row(old) != _row(new):
        return ""
    at = next(k for k, (one, other) in enumerate(zip(old, new)) if repr(one) != repr(other))
    return f"; number {at} is {new[at]!r}, there {old[at]!r}"


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
