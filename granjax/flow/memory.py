"""Runs of lattices whose forces read the past.

Adaptive steps carry internal variables, or equal steps keep the whole history.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln

from ..base.arrays import trailing
from ..base.checks import concrete, refuse, show, traced, whole
from ..base.derivatives import forward_only, with_rule
from ..base.printing import text
from ..base.programs import compiled
from ..base.types import Number, Numbers, Scalar, StateLike, Times
from ..lattice import Lattice, State
from ..lattice.split import damping_rates
from ..results import array, entries, hidden
from ..solvers.interpolation import Path
from ..solvers.wrapped import Wrapped
from ..terms import CaputoDamping
from ..terms.base import memory_of, only
from ..terms.reach import per_lane, reads
from .arguments import checked_size, checked_tolerance, held_frames, least_tolerance, number
from .bath import baths
from .control import Scales, StepControl, one_sided
from .integrate import Plan, least_overlap, ordered, solved
from .remarks import passing
from .run import COMPLETED, NOT_FINITE, NOTHING, Found, Run, failed, finite, run_of
from .steps import floored_frequency, largest_excitation, refuse_far, refuse_unresolved

# The default tolerance of steps that carry internal variables.
TOLERANCE = 1e-11
# The first of these steps for a tolerance of 1, relative to t1 - t0.
FIRST = 0.01
# The number of times at which drives are evaluated.
SAMPLES = 257
# h omega of the default step with the whole history. The relative error is its square.
STEP_FRACTION = 0.02
WHOSE = "for a lattice whose forces read the past"


class RunWithMemory(Run):
    """A `Run` of a lattice whose forces read the past.

    `energy_error` is the largest |E - E0 - work| over the largest of |E0|, the kinetic energy at t0
    and |work|, where E includes `lost`; NaN where the work is not known. Contact openings are
    detected at the saved times only, or with Caputo damping at the ends of steps.
    """

    lattice: Lattice | None = hidden(
        "The lattice with its internal variables at the end, to continue: `gx.simulate(run.lattice, "
        "run.final, t1, t0=...)`. `None` with Caputo damping, whose history ends with the run.",
        default=None,
    )
    memory: dict[str, Numbers] | None = entries(
        "The internal variables at the saved times, (T, bonds), such as `largest_overlap` [m] of "
        "`PlasticContact`; that of a second such term is `largest_overlap_1`.",
        axes="time bond",
        default=None,
    )
    lost: Numbers | None = array(
        "The energy that terms with internal variables have dissipated since their virgin state.",
        "J",
        "time",
        default=None,
    )
    work: Numbers | None = array(
        "The work of all terms that do not conserve energy on the lattice since t0: above zero "
        "for drives, below zero for dashpots.",
        "J",
        "time",
        default=None,
    )

    @property
    def by_term(self) -> tuple[dict[str, Numbers] | None, ...]:
        """Internal variables at the saved times: a dict or `None` per term; `()` with Caputo damping."""
        if self.lattice is None:
            return ()
        found = [{} if term.memory else None for term in self.lattice.terms]
        for i, own, name in named(self.lattice):
            found[i][own] = self.memory[name]
        return tuple(found)

    def _held(self, name):
        held = super()._held(name)
        if name != "memory" or self.memory is None:
            return held
        terms = self.lattice.terms
        return held._replace(
            unit={name: terms[i].memory[own] for i, own, name in named(self.lattice)}
        )

    def _rows(self):
        *rows, outcome = super()._rows()
        yield from rows
        last = {"lost", "work", *(self.memory or {})}
        for name, x, held in self._fields():
            if name in last:
                yield name.replace("_", " "), text(np.asarray(x)[-1], self._unit(held))
        yield outcome


def named(lattice: Lattice) -> list[tuple[int, str, str]]:
    """Return (term, own name, name in a run) of every internal variable."""
    owned = [(i, own) for i, term in enumerate(lattice.terms) for own in term.memory]
    before = [sum(own == other for _, other in owned[:k]) for k, (_, own) in enumerate(owned)]
    return [(i, own, f"{own}_{n}" if n else own) for (i, own), n in zip(owned, before)]


def with_memory(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    save_ts: Any,
    every: bool,
    solver: Any,
    step: Any,
    tolerance: Any,
    record: Any,
    adjoint: Any,
    progress: bool,
    throw: bool | None,
    max_steps: Any,
) -> Run:
    """Run a lattice whose forces read the past, with checked state and times."""
    remedy = "Such lattices have a solver of their own; save_at= stores the motion."
    if solver is not None:
        refuse("solver", f"None {WHOSE}", type(solver).__name__, remedy)
    if record:
        refuse("record", f"None {WHOSE}", "records", remedy)
    if adjoint is not None and not isinstance(adjoint, diffrax.ForwardMode):
        modes = "as such a run has forward derivatives (jax.jvp, jax.jacfwd)"
        refuse("adjoint", f"None or diffrax.ForwardMode(), {modes}", type(adjoint).__name__)
    if every:
        refuse("save_at", f"times or a number of them, {WHOSE}", "'steps'")
    if baths(lattice):
        refuse("lattice", f"no heat baths {WHOSE}", "Langevin", "gx.Damping is its mean motion.")
    history = any(isinstance(term, CaputoDamping) for term in lattice.terms)
    for i, term in enumerate(lattice.terms):
        own = (
            isinstance(term, CaputoDamping) if history else term.memory and term.variables(lattice)
        )
        if memory_of(term) and not own:
            refuse(
                f"terms[{i}] ({type(term).__name__})",
                "a term whose memory has a solver here",
                "one that has none",
                "PlasticContact and CaputoDamping do not work within another term or side by side.",
            )
    dtype = lattice.dtype
    step = checked_size("step", step)
    begin = lattice, state, number(t0, dtype), number(t1, dtype)
    save_ts = None if save_ts is None else jnp.asarray(save_ts, dtype)
    if history:
        steps = _steps_of_history(lattice, state, t0, t1, step, tolerance)
        power = "h^2"
        if lattice.breaks:
            power = "h where forces jump within steps"
            # Equal steps do not see the breaks: derivatives by them would be zero without a word.
            times = jax.tree.leaves(lattice.breaks)
            none = with_rule(lambda *_: jnp.zeros((), dtype), _refuse_breaks, *times)
            begin = *begin[:2], begin[2] + none, begin[3]
        choice = f"equal steps of {(t1 - t0) / steps:.4g} with the whole history, error ~ {power}"
        name = "velocity Verlet"
        found, own = _with_history(*begin, save_ts, steps)
        looked = "ends of steps"
    else:
        refuse_far(lattice, state, t0, t1)
        longest = None if step is None else number(step, dtype)
        max_steps = None if max_steps is None else whole("max_steps", max_steps, 1)
        given = max(TOLERANCE, least_tolerance(dtype)) if tolerance is None else tolerance
        given = checked_tolerance(given, dtype)
        adjoint = diffrax.ForwardMode()
        plan = Plan(None, longest, given, save_ts, {}, adjoint, max_steps, progress=progress)
        name = "Dopri8"
        found, own = forward_only(_with_variables(*begin, plan), _refuse_reverse)
        looked = "saved times"
        choice = f"adaptive steps that carry internal variables, tolerance {show(given)}"
    remark = "" if traced(found) else passing(lattice, found.ts, found.us, found.final.u)
    names = name, choice, remark, f"checked at {looked} only", 0.0
    throws = not traced(found) and failed(found) and (throw is None or throw)
    return run_of(RunWithMemory, found, lattice, names, own | {"_t1": begin[3]}, throws)


def _refuse_breaks(times, changes):
    remedy = "Hold the times of breaks, and what sets them, such as the frequency of a Square."
    refuse("lattice", "no derivative by times of breaks with Caputo damping", "one", remedy)


def _refuse_reverse():
    got = "reverse mode (jax.grad, jax.vjp, jax.jacrev)"
    refuse("simulate", f"forward mode (jax.jvp, jax.jacfwd) {WHOSE}", got)


def _total(lattice, tree):
    return jnp.zeros(lattice.lanes, lattice.dtype) + per_lane(tree, len(lattice.lanes))


def _power(lattice, force, v):
    # The power of a force; a dict may hold only some of the fields.
    v = {name: v[name] for name in force} if isinstance(force, dict) else v
    return _total(lattice, jax.tree.map(jnp.multiply, force, v))


def _conserve(lattice):
    return [reads(term, lattice).conserves for term in lattice.terms]


def _found(lattice, state, begin, works, missed, seen, ts, us, vs, final, code, **stats):
    # `begin`: the energy at the start. `works`: the work at each time. `missed`: the error of the
    # energy balance. `seen`: the least overlaps along the run.
    scale = jnp.maximum(jnp.abs(begin), lattice.kinetic_energy(state.v))
    scale = jnp.maximum(scale, jnp.max(jnp.abs(works), axis=0))
    error = missed / jnp.where(scale > 0, scale, 1)
    least = jnp.min(seen, axis=0)
    margin = jnp.where(least < 0, -1.0, jnp.inf)
    return Found(ts, us, vs, final, {}, error, margin, least, {}, code, stats)


class Moving(NamedTuple):
    """Displacements, velocities, the work of non-conservative terms (lanes), and memory by term."""

    u: Any
    v: Any
    work: Any
    memory: tuple


@compiled
def _with_variables(
    lattice: Lattice, state: StateLike, t0: Scalar, t1: Scalar, plan: Plan
) -> tuple[Found, dict]:
    # All lanes share the adaptive steps. Also returns the further fields of a `RunWithMemory`.
    begin = State(*state)
    none = jnp.zeros(lattice.lanes, lattice.dtype)
    start = Moving(*begin, none, memory_at(lattice, begin))
    # Errors of velocities alone count.
    norm = Scales(jnp.finfo(lattice.dtype).max, _speed(lattice, start, t0, t1))
    controller = StepControl(plan.tolerance, norm, FIRST * (t1 - t0), plan.step, lattice.breaks)
    if plan.save_ts is not None:
        controller = diffrax.ClipStepSizeController(controller, step_ts=plan.save_ts)
    solver = Remembering(one_sided(diffrax.Dopri8(scan_kind="lax"), lattice))
    found = solved(_field, solver, controller, lattice, start, t0, t1, plan)
    (ys, final, _, code), (ts, _, steps, accepted, rejected) = found

    def looked(frame):
        t, y = frame
        return _kept_energy(lattice, t, y), least_overlap(recalled(lattice, y.memory), t, y.u)

    energies, seen = jax.lax.map(looked, (ts, ys))
    begin = _kept_energy(lattice, t0, start)
    lost = [
        jax.lax.map(lambda x, term=term: _total(lattice, term.lost(x)), x)
        for term, x in zip(lattice.terms, ys.memory)
        if x is not None
    ]
    found = _found(
        lattice,
        state,
        begin,
        ys.work,
        jnp.max(jnp.abs(energies - begin - ys.work), axis=0),
        seen,
        ts,
        ys.u,
        ys.v,
        State(final.u, final.v),
        code,
        steps=steps,
        accepted=accepted,
        rejected=rejected,
        step=(t1 - t0) / jnp.maximum(accepted, 1),
        force_evaluations=jnp.nan,
    )
    return found, {
        "lattice": recalled(lattice, final.memory),
        "memory": {name: ys.memory[i][own] for i, own, name in named(lattice)},
        "lost": sum(lost),
        "work": ys.work,
    }


def recalled(lattice: Lattice, memory: tuple) -> Lattice:
    """Return the lattice with these internal variables."""
    terms = tuple(
        term if x is None else term.recalling(x) for term, x in zip(lattice.terms, memory)
    )
    return eqx.tree_at(lambda x: x.terms, lattice, terms)


def memory_at(lattice: Lattice, state: State) -> tuple:
    """Return the internal variables of all terms where a run begins."""
    # The initial state itself may change them.
    memory = tuple(term.variables(lattice) if term.memory else None for term in lattice.terms)
    return _advanced(lattice, memory, jnp.zeros((), lattice.dtype), state, state)


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
    for force, conserves in zip(forces, _conserve(lattice)):
        if not conserves:
            work = work + _power(lattice, force, y.v)
    return Moving(y.v, acceleration, work, jax.tree.map(jnp.zeros_like, y.memory))


def _kept_energy(lattice, t, y):
    # The energy of the motion and of the conservative terms, including what those have lost.
    terms = zip(recalled(lattice, y.memory).terms, _conserve(lattice))
    kept = [term.energy(t, y.u) for term, conserves in terms if conserves]
    return lattice.kinetic_energy(y.v) + _total(lattice, kept)


def _speed(lattice, start, t0, t1):
    # The speed of the lightest site if it had all the energy. For a lattice at rest, the speed that
    # drives and walls give it within the run.
    lightest = jnp.min(jnp.stack([jnp.min(m) for m in jax.tree.leaves(lattice.mass)]))
    speed = jnp.sqrt(2 * jnp.max(jnp.abs(_kept_energy(lattice, t0, start))) / lightest)
    if lattice.reads_time:
        driven = largest_excitation(lattice, jnp.linspace(t0, t1, SAMPLES))
        given = jnp.maximum(driven.force * (t1 - t0) / lightest, driven.speed)
        speed = jnp.maximum(speed, given)
    return jax.lax.stop_gradient(jnp.where(speed > 0, speed, 1.0))


class Remembering(Wrapped):
    """A solver that takes each step with the internal variables of its start, then updates them.

    The error that this makes in the force at the end, times the step, is added to the error
    estimate. So steps are short where a contact turns from loading to unloading, and the error
    falls with their third power.
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
        end = y1._replace(memory=_advanced(args, y0.memory, h, y0, y1))
        before = terms.vf(t1, y1, args).v
        after = terms.vf(t1, end, args).v
        missed = jax.tree.map(lambda a, b: jnp.abs(h * (a - b)), before, after)
        more = lambda e, x: jnp.abs(e) + x
        error = error._replace(
            u=jax.tree.map(lambda e, x: more(e, h * x), error.u, missed),
            v=jax.tree.map(more, error.v, missed),
        )
        dense = {"inner": dense, "start": y0, "lattice": args}
        return end, error, dense, own, result


class _Path(Path):
    """The dense output of a step, with the internal variables at each time."""

    kind: Callable = eqx.field(static=True)
    t0: Any
    t1: Any
    inner: Any
    start: Any
    lattice: Any

    def at(self, t):
        y = self.kind(t0=self.t0, t1=self.t1, **self.inner).evaluate(t)
        passed = t - self.t0
        return y._replace(memory=_advanced(self.lattice, self.start.memory, passed, self.start, y))


def _steps_of_history(lattice, state, t0, t1, step, tolerance):
    if tolerance is not None:
        refuse(
            "tolerance",
            "None with Caputo damping, whose steps are equal",
            show(tolerance),
            "Give step=; the error falls with its square.",
        )
    others = [
        type(term).__name__
        for term in lattice.terms
        if not term.memory and term.exact_damping() is None and reads(term, lattice).velocity
    ]
    if others:
        refuse(
            "lattice",
            "no force that reads velocities, except CaputoDamping and Damping",
            ", ".join(others),
        )
    if traced((step, t0, t1)):
        refuse(
            "step, t0, t1",
            "known numbers, which say how many steps of history are kept",
            "traced ones",
        )
    omega = None
    if step is None or not traced((lattice, state)):
        omega = concrete(floored_frequency(lattice, state, t0, t1))
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
            show(step),
        )
    refuse_unresolved(t0, t1, step, lattice.dtype)
    steps = max(math.ceil((t1 - t0) / step * (1 - 1e-9)), 2)
    held_frames("step", steps, state, "steps of history")
    return steps


def weights(order: Number, step: Number, count: int) -> tuple[Numbers, Numbers, Numbers]:
    """Return the weights and the error of the product trapezoidal rule, by steps.

    The rule is for the integral of v(s) (t - s)^{-a}/Gamma(1 - a), v linear within steps. The first
    array, (count + 1,) and the shape of `order`, is b_j of the value j steps ago, the second that
    of the initial value after j steps. The third one, (count,), is the rule's error in each step
    for t^{1-a}/Gamma(2 - a): the damping of the initial velocity, which is of order h^{2-a} in the
    first steps, and would persist.
    """
    j = trailing(jnp.arange(count + 1, dtype=order.dtype), 1 + order.ndim)
    far = jnp.maximum(j, 1)
    q = 2 - order
    before = jnp.where(far > 1, jnp.expm1(q * jnp.log1p(-1 / jnp.maximum(far, 2))), -1.0)
    inner = far**q * (jnp.expm1(q * jnp.log1p(1 / far)) + before)
    # (j - 1)^q - (j - q) j^{q - 1}
    first = far**q * (before + q / far)
    unit = step ** (q - 1) / jnp.exp(gammaln(1 + q))
    one_less = jnp.where(j > 0, far ** (q - 1), 0.0)
    missed = jnp.diff(j * one_less, axis=0) - q / 2 * (one_less[1:] + one_less[:-1])
    return (
        unit * jnp.where(j > 0, inner, 1.0),
        unit * jnp.where(j > 0, first, 1.0),
        step * unit * missed,
    )


@compiled
def _with_history(
    lattice: Lattice, state: StateLike, t0: Scalar, t1: Scalar, save_ts: Times | None, steps: int
) -> tuple[Found, dict]:
    # Velocity Verlet with the whole history of the velocities. Also returns the further fields of a
    # `RunWithMemory`.
    h = (t1 - t0) / steps
    u0, v0 = state
    # For each damping: its field, its coefficient, the weights of the past and of the start, and
    # the errors of the rule.
    damped = []
    for term in lattice.terms:
        if isinstance(term, CaputoDamping):
            order = jnp.asarray(term.order, lattice.dtype)
            damped.append((term.field, term.coefficient, *weights(order, h, steps)))
    plain = [t for t in lattice.terms if not t.memory and t.exact_damping() is None]
    kept = [term for term in plain if reads(term, lattice).conserves]
    rates = {name: 0.0 if rate is None else rate for name, rate in damping_rates(lattice, v0)}
    own = {
        name: sum((c * inner[0] for field, c, inner, *_ in damped if field in (None, name)), 0.0)
        for name in rates
    }
    rates, own = (found.get(None, found) for found in (rates, own))
    slowing = jax.tree.map(lambda m, rate, own: rate + own / m, lattice.mass, rates, own)

    def momenta(vs, each):
        # The sum over the dampings of c times a function of its weights and the velocities.
        parts = []
        for field, c, *rules in damped:
            own = only(vs, field)
            parts.append(jax.tree.map(lambda v, c=c, rules=rules: c * each(v, *rules), own))
        return lattice.total(parts, v0)

    def power(t, u, v, a):
        # The power of the non-conservative terms: that of all forces, m a v, less that of the
        # others.
        keep = lattice.sum_forces(t, u, v, kept)
        rest = jax.tree.map(lambda m, a, f: m * a - f, lattice.mass, a, keep)
        return _power(lattice, rest, v)

    def energy(t, u, v):
        return lattice.kinetic_energy(v) + _total(lattice, [term.energy(t, u) for term in kept])

    def step(carry, n):
        u, v, a, us, vs, work, before, worst = carry
        t = t0 + (n + 1) * h
        half = jax.tree.map(lambda v, a: v + h / 2 * a, v, a)
        u = jax.tree.map(lambda u, w: u + h * w, u, half)
        # The damping force of the velocities before this step.
        past = momenta(vs, lambda v, inner, first, _: _convolved(v, inner, first, n + 1))
        pushed = jax.tree.map(jnp.subtract, lattice.sum_forces(t, u, half, plain), past)
        slow = jax.tree.map(
            lambda w, f, m, rate: (w + h / 2 * f / m) / (1 + h / 2 * rate),
            half,
            pushed,
            lattice.mass,
            slowing,
        )
        a = jax.tree.map(lambda v, w: 2 / h * (v - w), slow, half)
        # The momentum that the rule misses in this step.
        taken = momenta(v0, lambda v, *rules: rules[-1][n] * v)
        v = jax.tree.map(lambda v, p, m: v - p / m, slow, taken, lattice.mass)
        us, vs = (_written(xs, x, n + 1) for xs, x in ((us, u), (vs, v)))
        now = power(t, u, v, a)
        mean = jax.tree.map(lambda a, b: (a + b) / 2, slow, v)
        work = work + h / 2 * (before + now) - _power(lattice, taken, mean)
        worst = jnp.maximum(worst, jnp.abs(energy(t, u, v) - begin - work))
        return (u, v, a, us, vs, work, now, worst), (work, least_overlap(lattice, t, u))

    begin = energy(t0, u0, v0)
    none = jnp.zeros(lattice.lanes, lattice.dtype)
    pushed = lattice.sum_forces(t0, u0, v0, plain)
    a0 = jax.tree.map(lambda f, m, rate, v: f / m - rate * v, pushed, lattice.mass, rates, v0)
    us, vs = (
        _written(jax.tree.map(lambda x: jnp.zeros((steps + 1, *x.shape), x.dtype), x), x, 0)
        for x in (u0, v0)
    )
    carry = u0, v0, a0, us, vs, none, power(t0, u0, v0, a0), none
    carry, (works, seen) = jax.lax.scan(step, carry, jnp.arange(steps))
    u, v, _, us, vs, _, _, worst = carry
    final = State(u, v)
    ts = t1[None] if save_ts is None else save_ts
    sound = ordered(ts, t0, t1)
    ts = jnp.where(sound, ts, jnp.nan)

    # Displacements are interpolated by the cubic through both ends of a step, other quantities
    # linearly.
    place = (ts - t0) / h
    k = jnp.clip(jnp.floor(place).astype(int), 0, steps - 1)
    within = lambda x: trailing(place - k, x.ndim)

    def cubic(u, v):
        x = within(u)
        a = u[k]
        b = u[k + 1]
        d = h * v[k]
        e = h * v[k + 1]
        return a + x * (d + x * (3 * (b - a) - 2 * d - e + x * (d + e - 2 * (b - a))))

    def linear(w):
        return (1 - within(w)) * w[k] + within(w) * w[k + 1]

    found = _found(
        lattice,
        state,
        begin,
        works,
        worst,
        seen,
        ts,
        jax.tree.map(cubic, us, vs),
        jax.tree.map(linear, vs),
        final,
        jnp.where(sound, jnp.where(finite(final, lattice.lanes), COMPLETED, NOT_FINITE), NOTHING),
        steps=jnp.asarray(steps),
        accepted=jnp.asarray(steps),
        rejected=jnp.asarray(0),
        step=h,
        force_evaluations=jnp.asarray(steps + 1.0),
    )
    work = linear(jnp.concatenate([none[None], works]))
    return found, {"work": work}


def _convolved(x, inner, first, n):
    # The sum over k < n of b_{n-k} v_k, for velocities (T + 1, sites, lanes) that are zero from n
    # on.
    count = x.shape[0]
    # b_n, b_{n-1}, ..., b_1, then weights that multiply zeros.
    rows = jnp.abs(n - jnp.arange(count))
    b = inner[rows].at[0].set(first[n])
    b = b.reshape((count,) + (1,) * (x.ndim - b.ndim) + b.shape[1:])
    return jnp.sum(b * x, axis=0)


def _written(xs, x, n):
    return jax.tree.map(lambda xs, x: jax.lax.dynamic_update_index_in_dim(xs, x, n, 0), xs, x)
