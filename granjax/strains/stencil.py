"""Strain maps from slices: sites of fields at fixed offsets, each with a weight."""

import abc
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import padded
from ..base.checks import is_whole, one_of, parameter, refuse
from ..base.types import Site
from .maps import BOTH, BOUNDARIES, LinearMap, TwoEnds, checked_fields, get


class _Grid(LinearMap):
    boundary: eqx.AbstractVar[tuple[str, ...]]

    @property
    @abc.abstractmethod
    def _reaches(self) -> list[tuple[int, int]]:
        """The least and the largest offset, for every axis."""

    @property
    def span(self):
        return tuple(high - low for low, high in self._reaches)

    @property
    def walls(self):
        return BOTH if "fixed" in [b for b, n in zip(self.boundary, self.span) if n] else ()

    @property
    def axes(self):
        """Number of leading axes."""
        return len(self.boundary)

    def _moved(self, x, offset, back=False):
        """The sites at an offset from all bonds; `back`, the transpose, values at these sites."""
        for axis, (k, (low, high), b) in enumerate(zip(offset, self._reaches, self.boundary)):
            if b == "periodic":
                # As `padded` does.
                library = np if isinstance(x, np.ndarray) else jnp
                x = x if k == 0 else library.roll(x, k if back else -k, axis)
                continue
            # Sites at rest beyond the ends are added for the bonds and cut off on the way back;
            # between free ends it is the other way round.
            fixed = b == "fixed"
            ends = (high - k, k - low) if fixed else (k - low, high - k)
            x = (_cut if fixed == back else _pad)(x, axis, *ends)
        return x


def _cut(x, axis, low, high):
    return x[(slice(None),) * axis + (slice(low, x.shape[axis] - high),)] if low or high else x


def _pad(x, axis, low, high):
    return padded(x, low, high, axis) if low or high else x


def _offsets(offset):
    offsets = tuple(offset) if np.ndim(offset) else (offset,)
    if not offsets or not all(map(is_whole, offsets)):
        refuse("offset", "a whole number, or one per axis", repr(offset))
    return tuple(int(k) for k in offsets)


def _boundaries(boundary, axes):
    boundaries = tuple(boundary) if np.ndim(boundary) else (boundary,) * axes
    if len(boundaries) != axes:
        refuse("boundary", f"{axes} names, one per axis", repr(boundary))
    return tuple(one_of("boundary", b, BOUNDARIES) for b in boundaries)


class Shift(_Grid, TwoEnds):
    r"""Bonds between each site and the site `offset` further on: e_n = u_n - u_{n+offset}.

    **Arguments:**

    - `offset`: an integer, or a tuple with one per axis of the lattice; 0 only between two fields.
    - `boundary`: `"fixed"` (rigid walls; N + |offset| bonds), `"free"` (N - |offset|) or
      `"periodic"` (N); or a tuple, one per axis.
    - `fields`: name of the field, or the pair (tail, head), if a cell has several; `None` for a
      plain array.

    **Shapes:** `u` (N,) to `e` (N + 1,), (N - 1,) or (N,) for offset 1; trailing axes
    (vectors, lanes) are kept. **Raises** ValueError for an unknown boundary, an offset that is not
    an integer, or 0 within one field.

    **Example:**

    >>> gx.Shift(1, "fixed").strain(jnp.array([0.1, 0.3]))   # wall - bead - bead - wall
    Array([-0.1, -0.2,  0.3], dtype=float64)
    """

    dimensions = {}
    offset: tuple[int, ...] = eqx.field(static=True)
    boundary: tuple[str, ...] = eqx.field(static=True)
    fields: tuple[str, str] | None = eqx.field(static=True)

    def __init__(
        self,
        offset: Site = 1,
        boundary: str | Sequence[str] = "fixed",
        fields: str | Sequence[str] | None = None,
    ):
        self.offset = _offsets(offset)
        self.boundary = _boundaries(boundary, len(self.offset))
        self.fields = checked_fields(fields)
        if not any(self.offset) and (self.fields is None or self.fields[0] == self.fields[1]):
            refuse(
                "offset",
                "a step that is not zero within one field",
                repr(offset),
                "A site has no bond to itself.",
            )

    @property
    def _reaches(self):
        return [(min(k, 0), max(k, 0)) for k in self.offset]

    def _select(self, x, end):
        return self._moved(x, self.offset if end else (0,) * len(self.offset))

    def _return(self, f, end):
        return self._moved(f, self.offset if end else (0,) * len(self.offset), back=True)


class Stencil(_Grid):
    r"""Bonds over several sites and fields: e_n = sum over parts of weight * u_field[n + offset].

    Examples: `Shift`, with weights 1 and -1; shear with rotation u_n - u_{n+1} + R
    (theta_n + theta_{n+1}); the bend u_{n-1} - 2 u_n + u_{n+1}.

    **Arguments:**

    - `parts`: triples (field, offset, weight). `field`: a name, or `None` for a plain array;
      `offset`: an integer, or one per axis; `weight`: a number or an array over the bonds, which
      can be swept and differentiated. Fields are displacements: a rotation enters as a length
      (R theta), unless the scene has its own units.
    - `boundary`: as in `Shift`: `"fixed"` has every bond that touches a site, with sites at rest
      beyond the ends, `"free"` those within the lattice, `"periodic"` one per site.

    **Shapes:** `u` (N,) to `e` (N + k,), (N - k,) or (N,) for these boundaries, k = largest minus
    least offset. **Raises** ValueError for parts that are no such triples, offsets of different
    length, or no part.
    """

    dimensions = {"weights": (0, 0, 0)}
    weights: tuple[jax.Array, ...]
    fields: tuple[str | None, ...] = eqx.field(static=True)
    offsets: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    boundary: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, parts: Sequence, boundary: str | Sequence[str] = "fixed"):
        self.fields = tuple(field for field, _, _ in parts)
        self.offsets = tuple(_offsets(offset) for _, offset, _ in parts)
        if len({len(offset) for offset in self.offsets}) > 1:
            refuse("parts", "offsets of one length, a number per axis", repr(self.offsets))
        self.weights = tuple(parameter("weight", weight) for _, _, weight in parts)
        self.boundary = _boundaries(boundary, len(self.offsets[0]))

    @property
    def _reaches(self):
        return [(min(along), max(along)) for along in zip(*self.offsets)]

    def _sum(self, u, change):
        parts = [
            change(weight) * self._moved(get(u, field), offset)
            for field, offset, weight in zip(self.fields, self.offsets, self.weights)
        ]
        return sum(parts[1:], parts[0])

    def strain(self, u):
        return self._sum(u, lambda x: x)

    def reach(self, w):
        return self._sum(w, jnp.abs)

    def gather(self, f):
        total = {}
        for field, offset, weight in zip(self.fields, self.offsets, self.weights):
            part = self._moved(weight * f, offset, back=True)
            total[field] = total[field] + part if field in total else part
        return total[None] if None in total else total
