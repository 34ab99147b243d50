"""What a lattice's equations promise of a monodromy matrix: the symplectic form, damping, multipliers at +1."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..lattice import Lattice
from ..printing import told
from ..terms.tracing import reads
from ..types import Scalar
from .symmetry import shifts


class Structure(NamedTuple):
    """`mass`: (n,) of the raveled displacements, or `None` for a flow of which nothing is known.

    `rate`: gamma of a uniform damping, 0 for none, `None` where the flow is not even conformally symplectic.
    `expected`: multipliers at +1. `autonomous`: nothing depends on time.
    """

    mass: np.ndarray | None
    rate: float | None
    expected: int
    autonomous: bool
    __repr__ = told


NOTHING = Structure(None, None, 0, False)


def structure(lattice: Lattice) -> Structure:
    """The `Structure` of a lattice.

    Expected at +1: for an orbit of an autonomous, conservative lattice two (phase and energy), and two more for every
    free displacement (position and momentum): four for a chain with free ends or a ring, two between walls; none where
    it is driven or damped, but the free displacement of a damped or driven chain, which keeps one (or two).
    """
    masses = zip(jax.tree.leaves(lattice.mass), jax.tree.leaves(lattice.template()))
    mass = np.concatenate([np.broadcast_to(m, x.shape).ravel() for m, x in masses])
    damping = [term.exact_damping() for term in lattice.terms]
    damping = [found for found in damping if found is not None]
    found = [reads(term, lattice) for term in lattice.terms if term.exact_damping() is None]
    # a force that comes from no energy is no more symplectic than one that reads velocities
    others = [x for x in found if x.velocity or x.displacement and not x.energy]
    autonomous = not lattice.reads_time
    moves = shifts(lattice).shape[1]
    rates = {float(x) for _, rate in damping for x in np.ravel(rate)}
    everywhere = all(field is None for field, _ in damping)
    dissipates = bool(others or any(rates))
    if dissipates:
        expected = moves + (1 if autonomous else 0)
    else:
        expected = 2 * moves + (2 if autonomous else 0)
    uniform = (
        not others
        and everywhere
        and all(np.unique(np.ravel(rate)).size == 1 for _, rate in damping)
    )
    rate = sum(float(np.ravel(rate)[0]) for _, rate in damping) if uniform else None
    return Structure(mass, rate, expected, autonomous)


def weights(mass: Float[np.ndarray, " n"], period: Scalar) -> Float[np.ndarray, " two_n"]:
    """D = sqrt(m/m_mean) (1, T/2 pi) over the raveled (u, v), which turns both into lengths of one size, (2n,).

    D M D^-1 of a tangent map M has no units: norms, condition numbers and errors are taken of it. m_mean is the
    geometric mean, so that masses and moments of inertia may stand side by side.
    """
    root = np.sqrt(mass / np.exp(np.mean(np.log(mass))))
    return np.concatenate([root, root * float(period) / (2 * np.pi)])


def defect(monodromy: np.ndarray, rate: float | None, period: Scalar) -> float:
    """max |M^T J M - exp(-gamma T) J| of D M D^-1: rounding for a (conformally) symplectic map, whatever its error."""
    if rate is None:
        return float("nan")
    one = np.eye(len(monodromy) // 2)
    J = np.block([[0 * one, one], [-one, 0 * one]])
    return float(np.abs(monodromy.T @ J @ monodromy - np.exp(-rate * period) * J).max())


def krein(
    multipliers: np.ndarray,
    vectors: np.ndarray,
    mass: np.ndarray | None,
    tolerance: np.ndarray,
) -> np.ndarray:
    """Signature of each multiplier on the unit circle: the sign of Im sum m conj(u) v; 0 off the circle or mixed.

    +1: the motion exp(i omega t) of a positive energy, with its conjugate at -1. Two of one sign pass through each
    other; of unlike signs they may leave the circle (M. G. Krein; Aubry, Physica D 216, 1 (2006)).
    """
    if mass is None:
        return np.full(len(multipliers), np.nan)
    n = len(mass)
    u, v = vectors[:n], vectors[n:]
    value = np.imag(np.sum(mass[:, None] * np.conj(u) * v, axis=0))
    size = np.sum(mass[:, None] * np.abs(u) * np.abs(v), axis=0)
    definite = (np.abs(np.abs(multipliers) - 1) <= tolerance) & (np.abs(value) > 1e-6 * size)
    return np.where(definite, np.sign(value), 0.0)
