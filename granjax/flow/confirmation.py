"""The errors of records: a run again, by finer steps."""

import pickle
from functools import partial
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import refuse, traced
from ..lattice import vector_field
from ..programs import joined, parted
from ..types import Flags
from .batching import batched
from .control import tighter
from .march import march

# a run with records is confirmed by a tolerance so many times smaller; or by steps so many times shorter, the second
# one where contacts opened, as errors of order 5/2 that come and go with the mesh may be alike twice
TIGHTER = 100
SHORTER = 2, 4
# the part of the largest gap over a record's entries that every entry's error has at least: gaps may vanish by chance
SHARED = 0.1


class Confirmation(eqx.Module):
    """What it takes to run again by finer steps, and the error of records that follows.

    The error is the gap between both runs, taken on to vanishing steps for the solver's order (2 at most, as contacts
    that open leave little more), doubled, and a tenth of the largest gap over the entries, and rounding. It covers
    the run's own error, that of the dense output, and that of the record.
    """

    arrays: list
    static: tuple = eqx.field(static=True)
    shapes: tuple = eqx.field(static=True)

    @classmethod
    def of(cls, *arguments: Any) -> Any:
        """From lattice, state, t0, t1, dt, tolerance, records and solver of `integrate`."""
        static, arrays = parted(arguments)
        return cls(arrays, static, tuple(np.shape(x) for x in arrays))

    def __reduce__(self):
        # a structure of JAX's does not come back the same; what holds a lambda leaves no confirmation behind
        arguments = joined(self.static, self.arrays)
        try:
            pickle.dumps(arguments)
        except (pickle.PicklingError, AttributeError, TypeError):
            return type(None), ()
        return _restored, (arguments, self.shapes)

    @property
    def tells(self):
        """Whether lanes of `jax.vmap`, if any, stand in front."""
        mapped = np.ndim(self.arrays[0]) - len(self.shapes[0])
        return all(np.shape(x)[mapped:] == shape for x, shape in zip(self.arrays, self.shapes))

    def errors(self, recorded: dict, short: dict, completed: Flags, opened: Flags) -> dict:
        """The error of each record, of its shape; infinite where a run did not complete. `opened`: any contact."""
        function, mapped = self._errors, np.ndim(self.arrays[0]) - len(self.shapes[0])
        if not self.tells:
            remedy = "Read it inside of the function that is mapped."
            refuse(
                "record_error",
                "a run by itself, or many behind jax.vmap with out_axes=0",
                "another one",
                remedy,
            )
        for _ in range(mapped):
            function = jax.vmap(function)
        return function(*jax.lax.stop_gradient((self.arrays, recorded, short, completed, opened)))

    def _errors(self, arrays, recorded, short, completed, opened):
        lattice, state, t0, t1, dt, tolerance, records, solver = joined(self.static, arrays)
        if dt is not None:
            dt = dt / jnp.where(jnp.any(opened), *SHORTER[::-1]).astype(dt.dtype)
        tolerance = None if tolerance is None else tighter(tolerance, TIGHTER, lattice.dtype)
        rest = solver, diffrax.ForwardMode(), None, False, False, False, False
        go = partial(batched, own_step=False) if traced((arrays, opened)) else march
        finer = go(lattice, state, t0, t1, dt, tolerance, None, records, *rest)
        order, lanes = min(solver.order(diffrax.ODETerm(vector_field)), 2), len(lattice.lanes)
        good = completed & finer.completed
        error = partial(_error, 2 / (1 - 0.5**order), lanes, good)
        return {
            name: jax.tree.map(
                error, recorded[name], finer.recorded[name], short[name], finer._short[name]
            )
            for name in recorded
        }


def _restored(arguments, shapes):
    static, arrays = parted(arguments)
    return Confirmation(arrays, static, shapes)


def _error(factor, lanes, good, x, finer, short, finer_short):
    gap = jnp.abs(x - finer)
    known = jnp.where(jnp.isfinite(gap), gap, 0)
    largest = jnp.max(known, axis=tuple(range(max(x.ndim - lanes, 0))), keepdims=True, initial=0)
    rounding = 8 * jnp.finfo(x.dtype).eps * jnp.where(jnp.isnan(x), 0, jnp.abs(x))
    error = factor * known + SHARED * largest + rounding
    error = jnp.where(jnp.isfinite(gap) & good, error, jnp.inf)
    # what both runs never saw arrive, and by more than they are known to, has no time that could be wrong
    missed = finer_short > factor * jnp.abs(short - finer_short)
    return jnp.where(jnp.isnan(x) & jnp.isnan(finer) & good & missed, jnp.nan, error)
