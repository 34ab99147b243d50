"""What an argument may be: a test for each word of `granjax.types` and for plain types, and the words that say it."""

import os
import types
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np

from .. import types as words
from ..checks import BITS, LEAST, MOST, described, is_whole, letter, refuse, unmasked

KNOWN = "It must be known before tracing: keep it out of the transformation."


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
    if is_sequence(x):
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


def is_sequence(x: Any) -> bool:
    """Whether it is a list or the like, and no text."""
    return isinstance(x, Sequence) and not isinstance(x, (str, bytes, bytearray, memoryview))


def _many(x):
    return is_sequence(x) or not isinstance(x, jax.core.Tracer) and array_of(x, "fiucbUS") and x.ndim > 0


def _values(x):
    if is_sequence(x) or isinstance(x, jax.Array):
        return True
    if isinstance(x, type) or not hasattr(x, "__array__") or np.ma.is_masked(x):
        return False
    try:
        array = np.asarray(x)
    except (TypeError, ValueError, RuntimeError):
        return False
    names = array.dtype.kind == "O" and all(isinstance(part, str) for part in array.flat)
    return array.ndim > 0 and (names or array.dtype.kind in "fiucbUS")


def _scalar(x):
    return type(x) is float or shape_of(x) == ()


def _number(x):
    return type(x) is float or not isinstance(x, Sequence) and shape_of(x) is not None


def _count(x):
    return is_whole(x) and LEAST <= x <= MOST


def _flag(x):
    return isinstance(x, (bool, np.bool_))


def array_of(x: Any, kinds: str) -> bool:
    """Whether it is an array of numbers of NumPy's `kinds`, with nothing hidden."""
    return isinstance(x, (np.ndarray, jax.Array)) and shape_of(x, kinds) is not None


def _seed(x):
    return _count(x) or isinstance(x, jax.Array) and letter(x) in "iuK"


def _over_sites(x, kinds="fiu"):
    if isinstance(x, dict):
        return bool(x) and all(isinstance(name, str) and _array_over_sites(part, kinds) for name, part in x.items())
    return _array_over_sites(x, kinds)


def _array_over_sites(x, kinds):
    return array_of(x, kinds) and x.ndim > 0


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
    return bool(leaves) and all(not is_sequence(leaf) and shape_of(leaf, "fiuc") is not None for leaf in leaves)


SITES = Kind("an array of real numbers over the sites, or a dict of such", _over_sites, parts=_sites_of)
MOVES = Kind("an array of numbers over the sites, or a dict of such", lambda x: _over_sites(x, "fiuc"), parts=_sites_of)
COUNT = Kind("a whole number", _count, known=True)
FLAG = Kind("True or False", _flag, known=True)
ONE = Kind("one number", _scalar)
GIVE = "Give a number or an array of numbers."

TREE = Kind("a tree of arrays of numbers", _tree)

# the words of granjax.types; a word that holds another comes before it
WORDS = (
    (words.Parameter, Kind("real numbers", lambda x: shape_of(x) is not None, GIVE)),
    (words.Values, Kind("an array or a sequence", _values)),
    (words.Scalar, ONE),
    (words.Number, Kind("real numbers", _number, GIVE)),
    (words.Site, Kind("a whole number, or one per axis", lambda x: _count(x) or type(x) in (tuple, list)
                      and all(map(_count, x)))),
    (words.Flags, Kind("True or False, or an array of them", lambda x: _flag(x) or array_of(x, "b"))),
    (words.Displacements, MOVES),
    (words.Seed, Kind("a whole number or a JAX key", _seed, "Equal seeds give equal draws.")),
    (words.StateLike, Kind("State(u, v) or a pair (u, v)", _pair, "See gx.states.", _pair_parts)),
    (words.Numbers, Kind("an array of real numbers", lambda x: array_of(x, "fiu"))),
    (words.Counts, Kind("an array of whole numbers", lambda x: array_of(x, "iu"))),
    (words.ComplexNumbers, Kind("an array of numbers", lambda x: array_of(x, "fiuc"))),
    (words.Times, Kind("an array of times, shape (T,)", lambda x: array_of(x, "fiu") and x.ndim == 1)),
    (words.Count, COUNT),
    (words.AnyArray, Kind("an array", lambda x: isinstance(x, jax.Array) or array_of(x, "fiucb"))),
)
PLAIN_KINDS = {
    str: Kind("a string", lambda x: isinstance(x, str)),
    bool: FLAG,
    int: COUNT,
    float: Kind("one number", lambda x: not isinstance(x, jax.core.Tracer) and _scalar(x), known=True),
    complex: Kind("one number, real or complex", lambda x: shape_of(x, "fiuc") == ()),
    types.NoneType: Kind("None", lambda x: x is None),
    Path: Kind("a path", lambda x: isinstance(x, os.PathLike)),
    jax.Array: Kind("an array", lambda x: isinstance(x, jax.Array) or array_of(x, "fiucb")),
    np.ndarray: Kind("an array", lambda x: isinstance(x, np.ndarray)),
    tuple: Kind("a tuple", lambda x: isinstance(x, tuple)),
    list: Kind("a list", lambda x: isinstance(x, list)),
    dict: Kind("a dict", lambda x: isinstance(x, dict)),
    Sequence: Kind("a sequence", _many, known=True),
    Iterable: Kind("several values", lambda x: hasattr(x, "__iter__")),
    Callable: Kind("a function", callable),
}
