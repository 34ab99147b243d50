"""First-order lattices i dpsi/dt = dH/dpsi*: DNLS, Salerno (Ablowitz-Ladik), electrical, DpS."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import padded, trailing
from ..base.checks import non_negative, one_of, parameter, positive, refuse, whole, within
from ..base.printing import told
from ..base.types import Amplitudes, Count, Flags, Number, Numbers, Parameter, Scalar
from ..lattice import State
from ..laws import Law, Linear, plus_power
from ..strains import BOUNDARIES
from ..terms.fractional import checked_order
from .coupling import Coupling, of_order, of_weights


class Equation(eqx.Module):
    """A first-order lattice i dpsi_n/dt = dH/dpsi_n*, with psi complex of shape (N, *lanes).

    To add one, give it `sites` and `energy`, real and independent of the phase of psi (then the
    norm is kept), and `gradient` if that is cheaper than automatic differentiation. With other
    Poisson brackets it also needs `rate` and `norm`, as `Salerno`.
    """

    sites: eqx.AbstractVar[int]
    __repr__ = told

    @abc.abstractmethod
    def energy(self, psi: Amplitudes) -> Numbers:
        """Return H, one number per lane."""

    def gradient(self, psi: Amplitudes) -> Amplitudes:
        """Return dH/dpsi*, of psi's shape."""
        return jnp.conj(jax.grad(lambda psi: jnp.sum(self.energy(psi)))(psi)) / 2

    def rate(self, psi: Amplitudes) -> Amplitudes:
        """Return i dpsi/dt, which is dH/dpsi* for the standard brackets."""
        return self.gradient(psi)

    def norm(self, psi: Amplitudes) -> Numbers:
        """Return the sum of |psi_n|^2 over the sites, one number per lane."""
        return jnp.sum(density(psi), axis=0)

    @property
    def has_flows(self) -> Flags:
        """Whether H = H1 + H2 with exact flows `drift` and `kick`, as of `DNLS`, for `SplitStep`."""
        return False


def check_shape(psi: Any, equation: Any) -> None:
    """Refuse an array that does not have the sites of an equation."""
    if jnp.ndim(psi) == 0 or jnp.shape(psi)[0] != equation.sites:
        refuse("psi", f"shape ({equation.sites},), then lanes", f"shape {jnp.shape(psi)}")


def field(t: Any, psi: Amplitudes, equation: Equation) -> Amplitudes:
    """Return dpsi/dt = -i `rate`, a vector field f(t, psi, args) for `gx.Flow` and diffrax."""
    check_shape(psi, equation)
    return -1j * equation.rate(psi)


class DNLS(Equation):
    r"""The discrete nonlinear Schroedinger equation, with any linear coupling (also fractional).

    i dpsi_n/dt = e_n psi_n + V sum_{m != 0} c_|m| (psi_n - psi_{n+m}) - g(|psi_n|^2) psi_n,
    g(x) = chi x.

    It keeps the norm and, with G' = g,

    H = sum_n e_n |psi_n|^2 + V sum_{n, m>0} c_m |psi_{n+m} - psi_n|^2 - G(|psi_n|^2).

    Its band is [0, 4 V], or [0, 4^s V] for the order s. The tight-binding form with -V (psi_{n+1} +
    psi_{n-1}) is the same in a rotating frame, psi exp(2 i V t). chi > 0 focuses (V > 0): bright
    solitons lie below the band. The dimer is `DNLS(2, V, chi, boundary="fixed")`.

    **Arguments:**

    - `sites`: N >= 2, on a ring >= 3.
    - `coupling`: V [rad/s]. `nonlinearity`: chi [rad/s per |psi|^2], or a `Law` whose force is g,
      of |psi|^2.
    - `order`: s in (0, 1] of a fractional Laplacian, with weights c_m from
      `gx.fractional.kernel(s, M)`.
    - `kernel`: weights c_1, ..., c_M (M,) instead. Without both, next neighbours.
    - `potential`: e_n [rad/s], a number, or one per site (N,).
    - `boundary`: `"periodic"`; `"fixed"`, psi = 0 beyond the ends; `"free"`, no sites there.

    All numbers, s too, may have lanes (*lanes), be traced and differentiated.
    **Raises** ValueError for s outside (0, 1], an order beside a kernel, potentials of another
    length, unknown boundaries. Sources: Kenkre, Campbell, PRB 34, 4959 (1986); Molina, Phys. Lett.
    A 384, 126180 (2020).

    **Example:**

    >>> chain = gx.first_order.DNLS(20, coupling=1.0, nonlinearity=1.0)
    >>> psi = np.eye(20)[10] + 0j
    >>> float(chain.norm(psi)), float(chain.energy(psi))
    (1.0, 1.5)
    """

    coupling: jax.Array
    nonlinearity: Law
    potential: jax.Array | None
    laplacian: Coupling
    sites: int = eqx.field(static=True)

    def __init__(
        self,
        sites: Count,
        coupling: Parameter = 1.0,
        nonlinearity: Parameter | Law = 1.0,
        *,
        order: Parameter | None = None,
        kernel: Parameter | None = None,
        potential: Parameter | None = None,
        boundary: str = "periodic",
    ):
        self.sites = _sites(sites, boundary)
        self.coupling = parameter("coupling", coupling)
        if not isinstance(nonlinearity, Law):
            nonlinearity = Linear(parameter("nonlinearity", nonlinearity))
        self.nonlinearity = nonlinearity
        if potential is not None:
            potential = jnp.atleast_1d(parameter("potential", potential))
            if len(potential) not in (1, self.sites):
                wanted = f"one number, or one per site, shape ({self.sites},)"
                refuse("potential", wanted, f"shape {potential.shape}")
        self.potential = potential
        if order is not None and kernel is not None:
            refuse("kernel", "a kernel, or an order", "both", "Leave one of them out.")
        if kernel is None:
            self.laplacian = of_order(
                self.sites, checked_order(1.0 if order is None else order), boundary
            )
        else:
            weights = parameter("kernel", kernel)
            self.laplacian = of_weights(self.sites, weights, boundary)

    def energy(self, psi):
        squares = density(psi)
        bonds = self.coupling * jnp.sum(jnp.real(jnp.conj(psi) * self.laplacian(psi)), axis=0)
        if self.potential is not None:
            bonds = bonds + jnp.sum(trailing(self.potential, psi.ndim) * squares, axis=0)
        return bonds - jnp.sum(self.nonlinearity.energy(squares), axis=0)

    def gradient(self, psi):
        return self.coupling * self.laplacian(psi) + self._shift(psi) * psi

    @property
    def has_flows(self):
        return self.laplacian.diagonal is None or self.laplacian.modes is not None

    def drift(self, psi: Amplitudes, time: Number) -> Amplitudes:
        """Return the exact flow of the linear coupling."""
        return self.laplacian.flow(psi, time * self.coupling)

    def kick(self, psi: Amplitudes, time: Number) -> Amplitudes:
        """Return the exact flow of each site by itself."""
        return psi * jnp.exp(-1j * time * self._shift(psi))

    def _shift(self, psi):
        own = -self.nonlinearity.force(density(psi))
        return own if self.potential is None else own + trailing(self.potential, psi.ndim)


# below this mu |psi|^2 a series replaces the logarithm, exact to rounding
SMALL = 0.05
# the terms of this series
TERMS = 12


# what is padded beyond the ends
BEYOND = {"periodic": "wrap", "fixed": "constant", "free": "edge"}


class Salerno(Equation):
    r"""Salerno's lattice, between the Ablowitz-Ladik lattice and DNLS.

    i dpsi_n/dt = V [2 psi_n - (1 + mu |psi_n|^2) (psi_{n+1} + psi_{n-1})] - chi |psi_n|^2 psi_n.

    chi = 0 is the integrable Ablowitz-Ladik lattice, mu = 0 is `DNLS`. With the brackets i
    dpsi_n/dt = (1 + mu |psi_n|^2) dH/dpsi_n*
    it keeps the norm sum ln(1 + mu |psi_n|^2)/mu and

    H = sum_n -2 V Re(psi_n* psi_{n+1}) + (2 V + chi/mu) ln(1 + mu |psi_n|^2)/mu - chi |psi_n|^2/mu.

    For chi = 0 the soliton at rest is sinh(b) sech(b (n - x)) exp(-i omega t)/sqrt(mu) at any x,
    with omega = 2 V (1 - cosh b).

    **Arguments:** `sites`: N >= 2, on a ring >= 3. `coupling`: V [rad/s]. `nonlinearity`: chi
    [rad/s per |psi|^2]. `intersite`: mu >= 0 [per |psi|^2]. `boundary`: `"periodic"`, or `"fixed"`,
    psi = 0 beyond the ends. Numbers may have lanes (*lanes). **Raises** ValueError for mu < 0 and
    other boundaries.
    Sources: Ablowitz, Ladik, J. Math. Phys. 17, 1011 (1976); Salerno, Phys. Rev. A 46, 6856 (1992).

    **Example:**

    >>> chain = gx.first_order.Salerno(21, intersite=1.0)
    >>> psi = np.sinh(1.0) / np.cosh(np.arange(21) - 10.0)
    >>> bool(abs(chain.rate(psi) - 2 * (1 - np.cosh(1.0)) * psi).max() < 1e-3)
    True
    """

    coupling: jax.Array
    nonlinearity: jax.Array
    intersite: jax.Array
    sites: int = eqx.field(static=True)
    boundary: str = eqx.field(static=True)

    def __init__(
        self,
        sites: Count,
        coupling: Parameter = 1.0,
        nonlinearity: Parameter = 0.0,
        intersite: Parameter = 1.0,
        *,
        boundary: str = "periodic",
    ):
        self.sites = _sites(sites, boundary, ("periodic", "fixed"))
        self.boundary = boundary
        self.coupling = parameter("coupling", coupling)
        self.nonlinearity = parameter("nonlinearity", nonlinearity)
        self.intersite = non_negative("intersite", intersite)

    def energy(self, psi):
        logarithm, rest = self._logarithms(psi)
        bonds = -self.coupling * jnp.sum(jnp.real(jnp.conj(psi) * self._neighbours(psi)), axis=0)
        sites = 2 * self.coupling * logarithm - self.nonlinearity * rest
        return bonds + jnp.sum(sites, axis=0)

    def gradient(self, psi):
        return self.rate(psi) / (1 + self.intersite * density(psi))

    def rate(self, psi):
        x = density(psi)
        hop = 2 * psi - (1 + self.intersite * x) * self._neighbours(psi)
        return self.coupling * hop - self.nonlinearity * x * psi

    def norm(self, psi):
        return jnp.sum(self._logarithms(psi)[0], axis=0)

    def _logarithms(self, psi):
        x = density(psi)
        z = self.intersite * x
        small = z < SMALL
        series = sum((-z) ** k / (k + 2) for k in range(TERMS))
        away = jnp.where(small, 1.0, z)
        share = jnp.where(small, series, (away - jnp.log1p(away)) / away**2)
        return x * (1 - z * share), x**2 * share

    def _neighbours(self, psi):
        wide = padded(psi, 1, 1, mode=BEYOND[self.boundary])
        return wide[2:] + wide[:-2]


def density(psi: Amplitudes) -> Numbers:
    """Return |psi_n|^2."""
    return jnp.real(psi) ** 2 + jnp.imag(psi) ** 2


def electrical(
    sites: Count,
    *,
    inductance: Parameter = 1.0,
    ground: Parameter = 1.0,
    capacitance: Parameter = 1.0,
    nonlinearity: Parameter = 1.0,
    order: Parameter | None = None,
    boundary: str = "periodic",
) -> DNLS:
    r"""Return the DNLS of the voltage envelope of an electrical lattice with fractional coupling.

    Its cells are a nonlinear capacitor Q = C (U + b U^3) and a coil L2 to the ground, coupled by
    coils L1:

    d^2 Q_n/dt^2 = -(1/L1) ((-Delta)^s U)_n - U_n/L2,  omega0^2 = 1/(L2 C).

    With U = 2 Re(psi exp(-i omega0 t)), weak coupling and small b |psi|^2, it is DNLS with
    V = omega0 L2/(2 L1) and chi = (3/2) b omega0, in SI or scaled. Errors are of second order in
    V/omega0 and chi |psi|^2/omega0.

    **Arguments:** `sites`: N. `inductance`: L1 > 0 [H] between cells, `ground`: L2 > 0 [H].
    `capacitance`: C > 0 [F]. `nonlinearity`: b [1/V^2], positive if the capacitance grows. `order`,
    `boundary`: as of `DNLS`; a fixed end has U = 0, a free end is open.
    **Returns:** `DNLS`; psi [V]. **Raises** ValueError as `DNLS`, and for L1, L2, C not above zero.
    Typical: L1 = 680 uH, L2 = 330 uH, C = 788 pF. Source: Molina, Phys. Rev. E 104, 024219 (2021).
    """
    inductance = positive("inductance", inductance)
    ground = positive("ground", ground)
    omega = (ground * positive("capacitance", capacitance)) ** -0.5
    return DNLS(
        sites,
        omega * ground / (2 * inductance),
        1.5 * omega * parameter("nonlinearity", nonlinearity),
        order=order,
        boundary=boundary,
    )


class DpS(Equation):
    r"""The discrete p-Schroedinger equation: the modulation equation of Newton's cradle.

    i dA_n/dt = kappa [(A_{n+1} - A_n) |A_{n+1} - A_n|^{p-1}
                      - (A_n - A_{n-1}) |A_n - A_{n-1}|^{p-1}].

    By default kappa = 1/(2 tau_0), see `tau_0`. Then u_n = 2 Re(A_n exp(i t)) is the cradle with
    k = m = A = 1 (`of_cradle` for others) for a time of order eps^{1-p}, with an error that falls
    with the amplitude eps. It keeps the norm and H = -2 kappa/(p + 1) sum |A_{n+1} - A_n|^{p+1};
    eps times a solution is one in the time t eps^{1-p}.

    **Arguments:** `sites`: N >= 2, on a ring >= 3. `stiffness`: kappa [rad/s m^{1-p}]; `None` is
    1/(2 tau_0). `exponent`: p > 1. `omega`: of the carrier, for `state`. `boundary`: `"free"`, `"fixed"` (walls,
    A = 0) or `"periodic"`.
    **Raises** ValueError for p <= 1, omega <= 0. Source: James, Kevrekidis, Cuevas, Physica D 251,
    39 (2013).

    **Example:**

    >>> chain = gx.first_order.DpS(20)
    >>> round(float(chain.stiffness * gx.first_order.tau_0()), 6)
    0.5
    """

    stiffness: jax.Array
    exponent: jax.Array
    omega: jax.Array
    sites: int = eqx.field(static=True)
    boundary: str = eqx.field(static=True)

    def __init__(
        self,
        sites: Count,
        stiffness: Parameter | None = None,
        exponent: Parameter = 1.5,
        *,
        omega: Parameter = 1.0,
        boundary: str = "free",
    ):
        self.sites = _sites(sites, boundary)
        self.boundary = boundary
        self.exponent = within(
            "exponent", exponent, 1, np.inf, open_low=True, remedy="At p = 1 it is linear: DNLS."
        )
        self.omega = positive("omega", omega)
        if stiffness is None:
            stiffness = 1 / (2 * tau_0(self.exponent))
        self.stiffness = parameter("stiffness", stiffness)

    @staticmethod
    def of_cradle(
        sites: Count,
        *,
        mass: Parameter = 1.0,
        stiffness: Parameter = 1.0,
        exponent: Parameter = 1.5,
        pendulum: Parameter = 1.0,
        boundary: str = "free",
    ) -> "DpS":
        """Return the modulation equation of `gx.scenes.cradle`; one number each, in SI or scaled.

        omega = sqrt(k/m), kappa = A/(2 m omega tau_0).
        """
        mass = positive("mass", mass)
        omega = jnp.sqrt(positive("pendulum", pendulum) / mass)
        exponent = within("exponent", exponent, 1, np.inf, open_low=True)
        kappa = non_negative("stiffness", stiffness) / (2 * mass * omega * tau_0(exponent))
        return DpS(sites, kappa, exponent, omega=omega, boundary=boundary)

    def energy(self, psi):
        p = self.exponent
        powers = plus_power(density(self._steps(psi)), (p + 1) / 2)
        return -2 * self.stiffness / (p + 1) * jnp.sum(powers, axis=0)

    def gradient(self, psi):
        steps = self._steps(psi)
        flux = steps * plus_power(density(steps), (self.exponent - 1) / 2)
        if self.boundary == "periodic":
            return self.stiffness * (flux - jnp.roll(flux, 1, axis=0))
        return self.stiffness * jnp.diff(flux, axis=0)

    def state(self, psi: Amplitudes, t: Scalar = 0.0) -> State:
        """Return the cradle's u = 2 Re(A exp(i omega t)) and v = 2 Re(i omega A exp(i omega t))."""
        turned = psi * jnp.exp(1j * self.omega * t)
        return State(2 * turned.real, -2 * self.omega * turned.imag)

    def _steps(self, psi):
        before = 0 if self.boundary == "periodic" else 1
        return jnp.diff(padded(psi, before, 1, mode=BEYOND[self.boundary]), axis=0)


def tau_0(exponent: Parameter = 1.5) -> Numbers:
    r"""Return tau_0 = 2^{1-p} sqrt(pi) Gamma(p/2 + 3/2)/Gamma(p/2 + 1).

    It is 1.5450622310844768 for Hertz's p = 3/2: the first harmonic of [cos]_+^p, for the effective
    contact force of swinging beads.
    """
    p = positive("exponent", exponent)
    gamma = jax.scipy.special.gammaln
    return 2 ** (1 - p) * jnp.sqrt(jnp.pi) * jnp.exp(gamma(p / 2 + 1.5) - gamma(p / 2 + 1))


def _sites(sites, boundary, boundaries=BOUNDARIES):
    if one_of("boundary", boundary, boundaries) == "periodic":
        return whole("sites", sites, 3, "A dimer is two sites with boundary='fixed'.")
    return whole("sites", sites, 2)
