"""Wave numbers between which waves of a modulated chain grow: gaps in k, their edges by root-finding."""

from typing import Any

import numpy as np

from ..tuning import one_thread

EPS = np.finfo(float).eps
# how far a multiplier may turn between two samples [rad], and how many there are
TURN, FEWEST, MOST = 0.2, 24, 1536
# products of two signatures above: multipliers that pass each other
SAME = 1e-3
# rounds of the search for a root, and for a largest value, and how near the latter comes
ROUNDS, CLOSING, NEAR = 40, 12, 1e-3
# s of two multipliers that do not meet
APART = -1e-3
# of the slope at an edge, in parts of the gap
ASIDE = 1e-3
# of a map's own error, for what is told from zero
TOLD = 50


class _Look:
    """What is asked of the waves at k: how unstable they are, and how near to becoming so.

    Without losses that is s = (rho_a - rho_b)^2/(rho_a rho_b) of the pair whose s is largest among those of opposite
    signature: real and smooth in k, negative on the unit circle and positive off it, so that its zeros are the edges.
    With losses it is log|rho| of the largest multiplier.
    """

    def __init__(self, known: Any):
        self.known = known

    def at(self, k: np.ndarray) -> np.ndarray:
        """f at some k."""
        return self._chosen(self._numbers(self.known.fine(k[:, None])))

    def near(self, k: np.ndarray) -> np.ndarray:
        """s of the pair that is nearest to collision."""
        return self._numbers(self.known.fine(k[:, None]))[0]

    def growth(self, k: np.ndarray) -> np.ndarray:
        """log|rho| of the largest multiplier."""
        return self._numbers(self.known.fine(k[:, None]))[1]

    def told(self, k: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """f, what is told from zero in it, its change by larger steps, and s."""
        fine, coarse, about = self.known.levels(k[:, None])
        found, size = self._numbers(fine), np.linalg.norm(fine, axis=(1, 2))
        least = TOLD * about * (np.maximum(1, size) if self.known.conserves else 1)
        return (
            self._chosen(found),
            least,
            np.abs(self._chosen(found) - self._chosen(self._numbers(coarse))),
            found[0],
        )

    def rounding(self, k: np.ndarray) -> np.ndarray:
        """That of f."""
        size = np.linalg.norm(self.known.fine(k[:, None]), axis=(1, 2))
        return 4 * self.known.eps * size * (np.maximum(1, size) if self.known.conserves else 1)

    def _chosen(self, numbers):
        return numbers[0 if self.known.conserves else 1]

    def _numbers(self, maps):
        rho, vectors = np.linalg.eig(maps)
        half = maps.shape[1] // 2
        q, p = vectors[:, :half], vectors[:, half:]
        sign = 2 * np.sum(np.imag(np.conj(q) * p), axis=1)
        a, b = np.triu_indices(2 * half, 1)
        ratio = rho[:, a] / rho[:, b]
        near = np.real(ratio - 2 + 1 / ratio)
        near = np.where(sign[:, a] * sign[:, b] <= SAME, near, -4.0).max(1)
        return near, np.log(np.abs(rho)).max(1)


@one_thread
def gaps_of(known: Any, k: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Edges (gaps, 2), their errors, k of the fastest growth and its rate, of the gaps that meet the span of k."""
    look = _Look(known)
    inside, edges, errors = _half_zone(look, known)
    peak_k, peak = _fastest(look, edges)
    found = _over(edges, errors, peak_k, peak / float(known.period), float(k.min()), float(k.max()))
    return (
        tuple(
            np.array(x, float).reshape(shape)
            for x, shape in zip(zip(*found), ((-1, 2), (-1, 2), -1, -1))
        )
        if found
        else (np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    )


def _half_zone(look, known):
    """The gaps of 0 <= k <= pi: those of -k are the same; one that reaches beyond 0 or pi is its own mirror image."""
    reach = max(abs(n) for R in known.cell.shells for n in R)
    count = int(np.clip(np.pi * known.turned * reach / TURN / max(known.cell.cell), FEWEST, MOST))
    grid = np.linspace(0, np.pi, count + 1)
    f, doubt, _, near = look.told(grid)
    # between two samples a gap may hide: there the nearest pair comes nearest
    around = np.concatenate([near[1:2], near, near[-2:-1]])
    hidden = np.flatnonzero((f <= doubt) & (near >= around[:-2]) & (near >= around[2:]))
    if len(hidden):
        places = _largest(look.near, grid[hidden], grid[1], APART)
        more = look.told(places)
        grid, order = np.unique(np.concatenate([grid, places]), return_index=True)
        f, doubt = (np.concatenate([x, y])[order] for x, y in ((f, more[0]), (doubt, more[1])))
    unstable = f > doubt
    starts = np.flatnonzero(unstable & ~np.concatenate([[False], unstable[:-1]]))
    ends = np.flatnonzero(unstable & ~np.concatenate([unstable[1:], [False]]))
    sides = [(i, grid[i - 1], grid[i]) for i in starts if i]
    sides += [(i, grid[i + 1], grid[i]) for i in ends if i < len(grid) - 1]
    roots, errors = _edges(look, np.array([s[1] for s in sides]), np.array([s[2] for s in sides]))
    low = {s[0]: (r, e) for s, r, e in zip(sides, roots, errors) if s[1] < s[2]}
    high = {s[0]: (r, e) for s, r, e in zip(sides, roots, errors) if s[1] > s[2]}
    edges, known_to = [], []
    for a, b in zip(starts, ends):
        # beyond the ends of the zone's half gaps are mirror images
        (right, e_right) = high.get(b, (None, None))
        (left, e_left) = low.get(a, (None, None))
        if left is None and right is None:
            left, right, e_left, e_right = -np.pi, np.pi, 0.0, 0.0
        elif left is None:
            left, e_left = -right, e_right
        elif right is None:
            right, e_right = 2 * np.pi - left, e_left
        edges.append((left, right))
        known_to.append((e_left, e_right))
    return unstable, np.array(edges).reshape(-1, 2), np.array(known_to).reshape(-1, 2)


def _largest(f, k, width, least=-np.inf):
    """Where f is largest within a width of some k: through three points a parabola, again and again.

    One whose top is seen to lie below `least` is left where it is.
    """
    k, left = np.array(k, float), np.arange(len(k))
    width = np.broadcast_to(width, k.shape)
    for i in range(CLOSING):
        h = width[left] * 0.5 ** (i + 1)
        points = np.stack([k[left] - h, k[left], k[left] + h])
        low, at, high = f(points.ravel()).reshape(3, -1)
        bend = low - 2 * at + high
        move = np.where(
            bend < 0, h * (low - high) / np.where(bend < 0, 2 * bend, 1), np.sign(high - low) * h
        )
        move = np.clip(move, -h, h)
        k[left] += move
        top = at + (high - low) * move / (4 * h)
        left = left[(np.abs(move) > NEAR * h) & ((top > least) | (i == 0))]
        if not len(left):
            break
    return k


def _edges(look, outside, inside):
    """Roots of f between k where no wave grows and where one does, by regula falsi of Illinois, and their errors."""
    if not len(outside):
        return np.zeros(0), np.zeros(0)
    a, b = outside.copy(), inside.copy()
    fa, fb = np.minimum(look.at(a), 0), look.at(b)
    rounding, last, k = look.rounding(b), np.zeros(len(a), int), a
    for _ in range(ROUNDS):
        before, k = k, np.where(fb == fa, a, a - fa * (b - a) / np.where(fb == fa, 1, fb - fa))
        f = look.at(k)
        out = f <= 0
        # a side that stays weighs half
        fb = np.where(out & (last == 1), fb / 2, fb)
        fa = np.where(~out & (last == -1), fa / 2, fa)
        a, fa, b, fb = (
            np.where(out, k, a),
            np.where(out, f, fa),
            np.where(out, b, k),
            np.where(out, fb, f),
        )
        last = np.where(out, 1, -1)
        if np.all(
            (np.abs(f) <= rounding) | (np.abs(k - before) <= 4 * EPS * np.maximum(np.abs(k), 1))
        ):
            break
    f, doubt, change, _ = look.told(k)
    step = ASIDE * (inside - k)
    aside = look.at(k + step)
    slope = np.abs((aside - f) / np.where(step == 0, 1, step))
    missed = np.abs(f) + 4 * change + doubt / TOLD
    return k, missed / np.where(slope > 0, slope, np.nan) + 4 * EPS * np.abs(k)


def _fastest(look, edges):
    """Where waves grow fastest in each gap, and log|rho| there."""
    if not len(edges):
        return np.zeros(0), np.zeros(0)
    # of two mirror images the one in 0 <= k <= pi
    edges, share = np.clip(edges, 0, np.pi), np.linspace(0, 1, 19)
    k = edges[:, :1] + (edges[:, 1:] - edges[:, :1]) * share
    found = look.growth(k.ravel()).reshape(k.shape)
    best = np.take_along_axis(k, found.argmax(1)[:, None], 1)[:, 0]
    best = _largest(look.growth, best, (edges[:, 1] - edges[:, 0]) * share[1])
    return best, look.growth(best)


def _over(edges, errors, peak_k, peak, low, high):
    """The gaps, their mirror images, and those of other zones, as far as they meet a span, in order."""
    found, turn = {}, 2 * np.pi
    for (a, b), (ea, eb), k, rate in zip(edges, errors, peak_k, peak):
        for left, right, e, place in ((a, b, (ea, eb), k), (-b, -a, (eb, ea), -k)):
            for n in range(
                int(np.floor((low - right) / turn)), int(np.ceil((high - left) / turn)) + 1
            ):
                if right + n * turn >= low and left + n * turn <= high:
                    key = round(left + n * turn, 9), round(right + n * turn, 9)
                    found.setdefault(
                        key, ((left + n * turn, right + n * turn), e, place + n * turn, rate)
                    )
    return [found[key] for key in sorted(found)]
