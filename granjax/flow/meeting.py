"""Where magnets met, of a run that stopped there; and beads that met without a bond."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..lattice import Lattice, State
from ..programs import once
from ..strains import WALL
from ..strains.maps import TwoEnds
from ..terms.base import within as inner_of
from ..terms.chain import span
from ..terms.tracing import reads
from ..types import Displacements, Number, StateLike, Times

# of the distance at rest, which is none
TOUCH = 1e-6
# of a contact's length: what float32 resolves across a thousand of them, and what counts as overlap
ALIKE = 1e-4
# how much further than touch it is looked, over the largest diameter, until something has moved so far
SKIN = 0.5
# the least multiple of the middle length at which a bond on a line leads around a ring
AROUND = 1.5
# vectors by which a lattice repeats itself, along two axes and between; more mean other places than of bonds
REPEATS = 8


def meeting(lattice: Lattice, y: StateLike, t: Number, within: Number) -> tuple | None:
    """(bond, number of its term, time, lane) where a law ends at a length within a time; `None` for nowhere."""
    found, time, lanes = [], jnp.asarray(t, lattice.dtype), len(lattice.lanes)

    def rooms(u):
        return [[c.room for c in term.compressions(time, u)] for term in lattice.terms]

    still = rooms(lattice.zeros())
    now, rates = jax.jvp(rooms, (State(*y).u,), (State(*y).v,))
    for number, parts in enumerate(zip(still, now, rates)):
        for rest, room, rate in zip(*parts):
            if room is None:
                continue
            rest, room, rate = np.broadcast_arrays(rest, room, rate)
            left = np.where(rate < 0, room / np.where(rate < 0, -rate, 1), np.inf)
            left = np.where(room <= TOUCH * rest, 0.0, left)
            own, at = left.shape[: left.ndim - lanes], int(np.argmin(left))
            if left.flat[at] <= within:
                bond, *lane = np.unravel_index(
                    at, (int(np.prod(own)), *left.shape[left.ndim - lanes :])
                )
                found.append((float(left.flat[at]), int(bond), number, tuple(map(int, lane))))
    if not found:
        return None
    left, bond, number, lane = min(found)
    return bond, number, t + left, lane


class _Beads(NamedTuple):
    """What touches without a bond: `places` at rest of beads that move, and then of those of the walls.

    `radii` [m] of all; `sites`: numbers of the beads that move; `joined`: codes of the pairs that have a bond;
    `periods`: vectors by which the lattice repeats itself; `gap`: the least distance between rims without a bond, at
    rest, at most half a diameter.
    """

    places: np.ndarray
    radii: np.ndarray
    sites: np.ndarray
    joined: np.ndarray
    periods: np.ndarray
    gap: float = 0.0


def passing(lattice: Lattice, ts: Times, us: Displacements, end: Displacements) -> str:
    """Which beads without a bond overlap, at the saved times or the end of a run that is not traced, in a sentence.

    Empty where none do, where the lattice does not know the radii of its beads (no positions, no contacts), and where a
    term does not say which sites it joins.
    """
    lanes = _beads_of(lattice)
    if lanes is None:
        return ""
    sites, d = lanes[0].sites, lanes[0].places.shape[1]
    walled = any(len(beads.places) > len(sites) for beads in lanes)
    parts = [
        [np.asarray(x[name] if lattice.fields else x) for name in lattice.fields or (None,)]
        for x in (us, jax.tree.map(lambda x: x[None], end))
    ]
    components, saved = lattice.dimension or 1, len(parts[0][0])
    gap, last = np.array([beads.gap for beads in lanes]), 0
    for frame in range(saved + 1):
        now = [x[frame % saved] for x in parts[frame // saved]]
        u = np.concatenate([x.reshape(-1, components, len(lanes)) for x in now])[sites, :d]
        # as long as nothing has moved by half of the gap since it was found nothing can have met
        moved = u - last
        moved = moved if walled else moved - moved.mean(0)
        far = 4 * (moved * moved).sum(1).max(0) > gap * np.abs(gap)
        last = np.where(far, u, last)
        for lane in np.flatnonzero(far & np.isfinite(u).all((0, 1))):
            gap[lane], pairs, apart, touch = _gaps(lanes[lane], u[..., lane])
            near = apart < (1 - ALIKE) * touch
            if near.any():
                return _overlap_in_words(
                    lattice, np.asarray(ts), frame, lane, pairs[near], apart[near], touch[near]
                )
    return ""


def _overlap_in_words(lattice, ts, frame, lane, pairs, apart, touch):
    index, worst = np.unravel_index(lane, lattice.lanes), int(np.argmin(apart / touch))
    beads = _beads_of(lattice)[lane]
    ts = ts[index] if ts.ndim > 1 else ts
    when = f"at t = {ts[frame]:g}" if frame < ts.size else "at the end"
    within = f" in lane {', '.join(map(str, index))}" if index else ""
    first, second = (
        _site(lattice, beads.sites[i]) if i < beads.sites.size else "a bead of the wall"
        for i in pairs[worst]
    )
    others = f", and {len(pairs) - 1} more" if len(pairs) > 1 else ""
    return (
        f"Beads that have no bond overlap {when}{within}: {first} and {second}, {apart[worst]:.3g} apart where "
        f"they touch at {touch[worst]:.3g}{others}. Bonds are fixed: such beads pass through one another."
    )


def _site(lattice, number):
    """A site in words, from its number in the order of the fields."""
    for name in lattice.fields or (None,):
        shape = lattice.sites if name is None else lattice.sites[name]
        if number < np.prod(shape):
            break
        number -= int(np.prod(shape))
    index = tuple(map(int, np.unravel_index(number, shape)))
    return f"site {index[0] if len(index) == 1 else index}{'' if name is None else f' of {name!r}'}"


def _gaps(beads, u):
    """The least gap between beads without a bond, at most half a diameter; their pairs, distances, and of touch."""
    from scipy.spatial import cKDTree

    count, total = beads.sites.size, len(beads.places)
    at = beads.places + np.pad(u, ((0, total - count), (0, 0)))
    wide = 2 * beads.radii.max()
    images = [at, *(at[:count] + period for period in beads.periods)]
    number = np.concatenate([np.arange(total), *(np.arange(count) for _ in beads.periods)])
    at = np.concatenate(images)
    pairs = cKDTree(at).query_pairs((1 + SKIN) * wide, output_type="ndarray")
    low, high = np.sort(number[pairs], 1).T
    # one of both moves and is no image, and they are not joined
    codes = low * total + high
    joined = beads.joined[np.searchsorted(beads.joined[:-1], codes)] == codes
    apart = (pairs[:, 0] < count) & (low != high) & ~joined
    pairs, touch = pairs[apart], (beads.radii[low] + beads.radii[high])[apart]
    distance = np.sqrt(((at[pairs[:, 0]] - at[pairs[:, 1]]) ** 2).sum(1))
    return (distance - touch).min(initial=SKIN * wide), number[pairs], distance, touch


@once
def _beads_of(lattice):
    """The `_Beads` of each lane; `None` of a lattice that does not know their radii."""
    if lattice.positions is None:
        return None
    names, lanes = lattice.fields or (None,), len(lattice.lanes)
    batch = int(np.prod(lattice.lanes))
    places, numbers, count = [], {}, 0
    for name in names:
        shape = lattice.sites if name is None else lattice.sites[name]
        x = np.asarray(lattice.positions if name is None else lattice.positions[name])
        size = int(np.prod(shape))
        places.append(x.reshape(size, -1, batch))
        numbers[name], count = count + np.arange(size).reshape(shape), count + size
    places = np.concatenate(places)
    if places.shape[1] > (lattice.dimension or 1):
        return None
    numbers, bonds = numbers[None] if None in numbers else numbers, []
    for term in lattice.terms:
        term = inner_of(term)
        strain_map = getattr(term, "strain_map", None)
        pairs = getattr(strain_map, "pairs", strain_map)
        if isinstance(pairs, TwoEnds):
            tail, head = map(np.ravel, pairs.joins(numbers))
            vector = _vectors(strain_map, places, tail, head, lattice.dimension, lanes, batch)
            bonds.append((tail, head, vector, vector is not None and _touches(strain_map, term)))
        elif span(term) != () and reads(term, lattice).displacement:
            return None
    if not any(contact for *_, contact in bonds):
        return None
    found = [
        _one_lane(
            places[..., i], [(t, h, None if v is None else v[..., i], c) for t, h, v, c in bonds]
        )
        for i in range(batch)
    ]
    return None if None in found else found


def _vectors(strain_map, places, tail, head, dimension, lanes, batch):
    """From tail to head of every bond at rest, (bonds, d, lanes); NaN where not known, `None` of other bonds."""
    vector = getattr(strain_map, "vector", None)
    if vector is not None:
        own = np.ndim(vector) - lanes
        vector = np.asarray(vector).reshape(1 if own == 1 else len(tail), -1, batch)
        return np.broadcast_to(vector, (len(tail), *vector.shape[1:]))
    if dimension is not None:
        return None
    vector = places[head] - places[tail]
    length = np.where((tail == WALL) | (head == WALL), np.nan, np.abs(vector[:, 0, 0]))
    return np.where((length < AROUND * np.nanmedian(length))[:, None, None], vector, np.nan)


def _touches(strain_map, term):
    """Whether the ends of a bond are in touch: a contact that opens, or one that slips."""
    law = getattr(term, "law", None)
    if strain_map.tangential or law is None or not law.opens:
        return strain_map.tangential
    room = law.room(0.0)
    return room is None or not np.isfinite(room).all()


def _one_lane(places, bonds):
    """The `_Beads` of one lattice; `None` where its bonds say nothing of radii, or other than its places."""
    count, d = places.shape
    tail, head = (np.concatenate([bond[i] for bond in bonds]) for i in (0, 1))
    unknown = [
        np.full((len(t), d), np.nan) if v is None or v.shape[1] != d else v for t, _, v, _ in bonds
    ]
    vector = np.concatenate(unknown)
    touches = np.concatenate([np.full(len(t), c) for t, *_, c in bonds]) & np.isfinite(vector).all(
        1
    )
    inner, number = (tail != WALL) & (head != WALL), np.maximum(tail, head)
    length = np.sqrt((vector * vector).sum(1))
    radii = _radii(count, tail, head, length, touches, inner)
    if radii is None:
        return None
    size = length[touches].mean()
    # a bond around a ring is another vector than that between the places of its ends
    around = (vector - places[head] + places[tail])[inner & np.isfinite(length)]
    near = ALIKE * size
    periods = _halves(around[np.abs(around).max(1, initial=0) > near], near)
    if len(periods) > REPEATS:
        return None
    sums = [p + sign * q for i, p in enumerate(periods) for q in periods[:i] for sign in (1, -1)]
    periods = _halves(np.concatenate([periods, np.reshape(sums, (-1, d))]), near)
    at_wall = ~inner & touches & np.isfinite(radii[number])
    ends = np.where((head == WALL)[:, None], places[tail] + vector, places[head] - vector)[at_wall]
    walls, which = _distinct(ends, near)
    which = count + which
    rim = np.zeros(len(walls))
    rim[which - count] = (length - radii[number])[at_wall].clip(0)
    codes = np.concatenate(
        [np.stack([tail, head], 1)[inner], np.stack([number[at_wall], which], 1)]
    )
    # beads alone: of a site without a contact nothing is known
    kept = np.flatnonzero(np.isfinite(radii))
    order = np.full(count + len(walls), -1)
    order[kept], order[count:] = np.arange(len(kept)), len(kept) + np.arange(len(walls))
    codes = np.sort(order[codes], 1)
    codes = codes[codes[:, 0] >= 0]
    beads = _Beads(
        np.concatenate([places[kept], walls]),
        np.concatenate([radii[kept], rim]),
        kept,
        np.sort(codes[:, 0] * (len(kept) + len(walls)) + codes[:, 1]),
        periods,
    )
    return beads._replace(gap=_gaps(beads, np.zeros((len(kept), d)))[0])


def _radii(count, tail, head, length, touches, inner):
    """The radii that the lengths of contacts are sums of, the most even ones; NaN of sites that have no contact."""
    if not touches.any():
        return None
    known, radii = length[touches], np.full(count, np.nan)
    mean = known.mean()
    if np.ptp(known) <= ALIKE * mean:
        ends = np.concatenate([tail[touches], head[touches]])
        radii[ends[ends != WALL]] = mean / 2
        return radii
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import lsqr

    both = touches & inner
    ends, row = np.stack([tail[both], head[both]], 1), np.arange(np.count_nonzero(both))
    if not len(row):
        return None
    matrix = coo_array(
        (np.ones(2 * len(row)), (np.repeat(row, 2), ends.ravel())), shape=(len(row), count)
    ).tocsr()
    found = mean / 2 + lsqr(matrix, length[both] - mean, atol=ALIKE**2, btol=ALIKE**2)[0]
    if (np.abs(matrix @ found - length[both]) > ALIKE * mean).any() or (found[ends] <= 0).any():
        return None
    radii[ends] = found[ends]
    return radii


def _halves(vectors, near):
    """Vectors that differ, each one of a pair of opposite ones."""
    first = np.argmax(np.abs(vectors) > near, 1)[:, None]
    return _distinct(np.sign(np.take_along_axis(vectors, first, 1)) * vectors, near)[0]


def _distinct(points, near):
    """The points that differ, and which of these each one is."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(near, output_type="ndarray").T
    graph = coo_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(len(points),) * 2)
    count, which = connected_components(graph)
    kept = np.zeros(count, int)
    kept[which] = np.arange(len(points))
    return points[kept], which
