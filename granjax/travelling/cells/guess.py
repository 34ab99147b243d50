"""Where Newton's method for a wave of a cell begins: a pulse of the chain's own nonlinearity, or a simulated one."""

from typing import NamedTuple

import numpy as np

from ...profiles.fourier import Box, Chain, heaviness
from .tail import decay, stiffness

# compressions that are tried for the peak, over any unit of length
LENGTHS = np.logspace(-40, 40, 8001)
# the simulated pulse: cells of the chain, those between which its speed is measured, steps per shortest period
CELLS, FIRST, LAST, STEPS = 32, 14, 20, 40


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
    # all masses that go with a slow pulse
    total = heaviness(chain, np.zeros(1)).mean()
    P, K = len(chain.masses), stiffness(chain) / total
    with np.errstate(all="ignore"):
        forces = sign * chain.force(sign * np.tile(LENGTHS, (P, 1))) / total
        usable = np.all(np.isfinite(forces) & (forces > 0), axis=0)
        usable[1:] &= np.all(np.diff(forces, axis=1) > 0, axis=0)
        begin = usable
        if K > 0:
            # below some length a force that a preload is taken from has no digits
            linear = np.all(np.abs(forces / LENGTHS * total / chain.K2[:, None] - 1) < 1e-3, axis=0)
            begin = np.convolve(linear & usable, np.ones(20), "full")[19:][: len(usable)] > 19.5
    first = int(np.argmax(begin))
    last = first + int(np.argmin(np.append(usable[first:], False)))
    own = slice(first, last)
    if not begin.any() or last - first < 9:
        return None
    e, log_f = LENGTHS[own], np.log(forces[:, own])
    f = np.linspace(log_f[:, 0].max(), log_f[:, -1].min(), 8001)
    each = np.stack([np.exp(np.interp(f, row, np.log(e))) for row in log_f])
    mean = each.mean(0)
    gain = np.exp(f) / mean - K
    with np.errstate(all="ignore"):
        power = np.gradient(np.log(gain), np.log(mean))
        past = gain > (1 + np.clip(power, 0.05, 6) / 2) * (1 - K)
    # above the digits that F/e - K loses near equilibrium
    past &= gain > 1e-6 * K
    if not past.any() or past[0] or not np.argmax(past):
        return None
    at = np.argmax(past)
    return Peak(sign * each[:, at], float(np.clip(power[at], 0.05, 6)))


def pulse(chain: Chain, box: Box, top: Peak):
    """Strains (P, N) of the form sech^(2/s)(s q x/2) with the decay rate q of the linear tail."""
    argument = np.minimum(top.power * decay(chain) * np.abs(box.x) / 2, 300.0)
    with np.errstate(over="ignore"):
        return top.strain[:, None] / np.cosh(argument) ** (2 / top.power)


class Struck(NamedTuple):
    """A simulated pulse: its speed, places x (P, T) of the bonds behind its centre, strains there, half its width."""

    speed: float
    x: np.ndarray
    strain: np.ndarray
    width: float


def struck(chain: Chain, top: Peak) -> Struck | None:
    """The pulse that a blow to the heaviest bead of a cell sends down a chain with free ends; `None` without one."""
    P = len(chain.masses)
    slope = np.abs(chain.slope(2 * np.tile(top.strain[:, None], 2))).max()
    step = np.pi / np.sqrt(slope / chain.masses.min()) / STEPS
    masses, sites = np.tile(chain.masses, CELLS), P * CELLS
    u, v = np.zeros(sites), np.zeros(sites)
    v[np.argmax(chain.masses)] = 1.6 * top.strain.mean()
    seen, after = [], 0

    def force(u):
        e = np.append(u[:-1] - u[1:], -1e-300)
        f = np.asarray(chain.force(e.reshape(CELLS, P).T)).T.ravel()
        return e, np.append(0.0, f[:-1]) - np.append(f[:-1], 0.0)

    e, pull = force(u)
    while after < 6 * P / step and len(seen) < 8 * sites / step:
        v += step / 2 * pull / masses
        u += step * v
        e, pull = force(u)
        v += step / 2 * pull / masses
        seen.append(e)
        # until the pulse has left the last cell that counts by some cells
        after += e[P * (LAST + 5)] > 0.05 * top.strain.mean() or after > 0
    history = np.maximum(np.array(seen), 0.0)
    t = step * np.arange(len(history))
    return (
        _measured(chain, t, history, P)
        if np.isfinite(history).all() and history.max() > 0
        else None
    )


def _measured(chain, t, history, P):
    def centre(cell):
        """When the pulse is mirrored into itself at a cell."""
        bonds = P * cell + np.arange(P)
        partners = P * cell + chain.mirror - 1 - np.arange(P)
        return np.mean([_first_centroid(t, history[:, b]) for b in (*bonds, *partners)])

    middle = centre(FIRST)
    speed = P * (LAST - FIRST) / (centre(LAST) - middle)
    bonds = P * FIRST + np.arange(P)
    x = bonds[:, None] + 0.5 - (P * FIRST + chain.mirror / 2) - speed * (t - middle)
    strain = history[:, bonds].T
    return Struck(speed, x, strain, max(_width(*row) for row in zip(x, strain)))


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


def from_struck(found: Struck, box: Box):
    """Strains (P, N) of a simulated pulse on a box, zero beyond its core."""
    rows = [np.interp(box.x, x[::-1], e[::-1], 0.0, 0.0) for x, e in zip(found.x, found.strain)]
    return np.where(np.abs(box.x) < found.width + 1.5, np.stack(rows), 0.0)
