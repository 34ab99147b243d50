"""Equilibria of lattices by Newton's method, with the loads that hold them."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..base.arrays import most, padded, trailing
from ..base.checks import one_of, refuse, traced
from ..base.derivatives import eigvalsh
from ..base.programs import compiled, concretely
from ..base.types import AnyArray, Count, Displacements, Flags, Numbers
from ..base.units import PART
from ..lattice import Lattice, State, uniform_moves
from ..lattice.model import check_shape as _check_shape
from ..laws import Strained
from ..results import Result, array, note, part
from ..strains import Stretch
from ..terms import Bond, Drive, LongRange, Modulated, Term, chain, reach
from ..terms.base import Altered, Clipped, get, layers, within
from ..terms.sites import still, with_still_walls
from .newton import FLAT, NOT_FINITE, by_forward_mode, newton

# The most unknowns for which Newton's method has a dense derivative.
DENSE = 4000
# The residual force, relative to the largest force.
TIGHT = 1e-13
# The rounding of a sum of forces, and of displacements times the stiffness, in units of the last
# place.
ROUNDING = 64
HOLDS = ("ends", "loads", "nothing")


class Equilibrium(Result):
    """An equilibrium of a lattice, and the loads that hold it there."""

    state: State = part(
        "Displacements, from where the lattice was built, and velocities, which are zero.",
        "site ...",
    )
    loads: Displacements = array(
        "The external forces that hold each site, apart from walls; zero where nothing holds it.",
        "N",
        "site ...",
    )
    ends: Numbers | None = array(
        "The forces on the left and right end of a chain, compression positive; `None` if a term "
        "does not know its walls.",
        "N",
        "end",
    )
    residual: Numbers = array("The largest residual force on a site.", "N")
    largest: Numbers = array("The largest force of a contact, or of a term on a site.", "N")
    stiffness: Numbers | None = array(
        "The least eigenvalue of the stiffness (without uniform displacements of a ring), "
        "negative at a saddle.",
        "N/m",
    )
    error: Numbers | None = array("The error of `stiffness`.", "N/m")
    lattice: Lattice = note("The lattice measured from the equilibrium, which rests at u = 0.")
    _floor: Numbers
    _moved: Numbers
    _borne: Flags
    _code: str = eqx.field(static=True, default="")

    @property
    def verdict(self) -> str | AnyArray:
        """The stability: "stable", "unstable", or "undecided" (the least stiffness is rounding)."""
        if traced((self.stiffness, self.error)) or self.stiffness is None:
            return "undecided"
        least = np.asarray(self.stiffness)
        known = np.abs(least) > np.asarray(self.error)
        said = np.where(known, np.where(least > 0, "stable", "unstable"), "undecided")
        return said if said.ndim else str(said)

    @property
    def found(self) -> Flags:
        """Whether the residual is rounding of forces or of displacements."""
        return self.residual <= self._floor

    @property
    def outcome(self) -> str:
        """What was found: a minimum, a saddle, or none."""
        if traced((self.residual, self.largest)):
            return "traced"
        if jnp.ndim(self.residual):
            rest = np.asarray(self.found)
            stable = np.count_nonzero(rest & (np.asarray(self.verdict) == "stable"))
            count = f"{np.count_nonzero(rest)} of {rest.size}"
            return f"A state of rest was found in {count} lanes, a stable one in {stable}."
        share = float(self.residual) / float(self.largest) if float(self.largest) else 0.0
        of = f"{share:.1e} of the largest force"
        if self.found and share > _tight(jnp.result_type(self.largest)):
            of = "which is rounding of the displacements"
        left = f"{self._told('residual', self.residual)} is left over, {of}"
        if not self.found:
            return f"No state of rest was found: {left}. {self._code}"
        kind = {
            "stable": "A stable state of rest",
            "unstable": "A saddle, no stable state of rest (start from another "
            "`guess`, moved along the mode that grows)",
            "undecided": "A state of rest; whether it is stable is not "
            "known, as its least stiffness is zero to rounding",
        }[self.verdict]
        if self.stiffness is None:
            kind = f"A state of rest; whether it is stable is not known for more than {DENSE} displacements"
        moved = _MOVED * bool(self._moved > self._floor)
        return f"{kind}: {left}.{moved}{_BORNE * bool(self._borne)}"


_MOVED = " At u = 0 only loads on inner sites hold the lattice: simulate the result's `lattice`."
_LOOSE = (
    " At the guess some displacements meet no resistance, as those of beads that only touch: start"
    " from a `guess` at which the contacts are closed."
)
_BORNE = (
    " Held sites do not move: what holds them bears the loads given on them"
    " (hold='nothing' lets these act)."
)


class _Problem(eqx.Module):
    # `loads`: all external forces; `given`: those from the user; `holds`: flags of what stays at
    # the guess; `free`: uniform moves that cost nothing, as orthonormal columns.

    lattice: Lattice
    loads: AnyArray
    given: AnyArray
    holds: AnyArray
    guess: AnyArray
    free: AnyArray
    scale: AnyArray

    def total(self, x):
        # All forces on the sites, with those of preloads and loads, as one row.
        return ravel_pytree(_total(self.lattice, _shaped(self.lattice, x)))[0] + self.loads


def _total(lattice, u):
    zeros = jax.tree.map(jnp.zeros_like, u)
    forces = lattice.force(jnp.zeros((), lattice.dtype), u, zeros)
    return jax.tree.map(jnp.add, forces, lattice.unbalanced())


def _shaped(lattice, x):
    return ravel_pytree(lattice.zeros())[1](x)


def equilibrium(
    lattice: Lattice,
    *,
    hold: str | Sequence = "ends",
    loads: Displacements | None = None,
    guess: Displacements | State | None = None,
    max_steps: Count = 50,
    throw: bool | None = None,
) -> Equilibrium:
    r"""Find an equilibrium of any lattice, and the loads that hold it.

    sum of force(u) + preloads + loads = 0 on every site that can move. Laws are measured from a
    preload, and at u = 0 the lattice is assumed to be held. Where preloads do not balance at inner
    sites (equally spaced magnets), the lattice moves elsewhere. The result's `lattice` is measured
    from the equilibrium: simulate that one.

    **Arguments:**

    - `lattice`: one `Lattice`, with fields, vectors, own terms. Drives (also constant ones)
      are left out, walls stand still, t = 0; the result's `lattice` has both. What a `Modulated`
      term does at rest it has not: u = 0 stays an equilibrium.
    - `hold`: what holds a lattice for which a uniform displacement costs nothing. `"ends"`: its
      outermost sites stay and their `loads` are found; however, if given `loads` push these sites,
      add up to zero and displacements are scalar, they act, as with `"loads"`.
      `"loads"`: the loads that balance their preloads at u = 0 are kept, and their positions found.
      `"nothing"`: neither. Or a list of sites that stay (first axis). A ring keeps its mean; a
      lattice between walls is held by these.
    - `loads`: further external forces on the sites [N], such as weights.
    - `guess`: displacements (or a `State`) where Newton's method begins, else u = 0.
    - `max_steps`: of Newton's method, and downhill where that stalls. `throw`: raise if none is
      found; `None` does so outside of transformations.

    **Returns:** `Equilibrium`; its outcome names a saddle. Differentiable in parameters and loads,
    in both modes. The cost is n^3 for n displacements, up to 4000; a larger lattice must rest
    already.
    **Raises** ValueError for a batch (`jax.vmap(gx.equilibrium, in_axes=-1)`), and a guess at which
    a force is not finite, as of magnets that touch; RuntimeError if no equilibrium is found.

    **Example:**

    >>> chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Linear()), sites=3)
    >>> rest = gx.equilibrium(chain, loads=jnp.array([0.0, 1.0, 0.0]))
    >>> rest.state.u.round(4)
    Array([0.5, 1. , 0.5], dtype=float64)
    """
    if lattice.lanes:
        refuse(
            "lattice",
            "one lattice",
            f"a batch with lanes {lattice.lanes}",
            "Use jax.vmap(gx.equilibrium, in_axes=-1)(lattice).",
        )
    kept = tuple(term for term in lattice.terms if not _drives(term, lattice))
    undriven = with_still_walls(eqx.tree_at(lambda x: x.terms, lattice, kept))
    problem = posed(undriven, hold, loads, guess)
    x = problem.guess
    code = f"More than {DENSE} displacements are not solved for." if x.size > DENSE else ""
    root = None
    for _ in range(2 if not code else 0):
        # Where contacts open, Newton's method stalls at beads that no contact holds any more.
        if root is not None and (traced(root) or not root.converged):
            x = _downhill(*jax.lax.stop_gradient((problem, root)), max_steps)
        # Forces at the guess may be far above those at rest, so the tolerance of the second round
        # counts.
        _, floor, scale = jax.lax.stop_gradient(sizes(problem, x))
        problem = dataclasses.replace(problem, scale=scale)
        root = newton(
            left_over,
            jax.lax.stop_gradient(x),
            problem,
            tolerance=floor / 4,
            max_steps=max_steps,
            throw=False,
        )
        x = root.x
    if root is not None and not traced(root) and not root.converged:
        code = root.outcome + _LOOSE * bool(root.code == NOT_FINITE and root.residual == root.first)
    found = dataclasses.replace(_finished(problem, lattice, x), _code=code)
    if not traced(found) and (throw is None or throw) and not found.found:
        raise RuntimeError(found.outcome)
    return found


def _drives(term, lattice):
    # Whether the force is that of a drive. One that reads displacements as well counts as at t = 0.
    found = reach.reads(term, lattice)
    return not found.displacement and (found.time or isinstance(within(term), Drive))


def left_over(x: Numbers, problem: Any) -> Numbers:
    """Return the forces on what can move."""
    # What cannot is tied to the guess.
    force = jnp.where(problem.holds, 0, problem.total(x))
    tied = problem.scale * (problem.guess - x)
    force = force + problem.free @ (problem.free.T @ (tied - force))
    return jnp.where(problem.holds, tied, force)


@compiled
def _downhill(problem, root, most):
    # Levenberg's steps (K + mu)^-1 F from the guess, which reach the minimum of a convex energy.
    # The work of the force along a step says whether it went too far, as not every term has an
    # energy. What they do not bring to rest stays where Newton's method left it.
    _, floor, _ = sizes(problem, root.x)

    def high(f):
        return jnp.max(jnp.abs(f)) > jnp.maximum(floor, FLAT * root.first)

    lost = (root.code != NOT_FINITE) & high(root.residual)

    def going(carry):
        _, f, _, _, steps = carry
        return lost & (steps < most) & ((steps == 0) | high(f))

    def body(carry):
        x, f, jacobian, mu, steps = carry
        # The first step, zero, evaluates the guess.
        step = jnp.linalg.solve(mu * jnp.eye(x.size, dtype=x.dtype) - jacobian, f)
        there = x + step, *by_forward_mode(left_over, x + step, problem)
        downhill = (steps == 0) | (step @ f > 0) & (step @ there[1] >= -step @ f / 2)
        best = (jnp.where(downhill, new, old) for new, old in zip(there, carry))
        return *best, jnp.where(downhill, mu / 4, mu * 4), steps + 1

    x = problem.guess
    nothing = jnp.zeros_like(x), jnp.zeros_like(root.jacobian)
    start = x, *nothing, problem.scale, jnp.zeros((), int)
    x, f, *_ = jax.lax.while_loop(going, body, start)
    return jnp.where(lost & ~high(f), x, root.x)


def posed(lattice: Lattice, hold: str | Sequence, loads: Any, guess: Any) -> Any:
    """Pose the problem of `equilibrium`."""
    start = lattice.zeros() if guess is None else guess.u if isinstance(guess, State) else guess
    loads = lattice.zeros() if loads is None else loads
    _check_shape(lattice, "guess", start)
    _check_shape(lattice, "loads", loads)
    start, own = (
        ravel_pytree(jax.tree.map(lambda x: jnp.asarray(x, lattice.dtype), x))[0]
        for x in (start, loads)
    )
    # Values that are known before tracing stay NumPy arrays.
    none = np.zeros(start.size, bool)
    nothing = np.zeros((start.size, 0), start.dtype)
    problem = _Problem(lattice, own, own, none, start, nothing, jnp.ones((), start.dtype))
    if not traced(problem) and not np.all(np.isfinite(_response(problem, own)[0])):
        remedy = "Magnets that touch have no force: start where all of them are apart."
        refuse("guess", "displacements at which every force is finite", "others", remedy)
    moves, _ = np.linalg.qr(uniform_moves(lattice).astype(start.dtype))
    edges = _edges(problem)
    acts = np.False_
    if isinstance(hold, str):
        one_of("hold", hold, HOLDS)
        holds = edges if hold == "ends" and moves.shape[1] else none
        if lattice.dimension is None:
            acts = _balanced(own, holds, moves)
    else:
        sites = min(s.shape[0] for s in jax.tree.leaves(lattice.template()))
        holds = none
        for site in hold:
            if not -sites <= site < sites:
                wanted = f"{', '.join(map(repr, HOLDS))}, or sites from 0 to {sites - 1}"
                refuse("hold", wanted, repr(hold))
            holds = holds | _slab(lattice, 0, site)
    if np.any(holds):
        moves = moves * acts
        holds = holds & ~acts
    dead = none if hold == "nothing" else edges & ~holds
    loads = _loaded(lattice, own, dead)
    return dataclasses.replace(problem, loads=loads, holds=holds, free=moves)


def _balanced(loads, holds, moves):
    # Whether loads push sites that would be held, but no uniform displacement of the lattice.
    numpy = jnp if traced(loads) else np
    loads = numpy.asarray(loads)
    rounding = ROUNDING * np.finfo(loads.dtype).eps * numpy.abs(loads).sum()
    return numpy.any(loads * holds != 0) & numpy.all(numpy.abs(moves.T @ loads) <= rounding)


@compiled
def _loaded(lattice, own, dead):
    # The given loads, and on some sites those that the preloads need at u = 0.
    return own + jnp.where(dead, -ravel_pytree(lattice.unbalanced())[0], 0)


def _edges(problem):
    # The outermost sites of all axes that are not periodic, except those at a wall of a chain, as
    # one row.
    lattice = problem.lattice
    walls = (
        {side for term in lattice.terms for side in chain.walls(term)}
        if lattice.axes == 1
        else set()
    )
    edges = np.zeros(problem.guess.size, bool)
    ends = [end for name, end in (("left", 0), ("right", -1)) if name not in walls]
    for axis in range(lattice.axes):
        if ends and not _goes_around(problem, axis):
            for end in ends:
                edges |= _slab(lattice, axis, end)
    return edges


def _goes_around(problem, axis):
    # Whether the first sites of an axis act on the last ones more than on those half way between.
    lattice = problem.lattice
    size = min(s.shape[axis] for s in jax.tree.leaves(lattice.template()))
    first, middle, last = (_slab(lattice, axis, end) for end in (0, size // 2, -1))
    push = np.where(first, np.random.default_rng(0).uniform(1, 2, first.size), 0).astype(
        lattice.dtype
    )
    numbers, flags = eqx.partition(problem, eqx.is_inexact_array)
    plain = eqx.combine(jax.tree.map(reach.stand_in, numbers), flags)
    answer = np.abs(concretely(_response, plain, push)[1])
    return size > 3 and bool(answer[last].max() > 2 * answer[middle].max())


def _slab(lattice, axis, end):
    # Flags in one row for the displacements of all sites at one place along an axis.
    shapes = [s.shape for s in jax.tree.leaves(lattice.template())]
    return np.concatenate([(np.indices(s)[axis] == end % s[axis]).ravel() for s in shapes])


@compiled
def _response(problem, push):
    # All forces at the guess, and their change by a displacement.
    return jax.jvp(problem.total, (problem.guess,), (push,))


@compiled
def sizes(problem: Any, x: Numbers) -> tuple:
    """Return the largest force, the force of rounding, and the stiffness of what is tied."""
    lattice = problem.lattice
    u = _shaped(lattice, x)
    time = jnp.zeros((), lattice.dtype)
    zeros = jax.tree.map(jnp.zeros_like, u)
    forces = [term.force(time, u, zeros, lattice.mass) for term in lattice.terms]
    forces += [c.force for term in lattice.terms for c in term.compressions(time, u)]
    forces += [lattice.unbalanced(), problem.loads]
    slope = jax.jvp(problem.total, (x,), (jnp.cos(jnp.arange(x.size) ** 2.0).astype(x.dtype),))[1]
    scale = jnp.max(jnp.abs(slope))
    largest = most(jax.tree.map(jnp.abs, forces))
    eps = jnp.finfo(x.dtype).eps
    # At u = 0 the forces vanish with the displacements, and only those of the guess have a size.
    size = jnp.maximum(jnp.max(jnp.abs(x)), eps * jnp.max(jnp.abs(problem.guess)))
    rounding = ROUNDING * eps * scale * size
    floor = jnp.maximum(_tight(x.dtype) * largest, rounding)
    return largest, floor, jnp.where(scale > 0, scale, 1)


def _tight(dtype):
    # In float32 the rounding of the forces is above `TIGHT`.
    return max(TIGHT, ROUNDING * float(jnp.finfo(dtype).eps))


def _least(problem, x):
    # The least eigenvalue of the stiffness of what can move, and its error.
    tied = problem.holds
    free = problem.free
    stiffness = jnp.where(tied[:, None] | tied, 0, -jax.jacfwd(problem.total)(x))
    stiffness = stiffness - free @ (free.T @ stiffness)
    stiffness = stiffness - (stiffness @ free) @ free.T
    scale = jax.lax.stop_gradient(jnp.max(jnp.abs(stiffness)))
    # What cannot move lies above all eigenvalues, which the sums of rows bound.
    above = 2 * jax.lax.stop_gradient(jnp.max(jnp.abs(stiffness).sum(1)))
    out = jnp.diag(tied.astype(x.dtype)) + free @ free.T
    values = eigvalsh(stiffness + above * out)
    return values[0], ROUNDING * x.size * jnp.finfo(x.dtype).eps * scale


@compiled
def _finished(problem, driven, x):
    lattice = problem.lattice
    u = _shaped(lattice, x)
    force = problem.total(x)
    residual = jnp.max(jnp.where(problem.holds, 0, jnp.abs(force)))
    loads = _shaped(lattice, problem.loads - jnp.where(problem.holds, force, 0))
    measured = tuple(_measured_from(term, driven, u) for term in driven.terms)
    parts = measured, _places(lattice, u)
    measured = eqx.tree_at(lambda x: (x.terms, x.positions), driven, parts, is_leaf=_is_none)
    preloads = ravel_pytree(_total(lattice, lattice.zeros()))[0]
    inner = jnp.abs(preloads + problem.loads - problem.given)
    largest, floor, _ = sizes(problem, x)
    stiffness = (None, None) if x.size > DENSE else _least(problem, x)
    return Equilibrium(
        State(u, jax.tree.map(jnp.zeros_like, u)),
        loads,
        _ends(lattice, u, loads),
        residual,
        largest,
        *stiffness,
        measured,
        floor,
        jnp.max(jnp.where(problem.holds, 0, inner)),
        jnp.any(problem.holds & (problem.given != 0)),
        **lattice.origin,
    )


class _MeasuredFrom(Altered):
    # A term whose displacements are counted from `start`, and whose forces are those beyond the
    # forces there.

    dimensions = {"term": PART, "start": (0, 1, 0), "mass": (1, -1, 2)}
    term: Term
    start: Any
    mass: Any

    def _moved(self, u):
        return jax.tree.map(
            lambda s, x: jnp.broadcast_to(trailing(s, x.ndim), x.shape) + x,
            self.start,
            u,
        )

    def _rest(self, t, u):
        # What counts as rest: t = 0 and walls at rest, so that drives act. A modulation goes on, so
        # that u = 0 stays an equilibrium; what it multiplies is that of t = 0.
        term = still(self.term)
        zero = jnp.zeros_like(t)
        start = self._moved(jax.tree.map(jnp.zeros_like, u))
        if not any(isinstance(layer, Modulated) for layer in layers(term)):
            return term, zero, start
        return eqx.tree_at(within, term, Clipped(within(term), zero, zero)), t, start

    def _held(self, t, u, mass):
        term, t, start = self._rest(t, u)
        return term.force(t, start, jax.tree.map(jnp.zeros_like, u), mass)

    def force(self, t, u, v, mass):
        force = self.term.force(t, self._moved(u), v, mass)
        return jax.tree.map(jnp.subtract, force, self._held(t, u, mass))

    def energy(self, t, u):
        energy = self.term.energy(t, self._moved(u))
        if energy is None:
            return None
        term, t, start = self._rest(t, u)
        held, work = jax.jvp(lambda u: term.energy(t, u), (start,), (u,))
        return jax.tree.map(lambda e, held, work: e - held - work, energy, held, work)

    def preload_force(self, u):
        force = self._held(jnp.zeros(()), u, self.mass)
        held = self.term.preload_force(u)
        return force if held is None else jax.tree.map(jnp.add, force, held)

    linearised = Term.linearised
    resists = Term.resists

    def moving(self, u, v):
        return super().moving(self._moved(u), v)

    def compressions(self, t, u):
        term, then, start = self._rest(t, u)
        found = zip(self.term.compressions(t, self._moved(u)), term.compressions(then, start))
        return tuple(
            c._replace(
                law=Strained(c.law, s.compression), compression=c.compression - s.compression
            )
            for c, s in found
        )


def _measured_from(term, lattice, u):
    # The term with displacements counted from `u`, and its forces beyond those there.
    if isinstance(term, LongRange):
        rest = get(u, term.field) + (0 if term.rest is None else term.rest)
        return eqx.tree_at(lambda x: x.rest, term, rest, is_leaf=_is_none)
    if type(term) is Bond and (term.strain_map.linear or type(term.strain_map) is Stretch):
        at = term.strain_map
        law = term.law
        strain = at.strain(u)
        if type(law) is Strained and law.reference is None:
            strain = law.strain + strain
            law = law.law
        if not at.linear:
            at = Stretch(at.pairs, at.vector - at.pairs.strain(u)[..., : at.components])
        return eqx.tree_at(lambda x: (x.strain_map, x.law), term, (at, Strained(law, strain)))
    found = reach.reads(term, lattice)
    damps = found.velocity and not found.displacement and not _acts_at_rest(term, lattice)
    return term if damps or _drives(term, lattice) else _MeasuredFrom(term, u, lattice.mass)


def _acts_at_rest(term, lattice):
    # Whether a force of the velocity alone does, as that of a wind, whatever the traced numbers.
    random = np.random.default_rng(0)
    term, mass = jax.tree.map(lambda x: reach.stand_in(x, random), (term, lattice.mass))
    zeros = jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), lattice.template())
    force = concretely(_force_at_rest, term, zeros, mass)
    return any(x.any() for x in jax.tree.leaves(force))


@compiled
def _force_at_rest(term, zeros, mass):
    return term.force(jnp.zeros(()), zeros, zeros, mass)


def _is_none(x):
    return x is None


def _places(lattice, u):
    # The positions of the sites at rest, where displacements have components along them.
    if lattice.positions is None or lattice.dimension is None:
        return lattice.positions
    shared = min(lattice.dimension, jax.tree.leaves(lattice.positions)[0].shape[-1])
    moved = lambda x, u: x.at[..., :shared].add(u[..., :shared])
    return jax.tree.map(moved, lattice.positions, u)


def _wall_loads(term, u):
    # The forces of rigid walls on the left and right end of a chain; `None` if they are not known.
    if not isinstance(term, LongRange):
        if term.linear_in != "law" or chain.boundary_of(term) != "fixed":
            return None
        force = term.compressions(0.0, u)[0].force
        return jnp.stack([force[0], force[-1]])
    if term.boundary != "fixed":
        return None
    x = get(u, term.field)
    x = x if term.rest is None else x + term._at_rest(x)
    count = term.kernel.shape[0] if term.beyond is None else term.beyond
    # The sites at rest beyond an end belong to a free chain, pushed by all sites on the other side.
    whole = LongRange(term.kernel, term.law, "free", takes=term.takes)
    wide = padded(x, count, count)
    force = whole.force(0.0, wide, wide, 1.0) + whole.preload_force(wide)
    return jnp.stack([-force[:count].sum(0), force[-count:].sum(0)])


def _ends(lattice, u, loads):
    # For a chain of one field: the forces of walls on its ends, or of loads where there is no wall.
    if lattice.fields or lattice.axes != 1 or lattice.dimension:
        return None
    walls = {side for term in lattice.terms for side in chain.walls(term)}
    found = [_wall_loads(term, u) for term in lattice.terms if chain.walls(term)]
    if any(x is None for x in found):
        return None
    by_walls = sum(found, jnp.zeros(2, lattice.dtype))
    held = jnp.stack([loads[0], -loads[-1]])
    return jnp.where(np.array(["left" in walls, "right" in walls]), by_walls, held)
