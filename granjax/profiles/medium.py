"""What a wave runs through: a law between neighbours and a mass, given as such or as a uniform chain."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, positive, refuse, traced
from ..lattice import Lattice
from ..laws import Law
from ..printing import told
from ..programs import compiled
from ..terms.chain import next_neighbours, span, walls, without_walls
from ..types import Number, Numbers, Scalar

# arguments that a law is evaluated at in one program
CHUNK = 8192
UNIFORM = 1e-12
# relative difference of a rule and its half at which the stiffness between 0 and e is smooth: the rule itself then
# errs by rounding alone, as its error is the square of the half's
SMOOTH = 1e-12
# units of rounding of the preload, which laws that know theirs have subtracted
UNITS = 16


def _rules():
    """Radau's nine nodes on (0, 1], and the weights of 1 and of 1 - s by all of them and by every second one."""
    legendre = np.polynomial.legendre
    nodes = np.append(np.sort(legendre.legroots(np.eye(10)[8] - np.eye(10)[9]).real)[:-1], 1.0)
    # int P_k/2 and int (1 - s) P_k with s = (1 + x)/2
    moments = np.array([np.eye(9)[0], np.eye(9)[0] / 2 - np.eye(9)[1] / 6])
    rules = []
    for step in (1, 2):
        own = nodes[::step]
        weights = np.zeros((2, 9))
        weights[:, ::step] = np.linalg.solve(
            legendre.legvander(own, len(own) - 1).T, moments[:, : len(own)].T
        ).T
        rules.append(weights)
    return (1 + nodes) / 2, *zip(*rules)


_NODES, _FORCE, _ENERGY = _rules()


class Medium(NamedTuple):
    """A law between neighbours, the mass of every site, and what a result keeps of the lattice that they come from."""

    law: Law
    mass: Any
    origin: dict
    __repr__ = told

    @property
    def known(self) -> "Medium":
        """The same with the numbers that are there while derivatives are taken.

        **Raises** ValueError where they are not, within `jax.jit` or `jax.vmap`.
        """
        law, mass = jax.lax.stop_gradient((self.law, self.mass))
        if traced((law, mass)):
            refuse(
                "law",
                "numbers that are known",
                "traced ones of jax.jit or jax.vmap",
                "Look for the wave outside of them: how many panels it takes depends on it. jax.grad and jax.jvp "
                "may go through it.",
            )
        return Medium(law, mass, self.origin)


def medium_of(law: Law | Lattice, mass: Scalar = 1.0) -> Medium:
    """The medium of a law, or of a lattice whose sites and bonds are all alike.

    **Raises** ValueError for a lattice that is no such chain, or a law whose parameters are not single numbers.
    """
    if isinstance(law, Lattice):
        lattice, wanted = law, "a uniform chain of bonds between neighbours"
        law, origin = law_between(lattice, wanted), lattice.origin
        mass = single("law", "masses", lattice.mass)
    else:
        origin, mass = {}, single("mass", "masses", positive("mass", mass))
    law = jax.tree.map(
        lambda x: single("law", "parameters", x) if eqx.is_inexact_array(x) else x, law
    )
    return Medium(law, mass, origin)


def law_between(lattice: Lattice, wanted: str) -> Law:
    """The law of a chain's bonds to the next site, of all such terms; walls and their contacts do not count.

    **Raises** ValueError for a batch, and for a lattice that is not a chain, has other terms or no such bonds: none of
    what is `wanted`.
    """
    if lattice.fields is not None or lattice.axes != 1 or lattice.dimension is not None:
        refuse("law", wanted, f"a lattice of shape {lattice.shape}")
    if lattice.lanes:
        refuse(
            "law",
            "one lattice",
            f"a batch of shape {lattice.lanes}",
            "Look for the wave of each in a loop.",
        )
    # contacts with walls may be others than those between sites
    inner = [(without_walls(term, lattice) or (term,))[0] for term in lattice.terms]
    found = [next_neighbours(term) for term in inner]
    others = [
        term
        for term, one in zip(inner, found)
        if one is None and not (walls(term) and span(term) == ())
    ]
    own = [one[0] for one in found if one is not None]
    if others or not own:
        names = ", ".join(type(term).__name__ for term in others) or "no bond to the next site"
        refuse("law", wanted, f"one with {names}")
    return sum(own[1:], own[0])


def single(argument: str, what: str, x: Any) -> Number:
    """One number out of equal ones, in the default type."""
    values = concrete(jax.lax.stop_gradient(x))
    if np.ndim(x) == 0:
        return jnp.asarray(x, float)
    if values is not None and not np.ptp(values) <= UNIFORM * np.abs(values).max():
        refuse(
            argument,
            f"a uniform chain, all {what} alike",
            f"{what} from {values.min():g} to {values.max():g}",
            "Waves of cells of several masses or laws are gx.travelling.cell_wave's.",
        )
    return jnp.asarray(x.reshape(-1)[0], float)


def fine(law: Law, e: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """F(e), F'(e) and W(e), to their last digits also where F and W are small differences, as a user writes them.

    F = e int_0^1 F'(e s) ds and W = e^2 int_0^1 (1 - s) F'(e s) ds, wherever half of the nodes give the same.
    """
    slopes = [law.derivative(s * e) for s in _NODES]
    rounding = UNITS * jnp.finfo(jnp.result_type(float)).eps * jnp.abs(law.preload * e)

    def chosen(rules, power, plain):
        mean, half = (e**power * sum(w * slope for w, slope in zip(rule, slopes)) for rule in rules)
        preload = rounding if power == 2 else rounding / jnp.where(e == 0, 1.0, jnp.abs(e))
        return jnp.where(jnp.abs(mean - half) <= SMOOTH * jnp.abs(mean) + preload, mean, plain)

    return chosen(_FORCE, 1, law.force(e)), slopes[-1], chosen(_ENERGY, 2, law.energy(e))


def fine_force(law: Law, e: Numbers) -> Numbers:
    """F(e), to its last digit also where it is a small difference of larger numbers."""
    return fine(law, e)[0]


@compiled
def fine_values(law: Law, e: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """`fine`, compiled for each shape."""
    return fine(law, e)


def values(law: Law, e: Numbers) -> tuple[Numbers, ...]:
    """Force, stiffness and energy at compressions of any shape: by NumPy, or by JAX where something is traced."""
    return fine(law, e) if traced((law, e)) else in_chunks(fine_values, law, e)


def in_chunks(program: Callable, law: Law, e: np.ndarray) -> tuple[np.ndarray, ...]:
    """What `program(law, e)`, compiled for `CHUNK` compressions, gives at known ones of any shape."""
    flat = np.ravel(e)
    padded = np.zeros(-(-max(flat.size, 1) // CHUNK) * CHUNK)
    padded[: flat.size] = flat
    parts = [program(law, jax.device_put(part)) for part in padded.reshape(-1, CHUNK)]
    return tuple(
        np.concatenate([np.asarray(p, float) for p in x])[: flat.size].reshape(np.shape(e))
        for x in zip(*parts)
    )


def implicit(x: Number, gap: Number, slope: Number) -> Number:
    """A root x of a gap with its derivative: `gap` is what is left at a fixed x, `slope` its derivative in x."""
    return x - (gap - jax.lax.stop_gradient(gap)) / jax.lax.stop_gradient(slope)


def one_number(argument: str, x: Any) -> float | None:
    """A known number behind what may be differentiated; `None` for `None`."""
    if x is None:
        return None
    value = concrete(jax.lax.stop_gradient(jnp.asarray(x, float)))
    if value is None:
        refuse(
            argument,
            "a number that is known",
            "one that jax.jit or jax.vmap traces",
            "Keep it out of them.",
        )
    return float(value)
