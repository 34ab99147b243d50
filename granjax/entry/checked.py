"""`checked`: the annotations of a function, read once, as tests of what it is given."""

import functools
import inspect
import os
import sys
import traceback
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, TypeVar

import jax
import numpy as np

from .. import types as words
from ..checks import described, unexpected
from .kinds import KNOWN, PLAIN_KINDS, TREE, WORDS, Kind, array_of

T = TypeVar("T", bound=Callable)

UNKNOWN = (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError,
           jax.errors.TracerIntegerConversionError)
# whose frames say nothing of who asked for a value
LIBRARIES = sys.stdlib_module_names | {
    "jax", "jaxlib", "numpy", "equinox", "diffrax", "lineax", "optimistix", "optax", "scipy", "matplotlib", "xarray",
    "jaxtyping", "beartype", "tqdm", "threadpoolctl", "h5py", "h5netcdf",
}
# for classes whose name says too little: what is expected, and what helps
CLASSES = {
    "Lattice": ("a Lattice, such as gx.scenes.monomer(100)", ""),
    "State": ("a State(u, v)", "See gx.states."),
    "Law": ("a law, such as Hertz()", "See gx.laws."),
    "Term": ("a term, such as Bond(Shift(1), Hertz())", "See gx.terms."),
    "StrainMap": ("a strain map, such as Shift(1)", "See gx.strains."),
    "Record": ("a record, such as gx.Peak(quantity)", ""),
    "AbstractSolver": ("a solver, such as gx.SRKN11b()", "Any of granjax's or diffrax's will do."),
    "AbstractAdjoint": ("an adjoint, such as diffrax.ForwardMode()", "None serves both derivative modes."),
    "Ladder": ("a Ladder(name, parameter, values, call)", ""),
    "Material": ("a Material", "Names: granjax.materials.NAMES."),
    "Axes": ("matplotlib's Axes", "Such as matplotlib.pyplot.subplots makes."),
}


def kind_of(annotation: Any) -> Kind | None:
    """What an annotation lets through, or `None` where that is anything."""
    origin, args = typing.get_origin(annotation), typing.get_args(annotation)
    if annotation in (Any, object) or isinstance(annotation, (TypeVar, str)):
        return None
    if annotation is words.Pytree:
        return TREE
    if annotation is None:
        return PLAIN_KINDS[types.NoneType]
    if origin in (typing.Union, types.UnionType):
        return _either(_members(args))
    if origin is Literal:
        return Kind(" or ".join(map(repr, args)), lambda x: isinstance(x, tuple(map(type, args))) and x in args)
    if hasattr(annotation, "dim_str"):
        return _of_shape(annotation)
    if annotation in PLAIN_KINDS:
        return PLAIN_KINDS[annotation]
    if origin is Callable:
        return _of_arity(args[0])
    if origin in (dict, Mapping):
        return _mapping(*map(kind_of, args), dict if origin is dict else Mapping)
    if origin is tuple and (len(args) != 2 or args[1] is not Ellipsis):
        return _fixed(tuple(map(kind_of, args)))
    if origin in (tuple, list, Sequence, Iterable):
        return _each(PLAIN_KINDS[origin], kind_of(args[0]))
    return _instance(annotation) if isinstance(annotation, type) else None


def _members(args):
    """Kinds of the members of a union, the words of granjax.types taken together."""
    left, found = list(args), []
    for word, kind in WORDS:
        own = typing.get_args(word)
        if all(one in left for one in own):
            left = [one for one in left if one not in own]
            found.append(kind)
    return found + [kind_of(one) for one in left]


def _either(kinds):
    if None in kinds or len(kinds) == 1:
        return kinds[0] if len(kinds) == 1 else None
    tests = tuple(kind.fits for kind in kinds)
    said = list(dict.fromkeys(kind.expected for kind in kinds))
    said = ", ".join(said[:-1]) + f" or {said[-1]}" if len(said) > 1 else said[0]
    remedy = next((kind.remedy for kind in kinds if kind.remedy), "")
    known = any(kind.known for kind in kinds)

    def parts(argument, x):
        return [part for kind in kinds if kind.parts for part in kind.parts(argument, x)]

    if len(tests) == 2:
        first, second = tests
        return Kind(said, lambda x: first(x) or second(x), remedy, parts, known)
    return Kind(said, lambda x: any(fits(x) for fits in tests), remedy, parts, known)


def _of_shape(annotation):
    """An array with jaxtyping's names of its axes."""
    dtypes = annotation.dtypes if isinstance(annotation.dtypes, (tuple, list)) else ()
    axes, kinds = annotation.dim_str.split(), {str(dtype)[:1] for dtype in dtypes}
    any_number = any("..." in name or "*" in name for name in axes)
    kinds = "fiuc" if "c" in kinds else "fiu" if "f" in kinds else "iu" if "i" in kinds else "b" if "b" in kinds else ""
    said = {"fiuc": "an array of numbers", "iu": "an array of whole numbers", "b": "an array of True and False"}
    said = said.get(kinds, "an array of real numbers" if kinds else "an array")
    said += "" if any_number or not axes else f", shape ({', '.join(axes)}{',' * (len(axes) == 1)})"

    known = annotation.array_type is np.ndarray

    def fits(x):
        array = array_of(x, kinds) if kinds else isinstance(x, (np.ndarray, jax.Array)) and not np.ma.is_masked(x)
        return array and not (known and isinstance(x, jax.core.Tracer)) and (any_number or x.ndim == len(axes))

    return Kind(said, fits, known=known)


def _of_arity(args):
    """A function of as many arguments, by position, as the annotation lists; of any where it lists none."""
    if args is Ellipsis:
        return PLAIN_KINDS[Callable]
    count = len(args)
    said = f"a function of {count} argument{'s' * (count != 1)}"
    return Kind(said, lambda x: takes(x, count))


def takes(function: Any, count: int, options: Iterable[str] = ()) -> bool:
    """Whether it is a function that can be called with so many arguments, and with options by their names."""
    if not callable(function):
        return False
    # some twenty times faster than a signature
    plain = inspect.unwrap(function, stop=_says)
    if type(plain) is types.FunctionType and not _says(plain) and not options:
        code, named = plain.__code__, plain.__kwdefaults__ or ()
        least = code.co_argcount - len(plain.__defaults__ or ())
        most = np.inf if code.co_flags & inspect.CO_VARARGS else code.co_argcount
        return least <= count <= most and len(named) == code.co_kwonlyargcount
    try:
        inspect.signature(function).bind(*range(count), **dict.fromkeys(options))
    except TypeError:
        return False
    except ValueError:  # some of C's say nothing of their arguments
        return True
    return True


def _says(function):
    """Whether it has a signature of its own, or is a method, whose function has one argument more."""
    return isinstance(function, types.MethodType) or hasattr(function, "__signature__")


def _mapping(key, value, container):
    def parts(argument, x):
        named = [(f"a name in {argument}", key, name) for name in x] if key else []
        return named + ([(f"{argument}[{name!r}]", value, part) for name, part in x.items()] if value else [])

    def fits(x):
        return isinstance(x, container) and all(kind.fits(part) for _, kind, part in parts("", x))

    said = f"a dict from {'names' if key is PLAIN_KINDS[str] else 'keys'}"
    said += f" to values (each: {value.expected})" if value else ""
    return Kind(said, fits, parts=lambda argument, x: parts(argument, x) if isinstance(x, container) else [])


def _fixed(kinds):
    def parts(argument, x):
        same = isinstance(x, tuple) and len(x) == len(kinds)
        return [(f"{argument}[{i}]", k, part) for i, (k, part) in enumerate(zip(kinds, x)) if k] if same else []

    def fits(x):
        return isinstance(x, tuple) and len(x) == len(kinds) and all(k is None or k.fits(p) for k, p in zip(kinds, x))

    said = ", ".join(kind.expected if kind else "anything" for kind in kinds)
    return Kind(f"a tuple of {len(kinds)} ({said})", fits, parts=parts)


def _each(container, kind):
    if kind is None:
        return container

    def inside(x):
        return np.asarray(x) if isinstance(x, jax.Array) else x

    def known(x):
        return container.fits(x) and not isinstance(x, jax.core.Tracer)

    def parts(argument, x):
        return [(f"{argument}[{i}]", kind, part) for i, part in enumerate(inside(x))] if known(x) else []

    def fits(x):
        return known(x) and all(map(kind.fits, inside(x)))

    return Kind(f"{container.expected} (each: {kind.expected})", fits, parts=parts)


def _instance(cls):
    name = cls.__name__
    said, remedy = CLASSES.get(name, (f"a{'n' * (name[0] in 'AEIOU')} {name}", ""))
    # a named tuple, which JAX makes anew of whatever its leaves become, is looked at where it is taken
    fields = typing.get_type_hints(cls) if issubclass(cls, tuple) else {}
    kinds = {field: kind for field, kind in zip(fields, map(kind_of, fields.values())) if kind}
    if not kinds:
        return Kind(said, lambda x: type(x) is cls or isinstance(x, cls), remedy)

    def parts(argument, x):
        return [(f"{argument}.{field}", kind, getattr(x, field)) for field, kind in kinds.items()
                if isinstance(x, cls)]

    def fits(x):
        return isinstance(x, cls) and all(kind.fits(getattr(x, field)) for field, kind in kinds.items())

    return Kind(said, fits, remedy, parts)


def checked(target: T) -> T:
    """A public function, or a class as it is made, whose arguments are looked at before anything else happens.

    **Raises** ValueError for an argument of another kind than its annotation, naming argument, expected, got, remedy;
    a wrong number or name of arguments stays Python's TypeError. What is the default is not looked at. JAX rebuilds a
    class's instances without `__init__`, and a subclass with an `__init__` of its own has its own arguments.
    """
    if isinstance(target, type):
        target.__init__ = checked(target.__init__)
        return target

    def prepared():
        signature = inspect.signature(target).parameters.values()
        hints = {p.name: p.annotation for p in signature}
        if any(isinstance(hint, str) for hint in hints.values()):
            hints |= typing.get_type_hints(inspect.unwrap(target))
        named = {}
        for p in signature:
            plain = p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD) and p.annotation is not p.empty
            kind = kind_of(hints[p.name]) if plain else None
            named[p.name] = (p.name, kind.fits if kind else None, p.default, kind)
        ordered = [named[p.name] for p in signature if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
        return ordered, named, any(p.kind is p.VAR_KEYWORD for p in signature)

    tests = None

    @functools.wraps(target)
    def call(*args, **kwargs):
        nonlocal tests
        if tests is None:
            tests = prepared()  # at once, whichever thread is first
        ordered, named, others = tests
        if not others and not kwargs.keys() <= named.keys():
            unexpected(target, next(key for key in kwargs if key not in named), named)
        for (name, fits, default, kind), x in zip(ordered, args):
            if fits is not None and x is not default and not fits(x):
                kind.refuse(name, x)
        for key, x in kwargs.items():
            name, fits, default, kind = named.get(key, UNNAMED)
            if fits is not None and x is not default and not fits(x):
                kind.refuse(name, x)
        try:
            return target(*args, **kwargs)
        except UNKNOWN as error:
            given = [*zip([name for name, *_ in ordered], args), *kwargs.items()]
            _refuse_unknown(given, error, target.__module__.split(".")[0])
            raise

    call.is_checked = True
    return call


def _refuse_unknown(given, error, package):
    """Say of a value that had to be known which argument is traced, or which function of the user's asks for it."""
    frames = [(frame, line, frame.f_globals.get("__name__", "").split(".")[0])
              for frame, line in traceback.walk_tb(error.__traceback__)]
    frames = [own for own in frames if own[2] not in LIBRARIES]
    frame, line, last = frames[-1]
    if last == package:
        traced = {name: leaf for name, x in given for leaf in jax.tree.leaves(x) if isinstance(leaf, jax.core.Tracer)}
        if traced:
            got = " and ".join(map(described, traced.values()))
            raise ValueError(
                f"{', '.join(traced)}: expected what is known before tracing, got {got}. {KNOWN}") from error
        return
    asking = {frame.f_code for frame, _, root in frames if root != package}
    for name, x in _functions(given):
        if callable(x) and _code(x) in asking:
            place = f"line {line} of {os.path.basename(frame.f_code.co_filename)}"
            raise ValueError(
                f"{name}: expected a function that JAX can trace, got one that asks for a known value in {place}. "
                "Take jax.numpy for numpy, jnp.where for if, and no float() of what it is given.") from error


def _functions(given):
    """What is given, or is a part of the object whose method this is."""
    for name, x in given:
        yield from getattr(x, "__dict__", {}).items() if name == "self" else [(name, x)]


def _code(function):
    """What Python runs where a function, or an object that can be called, is called."""
    function = inspect.unwrap(function)
    function = getattr(function, "func", function)  # functools.partial
    return getattr(function, "__code__", None) or getattr(type(function).__call__, "__code__", None)


UNNAMED = ("", None, None, None)
