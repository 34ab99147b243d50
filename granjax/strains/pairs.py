"""Bonds listed one by one, on any graph."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import trailing
from ..base.checks import positive, refuse, whole
from ..base.types import Parameter, Site, Values
from .maps import BOTH, TwoEnds, checked_fields

# The site index that stands for a rigid wall.
WALL = -1


class Pairs(TwoEnds):
    """Bonds listed one by one, on any graph: e_b = u[tail_b] - u[head_b].

    **Arguments:** `tail`, `head`: site indices along the first axis, one of each per bond; -1 is a
    rigid wall. `sites`: number of sites, where the last ones have no bond (a pair for two fields).
    `fields`: as in `Shift`. `weights`: a pair of positive numbers or arrays over bonds
    (w_tail, w_head), e_b = w_tail u[tail] - w_head u[head], such as the cosine of a guide's angle;
    `None` for 1.

    **Shapes:** `u` (N,) to `e` (bonds,). **Raises** ValueError for indices that are not integers,
    lists of different length, an index outside the lattice, or a bond from a site to itself.

    **Example:**

    >>> star = gx.Pairs([0, 0, 0], [1, 2, 3])
    >>> star.strain(jnp.array([1.0, 0.0, 0.5, 2.0]))
    Array([ 1. ,  0.5, -1. ], dtype=float64)
    """

    dimensions = {"weights": (0, 0, 0)}
    weights: tuple[jax.Array, jax.Array] | None
    tail: tuple[int, ...] = eqx.field(static=True)
    head: tuple[int, ...] = eqx.field(static=True)
    sites: tuple[int, int] = eqx.field(static=True)
    fields: tuple[str, str] | None = eqx.field(static=True)

    def __init__(
        self,
        tail: Values,
        head: Values,
        *,
        sites: Site | None = None,
        fields: str | Sequence[str] | None = None,
        weights: tuple[Parameter, Parameter] | None = None,
    ):
        self.fields = checked_fields(fields)
        self.weights = (
            None
            if weights is None
            else tuple(positive(f"weights[{i}]", w) for i, w in enumerate(weights))
        )
        self.tail = _indices("tail", tail)
        self.head = _indices("head", head)
        if len(self.tail) != len(self.head):
            refuse("head", f"{len(self.tail)} indices, as many as tails", f"{len(self.head)}")
        within = self.fields is None or self.fields[0] == self.fields[1]
        if within and any(t == h for t, h in zip(self.tail, self.head)):
            refuse(
                "head", "another site than the tail", "the same", "A site has no bond to itself."
            )
        least = max(self.tail) + 1, max(self.head) + 1
        if within:
            least = (max(least),) * 2
        given = least if sites is None else tuple(sites) if np.ndim(sites) else (sites,) * 2
        given = tuple(whole("sites", g) for g in given)
        if any(g < n for g, n in zip(given, least)):
            refuse("sites", f"at least {max(least)}, the largest index and one", repr(sites))
        self.sites = given

    def _select(self, x, end):
        index = np.array((self.tail, self.head)[end])
        sites = self.sites[end]
        if x.shape[0] != sites:
            refuse(
                "sites",
                f"{x.shape[0]}, the lattice's number of sites",
                f"{sites}",
                "Give Pairs(..., sites=...).",
            )
        chosen = x[np.where(index == WALL, 0, index)]
        if (index == WALL).any():
            chosen = chosen * trailing((index != WALL).astype(x.dtype), x.ndim)
        return chosen

    def _weighted(self, x):
        ends = self.ends(x)
        if self.weights is None:
            return ends
        return tuple(end * trailing(w, end.ndim) for w, end in zip(self.weights, ends))

    @property
    def walls(self):
        return BOTH if WALL in self.tail + self.head else ()

    def _return(self, f, end):
        index = np.array((self.tail, self.head)[end])
        sites = self.sites[end]
        # The force on a wall goes to one extra site, which is then cut off.
        f = f if self.weights is None else f * trailing(self.weights[end], f.ndim)
        spread = jnp.zeros((sites + 1,) + f.shape[1:], f.dtype)
        return spread.at[np.where(index == WALL, sites, index)].add(f)[:sites]


def _indices(name, x):
    x = np.asarray(x)
    if x.ndim != 1 or x.size == 0 or x.dtype.kind not in "iu" or x.min() < WALL:
        refuse(name, "a list of site indices (-1 for a wall)", np.array2string(x, threshold=6))
    return tuple(int(i) for i in x)
