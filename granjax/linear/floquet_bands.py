"""Floquet-Bloch bands of lattices whose stiffness changes periodically in time."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..base.arrays import trailing
from ..base.checks import is_site, parameter, positive, refuse, traced, whole
from ..base.derivatives import eigenvalues
from ..base.tuning import one_thread
from ..base.types import Cell, ComplexNumbers, Count, Number, Numbers, Parameter, Scalar
from ..lattice import Lattice, State
from ..results import Result, array, note
from .cell import along_waves, by_lanes, in_lanes, phases
from .gaps import gaps_of
from .modulated_cell import ModulatedCell, modulated_cell, monodromies
from .stiffness import in_groups, unpack_waves, without_derivatives

# wave numbers per batch; smaller batches are padded, so that one compiled program serves any number
TOGETHER = 16
# the fewest steps per period
LEAST_STEPS = 16
# the steps per radian of the highest frequency, to begin with
PER_RADIAN = 1.1
# the most steps per period
MOST_STEPS = 2**14
# the requested error of M, relative to its largest entry
TOLERANCE = 2e-12
# error of M over its difference between n and 3n/4 steps; that difference is only 1/3 of the error
# where forces jump at a time that is not declared as a break
SAFETY = 4
# the rounding error of products, in units of eps
ROUNDING = 20
# a refinement that stalls within this many times that error stops, as more steps would not help
STALLED = 1e3
# multipliers closer than this are treated as copies of one nearly defective multiplier
NEAR = 1e-3


class FloquetBands(Result):
    r"""Waves u(t) exp(i k . R) of a lattice modulated with period T: (u, v) -> rho (u, v) after T.

    `k` has the shape (k...,) for a chain and (k..., d) for d axes; a cell of P degrees of freedom
    has 2P multipliers. Waves are normalised by sum m/m_mean (|u|^2 + |T v/2 pi|^2) = 1 over the
    cell. The errors of `growth` and `omega` are `error`/(|rho| T). The edges of gaps are `None`
    where `k` is one number or has several axes, and where anything is traced.
    """

    k: Numbers = array("The phase advance per unit cell.", "rad", "wave")
    multipliers: ComplexNumbers = array(
        "Bloch multipliers rho, the largest modulus first.",
        "1",
        "wave multiplier",
        name="multiplier",
    )
    error: Numbers = array(
        "The error of each multiplier, estimated from two step sizes, rounding and its condition.",
        "1",
        "wave multiplier",
    )
    growth: Numbers = array("log|rho|/T.", "1/s", "wave multiplier")
    omega: Numbers = array(
        "Quasi-frequencies -arg(rho)/T in [-pi/T, pi/T); others differ by multiples of 2 pi/T.",
        "rad/s",
        "wave multiplier",
    )
    displacements: ComplexNumbers | dict[str, ComplexNumbers] = array(
        "The displacements of the waves at t0.", axes="wave site ... multiplier"
    )
    velocities: ComplexNumbers | dict[str, ComplexNumbers] = array(
        "The velocities of the waves at t0.", "1/s", "wave site ... multiplier"
    )
    edges: Numbers | None = array(
        "The pairs of wave numbers between which some wave grows.", "rad", "gap side"
    )
    edge_error: Numbers | None = array("The errors of the edges.", "rad", "gap side")
    fastest_k: Numbers | None = array(
        "The wave number at which waves of a gap grow fastest.", "rad", "gap"
    )
    fastest: Numbers | None = array("The rate of the fastest growth in a gap.", "1/s", "gap")
    period: Number = array("The period T of the modulation.", "s")
    t0: Number = array("The time at which the period begins.", "s")
    steps: Any = array("The number of steps of a period.")
    cell: tuple[int, ...] = note("The number of sites per cell along each axis.", static=True)

    def _held(self, name):
        return along_waves(self, super()._held(name))

    @property
    def gaps(self) -> list[tuple[float, float]]:
        """The k-gaps (wave number bandgaps) in which some wave grows, pairs (low, high) [rad].

        These are all gaps that overlap the span of `k`; those around 0 and pi reach beyond it. Gaps
        whose growth over a period is within the errors of the multipliers are left out.
        **Raises** ValueError where gaps were not computed.
        """
        if self.edges is None:
            refuse(
                "gaps",
                "a chain, and several wave numbers that are known",
                "one number, a lattice of several axes, or traced ones",
                "Give k=np.linspace(0, np.pi, 101); .growth says whether a wave grows.",
            )
        return [(float(a), float(b)) for a, b in self.edges]

    @property
    def outcome(self) -> str:
        """The number of multipliers, and where waves grow."""
        if traced(self):
            return "Multipliers that are traced."
        grows = by_lanes(self, self.grows)
        text = (
            f"{grows.shape[-1]} multipliers at {grows[0, ..., 0].size} wave numbers{in_lanes(self)}, "
            f"to {np.max(self.error):.1e}; "
        )
        if self.edges is not None:
            count = len(self.edges)
            fast = f", fastest at {self._told('fastest', np.max(self.fastest))}" if count else ""
            return text + f"{count or 'no'} k-gap{'s' * (count != 1)}{fast}."
        count = int(grows.any(-1).sum())
        return text + (f"waves grow at {count} of them." if count else "none grows.")

    @property
    def grows(self) -> Any:
        """Whether |rho| exceeds 1 by more than its error, (k..., 2P)."""
        return np.abs(self.multipliers) - 1 > self.error

    def state(
        self, lattice: Lattice, wave: Count = 0, multiplier: Count = 0, amplitude: Scalar = 1.0
    ) -> State:
        """Return a wave as a state at t0: u_n = Re(a u_j exp(i k R)), n = R P + j.

        P is the number of sites per cell. On a ring that holds a whole number of wavelengths, a
        real rho multiplies it each period.

        **Arguments:** `lattice`: that of the bands; `wave`: index into an array `k`; `multiplier`:
        index, 0 grows fastest; `amplitude`: the largest displacement [m]. **Raises** ValueError for
        a lattice with another cell, an index out of range, or several axes.
        """
        if len(self.cell) > 1 or lattice.axes > 1:
            refuse(
                "lattice",
                "a chain",
                f"a lattice of {lattice.axes} axes",
                "Build the state from .displacements.",
            )
        amplitude = positive("amplitude", amplitude)
        k = jnp.ravel(self.k)
        counts = np.size(self.k), self.omega.shape[-1]
        if not is_site((wave, multiplier), counts):
            wanted = f"a wave and a multiplier of {counts}, counted from either end"
            refuse("wave, multiplier", wanted, f"{(wave, multiplier)}")
        lead = self.omega.ndim - 1

        def spread(x, like):
            x = x.reshape((-1,) + x.shape[lead:])[wave][..., multiplier]
            if x.shape[1:] != like.shape[1:] or x.shape[0] != self.cell[0]:
                refuse("lattice", "the one whose bands these are", f"sites of shape {like.shape}")
            number = np.arange(like.shape[0])
            turn = trailing(jnp.exp(1j * k[wave] * (number // len(x))), x.ndim)
            return jnp.real(turn * x[number % len(x)]).astype(like.dtype)

        u, v = (
            jax.tree.map(spread, x, lattice.template())
            for x in (self.displacements, self.velocities)
        )
        largest = jnp.abs(ravel_pytree(u)[0]).max()
        return State(*jax.tree.map(lambda x: x * (amplitude / largest), (u, v)))


def floquet_bands(
    lattice: Lattice,
    k: Parameter,
    period: Scalar,
    *,
    t0: Scalar = 0.0,
    cell: Cell = None,
    steps: Count | None = None,
) -> FloquetBands:
    r"""Compute the Floquet-Bloch bands of an infinite lattice modulated with a period T in time.

    Linear waves u_j(R, t) = q_j(t) exp(i k . R) about u = 0 obey q(t + T) = M(k) q(t), with
    multipliers rho, the eigenvalues of M. Where one leaves the unit circle
    (a k-gap, or wavenumber bandgap), waves grow as |rho|^{t/T}. All linear forces are included,
    damping, dashpots and cells of several fields among them, with modulation in time alone or
    travelling, by `Modulated` or a user-defined term. Drives and moving walls are left out.

    **Arguments:**

    - `lattice`, `k`: as in `dispersion`.
    - `period`: T > 0, the period of the modulation or a multiple; any for a lattice that does not
      change. `t0`: the time at which M begins; multipliers do not depend on it.
    - `cell`: sites per unit cell; `None` finds the smallest period, which a travelling modulation
      makes larger.
    - `steps`: steps per period; `None` finds the number for which M is known to 2e-12 of its
      largest entry.

    **Returns:** `FloquetBands`. Where K is modulated uniformly, each k is a Hill equation with
    omega(k)^2 g(t), and the first k-gap lies where omega(k) = pi/T. Simple multipliers
    are differentiable in `k` and every parameter; waves are not, and gaps are not computed then.
    Within `jax.jit` or `jax.vmap` give `cell` and `steps`; errors are not computed there.
    **Raises** ValueError for a period after which the forces do not repeat, `k` of another shape,
    and where `unit_cell` does, except for modulated, gyroscopic and non-conservative forces.
    Source: Trainiti, Xia, Marconi, Cazzulani, Erturk, Ruzzene, Phys. Rev. Lett. 122, 124301 (2019);
    k-gaps: Kim, Chong, Hajarolasvadi, Wang, Daraio, Phys. Rev. E 107, 034211 (2023).

    **Example:**

    >>> crystal = gx.scenes.modulated(12, amplitude=0.1, omega=2.0, shape="square")
    >>> found = gx.linear.floquet_bands(crystal, np.linspace(0, np.pi, 13), period=np.pi)
    >>> print(found.edges.round(2))  # gaps about k = pi/3 and pi, where 2 sin(k/2) is 1 and 2
    [[1.01 1.09]
     [3.04 3.24]]
    """
    period = positive("period", period, "It is the modulation's, 2 pi/omega.")
    k = parameter("k", k)
    t0 = parameter("t0", t0)
    steps = None if steps is None else whole("steps", steps, 2)
    if traced(without_derivatives((period, t0))):
        refuse(
            "period",
            "a number",
            "a traced one",
            "It may be differentiated, but not under jit or vmap.",
        )
    found = modulated_cell(lattice, cell, t0, period)
    axes = len(found.cell)
    points = phases(k, axes)
    shape = points.shape[:-1]
    points = points.reshape(-1, axes)
    held = without_derivatives((found, k, t0, period))
    known = None if traced(held) else _Known(*held, steps)
    omega = known.omega if known else 2 * np.pi / period
    if known:
        steps = known.steps
    elif steps is None:
        refuse(
            "steps",
            "the number of steps of a period, since the lattice or k is traced",
            "None",
            "Write steps=64.",
        )
    differs = traced((found, k, t0, period))
    if differs:
        waves = _traced_waves(found, points, t0, period, omega, steps, known)
    else:
        waves = known.waves(np.asarray(points))
    searched = not differs and axes == 1 and k.size > 1
    gaps = gaps_of(known, np.asarray(held[1])) if searched else (None,) * 4
    rho, error, vectors = waves
    parts = rho, error, *_parted(found, vectors, period, omega)
    rho, error, *motion = (x.reshape(shape + x.shape[1:]) for x in parts)
    u, v = (unpack_waves(x, found.cell, lattice.fields, lattice.dimension) for x in motion)
    return FloquetBands(
        k,
        rho,
        error,
        jnp.log(jnp.abs(rho)) / period,
        0.0 - _angle(rho) / period,
        u,
        v,
        *gaps,
        period,
        t0,
        steps,
        found.cell,
        **lattice.origin,
    )


def _angle(rho):
    # arg(rho), with +pi on the negative axis up to rounding
    turned = jnp.angle(rho)
    return jnp.where(
        turned < -jnp.pi + 64 * jnp.finfo(turned.dtype).eps, turned + 2 * jnp.pi, turned
    )


class _Known:
    """The waves of a cell with concrete values, for any k."""

    def __init__(self, cell: ModulatedCell, k: Any, t0: Any, period: Any, steps: int | None):
        self.cell = cell
        self.t0 = jnp.asarray(t0)
        self.period = jnp.asarray(period)
        self.eps = float(np.finfo(cell.coupling.dtype).eps)
        self.omega = cell.omega or 1 / float(period)
        self.conserves = cell.conserves
        self.turned = self.omega * float(period)
        # forces that do not repeat exactly change M by at most the integral of the mismatch
        stiff, lost, late = cell.missed
        self.missed = float(period) * (stiff / self.omega + lost) + 2 * self.omega * late
        if PER_RADIAN * self.turned > MOST_STEPS:
            refuse(
                "period",
                f"one of at most {MOST_STEPS / PER_RADIAN:.3g} radians of the fastest waves",
                f"{float(period):.6g}, which is {self.turned:.3g} of them",
                "Check its unit.",
            )
        points = np.asarray(k).reshape(-1, len(cell.cell))
        self.steps = self._found(points) if steps is None else steps

    def maps(self, k: np.ndarray, steps: int | None = None) -> np.ndarray:
        """Return M(k) over (q, q'/omega), (K, 2P, 2P)."""
        steps = self.steps if steps is None else steps
        along = self.t0, self.period, jnp.asarray(self.omega), jnp.asarray(steps)
        points = k.astype(self.cell.coupling.dtype)
        return in_groups(lambda k: monodromies(self.cell, k, *along), points, TOGETHER)

    def _found(self, k):
        some = np.concatenate([k[:: max(1, len(k) // 32)][:32], np.full((1, k.shape[1]), np.pi)])
        count = max(LEAST_STEPS, PER_RADIAN * self.turned)
        last = np.inf
        while True:
            # a multiple of 4, so that 3n/4 is whole
            count = 4 * int(np.ceil(count / 4))
            fine = self.maps(some, count)
            size = np.abs(fine).max()
            off = np.abs(fine - self.maps(some, 3 * count // 4)).max()
            if not np.isfinite(size):
                refuse(
                    "lattice",
                    "waves that stay finite over a period",
                    "a growth that overflows",
                    "Check its stiffness, or give a shorter period.",
                )
            rounding = ROUNDING * self.eps * size * (1 + self.turned)
            least = max(TOLERANCE * size, rounding)
            stalled = off > last / 2 and off <= STALLED * rounding
            if off <= least or stalled or count >= MOST_STEPS:
                return count
            # the number that order 6 needs, but at most twice as many
            count = count * np.clip(1.1 * (off / least) ** (1 / 6), 1.25, 2.0)
            last = off

    def levels(self, k: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return M(k) by n and by 3n/4 steps, and a bound on the error of the former, (K,)."""
        fine = self.maps(k)
        coarse = self.maps(k, 3 * self.steps // 4)
        size = np.linalg.norm(fine, axis=(1, 2))
        rounding = (ROUNDING * self.eps * (1 + self.turned) + self.missed) * size
        return fine, coarse, SAFETY * np.linalg.norm(fine - coarse, axis=(1, 2)) + rounding

    @one_thread
    def waves(self, k: np.ndarray) -> tuple:
        """Return multipliers (K, 2P), errors, and vectors over (q, q'/omega) (K, 2P, 2P)."""
        fine, _, about = self.levels(k)
        rho, vectors = _in_order(np, *np.linalg.eig(fine))
        return rho, errors_of(fine, rho, vectors, about), vectors


def _in_order(xp, rho, vectors):
    # by modulus, the largest first
    order = xp.lexsort((-xp.angle(rho), -xp.abs(rho).round(9)))
    return xp.take_along_axis(rho, order, -1), xp.take_along_axis(vectors, order[:, None, :], -1)


def errors_of(
    maps: np.ndarray, rho: np.ndarray, vectors: np.ndarray, about: np.ndarray
) -> np.ndarray:
    """Bound the errors of eigenvalues, (K, 2P), of matrices known to within `about` in norm.

    The bound is |dM|/|y^H x|, or for m eigenvalues that meet, where it is smaller, Elsner's,
    (|M| + |M + dM|)^{1 - 1/m} |dM|^{1/m}.
    """
    try:
        left = np.linalg.inv(vectors)
        condition = np.linalg.norm(left, axis=2) * np.linalg.norm(vectors, axis=1)
    except np.linalg.LinAlgError:
        condition = np.full(rho.shape, np.inf)
    near = (
        np.abs(rho[:, :, None] - rho[:, None, :]) <= NEAR * np.maximum(1, np.abs(rho))[:, :, None]
    )
    m = near.sum(-1)
    size = 2 * np.linalg.norm(maps, axis=(1, 2))[:, None] + about[:, None]
    about = about[:, None]
    met = size ** (1 - 1 / m) * about ** (1 / m)
    alone = np.minimum(condition, 1e15) * about
    return np.where(m > 1, np.minimum(condition * about, met), alone)


def _traced_waves(cell, k, t0, period, omega, steps, known):
    # as `_Known.waves`: multipliers carry derivatives, vectors do not
    maps = monodromies(cell, k, t0, period, jnp.asarray(omega), int(steps))
    if known:
        own, error, vectors = map(jnp.asarray, known.waves(np.asarray(jax.lax.stop_gradient(k))))
    else:
        own, vectors = _in_order(jnp, *jnp.linalg.eig(jax.lax.stop_gradient(maps)))
        error = jnp.full(own.shape, jnp.nan)
    rho = jax.vmap(eigenvalues)(maps)
    apart = jnp.abs(own[:, :, None] - jax.lax.stop_gradient(rho)[:, None, :])
    return jnp.take_along_axis(rho, jnp.argmin(apart, -1), -1), error, vectors


def _parted(cell, vectors, period, omega):
    # displacements and velocities (K, P, 2P) from vectors over (q, q'/omega), normalised over the
    # cell
    size = vectors.shape[-2] // 2
    mass = jnp.asarray(cell.mass)[:, None]
    mean = jnp.exp(jnp.mean(jnp.log(mass)))
    q = vectors[:, :size] * jnp.sqrt(mean)
    p = omega * vectors[:, size:] * jnp.sqrt(mean)
    weight = jnp.sqrt(
        jnp.sum(jnp.abs(q) ** 2 + jnp.abs(p * period / (2 * np.pi)) ** 2, -2, keepdims=True) / mean
    )
    both = jnp.concatenate([q, p * period], -2)
    lead = jnp.take_along_axis(both, jnp.argmax(jnp.abs(both).round(9), -2, keepdims=True), -2)
    turn = jnp.abs(lead) / lead / weight
    return q * turn / jnp.sqrt(mass), p * turn / jnp.sqrt(mass)
