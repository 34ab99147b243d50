"""Chains in scaled units: mass 1, contact coefficient 1, compression positive, u = 0 at rest."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import concrete, non_negative, one_of, parameter, positive, refuse, whole, within
from ..base.programs import library
from ..base.types import Count, Parameter, Scalar
from ..base.units import SCALED
from ..lattice import Lattice
from ..laws import Hertz, Law, Linear, Polynomial, PowerLaw, Thornton, Toda, plus_power
from ..strains import BOUNDARIES, Shift
from ..terms import Bond, Damping, Harmonic, Modulated, OnSite, PlasticContact, Square

MANY = "For many at once: jax.vmap(lambda x: scene(..., x), out_axes=-1)(values)."
_SHAPES = {"cosine": Harmonic, "square": Square}
_RATIO = "The ratio is light over heavy; the heavy bead has mass 1."


def chain(
    sites: Count,
    mass: Parameter,
    law: Law,
    *,
    boundary: str = "fixed",
    on_site: Law | None = None,
    damping: Parameter | None = None,
    units: str = SCALED,
) -> Lattice:
    r"""Build a chain with one law between neighbours, of which other scenes are made.

    m_n u_n'' = F(u_{n-1} - u_n) - F(u_n - u_{n+1}) - G(u_n) - m_n gamma u_n'

    **Arguments:**

    - `sites`: number of sites N >= 2.
    - `mass`: m > 0 [kg], a number, or one per site (N,).
    - `law`: F; its parameters are numbers, or one per bond: (N + 1,), (N - 1,) or (N,) for the
      boundaries below.
    - `boundary`: `"fixed"` (rigid walls, bonds as between sites), `"free"` (the preload is held at
      the ends), `"periodic"`.
    - `on_site`: G, a law between each site and its rest position, `None` for none.
    - `damping`: gamma >= 0 [1/s], a number, or one per site; `None` for none.
    - `units`: `"scaled"` or `"SI"`.

    **Returns:** a `Lattice`, u of shape (N,). All numbers but N may be traced.
    **Raises** ValueError for arguments outside these ranges, or parameters that do not fit the
    chain.

    **Example:**

    >>> lattice = gx.scenes.chain(20, 1.0, gx.Linear(4.0), boundary="periodic", on_site=gx.Linear(9.0))
    >>> band = gx.linear.bands(lattice)
    >>> print(band.lower.round(6), band.upper.round(6))  # the roots of 9 and 9 + 4 * 4
    [3.] [5.]
    """
    terms = [Bond(Shift(1, boundary), fitting(law, contacts_of(sites, boundary), "contact"))]
    if on_site is not None:
        terms.append(OnSite(fitting(on_site, sites, "site")))
    if damping is not None:
        terms.append(Damping(damping))
    return Lattice(mass, terms, sites=a_chain(sites), units=units)


def a_chain(sites: Count) -> int:
    """Return the checked number of sites of a chain."""
    return whole("sites", sites, 2, "A chain has at least two beads.")


def contacts_of(sites: Count, boundary: str) -> int:
    """Return the number of bonds to the next site, walls included."""
    more = {"fixed": 1, "free": -1, "periodic": 0}
    return a_chain(sites) + more[one_of("boundary", boundary, more)]


def check_each(count: int, what: str, **parameters: Parameter | None) -> None:
    """Refuse parameters that are neither a number nor one per contact or site."""
    for name, x in parameters.items():
        if np.shape(x)[:1] not in ((), (1,), (count,)):
            refuse(name, f"one number, or one per {what}, shape ({count},)", f"shape {np.shape(x)}")


def fitting(law: Any, count: int, what: str) -> Any:
    """Return the law after checking its parameters with `check_each`."""
    # A law with memory has no parts.
    for part in getattr(law, "parts", (law,)):
        kind = type(part)
        # A user-defined law may have arrays of other shapes.
        if kind.__module__.startswith("granjax."):
            own = {name.removeprefix("_free_"): x for name, x in vars(part).items() if np.shape(x)}
            check_each(count, what, **{f"{kind.__name__}.{name}": x for name, x in own.items()})
    return law


def number(argument: str, x: Scalar) -> Scalar:
    """Return a parameter that is one number, traced or not."""
    x = parameter(argument, x)
    if x.ndim:
        refuse(argument, "one number", f"an array of shape {x.shape}", MANY)
    return x


def stacked(argument: str, values: Parameter) -> Any:
    """Return a sequence of numbers, possibly traced, as one array; else a parameter."""
    if not isinstance(values, (tuple, list)) or not values:
        return parameter(argument, values)
    found = [number(f"{argument}[{i}]", x) for i, x in enumerate(values)]
    # Known numbers use NumPy, because JAX compiles a program for each operation.
    return jax.device_put(library(*found).stack(found))


def contact(
    stiffness: Parameter = 1.0, exponent: Parameter = 1.5, precompression: Parameter = 0.0
) -> Law:
    """Return the law of power-law contacts: `Hertz` for the exponent 3/2."""
    if isinstance(exponent, (int, float)) and exponent == 1.5:
        return Hertz(stiffness, precompression)
    return PowerLaw(stiffness, exponent, precompression)


def _ratio(argument, x):
    return within(argument, number(argument, x), 0, 1, open_low=True, remedy=_RATIO)


def monomer(
    sites: Count,
    mass: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    exponent: Parameter = 1.5,
    precompression: Parameter = 0.0,
    boundary: str = "fixed",
) -> Lattice:
    r"""Build a chain of equal beads with power-law contacts.

    m u_n'' = A [d0 + u_{n-1} - u_n]_+^p - A [d0 + u_n - u_{n+1}]_+^p,  d0 = (F0/A)^{1/p}.

    **Arguments:**

    - `sites`: number of beads N >= 2.
    - `mass`: m > 0, a number, or one per bead (N,). A number stays one number in the lattice's
      `mass`; `gx.lattice.spread_mass(lattice)` has one per bead.
    - `stiffness`: A > 0, a number, or one per contact: (N + 1,), (N - 1,) or (N,) for the
      boundaries below.
    - `exponent`: p; 3/2 is Hertz. Another number is static; an array can be swept and
      differentiated.
    - `precompression`: static force F0 >= 0; the number 0 is a sonic vacuum.
    - `boundary`: `"fixed"` (rigid walls, contacts as between beads), `"free"` (F0 held at the
      ends), `"periodic"`.

    All numbers but N may be traced.

    **Raises** ValueError for arguments outside these ranges.
    Source: Nesterenko, J. Appl. Mech. Tech. Phys. 24, 733 (1983).

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> round(float(gx.linear.normal_modes(chain).omega[-1]), 6)  # 6^{1/2} sin(20 pi/42)
    2.44264
    """
    return chain(sites, mass, contact(stiffness, exponent, precompression), boundary=boundary)


def pattern(
    sites: Count, masses: Parameter, *, boundary: str = "fixed", **contacts: Parameter
) -> Lattice:
    """Build a chain whose masses repeat: m_n = masses[n mod len(masses)].

    The last cell may be cut short.

    **Arguments:** `masses`: m > 0 of one cell, may be traced; `boundary` and `contacts`
    (`stiffness`, `exponent`, `precompression`): as in `monomer`.

    **Raises** ValueError as `monomer` does, and for a ring that does not hold whole cells.
    """
    sites = a_chain(sites)
    cell = stacked("masses", masses)
    if not len(cell):
        refuse("masses", "the masses of a cell", "none")
    if boundary == "periodic" and sites % len(cell):
        refuse("sites", f"a multiple of {len(cell)}, whole cells on a ring", repr(sites))
    repeated = library(cell).tile(cell, -(-sites // len(cell)))
    mass = jax.device_put(repeated[:sites])
    return monomer(sites, mass, boundary=boundary, **contacts)


def dimer(
    sites: Count,
    ratio: Scalar = 0.5,
    *,
    precompression: Parameter = 0.0,
    **contacts: Parameter | str,
) -> Lattice:
    """Build a chain of alternating heavy and light beads: masses 1, ratio, 1, ratio, ...

    With F0 > 0 and K2 = p A^{1/p} F0^{1-1/p} the bands are [0, sqrt(2 K2)] and [sqrt(2 K2/ratio),
    sqrt(2 K2 (1 + 1/ratio))].

    **Arguments:** `ratio`: light over heavy, in (0, 1]; `precompression`: F0, and `contacts`
    (`stiffness`, `exponent`, `boundary`): as in `monomer`. Typical: ratio 0.3428 (first
    anti-resonance), 0.59 (first resonance) with F0 = 0; 0.338 for steel and aluminium beads of one
    size.

    **Raises** ValueError as `monomer` does, and for a ratio out of range.
    Source: Jayaprakash, Starosvetsky, Vakakis, Phys. Rev. E 83, 036606 (2011).

    **Example:**

    >>> chain = gx.scenes.dimer(20, ratio=0.5, precompression=1.0, boundary="periodic")
    >>> print(gx.linear.bands(chain).lower.round(4))
    [0.     2.4495]
    """
    masses = (1.0, _ratio("ratio", ratio))
    return pattern(sites, masses, precompression=precompression, **contacts)


def trimer(sites: Count, ratios: Parameter = (0.5, 0.25), **contacts: Parameter | str) -> Lattice:
    """Build a chain of three alternating kinds of beads: masses 1, ratios[0], ratios[1], 1, ...

    **Arguments:** `ratios`: two masses over the heavy one, each in (0, 1]; `contacts`: `stiffness`,
    `exponent`, `precompression`, `boundary`, as in `monomer`.

    **Raises** ValueError as `monomer` does, and for ratios that are not two in (0, 1].
    Source: Porter, Daraio, Szelengowicz, Herbold, Kevrekidis, Physica D 238, 666 (2009).
    """
    second, third = (_ratio(f"ratios[{i}]", r) for i, r in enumerate(ratios))
    return pattern(sites, (1.0, second, third), **contacts)


def n_to_one(
    sites: Count, beads: Count, ratio: Scalar = 0.5, **contacts: Parameter | str
) -> Lattice:
    """Build an N:1 chain: cells of `beads` heavy beads of mass 1 and one of mass `ratio`.

    **Arguments:** `beads`: N >= 1, 1 for the dimer; `ratio`: light over heavy, in (0, 1], 1 for the
    monomer; `contacts`: as in `trimer`.

    **Raises** ValueError as `dimer` does, and for N < 1.
    Source: Porter, Daraio, Szelengowicz, Herbold, Kevrekidis, Physica D 238, 666 (2009).
    """
    beads = whole("beads", beads, 1, "It counts the heavy beads of a cell.")
    # In a chain shorter than the cell no light bead occurs.
    masses = (1.0,) * min(beads, a_chain(sites)) + (_ratio("ratio", ratio),)
    return pattern(sites, masses, **contacts)


def defects(
    sites: Count,
    masses: dict[Count, Scalar],
    *,
    mass: Scalar = 1.0,
    **contacts: Parameter | str,
) -> Lattice:
    """Build a monomer chain with some beads of another mass.

    With F0 > 0 in a long chain with equal contacts, a light bead of mass m_d has a mode above the
    band, at omega^2 = 4 K2/(m_d (2 - m_d/m)), K2 = p A^{1/p} F0^{1-1/p}.

    **Arguments:** `masses`: a dict from site to mass > 0, `{50: 0.6}`; negative sites count from
    the end. `mass`: of all other beads; `contacts`: as in `trimer`.

    **Raises** ValueError as `monomer` does, for a site outside the chain or named twice.
    Source: Theocharis et al., Phys. Rev. E 80, 066601 (2009).

    **Example:**

    >>> chain = gx.scenes.defects(20, {10: 0.5}, precompression=1.0)
    >>> round(float(gx.linear.normal_modes(chain).omega[-1]), 6)  # 8^{1/2}, above the band's 6^{1/2}
    2.828427
    """
    sites = a_chain(sites)
    m = jnp.full(sites, positive("mass", mass, "A bead needs a mass."))
    if len({site % sites for site in masses}) < len(masses):
        refuse("masses", "each site once", ", ".join(map(str, masses)))
    for site, other in masses.items():
        if not -sites <= site < sites:
            wanted = f"a site from 0 to {sites - 1}, or negative from the end"
            refuse(f"masses[{site!r}]", wanted, repr(site))
        m = m.at[site].set(positive(f"masses[{site!r}]", other, "A bead needs a mass."))
    return monomer(sites, m, **contacts)


def taper(
    sites: Count,
    q: Scalar = 0.05,
    *,
    stiffness: Scalar = 1.0,
    precompression: Parameter = 0.0,
    boundary: str = "fixed",
) -> Lattice:
    r"""Build a tapered chain of spheres of one material: R_{n+1} = (1 - q) R_n.

    Masses are m_n = (R_n/R_0)^3 and Hertz coefficients A_n = A sqrt(R*_n/R*_0), 1/R*_n =
    1/R_n + 1/R_{n+1}, with A that of the first pair. A wall acts as a bead of the end bead's
    radius, so that q = 0 is the monomer chain.

    **Arguments:** `q` in (-1, 1), negative for growing radii; the others as in `monomer`. Typical:
    q = 0.01 ... 0.1.

    **Raises** ValueError for q out of range, a ring, and as `monomer` does.
    Source: Sen, Manciu, Manciu, Physica A 299, 551 (2001).

    **Example:**

    >>> print(gx.scenes.taper(4, q=0.1).mass.round(4))
    [1.     0.729  0.5314 0.3874]
    """
    sites = a_chain(sites)
    if one_of("boundary", boundary, BOUNDARIES) == "periodic":
        refuse(
            "boundary",
            "'fixed' or 'free' for a taper",
            "'periodic'",
            "The last radius differs from the first.",
        )
    q = within(
        "q", q, -1, 1, open_low=True, open_high=True, remedy="Radii shrink by the factor 1 - q."
    )
    A = positive("stiffness", stiffness, "It is the coefficient of the first pair.")
    R = (1 - q) ** jnp.arange(sites)
    # R*_n/R*_0 = R_n/R_0 between beads
    share = R[:-1]
    if boundary == "fixed":
        wall = (2 - q) / (1 - q) / 2
        share = jnp.concatenate([R[:1] * wall, share, R[-1:] * wall])
    return monomer(
        sites, R**3, A * jnp.sqrt(share), precompression=precompression, boundary=boundary
    )


def fput(
    sites: Count,
    alpha: Parameter | None = None,
    beta: Parameter | None = None,
    *,
    mass: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    boundary: str = "fixed",
) -> Lattice:
    r"""Build a Fermi-Pasta-Ulam-Tsingou chain: F(e) = K e + alpha e^2 + beta e^3.

    Compression e = u_n - u_{n+1} is positive, so alpha > 0 stiffens under compression. The original
    chain stiffens under extension: the same with u -> -u. N = 32 in the literature counts
    intervals: 31 moving masses.

    **Arguments:** `sites`: number of moving masses; `alpha`, `beta`: K3 and K4, by default 1/4 and
    0; if only one is given, the other is 0; `stiffness`: K > 0; `mass`, `boundary`: as in
    `monomer`. Typical: `fput(31)`, the alpha chain; `fput(31, beta=1.0)`, the beta chain.

    **Raises** ValueError for arguments outside these ranges.
    Source: Fermi, Pasta, Ulam (with Tsingou), Los Alamos report LA-1940 (1955).

    **Example:**

    >>> chain = gx.scenes.fput(31)
    >>> round(float(gx.linear.normal_modes(chain).omega[0]), 6)  # 2 sin(pi/64)
    0.098135
    """
    stiffness = positive("stiffness", stiffness, "At rest the springs hold the chain.")
    if alpha is None:
        alpha = 0.25 if beta is None else 0.0
    beta = 0.0 if beta is None else beta
    return chain(sites, mass, Polynomial(stiffness, alpha, beta), boundary=boundary)


def toda(
    sites: Count,
    *,
    mass: Parameter = 1.0,
    strength: Parameter = 1.0,
    rate: Parameter = 1.0,
    boundary: str = "free",
) -> Lattice:
    """Build a Toda chain: F(e) = a (exp(b e) - 1).

    m u_n'' = a exp(b (u_{n-1} - u_n)) - a exp(b (u_n - u_{n+1})), integrable with `"free"` and
    `"periodic"` ends. The constant force a holds free ends.

    **Arguments:** `strength`: a > 0; `rate`: b > 0; `mass`, `boundary`: as in `monomer`.

    **Raises** ValueError for arguments outside these ranges.
    Source: Toda, J. Phys. Soc. Japan 22, 431 (1967).

    **Example:**

    >>> chain = gx.scenes.toda(20)
    >>> float(gx.linear.sound_speed(chain))
    1.0
    """
    return chain(sites, mass, Toda(strength, rate), boundary=boundary)


def plastic(
    sites: Count,
    *,
    mass: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    yield_overlap: Parameter = 0.02,
    precompression: Parameter = 0.0,
    boundary: str = "free",
    units: str = SCALED,
) -> Lattice:
    r"""Build a chain of elastic-plastic spheres (Thornton's law).

    The force is Hertz's up to the overlap s_y, and linear beyond. Unloading leaves an indentation:
    each contact remembers its largest overlap. `gx.simulate` returns these and the energy lost.
    Pulses decay, higher ones faster.

    **Arguments:** `sites`: N >= 2; `mass`: m > 0, a number or one per bead; `stiffness`: A,
    `yield_overlap`: s_y > 0, numbers or one per contact, as in `gx.Thornton`; `precompression`:
    F0 >= 0; `boundary`: `"free"`, `"fixed"` or `"periodic"`; `units`: "scaled" or "SI". In SI use
    `gx.materials.bead_mass`, `hertz_coefficient`, `yield_overlap`.

    **Raises** ValueError for arguments outside these ranges.
    Source: C. Thornton, J. Appl. Mech. 64, 383 (1997).

    **Example:**

    >>> chain = gx.scenes.plastic(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05)
    >>> bool(run.lost.sum() > 0)  # what yielding has taken of the energy
    True
    """
    stiffness = positive("stiffness", stiffness)
    yields = positive("yield_overlap", yield_overlap)
    F0 = non_negative("precompression", precompression, "A chain under tension falls apart.")
    law = fitting(Thornton(stiffness, yields), contacts_of(sites, boundary), "contact")
    # the overlap of virgin contacts under F0
    first = stiffness * plus_power(yields, 1.5)
    overlap = jnp.where(
        F0 > first, yields * (2 * F0 / first + 1) / 3, plus_power(F0 / stiffness, 2 / 3)
    )
    contacts = PlasticContact(Shift(1, boundary), law, overlap)
    return Lattice(mass, contacts, sites=a_chain(sites), units=units)


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
    if on == "sites" and not _there(grounding):
        wanted = "a stiffness above zero, which is modulated"
        refuse("grounding", wanted, "0", 'Or modulate on="bonds".')
    in_time = lambda term, where: Modulated(term, wave) if on == where else term
    bond = Bond(Shift(1, boundary), Linear() if law is None else law)
    terms = [in_time(bond, "bonds")]
    if _there(grounding):
        terms.append(in_time(OnSite(Linear(grounding)), "sites"))
    if _there(damping):
        terms.append(Damping(damping))
    return Lattice(mass, terms, sites=sites)


def _there(x):
    value = concrete(x)
    return value is None or np.any(value)
