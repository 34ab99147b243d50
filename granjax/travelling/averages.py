r"""Averages of a periodic wave over its wavelength: what modulation theory is made of."""

import jax.numpy as jnp
import numpy as np

from ..checks import traced
from ..profiles import Profile
from ..profiles.medium import values
from ..results import Result, array
from ..types import Number


class Averages(Result):
    r"""Averages over a wavelength of a periodic wave y(theta), theta = k n - omega t, beads at rest in the mean.

    Whitham's equations of slowly modulated waves say that strain, momentum, action and energy are conserved:

        y_t + v_n = 0,   (m v)_t + F_n = 0,   J_t + (S/omega)_n = 0,   k_t + omega_n = 0,

    of the means. With the Lagrangian L(omega, k, y) of the family, J = dL/d omega, S/omega = -dL/dk, F = -dL/dy: so one
    table of a family has all derivatives of its modulation equations, and a check on itself.
    """

    omega: Number = array("The angular frequency.", "rad/s")
    wavenumber: Number = array("The wave number k per site.", "rad")
    mean_strain: Number = array("The mean strain y.", "m")
    mean_force: Number = array("The mean force F beyond the preload.", "N")
    kinetic: Number = array("The kinetic energy per site.", "J")
    potential: Number = array("The potential energy per site, from the law's own rest.", "J")
    energy: Number = array("The energy per site.", "J")
    lagrangian: Number = array("The kinetic energy less the potential energy, per site.", "J")
    action: Number = array("J = 2 `kinetic`/omega per site.", "J s")
    energy_flux: Number = array("S, the power of a bond on the bead ahead of it.", "W")
    error: Number = array("The estimated relative distance from the truth.", "1")

    @property
    def outcome(self) -> str:
        """Over how many contacts, and how well they are known."""
        if traced((self.wavenumber, self.error)):
            return "Not known while traced."
        contacts = 2 * np.pi / self.wavenumber
        return f"Averages over {contacts:.6g} contacts, right to {self.error:.0e} or so."


def averages_of(wave: Profile, points: int, error: float) -> Averages:
    """Averages of a periodic wave by the trapezoidal rule, which is exact of a Fourier form but for the law's curve.

    `error`: the relative one of the wave, to which rounding is added.
    """
    mass, wavelength, omega = (
        float(x) for x in (wave.mass, wave.wavelength, 2 * np.pi * wave.speed / wave.wavelength)
    )
    xi = wavelength / points * np.arange(points)
    strain, own, ahead = (
        np.asarray(x) for x in (wave.strain(xi), wave.velocity(xi), wave.velocity(xi + 1))
    )
    F, _, W = values(wave.law, strain)
    kinetic, potential = mass / 2 * np.mean(own**2), np.mean(W)
    error = max(error, points**0.5 * np.finfo(float).eps)
    numbers = dict(
        omega=omega,
        wavenumber=2 * np.pi / wavelength,
        mean_strain=strain.mean(),
        mean_force=F.mean(),
        kinetic=kinetic,
        potential=potential,
        energy=kinetic + potential,
        lagrangian=kinetic - potential,
        action=2 * kinetic / omega,
        energy_flux=np.mean(F * ahead),
        error=error,
    )
    return Averages(
        **{name: jnp.asarray(x) for name, x in numbers.items()},
        _mark=wave._mark,
        _space=wave._space,
    )
