"""`periodic_wave`: periodic trains of waves about a mean strain."""

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import positive, refuse, traced
from ..base.types import Count, Number, Scalar
from ..lattice import Lattice, State
from ..laws import Law
from ..profiles import Profile, medium_of, one_given, tabled
from ..profiles.medium import one_number, values
from ..profiles.periodic import differentiated, train
from ..results import Result, array

# The number of points in the table.
TABLE = 129
# The number of points per harmonic in an average.
AVERAGED = 4


class Averages(Result):
    r"""Averages over a wavelength of a periodic wave y(theta), theta = k n - omega t.

    The beads are at rest in the mean. Whitham's equations of slowly modulated waves are
    conservation laws of the averages:

        y_t + v_n = 0,   (m v)_t + F_n = 0,   J_t + (S/omega)_n = 0,   k_t + omega_n = 0.

    With the Lagrangian L(omega, k, y) of the family, J = dL/d omega, S/omega = -dL/dk and F =
    -dL/dy.
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
    energy_flux: Number = array("S, the power that a bond transmits to the bead ahead of it.", "W")
    error: Number = array(
        "The estimated relative error: of `lagrangian` relative to `energy`, of `mean_force` to the "
        "largest force, of `mean_strain` to the largest strain.",
        "1",
    )

    @property
    def outcome(self) -> str:
        """The number of contacts in the average, and its accuracy."""
        if traced((self.wavenumber, self.error)):
            return "Not known while traced."
        contacts = 2 * np.pi / self.wavenumber
        return f"Averages over {contacts:.6g} contacts, right to {self.error:.0e} or so."


class PeriodicWave(Profile):
    r"""A periodic train of waves: contact n has the strain phi(n - c t), with a crest at xi = 0.

    m c^2 (phi - mean) = tent * F(phi) less its mean, in the frame in which the beads' mean velocity
    is zero.
    """

    wavelength: Number = array("The wavelength in contacts.", "1")
    mean: Number = array("The mean strain.", "m")
    amplitude: Number = array("(crest - trough)/2.", "m")
    crest: Number = array("The highest strain.", "m")
    trough: Number = array("The lowest strain.", "m")
    energy: Number = array("The energy of a wavelength, from the law's own rest.", "J")

    def _said(self):
        return f"Found to {self.error / abs(self.amplitude):.1e} of its amplitude."

    def state(self, sites: Count, centre: Scalar = 0.0) -> State:
        """Return displacements and velocities (sites,) of a chain with a crest at contact `centre`.

        On a ring, whose number of sites is a multiple of the wavelength, put the mean strain into
        the law, `gx.laws.Strained(wave.law, wave.mean)`, and add `wave.mean n` to the
        displacements.
        """
        return super().state(sites, centre)

    def averages(self) -> Averages:
        """Return mean strain, force, energy, action and their fluxes, for modulation theory."""
        # The curvature of the law is the only source of error of the trapezoidal rule.
        points = AVERAGED * (len(self._shape.strain) // 2 + 1)
        error, amplitude = jax.lax.stop_gradient((self.error, self.amplitude))
        omega = 2 * np.pi * self.speed / self.wavelength
        xi = self.wavelength / points * np.arange(points)
        strain = self.strain(xi)
        F, _, W = values(self.law, strain)
        kinetic = self.mass / 2 * (self.velocity(xi) ** 2).mean()
        potential = W.mean()
        numbers = dict(
            omega=omega,
            wavenumber=2 * np.pi / self.wavelength,
            mean_strain=strain.mean(),
            mean_force=F.mean(),
            kinetic=kinetic,
            potential=potential,
            energy=kinetic + potential,
            lagrangian=kinetic - potential,
            action=2 * kinetic / omega,
            energy_flux=(F * self.velocity(xi + 1)).mean(),
            error=max(float(error / amplitude), points**0.5 * np.finfo(float).eps),
        )
        return Averages(
            **{name: jnp.asarray(x) for name, x in numbers.items()},
            _mark=self._mark,
            _space=self._space,
        )


def periodic_wave(
    law: Law | Lattice,
    wavelength: Scalar,
    *,
    speed: Scalar | None = None,
    amplitude: Scalar | None = None,
    mean: Scalar = 0.0,
    mass: Scalar = 1.0,
) -> PeriodicWave:
    r"""Compute a periodic travelling wave of a chain of equal masses, exact on the lattice.

    Newton's method solves the Fourier form, c^2 m psi_k = sinc^2(k/2) (F(mean + psi))_k for k != 0,
    by continuation from waves of small amplitude, whose speed is (K2/m)^{1/2} sinc(k/2), k = 2
    pi/wavelength. Long waves are trains of solitary waves.

    **Arguments:** `law`, `mass`: as for `solitary_wave`. `wavelength`: in contacts, above 2. One of
    `speed` (contacts per time, positive) and `amplitude`, (crest - trough)/2. `mean`: strain,
    positive in compression, at which the law must have a stiffness.
    **Returns:** `PeriodicWave`, differentiable in all numbers and the law's parameters
    (`jax.grad`, `jax.jvp`; `jax.jit` and `jax.vmap` are refused).
    **Raises** ValueError for a speed or an amplitude that the family does not reach, waves too long
    to resolve, a law without stiffness at the mean or linear there.
    Source: J. C. Eilbeck, R. Flesch, Phys. Lett. A 149, 200 (1990).

    **Example:**

    >>> wave = gx.travelling.periodic_wave(gx.Toda(), 6.0, amplitude=0.2)
    >>> round(float(wave.speed), 6)  # of small waves sin(pi/6)/(pi/6) = 0.9549
    0.964331
    """
    one_given(speed=speed, amplitude=amplitude)
    medium = medium_of(law, mass)
    numbers = dict(mean=mean, wavelength=wavelength, speed=speed, amplitude=amplitude)
    given = medium.law, medium.mass, *numbers.values()
    fixed = medium.known
    s, L, c, a = (one_number(*x) for x in numbers.items())
    if not L > 2:
        refuse(
            "wavelength",
            "more than two contacts",
            f"{L:g}",
            "Shorter waves are the same on a lattice.",
        )
    if a is None:
        positive("speed", c, "For a wave to the left, negate the velocities of its state.")
    else:
        positive("amplitude", a)
    found = train(fixed.law, float(fixed.mass), s, L, c, a)
    if traced(given):
        found = differentiated(found, *given)
        L = wavelength
        s = mean
    return _recorded(medium, found, L, s)


def _recorded(medium, found, wavelength, mean):
    psi = found.strain
    mass = medium.mass
    crest = psi[len(psi) // 2]
    trough = psi[0]
    stored = values(medium.law, mean + psi)[2].mean() + mass / 2 * (found.velocity**2).mean()
    numbers = dict(
        speed=found.speed,
        wavelength=wavelength,
        mean=mean,
        amplitude=(crest - trough) / 2,
        crest=mean + crest,
        trough=mean + trough,
        energy=wavelength * stored,
        residual=found.residual,
        error=found.error,
    )
    return PeriodicWave(
        **{name: jnp.asarray(x) for name, x in numbers.items()},
        law=medium.law,
        mass=medium.mass,
        **tabled(found, np.linspace(-0.5, 0.5, TABLE) * wavelength),
        **medium.origin,
    )
