"""All solutions from some guesses: equilibria, breathers, forced orbits."""

import abc
import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree

from ..base.checks import positive, refuse
from ..base.types import Count, Numbers, Scalar, StateLike
from ..continuation.arclength import APART, Problem, another, solve
from ..continuation.equilibria import equilibrium, left_over, posed, sizes
from ..flow import Flow
from ..lattice import Lattice, State
from ..results import Result, array, note, part
from ..solvers import KahanLi8
from ..states import rest
from .asked import (
    Mirror,
    Sign,
    Symmetry,
    Translation,
    checked_lattice,
    checked_period,
    checked_state,
    flow_over,
    one_lattice,
    shifts,
    stacked,
)
from .families import breather, half_steps
from .orbit import checked_free, forced_orbit
from .problems import Family, Shooting


class Sought(Problem):
    """The problem F(x) = 0 that `find_all` solves, and the meaning of its unknowns."""

    lattice: eqx.AbstractVar[Lattice]

    @abc.abstractmethod
    def unknowns(self, state: StateLike) -> Numbers:
        """Return the unknowns of a state, all of them lengths."""

    @abc.abstractmethod
    def state(self, x: Numbers) -> State:
        """Return the state of the unknowns."""

    @abc.abstractmethod
    def solution(self, state: StateLike) -> Result:
        """Return the solution next to a state, with its error."""

    def later(self, state: StateLike) -> State | None:
        """Return the state half a period later, `None` at rest."""
        return None

    def trivial(self) -> list[np.ndarray]:
        """Return solutions that are not looked for."""
        return []

    def images(self, x: Numbers) -> list[tuple[str | None, np.ndarray]]:
        """Return (name, unknowns) of the images under symmetries that a lattice may have.

        The name is `None` for the same orbit half a period later.
        """
        state = self.state(jnp.asarray(x))
        signs = [Symmetry(), Sign()]
        if self.lattice.dimension is None and self.lattice.axes == 1:
            signs += [Mirror(), Mirror() @ Sign()]
        size = min(x.shape[0] for x in jax.tree.leaves(self.lattice.template()))
        found = []
        for later, there in ((False, state), (True, self.later(state))):
            for symmetry in [Translation(n) @ b for n in range(size) for b in signs]:
                if there is not None and (later or not symmetry.trivial):
                    name = f"{symmetry!r}, half a period later" if later else repr(symmetry)
                    y = np.asarray(self.unknowns(symmetry(there)))
                    found.append((None if symmetry.trivial else name, y))
        return found


class _AtRest(Sought):
    lattice: Lattice
    posed: Any

    def residual(self, x, p):
        return left_over(x, self.posed)

    def unknowns(self, state):
        return ravel_pytree(state[0])[0]

    def state(self, x):
        return State(ravel_pytree(self.lattice.zeros())[1](x), self.lattice.zeros())

    def solution(self, state):
        return equilibrium(self.lattice, guess=state, hold="loads")


class _Returning(Sought, Family):
    # Orbits of one lattice and one period.

    @property
    def lattice(self):
        return self.make

    def unknowns(self, state):
        return self.shooting.guess(state, (self.make, self.period))

    def state(self, x):
        return self.shooting.state(x)

    def trivial(self):
        # At rest every time is a period.
        return [np.asarray(self.unknowns(rest(self.lattice)))] if self.shooting.reversible else []

    def later(self, state):
        flow = self.shooting.flow
        if not self.shooting.reversible:
            flow = Flow(flow.steps // 2, flow.solver)
        t0 = self.shooting.t0
        return flow(state, t0, t0 + self.period / 2, self.lattice)

    def solution(self, state):
        if self.shooting.reversible:
            omega = 2 * np.pi / float(self.period)
            return breather(self.lattice, omega, state, check=False)
        return forced_orbit(self.lattice, float(self.period), state, t0=float(self.shooting.t0))


def problem(
    lattice: Lattice,
    *,
    omega: Scalar | None = None,
    period: Scalar | None = None,
    t0: Scalar = 0.0,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
) -> Sought:
    """Pose the problem that `find_all` solves: equilibria, breathers, or forced orbits.

    **Arguments:** `lattice`: one `Lattice`. Without `omega` and `period` its equilibria are sought.
    `omega` [rad/s]: breathers of this frequency, time-reversible and at rest twice a period, of a
    conservative, autonomous lattice. `period` [s]: orbits of this period under forcing, at the
    phase `t0`. `steps`, `solver`: as in `gx.breathers.breather` and `gx.forced.forced_orbit`; finer
    steps confirm the solutions.
    **Returns:** the problem, a `gx.continuation.Problem`.
    **Raises** ValueError for both a frequency and a period, and as those functions do.
    """
    one_lattice(lattice)
    if omega is not None and period is not None:
        refuse("period", "a period or a frequency", "both", "Breathers have no forcing.")
    if period is None:
        checked_lattice(lattice)
        if omega is None:
            at_rest = posed(lattice, "loads", None, None)
            *_, scale = sizes(at_rest, at_rest.guess)
            return _AtRest(lattice, dataclasses.replace(at_rest, scale=scale))
        period = 2 * np.pi / float(positive("omega", omega))
        flow = Flow(jnp.asarray(half_steps(lattice, period, steps)), solver or KahanLi8())
        shooting = Shooting.half(lattice, flow, omega=2 * np.pi / period)
        return _Returning(shooting, lattice, jnp.asarray(period))
    if checked_free(lattice):
        refuse("lattice", "a lattice under forcing", "none", "Give omega=, for its breathers.")
    period = float(positive("period", period))
    start = rest(lattice)
    checked_period(lattice, start, t0, period)
    flow = flow_over(lattice, period, steps, solver, 2, start)
    n = shifts(lattice).shape[0]
    scale = jnp.asarray(np.repeat([1.0, 2 * np.pi / period], n))
    shooting = Shooting.of(lattice, flow, t0=jnp.asarray(t0, lattice.dtype), scale=scale)
    return _Returning(shooting, lattice, jnp.asarray(period))


class Solutions(Result):
    """Solutions of one problem, from `find_all`."""

    solutions: tuple[Any, ...] = array(
        "The solutions, each with its error. None is a symmetric copy of another.", axes="solution"
    )
    states: State = part("The state of each solution.", "solution site", name="state")
    copies: tuple[tuple[str, ...], ...] = note(
        "The symmetries that map each solution to another one."
    )

    @property
    def outcome(self) -> str:
        """How many solutions were found."""
        count = len(self.solutions)
        return f"{count} solutions, {count + sum(map(len, self.copies))} with symmetric copies."


def find_all(sought: Sought, guesses: Sequence[StateLike], *, most: Count = 20) -> Solutions:
    """Find distinct solutions of a problem by Newton's method with deflation, from each guess.

    Known solutions are divided out, with their symmetric copies (the sign, translations along the
    first axis, the mirror image of a chain, half a period later). So the same guess leads to
    another solution, until it leads to none. Other symmetries of a lattice are not tried. No such
    search proves that there are no more solutions.

    **Arguments:** `sought`: from `problem`. `guesses`: `State`s, not all at rest at u = 0. `most`:
    the most solutions.
    **Returns:** `Solutions`, of `Equilibrium`s or `Orbit`s. **Raises** ValueError for guesses that
    do not fit; RuntimeError if nothing is found.
    Source: Farrell, Birkisson, Funke, SIAM J. Sci. Comput. 37, A2026 (2015).

    **Example:**

    >>> wells = gx.OnSite(gx.Polynomial(-1.0, 0.0, 1.0))
    >>> pair = gx.Lattice(1.0, (wells, gx.Bond(gx.Shift(1, "free"), gx.Linear(0.2))), sites=2)
    >>> found = gx.orbits.find_all(gx.orbits.problem(pair), [gx.State(jnp.array([0.5, 0.2]), jnp.zeros(2))])
    >>> for rest, copies in zip(found.solutions, found.copies):
    ...     print(np.array(rest.state.u).round(4).tolist(), rest.verdict, len(copies))
    [0.864, -0.2315] unstable 3
    [0.0, 0.0] unstable 0
    [1.0, 1.0] stable 1
    [0.7746, -0.7746] stable 1
    """
    states = [checked_state(sought.lattice, guess, "guess") for guess in guesses]
    starts = [np.asarray(sought.unknowns(state)) for state in states]
    size = max((float(np.abs(x).max()) for x in starts), default=0.0)
    if not size > 0:
        refuse("guesses", "states that are not all at rest at u = 0", f"{len(starts)} of them")
    roots = []
    copies = []
    known = sought.trivial()
    for start in starts:
        while len(roots) < most:
            x = another(sought, start, known, size)
            if x is None:
                break
            known.append(x)
            roots.append(x)
            copies.append(())
            # An image is a solution if the lattice has the symmetry.
            names, images = zip(*sought.images(x))
            for name, y, solves in zip(names, images, solve(sought, x, images, size)):
                if solves and all(np.abs(y - other).max() > APART * size for other in known):
                    known.append(y)
                    copies[-1] += () if name is None else (name,)
    if not roots:
        raise RuntimeError("Newton's method found no solution from any of the guesses.")
    found = tuple(sought.solution(sought.state(jnp.asarray(x))) for x in roots)
    states = stacked(one.state for one in found)
    return Solutions(found, states, tuple(copies), **sought.lattice.origin)
