"""The spread of energy: participation, centre, second moment."""

from functools import partial

import jax
import jax.numpy as jnp

from ..base.arrays import trailing
from ..base.checks import described, is_site, parameter, refuse
from ..base.types import Number, Parameter, StateLike
from ..lattice import Lattice
from .energies import site_energy


def participation(weights: Parameter, axis: int | tuple[int, ...] = 0) -> Number:
    """Return the number of sites that share a positive quantity, (sum w)^2 / sum w^2.

    It is 1 for one site alone, N where all are equal. **Arguments:** `weights`: such as energies,
    or mass times squared displacements of a mode; `axis`: one or several axes of the sites.
    **Returns:** the array without these axes; NaN where all weights are zero.
    """
    weights = parameter("weights", weights)
    axes = axis if isinstance(axis, tuple) else (axis,)
    if not is_site(axes, (weights.ndim,) * len(axes)):
        n = weights.ndim
        refuse("axis", f"whole numbers within {-n} ... {n - 1}", described(axis))
    return _participation(weights, axis)


@partial(jax.jit, static_argnums=1)
def _participation(weights, axis):
    # Squares of the weights themselves would underflow, as those of small energies in float32.
    shares = weights / jax.lax.stop_gradient(jnp.abs(weights).max(axis, keepdims=True))
    return shares.sum(axis) ** 2 / (shares * shares).sum(axis)


def participation_number(lattice: Lattice, y: StateLike, t: Number = 0.0) -> Number:
    """Return the participation number of site energies, (sum e)^2 / sum e^2, from 1 to N.

    The fields of a cell count together. **Returns:** shape of the lanes; NaN for a lattice at rest.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> float(gx.measures.participation_number(chain, gx.State(jnp.zeros(20), jnp.ones(20))))
    20.0
    >>> float(gx.measures.participation_number(chain, gx.states.impact(chain)))
    1.0
    """
    return participation(_cell_energy(lattice, y, t), tuple(range(lattice.axes)))


def energy_centre(lattice: Lattice, y: StateLike, t: Number = 0.0) -> Number:
    """Return the mean place of the energy, sum n e_n / sum e_n [sites], (2,) on a grid."""
    mean, places = _weighted(lattice, y, t)
    centres = [mean(n) for n in places]
    return centres[0] if len(centres) == 1 else jnp.stack(centres)


def second_moment(lattice: Lattice, y: StateLike, t: Number = 0.0) -> Number:
    """Return the mean square distance of the energy from its centre [sites^2].

    It is sum (n - centre)^2 e_n / sum e_n. On a grid both axes are summed. It grows as t^2 for
    ballistic energy and is bounded if it is localised. **Returns:** shape of the lanes; NaN at
    rest.
    """
    mean, places = _weighted(lattice, y, t)
    return sum(mean((n - mean(n)) ** 2) for n in places)


def _cell_energy(lattice, y, t):
    e = site_energy(lattice, y, t)
    leaves = jax.tree.leaves(e)
    if any(leaf.shape != leaves[0].shape for leaf in leaves):
        refuse(
            "lattice",
            "fields of one shape, one of each per cell",
            f"{lattice.sites}",
            "Use site_energy.",
        )
    return sum(leaves)


def _weighted(lattice, y, t):
    # means weighted by the energies, and site indices along each axis that broadcast against them
    e = _cell_energy(lattice, y, t)
    axes = tuple(range(lattice.axes))
    places = [trailing(jnp.arange(e.shape[i], dtype=e.dtype), e.ndim - i) for i in axes]
    return lambda x: (x * e).sum(axes) / e.sum(axes), places
