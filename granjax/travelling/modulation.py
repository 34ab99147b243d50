"""Modulations of a periodic wave: growth, and characteristic speeds of Whitham's equations."""

import numpy as np
import scipy
from jaxtyping import Complex, Float

from ..base.checks import refuse
from ..base.tuning import one_thread
from ..base.types import Parameter
from ..orbits.floquet import STABLE, UNSTABLE
from ..profiles.medium import values
from ..results import Result, array
from .periodic import PeriodicWave

# The default number of phases of a modulation, up to pi.
PHASES = 48
# The least number of harmonics.
FEWEST = 8
# The most harmonics; the matrix has four times as many rows.
MOST = 96
# The stiffness of a harmonic, over that of the mean, below which it is neglected.
NEGLIGIBLE = 1e-11
# The least part of a resolved perturbation in the lower half of the harmonics.
RESOLVED = 0.9
# The error over the change with fewer harmonics.
SAFETY = 2
# The most that rounding moves eigenvalues that meet, over its square root.
MEETING = 30
# The first phase at which speeds are computed [rad].
LONG = 0.03
# How often it is halved for the limit.
HALVINGS = 3


class Modulation(Result):
    r"""The growth of modulations exp(i kappa n + lambda t) f(theta) of a periodic wave.

    f has the wave's period. For kappa -> 0 four modulations have lambda = -i C kappa. The C are the
    characteristic speeds of Whitham's four conservation laws (`Averages`), with which slow changes
    of the wave propagate. Where two of them are complex the wave is unstable to long modulations.
    """

    kappa: Float[np.ndarray, " kappa"] = array("The phase per site of each modulation.", "rad")
    growth: Float[np.ndarray, " kappa"] = array(
        "The largest real part of lambda at each phase.", "1/s"
    )
    growth_error: Float[np.ndarray, " kappa"] = array("The error of the growth.", "1/s")
    speeds: Complex[np.ndarray, " speed"] = array(
        "The characteristic speeds, in sites per time, in ascending order of the real part.", "1/s"
    )
    speed_errors: Float[np.ndarray, " speed"] = array("The errors of the speeds.", "1/s")

    @property
    def verdict(self) -> str:
        """Say "unstable" where a computed modulation grows by more than its error, else "stable"."""
        return UNSTABLE if np.any(self.growth > self.growth_error) else STABLE

    @property
    def outcome(self) -> str:
        """The fastest modulation, and whether long modulations grow."""
        i = int(np.argmax(self.growth))
        ways = "complex: long modulations grow"
        if np.all(np.abs(self.speeds.imag) <= self.speed_errors):
            ways = "real"
        said = f"No modulation grows, to {self._told('growth', self.growth_error.max())}."
        if self.verdict == UNSTABLE:
            top = f"{self._told('growth', self.growth[i])} at kappa = {self.kappa[i]:.4g}"
            said = f"Modulations grow, by up to {top}."
        return f"{said} The characteristic speeds are {ways}."


@one_thread
def modulation(wave: PeriodicWave, kappa: Parameter | None = None) -> Modulation:
    r"""Compute the growth of a periodic wave's modulations, and its characteristic speeds.

    On the infinite chain, with w_n = exp(i kappa n + lambda t) sum_j w_j exp(i j theta), theta = k
    n - omega t, and c_l the Fourier coefficients of the stiffness F'(phi(theta)) along the wave,

        m (lambda - i j omega)^2 w_j = -4 sin^2((kappa + j k)/2) sum_l c_{j-l} w_l

    (Hill's method), an eigenvalue problem for each kappa. exp(2 pi lambda/omega) are the Floquet
    multipliers on a ring that holds the wave and the modulation. The speeds are the limit of i
    lambda/kappa, by Richardson's extrapolation.

    **Arguments:** `wave`: of `periodic_wave`. `kappa`: any phases per site [rad]; `None` takes 48
    up to pi. kappa, kappa + k, -kappa and kappa + 2 pi are the same modulation.

    **Returns:** `Modulation`. Typical: 1 s. Toda's waves are stable, and their speeds agree with
    those of the four Riemann invariants to 1e-9.
    Source: Bronski, Hur, Johnson, in New Approaches to Nonlinear Waves, Springer (2016); Whitham,
    Linear and Nonlinear Waves (1974).

    **Example:**

    >>> wave = gx.travelling.periodic_wave(gx.Toda(), 5.0, amplitude=0.5)
    >>> found = gx.travelling.modulation(wave, [0.3, 1.0])
    >>> found.verdict, found.speeds.real.round(3).tolist()
    ('stable', [-1.0, 0.684, 0.936, 1.013])
    """
    phases = np.pi * np.arange(1, PHASES + 1) / PHASES
    phases = phases if kappa is None else np.ravel(np.asarray(kappa, float))
    if not phases.size:
        refuse("kappa", "one phase or more", "none")
    theta = float(wave.wavelength) * np.arange(4 * MOST) / (4 * MOST)
    hat = np.fft.fft(values(wave.law, np.asarray(wave.strain(theta)))[1]) / len(theta)
    counts = np.flatnonzero(np.abs(hat[:MOST]) > NEGLIGIBLE * np.abs(hat[0]))
    count = int(np.clip(2 * counts[-1], FEWEST, MOST))
    both = [_Hill(wave, hat, n) for n in (count, 3 * count // 4)]
    (growth, about), (other, _) = (
        np.array([hill.growth(phase) for phase in phases]).T for hill in both
    )
    (speeds, errors), (others, _) = (hill.speeds() for hill in both)
    return Modulation(
        phases,
        growth,
        about + SAFETY * np.abs(growth - other),
        speeds,
        errors + SAFETY * np.abs(speeds - others),
        _mark=wave._mark,
        _space=wave._space,
    )


class _Hill:
    def __init__(self, wave, hat, count):
        self.k = 2 * np.pi / float(wave.wavelength)
        self.omega = self.k * float(wave.speed)
        self.j = np.arange(-count, count + 1)
        scale = float(wave.mass) * self.omega**2
        self.stiffness = hat[self.j[:, None] - self.j].real / scale

    def spectrum(self, kappa):
        # Strains and velocities, so that sin((kappa + j k)/2) stands once in each. The fourfold
        # eigenvalue of the symmetries at kappa = 0 then has a chain of two, which rounding splits
        # by its square root. With strains and their rates it is a chain of three, and the cube
        # root. The matrix is real, as the wave is even: rounding makes no lone real eigenvalue
        # complex.
        step = np.diag(2 * np.sin((kappa + self.j * self.k) / 2))
        turn = np.diag(self.j.astype(float))
        matrix = np.block([[turn, step], [step @ self.stiffness, turn]])
        found, left, right = scipy.linalg.eig(matrix, left=True)
        weight = np.abs(right[: len(self.j)]) ** 2 + np.abs(right[len(self.j) :]) ** 2
        low = weight[np.abs(self.j) <= self.j[-1] // 2].sum(0)
        own = low > RESOLVED * weight.sum(0)
        alike = np.abs(np.sum(left.conj() * right, 0))
        rounding = np.finfo(float).eps * np.linalg.norm(matrix)
        # The harmonics of the stiffness beyond `count`, which waves with sharp crests still have.
        tail = np.abs(self.stiffness[0, self.j[-1] + 1 :]).max()
        most = MEETING * np.sqrt(rounding) + np.sqrt(tail)
        error = np.minimum((rounding + tail) / np.maximum(alike, rounding), most)
        return 1j * self.omega * found[own], self.omega * error[own]

    def growth(self, kappa):
        found, error = self.spectrum(kappa)
        growth = found.real.max()
        # Any eigenvalue may be the fastest, within its error.
        return growth, (found.real + error).max() - growth

    def speeds(self):
        rows = []
        for kappa in LONG / 2.0 ** np.arange(HALVINGS + 1):
            found, error = self.spectrum(kappa)
            near = np.argsort(np.abs(found))[:4]
            speeds = 1j * found[near] / kappa
            # The rounded real parts of a complex pair are equal, so the sort keeps it together.
            digits = np.round(speeds.real / np.abs(speeds).max(), 6)
            order = np.lexsort((speeds.imag, digits))
            rounding = error[near][order] / kappa
            rows.append(speeds[order])
        # Richardson's extrapolation of an even function of kappa.
        for order in range(1, HALVINGS + 1):
            before = rows[-1]
            rows = [(4**order * b - a) / (4**order - 1) for a, b in zip(rows, rows[1:])]
        return rows[0], SAFETY * (np.abs(rows[0] - before) + rounding)
