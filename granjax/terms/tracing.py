"""What a force reads, found by tracing it, and which displacements it does not resist, by trying."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr
from jax.flatten_util import ravel_pytree
from jax.interpreters.partial_eval import dce_jaxpr

from ..checks import traced as is_traced
from ..programs import concretely
from ..types import Displacements, Number, Pytree

SCALES = 10.0 ** np.arange(-12, 4)
RESISTS = 1e-9


class Dependence(NamedTuple):
    """What a force reads: `time`, `displacement`, `velocity`; and whether the term stores an `energy`.

    `transforms`: it holds an FFT, which XLA compiles for the CPU in some memory layouts only: no batches by `vmap`.
    """

    time: bool = False
    displacement: bool = False
    velocity: bool = False
    energy: bool = False
    transforms: bool = False

    @property
    def conserves(self):
        """Whether the term keeps the energy."""
        return self.energy and not self.time and not self.velocity


def traced(term: Any, lattice: Any):
    """(shapes of the force, `Dependence`) of a term on a lattice, found once for each structure."""
    return _used_by_force((term, time_of(lattice), lattice.template(), lattice.mass))


def reads(term: Any, lattice: Any) -> Dependence:
    """What the force of a term reads, found by tracing it."""
    return traced(term, lattice)[1]


def time_of(lattice: Any):
    """A time in the lattice's floating type, as a shape."""
    return jax.ShapeDtypeStruct((), lattice.dtype)


def _used_by_force(arguments):
    leaves, structure = jax.tree.flatten(arguments)
    key = tuple(_abstract(x) for x in leaves)
    try:
        return _traced_force(structure, key)
    except TypeError as error:
        if "unhashable" not in str(error):
            raise
        return _traced_force.__wrapped__(structure, key)


@lru_cache(maxsize=1024)
def _traced_force(structure, leaves):
    term, t, u, mass = jax.tree.unflatten(structure, leaves)

    def force(term, t, u, v, mass):
        return term.force(t, u, v, mass)

    shapes, transforms, time, displacement, velocity = used(force, (term, t, u, u, mass), (1, 2, 3))
    stores = _shapes(lambda term, t, u: term.energy(t, u), (term, t, u)) is not None
    return shapes, Dependence(time, displacement, velocity, stores, transforms)


def used(function: Callable, arguments: tuple, places: tuple = (1,)):
    """(shapes of the result, whether an FFT is in it, whether it depends on each of the arguments at some places)."""
    arguments = jax.tree.map(_abstract, arguments)
    dynamic, static = eqx.partition(arguments, _is_shape)
    closed, shapes = jax.make_jaxpr(
        lambda dynamic: function(*eqx.combine(dynamic, static)), return_shape=True
    )(dynamic)
    _, used = dce_jaxpr(closed.jaxpr, [True] * len(closed.out_avals))
    used = jax.tree.unflatten(jax.tree.structure(dynamic), used)
    return (
        shapes,
        _holds(closed.jaxpr, "fft"),
        *(any(jax.tree.leaves(used[place])) for place in places),
    )


def _holds(jaxpr, primitive):
    """Whether a traced program holds an operation, in whatever it calls too."""
    parameters = jax.tree.leaves([list(eqn.params.values()) for eqn in jaxpr.eqns])
    inner = [getattr(x, "jaxpr", x) for x in parameters if isinstance(x, (ClosedJaxpr, Jaxpr))]
    return any(eqn.primitive.name == primitive for eqn in jaxpr.eqns) or any(
        _holds(part, primitive) for part in inner
    )


def _shapes(function, arguments):
    dynamic, static = eqx.partition(arguments, _is_shape)
    return jax.eval_shape(lambda dynamic: function(*eqx.combine(dynamic, static)), dynamic)


def _is_shape(x):
    return isinstance(x, jax.ShapeDtypeStruct)


def _abstract(x):
    if isinstance(x, (jax.Array, np.ndarray, np.generic, jax.ShapeDtypeStruct)):
        return jax.ShapeDtypeStruct(x.shape, x.dtype)
    return x


def stand_in(x: Number):
    """The value, or ones in its place where it is traced."""
    x = jax.lax.stop_gradient(x) if is_traced(x) else x
    return np.ones(x.shape, x.dtype) if is_traced(x) else x


def answers_to(moves: list, term: Any, mass: Displacements | Number, template: Pytree):
    """dF/du along some displacements, (scales, n, moves), each relative to the answer to a random one."""
    random = np.random.default_rng(0)
    where, other = (
        jax.tree.map(lambda s: random.normal(size=s.shape).astype(s.dtype), template)
        for _ in range(2)
    )
    fixed = moves, term, mass, where, other
    return np.stack([concretely(_answers, *fixed, np.asarray(scale)) for scale in SCALES])


@eqx.filter_jit
def _answers(moves, term, mass, where, other, scale):
    zeros = jax.tree.map(jnp.zeros_like, where)

    def push(u):
        return _raveled(term.force(jnp.zeros(()), u, zeros, mass), zeros)

    slope = jax.linearize(push, jax.tree.map(lambda x: scale.astype(x.dtype) * x, where))[1]
    size = jnp.max(jnp.abs(slope(other)))
    columns = jnp.stack([slope(move) for move in moves], -1) / jnp.where(size > 0, size, 1)
    good = jnp.isfinite(size) & jnp.all(jnp.isfinite(columns))
    least = max(RESISTS, 1e3 * float(jnp.finfo(columns.dtype).eps))
    return jnp.where(good & (jnp.abs(columns) > least), columns, 0)


def _raveled(force, zeros):
    """A force as one array, with zeros for the fields that it does not touch."""
    if isinstance(zeros, dict):
        force = {name: force.get(name, zero) for name, zero in zeros.items()}
    return ravel_pytree(jax.tree.map(lambda f, u: jnp.broadcast_to(f, u.shape), force, zeros))[0]
