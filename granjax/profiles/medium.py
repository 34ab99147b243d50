"""The medium of a wave: a law between neighbours and a mass, or a uniform chain."""

from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ..base.checks import known_value, positive, refuse, traced
from ..base.derivatives import changed, with_rule
from ..base.printing import told
from ..base.programs import compiled
from ..base.types import Number, Numbers, Scalar
from ..lattice import Lattice
from ..laws import Law
from ..terms.chain import next_neighbours, span, walls, without_walls

# The number of arguments at which one program evaluates a law.
CHUNK = 8192
# The relative spread below which numbers are equal.
UNIFORM = 1e-12
# The relative difference of a rule and its half below which the stiffness is smooth between 0 and
# e. The error of the full rule is the square of the half's, so only rounding remains.
SMOOTH = 1e-12
# The units of rounding of the preload, which some laws have subtracted from their force.
UNITS = 16
# The least strain at which the stiffness is looked at, because its derivatives may overflow below:
# those of a power of 3/2 do at 1e-205.
TINY = 1e-150


@cache
def _rules():
    """Return nine Radau nodes on (0, 1], and weights for 1 and 1 - s of all and every second."""
    legendre = np.polynomial.legendre
    nodes = np.append(scipy.special.roots_jacobi(8, 1, 0)[0], 1.0)
    # The moments int P_k/2 and int (1 - s) P_k, with s = (1 + x)/2.
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


class Medium(NamedTuple):
    """A law between neighbours, the mass of every site, and the metadata of their lattice."""

    law: Law
    mass: Any
    origin: dict
    __repr__ = told

    @property
    def known(self) -> "Medium":
        """The medium with the known numbers behind traced ones.

        **Raises** ValueError where there are none, within `jax.jit` or `jax.vmap`.
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


def in_float64() -> None:
    """Refuse JAX restricted to float32."""
    if not jax.config.jax_enable_x64:
        remedy = "A wave's shape is found in float64: leave JAX_ENABLE_X64 unset; lattices may be float32."
        refuse("jax_enable_x64", "True", "False", remedy)


def medium_of(law: Law | Lattice, mass: Scalar = 1.0) -> Medium:
    """Return the medium of a law or a uniform lattice.

    **Raises** ValueError for a lattice that is not a uniform chain, and parameters that are not
    single numbers.
    """
    if isinstance(law, Lattice):
        lattice = law
        wanted = "a uniform chain of bonds between neighbours"
        law = law_between(lattice, wanted)
        origin = lattice.origin
        mass = single("law", "masses", lattice.mass)
    else:
        origin = {}
        mass = single("mass", "masses", positive("mass", mass))
    law = jax.tree.map(
        lambda x: single("law", "parameters", x) if eqx.is_inexact_array(x) else x, law
    )
    return Medium(law, mass, origin)


def law_between(lattice: Lattice, wanted: str) -> Law:
    """Return the summed law of a chain's bonds to the next site, without contacts with walls.

    **Raises** ValueError for a batch, and for a lattice that is not a chain, has other terms or no
    such bonds. `wanted` names the expected lattice in the message.
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
    # Contacts with walls may differ from those between sites.
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
    """Return one number out of equal ones, in the default type."""
    values = known_value(x)
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
    """Return F(e), F'(e) and W(e) without cancellation, even where F and W are small differences.

    F = e int_0^1 F'(e s) ds and W = e^2 int_0^1 (1 - s) F'(e s) ds, where half of the nodes give
    the same result.
    """
    nodes, forces, energies = _rules()
    near = jnp.where(jnp.abs(e) < TINY, TINY, e)
    slopes = [law.derivative(s * near) for s in nodes]
    rounding = UNITS * jnp.finfo(jnp.result_type(float)).eps * jnp.abs(law.preload / near)

    def chosen(rules, power, plain):
        mean, half = (sum(w * slope for w, slope in zip(rule, slopes)) for rule in rules)
        smooth = jnp.abs(mean - half) <= SMOOTH * jnp.abs(mean) + rounding
        return jnp.where(smooth, e**power * mean, plain)

    return chosen(forces, 1, law.force(e)), law.derivative(e), chosen(energies, 2, law.energy(e))


def fine_force(law: Law, e: Numbers) -> Numbers:
    """Return F(e) without cancellation."""
    return fine(law, e)[0]


@compiled
def fine_values(law: Law, e: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Compile `fine` for each shape."""
    return fine(law, e)


def values(law: Law, e: Numbers) -> tuple[Numbers, ...]:
    """Return force, stiffness and energy at compressions of any shape; traced ones by JAX."""
    return fine(law, e) if traced((law, e)) else in_chunks(fine_values, law, e)


def in_chunks(program: Callable, given: Any, x: Any, chunk: int = CHUNK) -> tuple[np.ndarray, ...]:
    """Evaluate `program(given, x)`, compiled for `chunk` numbers x, at any number of them."""
    flat = np.ravel(x)
    padded = np.zeros(-(-max(flat.size, 1) // chunk) * chunk)
    padded[: flat.size] = flat
    parts = [program(given, jax.device_put(part)) for part in padded.reshape(-1, chunk)]
    return tuple(
        np.concatenate([np.asarray(p, float) for p in y])[: flat.size].reshape(np.shape(x))
        for y in zip(*parts)
    )


def implicit(gap: Callable, x: Any, inverse: Any) -> Any:
    """Return a known root x of `gap(x)` with derivatives of any order.

    `inverse`: of the Jacobian at x, a matrix or a number.
    """
    x, inverse = (jax.lax.stop_gradient(jnp.asarray(y)) for y in (x, inverse))
    gap, given = jax.closure_convert(gap, x)

    def rule(given, changes):
        root = with_rule(lambda *_: x, rule, *given)
        _, push = changed(partial(gap, root), given, changes)
        if not traced(given):
            return root, -jnp.dot(inverse, push)
        # The inverse is constant, but this solution has the derivatives of the Jacobian.
        along = lambda y: jax.jvp(lambda x: gap(x, *given), (root,), (y,))[1]
        ways = (lambda _, y: jnp.dot(inverse, y)), (lambda _, y: jnp.dot(inverse.T, y))
        return root, -jax.lax.custom_linear_solve(along, push, *ways)

    return with_rule(lambda *_: x, rule, *given)


def one_number(argument: str, x: Any) -> float | None:
    """Return the known number behind a differentiable one; `None` for `None`."""
    if x is None:
        return None
    value = known_value(jnp.asarray(x, float))
    if value is None:
        refuse(
            argument,
            "a number that is known",
            "one that jax.jit or jax.vmap traces",
            "Keep it out of them.",
        )
    return float(value)
