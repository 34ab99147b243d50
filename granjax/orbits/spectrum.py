"""Eigenvalues of monodromy matrices, with errors; products that keep what is small."""

import numpy as np
from jaxtyping import Float, Inexact
from scipy.linalg import eig, eigh
from scipy.optimize import linear_sum_assignment

from ..tuning import one_thread
from ..types import Parameter, Scalar

# of a norm: rounding of a product of many steps, in units of the last place
ROUNDING = 500
# of a difference between two flows, of three, and of two alone
SAFETY = 4
ALONE = 8
# changes of three flows in this ratio and direction are those of a smooth one of order 6 or more
REGULAR = 10
ALIGNED = 0.95

Map = Float[np.ndarray, "n n"]


@one_thread
def spectrum(
    fine: Map,
    coarse: Map | None = None,
    coarser: Map | None = None,
    *,
    moved: Scalar = 0.0,
) -> tuple[Inexact[np.ndarray, " n"], Inexact[np.ndarray, "n n"], Float[np.ndarray, " n"]]:
    """Eigenvalues (largest modulus first), unit right eigenvectors, and an error of each, of a matrix without units.

    `coarse`, `coarser`: the matrix by 3/4 and 1/2 of the steps, or the former alone by half. The error is the bound
    |dM|/|y^H x| of the first-order effect of a change dM (y, x left and right unit eigenvectors) or, if more, the
    distance to the nearest eigenvalue of `coarse` in a one-to-one matching; plus the rounding of M by the eigenvalue's
    condition. At a double multiplier the condition makes it a square root. |dM| is `uncertain`, plus `moved`: what else
    M is not known to. The effect y^H dM x itself may be small by accident, above all where contacts open.
    """
    fine, coarse, coarser = (None if x is None else np.asarray(x) for x in (fine, coarse, coarser))
    return known_spectrum(
        fine, coarse, 0.0 if coarse is None else uncertain(fine, coarse, coarser), moved
    )


def known_spectrum(fine: Map, coarse: Map | None, about: float, moved: Scalar) -> tuple:
    """`spectrum` of a matrix that is `uncertain` by `about`."""
    values, left, right = eig(fine, left=True, check_finite=False)
    order = np.lexsort((-np.angle(values), -np.abs(values).round(9)))
    values, left, right = values[order], left[:, order], right[:, order]
    overlap = np.abs(np.sum(np.conj(left) * right, axis=0))
    overlap = np.maximum(overlap, np.finfo(float).eps)
    error = (ROUNDING * np.finfo(float).eps * size_of(fine) + moved) / overlap
    if coarse is not None:
        error = error + np.maximum(about / overlap, matched(values, np.linalg.eigvals(coarse)))
    return values, right, error


def size_of(matrix: np.ndarray) -> float:
    """The largest singular value, in a third of the time of all."""
    largest = np.abs(matrix).max()
    if not 0 < largest < np.inf:
        return float(largest)
    matrix, last = matrix / largest, len(matrix) - 1
    squared = eigh(
        matrix.conj().T @ matrix,
        eigvals_only=True,
        subset_by_index=[last, last],
        check_finite=False,
    )
    return float(largest * np.sqrt(squared[0]))


def matched(
    values: Inexact[np.ndarray, " n"],
    others: Inexact[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """How far each value is from its partner among others, in the one-to-one matching of the least distances."""
    distance = np.abs(values[:, None] - others[None])
    rows, columns = linear_sum_assignment(distance)
    away = np.empty(len(values))
    away[rows] = distance[rows, columns]
    return away


def uncertain(fine: Map, coarse: Map, coarser: Map | None = None) -> float:
    """The norm to which a matrix is known by those with 3/4 and with 1/2 of the steps, or with 1/2 alone.

    Four times that of `change`; of two flows alone eight times that of their difference.
    """
    if coarser is None:
        return ALONE * size_of(fine - coarse)
    return SAFETY * size_of(change(fine, coarse, coarser))


def change(fine: np.ndarray, coarse: np.ndarray, coarser: np.ndarray) -> np.ndarray:
    """Of the differences between three flows, by n, 3n/4 and n/2 steps, the one that tells the error of the first.

    Where contacts open errors fall unevenly, with an order of 3/2 to 5/2: the difference of two flows is small by
    accident, up to eightfold as a rule, all three are not. So the largest; where they fall as those of a smooth flow of
    high order do, the smallest.
    """
    near, far = fine - coarse, fine - coarser
    sizes = np.linalg.norm(near), np.linalg.norm(far)
    if sizes[1] >= REGULAR * sizes[0] and np.vdot(near, far).real >= ALIGNED * sizes[0] * sizes[1]:
        return near
    return max(near, far, coarse - coarser, key=np.linalg.norm)


@one_thread
def product_multipliers(factors: Parameter) -> Inexact[np.ndarray, " n"]:
    """Eigenvalues of the product M_m ... M_1 from its factors, small ones kept beside large ones.

    The product itself loses every multiplier below eps times the largest. The cyclic matrix with the factors below its
    diagonal has the m-th roots, whose range is the m-th root of the product's: what is lost is what falls below eps
    times the largest within one factor, so that the more factors, the better.

    **Arguments:** `factors`: (m, N, N), the first applied first. **Returns:** (N,), the largest modulus first.
    """
    factors = [np.asarray(factor) for factor in factors]
    roots = np.linalg.eigvals(_cyclic(factors))
    roots = roots[np.argsort(-np.abs(roots))]
    m = len(factors)
    return np.array([(roots[copies] ** m).mean() for copies in _copies(roots, m)])


def product_spectrum(fine: list, coarse: list, coarser: list, *, moved: Scalar = 0.0) -> tuple:
    """`spectrum` of the product M_m ... M_1 by way of its cyclic matrix: what it keeps, see `product_multipliers`."""
    roots, vectors, error = spectrum(_cyclic(fine), _cyclic(coarse), _cyclic(coarser), moved=moved)
    m, size = len(fine), len(fine[0])
    copies = _copies(roots, m)
    values = np.array([(roots[c] ** m).mean() for c in copies])
    errors = np.array([(m * np.abs(roots[c]) ** (m - 1) * error[c]).max() for c in copies])
    # the first block of the cyclic matrix's eigenvector is one of the product
    vectors = np.stack([vectors[:size, c[0]] for c in copies], axis=-1)
    return values, vectors / np.linalg.norm(vectors, axis=0), errors


def _cyclic(factors):
    factors = np.asarray(factors)
    m, size, _ = factors.shape
    cyclic = np.zeros((m, size, m, size))
    for i, factor in enumerate(factors):
        cyclic[(i + 1) % m, :, i] = factor
    return cyclic.reshape(m * size, m * size)


def _copies(roots, m):
    """Each multiplier stands m times among the m-th powers of the roots: the indices of its copies."""
    values, left, found = roots**m, np.arange(len(roots)), []
    while len(left):
        near = np.argsort(np.abs(values[left] - values[left[0]]), kind="stable")[:m]
        found.append(left[near])
        left = np.delete(left, near)
    return found


@one_thread
def reversible_multipliers(
    half: Map, coarse: Map | None = None, coarser: Map | None = None
) -> tuple:
    r"""Multipliers of a time-reversible orbit from the tangent map of half a period between rests, with errors.

    With half = [[A, B], [C, D]] over (u, p = m v) symplectic and the reversal R, M = R half^{-1} R half has
    (M + M^{-1})/2 = diag(1 + 2 B^T C, 1 + 2 C^T B), so the n numbers (rho + 1/rho)/2 are the eigenvalues of
    1 + 2 B^T C. They are simple where the multipliers are double (at +-1), and carry no square root of the error.

    **Returns:** half-traces mu (n,), multipliers rho (2n,), the largest modulus first, and the error of each rho.
    """
    half, coarse, coarser = (None if x is None else np.asarray(x) for x in (half, coarse, coarser))
    n = len(half) // 2
    stiff = lambda h: np.eye(n) + 2 * h[:n, n:].T @ h[n:, :n]
    mu, _, error = spectrum(
        stiff(half), *(None if h is None else stiff(h) for h in (coarse, coarser))
    )
    root = np.sqrt(mu.astype(complex) ** 2 - 1)
    rho = mu + np.where(np.real(np.conj(mu) * root) >= 0, root, -root)
    spread = error * np.abs(rho) / np.maximum(np.abs(root), np.sqrt(2 * error))
    rho, spread = (
        np.concatenate([rho, 1 / rho]),
        np.concatenate([spread, spread / np.abs(rho) ** 2]),
    )
    order = np.argsort(-np.abs(rho), kind="stable")
    return mu, rho[order], spread[order]
