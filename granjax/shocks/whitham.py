r"""Whitham's modulation equations of any law, solved along the dispersive shock of a velocity step.

Periodic waves phi(theta), theta = k n - omega t, of mean strain y form a family in k, y and the
amplitude a. Slow changes conserve waves, strain, momentum and action (see
`gx.travelling.Averages`):

    k_t + omega_n = 0,   y_t + v_n = 0,   m v_t + <F>_n = 0,   J_t + (-L_k)_n = 0.

In the shock all quantities depend only on s = n/t, so that along it

    d omega = s dk,   dv = s dy,   d<F> = m s dv,   d(-L_k) = s dJ.

At each wave this is an eigenvalue problem for s and the direction in (k, y, a, v); the second
fastest s is that of the shock. The curve is followed from the plateau, a = 0, to k = 0, a solitary
wave that runs into the chain ahead. A shooting method finds the strain and the wave number at its
start from the strain and the velocity ahead.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ..base.checks import refuse, traced
from ..base.tuning import one_thread
from ..base.types import Scalar
from ..lattice import Lattice
from ..laws import Law
from ..profiles import medium_of
from ..profiles.medium import fine_values
from ..profiles.solving import decay_rate
from ..results import Result, array
from ..theory.fitting import shock_edges

# The harmonics of a wave at first.
HARMONICS = 32
# The most harmonics of a wave.
MOST = 512
# The size of the last three harmonics, over the jump, at which their number suffices.
RESOLVED = 1e-13
# The most steps of Newton's method.
STEPS = 8
# The size of its last step, over the jump.
CONVERGED = 1e-13
# The same in units of rounding over the change of the stiffness by the jump: the weaker a shock is,
# the less do the terms of its equations differ.
ROUNDING = 4 * np.finfo(float).eps
# The least change of the speed of sound by the jump. Weaker shocks took minutes, and were not found.
WEAKEST = 2e-4
# The most parts of the way from one wave to the next.
PARTS = 16
# The change of the strain and the wave number at the start, for finite differences.
CHANGE = 1e-5
# The most rounds of the search for these two numbers. Six sufficed in twenty shocks.
ROUNDS = 10
# The largest miss, over the jump, of the strain and the velocity ahead where the search ends.
MET = 3e-9
# The imaginary part of s, over the speed of sound, above which the waves are unstable. It exceeds
# the square root of rounding, by which two equal speeds at an edge may differ.
COMPLEX = 1e-5
# The error over the difference of two curves. In twelve cases of Toda this was at least 0.4 of the
# error.
SAFETY = 4
# The fall of the speed between neighbours of the table, over the range of speeds, that is not
# rounding.
FALLS = 1e-6
# The wave number, over that of the end, whose wave shows what changes from the end on.
NEAR_END = 1.05
# The number of places in the table.
PLACES = 65
# Gauss's implicit method of two stages.
GAUSS = np.array([[1 / 4, 1 / 4 - 3**0.5 / 6], [1 / 4 + 3**0.5 / 6, 1 / 4]])
# The rounds for its stages. Each divides their error by about a hundred.
GAUSS_ROUNDS = 4


class _Means(NamedTuple):
    """The numerical parameters of a curve.

    `first`: (crest - trough)/2 over the jump after the first step from the plateau;
    `tolerance`: of the steps; `steps`: their least number; `overlap`: exp(-q pi/k) of neighbouring
    waves, which fall like exp(-q |n|), at the end.
    """

    first: float
    tolerance: float
    steps: int
    overlap: float


# for the result
FINE = _Means(first=2e-2, tolerance=1e-9, steps=20, overlap=1e-7)
# for the estimate of the error
COARSER = _Means(first=4e-2, tolerance=1e-8, steps=12, overlap=1e-6)


class WhithamShock(Result):
    """The result of `whitham`: the edges, and the waves between plateau and chain ahead."""

    trailing_speed: float = array("The speed of the trailing edge.", "1/s")
    leading_speed: float = array("The speed of the leading edge.", "1/s")
    mean: float = array("The strain of the plateau.", "m")
    amplitude: float = array("The height of the leading wave above the strain ahead.", "m")
    ahead: float = array("The strain of the chain ahead.", "m")
    sound: float = array("The speed of sound ahead.", "1/s")
    error: float = array(
        "The estimated error of both speeds over `sound`, of mean and amplitude over mean - ahead."
    )
    s: Float[np.ndarray, " s"] = array("The speed n/t.", "1/s", "s")
    means: Float[np.ndarray, " s"] = array("The mean strain.", "m", "s")
    crests: Float[np.ndarray, " s"] = array("The largest strain.", "m", "s")
    troughs: Float[np.ndarray, " s"] = array("The smallest strain.", "m", "s")
    wavelengths: Float[np.ndarray, " s"] = array("The wavelength in bonds.", "1", "s")
    omegas: Float[np.ndarray, " s"] = array("The angular frequency.", "rad/s", "s")

    @property
    def amplitudes(self) -> Float[np.ndarray, " s"]:
        """Crest less trough [m]."""
        return self.crests - self.troughs

    @property
    def outcome(self) -> str:
        """The accuracy of the shock, and whether it is a simple wave."""
        told = f"Solved to {self.error:.0e}."
        if np.any(np.diff(self.s) < -FALLS * np.ptp(self.s)):
            told += " The speed does not rise all along the shock, so that this is no solution beyond there."
        return told


@one_thread
def whitham(
    law: Law | Lattice, c: Scalar, mass: Scalar = 1.0, *, ahead: Scalar = 0.0
) -> WhithamShock:
    r"""Find the dispersive shock of v_n = -2c sign(n) by Whitham's equations for any law.

    This is the limit of the shock for large t: the plateau, both edges, and mean, amplitude and
    wavelength between them. For Toda's chain it agrees with the closed form to 1e-8. For other laws
    it is near `theory.shock_edges`, which fits the edges by long and linear waves alone. The
    lattice converges to the numbers found here:

    | Hertz, d0 = 1/2, sound 1 | s_- | fit | measured | mean | fit | simulated |
    |---|---|---|---|---|---|---|
    | c = 0.3 | 0.8286 | 0.7989 | 0.829 | 0.540480 | 0.540692 | 0.540479 |
    | c = 0.5 | 0.7803 | 0.7153 | 0.780 | 0.861419 | 0.862148 | 0.861419 |

    **Arguments:** as of `theory.shock_edges`. **Returns:** `WhithamShock`. Typical: 5 s.
    **Raises** ValueError as `shock_edges`; where the fit has no trailing edge, such as without
    sound ahead; where no shock is found; where modulations grow within it; and for traced numbers
    (it has no derivatives).
    Source: G. B. Whitham, Linear and Nonlinear Waves (1974).

    **Example:**

    >>> found = gx.shocks.whitham(gx.Toda(), 0.5)
    >>> round(found.trailing_speed, 6), round(found.leading_speed, 6), round(found.amplitude, 6)
    (0.5, 1.315191, 1.386294)
    """
    if traced((law, c, mass, ahead)):
        refuse(
            "law, c, mass, ahead",
            "numbers that are known",
            "traced ones",
            "There are no derivatives.",
        )
    ahead = float(ahead)
    c = float(c)
    why = None
    # Strong shocks are reached from weaker ones where the fit is too far off.
    for parts in (1, 2, 4):
        try:
            share = np.ones(2)
            for part in range(1, parts + 1):
                step = _posed(law, c * part / parts, mass, ahead)
                start, slope, found, left = _search(step, step.start * share)
                share = start / step.start
            # The same with coarser parameters, for the error.
            other = _curve(step, start, COARSER)
            other = _curve(step, start - np.linalg.solve(slope, step.missed(other)), COARSER)
            rows = found.rows()
            break
        except _Lost as error:
            why = str(error)
    else:
        refuse("law, c", "a shock that is found", "none", why)
    sound = step.sound
    jump = step.jump
    first, last = found.edges
    s, omegas, k, *strains = np.array([first, *rows, last]).T
    means, crests, troughs = (ahead + jump * x for x in strains)
    if jump < 0:
        crests, troughs = troughs, crests
    with np.errstate(divide="ignore"):
        wavelengths = 2 * np.pi / k
    return WhithamShock(
        float(sound * s[0]),
        float(sound * s[-1]),
        float(means[0]),
        float(jump * last[4]),
        ahead,
        sound,
        float(SAFETY * np.abs(found.told - other.told).max() + left),
        sound * s,
        means,
        crests,
        troughs,
        wavelengths,
        sound * omegas,
        **medium_of(law, mass).origin,
    )


class _Step(NamedTuple):
    """A scaled velocity step: strains over `jump`, speeds over `sound`, velocities over both.

    `start`: the fitted strain and wave number of the plateau; `velocity`: that of the chain ahead.
    """

    force: Callable
    sound: float
    jump: float
    decay: float
    start: np.ndarray
    velocity: float

    def missed(self, found):
        return np.array([found.ahead, found.velocity - self.velocity])


def _posed(law, c, mass, ahead):
    fit = shock_edges(law, c, mass, ahead=ahead)
    if not np.isfinite(fit.trailing_speed):
        refuse("c", "a shock with a trailing edge", f"{c:g}", fit.outcome)
    if not -fit.trailing_excess > WEAKEST:
        refuse(
            "c",
            f"a jump that changes the speed of sound by a part of {WEAKEST:g} or more",
            f"{c:g}, which changes it by {-float(fit.trailing_excess):.2g}",
            "Weaker shocks are those of gx.theory.kdv.velocity_shock within such a part.",
        )
    sound = float(fit.sound)
    jump = float(fit.mean) - ahead
    # The trailing edge of the fit is at cos^2(k/4) = V_+/V_-.
    k = 4 * np.arccos((1 - float(fit.trailing_excess)) ** -0.5)
    return _Step(
        _scaled(medium_of(law, mass).law, ahead, jump),
        sound,
        jump,
        decay_rate((1 + float(fit.leading_excess)) ** 2),
        np.array([1.0, k]),
        -2 * c / (sound * jump),
    )


def _scaled(law, ahead, jump):
    begin, stiffness, _ = (float(x[0]) for x in fine_values(law, np.array([ahead])))

    def force(x):
        F, slope, _ = (np.asarray(y) for y in fine_values(law, ahead + jump * x))
        return (F - begin) / (stiffness * jump), slope / stiffness

    return force


class _Wave(NamedTuple):
    """A wave: `place` (k, mean strain, (crest - trough)/2), cosine coefficients c, omega^2.

    `slopes`: derivatives of (c, omega^2) by `place`. `phi`: the strain less the mean over a period,
    from a crest on; `stiffness`: its Fourier coefficients.
    """

    place: np.ndarray
    c: np.ndarray
    square: float
    slopes: np.ndarray
    phi: np.ndarray
    stiffness: np.ndarray


class _Family:
    def __init__(self, force: Callable):
        self.force = force
        self.converged = max(CONVERGED, ROUNDING / abs(force(np.ones(1))[1][0] - 1))
        self.count = HARMONICS
        self.known = None

    def system(self, place, c, square):
        k, mean, size = place
        j = np.arange(1, self.count + 1)
        points = 4 * self.count
        phi = np.fft.irfft(np.concatenate([[0.0], c, np.zeros(self.count)]), points) * points / 2
        force, stiffness = (np.fft.rfft(x).real / points for x in self.force(mean + phi))
        spring = (2 * np.sin(j * k / 2) / j) ** 2
        odd = j % 2
        own = stiffness[np.abs(j[:, None] - j)] + stiffness[j[:, None] + j]
        residual = np.append(square * c - spring * 2 * force[j], odd @ c - size)
        jacobian = np.block(
            [[square * np.eye(self.count) - spring[:, None] * own, c[:, None]], [odd, 0.0]]
        )
        by_place = np.zeros((self.count + 1, 3))
        by_place[:-1, 0] = 2 * np.sin(j * k) / j * 2 * force[j]
        by_place[:-1, 1] = spring * 2 * stiffness[j]
        by_place[-1, 2] = 1.0
        return residual, jacobian, by_place, phi, stiffness

    def newton(self, place, c, square):
        c = np.concatenate([c, np.zeros(self.count - len(c))])
        for _ in range(STEPS):
            residual, jacobian, by_place, *seen = self.system(place, c, square)
            if not np.isfinite(residual).all():
                return None
            *move, change = np.linalg.solve(jacobian, residual)
            c = c - move
            square = square - change
            # The square enters times the amplitude, so its rounding error is over the amplitude.
            if max(np.abs(move).max(), abs(change) * place[2]) < self.converged:
                return _Wave(place, c, square, np.linalg.solve(jacobian, by_place), *seen)
        return None

    def follow(self, place):
        place = np.asarray(place, float)
        if self.known is None:
            c = np.zeros(self.count)
            c[0] = place[2]
            stiff = self.force(np.array([place[1]]))[1][0]
            self.known = self.newton(place, c, 4 * np.sin(place[0] / 2) ** 2 * stiff)
        parts = 1
        wave = None
        while wave is None and parts <= PARTS and self.known is not None:
            wave = self.known
            for i in range(1, parts + 1):
                near = self.known.place + i / parts * (place - self.known.place)
                *move, change = wave.slopes @ (near - wave.place)
                wave = self.newton(near, wave.c + move, wave.square + change)
                if wave is None:
                    break
            parts *= 2
        while wave and np.abs(wave.c[-3:]).max() > RESOLVED and self.count < MOST:
            self.count *= 2
            wave = self.newton(place, wave.c, wave.square)
        if wave is None:
            k, mean, size = place
            where = f"k = {k:.3g}, with {mean:.3g} and {2 * size:.3g} jumps of mean and height"
            raise _Lost(f"No wave is found where {where}.")
        self.known = wave
        return wave

    def characteristic(self, place):
        """Return the direction (dk, dy, da, dv) of the second fastest s, and the table's row."""
        wave = self.follow(place)
        (k, mean, size), c, square, (*by_c, by_square), phi, stiffness = wave
        j = np.arange(1, len(c) + 1)
        omega = square**0.5
        by_k, by_mean, _ = np.eye(3)
        omega_by = by_square / (2 * omega)
        force_by = stiffness[j] @ by_c + stiffness[0] * by_mean
        # J = omega w c^2, and -L_k = -omega^2/2 w' c^2, with w = j^2/(8 sin^2(j k/2)) and its
        # derivatives by k.
        sin = np.sin(j * k / 2)
        cos = np.cos(j * k / 2)
        w = j**2 / (8 * sin**2)
        w1 = -(j**3) * cos / (8 * sin**3)
        w2 = j**4 * (1 + 2 * cos**2) / (16 * sin**4)
        action_by = (w @ c**2) * omega_by + omega * (2 * (w * c) @ by_c + w1 @ c**2 * by_k)
        flux_by = -(w1 @ c**2) / 2 * by_square - square / 2 * (
            2 * (w1 * c) @ by_c + w2 @ c**2 * by_k
        )
        # Derivatives are by the squared amplitude, of which everything is a smooth function.
        smooth = np.array([1.0, 1.0, 1 / (2 * size)])
        left, right = np.zeros((2, 4, 4))
        left[0, :3] = omega_by * smooth
        right[0, 0] = 1.0
        left[1, 3] = 1.0
        right[1, 1] = 1.0
        left[2, :3] = force_by * smooth
        right[2, 3] = 1.0
        left[3, :3] = flux_by * smooth
        right[3, :3] = action_by * smooth
        speeds, ways = scipy.linalg.eig(left, right)
        i = np.argsort(speeds.real)[2]
        if abs(speeds[i].imag) > COMPLEX:
            raise _Lost("Modulations of its waves grow.")
        way = ways[:, i].real * np.append(smooth, 1.0)
        return way, np.array(
            [speeds[i].real, omega, k, mean, mean + phi[0], mean + phi[len(phi) // 2]]
        )


class _Lost(Exception):
    """Raised with the reason why there is no wave or no shock."""


class _Curve(NamedTuple):
    """A curve of waves: both edges' rows, strain and velocity ahead, family, (y, a, v) of k."""

    edges: tuple[np.ndarray, np.ndarray]
    ahead: float
    velocity: float
    family: _Family
    along: Callable
    span: tuple[float, float]

    @property
    def told(self):
        (trailing, *_), (leading, *_, amplitude, _) = self.edges
        return np.array([trailing, leading, self.edges[0][3], amplitude])

    def rows(self):
        # From the end on, because the family is there.
        ks = np.linspace(*self.span, PLACES)[::-1]
        return [self.family.characteristic([k, *self.along(k)[:2]])[1] for k in ks][::-1]


def _curve(step, start, means):
    force = step.force
    mean, k = start
    if not 0 < k < np.pi:
        raise _Lost("Its waves would be shorter than two sites at the trailing edge.")
    family = _Family(force)
    end = np.pi * step.decay / -np.log(means.overlap)
    sound = force(np.array([mean]))[1][0] ** 0.5
    edge = np.array([sound * np.cos(k / 2), 2 * sound * np.sin(k / 2), k, mean, mean, mean])
    # The step is in the amplitude, because directions change at a finite rate in it at zero. Their
    # rounding error is over its cube, so the step is a long one, by Gauss's method of order four.
    leave = np.array([k, mean, 0.0, 0.0])
    slopes = np.array([0.0, 0.0, 1.0, 0.0])
    for _ in range(GAUSS_ROUNDS):
        places = leave + means.first * GAUSS @ np.broadcast_to(slopes, (2, 4))
        ways = np.array([family.characteristic(place[:3])[0] for place in places])
        slopes = ways / ways[:, 2:3]
    k1, mean, size, v = leave + means.first * slopes.mean(0)
    if not end < k1 < k:
        raise _Lost("The wavelength does not grow from the trailing edge on.")

    def along(k, x):
        way, _ = family.characteristic([k, *x[:2]])
        return way[1:] / way[0]

    # Longer steps would try places where there is no wave.
    how = dict(rtol=means.tolerance, atol=means.tolerance, max_step=(k1 - end) / means.steps)
    found = scipy.integrate.solve_ivp(
        along, (k1, end), [mean, size, v], "DOP853", dense_output=True, **how
    )
    seen = []
    for k in (NEAR_END * end, end):
        mean, size, v = found.sol(k)
        _, (_, omega, _, _, crest, trough) = family.characteristic([k, mean, size])
        speed = omega / k
        seen.append(np.array([speed, trough, crest - trough, v - speed * (mean - trough)]))
    # At k = 0 two speeds are equal, and near there rounding mixes their directions. The curve ends
    # before, where what is left is proportional to the overlap.
    before, last = seen
    decay = decay_rate(speed**2 / force(np.array([trough]))[1][0])
    decline = np.expm1(decay * np.pi * (1 - 1 / NEAR_END) / end)
    speed, trough, height, velocity = last + (last - before) / decline
    ahead = np.array([speed, 0.0, 0.0, trough, height, trough])
    return _Curve((edge, ahead), trough, velocity, family, found.sol, (k1, end))


def _search(step, x):
    """Find the start that meets strain and velocity ahead, by Broyden's method.

    Return it with the derivative of the misses, the curve, and the effect of the tolerance on the
    result.
    """
    curve = partial(_curve, step, means=FINE)
    missed = step.missed
    found = curve(x)
    left = missed(found)
    near = [curve(x + h) for h in CHANGE * np.eye(2)]
    slope = np.array([(missed(one) - left) / CHANGE for one in near]).T
    gain = np.linalg.solve(slope.T, [(one.told - found.told) / CHANGE for one in near])
    for _ in range(ROUNDS):
        if np.abs(left).max() < MET:
            return x, slope, found, MET * np.abs(gain).sum(0).max()
        move = -np.linalg.solve(slope, left)
        x = x + move
        found = curve(x)
        before = left
        left = missed(found)
        slope += np.outer(left - before - slope @ move, move) / (move @ move)
    raise _Lost("The search does not settle.")
