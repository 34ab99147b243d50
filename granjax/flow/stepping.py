"""The map of a state over a time by a fixed number of steps, with its tangents.

Periodic orbits and Floquet theory use it.
"""

from numbers import Number
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..base.arrays import padded
from ..base.checks import refuse, traced, whole
from ..base.printing import told
from ..base.programs import compiled, parted
from ..base.types import Count, Counts, Numbers, Pytree, Scalar, VectorField
from ..lattice import Lattice, vector_field
from ..lattice.model import check_shape
from ..solvers import AbstractNystrom, AbstractSplitting, SRKN14a
from ..solvers.split_system import pair
from .control import OneSided, both_modes, shared_out
from .steps import refuse_unresolved

# The most numbers in a vector register: rows of tangents that are a multiple of it are up to 1.2
# times faster.
VECTOR = 8


class Flow(eqx.Module):
    r"""The flow phi(y; t0, t1, args) of y' = f(t, y, args), by a fixed number of equal steps.

    Steps and method do not depend on the state, so the derivative is that of a smooth map; with a
    symplectic solver the map is symplectic. Tangents are carried beside the state in a trailing
    axis: D phi times many vectors at once.

    **Arguments:** `steps`: the number from t0 to t1; a whole number, or an array, whose value
    compiles nothing anew but has no reverse mode. `solver`: any of granjax or diffrax, used at a
    fixed step. `field`: f(t, y, args), by default that of a lattice, with the lattice as `args` and
    `State(u, v)` as y. Where its forces jump in time, at `Breaks`, the stretches between share the
    steps.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> state = gx.Flow(100)(gx.states.impact(chain, velocity=0.1), 0.0, 5.0, chain)
    >>> round(float(gx.measures.energy(chain, state)), 6)
    0.005
    """

    steps: Count | Counts
    solver: diffrax.AbstractSolver = SRKN14a()
    field: VectorField = eqx.field(static=True, default=vector_field)
    __repr__ = told

    def __check_init__(self):
        if np.ndim(self.steps) == 0:
            check_steps(self.steps)

    def __call__(self, y: Pytree, t0: Scalar, t1: Scalar, args: Any) -> Pytree:
        """Return the state at t1 from `y` at t0, of the lattice's shape where a lattice moves."""
        check_moved("y", y, self, args)
        return _run(self.solver, self.field, self.steps, y, t0, t1, args)

    def tangents(self, y: Pytree, tangents: Pytree, t0: Scalar, t1: Scalar, args: Any) -> tuple:
        """Return (phi(y), D phi(y) tangents); `tangents` is like `y` with a trailing axis."""
        check_moved("y", y, self, args)
        shapes, own = ([np.shape(x) for x in jax.tree.leaves(tree)] for tree in (tangents, y))
        if len(shapes) != len(own) or any(x[:-1] != a or x == a for x, a in zip(shapes, own)):
            refuse(
                "tangents",
                f"arrays of the shapes {own} and a trailing axis each",
                f"shapes {shapes}",
            )
        count = shapes[0][-1]
        idle = -count % VECTOR if count > VECTOR else 0
        tangents = jax.tree.map(lambda x: padded(x, 0, idle, -1), tangents)
        end, moved = _run(self.solver, self.field, self.steps, y, t0, t1, args, tangents)
        return end, jax.tree.map(lambda x: x[..., :count], moved)

    def derivative(self, y: Pytree, t0: Scalar, t1: Scalar, args: Any) -> tuple:
        """Return (phi(y), D phi(y)), with the derivative as a matrix over the raveled state."""
        flat, unravel = ravel_pytree(_floating(y))
        if jnp.iscomplexobj(flat):
            refuse(
                "y",
                "a real state",
                "a complex one",
                "The derivative is not a complex matrix: give `tangents` along 1 and 1j.",
            )
        unit = jax.vmap(unravel, out_axes=-1)(jnp.eye(flat.size, dtype=flat.dtype))
        end, tangents = self.tangents(y, unit, t0, t1, args)
        return end, matrix(tangents)


def check_steps(steps: Count | Counts) -> None:
    """Refuse a known value that is not a number of steps."""
    if not traced(steps):
        whole("steps", np.asarray(steps)[()], 1)


def check_moved(argument: str, y: Any, flow: Flow, args: Any) -> None:
    """Refuse a `y` that is not a state of the lattice `args`, where a lattice moves."""
    if flow.field is not vector_field:
        if isinstance(flow.solver, (AbstractSplitting, AbstractNystrom)) and not _is_pair(y):
            refuse(
                "solver",
                "a solver of first-order equations, since the state is not a pair (u, v)",
                type(flow.solver).__name__,
                "Take diffrax.Dopri8(), or gx.first_order.SplitStep() for DNLS.",
            )
        return
    for name, x in zip(("u", "v"), y):
        check_shape(args, f"{argument}.{name}", x)


def matrix(tangents: Pytree) -> Numbers:
    """Return tangents as the columns of a matrix, with rows raveled as a state is."""
    return jnp.concatenate([x.reshape(-1, x.shape[-1]) for x in jax.tree.leaves(tangents)])


def columns(like: Pytree, vectors: Numbers) -> Pytree:
    """Return columns (n, m) as tangents of a state, the inverse of `matrix`."""
    _, unravel = ravel_pytree(like)
    return jax.vmap(unravel, in_axes=-1, out_axes=-1)(vectors)


def _run(solver, field, steps, y, t0, t1, args, tangents=None):
    # `_marched` within a program that is being traced; else a program of its own, compiled once.
    y = _floating(y)
    if not traced((steps, t0, t1)):
        refuse_unresolved(t0, t1, float(np.min(abs(t1 - t0) / np.asarray(steps))), _of_times(y))
    fixed = solver, field, args
    if not traced((steps, y, t0, t1, args, tangents)) and all(map(_stays, jax.tree.leaves(fixed))):
        # Plain numbers become inputs of the compiled program, so that other numbers do not compile
        # anew.
        t0, t1, numbers = jax.tree.map(
            lambda x: jnp.asarray(x) if type(x) in (int, float, complex) else x, (t0, t1, args)
        )
        try:
            hash(parted(fixed)[0])
            return _by_itself(solver, field, steps, y, t0, t1, numbers, tangents)
        except (
            TypeError
        ):  # Arguments without a hash, or a field that needs the value of a number: `range(args)`.
            pass
    return _marched(solver, field, steps, y, t0, t1, args, tangents)


def _floating(y):
    # Whole numbers become floating ones, as steps are not whole numbers.
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.result_type(x, float)), y)


def _of_times(y):
    # Return the floating type of times, which are real where a state is complex.
    return jnp.finfo(jnp.result_type(*jax.tree.leaves(y))).dtype


def _stays(leaf):
    # Whether a program may keep the object, or take it as an input: any other object may change
    # while JAX takes it for the same.
    return (
        leaf is None
        or isinstance(leaf, (jax.Array, np.ndarray, np.generic, Number, str))
        or callable(leaf)
    )


def _marched(solver, field, steps, y, t0, t1, args, tangents):
    # A field without breaks does not declare any.
    breaks = getattr(field, "breaks", lambda args: ())(args)
    args = args.for_run() if isinstance(args, Lattice) else args
    if tangents is None:
        return _march(solver, field, steps, y, t0, t1, args, breaks)
    return _part(
        y, _march(solver, _variational(field, y), steps, _join(y, tangents), t0, t1, args, breaks)
    )


_by_itself = compiled(_marched)


def _march(solver, field, steps, y, t0, t1, args, breaks):
    # Equal steps, or as many that end at breaks. Time runs forwards in `t * sign`.
    terms = diffrax.ODETerm(field)
    flat = _of_times(y)
    solver = both_modes(solver)
    solver = OneSided(solver) if breaks else solver
    t0, t1, h = (jnp.asarray(x, flat) for x in (t0, t1, (t1 - t0) / steps))
    sign = jnp.where(t1 < t0, -1, 1).astype(flat)

    def step(i, carry):
        y, t, state = carry
        if breaks:
            left = (steps - i).astype(flat)
            end = shared_out(breaks, t * sign, left, t1 * sign, sign).astype(flat) * sign
        else:
            # Adding h each time would accumulate its rounding.
            end = t0 + (i + 1) * h
        y, _, _, state, _ = solver.step(terms, t, end, y, args, state, False)
        return y, end, state

    begin = y, t0, solver.init(terms, t0, t0 + h, y, args)
    return jax.lax.fori_loop(0, steps, step, begin)[0]


def _is_pair(y):
    return isinstance(y, tuple) and len(y) == 2


def _join(y, tangents):
    # Tangents join positions and velocities, so that methods for (u, v) apply. Other states stay as
    # they are.
    return ((y[0], tangents[0]), (y[1], tangents[1])) if _is_pair(y) else (y, tangents)


def _part(like, ends):
    if not _is_pair(like):
        return ends
    (u, U), (v, V) = ends
    return pair(like, u, v), pair(like, U, V)


def _variational(field, like):
    # The field's own variational equation, or one by `jax.jvp`.
    own = getattr(field, "variational", None)
    if own is not None:
        return own

    def extended(t, joined, args):
        y, tangents = _part(like, joined)
        f = lambda y: field(t, y, args)
        slopes = jax.vmap(lambda dy: jax.jvp(f, (y,), (dy,))[1], in_axes=-1, out_axes=-1)(tangents)
        return _join(f(y), slopes)

    return extended
