"""`planar_ode`: a planar equation y'' = f(y) for measured waves, and its orbits."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float
from numpy.polynomial import polynomial
from scipy.optimize import minimize_scalar

from ..checks import parameter, refuse, whole
from ..printing import told
from ..results import Result, array
from ..types import Count, Numbers, Parameter, Scalar
from .planar_fit import LEAST, Train, first, fit, growth, split
from .planar_orbits import TABLE, PlanarOrbit, Way

# waves in a window, numbers per unknown; how far beyond the data orbits are looked for, in halves of their range
WAVES, EACH, BEYOND = 1.2, 2, 6.0
REAL, ALIKE, CLOSE = 1e-7, 0.5, 1e-9
# powers of e that trajectories of a window part by
PARTS = 4.0


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
    outcome: str = eqx.field(static=True)
    # f of scaled strains and places: (y - middle)/half, xi/length
    _scaled: Any = eqx.field(kw_only=True, repr=False)
    # G - p^2/2 of the trajectory of each window, in these
    _levels: Any = eqx.field(kw_only=True, repr=False)

    def bend(self, strain: Parameter) -> Float[np.ndarray, "..."]:
        """f at strains of any shape [m]: y'' where there is no drift."""
        middle, half, length, f = self._scaled
        return half / length**2 * polynomial.polyval((np.asarray(strain, float) - middle) / half, f)

    def homoclinic(self) -> PlanarOrbit | None:
        """The orbit that leaves a saddle and comes back to it, around most of the data; `None` where there is none.

        Of an equation with a drift that of the equation without.
        """
        middle, half, _, f = self._scaled
        found = []
        for point in self.equilibria:
            if point.kind == "saddle":
                end = (point.strain - middle) / half
                G = polynomial.polyint(f)
                G[0] -= polynomial.polyval(end, G)
                rest = polynomial.polydiv(polynomial.polydiv(G, [-end, 1.0])[0], [-end, 1.0])[0]
                turns = _real_roots(rest)
                for side in (1, -1):
                    beyond = turns[(turns - end) * side > CLOSE]
                    if beyond.size:
                        found.append((float(beyond[np.argmin(np.abs(beyond - end))]), end))
        # most of the data's range, then the shortest
        found.sort(key=lambda x: (-_overlap(*x), abs(x[0] - x[1])))
        return self._orbit(*found[0], True) if found and _overlap(*found[0]) > 0 else None

    def periodic(self, *, crest: Scalar | None = None, energy: Scalar | None = None) -> PlanarOrbit:
        """The periodic orbit through a crest [m], or of an energy y'^2/2 - int_0^y f [m^2].

        Without either that of the window with the highest crest, by the trajectory that was fitted there.
        **Raises** ValueError where no periodic orbit has it, or for both.
        """
        middle, half, length, f = self._scaled
        if crest is not None and energy is not None:
            refuse("crest, energy", "one of them", "both")
        G = polynomial.polyint(f)
        if crest is not None:
            top = (float(crest) - middle) / half
            level = polynomial.polyval(top, G)
        elif energy is not None:
            level = polynomial.polyval(-middle / half, G) - float(energy) * (length / half) ** 2
        else:
            level = self._levels[self.window[np.argmax(self.strains)]]
        # where p^2/2 = G - level is above zero, between two turns
        roots = _real_roots(polynomial.polysub(G, [level]))
        pairs = [
            (b, a)
            for a, b in zip(roots[:-1], roots[1:])
            if polynomial.polyval((a + b) / 2, G) > level
        ]
        if crest is not None:
            pairs = [(top, a) for b, a in pairs if abs(b - top) < 1e-6 * max(1.0, abs(top))]
        pairs.sort(key=lambda x: -_overlap(*x))
        if not pairs or not polynomial.polyval(pairs[0][0], f) < 0 < polynomial.polyval(
            pairs[0][1], f
        ):
            name, got = ("energy", energy) if crest is None else ("crest", crest)
            refuse(
                name,
                "one of a periodic orbit, between a centre and the homoclinic orbit",
                "that of the data" if got is None else f"{got:g}",
                "See .equilibria.",
            )
        return self._orbit(*pairs[0], False)

    def _orbit(self, start, end, homoclinic):
        middle, half, length, f = self._scaled
        way = Way(f, start, end, homoclinic)
        place = _Placed(way, middle, half, length)
        G = polynomial.polyint(f)
        energy = -((half / length) ** 2) * float(
            polynomial.polyval(end, G) - polynomial.polyval(-middle / half, G)
        )
        decay = (
            float(np.sqrt(polynomial.polyval(end, polynomial.polyder(f)))) / length
            if homoclinic
            else None
        )
        distance, shift = self._distance(place, start > end)
        reach = 12 / decay if homoclinic else way.wavelength * length / 2
        xi = np.linspace(-reach, reach, TABLE)
        high, low = max(start, end) * half + middle, min(start, end) * half + middle
        wavelength = np.inf if homoclinic else way.wavelength * length
        kind = "homoclinic" if homoclinic else "periodic"
        return PlanarOrbit(
            kind,
            high,
            low,
            wavelength,
            energy,
            decay,
            distance,
            shift,
            xi,
            place(xi),
            f"A {kind} orbit, {distance / half:.2g} of half of crest less trough from the measured wave.",
            _way=place,
        )

    def _distance(self, place, up):
        """Rms of the data about their highest crest (or lowest trough) less an orbit, at the best place."""
        best = int(np.argmax(self.strains if up else -self.strains))
        near = (np.abs(self.xi - self.xi[best]) <= self.wavelength / 2) & (
            self.window == self.window[best]
        )
        x, y = self.xi[near], self.strains[near]

        def off(shift):
            return float(np.mean((y - place(x - shift)) ** 2))

        width = self.wavelength / 4
        found = minimize_scalar(
            off,
            bounds=(self.xi[best] - width, self.xi[best] + width),
            method="bounded",
            options={"xatol": 1e-10 * width},
        )
        return float(np.sqrt(found.fun)), float(found.x)


class _Placed:
    """An orbit in the units of the data."""

    def __init__(self, way, middle, half, length):
        self.parts = way, middle, half, length

    def __call__(self, xi):
        way, middle, half, length = self.parts
        return middle + half * way(np.asarray(xi, float) / length)


def _overlap(a, b):
    """How much of [-1, 1] lies between two numbers."""
    return max(0.0, min(max(a, b), 1.0) - max(min(a, b), -1.0))


def _real_roots(p):
    """Real roots of a polynomial near the data, increasing."""
    p = np.trim_zeros(np.asarray(p, float), "b")
    roots = polynomial.polyroots(p) if len(p) > 1 else np.zeros(0)
    roots = np.sort(roots[np.abs(roots.imag) < REAL * np.maximum(1, np.abs(roots))].real)
    slope = polynomial.polyder(p)
    for _ in range(3):
        steep = polynomial.polyval(roots, slope)
        roots = roots - np.where(
            steep != 0, polynomial.polyval(roots, p) / np.where(steep != 0, steep, 1.0), 0.0
        )
    return roots[np.abs(roots) < BEYOND]


def planar_ode(
    xi: Parameter | Sequence[Numbers],
    strain: Parameter | Sequence[Numbers],
    *,
    degree: Count = 3,
    windows: Count | None = None,
    drift: bool = False,
) -> PlanarODE:
    r"""A planar equation y'' = f(y), f a polynomial, fitted to a travelling wave or to the interior of a shock.

    A first guess comes from the equation in weak form, int y phi'' = int f(y) phi, which needs no derivative of data;
    then the trajectories of the equation are fitted, in windows of about one wave that share f and have starts of
    their own: least squares, exact of data that obey such an equation, with error bars of independent errors of one
    size, widened where residuals of neighbouring points are alike.

    **Arguments:**

    - `xi`, `strain`: places n - c t, increasing, and strains (P,) there, of contacts or of anything else that
      oscillates; or lists of several trains, rows of a table too. Five points a wave or more, evenly spaced or not.
    - `degree`: of f; 2 is the equation of waves of Korteweg and de Vries. Compare `misfit` of several.
    - `windows`: of each train; more of them where the wave is modulated, as in a shock, where each has a mean and
      an amplitude of its own. `drift`: whether a term g y' is fitted too, for waves that grow or decay slowly.

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
    scaled = [Train((x - x[0]) / length, (y - middle) / half) for x, y in trains]
    count = None if windows is None else whole("windows", windows, 1)
    if count is None:
        # the longer a trajectory runs beside a saddle, the less its start says of its end
        guess = first(scaled, degree, drift)
        counts = [
            max(train.x[-1] / (2 * np.pi * WAVES), growth(train, guess, degree) / PARTS)
            for train in scaled
        ]
        counts = [
            min(max(1, int(np.ceil(n - CLOSE))), max(1, len(train.x) // LEAST))
            for n, train in zip(counts, scaled)
        ]
    pieces = [
        piece
        for train, n in zip(scaled, counts if count is None else [count] * len(scaled))
        for piece in split(train, n)
    ]
    unknown, points = degree + 1 + drift + 2 * len(pieces), len(everything)
    if points < EACH * unknown or min(len(piece.x) for piece in pieces) < 5:
        refuse(
            "xi",
            f"{EACH * unknown} points or more, {EACH} for each of {unknown} unknowns, and five in a window",
            f"{points} in {len(pieces)} windows",
            "Lower the degree, or take fewer windows.",
        )
    found = fit(pieces, degree, drift)
    return _recorded(trains, pieces, found, degree, drift, (middle, half, length))


def _trains(xi, strain):
    """Pairs of places and strains."""

    def several(x):
        if hasattr(x, "ndim") or not isinstance(x, Sequence):
            return np.ndim(x) == 2
        return any(np.ndim(part) for part in x)

    both = several(xi), several(strain)
    if both[0] != both[1] or both[0] and len(xi) != len(strain):
        refuse(
            "xi and strain", "one train, or as many trains of both", f"{len(xi)} and {len(strain)}"
        )
    pairs = list(zip(xi, strain)) if both[0] else [(xi, strain)]
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
    ends = np.cumsum([0] + [len(piece.x) for piece in pieces])
    window = np.repeat(np.arange(len(pieces)), np.diff(ends))
    alike = _correlation(found.residual, window)
    wider = (1 + max(alike, 0.0)) / max(1 - max(alike, 0.0), 1 / points)
    widths = np.sqrt((found.jacobian**2).sum(0))
    _, s, V = np.linalg.svd(found.jacobian / widths, full_matrices=False)
    factor = (V.T / s)[: shared + drift] * noise * np.sqrt(wider) / widths[: shared + drift, None]
    f = found.coefficients[:shared]
    # powers of (y - middle)/half as those of y
    shift = np.zeros((shared, shared))
    for k in range(shared):
        shift[: k + 1, k] = polynomial.polypow([-middle / half, 1 / half], k) if k else [1.0]
    shift *= half / length**2
    factor_y = shift @ factor[:shared]
    covariance = factor_y @ factor_y.T
    y = np.concatenate([y for _, y in trains])
    roots = _real_roots(f)
    slopes = polynomial.polyval(roots, polynomial.polyder(f))
    equilibria = tuple(
        Equilibrium(
            float(middle + half * z),
            "saddle" if k > 0 else "centre",
            float(np.sqrt(abs(k)) / length),
        )
        for z, k in zip(roots, slopes)
    )
    words = [f"Fitted to {noise:.1e} of half of crest less trough, in {len(pieces)} windows."]
    if not found.settled:
        words.append("The least squares had not settled: another degree or more windows may help.")
    if alike > ALIKE and noise > CLOSE:
        words.append("The residuals are no noise but what such an equation leaves out.")
    return PlanarODE(
        shift @ f,
        np.sqrt(np.diag(covariance)),
        covariance,
        float(found.coefficients[shared] / length) if drift else None,
        float(np.sqrt(factor[shared] @ factor[shared]) / length) if drift else None,
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
        " ".join(words),
        _scaled=(middle, half, length, f),
        _levels=polynomial.polyval(found.starts[0], polynomial.polyint(f))
        - found.starts[1] ** 2 / 2,
    )


def _correlation(residual, window):
    """Of neighbouring residuals within a window."""
    same = window[1:] == window[:-1]
    power = np.mean(residual**2)
    return float(np.mean(residual[1:][same] * residual[:-1][same]) / power) if power > 0 else 0.0
