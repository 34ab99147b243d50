"""`Wave`: a solitary wave as a result."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import traced
from ..laws import Law
from ..orbits.floquet import Floquet
from ..profiles import Profile, Shape
from ..results import array
from ..types import Count, Number, Numbers
from .stability import stability


class Wave(Profile):
    r"""A wave that runs without changing its shape: strain phi(n - c t) of contact n, between the beads n and n + 1.

    m c^2 phi = tent * F(phi), tent(x) = [1 - |x|]_+. Places xi = n - c t count contacts; the beads ahead of the wave
    are at rest, and each has moved by `compression` when it has passed. Beads are fastest at xi = 1/2, midway between
    two contacts. `state` is meant for a long chain with free ends: the beads ahead are at rest in place, those behind
    have moved, which a wall there would feel.

    Differentiable once in the parameters of the law, the mass and the given speed, amplitude or energy, by the implicit
    function theorem (`jax.grad`, `jax.jvp`, `jax.jacfwd`); `jax.jit` and `jax.vmap` around the search are refused.
    """

    speed: Number = array(
        "The speed c in contacts per time; negative where the wave runs to the left.", "1/s"
    )
    amplitude: Number = array("The largest strain phi(0), negative for tension.", "m")
    energy: Number = array("int (phi F/2 + W); the kinetic energy is int phi F/2.", "J")
    momentum: Number = array("m c int phi.", "N s")
    compression: Number = array("int phi.", "m")
    width: Number = array(
        "The number of contacts between the places where the strain is half of the amplitude.", "1"
    )
    decay: Number = array(
        "kappa of the tail exp(-kappa |xi|); NaN for a tail that falls faster (no sound at rest).",
        "1",
    )
    exponent: Number = array(
        "ln phi(xi + 1) / ln phi(xi) of a tail that falls faster than an exponential; NaN "
        "where there is a `decay`.",
        "1",
    )
    residual: Number = array(
        "What the equation leaves between the places of the solution, relative to the strain.", "1"
    )
    error: Number = array("The estimated distance of the strain from the truth.", "m")
    law: Law = array("The law of the contacts.")
    mass: Number = array("The mass of the beads.", "kg")
    xi: Numbers = array("The places of the table.", "1", "xi")
    strains: Numbers = array("The strains of the table; `strain(xi)` gives any place.", "m", "xi")
    velocities: Numbers = array("The velocities of the table.", "m/s", "xi")

    @property
    def outcome(self) -> str:
        """How well it is known, and how its tail falls."""
        if traced((self.amplitude, self.error, self.decay, self.exponent)):
            return "Not known while traced."
        tail = (
            f"exp(-{self.decay:.6g} |xi|)"
            if np.isfinite(self.decay)
            else f"double exponential, of exponent {self.exponent:.6g}"
        )
        share = self.error / abs(self.amplitude)
        return f"Found to {share:.1e} of its peak; its tail is {tail}."

    def floquet(
        self, sites: Count | None = None, ends: str | None = None, **keywords: Any
    ) -> Floquet:
        """Stability over the time in which it runs one site: `granjax.travelling.stability`."""
        return stability(self, sites, ends, **keywords)


def half_width(shape: Shape, reach: float) -> float:
    """Where the strain is half of its largest, for a shape that falls from xi = 0 on, known to lie before `reach`."""
    low, high = 0.0, float(reach)
    for _ in range(5):
        grid = np.linspace(low, high, 64)
        values = np.abs(np.asarray(shape.at("strain", np.append(grid, 0.0))))
        above = values[:-1] > values[-1] / 2
        k = min(int(np.argmin(above)), 63) or 63
        low, high = grid[k - 1], grid[k]
    share = (values[k - 1] - values[-1] / 2) / (values[k - 1] - values[k])
    return float(low + share * (high - low))


def implicit_width(shape: Shape, half: float) -> Number:
    """Twice the place `half` at which the strain is half of the peak, with its derivative."""
    if not traced(shape):
        return jnp.asarray(2 * half)
    known = jax.lax.stop_gradient(shape)
    slope = jax.grad(lambda x: known.strain(x))(half)
    gap = shape.strain(half) - shape.strain(0.0) / 2
    return 2 * (half - (gap - jax.lax.stop_gradient(gap)) / slope)
