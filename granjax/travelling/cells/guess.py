"""Where Newton's method for a wave of a cell begins: the wave of a uniform chain, or a simulated pulse."""

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

# the simulated pulse: cells of the chain, those between which its speed is measured, frames per shortest period
CELLS, FIRST, LAST, FRAMES = 32, 14, 20, 40


class Uniform(NamedTuple):
    """The wave of a uniform chain, and the strain of each bond (P,) over its own."""

    shape: TentShape
    share: np.ndarray

    def at(self, x: np.ndarray) -> np.ndarray:
        """Strains (P, X) of the bonds."""
        return self.share[:, None] * np.asarray(self.shape.at("strain", x))


def uniform(chain: Chain) -> Uniform:
    """The wave of equal bonds in which all masses go along, and which give way as the cell's bonds do in the mean.

    Where there are waves of both signs it has the smaller strains. **Raises** ValueError where there is none.
    """
    law, mass, share = chain.laws[0], chain.total * chain.unit, np.ones(len(chain.masses))
    if chain.stiffness.any():
        # all bonds carry one force
        share = chain.K2[0] / chain.K2
        mass *= share.mean()
    sides = [bounds(law, side) for side in (1, -1)]
    peaks = [reached(law, side, mass) if side.exist else None for side in sides]
    peaks = sorted([x for x in peaks if x is not None], key=abs)
    if peaks and not chain.stiffness.any():
        # as powers of the strain
        F, slope, _ = chain.bonds(np.full((len(share), 1), peaks[0]))[..., 0]
        power = peaks[0] * slope / F
        share = (F[0] / F) ** (1 / power)
        mass *= share.mean() ** power[0]
    side = "tension" if peaks and peaks[0] < 0 else "compression"
    shape = wave_of(Medium(law, mass, {}), 1.0, side=side).shape
    return Uniform(shape, share / share.mean())


def struck(chain: Chain, peak: float) -> tuple[float, float, Callable] | None:
    """The pulse that a blow to the heaviest bead of a cell sends down a chain with free ends; `None` without one.

    `peak`: the strain of a wave of speed 1, about.

    Its speed, half its width, and its strains (P, N) as a function of a box, zero beyond its core.
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
    t, history = np.asarray(run.ts), np.maximum(-np.diff(run.us, axis=1), 0.0)
    if not (np.isfinite(history).all() and history.max() > 0):
        return None

    def centre(cell):
        """When the pulse is mirrored into itself at a cell."""
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
    """How far from the centre a strain falls to a hundredth of its peak."""
    low = np.abs(x[strain < 1e-2 * strain.max()])
    at = np.abs(x[np.argmax(np.where(np.abs(x) < 3, strain, 0))])
    return float(low[low > at].min())


def _first_centroid(t, strain):
    """Mean time of the first pulse of a strain, weighted by its square."""
    top = np.argmax(strain > 0.3 * strain.max())
    gone = np.flatnonzero(strain[top:] < 1e-3 * strain.max())
    weight = strain[: top + (gone[0] if len(gone) else len(t))] ** 2
    return t[: len(weight)] @ weight / weight.sum()
