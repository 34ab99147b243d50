"""Names of the types of arguments, results and fields.

Where the shape is known, jaxtyping states it in place. Space comes first and lanes last: an array
over sites has shape (N,), (N1, N2) or (N1, N2, d), and a batch of lattices adds trailing axes. All
names hold for NumPy and JAX, traced or not, in float32 and float64.
"""

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias, runtime_checkable

import jax
import numpy as np
from jaxtyping import Bool, Complex, Float, Inexact, Integer, PyTree, Real

AnyArray: TypeAlias = jax.Array | np.ndarray
"""An array of NumPy or JAX."""


@runtime_checkable
class _Column(Protocol):
    """What NumPy can read as an array, such as a `pandas.Series`."""

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray: ...


Values: TypeAlias = Sequence | AnyArray | _Column
"""A sequence of indices, labels or numbers: a list, an array, a column of a table."""

Scalar: TypeAlias = int | float | np.number | Real[AnyArray, ""]
"""One real number."""

Number: TypeAlias = int | float | np.number | Real[AnyArray, "..."]
"""A real number, or one per lane, of shape (*lanes)."""

Parameter: TypeAlias = Number | Sequence
"""A real number, or an array or list that broadcasts to the bonds or sites, then lanes."""

Count: TypeAlias = int | np.integer
"""A whole number."""

Numbers: TypeAlias = Float[AnyArray, "..."]
"""An array of floating numbers, whose shape the docstring states."""

Counts: TypeAlias = Integer[AnyArray, "..."]
"""An array of whole numbers."""

Flags: TypeAlias = Bool[AnyArray, "..."] | bool | np.bool_
"""A truth value, or an array of them."""

ComplexNumbers: TypeAlias = Complex[AnyArray, "..."]
"""An array of complex numbers."""

Amplitudes: TypeAlias = Inexact[AnyArray, "..."]
"""An array of real or complex numbers, such as the amplitudes of a first-order lattice."""

Displacements: TypeAlias = Inexact[AnyArray, "..."] | dict[str, Inexact[AnyArray, "..."]]
"""Displacements, velocities or forces of the sites: an array, or a dict of one per field."""

Times: TypeAlias = Float[AnyArray, " times"]
"""Times (T,), increasing."""

Along: TypeAlias = Float[np.ndarray, " point"]
"""One number per point of a branch, (P,)."""

Pytree: TypeAlias = PyTree
"""A tree of arrays: a state, tangents, named parameters."""

Scene: TypeAlias = Callable[[Any], Any]
"""A function of parameters that returns a `Lattice`."""

Quantity: TypeAlias = Callable[[Any, Any, Any], Any]
"""A function (t, y, lattice) of time, state and lattice that returns an array."""

Response: TypeAlias = Callable[[Any, Any, Any, Any], Any]
"""A function (lattice, u, v, t) of a history that returns one number."""

Waveform: TypeAlias = Callable[[Any], Any]
"""A function of time that returns a number, an array over sites, or a vector."""

VectorField: TypeAlias = Callable[[Any, Any, Any], Any]
"""The right-hand side f(t, y, args) of y' = f, in diffrax's form."""

StateLike: TypeAlias = tuple[Any, Any] | list[Any]
"""A `State(u, v)`, or a pair."""

Site: TypeAlias = Count | tuple[Count, ...] | list[Count]
"""The index of a site, negative from the end; on a grid one per axis."""

Cell: TypeAlias = Count | tuple[Count, ...] | None
"""The number of sites per unit cell, on a grid along each axis; `None` determines it."""

Seed: TypeAlias = Count | jax.Array
"""A whole number or a key of `jax.random`."""
