"""Runs of lattices with Caputo damping: velocity Verlet, and the whole history of the velocities."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.special import gammaln

from ...lattice import Lattice, State
from ...lattice.split import damping_rates
from ...terms import CaputoDamping
from ...terms.tracing import reads
from ...types import Number, Numbers, Scalar, StateLike, Times
from ..integrate import overlaps
from ..run import COMPLETED, NOT_FINITE, Found, finite
from .internal import _over_sites

# h omega of the default step, whose square is the error
STEP_FRACTION = 0.02


def weights(order: Number, step: Number, count: int) -> tuple[Numbers, Numbers]:
    """(b_j of the value j steps ago, those of the value at the start, of j steps) of the product trapezoidal rule.

    For the integral of v(s) (t - s)^{-a}/Gamma(1 - a), v linear within steps; (count + 1,) and the shape of `order`.
    """
    j = jnp.arange(count + 1, dtype=order.dtype).reshape((-1,) + (1,) * order.ndim)
    far, q = jnp.maximum(j, 1), 2 - order
    before = jnp.where(far > 1, jnp.expm1(q * jnp.log1p(-1 / jnp.maximum(far, 2))), -1.0)
    inner = far**q * (jnp.expm1(q * jnp.log1p(1 / far)) + before)
    # (j - 1)^q - (j - q) j^{q - 1}
    first = far**q * (before + q / far)
    unit = step ** (1 - order) / jnp.exp(gammaln(3 - order))
    return unit * jnp.where(j > 0, inner, 1.0), unit * jnp.where(j > 0, first, 1.0)


def missed(order: Number, step: Number, count: int) -> Numbers:
    """What the trapezoidal rule misses of t^{1-a}/Gamma(2 - a) in each of `count` steps, (count,) and `order`'s shape.

    The damping of a velocity that is there at the start: of order h^{2-a} in the first steps, which would stay.
    """
    j = jnp.arange(count + 1, dtype=order.dtype).reshape((-1,) + (1,) * order.ndim)
    q = 2 - order
    one_less = jnp.where(j > 0, jnp.maximum(j, 1) ** (q - 1), 0.0)
    found = jnp.diff(j * one_less, axis=0) - q / 2 * (one_less[1:] + one_less[:-1])
    return step**q / jnp.exp(gammaln(1 + q)) * found


@eqx.filter_jit
def march(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    save_ts: Times | None,
    steps: int,
) -> tuple[Found, dict]:
    """Integrate and reduce; everything checked. What is found, and what else a `RunWithMemory` has."""
    h, u0, v0 = (t1 - t0) / steps, *state
    remember = [term for term in lattice.terms if isinstance(term, CaputoDamping)]
    damped = [(term.field, term.order, term.coefficient) for term in remember]
    orders = [jnp.asarray(order, lattice.dtype) for _, order, _ in damped]
    tables, misses = ([table(order, h, steps) for order in orders] for table in (weights, missed))
    rates = dict(damping_rates(lattice, v0))
    plain = [t for t in lattice.terms if not t.memory and t.exact_damping() is None]

    def forces(t, u, v):
        return lattice.total([term.force(t, u, v, lattice.mass) for term in plain], u)

    def history(vs, n):
        """Of each damping, its part of the force that the velocities before step n say, and what v_n is times."""
        parts = []
        for (field, _, c), (inner, first) in zip(damped, tables):
            own = vs if field is None else {field: vs[field]}
            parts.append(jax.tree.map(lambda x: c * _convolved(x, inner, first, n), own))
        return lattice.total(parts, v0)

    def correction(n):
        """What step n still has to take from the momenta."""
        own = [v0 if field is None else {field: v0[field]} for field, *_ in damped]
        parts = [
            jax.tree.map(lambda v: c * miss[n] * v, v)
            for v, miss, (*_, c) in zip(own, misses, damped)
        ]
        return lattice.total(parts, v0)

    def own_rate(name):
        """c b_0 of all dampings of a field."""
        return sum(
            (
                c * inner[0]
                for (field, _, c), (inner, _) in zip(damped, tables)
                if field in (None, name)
            ),
            0.0,
        )

    def slowed(half, pushed):
        def one(name, half, pushed, m):
            rate = 0.0 if rates[name] is None else rates[name]
            return (half + h / 2 * pushed / m) / (1 + h / 2 * (rate + own_rate(name) / m))

        if isinstance(half, dict):
            return {name: one(name, half[name], pushed[name], lattice.mass[name]) for name in half}
        return one(None, half, pushed, lattice.mass)

    def power(t, u, v, a):
        """Of the terms that keep no energy: of all forces, m a v, less those that do."""
        kept = [
            term.force(t, u, v, lattice.mass) for term in plain if reads(term, lattice).conserves
        ]
        rest = jax.tree.map(lambda m, a, f: m * a - f, lattice.mass, a, lattice.total(kept, u))
        return sum(jax.tree.leaves(jax.tree.map(lambda f, v: _over_sites(f * v, lattice), rest, v)))

    def given(momenta, before, after):
        """The work of momenta that change velocities from before to after."""
        sums = jax.tree.map(
            lambda p, a, b: _over_sites(p * (a + b) / 2, lattice), momenta, before, after
        )
        return sum(jax.tree.leaves(sums))

    def energy(t, u, v):
        stored = [term.energy(t, u) for term in plain if reads(term, lattice).conserves]
        return lattice.kinetic_energy(v) + sum(
            _over_sites(e, lattice) for x in stored for e in jax.tree.leaves(x)
        )

    def step(carry, n):
        u, v, a, us, vs, work, before, worst = carry
        t = t0 + (n + 1) * h
        half = jax.tree.map(lambda v, a: v + h / 2 * a, v, a)
        u = jax.tree.map(lambda u, w: u + h * w, u, half)
        slow = slowed(half, jax.tree.map(jnp.subtract, forces(t, u, half), history(vs, n + 1)))
        a = jax.tree.map(lambda v, w: 2 / h * (v - w), slow, half)
        taken = correction(n)
        v = jax.tree.map(lambda v, p, m: v - p / m, slow, taken, lattice.mass)
        us, vs = (_written(xs, x, n + 1) for xs, x in ((us, u), (vs, v)))
        now = power(t, u, v, a)
        work = work + h / 2 * (before + now) - given(taken, slow, v)
        worst = jnp.maximum(worst, jnp.abs(energy(t, u, v) - begin - work))
        return (u, v, a, us, vs, work, now, worst), (work, _overlap(lattice, t, u))

    begin = energy(t0, u0, v0)
    rated = {name: 0.0 if rate is None else rate for name, rate in rates.items()}
    named = lambda x: x if isinstance(x, dict) else {None: x}
    a0 = {
        name: f / m - rated[name] * v
        for (name, f), m, v in zip(
            named(forces(t0, u0, v0)).items(), named(lattice.mass).values(), named(v0).values()
        )
    }
    a0 = a0 if isinstance(u0, dict) else a0[None]
    none = jnp.zeros(lattice.lanes, lattice.dtype)
    us, vs = (
        _written(jax.tree.map(lambda x: jnp.zeros((steps + 1, *x.shape), x.dtype), x), x, 0)
        for x in (u0, v0)
    )
    first = power(t0, u0, v0, a0)
    carry, (works, seen) = jax.lax.scan(
        step, (u0, v0, a0, us, vs, none, first, none), jnp.arange(steps)
    )
    u, v, _, us, vs, work, _, worst = carry
    final = State(u, v)
    ts = t1[None] if save_ts is None else save_ts
    frames = _frames((us, vs), jnp.concatenate([none[None], works]), ts, t0, h, steps)
    scale = jnp.maximum(
        jnp.maximum(jnp.abs(begin), lattice.kinetic_energy(v0)), jnp.max(jnp.abs(works), axis=0)
    )
    code = jnp.where(finite(final), COMPLETED, NOT_FINITE)
    stats = {
        "steps": jnp.asarray(steps),
        "accepted": jnp.asarray(steps),
        "rejected": jnp.asarray(0),
        "step": h,
        "force_evaluations": jnp.asarray(steps + 1.0),
    }
    margin = jnp.where(jnp.min(seen, axis=0) < 0, -1.0, jnp.inf)
    least, lost = jnp.min(seen, axis=0), worst / jnp.where(scale > 0, scale, 1)
    found = Found(ts, *frames[:2], final, {}, lost, margin, least, {}, code, stats)
    return found, {"work": frames[2], "unseen": "looked at at the ends of steps alone"}


def _convolved(x, inner, first, n):
    """Sum over k < n of b_{n-k} v_k, of an array of all velocities (T + 1, sites, lanes) that is zero from n on."""
    count = x.shape[0]
    # b_n, b_{n-1}, ..., b_1 and what meets zeros
    rows = jnp.abs(n - jnp.arange(count))
    b = inner[rows].at[0].set(first[n])
    b = b.reshape((count,) + (1,) * (x.ndim - b.ndim) + b.shape[1:])
    return jnp.sum(b * x, axis=0)


def _written(xs, x, n):
    return jax.tree.map(lambda xs, x: jax.lax.dynamic_update_index_in_dim(xs, x, n, 0), xs, x)


def _overlap(lattice, t, u):
    seen = overlaps(lattice, t, u)
    found = [s.min(tuple(range(s.ndim - len(lattice.lanes)))) for s in seen]
    return (
        jnp.min(jnp.stack(found), axis=0)
        if found
        else jnp.full(lattice.lanes, jnp.inf, lattice.dtype)
    )


def _frames(motion, works, ts, t0, h, steps):
    """(us, vs, work) at times: displacements by the cubic through two ends of a step, the others linear between."""
    place = (ts - t0) / h
    k = jnp.clip(jnp.floor(place).astype(int), 0, steps - 1)
    us, vs = motion

    def at(x, k):
        return x[k]

    def along(x, like):
        return x.reshape((-1,) + (1,) * (like.ndim - 1))

    def cubic(u, v):
        x = along(place - k, u)
        a, b, d, e = at(u, k), at(u, k + 1), h * at(v, k), h * at(v, k + 1)
        return a + x * (d + x * (3 * (b - a) - 2 * d - e + x * (d + e - 2 * (b - a))))

    def linear(w):
        x = along(place - k, w)
        return (1 - x) * at(w, k) + x * at(w, k + 1)

    return jax.tree.map(cubic, us, vs), jax.tree.map(linear, vs), linear(works)
