"""Branches of forced orbits over a parameter, with their stability and bifurcations."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree
from scipy.optimize import brentq

from ..checks import positive, refuse
from ..continuation import continuation
from ..flow import Flow
from ..lattice import State
from ..measures import rms_velocity
from ..newton import nearby
from ..solvers import SRKN14a
from ..tuning import one_thread
from ..types import Count, Numbers, Scalar, StateLike
from .branch import BRANCH_POINT, DOUBLING, FOLD, TORUS, Bifurcation, Branch, verdicts_of
from .confirm import (
    BRANCH,
    DOUBLINGS,
    LEFT_ON_BRANCH,
    OrbitError,
    covering,
    error_of,
    neighbours,
    newtons,
    rounding,
)
from .orbit import FRAMES, checked_free, prepared
from .problems import Family, made
from .repeats import checked_state, checked_symmetry
from .spectrum import spectrum
from .steps import answered, fixed_step_solver, flow_over, history
from .structure import structure, weights
from .symmetry import Symmetry

# of dp along the first tangent, so that a branch that begins near a fold does not count as endlessly steep
LEAST_SLOPE = 1e-2
# of two doublings of the steps, the least that they must lower an error by
HELPS = 4
# fractions of the way between two points: how near a bifurcation is found, and how far another one lies at least
LOCATED, APART = 1e-10, 1e-7


@one_thread
def forced_branch(
    make: Callable[[Any], Any],
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
    response: Callable[[Any, Any, Any, Any], Any] = rms_velocity,
) -> Branch:
    r"""Follow the periodic orbits of a forced lattice over a parameter, through folds, stable or not.

    Pseudo-arclength continuation of y(t0 + T; p) = y(t0). Stability at every point by the multipliers of the same
    flow; where their number outside the unit circle changes, the bifurcation between is located by Brent's method on
    the modulus that passes 1, folds by continuation itself. Two bifurcations within one step whose changes cancel
    are not seen: shorten `longest_arclength`.

    **Arguments:**

    - `make(p)`: the lattice at a value of the parameter, traced: `lambda f: driven_chain(chain, 0.1, 2 * jnp.pi * f)`.
      The same function again compiles nothing; a Module with arrays may change them too.
    - `start`, `until`: the branch begins at p = `start` towards `until`, and ends at either.
    - `period`: T, a number, or a function of p such as `lambda f: 1 / f`.
    - `guess`, `transient`, `t0`, `segments`, `solver`: of the first orbit, as in `forced_orbit`.
    - `steps`: per period, the same all along; `None` begins with the most that `start` or `until` asks for, and doubles
      them until half as many confirm every orbit to `tolerance`, relative to its size.
    - `arclength`, `longest_arclength`: first and longest (5 arclength) step along the branch, in which the
      way from `start` to `until` counts 1, and so does a change of the state by the first orbit's size, or by what its
      slope in p makes over the whole way, if that is more.
    - `points`: the most points. `response(lattice, u, v, t)`: a number from one period u, v (F, N), t (F,); by
      default the root mean square of all velocities.

    **Returns:** `Branch`. **Raises** ValueError for `until` equal to `start`, no forcing, and as `forced_orbit`;
    RuntimeError where the first orbit does not converge.
    Source: Doedel, Keller, Kernevez, Int. J. Bifurcation Chaos 1, 493 and 745 (1991); Kuznetsov, Elements of Applied
    Bifurcation Theory.

    **Example:**

    >>> chain = gx.scenes.monomer(3, precompression=1.0)
    >>> make = lambda a: gx.driven.driven_chain(chain, a, 0.5, damping=0.5)
    >>> branch = gx.forced.forced_branch(make, 0.01, 0.02, period=2 * np.pi / 0.5, steps=64, arclength=0.5)
    >>> branch.outcome
    'p reached 0.02.'
    >>> round(float(branch.response[-1] / branch.response[0]), 3)
    2.0
    """
    start, until = float(start), float(until)
    if start == until:
        refuse("until", "another value than start", repr(until))
    period = period if callable(period) else positive("period", period)
    longest_arclength = 5 * arclength if longest_arclength is None else longest_arclength
    scenes = [made(make, period, p) for p in (start, until)]
    solver = fixed_step_solver(scenes[0][0], solver, SRKN14a())
    lattice, T = scenes[0]
    guess = (
        State(lattice.zeros(), lattice.zeros())
        if guess is None
        else checked_state(lattice, guess, "guess")
    )
    flows = [flow_over(lattice, T, steps, solver, segments, guess) for lattice, T in scenes]
    # an array, whose value compiles nothing anew
    flow = Flow(jnp.asarray(max(int(f.steps) for f in flows)), solver)
    for lattice, T in scenes[::-1]:
        if checked_free(lattice):
            refuse(
                "make",
                "a lattice under forcing",
                "none",
                "Breathers over their frequency: gx.breathers.family.",
            )
        checked_symmetry(lattice, Symmetry(), guess, t0, T)
    shooting, x = prepared(
        lattice, T, guess, flow, jnp.asarray(t0, lattice.dtype), segments, jnp.asarray(transient)
    )
    family = Family(shooting, make, period, jnp.asarray(start), jnp.asarray(until - start))
    settings = {"tolerance": newtons(tolerance, lattice.dtype, LEFT_ON_BRANCH), "find": ("fold",)}
    first = continuation(family.residual, x, 0.0, linearise=family.linearise, points=1, **settings)
    # the unit of length: the first orbit, or where its slope over the whole way leads, if that is more
    slope = np.linalg.norm(first.tangents[0, :-1]) / max(abs(first.tangents[0, -1]), LEAST_SLOPE)
    unit = max(np.linalg.norm(first.x[0]), slope) or 1.0
    family = eqx.tree_at(lambda f: f.shooting.scale, family, unit * shooting.scale)
    x0, settings["linearise"] = first.x[0] / unit, family.linearise
    most = 2**DOUBLINGS * int(flow.steps)
    while True:
        curve = continuation(
            family.residual,
            x0,
            0.0,
            until=(0.0, 1.0),
            arclength=arclength,
            longest_arclength=longest_arclength,
            points=points,
            **settings,
        )
        z = np.column_stack([curve.x, curve.p])
        looked = [_examined(family, flow, point, response) for point in z]
        if steps is not None:
            break
        enough = _enough(family, flow, curve, looked, response, tolerance, most)
        if enough == flow.steps:
            break
        flow = Flow(jnp.asarray(enough), solver)
        family = eqx.tree_at(
            lambda f: f.shooting.flow.steps, family, jnp.asarray(enough // segments)
        )
        x0, settings["linearise"] = curve.x[0], family.linearise
    known = structure(lattice)
    scales = [weights(known.mass, found.period) for found in looked]
    maps = [np.asarray(found.maps) * scale[:, None] / scale for found, scale in zip(looked, scales)]
    spectra = [spectrum(*three)[::2] for three in maps]
    multipliers, errors, verdicts = verdicts_of(spectra, known.expected, False)
    states, periods, energies, responses, errors_of_orbits, about = (
        jax.tree.map(lambda *x: np.stack(x), *part) for part in list(zip(*looked))[:6]
    )

    # one that is small by accident is as large as its neighbours
    errors_of_orbits, about = jax.tree.map(neighbours, (errors_of_orbits, about))

    def look(point):
        return np.linalg.eigvals(np.asarray(_examined(family, flow, point, response).maps[0]))

    found = _bifurcations(family, look, z, curve.special, multipliers, settings)
    return Branch(
        family.values(curve.p),
        periods,
        states,
        energies,
        responses,
        errors_of_orbits.state,
        errors_of_orbits.energy,
        about,
        multipliers,
        errors,
        np.array([np.abs(fine - coarser).max() for fine, _, coarser in maps]),
        verdicts,
        found,
        family.outcome(curve),
        float(t0),
        flow,
        family,
        curve,
        **family.scene(jnp.asarray(curve.p[0]))[0].origin,
    )


class Examined(NamedTuple):
    """An orbit of the branch, its errors, and monodromy matrices by the flow's steps, 3/4 and 1/2 of them.

    `changes`: of the state (3, 2n), by other steps.
    """

    state: State
    period: Numbers
    energy: Numbers
    response: Numbers
    error: OrbitError
    response_error: Numbers
    maps: Numbers
    changes: Numbers


@eqx.filter_jit
def _examined(family, flow, z, response):
    """What there is to say of an orbit; its error is the most that the other steps change."""
    (lattice, period), state = family.scene(z[-1]), family.shooting.state(z[:-1])
    t0, period = family.shooting.t0, jnp.asarray(period, lattice.dtype)

    def responded(y, n):
        _, ts, ys = history(Flow(n, flow.solver), lattice, y, t0, period, FRAMES)
        return answered(response, lattice, ys, ts)

    def mapped(n):
        end, map_ = Flow(n, flow.solver).derivative(state, t0, t0 + period, lattice)
        return ravel_pytree(end)[0], map_

    counts = jnp.stack([flow.steps, 3 * flow.steps // 4, flow.steps // 2])
    ends, maps = jax.lax.map(mapped, counts)
    # in one unit for displacements and one for velocities
    flat, unravel = ravel_pytree(state)
    scale = jnp.where(jnp.arange(flat.size) < flat.size // 2, 2 * jnp.pi, period)
    inverse = jnp.linalg.inv(jnp.eye(flat.size) - maps[0] * scale[:, None] / scale)
    changes = (
        jnp.stack([ends[1] - ends[0], ends[2] - ends[0], ends[2] - ends[1]]) * scale @ inverse.T
    )
    # of each flow's own orbit
    others = flat + jnp.concatenate([jnp.zeros_like(changes[:1]), changes[:2]]) / scale
    numbers = jax.lax.map(lambda x: responded(unravel(x[0]), x[1]), (others, counts))
    about = covering((numbers[1:] - numbers[0])[:, None], rounding(inverse, jnp.abs(numbers[0])))[0]
    state = unravel(nearby(flat * scale, inverse @ ((ends[0] - flat) * scale)) / scale)
    apart = covering(changes, rounding(inverse, jnp.max(jnp.abs(flat * scale))))
    error = error_of(lattice, t0, state, unravel(apart / scale), 2 * jnp.pi / period, jnp.zeros(()))
    return Examined(
        state, period, lattice.energy(t0, *state), numbers[0], error, about, maps, changes / scale
    )


def _enough(family, flow, curve, looked, response, tolerance, most):
    """Steps for which the branch is known well enough where it is known worst.

    What moves an orbit along the branch does not count: at a fold that is all.
    """
    scale = np.asarray(family.shooting.scale)

    def share(found, i):
        changes, along = np.asarray(found.changes) / scale, curve.tangents[i, : len(scale)]
        # of an orbit at rest neither is there
        changes = changes - (changes @ along)[:, None] * along / (along @ along or 1)
        return np.abs(changes).max() / (np.abs(curve.x[i, : len(scale)]).max() or 1)

    shares = [share(found, i) for i, found in enumerate(looked)]
    worst, steps = int(np.argmax(shares)), int(flow.steps)
    known, z = [shares[worst]], np.append(curve.x[worst], curve.p[worst])
    # where two doublings help little it is not the steps: another branch crosses there
    while (
        known[-1] > tolerance
        and 2 * steps <= most
        and not (len(known) > 2 and known[-1] > known[-3] / HELPS)
    ):
        steps *= 2
        known.append(
            share(_examined(family, Flow(jnp.asarray(steps), flow.solver), z, response), worst)
        )
    return steps


def _bifurcations(family, look, z, folds, multipliers, settings):
    """All of them in the order of the branch; folds are known already."""
    outside, found = np.count_nonzero(np.abs(multipliers) > 1, axis=1), []

    def add(kind, i, point, rho):
        p, state = float(family.value(point[-1])), State(*family.shooting.state(point[:-1]))
        event = Bifurcation(
            kind, p, int(i), state, critical(rho), **family.scene(jnp.asarray(point[-1]))[0].origin
        )
        found.append((i, np.linalg.norm(point - z[i]), event))

    for fold in folds:
        point = np.append(fold.x, fold.p)
        add(FOLD, fold.after, point, look(point))
    for i in np.flatnonzero(outside[1:] != outside[:-1]):
        way = Between(family, look, z[i : i + 2], multipliers[i : i + 2], settings)
        unmatched = sum(fold.after == i for fold in folds)
        for s in way.crossings():
            point, rho = way.at(s)
            kind = kind_of(critical(rho))
            if kind == BRANCH_POINT and unmatched:
                unmatched -= 1
            else:
                add(kind, i, point, rho)
    return tuple(event for *_, event in sorted(found, key=lambda entry: entry[:2]))


class Between:
    """The branch between two of its points, z = (x, q), over a fraction s of the chord that joins them.

    `at_ends`: multipliers there. `look(z)`: multipliers of the orbit z. `settings`: tolerance and derivative, as
    continuation takes them.
    """

    def __init__(self, family, look, ends, at_ends, settings):
        self.family, self.look, self.ends, self.settings = family, look, ends, settings
        self.known = {0.0: (ends[0], at_ends[0]), 1.0: (ends[1], at_ends[1])}

    def at(self, s: float) -> tuple:
        """(z, multipliers) of the orbit in the plane across the chord at s."""
        if s not in self.known:
            low, chord = self.ends[0], self.ends[1] - self.ends[0]
            curve = continuation(
                self.family.residual,
                low[:-1],
                low[-1],
                direction=chord,
                arclength=s * np.linalg.norm(chord),
                points=1,
                **self.settings,
            )
            z = np.append(curve.x[0], curve.p[0])
            self.known[s] = z, self.look(z)
        return self.known[s]

    def crossings(self) -> list[float]:
        """Fractions at which a modulus passes 1, in order: as many as the number of unstable multipliers changes by."""
        counts = [np.count_nonzero(np.abs(self.at(s)[1]) > 1) for s in (0.0, 1.0)]
        found = []
        for k in range(min(counts), max(counts)):
            # the k-th modulus in order of size is continuous, whatever the multipliers do
            excess = lambda s: float(np.sort(np.abs(self.at(s)[1]))[::-1][k] - 1)
            try:
                s = brentq(excess, 0.0, 1.0, xtol=LOCATED, rtol=LOCATED)
            except RuntimeError:  # Newton failed on the way: as near as it came
                s = min(self.known, key=lambda s: abs(excess(s)))
            if not found or min(abs(s - other) for other in found) > APART:
                found.append(s)
        return sorted(found)


def kind_of(multiplier: complex, near: float = 1e-5) -> str:
    """The kind of a bifurcation with this multiplier on the unit circle; one at +1 is a branch point."""
    if abs(multiplier.imag) > near:
        return TORUS
    return BRANCH_POINT if multiplier.real > 0 else DOUBLING


def critical(multipliers: np.ndarray) -> complex:
    """The multiplier nearest to the unit circle, of a pair the one above the real axis."""
    rho = multipliers[np.argmin(np.abs(np.abs(multipliers) - 1))]
    return complex(rho.real, abs(rho.imag))
