"""What a wave runs through: a law between neighbours and a mass, given as such or as a uniform chain."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, described, positive, refuse, traced
from ..entry import checked
from ..lattice import Lattice
from ..laws import Law
from ..outside import Outside
from ..printing import told
from ..types import Number, Numbers, Scalar

# arguments that a law is evaluated at in one program, nodes of the mean of a stiffness, units of rounding
CHUNK, MEAN, ROUNDING = 8192, 8, 16
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(MEAN)
UNIFORM = 1e-12


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
            refuse("law", "numbers that are known", "traced ones of jax.jit or jax.vmap",
                   "Look for the wave outside of them: how many panels it takes depends on it. jax.grad and jax.jvp "
                   "may go through it.")
        return Medium(law, mass, self.origin)


@checked
def medium_of(law: Law | Lattice, mass: Scalar = 1.0) -> Medium:
    """The medium of a law, or of a lattice whose sites and bonds are all alike.

    **Raises** ValueError for a lattice that is no such chain, or a law whose parameters are not single numbers.
    """
    if isinstance(law, Lattice):
        lattice, wanted = law, "a uniform chain of bonds between neighbours"
        if lattice.fields is not None or lattice.axes != 1 or lattice.dimension is not None:
            refuse("law", wanted, f"a lattice of shape {lattice.shape}")
        if lattice.lanes:
            refuse("law", "one lattice", f"a batch of shape {lattice.lanes}", "Look for the wave of each in a loop.")
        law, origin = law_between(lattice, wanted), lattice.origin
        mass = single("law", "masses", lattice.mass)
    else:
        origin, mass = {}, positive("mass", mass)
        if mass.shape:
            refuse("mass", "one number", f"shape {mass.shape}", "All sites are alike.")
    law = jax.tree.map(lambda x: single("law", "parameters", x) if eqx.is_inexact_array(x) else x, law)
    return Medium(law, mass, origin)


def law_between(lattice: Lattice, wanted: str) -> Law:
    """The law of a chain's bonds to the next site, of all such terms; walls and their contacts do not count.

    **Raises** ValueError for a chain with other terms, or without such bonds, as none of what is `wanted`.
    """
    # contacts with walls may be others than those between sites
    inner = [(term.without_walls(lattice) or (term,))[0] for term in lattice.terms]
    found = [term.next_neighbours() for term in inner]
    others = [term for term, one in zip(inner, found) if one is None and not (term.walls() and term.span() == ())]
    own = [one[0] for one in found if one is not None]
    if others or not own:
        names = ", ".join(type(term).__name__ for term in others) or "no bond to the next site"
        refuse("law", wanted, f"one with {names}")
    return sum(own[1:], own[0])


@checked
def single(argument: str, what: str, x: Any) -> Number:
    """One number out of equal ones, in the default type."""
    values = concrete(jax.lax.stop_gradient(x))
    if np.ndim(x) == 0:
        return jnp.asarray(x, float)
    if values is not None and not np.ptp(values) <= UNIFORM * np.abs(values).max():
        refuse(argument, f"a uniform chain, all {what} alike", f"{what} from {values.min():g} to {values.max():g}",
               "Waves of cells of several masses or laws are gx.travelling.cell_wave's.")
    return jnp.asarray(x.reshape(-1)[0], float)


def fine_force(law: Law, e: Numbers) -> Numbers:
    """F(e), to its last digit also where it is a small part of the preload.

    There it is e times the mean of the stiffness between 0 and e.
    """
    plain = law.force(e)
    mean = sum(w / 2 * law.derivative((1 + t) / 2 * e) for t, w in zip(_NODES, _WEIGHTS))
    close = jnp.abs(e * mean - plain) <= ROUNDING * jnp.finfo(plain.dtype).eps * (jnp.abs(plain) + jnp.abs(law.preload))
    return jnp.where(close & (law.preload != 0), e * mean, plain)


@eqx.filter_jit
def _values(law, e, outside):
    return fine_force(law, e), law.derivative(e), law.energy(e)


def values(law: Law, e: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Force, stiffness and energy at known compressions of any shape, by one program for each law."""
    flat, outside = np.ravel(e), Outside(law)
    padded = np.zeros(-(-max(flat.size, 1) // CHUNK) * CHUNK)
    padded[: flat.size] = flat
    parts = [_values(law, jnp.asarray(part), outside) for part in padded.reshape(-1, CHUNK)]
    return tuple(np.concatenate([np.asarray(p, float) for p in x])[: flat.size].reshape(np.shape(e))
                 for x in zip(*parts))


@checked
def one_number(argument: str, x: Any) -> float | None:
    """A known number behind what may be differentiated; `None` for `None`."""
    if x is None:
        return None
    value = concrete(jax.lax.stop_gradient(jnp.asarray(x, float)))
    if value is None:
        refuse(argument, "a number that is known", "one that jax.jit or jax.vmap traces", "Keep it out of them.")
    if not np.isfinite(value):
        refuse(argument, "a finite number", described(x))
    return float(value)
