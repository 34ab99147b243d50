"""Multiple shooting: a long or chaotic record in windows, each with its own initial state."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.flatten_util import ravel_pytree
from jaxtyping import Float, Integer

from ..base.checks import refuse
from ..base.printing import told
from ..base.programs import compiled
from ..base.types import AnyArray
from .problem import Problem, Signals, misfits
from .traces import number

# the tolerance for the mismatch of neighbouring windows, in standard deviations of the noise
MEETING = 0.1


class Windows(Problem):
    r"""A `Problem` in K windows, with free initial states in windows 1 ... K - 1.

    The residuals are those of the data, and the mismatches between the end of each window and the
    next initial state, in units of a tenth of the noise. Derivatives grow with the length of a
    window. Over a whole chaotic record they grow like exp(lambda t), and minima are as dense.
    Source: Bock, Recent advances in parameter identification techniques for ODE, Birkhaeuser (1983).
    """

    starts: Float[AnyArray, "K1 n"]
    scale: Float[AnyArray, " n"]
    meeting: Float[AnyArray, " n"]
    edges: Float[AnyArray, " K"]
    parts: tuple
    kept: Integer[AnyArray, " m"]
    unravel: Callable = eqx.field(static=True)
    __repr__ = told

    def _cut(self, x):
        # Split x into parameter coordinates and the initial states of all windows (K, n).
        own, rest = jnp.split(x, [self.coordinates.size])
        parameters = self.coordinates.parameters(own)
        first = ravel_pytree(self.at(parameters)[1])[0]
        moved = self.starts + self.scale * rest.reshape(self.starts.shape)
        return own, jnp.concatenate([first[None], moved])

    def _window(self, own, start, parts, t0, t1):
        start = self.unravel(start)
        how = self.coordinates, parts, t0, t1, self.step, self.solver, None
        problem = Problem(self.scene, start, *how)
        signals, final = problem.signals(problem.coordinates.parameters(own))
        return misfits(parts, signals), ravel_pytree(final)[0], signals

    def linearise(
        self,
        x: Float[AnyArray, " P"],
    ) -> tuple[Float[AnyArray, " m"], Float[AnyArray, "m P"], Signals]:
        """Return (residuals, their Jacobian, signals): data first, then mismatches.

        Each window is differentiated by its state and the parameters, then the chain rule applied.
        """
        parts, named = eqx.partition(self.parts, eqx.is_array)
        own, starts = self._cut(x)
        own_by_x, starts_by_x = jax.jacfwd(self._cut)(x)

        def window(start, parts, t0, t1):
            def both(own, start):
                residuals, end, signals = self._window(
                    own, start, eqx.combine(parts, named), t0, t1
                )
                return (residuals, end), (residuals, end, signals)

            return jax.jacfwd(both, (0, 1), has_aux=True)(own, start)

        slopes, (residuals, ends, signals) = jax.vmap(window)(
            starts, parts, self.edges[:-1], self.edges[1:]
        )
        by_x, ends_by_x = (
            by_own @ own_by_x + by_start @ starts_by_x for by_own, by_start in slopes
        )
        gaps = (ends[:-1] - starts[1:]) / self.meeting
        gaps_by_x = (ends_by_x[:-1] - starts_by_x[1:]) / self.meeting[:, None]
        value = jnp.concatenate([residuals.ravel(), gaps.ravel()])
        jacobian = jnp.concatenate([rows.reshape(-1, x.size) for rows in (by_x, gaps_by_x)])
        return value, jacobian, tuple(s.reshape(-1, s.shape[-1])[self.kept] for s in signals)


def cut(problem: Problem, count: int) -> Windows:
    """Split a problem into `count` windows of equally many samples.

    Initial states are guessed by running the scene at the start from window to window, and
    inserting measured velocities and displacements, or integrals of velocities.
    """
    clocks = [
        None if isinstance(trace.offset, str) else np.asarray(trace.times + trace.offset)
        for trace in problem.traces
    ]
    times = clocks[0]
    for k, clock in enumerate(clocks):
        if problem.traces[k].sigma is None:
            refuse("sigma", "a number for windows, which have to meet within the noise", "None")
        if clock is None or not np.array_equal(clock, times):
            refuse(
                "windows",
                "traces that were sampled together, without an unknown offset",
                f"traces[{k}]",
            )
    if count > times.size // 2:
        refuse("windows", f"at most {times.size // 2}, for {times.size} samples", f"{count}")
    first = np.linspace(0, times.size, count + 1).round().astype(int)
    edges = np.concatenate([[float(problem.t0)], times[first[1:-1]], times[-1:]])
    # the samples of each window; shorter windows repeat their last sample
    samples = np.minimum(first[:-1, None] + np.arange(np.diff(first).max()), first[1:, None] - 1)
    repeated = np.diff(samples, axis=1, prepend=-1) == 0
    parts = tuple(_parted(trace, samples, repeated) for trace in problem.traces)
    parameters = problem.coordinates.start
    _, state = problem.at(parameters)
    readings = _readings(problem, parameters, state)
    starts = []
    for t0, t1, sample in zip(edges[:-2], edges[1:-1], first[1:-1]):
        leg = eqx.tree_at(lambda p: (p.t0, p.t1), problem, (jnp.asarray(t0), jnp.asarray(t1)))
        # NumPy arrays can be written to.
        state = jax.tree.map(np.array, _leg(leg, parameters, state))
        for part, trace, values in readings:
            x = state[part] if trace.field is None else state[part][trace.field]
            for index, value in zip(trace.indices, values[sample]):
                if np.isfinite(value):
                    x[index] = value
        starts.append(state)
    flat = np.stack([ravel_pytree(state)[0] for state in starts])
    # Displacements and velocities are scaled by the largest of each over all windows. They are the
    # halves of a flat state.
    largest = np.abs(flat).reshape(len(flat), 2, -1).max((0, 2))
    scale = np.repeat(np.where(largest > 0, largest, 1), flat.shape[1] // 2)
    noise = max(
        np.max(np.asarray(trace.sigma) * np.isfinite(trace.data)) / np.nanmax(np.abs(trace.data))
        for trace in problem.traces
    )
    return Windows(
        **vars(problem),
        starts=jnp.asarray(flat),
        scale=jnp.asarray(scale),
        meeting=jnp.asarray(MEETING * noise * scale),
        edges=jnp.asarray(edges),
        parts=parts,
        kept=jnp.asarray(np.flatnonzero(~repeated)),
        unravel=ravel_pytree(state)[1],
    )


@compiled
def _leg(problem, parameters, state):
    return problem.run(parameters, state=state).final


def _parted(trace, samples, repeated):
    # Return a trace with a leading axis of windows; repeated samples count as missing.
    sigma = np.broadcast_to(trace.sigma, trace.data.shape)[samples]
    data = np.where(repeated[..., None], np.nan, np.asarray(trace.data)[samples])
    gain, offset = (
        x if isinstance(x, str) else np.broadcast_to(x, (len(samples), *np.shape(x)))
        for x in (trace.gain, trace.offset)
    )
    return eqx.tree_at(
        lambda t: (t.times, t.data, t.sigma, t.gain, t.offset),
        trace,
        (np.asarray(trace.times)[samples], data, sigma, gain, offset),
    )


def _readings(problem, parameters, state):
    # Return readings (0 for u or 1 for v, trace, values (T, S)), the most reliable last.
    measured = []
    integrated = []
    for trace in problem.traces:
        values = np.asarray(trace.data) / np.asarray(number(trace.gain, parameters))
        if trace.kind == "displacement":
            measured.append((0, trace, values))
        elif trace.kind == "velocity":
            u, v = (np.asarray(trace.picked(part)) for part in state)
            times = np.append(float(problem.t0), np.asarray(trace.times + trace.offset))
            moved = scipy.integrate.cumulative_trapezoid(
                np.nan_to_num(np.vstack([v, values])), times, axis=0
            )
            integrated += [(1, trace, values), (0, trace, u + moved)]
    return integrated + measured
