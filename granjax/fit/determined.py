"""Directions in parameter space that the data determine or do not, and sentences about them."""

import itertools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from ..base.printing import told
from ..base.programs import compiled
from ..base.types import AnyArray, Numbers
from .problem import Problem

# A combination with a relative deviation above this counts as not determined.
LOOSE = 0.3
# A parameter takes part in a direction if its component, relative to the largest, exceeds this.
PART = 0.2
# A singular value counts as zero below this part of the largest, times the larger dimension of the
# Jacobian.
SINGULAR = 1e-14
# the most names that one sentence lists
MANY = 6


class Direction(NamedTuple):
    """A combination of parameters, prod theta_i^{w_i}, and its relative standard deviation.

    - `weights` (P,): a unit vector in d theta_i/size_i (d log theta_i if the size is theta_i).
    - `deviation`: the standard deviation along it; infinite if the data do not see it.
    """

    weights: np.ndarray
    deviation: float
    __repr__ = told

    def words(self, names: Sequence[str]) -> str:
        """Return the combination as a product of powers of its parameters."""
        powers = self.weights / np.abs(self.weights).max()
        shown = np.flatnonzero(np.abs(powers) > 0.05)
        powers = np.sign(powers[shown[0]]) * powers
        if len(shown) > MANY:
            shown = shown[np.argsort(-np.abs(powers[shown]))[:MANY]]
        power = lambda w: "" if abs(w - 1) < 0.005 else f"^{w:.2f}"
        return " ".join(names[i] + power(powers[i]) for i in shown)


def directions(
    jacobian: Float[AnyArray, "n P"],
    sizes: Float[AnyArray, " P"],
    noise: float = 1.0,
) -> list[Direction]:
    """Return the principal directions of the Fisher information, the least known first.

    **Arguments:** `jacobian` (n, P): of the residuals with respect to the parameters; `sizes` (P,):
    what relative changes refer to; `noise`: standard deviation of the residuals.
    """
    scaled = np.asarray(jacobian) * np.asarray(sizes)
    _, s, vh = np.linalg.svd(scaled, full_matrices=scaled.shape[0] < scaled.shape[1])
    s = np.concatenate([s, np.zeros(vh.shape[0] - s.size)])
    s = np.where(s > SINGULAR * s.max(initial=0.0) * max(scaled.shape), s, 0.0)
    with np.errstate(divide="ignore"):
        return [Direction(vector, float(noise / size)) for vector, size in zip(vh[::-1], s[::-1])]


def covariance(
    found: Sequence[Direction], sizes: Float[AnyArray, " P"]
) -> Float[np.ndarray, "P P"]:
    """Return the covariance of the parameters (P, P); infinite for those in unseen directions."""
    weights, deviations, seen = _arrays(found)
    columns = deviations[seen] * weights[seen].T
    total = columns @ columns.T
    blind = np.any(np.abs(weights[~seen]) > 1e-6, axis=0)
    total[blind, blind] = np.inf
    return total * np.outer(sizes, sizes)


def _arrays(found):
    # The weights and deviations of directions, and which of these are finite.
    weights, deviations = map(np.array, zip(*found))
    return weights, deviations, np.isfinite(deviations)


def sentences(
    found: Sequence[Direction], names: Sequence[str], quantities: Sequence[tuple]
) -> tuple[str, ...]:
    """Describe undetermined parameters, and what is known instead; empty if there are none."""
    loose = [direction for direction in found if not direction.deviation <= LOOSE]
    if not loose:
        return ()
    unseen = [direction.weights for direction in loose if np.isinf(direction.deviation)]
    if unseen:
        loose[: len(unseen)] = [Direction(weights, np.inf) for weights in _simplest(unseen)]
    said = []
    for direction in loose:
        taking = listed(names, _taking(direction))
        several = np.sum(_taking(direction)) > 1
        what = f"the direction {direction.words(names)}" if several else taking
        how = f"only to {_percent(direction.deviation)}"
        said.append(
            f"The data do not determine {taking}{' apart' if several else ''}: "
            f"{what} is known {'not at all' if np.isinf(direction.deviation) else how}."
        )
    involved = np.any([_taking(direction) for direction in loose], axis=0)
    known = [
        (name, along(found, gradient))
        for name, gradient in quantities
        if np.any(np.abs(gradient[involved]) > 1e-6 * np.abs(gradient).max(initial=0.0))
    ]
    known = [one for one in known if one[1] < LOOSE / 3]
    if not known:
        firm = [d for d in found if d.deviation <= LOOSE and np.sum(_taking(d)[involved]) > 1]
        known = [(d.words(names), d.deviation) for d in firm[::-1][:2]]
    said += [f"They determine {what} to {_percent(deviation)}." for what, deviation in known]
    return tuple(said)


def quantities(
    problem: Problem,
    parameters: dict[str, Numbers],
    flat: Float[AnyArray, " P"],
    sizes: Float[AnyArray, " P"],
) -> list[tuple[str, Float[np.ndarray, " P"]]]:
    """Return (name, gradient (P,)) of the linear stiffness of each bond law.

    The gradient is that of its logarithm with respect to relative changes of the parameters.
    """
    laws = []
    found = []
    # Tracing gives the laws' static properties without computing anything.
    jax.eval_shape(lambda p: laws.extend(_bonds(problem, p)), parameters)
    for (i, law), value, gradient in zip(laws, *map(np.asarray, _stiffnesses(problem, flat))):
        if value > 0 and np.isfinite([value, *gradient]).all():
            formula = "K2" if law.power_law is None else "A p d0^(p-1)"
            name = f"the linear stiffness {formula} of terms[{i}] ({type(law).__name__})"
            found.append((name, gradient * sizes / value))
    return found


def _bonds(problem, parameters):
    # (index of the term, law) of all bond laws at t0
    lattice = problem.scene(parameters)
    return [
        (i, c.law)
        for i, term in enumerate(lattice.terms)
        for c in term.compressions(problem.t0, lattice.zeros())
        if c.place == "bond"
    ]


@compiled
def _stiffnesses(problem, flat):
    def every(flat):
        laws = _bonds(problem, problem.coordinates.unflat(flat))
        return jnp.array(
            [jnp.mean(jnp.abs(law.derivative(jnp.zeros_like(flat[0])))) for _, law in laws]
        )

    return every(flat), jax.jacfwd(every)(flat)


def along(found: Sequence[Direction], gradient: Float[AnyArray, " P"]) -> float:
    """Return the standard deviation of a quantity, from its gradient in relative parameters (P,).

    It sums over directions: in the covariance, large variances would have to cancel.
    """
    weights, deviations, seen = _arrays(found)
    shares = np.abs(weights @ gradient)
    if np.any(shares[~seen] > 1e-6 * np.linalg.norm(gradient)):
        return np.inf
    return float(np.linalg.norm(deviations[seen] * shares[seen]))


def _simplest(directions):
    # A sparse basis of the same space: each vector alone has one of the leading parameters.
    _, rows, order = scipy.linalg.qr(np.array(directions), mode="economic", pivoting=True)
    basis = np.zeros(rows.shape)
    basis[:, order] = np.linalg.solve(rows[:, : len(rows)], rows)
    return basis


def _taking(direction):
    size = np.abs(direction.weights)
    return size > PART * size.max()


def _percent(x):
    return f"{100 * x:.2g} %" if x < 1 else f"a factor of {1 + x:.2g}"


def listed(names: Sequence[str], which: Iterable) -> str:
    """Return some of the names as words, "a, b and c"; "" for none."""
    chosen = list(itertools.compress(names, which))
    if len(chosen) > MANY:
        chosen[MANY - 1 :] = [f"{len(chosen) - MANY + 1} more"]
    return " and ".join(filter(None, (", ".join(chosen[:-1]), *chosen[-1:])))
