"""Backbone curves: the frequency of a normal mode over its amplitude, to leading order."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..base.arrays import most
from ..base.checks import described, is_site, refuse, traced
from ..base.programs import compiled
from ..base.types import Count, Displacements, Number, Scalar, StateLike
from ..flow.stepping import matrix
from ..lattice import Lattice, State
from ..linear import normal_modes
from ..linear.stiffness import at_rest
from ..results import Result, array
from .asked import checked_state, force_at, masses

# Modes whose omega^2 differ by less than this share of the largest have one frequency.
ALIKE = 1e-11
# A force below this share of that on the mode is rounding.
ROUNDED = 1e-8


class Backbone(Result):
    r"""The backbone curve of a normal mode: omega^2 = omega_0^2 + curvature a^2.

    The orbits are u(t) = a shape cos(omega t) + a^2 (constant + second cos(2 omega t)) + O(a^3),
    with a the largest displacement of the first harmonic.
    """

    omega: Number = array("The frequency of the mode.", "rad/s")
    omega_squared: Number = array("omega_0^2 of the mode.", "rad^2/s^2")
    curvature: Number = array("d omega^2/d a^2 at a = 0.", "rad^2/s^2/m^2")
    quartic: Number = array(
        "The part of the curvature from the third derivative of the force.", "rad^2/s^2/m^2"
    )
    cubic: Number = array(
        "The part of the curvature from the second derivative of the force, squared.",
        "rad^2/s^2/m^2",
    )
    error: Number = array("The rounding error of the curvature.", "rad^2/s^2/m^2")
    limit: Number = array(
        "The amplitude at which a correction of the shape is as large as the mode itself. The "
        "curve holds well below it. It is infinite where the shape needs no correction.",
        "m",
    )
    shape: Displacements = array("The shape of the mode.", "1", "site ...")
    constant: Displacements = array("The constant correction of the shape.", "1/m", "site ...")
    second: Displacements = array("The second harmonic of the shape.", "1/m", "site ...")

    @property
    def outcome(self) -> str:
        """Whether the mode hardens or softens, and up to which amplitude that is known."""
        if abs(float(self.curvature)) <= float(self.error):
            way = "keeps its frequency to this order"
        else:
            way = "hardens" if float(self.curvature) > 0 else "softens"
        bound = (
            f", for amplitudes well below {self._told('limit', self.limit)}"
            if np.isfinite(self.limit)
            else ""
        )
        return f"The mode at omega = {self._told('omega', self.omega)} {way}{bound}."

    def omega_at(self, amplitude: Scalar) -> Number:
        """Return (omega_0^2 + curvature a^2)^{1/2} [rad/s] at amplitudes a [m] of any shape."""
        return jnp.sqrt(self.omega_squared + self.curvature * jnp.asarray(amplitude) ** 2)

    def state(self, amplitude: Scalar) -> State:
        """Return the orbit's turning point to second order: a guess for `gx.breathers.breather`.

        **Arguments:** `amplitude`: a [m], of either sign. **Returns:** a `State` at rest.
        """
        a = jnp.asarray(amplitude)
        u = jax.tree.map(
            lambda s, c, d: a * s + a * a * (c + d), self.shape, self.constant, self.second
        )
        return State(u, jax.tree.map(jnp.zeros_like, u))


def backbone(lattice: Lattice, mode: Count | StateLike) -> Backbone:
    r"""Compute the backbone curve of a normal mode to leading order.

    That is first order in the quartic potential and second order in the cubic one. With M u'' + K u
    + N2(u, u) + N3(u, u, u) = 0 and a mode phi,

    d omega^2/d a^2 = phi . [2 N2(phi, c) + N2(phi, d) + (3/4) N3(phi, phi, phi)]/(phi . M phi),
    c = -K^{-1} N2(phi, phi)/2,  d = -(K - 4 omega_0^2 M)^{-1} N2(phi, phi)/2

    (Lindstedt and Poincare). The lattice is arbitrary: edge, corner and defect modes, compact
    states of flat bands, waves of a ring. The orbits are
    `gx.breathers.breather(lattice, found.omega_at(a), found.state(a))`.

    **Arguments:** `lattice`: one `Lattice` whose forces are smooth at rest. `mode`: an index into
    `gx.linear.normal_modes`, from the lowest; or a `State` (or displacements) of the mode's shape,
    of any size, such as a compact state or one of several modes with one frequency.

    **Returns:** `Backbone`; for a mode by index, its numbers are differentiable in the lattice's
    parameters.
    **Raises** ValueError for a batch (use `jax.vmap` over `in_axes=-1`), a state that is not a
    mode, a mode that does not oscillate, a mode whose second harmonic or constant part is a mode
    itself, and a mode that drives another one of the same frequency; and where `normal_modes` does.
    Source: Nayfeh, Mook, Nonlinear Oscillations (1979).

    **Example:**

    >>> found = gx.breathers.backbone(gx.scenes.klein_gordon(5, 0.02), 0)
    >>> round(float(found.omega), 6), round(float(found.curvature), 6)
    (1.0, 0.75)
    """
    modes = normal_modes(lattice)
    flat, unravel = ravel_pytree(lattice.zeros())
    phi = matrix(modes.modes)
    mass = masses(lattice)
    squared = modes.omega_squared
    if np.isscalar(mode):
        if not is_site((mode,), (flat.size,)):  # JAX clips an index.
            expected = f"a whole number below {flat.size}, the number of modes"
            refuse("mode", expected, described(mode))
        shape = phi[:, mode]
        own = squared[mode]
    else:
        shape, own = _given(lattice, mode, phi, mass, squared)
    shape = shape / jnp.take(shape, jnp.argmax(jnp.abs(shape)))
    found = _expanded(at_rest(lattice), shape, own, phi, mass, squared)
    if not traced(found):
        _check(found, own, squared)
    numbers, parts, _ = found
    return Backbone(jnp.sqrt(own), own, *numbers, *(unravel(x) for x in parts), **lattice.origin)


def _given(lattice, mode, phi, mass, squared):
    # The given displacements must lie within the modes of one frequency.
    state = mode if isinstance(mode, State) else State(mode, lattice.zeros())
    u, _ = ravel_pytree(checked_state(lattice, state, "mode").u)
    if not float(jnp.abs(u).max()) > 0:
        refuse("mode", "displacements that are not all zero", "the state at rest")
    u = u / jnp.abs(u).max()
    share = phi.T @ (mass * u)
    own = squared[jnp.argmax(jnp.abs(share))]
    near = jnp.abs(squared - own) <= ALIKE * jnp.abs(squared).max()
    shape = phi @ jnp.where(near, share, 0)
    off = float(jnp.abs(shape - u).max())
    if off > ROUNDED:
        refuse(
            "mode",
            "a normal mode",
            f"displacements of which {off:.2g} belong to modes of other frequencies",
            "gx.linear.normal_modes has them, gx.linear.flat_bands the compact states.",
        )
    return jnp.where(u == 0, 0, shape), own


@compiled
def _expanded(lattice, shape, own, phi, mass, squared):
    # Returns the curve's numbers, its displacements, and the quantities that must vanish: forces
    # that would be divided by zero or drive another mode.
    flat = jnp.zeros_like(shape)
    pull = lambda x: -force_at(lattice, x)

    def along(function, v):
        return lambda x: jax.jvp(function, (x,), (v,))[1]

    bent = along(along(pull, shape), shape)
    tiny = jnp.finfo(flat.dtype).tiny
    both = bent(flat) / 2
    third = along(bent, shape)(flat) / 6
    norm = jnp.vdot(shape, mass * shape)
    f = phi.T @ both
    # The forces that a shape without symmetry would drive. Forces that cancel leave rounding of
    # this size.
    uneven = jnp.cos(jnp.arange(flat.size) ** 2.0)
    usual = phi.T @ along(along(pull, uneven), uneven)(flat) / 2
    scale = jnp.maximum(jnp.maximum(jnp.abs(f).max(), jnp.abs(usual).max()), tiny)
    f = jnp.where(jnp.abs(f) <= ALIKE * scale, 0, f)
    floor = ALIKE * jnp.abs(squared).max()

    def response(force, stiffness):
        # Of each mode to a force; and the force on modes without a stiffness, which have none.
        soft = jnp.abs(stiffness) <= floor
        return jnp.where(soft, 0, force / jnp.where(soft, 1, stiffness)), jnp.where(soft, force, 0)

    low, still = response(f, squared)
    high, twice = response(f, squared - 4 * own)
    constant = phi @ (-low / 2)
    second = phi @ (-high / 2)
    # N2(shape, w), twice for the constant part.
    mixed = along(along(pull, shape), 2 * constant + second)(flat) / 2
    cubic = jnp.vdot(shape, mixed) / norm
    quartic = 0.75 * jnp.vdot(shape, third) / norm
    # The omega^2 of each mode is known to rounding of the largest one, and enters as 1/omega^2.
    eps = jnp.finfo(flat.dtype).eps
    size = jnp.abs(squared).max() * flat.size
    weak = jnp.sum(low**2 + high**2)
    error = eps * (size * weak / norm + 8 * (jnp.abs(quartic) + jnp.abs(cubic)))
    drive = phi.T @ (mixed + 0.75 * third)
    drive = jnp.where(jnp.abs(drive) <= ALIKE * jnp.abs(drive).max(), 0, drive)
    mix, alike = response(drive, squared - own)
    mix = jnp.abs(phi @ mix).max()
    mixed_in = jnp.where(mix > 0, jnp.sqrt(jnp.where(mix > 0, mix, 1)), 0)
    limit = 1 / most([jnp.abs(constant), jnp.abs(second), mixed_in])
    stray = phi @ alike - (cubic + quartic) * shape
    relative = lambda force, size: jnp.abs(force).max() / size
    driven = jnp.maximum(jnp.abs(phi @ drive).max(), tiny)
    refused = relative(still, scale), relative(twice, scale), relative(stray, driven)
    return (cubic + quartic, quartic, cubic, error, limit), (shape, constant, second), refused


def _check(found, own, squared):
    still, twice, stray = map(float, found[2])
    if not float(own) > ALIKE * float(jnp.abs(squared).max()):
        refuse(
            "mode",
            "a mode that oscillates",
            f"one with omega^2 = {float(own):.3g}",
            "At rest it has no stiffness, or is unstable.",
        )
    if still > ROUNDED:
        refuse(
            "mode",
            "one whose mean force drives no zero-frequency mode",
            "one that pushes such a mode",
            "Hold the lattice: walls, or on-site springs.",
        )
    if twice > ROUNDED:
        refuse(
            "mode",
            "one whose second harmonic is no mode",
            "one that drives a mode of frequency 2 omega",
            "Both exchange their energy, and no expansion in one amplitude holds.",
        )
    if stray > ROUNDED:
        refuse(
            "mode",
            "one that drives no other mode of its frequency",
            "one that does",
            "Give the combination of these modes that is an orbit, as a State.",
        )
