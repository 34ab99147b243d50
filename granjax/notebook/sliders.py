"""What of a scene sliders can move, and from where to where."""

import inspect
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import described, is_whole, non_negative, one_of, real, refuse, within
from ..lattice import Lattice
from ..types import Count

AMPLITUDE, RATIO, PRECOMPRESSION = "amplitude", "ratio", "precompression"
LEAST_RATIO = 0.05
# a logarithmic slider spans so much about its value, and one whose ends are given is one from this share of them on
DECADE, WIDE = 10.0, 100.0


class Slider(NamedTuple):
    """From `low` to `high`, beginning at `value`; by the logarithm, or by whole numbers.

    `high` is NaN where only a run can say what is much.
    """

    low: float
    high: float
    value: float
    log: bool = False
    whole: bool = False


class Movable(NamedTuple):
    """A function of named numbers that makes a scene, the names that it says it takes; sliders, and what is fixed."""

    make: Callable
    names: frozenset[str]
    sliders: dict[str, Slider]
    fixed: dict[str, Any]


def movable(scene: Lattice | Callable, given: Mapping[str, Any]) -> Movable:
    """What of a scene can be moved, with the ranges and values that are given.

    **Raises** ValueError for names that the scene does not have, and for what has no range.
    """
    if isinstance(scene, Lattice):
        (make, known), own = _of_lattice(scene), False
        for name in given:
            one_of("parameter", name, [*known, AMPLITUDE])
    else:
        make, known, own = _of_function(scene, given)
    sliders, fixed = {}, {}
    for name in dict.fromkeys([*known, *given]):
        p = known.get(name)
        default, x = None if p is None else p.default, given.get(name)
        if name not in given:
            found = _unasked(name, p, own)
            sliders |= {name: found} if found else {}
        elif isinstance(x, (tuple, list)):
            sliders[name] = _ranged(name, x, default, p is not None and p.annotation is Count)
        else:
            fixed[name] = x
    return Movable(make, frozenset(known), sliders, fixed)


def _of_function(scene, given):
    """The function, its parameters by name, and whether it is the user's own."""
    found = inspect.signature(scene).parameters.values()
    known = {p.name: p for p in found if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)}
    every = any(p.kind is p.VAR_KEYWORD for p in found)
    alone = [p for p in known.values() if p.default is p.empty]
    if (
        len(known) == len(alone) == 1
        and given
        and alone[0].name not in {*given, RATIO, PRECOMPRESSION}
    ):
        return lambda **values: scene(values), {}, True  # of one dict
    for name in given:
        if not every and name not in known:
            one_of("parameter", name, [*known, AMPLITUDE])
    inner = inspect.unwrap(getattr(scene, "func", scene))
    return scene, known, not str(getattr(inner, "__module__", "")).startswith("granjax.")


def _of_lattice(lattice):
    """A function of a lattice's mass ratio and precompression, and these, with their present values as defaults."""
    present, moves = {}, {}
    masses = np.asarray(lattice.mass) if lattice.fields is None else np.zeros(0)
    kinds = np.unique(masses)
    if len(kinds) == 2:
        light, heavy = masses == kinds[0], kinds[1]
        present[RATIO] = float(kinds[0] / heavy)
        moves[RATIO] = lambda x, ratio: eqx.tree_at(
            lambda c: c.mass,
            x,
            jnp.where(light, within(RATIO, ratio, 0, 1, open_low=True) * heavy, masses),
        )
    loads = [law.precompression for law in _loaded(lattice.terms)]
    if loads:
        mean = float(np.mean([np.mean(F0) for F0 in loads if F0 is not None] or [0.0]))
        present[PRECOMPRESSION] = mean
        moves[PRECOMPRESSION] = lambda x, F0: eqx.tree_at(
            lambda c: c.terms, x, _pressed(x.terms, non_negative(PRECOMPRESSION, F0), mean)
        )

    def make(**values):
        moved = lattice
        for name, x in values.items():
            moved = moves[name](moved, x)
        return moved

    keyword = inspect.Parameter.KEYWORD_ONLY
    return make, {name: inspect.Parameter(name, keyword, default=x) for name, x in present.items()}


def _is_loaded(x):
    return hasattr(x, "precompression")


def _loaded(terms):
    return [x for x in jax.tree.leaves(terms, is_leaf=_is_loaded) if _is_loaded(x)]


def _pressed(terms, F0, mean):
    """The terms with a mean precompression of F0."""

    def pressed(law):
        if not _is_loaded(law):
            return law
        own = law.precompression
        share = F0 if own is None or mean == 0 else F0 * (own / mean)
        return eqx.tree_at(lambda x: x.precompression, law, share, is_leaf=lambda x: x is None)

    return jax.tree.map(pressed, terms, is_leaf=_is_loaded)


def _unasked(name, p, own):
    """The slider of a parameter of which nothing was said; `None` for one that keeps its default."""
    missing = p.default is p.empty
    number = isinstance(p.default, (float, np.floating)) and math.isfinite(p.default)
    if name == RATIO and (missing or number):
        return Slider(LEAST_RATIO, 1.0, 0.5 if missing else float(p.default))
    if name == PRECOMPRESSION and (missing or number):
        value = 0.0 if missing else float(p.default)
        return Slider(0.0, 4 * value if value > 0 else math.nan, value)
    if missing and name == AMPLITUDE:
        return Slider(1 / DECADE**2, DECADE, 1.0, True)
    if missing or own and number and p.default <= 0:
        refuse(
            name,
            "a range or a value, for a slider or for good",
            "none",
            f"Such as {name}=(1.0, 10.0), or {name}=2.0.",
        )
    return about(p.default) if own and number else None


def about(value: float) -> Slider:
    """A logarithmic slider about a number above zero."""
    return Slider(value / DECADE, value * DECADE, float(value), True)


def _ranged(name, x, default, count):
    """The slider of a range that was given."""
    log = len(x) == 3 and x[2] == "log"
    low, high = (float(end) for end in real(name, x[: 2 if log else None]))
    if not (math.isfinite(low) and math.isfinite(high) and low < high) or log and low <= 0:
        refuse(
            name,
            f"two finite numbers, the lower one first{' and above zero' if log else ''}",
            described(x),
        )
    if all(map(is_whole, x[:2])) and (count or is_whole(default)):
        value = int(default) if is_whole(default) and low <= default <= high else int(low)
        return Slider(int(low), int(high), value, False, True)
    log = log or low > 0 and high / low >= WIDE
    middle = math.sqrt(low * high) if log else (low + high) / 2
    known = (
        isinstance(default, (int, float, np.number))
        and not isinstance(default, bool)
        and low <= default <= high
    )
    return Slider(low, high, float(default) if known else middle, log)
