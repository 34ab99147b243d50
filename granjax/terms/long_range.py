"""Bonds to many neighbours of a chain, summed by FFT: magnets, algebraic and fractional kernels."""

import math
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ..base.arrays import padded, trailing
from ..base.checks import one_of, parameter, refuse, whole
from ..base.programs import by_rows
from ..base.types import Count, Parameter
from ..base.units import PART
from ..laws import Law, Scaled, Strained
from ..strains import BOTH, BOUNDARIES, Shift
from .base import Compression, Term, get, put, wider
from .reach import steepest

# Number of offsets up to which a sum over neighbours costs less than two transforms.
FEW = 8
TAKES = ("displacement", "strain")


class LongRange(Term):
    r"""Bonds from each site of a chain to its first M neighbours: one law, weighted by offset.

    Force on site n: -sum_m [c_m F(u_n - u_{n+m}) - c_m F(u_{n-m} - u_n)], m = 1 ... M. With
    `takes="strain"` the law takes the compression per spacing, F(e/m), as for magnets that all
    repel each other: A (m d - e)^p = A m^p (d - e/m)^p, the kernel m^p and the law of neighbours.

    Polynomial laws (`Linear`, `Polynomial`) cost a few FFTs, whatever M: (u_n - u_j)^k is expanded
    by the binomial theorem. A run transforms the kernel once (`for_run`). At 1e5 sites one force
    evaluation takes about 7 times that of linear springs to next neighbours, 5 times that of Hertz
    contacts (22, 3.3, 4.2 ns per site, processor time). The rounding error is about 1e-16 sum_m c_m
    (2 max |u|)^k, with u measured from its mean. Other laws, and kernels of at most 8 offsets, are
    summed bond by bond.

    **Arguments:**

    - `kernel`: c_m (M,), dimensionless, of any sign, for the offsets 1 to M; it may be longer than
      the chain. Typical: 1/m^2 ... 1/m^5.
    - `law`: one for all bonds.
    - `boundary`: `"free"` (only bonds within the chain), `"fixed"` (the chain continues at rest
      beyond its ends, as far as the kernel reaches), `"periodic"` (every offset goes around the
      ring, several times for large M, as in an infinite chain with periodic motion).
    - `takes`: "displacement" or "strain". `field`: as in `OnSite`.
    - `beyond`: number of sites at rest beyond each end of a fixed chain, `None` for the kernel's
      range; 1 for magnets between two held ones.
    - `rest`: displacements (N,) from which `u` and forces are measured, or `None`.

    If the law has a preload, a free chain, or one with few sites beyond, rests at u = 0 only under
    loads on its sites (`Lattice.unbalanced`); `gx.equilibrium` finds `rest` without them.
    **Raises** ValueError for a kernel that is no row of numbers, a law with separate parameters for
    each bond, and a lattice that is no chain. Source: Flach, Phys. Rev. E 58, R4116 (1998); Chong
    et al., Phys. Rev. Lett. 131, 117201.
    """

    dimensions = {"kernel": (0, 0, 0), "law": PART, "rest": (0, 1, 0)}
    per_site: ClassVar[bool] = True
    kernel: jax.Array
    law: Law
    rest: jax.Array | None
    boundary: str = eqx.field(static=True)
    takes: str = eqx.field(static=True)
    field: str | None = eqx.field(static=True)
    beyond: int | None = eqx.field(static=True)
    _kept: "_Kept | None"

    def __init__(
        self,
        kernel: Parameter,
        law: Law,
        boundary: str = "fixed",
        *,
        takes: str = "displacement",
        field: str | None = None,
        beyond: Count | None = None,
        rest: Parameter | None = None,
    ):
        self.kernel = parameter("kernel", kernel)
        self.law = law
        self.field = field
        self._kept = None
        self.beyond = (
            None if beyond is None else whole("beyond", beyond, 1, "Without any the chain is free.")
        )
        self.rest = None if rest is None else parameter("rest", rest)
        if self.kernel.ndim != 1 or not self.kernel.size:
            refuse(
                "kernel",
                "a row of weights, one for each offset from 1 on",
                f"shape {self.kernel.shape}",
            )
        self.boundary = one_of("boundary", boundary, BOUNDARIES)
        self.takes = one_of("takes", takes, TAKES)

    def check(self, name, lattice):
        if lattice.axes != 1:
            refuse(
                name,
                "a chain",
                f"a lattice with {lattice.axes} axes",
                "Write a term of your own for a grid.",
            )
        if any(jnp.ndim(x) > len(lattice.lanes) for x in jax.tree.leaves(self.law)):
            refuse(name, "a law with single numbers, the same for all bonds", "one with arrays")

    def resists(self, lattice, moves):
        if self.boundary != "fixed":
            return np.zeros((0, len(moves)))
        return np.stack([np.ravel(get(move, self.field)) for move in moves], -1)

    @property
    def span(self):
        """The coupling range along the chain."""
        return (self.kernel.shape[0],)

    @property
    def walls(self):
        """The ends that are tied to sites at rest."""
        return BOTH if self.boundary == "fixed" else ()

    def nearest(self) -> Law:
        """Return the law of the bonds to the next site at rest."""
        law = self.law if self.rest is None else Strained(self.law, self._strains(self.rest))
        return Scaled(law, self.kernel[:1])

    def _strains(self, x):
        return Shift(1, self.boundary).strain(x)

    @property
    def _beyond(self):
        if self.boundary == "fixed":
            return self.kernel.shape[0] if self.beyond is None else self.beyond
        return 0 if self.boundary == "free" else None

    @property
    def _powers(self):
        return None if self.kernel.shape[0] <= FEW else self.law.powers

    def force(self, t, u, v, mass):
        x = get(u, self.field)
        if self.rest is None:
            return put(self._sums(x).force(), self.field)
        rest = self._at_rest(x)
        held = self._sums(rest).force() if self._kept is None else _spread(self._kept.held, x)
        return put(self._sums(rest + x).force() - held, self.field)

    def for_run(self, lattice: Any) -> Any:
        """Return the term with the transforms of its kernel and its forces at rest computed."""
        x = get(lattice.zeros(), self.field)
        weights = {} if self._powers is None else self._sums(x).known()
        held = None if self.rest is None else self._sums(self._at_rest(x)).force()
        return eqx.tree_at(
            lambda x: x._kept, self, _Kept(weights, held), is_leaf=lambda x: x is None
        )

    def energy(self, t, u):
        x = get(u, self.field)
        if self.rest is None:
            return put(self._sums(x).energy(), self.field)
        rest = self._at_rest(x)
        held, work = jax.jvp(lambda x: self._sums(x).energy(), (rest,), (x,))
        return put(self._sums(rest + x).energy() - held - work, self.field)

    def _at_rest(self, x):
        return _spread(self.rest, x)

    def _sums(self, x):
        law = self._law(x)
        if self._powers is None:
            return _Bonds(law, x, self._beyond)
        weights = {} if self._kept is None else self._kept.weights
        return _Powers(law.powers, x, self._beyond, weights)

    def _law(self, x):
        beyond = self._beyond
        c = self.kernel if beyond is None else self.kernel[: x.shape[0] - 1 + beyond]
        c = trailing(c, x.ndim)
        return Scaled(self.law, c, _offsets(c) if self.takes == "strain" else None)

    def preload_force(self, u):
        x = get(u, self.field)
        right, left = _bonds_within(self._law(x).factor, x.shape[0], self._beyond)
        force = jnp.broadcast_to(self.law.preload * (left - right), x.shape).astype(x.dtype)
        if self.rest is not None:
            force = force + self._sums(self._at_rest(x)).force()
        return put(force, self.field)

    def compressions(self, t, u):
        """Return the compressions of next neighbours."""
        law = self.nearest()
        x = get(u, self.field)
        law = Scaled(law.law, trailing(law.factor, x.ndim))
        return (Compression(law, self._strains(x)),)

    def linearised(self, lattice, t, u, v):
        x = get(u, self.field)
        about = x if self.rest is None else self._at_rest(x) + x
        return LongRangeTangent(wider(self), about[..., None])

    def stiffness_bound(self, lattice, reach, factor=1.0):
        if self.rest is not None and self.takes != "strain" and not self.law.is_linear:
            return super().stiffness_bound(lattice, reach, factor)
        law = self._law(get(lattice.zeros(), self.field))
        law = Scaled(self.law, jnp.abs(law.factor), law.length)
        k = jnp.abs(self._steepest(law, reach) * factor)

        def bound(w):
            x = get(w, self.field)
            own = trailing(k, x.ndim)
            springs = _Powers({1: own}, x, self._beyond, {})
            # The springs' force is the push of the neighbours minus the part that holds the site.
            pushed = springs.force() + springs.held(1, self._beyond) * x
            return put(2 * own.sum(0) * x + pushed, self.field)

        return bound

    def _steepest(self, law, reach):
        c = law.factor
        if self.takes == "strain":
            # e/m is the mean of m adjacent compressions, so it does not exceed the largest of them.
            first = jnp.where(c[:1] > 0, c[:1], 1)
            k = reach.stiffest(Scaled(self.nearest().law, first), 0)
            return jnp.max(k, 0, keepdims=True) / first * c / law.length
        if reach.seen is None:
            return reach.stiffest(law, 0)
        low, high = reach.ends(law, 0)
        return steepest(law, jnp.min(low, 0) * _offsets(c), jnp.max(high, 0) * _offsets(c))


class LongRangeTangent(Term):
    """The linear springs of a `LongRange` term at displacements `about`, tangents last."""

    dimensions = {"term": PART, "about": (0, 1, 0)}
    term: LongRange
    about: jax.Array

    def force(self, t, u, v, mass):
        return put(self.term._sums(self.about).slope(get(u, self.term.field)), self.term.field)


class _Bonds(NamedTuple):
    law: Scaled
    x: jax.Array
    beyond: int | None

    def force(self):
        return self._sum(lambda law, e, own: law.force(e), jnp.subtract)

    def slope(self, w):
        return self._sum(lambda law, e, own: law.derivative(e) * own, jnp.subtract, w)

    def energy(self):
        """Each end gets half of a bond's energy, or all if the other end is beyond the chain."""
        return self._sum(lambda law, e, own: law.energy(e), jnp.add, halves=True)

    def _sum(self, bond, joined, w=None, halves=False):
        # Evaluate each bond once, at column k + count for a left end at k, and sum at sites.
        n = self.x.shape[0]
        count = self.law.factor.shape[0]
        mode = "wrap" if self.beyond is None else "constant"
        arrays = (self.x,) if w is None else (self.x, w)
        wide = [padded(x, count, count, mode=mode) for x in arrays]
        size = n + count
        k = trailing(np.arange(-count, n), self.x.ndim)
        ends = self.beyond is not None and self.beyond < count

        def add(total, part):
            offset, scale = part
            es = [far[:size] - jax.lax.dynamic_slice_in_dim(far, offset, size) for far in wide]
            there = (k >= -self.beyond) & (k + offset < n + self.beyond) if ends else True
            es = [jnp.where(there, e, 0) if ends else e for e in es]
            value = bond(Scaled(self.law.law, *scale), es[0], es[-1])
            value = jnp.where(there, value, 0) if ends else value
            shared = (self.beyond is None) | (k >= 0) & (k + offset < n)
            value = jnp.where(shared, value / 2, value) if halves else value
            left = jax.lax.dynamic_slice_in_dim(value, count - offset, n)
            return total + joined(left, value[count:]), None

        bonds = np.arange(1, count + 1), (self.law.factor, self.law.length)
        start = jnp.zeros_like(arrays[-1], jnp.result_type(arrays[-1], *jax.tree.leaves(self.law)))
        return jax.lax.scan(add, start, bonds)[0]


class _Kept(NamedTuple):
    """Precomputed for a run: `weights`, as `_Powers.known`, and the forces at rest."""

    weights: dict
    held: jax.Array | None


class _Powers(NamedTuple):
    """The same sums as `_Bonds` for a polynomial law with coefficients c (M, lanes...), by FFT.

    The sum over j of s_j c_j (x_n - x_j)^p, s_j = -1 for even k where j < n, expands into terms
    x_n^a times sums over all neighbours of x_j^b, a + b = p: one transform of each x^b, and one
    back for each x^a.
    """

    powers: dict
    x: jax.Array
    beyond: int | None
    weights: dict

    @property
    def turn(self):
        """Factors w^j, w^L = i, by which what the transforms of a chain wrap around is imaginary.

        Real transforms would need twice the length.
        """
        length = scipy.fft.next_fast_len(len(self.x))
        turn = np.exp(0.5j * np.pi * np.arange(length) / length)
        return turn.astype(jnp.result_type(self.x.dtype, np.complex64))

    def known(self):
        """{k: the transform of the weights of e^k, and their sums over the bonds of each site}."""
        return self.weights or {
            k: (self._spectrum(k, c), self.held(k, self.beyond)) for k, c in self.powers.items()
        }

    def _spectrum(self, k, c):
        # The real and the imaginary part.
        size = len(self.x)
        around = self.beyond is None
        after = folded(c, size) if around else folded(c[: size - 1], len(self.turn))
        before = jnp.roll(after[::-1], 1, 0)
        found = self._forth(-((-1) ** k) * after + (1 if around else -1j) * before)
        return found.real, found.imag

    def _forth(self, x):
        if self.beyond is None:
            return by_rows(jnp.fft.rfft, x, axis=0)
        turn = trailing(self.turn, x.ndim)
        return by_rows(jnp.fft.fft, turn * padded(x, 0, len(turn) - len(x)), axis=0)

    def _back(self, y):
        if self.beyond is None:
            return by_rows(jnp.fft.irfft, y, len(self.x), axis=0)
        turned = by_rows(jnp.fft.ifft, y, axis=0) * trailing(self.turn, y.ndim).conj()
        return turned.real[: len(self.x)]

    def force(self):
        return self._sum([(-1, k, k) for k in self.powers])

    def energy(self):
        total = self._sum([(1 / (2 * (k + 1)), k + 1, k) for k in self.powers])
        if not self.beyond:
            return total
        outside = {k: self.held(k, self.beyond) - self.held(k, 0) for k in self.powers}
        return total + sum(x / (k + 1) / 2 * self.x ** (k + 1) for k, x in outside.items())

    def slope(self, w):
        parts = [(-k, k - 1, k) for k in self.powers]
        return self._sum(parts) * w - self._sum(parts, w)

    def _sum(self, parts, w=None):
        # Sum a s_j c_j (x_n - x_j)^p [w_j] over neighbours j and `parts` (a, p, k).
        known = self.known()
        x = self._centred()
        one = 0 if w is None else w
        shape = jnp.broadcast_shapes(x.shape, jnp.shape(one))
        transforms = {}
        total = 0.0
        columns = {}
        for a, p, k in parts:
            for b in range(p + 1):
                factor = (-1) ** b * math.comb(p, b) * a
                if b == 0 and w is None:
                    total = total + factor * x**p * _spread(known[k][1], x)
                    continue
                if b not in transforms:
                    powers = x**b if w is None else x**b * w
                    transforms[b] = self._forth(jnp.broadcast_to(powers, shape))
                spectrum = jax.lax.complex(*(trailing(part, len(shape)) for part in known[k][0]))
                columns[p - b] = columns.get(p - b, 0) + factor * spectrum * transforms[b]
        for a, column in columns.items():
            total = total + x**a * self._back(column)
        return total

    def held(self, k, beyond):
        right, left = _bonds_within(self.powers[k], self.x.shape[0], beyond)
        return right - (-1) ** k * left

    def _centred(self):
        # Subtract the mean, where no site is held, since only differences matter.
        if self.beyond:
            return self.x
        return self.x - jax.lax.stop_gradient(jnp.mean(self.x, 0, keepdims=True))


def _offsets(c):
    return trailing(jnp.arange(1, c.shape[0] + 1, dtype=c.dtype), c.ndim)


def _spread(values, x):
    return jnp.broadcast_to(trailing(values, x.ndim), x.shape)


def _bonds_within(c, n, beyond):
    if beyond is None or beyond >= c.shape[0]:
        return c.sum(0, keepdims=True), c.sum(0, keepdims=True)
    sums = jnp.concatenate([jnp.zeros_like(c[:1]), jnp.cumsum(c, 0)])
    left = sums[jnp.minimum(jnp.arange(n) + beyond, c.shape[0])]
    return left[::-1], left


def folded(c, n):
    """Return the weights (n, lanes...) of the offsets 0, ..., n - 1 on a ring of n sites."""
    count = -(-(len(c) + 1) // n)
    c = padded(c, 1, count * n - 1 - len(c))
    return c.reshape(count, n, *c.shape[1:]).sum(0)
