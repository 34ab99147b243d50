"""`Wave`: a solitary wave as a result."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

from ..checks import traced
from ..orbits.floquet import Floquet
from ..profiles import Profile, Shape
from ..profiles.medium import implicit
from ..results import array
from ..types import Count, Number
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


def full_width(shape: Shape, reach: float) -> Number:
    """The full width at half of the largest strain, whose ends lie within `reach`, with its derivative."""
    known = jax.lax.stop_gradient(shape)
    level = float(known.at("strain", 0.0)) / 2
    half = brentq(lambda x: float(known.at("strain", x)) - level, 0.0, reach, xtol=1e-15)
    # the slope takes ten times as long as the search
    if not traced(shape):
        return jnp.asarray(2 * half)
    gap = shape.at("strain", half) - shape.at("strain", 0.0) / 2
    return 2 * implicit(half, gap, jax.grad(known.strain)(half))
