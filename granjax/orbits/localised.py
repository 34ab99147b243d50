"""Localisation of orbits: how many cells share the energy, and the dip of a dark breather."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.checks import traced
from ..base.printing import told
from ..base.types import StateLike
from ..lattice import Lattice, State
from ..measures import participation, site_energy
from .asked import checked_state, one_lattice
from .guesses import cell_or_none
from .orbit import SPREAD, Orbit

# The share of the cells over which the energy of a wave between walls spreads, along each axis.
WAVE = 2 / 3
# The share of the cells of such a wave above which an orbit is not a bright breather.
EXTENDED = 0.9
# The share of all cells above which the energy has a background.
BACKGROUND = 0.4
# The share of all cells above which an orbit has left a guess over less than half as many cells
# as its own.
STRAYED = 0.5
# With fewer cells shares tell nothing: two or three coupled sites are an orbit however they share
# the energy.
FEWEST = 5
# The largest energy in the middle of a dip, over that on the lower of its sides.
DIP = 0.5
WAVES = "gx.orbits.orbit finds waves, and check=False accepts them."


class Localisation(NamedTuple):
    """How the energy of a state at rest is spread over the cells of a lattice.

    **Fields:**

    - `participation`: (sum e)^2/sum e^2 over the cells: 1 for a single cell, the number of cells
      for a uniform oscillation, two thirds of it for a wave between walls, down to four ninths in
      the plane.
    - `cells`: the number of cells.
    - `dip`: the least energy of a cell over the largest on the lower of its sides; 1 or more
      without a dip.
    - `axes`: in how many directions waves run.
    """

    participation: float
    cells: int
    dip: float
    axes: int = 1
    __repr__ = told

    @property
    def bright(self) -> bool:
        """Whether too few cells share the energy for a wave."""
        return self.participation <= EXTENDED * WAVE**self.axes * self.cells

    @property
    def fills(self) -> bool:
        """Whether there is a background."""
        return self.participation > BACKGROUND * self.cells

    @property
    def dark(self) -> bool:
        """Whether there is a background with a dip."""
        return self.fills and self.dip <= DIP

    def __str__(self) -> str:
        return f"{self.participation:.3g} of {self.cells} cells share its energy"

    def why_not(self, kind: str, guess: "Localisation") -> str | None:
        """Return why this is not a breather of a kind, as a sentence; `None` if it is one.

        `kind`: "bright", "dark" or "any".
        """
        strayed = kind == "bright" and self.participation > max(
            2 * guess.participation, STRAYED * self.cells
        )
        if kind != "dark" and self.bright and not strayed or kind != "bright" and self.dark:
            return None
        if kind == "dark":
            lacks = (
                f"its least energy is {self.dip:.2g} of that beside it"
                if self.fills
                else "there is no background"
            )
            return f"Not a dark breather: {self} (participation number), and {lacks}. {WAVES}"
        dip = "" if kind == "bright" else ", without the dip of a dark breather"
        return f"Not localised: {self} (participation number; of the guess {guess.participation:.3g}){dip}. {WAVES}"


def localisation(lattice: Lattice, state: StateLike) -> Localisation:
    """Return the `Localisation` of a state at rest."""
    energies = _cell_energies(lattice, checked_state(one_lattice(lattice), state))
    # A graph of beads that move in the plane fills the plane.
    axes = max(energies.ndim, min(lattice.dimension or 1, 2))
    return Localisation(float(participation(energies.ravel())), energies.size, _dip(energies), axes)


def checked_localised(orbit: Orbit, kind: str, guess: State, throw: bool | None) -> Orbit:
    """Return a breather with a remark on its localisation, and mark an orbit that is not one.

    `kind`: as in `why_not`. With fewer than five cells there is only the remark: waves and
    breathers do not differ.
    **Raises** RuntimeError with the participation number if it is not a breather and `throw`.
    """
    if traced(orbit) or not orbit.converged:
        return orbit
    found = localisation(orbit.lattice, orbit.state)
    reason = found.why_not(kind, localisation(orbit.lattice, guess))
    if reason is None or found.cells < FEWEST:
        return dataclasses.replace(orbit, remark=f"{found}.")
    root = dataclasses.replace(orbit.root, code=jnp.full_like(orbit.root.code, SPREAD))
    orbit = dataclasses.replace(orbit, root=root, remark=reason)
    if throw is None or throw:
        raise RuntimeError(orbit.outcome)
    return orbit


def _cell_energies(lattice: Lattice, state: State) -> Float[np.ndarray, "..."]:
    # Over the axes of the lattice; of each site where the lattice has no period.
    leaves = [np.asarray(e) for e in jax.tree.leaves(site_energy(lattice, state))]
    if any(e.shape != leaves[0].shape for e in leaves):
        return np.concatenate([e.ravel() for e in leaves])
    total = sum(leaves)
    cell = cell_or_none(lattice)
    for axis, size in enumerate(cell.cell if cell else ()):
        total = np.add.reduceat(total, np.arange(0, total.shape[axis], size), axis)
    return total


def _dip(energies):
    # The least value over all axes.
    least = np.inf
    for axis in range(energies.ndim):
        e = energies.sum(tuple(i for i in range(energies.ndim) if i != axis))
        if len(e) > 2:
            left = np.maximum.accumulate(e)[:-2]
            right = np.maximum.accumulate(e[::-1])[::-1][2:]
            beside = np.maximum(np.minimum(left, right), np.finfo(e.dtype).tiny)
            with np.errstate(over="ignore"):  # Neighbouring cells may be at rest.
                least = min(least, np.min(e[1:-1] / beside))
    return float(least)
