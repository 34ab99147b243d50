"""The initial data of a run's shock, and the medium into which it runs."""

import numpy as np

from ..base.checks import refuse, show
from ..flow import Run
from ..lattice import Lattice, State
from ..profiles import Medium, medium_of
from .riemann import Riemann

# The relative difference below which strains are equal.
ALIKE = 1e-9


def problem_of(run: Run, problem: Riemann | None) -> Riemann:
    """Return the given problem, the one that the run remembers, or that of its first state.

    **Raises** ValueError where that is not a step in the strain or the velocity, for a batch, and
    for a run that stopped.
    """
    if np.ndim(run.energy_error):
        refuse(
            "run",
            "a run of one lattice",
            f"a batch of shape {np.shape(run.energy_error)}",
            "One at a time.",
        )
    if not bool(run.completed):
        refuse("run", "one that completed", run.outcome)
    if problem is None and isinstance(run.started, Riemann):
        problem = run.started
    if problem is not None:
        size = np.shape(problem.state.v)
        if np.shape(run.final.v) != size:
            refuse(
                "problem", f"that of the run, of {np.shape(run.final.v)} sites", f"one of {size}"
            )
        return problem
    if run.started is None:
        refuse(
            "problem",
            "what was run, as gx.shocks.velocity_shock returns it",
            "None, and the run does not hold it",
            "Give it: measure(run, problem).",
        )
    return _recognised(*run.started)


def _recognised(lattice: Lattice, state: State) -> Riemann:
    remedy = "Begin with gx.shocks.velocity_shock, step or piston; or give the problem: measure(run, problem)."
    if lattice.axes != 1 or lattice.fields is not None or lattice.dimension is not None:
        refuse("run", "one of a chain", f"a lattice of shape {lattice.shape}", remedy)
    u, v = (np.asarray(x, float) for x in state)
    y = u[:-1] - u[1:]
    if not u.any() and v.any():
        left = np.flatnonzero(v == v[0])
        right = np.flatnonzero(v == v[-1])
        middle = (left[-1] + right[0]) / 2
        if v[0] == -v[-1] and len(left) + len(right) == len(v) - (middle % 1 == 0):
            return Riemann(lattice, state, v[0] / 2, middle - 0.5, 0.0, "velocity")
    elif y.any() and not v.any():
        steps = np.flatnonzero(np.abs(np.diff(y)) > ALIKE * np.abs(y).max())
        if len(steps) == 1:
            return Riemann(lattice, state, y[0] - y[-1], steps[0] + 0.5, 0.0, "strain")
    elif not u.any() and any(getattr(term, "motion", None) is not None for term in lattice.terms):
        return Riemann(lattice, state, np.nan, -1.5, 0.0, "piston")
    refuse(
        "run",
        "one that begins with a step in the strain or the velocity, or a piston",
        f"velocities from {show(v.min())} to {show(v.max())}",
        remedy,
    )


def medium_before(problem: Riemann) -> Medium:
    """Return the law and the mass of the given chain. **Raises** ValueError for several."""
    if np.ndim(problem.rest) == 0:
        return medium_of(problem.lattice).known
    mass = np.asarray(problem.lattice.mass, float)
    if np.ptp(mass):
        refuse(
            "problem", "a chain of equal masses", f"masses from {mass.min():g} to {mass.max():g}"
        )
    medium = medium_of(problem.law, mass.flat[0])
    return medium._replace(origin=problem.lattice.origin).known
