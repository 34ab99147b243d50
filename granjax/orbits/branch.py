"""A branch of periodic orbits over a parameter, and its bifurcations."""

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree
from jaxtyping import Inexact, Shaped

from ..base.checks import described, is_site, one_of, positive, refuse, tolerance
from ..base.programs import compiled
from ..base.tuning import one_thread
from ..base.types import Along, Count, Displacements, Numbers, Response, Scalar, Scene, StateLike
from ..continuation.arclength import Curve, places, residual_of
from ..continuation.newton import Root, nearby
from ..flow import Flow
from ..lattice import Lattice, State
from ..measures import rms_velocity
from ..results import Held, Result, array, hidden, part
from ..states import rest
from .asked import (
    answered,
    checked_period,
    checked_state,
    flow_over,
    history,
    largest_of_each,
    masses,
    stacked,
)
from .floquet import decide, of_symmetry, structure, weights
from .leaving import NormalForm, normal_form, ways
from .loci import KINDS as LOCI
from .loci import Locus, locus
from .orbit import (
    AT_REST,
    BRANCH,
    DOUBLINGS,
    DRIFT,
    DRIFTING,
    FRAMES,
    LEFT_ON_BRANCH,
    Orbit,
    OrbitError,
    checked_free,
    covering,
    error_of,
    newtons,
    prepared,
    rounding,
)
from .problems import Family, made
from .scales import nonlinear_length
from .spectrum import reversible_multipliers, spectrum
from .tori import TorusBranch, from_neimark_sacker

FOLD = "fold"
BRANCH_POINT = "branch point"
DOUBLING = "period doubling"
TORUS = "Neimark-Sacker"
KREIN = "Krein collision"
# Without damping multipliers stay on the circle until they meet; rounding takes them off it by less
# than this.
OFF_THE_CIRCLE = 1e-5
# The part of a period after which no usual function of time is zero.
GENERIC = 0.618


class Bifurcation(Result):
    """A qualitative change along a parameter."""

    kind: str = array(
        '"fold" (dp = 0), "branch point" (another branch crosses), "period doubling" (a '
        'multiplier -1), "Neimark-Sacker" (a complex pair on the unit circle). Conservative '
        'families also have "real pair at +1", "Krein collision" and "extremum of energy"; a '
        'sweep has "repetition".',
        static=True,
    )
    p: float = array("The value of the parameter.")
    after: int = array("The index of the point before it.")
    state: State | None = part("The state of the orbit there, at t0.", "site", default=None)
    multiplier: complex | None = array(
        "The multiplier on the unit circle, of a pair the one above the real axis. Its modulus "
        "differs from 1 by the accuracy of the location.",
        default=None,
    )
    before: int | None = array(
        "The count before the bifurcation: real pairs beyond +1 or -1, complex quadruples; for a "
        "sweep the periods after which the motion repeats, 0 where it does not.",
        default=None,
    )
    behind: int | None = array("The same count behind the bifurcation.", default=None)
    _z: Any = hidden("The unknowns (x, q) there.", default=None)

    def __repr__(self) -> str:
        return f"Bifurcation({self.outcome[:-1]})"

    @property
    def outcome(self) -> str:
        """The kind and the place, in one sentence."""
        counts = "" if self.before is None else f", {self.before} before and {self.behind} behind"
        return f"{self.kind[0].upper()}{self.kind[1:]} at p = {self.p:.9g}{counts}."


class Branch(Result):
    r"""Orbits along a parameter: what `family`, `anticontinuous` and `forced_branch` return.

    It has P points. Errors are estimated distances from the true values.
    """

    p: Along = array(
        "The parameter: the frequency for a family of breathers, the coupling from the "
        "anticontinuous limit."
    )
    periods: Along = array("The period of each orbit.", "s", name="period")
    states: State = part("The state of each orbit at t0.", "point site", name="state")
    energy: Along = array("The energy of each orbit at t0.", "J")
    response: Along | None = array("The response of each orbit of a forced branch.")
    state_error: State = part("The error of each state.", "point site")
    energy_error: Along = array("The error of each energy.", "J")
    response_error: Along | None = array("The error of each response.")
    multipliers: Inexact[np.ndarray, "point multiplier"] = array(
        "The Floquet multipliers of each orbit, the largest modulus first.", "1", name="multiplier"
    )
    error: Numbers = array("The error of each multiplier.", "1", "point multiplier")
    step_error: Along = array("The change of the tangent map when the steps are doubled.", "1")
    verdict: Shaped[np.ndarray, " point"] = array(
        '"stable", "unstable" or "undecided", or "" where the multipliers were not computed.'
    )
    bifurcations: tuple[Bifurcation, ...] = array(
        "The bifurcations in the order of the branch.", axes="bifurcation"
    )
    t0: float = array("The time at which the orbits begin.", "s")
    exported: ClassVar[dict[str, Held]] = {
        "omega": Held("point", "rad/s"),
        "amplitude": Held("point", "m"),
        "folds": Held(None),
    }
    _family: Family
    _curve: Curve

    def __len__(self) -> int:
        return len(self.p)

    @property
    def outcome(self) -> str:
        """Why the branch ended."""
        if self._curve.end == "p":
            return f"p reached {self.p[-1]:.6g}."
        return self._curve.outcome

    @property
    def omega(self) -> Along:
        """Angular frequencies 2 pi/T, (P,)."""
        return self.p if isinstance(self._family.make, Lattice) else 2 * np.pi / self.periods

    @property
    def u(self) -> Displacements:
        """Displacements at t0, (P, N); a breather is at its turning point there."""
        return self.states.u

    @property
    def amplitude(self) -> Along:
        """max |u| at t0, (P,)."""
        return largest_of_each(self.u)

    @property
    def folds(self) -> Numbers:
        """Values of the parameter where the branch turns back."""
        return places(self.bifurcations, FOLD)

    @property
    def branch_points(self) -> Numbers:
        """Values of the parameter where another branch crosses."""
        return places(self.bifurcations, BRANCH_POINT)

    def normal_form(self, i: Count | Bifurcation) -> NormalForm:
        """Tell super- from subcritical at a bifurcation of forced orbits by its normal form.

        `i`: an index into `bifurcations`, or a `Bifurcation`. **Returns:** `NormalForm`. **Raises**
        ValueError for orbits without damping (follow `switch` there), and for a fold.
        """
        found = self._bifurcation(i, (BRANCH_POINT, DOUBLING, TORUS))
        if structure(self._family.scene(jnp.zeros(()))[0]).rate == 0:
            got = "a family of breathers" if self._family.shooting.reversible else "one without it"
            remedy = "Follow what leaves: branch.switch(i)."
            refuse("branch", "a branch of forced orbits with damping", got, remedy)
        return normal_form(self._family, found._z, found.kind, found.multiplier)

    def switch(
        self,
        i: Count | Bifurcation,
        *,
        side: int = 1,
        until: tuple[Scalar, ...] | Scalar | None = None,
        arclength: Scalar = 0.02,
        longest_arclength: Scalar | None = None,
        points: Count = 50,
        response: Response = rms_velocity,
    ) -> "Branch | TorusBranch":
        """Follow the branch that leaves a bifurcation.

        At a branch point that is the other branch, at a period doubling the doubled orbit, at a
        Neimark-Sacker point the torus. Its first point is `arclength` away from the bifurcation.

        **Arguments:** `i`: an index into `bifurcations`, or a `Bifurcation` such as
        `gx.breathers.bifurcations` returns. `side`: 1 or -1; at a doubling -1 gives the same orbit
        a period later. `until`: values of the parameter at which to end, by default the ends of the
        branch. `arclength`, `longest_arclength`, `points`, `response`: as in
        `gx.forced.forced_branch`. Time steps of forced orbits are doubled as there; those of
        breathers stay.

        **Returns:** `Branch`, or `TorusBranch` for a torus; for a doubled breather the parameter is
        its own frequency.
        **Raises** ValueError for a fold; RuntimeError if nothing is found beside the point.
        Source: Keller, in Applications of Bifurcation Theory (1977), 359.

        **Example:**

        >>> well, beside = gx.OnSite(gx.Polynomial(-1.0, 0.0, 1.0)), gx.State(jnp.ones(2), jnp.zeros(2))
        >>> make = lambda f: gx.Lattice(jnp.ones(2), (well, gx.Damping(0.3), gx.Drive(gx.Harmonic(f, 1.2), 0)))
        >>> branch = gx.forced.forced_branch(make, 0.25, 0.28, period=2 * np.pi / 1.2, guess=beside, transient=60)
        >>> branch.bifurcations
        (Bifurcation(Period doubling at p = 0.265581786),)
        >>> branch.normal_form(0).criticality, branch.switch(0, points=3).verdict.tolist()
        ('supercritical', ['stable', 'stable', 'stable'])
        """
        found = self._bifurcation(i, (BRANCH_POINT, DOUBLING, TORUS))
        if side not in (1, -1):
            refuse("side", "1 or -1", described(side))
        z = found._z
        family = self._family
        longest = 5 * arclength if longest_arclength is None else longest_arclength
        settings = {"arclength": arclength, "longest_arclength": longest, "points": points}
        if found.kind != TORUS:
            tangent = self._curve.tangents[found.after]
            family, x, q, direction = ways(family, z, found.kind, tangent)
        reversible = family.shooting.reversible
        if until is not None:
            until = (np.atleast_1d(until) - float(family.start)) / float(family.span)
        elif not reversible:
            until = 0.0, 1.0
        if found.kind == TORUS:
            return from_neimark_sacker(family, z, found.multiplier, until=until, **settings)
        settings |= {"until": until, "direction": np.sign(side) * direction}
        if reversible:
            curve = family.follow(x, q, find=(FOLD, BRANCH_POINT), **settings)
            return branch_of(family, curve, examined_along(family, curve))
        return _followed(family, x, q, response, BRANCH, **settings)

    def locus(
        self,
        i: Count | Bifurcation,
        make: Callable[..., Any],
        start: Scalar,
        until: Scalar,
        *,
        period: Callable[..., Any] | None = None,
        arclength: Scalar = 0.02,
        points: Count = 100,
    ) -> Locus:
        """Follow a fold, doubling, pitchfork, torus point or Krein collision in a second parameter.

        **Arguments:** `i`: an index into `bifurcations`, or a `Bifurcation`. `make(p, other)`: the
        lattice, traced; at `other = start` that of the branch. For a family over the frequency it
        is `make(other)`. `until`: the curve ends there, or where it returns to `start`; it passes
        its own folds. `period`: a function of p and `other`, where it depends on `other`.
        `arclength`: the first step, where the way from `start` to `until` counts 1; the longest is
        five times that. `points`: the most points. A branch point is followed as long as the
        lattice has the symmetry that it breaks.

        **Returns:** `Locus`, with cusps and strong resonances. **Raises** ValueError for lattices
        that do not begin with the branch; RuntimeError if the first point is not found.
        """
        found = self._bifurcation(i, LOCI)
        return locus(self._family, found, make, start, until, period, arclength, points)

    def continue_in(
        self, i: Count, make: Scene, start: Scalar, until: Scalar, **keywords: Any
    ) -> "Branch":
        """Follow the forced orbit at point i over another parameter, by `gx.forced.forced_branch`.

        `make`, `start`, `until`, `keywords`: as there. `period` is that of the orbit unless given.
        """
        orbit = self.orbit(i)
        given = {"period": float(orbit.period), "guess": orbit.state, "t0": self.t0}
        return forced_branch(make, start, until, **given | keywords)

    def _bifurcation(self, i, kinds):
        shooting = self._family.shooting
        found = i
        if not isinstance(i, Bifurcation):
            known = self.bifurcations
            if not is_site((i,), (len(known),)):
                breathers = shooting.reversible
                remedy = "gx.breathers.bifurcations(branch) finds them." if breathers else ""
                refuse("i", f"the index of one of {len(known)} bifurcations", described(i), remedy)
            found = known[i]
        if not shooting.reversible:
            kinds = [kind for kind in kinds if kind != KREIN]
        if found._z is None or found.kind not in kinds:
            pair = found.kind == "real pair at +1"
            remedy = "The branch point of that place is in branch.bifurcations." if pair else ""
            refuse("i", " or ".join(f"a {kind}" for kind in kinds), f"a {found.kind}", remedy)
        if shooting.driven and shooting.moves.size:
            refuse("branch", "a lattice that something holds", "one that moves freely")
        return found

    def orbit(self, i: Count) -> Orbit:
        """Return the `Orbit` at point i; -1 is the last."""
        family = self._family
        x, q = jax.device_put((self._curve.x[i], self._curve.p[i]))
        lattice, _ = family.scene(q)
        none = np.zeros((), int)
        residual = jnp.asarray(np.abs(residual_of(family, x, q)).max())
        unknown = np.full((x.size,) * 2, np.nan)
        root = Root(x, unknown, residual, residual, none, none, residual)
        known = self.states, self.periods, self.energy, self.state_error, self.energy_error
        state, period, energy, *apart = jax.tree.map(lambda y: jax.device_put(y[i]), known)
        exact = np.zeros(())
        return Orbit(
            state,
            period,
            lattice,
            root,
            family.shooting.whole,
            jnp.asarray(self.t0),
            energy,
            family.shooting.symmetry,
            OrbitError(*apart, exact, exact, **lattice.origin),
        )


def _bifurcation_at(family, kind, z, after, *known):
    # `known`: the multiplier, and the counts before and behind, if any.
    q = jnp.asarray(z[-1])
    state = family.shooting.state(z[:-1])
    origin = family.scene(q)[0].origin
    place = kind, float(family.value(q)), int(after)
    return Bifurcation(*place, state, *known, _z=z, **origin)


class _Examined(NamedTuple):
    # An orbit of a branch, its errors, and its tangent maps without units by several numbers of
    # steps, the most first: of a breather over half a period, in u and m v. `changes`: those of the
    # unknowns of the first segment between each two of these numbers.

    state: State
    period: Numbers
    energy: Numbers
    response: Numbers | None
    error: OrbitError
    response_error: Numbers | None
    maps: Numbers | None
    changes: Numbers

    @property
    def step_error(self) -> float:
        maps = np.asarray(self.maps)
        return float(np.abs(maps[0] - maps[-1]).max())


@compiled
def examined(family: Family, z: Numbers, response: Callable | None = None) -> _Examined:
    """Return the orbit z = (x, q) of a family, with errors and tangent maps."""
    # The steps of the family are compared with twice as many for a breather, else with 3/4 and 1/2
    # of them. The error is the largest change that other steps make.
    lattice, period = family.scene(z[-1])
    period = jnp.asarray(period, lattice.dtype)
    y = family.shooting.state(z[:-1])
    one = family.shooting.in_one()
    shares, own = ((2.0, 1.0), 1) if one.reversible else ((1.0, 0.75, 0.5), 0)
    counts = (one.flow.steps * jnp.array(shares)).astype(int)
    t0 = one.t0

    def flow(steps):
        return Flow(steps, one.flow.solver, one.flow.field)

    def mapped(steps):
        end, map_ = flow(steps).derivative(y, t0, t0 + period / one.parts, lattice)
        return ravel_pytree(end)[0] / one.scale, map_

    def responded(x, steps):
        _, ts, ys = history(flow(steps), lattice, one.state(x), t0, period, FRAMES)
        return answered(response, lattice, ys, ts)

    ends, maps = jax.lax.map(mapped, counts)
    x = one.guess(y)
    near = one.near(lattice, x, ends[:1], maps[:1] * one.scale / one.scale[:, None])
    gaps = jax.vmap(lambda end: near(x, end - ends[0]))(ends)
    inverse = jnp.linalg.inv(jax.jacfwd(near)(x))
    changes = jnp.stack([a - b for a, b in itertools.combinations(gaps, 2)]) @ inverse.T
    apart = covering(changes, rounding(inverse, jnp.max(jnp.abs(x))))
    state = one.state(nearby(x, -inverse @ gaps[own]))
    error = error_of(lattice, t0, state, one.state(apart), period)
    number = about = None
    if response is not None:
        # The orbit of each flow.
        others = x + jnp.concatenate([jnp.zeros_like(changes[:1]), changes[:2]])
        number, *numbers = jax.lax.map(lambda x: responded(*x), (others, counts))
        off = jnp.stack(numbers) - number
        about = covering(off[:, None], rounding(inverse, jnp.abs(number)))[0]
    mass = masses(lattice)
    if one.reversible:
        unit = jnp.concatenate([jnp.ones_like(mass), mass / mass.mean() * period])
    else:
        unit = weights(mass, period)
    maps = maps * unit[:, None] / unit
    energy = lattice.energy(t0, *state)
    return _Examined(state, period, energy, number, error, about, maps, changes)


def examined_along(
    family: Family, curve: Curve, response: Callable | None = None, stability: bool = True
) -> list[tuple]:
    """Return what is known of each orbit of a curve.

    That is the orbit without its maps, multipliers, their error, `step_error` and verdict. The next
    orbit's maps are computed while one is decomposed.
    """
    n = family.shooting.count
    reversible = family.shooting.reversible
    known = structure(family.scene(jax.device_put(curve.p[0]))[0])
    found = []
    orbits = (examined(family, z, response) for z in np.column_stack([curve.x, curve.p]))
    for here, _ in itertools.pairwise(itertools.chain(orbits, [None])):
        maps = np.asarray(here.maps)
        values = np.full(2 * n, np.nan, complex)
        error = np.full(2 * n, np.nan)
        verdict = ""
        if stability:
            values, error = (
                reversible_multipliers(*maps)[1:] if reversible else spectrum(*maps)[::2]
            )
            verdict = decide(values, error, known.expected, reversible or known.rate == 0)
        kept = jax.tree.map(np.asarray, here._replace(maps=None))
        found.append((kept, values, error, here.step_error, verdict))
    return found


def _neighbours(x):
    wide = np.concatenate([x[:1], x, x[-1:]])
    return np.max([wide[:-2], wide[1:-1], wide[2:]], axis=0)


def branch_of(
    family: Family,
    curve: Curve,
    along: list[tuple],
    bifurcations: Sequence[Bifurcation] | None = None,
) -> Branch:
    """Return the `Branch` of a curve, from the results of `examined_along`.

    By default its bifurcations are the folds and branch points that continuation has met.
    """
    if bifurcations is None:
        special = [(s.kind, np.append(s.x, s.p), s.after) for s in curve.special]
        bifurcations = [_bifurcation_at(family, *at) for at in special]
    found, multipliers, about, step_error, verdict = stacked(along)
    # An error may be small by accident: it is taken as large as its neighbours.
    error, response_error = jax.tree.map(_neighbours, (found.error, found.response_error))
    return Branch(
        # NumPy compiles nothing for another number of points.
        np.asarray(family.start) + curve.p * np.asarray(family.span),
        found.period,
        found.state,
        found.energy,
        found.response,
        error.state,
        error.energy,
        response_error,
        multipliers,
        about,
        step_error,
        verdict,
        tuple(bifurcations),
        float(family.shooting.t0),
        family,
        curve,
        **family.scene(jnp.asarray(curve.p[0]))[0].origin,
    )


KINDS = ("real pair at +1", "period doubling", "Krein collision", "extremum of energy")


@one_thread
def bifurcations(
    branch: Branch, kinds: str | Sequence[str] = KINDS, *, accuracy: Scalar = 1e-9
) -> list[Bifurcation]:
    r"""Return the bifurcations along a family, each located between two breathers.

    With mu = (rho + 1/rho)/2, a pair leaves the circle at +1 where mu crosses 1, and at -1 (period
    doubling) where it crosses -1. Two pairs of opposite Krein signature leave it where two mu meet
    and become complex. A mu that equals 1 within its error counts as one of the symmetries. From
    uncoupled sites to the first breather, none is sought at +1.

    **Arguments:** `branch`: from `gx.breathers.family`. `kinds`: any of "real pair at +1", "period
    doubling", "Krein collision", "extremum of energy". `accuracy`: relative, of `p`, apart from
    the error of the steps.

    **Returns:** `Bifurcation`s in order. Pairs that come and go within one step are missed: reduce
    `longest_arclength`. **Raises** ValueError for forced orbits.

    **Example:**

    >>> chain = gx.scenes.klein_gordon(5, 0.02)
    >>> branch = gx.breathers.family(chain, points=3, arclength=0.3, steps=64)
    >>> branch.verdict.tolist(), gx.breathers.bifurcations(branch)
    (['stable', 'stable', 'stable'], [])
    """
    if not branch._family.shooting.reversible:
        wanted = "a family of breathers"
        refuse("branch", wanted, "a branch of forced orbits", "Use branch.bifurcations.")
    kinds = [kinds] if isinstance(kinds, str) else kinds
    for kind in kinds:
        one_of("kinds", kind, KINDS)
    accuracy = float(tolerance("accuracy", accuracy, 1, 1e-9))
    found = []
    family = branch._family
    system = family.system()

    @functools.cache
    def known(*z):
        found = examined(family, np.array(z))
        return reversible_multipliers(*found.maps)[0], found.step_error

    slope = lambda point: _energy_slope(family, point.z, point.tangent)
    for i, (here, there) in enumerate(branch._curve.steps):
        events = []
        length = (there.z - here.z) @ here.tangent
        error = branch.energy_error[i : i + 2].max()

        def count(point, kind):
            if kind == KINDS[-1]:
                return int(slope(point) > 0)
            between = point is not here and point is not there
            return _counted(kind, *known(*point.z), 1 + family.shooting.moves.shape[1], between)

        for kind in kinds:
            # Without coupling the pairs of all sites that oscillate lie at +1.
            if kind == "real pair at +1" and (here.p == 0 or there.p == 0):
                continue
            before = count(here, kind)
            behind = count(there, kind)
            if before == behind:
                continue
            # An energy that is the same along the branch has slopes of rounding.
            if kind == KINDS[-1] and max(abs(slope(here)), abs(slope(there))) * length < error:
                continue
            test = lambda point: 1.0 if count(point, kind) == behind else -1.0
            size = max(abs(here.p), abs(there.p))
            share = accuracy * size / 4 / length
            point = system.zero(here, there, test, share)
            events.append((kind, point.z, before, behind))
        events.sort(key=lambda event: (event[1] - here.z) @ here.tangent)
        found += [_bifurcation_at(family, kind, z, i, None, *counts) for kind, z, *counts in events]
    return found


def _counted(kind, traces, step_error, symmetries, between):
    # Counts the multipliers of a kind from half-traces, of which one is 1 for each symmetry.
    # Two mu that nearly meet split like a square root of the error, but their sum does not: near 1
    # the sum decides, at the ends of a step once it exceeds the error, between them by its sign.
    error = max(step_error, 1e-12)
    near = np.abs(traces - 1) < max(1e-4, 10 * np.sqrt(error))
    apart = traces[~near]
    real = np.abs(apart.imag) <= np.sqrt(error)
    if kind == "Krein collision":
        return int(np.sum(~real)) // 2
    if kind == "period doubling":
        return int(np.sum(apart[real].real < -1))
    beyond = int(np.sum(apart[real].real > 1))
    # Those nearest to 1 belong to the symmetries. On a ring two pairs cross 1 together.
    near = traces[near]
    own = near[np.argsort(np.abs(near - 1))][symmetries:].real
    if len(set(own > 1)) == 1:
        return beyond + own.size * int(np.sum(near - 1).real > (0 if between else error))
    return beyond + int(np.sum(own > 1 + np.sqrt(error)))


@compiled
def _energy_slope(problem, z, tangent):
    # dE/ds along a tangent (x, q) of a branch.

    def total(z):
        state = problem.shooting.state(z[:-1])
        return problem.scene(z[-1])[0].energy(0.0, state.u, state.v)

    return jax.jvp(total, (z,), (tangent,))[1]


def _along_forced(family, curve, multipliers, response):
    # Folds are known already. Elsewhere the number of multipliers outside the unit circle changes,
    # and Brent's method finds where a modulus passes 1.
    found = []
    system = family.system()
    known = structure(family.scene(jax.device_put(curve.p[0]))[0])
    edge = 1 + (OFF_THE_CIRCLE if known.rate == 0 else 0)
    for i, (here, there) in enumerate(curve.steps):
        seen = {here.z.tobytes(): multipliers[i], there.z.tobytes(): multipliers[i + 1]}

        def look(z):
            # The multipliers but for those that symmetry puts at +1.
            if z.tobytes() not in seen:
                maps = examined(family, z, response).maps
                seen[z.tobytes()] = np.linalg.eigvals(maps[0])
            values = seen[z.tobytes()]
            return np.delete(values, of_symmetry(values, known.expected))

        def critical(z):
            # Of a pair, the multiplier above the real axis.
            values = look(z)
            rho = values[np.argmin(np.abs(np.abs(values) - edge))]
            return complex(rho.real, abs(rho.imag))

        moduli = lambda point: np.sort(np.abs(look(point.z)))[::-1]
        counts = sorted(np.count_nonzero(moduli(point) > edge) for point in (here, there))
        chord = there.z - here.z
        places = []
        length = np.linalg.norm(chord)
        along = lambda z: (z - here.z) @ chord
        for k in range(*counts):
            # The k-th modulus in order of size is continuous, whatever the multipliers do.
            test = lambda point: float(moduli(point)[k] - edge)
            z = system.zero(here, there, test, 1e-10, chord / length).z
            if all(np.linalg.norm(z - other) > 1e-7 * length for other in places):
                places.append(z)
        events = [(FOLD, np.append(s.x, s.p)) for s in curve.special if s.after == i]
        folds = len(events)
        for z in sorted(places, key=along):
            rho = critical(z)
            kind = BRANCH_POINT if rho.real > 0 else DOUBLING
            kind = (KREIN if known.rate == 0 else TORUS) if rho.imag > 1e-5 else kind
            if kind == BRANCH_POINT and folds:  # A modulus passes 1 at a fold too.
                folds -= 1
            else:
                events.append((kind, z))
        events.sort(key=lambda event: along(event[1]))
        found += [_bifurcation_at(family, kind, z, i, critical(z)) for kind, z in events]
    return tuple(found)


@one_thread
def forced_branch(
    make: Scene,
    start: Scalar,
    until: Scalar,
    *,
    period: Callable[[Any], Any] | Scalar,
    guess: StateLike | None = None,
    transient: Count = 0,
    t0: Scalar = 0.0,
    steps: Count | None = None,
    segments: Count = 1,
    solver: AbstractSolver | None = None,
    tolerance: Scalar = BRANCH,
    arclength: Scalar = 0.02,
    longest_arclength: Scalar | None = None,
    points: Count = 400,
    response: Response = rms_velocity,
) -> Branch:
    r"""Follow periodic orbits of a forced lattice over a parameter, through folds, stable or not.

    This is pseudo-arclength continuation of y(t0 + T; p) = y(t0). The multipliers of the same flow
    give the stability at every point. Where their number outside the unit circle changes, Brent's
    method on the modulus that passes 1 locates the bifurcation; continuation itself locates folds.
    Two bifurcations within one step whose changes cancel are missed: shorten `longest_arclength`.

    **Arguments:**

    - `make(p)`: the lattice at a value of the parameter, traced:
      `lambda f: driven_chain(chain, 0.1, 2 * jnp.pi * f)`. The same function again compiles
      nothing; a Module may also change its arrays.
    - `start`, `until`: the branch begins at p = `start` towards `until`, and ends at either.
    - `period`: T, a number, or a function of p such as `lambda f: 1 / f`.
    - `guess`, `transient`, `t0`, `segments`, `solver`: for the first orbit, as in `forced_orbit`.
    - `steps`: per period, the same along the branch. `None` begins with the larger default of
      `start` and `until`, and doubles the steps until half as many confirm every orbit to
      `tolerance`, relative to its size.
    - `arclength`, `longest_arclength`: first and longest (5 arclength) step along the branch. The
      way from `start` to `until` counts 1, and so does a change of the state by the first orbit's
      size, or by the change that its slope in p makes over the whole way, if that is more.
    - `points`: the most points. `response(lattice, u, v, t)`: a number from one period u, v (F, N),
      t (F,); by default the root mean square of all velocities.

    **Returns:** `Branch`. **Raises** ValueError for `until` equal to `start`, no forcing, and as
    `forced_orbit`; RuntimeError if the first orbit does not converge.
    Source: Doedel, Keller, Kernevez, Int. J. Bifurcation Chaos 1, 493 and 745 (1991); Kuznetsov,
    Elements of Applied Bifurcation Theory.

    **Example:**

    >>> chain = gx.scenes.monomer(3, precompression=1.0)
    >>> make = lambda a: gx.driven.driven_chain(chain, a, 0.5, damping=0.5)
    >>> branch = gx.forced.forced_branch(make, 0.01, 0.02, period=2 * np.pi / 0.5, steps=64, arclength=0.5)
    >>> branch.outcome
    'p reached 0.02.'
    >>> round(float(branch.response[-1] / branch.response[0]), 3)
    2.0
    """
    start = float(start)
    until = float(until)
    if start == until:
        refuse("until", "a value other than start", repr(until))
    period = period if callable(period) else positive("period", period)
    longest_arclength = 5 * arclength if longest_arclength is None else longest_arclength
    scenes = [made(make, period, p) for p in (start, until)]
    lattice, T = scenes[0]
    guess = rest(lattice) if guess is None else checked_state(lattice, guess, "guess")
    flows = [flow_over(lattice, T, steps, solver, segments, guess) for lattice, T in scenes]
    # As an array, so that another value compiles nothing new.
    flow = Flow(jnp.asarray(max(int(f.steps) for f in flows)), flows[0].solver)
    for lattice, T in scenes[::-1]:
        if checked_free(lattice):
            remedy = "Breathers over their frequency: gx.breathers.family."
            refuse("make", "a lattice under forcing", "none", remedy)
        checked_period(lattice, guess, t0, T)
    shooting, x = prepared(
        lattice, T, guess, flow, jnp.asarray(t0, lattice.dtype), segments, jnp.asarray(transient)
    )
    left = newtons(tolerance, lattice.dtype, LEFT_ON_BRANCH)
    family = Family(shooting, make, period, jnp.asarray(start), jnp.asarray(until - start), left)
    first = family.follow(x, 0.0, points=1)
    # The unit of length is the size of the first orbit, or of the change that its slope makes over
    # the whole way, if that is more. The share of dp in the first tangent is bounded from below, so
    # that a branch that begins near a fold does not count as infinitely steep. At rest it is the
    # amplitude at which the forces become nonlinear.
    slope = np.linalg.norm(first.tangents[0, :-1]) / max(abs(first.tangents[0, -1]), 1e-2)
    unit = max(np.linalg.norm(first.x[0]), slope)
    if unit <= AT_REST:
        length = nonlinear_length(lattice, t=t0 + GENERIC * T) / float(shooting.scale[0])
        if unit <= AT_REST * length < np.inf:
            unit = length
    unit = unit or 1.0
    family = eqx.tree_at(lambda f: f.shooting.scale, family, unit * shooting.scale)
    x = first.x[0] / unit
    return _followed(
        family,
        x,
        0.0,
        response,
        tolerance if steps is None else None,
        until=(0.0, 1.0),
        arclength=arclength,
        longest_arclength=longest_arclength,
        points=points,
    )


def _followed(family, x, q, response, tolerance, **settings):
    # Without a `tolerance` the steps stay.
    most = 2**DOUBLINGS * int(family.shooting.whole.steps)
    while True:
        curve = family.follow(x, q, find=(FOLD,), **settings)
        lattice = family.scene(jax.device_put(curve.p[0]))[0]
        if max(float(family.shooting.gap(lattice, x)) for x in curve.x) > DRIFT:
            raise RuntimeError(DRIFTING)
        along = examined_along(family, curve, response)
        looked, multipliers, *_ = zip(*along)
        enough = family
        if tolerance is not None:
            enough = _enough(family, curve, looked, response, tolerance, most)
        if enough is family:
            found = _along_forced(family, curve, multipliers, response)
            return branch_of(family, curve, along, found)
        # A branch that begins beside a bifurcation begins there again.
        family = enough
        x = x if "direction" in settings else curve.x[0]


def _enough(family, curve, looked, response, tolerance, most):
    # Doubles the steps until the worst known orbit is known well enough. Changes along the branch
    # do not count: at a fold the orbit may move along it.
    size = family.shooting.size

    def share(found, i):
        changes = np.asarray(found.changes)
        along = curve.tangents[i, :size]
        # An orbit at rest has neither.
        changes = changes - (changes @ along)[:, None] * along / (along @ along or 1)
        return np.abs(changes).max() / (np.abs(curve.x[i, :size]).max() or 1)

    shares = [share(found, i) for i, found in enumerate(looked)]
    worst = int(np.argmax(shares))
    known = [shares[worst]]
    z = np.append(curve.x[worst], curve.p[worst])
    # If two doublings help little, the steps are not the cause: another branch crosses there.
    while (
        known[-1] > tolerance
        and 2 * family.shooting.whole.steps <= most
        and not (len(known) > 2 and known[-1] > known[-3] / 4)
    ):
        family = family.with_steps(2 * family.shooting.flow.steps)
        known.append(share(examined(family, z, response), worst))
    return family
