"""Displacements inside a Nystrom step, from forces that the step has evaluated anyway.

The position at the fraction c of a step is u0 + c h v0 + h^2 sum w_j(c) k_j. The weights w satisfy
as many order conditions as the stages allow and make the next ones small. Dense output starts from
the forces at such positions.

The error of such a position is a sum over *trees*, vectors x over the stages, of
(w . x) h^(2 + grade). Trees are the powers c^g/g!, for which w . x should be c^(g+2)/(g+2)!, and
products of powers of c with the errors of the stages' own positions, for which it should be zero.
The error of a stage's position is the quadrature error of a power, or A times a tree of the second
kind.
"""

from math import factorial

import numpy as np

# the size of a tree's entry, over the tree's scale, up to which it is rounding and set to zero
ROUNDING = 1e-13
# the h omega at which the conditions beyond those that hold are made small
STEP = 1.5
# the number of these further grades
FURTHER = 4


def weights(A: np.ndarray, c: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    r"""Return the weights w, one row per node.

    `A`, `c`: the stages. The order conditions hold up to the highest possible grade. The remaining
    freedom makes those of the next grades small, in the least-squares sense.
    """
    import scipy.linalg

    found = None
    grade = 0
    while True:
        _, left, right = _conditions(A, c, nodes, grade)
        size = np.abs(left).max(1, keepdims=True)
        size = np.where(size > 0, size, 1)
        left = left / size
        right = right / size
        w = np.linalg.lstsq(left, right, rcond=1e-12)[0]
        if np.abs(left @ w - right).max() > 1e-12:
            break
        found = w
        free = scipy.linalg.null_space(left, rcond=1e-11)
        grade = grade + 1
    if not free.size:
        return found.T
    grades, left, right = _conditions(A, c, nodes, grade + FURTHER - 1)
    size = np.where(grades >= grade, STEP**grades, 0)[:, None]
    left = size * left
    right = size * right
    return (found + free @ np.linalg.lstsq(left @ free, right - left @ found, rcond=None)[0]).T


# the conditions left @ w = right, row by row, with the grades of their trees
def _conditions(A, c, nodes, most):
    rows = [
        (g, x, 0 * nodes if i else _moment(g, nodes))
        for g, trees in enumerate(_trees(A, c, most))
        for i, x in enumerate(trees)
    ]
    return map(np.array, zip(*rows))


def _moment(g, s):
    return s ** (g + 2) / factorial(g + 2)


def _clean(x, scale):
    return np.where(np.abs(x) > ROUNDING * scale, x, 0)


# the trees by grade; the power of c comes first
def _trees(A, c, grades):
    power = [c**g / factorial(g) for g in range(grades + 1)]
    errors = [[] for _ in power]
    products = [[] for _ in power]
    for g in range(2, grades + 1):
        quadrature = _clean(A @ power[g - 2] - _moment(g - 2, c), 1 / factorial(g - 2))
        carried = [_clean(A @ x, np.abs(x).max()) for x in products[g - 2]]
        errors[g] = [x for x in [quadrature, *carried] if np.any(x)]
        for low in range(2, g + 1):
            products[g] += [power[g - low] * d for d in errors[low]]
            products[g] += [
                power[g - low - other] * d * e
                for other in range(low, g - low + 1)
                for d in errors[low]
                for e in errors[other]
            ]
        products[g] = [x for x in products[g] if np.any(x)]
    return [[p, *x] for p, x in zip(power, products)]
