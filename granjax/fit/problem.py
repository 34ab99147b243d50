"""`Problem`: signals and residuals of a fit as functions of the parameters."""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from ..base.checks import described, is_site, one_of, positive, refuse, traced
from ..base.printing import told
from ..base.programs import compiled, is_untraced
from ..base.types import AnyArray, Numbers, Parameter, Scalar, Scene, StateLike
from ..base.units import SI
from ..flow import Run, simulate
from ..flow.arguments import checked_state, checked_tolerance, facts, least_tolerance
from ..flow.steps import STEP_FRACTION, floored_frequency
from ..lattice import Lattice, State
from ..measures import along, contact_force, sensor_force
from ..solvers import RKN86, SRKN11b
from ..terms import CaputoDamping
from .parameters import Bounds, Coordinates, looked_up
from .traces import Traces, checked_shape, checked_traces, number

# time after the last sample that leaves room for a fitted offset, in record lengths
ROOM = 0.1
# A record that is longer than the chain's own time by more than this factor, or shorter, is in
# another unit of time.
FAR_OFF = 1e6
# the largest step times the fastest decay rate (4 c/m in a chain of dashpots)
FASTEST = 4.0
# the number of power iterations for this rate
POWER_STEPS = 64
Start: TypeAlias = StateLike | Callable[[Any, Any], StateLike]
"""A state at t0, or a function (parameters, lattice) that returns one."""
Signals: TypeAlias = tuple[Float[AnyArray, "_ _"], ...]
"""One array (T, S) per trace."""


class Problem(eqx.Module):
    """The runs of `scene(parameters)` from t0 to t1, sampled where the traces are.

    A scene or state that is an `eqx.Module` may hold arrays; new values need no new compilation.
    """

    scene: Callable
    begin: Callable | State
    coordinates: Coordinates
    traces: tuple[Traces, ...]
    t0: Float[AnyArray, ""]
    t1: Float[AnyArray, ""]
    step: Float[AnyArray, ""]
    solver: diffrax.AbstractSolver | None
    run_tolerance: Float[AnyArray, ""] | None
    __repr__ = told

    @property
    def dtype(self) -> jnp.dtype:
        """The floating type of the lattice."""
        return self.step.dtype

    @property
    def moving(self) -> bool:
        """Whether the offset of a trace is fitted."""
        return any(isinstance(trace.offset, str) for trace in self.traces)

    @property
    def still(self) -> float:
        """The sum of squared data/sigma."""
        parts = (np.nan_to_num(trace.data) * np.asarray(trace.weights) for trace in self.traces)
        return float(sum(np.sum(np.square(part)) for part in parts))

    def at(self, parameters: dict[str, Numbers]) -> tuple[Lattice, State]:
        """Return the lattice at some parameters, and the state at t0."""
        lattice = looked_up("scene", self.scene, parameters)
        if not callable(self.begin):
            return lattice, self.begin
        return lattice, as_state(self.begin(parameters, lattice), lattice.dtype)

    def finer(self) -> "Problem":
        """Return the problem with step/2, or tolerance/100, to estimate the integration error."""
        if self.run_tolerance is None:
            return self.with_step(float(self.step) / 2)
        finer = max(float(self.run_tolerance) / 100, least_tolerance(self.dtype))
        return eqx.tree_at(lambda p: p.run_tolerance, self, jnp.asarray(finer, self.dtype))

    def with_step(self, step: Scalar) -> "Problem":
        """Return the problem with another time step."""
        return eqx.tree_at(lambda p: p.step, self, jnp.asarray(step, self.dtype))

    def run(
        self,
        parameters: dict[str, Numbers],
        times: Float[AnyArray, " T"] | None = None,
        adjoint: eqx.Module | None = diffrax.ForwardMode(),
        max_steps: int | None = None,
        state: State | None = None,
    ) -> Run:
        """Run the scene, saved at increasing times, from `state` or that of the parameters."""
        lattice, first = self.at(parameters)
        return simulate(
            lattice,
            first if state is None else state,
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
        """Return the noise-free signals, a tuple of (T, S), and the state at t1."""
        times = [trace.times + number(trace.offset, parameters) for trace in self.traces]
        joined = jnp.concatenate(times)
        order = jnp.argsort(joined)
        run = self.run(parameters, jnp.clip(joined[order], self.t0, self.t1), **keywords)
        lattice = self.scene(parameters)
        places = jnp.split(jnp.argsort(order), np.cumsum([own.size for own in times])[:-1])
        signals = (
            number(trace.gain, parameters) * _read(trace, lattice, run)[place]
            for trace, place in zip(self.traces, places)
        )
        return tuple(signals), run.final

    def residuals(self, x: Float[AnyArray, " P"], **keywords: object) -> Float[AnyArray, " n"]:
        """Return (signal - data)/sigma of all samples at x; zero for missing ones."""
        return misfits(self.traces, self.signals(self.coordinates.parameters(x), **keywords)[0])

    def linearise(
        self,
        x: Float[AnyArray, " P"],
    ) -> tuple[Float[AnyArray, " n"], Float[AnyArray, "n P"], Signals]:
        """Return (residuals, their Jacobian, signals) at x."""

        def both(x):
            signals, _ = self.signals(self.coordinates.parameters(x))
            residuals = misfits(self.traces, signals)
            return residuals, (residuals, signals)

        matrix, (value, signals) = jax.jacfwd(both, has_aux=True)(x)
        return value, matrix, signals

    def times(self, parameters: dict[str, Numbers]) -> Float[np.ndarray, " n"]:
        """Return the times of all samples, with offsets."""
        return np.concatenate(
            [
                np.asarray(trace.times) + np.asarray(number(trace.offset, parameters))
                for trace in self.traces
            ]
        )

    def end(self, parameters: dict[str, Numbers]) -> Float[AnyArray, ""]:
        """Return the end of a run: the last sample, plus room for fitted offsets."""
        times = self.times(parameters)
        return jnp.asarray(times.max() + ROOM * np.ptp(times) * self.moving, self.dtype)

    def pace(self, parameters: dict[str, Numbers]) -> tuple[float, float]:
        """Return (frequency, step); the step is infinite if no time scale sets it.

        The frequency is the highest that the initial energy allows, of linear modes or closing
        contacts.
        """
        lattice, state = self.at(parameters)
        state = checked_state(lattice, state)
        omega = float(floored_frequency(lattice, state, self.t0, self.t1))
        if not omega > 0:
            return omega, np.inf
        # Splitting solvers treat dissipation exactly, so that it does not limit their step.
        rate = 0.0 if facts(lattice).splits else float(_fastest_decay(lattice, self.t0, *state))
        return omega, min(STEP_FRACTION / omega, FASTEST / rate if rate > 0 else np.inf)


@compiled
def _fastest_decay(lattice, t, u, v):
    # Return the fastest decay rate by velocity-dependent forces, by power iteration.
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
) -> Problem:
    """Build the checked `Problem` of a fit, with a step for the start.

    **Arguments**, **Raises:** as in `fit`.
    """
    # This keeps known numbers concrete inside a traced program.
    with jax.ensure_compile_time_eval():
        coordinates = Coordinates(start, bounds)
    parameters = coordinates.start
    lattice = looked_up("scene", scene, parameters)
    if not isinstance(lattice, Lattice):
        refuse("scene", "a function that returns a Lattice", described(lattice))
    traces = checked_traces(traces)
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
    if callable(state):
        made = looked_up("state", state, parameters, lattice)
        first = checked_state(lattice, as_state(made, lattice.dtype))
    else:
        state = first = checked_state(lattice, state)
    _check_places(traces, lattice, first, parameters)
    dtype = lattice.dtype
    if any(trace.data.dtype != dtype for trace in traces):
        refuse("scene", f"a lattice of {traces[0].data.dtype}, as the traces are", f"{dtype}")
    if run_tolerance is not None:
        if step is not None:
            refuse("step", "None where run_tolerance is given", f"{step}")
        run_tolerance = jnp.asarray(checked_tolerance(run_tolerance, dtype), dtype)
    about = facts(lattice)
    if any(isinstance(term, CaputoDamping) for term in lattice.terms):
        refuse(
            "scene",
            "a lattice without CaputoDamping, whose number of steps a fit cannot know",
            "one with it",
            "Minimise the misfit of gx.simulate yourself, with jax.jacfwd.",
        )
    if solver is None and not about.remembers:
        plain = about.splits if run_tolerance is None else not about.reads_velocity
        usual = SRKN11b() if run_tolerance is None else RKN86()
        solver = usual if plain else diffrax.Dopri8()
    t0 = np.asarray(t0, dtype)
    unknown = np.ones((), dtype)
    how = t0, unknown, unknown, solver, run_tolerance
    problem = Problem(scene, state, coordinates, traces, *how)
    times = problem.times(parameters)
    if not problem.moving and times.min() < float(t0) - 1e-9 * np.ptp(times):
        refuse(
            "times",
            f"samples from t0 = {t0} on",
            f"{times.min()}",
            "Give offset=, or an earlier t0.",
        )
    problem = eqx.tree_at(lambda p: p.t1, problem, problem.end(parameters))
    if not is_untraced() or traced((lattice, first)):
        # The scene may close over traced values, from which no step can be derived.
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
    """Convert a pair of arrays, or of dicts of arrays, to a `State`."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), State(*state))


def misfit(trace: Traces, signal: Float[AnyArray, "T S"]) -> Float[AnyArray, "T S"]:
    """Return (signal - data)/sigma of one trace (T, S), zero for missing samples."""
    return jnp.where(trace.weights > 0, (signal - trace.data) * trace.weights, 0.0)


def misfits(traces: tuple[Traces, ...], signals: Signals) -> Float[AnyArray, " n"]:
    """Return the misfits of all traces as one vector."""
    return jnp.concatenate([misfit(*both).ravel() for both in zip(traces, signals)])


def _read(trace, lattice, run):
    if trace.kind == "force":
        forces = along(_forces, lattice, run, trace=trace)
        return jnp.stack([forces[(..., *place)] for place in trace.places], axis=-1)
    return trace.picked(run.vs if trace.kind == "velocity" else run.us)


def _forces(lattice, state, t=0.0, *, trace):
    if trace.at == "sites":
        return sensor_force(lattice, state, t, field=trace.field)
    return contact_force(lattice, state, t, bond=trace.bond)


def _check_places(traces, lattice, state, parameters):
    for k, trace in enumerate(traces):
        gain = "gain", trace.gain, (len(trace.places),)
        for what, x, *shapes in (gain, ("offset", trace.offset)):
            if isinstance(x, str):
                one_of(f"traces[{k}].{what}", x, tuple(parameters))
                checked_shape(x, parameters[x], *shapes)
        name = f"traces[{k}].{trace.at}"
        if trace.kind == "force":
            shape = jax.eval_shape(lambda: _forces(lattice, state, trace=trace)).shape
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
            shape = u.shape[: lattice.axes]
            components = [None] if lattice.dimension is None else range(lattice.dimension)
            if trace.component not in components:
                refuse(
                    f"traces[{k}].component",
                    f"which of {lattice.dimension or 'no'} components",
                    repr(trace.component),
                )
        for place in trace.places:
            if not is_site(place, shape):
                refuse(name, f"indices within {shape}", f"{place[0] if len(place) == 1 else place}")
