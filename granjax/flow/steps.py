"""The choice of a fixed step, and the bound on the highest frequency that sets the default one.

A bond gathers at most the energy that its neighbourhood holds at the start, which limits its
compression. The largest stiffness k_b = F'(x) in that range makes a matrix |K| = sum |B|^T k |B|
without signs, and for every positive w

    omega_max^2 <= max_i (M^-1 |K| w)_i / w_i                                   (Collatz, Wielandt),

exact for chains of next neighbours if w is the leading vector; a few power steps come close. Terms
without such a matrix add their largest eigenvalue. The neighbourhood is a rule of thumb, which is
checked at the end of the run.
"""

import inspect
import math
from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import most, trailing
from ..base.checks import concrete, refuse, traced, whole
from ..base.programs import compiled, concretely, library, once
from ..base.types import Count, Displacements, Number, Numbers, Scalar, StateLike, Times
from ..lattice import Lattice
from ..solvers.stability import refused_from
from ..terms import Reach, Term, Wall
from ..terms.base import Excitation, within
from ..terms.chain import next_neighbours, span, walls
from ..terms.energies import site_energy
from ..terms.reach import per_lane, reads, time_of
from ..terms.waveforms import count_breaks
from .arguments import checked_state, checked_times, facts, number, rounding_unit

# The steps of power iteration for a bound on the frequencies.
POWER_STEPS = 40
# The steps of power iteration for a check after a run. They are few, since an error of a tenth does
# not mislead it.
FEW_STEPS = 12
# The number of times at which drives, moving walls and modulations are evaluated for such a bound.
SAMPLES = 257
# The neighbourhood, in lengths of a bond, from which energy may gather in a bond.
NEIGHBOURHOOD = 16
# Speeds below this part of the largest count as zero.
ROUNDING = 1e-12
# Where contacts open all over a lattice, every method has order 5/2, so the steps are shorter by
# this factor.
OPENING = 2.0
# Extension and compression.
BOTH = np.ones(2, bool)
# h omega of the default step.
STEP_FRACTION = 0.5
# The neighbourhoods, in lengths of a bond, from which energy may gather in a bond, where the run is
# checked at its end. The second one is for a law without a floor.
GATHERED = (4, 1)
# A run at the default step is repeated if it passed its bound by more than this factor.
PASSED = 1.1
# A default step of which a run would take more than this many is refused as useless.
MOST_STEPS = 1e8
# Above this number of default steps the second neighbourhood is tried too.
MANY_STEPS = 1e6
# It is taken if its bound is lower by this factor: the law of the first one has no floor.
FLOORLESS = 1e3
# Below this part of a run's length, the rounding of t0 does not matter.
NEAR = 1e-9
# A step spans at least this many rounding units of t0, since the user can avoid that loss of
# accuracy with t0 = 0.
UNITS_AT_START = 256
# It also spans this many rounding units of the later of t0 and t1, so that steps change the time.
# More is not asked, as long runs lose accuracy in other ways.
UNITS_AT_END = 4


class Steps(NamedTuple):
    """Equal steps: their size, number (`None` while traced), how they were chosen, and a remark.

    `allowed`: the h omega that the run may reach, if it may pass the bound that set the step, so
    that it must be checked at the end; else `None`.
    """

    size: Number
    count: int | None
    choice: str
    remark: str
    allowed: float | None


def fixed_step(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    step: Scalar | None,
    solver: diffrax.AbstractSolver | type,
    frames: int,
    bound: Any = None,
) -> Steps:
    """Return the steps of a run, a whole number of them in each of the equal frames.

    `bound`: the highest frequency that a run has shown; by default that of the lattice's energy.
    """
    about = facts(lattice)
    limit = refused_from(solver)
    allowed = None
    if step is None:
        bound, watch = reachable(lattice, state, t0, t1) if bound is None else (bound, True)
        bound = chosen(bound)
        if not isinstance(bound, jax.core.Tracer) and not bound > 0:
            if math.isnan(bound):
                refuse("lattice", "finite parameters", "a stiffness that is not a number")
            refuse(
                "step",
                "a time step",
                "None",
                "Nothing is stiff at this energy (a sonic vacuum at rest?), so no time scale sets one: give step=.",
            )
        fraction = min(STEP_FRACTION, limit or STEP_FRACTION)
        step = fraction / bound
        allowed = PASSED * fraction if watch else None
        choice = f"default step, h omega_max <= {fraction:.3g}"
        if not traced((step, t0, t1)) and useless(step, t0, t1):
            refuse(
                "step",
                "a time step",
                "None",
                f"The bound on the stiffness at this energy asks for steps of {step:.1e}: no useful one (a law "
                "without a floor, or far more energy than moves). Give step= or tolerance=.",
            )
    else:
        choice = "given step"
        if limit is not None and not (about.traced or traced((state, step, t0, t1))):
            _refuse_unstable(lattice, state, t0, t1, step, solver, limit)
        if isinstance(step, jax.core.Tracer):
            step = jnp.where(step > 0, step, jnp.nan)  # The outcome then reports it.
    remark = ""
    if softens(lattice):
        remark = "An exponent below 1: a contact that re-opens is infinitely stiff, and no step bound exists there."
    span = chosen((t1 - t0) / frames)
    # A few ulp of slack, so that 120/0.05 is 2400 and not 2401.
    count = span / step * (1 - 1e-12)
    if traced((step, t0, t1)):
        count = jnp.maximum(jnp.ceil(count), 1)
        return Steps((t1 - t0) / (count * frames), None, choice, remark, allowed)
    refuse_unresolved(t0, t1, step, about.dtype)
    count = max(math.ceil(count), 1) * frames
    more = count_breaks(lattice.breaks, t0, t1) if about.has_breaks else 0
    steps = None if isinstance(more, jax.core.Tracer) else count + int(more)
    return Steps((t1 - t0) / count, steps, choice, remark, allowed)


def reachable(lattice: Lattice, state: StateLike, t0: Scalar, t1: Scalar) -> tuple:
    """Return a bound on the frequencies at this energy, and whether a run may pass it.

    It is a Python number where known.
    """
    span = number(t0, np.dtype(float)), number(t1, np.dtype(float))
    if facts(lattice).traced or traced((state, t0, t1)):
        return frequency_bound(*jax.tree.map(chosen, (lattice, state, *span))), False
    first, second = (partial(gathered_frequency, lattice, state, *span, n) for n in GATHERED)
    found = first()
    # Plain numbers within a transformation of something else.
    if isinstance(found, jax.core.Tracer):
        return frequency_bound(lattice, state, *span), False
    bound, beyond = np.asarray(found).tolist()
    if (t1 - t0) * bound > STEP_FRACTION * MANY_STEPS:
        lower, watch = np.asarray(second()).tolist()
        if FLOORLESS * lower < bound or useless(STEP_FRACTION / bound, t0, t1):
            return lower, bool(watch)
    return bound, bool(beyond)


def floored_frequency(lattice: Lattice, state: StateLike, t0: Scalar, t1: Scalar) -> Number:
    """Return `frequency_bound`, or `reachable` if lower."""
    # Only a far lower one is taken, so that lattices whose laws have a floor keep their steps.
    bound = frequency_bound(lattice, state, t0, t1)
    if traced((bound, t0, t1)) or (t1 - t0) * bound <= STEP_FRACTION * MANY_STEPS:
        return bound
    lower, _ = reachable(lattice, state, t0, t1)
    return lower if FLOORLESS * lower < bound else bound


def useless(step: Any, t0: Any, t1: Any) -> bool:
    """Return whether a step is not finite, or a run would take too many of them."""
    return bool(not math.isfinite(step) or (t1 - t0) / step > MOST_STEPS)


def _refuse_unstable(lattice, state, t0, t1, step, solver, limit):
    omega = linear_bound(lattice)
    if 0 < step * omega <= limit:
        return
    what = "The highest linear frequency"
    if omega > 0:
        omega = concrete(linear_frequency(lattice))
    else:
        omega = concrete(reachable(lattice, state, t0, t1)[0])
        what = "The highest frequency at this energy"
    if omega is not None and step * omega > limit:
        refuse(
            "step",
            f"at most {limit / omega:.4g}, where {type(solver).__name__} is stable",
            f"{step}",
            f"{what} is {omega:.4g} and the limit h omega < {limit:.4g}.",
        )


def least_step(t0: Scalar, t1: Scalar, dtype: Any) -> Scalar:
    """Return the shortest step that the floating type resolves at these times."""
    start = UNITS_AT_START * abs(t0)
    larger = library(t0, t1).maximum
    return rounding_unit(dtype) * larger(start, UNITS_AT_END * larger(abs(t0), abs(t1)))


def refuse_unresolved(t0: Scalar, t1: Scalar, step: Scalar, dtype: Any) -> None:
    """Refuse known times at which the floating type does not resolve the steps."""
    if step < least_step(t0, t1, dtype):
        gap = rounding_unit(dtype) * max(abs(t0), abs(t1))
        finer = "" if dtype == np.dtype(float) else " Or compute in float64."
        refuse(
            "t0, t1, step",
            f"a step that is long against the gaps between numbers of {dtype} at these times",
            f"a step of {step:.3g} from t0 = {t0:g} to t1 = {t1:g}, where numbers lie {gap:.2g} apart",
            f"Count time from t0=0 (of what drives the lattice too), or take a longer step.{finer}",
        )


def refuse_far(lattice: Lattice, state: StateLike, t0: Scalar, t1: Scalar) -> None:
    """Refuse times as `refuse_unresolved` does, for adaptive steps.

    Those are about as long as the default step.
    """
    about = facts(lattice)
    eps = rounding_unit(about.dtype)
    # Most calls end here; the rest takes longer.
    if traced((t0, t1)) or eps * abs(t0) < NEAR * (t1 - t0) or about.traced or traced(state):
        return
    omega = linear_bound(lattice) or reachable(lattice, state, t0, t1)[0]
    if omega > 0:
        refuse_unresolved(t0, t1, STEP_FRACTION / omega, about.dtype)


def frequency_bound(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    neighbourhood: Count = NEIGHBOURHOOD,
) -> Number:
    """Return a bound on the frequencies of linearisation about all states that the energy allows.

    A bond may gather the largest energy that a neighbourhood, some bond lengths wide, holds at the
    start (that of the whole lattice if a term does not say how far it couples). Driving adds
    energy:

    - a drive adds that stored by a quasi-static push to twice its largest value;
    - a moving wall adds that of the heaviest site at twice the wall's largest speed, or its
      displacement shared by all sites, whichever is more;
    - a modulation counts with its largest value and the energy that it gives the initial state.

    The bound is doubled where contacts may open all over the lattice.

    **Returns:** omega_max [rad/s], one number for all lanes; zero for a lattice without stiffness
    at its energy. **Raises** ValueError for a state of another shape, and times that are not in
    order.
    """
    state = checked_state(lattice, state)
    neighbourhood = whole("neighbourhood", neighbourhood, 1)
    # As arrays, so that other values compile nothing.
    t0, t1 = (jnp.asarray(t, lattice.dtype) for t in checked_times(t0, t1))
    return _bound_at(lattice, state, t0, t1, neighbourhood)


@compiled
def _bound_at(lattice, state, t0, t1, neighbourhood):
    return gathered_frequency(lattice, state, t0, t1, neighbourhood)[0]


@compiled
def gathered_frequency(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    neighbourhood: Any = NEIGHBOURHOOD,
) -> Numbers:
    """Return (`frequency_bound`, whether a run may pass it), (2,).

    A run cannot pass it if the neighbourhood holds all energy.
    """
    ts = sampled_times(lattice, t0, t1)
    force, displacement, speed = largest_excitation(lattice, ts)
    heaviest = most(lattice.mass)
    gathered, whole, stored = _gathered(lattice, state, ts, neighbourhood)
    spread = jnp.any(whole > 2 * gathered)
    energy = jnp.broadcast_to(gathered + 2 * heaviest * speed**2, (2, *lattice.lanes))
    sites = sum(math.prod(shape) for _, shape, _ in lattice._cell)
    share = jnp.broadcast_to(displacement / sites, 2)

    def reach(energy, share):
        share = share if lattice.reads_time else None
        return Reach(energy, 2 * force, share, neighbourhood, ts, state.u)

    sides = _sides(lattice, state, ts) if neighbourhood < NEIGHBOURHOOD else BOTH
    one = jnp.where(trailing(sides, energy.ndim), energy, stored)
    bound = _bound(lattice, [reach(one, jnp.where(sides, share, 0))] * len(lattice.terms))
    known = not lattice.reads_time and all(span(term) is not None for term in lattice.terms)
    beyond = jnp.any(whole > 1.01 * gathered) | ~jnp.all(sides)
    beyond = beyond if known and not softens(lattice) else jnp.ones((), bool)
    contacts = [
        c.law
        for term in lattice.terms
        for c in term.compressions(ts[0], state.u)
        if c.place != "site"
    ]
    if contacts:
        # Conditional, as for a cheap lattice the search takes longer than all else.
        opens = jax.lax.cond(
            spread,
            lambda: jnp.any(jnp.stack([reach(energy, share).opens(law) for law in contacts])),
            lambda: spread,
        )
        bound = jnp.where(opens, OPENING, 1.0).astype(bound.dtype) * bound
    return jnp.stack([bound, beyond.astype(bound.dtype)])


def largest_excitation(lattice: Lattice, ts: Times) -> Excitation:
    """Return the largest excitation by drives and walls at some times."""
    zero = jnp.zeros((), lattice.dtype)
    driven = [term.excitation(lattice, ts) for term in lattice.terms]
    return reduce(partial(jax.tree.map, jnp.maximum), driven, Excitation(zero, zero, zero))


@compiled
def linear_frequency(lattice: Lattice, power_steps: Count = POWER_STEPS) -> Number:
    """Return the bound for infinitesimal motion about equilibrium: zero in a sonic vacuum.

    `power_steps`: more steps give a sharper bound; zero steps still give a bound.
    """
    zero = jnp.zeros((), lattice.dtype)
    none = jnp.zeros((2, *lattice.lanes), lattice.dtype)
    reach = Reach(none, zero, None, 1, zero[None], lattice.zeros())
    return _bound(lattice, [reach] * len(lattice.terms), power_steps)


@once
def linear_bound(lattice: Lattice) -> float:
    """Return a bound on the linear frequencies of a known lattice; it is quick and cached."""
    return float(concretely(linear_frequency, lattice, 0))


def compressions(lattice: Lattice, t: Number, u: Displacements) -> tuple:
    """Return the compressions of the laws of each term, or the energy of a term without laws."""
    found = []
    for term in lattice.terms:
        own = tuple(c.compression for c in term.compressions(t, u))
        if not own and reads(term, lattice).energy:
            lanes = len(lattice.lanes)
            own = tuple(per_lane(e, lanes) for e in jax.tree.leaves(term.energy(t, u)))
        found.append(own)
    return tuple(found)


def reached_frequency(
    lattice: Lattice, low: Any, high: Any, t0: Scalar, t1: Scalar, u: Displacements
) -> Number:
    """Return the bound at the least and largest `compressions` of a run."""
    ts = sampled_times(lattice, t0, t1)
    none = jnp.zeros(lattice.lanes, lattice.dtype)
    reaches = []
    for term, *ends in zip(lattice.terms, low, high):
        has_laws = bool(term.compressions(ts[0], u))
        energy = none if has_laws else sum(ends[1], none)
        reaches.append(Reach(energy, none, None, 1, ts, u, tuple(ends)))
    return _bound(lattice, reaches, FEW_STEPS)


def sampled_times(lattice: Lattice, t0: Scalar, t1: Scalar) -> Times:
    """Return times from t0 to t1, unevenly spaced: no period of a drive hides between them."""
    i = np.arange(SAMPLES)
    places = np.clip(
        i + np.where(i % (SAMPLES - 1) == 0, 0, (0.6180339887498949 * i) % 1 - 0.5), 0, SAMPLES - 1
    )
    return (t0 + (t1 - t0) * jnp.asarray(places / (SAMPLES - 1))).astype(lattice.dtype)


def _sides(lattice, state, ts):
    # Whether bonds may be extended, and compressed, by more than their energy at the start allows;
    # both for lattices other than plain chains.
    # Where all bonds of a chain extend, or all compress, they go on until waves return from a free
    # end: a shock compresses, a rarefaction extends. This rule of thumb is corrected by the check
    # at the end of a run.
    plain = lattice.fields is None and lattice.axes == 1 and lattice.dimension is None
    if not plain or any(
        span(term) is None or max(span(term), default=0) > 1 for term in lattice.terms
    ):
        return BOTH
    # Between two walls and in a ring, extension of one bond compresses others.
    ring = any(
        found is not None and found[1] == "periodic"
        for found in map(next_neighbours, lattice.terms)
    )
    if ring or {side for term in lattice.terms for side in walls(term)} == {"left", "right"}:
        return BOTH
    u, v = state
    extend = press = jnp.zeros((), bool)
    squared = jnp.zeros((), lattice.dtype)
    size = ROUNDING * jnp.max(jnp.abs(v))
    for term in lattice.terms:
        found = reads(term, lattice)
        contacts = term.compressions(ts[0], u)
        if not contacts:
            if found.displacement or found.time:
                return BOTH
            continue
        # A site on a spring of its own swings back at once; a stiffness that changes in time brings
        # energy back at once.
        if any(c.place == "site" for c in contacts) or len(_energy_times(term, lattice, ts)) > 1:
            return BOTH

        def rates(t, term=term):
            squeezed = lambda t, u: [c.compression for c in term.compressions(t, u)]
            found = jax.jvp(squeezed, (t, u), (jnp.ones_like(t), v))[1]
            return -most(jax.tree.map(jnp.negative, found)), most(found)

        low, high = jax.lax.map(rates, ts) if found.time else rates(ts[0])
        extend = extend | (jnp.min(low) < -size)
        press = press | (jnp.max(high) > size)
        stiffness = most([jnp.abs(c.law.derivative(c.compression)) for c in contacts])
        squared = jnp.maximum(squared, stiffness / jnp.min(lattice.mass))
    coming = jnp.sqrt(squared) * (ts[-1] - ts[0]) < _way(lattice, v, size)
    return ~coming | jnp.stack([extend, press])


def _way(lattice, v, size):
    # The number of sites between the moving part of a chain and its nearest free end.
    count = v.shape[0]
    held = {side for term in lattice.terms for side in walls(term)}
    ways = [jnp.asarray(count)]
    for side, x in (("left", v), ("right", v[::-1])):
        if side not in held:
            moves = (jnp.abs(x - x[:1]) > size).any(tuple(range(1, x.ndim)))
            ways.append(jnp.where(moves.any(), jnp.argmax(moves), count))
    return jnp.stack(ways).min()


def _gathered(lattice, state, ts, neighbourhood):
    # The most energy of a neighbourhood at the start, the energy of the whole lattice, and the
    # first without kinetic energy.
    u, v = state
    spans = [span(term) for term in lattice.terms]
    one_shape = lattice.fields is None or len(set(lattice.sites.values())) == 1
    local = one_shape and all(span is not None and len(span) in (0, lattice.axes) for span in spans)
    parts = [jax.tree.map(lambda m, v: m * v * v / 2, lattice.mass, v)]
    for term in lattice.terms:
        if reads(term, lattice).energy:

            def energy(t, term=term):
                return site_energy(term, lattice, t, u) if local else term.energy(t, u)

            energies = jax.vmap(energy)(_energy_times(term, lattice, ts))
            parts.append(jax.tree.map(lambda e: jnp.max(e, axis=0), energies))
    lanes = len(lattice.lanes)
    moving, *held = jax.tree.map(lambda x: jnp.maximum(x, 0), parts)
    none = jnp.zeros(lattice.lanes, lattice.dtype)
    if not local:
        moves, holds = (none + per_lane(own, lanes) for own in (moving, held))
        return moves + holds, moves + holds, holds
    shape = next(iter(lattice.sites.values())) if lattice.fields else lattice.sites
    axes = tuple(range(lattice.axes))

    def most(energies):
        total = jnp.zeros(shape + lattice.lanes, lattice.dtype)
        for x in jax.tree.leaves(energies):
            total = total + (x.sum(lattice.axes) if x.ndim > total.ndim else x)
        whole = total.sum(axes)
        for axis in axes:
            width = neighbourhood * max([1, *(span[axis] for span in spans if span)])
            total = _window(total, axis, width)
        return jnp.max(total, axis=axes), whole

    return *most((moving, held)), most(held)[0]


def _energy_times(term, lattice, ts):
    # The times at which the energy of the initial state is evaluated: all, if the stiffness changes
    # in time. A moving wall counts at its initial position.
    moves = isinstance(within(term), Wall) and within(term).motion is not None
    return ts if reads(term, lattice).time and not moves else ts[:1]


def _window(x, axis, width):
    # Sums over `width` neighbours along an axis, as if it were a ring.
    size = x.shape[axis]
    if width >= size:
        return x.sum(axis, keepdims=True)
    x = jnp.concatenate([x, jax.lax.slice_in_dim(x, 0, width - 1, axis=axis)], axis)
    shape = tuple(width if i == axis else 1 for i in range(x.ndim))
    # A zero of JAX would be traced within a program, and the sum would then have no derivatives.
    return jax.lax.reduce_window(
        x, np.zeros((), x.dtype), jax.lax.add, shape, (1,) * x.ndim, "VALID"
    )


def _bound(lattice, reaches, power_steps=POWER_STEPS):
    found = [term.stiffness_bound(lattice, reach) for term, reach in zip(lattice.terms, reaches)]
    products = [x for x in found if inspect.isroutine(x)]
    numbers = [x for x in found if not inspect.isroutine(x)]
    mass = lattice.mass
    site = lattice.zeros()
    if lattice.dimension is not None:
        # If components have their own masses, the least counts.
        mass = jax.tree.map(
            lambda m: jnp.min(m, lattice.axes) if m.ndim > lattice.axes else m, mass
        )
        site = jax.tree.map(lambda x: x[(slice(None),) * lattice.axes + (0,)], site)

    def apply(w):
        total = lattice.total([product(w) for product in products], w)
        return jax.tree.map(jnp.divide, total, mass)

    def power(_, w):
        grown = apply(w)
        size = most(grown)
        return jax.tree.map(
            lambda x, b: jnp.maximum(x / jnp.where(size > 0, size, 1) + 1e-9 * b, 1e-12), grown, w
        )

    w = jax.lax.fori_loop(0, power_steps, power, jax.tree.map(jnp.ones_like, site))
    ratios = jax.tree.map(jnp.divide, apply(w), w)
    return jnp.sqrt(most(ratios) + sum(jnp.max(x) for x in numbers))


def chosen(x: Any) -> Any:
    """Return the value without derivatives: a step is a choice, not a function of the lattice."""
    return jax.lax.stop_gradient(x) if isinstance(x, jax.Array) else x


@once
def softens(lattice: Lattice) -> bool:
    """Return whether re-opening contacts are infinitely stiff, so that no step bound exists."""
    return any(of_contacts(lambda c: c.law.softens, lattice.terms, lattice))


def of_contacts(function: Callable, terms: Sequence[Term], lattice: Lattice) -> list:
    """Return what a function says of each contact of some terms; nothing is computed."""
    found = []

    def look(t, u):
        found.extend(function(c) for term in terms for c in term.compressions(t, u))

    jax.eval_shape(look, time_of(lattice), lattice.template())
    return found
