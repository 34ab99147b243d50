"""Runs of lattices with internal variables, such as plastic contacts: adaptive steps that carry them."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from ...lattice import Lattice, State
from ...solvers.wrapped import Wrapped
from ...terms.tracing import reads
from ...types import Number, Pytree, Scalar, StateLike, Times
from ..breaks import one_sided
from ..control import StepControl, largest
from ..integrate import _code, overlaps
from ..run import Found

# of a run: what the first step would be with a tolerance of 1; times at which drives are looked at
FIRST, SAMPLES = 0.01, 257


class Moving(NamedTuple):
    """Displacements, velocities, the work of terms that keep no energy (lanes), and the internal variables by term."""

    u: Any
    v: Any
    work: Any
    memory: tuple


class _Speeds(eqx.Module):
    """The largest error of a velocity, by the speed that all energy would give to the lightest site."""

    speed: jax.Array

    def __call__(self, y):
        return largest(y.v) / self.speed


def _speed(lattice, start, t0, t1):
    """That speed; where nothing moves at first, what drives and walls give within the run."""
    lightest = jnp.min(jnp.stack([jnp.min(m) for m in jax.tree.leaves(lattice.mass)]))
    speed = jnp.sqrt(2 * jnp.max(jnp.abs(_kept_energy(lattice, t0, start))) / lightest)
    if lattice.reads_time:
        ts = jnp.linspace(t0, t1, SAMPLES)
        for term in lattice.terms:
            driven = term.excitation(lattice, ts)
            speed = jnp.maximum(
                speed, jnp.maximum(driven.force * (t1 - t0) / lightest, driven.speed)
            )
    return jax.lax.stop_gradient(jnp.where(speed > 0, speed, 1.0))


def recalled(lattice: Lattice, memory: tuple) -> Lattice:
    """The lattice that holds these internal variables."""
    terms = tuple(
        term if x is None else term.recalling(x) for term, x in zip(lattice.terms, memory)
    )
    return eqx.tree_at(lambda x: x.terms, lattice, terms)


def _advanced(lattice, memory, h, start, end):
    pairs = (start.u, start.v), (end.u, end.v)
    return tuple(
        None if x is None else term.advanced(x, h, *pairs) for term, x in zip(lattice.terms, memory)
    )


def _field(t, y, lattice):
    now = recalled(lattice, y.memory)
    forces = [term.force(t, y.u, y.v, now.mass) for term in now.terms]
    acceleration = jax.tree.map(jnp.divide, now.total(forces, y.u), now.mass)
    work = jnp.zeros_like(y.work)
    for term, force in zip(lattice.terms, forces):
        if not reads(term, lattice).conserves:
            pairs = (
                [(force[k], y.v[k]) for k in force] if isinstance(force, dict) else [(force, y.v)]
            )
            work = work + sum(_over_sites(f * v, lattice) for f, v in pairs)
    return Moving(y.v, acceleration, work, jax.tree.map(jnp.zeros_like, y.memory))


def _over_sites(x, lattice):
    return x.sum(tuple(range(x.ndim - len(lattice.lanes))))


class Remembering(Wrapped):
    """A solver that takes each step with the internal variables of its start, and then moves them.

    A contact that turns within a step has loaded all along it. What that misses in the force at the end, times the
    step, joins the error: so steps are short where a contact turns, and what is missed falls with their third power.
    """

    @property
    def interpolation_cls(self):
        return partial(_Path, self.solver.interpolation_cls)

    def init(self, terms, t0, t1, y0, args):
        return self.solver.init(terms, t0, t1, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        y1, error, dense, own, result = self.solver.step(
            terms, t0, t1, y0, args, solver_state, True
        )
        h = t1 - t0
        memory = _advanced(args, y0.memory, h, y0, y1)
        end = y1._replace(memory=memory)
        before, after = terms.vf(t1, y1, args).v, terms.vf(t1, end, args).v
        missed = jax.tree.map(lambda a, b: jnp.abs(h * (a - b)), before, after)
        more = lambda e, x: jnp.abs(e) + x
        error = error._replace(
            u=jax.tree.map(lambda e, x: more(e, h * x), error.u, missed),
            v=jax.tree.map(more, error.v, missed),
        )
        dense = {"inner": dense, "start": y0, "lattice": args}
        return end, error, dense, own, result


class _Path(diffrax.AbstractLocalInterpolation):
    """The dense output of a step, with the internal variables as they have become at a time within it."""

    kind: Callable = eqx.field(static=True)
    t0: Any
    t1: Any
    inner: Any
    start: Any
    lattice: Any

    def evaluate(self, t0, t1=None, left=True):
        if t1 is not None:
            return jax.tree.map(jnp.subtract, self.evaluate(t1), self.evaluate(t0))
        y = self.kind(t0=self.t0, t1=self.t1, **self.inner).evaluate(t0)
        return y._replace(
            memory=_advanced(self.lattice, self.start.memory, t0 - self.t0, self.start, y)
        )


@eqx.filter_jit
def integrate(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    tolerance: Number,
    longest: Number | None,
    save_ts: Times | None,
    max_steps: int | None,
    progress: bool,
) -> tuple[Found, dict]:
    """Integrate and reduce; everything checked. A `RunWithMemory` without its names; lanes share their steps."""
    start = _begin(lattice, state)
    norm, first = _Speeds(_speed(lattice, start, t0, t1)), FIRST * (t1 - t0)
    controller = StepControl(tolerance, norm, first, longest, lattice.breaks)
    if save_ts is not None:
        controller = diffrax.ClipStepSizeController(controller, step_ts=save_ts)
    subs = [diffrax.SubSaveAt(t1=True)] + (
        [] if save_ts is None else [diffrax.SubSaveAt(ts=save_ts)]
    )
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(_field),
        Remembering(one_sided(diffrax.Dopri8(scan_kind="lax"), lattice)),
        t0,
        t1,
        None,
        start,
        args=lattice,
        saveat=diffrax.SaveAt(subs=subs),
        stepsize_controller=controller,
        adjoint=diffrax.ForwardMode(),
        max_steps=max_steps,
        throw=False,
        progress_meter=diffrax.TqdmProgressMeter() if progress else diffrax.NoProgressMeter(),
    )
    final = jax.tree.map(lambda x: x[0], solution.ys[0])
    ts, ys = solution.ts[-1], solution.ys[-1]
    counts = {
        kind or "steps": solution.stats[f"num_{kind}{'_' if kind else ''}steps"]
        for kind in ("", "accepted", "rejected")
    }
    code = _code(solution.result, final)
    return _reduced(lattice, state, (t0, t1), start, (ts, ys, final, counts, code))


def _begin(lattice: Lattice, state: StateLike) -> Moving:
    """The start: internal variables that the state itself has moved already."""
    memory = tuple(term.variables(lattice) if term.memory else None for term in lattice.terms)
    start = Moving(*state, jnp.zeros(lattice.lanes, lattice.dtype), memory)
    return start._replace(
        memory=_advanced(lattice, memory, jnp.zeros((), lattice.dtype), start, start)
    )


def _kept_energy(lattice, t, y):
    """Energy of the motion and of the terms that keep it, what they have lost included."""
    now, total = recalled(lattice, y.memory), lattice.kinetic_energy(y.v)
    for term, kept in zip(now.terms, lattice.terms):
        if reads(kept, lattice).conserves:
            total = total + sum(
                _over_sites(e, lattice) for e in jax.tree.leaves(term.energy(t, y.u))
            )
    return total


def _reduced(lattice, state, span, start, found):
    (t0, t1), (ts, ys, final, counts, code) = span, found
    energies = jax.lax.map(lambda ty: _kept_energy(lattice, *ty), (ts, ys))
    begin = _kept_energy(lattice, t0, start)
    scale = jnp.maximum(
        jnp.maximum(jnp.abs(begin), lattice.kinetic_energy(state.v)),
        jnp.max(jnp.abs(ys.work), axis=0),
    )
    missed = jnp.max(jnp.abs(energies - begin - ys.work), axis=0) / jnp.where(scale > 0, scale, 1)
    lost = sum(
        (
            _over_frames(term.lost, x, lattice)
            for term, x in zip(lattice.terms, ys.memory)
            if x is not None
        ),
        jnp.zeros_like(ys.work),
    )
    memory, kinds = _named(lattice, ys.memory)
    least = jax.lax.map(lambda ty: _smallest(lattice, *ty), (ts, ys))
    margin = jnp.where(jnp.min(least, axis=0) < 0, -1.0, jnp.inf)
    stats = {
        **counts,
        "step": (t1 - t0) / jnp.maximum(counts["accepted"], 1),
        "force_evaluations": jnp.nan,
    }
    state = State(final.u, final.v)
    least = jnp.min(least, axis=0)
    found = Found(ts, ys.u, ys.v, state, {}, missed, margin, least, {}, code, stats)
    own = {
        "lattice": recalled(lattice, final.memory),
        "memory": memory,
        "lost": lost,
        "work": ys.work,
        "_kinds": kinds,
        "unseen": "looked at at the saved times alone",
    }
    return found, own


def _over_frames(lost, variables, lattice):
    energy = jax.lax.map(lost, variables)
    return energy.sum(tuple(range(1, energy.ndim - len(lattice.lanes))))


def _named(lattice: Lattice, memory: Pytree) -> tuple[dict, tuple]:
    """The internal variables by name, and (name, unit) of each."""
    named, kinds = {}, []
    for term, variables in zip(lattice.terms, memory):
        for name, x in (variables or {}).items():
            count = sum(known == name or known.startswith(f"{name}_") for known in named)
            said = f"{name}_{count}" if count else name
            named[said] = x
            kinds.append((said, term.memory[name]))
    return named, tuple(kinds)


def _smallest(lattice, t, y):
    """The least overlap of all contacts, per lane."""
    seen = overlaps(recalled(lattice, y.memory), t, y.u)
    found = [s.min(tuple(range(s.ndim - len(lattice.lanes)))) for s in seen]
    return (
        jnp.min(jnp.stack(found), axis=0)
        if found
        else jnp.full(lattice.lanes, jnp.inf, lattice.dtype)
    )
