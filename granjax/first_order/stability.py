"""Linear stability of standing solitons (Bogoliubov-de Gennes), and families over the frequency."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Complex, Float, Shaped

from ..base.checks import refuse, traced
from ..base.programs import compiled
from ..base.types import Count, Scalar
from ..continuation.arclength import Curve, Problem, continuation
from ..results import Result, array, hidden
from .equations import Equation
from .solitons import Soliton, rate_scale, soliton

# the rounding error of the linearisation, relative to its norm
ROUNDING = 50 * np.finfo(float).eps
# a growth rate above this many errors is an instability
SURE = 3


class SolitonStability(Result):
    """The growth rates of small disturbances, from `gx.first_order.stability`."""

    rates: Complex[np.ndarray, " mode"] = array(
        "The rates lambda of exp(lambda t), the largest real part first.", "rad/s"
    )
    error: Float[np.ndarray, " mode"] = array("The error of each rate.", "rad/s")
    modes: Complex[np.ndarray, "two site mode"] = array(
        "The real and the imaginary part of the disturbance chi of each rate.",
        axes="part site mode",
    )
    verdict: str = array('"stable", "unstable" or "undecided".', static=True)

    @property
    def growth(self) -> float:
        """The largest growth rate [1/s]."""
        return float(self.rates[0].real)

    @property
    def outcome(self) -> str:
        return (
            f"{self.verdict.capitalize()}: the largest growth rate is {self.growth:.6g} "
            f"+- {self.error[0]:.1g}."
        )


def stability(equation: Equation, found: Soliton) -> SolitonStability:
    r"""Compute the growth rates of small disturbances of a standing soliton.

    psi_n = (phi_n + chi_n(t)) exp(-i omega t) gives a real linear system for (Re chi, Im chi), with
    eigenvalues +-lambda and +-lambda*. Those on the imaginary axis are oscillations; two are zero,
    since the phase is free. The error includes rounding and the error of the soliton, times the
    condition of each eigenvalue; at a double eigenvalue it is the root of that.

    **Arguments:** `equation`, `found`: an equation and its `Soliton`, from `soliton`.
    **Returns:** `SolitonStability`. **Raises** ValueError for a batch, and while traced.
    Source: Kevrekidis, The Discrete Nonlinear Schroedinger Equation (Springer 2009), chapter 2.

    **Example:**

    >>> chain = gx.first_order.DNLS(40)
    >>> wave = gx.first_order.soliton(chain, omega=-1.0, guess="bond")
    >>> gx.first_order.stability(chain, wave).verdict
    'unstable'
    """
    if traced((equation, found)):
        refuse(
            "found",
            "a soliton of known numbers",
            "a traced one",
            "Take it out of the transformation.",
        )
    phi = np.asarray(found.psi)
    if phi.shape != (equation.sites,):
        refuse("found", f"one soliton of {equation.sites} sites", f"shape {phi.shape}")
    error = float(found.error) * np.abs(phi).max()
    # a random direction, since the error of the profile may have any shape
    other = phi + error * np.random.default_rng(0).choice([-1.0, 1.0], phi.size)
    near, far = (
        np.asarray(_linearised(equation, jnp.asarray(x), jnp.asarray(found.omega)))
        for x in (phi, other)
    )
    values, left, right = scipy.linalg.eig(near, left=True)
    size = np.linalg.norm(near, 2)
    about = ROUNDING * size + np.linalg.norm(far - near, 2)
    overlap = np.abs(np.sum(left.conj() * right, axis=0))
    # a perturbation moves a double eigenvalue by its square root
    apart = np.minimum(about / np.maximum(overlap, about / size), np.sqrt(about * size))
    order = np.lexsort((-values.imag, -values.real.round(12)))
    values = values[order]
    apart = apart[order]
    grows = values.real > SURE * apart
    verdict = "unstable" if grows.any() else "stable"
    # a growth within its error, apart from the zeros of the phase
    if verdict == "stable" and np.any((values.real > 1e-6 * size) & ~grows):
        verdict = "undecided"
    # SciPy gives real vectors where all rates are real
    modes = right[:, order].astype(complex).reshape(2, equation.sites, -1)
    return SolitonStability(values, apart, modes, verdict, _space=(1, 0))


@compiled
def _linearised(equation, phi, omega):
    def rate(x):
        psi = x[: phi.size] + 1j * x[phi.size :]
        change = -1j * (equation.rate(psi) - omega * psi)
        return jnp.concatenate([change.real, change.imag])

    return jax.jacfwd(rate)(jnp.concatenate([phi, 0 * phi]))


class SolitonFamily(Result):
    """Standing solitons over the frequency, from `gx.first_order.soliton_family`."""

    omega: Float[np.ndarray, " point"] = array("The frequencies.", "rad/s")
    psi: Float[np.ndarray, "point site"] = array("The real amplitudes phi.")
    norm: Float[np.ndarray, " point"] = array("The norms.")
    growth: Float[np.ndarray, " point"] = array("The largest growth rates.", "1/s")
    growth_error: Float[np.ndarray, " point"] = array("The errors of the growth rates.", "1/s")
    verdict: Shaped[np.ndarray, " point"] = array("The verdict of `stability` on each soliton.")
    curve: Curve = hidden("The curve, with its folds and branch points.")

    @property
    def outcome(self) -> str:
        return self.curve.outcome.replace("p reached", "The frequency reached")


class _Standing(Problem):
    # Amplitudes and frequency are relative to `scale` (N + 1,), so that neither decides the step.

    equation: Equation
    scale: Float[np.ndarray, " n_and_p"]

    def residual(self, x, p):
        size, rate = self.scale[-2:]
        return jnp.real(self.equation.rate(size * x)) / (size * rate) - p * x


def soliton_family(
    equation: Equation,
    found: Soliton,
    until: Scalar,
    *,
    leaving: tuple[Curve, Count] | None = None,
    arclength: Scalar = 0.05,
    points: Count = 200,
) -> SolitonFamily:
    """Follow a standing soliton over its frequency, through folds, with its stability.

    **Arguments:** `equation`, `found`: an equation and its `Soliton`. `until`: the frequency at
    which to end. `leaving`: instead of `found`, the branch that crosses at a branch point:
    `(family.curve, i)` for `family.curve.special[i]`. `arclength`: the first step of phi and
    omega over their largest values. `points`: the most solitons.
    **Returns:** `SolitonFamily`. **Raises** ValueError for a point that is no branch point;
    RuntimeError if the first soliton is not found.

    **Example:**

    >>> chain = gx.first_order.DNLS(20)
    >>> wave = gx.first_order.soliton(chain, omega=-1.0)
    >>> family = gx.first_order.soliton_family(chain, wave, -1.5)
    >>> family.outcome, bool(np.all(family.verdict == "stable"))
    ('The frequency reached -1.5.', True)
    """
    x = np.asarray(found.psi)
    omega = float(found.omega)
    until = float(until)
    direction = np.sign(until - omega)
    rate = max(float(rate_scale(equation, w)) for w in (omega, until))
    scale = np.append(np.full(x.size, np.abs(x).max()), rate)
    if leaving is not None:
        point = leaving[0].special[leaving[1]]
        if len(point.directions) < 2:
            refuse("leaving", "a branch point", f"a {point.kind}")
        x = point.x
        omega = point.p
        direction = point.directions[1] / scale
    curve = continuation(
        _Standing(equation, scale),
        x / scale[0],
        omega / rate,
        until=until / rate,
        direction=direction,
        arclength=arclength,
        points=points,
        tolerance=1e-11,
    )
    curve = dataclasses.replace(
        curve,
        x=curve.x * scale[0],
        p=curve.p * rate,
        tangents=curve.tangents * scale,
        special=tuple(
            s._replace(x=s.x * scale[0], p=s.p * rate, directions=s.directions * scale)
            for s in curve.special
        ),
    )
    waves = [soliton(equation, w, guess=phi, throw=False) for phi, w in zip(curve.x, curve.p)]
    spectra = [stability(equation, wave) for wave in waves]
    return SolitonFamily(
        curve.p,
        np.stack([np.asarray(wave.psi) for wave in waves]),
        np.array([float(wave.norm) for wave in waves]),
        np.array([one.growth for one in spectra]),
        np.array([one.error[0] for one in spectra]),
        np.array([one.verdict for one in spectra]),
        curve,
        _space=(1, 0),
    )
