"""`Wave`: a solitary wave as a result."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import traced
from ..lattice import State
from ..laws import Law
from ..orbits.floquet import Floquet
from ..profiles import Shape
from ..results import Held, Result
from ..types import Count, Number, Numbers, Parameter, Scalar
from .stability import stability


class Wave(Result):
    r"""A wave that runs without changing its shape: strain phi(n - c t) of contact n, between the beads n and n + 1.

    m c^2 phi = tent * F(phi), tent(x) = [1 - |x|]_+. Places xi = n - c t count contacts; the beads ahead of the wave
    are at rest, and each has moved by `compression` when it has passed.

    **Fields:**

    - `speed`: c, contacts per time [1/s]; below zero it runs to the left.
    - `amplitude`: phi(0), the largest strain, below zero for tension [m]. `width`: contacts between the places where
      the strain is half of that. `compression`: int phi [m].
    - `energy`: int (phi F/2 + W) [J]; kinetic energy is int phi F/2. `momentum`: m c int phi [N s].
    - `decay`: kappa of the tail exp(-kappa |xi|); NaN for a tail that falls faster than that (no sound at rest), ln
      phi(xi + 1) = `exponent` ln phi(xi) in the main, so ln |ln phi| grows as xi ln(exponent); NaN where `decay` is.
    - `residual`: what the equation leaves between the places of the solution, by finer integrals, relative to the
      strain. `error`: estimated distance of the strain from the truth [m], from that and from rounding.
    - `xi`, `strains`, `velocities`: a table, for pictures and files; `strain(xi)` gives any place.
    - `law`, `mass`: what it runs through.

    Differentiable once in the parameters of the law, the mass and the given speed, amplitude or energy, by the implicit
    function theorem (`jax.grad`, `jax.jvp`, `jax.jacfwd`); `jax.jit` and `jax.vmap` around the search are refused.

    **Example:**

    >>> wave = gx.travelling.solitary_wave(gx.Hertz(), speed=1.0)
    >>> round(float(wave.energy), 6), round(float(wave.strain(1.0)), 6)
    (2.823487, 0.583929)
    """

    held: ClassVar[dict[str, Held]] = {
        "speed": Held("", "1/s"),
        "amplitude": Held("", "m"),
        "energy": Held("", "J"),
        "momentum": Held("", "N s"),
        "compression": Held("", "m"),
        "width": Held("", "1"),
        "decay": Held("", "1"),
        "exponent": Held("", "1"),
        "residual": Held("", "1"),
        "error": Held("", "m"),
        "mass": Held("", "kg"),
        "xi": Held("xi", "1"),
        "strains": Held("xi", "m"),
        "velocities": Held("xi", "m/s"),
    }
    speed: Number
    amplitude: Number
    energy: Number
    momentum: Number
    compression: Number
    width: Number
    decay: Number
    exponent: Number
    residual: Number
    error: Number
    law: Law
    mass: Number
    xi: Numbers
    strains: Numbers
    velocities: Numbers
    outcome: str
    _shape: Shape = eqx.field(kw_only=True, repr=False)

    def strain(self, xi: Parameter) -> Numbers:
        """Compression of the contacts at places xi = n - c t, of any shape [m]."""
        return self._shape.at("strain", xi)

    def velocity(self, xi: Parameter) -> Numbers:
        """Velocity of the beads at places xi [m/s]: largest at xi = 1/2, midway between two contacts."""
        return self._shape.at("velocity", xi)

    def displacement(self, xi: Parameter) -> Numbers:
        """Displacement of the beads at places xi [m]: zero ahead of the wave, `compression` behind it."""
        return self._shape.at("displacement", xi)

    def state(self, sites: Count, centre: Scalar | None = None) -> State:
        """Displacements and velocities (sites,) of a chain whose peak is at contact `centre`, a real number.

        `None` is the middle of the chain, (sites - 2)/2. Meant for a long chain with free ends: the beads ahead are at
        rest in place, those behind have moved by `compression`, which a wall there would feel.
        """
        middle = (sites - 2) / 2 if centre is None else centre
        xi = np.arange(sites) - middle
        return State(self.displacement(xi), self.velocity(xi))

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
