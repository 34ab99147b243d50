"""Words for the types of arguments, results and fields; where a shape is known, jaxtyping says it at its place.

Space comes first and lanes last: an array over sites has shape (N,), (N1, N2) or (N1, N2, d), and a batch of scenes
adds trailing axes. Every word holds for NumPy and JAX, traced or not, in float32 and float64.
"""

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias, runtime_checkable

import jax
import numpy as np
from jaxtyping import Bool, Complex, Float, Inexact, Integer, PyTree, Real

AnyArray: TypeAlias = jax.Array | np.ndarray
"""An array of NumPy or of JAX."""


@runtime_checkable
class _Column(Protocol):
    """What NumPy reads as an array, such as a `pandas.Series`."""

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray: ...


Values: TypeAlias = Sequence | AnyArray | _Column
"""Indices, labels or numbers one after the other: a list, an array, a column of a table."""

Scalar: TypeAlias = int | float | np.number | Real[AnyArray, ""]
"""One real number."""

Number: TypeAlias = int | float | np.number | Real[AnyArray, "..."]
"""A real number, or one per lane (*lanes)."""

Parameter: TypeAlias = Number | Sequence
"""A real number or an array over bonds or sites, then lanes; anything that broadcasts to them, lists too."""

Count: TypeAlias = int | np.integer
"""A whole number."""

Numbers: TypeAlias = Float[AnyArray, "..."]
"""An array of floating numbers, its shape said in the docstring."""

Counts: TypeAlias = Integer[AnyArray, "..."]
"""An array of whole numbers."""

Flags: TypeAlias = Bool[AnyArray, "..."] | bool | np.bool_
"""Whether, for one or for an array."""

ComplexNumbers: TypeAlias = Complex[AnyArray, "..."]
"""An array of complex numbers."""

Amplitudes: TypeAlias = Inexact[AnyArray, "..."]
"""An array of real or complex numbers, such as the amplitudes of a first-order lattice."""

Displacements: TypeAlias = Inexact[AnyArray, "..."] | dict[str, Inexact[AnyArray, "..."]]
"""Displacements, velocities or forces over the sites: an array, or a dict of arrays where a cell holds fields."""

Times: TypeAlias = Float[AnyArray, " times"]
"""Times (T,), increasing."""

Pytree: TypeAlias = PyTree
"""A tree of arrays: a state, tangents, parameters with names."""

Scene: TypeAlias = Callable[[Any], Any]
"""A function of parameters that returns a `Lattice`."""

Quantity: TypeAlias = Callable[[Any, Any, Any], Any]
"""A function (t, y, lattice) of time, state and lattice that returns an array."""

Waveform: TypeAlias = Callable[[Any], Any]
"""A function of time that returns a number, an array over sites, or a vector."""

VectorField: TypeAlias = Callable[[Any, Any, Any], Any]
"""The right-hand side f(t, y, args) of y' = f, in diffrax's form."""

StateLike: TypeAlias = tuple[Any, Any] | list[Any]
"""A `State(u, v)`, or a pair."""

Site: TypeAlias = Count | tuple[Count, ...] | list[Count]
"""Index of a site, negative from the end; on a grid one per axis."""

Cell: TypeAlias = Count | tuple[Count, ...] | None
"""Sites per unit cell, on a grid along each axis; `None` finds them."""

Seed: TypeAlias = Count | jax.Array
"""A whole number, or a key of `jax.random`."""
