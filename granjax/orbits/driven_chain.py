"""A chain between walls that move."""

from collections.abc import Sequence

import equinox as eqx

from ..checks import one_of, per_lane, refuse
from ..lattice import Lattice
from ..terms import Damping, Harmonic, Wall
from ..terms.chain import walls, without_walls
from ..types import Parameter

SIDES = ("left", "right")


def driven_chain(
    lattice: Lattice,
    amplitude: Parameter,
    omega: Parameter,
    *,
    ends: str | Sequence[str] = SIDES,
    damping: Parameter | None = None,
    phase: Parameter | tuple = 0.0,
    field: str | None = None,
) -> Lattice:
    r"""A chain whose end walls shake: w(t) = a cos(omega t + phase), u_0 = w on the left, u_{N+1} = w on the right.

    m_n u_n'' = F_n(u_{n-1} - u_n) - F_{n+1}(u_n - u_{n+1}) - gamma m_n u_n'. The end bonds keep their law and become
    `Wall` terms; the bonds between become `Shift(1, "free")`; an end that is not driven keeps a wall at rest.

    **Arguments:**

    - `lattice`: a chain whose walls are fixed, such as `gx.scenes.monomer(21, precompression=1.0)`.
    - `amplitude`: a [m]; `omega`: angular frequency [rad/s]. Numbers, traced or swept.
    - `ends`: which walls move, `"left"`, `"right"` or both.
    - `damping`: gamma >= 0 [1/s] of every site, added to what the lattice has; `None` for none.
    - `phase` [rad]: a number for all, or one for each of `ends`. Equal phases move both walls in the same direction
      at a time; (0, pi) makes them mirror images, which squeeze the chain together.
    - `field`: name of the field that the walls touch, where a cell holds several.

    **Returns:** a `Lattice`; its bond is where it was, walls follow after all other terms, left then right.
    **Raises** ValueError for a lattice that is no chain with one bond to fixed walls, another term that reaches a
    wall, an unknown end, or as many phases as do not fit.
    Typical: a = 0.05 ... 0.5 d0, omega near a band edge, gamma = 0.01 ... 0.1 in scaled units (200/s for steel beads).

    **Example:**

    >>> chain = gx.driven.driven_chain(gx.scenes.monomer(20, precompression=1.0), 0.1, 1.0, ends="left")
    >>> gx.measures.strain(chain, gx.states.rest(chain), bond=1).tolist()
    [0.1]
    """
    ends = tuple(one_of("ends", end, SIDES) for end in ((ends,) if isinstance(ends, str) else ends))
    phases = phase if isinstance(phase, (tuple, list)) else (phase,) * len(ends)
    if len(phases) != len(ends):
        refuse("phase", f"a number, or {len(ends)}, one for each of {ends}", repr(phase))
    if lattice.axes != 1 or lattice.dimension is not None:
        refuse(
            "lattice", "a chain with scalar displacements", f"a lattice of shape {lattice.shape}"
        )
    amplitude, omega = (
        per_lane("amplitude", amplitude, lattice.lanes),
        per_lane("omega", omega, lattice.lanes),
    )
    phases = tuple(per_lane("phase", x, lattice.lanes) for x in phases)
    if field is not None:
        one_of("field", field, lattice.fields or (None,))
    terms, laws = [], None
    for i, term in enumerate(lattice.terms):
        parted = without_walls(term, lattice, field) if laws is None else None
        if parted is not None:
            inner, *laws = parted
            terms.append(inner)
        elif walls(term):
            refuse(
                "lattice",
                "one Bond(Shift(1, 'fixed'), law) to the walls and no other term that reaches them",
                f"terms[{i}] ({type(term).__name__})",
                "Build such a scene from Wall terms.",
            )
        else:
            terms.append(term)
    if laws is None:
        refuse(
            "lattice",
            "a Bond(Shift(1, 'fixed'), law), which leads to walls",
            "none",
            "Use boundary='fixed'.",
        )
    if damping is not None:
        terms.append(Damping(damping))
    for side, law in zip(SIDES, laws):
        motion = Harmonic(amplitude, omega, phases[ends.index(side)]) if side in ends else None
        terms.append(Wall(law, side, motion, field=field))
    driven = eqx.tree_at(lambda c: c.terms, lattice, tuple(terms))
    driven.check_terms()
    return driven
