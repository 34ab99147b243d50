"""Chains with a force on every site: Newton's cradle, Klein-Gordon (phi^4), sine-Gordon."""

from ..base.checks import non_negative, positive, refuse
from ..base.types import Count, Parameter
from ..lattice import Lattice
from ..laws import Law, Linear, Polynomial, Sine
from .chains import chain, check_each, contact

# Weak coupling is the usual case of these chains, so 0 is allowed.
COUPLED = "Sites without coupling are coupling=0."
_HELD = "A site that is not held back is a site of another chain."


def cradle(
    sites: Count,
    *,
    mass: Parameter = 1.0,
    pendulum: Parameter = 1.0,
    length: Parameter | None = None,
    law: Law | None = None,
    boundary: str = "free",
    **contacts: Parameter,
) -> Lattice:
    r"""Build Newton's cradle: beads that touch, each on its own pendulum.

    m u_n'' = A [d0 + u_{n-1} - u_n]_+^p - A [d0 + u_n - u_{n+1}]_+^p - k L sin(u_n/L),
    d0 = (F0/A)^{1/p},

    with -k u_n as the last force for long strings. Without precompression the chain has no linear
    coupling: all sites swing at sqrt(k/m), and breathers and travelling waves of small amplitude
    obey the discrete p-Schroedinger equation. For strings of length L in gravity g: k = m g/L. On
    hardening cantilevers, `law=gx.Polynomial(1.0, 0.0, 2.0)`, an impact makes a boomeron, a
    breather that turns back by itself: at bead 11 for the velocity 1.2 (A = k = m = 1).

    **Arguments:**

    - `sites`, `mass`, `contacts` (`stiffness`, `exponent`, `precompression`): as in `monomer`.
    - `pendulum`: k > 0 [N/m], a number, or one per bead.
    - `length`: L > 0 of the strings, a number, or one per bead; `None` for the limit of long
      strings.
    - `law`: another force -law.force(u) on each bead, instead of `pendulum` and `length`.
    - `boundary`: `"free"`, `"fixed"` (walls beside the end beads) or `"periodic"`.

    Typical: amplitudes of 0.01 ... 1 with A = k = m = 1; 9.53 mm steel
    beads on 10 cm: m = 28.4 g, k = 2.8 N/m.
    **Raises** ValueError for arguments outside these ranges, a law together with a length, and as
    `monomer` does.
    Source: James, Kevrekidis, Cuevas, Physica D 251, 39 (2013).

    **Example:**

    >>> chain = gx.scenes.cradle(5)
    >>> print(gx.linear.normal_modes(chain).omega.round(6))  # uncoupled pendula
    [1. 1. 1. 1. 1.]
    """
    pendulum = positive("pendulum", pendulum, "It is m g/L of each bead.")
    if law is not None and length is not None:
        refuse("law", "a law, or strings of a length", "both", "Leave one of them out.")
    if length is not None:
        length = positive("length", length, "None is a string so long that the arc is straight.")
    if law is None:
        law = Linear(pendulum) if length is None else Sine(pendulum, 1 / length)
    check_each(sites, "site", pendulum=pendulum, length=length)
    return chain(sites, mass, contact(**contacts), boundary=boundary, on_site=law)


def klein_gordon(
    sites: Count,
    coupling: Parameter = 0.1,
    *,
    alpha: Parameter | None = None,
    beta: Parameter | None = None,
    law: Law | None = None,
    mass: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    boundary: str = "free",
) -> Lattice:
    r"""Build a Klein-Gordon chain: nonlinear oscillators coupled by springs.

    m u_n'' = C (u_{n-1} - 2 u_n + u_{n+1}) - V'(u_n),  V'(u) = k u + alpha u^2 + beta u^3.

    The default is the hard phi^4 chain, V = u^2/2 + u^4/4; `beta=-1.0` is the soft one. The double
    well of kinks, V = (x^2 - 1)^2/4, is `stiffness=2.0, alpha=3.0, beta=1.0` with u = x - 1 and the
    other well at u = -2. The band is k/m <= omega^2 <= (k + 4 C)/m. Breathers lie above it if the
    force hardens, below it if it softens, and continue from C = 0 (`gx.breathers.anticontinuous`).

    **Arguments:**

    - `sites`: N >= 2.
    - `coupling`: C >= 0 [N/m], a number, or one per spring: (N - 1,), (N + 1,) or (N,) for the
      boundaries below.
    - `alpha`, `beta`: a number, or one per site; 0 and 1 by default; if only one is given, the
      other is 0.
    - `law`: another force -law.force(u) on each site, instead of `stiffness`, `alpha` and `beta`.
    - `mass`: m > 0 and `stiffness`: k > 0 [N/m], a number, or one per site.
    - `boundary`: `"free"`, `"fixed"` (springs to walls) or `"periodic"`.

    **Raises** ValueError for arguments outside these ranges, or a law together with coefficients.
    Source: Marin, Aubry, Nonlinearity 9, 1501 (1996).

    **Example:**

    >>> chain = gx.scenes.klein_gordon(20, coupling=0.1, boundary="periodic")
    >>> print(gx.linear.normal_modes(chain).omega_squared[jnp.array([0, -1])].round(6))  # 1 and 1 + 4 C
    [1.  1.4]
    """
    if law is not None and not (alpha is None and beta is None):
        refuse("law", "a law, or alpha and beta", "both", "Leave one of them out.")
    stiffness = positive("stiffness", stiffness, _HELD)
    if alpha is None:
        alpha = 0.0
        beta = 1.0 if beta is None else beta
    beta = 0.0 if beta is None else beta
    on_site = Polynomial(stiffness, alpha, beta) if law is None else law
    return _coupled(sites, coupling, mass, boundary, on_site)


def sine_gordon(
    sites: Count,
    coupling: Parameter = 1.0,
    *,
    mass: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    wavenumber: Parameter = 1.0,
    boundary: str = "free",
) -> Lattice:
    r"""Build a discrete sine-Gordon (Frenkel-Kontorova) chain: pendula on a torsion spring.

    m u_n'' = C (u_{n-1} - 2 u_n + u_{n+1}) - (k/q) sin(q u_n).

    With m = k = q = 1 and C = 1/h^2 the chain discretises u_tt = u_xx - sin u at x = n h to order
    h^2. That equation has the kink 4 atan(exp((x - v t)/sqrt(1 - v^2))), of energy 8/(h
    sqrt(1 - v^2)) in units of the chain (8 per unit length of x), and the breather 4
    atan(sqrt(1 - w^2)/w cos(w t)/cosh(sqrt(1 - w^2) x)). Static kinks of the chain:
    `gx.kinks.kink`; breathers that travel on a ring: `gx.orbits.orbit` with the symmetry
    `Translation(j)`.

    **Arguments:**

    - `sites`: N >= 2.
    - `coupling`: C >= 0 [N/m], a number, or one per spring: (N - 1,), (N + 1,) or (N,) for the
      boundaries below.
    - `mass`: m > 0, `stiffness`: k > 0 [N/m], `wavenumber`: q > 0 of the potential, whose period is
      2 pi/q: a number, or one per site.
    - `boundary`: `"free"`, `"fixed"` (springs to walls at u = 0) or `"periodic"`. A kink needs free
      ends.

    **Raises** ValueError for arguments outside these ranges.
    Source: Frenkel, Kontorova, Zh. Eksp. Teor. Fiz. 8, 1340 (1938); Braun, Kivshar, The
    Frenkel-Kontorova Model (2004).

    **Example:**

    >>> chain = gx.scenes.sine_gordon(20, coupling=1.0)
    >>> kink = gx.State(2 * jnp.pi * (jnp.arange(20.0) > 9), jnp.zeros(20))
    >>> round(float(gx.measures.energy(chain, kink) / (2 * jnp.pi**2)), 6)  # the one stretched spring
    1.0
    """
    on_site = pendula(stiffness, wavenumber)
    return _coupled(sites, coupling, mass, boundary, on_site)


def pendula(stiffness: Parameter, wavenumber: Parameter) -> Sine:
    """Return the sine law on each site; its parameters are numbers or one per site."""
    stiffness = positive("stiffness", stiffness, _HELD)
    wavenumber = positive("wavenumber", wavenumber, "The potential's period is 2 pi/q.")
    return Sine(stiffness, wavenumber)


def _coupled(sites, coupling, mass, boundary, on_site):
    coupling = non_negative("coupling", coupling, COUPLED)
    return chain(sites, mass, Linear(coupling), boundary=boundary, on_site=on_site)
