"""Scale a lattice in SI to numbers of order one, and convert back."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.checks import concrete, positive, refuse
from ..base.printing import told
from ..base.types import Scalar
from ..base.units import SCALED, Units
from ..lattice import Lattice


class ScaledLattice(NamedTuple):
    """A lattice in scaled numbers, and the units that convert them to SI."""

    lattice: Lattice
    units: Units
    __repr__ = told


def scaled(
    lattice: Lattice, velocity: Scalar | None = None, *, units: Units | None = None
) -> ScaledLattice:
    r"""Scale a lattice in SI to numbers of order one; return it with its units.

    - Mass unit: the mean mass.
    - Length unit: the overlap at rest d0 = (F0/A)^{1/p} of the mean contact; with `velocity` v the
      overlap (m v^2/A)^{1/(p+1)} that an impact reaches, so that v becomes 1.
    - Time unit: such that A becomes 1; with F0 then F0 = d0 = 1.

    All lanes share one set of units. In float64 SI numbers lose no digits (A = 1e10, u = 1e-6, t =
    1e-4). Scaled numbers help with absolute tolerances, optimisers, comparison with papers, and
    float32, where 1e-6 leaves little room for tails.

    **Arguments:** `lattice`, as from `beads`; `velocity` [m/s] > 0 of the impact, needed without
    precompression; `units`: a `Units` that replaces the natural one.

    **Returns:** `ScaledLattice(lattice, units)`. Convert back with `units.state_to_si(state)`,
    `run.ts * units.time`, `forces * units.force`. A user-defined law or term is wrapped and still
    works in its own units.
    **Raises** ValueError for a lattice without a contact law or a length to scale with.

    **Example:**

    >>> beads = gx.scenes.beads("steel 316", 9.53e-3, precompression=10.0, cells=20, boundary="periodic")
    >>> chain, units = gx.scenes.scaled(beads)
    >>> round(float(gx.linear.sound_speed(chain)), 6)  # (3/2)^{1/2}
    1.224745
    """
    if units is None:
        units = _natural_units(lattice, velocity)
    elif velocity is not None:
        refuse(
            "units",
            "Units(mass, length, time) without a velocity, or a velocity alone",
            repr(units),
        )
    mass = jax.tree.map(lambda m: m / units.mass, lattice.mass)
    terms = tuple(term.in_units(units) for term in lattice.terms)
    positions = jax.tree.map(lambda x: x / units.length, lattice.positions)
    converted = eqx.tree_at(
        lambda c: (c.mass, c.terms, c.positions),
        lattice,
        (mass, terms, positions),
        is_leaf=lambda x: x is None,
    )
    return ScaledLattice(converted.counted_in(SCALED), units)


def _natural_units(lattice, velocity):
    u = lattice.zeros()
    laws = [
        c.law
        for term in lattice.terms
        for c in term.compressions(jnp.zeros(()), u)
        if c.place != "site"
    ]
    contacts = [part for law in laws for part in law.parts if part.power_law is not None]
    if not contacts:
        refuse(
            "lattice",
            "a Hertz or PowerLaw contact to scale with",
            "none",
            "Give units=Units(mass, length, time).",
        )
    law = contacts[0]
    A, p = (jnp.mean(x) for x in law.power_law)
    masses = jax.tree.leaves(lattice.mass)
    m = sum(jnp.mean(x) for x in masses) / len(masses)
    if velocity is not None:
        v = positive("velocity", velocity, "It is the speed of the impact in m/s.")
        length = (m * v * v / A) ** (1 / (p + 1))
    else:
        F0 = jnp.mean(jnp.asarray(law.preload))
        value = concrete(F0)
        if value is not None and not value > 0:
            refuse(
                "velocity",
                "the impact's speed in m/s",
                "None",
                "Without precompression the chain has no length.",
            )
        length = (F0 / A) ** (1 / p)
    return Units(m, length, jnp.sqrt(m * length / (A * length**p)))
