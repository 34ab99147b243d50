"""From `simulate` to the solver that serves what a lattice remembers."""

import math
from typing import Any

import diffrax
import jax
import numpy as np

from ...checks import concrete, refuse, show, traced, whole
from ...lattice import Lattice
from ...terms import CaputoDamping
from ...terms.base import memory_of
from ...terms.tracing import reads
from ...types import Scalar, StateLike
from ..control import least_tolerance, refuse_unresolved
from ..dispatch import facts
from ..inputs import checked_size, held_frames
from ..meeting import passing
from ..method import number, refuse_far
from ..run import COMPLETED, FILLED, Run
from ..stiffness import frequency_bound
from .damped import STEP_FRACTION, march
from .internal import integrate
from .run import RunWithMemory

TOLERANCE = 1e-11


def refuse_with_memory(
    lattice: Lattice, solver: Any, record: Any, adjoint: Any, every: bool
) -> None:
    """Refuse keywords of `simulate` that runs do not have whose forces read the past, and terms that nothing solves."""
    whose = "for a lattice whose forces read the past"
    remedy = "Terms that remember are carried by a solver of their own; save_at= keeps what happens on the way."
    if solver is not None:
        refuse("solver", f"None {whose}", type(solver).__name__, remedy)
    if record:
        refuse("record", f"None {whose}", "records", remedy)
    if adjoint is not None and not isinstance(adjoint, diffrax.ForwardMode):
        modes = "as such a run has forward derivatives (jax.jvp, jax.jacfwd)"
        refuse("adjoint", f"None or diffrax.ForwardMode(), {modes}", type(adjoint).__name__)
    if every:
        refuse("save_at", f"times or a number of them, {whose}", "'steps'")
    fractional = _is_fractional(lattice)
    for i, term in enumerate(lattice.terms):
        if fractional:
            solved = isinstance(term, CaputoDamping)
        else:
            solved = term.memory and term.variables(lattice) is not None
        if memory_of(term) and not solved:
            refuse(
                f"terms[{i}] ({type(term).__name__})",
                "a term whose memory has a solver here",
                "one that has none",
                "PlasticContact and CaputoDamping stand by themselves, not within another term or side by side.",
            )


def _is_fractional(lattice):
    return any(isinstance(term, CaputoDamping) for term in lattice.terms)


def with_memory(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    save_ts: Any,
    step: Any,
    tolerance: Any,
    max_steps: Any,
    progress: bool,
    throw: bool | None,
) -> Run:
    """The run of `simulate` where forces read the past, its state and its times checked."""
    if _is_fractional(lattice):
        return _damped(lattice, state, t0, t1, step, tolerance, save_ts, throw)
    dtype, step = facts(lattice).dtype, checked_size("step", step)
    refuse_far(lattice, state, t0, t1)
    max_steps = None if max_steps is None else whole("max_steps", max_steps, 1)
    tolerance = checked_size("tolerance", tolerance)
    least = least_tolerance(dtype)
    if tolerance is None:
        tolerance = max(TOLERANCE, least)
    elif not traced(tolerance) and not least <= tolerance < 1:
        refuse(
            "tolerance",
            f"from {least:.1e}, what {dtype} holds, to below 1",
            show(np.asarray(tolerance)),
        )
    longest = None if step is None else number(step, dtype)
    save_ts = None if save_ts is None else jax.numpy.asarray(save_ts, dtype)
    run = integrate(
        lattice,
        state,
        number(t0, dtype),
        number(t1, dtype),
        number(tolerance, dtype),
        longest,
        save_ts,
        max_steps,
        progress,
    )
    said = "traced" if traced(tolerance) else show(np.asarray(tolerance))
    choice = f"adaptive steps that carry internal variables, tolerance {said}"
    return _completed(lattice, run, "Dopri8", choice, throw)


def _damped(lattice, state, t0, t1, step, tolerance, save_ts, throw):
    """The run of a lattice with Caputo damping, by equal steps."""
    if tolerance is not None:
        refuse(
            "tolerance",
            "None with Caputo damping, whose steps are equal",
            show(np.asarray(tolerance)),
            "Give step=; the error falls with its square.",
        )
    others = [
        type(term).__name__
        for term in lattice.terms
        if not term.memory and term.exact_damping() is None and reads(term, lattice).velocity
    ]
    if others:
        refuse(
            "lattice", "no force of velocities beside CaputoDamping and Damping", ", ".join(others)
        )
    step, dtype = checked_size("step", step), facts(lattice).dtype
    if traced((step, t0, t1)):
        refuse(
            "step, t0, t1",
            "known numbers, which say how many steps of history are kept",
            "traced ones",
        )
    omega = (
        concrete(frequency_bound(lattice, state, t0, t1))
        if step is None or not traced((lattice, state))
        else None
    )
    if step is None:
        if omega is None or not omega > 0:
            refuse(
                "step",
                "a time step, where the highest frequency is not known or zero",
                "None",
                f"h omega = {STEP_FRACTION} is usual with Caputo damping.",
            )
        step = STEP_FRACTION / float(omega)
    elif omega is not None and step * omega >= 2:
        refuse(
            "step",
            f"below {2 / float(omega):.3g}, where velocity Verlet is stable",
            show(np.asarray(step)),
        )
    refuse_unresolved(t0, t1, step, dtype)
    steps = max(math.ceil((t1 - t0) / step * (1 - 1e-9)), 2)
    held_frames("step", steps, state, "steps of history")
    run = march(lattice, state, number(t0, dtype), number(t1, dtype), save_ts, steps)
    choice = f"equal steps of {(t1 - t0) / steps:.4g} with the whole history, error ~ h^2"
    return _completed(lattice, run, "velocity Verlet", choice, throw)


def _completed(lattice, run, solver, choice, throw):
    found, own = run
    known = not traced(found.code)
    filled = {name: x for name, x in found._asdict().items() if name in FILLED}
    run = RunWithMemory(
        **filled,
        **own,
        _margin=found.margin,
        solver=solver,
        choice=choice,
        remark="" if traced(run) else passing(lattice, found.ts, found.us, found.final.u),
        _mark=lattice._mark,
        _space=lattice.space,
    )
    if known and not (np.asarray(run.code) == COMPLETED).all() and (throw is None or throw):
        raise RuntimeError(run.outcome)
    return run
