"""Chains whose stiffness changes in time: phononic time crystals and travelling modulation."""

import numpy as np

from ..base.checks import concrete, non_negative, one_of, positive, refuse
from ..base.types import Count, Parameter
from ..lattice import Lattice
from ..laws import Law, Linear
from ..strains import Shift
from ..terms import Bond, Damping, Harmonic, Modulated, OnSite, Square
from .chains import check_each, contacts_of, number

_SHAPES = {"cosine": Harmonic, "square": Square}


def modulated(
    sites: Count,
    amplitude: Parameter = 0.1,
    omega: Parameter = 2.0,
    *,
    shape: str = "cosine",
    on: str = "bonds",
    law: Law | None = None,
    grounding: Parameter = 0.0,
    damping: Parameter = 0.0,
    phase: Parameter = 0.0,
    mass: Parameter = 1.0,
    boundary: str = "periodic",
) -> Lattice:
    r"""Build a chain whose stiffness is modulated in time: a phononic time crystal.

    m u_n'' = g_b(t) [F(u_{n-1} - u_n) - F(u_n - u_{n+1})] - g_s(t) k_0 u_n - m gamma u_n',

    with g(t) = 1 + a cos(Omega t + phase), or alternately 1 + a and 1 - a (`"square"`, layers in
    time), for bonds or for sites. Its gaps are in the wave number.

    **Arguments:**

    - `sites`: N >= 2; `mass`, `boundary`: as in `monomer`.
    - `amplitude`: a; `omega`: Omega > 0 [rad/s], period 2 pi/Omega; `phase` [rad]: amplitude and
      phase are one number or one per modulated bond or site.
    - `shape`: `"cosine"` or `"square"`; `on`: `"bonds"` or `"sites"` (the grounding, as of magnets
      between electromagnets).
    - `law`: of the bonds, `Linear(1)` by default, such as `PowerLaw(1, -3, 1)` for magnets.
    - `grounding`: k_0 >= 0 [N/m] and `damping`: gamma >= 0 [1/s], one number or one per site.

    With `phase=-2 * np.pi * np.arange(sites) / L` a wave of L sites modulates a ring. It travels to
    the right, and the bands are non-reciprocal, omega(k) != omega(-k) (Swinteck and others, J.
    Appl. Phys. 118, 063103, 2015).

    **Returns:** a `Lattice`. `gx.linear.floquet_bands(lattice, k, 2 * np.pi / omega)` has its bands
    and k-gaps, the first where omega(k) = Omega/2.
    **Raises** ValueError for arguments outside these ranges, or modulated sites without a
    grounding.
    Source: Kim, Chong, Hajarolasvadi, Wang, Daraio, Phys. Rev. E 107, 034211 (2023); Chong, Kim,
    Wallace, Daraio, Phys. Rev. Res. 6, 023045 (2024).

    **Example:**

    >>> crystal = gx.scenes.modulated(12, amplitude=0.1, omega=2.0, shape="square")
    >>> bands = gx.linear.floquet_bands(crystal, np.linspace(0, np.pi, 13), period=np.pi)
    >>> bool(bands.fastest[0] > 0)  # waves grow in a gap of k
    True
    """
    contacts = contacts_of(sites, boundary)
    places = contacts if one_of("on", on, ("bonds", "sites")) == "bonds" else sites
    check_each(places, "modulated bond or site", amplitude=amplitude, phase=phase)
    omega = positive("omega", number("omega", omega), "The modulation has a period.")
    wave = _SHAPES[one_of("shape", shape, _SHAPES)](amplitude, omega, phase, 1.0)
    grounding = non_negative("grounding", grounding)
    damping = non_negative("damping", damping)
    check_each(sites, "site", grounding=grounding, damping=damping)
    bond = Bond(Shift(1, boundary), Linear() if law is None else law)
    ground = OnSite(Linear(grounding)) if _there(grounding) else None
    if on == "bonds":
        terms = [Modulated(bond, wave), ground]
    elif ground is None:
        wanted = "a stiffness above zero, which is modulated"
        refuse("grounding", wanted, "0", 'Or modulate on="bonds".')
    else:
        terms = [bond, Modulated(ground, wave)]
    terms.append(Damping(damping) if _there(damping) else None)
    return Lattice(mass, [term for term in terms if term is not None], sites=sites)


def _there(x):
    value = concrete(x)
    return value is None or np.any(value)
