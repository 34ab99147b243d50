"""Fits of the modulated waves of Toda and KdV to windows of a shock."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ..laws import Strained, taylor
from ..profiles.medium import Medium
from ..theory import kdv, toda
from .windows import LocalWave

# The number of phases at which a modulated wave is computed.
STARTS = 64
# The m of the table in which the amplitude gives the start of a fit.
TABLE = np.linspace(0.0, 1.0, 65)


class Seen(NamedTuple):
    """The data of windows: places n, middle time, offsets (B,), (F,), strains (F, B, W)."""

    places: np.ndarray
    time: float
    xi: np.ndarray
    tau: np.ndarray
    strains: np.ndarray
    local: LocalWave


class Theory(NamedTuple):
    """A theory: formulas, constants by K2, K3 and mass, c of the plateau's jump, periodic wave."""

    name: str
    formulas: object
    constants: object
    c: object
    wave: object


THEORIES = {
    "toda": Theory(
        "Toda",
        toda,
        lambda K2, K3, mass: toda.matched(K2, K3)._asdict() | {"mass": mass},
        lambda jump, strength, rate, mass: (
            np.expm1(rate * jump / 2) * np.sqrt(strength * rate / mass) / rate
        ),
        lambda n, wave, constants: toda.periodic_wave(
            n, 0.0, wave.E1, wave.E2, wave.E3, wave.E4, **constants
        ),
    ),
    "kdv": Theory(
        "KdV",
        kdv,
        lambda K2, K3, mass: {"K2": K2, "K3": K3, "mass": mass},
        lambda jump, K2, K3, mass: jump / 2 * np.sqrt(K2 / mass),
        lambda n, wave, constants: kdv.cnoidal(n, 0.0, wave.r1, wave.r2, wave.r3, **constants),
    ),
}


def modulated(theory: str, medium: Medium, ahead: float, mean: float, seen: Seen) -> dict:
    """Return the `Shock` fields of the theory's waves in all windows, or NaN and a reason."""
    own = THEORIES[theory]
    none = np.full(seen.places.shape, np.nan)
    names = "m", "m_errors", "speeds_of_m", "phases", "theory_errors"
    K2, K3, _ = (float(x) for x in taylor(Strained(medium.law, jnp.asarray(ahead))))
    told = lambda why: (
        dict.fromkeys(names, none)
        | dict(c=np.nan, _not_compared=f"Not compared with {own.name}: {why}")
    )
    if not (np.isfinite(K2) and K2 > 0 and np.isfinite(K3)):
        return told("the chain ahead has no sound.")
    if not np.isfinite(mean):
        return told("its waves come so near to the step that there is no plateau to match.")
    if not K3 * (mean - ahead) > 0:
        return told("K3 ahead is not of the sign of the jump.")
    constants = {name: float(x) for name, x in own.constants(K2, K3, float(medium.mass)).items()}
    c = float(own.c(mean - ahead, **constants))
    try:
        table = own.formulas.modulation(TABLE, c, **constants)
    except ValueError as error:
        return told(str(error))
    known = np.flatnonzero(np.isfinite(seen.local.amplitude))
    if not known.size:
        return told("no waves were found in the windows.")
    found = np.full((5, len(none)), np.nan)
    start = np.interp(seen.local.amplitude, np.abs(np.asarray(table.amplitude)), TABLE)
    for j in known:
        strains = seen.strains[..., j] - ahead
        parameter = _parameter(theory, c, constants, seen, j, strains, start[j])
        found[:, j] = *parameter, *_phase(own, c, constants, seen, j, strains)
    found[-1] /= abs(mean - ahead)
    return dict(zip(names, found), c=c)


def _parameter(theory, c, constants, seen, j, strains, start):
    """Return the best m of a window, its error from either half of the frames, and its speed s.

    The phase k n - omega t is the measured one, because the waves of another law have the theory's
    shape sooner than its dispersion.
    """
    wave = LocalWave(*(x[j] for x in seen.local))
    turns = (wave.wavenumber * seen.xi - wave.omega * seen.tau[:, None]) / (2 * np.pi)
    numbers = {name: jnp.asarray(x) for name, x in constants.items()}
    first = (
        scipy.special.logit(np.clip(start, 1e-3, 1 - 1e-3)),
        wave.crest * wave.wavenumber / (2 * np.pi),
    )

    def nearest(frames):
        def rest(p):
            theirs = _periodic(theory, turns - p[1], scipy.special.expit(p[0]), c, numbers)[0]
            return (np.asarray(theirs) - strains)[frames].ravel() / np.abs(strains).max()

        return scipy.special.expit(
            scipy.optimize.least_squares(rest, first, xtol=1e-9, ftol=1e-12, max_nfev=40).x[0]
        )

    half = (len(strains) + 1) // 2
    whole, *parts = map(nearest, (slice(None), slice(half), slice(len(strains) - half, None)))
    # m changes evenly in time, so the mean of both halves is that of the middle.
    speed = _periodic(theory, turns, whole, c, numbers)[1]
    return whole, abs(np.mean(parts) - whole), float(speed)


def _phase(own, c, constants, seen, j, strains):
    phases = 2 * np.pi * np.arange(STARTS) / STARTS
    n = seen.places[j] + seen.xi[:, None]
    t = seen.time + seen.tau[:, None, None]
    wave = np.asarray(own.formulas.shock_wave(n, t, c, phase=phases, **constants).strain)
    # The wave is periodic in its phase, so it is a Fourier series in it.
    series = np.fft.rfft(wave, axis=-1) / STARTS
    order = np.arange(STARTS // 2 + 1)
    series[..., 1:-1] *= 2
    left = lambda phase: (series @ np.exp(1j * order * phase)).real - strains
    best = phases[np.argmin(np.sum((wave - strains[..., None]) ** 2, (0, 1)))]
    near = scipy.optimize.minimize_scalar(
        lambda x: np.sum(left(x) ** 2),
        bounds=(best - 0.2, best + 0.2),
        method="bounded",
        options={"xatol": 1e-6},
    )
    return near.x % (2 * np.pi), np.abs(left(near.x)).max()


@partial(jax.jit, static_argnums=0)
def _periodic(theory, turns, m, c, constants):
    own = THEORIES[theory]
    wave = own.formulas.modulation(m, c, **constants)
    return own.wave(turns * wave.wavelength, wave, constants).strain, wave.speed
