"""Orbits of y'' = f(y) for a polynomial f, by quadrature: p^2/2 = G(y) - G(end), G' = f, less both ends."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float
from numpy.polynomial import Polynomial

from ..results import Result, array
from ..types import Parameter

# pieces of half of an orbit
PIECES = 64
# steps of Newton's method for a place
STEPS = 40
# where a homoclinic orbit has come to its end, 1/cosh(s)^2 = 6e-21
END = 24.0
# places of the table that a result holds
TABLE = 513
# nodes and weights of a piece
_T, _W = np.polynomial.legendre.leggauss(16)


class PlanarOrbit(Result):
    """An orbit of a planar equation y'' = f(y), a crest or its trough at xi = 0, beside the measured wave."""

    kind: str = array('"homoclinic" or "periodic".', static=True)
    crest: float = array(
        "The highest strain; a homoclinic orbit falls to the crest or the trough.", "m"
    )
    trough: float = array("The lowest strain.", "m")
    wavelength: float = array("The wavelength, infinite for a homoclinic orbit.")
    energy: float = array("y'^2/2 - int_0^y f, in m^2.")
    decay: float | None = array("The decay rate of a homoclinic orbit's tail.")
    distance: float = array(
        "The rms of the measured wave less the orbit about the highest crest, at the best place.",
        "m",
    )
    shift: float = array("The best place.")
    xi: Float[np.ndarray, " xi"] = array("The places of the table.", "1")
    strains: Float[np.ndarray, " xi"] = array(
        "The strains of the table; `strain(xi)` gives any place.", "m"
    )
    share: float = array("The distance over half of the data's crest less trough.")
    _way: Any = eqx.field(kw_only=True, repr=False)

    @property
    def outcome(self) -> str:
        """What it is, in a sentence."""
        return f"A {self.kind} orbit, {self.share:.2g} of half of crest less trough from the measured wave."

    def strain(self, xi: Parameter) -> Float[np.ndarray, "..."]:
        """Strain at places xi, of any shape [m]."""
        return self._way(np.asarray(xi, float))


class Way:
    """An orbit as a function of place: y(s) at x(s), both known, s by Newton's method.

    A periodic one has y = middle + half cos s, a homoclinic one y = low + height/cosh(s)^2; both s' are smooth.
    """

    def __init__(self, f: Polynomial, start: float, end: float, homoclinic: bool):
        self.start, self.end, self.homoclinic = start, end, homoclinic
        # G(y) - G(end) is -(y - end)(y - start) q on a periodic orbit, -(y - end)^2 (y - start) q on a homoclinic one
        G = f.integ()
        ends = [end, end, start] if homoclinic else [end, start]
        self.q = (G(end) - G) // Polynomial.fromroots(ends, domain=f.domain)
        self.edges = np.linspace(0, END if homoclinic else np.pi, PIECES + 1)
        width = self.edges[1]
        parts = self.rate(self.edges[:-1, None] + width * (1 + _T) / 2) @ _W * width / 2
        self.places = np.append(0.0, np.cumsum(parts))

    def y(self, s: Any) -> Any:
        """Strain by s."""
        if self.homoclinic:
            return self.end + (self.start - self.end) / np.cosh(np.minimum(np.abs(s), 300)) ** 2
        return (self.start + self.end) / 2 + (self.start - self.end) / 2 * np.cos(s)

    def rate(self, s: Any) -> Any:
        """dx/ds."""
        q = 2 * self.q(self.y(s))
        with np.errstate(all="ignore"):
            return 2 / np.sqrt(q * (self.start - self.end)) if self.homoclinic else 1 / np.sqrt(q)

    @property
    def wavelength(self) -> float:
        """Of a periodic orbit."""
        return 2 * float(self.places[-1])

    def __call__(self, x: Any) -> Any:
        """Strain by place."""
        x = np.abs(x)
        if not self.homoclinic:
            x = np.abs((x + self.wavelength / 2) % self.wavelength - self.wavelength / 2)
        k = np.clip(np.searchsorted(self.places, x, "right") - 1, 0, PIECES - 1)
        low, width = self.edges[k], self.edges[1]
        s = low + np.minimum((x - self.places[k]) / self.rate(low), width)
        for _ in range(STEPS):
            half = (s - low) / 2
            over = (
                self.places[k]
                + half * (self.rate(low[..., None] + half[..., None] * (1 + _T)) @ _W)
                - x
            )
            step = over / self.rate(s)
            s = np.clip(s - step, low, low + width)
            if np.abs(step).max(initial=0.0) < 1e-15 * self.edges[-1]:
                break
        if self.homoclinic:
            s = np.where(
                x > self.places[-1], END + (x - self.places[-1]) / self.rate(np.asarray(END)), s
            )
        return self.y(s)
