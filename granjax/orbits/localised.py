"""Whether an orbit is localised: how many cells share its energy, and whether a wave has the dip of a dark breather."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..checks import traced
from ..lattice import Lattice, State
from ..linear.cell import unit_cell
from ..measures import participation, site_energy
from ..printing import told
from ..types import StateLike
from .asked import checked_state, one_lattice
from .orbit import SPREAD, Orbit

# shares of the cells over which energy spreads: of a wave between walls along each axis, and of that the least that is
# no bright breather; of a background; and of what has left a guess that holds less than half of it
WAVE = 2 / 3
EXTENDED = 0.9
BACKGROUND = 0.4
STRAYED = 0.5
# of fewer cells shares tell nothing: two coupled sites, or three, are an orbit however they share it
FEWEST = 5
# energy in the middle of a dip, over that on either side
DIP = 0.5
WAVES = "gx.orbits.orbit finds waves, and check=False tells nothing apart."


class Localisation(NamedTuple):
    """How the energy of a state at rest is spread over the cells of a lattice.

    **Fields:** `participation`: (sum e)^2/sum e^2 over the cells, 1 for one alone, all of them for a uniform
    oscillation, two thirds for a wave between walls, down to four ninths in the plane. `cells`: how many there are.
    `dip`: the least energy of a cell over the largest on the poorer of its sides; 1 or more without a dip. `axes`: in
    how many directions waves run.
    """

    participation: float
    cells: int
    dip: float
    axes: int = 1
    __repr__ = told

    @property
    def bright(self) -> bool:
        """Whether so few cells share the energy that it is no wave."""
        return self.participation <= EXTENDED * WAVE**self.axes * self.cells

    @property
    def fills(self) -> bool:
        """Whether there is a background."""
        return self.participation > BACKGROUND * self.cells

    @property
    def dark(self) -> bool:
        """Whether there is a background, with a dip."""
        return self.fills and self.dip <= DIP

    def __str__(self) -> str:
        return f"{self.participation:.3g} of {self.cells} cells share its energy"

    def why_not(self, kind: str, guess: "Localisation") -> str | None:
        """A sentence on why this is no breather of a kind, "bright", "dark" or "any", or `None` where it is one."""
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
    """The `Localisation` of a state at rest."""
    energies = _cell_energies(lattice, checked_state(one_lattice(lattice), state))
    # a graph of beads that move in the plane fills it
    axes = max(energies.ndim, min(lattice.dimension or 1, 2))
    return Localisation(float(participation(energies.ravel())), energies.size, _dip(energies), axes)


def checked_localised(orbit: Orbit, kind: str, guess: State, throw: bool | None) -> Orbit:
    """A breather with a remark on its localisation; an orbit that is no breather is marked. `kind`: as in `why_not`.

    Of fewer than five cells the remark is all: there is no room for waves and breathers to differ.
    **Raises** RuntimeError with the participation number where it is none and `throw`.
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
    """Energy of each unit cell, over the axes of the lattice; of each site where the lattice has no period."""
    leaves = [np.asarray(e) for e in jax.tree.leaves(site_energy(lattice, state))]
    if any(e.shape != leaves[0].shape for e in leaves):
        return np.concatenate([e.ravel() for e in leaves])
    total = sum(leaves)
    try:
        cell = unit_cell(lattice).cell
    except ValueError:
        return total
    for axis, size in enumerate(cell):
        total = np.add.reduceat(total, np.arange(0, total.shape[axis], size), axis)
    return total


def _dip(energies):
    """The least over all axes."""
    least = np.inf
    for axis in range(energies.ndim):
        e = energies.sum(tuple(i for i in range(energies.ndim) if i != axis))
        if len(e) > 2:
            left, right = np.maximum.accumulate(e)[:-2], np.maximum.accumulate(e[::-1])[::-1][2:]
            beside = np.maximum(np.minimum(left, right), np.finfo(e.dtype).tiny)
            with np.errstate(over="ignore"):  # beside cells at rest
                least = min(least, np.min(e[1:-1] / beside))
    return float(least)
