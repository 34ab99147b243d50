"""What Floquet theory says of one periodic orbit."""

import equinox as eqx
import numpy as np

STABLE, UNSTABLE, UNDECIDED = "stable", "unstable", "undecided"
RESOLUTION = 1e-4


class Floquet(eqx.Module):
    r"""Stability of a T-periodic orbit: a perturbation obeys V(t + T) = M V(t).

    **Fields:**

    - `monodromy`: M, (2n, 2n), over the raveled (u, v). `multipliers`: its eigenvalues rho (2n,), the largest
      modulus first; `vectors`: eigenvectors in columns, of norm 1.
    - `error`: of each multiplier, from two step sizes and its condition number; it grows like a square root where
      multipliers meet, as those at +1 do. Of the flow alone: the error of the orbit is not in it.
    - `krein`: signature +1, -1, or 0 off the circle and for those of symmetry (NaN for a flow without masses).
    - `defect`: max |M^T J M - exp(-gamma T) J|, relative; it is blind to time errors. `step_error`: max |M - M_coarse|.
    - `expected`: how many multipliers symmetry puts at +1; these are left out of the verdict.
    - `verdict`: "stable", "unstable" or "undecided"; `outcome` says why.
    - `period`, `steps`, `state`, `rate` (of uniform damping: multipliers pair as rho rho' = exp(-gamma T)).
    """

    monodromy: np.ndarray
    multipliers: np.ndarray
    vectors: np.ndarray
    error: np.ndarray
    krein: np.ndarray
    defect: float
    step_error: float
    expected: int
    verdict: str
    outcome: str
    period: float
    steps: int
    rate: float | None
    state: object

    @property
    def exponents(self):
        """log(rho)/T; a positive real part is a growth rate."""
        return np.log(self.multipliers.astype(complex)) / self.period

    @property
    def displacements(self):
        """u-parts of the eigenvectors, (n, 2n)."""
        return self.vectors[: len(self.vectors) // 2]

    @property
    def velocities(self):
        """v-parts of the eigenvectors, (n, 2n)."""
        return self.vectors[len(self.vectors) // 2 :]

    @property
    def unstable(self):
        """Indices of the multipliers that lie outside the unit circle by more than their error."""
        return np.flatnonzero(np.abs(self.multipliers) - 1 > self.error)


def decide(multipliers, error, expected, conserves, resolution=RESOLUTION):
    """(verdict, sentence) from multipliers and their errors.

    The `expected` ones nearest to +1 are left out. Unstable: one lies outside the circle by more than its error.
    Undecided: an error above `resolution` could hide such a one. Stable: neither; in a conservative lattice every
    multiplier then lies on the circle within its error, in a damped one inside.
    """
    rest = np.delete(np.arange(len(multipliers)), np.argsort(np.abs(multipliers - 1))[:expected])
    left_out = f" {expected} multipliers at +1 are those of symmetry." if expected else ""
    if not len(rest):
        return STABLE, "Nothing but symmetries." + left_out
    excess, error = np.abs(multipliers[rest]) - 1, error[rest]
    outside = excess > error
    if outside.any():
        i = np.argmax(np.where(outside, excess, -np.inf))
        rho = multipliers[rest][i]
        kind = "real" if abs(rho.imag) <= error[i] else "complex"
        direction = " (period doubling)" if kind == "real" and rho.real < 0 else ""
        size = f"{abs(rho):.6g} +- {error[i]:.1e}"
        return UNSTABLE, f"A {kind} multiplier{direction} of modulus {size} lies outside the unit circle.{left_out}"
    doubtful = (excess + error > resolution) if conserves else (excess + error > 0)
    if doubtful.any():
        i = np.argmax(np.where(doubtful, excess + error, -np.inf))
        return UNDECIDED, (f"A multiplier of modulus {abs(multipliers[rest][i]):.6g} is known to {error[i]:.1e} only: "
                           f"smaller steps would tell.{left_out}")
    if conserves:
        return STABLE, f"Every multiplier is on the unit circle, to {error.max():.1e}.{left_out}"
    return STABLE, f"Every multiplier is inside the unit circle, by {-(excess + error).max():.1e} at least.{left_out}"
