"""Branches of forced orbits over a parameter, with their stability and bifurcations."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import parameter, positive, refuse
from ..continuation import continuation
from ..floquet import decide, spectrum, structure
from ..flow import Flow
from ..lattice import State
from ..measures import rms_velocity
from ..orbits import flow_over, history
from ..solvers import SRKN14a
from ..tuning import one_thread
from .events import BRANCH_POINT, FOLD, Between, Bifurcation, critical, kind_of
from .family import Family, period_at
from .orbit import FRAMES, checked_guess, forced_orbit, prepared

# of dp along the first tangent, so that a branch that begins near a fold does not count as endlessly steep
LEAST_SLOPE = 1e-2


class ForcedBranch(eqx.Module):
    """Orbits along a parameter; what `forced_branch` returns.

    - `p` (P,), `periods` (P,), `states` at t0: a `State` of (P, N). `response` (P,): the chosen number.
    - `multipliers` (P, 2n), the largest modulus first, and the error of each, `errors` (P, 2n), from a flow of half as
      many steps. `verdicts` (P,): "stable", "unstable" or "undecided".
    - `bifurcations`: a tuple of `Bifurcation` in the order of the branch. `outcome`: why the branch ended.
    """

    p: np.ndarray
    periods: np.ndarray
    states: State
    response: np.ndarray
    multipliers: np.ndarray
    errors: np.ndarray
    verdicts: np.ndarray
    bifurcations: tuple[Bifurcation, ...]
    outcome: str = eqx.field(static=True)
    make: Callable
    t0: float
    steps: int
    segments: int

    @property
    def folds(self):
        """Values of the parameter at the folds."""
        return np.array([b.p for b in self.bifurcations if b.kind == FOLD])

    @property
    def stable(self):
        """Which points are stable, (P,)."""
        return self.verdicts == "stable"

    def orbit(self, i):
        """The `Orbit` at point i."""
        state = jax.tree.map(lambda x: x[i], self.states)
        return forced_orbit(self.make(jnp.asarray(self.p[i])), self.periods[i], state, t0=self.t0, steps=self.steps,
                            segments=self.segments)


@one_thread
def forced_branch(
    make, start, until, *, period, guess=None, transient=0, t0=0.0, steps=None, segments=1, solver=SRKN14a(),
    tolerance=1e-10, arclength=0.02, longest_arclength=None, points=400,
    response=rms_velocity,
):
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
    - `guess`, `transient`, `t0`, `segments`, `solver`, `tolerance`: of the first orbit, as in `forced_orbit`.
    - `steps`: per period, the same all along; `None` is the most that `start` or `until` asks for.
    - `arclength`, `longest_arclength`: first and longest (5 arclength) step along the branch, in which the
      way from `start` to `until` counts 1, and so does a change of the state by the first orbit's size, or by what its
      slope in p makes over the whole way, if that is more.
    - `points`: the most points. `response(lattice, u, v, t)`: a number from one period u, v (F, N), t (F,); by
      default the root mean square of all velocities.

    **Returns:** `ForcedBranch`. **Raises** ValueError for `until` equal to `start`, and as `forced_orbit`;
    RuntimeError where the first orbit does not converge.
    Source: Doedel, Keller, Kernevez, Int. J. Bifurcation Chaos 1, 493 and 745 (1991); Kuznetsov, Elements of Applied
    Bifurcation Theory.
    """
    start, until = (float(parameter(name, x)) for name, x in (("start", start), ("until", until)))
    if start == until:
        refuse("until", "another value than start", repr(until))
    period = period if callable(period) else positive("period", period)
    scenes = [(make(jnp.asarray(p)), period_at(period, p)) for p in (start, until)]
    flows = [flow_over(lattice, T, steps, solver, segments) for lattice, T in scenes]
    # an array, whose value compiles nothing anew
    flow = Flow(jnp.asarray(max(int(f.steps) for f in flows)), solver)
    lattice, T = scenes[0]
    guess = State(lattice.zeros(), lattice.zeros()) if guess is None else checked_guess(lattice, guess)
    shooting, x = prepared(lattice, T, guess, flow, jnp.asarray(t0, lattice.dtype), segments, jnp.asarray(transient))
    family = Family(shooting, make, period, jnp.asarray(start), jnp.asarray(until - start))
    settings = {"tolerance": tolerance, "find": ("fold",)}
    first = continuation(family.residual, x, 0.0, linearise=family.linearise, points=1, **settings)
    # the unit of length: the first orbit, or where its slope over the whole way leads, if that is more
    slope = np.linalg.norm(first.tangents[0, :-1]) / max(abs(first.tangents[0, -1]), LEAST_SLOPE)
    unit = max(np.linalg.norm(first.x[0]), slope) or 1.0
    family = eqx.tree_at(lambda f: f.shooting.scale, family, unit * shooting.scale)
    settings["linearise"] = family.linearise
    curve = continuation(
        family.residual, first.x[0] / unit, 0.0, until=(0.0, 1.0), arclength=arclength,
        longest_arclength=longest_arclength or 5 * arclength, points=points, **settings)
    z = np.column_stack([curve.x, curve.p])
    looked = [_examined(family, flow, point, response) for point in z]
    spectra = [spectrum(np.asarray(fine), np.asarray(coarse)) for _, _, _, fine, coarse in looked]
    expected = structure(lattice).expected
    verdicts = np.array([decide(rho, error, expected, False)[0] for rho, _, error in spectra])
    states, periods, responses = (jax.tree.map(lambda *x: np.stack(x), *part) for part in list(zip(*looked))[:3])
    multipliers, errors = np.stack([s[0] for s in spectra]), np.stack([s[2] for s in spectra])

    def look(point):
        return np.linalg.eigvals(np.asarray(_examined(family, flow, point, response)[3]))

    found = _bifurcations(family, look, z, curve.special, multipliers, settings)
    p = start + curve.p * (until - start)
    # continuation knows the share of the way alone
    outcome = f"p reached {p[-1]:.6g}." if curve.outcome.startswith("p reached") else curve.outcome
    return ForcedBranch(
        p, periods, State(*states), responses, multipliers, errors, verdicts, found, outcome, make, float(t0),
        int(flow.steps), segments,
    )


@eqx.filter_jit
def _examined(family, flow, z, response):
    """State, period, response and two monodromy matrices of an orbit, the finer flow's first."""
    (lattice, period), state = family.scene(z[-1]), family.shooting.state(z[:-1])
    t0 = family.shooting.t0
    _, ts, ys = history(flow, lattice, state, t0, period, FRAMES)
    number = response(lattice, ys.u, ys.v, ts)
    counts = jnp.stack([flow.steps, flow.steps // 2])
    fine, coarse = jax.lax.map(lambda n: Flow(n, flow.solver).derivative(state, t0, t0 + period, lattice)[1], counts)
    return state, jnp.asarray(period), number, fine, coarse


def _bifurcations(family, look, z, folds, multipliers, settings):
    """All of them in the order of the branch; folds are known already."""
    outside, found = np.count_nonzero(np.abs(multipliers) > 1, axis=1), []

    def add(kind, i, point, rho):
        p = float(family.start + point[-1] * family.span)
        event = Bifurcation(kind, p, critical(rho), State(*family.shooting.state(point[:-1])), i)
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
