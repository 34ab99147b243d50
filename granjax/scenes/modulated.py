"""Chains whose stiffness changes in time: phononic time crystals, and modulation that travels."""

from collections.abc import Callable

import numpy as np

from ..checks import concrete, non_negative, one_of, positive, refuse
from ..lattice import Lattice
from ..laws import Law, Linear
from ..strains import BOUNDARIES, Shift
from ..terms import Bond, Damping, Harmonic, Modulated, OnSite, Square
from ..types import Count, Parameter
from .chains import _number, _sites, check_each

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
    r"""Chain whose stiffness is modulated in time alone: a phononic time crystal, with gaps in the wave number.

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
    sites, places = _places(sites, on, boundary)
    wave = _wave(shape, amplitude, omega, phase, places)
    return _chain(sites, wave, on, law, grounding, damping, mass, boundary)


def travelling_modulation(
    sites: Count,
    amplitude: Parameter = 0.1,
    omega: Parameter = 0.5,
    wavelength: Parameter = 3.0,
    *,
    shape: str = "cosine",
    on: str = "bonds",
    law: Law | None = None,
    grounding: Parameter = 0.0,
    damping: Parameter = 0.0,
    mass: Parameter = 1.0,
    boundary: str = "periodic",
) -> Lattice:
    r"""Chain whose stiffness is modulated in space and time, by a wave that travels: non-reciprocal bands.

    As `modulated`, with g_n(t) = 1 + a cos(Omega t - 2 pi n/L) for the bond between n and n + 1 (or site n), so that a
    wave to the right meets another medium than one to the left: omega(k) != omega(-k).

    **Arguments:** `wavelength`: L in sites, |L| >= 2, negative for one that travels to the left; where L = P/q in
    lowest terms the unit cell has P sites. The others as in `modulated`.

    **Returns:** a `Lattice`. **Raises** ValueError as `modulated` does, for |L| < 2, and for a ring that L does not
    divide.
    Source: Swinteck, Matsuo, Runge, Vasseur, Lucas, Deymier, J. Appl. Phys. 118, 063103 (2015).
    """
    sites, places = _places(sites, on, boundary)
    wavelength = _number("wavelength", wavelength)
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
    wave = _wave(shape, amplitude, omega, -2 * np.pi * place / wavelength, places)
    return _chain(sites, wave, on, law, grounding, damping, mass, boundary)


def _places(sites: Count, on: str, boundary: str) -> tuple:
    """The number of sites, and the numbers of the bonds or sites that are modulated."""
    sites, walls = (
        _sites(sites),
        {"fixed": 1, "free": -1}.get(one_of("boundary", boundary, BOUNDARIES), 0),
    )
    return sites, np.arange(sites + walls * (one_of("on", on, ("bonds", "sites")) == "bonds"))


def _wave(
    shape: str, amplitude: Parameter, omega: Parameter, phase: Parameter, places: np.ndarray
) -> Callable:
    check_each("amplitude", amplitude, len(places), "modulated bond or site")
    check_each("phase", phase, len(places), "modulated bond or site")
    omega = positive("omega", _number("omega", omega), "The modulation has a period.")
    return _SHAPES[one_of("shape", shape, tuple(_SHAPES))](amplitude, omega, phase, 1.0)


def _chain(
    sites: int,
    wave: Callable,
    on: str,
    law: Law | None,
    grounding: Parameter,
    damping: Parameter,
    mass: Parameter,
    boundary: str,
) -> Lattice:
    bond = Bond(Shift(1, boundary), Linear() if law is None else law)
    grounding, damping = non_negative("grounding", grounding), non_negative("damping", damping)
    check_each("grounding", grounding, sites, "site")
    check_each("damping", damping, sites, "site")
    value, still = concrete(grounding), concrete(damping)
    grounded = value is None or bool(np.any(value))
    if on == "sites" and not grounded:
        refuse(
            "grounding",
            "a stiffness above zero, which is modulated",
            "0",
            'Or modulate on="bonds".',
        )
    site = (OnSite(Linear(grounding)),) if grounded else ()
    terms = (Modulated(bond, wave), *site) if on == "bonds" else (bond, Modulated(site[0], wave))
    lost = (Damping(damping),) if still is None or np.any(still) else ()
    return Lattice(mass, (*terms, *lost), sites=sites)
