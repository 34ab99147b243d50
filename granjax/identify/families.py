"""Families of force laws: where a search begins, which numbers of a law it moves, and within which bounds."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, one_of, parameter, positive, refuse
from ..lattice import Lattice
from ..laws import Law, Network, PowerLaw, Spline
from ..types import AnyArray, Numbers, Parameter, Scalar, Scene

# knots of a spline and units of a network: enough for a contact to 1 % of its largest force, few enough for traces
KNOTS = 7
UNITS = 6
FAMILIES = ("power law", "polynomial", "spline", "network")


class Series(Law):
    r"""A polynomial of any degree through the origin: F(e) = F_s sum_{k=1}^n c_k (e/e_s)^k.

    **Arguments:** `coefficients`: c_1 ... c_n, (n,), or (n, bonds) for one law per bond; `strain`: e_s > 0 [m] and
    `force`: F_s > 0 [N], about the largest that occur, so that the c_k are of order one. The linear stiffness is
    c_1 F_s/e_s. Far beyond the strains that it was fitted to its force may fall, and a run escape.
    **Raises** ValueError for e_s, F_s <= 0 or no coefficient.
    """

    dimensions = {"_coefficients": (0, 0, 0), "strain": (0, 1, 0), "scale": (1, 0, 0)}
    held = ("strain", "scale")
    _shown = {"coefficients": "_coefficients", "strain": "strain", "force": "scale"}
    _coefficients: tuple[Numbers, ...]
    strain: Numbers
    scale: Numbers

    def __init__(self, coefficients: Parameter, strain: Scalar = 1.0, force: Scalar = 1.0):
        coefficients = parameter("coefficients", coefficients)
        # a leaf for each: scalars, or arrays over the bonds, as the parameters of any law
        self._coefficients = tuple(coefficients)
        self.strain, self.scale = positive("strain", strain), positive("force", force)

    @property
    def coefficients(self) -> Numbers:
        """c_1 ... c_n, (n,)."""
        return jnp.stack(self._coefficients)

    def force(self, e):
        return self.scale * self._sum(e / self.strain, [1] * len(self._coefficients))

    def energy(self, e):
        x = e / self.strain
        return self.scale * self.strain * x * self._sum(x, range(2, len(self._coefficients) + 2))

    def _sum(self, x, divisors):
        total = 0.0
        for c, divisor in list(zip(self._coefficients, divisors))[::-1]:
            total = (total + c / divisor) * x
        return total


def starting_law(
    family: str,
    stiffness: Scalar,
    reach: tuple[Scalar, Scalar],
) -> tuple[Law, tuple[str, ...], float | None]:
    """(law, names of its numbers that stay, strain of `LawScene`) of a named family.

    It has that linear stiffness [N/m], for strains low ... high [m].
    """
    one_of("family", family, FAMILIES)
    low, high = reach
    size = max(-low, high)
    if family == "power law":
        # d0 = size
        A = stiffness / (1.5 * size**0.5)
        return PowerLaw(A, jnp.asarray(1.5), A * size**1.5), (), size
    if family == "polynomial":
        return Series([1.0, 0.0, 0.0, 0.0, 0.0], size, stiffness * size), (), None
    if family == "spline":
        return Spline(np.linspace(low, high, KNOTS), np.full(KNOTS + 1, stiffness)), (), None
    # slopes and thresholds p, b stay: what they share with the weights no trace tells apart, and a search never ends.
    # Units over twice the strains are wide enough for a smooth force
    hidden = tuple(f"parameters[{i}]" for i in range(2 * UNITS))
    return Network(UNITS, 2 * size, 2 * stiffness * size, monotone=False), hidden, None


class Leaf(NamedTuple):
    """One floating leaf of a law: its name, its value, whether it is held, and its bounds."""

    name: str
    value: Any
    held: bool
    bounds: tuple | None


def _leaf(law, path, value):
    """A leaf with the name that the law gives it, such as "parts[0].stiffness"."""
    owner, words = law, []
    for key in path:
        if isinstance(owner, Law):
            holder, name = owner, key.name.removeprefix("_").removeprefix("free_")
            words.append(name)
            owner = getattr(owner, key.name)
        else:
            index = getattr(key, "idx", getattr(key, "key", None))
            words[-1] += f"[{index}]"
            owner = owner[index]
    at, bounds = concrete(value), None
    if name in holder.positive and at is not None and at.any():
        bounds = (0.0, None) if (at > 0).all() else (None, 0.0)
    held = not eqx.is_inexact_array(value) or name in holder.held
    return Leaf(".".join(words), value, held, bounds)


class LawScene(eqx.Module):
    """A scene as a function of a dict of parameters, from one that is a function of a law.

    What the law holds are arrays: those of another reach are compiled once with it.

    With a `strain` e_s the law is a power law whose coefficient is counted as the force A e_s^p: the unit of A holds
    the exponent, and a search in both would depend on the units.
    """

    scene: Scene
    structure: Any = eqx.field(static=True)
    # of every leaf its name where it moves, else its value
    names: tuple[str | None, ...] = eqx.field(static=True)
    held: tuple
    others: tuple[str, ...] = eqx.field(static=True)
    strain: AnyArray | None = None

    def law(self, parameters: dict[str, Parameter]) -> Law:
        """The law of some parameters."""
        leaves = [x if name is None else parameters[name] for name, x in zip(self.names, self.held)]
        law = jax.tree.unflatten(self.structure, leaves)
        return law if self.strain is None else _with_coefficient(law, self.strain**-law.exponent)

    def __call__(self, parameters: dict[str, Parameter]) -> Lattice:
        return self.lattice(self.law(parameters), parameters)

    def lattice(self, law: Law, parameters: dict[str, Parameter]) -> Lattice:
        """The lattice of a law and of the other parameters."""
        return (
            self.scene(law, {name: parameters[name] for name in self.others})
            if self.others
            else self.scene(law)
        )


def _with_coefficient(law, factor):
    return eqx.tree_at(lambda law: law.stiffness, law, law.stiffness * factor)


def law_scene(
    scene: Scene,
    law: Law,
    others: dict[str, Parameter],
    hold: Sequence[str],
    strain: float | None = None,
) -> tuple[LawScene, dict[str, Parameter], dict[str, tuple]]:
    """(`LawScene`, start, bounds) of a law and other parameters; with a `strain` "force" stands for "stiffness"."""
    if strain is not None:
        law = _with_coefficient(law, strain**law.exponent)
    leaves = [_leaf(law, *leaf) for leaf in jax.tree_util.tree_flatten_with_path(law)[0]]
    if strain is not None:
        leaves = [
            leaf._replace(name="force") if leaf.name == "stiffness" else leaf for leaf in leaves
        ]
    free = {leaf.name: leaf for leaf in leaves if not leaf.held}
    for name in hold:
        one_of("hold", name, free)
    moving = {name: leaf for name, leaf in free.items() if name not in hold}
    if not moving:
        refuse(
            "family",
            "a law with a number to move",
            f"{type(law).__name__} without one",
            "An exponent moves where it is an array: PowerLaw(1.0, jnp.asarray(1.5), 1.0).",
        )
    both = sorted(moving.keys() & others.keys())
    if both:
        refuse("others", f"names other than the law's {list(free)}", f"{both}")
    places = tuple(leaf.name if leaf.name in moving else None for leaf in leaves)
    held = tuple(None if name else jnp.asarray(leaf.value) for name, leaf in zip(places, leaves))
    start = {name: leaf.value for name, leaf in moving.items()} | others
    bounds = {name: leaf.bounds for name, leaf in moving.items() if leaf.bounds}
    strain = None if strain is None else jnp.asarray(strain, float)
    return (
        LawScene(scene, jax.tree.structure(law), places, held, tuple(sorted(others)), strain),
        start,
        bounds,
    )
