"""The scene beside its traces: signals and residuals as functions of the parameters."""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from ..checks import one_of, positive, refuse
from ..flow import Run, frequency_bound, simulate
from ..flow.method import STEP_FRACTION, checked_state, checked_tolerance, facts, least_tolerance
from ..lattice import Lattice, State
from ..measures import contact_force
from ..parameters import Bounds, Coordinates
from ..printing import told
from ..programs import compiled, is_untraced
from ..solvers import RKN86, SRKN11b
from ..types import AnyArray, Numbers, Parameter, Scalar, Scene, StateLike
from ..units import SI
from .traces import Traces, checked_shape, checked_traces, number

# room behind the last sample for an offset that is fitted, in record lengths
ROOM = 0.1
# a record beyond this share of the chain's own time, or below it, is counted in another unit of time
FAR_OFF = 1e6
# the longest step times the fastest decay, which is 4 c/m in a chain of dashpots; steps of the iteration for it
FASTEST, POWER_STEPS = 4.0, 64
Start: TypeAlias = StateLike | Callable[[Any, Any], StateLike]
"""A state at t0, or a function (parameters, lattice) that returns one."""
Signals: TypeAlias = tuple[Float[AnyArray, "_ _"], ...]
"""One (T, S) per trace."""


class Problem(eqx.Module):
    """What a fit compares: the run of `scene(parameters)` from t0 to t1 at a fixed step, read off where traces are.

    A scene or a state that is a module may hold arrays: others like it are compared by the same program.
    """

    scene: Callable
    make_state: Callable | None
    given_state: State | None
    coordinates: Coordinates
    traces: tuple[Traces, ...]
    t0: Float[AnyArray, ""]
    t1: Float[AnyArray, ""]
    step: Float[AnyArray, ""]
    solver: diffrax.AbstractSolver
    run_tolerance: Float[AnyArray, ""] | None
    __repr__ = told

    @property
    def dtype(self) -> jnp.dtype:
        """The floating type of the lattice."""
        return self.step.dtype

    @property
    def moving(self) -> bool:
        """Whether the time of some trace is fitted."""
        return any(isinstance(trace.offset, str) for trace in self.traces)

    def lattice(self, parameters: dict[str, Numbers]) -> Lattice:
        """The lattice of some parameters."""
        return self.scene(parameters)

    def state(self, parameters: dict[str, Numbers], lattice: Lattice) -> State:
        """The state at t0."""
        if self.make_state is None:
            return self.given_state
        return as_state(self.make_state(parameters, lattice), lattice.dtype)

    def finer(self) -> "Problem":
        """The same by half the step, or a hundredth of the tolerance: its signals differ by their error."""
        if self.run_tolerance is None:
            return self.with_step(float(self.step) / 2)
        finer = max(float(self.run_tolerance) / 100, least_tolerance(self.dtype))
        return eqx.tree_at(lambda p: p.run_tolerance, self, jnp.asarray(finer, self.dtype))

    def with_step(self, step: Scalar) -> "Problem":
        """The same at another time step."""
        return eqx.tree_at(lambda p: p.step, self, jnp.asarray(step, self.dtype))

    def run(
        self,
        parameters: dict[str, Numbers],
        times: Float[AnyArray, " T"] | None = None,
        adjoint: eqx.Module | None = diffrax.ForwardMode(),
        max_steps: int | None = None,
        state: State | None = None,
    ) -> Run:
        """The run of some parameters, saved at rising times; from their own state or another."""
        lattice = self.lattice(parameters)
        state = self.state(parameters, lattice) if state is None else state
        return simulate(
            lattice,
            state,
            self.t1,
            t0=self.t0,
            solver=self.solver,
            step=self.step if self.run_tolerance is None else None,
            tolerance=self.run_tolerance,
            save_at=times,
            adjoint=adjoint,
            max_steps=max_steps,
            throw=False,
        )

    def signals(self, parameters: dict[str, Numbers], **keywords: object) -> tuple[Signals, State]:
        """What every trace would show without noise, a tuple of (T, S), and the state at t1."""
        times = [trace.times + number(trace.offset, parameters) for trace in self.traces]
        joined = jnp.concatenate(times)
        order = jnp.argsort(joined)
        back = jnp.argsort(order)
        run = self.run(parameters, jnp.clip(joined[order], self.t0, self.t1), **keywords)
        us, vs = jax.tree.map(lambda x: x[back], (run.us, run.vs))
        lattice, signals, start = self.lattice(parameters), [], 0
        for trace in self.traces:
            part = slice(start, start + trace.times.size)
            start = part.stop
            u, v = jax.tree.map(lambda x: x[part], (us, vs))
            gain = number(trace.gain, parameters)
            signals.append(gain * _read(trace, lattice, u, v, joined[part]))
        return tuple(signals), run.final

    def residuals(self, x: Float[AnyArray, " P"], **keywords: object) -> Float[AnyArray, " n"]:
        """(signal - data)/sigma of every sample at free coordinates x, one vector; zero where a sample is missing."""
        return misfits(self.traces, self.signals(self.coordinates.parameters(x), **keywords)[0])

    def linearise(
        self,
        x: Float[AnyArray, " P"],
    ) -> tuple[Float[AnyArray, " n"], Float[AnyArray, "n P"], Signals]:
        """(residuals, their Jacobian, signals) at x."""

        def both(x):
            signals, _ = self.signals(self.coordinates.parameters(x))
            residuals = misfits(self.traces, signals)
            return residuals, (residuals, signals)

        matrix, (value, signals) = jax.jacfwd(both, has_aux=True)(x)
        return value, matrix, signals

    def times(self, parameters: dict[str, Numbers]) -> Float[np.ndarray, " n"]:
        """The times of all samples in the scene's clock, at some parameters."""
        return np.concatenate(
            [
                np.asarray(trace.times) + np.asarray(number(trace.offset, parameters))
                for trace in self.traces
            ]
        )

    def end(self, parameters: dict[str, Numbers]) -> Float[AnyArray, ""]:
        """Where a run has to end: at the last sample, with room behind it where its time is fitted."""
        times = self.times(parameters)
        return jnp.asarray(times.max() + ROOM * np.ptp(times) * self.moving, self.dtype)

    def pace(self, parameters: dict[str, Numbers]) -> tuple[float, float]:
        """(frequency, step) of some parameters; an infinite step where no time scale sets one.

        The highest frequency that the energy of the start allows, of linear modes or of contacts that close, and the
        step that it asks for.
        """
        lattice = self.lattice(parameters)
        state = checked_state(lattice, self.state(parameters, lattice))
        omega = float(frequency_bound(lattice, state, self.t0, self.t1))
        if not omega > 0:
            return omega, np.inf
        # what a splitting solver does not take exactly
        rate = 0.0 if facts(lattice).splits else float(_fastest_decay(lattice, self.t0, *state))
        return omega, min(STEP_FRACTION / omega, FASTEST / rate if rate > 0 else np.inf)


@compiled
def _fastest_decay(lattice, t, u, v):
    """The largest rate at which a motion about a state decays by forces that read velocities, by power iteration."""
    flat, unravel = ravel_pytree(v)
    rates = jax.linearize(lambda w: ravel_pytree(lattice.acceleration(t, u, unravel(w)))[0], flat)[
        1
    ]

    def power(_, carry):
        grown = rates(carry[0])
        size = jnp.linalg.norm(grown)
        return grown / jnp.where(size > 0, size, 1), size

    first = jnp.asarray(np.random.default_rng(0).normal(size=flat.shape), flat.dtype)
    return jax.lax.fori_loop(
        0, POWER_STEPS, power, (first / jnp.linalg.norm(first), jnp.zeros((), flat.dtype))
    )[1]


def prepared(
    scene: Scene,
    start: dict[str, Parameter],
    traces: Traces | Sequence[Traces],
    *,
    state: Start,
    bounds: Bounds = None,
    t0: Scalar = 0.0,
    step: Scalar | None = None,
    solver: diffrax.AbstractSolver | None = None,
    run_tolerance: Scalar | None = None,
    **others: object,
) -> Problem:
    """The checked `Problem` of a fit, with a step for the start. **Arguments**, **Raises:** as in `fit`.

    `others`: options of `fit` that say how it goes on from there.
    """
    # known numbers stay known within a program that is traced
    with jax.ensure_compile_time_eval():
        coordinates = Coordinates(start, bounds)
    parameters = coordinates.start
    lattice, traces = scene(parameters), checked_traces(traces)
    if lattice.lanes:
        refuse(
            "scene", "a function that returns one Lattice", f"a batch with lanes {lattice.lanes}"
        )
    if len(traces) > 1 and any(trace.sigma is None for trace in traces):
        refuse(
            "sigma",
            "one for each of several traces",
            "None",
            "It says how they weigh against each other.",
        )
    make_state, given = (state, None) if callable(state) else (None, checked_state(lattice, state))
    begin = given or checked_state(lattice, as_state(state(parameters, lattice), lattice.dtype))
    _check_places(traces, lattice, begin, parameters)
    dtype = lattice.dtype
    if any(trace.data.dtype != dtype for trace in traces):
        refuse("scene", f"a lattice of {traces[0].data.dtype}, as the traces are", f"{dtype}")
    if run_tolerance is not None:
        if step is not None:
            refuse("step", "None where run_tolerance is given", f"{step}")
        run_tolerance = jnp.asarray(checked_tolerance(run_tolerance, dtype), dtype)
    if solver is None:
        splitting = SRKN11b() if run_tolerance is None else RKN86()
        solver = splitting if facts(lattice).splits else diffrax.Dopri8()
    t0, unknown = np.asarray(t0, dtype), np.ones((), dtype)
    how = t0, unknown, unknown, solver, run_tolerance
    problem = Problem(scene, make_state, given, coordinates, traces, *how)
    times = problem.times(parameters)
    if not problem.moving and times.min() < float(t0) - 1e-9 * np.ptp(times):
        refuse(
            "times",
            f"samples from t0 = {t0} on",
            f"{times.min()}",
            "Give offset=, or an earlier t0.",
        )
    problem = eqx.tree_at(lambda p: p.t1, problem, problem.end(parameters))
    if not is_untraced():
        # what a scene closes over may be traced too
        if step is None:
            refuse("step", "a time step within a program that is traced", "None")
        return problem.with_step(step)
    omega, wanted = problem.pace(parameters)
    _refuse_other_units(lattice.units, omega, float(np.ptp(times)))
    if run_tolerance is None and step is None and not np.isfinite(wanted):
        remedy = "Nothing is stiff at this energy, so no time scale sets one: give step=."
        refuse("step", "a time step", "None", remedy)
    return problem.with_step(wanted if step is None else float(positive("step", step)))


def _refuse_other_units(units, omega, span):
    """Refuse a record that is a million times as long as the chain's own time 1/omega, or as short."""
    if not 0 < omega < np.inf or FAR_OFF > span * omega > 1 / FAR_OFF:
        return
    unit = "seconds" if units == SI else "the lattice's unit of time"
    others = (
        "microseconds, which Traces.from_csv(..., units='us') reads"
        if span * omega > 1
        else "units of its own"
    )
    refuse(
        "traces",
        f"times in {unit}, of a record within {FAR_OFF:.0e} times the lattice's own, {1 / omega:.2g}",
        f"a record of {span:.3g}, {span * omega:.1e} times that",
        f"Its times may be in {others}; a scaled lattice wants times over units.time.",
    )


def as_state(state: State | tuple | list, dtype: object) -> State:
    """A pair of arrays, or of dicts of them, as a `State` of a floating type."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), State(*state))


def misfit(trace: Traces, signal: Float[AnyArray, "T S"]) -> Float[AnyArray, "T S"]:
    """(signal - data)/sigma of one trace (T, S), zero where a sample is missing."""
    return jnp.where(trace.weights > 0, (signal - trace.data) * trace.weights, 0.0)


def misfits(traces: tuple[Traces, ...], signals: Signals) -> Float[AnyArray, " n"]:
    """Those of several traces, one vector."""
    return jnp.concatenate([misfit(*both).ravel() for both in zip(traces, signals)])


def _read(trace, lattice, us, vs, times):
    """The signal of one trace's sensors (T, S)."""
    if trace.kind == "force":
        forces = jax.vmap(lambda u, v, t: contact_force(lattice, State(u, v), t, bond=trace.bond))(
            us, vs, times
        )
        return jnp.stack([forces[(..., *place)] for place in trace.places], axis=-1)
    return trace.picked(vs if trace.kind == "velocity" else us)


def _check_places(traces, lattice, state, parameters):
    """That every sensor is where something is, and every named gain and offset a parameter."""
    for k, trace in enumerate(traces):
        for what, x in (("gain", trace.gain), ("offset", trace.offset)):
            if isinstance(x, str):
                one_of(f"traces[{k}].{what}", x, tuple(parameters))
                checked_shape(x, parameters[x], *([(len(trace.places),)] if what == "gain" else []))
        name = f"traces[{k}].{'contacts' if trace.kind == 'force' else 'sites'}"
        if trace.kind == "force":
            shape = jax.eval_shape(lambda: contact_force(lattice, state, bond=trace.bond)).shape
        else:
            u = state.u
            if isinstance(u, dict):
                one_of(f"traces[{k}].field", trace.field, tuple(u))
                u = u[trace.field]
            elif trace.field is not None:
                refuse(
                    f"traces[{k}].field",
                    "None for a lattice without named fields",
                    repr(trace.field),
                )
            shape = u.shape if lattice.dimension is None else u.shape[:-1]
            components = [None] if lattice.dimension is None else range(lattice.dimension)
            if trace.component not in components:
                refuse(
                    f"traces[{k}].component",
                    f"which of {lattice.dimension or 'no'} components",
                    repr(trace.component),
                )
        for place in trace.places:
            if len(place) != len(shape) or any(not -n <= i < n for i, n in zip(place, shape)):
                refuse(name, f"indices within {shape}", f"{place[0] if len(place) == 1 else place}")
