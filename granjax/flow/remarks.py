"""Remarks on a run that has ended.

They report lost energy, missed pulses, magnets that met, and beads that passed through each other.
"""

import math
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ..base.checks import show
from ..base.programs import compiled, once
from ..base.types import Displacements, Number, Scalar, StateLike, Times
from ..lattice import Lattice, State
from ..solvers.stability import refused_from
from ..strains import WALL
from ..strains.maps import TwoEnds
from ..terms import Dashpot, ViscousContact
from ..terms.base import functions_of_time
from ..terms.base import within as inner_of
from ..terms.chain import span
from ..terms.energies import energy_gap
from ..terms.reach import reads
from .run import Found
from .steps import of_contacts, reachable

# The tolerance from which on there is a remark.
LOOSE = 1e-2
# The relative energy error from which on there is a remark.
SUSPICIOUS = 0.02
# The energy is evaluated again nearby, up to this part of the final displacements away from them.
NEARBY = 1e-3
# The energy may be lost by this many times the rounding seen there.
ROUNDED = 10
# The number of times, about in all, at which a function of time is evaluated.
MOST_PLACES = 2**18
# The fewest and the most of these times in each step.
PLACES = 8, 2048
# The number of steps in which such a function is evaluated at a time.
BLOCK = 64
# A pulse leaves the values at the ends of steps by at least this part of the range.
LEAP = 0.25


def doubts(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    step: Scalar | None,
    tolerance: Any,
    solver: diffrax.AbstractSolver,
    run: Found,
) -> str:
    """Return remarks on a loose tolerance, lost energy or an unknown energy; empty without any."""
    said = []
    if tolerance is not None and tolerance > LOOSE:
        said.append(
            f"A tolerance of {show(tolerance)} is loose: a step may err by that part of the motion."
        )
    lost = np.asarray(run.energy_error)
    # Most calls end here; the rest takes longer.
    if lost.max() <= SUSPICIOUS or not lattice.conserves:
        return " ".join(said)
    if np.isnan(lost).any() and np.all(run.completed):
        ends = [lattice.energy(t, *y) for t, y in ((t0, state), (t1, run.final))]
        gaps = [np.max(energy_gap(term, lattice, t1, run.final.u)) for term in lattice.terms]
        if not np.isfinite(ends).all() or not np.isfinite(gaps).all():
            dtype = lattice.dtype
            said.append(
                f"The energy is larger than any number of {dtype}, or no number at all, so what is lost of it "
                "is not known. Count lengths and times in larger units."
            )
        else:
            name = type(inner_of(lattice.terms[int(np.argmax(gaps))])).__name__
            said.append(
                f"The force of {name} is not the slope of its `energy`: no energy is conserved."
            )
    if not np.isnan(lost).all() and np.nanmax(lost) > SUSPICIOUS:
        if _resolved(lattice, state, t0, t1, run):
            said.append(
                _lost(lattice, state, t0, t1, step, tolerance, solver, float(np.nanmax(lost)))
            )
        else:
            said.append(
                "The energy error is the rounding of `energy`, which does not resolve so small a motion."
            )
    return " ".join(said)


def missed(lattice: Lattice, t0: Scalar, t1: Scalar, step: Any, tolerance: Any) -> str:
    """Return a remark if a function of time without breaks has a pulse that steps may miss.

    Such a pulse leaves the range of the four nearest ends of steps by a quarter of the function's
    range. An adaptive step evaluates many times, so a quarter of the mean step counts. Each step is
    searched at 8 to 2048 times; shorter pulses are not found.
    """
    if not _signals(lattice):
        return ""
    step = np.max(step) / (1 if tolerance is None else 4)
    count = max(int(np.ceil((t1 - t0) / step * (1 - 1e-9))), 1)
    places = int(np.clip(4 ** int(np.log2(MOST_PLACES / count) / 2), *PLACES))
    t0, t1 = (jnp.asarray(t, lattice.dtype) for t in (t0, t1))
    for i, function in _signals(lattice):
        if _leap(function, t0, t1, jnp.asarray(count), places) > LEAP:
            name = type(lattice.terms[i]).__name__
            return (
                f"terms[{i}] ({name}) has a pulse that is shorter than the steps, or swings within one: the run "
                f"may have missed it. Give {name} breaks= where the pulse begins and ends, or simulate a shorter "
                "step=."
            )
    return ""


@once
def _signals(lattice):
    # The functions of time of a lattice, each with the number of its term.
    return [(i, f) for i, term in enumerate(lattice.terms) for f in functions_of_time(term)]


@compiled
def _leap(function, t0, t1, count, places):
    # How far a function of time, within one of equal steps, leaves its values at the nearest ends,
    # relative to its range.
    at = jax.vmap(function)
    h = (t1 - t0) / count
    inner = (np.arange(places) + 0.5) / places

    def one(k):
        ends = at(jnp.clip(t0 + h * (k + np.arange(-1, 3)), t0, t1))
        inside = at(t0 + h * (k + inner))
        low = jnp.minimum(ends.min(0), inside.min(0))
        high = jnp.maximum(ends.max(0), inside.max(0))
        return jnp.maximum(high - ends.max(0), ends.min(0) - low), low, high

    def block(b, found):
        beyond, low, high = jax.vmap(one)(jnp.minimum(b * BLOCK + np.arange(BLOCK), count - 1))
        own = beyond.max(0), low.min(0), high.max(0)
        return tuple(f(*x) for f, *x in zip((jnp.maximum, jnp.minimum, jnp.maximum), found, own))

    beyond, low, high = jax.lax.fori_loop(0, (count - 1) // BLOCK + 1, block, one(0))
    return jnp.max(beyond / jnp.where(high > low, high - low, 1))


def _resolved(lattice, state, t0, t1, run):
    # Whether some lane lost more energy than rounding explains. The rounding shows in the energy
    # along a short straight line through the final displacements, on which the energy hardly bends.
    scale = np.maximum(np.abs(lattice.energy(t0, *state)), lattice.kinetic_energy(state.v))
    parts = 1 + NEARBY * np.linspace(-1, 1, 9)
    line = [
        lattice.potential_energy(t1, jax.tree.map(lambda u: u * part, run.final.u))
        for part in parts
    ]
    rounding = ROUNDED * np.abs(np.diff(np.asarray(line), 2, axis=0)).max(axis=0)
    lost = np.asarray(run.energy_error) * scale
    return bool(np.any((lost > SUSPICIOUS * scale) & ~(lost <= rounding)))


def _lost(lattice, state, t0, t1, step, tolerance, solver, lost):
    limit = None if tolerance is not None else refused_from(solver)
    if limit is not None and step is not None:
        omega, _ = reachable(lattice, state, t0, t1)
        if step * omega > limit:
            return (
                f"Much energy was lost: the step is past stability for frequencies that this energy can reach, "
                f"h omega <= {step * omega:.3g}, where {type(solver).__name__} is stable below {limit:.3g}."
            )
    way = "a shorter step=" if tolerance is None else "a smaller tolerance="
    return f"Much energy was lost or gained, {lost:.2g} of it: the run is not accurate; give {way}."


# Magnets meet at this part of their distance at rest.
TOUCH = 1e-6
# The relative accuracy of lengths: what float32 resolves across a thousand contacts, and the least
# overlap that is reported.
ALIKE = 1e-4
# Pairs are sought this much further apart than touch, relative to the largest diameter.
SKIN = 0.5
# A bond on a line that is longer than this multiple of the median leads around a ring.
AROUND = 1.5
# The most periods of a lattice along two axes and their diagonals. With more, the positions do not
# match the bonds.
REPEATS = 8


@once
def unseen(lattice: Lattice) -> str:
    """Return the names of terms whose contacts do not tell whether they open."""
    names = [type(term).__name__ for term in lattice.terms if not _known(term, lattice)]
    return ", ".join(dict.fromkeys(names))


def _known(term, lattice):
    # Whether the laws of a term tell whether they open. A term without laws does not tell, if it
    # reads displacements.
    def tells(c):
        known = c.law.opens is not None and (c.overlap is not None or not c.law.opens)
        return c.place == "site" or known

    found = of_contacts(tells, (term,), lattice)
    if found:
        return all(found)
    # The contact beside a dashpot is that of another term.
    beside = isinstance(inner_of(term), (Dashpot, ViscousContact))
    return beside or not reads(term, lattice).displacement


def meeting(lattice: Lattice, y: StateLike, t: Number, within: Number) -> tuple | None:
    """Return (bond, term number, time, lane) where magnets meet within a time, or `None`."""
    found = []
    time = jnp.asarray(t, lattice.dtype)

    def rooms(u):
        return [[c.room for c in term.compressions(time, u)] for term in lattice.terms]

    still = rooms(lattice.zeros())
    now, rates = jax.jvp(rooms, (State(*y).u,), (State(*y).v,))
    for number, parts in enumerate(zip(still, now, rates)):
        for rest, room, rate in zip(*parts):
            if room is None:
                continue
            # The shape is (bonds, lanes).
            shape = (-1, int(np.prod(lattice.lanes)))
            rest, room, rate = (x.reshape(shape) for x in np.broadcast_arrays(rest, room, rate))
            left = np.where(rate < 0, room / np.where(rate < 0, -rate, 1), np.inf)
            left = np.where(room <= TOUCH * rest, 0.0, left)
            bond, lane = np.unravel_index(np.argmin(left), left.shape)
            found.append((float(left[bond, lane]), int(bond), number, lane))
    if not found or min(found)[0] > within:
        return None
    left, bond, number, lane = min(found)
    return bond, number, t + left, tuple(map(int, np.unravel_index(lane, lattice.lanes)))


class _Beads(NamedTuple):
    """Beads that may touch without a bond.

    - `places`: at rest, of all sites and then of the beads of the walls
    - `radii` [m]: -inf for a site without contacts
    - `joined`: codes of the pairs with a bond
    - `periods`: vectors by which the lattice repeats
    - `gap`: the least distance at rest between rims without a bond, at most half a diameter
    """

    places: np.ndarray
    radii: np.ndarray
    joined: np.ndarray
    periods: np.ndarray
    gap: float = 0.0


def passing(lattice: Lattice, ts: Times, us: Displacements, end: Displacements) -> str:
    """Return a sentence about beads without a bond that overlap, at the saved times or the end.

    It is empty without such beads, where the lattice does not know the radii (no positions or
    contacts), and where a term does not tell which sites it joins. The run must not be traced.
    """
    lanes = _beads_of(lattice)
    if lanes is None:
        return ""
    gap = np.array([beads.gap for beads in lanes])
    shape = -1, lattice.dimension or 1, len(lanes)
    frames = zip(
        map("at t = {:g}".format, np.asarray(ts)), zip(*map(np.asarray, jax.tree.leaves(us)))
    )
    for when, u in (*frames, ("at the end", jax.tree.leaves(end))):
        u = np.concatenate([np.asarray(x).reshape(shape) for x in u])
        moved = u[:, : lanes[0].places.shape[1]]
        # Nothing can have met before something moved by half of the gap at rest.
        far = 2 * np.linalg.norm(moved, axis=1).max(0) > gap
        for lane in np.flatnonzero(far & np.isfinite(moved).all((0, 1))):
            pairs, apart, touch = _near(lanes[lane], moved[..., lane])
            met = np.flatnonzero(apart < (1 - ALIKE) * touch)
            if not len(met):
                continue
            worst = met[np.argmin(apart[met] / touch[met])]
            index = np.unravel_index(lane, lattice.lanes)
            within = f" in lane {', '.join(map(str, index))}" if index else ""
            first, second = (_site(lattice, i) for i in pairs[worst])
            others = f", and {len(met) - 1} more" if len(met) > 1 else ""
            return (
                f"Beads that have no bond overlap {when}{within}: {first} and {second}, {apart[worst]:.3g} apart "
                f"where they touch at {touch[worst]:.3g}{others}. Bonds are fixed: such beads pass through one another."
            )
    return ""


def _site(lattice, number):
    for name, shape, _ in lattice._cell:
        if number < math.prod(shape):
            index = tuple(map(int, np.unravel_index(number, shape)))
            own = "" if name is None else f" of {name!r}"
            return f"site {index[0] if len(index) == 1 else index}{own}"
        number -= math.prod(shape)
    return "a bead of the wall"


def _near(beads, u):
    # Near pairs of beads without a bond, their distances, and the distances at which they touch.
    count = len(u)
    total = len(beads.places)
    at = np.concatenate([beads.places[:count] + u, beads.places[count:]])
    number = np.concatenate([np.arange(total), *(np.arange(count) for _ in beads.periods)])
    at = np.concatenate([at, *(at[:count] + period for period in beads.periods)])
    reach = (1 + SKIN) * 2 * beads.radii.max()
    pairs = scipy.spatial.cKDTree(at).query_pairs(reach, output_type="ndarray")
    low, high = np.sort(number[pairs], 1).T
    # The first bead is no image, both differ, and no bond joins them.
    apart = (pairs[:, 0] < count) & (low != high) & ~np.isin(low * total + high, beads.joined)
    distance = np.linalg.norm(at[pairs[apart, 0]] - at[pairs[apart, 1]], axis=1)
    return number[pairs[apart]], distance, (beads.radii[low] + beads.radii[high])[apart]


@once
def _beads_of(lattice):
    # The `_Beads` of each lane; `None` for a lattice that does not know their radii.
    if lattice.positions is None:
        return None
    batch = math.prod(lattice.lanes)
    places = []
    numbers = {}
    count = 0
    for (name, shape, _), x in zip(lattice._cell, jax.tree.leaves(lattice.positions)):
        size = math.prod(shape)
        places.append(np.asarray(x).reshape(size, -1, batch))
        numbers[name] = count + np.arange(size).reshape(shape)
        count = count + size
    places = np.concatenate(places)
    if places.shape[1] > (lattice.dimension or 1):
        return None
    numbers = numbers.get(None, numbers)
    bonds = []
    for term in lattice.terms:
        term = inner_of(term)
        strain_map = getattr(term, "strain_map", None)
        pairs = getattr(strain_map, "pairs", strain_map)
        if isinstance(pairs, TwoEnds):
            tail, head = map(np.ravel, pairs.joins(numbers))
            vector = _vectors(lattice, strain_map, places, tail, head)
            touches = np.full(len(tail), _touches(strain_map, term))
            bonds.append((tail, head, vector, touches))
        elif span(term) != () and reads(term, lattice).displacement:
            return None
    if not any(touches.any() for *_, touches in bonds):
        return None
    tail, head, vector, touches = map(np.concatenate, zip(*bonds))
    found = [_one_lane(places[..., i], tail, head, vector[..., i], touches) for i in range(batch)]
    return None if None in found else found


def _vectors(lattice, strain_map, places, tail, head):
    # The vectors from tail to head of all bonds at rest, (bonds, d, lanes); NaN where not known.
    shape = len(tail), *places.shape[1:]
    vector = getattr(strain_map, "vector", None)
    if vector is not None:
        one = np.ndim(vector) - len(lattice.lanes) == 1
        vector = np.asarray(vector).reshape(1 if one else len(tail), -1, shape[2])
    elif lattice.dimension is None:
        vector = places[head] - places[tail]
        wall = (tail == WALL) | (head == WALL)
        length = np.where(wall, np.nan, np.abs(vector[:, 0, 0]))
        near = length < AROUND * np.nanmedian(length)
        vector = np.where(near[:, None, None], vector, np.nan)
    known = vector is not None and vector.shape[1] == shape[1]
    return np.broadcast_to(vector if known else np.nan, shape)


def _touches(strain_map, term):
    # Whether the ends of a bond touch: a contact that opens, or a tangential one.
    law = getattr(term, "law", None)
    if strain_map.tangential or law is None or not law.opens:
        return strain_map.tangential
    room = law.room(0.0)
    return room is None or not np.isfinite(room).all()


def _one_lane(places, tail, head, vector, touches):
    # `None` where the bonds do not tell the radii, or do not match the positions.
    count, d = places.shape
    touches = touches & np.isfinite(vector).all(1)
    inner = (tail != WALL) & (head != WALL)
    number = np.maximum(tail, head)
    length = np.linalg.norm(vector, axis=1)
    radii = _radii(count, tail, head, length, touches)
    if radii is None:
        return None
    near = ALIKE * length[touches].mean()
    # The vector of a bond around a ring differs from that between its ends.
    around = (vector - places[head] + places[tail])[inner & np.isfinite(length)]
    periods = _halves(around[np.abs(around).max(1, initial=0) > near], near)
    if len(periods) > REPEATS:
        return None
    sums = [p + sign * q for i, p in enumerate(periods) for q in periods[:i] for sign in (1, -1)]
    periods = _halves(np.concatenate([periods, np.reshape(sums, (-1, d))]), near)
    at_wall = ~inner & touches & np.isfinite(radii[number])
    ends = np.where((head == WALL)[:, None], places[tail] + vector, places[head] - vector)[at_wall]
    walls, which = _distinct(ends, near)
    rim = np.zeros(len(walls))
    rim[which] = (length - radii[number])[at_wall].clip(0)
    pairs = [np.stack([tail, head])[:, inner], np.stack([number[at_wall], count + which])]
    low, high = np.sort(np.concatenate(pairs, 1), 0)
    beads = _Beads(
        np.concatenate([places, walls]),
        np.concatenate([radii, rim]),
        low * (count + len(walls)) + high,
        periods,
    )
    _, distance, touch = _near(beads, np.zeros((count, d)))
    return beads._replace(gap=(distance - touch).min(initial=SKIN * 2 * beads.radii.max()))


def _radii(count, tail, head, length, touches):
    # The radii whose sums are the lengths of the contacts, as even as possible; -inf for sites
    # without contacts.
    if not touches.any():
        return None
    ends = np.stack([tail, head], 1)[touches]
    known = length[touches]
    mean = known.mean()
    radii = np.full(count, -np.inf)
    if np.ptp(known) <= ALIKE * mean:
        radii[ends[ends != WALL]] = mean / 2
        return radii
    # The radii of beads that touch only walls are not known.
    both = (ends != WALL).all(1)
    ends = ends[both]
    known = known[both]
    if not len(ends):
        return None
    rows = np.repeat(np.arange(len(ends)), 2)
    matrix = scipy.sparse.csr_array(
        (np.ones(2 * len(ends)), (rows, ends.ravel())), shape=(len(ends), count)
    )
    found = (
        mean / 2 + scipy.sparse.linalg.lsqr(matrix, known - mean, atol=ALIKE**2, btol=ALIKE**2)[0]
    )
    if (np.abs(matrix @ found - known) > ALIKE * mean).any() or (found[ends] <= 0).any():
        return None
    radii[ends] = found[ends]
    return radii


def _halves(vectors, near):
    # Different vectors, one of each opposite pair.
    first = np.argmax(np.abs(vectors) > near, 1)[:, None]
    return _distinct(np.sign(np.take_along_axis(vectors, first, 1)) * vectors, near)[0]


def _distinct(points, near):
    # The different points, and the index among them of each given point.
    if not len(points):
        return points, np.zeros(0, int)
    alike = [min(others) for others in scipy.spatial.cKDTree(points).query_ball_point(points, near)]
    first, which = np.unique(alike, return_inverse=True)
    return points[first], which
