"""Gaps in k of a modulated chain, in which waves grow, with their edges by root-finding."""

from typing import Any

import numpy as np

from ..base.tuning import one_thread

EPS = np.finfo(float).eps
# how far a multiplier may turn between two samples [rad]
TURN = 0.2
# the fewest samples of half a zone
FEWEST = 24
# the most samples of half a zone
MOST = 1536
# the samples of a gap, from which the fastest growth in it is sought
WITHIN = 19
# multipliers whose signatures have a product above this pass each other without a gap
SAME = 1e-3
# the step for the slope at an edge, as a part of the distance between two samples
ASIDE = 1e-3
# a number differs from zero where it exceeds this many times the error of the map
TOLD = 50
# the digits to which two mirror images of one gap agree
DIGITS = 9


@one_thread
def gaps_of(known: Any, k: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return edges (gaps, 2), errors, k and rate of fastest growth, of gaps in the span of k."""
    edges, errors = _half_zone(known)
    fastest, growth = _fastest(known, edges)
    half = np.column_stack([edges, errors, fastest, growth / float(known.period)])
    mirrored = half[:, [1, 0, 3, 2, 4, 5]] * [-1, -1, 1, 1, -1, 1]
    # in all zones that the span may touch
    turns = np.arange(k.min() // (2 * np.pi) - 1, k.max() // (2 * np.pi) + 2)
    moves = 2 * np.pi * turns[:, None, None] * [1, 1, 0, 0, 1, 0]
    rows = (moves + np.concatenate([half, mirrored])).reshape(-1, 6)
    rows = rows[(rows[:, 0] <= k.max()) & (rows[:, 1] >= k.min())]
    # a gap around 0 or pi is its own mirror image
    rows = rows[np.unique(rows[:, :2].round(DIGITS), axis=0, return_index=True)[1]]
    return rows[:, :2], rows[:, 2:4], rows[:, 4], rows[:, 5]


# s = (rho_a - rho_b)^2/(rho_a rho_b) of the pair of opposite signature with the largest s. It is
# real and smooth in k, negative on the unit circle and positive off it, so that its zeros are the
# edges of gaps. The instability is s without losses, and log|rho| with them or gyroscopic forces.
def _look(known, maps):
    # Return the instability, the nearness s, and the largest log|rho|, of maps (K, 2P, 2P).
    rho, vectors = np.linalg.eig(maps)
    half = maps.shape[1] // 2
    sign = 2 * np.sum(np.imag(np.conj(vectors[:, :half]) * vectors[:, half:]), axis=1)
    a, b = np.triu_indices(2 * half, 1)
    ratio = rho[:, a] / rho[:, b]
    near = np.where(sign[:, a] * sign[:, b] <= SAME, np.real(ratio - 2 + 1 / ratio), -4.0).max(1)
    growth = np.log(np.abs(rho)).max(1)
    return near if known.conserves else growth, near, growth


def _told(known, k):
    # Return the instability at k, the least that counts, its change with larger steps, and s.
    fine, coarse, about = known.levels(k[:, None])
    unstable, near, _ = _look(known, fine)
    size = np.maximum(1, np.linalg.norm(fine, axis=(1, 2))) if known.conserves else 1
    return unstable, TOLD * about * size, np.abs(unstable - _look(known, coarse)[0]), near


def _half_zone(known):
    # the gaps of 0 <= k <= pi; one that reaches beyond 0 or pi is its own mirror image
    reach = max(abs(n) for R in known.cell.shells for n in R)
    count = int(np.clip(np.pi * known.turned * reach / TURN / max(known.cell.cell), FEWEST, MOST))
    k = np.linspace(0, np.pi, count + 1)
    f, doubt, _, near = _told(known, k)
    # a gap may hide between two samples, where s has a local maximum
    before = np.append(near[1], near[:-1])
    after = np.append(near[1:], near[-2])
    hidden = k[(f <= doubt) & (near >= before) & (near >= after)]
    if len(hidden):
        more = _largest(known, 1, hidden, k[1])
        k, order = np.unique(np.concatenate([k, more]), return_index=True)
        f, doubt = (np.concatenate(x)[order] for x in zip((f, doubt), _told(known, more)))
    grows = np.concatenate([[False], f > doubt, [False]])
    starts = np.flatnonzero(grows[1:] & ~grows[:-1])
    ends = np.flatnonzero(grows[:-1] & ~grows[1:]) - 1
    begins = starts > 0
    stops = ends < len(k) - 1
    edges, errors = np.full((2, len(starts), 2), np.nan)
    edges[begins, 0], errors[begins, 0] = _edges(known, k[starts[begins] - 1], k[starts[begins]])
    edges[stops, 1], errors[stops, 1] = _edges(known, k[ends[stops] + 1], k[ends[stops]])
    errors = np.where(np.isnan(errors), errors[:, ::-1], errors)
    low = np.where(begins, edges[:, 0], np.where(stops, -edges[:, 1], -np.pi))
    high = np.where(stops, edges[:, 1], np.where(begins, 2 * np.pi - low, np.pi))
    return np.stack([low, high], 1), np.where(np.isnan(errors), 0.0, errors)


def _largest(known, which, k, width):
    # refine local maxima k of one output of `_look`, within a width
    from scipy.optimize.elementwise import find_minimum

    found = find_minimum(
        lambda k: -_look(known, known.maps(k[:, None]))[which], (k - width, k, k + width)
    )
    return np.where(found.success, found.x, k)


def _edges(known, outside, inside):
    # roots between k without growth and k with growth, and their errors
    from scipy.optimize.elementwise import find_root

    if not len(outside):
        return np.zeros((2, 0))

    # log|rho| outside is rounding of either sign where nothing damps, so that a gap begins there
    # where growth exceeds it
    f, doubt, _, _ = _told(known, outside)
    least = np.where(known.conserves | (f < -doubt), 0.0, 1.0)

    def unstable(k, outside, least):
        if least.any():
            f, doubt, _, _ = _told(known, k)
            f = f - least * doubt
        else:
            f = _look(known, known.maps(k[:, None]))[0]
        return np.where(k == outside, np.minimum(f, -1e-300), f)

    k = find_root(unstable, (outside, inside), args=(outside, least)).x
    f, doubt, change, _ = _told(known, k)
    step = ASIDE * (inside - k)
    rise = unstable(k + step, np.nan, least) - (f - least * doubt)
    slope = np.abs(rise / np.where(step == 0, 1, step))
    missed = np.abs(f) + 4 * change + np.maximum(least, 1 / TOLD) * doubt
    return k, missed / np.where(slope > 0, slope, np.nan) + 4 * EPS * np.abs(k)


def _fastest(known, edges):
    # Return where waves grow fastest in each gap, and log|rho| there.
    if not len(edges):
        return np.zeros((2, 0))
    # take the mirror image in 0 <= k <= pi
    low, high = np.clip(edges, 0, np.pi).T
    k = np.linspace(low, high, WITHIN, axis=1)
    growth = _look(known, known.maps(k.reshape(-1, 1)))[2].reshape(k.shape)
    best = np.take_along_axis(k, growth.argmax(1)[:, None], 1)[:, 0]
    best = _largest(known, 2, best, k[:, 1] - k[:, 0])
    return best, _look(known, known.maps(best[:, None]))[2]
