"""Spectra: power over wave number and frequency, and over time and frequency."""

import jax.numpy as jnp
import numpy as np
import scipy

from ..base.arrays import trailing
from ..base.checks import one_of, parameter, positive, refuse
from ..base.types import Numbers, Parameter, Scalar
from ..base.units import names
from ..results import Result, array

# the names of windows, and those of SciPy
WINDOWS = {"hann": "hann", "none": "boxcar"}


class Spectrum(Result):
    """Power over wave number and angular frequency."""

    k: Numbers = array("The wave numbers per site, rising in [-pi, pi].", "rad", "k")
    omega: Numbers = array("The angular frequencies, from zero on.", "rad/s", "omega")
    power: Numbers = array("The power.", axes="k omega")

    @property
    def outcome(self) -> str:
        return f"{self.k.size} wave numbers, {self.omega.size} frequencies up to {self._told('omega', self.omega[-1])}."


class Spectrogram(Result):
    """Power density over time and angular frequency."""

    time: Numbers = array("The middles of the windows.", "s", "time")
    omega: Numbers = array("The angular frequencies.", "rad/s", "omega")
    power: Numbers = array("The power density.", axes="time omega")

    @property
    def outcome(self) -> str:
        return f"{self.time.size} windows, {self.omega.size} frequencies up to {self._told('omega', self.omega[-1])}."


def spectrum(
    us: Parameter,
    dt: Scalar,
    *,
    time_window: str = "hann",
    space_window: str = "hann",
    units: str | None = None,
) -> Spectrum:
    r"""Compute the power of a history over wave number and frequency.

    It is |sum_nt w_n w_t u_n(t) exp(-i(k n - omega t))|^2.

    Sign: a wave cos(k n - omega t) with omega > 0 runs to the right for k > 0, with its line at
    (k, omega). As u is real, negative frequencies are folded in: omega runs from 0 to pi/dt.

    Scale: without windows the powers sum to the mean of u^2 over sites and frames (Parseval); a
    plane wave of amplitude a has a^2/2. A window keeps this for signals spread over the record.

    **Arguments:** `us`: (T, N) and lanes, frames spaced by `dt`: displacements, velocities or
    strains. `time_window`, `space_window`: `"hann"` or `"none"`
    (right in space for a periodic chain). `units`: `"SI"` or `"scaled"`, such as `run.units`, or
    `None`.
    **Returns:** `Spectrum(k, omega, power)`, power (N, T//2 + 1) and lanes. The resolution is
    2 pi/N in k and 2 pi/(T dt) in omega, doubled by a Hann window.
    **Raises** ValueError for fewer than four frames or two sites, dt <= 0, or another window.

    **Example:**

    >>> ts, n = 0.1 * np.arange(400), np.arange(20)
    >>> found = gx.measures.spectrum(np.cos(np.pi / 2 * n - np.pi * ts[:, None]), 0.1, space_window="none")
    >>> k, omega = np.unravel_index(found.power.argmax(), found.power.shape)
    >>> round(float(found.k[k]) / np.pi, 4), round(float(found.omega[omega]) / np.pi, 4)
    (0.5, 1.0)
    >>> round(float(found.power.sum()), 4)
    0.5
    """
    us = parameter("us", us)
    dt = positive("dt", dt)
    if us.ndim < 2 or us.shape[0] < 4 or us.shape[1] < 2:
        refuse("us", "at least 4 frames of 2 sites, shape (T, N)", f"shape {us.shape}")
    frames, sites = us.shape[:2]
    w_time = trailing(_window("time_window", time_window, frames), us.ndim)
    w_space = trailing(_window("space_window", space_window, sites), us.ndim - 1)
    # for real u the modulus at (k, omega) is that for exp(+ikn) exp(-i omega t)
    amplitude = jnp.fft.ifft(jnp.fft.rfft(w_time * w_space * us, axis=0), axis=1) / frames
    power = jnp.abs(amplitude) ** 2 / (jnp.mean(w_time**2) * jnp.mean(w_space**2))
    twice = np.full(frames // 2 + 1, 2.0)
    twice[0] = 1
    if frames % 2 == 0:
        twice[-1] = 1
    power = jnp.fft.fftshift(jnp.swapaxes(power * trailing(twice, us.ndim), 0, 1), 0)
    k = 2 * jnp.pi * jnp.fft.fftshift(jnp.fft.fftfreq(sites))
    return Spectrum(
        k, 2 * jnp.pi * jnp.fft.rfftfreq(frames) / dt, power, _mark=names.mark_of(units)
    )


def _window(name, window, size):
    own = WINDOWS[one_of(name, window, WINDOWS)]
    return jnp.asarray(scipy.signal.get_window(own, size))


def spectrogram(
    v: Parameter,
    dt: Scalar,
    window: Scalar,
    *,
    units: str | None = None,
) -> Spectrogram:
    """Compute the power density over time and frequency by a short-time Fourier transform.

    A Hann window is used. The integral over omega is the mean square of the signal about that time.
    Only windows inside the record count.

    **Arguments:** `v`: (T,) and trailing axes, frames spaced by `dt`. `window`: its length, in the
    units of `dt`; windows are a quarter of it apart, and the resolution in frequency is about
    4 pi/window. `units`: as in `spectrum`.
    **Returns:** `Spectrogram(time, omega, power)`, NumPy arrays, time from the first frame; power
    (S, W) and trailing axes. **Raises** ValueError for a window shorter than four frames or longer
    than the record; TypeError for traced input.

    **Example:**

    >>> ts = 0.1 * np.arange(400)
    >>> found = gx.measures.spectrogram(np.cos(2.0 * ts), 0.1, window=10.0)
    >>> round(float(found.omega[found.power[0].argmax()]), 4), round(float(found.power[0].sum() * found.omega[1]), 4)
    (1.885, 0.5)
    """
    v = np.asarray(parameter("v", v))
    dt = float(positive("dt", dt))
    frames = len(v) if v.ndim else 0
    if frames < 4:
        refuse("v", "a record of at least 4 frames", f"shape {v.shape}")
    size = float(positive("window", window)) / dt
    if not 4 <= round(min(size, frames + 1)) <= frames:
        refuse(
            "window and dt",
            f"a window of 4 to {frames} frames",
            f"{window}, {size:.3g} frames of {dt:g}",
        )
    size = round(size)
    step = max(1, size // 4)

    transform = scipy.signal.ShortTimeFFT(
        scipy.signal.windows.hann(size, sym=False),
        step,
        1 / dt,
        fft_mode="onesided2X",
        scale_to="psd",
    )
    first = transform.lower_border_end[1]
    last = max(transform.upper_border_begin(frames)[1], first + 1)
    power = transform.spectrogram(v, axis=0, p0=first, p1=last)
    time = transform.t(frames, first, last)
    power = np.moveaxis(power, -1, 0) / (2 * np.pi)
    return Spectrogram(time, 2 * np.pi * transform.f, power, _mark=names.mark_of(units))
