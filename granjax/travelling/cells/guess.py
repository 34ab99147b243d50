"""Where Newton's method for a wave of a cell begins: a pulse of the chain's own nonlinearity, or a simulated one."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from ...flow import simulate
from ...lattice import Lattice
from ...profiles.fourier import Box, Chain
from ...strains import Shift
from ...terms import Bond
from .tail import decay, stiffness

# compressions that are tried for the peak, over any unit of length
LENGTHS = np.logspace(-40, 40, 8001)
# the simulated pulse: cells of the chain, those between which its speed is measured, frames per shortest period
CELLS, FIRST, LAST, FRAMES = 32, 14, 20, 40


class Peak(NamedTuple):
    """The peak of a pulse: strains of the bonds (P,), and s in F/e - K ~ |e|^s there."""

    strain: np.ndarray
    power: float


def peak(chain: Chain) -> Peak | None:
    """Peak strains of a pulse of speed 1, of the sign whose is lower; `None` where the law has none of that speed.

    All bonds of the cell carry one force f, the mean strain is e: (f/e - K) = (1 + s/2) (1 - K), which is right for a
    weak pulse of quadratic (s = 1) and cubic (s = 2) laws, and within a few percent for Hertz without precompression.
    """
    found = [top for sign in (1.0, -1.0) if (top := _peak(chain, sign)) is not None]
    return min(found, key=lambda top: np.abs(top.strain).mean(), default=None)


def _peak(chain, sign):
    # all masses go with a slow pulse
    P, K = len(chain.masses), stiffness(chain) / chain.total
    with np.errstate(all="ignore"):
        forces = sign * chain.bonds(sign * np.tile(LENGTHS, (P, 1)))[0] / chain.total
        usable = np.all(np.isfinite(forces) & (forces > 0), axis=0)
        usable[1:] &= np.all(np.diff(forces, axis=1) > 0, axis=0)
    first = int(np.argmax(usable))
    last = first + int(np.argmin(np.append(usable[first:], False)))
    if last - first < 9:
        return None
    e, log_f = LENGTHS[first:last], np.log(forces[:, first:last])
    f = np.linspace(log_f[:, 0].max(), log_f[:, -1].min(), 8001)
    each = np.stack([np.exp(np.interp(f, row, np.log(e))) for row in log_f])
    mean = each.mean(0)
    gain = np.exp(f) / mean - K
    with np.errstate(all="ignore"):
        power = np.clip(np.gradient(np.log(gain), np.log(mean)), 0.05, 6)
        past = gain > (1 + power / 2) * (1 - K)
    at = np.argmax(past)
    return Peak(sign * each[:, at], float(power[at])) if at else None


def pulse(chain: Chain, box: Box, top: Peak) -> np.ndarray:
    """Strains (P, N) of the form sech^(2/s)(s q x/2) with the decay rate q of the linear tail."""
    argument = np.minimum(top.power * decay(chain) * np.abs(box.x) / 2, 300.0)
    with np.errstate(over="ignore"):
        return top.strain[:, None] / np.cosh(argument) ** (2 / top.power)


def struck(chain: Chain, top: Peak) -> tuple[float, float, Callable] | None:
    """The pulse that a blow to the heaviest bead of a cell sends down a chain with free ends; `None` without one.

    Its speed, half its width, and its strains (P, N) as a function of a box, zero beyond its core.
    """
    P = len(chain.masses)
    sites = P * CELLS
    law = jax.tree.map(lambda *x: np.resize(x, sites - 1), *chain.laws)
    bond = Bond(Shift(1, "free"), law)
    lattice = Lattice(chain.unit * np.tile(chain.masses, CELLS), bond, sites=sites)
    u, v = np.zeros((2, sites))
    v[np.argmax(chain.masses)] = 1.6 * top.strain.mean()
    stiffest = np.abs(chain.bonds(2 * np.tile(top.strain[:, None], 2))[1]).max()
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
