"""`planar_ode`: a planar equation y'' = f(y) for measured waves, and its orbits."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float
from numpy.polynomial import Polynomial, polynomial

from ..checks import parameter, refuse, whole
from ..fit.determined import covariance, directions
from ..printing import told
from ..results import Result, array
from ..types import Count, Numbers, Parameter, Scalar
from .planar_fit import fitted
from .planar_orbits import TABLE, PlanarOrbit, Way

# points for each unknown
EACH = 2
# how far from the middle of the data orbits are looked for, in halves of their range
BEYOND = 6.0
# of a root, the imaginary part that rounding makes of none
REAL = 1e-7
# correlation of neighbouring residuals from which on they are said to be no noise
ALIKE = 0.5
# a share of the data's range that rounding makes of none
CLOSE = 1e-9


class Equilibrium(NamedTuple):
    """A strain at which f = 0: a "saddle" (f' > 0) or a "centre", and the rate or wave number |f'|^{1/2}."""

    strain: float
    kind: str
    rate: float
    __repr__ = told


class PlanarODE(Result):
    """What `planar_ode` returns: y'' = f(y) + drift y', f = sum c_k y^k.

    `homoclinic()` and `periodic()` give orbits.
    """

    coefficients: Float[np.ndarray, " power"] = array("The coefficients c_k, in m^(1-k).")
    errors: Float[np.ndarray, " power"] = array("Standard errors of the coefficients.")
    covariance: Float[np.ndarray, "power power_"] = array("The covariance of the coefficients.")
    drift: float | None = array("The drift, `None` where none was asked for.")
    drift_error: float | None = array("The standard error of the drift.")
    misfit: float = array(
        "The rms of the data less the fitted trajectories, per degree of freedom.", "m"
    )
    misfit_error: float = array("The standard error of the misfit.", "m")
    correlation: float = array(
        "The correlation of neighbouring residuals, near 0 for noise, near 1 where the "
        "equation is a model."
    )
    equilibria: tuple[Equilibrium, ...] = array(
        "The equilibria of the equation.", axes="equilibrium"
    )
    crest: float = array("The highest strain of the data.", "m")
    trough: float = array("The lowest strain of the data.", "m")
    wavelength: float = array("The wavelength of the data.")
    xi: Float[np.ndarray, " point"] = array("The places of the data.", "1")
    strains: Float[np.ndarray, " point"] = array("The strains of the data.", "m")
    fitted: Float[np.ndarray, " point"] = array("The fitted strains.", "m")
    slopes: Float[np.ndarray, " point"] = array("The slope y' of the fitted strains.", "m")
    window: np.ndarray = array("The window that each point belongs to.", axes="point")
    settled: bool = array("Whether the least squares had settled.")
    # f, with powers of (y - middle)/half
    _f: Any = eqx.field(kw_only=True, repr=False)

    @property
    def outcome(self) -> str:
        """What became of it, in sentences."""
        misfit = 2 * self.misfit / (self.crest - self.trough)
        said = [
            f"Fitted to {misfit:.1e} of half of crest less trough, in {self.window.max() + 1} windows."
        ]
        if not self.settled:
            said.append("The least squares had not settled: another degree may help.")
        if self.correlation > ALIKE and misfit > CLOSE:
            said.append("The residuals are no noise but what such an equation leaves out.")
        return " ".join(said)

    def bend(self, strain: Parameter) -> Float[np.ndarray, "..."]:
        """f at strains of any shape [m]: y'' where there is no drift."""
        return self._f(np.asarray(strain, float))

    def homoclinic(self) -> PlanarOrbit | None:
        """The orbit that leaves a saddle and comes back to it, around most of the data; `None` where there is none.

        Of an equation with a drift that of the equation without.
        """
        G, found = self._f.integ(), []
        for end in (point.strain for point in self.equilibria if point.kind == "saddle"):
            double = Polynomial.fromroots([end, end], domain=self._f.domain)
            turns = _real_roots((G - G(end)) // double)
            for side in (1, -1):
                beyond = turns[(turns - end) * side > CLOSE * (self.crest - self.trough)]
                if beyond.size:
                    found.append((float(beyond[np.argmin(np.abs(beyond - end))]), end))
        # most of the data's range, then the shortest
        found.sort(key=lambda x: (-self._overlap(*x), abs(x[0] - x[1])))
        return self._orbit(*found[0], True) if found and self._overlap(*found[0]) > 0 else None

    def periodic(self, *, crest: Scalar | None = None, energy: Scalar | None = None) -> PlanarOrbit:
        """The periodic orbit through a crest [m], or of an energy y'^2/2 - int_0^y f [m^2].

        Without either that of the window with the highest crest, by the trajectory that was fitted there.
        **Raises** ValueError where no periodic orbit has it, or for both.
        """
        if crest is not None and energy is not None:
            refuse("crest, energy", "one of them", "both")
        G = self._f.integ()
        if crest is not None:
            level = G(float(crest))
        elif energy is not None:
            level = G(0.0) - float(energy)
        else:
            k = np.argmax(self.window == self.window[np.argmax(self.strains)])
            level = G(self.fitted[k]) - self.slopes[k] ** 2 / 2
        # where y'^2/2 = G - level is above zero, between two turns
        roots = _real_roots(G - level)
        pairs = [(b, a) for a, b in zip(roots[:-1], roots[1:]) if G((a + b) / 2) > level]
        if crest is not None:
            near = 1e-6 * (self.crest - self.trough)
            pairs = [(float(crest), a) for b, a in pairs if abs(b - float(crest)) < near]
        pairs.sort(key=lambda x: -self._overlap(*x))
        if not pairs or not self._f(pairs[0][0]) < 0 < self._f(pairs[0][1]):
            name, got = ("energy", energy) if crest is None else ("crest", crest)
            refuse(
                name,
                "one of a periodic orbit, between a centre and the homoclinic orbit",
                "that of the data" if got is None else f"{got:g}",
                "See .equilibria.",
            )
        return self._orbit(*pairs[0], False)

    def _orbit(self, start, end, homoclinic):
        way, G = Way(self._f, start, end, homoclinic), self._f.integ()
        decay = float(np.sqrt(self._f.deriv()(end))) if homoclinic else None
        reach = 12 / decay if homoclinic else way.wavelength / 2
        xi = np.linspace(-reach, reach, TABLE)
        kind = "homoclinic" if homoclinic else "periodic"
        return PlanarOrbit(
            kind,
            max(start, end),
            min(start, end),
            np.inf if homoclinic else way.wavelength,
            float(G(0.0) - G(end)),
            decay,
            xi,
            way(xi),
            _way=way,
        )

    def _overlap(self, a, b):
        """How much of the data's range lies between two strains."""
        return max(0.0, min(max(a, b), self.crest) - max(min(a, b), self.trough))


def _real_roots(p):
    """Real roots of a polynomial near the data, increasing."""
    p = p.trim()
    z = polynomial.polyroots(p.coef)
    z = z[np.abs(z.imag) < REAL * np.maximum(1, np.abs(z))].real
    offset, scale = p.mapparms()
    roots, slope = (np.sort(z[np.abs(z) < BEYOND]) - offset) / scale, p.deriv()
    for _ in range(3):
        steep = slope(roots)
        roots = roots - np.divide(p(roots), steep, out=np.zeros_like(roots), where=steep != 0)
    return roots


def planar_ode(
    xi: Parameter | Sequence[Numbers],
    strain: Parameter | Sequence[Numbers],
    *,
    degree: Count = 3,
    drift: bool = False,
) -> PlanarODE:
    r"""A planar equation y'' = f(y), f a polynomial, fitted to a travelling wave or to the interior of a shock.

    The trajectories of the equation are fitted by least squares: first in short pieces, whose equation is found from
    that of a harmonic oscillation, then in windows of about one wave that share f and have starts of their own. The
    fit is exact for data that obey such an equation. Its error bars are those of independent errors of one size, wider
    where residuals of neighbouring points are alike.

    **Arguments:**

    - `xi`, `strain`: places n - c t, increasing, and strains (P,) there, of contacts or of anything else that
      oscillates; or lists of several trains, rows of a table too. Five points a wave or more, evenly spaced or not.
    - `degree`: of f; 2 is the equation of waves of Korteweg and de Vries. Compare `misfit` of several.
    - `drift`: whether a term g y' is fitted too, for waves that grow or decay slowly.

    **Returns:** `PlanarODE`, which does not differ between units: of a y and b xi it is that of y and xi, converted.
    It is not differentiated.

        wave = gx.travelling.periodic_wave(gx.Toda(), 8.0, amplitude=0.2)
        found = gx.identify.planar_ode(wave.xi, wave.strains, degree=4)
        print(found, found.homoclinic(), found.periodic(crest=0.2))

    **Raises** ValueError for data that do not rise and fall, too few points, places that do not increase.
    Source: C. Chong, M. Herrmann, P. G. Kevrekidis, Physica D 442, 133533 (2022).

    **Example:**

    >>> xi = np.linspace(-6.0, 6.0, 61)
    >>> found = gx.identify.planar_ode(xi, 1.5 / np.cosh(xi / 2) ** 2, degree=2)
    >>> found.coefficients[1:].round(4).tolist()  # y'' = y - y^2
    [1.0, -1.0]
    """
    degree = whole("degree", degree, 1)
    trains = _trains(xi, strain)
    everything = np.concatenate([y for _, y in trains])
    middle, half = (everything.max() + everything.min()) / 2, np.ptp(everything) / 2
    if not half > CLOSE * np.abs(everything).max():
        refuse("strain", "numbers that oscillate", "ones that are all alike")
    length = _wavelength(trains, middle) / (2 * np.pi)
    scaled = [((x - x[0]) / length, (y - middle) / half) for x, y in trains]
    pieces, found = fitted(scaled, degree, drift)
    unknown, points = degree + 1 + drift + 2 * len(pieces), len(everything)
    if points < EACH * unknown or min(map(len, pieces)) < 5:
        refuse(
            "xi",
            f"{EACH * unknown} points or more, {EACH} for each of {unknown} unknowns, and five in a window",
            f"{points} in {len(pieces)} windows",
            "Lower the degree.",
        )
    return _recorded(trains, pieces, found, degree, drift, (middle, half, length))


def _trains(xi, strain):
    """Pairs of places and strains."""
    pairs = [(xi, strain)] if np.ndim(xi[0]) == 0 else list(zip(xi, strain, strict=True))
    found = []
    for x, y in pairs:
        x, y = np.asarray(parameter("xi", x)), np.asarray(parameter("strain", y))
        if x.ndim != 1 or x.shape != y.shape or len(x) < 5:
            refuse(
                "xi and strain",
                "as many places as strains, five or more",
                f"shapes {x.shape} and {y.shape}",
            )
        if not (np.diff(x) > 0).all():
            refuse(
                "xi", "places that increase", "some that do not", "Sort them, with their strains."
            )
        found.append((x, y))
    return found


def _wavelength(trains, middle):
    """Mean distance of the places at which the strain rises through the middle, or twice the width of one hump."""
    gaps, widths = [], []
    for x, y in trains:
        k = np.flatnonzero(np.diff(y > middle))
        if len(k) < 2:
            continue
        at = x[k] + (middle - y[k]) / (y[k + 1] - y[k]) * (x[k + 1] - x[k])
        gaps += list(at[2:] - at[:-2])
        widths += list(np.diff(at))
    if not widths:
        refuse(
            "strain",
            "numbers that rise and fall through the middle of their range",
            "ones that do not",
            "Give one crest or trough at least, with what is to both sides of it.",
        )
    return float(np.mean(gaps)) if gaps else 2 * float(np.mean(widths))


def _recorded(trains, pieces, found, degree, drift, scales):
    middle, half, length = scales
    shared = degree + 1
    points, unknown = found.jacobian.shape
    free = points - unknown
    noise = np.sqrt(found.residual @ found.residual / free)
    window = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
    alike = _correlation(found.residual, window)
    wider = (1 + max(alike, 0.0)) / max(1 - max(alike, 0.0), 1 / points)
    widths = np.linalg.norm(found.jacobian, axis=0)
    known = directions(found.jacobian, 1 / widths, noise * np.sqrt(wider))
    matrix = covariance(known, 1 / widths)
    f = found.coefficients[:shared]
    # powers of (y - middle)/half as those of y
    shift = np.zeros((shared, shared))
    for k in range(shared):
        shift[: k + 1, k] = polynomial.polypow([-middle / half, 1 / half], k) if k else [1.0]
    shift *= half / length**2
    matrix_y = shift @ matrix[:shared, :shared] @ shift.T
    y = np.concatenate([y for _, y in trains])
    bend = Polynomial(f * half / length**2, domain=[middle - half, middle + half])
    roots = _real_roots(bend)
    equilibria = tuple(
        Equilibrium(float(z), "saddle" if k > 0 else "centre", float(np.sqrt(abs(k))))
        for z, k in zip(roots, bend.deriv()(roots))
    )
    return PlanarODE(
        shift @ f,
        np.sqrt(np.diag(matrix_y)),
        matrix_y,
        float(found.coefficients[shared] / length) if drift else None,
        float(np.sqrt(matrix[shared, shared]) / length) if drift else None,
        float(noise * half),
        float(noise * half * np.sqrt(wider / (2 * free))),
        alike,
        equilibria,
        float(y.max()),
        float(y.min()),
        2 * np.pi * length,
        np.concatenate([x for x, _ in trains]),
        y,
        y + half * found.residual,
        half / length * found.slopes,
        window,
        found.settled,
        _f=bend,
    )


def _correlation(residual, window):
    """Of neighbouring residuals within a window."""
    same = window[1:] == window[:-1]
    power = np.mean(residual**2)
    return float(np.mean(residual[1:][same] * residual[:-1][same]) / power) if power > 0 else 0.0
