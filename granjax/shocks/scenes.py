"""Initial data of shocks: a step in the strain, colliding halves, a piston."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import trailing
from ..base.checks import concrete, per_lane, refuse, show, traced
from ..base.printing import told
from ..base.types import Count, Number, Parameter
from ..lattice import Lattice, State
from ..laws import Law, Strained
from ..states import velocity_step
from ..states.places import chain_only, inside
from ..strains import Shift
from ..terms import Bond, Wall
from ..terms.chain import next_neighbours
from ..terms.reach import reads
from .riemann import Jolt, Riemann, simple_wave_velocity

CHAIN = "a chain of bonds between neighbours"
# The force, over a term's largest, that counts as zero.
ROUNDED = 1e-9


class Uniform(eqx.Module):
    """The motion w(t) = speed t of a piston; its speed can be swept and differentiated."""

    speed: jax.Array
    __repr__ = told

    def __call__(self, t: Number) -> Number:
        """Return the place of the piston at time t."""
        return self.speed * t


def velocity_shock(lattice: Lattice, c: Parameter, *, centre: Parameter | None = None) -> Riemann:
    r"""Build two halves of a chain that collide: u = 0, v_n = -2c sign(n - centre).

    For c > 0 they meet with a relative velocity 4c and a shock runs into each. For c < 0 they part,
    which sends out a rarefaction, or a shock where the law softens. The strain behind is about 2c
    over the speed of sound (Toda, a = b = m = 1: 2 ln(1 + c) for -1 < c < 1; for c >= 1 the strain
    oscillates forever from site to site).

    The ends become free: bonds to walls are removed and a ring is cut, because the far states
    translate, which a wall or a ring would prevent. The ends then send out no waves.

    **Arguments:** `lattice`: a chain; `c`: a quarter of the relative velocity [m/s], a number or
    one per lane; `centre`: as in `gx.states.velocity_step`: a site, which stays at rest, or half
    way between two; `None` for the site in the middle, (N - 1)//2. Where no site rests, the
    plateau's mean converges like 1/t.
    **Returns:** `Riemann`, its `centre` half a bond further left, where sites lie on the scale of
    bonds.
    **Raises** ValueError for a lattice that is not a chain, terms that hold or slow a translation
    (walls, on-site forces, damping of sites: use `piston` for those), c not finite, or a centre
    outside the chain.
    Source: S. Venakides, P. Deift, R. Oba, Comm. Pure Appl. Math. 44, 1171 (1991).

    **Example:**

    >>> lattice, state = gx.shocks.velocity_shock(gx.scenes.toda(40), 0.1)
    >>> print(state.v[18:22])
    [ 0.2  0.  -0.2 -0.2]
    """
    size = chain_only(lattice, "velocity_shock")
    chain = _opened(lattice)
    c = per_lane("c", c, lattice.lanes)
    middle = inside("centre", (size - 1) // 2 if centre is None else centre, size)
    known = concrete(middle)
    if known is not None and not 1 < known < size - 2:
        refuse(
            "centre",
            "a place with two sites or more on either side",
            show(known),
            f"The chain has {size} sites.",
        )
    state = velocity_step(chain, c, middle)
    _refuse_ends(chain, state)
    return Riemann(chain, state, c, middle - 0.5, 0.0, "velocity", _jolt(chain, [(0.0, 4 * c)]))


def step(
    lattice: Lattice, left: Parameter, right: Parameter = 0.0, *, centre: Count | None = None
) -> Riemann:
    r"""Build a step in the strain, at rest.

    y_n = left for n < centre, right for n >= centre; u = v = 0. The law of each bond contains its
    initial strain, gx.laws.Strained(law, left or right, r), so there is no ramp u_n = -left n: with
    a million sites it would round the strain to 1e-10. u counts from the initial places;
    `problem.strain(u)` is the total strain. Forces and energies are measured from r: `left` or
    `right`, whichever makes the other's energy smaller. The ends become rigid walls, which carry
    the load of the far states: these stay at rest, to the last bit, until a wave arrives.

    The sites start at once: the site `centre` feels F(left) - F(right). For a law that stiffens and
    left > right, a shock runs to the right and a rarefaction to the left.

    **Arguments:** `left`, `right`: strains from the rest of `lattice`, positive in compression [m],
    numbers or one per lane; `centre`: the first bond that carries `right`, from 1 to N - 2; `None`
    for the middle, (N-1)//2.
    **Returns:** `Riemann`, its `centre` half way between the bonds centre - 1 and centre.
    **Raises** ValueError for a lattice that is not a chain, bonds that differ or do not lead to the
    next site, on-site forces, equal strains, those at which the law has no force, or a centre
    outside the chain.
    """
    size = chain_only(lattice, "step")
    left = per_lane("left", left, lattice.lanes).astype(lattice.dtype)
    right = per_lane("right", right, lattice.lanes).astype(lattice.dtype)
    lanes = len(lattice.lanes)
    centre = (size - 1) // 2 if centre is None else centre
    if not 1 <= centre <= size - 2:
        refuse("centre", f"a bond from 1 to {size - 2}", show(centre))
    centre = int(centre)
    own = [_between(term, lattice) for term in lattice.terms]
    law = _alike(_law(own), lanes)
    for name, y in (("left", left), ("right", right)):
        force = concrete(law.force(y))
        if force is not None and not np.all(np.isfinite(force)):
            refuse(name, "a strain at which the law has a force", show(concrete(y)))
    reference = jnp.where(_beyond(law, left, right) <= _beyond(law, right, left), right, left)
    bonds = trailing(np.arange(-1, size), 1 + lanes)  # those to the walls as well
    strain = jnp.where(bonds < centre, left, right)
    terms = []
    for i, term in enumerate(own):
        found = next_neighbours(term)
        if found is not None:
            terms.append(
                Bond(Shift(1, "fixed"), Strained(_alike(found[0], lanes), strain, reference))
            )
        elif reads(term, lattice).displacement or reads(term, lattice).time:
            refuse(
                "lattice",
                f"{CHAIN}, damping and dashpots",
                f"terms[{i}] ({type(term).__name__})",
                "The far states must be at rest at their strains.",
            )
        else:
            terms.append(term)
    chain = _with(lattice, terms)
    jump = concrete(left - right)
    if jump is not None and not np.all(jump):
        refuse(
            "left",
            "another strain than right",
            show(concrete(left)),
            "Without a jump nothing moves.",
        )
    velocity = simple_wave_velocity(law, _least(chain), right, left)
    zeros = chain.zeros()
    return Riemann(
        chain,
        State(zeros, zeros),
        left - right,
        jnp.asarray(centre - 0.5, float),
        strain[1:-1],
        "strain",
        Jolt(law, _least(chain), ((right, velocity), (left, -velocity)), _spread(lattice)),
    )


def piston(lattice: Lattice, speed: Parameter) -> Riemann:
    r"""Build a piston left of a chain at rest.

    It is a `Wall` with w(t) = speed t and the chain's own law, one half of a velocity shock with
    c = speed/2 in the frame of the far sites: u_n + 2c t of the sites right of one that stays at
    rest, to rounding (the piston's contact has no dashpot). A negative speed withdraws it.

    **Arguments:** `lattice`: a chain; bonds to walls are removed and a ring is cut, the right end
    is free. `speed` [m/s], a number or one per lane.
    **Returns:** `Riemann`, with c = speed/2; the piston's contact is bond -1, and `centre` -1.5.
    **Raises** ValueError for other lattices than a chain of bonds to the next site, and speeds
    that are not finite.
    Source: Molinari, Daraio, Phys. Rev. E 80, 056602 (2009).

    **Example:**

    >>> problem = gx.shocks.piston(gx.scenes.toda(40), 0.2)
    >>> problem.kind, float(problem.c)  # half of a velocity shock of c = speed/2
    ('piston', 0.1)
    """
    chain_only(lattice, "piston")
    speed = per_lane("speed", speed, lattice.lanes)
    # The law of the bond to a wall on the left if there is one, else of the first bond.
    contact = _over_bonds(_law(lattice.terms), lattice, lambda x: x[0])
    free = _opened(lattice)
    chain = _with(free, (*free.terms, Wall(contact, "left", Uniform(speed.astype(lattice.dtype)))))
    zeros = chain.zeros()
    return Riemann(
        chain,
        State(zeros, zeros),
        speed / 2,
        jnp.asarray(-1.5),
        0.0,
        "piston",
        _jolt(free, [(0.0, 2 * speed)]),
    )


def _with(lattice, terms):
    chain = eqx.tree_at(lambda x: x.terms, lattice, tuple(terms))
    chain.check_terms()
    return chain


def _opened(lattice):
    return _with(lattice, [_between(term, lattice) for term in lattice.terms])


def _between(term, lattice):
    found = next_neighbours(term)
    if found is None or found[1] == "free":
        return term
    law, boundary = found
    return Bond(
        Shift(1, "free"),
        _over_bonds(law, lattice, (lambda x: x[1:-1]) if boundary == "fixed" else lambda x: x[:-1]),
    )


def _law(terms):
    laws = [found[0] for found in map(next_neighbours, terms) if found is not None]
    if not laws:
        names = ", ".join(type(term).__name__ for term in terms)
        refuse(
            "lattice",
            CHAIN,
            f"one with {names or 'no terms'}",
            "Bonds to the next site are Bond(Shift(1), law).",
        )
    return sum(laws[1:], laws[0])


def _over_bonds(law: Law, lattice: Lattice, choose: Callable) -> Law:
    axes = 1 + len(lattice.lanes)
    return jax.tree.map(lambda x: choose(x) if jnp.ndim(x) == axes and x.shape[0] > 1 else x, law)


def _beyond(law, strain, reference):
    # Return the energy of a bond at one strain beyond the work of the force at another.
    return law.energy(strain) - law.energy(reference) - law.force(reference) * (strain - reference)


def _alike(law, lanes):
    def one(x):
        if jnp.ndim(x) != 1 + lanes:
            return x
        values = concrete(x)
        if values is not None and not np.all(values == values[:1]):
            refuse(
                "lattice",
                "bonds that are all alike",
                f"parameters from {values.min():g} to {values.max():g}",
                "At one strain bonds that differ are not in equilibrium.",
            )
        return x[0]

    return jax.tree.map(one, law)


def _least(lattice):
    mass = lattice.mass
    return mass.min(0) if mass.ndim > len(lattice.lanes) else mass


def _jolt(lattice, into):
    others = [term for term in lattice.terms if next_neighbours(term) is None]
    if len(others) == len(lattice.terms) or any(
        reads(term, lattice).displacement for term in others
    ):
        return None
    return Jolt(_law(lattice.terms), _least(lattice), tuple(into), _spread(lattice))


def _spread(lattice):
    # Return the force of a site's unit velocity on its neighbours by dashpots, over the mass.
    v = lattice.zeros()
    v = v.at[v.shape[0] // 2].set(1)
    found = jnp.zeros(lattice.lanes)
    for term in lattice.terms:
        if next_neighbours(term) is None and reads(term, lattice).velocity:
            pulls = jnp.abs(term.force(0.0, 0 * v, v, lattice.mass)) / _least(lattice)
            found = found + jnp.where(v == 0, pulls, 0).max(0)
    return found


def _refuse_ends(lattice, state):
    for i, term in enumerate(lattice.terms):
        if traced((term, lattice.mass, state.v)):
            continue
        force = np.abs(np.asarray(term.force(0.0, state.v, state.v, lattice.mass)))
        if np.any(force[[0, -1]] > ROUNDED * force.max(initial=0)):
            refuse(
                "lattice",
                "a chain whose halves may translate, free at its ends",
                f"terms[{i}] ({type(term).__name__}), which acts on its ends then",
                "Take it out, write it with Shift(.., 'free'), or use gx.shocks.piston, where the chain rests.",
            )
