"""The entry of public functions: what is given for an argument is of the kind that its annotation says.

`checked` reads the annotations of a function once and makes a test of each; the words are those of `granjax.types`. A
wrong kind meets a sentence before anything is computed, traced or converted. A number that is not known yet (traced)
passes where an array is meant. What a number must be beyond its kind (positive, within) is the function's own check.
"""

import functools
import inspect
import os
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NoReturn, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from . import types as words
from .checks import BITS, LEAST, MOST, described, letter, refuse, unmasked

T = TypeVar("T", bound=Callable)

UNKNOWN = (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError)
KNOWN = "It must be known before tracing: keep it out of the transformation."
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
    "Material": ("a Material", "Names: granjax.materials.NAMES."),
    "Axes": ("matplotlib's Axes", "Such as matplotlib.pyplot.subplots makes."),
}


class Kind:
    """What an argument may be: its words, a test, and (name, kind, value) of the parts of a container."""

    __slots__ = ("expected", "fits", "known", "parts", "remedy")

    def __init__(
        self, expected: str, fits: Callable, remedy: str = "", parts: Callable | None = None, known: bool = False
    ):
        self.expected, self.fits, self.remedy, self.parts, self.known = expected, fits, remedy, parts, known

    def refuse(self, argument: str, x: Any) -> NoReturn:
        """Say what is wrong: of a container, the first part that does not fit."""
        for name, kind, part in self.parts(argument, x) if self.parts else ():
            if not kind.fits(part):
                kind.refuse(name, part)
        unmasked(argument, x)
        remedy = self.remedy
        if isinstance(x, jax.core.Tracer) and self.known:
            remedy = KNOWN
        elif ONE.expected in self.expected and shape_of(x):
            remedy = "For many at once: jax.vmap."
        elif letter(x) == "c" or isinstance(x, complex):
            remedy = "Take .real or abs() of it, whichever is meant."
        elif isinstance(x, int) and not LEAST <= x <= MOST:
            remedy = BITS
        refuse(argument, self.expected, described(x), remedy)


def shape_of(x: Any, kinds: str = "fiu") -> tuple[int, ...] | None:
    """Shape of real numbers (or of those of NumPy's `kinds`), an array or nested sequences; `None` where it is none."""
    kind = type(x)
    if kind is float:
        return () if "f" in kinds else None
    if isinstance(x, (np.ndarray, np.generic)):
        hidden = isinstance(x, np.ma.MaskedArray) and np.ma.is_masked(x)
        return x.shape if x.dtype.kind in kinds and not hidden else None
    if isinstance(x, jax.Array):
        real = letter(x) in kinds or "f" in kinds and jnp.issubdtype(x.dtype, jnp.floating)
        return x.shape if real else None
    if isinstance(x, str):
        return () if "U" in kinds else None
    if isinstance(x, (int, float, complex)):
        if kind is bool and "b" not in kinds or isinstance(x, complex) and "c" not in kinds:
            return None
        return None if isinstance(x, int) and not LEAST <= x <= MOST else ()
    if _is_sequence(x):
        try:
            plain = x and set(map(type, x)) == {float}
            shapes = {shape_of(part, kinds) for part in (x[:1] if plain else x)}
        except RecursionError:  # a list that holds itself
            return None
        return None if len(shapes) > 1 or None in shapes else (len(x), *(shapes.pop() if shapes else ()))
    if hasattr(x, "__array__") and not isinstance(x, type):
        try:
            return shape_of(np.asarray(x), kinds)
        except (TypeError, ValueError, RuntimeError):
            return None
    return None


def _is_sequence(x):
    return isinstance(x, Sequence) and not isinstance(x, (str, bytes, bytearray, memoryview))


def _scalar(x):
    return type(x) is float or shape_of(x) == ()


def _number(x):
    return type(x) is float or not isinstance(x, Sequence) and shape_of(x) is not None


def _count(x):
    return isinstance(x, (int, np.integer)) and type(x) is not bool and LEAST <= x <= MOST


def _flag(x):
    return isinstance(x, (bool, np.bool_))


def _array(x, kinds):
    return isinstance(x, (np.ndarray, jax.Array)) and shape_of(x, kinds) is not None


def _seed(x):
    return _count(x) or isinstance(x, jax.Array) and letter(x) in "iuK"


def _over_sites(x, kinds="fiu"):
    if isinstance(x, dict):
        return bool(x) and all(isinstance(name, str) and bool(shape_of(part, kinds)) for name, part in x.items())
    return bool(shape_of(x, kinds))


def _moves(x):
    parts = x.values() if isinstance(x, dict) else (x,)
    return bool(parts) and all(_array(part, "fiuc") and part.ndim for part in parts) and _over_sites(x, "fiuc")


def _sites_of(argument, x):
    return [(f"{argument}[{name!r}]", SITES, part) for name, part in x.items()] if isinstance(x, dict) else []


def _pair(x):
    return isinstance(x, (tuple, list)) and len(x) == 2 and _over_sites(x[0]) and _over_sites(x[1])


def _pair_parts(argument, x):
    whole = isinstance(x, (tuple, list)) and len(x) == 2
    return [(f"{argument}.{name}", SITES, part) for name, part in zip("uv", x)] if whole else []


def _tree(x):
    try:
        leaves = jax.tree.leaves(x)
    except (RecursionError, SystemError):  # a list that holds itself
        return False
    return bool(leaves) and all(not _is_sequence(leaf) and shape_of(leaf, "fiuc") is not None for leaf in leaves)


SITES = Kind("an array of real numbers over the sites, or a dict of such", _over_sites, parts=_sites_of)
MOVES = Kind("an array of numbers over the sites, or a dict of such", _moves, parts=_sites_of)
COUNT = Kind("a whole number", _count, known=True)
FLAG = Kind("True or False", _flag, known=True)
ONE = Kind("one number", _scalar)
GIVE = "Give a number or an array of numbers."

TREE = Kind("a tree of arrays of numbers", _tree)

# the words of granjax.types; a word that holds another comes before it
WORDS = (
    (words.Parameter, Kind("real numbers", lambda x: shape_of(x) is not None, GIVE)),
    (words.Scalar, ONE),
    (words.Number, Kind("real numbers", _number, GIVE)),
    (words.Site, Kind("a whole number, or one per axis", lambda x: _count(x) or type(x) in (tuple, list)
                      and all(map(_count, x)), "Sites are counted from 0, negative ones from the end.")),
    (words.Flags, Kind("True or False, or an array of them", lambda x: _flag(x) or _array(x, "b"))),
    (words.Displacements, MOVES),
    (words.Seed, Kind("a whole number or a JAX key", _seed, "Equal seeds give equal draws.")),
    (words.StateLike, Kind("State(u, v) or a pair (u, v)", _pair, "See gx.states.", _pair_parts)),
    (words.Numbers, Kind("an array of real numbers", lambda x: _array(x, "fiu"))),
    (words.Counts, Kind("an array of whole numbers", lambda x: _array(x, "iu"))),
    (words.ComplexNumbers, Kind("an array of numbers", lambda x: _array(x, "fiuc"))),
    (words.Times, Kind("an array of times, shape (T,)", lambda x: _array(x, "fiu") and x.ndim == 1)),
    (words.Count, COUNT),
    (words.AnyArray, Kind("an array", lambda x: isinstance(x, jax.Array) or _array(x, "fiucb"))),
)
PLAIN_KINDS = {
    str: Kind("a string", lambda x: isinstance(x, str)),
    bool: FLAG,
    int: COUNT,
    float: Kind("one number", lambda x: not isinstance(x, jax.core.Tracer) and _scalar(x), known=True),
    complex: Kind("one number, real or complex", lambda x: shape_of(x, "fiuc") == ()),
    types.NoneType: Kind("None", lambda x: x is None),
    Path: Kind("a path", lambda x: isinstance(x, os.PathLike)),
    jax.Array: Kind("an array", lambda x: isinstance(x, jax.Array) or _array(x, "fiucb")),
    np.ndarray: Kind("an array", lambda x: isinstance(x, np.ndarray)),
    tuple: Kind("a tuple", lambda x: isinstance(x, tuple)),
    list: Kind("a list", lambda x: isinstance(x, list)),
    dict: Kind("a dict", lambda x: isinstance(x, dict)),
    Sequence: Kind("a sequence", lambda x: _is_sequence(x) or _array(x, "fiucbUS") and x.ndim > 0),
    Iterable: Kind("several values", lambda x: hasattr(x, "__iter__")),
    Callable: Kind("a function", callable),
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
        array = _array(x, kinds) if kinds else isinstance(x, (np.ndarray, jax.Array)) and not np.ma.is_masked(x)
        return array and not (known and isinstance(x, jax.core.Tracer)) and (any_number or x.ndim == len(axes))

    return Kind(said, fits, known=known)


def _of_arity(args):
    """A function of as many arguments, by position, as the annotation lists; of any where it lists none."""
    if args is Ellipsis:
        return PLAIN_KINDS[Callable]
    count = len(args)
    said = f"a function of {count} argument{'s' * (count != 1)}"
    return Kind(said, lambda x: takes(x, count))


def takes(function: Any, count: int) -> bool:
    """Whether it is a function that can be called with so many arguments."""
    if not callable(function):
        return False
    try:
        inspect.signature(function).bind(*range(count))
    except TypeError:
        return False
    except ValueError:  # some of C's say nothing of their arguments
        return True
    return True


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


def _instance(kind):
    name = kind.__name__
    said, remedy = CLASSES.get(name, (f"a{'n' * (name[0] in 'AEIOU')} {name}", ""))
    return Kind(said, lambda x: type(x) is kind or isinstance(x, kind), remedy)


def checked(target: T) -> T:
    """A public function, or a class as it is made, whose arguments are looked at before anything else happens.

    **Raises** ValueError for an argument of another kind than its annotation, naming argument, expected, got, remedy;
    a wrong number or name of arguments stays Python's TypeError. What is the default is not looked at. JAX rebuilds a
    class's instances without `__init__`, and a subclass with an `__init__` of its own has its own arguments.
    """
    if isinstance(target, type):
        target.__init__ = checked(target.__init__)
        return target
    ordered, named = [], {}

    def prepare():
        signature = inspect.signature(target).parameters.values()
        hints = {p.name: p.annotation for p in signature}
        if any(isinstance(hint, str) for hint in hints.values()):
            hints |= typing.get_type_hints(inspect.unwrap(target))
        found = {}
        for p in signature:
            plain = p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD) and p.annotation is not p.empty
            kind = kind_of(hints[p.name]) if plain else None
            found[p.name] = (p.name, kind.fits if kind else None, p.default, kind)
        ordered.extend(found[p.name] for p in signature if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD))
        named.update(found)

    @functools.wraps(target)
    def call(*args, **kwargs):
        if not named:
            prepare()
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
            _refuse_traced(zip([*(name for name, *_ in ordered), *kwargs], (*args, *kwargs.values())), error)
            raise

    call.is_checked = True
    return call


def _refuse_traced(given, error):
    """Say of a value that had to be known which arguments are not, if any."""
    traced = {name: leaf for name, x in given for leaf in jax.tree.leaves(x) if isinstance(leaf, jax.core.Tracer)}
    if traced:
        got = " and ".join(map(described, traced.values()))
        raise ValueError(f"{', '.join(traced)}: expected what is known before tracing, got {got}. {KNOWN}") from error


UNNAMED = ("", None, None, None)
