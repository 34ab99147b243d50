"""Orbits of y'' = f(y) for a polynomial f, by y'^2/2 = G(y) - G(end), G' = f, less both ends."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float
from numpy.polynomial import Polynomial
from scipy.integrate import quad, solve_ivp

from ..results import Result, array
from ..types import Parameter

# places of the table that a result holds
TABLE = 513
# relative and absolute error of the integrals
EXACT = 1e-13


class PlanarOrbit(Result):
    """An orbit of a planar equation y'' = f(y), a crest or its trough at xi = 0."""

    kind: str = array('"homoclinic" or "periodic".', static=True)
    crest: float = array(
        "The highest strain; a homoclinic orbit falls to the crest or the trough.", "m"
    )
    trough: float = array("The lowest strain.", "m")
    wavelength: float = array("The wavelength, infinite for a homoclinic orbit.")
    energy: float = array("y'^2/2 - int_0^y f, in m^2.")
    decay: float | None = array("The decay rate of a homoclinic orbit's tail.")
    xi: Float[np.ndarray, " xi"] = array("The places of the table.", "1")
    strains: Float[np.ndarray, " xi"] = array(
        "The strains of the table; `strain(xi)` gives any place.", "m"
    )
    _way: Any = eqx.field(kw_only=True, repr=False)

    @property
    def outcome(self) -> str:
        """What it is, in a sentence."""
        return f"A {self.kind} orbit from {self.trough:.6g} to {self.crest:.6g}."

    def strain(self, xi: Parameter) -> Float[np.ndarray, "..."]:
        """Strain at places xi, of any shape [m]."""
        return self._way(np.asarray(xi, float))


class Way:
    """An orbit as a function of place: y(s), where s(x) solves ds/dx = rate(s) from s = 0.

    A periodic one has y = middle + half cos s, a homoclinic one y = low + height/cosh(s)^2; both rates are smooth.
    """

    def __init__(self, f: Polynomial, start: float, end: float, homoclinic: bool):
        self.start, self.end, self.homoclinic = start, end, homoclinic
        # G(y) - G(end) is -(y - end)(y - start) q on a periodic orbit, -(y - end)^2 (y - start) q on a homoclinic one
        G = f.integ()
        ends = [end, end, start] if homoclinic else [end, start]
        self.q = (G(end) - G) // Polynomial.fromroots(ends, domain=f.domain)
        self.wavelength = np.inf
        if not homoclinic:
            half = quad(lambda s: 1 / self.rate(s), 0, np.pi, epsabs=0, epsrel=EXACT, limit=1000)
            self.wavelength = 2 * half[0]

    def y(self, s: Any) -> Any:
        """Strain by s."""
        if self.homoclinic:
            return self.end + (self.start - self.end) / np.cosh(np.minimum(s, 300)) ** 2
        return (self.start + self.end) / 2 + (self.start - self.end) / 2 * np.cos(s)

    def rate(self, s: Any) -> Any:
        """ds/dx."""
        return np.sqrt(
            2 * self.q(self.y(s)) * ((self.start - self.end) / 4 if self.homoclinic else 1)
        )

    def __call__(self, x: Any) -> Any:
        """Strain by place."""
        x = np.abs(x)
        if not self.homoclinic:
            x = np.abs((x + self.wavelength / 2) % self.wavelength - self.wavelength / 2)
        places, back = np.unique(x, return_inverse=True)
        beyond = places[-1] + 1 / self.rate(0.0)
        how = {"method": "DOP853", "t_eval": places, "rtol": EXACT, "atol": EXACT}
        s = solve_ivp(lambda _, s: self.rate(s), (0, beyond), [0.0], **how).y[0]
        return self.y(s[back]).reshape(np.shape(x))
