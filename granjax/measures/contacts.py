"""Contacts: compression, overlap and total force of bonds and walls."""

import jax.numpy as jnp

from ..checks import refuse, whole
from ..terms import Bond, Modulated, Wall
from .states_of import displacements


def _contacts(lattice):
    """Bonds in the order of the terms, then walls in theirs."""
    def is_bond(term):
        return isinstance(term, Bond) or isinstance(term, Modulated) and isinstance(term.term, Bond)

    bonds = [term for term in lattice.terms if is_bond(term)]
    return bonds + [term for term in lattice.terms if isinstance(term, Wall)]


def _law_and_compression(lattice, y, t, bond):
    contacts = _contacts(lattice)
    bond = whole("bond", bond)
    if bond >= len(contacts):
        names = ", ".join(f"{i}: {type(term).__name__}" for i, term in enumerate(contacts)) or "none"
        refuse("bond", f"an index below {len(contacts)}", f"{bond}", f"The lattice's bonds and then walls are {names}.")
    term, u = contacts[bond], displacements(lattice, y)
    if isinstance(term, Wall):
        return term.law, jnp.asarray(term.compression(t, u))[None]
    if isinstance(term, Modulated):
        term = term.at(t)
    return term.law, term.strain_map.strain(u)


def strain(lattice, y, t=0.0, *, bond=0):
    """Compression of every bond from equilibrium, e_n = u_n - u_{n+1} for a chain, positive in compression [m].

    **Arguments:** `lattice`; `y`: a `State`; `t`: time, which only driven walls read; `bond`: which bond term, counted
    from 0 in the order of the terms, walls after all bonds.
    **Shapes:** (bonds,), then lanes; a grid's bonds on as many axes; (1,) for a wall.
    **Raises** ValueError for a state of another shape than the lattice's, or a bond that is not there.
    """
    return _law_and_compression(lattice, y, t, bond)[1]


def contact_force(lattice, y, t=0.0, *, bond=0):
    """Total contact force of every bond, F0 + F(e), positive in compression [N].

    At rest it is the preload F0; an open contact carries zero. Under a modulation g(t) it is g(t) (F0 + F(e)).

    **Arguments, shapes and errors:** as in `strain`.
    """
    law, e = _law_and_compression(lattice, y, t, bond)
    force = law.force(e)
    return force + jnp.asarray(law.preload).astype(force.dtype)


def overlap(lattice, y, t=0.0, *, bond=0):
    """Overlap of every contact, d0 + e for a power law; not above zero where it is open [m].

    **Arguments and shapes:** as in `strain`. **Raises** ValueError also for a law that cannot open.
    """
    law, e = _law_and_compression(lattice, y, t, bond)
    value = law.overlap(e)
    if value is None:
        refuse("bond", "a law whose contact can open", f"{type(law).__name__}", "Ask for strain instead.")
    return value
