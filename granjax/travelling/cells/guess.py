"""Starting points of Newton's method: the wave of a uniform chain, or a simulated pulse."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from ...flow import simulate
from ...lattice import Lattice
from ...profiles import Medium, TentShape, wave_of
from ...profiles.existence import bounds, reached
from ...profiles.fourier import Chain
from ...strains import Shift
from ...terms import Bond

# The cells of the chain in which a pulse is simulated.
CELLS = 32
# The first of the two cells between which its speed is measured.
FIRST = 14
# The second of these cells.
LAST = 20
# The frames of the run per shortest period.
FRAMES = 40


class Uniform(NamedTuple):
    """The wave of a uniform chain, and the ratio (P,) of each bond's strain to it."""

    shape: TentShape
    share: np.ndarray

    def at(self, x: np.ndarray) -> np.ndarray:
        """Return the strains (P, X) of the bonds."""
        return self.share[:, None] * np.asarray(self.shape.at("strain", x))


def uniform(chain: Chain) -> Uniform:
    """Return the wave of the uniform chain with the cell's mean total mass and mean compliance.

    Of two waves of opposite signs it is that of smaller strains. **Raises** ValueError where there
    is none.
    """
    law = chain.laws[0]
    mass = chain.total * chain.unit
    share = np.ones(len(chain.masses))
    if chain.stiffness.any():
        # All bonds carry the same force.
        share = chain.K2[0] / chain.K2
        mass *= share.mean()
    sides = [bounds(law, side) for side in (1, -1)]
    peaks = [reached(law, side, mass) if side.exist else None for side in sides]
    peaks = sorted([x for x in peaks if x is not None], key=abs)
    if peaks and not chain.stiffness.any():
        # Near the peak each law is approximated by a power of the strain.
        F, slope, _ = chain.bonds(np.full((len(share), 1), peaks[0]))[..., 0]
        power = peaks[0] * slope / F
        share = (F[0] / F) ** (1 / power)
        mass *= share.mean() ** power[0]
    side = "tension" if peaks and peaks[0] < 0 else "compression"
    shape = wave_of(Medium(law, mass, {}), 1.0, side=side).shape
    return Uniform(shape, share / share.mean())


def struck(chain: Chain, peak: float) -> tuple[float, float, Callable] | None:
    """Simulate the pulse after a blow to a cell's heaviest bead in a chain with free ends.

    `peak`: the approximate strain of a wave of speed 1.

    Return its speed, half its width, and its strains (P, N) as a function of a box, zero beyond the
    core; `None` without a pulse.
    """
    P = len(chain.masses)
    sites = P * CELLS
    law = jax.tree.map(lambda *x: np.resize(x, sites - 1), *chain.laws)
    bond = Bond(Shift(1, "free"), law)
    lattice = Lattice(chain.unit * np.tile(chain.masses, CELLS), bond, sites=sites)
    u, v = np.zeros((2, sites))
    v[np.argmax(chain.masses)] = 1.6 * peak
    stiffest = np.abs(chain.bonds(np.full((P, 2), 2 * peak))[1]).max()
    frames = int(1.5 * sites * FRAMES * np.sqrt(stiffest / chain.masses.min()) / np.pi)
    run = simulate(lattice, (u, v), 1.5 * sites, save_at=frames)
    t = np.asarray(run.ts)
    history = np.maximum(-np.diff(run.us, axis=1), 0.0)
    if not (np.isfinite(history).all() and history.max() > 0):
        return None

    # The time at which the pulse is its own mirror image at a cell.
    def centre(cell):
        bonds = P * cell + np.arange(P)
        partners = P * cell + chain.mirror - 1 - np.arange(P)
        return np.mean([_first_centroid(t, history[:, b]) for b in (*bonds, *partners)])

    middle = centre(FIRST)
    speed = P * (LAST - FIRST) / (centre(LAST) - middle)
    x = (np.arange(P) + 0.5 - chain.mirror / 2)[:, None] - speed * (t - middle)
    strain = history[:, P * FIRST + np.arange(P)].T
    width = max(_width(*row) for row in zip(x, strain))

    def on(box):
        rows = [np.interp(box.x, at[::-1], e[::-1], 0.0, 0.0) for at, e in zip(x, strain)]
        return np.where(np.abs(box.x) < width + 1.5, np.stack(rows), 0.0)

    return speed, width, on


def _width(x, strain):
    low = np.abs(x[strain < 1e-2 * strain.max()])
    at = np.abs(x[np.argmax(np.where(np.abs(x) < 3, strain, 0))])
    return float(low[low > at].min())


def _first_centroid(t, strain):
    top = np.argmax(strain > 0.3 * strain.max())
    gone = np.flatnonzero(strain[top:] < 1e-3 * strain.max())
    weight = strain[: top + (gone[0] if len(gone) else len(t))] ** 2
    return t[: len(weight)] @ weight / weight.sum()
