"""Functions of time: what drives, moves walls and modulates stiffness."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..checks import parameter, positive, within
from ..printing import told
from ..types import Number, Numbers, Parameter, Waveform
from ..units import Dimensional, Signal

# rounding units by which a function may miss the time at which it jumps
ULPS = 16


class Function(eqx.Module):
    """A plain Python function of time, held as static: two equal functions compile once, another compiles anew.

    It must be pure, as JAX asks: a global number that it reads is compiled into the first run and kept. Values that are
    swept, changed or differentiated belong in a Module, like `Harmonic`.
    """

    function: Callable = eqx.field(static=True)
    __repr__ = told

    def __call__(self, t):
        return self.function(t)


class Harmonic(eqx.Module):
    """a cos(omega t + phase): a waveform for `Drive`, `Wall` and `Modulated`, with parameters that can be swept.

    **Arguments:** `amplitude`; `omega`: angular frequency [rad/s]; `phase` [rad]; `mean`: added constant (1 for a
    modulation of stiffness).

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
        self.amplitude, self.omega = parameter("amplitude", amplitude), parameter("omega", omega)
        self.phase, self.mean = parameter("phase", phase), parameter("mean", mean)

    def __call__(self, t):
        return self.mean + self.amplitude * jnp.cos(self.omega * t + self.phase)


class Breaks(Dimensional):
    """Times at which a function of time jumps, itself or a derivative: time steps end there and look to one side alone.

    **Arguments:** `times` [s]: a number or a list, in any order; `period` [s]: those and all that lie whole periods
    away, `None` for those alone. **Raises** ValueError for no time, times that are not finite, period <= 0.
    """

    dimensions = {"times": (0, 0, 1), "period": (0, 0, 1)}
    times: jax.Array
    period: jax.Array | None

    def __init__(self, times: Parameter, period: Parameter | None = None):
        self.times = jnp.atleast_1d(parameter("times of breaks", times))
        self.period = None if period is None else positive("period", period)

    def _wrapped(self, units):
        raise NotImplementedError

    def after(self, t: Number, sign: Number = 1) -> Numbers:
        """The first break after t, later than it by more than rounding; infinity where there is none.

        `sign`: -1 for a time that runs backwards, t and the result being those of that time.
        """
        times, slack = sign * self.times, ULPS * jnp.finfo(self.times.dtype).eps
        if self.period is not None:
            count = (
                jnp.floor((t - times) / self.period + slack * (1 + jnp.abs(t) / self.period)) + 1
            )
            times = times + count * self.period
        return jnp.min(jnp.where(times > t + slack * jnp.abs(t), times, jnp.inf))

    def between(self, t0: Number, t1: Number, sign: Number = 1) -> Numbers:
        """How many breaks lie after t0 and before t1; those of different lanes count each."""
        times, slack = sign * self.times, ULPS * jnp.finfo(self.times.dtype).eps
        low, high = t0 + slack * jnp.abs(t0), t1 - slack * jnp.abs(t1)
        if self.period is None:
            return jnp.sum((times > low) & (times < high)).astype(times.dtype)
        before, until = (
            jnp.ceil((high - times) / self.period) - 1,
            jnp.floor((low - times) / self.period),
        )
        return jnp.sum(jnp.maximum(before - until, 0))


class Square(eqx.Module):
    """mean + amplitude for a share of each period 2 pi/omega, mean - amplitude for the rest: layers in time.

    The former while (omega t + phase)/2 pi, less its whole part, is below `share`. It knows its own breaks: steps end
    there without more ado.

    **Arguments:** `amplitude`; `omega`: angular frequency [rad/s]; `phase` [rad]; `mean`: 1 for a modulation of
    stiffness; `share` in (0, 1), 1/2 for equal layers. Numbers, or arrays over the bonds (one omega for all of them).
    **Raises** ValueError for omega <= 0, a share outside (0, 1).
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
        self.amplitude, self.omega = (
            parameter("amplitude", amplitude),
            positive("omega", omega, "It has a period."),
        )
        self.phase, self.mean = parameter("phase", phase), parameter("mean", mean)
        self.share = within("share", share, 0, 1, open_low=True, open_high=True)

    @property
    def _turns(self):
        return jnp.mod(self.phase / (2 * jnp.pi), 1)

    def __call__(self, t):
        high = jnp.mod(self.omega * t / (2 * jnp.pi) + self._turns, 1) < self.share
        return self.mean + jnp.where(high, self.amplitude, -self.amplitude)

    @property
    def breaks(self) -> Breaks:
        """The times at which it jumps."""
        period = 2 * jnp.pi / self.omega
        return Breaks(
            jnp.stack(
                jnp.broadcast_arrays(-self._turns * period, (self.share - self._turns) * period)
            ),
            period,
        )


def next_break(breaks: tuple, t: Number, sign: Number = 1) -> Number:
    """The first of some `Breaks` after t."""
    return jnp.min(jnp.stack([b.after(t, sign) for b in breaks]))


def count_breaks(breaks: tuple, t0: Number, t1: Number, sign: Number = 1) -> Number:
    """How many of some `Breaks` lie between two times."""
    return sum(b.between(t0, t1, sign) for b in breaks)


def signal_of(term: Any) -> str | None:
    """The field of a term that holds a function of time, as its `dimensions` say; `None` where none does."""
    for name, kind in (type(term).dimensions or {}).items():
        if isinstance(kind, Signal) and getattr(term, name) is not None:
            return name
    return None


def own_breaks(term: Any) -> Breaks | None:
    """The `Breaks` of the function of time that a term holds itself, or `None`."""
    name = signal_of(term)
    if name is None:
        return None
    given = getattr(term, "breaks", None)
    # else those that the function knows itself
    return checked_breaks(getattr(getattr(term, name), "breaks", None) if given is None else given)


def checked_breaks(breaks: Parameter | Breaks | None) -> Breaks | None:
    """`Breaks` from a list of times; `None` stays."""
    return breaks if breaks is None or isinstance(breaks, Breaks) else Breaks(breaks)


def as_module(f: Waveform) -> Callable:
    """A function of time as a Module."""
    return f if isinstance(f, eqx.Module) else Function(f)
