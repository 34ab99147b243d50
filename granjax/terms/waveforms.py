"""Functions of time: what drives, moves walls and modulates stiffness."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..checks import parameter, refuse
from ..types import Parameter


class Function(eqx.Module):
    """A plain Python function of time, held as static: two equal functions compile once, another compiles anew.

    What it reads from outside (closures, globals) counts as it stands at each run: another number compiles anew. Values
    that are swept or differentiated belong in a Module, like `Harmonic`.
    """

    function: Callable = eqx.field(static=True)

    def __call__(self, t):
        return self.function(t)


class Harmonic(eqx.Module):
    """a cos(omega t + phase): a waveform for `Drive`, `Wall` and `Modulated`, with parameters that can be swept.

    **Arguments:** `amplitude`; `omega`: angular frequency [rad/s]; `phase` [rad]; `mean`: added constant (1 for a
    modulation of stiffness).
    """

    amplitude: jax.Array
    omega: jax.Array
    phase: jax.Array
    mean: jax.Array

    def __init__(self, amplitude: Parameter, omega: Parameter, phase: Parameter = 0.0, mean: Parameter = 0.0):
        self.amplitude, self.omega = parameter("amplitude", amplitude), parameter("omega", omega)
        self.phase, self.mean = parameter("phase", phase), parameter("mean", mean)

    def __call__(self, t):
        return self.mean + self.amplitude * jnp.cos(self.omega * t + self.phase)


def checked_waveform(name: str, f: Any):
    """A function of time as a Module."""
    if not callable(f):
        refuse(name, "a function of time", repr(f), "Give f(t), or Harmonic(amplitude, omega).")
    return f if isinstance(f, eqx.Module) else Function(f)
