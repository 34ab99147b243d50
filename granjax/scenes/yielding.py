"""Chains with contacts that yield."""

import jax.numpy as jnp

from ..base.checks import non_negative, positive
from ..base.types import Count, Parameter
from ..base.units import SCALED
from ..lattice import Lattice
from ..laws import Thornton, plus_power
from ..strains import Shift
from ..terms import PlasticContact
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
    r"""Build a chain of elastic-plastic spheres (Thornton's law).

    The force is Hertz's up to the overlap s_y, and linear beyond. Unloading leaves an indentation:
    each contact remembers its largest overlap. `gx.simulate` returns these and the energy lost.
    Pulses decay, higher ones faster.

    **Arguments:** `sites`: N >= 2; `mass`: m > 0, a number or one per bead; `stiffness`: A,
    `yield_overlap`: s_y > 0, numbers or one per contact, as in `gx.Thornton`; `precompression`:
    F0 >= 0; `boundary`: `"free"`, `"fixed"` or `"periodic"`; `units`: "scaled" or "SI". In SI use
    `gx.materials.bead_mass`, `hertz_coefficient`, `yield_overlap`.

    **Raises** ValueError for arguments outside these ranges.
    Source: C. Thornton, J. Appl. Mech. 64, 383 (1997).

    **Example:**

    >>> chain = gx.scenes.plastic(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05)
    >>> bool(run.lost.sum() > 0)  # what yielding has taken of the energy
    True
    """
    stiffness = positive("stiffness", stiffness)
    yields = positive("yield_overlap", yield_overlap)
    F0 = non_negative("precompression", precompression, "A chain under tension falls apart.")
    law = fitting(Thornton(stiffness, yields), contacts_of(sites, boundary), "contact")
    # the overlap of virgin contacts under F0
    first = stiffness * plus_power(yields, 1.5)
    overlap = jnp.where(
        F0 > first, yields * (2 * F0 / first + 1) / 3, plus_power(F0 / stiffness, 2 / 3)
    )
    contacts = PlasticContact(Shift(1, boundary), law, overlap)
    return Lattice(mass, contacts, sites=a_chain(sites), units=units)
