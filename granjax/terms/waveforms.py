"""Functions of time for drives, moving walls and modulated stiffness."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.checks import parameter, positive, within
from ..base.printing import told
from ..base.types import Number, Numbers, Parameter, Waveform
from ..base.units import Dimensional, Signal

# Number of rounding units by which the jump of a function may differ from its break.
ULPS = 16


class Function(eqx.Module):
    """A plain Python function of time, a static field: equal functions compile once.

    It must be pure: a global number that it reads is fixed at the first compilation. Values that
    are swept, changed or differentiated belong in a Module such as `Harmonic`.
    """

    function: Callable = eqx.field(static=True)
    __repr__ = told

    def __call__(self, t):
        return self.function(t)

    @property
    def breaks(self):
        return getattr(self.function, "breaks", None)


class Harmonic(eqx.Module):
    """The waveform a cos(omega t + phase) + mean for `Drive`, `Wall` and `Modulated`.

    **Arguments:** `amplitude`: a; `omega`: angular frequency [rad/s]; `phase` [rad]; `mean`:
    constant, 1 for a modulation of stiffness.

    **Example:**

    >>> stiffness = gx.Harmonic(0.1, omega=2.0, mean=1.0)
    >>> round(float(stiffness(0.0)), 4), round(float(stiffness(jnp.pi / 2)), 4)
    (1.1, 0.9)
    """

    amplitude: jax.Array
    omega: jax.Array
    phase: jax.Array
    mean: jax.Array
    __repr__ = told

    def __init__(
        self, amplitude: Parameter, omega: Parameter, phase: Parameter = 0.0, mean: Parameter = 0.0
    ):
        self.amplitude = parameter("amplitude", amplitude)
        self.omega = parameter("omega", omega)
        self.phase = parameter("phase", phase)
        self.mean = parameter("mean", mean)

    def __call__(self, t):
        return self.mean + self.amplitude * jnp.cos(self.omega * t + self.phase)


class Breaks(Dimensional):
    """Times at which a function of time or one of its derivatives jumps; time steps end there.

    **Arguments:** `times` [s]: a number or a list, in any order; `period` [s] of their repetition,
    or `None`. **Raises** ValueError for no time, times that are not finite, period <= 0.
    """

    dimensions = {"times": (0, 0, 1), "period": (0, 0, 1)}
    times: jax.Array
    period: jax.Array | None

    def __init__(self, times: Parameter, period: Parameter | None = None):
        self.times = jnp.atleast_1d(parameter("times of breaks", times))
        self.period = None if period is None else positive("period", period)

    def after(self, t: Number, sign: Number = 1) -> Numbers:
        """Return the first break later than t by more than rounding; infinity without one.

        `sign`: -1 for t and the result in reversed time.
        """
        times = sign * self.times
        slack = ULPS * jnp.finfo(self.times.dtype).eps
        if self.period is not None:
            count = (
                jnp.floor((t - times) / self.period + slack * (1 + jnp.abs(t) / self.period)) + 1
            )
            times = times + count * self.period
        return jnp.min(jnp.where(times > t + slack * jnp.abs(t), times, jnp.inf))

    def between(self, t0: Number, t1: Number, sign: Number = 1) -> Numbers:
        """Return the number of breaks after t0 and before t1, summed over lanes."""
        times = sign * self.times
        slack = ULPS * jnp.finfo(self.times.dtype).eps
        low = t0 + slack * jnp.abs(t0)
        high = t1 - slack * jnp.abs(t1)
        if self.period is None:
            return jnp.sum((times > low) & (times < high)).astype(times.dtype)
        before = jnp.ceil((high - times) / self.period) - 1
        until = jnp.floor((low - times) / self.period)
        return jnp.sum(jnp.maximum(before - until, 0))


class Square(eqx.Module):
    """A square wave: mean + amplitude for a share of each period 2 pi/omega, else mean - amplitude.

    It is mean + amplitude while the fractional part of (omega t + phase)/2 pi is below `share`.
    Steps end at its jumps automatically.

    **Arguments:** `amplitude`; `omega`: angular frequency [rad/s]; `phase` [rad]; `mean`: 1 for a
    modulation of stiffness; `share` in (0, 1). Numbers, or arrays over the bonds
    (one omega for all). **Raises** ValueError for omega <= 0, a share outside (0, 1).
    """

    amplitude: jax.Array
    omega: jax.Array
    phase: jax.Array
    mean: jax.Array
    share: jax.Array
    __repr__ = told

    def __init__(
        self,
        amplitude: Parameter,
        omega: Parameter,
        phase: Parameter = 0.0,
        mean: Parameter = 0.0,
        share: Parameter = 0.5,
    ):
        self.amplitude = parameter("amplitude", amplitude)
        self.omega = positive("omega", omega, "It has a period.")
        self.phase = parameter("phase", phase)
        self.mean = parameter("mean", mean)
        self.share = within("share", share, 0, 1, open_low=True, open_high=True)

    @property
    def _turns(self):
        return jnp.mod(self.phase / (2 * jnp.pi), 1)

    def __call__(self, t):
        high = jnp.mod(self.omega * t / (2 * jnp.pi) + self._turns, 1) < self.share
        return self.mean + jnp.where(high, self.amplitude, -self.amplitude)

    @property
    def breaks(self) -> Breaks:
        """The times at which the waveform jumps."""
        period = 2 * jnp.pi / self.omega
        return Breaks(
            jnp.stack(
                jnp.broadcast_arrays(-self._turns * period, (self.share - self._turns) * period)
            ),
            period,
        )


def next_break(breaks: tuple, t: Number, sign: Number = 1) -> Number:
    """Return the first time after t in several `Breaks`."""
    return jnp.min(jnp.stack([b.after(t, sign) for b in breaks]))


def count_breaks(breaks: tuple, t0: Number, t1: Number, sign: Number = 1) -> Number:
    """Return the number of breaks between two times in several `Breaks`."""
    return sum(b.between(t0, t1, sign) for b in breaks)


def signal_of(term: Any) -> str | None:
    """Return the name of the field that holds the term's function of time, or `None`."""
    for name, kind in (type(term).dimensions or {}).items():
        if isinstance(kind, Signal) and getattr(term, name) is not None:
            return name
    return None


def own_breaks(term: Any) -> Breaks | None:
    """Return the `Breaks` of the term's own function of time, or `None`."""
    name = signal_of(term)
    if name is None:
        return None
    given = getattr(term, "breaks", None)
    # Without given breaks, use those that the function itself declares.
    return checked_breaks(getattr(getattr(term, name), "breaks", None) if given is None else given)


def checked_breaks(breaks: Parameter | Breaks | None) -> Breaks | None:
    """Return a list of times as `Breaks`; `None` stays `None`."""
    return breaks if breaks is None or isinstance(breaks, Breaks) else Breaks(breaks)


def as_module(f: Waveform) -> Callable:
    """Return a function of time as a Module."""
    return f if isinstance(f, eqx.Module) else Function(f)
