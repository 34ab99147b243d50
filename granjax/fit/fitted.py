"""`Fit`: the result of a fit."""

from typing import ClassVar

import numpy as np
import scipy
from jaxtyping import Float

from ..base.types import AnyArray, Numbers
from ..lattice import Lattice
from ..results import Held, Result, array, hidden
from .descent import CONVERGED, NO_GRADIENT, NO_START, SPENT, STALLED
from .determined import Direction
from .problem import Problem
from .traces import Traces

# The outcome mentions a step error above this, in units of sigma.
NOTICEABLE = 0.1
# The outcome warns of another minimum if the scene explains at most this share of the
# squared data.
SHOWN = 0.5
# A mean square of the residuals above this, in units of sigma^2, is more than noise.
NOISY = 2.0
# the most contacts that one sentence lists
MANY = 6


class Fit(Result):
    r"""The result of a fit: parameters, their covariance, and what the data determine."""

    parameters: dict[str, Numbers] = array("The fitted parameters, a dict like `start`.")
    covariance: Float[AnyArray, "P P"] = array(
        "The Gauss-Newton covariance, (J^T J)^{-1} with residuals in units of sigma, in the order"
        " of `names`; infinite for parameters that the data do not determine at all.",
        axes="parameter parameter_",
    )
    names: tuple[str, ...] = array(
        "A name for each number in the parameters.", "", "parameter", name="parameter", static=True
    )
    signals: tuple[Float[AnyArray, "_ _"], ...] = hidden("The signals of the scene, per trace.")
    residuals: tuple[Float[AnyArray, "_ _"], ...] = hidden(
        "(signal - data)/sigma per trace, zero for missing samples."
    )
    samples: int = array("The number of samples.", static=True)
    noise: float = array(
        "The standard deviation of the residuals if no sigma was given, else 1.", static=True
    )
    directions: tuple[Direction, ...] = hidden(
        "Combinations of parameters and their relative deviations, the least known first."
    )
    undetermined: tuple[str, ...] = hidden(
        "Sentences on what the data do not determine.", static=True
    )
    explained: float = array("The share of the squared data that the scene explains.", static=True)
    residue: float = array(
        "The rms that neighbouring residuals share beyond noise, over that of the residuals; 0 if "
        "it is only noise.",
        static=True,
    )
    at_bounds: tuple[str, ...] = hidden("The names of the parameters at a bound.", static=True)
    meeting: float | None = hidden(
        "The largest mismatch of neighbouring windows, in units of sigma; `None` for one window.",
        static=True,
    )
    windows: int = hidden("The number of windows.", static=True)
    silent: tuple[tuple, ...] = hidden(
        "Terms and their contacts that never close, if the traces see no parameter.", static=True
    )
    iterations: int = array("The number of iterations of the minimiser.", static=True)
    code: int = hidden("How the minimiser ended.", static=True)
    step: float = array("The time step, for runs at a fixed step.", "s", static=True)
    run_tolerance: float | None = array("The tolerance of adaptive runs.", static=True)
    step_error: float = array(
        "The change of the signals, in units of sigma, when the time step is halved, or the tolerance of adaptive "
        "runs is divided by 100.",
        static=True,
    )
    return_error: float = array("The relative error of integrating back to the start.", static=True)
    adjoint: str = array("The method of differentiation.", static=True)
    starts: tuple[float, ...] = array(
        "The chi_square that each start reached.",
        "1",
        "start",
        name="chi_square_of_starts",
        static=True,
    )
    traces: tuple[Traces, ...] = hidden("The traces.")
    problem: Problem = hidden("The least-squares problem.")
    exported: ClassVar[dict[str, Held]] = dict.fromkeys(("deviations", "chi_square"), Held())

    @property
    def lattice(self) -> Lattice:
        """The fitted lattice."""
        return self.problem.scene(self.parameters)

    @property
    def chi_square(self) -> float:
        """The sum of squared residuals; about `samples` - P if the scene and sigma are right."""
        return float(sum((np.asarray(r) ** 2).sum() for r in self.residuals))

    @property
    def reduced_chi_square(self) -> float:
        """chi_square/(`samples` - P); about 1 if the scene and sigma are right."""
        return self.chi_square / max(self.samples - len(self.names), 1)

    @property
    def deviations(self) -> dict[str, np.ndarray]:
        """The standard deviations of the parameters, a dict of the same shapes."""
        flat = np.sqrt(np.diag(self.covariance))
        return self.problem.coordinates.unflat(flat)

    @property
    def correlations(self) -> Float[np.ndarray, "P P"]:
        """The correlation matrix (P, P); NaN for parameters of infinite variance."""
        size = np.sqrt(np.diag(self.covariance))
        size = np.where(np.isfinite(size), size, np.nan)
        return self.covariance / np.outer(size, size)

    def whiteness(self) -> list[Float[np.ndarray, " _"]]:
        """Return the p-value for white residuals, per sensor (a list of (S,)).

        The Ljung-Box test: n(n+2) sum_k r_k^2/(n-k) against chi^2 of min(20, T/5) degrees of
        freedom. Source: Biometrika 65, 297 (1978).
        """
        return [np.array([_ljung_box(x) for x in np.asarray(r).T]) for r in self.residuals]

    @property
    def converged(self) -> bool:
        """Whether the minimiser converged."""
        return self.code == CONVERGED

    @property
    def outcome(self) -> str:
        """Sentences on convergence, agreement with the noise, and undetermined parameters."""
        how = {
            CONVERGED: f"Converged in {self.iterations} steps",
            SPENT: f"Not converged after {self.iterations} steps",
            STALLED: f"Stalled after {self.iterations} steps: the residuals could be smaller, but no step was better",
            NO_START: "Failed: the residuals are not finite at the start or near it",
            NO_GRADIENT: "Failed: the traces do not depend on the parameters at the start",
        }[self.code]
        said = [f"{how}; chi^2 per degree of freedom {self.reduced_chi_square:.3g}."]
        if len(self.starts) > 1:
            near = sum(c <= 1.001 * min(self.starts) for c in self.starts)
            said.append(f"{near} of {len(self.starts)} starts reached it.")
        return " ".join([*said, *self._remarks(), *self.undetermined])

    def _remarks(self):
        known = all(trace.sigma is not None for trace in self.traces)
        said = []
        if -np.inf < self.explained <= SHOWN and not (known and self.reduced_chi_square < NOISY):
            much = "no more of the traces than rest does"
            if self.explained > 0:
                much = f"only {100 * self.explained:.2g} % of the traces' squares"
            unless = "" if known else "unless noise is most of them, "
            said.append(
                f"The scene explains {much}: {unless}this is another minimum than the one sought, and what follows "
                "holds there. Start nearer, with bounds on both sides, or from more starts with a larger spread."
            )
        if self.code == NO_START:
            return [*said, "Give a start whose run stays finite."]
        if self.code == NO_GRADIENT:
            for i, contacts in self.silent:
                shown = ", ".join(map(str, contacts[:MANY])) + " ..." * (len(contacts) > MANY)
                said.append(
                    f"Contacts {shown} of terms[{i}] never close, and an open contact has no derivative."
                )
            return [*said, "Start where the motion reaches the sensors."]
        if self.at_bounds:
            held = ", ".join(self.at_bounds)
            said.append(f"At its bound, and beyond it if it could: {held}.")
        if self.step_error > NOTICEABLE:
            said.append(
                f"The time step moves the signals by up to {self.step_error:.2g} sigma: give a shorter step="
                " or a smaller run_tolerance=."
            )
        if self.residue and not said:
            said.append(
                f"A residue beyond noise is left, {100 * self.residue:.2g} % of the residuals: neighbouring "
                "samples share it, as independent errors would not. The scene does not describe what was "
                "measured, or the noise is correlated; the deviations are too small."
            )
        if not known:
            said.append(f"Noise, as the residuals have it: {self.noise:.3g}.")
        if self.meeting is not None:
            said.append(f"{self.windows} windows, which meet to {self.meeting:.2g} sigma.")
        return said

    def _rows(self):
        flat = self.problem.coordinates.flat(self.parameters)
        for name, value, variance in zip(self.names, flat, np.diag(self.covariance)):
            yield name, f"{value:.8g} +- {np.sqrt(variance):.2g}"
        yield "adjoint", f"{self.adjoint}, return error {self.return_error:.1e}"
        step = f"{self.step:.4g}"
        tolerance = self.run_tolerance
        taken = step if tolerance is None else f"adaptive, tolerance {tolerance:.2g}"
        yield "step", f"{taken}, error {self.step_error:.1e} sigma"
        yield "outcome", self.outcome

    def _held(self, name):
        held = super()._held(name)
        first = self.traces[0]
        if name == "noise" and first.sigma is None:
            return held._replace(unit=first.unit)
        return held

    def _fields(self):
        yield from super()._fields()
        # Each trace has its own times and sensors.
        for k, trace in enumerate(self.traces):
            time = f"time_{k}"
            sensor = f"sensor_{k}"
            both = f"{time} {sensor}"
            yield time, trace.times, Held(time, "s")
            yield sensor, trace.sensors, Held(sensor)
            yield f"data_{k}", trace.data, Held(both, trace.unit)
            yield f"signal_{k}", self.signals[k], Held(both, trace.unit)
            yield f"residual_{k}", self.residuals[k], Held(both, "1")


def _ljung_box(x):
    n = x.size
    lags = min(20, n // 5)
    x = x - x.mean()
    power = float(x @ x)
    if power == 0 or lags < 1:
        return np.nan
    k = np.arange(1, lags + 1)
    r = np.array([x[lag:] @ x[:-lag] for lag in k]) / power
    return float(scipy.stats.chi2.sf(n * (n + 2) * np.sum(r**2 / (n - k)), lags))
