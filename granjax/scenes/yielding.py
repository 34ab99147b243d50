"""Chains whose contacts yield."""

import jax.numpy as jnp

from ..checks import non_negative, parameter, positive
from ..lattice import Lattice
from ..laws import Thornton, plus_power
from ..strains import Shift
from ..terms import PlasticContact
from ..types import Count, Parameter
from ..units import SCALED
from .chains import a_chain, contacts_of, fitting


def plastic(
    sites: Count,
    *,
    mass: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    yield_overlap: Parameter = 0.02,
    precompression: Parameter = 0.0,
    boundary: str = "free",
    units: str = SCALED,
) -> Lattice:
    r"""Build a chain of elastic-plastic spheres (Thornton's): Hertz up to the overlap s_y, then a straight line.

    Unloading leaves an indentation: each contact remembers its largest overlap. `gx.simulate` runs it, and returns the
    overlaps and the energy lost; pulses fall off along the chain, the faster the higher they are.

    **Arguments:** `sites`: N >= 2; `mass`: m > 0, a number or one per bead; `stiffness`: A, `yield_overlap`: s_y,
    numbers or one per contact, as in `gx.Thornton`; `precompression`: F0 >= 0; `boundary`: `"free"`, `"fixed"` or
    `"periodic"`; `units`: "scaled" or "SI". In SI: `gx.materials.bead_mass`, `hertz_coefficient`, `yield_overlap`.
    **Returns:** a `Lattice`. **Raises** ValueError as `monomer` does, and for s_y that is not above zero.
    Source: C. Thornton, J. Appl. Mech. 64, 383 (1997).

    **Example:**

    >>> chain = gx.scenes.plastic(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05)
    >>> bool(run.lost.sum() > 0)  # what yielding has taken of the energy
    True
    """
    stiffness, yields = positive("stiffness", stiffness), positive("yield_overlap", yield_overlap)
    F0 = non_negative("precompression", precompression, "A chain under tension falls apart.")
    law = fitting(Thornton(stiffness, yields), contacts_of(sites, boundary), "contact")
    # the overlap that F0 presses virgin contacts to
    first = stiffness * plus_power(yields, 1.5)
    overlap = jnp.where(
        F0 > first, yields * (2 * F0 / first + 1) / 3, plus_power(F0 / stiffness, 2 / 3)
    )
    contacts = PlasticContact(Shift(1, boundary), law, overlap)
    return Lattice(parameter("mass", mass), contacts, sites=a_chain(sites), units=units)
