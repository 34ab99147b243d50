r"""The nonlinear Schroedinger equation of wave packets in a periodic chain: solitons, instability.

A cell has P sites of mass m_j. Bond j joins site j to site j+1 (the last one to the next cell) with
the force F_j(y) = K2_j y + K3_j y^2 + K4_j y^3 of the strain y_j = u_j - u_{j+1}, compression
positive; `granjax.laws.taylor` gives the coefficients. A packet at wave number k per cell,

    y_j(n, t) = eps [s_j Y(X, T) e^{i (k n + omega t)} + c.c.] + O(eps^2),
    X = eps (n - c t),  T = eps^2 t,

with c = -d omega/dk obeys

    i Y_T + nu2 Y_XX + nu3 |Y|^2 Y = 0,   nu2 = -(d^2 omega/dk^2)/2,

so that a uniform wave has the frequency omega + nu3 |eps Y|^2 (nu3 > 0: hardening). X counts cells.
Bright solitons exist for nu2 nu3 > 0, dark ones for nu2 nu3 < 0.

**Amplitude**: the mean of |s_j|^2 over the bonds of a cell is 1. So 2 |eps Y| is the amplitude of a
bond, in the root mean square if the bonds of a cell differ.

**Constant force or fixed length.** At second order the wave also causes a mean strain. At constant
force this strain follows the envelope freely. At fixed length its mean over the chain is zero. This
changes only the frequency of a wave that fills the chain: a modulation of the wave (the dip of a
dark soliton, the instability) still carries its own mean strain and keeps the nu3 of constant
force.

Source: G. Huang, B. Hu, Phys. Rev. B 57, 5746 (1998); C. Chong, P. G. Kevrekidis, Coherent
Structures in Granular Crystals (Springer, 2018). The fixed-length relation is tested against
periodic orbits of rings.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ..base.checks import concrete, parameter, refuse, show, traced
from ..base.derivatives import with_slope
from ..base.programs import compiled
from ..base.types import Count, Number, Parameter, Scalar
from ..results import Result, array
from .chain_wave import _numbers, _sech
from .nls_coefficients import B, Coefficients, coefficients

__all__ = [
    "B",
    "Coefficients",
    "Profile",
    "bright",
    "bright_profile",
    "coefficients",
    "dark",
    "dark_profile",
    "growth_rate",
]


def bright(
    X: Number, T: Number, kappa: Number, nu2: Number, nu3: Number, X0: Number = 0.0
) -> Complex[Array, "..."]:
    r"""Return the bright soliton at rest.

        Y = (2 kappa/nu3)^{1/2} sech[(kappa/nu2)^{1/2} (X - X0)] exp(i kappa T)

    **Arguments:** `X`, `T`: arrays that broadcast; `kappa`: shift of the frequency, of the sign of
    nu2 and nu3; `nu2`, `nu3`: as in `coefficients`, at constant force; `X0`: centre.

    **Returns:** Y, complex.

    **Raises** ValueError where nu2 nu3 < 0 (dark solitons only) or kappa nu3 <= 0.

    **Example:**

    >>> complex(gx.theory.nls.bright(0.0, 0.0, 0.02, nu2=1.0, nu3=1.0))
    (0.2+0j)
    """
    amplitude, width = _bright(kappa, nu2, nu3)
    return amplitude * _sech(width * (X - X0)) * jnp.exp(1j * kappa * T)


def dark(
    X: Number,
    T: Number,
    kappa: Number,
    nu2: Number,
    nu3: Number,
    X0: Number = 0.0,
    nu3_force: Number | None = None,
) -> Complex[Array, "..."]:
    r"""Return the black soliton.

        Y = (kappa/nu3)^{1/2} tanh[(-nu3_force kappa/(2 nu2 nu3))^{1/2} (X - X0)] exp(i kappa T)

    At constant force nu3_force = nu3 and the inverse width is (-kappa/(2 nu2))^{1/2}. At fixed
    length the background has the nu3 of fixed length (monomer at k = pi: 3 K4 K2^{-1/2}, m = 1),
    and the dip that of constant force.

    **Arguments:** as in `bright`; `nu3`: of the background; `nu3_force`: of the dip, by default the
    same.

    **Returns:** Y, complex.

    **Raises** ValueError where nu2 nu3_force > 0 (bright solitons only) or kappa nu3 <= 0.

    **Example:**

    >>> complex(gx.theory.nls.dark(0.0, 0.0, -0.02, nu2=1.0, nu3=-1.0))  # nothing in the middle
    0j
    >>> round(float(abs(gx.theory.nls.dark(1e3, 0.0, -0.02, nu2=1.0, nu3=-1.0))), 6)
    0.141421
    """
    nu3_force = nu3 if nu3_force is None else nu3_force
    amplitude, width = _dark(kappa, nu2, nu3, nu3_force)
    return amplitude * jnp.tanh(width * (X - X0)) * jnp.exp(1j * kappa * T)


def growth_rate(
    Q: Parameter, amplitude: Parameter, nu2: Number, nu3: Number
) -> Float[Array, "..."]:
    r"""Return the growth rate per unit T of a modulation e^{iQX} of a uniform wave.

        [nu2 Q^2 (2 nu3 |Y|^2 - nu2 Q^2)]^{1/2}

    It is zero where the bracket is not positive, and largest, nu3 |Y|^2, at Q^2 = nu3 |Y|^2/nu2.

    **Arguments:** `Q`: per cell; `amplitude`: |Y|; `nu2`, `nu3`: as in `coefficients`, at constant
    force, even if the chain has a fixed length.

    **Returns:** array of the broadcast shape.

    Source: T. B. Benjamin, J. E. Feir, J. Fluid Mech. 27, 417 (1967).

    **Example:**

    >>> print(gx.theory.nls.growth_rate([0.1, 0.2], 0.1, nu2=1.0, nu3=1.0).round(6))
    [0.01 0.  ]
    """
    Q, amplitude, nu2, nu3 = _numbers(Q=Q, amplitude=amplitude, nu2=nu2, nu3=nu3)
    square = nu2 * Q**2 * (2 * nu3 * amplitude**2 - nu2 * Q**2)
    # this way a NaN stays a NaN
    stable = square <= 0
    return jnp.where(stable, 0.0, jnp.sqrt(jnp.where(stable, 1.0, square)))


class Profile(Result):
    """A breather of N sites at a turning point (all velocities zero), to second order in amplitude.

    **Example:**

    >>> found = gx.theory.nls.coefficients(1.0, 1.5, 0.375, -0.0625, np.pi)
    >>> dark = gx.theory.nls.dark_profile(found, 0.99 * 6**0.5, 41)
    >>> dark.strain.shape, round(float(dark.kappa), 6)
    ((41,), -0.024495)
    """

    strain: Float[Array, " site"] = array(
        "y_i = u_i - u_{i+1} of the bond to the right of site i; the last bond leaves the chain."
    )
    mean_strain: Float[Array, " site"] = array("The part of the strain that does not oscillate.")
    displacement: Float[Array, " site"] = array(
        "The displacements of the sites; `strain` is their difference."
    )
    amplitude: Float[Array, ""] = array("|Y| at the centre (bright) or far from it (dark).")
    inverse_width: Float[Array, ""] = array("The inverse width of the envelope.", "1/cell")
    omega: Float[Array, ""] = array("The frequency of the breather.", "rad/s")
    kappa: Float[Array, ""] = array("The breather's frequency minus the linear one.", "rad/s")

    @property
    def outcome(self) -> str:
        if traced(self.omega):
            return "Not known inside a transformation."
        return f"A breather of frequency {show(self.omega)}, that of the linear wave shifted by {show(self.kappa)}."


def bright_profile(
    coefficients: Coefficients, omega: Scalar, cells: Count, centre: Scalar | None = None
) -> Profile:
    r"""Return the bright breather of frequency omega on a chain of cells.

    Its envelope is 2 (2 kappa/nu3)^{1/2} sech[(kappa/nu2)^{1/2} x], kappa = omega - omega(k). The
    strain contains the oscillation at its turning point, the second harmonic and the mean strain.
    Constant force and fixed length agree, as the chain is at rest far away.

    **Arguments:**

    - `coefficients`: the result of `nls.coefficients` at k = 0 or pi, where the packet stands
      still.
    - `omega`: frequency of the breather, on the side of omega(k) to which the nonlinearity shifts
      it.
    - `cells`: number of cells; the chain begins with the first site of a cell.
    - `centre`: 4 is site 4, 4.5 the bond between 4 and 5; `None`: the middle, (N - 1)/2.

    **Returns:** `Profile`. The relative error of the strain is of the order of `inverse_width`
    squared.

    **Raises** ValueError for another k, where nu2 nu3 < 0, and for omega on the other side.

    **Example:**

    >>> found = gx.theory.nls.coefficients(1.0, 0.5, -0.125, 0.0625, np.pi)  # PowerLaw(1, 1/2, 1), which softens
    >>> bright = gx.theory.nls.bright_profile(found, 1.01 * 2**0.5, 40)
    >>> bright.strain.shape, round(float(bright.amplitude), 4)
    ((40,), 0.5657)
    """
    c = coefficients
    kappa = _kappa(coefficients, omega, coefficients.nu3_force)
    amplitude, width = _bright(kappa, c.nu2, c.nu3_force)
    return _breather(c, kappa, _sech, amplitude, width, 0.0, cells, centre)


def dark_profile(
    coefficients: Coefficients, omega: Scalar, cells: Count, centre: Scalar | None = None
) -> Profile:
    r"""Return the dark breather of frequency omega on a chain of cells.

    Its envelope is 2 (kappa/nu3)^{1/2} tanh[b x], with b as in `dark` and kappa = omega - omega(k).
    Arguments and result are those of `bright_profile`. At fixed length (`coefficients` with
    `constraint="length"`) the mean strain vanishes far from the dip, as in an infinite chain; a
    ring of N sites is also stretched by the dip's mean strain over N.

    **Raises** ValueError for k other than 0 or pi, where nu2 nu3_force > 0, and for omega on the
    other side.

    **Example:**

    >>> found = gx.theory.nls.coefficients(1.0, 1.5, 0.375, -0.0625, np.pi)
    >>> round(float(gx.theory.nls.dark_profile(found, 0.99 * 6**0.5, 41).amplitude), 5)
    0.23094
    """
    c = coefficients
    kappa = _kappa(coefficients, omega, coefficients.nu3)
    amplitude, width = _dark(kappa, c.nu2, c.nu3, c.nu3_force)
    background = (c.mean_strain - c.mean_strain_force) * amplitude**2
    return _breather(c, kappa, jnp.tanh, amplitude, width, background, cells, centre)


def _bright(kappa, nu2, nu3):
    kappa, nu2, nu3, _ = _signs(1, kappa, nu2, nu3, nu3)
    return jnp.sqrt(2 * kappa / nu3), jnp.sqrt(kappa / nu2)


def _dark(kappa, nu2, nu3, nu3_force):
    kappa, nu2, nu3, nu3_force = _signs(-1, kappa, nu2, nu3, nu3_force)
    return jnp.sqrt(kappa / nu3), jnp.sqrt(-nu3_force * kappa / (2 * nu2 * nu3))


# refuses a pair unless nu2 nu3_force has the sign `focusing`
def _signs(focusing, kappa, nu2, nu3, nu3_force):
    name = "nu3" if nu3_force is nu3 else "nu3_force"
    given = _numbers(kappa=kappa, nu2=nu2, nu3=nu3, nu3_force=nu3_force)
    if traced(given):
        return given
    shift, two, three, force = map(np.asarray, given)
    if not (np.sign(two * force) == focusing).all():
        wanted, other = ("bright", "dark") if focusing == 1 else ("dark", "bright")
        signs = [
            "> 0" if (x > 0).all() else "< 0" if (x < 0).all() else "of 0" for x in (force, two)
        ]
        refuse(
            f"nu2, {name}",
            f"a pair with {wanted} solitons",
            f"{name} = {show(force)} and nu2 = {show(two)}",
            f"{name} {signs[0]} with nu2 {signs[1]}: only {other} solitons exist here.",
        )
    if not (shift * three > 0).all():
        refuse("kappa", f"a shift of the sign of nu3 = {show(three)}", show(shift), _shifts(three))
    return given


def _shifts(nu3):
    way = "raises" if (nu3 > 0).all() else "lowers"
    return f"The nonlinearity {way} the frequency of this wave."


def _kappa(c, omega, nu3):
    omega = parameter("omega", omega)
    k, resonant, linear, nu3 = map(concrete, (c.k, c.resonant, c.omega, nu3))
    if k is not None and abs(np.sin(k)) > max(1e-9, 4 * np.finfo(k.dtype).eps):
        refuse(
            "coefficients", "those of k = 0 or pi, where a packet stands still", f"k = {show(k)}"
        )
    if resonant is not None and resonant:
        refuse("coefficients", "an envelope equation", "none", c.outcome)
    kappa = concrete(omega - c.omega)
    if kappa is not None and nu3 is not None and not (kappa * nu3 > 0).all():
        side = "above" if nu3 > 0 else "below"
        refuse(
            "omega",
            f"a frequency {side} {show(linear)}, that of the linear wave",
            show(omega),
            _shifts(nu3),
        )
    return omega - c.omega


def _breather(c, kappa, shape, amplitude, width, background, cells, centre):
    centre = (len(c.mode) * cells - 1) / 2 if centre is None else centre
    centre = parameter("centre", centre)
    strains = _profile(c, shape, amplitude, width, background, cells, centre)
    return Profile(*strains, amplitude, width, kappa + c.omega, kappa)


@compiled
def _profile(c, shape, amplitude, width, background, cells, centre):
    P = len(c.mode)
    i = np.arange(P * cells)
    j = i % P
    sign = jnp.where(jnp.cos(c.k) > 0, 1, -1) ** (i // P)
    envelope = lambda x: amplitude * shape(width * x / P)
    bonds = i + 0.5 - centre
    # A modulated wave strains bond j by s A - i (ds/dk) A'. The envelope is evaluated at the bond
    # itself, which covers part of the second term; `lag` is the rest of it.
    s = jnp.real(c.strain)
    lag = P * jnp.imag(c.strain_slope) - s * np.arange(P)
    lag = lag - s * jnp.sum(s * lag) / jnp.sum(s**2)
    A, slope = with_slope(envelope, bonds)
    swing = 2 * sign * (s[j] * A + lag[j] * slope) + 2 * jnp.real(c.harmonic_strain)[j] * A**2
    mean = c.mean_strain_force[j] * A**2 + jnp.broadcast_to(background, P)[j]
    u, drift = (-jnp.append(0, jnp.cumsum(strain)[:-1]) for strain in (swing, mean))
    A = envelope(i - centre)
    wave = 2 * sign * jnp.real(c.mode)[j] * A + 2 * jnp.real(c.harmonic_mode)[j] * A**2
    return swing + mean, mean, u + jnp.mean(wave - u) + drift - jnp.mean(drift)
