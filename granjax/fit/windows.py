"""Multiple shooting: a long or chaotic record in windows, each with a state of its own at its start."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float, Integer

from ..checks import refuse
from ..lattice import State
from ..printing import told
from ..types import AnyArray, Scalar
from .problem import Problem, Signals, misfits
from .traces import Traces, number

# how much better than the noise neighbouring windows have to meet, in deviations
MEETING = 0.1


class Windows(eqx.Module):
    r"""A `Problem` in K windows: free are the parameters and the states s_j at the starts of windows 1 ... K - 1.

    Residuals are those of the data, each window run from its own start, and what the ends of windows miss of the
    next start, in units of a tenth of the noise. The derivative of a window grows with its own length alone, where that
    of the whole record grows like exp(lambda t) in a chaotic scene, with minima as close as that.
    Source: Bock, Recent advances in parameter identification techniques for ODE, Birkhaeuser (1983).
    """

    problem: Problem
    starts: Float[AnyArray, "K1 n"]
    scale: Float[AnyArray, " n"]
    meeting: Float[AnyArray, " n"]
    edges: Float[AnyArray, " K"]
    parts: tuple
    kept: Integer[AnyArray, " m"]
    unravel: Callable = eqx.field(static=True)
    __repr__ = told

    @property
    def plain(self) -> Problem:
        """The problem in one piece."""
        return self.problem

    @property
    def traces(self) -> tuple[Traces, ...]:
        """Those of the whole record."""
        return self.problem.traces

    @property
    def dtype(self) -> jnp.dtype:
        """The floating type of the lattice."""
        return self.problem.dtype

    def with_step(self, step: Scalar) -> "Windows":
        """The same at another time step."""
        return eqx.tree_at(lambda w: w.problem, self, self.problem.with_step(step))

    def remark(self, residuals: Float[AnyArray, " n"]) -> str:
        """How well the windows meet, from the residuals, whose last ones these are."""
        jumps = MEETING * np.abs(residuals[-self.starts.size :]).max()
        return f"{len(self.starts) + 1} windows, which meet to {jumps:.2g} sigma."

    def _cut(self, x):
        """(x of the parameters, states at the starts of all windows (K, n))."""
        coordinates = self.problem.coordinates
        own, rest = x[: coordinates.size], x[coordinates.size :]
        parameters = coordinates.parameters(own)
        first = ravel_pytree(self.problem.state(parameters, self.problem.lattice(parameters)))[0]
        moved = self.starts + self.scale * rest.reshape(self.starts.shape)
        return own, jnp.concatenate([first[None], moved])

    def _window(self, own, start, parts, t0, t1):
        """Residuals (m,), end (n,) and signals of one window."""
        problem = dataclasses.replace(
            self.problem,
            traces=parts,
            t0=t0,
            t1=t1,
            make_state=None,
            given_state=self.unravel(start),
        )
        signals, final = problem.signals(problem.coordinates.parameters(own))
        return misfits(parts, signals), ravel_pytree(final)[0], signals

    def _every(self, own, starts, window):
        parts, named = eqx.partition(self.parts, eqx.is_array)

        def one(start, parts, t0, t1):
            return window(own, start, eqx.combine(parts, named), t0, t1)

        return jax.vmap(one)(starts, parts, self.edges[:-1], self.edges[1:])

    def residuals(self, x: Float[AnyArray, " P"]) -> Float[AnyArray, " m"]:
        """All residuals, one vector: of the data, then where windows meet."""
        own, starts = self._cut(x)
        residuals, ends, _ = self._every(own, starts, self._window)
        return jnp.concatenate(
            [residuals.ravel(), ((ends[:-1] - starts[1:]) / self.meeting).ravel()]
        )

    def linearise(
        self,
        x: Float[AnyArray, " P"],
    ) -> tuple[Float[AnyArray, " m"], Float[AnyArray, "m P"], Signals]:
        """(residuals, their Jacobian, signals): every window's tangents side by side, put together as blocks."""

        def window(own, start, *rest):
            def both(own, start):
                residuals, end, signals = self._window(own, start, *rest)
                return (residuals, end), (residuals, end, signals)

            by_both, values = jax.jacfwd(both, (0, 1), has_aux=True)(own, start)
            return values, *zip(*by_both)

        def cut(p):
            own, starts = self._cut(jnp.concatenate([p, x[p.size :]]))
            return starts[0], (own, starts)

        first, (own, starts) = jax.jacfwd(cut, has_aux=True)(x[: self.problem.coordinates.size])
        (residuals, ends, signals), by_own, by_start = self._every(own, starts, window)
        jumps = (ends[:-1] - starts[1:]) / self.meeting
        # window j starts at the free state j - 1 and ends at the free state j
        begins, ends_at = (np.eye(len(starts), len(starts) - 1, k) for k in (-1, 0))
        blocks = []
        for of, (p, s) in enumerate(zip(by_own, by_start)):
            p, s = p.at[0].add(s[0] @ first), jnp.einsum("jmn,n,jk->jmkn", s, self.scale, begins)
            if of == 1:
                s = s - jnp.einsum("mn,jk->jmkn", jnp.diag(self.scale), ends_at)
                p, s = p[:-1] / self.meeting[:, None], s[:-1] / self.meeting[:, None, None]
            blocks.append(
                jnp.concatenate([p, s.reshape(*s.shape[:2], -1)], axis=-1).reshape(-1, x.size)
            )
        return (
            jnp.concatenate([residuals.ravel(), jumps.ravel()]),
            jnp.concatenate(blocks),
            self._joined(signals),
        )

    def _joined(self, signals):
        return tuple(s.reshape(-1, s.shape[-1])[self.kept] for s in signals)


def cut(problem: Problem, count: int) -> Windows:
    """A problem in `count` windows of equally many samples.

    Their starts are guessed by running the start's scene from window to window, with what the sensors of velocity and
    displacement say put in at each; a velocity also tells the displacement, by its integral from the state at t0.
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
    # the samples of every window; what shorter ones lack repeats their last
    samples = np.minimum(first[:-1, None] + np.arange(np.diff(first).max()), first[1:, None] - 1)
    repeated = np.diff(samples, axis=1, prepend=-1) == 0
    parts = tuple(_parted(trace, samples, repeated) for trace in problem.traces)
    parameters = problem.coordinates.start
    lattice = problem.lattice(parameters)
    state = problem.state(parameters, lattice)
    readings, starts = _readings(problem, parameters, state), []
    for j in range(1, count):
        leg = eqx.tree_at(
            lambda p: (p.t0, p.t1), problem, (jnp.asarray(edges[j - 1]), jnp.asarray(edges[j]))
        )
        both = list(_leg(leg, parameters, state))
        for part, trace, values in readings:
            both[part] = _put(both[part], trace, values[first[j]])
        state = State(*both)
        starts.append(ravel_pytree(state)[0])
    unravel, starts = ravel_pytree(state)[1], jnp.stack(starts)
    scale = ravel_pytree(State(*map(_sized, state, jax.vmap(unravel)(starts))))[0]
    noise = max(
        float(
            jnp.max(1 / jnp.where(trace.weights > 0, trace.weights, jnp.inf))
            / jnp.nanmax(jnp.abs(trace.data))
        )
        for trace in problem.traces
    )
    return Windows(
        problem,
        starts,
        scale,
        MEETING * noise * scale,
        jnp.asarray(edges),
        parts,
        jnp.asarray(np.flatnonzero(~repeated)),
        unravel,
    )


def _sized(part, every):
    """The displacements or the velocities of a state, with the largest of all windows everywhere."""
    largest = max(float(jnp.max(jnp.abs(x))) for x in jax.tree.leaves(every))
    return jax.tree.map(lambda x: jnp.full_like(x, largest or 1.0), part)


@eqx.filter_jit
def _leg(problem, parameters, state):
    return problem.run(parameters, state=state).final


def _parted(trace, samples, repeated):
    """A trace with its samples on a leading axis of windows; those that are repeated count as missing."""
    count = len(samples)
    sigma = jnp.broadcast_to(trace.sigma, trace.data.shape)[samples]
    data = jnp.where(repeated[..., None], jnp.nan, trace.data[samples])
    gain, offset = (
        x if isinstance(x, str) else jnp.broadcast_to(x, (count, *jnp.shape(x)))
        for x in (trace.gain, trace.offset)
    )
    return eqx.tree_at(
        lambda t: (t.times, t.data, t.sigma, t.gain, t.offset),
        trace,
        (trace.times[samples], data, sigma, gain, offset),
        is_leaf=lambda x: x is None,
    )


def _readings(problem, parameters, state):
    """(0 for displacements or 1 for velocities, trace, values (T, S)) of what sensors say, the surest last."""
    from scipy.integrate import cumulative_trapezoid

    measured, integrated = [], []
    for trace in problem.traces:
        values = np.asarray(trace.data) / np.asarray(number(trace.gain, parameters))
        if trace.kind == "displacement":
            measured.append((0, trace, values))
        elif trace.kind == "velocity":
            u, v = (np.asarray(_pick(part, trace)) for part in state)
            times = np.append(float(problem.t0), np.asarray(trace.times + trace.offset))
            moved = cumulative_trapezoid(np.nan_to_num(np.vstack([v, values])), times, axis=0)
            integrated += [(1, trace, values), (0, trace, u + moved)]
    return integrated + measured


def _index(place, trace):
    return (*place, *(() if trace.component is None else (trace.component,)))


def _pick(x, trace):
    x = x if trace.field is None else x[trace.field]
    return [x[_index(place, trace)] for place in trace.places]


def _put(x, trace, values):
    y = x if trace.field is None else x[trace.field]
    for place, value in zip(trace.places, values):
        if np.isfinite(value):
            y = y.at[_index(place, trace)].set(value)
    return y if trace.field is None else {**x, trace.field: y}
