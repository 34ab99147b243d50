"""Chains whose stiffness changes in time: phononic time crystals, and modulation that travels."""

import numpy as np

from ..checks import concrete, non_negative, one_of, positive, refuse
from ..lattice import Lattice
from ..laws import Law, Linear
from ..strains import Shift
from ..terms import Bond, Damping, Harmonic, Modulated, OnSite, Square
from ..types import Count, Parameter
from .chains import check_each, contacts_of, number

_SHAPES = {"cosine": Harmonic, "square": Square}
_TURNS = 1e-9


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
    r"""Build a chain whose stiffness is modulated in time alone: a phononic time crystal, with gaps in the wave number.

    m u_n'' = g_b(t) [F(u_{n-1} - u_n) - F(u_n - u_{n+1})] - g_s(t) k_0 u_n - m gamma u_n',
    g(t) = 1 + a cos(Omega t + phase), or 1 + a and 1 - a in turn (`"square"`, layers in time), for bonds or for sites.

    **Arguments:** `sites`: N >= 2; `amplitude`: a; `omega`: Omega > 0 [rad/s], period 2 pi/Omega; `shape`: `"cosine"`
    or `"square"`; `on`: `"bonds"` or `"sites"` (the grounding, as of magnets between electromagnets); `law`: of the
    bonds, `Linear(1)` by default, such as `PowerLaw(1, -3, 1)` for magnets, one of your own; `grounding`: k_0 >= 0
    [N/m], one number or one per site; `damping`: gamma >= 0 [1/s]; `phase` [rad]; `mass`, `boundary`: as in `monomer`.

    **Returns:** a `Lattice`; `gx.linear.floquet_bands(lattice, k, 2 * np.pi / omega)` has its bands and k-gaps: the
    first where omega(k) = Omega/2. **Raises** ValueError for N < 2, unknown words, Omega <= 0, k_0 or gamma < 0, sites
    modulated without a grounding.
    Source: Kim, Chong, Hajarolasvadi, Wang, Daraio, Phys. Rev. E 107, 034211 (2023); Chong, Kim, Wallace, Daraio,
    Phys. Rev. Res. 6, 023045 (2024).

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
    grounding, damping = non_negative("grounding", grounding), non_negative("damping", damping)
    check_each(sites, "site", grounding=grounding, damping=damping)
    bond, ground = Bond(Shift(1, boundary), Linear() if law is None else law), None
    if _there(grounding):
        ground = OnSite(Linear(grounding))
    if on == "bonds":
        terms = [Modulated(bond, wave), ground]
    elif ground is None:
        wanted = "a stiffness above zero, which is modulated"
        refuse("grounding", wanted, "0", 'Or modulate on="bonds".')
    else:
        terms = [bond, Modulated(ground, wave)]
    terms.append(Damping(damping) if _there(damping) else None)
    return Lattice(mass, [term for term in terms if term is not None], sites=sites)


def travelling_modulation(
    sites: Count,
    amplitude: Parameter = 0.1,
    omega: Parameter = 0.5,
    wavelength: Parameter = 3.0,
    *,
    on: str = "bonds",
    boundary: str = "periodic",
    **modulation: Parameter | str | Law | None,
) -> Lattice:
    r"""Build a chain whose stiffness is modulated in space and time, by a wave that travels: non-reciprocal bands.

    As `modulated`, with g_n(t) = 1 + a cos(Omega t - 2 pi n/L) for the bond between n and n + 1 (or site n), so that a
    wave to the right meets another medium than one to the left: omega(k) != omega(-k).

    **Arguments:** `wavelength`: L in sites, |L| >= 2, negative for one that travels to the left; where L = P/q in
    lowest terms the unit cell has P sites. `modulation`: `shape`, `law`, `grounding`, `damping` and `mass`; all others
    as in `modulated`.

    **Returns:** a `Lattice`. **Raises** ValueError as `modulated` does, for |L| < 2, and for a ring that L does not
    divide.
    Source: Swinteck, Matsuo, Runge, Vasseur, Lucas, Deymier, J. Appl. Phys. 118, 063103 (2015).
    """
    contacts = contacts_of(sites, boundary)
    places = np.arange(contacts if on == "bonds" else sites)
    wavelength = number("wavelength", wavelength)
    value = concrete(wavelength)
    if value is not None:
        if not abs(value) >= 2:
            refuse("wavelength", "a number of sites, 2 or more in size", repr(value.tolist()))
        turns = sites / float(value)
        if boundary == "periodic" and abs(turns - round(turns)) > _TURNS * sites:
            refuse(
                "wavelength",
                f"one that goes into a ring of {sites} sites",
                repr(float(value)),
                "Take as many sites as several wavelengths, or free ends.",
            )
    # the bond to a left wall comes first
    place = places - (on == "bonds" and boundary == "fixed")
    phase = -2 * np.pi * place / wavelength
    return modulated(sites, amplitude, omega, on=on, phase=phase, boundary=boundary, **modulation)


def _there(x):
    """Whether something is above zero, or may be: what is traced."""
    value = concrete(x)
    return value is None or np.any(value)
