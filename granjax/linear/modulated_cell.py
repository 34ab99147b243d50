"""Unit cells with stiffness and damping that are periodic in time, and waves over a period."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import refuse
from ..base.programs import compiled, concretely
from ..base.types import AnyArray, Cell, ComplexNumbers, Number, Numbers
from ..flow.control import shared_out
from ..lattice import Lattice
from .cell import Blocks, assemble, assembled, bloch, blocks_of, given_cell, one_way, periods
from .stiffness import blocks, grid, largest, undriven, without_derivatives

# phases at which forces are sampled; no simple fractions, where waveforms have zeros and jumps
PHASES = (0.1 + 0.6180339887498949 * np.arange(32)) % 1
# numbers of periods after which the forces are sampled again
LATER = (1, 2, 5)
# forces may fail to repeat by this part of their change in time; the error of the result includes
# it
MISSED = 1e-6
# sqrt(15), of Gauss' nodes and of Magnus' expansion at them
ROOT = 15**0.5
# Gauss' nodes of a step
NODES = 0.5 - ROOT / 10, 0.5, 0.5 + ROOT / 10


class ModulatedCell(eqx.Module):
    r"""One cell, at any time, of the infinite lattice that a finite lattice belongs to.

    A wave is u_j(R) = M_j^{-1/2} q_j(t) exp(i k . R) with q'' = -K(k, t) q - C(k, t) q', both over
    the masses.

    **Fields:** `lattice`: without drives. `cell`: sites along each axis; `chosen`: those that
    represent it; `shells`: the R of the neighbours. `coupling`: K_R and C_R at 32 times of a
    period, (shells, P, P, 2, times) [1/s^2], [1/s]. `mass`: (P,). `missed`: how far the forces are
    from periodic. `damped`: whether they read velocities.
    """

    lattice: Lattice
    coupling: AnyArray
    mass: AnyArray
    missed: tuple
    cell: tuple = eqx.field(static=True)
    chosen: tuple = eqx.field(static=True)
    reach: tuple = eqx.field(static=True)
    shells: tuple = eqx.field(static=True)
    damped: bool = eqx.field(static=True)

    def at(self, t: Number) -> tuple:
        """Return K_R/M and C_R/M at a time, (shells, P, P); C is `None` where not `damped`."""
        where = self.cell, self.chosen, self.reach, t, self.damped
        coupling = assembled(self.lattice, *where)[1][..., 0]
        return coupling[..., 0], coupling[..., 1] if self.damped else None

    @property
    def conserves(self) -> bool:
        """Whether the waves are Hamiltonian: C = 0, K_R the transpose of K_{-R}."""
        stiffness = self.coupling[..., 0, :]
        loss = self.coupling[..., 1, :]
        return not np.any(loss) and not one_way(stiffness, self.shells)

    @property
    def omega(self) -> float:
        """A bound on the frequencies, from the largest row sums of |K| and |C|."""
        stiff, loss = np.abs(self.coupling).sum((0, 2)).max((0, 2))
        return float(max(np.sqrt(stiff), loss))


def modulated_cell(lattice: Lattice, cell: Cell, t0: Number, period: Number) -> ModulatedCell:
    """Return the unit cell of a lattice from its forces over a whole period.

    **Raises** ValueError for a period after which the forces do not repeat, and where `unit_cell`
    does, except for modulated, gyroscopic and non-conservative forces.
    """
    lattice = undriven(lattice)
    # single-precision values are raised to the default precision
    lattice = lattice.astype(jnp.result_type(float))
    given = given_cell(cell, grid(lattice))
    start, length = map(float, without_derivatives((t0, period)))
    ts = start + length * PHASES
    known = blocks_of(lattice, ts, damped=True)
    missed = _missed(known, ts, length) if known.known else (0.0, 0.0, 0.0)
    size, chosen = periods(known, known.rings, given)
    shells, coupling, mass = assemble(np, known.found, known.mass, size, chosen, known.reach)
    places = size, chosen, known.reach, shells
    return ModulatedCell(lattice, coupling, mass, missed, *places, lattice.reads_velocity)


def _missed(known: Blocks, ts, period):
    # by how much K/M and C/M differ some periods later, and `_late`; more than rounding is refused
    lattice = known.plain
    found = known.found
    eps = np.finfo(found.dtype).eps
    change = largest(found - found[..., :1])
    off = np.zeros(2)
    for count in LATER:
        moved = np.asarray(ts, lattice.dtype) + np.asarray(count * period, lattice.dtype)
        later = concretely(blocks, lattice, known.reach, moved, True)[0]
        off = np.maximum(off, largest(later - found) / count)
    wrong = off > MISSED * change + 1e3 * eps * known.size
    if wrong.any():
        what = "stiffness" if wrong[0] else "damping"
        share = (off / np.where(change > 0, change, 1))[0 if wrong[0] else 1]
        refuse(
            "period",
            f"one after which the {what} repeats",
            f"{period!r}, after which it differs by {share:.2g} of what the modulation changes",
            "Give the modulation's period 2 pi/omega, or a multiple; several modulations need a common one.",
        )
    rounding = 1e2 * eps * change
    return (
        *(float(x) for x in np.maximum(off - rounding, 0) / float(known.mass.min())),
        _late(lattice, period, eps),
    )


@compiled
def _repeating(lattice):
    return [b.period for b in lattice.breaks if b.period is not None]


def _late(lattice, period, eps):
    # the time by which repeating jumps miss the period; more than rounding is refused
    late = 0.0
    for own in (float(x) for some in concretely(_repeating, lattice) for x in np.ravel(some)):
        turns = period / own
        off = abs(turns - round(turns))
        if off > MISSED or turns < 0.5:
            refuse(
                "period",
                f"one after which the breaks repeat, a multiple of {own:.10g}",
                repr(period),
            )
        late = max(late, off * own if off > 8 * eps * turns else 0.0)
    return late


@compiled
def monodromies(
    cell: ModulatedCell,
    k: Numbers,
    t0: Number,
    period: Number,
    omega: Number,
    steps: Any,
) -> ComplexNumbers:
    r"""Return Y(t0 + T) of Y' = A(t) Y, Y(t0) = 1, at k (K, axes): (K, 2P, 2P) over (q, q'/omega).

    Steps Y -> exp(Omega) Y by Magnus' expansion of order 6 at Gauss' nodes end at breaks. They are
    exact while stiffness and damping are constant, as in layers in time, and symplectic for a
    Hamiltonian A. `steps`: a whole number, or an array, which compiles nothing anew but has no
    reverse mode.
    Source: Blanes, Casas, Oteo, Ros, Phys. Rep. 470, 151 (2009), section 4.
    """
    dtype = jnp.result_type(cell.lattice.dtype, k.dtype, jnp.complex64)
    size = cell.mass.size
    one = jnp.eye(size, dtype=dtype)
    none = jnp.zeros((size, size), dtype)

    def generator(t):
        coupling, loss = cell.at(t)

        def of(k):
            stiff = bloch(coupling, cell.shells, k) / omega
            lost = none if loss is None else bloch(loss, cell.shells, k)
            return jnp.block([[none, omega * one], [-stiff.astype(dtype), -lost.astype(dtype)]])

        return jax.vmap(of)(k)

    def step(Y, t, h):
        first, middle, last = (generator(t + node * h) for node in NODES)
        return exponential(_magnus(h * first, h * middle, h * last)) @ Y

    Y = jnp.broadcast_to(jnp.eye(2 * size, dtype=dtype), (len(k), 2 * size, 2 * size))
    breaks = cell.lattice.breaks
    if not breaks:
        h = period / steps
        return jax.lax.fori_loop(0, steps, lambda i, Y: step(Y, t0 + i * h, h), Y)
    end = t0 + period

    def until(i, carry):
        Y, t = carry
        after = shared_out(breaks, t, jnp.asarray(steps - i, t.dtype), end, 1)
        return step(Y, t, after - t), after

    return jax.lax.fori_loop(0, steps, until, (Y, jnp.asarray(t0)))[0]


def _magnus(first, middle, last):
    a = middle
    b = ROOT / 3 * (last - first)
    c = 10 / 3 * (last - 2 * middle + first)
    near = _commutator(a, b)
    far = -_commutator(a, 2 * c + near) / 60
    return a + c / 12 + _commutator(-20 * a - c + near, b + far) / 240


def _commutator(x, y):
    return x @ y - y @ x


def exponential(x: ComplexNumbers) -> ComplexNumbers:
    """Return exp(x) of matrices of norm up to 2, by Taylor's series to degree 24."""
    powers = [jnp.broadcast_to(jnp.eye(x.shape[-1], dtype=x.dtype), x.shape), x]
    for _ in range(4):
        powers.append(powers[-1] @ x)
    weights = (1 / np.cumprod(np.maximum(np.arange(25.0), 1))).tolist()
    parts = [sum(weights[5 * j + i] * powers[i] for i in range(5)) for j in range(5)]
    total = parts[-1]
    for part in parts[-2::-1]:
        total = total @ powers[5] + part
    return total
