"""Ladders of solvers on a lattice: which solvers, which steps and tolerances."""

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import diffrax
import jax
import numpy as np
from jax.flatten_util import ravel_pytree

from ..checks import one_of, refuse
from ..flow import frequency_bound, linear_frequency, simulate
from ..flow.dispatch import facts
from ..lattice import Lattice, State
from ..solvers import (
    RKN86,
    RKN1210,
    KahanLi8,
    SofroniouSpaletta10,
    SRKN6b,
    SRKN11b,
    SRKN14a,
    VelocityVerlet,
)
from ..solvers.stability import stability_limit
from ..types import Parameter, Pytree, Scalar
from .ladder import DEFAULT, Ladder, checked_values

Solvers: TypeAlias = dict[str, diffrax.AbstractSolver]

SPLITTING = (VelocityVerlet, SRKN6b, SRKN11b, SRKN14a, KahanLi8, SofroniouSpaletta10)
NYSTROM = (RKN86, RKN1210)
DIFFRAX = (diffrax.Tsit5, diffrax.Dopri8)
TOLERANCES = np.array([float(f"1e-{k}") for k in range(2, 15)])
# of the stability limit: just inside
FIRST_STEP = 0.95
MOST_STEPS, LEAST_INTERVALS = 48, 4
# a solver whose order is not known
ORDER = 4


def splits(lattice: Lattice) -> bool:
    """Whether splitting solvers take the lattice."""
    return facts(lattice).splits


def reads_velocity(lattice: Lattice) -> bool:
    """Whether a force reads the velocity, so that Nystrom pairs do not take the lattice."""
    return facts(lattice).reads_velocity


def sensible_solvers(lattice: Lattice) -> Solvers:
    """A dict from name to solver: all that take the lattice, and diffrax's Tsit5 and Dopri8."""
    kinds = (
        (SPLITTING if splits(lattice) else ())
        + (() if reads_velocity(lattice) else NYSTROM)
        + DIFFRAX
    )
    return {kind.__name__: kind() for kind in kinds}


def checked_solvers(
    solvers: diffrax.AbstractSolver | Sequence | Mapping | None, lattice: Lattice
) -> Solvers:
    """A dict from name to solver. **Raises** ValueError for what is no solver."""
    if solvers is None:
        return sensible_solvers(lattice)
    if isinstance(solvers, diffrax.AbstractSolver):
        solvers = [solvers]
    named = solvers.items() if isinstance(solvers, dict) else [(None, solver) for solver in solvers]
    found = {}
    for name, solver in named:
        if not isinstance(solver, diffrax.AbstractSolver):
            got = getattr(solver, "__name__", None) or repr(solver)[:60]
            refuse(
                "solvers",
                "solvers, such as gx.SRKN11b()",
                got,
                "Solvers are instances: write the brackets.",
            )
        name = type(solver).__name__ if name is None else name
        if name in found or name == DEFAULT:
            remedy = "Give a dict from names to solvers."
            refuse(
                "solvers",
                "solvers of different names",
                f"{name!r}{' twice' if name in found else ''}",
                remedy,
            )
        found[name] = solver
    return found


def checked_steps(
    steps: Parameter | Mapping | None, solvers: Solvers
) -> dict[str, tuple[float, ...]]:
    """A dict from name to values, for the solvers that the user gave values for."""
    if steps is None:
        return {}
    if not isinstance(steps, dict):
        nested = isinstance(steps, list | tuple) and any(np.ndim(x) for x in steps)
        if nested and len(steps) != len(solvers):
            refuse(
                "steps",
                f"one list per solver ({len(solvers)}), or one list for all",
                f"{len(steps)} lists",
            )
        steps = dict(zip(solvers, steps)) if nested else dict.fromkeys(solvers, steps)
    return {
        one_of("steps", name, tuple(solvers)): checked_values(name, values)
        for name, values in steps.items()
    }


def adaptive(solver: diffrax.AbstractSolver) -> bool:
    """Whether a solver takes a tolerance."""
    return isinstance(solver, diffrax.AbstractAdaptiveSolver)


def solver_ladders(
    lattice: Lattice,
    state: Pytree,
    t0: float,
    t1: float,
    solvers: Solvers,
    steps: Mapping,
    tangents: bool = False,
) -> list[Ladder]:
    """One `Ladder` per solver of a dict; its values from the dict `steps`, or down from the stability limit."""
    omega = highest_frequency(lattice, state, t0, t1)
    ladders = []
    for name, solver in solvers.items():
        parameter = "tolerance" if adaptive(solver) else "step"
        limit = stable_step(solver, omega)
        if name in steps:
            values = steps[name]
        elif adaptive(solver):
            values = TOLERANCES[TOLERANCES > least_tolerance(lattice)]
        else:
            values = _steps(solver, limit, t1 - t0)
        call = _call(lattice, state, t0, t1, solver, parameter, tangents)
        values = tuple(float(x) for x in values)
        ladders.append(Ladder(name, parameter, values, call, name not in steps, limit, solver))
    return ladders


def default_ladder(
    lattice: Lattice, state: Pytree, t0: float, t1: float, tangents: bool = False
) -> Ladder:
    """What `simulate` does without any choice; its compile time is not measured, as it shares a solver's."""
    call = _call(lattice, state, t0, t1, None, None, tangents)
    return Ladder(DEFAULT, "step", (np.nan,), call, compile_seconds=np.nan)


def _call(lattice, state, t0, t1, solver, parameter, tangents):
    def final(value):
        chosen = {} if parameter is None else {parameter: value}
        run = simulate(lattice, state, t1, t0=t0, solver=solver, **chosen)
        return run.final, *_counts(run.solver, run.stats)

    def counted(value):
        matrix, stats = mapped(value)
        return matrix, *_counts(type(solver).__name__, stats)

    mapped = _tangent_call(lattice, state, t0, t1, solver, parameter) if tangents else None
    return counted if tangents else final


def _tangent_call(lattice, state, t0, t1, solver, parameter):
    """A function of the step or tolerance that returns the map (2N, 2N) and the run's `stats`.

    By forward differentiation through the solver: for adaptive ones through their mesh, which follows the state alone.
    """
    start, restore = ravel_pytree(tuple(state))

    @jax.jit
    def call(value):
        chosen = {} if parameter is None else {parameter: value}

        def flow(y):
            run = simulate(
                lattice,
                State(*restore(y)),
                t1,
                t0=t0,
                solver=solver,
                adjoint=diffrax.ForwardMode(),
                **chosen,
            )
            return ravel_pytree(tuple(run.final))[0], run.stats

        return jax.jacfwd(flow, has_aux=True)(start)

    return call


def _counts(name, stats):
    """(forces, steps) of a run, the mean over lanes; diffrax's explicit methods do not count their forces."""
    stats = jax.tree.map(np.mean, stats)
    return _evaluations(name, stats), stats["steps"]


def _evaluations(name, stats):
    kind = getattr(diffrax, name, None)
    if not isinstance(kind, type) or not issubclass(kind, diffrax.AbstractERK):
        return stats["force_evaluations"]
    return stats["steps"] * (kind.tableau.num_stages - bool(kind.tableau.fsal))


def highest_frequency(lattice: Lattice, state: Pytree, t0: Scalar, t1: Scalar) -> float:
    """The highest linear frequency; where that is zero (a sonic vacuum) the bound at this energy; 0 for neither."""
    omega = float(np.max(linear_frequency(lattice)))
    if omega == 0:
        try:
            omega = float(np.max(frequency_bound(lattice, state, t0, t1)))
        except ValueError:
            return 0.0
    return omega


def stable_step(solver: diffrax.AbstractSolver, omega: Scalar) -> float:
    """The longest stable step of a solver; infinity where none is known, or where it has no end."""
    limit = stability_limit(solver)
    return limit / omega if limit and omega > 0 else np.inf


def least_tolerance(lattice: Lattice) -> float:
    """What the floating type holds."""
    return 20 * float(np.finfo(lattice.dtype).eps)


def _steps(solver, limit, span):
    """Steps down from the limit in ratios of 10^(1/order), a decade of error each, as tolerances have; three digits."""
    table = getattr(type(solver), "table", None)
    order = ORDER if table is None else table().order
    first = min(FIRST_STEP * limit, span / LEAST_INTERVALS)
    return dict.fromkeys(
        float(f"{h:.3g}") for h in first * 10.0 ** (-np.arange(MOST_STEPS) / order)
    )
