"""Eigenvalues of monodromy matrices and of products of matrices, with errors."""

import jax
import numpy as np
import scipy
from jaxtyping import Float, Inexact

from ..base.tuning import one_thread
from ..base.types import Scalar

# The rounding of a product of many steps, relative to the norm, in units of the last place.
ROUNDING = 500
# The safety factor for a difference between two flows, where there are three flows.
SAFETY = 4
# The same where there are two flows alone.
ALONE = 8
# Changes of three flows in this ratio or above, and aligned, are those of a smooth flow of order 6
# or more.
REGULAR = 10
# The cosine of the angle between two changes above which they are aligned.
ALIGNED = 0.95
# Moduli in this ratio or above are separated.
GAP = 10
# A subspace that turns by less than this has settled.
SETTLED = 1e-14
# The most sweeps through the factors.
SWEEPS = 60
# The rounding of a turn below which a lower block is set to zero.
ROUNDED = 1e-9

Map = Float[np.ndarray | jax.Array, "n n"]


@one_thread
def spectrum(
    fine: Map, coarse: Map, coarser: Map | None = None
) -> tuple[Inexact[np.ndarray, " n"], Inexact[np.ndarray, "n n"], Float[np.ndarray, " n"]]:
    """Return the eigenvalues of a matrix without units, unit right eigenvectors, and errors.

    The largest modulus is first. `coarse`, `coarser`: the matrix by 3/4 and 1/2 of the steps, or
    `coarse` alone by 1/2.

    The error is the larger of two, plus the rounding of M times the eigenvalue's condition number:
    the bound |dM|/|y^H x| of the first-order effect of a change dM (y, x left and right unit
    eigenvectors), and the distance to the nearest eigenvalue of `coarse` in a one-to-one matching.
    At a double multiplier the condition makes it a square root. |dM| is `uncertain`. The effect
    y^H dM x itself may be small by accident, above all where contacts open.
    """
    fine, coarse, coarser = jax.tree.map(np.asarray, (fine, coarse, coarser))
    return known_spectrum(fine, coarse, uncertain(fine, coarse, coarser), 0.0)


def known_spectrum(fine: Map, coarse: Map, about: float, moved: Scalar) -> tuple:
    """Return the `spectrum` of a matrix that is `uncertain` by `about`.

    `moved`: other errors of it.
    """
    values, right, overlap = _decomposed(fine)
    error = (ROUNDING * np.finfo(float).eps * size_of(fine) + moved) / overlap
    apart = np.maximum(about / overlap, _matched(values, np.linalg.eigvals(coarse)))
    return values, right, error + apart


def _decomposed(matrix):
    # Eigenvalues, the largest modulus first, unit right eigenvectors, and their overlap with the
    # left ones.
    values, left, right = scipy.linalg.eig(matrix, left=True, check_finite=False)
    order = np.lexsort((-np.angle(values), -np.abs(values).round(9)))
    values = values[order]
    left = left[:, order]
    right = right[:, order]
    overlap = np.abs(np.sum(np.conj(left) * right, axis=0))
    return values, right, np.maximum(overlap, np.finfo(float).eps)


def size_of(matrix: np.ndarray) -> float:
    """Return the largest singular value, in a third of the time of all of them."""
    largest = np.abs(matrix).max()
    if not 0 < largest < np.inf:
        return float(largest)
    last = len(matrix) - 1
    matrix = matrix / largest
    squared = scipy.linalg.eigh(
        matrix.conj().T @ matrix,
        eigvals_only=True,
        subset_by_index=[last, last],
        check_finite=False,
    )
    return float(largest * np.sqrt(squared[0]))


def _matched(values, others):
    # The distance of each value from its partner in the closest one-to-one matching.
    distance = np.abs(values[:, None] - others[None])
    rows, columns = scipy.optimize.linear_sum_assignment(distance)
    away = np.empty(len(values))
    away[rows] = distance[rows, columns]
    return away


def uncertain(fine: Map, coarse: Map, coarser: Map | None = None) -> float:
    """Return the uncertainty of a matrix in norm, from those with 3/4 and 1/2 of the steps.

    It is four times the norm of `change`, or eight times that of the difference from a matrix with
    1/2 of the steps alone.
    """
    if coarser is None:
        return ALONE * size_of(fine - coarse)
    return SAFETY * size_of(change(fine, coarse, coarser))


def change(fine: np.ndarray, coarse: np.ndarray, coarser: np.ndarray) -> np.ndarray:
    """Return the difference between flows of n, 3n/4, n/2 steps that tells the error of the first.

    Where contacts open, errors fall unevenly, with an order of 3/2 to 5/2: the difference of two
    flows may be small by accident, usually up to eightfold, but not all three. So the largest
    difference is taken, or the smallest where they fall as those of a smooth flow of high order.
    """
    near = fine - coarse
    far = fine - coarser
    sizes = np.linalg.norm(near), np.linalg.norm(far)
    if sizes[1] >= REGULAR * sizes[0] and np.vdot(near, far).real >= ALIGNED * sizes[0] * sizes[1]:
        return near
    return max(near, far, coarse - coarser, key=np.linalg.norm)


def product_spectrum(fine: list, coarse: list, coarser: list, *, moved: Scalar = 0.0) -> tuple:
    """Return the `spectrum` of a product M_m ... M_1 from its factors, the first applied first.

    The product itself loses every multiplier below eps times the largest; here each keeps the
    digits that one factor leaves it. The error covers the differences between the three spectra,
    and the rounding of each factor and block. `moved`: other errors of the factors together.
    """
    blocks, basis, sizes = _by_blocks(fine)
    values, vectors, overlap = _decomposed(blocks)
    others = [np.linalg.eigvals(_by_blocks(factors)[0]) for factors in (coarse, coarser)]
    apart = np.max([_matched(values, other) for other in others], axis=0)
    # Sizes fall from block to block, as the moduli do.
    m = len(fine)
    eps = ROUNDING * np.finfo(float).eps
    rounded = np.empty(len(values))
    rounded[np.argsort(-np.abs(values), kind="stable")] = eps * sizes
    # A change of one factor counts according to that factor's share of the multiplier.
    change_of_one = moved + eps * max(map(size_of, fine))
    by_factor = m * np.abs(values) ** ((m - 1) / m) * change_of_one
    return values, basis @ vectors, (rounded + by_factor) / overlap + SAFETY * apart


def _by_blocks(factors):
    # The product M_m ... M_1 as B in an orthonormal basis Q, M Q = Q B, and for each row the size
    # of its block. Sweeps of QR decompositions through the factors turn the leading columns of Q to
    # where the product stretches most (orthogonal iteration). Where two neighbouring columns are
    # stretched in a ratio above `GAP`, the block below is set to zero once the columns have
    # settled. The eigenvalues of each block then keep the digits that the plain product loses to
    # the largest. Source: Bojanczyk, Golub, Van Dooren, Proc. SPIE 1770, 31 (1992).
    n = len(factors[0])
    before = np.inf
    basis, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(n, n)))
    for _ in range(SWEEPS):
        turned = basis
        product = np.eye(n)
        for factor in factors:
            turned, triangle = np.linalg.qr(factor @ turned)
            product = triangle @ product
        stretches = np.abs(np.diag(product))
        rotation = basis.T @ turned
        above = np.minimum.accumulate(stretches)[:-1]
        below = np.maximum.accumulate(stretches[::-1])[::-1][1:]
        cuts = [0, *1 + np.flatnonzero(above > GAP * below), n]
        turns = max(np.abs(rotation[cut:, :cut]).max(initial=0) for cut in cuts)
        # A small turn that no longer falls is rounding.
        if turns <= SETTLED or turns > before / 2 and turns < ROUNDED:
            break
        basis = turned
        before = turns
    # For columns that still turn, the product is taken as it is.
    cuts = [cut for cut in cuts if np.abs(rotation[cut:, :cut]).max(initial=0) < ROUNDED]
    for cut in cuts:
        rotation[cut:, :cut] = 0
    blocks = rotation @ product
    sizes = [size_of(blocks[a:b, a:b]) for a, b in zip(cuts, cuts[1:])]
    return blocks, basis, np.repeat(sizes, np.diff(cuts))


@one_thread
def reversible_multipliers(half: Map, coarse: Map, coarser: Map | None = None) -> tuple:
    r"""Return multipliers of a time-reversible orbit from the tangent map of half a period.

    The half period lies between two rests. With half = [[A, B], [C, D]] over (u, p = m v)
    symplectic and the reversal R,

    M = R half^{-1} R half,  (M + M^{-1})/2 = diag(1 + 2 B^T C, 1 + 2 C^T B).

    So the n numbers (rho + 1/rho)/2 are the eigenvalues of 1 + 2 B^T C. They are simple where the
    multipliers are double (at +-1), so their errors are not square roots.

    **Returns:** half-traces mu (n,), multipliers rho (2n,), the largest modulus first, and the
    error of each rho.
    """
    n = len(half) // 2

    def stiff(h):
        h = np.asarray(h)
        return np.eye(n) + 2 * h[:n, n:].T @ h[n:, :n]

    mu, _, error = spectrum(*jax.tree.map(stiff, (half, coarse, coarser)))
    root = np.sqrt(mu.astype(complex) ** 2 - 1)
    rho = mu + np.where(np.real(np.conj(mu) * root) >= 0, root, -root)
    spread = error * np.abs(rho) / np.maximum(np.abs(root), np.sqrt(2 * error))
    spread = np.concatenate([spread, spread / np.abs(rho) ** 2])
    rho = np.concatenate([rho, 1 / rho])
    order = np.argsort(-np.abs(rho), kind="stable")
    return mu, rho[order], spread[order]
