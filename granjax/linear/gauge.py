"""Phases of Bloch vectors: parallel transport from each wave number to the next."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import positive, refuse
from ..results import Result, array
from ..types import Amplitudes, ComplexNumbers, Numbers, Parameter

# overlaps below this lead nowhere: bands cross, or the mesh is too coarse
LOST = 0.5


def followed(vectors: Any, mass: Any, squared: Any = None, tolerance: Any = 0.0) -> Any:
    """Vectors (K, ..., bands) that follow each other: each one's overlap with what it continues is real and positive.

    With the inner product sum conj(x) m y. Bands that are together at one k (`squared` (K, bands) closer than
    `tolerance`) take the basis there that is nearest to the vectors before, at the first k to those after; past a
    crossing, where bands change places, a vector's phase is that of the one that it continues.
    """
    q = jnp.concatenate(
        [
            (x * jnp.sqrt(m)[..., None]).reshape(x.shape[0], -1, x.shape[-1])
            for x, m in zip(jax.tree.leaves(vectors), jax.tree.leaves(mass))
        ],
        1,
    )
    bands = q.shape[-1]
    if squared is None:
        same = jnp.broadcast_to(jnp.eye(bands, dtype=bool), (len(q), bands, bands))
    else:
        same = jnp.abs(squared[:, :, None] - squared[:, None, :]) <= tolerance
    turns = _turns(q, same)
    return jax.tree.map(lambda x: jnp.einsum("k...b,kbc->k...c", x, turns), vectors)


def _turns(q, same):
    """The unitary matrices (K, bands, bands) that take vectors q (K, P, bands) to those that follow each other."""
    basis = _nearest(q[1 % len(q)], q[0], same[0])
    # at the start the largest component is real and positive
    start = basis * _back(q[0] @ basis)

    def step(before, point):
        x, together = point
        basis = _nearest(before, x, together)
        turn = basis * _back(before.conj().T @ (x @ basis))
        return x @ turn, turn

    _, rest = jax.lax.scan(step, q[0] @ start, (q[1:], same[1:]))
    return jnp.concatenate([start[None], rest])


def _back(x):
    """The phase factors that make the largest entry of each column real and positive."""
    largest = jnp.take_along_axis(x, jnp.argmax(jnp.abs(x), 0)[None], 0)[0]
    return _unit(largest.conj())


def _unit(z):
    size = jnp.abs(z)
    return jnp.where(size > 0, z / jnp.where(size > 0, size, 1), 1)


def _nearest(before, x, together):
    """The unitary matrix among bands that are together whose vectors are nearest to those before."""
    several = together.sum(0) > 1
    link = jnp.where(
        together & several[:, None], before.conj().T @ x, jnp.diag(~several).astype(x.dtype)
    )
    left, _, right = jnp.linalg.svd(jax.lax.stop_gradient(link))
    return jnp.where(together, (left @ right).conj().T, 0)


class SmoothGauge(Result):
    """Bloch vectors around the zone of a chain, each in phase with the one before.

    `periodic` are the vectors with the phase shared out evenly over the mesh, smooth all around the zone and back.
    """

    vectors: ComplexNumbers | dict[str, ComplexNumbers] = array(
        "Bloch vectors; the overlap of each with the next is real and positive, that of the"
        " last with the first has the phase -`phase`.",
        axes="wave site ... band",
    )
    phase: Numbers = array("The Berry (Zak) phase in (-pi, pi].", "rad", "band")
    overlap: Numbers = array("The least |overlap| of neighbours, one on a fine mesh.", axes="band")

    @property
    def periodic(self) -> ComplexNumbers | dict[str, ComplexNumbers]:
        """The vectors times exp(-i phase j/K) at the j-th wave number."""

        def shared(x):
            turn = np.exp(-1j * self.phase * np.arange(len(x))[:, None] / len(x))
            return x * turn.reshape(len(x), *(1,) * (x.ndim - 2), -1)

        return jax.tree.map(shared, self.vectors)

    @property
    def outcome(self) -> str:
        """The phases in units of pi, and whether the mesh follows the bands."""
        lost = [str(n) for n, x in enumerate(self.overlap) if x < LOST]
        told = "Phases " + ", ".join(f"{x / np.pi:+.6g} pi" for x in self.phase)
        if not lost:
            return f"{told}; overlaps of neighbours {np.min(self.overlap):.3g} or more."
        return (
            f"{told}; not those of band {', '.join(lost)}, whose neighbours hardly overlap: "
            "bands cross, or the mesh is too coarse."
        )


def smooth_gauge(
    vectors: Amplitudes | dict[str, Amplitudes], mass: Parameter | dict[str, Parameter] = 1.0
) -> SmoothGauge:
    r"""Bloch vectors of a chain in a smooth gauge, by parallel transport around the zone: what is left is a Zak phase.

    **Arguments:** `vectors`: (K, cell..., bands) at k_j = k_0 + 2 pi j/K, all around the zone, or a dict of such, as
    `gx.linear.dispersion` has them, with D(k + 2 pi) = D(k). `mass`: of the sites of the cell, which the inner product
    sum conj(x) m y counts: one number, or an array or dict for the cell.

    **Returns:** `SmoothGauge`; a phase is that of `gx.topology.zak` on the same mesh. **Raises** ValueError for fewer
    than four wave numbers, masses that do not fit. Source: Resta, Rev. Mod. Phys. 66, 899 (1994).
    """
    shapes = [np.shape(x) for x in jax.tree.leaves(vectors)]
    if any(
        len(x) < 3 or x[0] < 4 or (x[0], x[-1]) != (shapes[0][0], shapes[0][-1]) for x in shapes
    ):
        refuse(
            "vectors",
            "arrays (K, cell..., bands) of at least four wave numbers",
            " and ".join(map(str, shapes)),
        )
    mass = mass if isinstance(mass, dict) else jax.tree.map(lambda _: mass, vectors)

    def fitted(x, m):
        m, shape = positive("mass", m), x.shape[1:-1]
        return jnp.broadcast_to(m.reshape(m.shape + (1,) * (len(shape) - m.ndim)), shape)

    vectors = jax.tree.map(lambda x: jnp.asarray(x) + 0j, vectors)
    masses = jax.tree.map(fitted, vectors, mass)
    return SmoothGauge(*_closed(vectors, masses))


@eqx.filter_jit
def _closed(vectors, masses):
    """Vectors that follow each other, what phase is left around the zone, the least overlap of neighbours."""
    moved = followed(vectors, masses)

    def products(x, y):
        parts = zip(jax.tree.leaves(x), jax.tree.leaves(y), jax.tree.leaves(masses))
        return sum(
            (x.conj() * m[..., None] * y).reshape(len(x), -1, x.shape[-1]).sum(1)
            for x, y, m in parts
        )

    links = products(moved, jax.tree.map(lambda x: jnp.roll(x, -1, 0), moved))
    phase = -jnp.angle(jnp.prod(_unit(links), 0))
    phase = jnp.where(jnp.abs(phase + np.pi) < 1e-12, np.pi, phase)
    return moved, phase, (jnp.abs(links) / products(moved, moved).real).min(0)
