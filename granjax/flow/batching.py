"""Runs under `jax.vmap`, with lanes last.

`jax.vmap` moves lanes to the front of every loop, which is up to three times slower than lanes that
come last. So a traced run has its own batching rule, which makes one lattice with lanes last. Runs
that are differentiated do not use it, since such a rule has no reverse mode.
"""

from functools import lru_cache

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap

from ..base.programs import joined, parted
from ..base.types import Scalar, StateLike
from ..lattice import Lattice, State, vector_field
from .integrate import Plan, integrate
from .run import TOO_MANY_STEPS, Found

# The bound on a traced run whose number of steps is not known. One that is not reached takes no time
# to run, but each factor of 64 is one more loop around the step in what a gradient compiles.
TRACED_STEPS = 2**24
# The number of lanes of the trial that shows whether a user's functions treat each lane separately.
TRIED = 3
# The agreement that this trial requires, relative and absolute.
AGREE = 1e-5


def batched(
    lattice: Lattice, state: StateLike, t0: Scalar, t1: Scalar, plan: Plan, *, own_step: bool
) -> Found:
    """Integrate as `integrate` does, with lanes last under `jax.vmap`.

    `own_step`: no step is given, so lanes may take that of the stiffest lane.
    """
    step = plan.step
    static, arrays = parted((lattice, state, plan.records))
    fixed, shared = parted((t0, t1, plan._replace(step=None, records={})))
    kinds = tuple((np.shape(x), np.dtype(x.dtype)) for x in arrays)

    def scenes(arrays, step, shared):
        lattice, state, records = joined(static, arrays)
        t0, t1, plan = joined(fixed, shared)
        return lattice, state, t0, t1, plan._replace(step=step, records=records)

    def plain(arrays, step, shared):
        return integrate(*scenes(arrays, step, shared))

    closed, shapes = jax.make_jaxpr(plain, return_shape=True)(arrays, step, shared)
    if any(isinstance(x, jax.core.Tracer) for x in closed.consts):
        # A function closes over traced values, of which a batching rule would not know.
        return plain(arrays, step, shared)
    everywhere = lambda own: jax.tree.map(lambda _: own, shapes)

    def lanes_last(size, over, arrays, step, shared):
        mapped, step_mapped, shared_mapped = over
        if not any(jax.tree.leaves(over)):
            # Only the tangents are mapped; this ends the recursion.
            return plain(arrays, step, shared), everywhere(False)
        alone = any(jax.tree.leaves(shared_mapped)) or step_mapped and not own_step
        if alone or not any(mapped) or not _keeps_lanes_apart(static, kinds):
            axes = jax.tree.map(lambda own: 0 if own else None, tuple(over))
            return jax.vmap(plain, in_axes=axes)(arrays, step, shared), everywhere(True)
        good = jnp.ones(size, bool)
        if step_mapped:
            t0, t1, _ = joined(fixed, shared)
            good = (t1 - t0) / step <= TRACED_STEPS
            step = jnp.min(jnp.where(good | ~jnp.any(good), step, jnp.inf))
        arrays = [_behind(x, own, size) for x, own in zip(arrays, mapped)]
        lattice, state, t0, t1, plan = scenes(arrays, step, shared)
        # Nothing is differentiated here.
        plan = plan._replace(adjoint=diffrax.ForwardMode())
        run = batched(lattice, state, t0, t1, plan, own_step=own_step)
        run = run._replace(code=jnp.where(good, run.code, TOO_MANY_STEPS))
        over = jax.tree.map(lambda x, one: jnp.ndim(x) > one.ndim, run, shapes)
        return jax.tree.map(lambda x, own: jnp.moveaxis(x, -1, 0) if own else x, run, over), over

    mapped = custom_vmap(plain)
    mapped.def_vmap(lanes_last)
    both = jax.custom_jvp(mapped)
    both.defjvp(lambda primals, tangents: jax.jvp(plain, primals, tangents))
    return both(arrays, step, shared)


def without_the_lost(run: Found) -> Found:
    """Set the numbers of lanes that did not complete to NaN, as tracing cannot raise."""
    lost = lambda tree: jax.tree.map(lambda x: jnp.where(run.completed, x, jnp.nan), tree)
    names = "us", "vs", "final", "recorded", "energy_error"
    return run._replace(**{name: lost(getattr(run, name)) for name in names})


def _behind(x, own, size):
    return (
        jnp.moveaxis(x, 0, -1)
        if own
        else jnp.broadcast_to(jnp.asarray(x)[..., None], (*jnp.shape(x), size))
    )


@lru_cache(maxsize=256)
def _keeps_lanes_apart(static, kinds):
    """Try whether forces and records treat each lane separately, on random lanes.

    A user's functions are written for one lattice, and may use an axis that holds the lanes here.
    """
    draw = np.random.default_rng(0)

    def values(arrays):
        lattice, state, records = joined(static, arrays)
        y = State(*state)
        t = jnp.asarray(0.37)
        return vector_field(t, y, lattice)[1], {
            name: record.value(t, y, lattice) for name, record in records.items()
        }

    @jax.jit
    def agree(arrays):
        each = jax.vmap(values, in_axes=-1, out_axes=-1)(arrays)
        close = lambda a, b: a.shape == b.shape and jnp.allclose(a, b, AGREE, AGREE, equal_nan=True)
        return jnp.all(jnp.array(jax.tree.leaves(jax.tree.map(close, values(arrays), each))))

    try:
        with jax.ensure_compile_time_eval():
            arrays = [
                jnp.asarray(draw.uniform(0.5, 1.5, (*shape, TRIED)), dtype)
                for shape, dtype in kinds
            ]
            return bool(agree(arrays))
    except Exception:
        return False
