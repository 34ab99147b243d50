"""Strain-softening chains, and chains that soften and harden alternately."""

import numpy as np

from ..base.checks import concrete, positive, refuse, within
from ..base.types import Count, Parameter
from ..base.units import SCALED
from ..lattice import Lattice
from .chains import contacts_of, monomer, stacked

_STIFF = "A contact of 0 < p < 1 without static force is infinitely stiff at rest, and so where it re-opens."
_SOFT = "0 < p < 1 softens; p = 1 is linear and p > 1 hardens: gx.scenes.monomer."


def foam(
    sites: Count,
    exponent: Parameter = 0.5,
    *,
    mass: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    precompression: Parameter = 1.0,
    boundary: str = "fixed",
    units: str = SCALED,
) -> Lattice:
    r"""Build a strain-softening chain of stainless steel cylinders separated by polymer foam.

    m u_n'' = F(u_{n-1} - u_n) - F(u_n - u_{n+1}),
    F(e) = A ([d0 + e]_+^p - d0^p),  0 < p < 1,  d0 = (F0/A)^{1/p}.

    With K2 = F'(0) = p A^{1/p} F0^{1-1/p} the speed of sound is (K2/m)^{1/2} and the band ends at 2
    (K2/m)^{1/2}. Because F'' < 0,

    - a compressive impact sends a rarefaction pulse ahead:
      `gx.travelling.solitary_wave(law, speed=c)` is a wave of extension for c above sound;
    - a step down in compression makes a rarefaction shock (`gx.shocks.step`), and a step up
      spreads;
    - bright breathers lie above the band (`gx.breathers.breather(lattice, omega, "bright")`);
      hardening chains have dark ones there: in the envelope equation B = p^3 (1 - p) A^2
      d0^{2p-4}/(2 K2^{3/2}) > 0 only for 0 < p < 1.

    A contact that opens is infinitely stiff when it closes again. No time step resolves this; runs
    report it.

    **Arguments:**

    - `sites`: number of cylinders N >= 2.
    - `exponent`: p in (0, 1), a number (static), or an array, which can be swept and
      differentiated.
    - `mass`, `stiffness`, `boundary`: as in `monomer`. `precompression`: F0 > 0, as the stiffness
      is infinite at F0 = 0.
    - `units`: `"scaled"` or `"SI"`.

    The defaults are scaled, not measured: p = 1/2, A = F0 = m = 1, K2 =
    1/2.
    **Raises** ValueError for arguments outside these ranges, and as `monomer` does.
    Source: Herbold, Nesterenko, Phys. Rev. Lett. 110, 144101 (2013).
    """
    within("exponent", exponent, 0, 1, open_low=True, open_high=True, remedy=_SOFT)
    F0 = positive("precompression", precompression, _STIFF)
    return monomer(sites, mass, stiffness, exponent, F0, boundary).counted_in(units)


def hollow_cylinders(
    sites: Count, exponent: Parameter = 0.5, **contacts: Parameter | str
) -> Lattice:
    """Build a strain-softening chain of hollow elliptical cylinders, whose walls bend.

    Equation, arguments and errors are those of `foam`. Dispersive rarefaction shocks:
    `gx.shocks.step(lattice, left, right)`, left < right.

    Source: Kim, Kim, Chong, Kevrekidis, Yang, Phys. Rev. Lett. 120, 194101 (2018).

    **Example:**

    >>> chain = gx.scenes.hollow_cylinders(20, exponent=0.25)
    >>> round(float(gx.linear.sound_speed(chain)), 6)  # (1/4)^{1/2}
    0.5
    """
    return foam(sites, exponent, **contacts)


def origami(sites: Count, exponent: Parameter = 0.5, **contacts: Parameter | str) -> Lattice:
    """Build a strain-softening chain of origami cells (Tachi-Miura polyhedra).

    Each cell is a bond whose folding follows the effective power law of `foam`, with the same
    equation, arguments and errors. The chain mitigates impacts. Cells that twist as they shorten
    need a `gx.strains.Stencil` over displacement and angle.

    Source: Yasuda, Chong, Charalampidis, Kevrekidis, Yang, Phys. Rev. E 93, 043004 (2016); Yasuda,
    Miyazawa, Charalampidis, Chong, Kevrekidis, Yang, Sci. Adv. 5, eaau2835 (2019).
    """
    return foam(sites, exponent, **contacts)


def tensegrity(sites: Count, exponent: Parameter = 0.5, **contacts: Parameter | str) -> Lattice:
    """Build a strain-softening chain of lumped masses between tensegrity prisms.

    Their prestress makes such prisms soften or harden. This is the softening regime, with the
    effective power law, equation, arguments and errors of `foam`. The hardening regime is
    `gx.scenes.monomer` with an exponent above 1.

    Source: Fraternali, Carpentieri, Amendola, Skelton, Nesterenko, Appl. Phys. Lett. 105, 201903
    (2014).

    **Example:**

    >>> chain = gx.scenes.tensegrity(20, mass=2.0)
    >>> round(float(gx.linear.sound_speed(chain)), 6)  # (1/4)^{1/2}
    0.5
    """
    return foam(sites, exponent, **contacts)


def alternating(
    sites: Count,
    exponents: Parameter = (1.5, 0.5),
    *,
    mass: Parameter = 1.0,
    stiffnesses: Parameter = (1.0, 1.0),
    precompression: Parameter = 1.0,
    boundary: str = "fixed",
    units: str = SCALED,
) -> Lattice:
    r"""Build a chain of equal masses whose contacts alternate between hardening and softening.

    Contact n has F(e) = A_j ([d_j + e]_+^{p_j} - d_j^{p_j}), j = n mod P, d_j = (F0/A_j)^{1/p_j};
    with walls, contact 0 is that of the left wall. For two kinds, with K_j = p_j A_j^{1/p_j}
    F0^{1-1/p_j},

    m omega^2 = K_1 + K_2 -+ (K_1^2 + K_2^2 + 2 K_1 K_2 cos k)^{1/2},

    with a gap between (2 min K/m)^{1/2} and (2 max K/m)^{1/2}.

    **Arguments:** `exponents`: p_j > 0, one per contact of a cell, above 1 for hardening, below for
    softening; differentiable. `stiffnesses`: A_j, as many, or one number. `precompression`: F0, one
    number, above zero if a contact softens. `mass`, `boundary`: as in `monomer`; a ring holds whole
    cells only. `units`: as in `foam`.

    Typical: exponents (3/2, 1/2).
    **Raises** ValueError for arguments outside these ranges, unequal lengths, and as `monomer`
    does.
    Source: Lee, Charalampidis, Xing, Chong, Kevrekidis, Phys. Rev. E 107, 054208 (2023).
    """
    contacts = contacts_of(sites, boundary)
    p = positive(
        "exponents",
        stacked("exponents", exponents),
        "Magnets, p < 0, have no plus part: use two bonds.",
    )
    A = positive(
        "stiffnesses",
        stacked("stiffnesses", stiffnesses),
        "The contact coefficient A is positive.",
    )
    if not p.ndim or A.ndim and A.shape[0] != p.shape[0]:
        refuse(
            "exponents, stiffnesses",
            "as many stiffnesses as exponents, in sequences",
            f"shapes {p.shape} and {A.shape}",
        )
    if boundary == "periodic" and sites % p.shape[0]:
        refuse("sites", f"a multiple of {p.shape[0]}, whole cells on a ring", repr(sites))
    known = concrete(p)
    if known is None or (known < 1).any():
        precompression = positive("precompression", precompression, _STIFF)
    order = np.arange(contacts) % p.shape[0]
    A = A[order] if A.ndim else A
    return monomer(sites, mass, A, p[order], precompression, boundary).counted_in(units)
