"""Chains of beads with resonators: mass-in-mass, mass-with-mass, woodpile."""

from collections.abc import Sequence

import jax.numpy as jnp

from ..base.checks import non_negative, positive, refuse, several
from ..base.types import Count, Numbers, Parameter
from ..base.units import SCALED
from ..lattice import Lattice
from ..laws import Law, Linear
from ..strains import Pairs, Shift
from ..terms import Bond
from .chains import a_chain, check_each, contact, contacts_of, fitting

_TIE = "A resonator without stiffness is let go: 0 leaves the chain of beads."


def mass_in_mass(
    sites: Count,
    mass: Parameter = 0.5,
    stiffness: Parameter = 1.0,
    **contacts: Parameter | str | Law | None,
) -> Lattice:
    r"""Build a mass-in-mass chain: each bead holds a mass mu on a linear spring kappa.

    m u_n'' = F(u_{n-1} - u_n) - F(u_n - u_{n+1}) - kappa (u_n - w_n),
    mu w_n'' = kappa (u_n - w_n),   F(e) = A ([d0 + e]_+^p - d0^p).

    With K2 = F'(0) the two bands obey

    (m + mu/(1 - omega^2/omega_0^2)) omega^2 = 4 K2 sin^2(k/2),   omega_0^2 = kappa/mu.

    The gap between them contains omega_0 and ends at (kappa (1/m + 1/mu))^{1/2}. Without
    precompression K2 = 0: the only linear motion is that of each bead against its resonator. Bright
    breathers then have long but finite lifetimes, longer for heavier mu: exact ones need contacts
    of zero mean force, which must also pull (`law`).

    **Arguments:**

    - `sites`: number of beads N >= 2.
    - `mass`: mu > 0 and `stiffness`: kappa >= 0 of the resonators, numbers or one per bead (N,).
    - `contacts`: `bead_mass`: m = 1, `contact_stiffness`: A = 1, `exponent`, `precompression`,
      `boundary`: as in `monomer`; `law`: in place of the power law; `units`.

    **Returns:** a `Lattice` of the fields `"bead"` and `"resonator"`, (N,) each. Tail-free waves:
    `gx.travelling.solitary_wave(law, speed=c, resonator=gx.Resonator(mu, kappa))`. Typical: mu =
    0.1 ... 10, kappa = 1.
    **Raises** ValueError for arguments outside these ranges, and as `monomer` does.
    Source: Liu, James, Kevrekidis, Vainchtein, Nonlinearity 29, 3496 (2016); Bonanomi, Theocharis,
    Daraio, Phys. Rev. E 91, 033208 (2015).

    **Example:**

    >>> chain = gx.scenes.mass_in_mass(20, precompression=1.0)
    >>> gap, = gx.linear.bands(chain).gaps
    >>> round(float(gap[1]), 6)  # (kappa (1/m + 1/mu))^{1/2}
    1.732051
    """
    return mass_with_mass(sites, mass, stiffness, **contacts)


def mass_with_mass(
    sites: Count,
    mass: Parameter = 0.5,
    stiffness: Parameter = 1.0,
    *,
    at: Sequence[Count] | None = None,
    **contacts: Parameter | str | Law | None,
) -> Lattice:
    r"""Build a mass-with-mass chain: beads with a mass mu outside, on a linear spring kappa.

    Equations as in `mass_in_mass`. Only some beads may carry a resonator, such as a mass-with-mass
    defect, which scatters solitary waves.

    **Arguments:** `at`: the beads that carry a resonator, negative from the end; `None` is all.
    `mass`, `stiffness`: numbers or one per resonator. `contacts`: as in `mass_in_mass`.

    **Returns:** a `Lattice` of the fields `"bead"` (N,) and `"resonator"`, one entry per resonator.
    **Raises** ValueError as `mass_in_mass` does, and if `at` is empty, outside the chain or repeats
    a bead.
    Source: Gantzounis, Serra-Garcia, Homma, Mendoza, Daraio, J. Appl. Phys. 114, 093514 (2013);
    Kevrekidis, Vainchtein, Serra Garcia, Daraio, Phys. Rev. E 87, 042911 (2013).
    """
    return _resonant(sites, {"resonator": {"mass": mass, "stiffness": stiffness}}, at, **contacts)


def woodpile(
    sites: Count,
    masses: Sequence[Parameter] | Numbers = (0.5, 0.25),
    stiffnesses: Sequence[Parameter] | Numbers = (1.0, 2.0),
    **contacts: Parameter | str | Law | None,
) -> Lattice:
    r"""Build a woodpile: a stack of crossed rods whose bending modes act as resonators.

    m u_n'' = F(u_{n-1} - u_n) - F(u_n - u_{n+1}) - sum_j kappa_j (u_n - w_nj),
    mu_j w_nj'' = kappa_j (u_n - w_nj).

    There is one branch more than there are resonators. With omega_j^2 = kappa_j/mu_j and K2 =
    F'(0):

    (m + sum_j mu_j/(1 - omega^2/omega_j^2)) omega^2 = 4 K2 sin^2(k/2).

    **Arguments:** `masses`: mu_j > 0 and `stiffnesses`: kappa_j >= 0 (0 decouples), one entry per
    resonator of a rod (the first axis of an array), each a number or one per rod (N,). `contacts`:
    as in `mass_in_mass`.

    **Returns:** a `Lattice` of the fields `"bead"` (the rod) and `"resonator_1"`,
    `"resonator_2"`, ..., (N,) each.
    **Raises** ValueError as `mass_in_mass` does, and for lengths that differ.
    Source: Kim, Li, Chong, Theocharis, Yang, Kevrekidis, Phys. Rev. Lett. 114, 118002 (2015).

    **Example:**

    >>> chain = gx.scenes.woodpile(20, precompression=1.0)
    >>> len(gx.linear.bands(chain).gaps)  # three branches
    2
    """
    masses = several("masses", masses, "one entry per resonator of a rod")
    stiffnesses = several("stiffnesses", stiffnesses, "one entry per resonator of a rod")
    if len(masses) != len(stiffnesses):
        refuse(
            "stiffnesses",
            f"{len(masses)}, as many as masses",
            f"{len(stiffnesses)}",
            "Each resonator has both.",
        )
    resonators = {
        f"resonator_{j + 1}": {f"masses[{j}]": mu, f"stiffnesses[{j}]": kappa}
        for j, (mu, kappa) in enumerate(zip(masses, stiffnesses))
    }
    return _resonant(sites, resonators, **contacts)


def _resonant(
    sites,
    resonators,
    at=None,
    *,
    bead_mass=1.0,
    contact_stiffness=1.0,
    exponent=1.5,
    precompression=0.0,
    boundary="fixed",
    law=None,
    units=SCALED,
):
    # Build the chain; `resonators`: from field to mass and stiffness, each by argument name.
    sites = a_chain(sites)
    if law is None:
        stiffness = positive(
            "contact_stiffness", contact_stiffness, "The contact coefficient A is positive."
        )
        law = contact(stiffness, exponent, precompression)
    places = range(sites) if at is None else _places(sites, at)
    count, carrier = (sites, "bead") if at is None else (len(places), "resonator")
    mass = {"bead": positive("bead_mass", bead_mass, "A bead needs a mass.")}
    law = fitting(law, contacts_of(sites, boundary), "contact")
    terms = [Bond(Shift(1, boundary, "bead"), law)]
    for name, given in resonators.items():
        check_each(count, carrier, **given)
        (of_mass, mu), (of_spring, kappa) = given.items()
        mass[name] = positive(of_mass, mu, "A resonator needs a mass.")
        fields = ("bead", name)
        tie = (
            Shift(0, "free", fields)
            if at is None
            else Pairs(places, range(count), sites=(sites, count), fields=fields)
        )
        terms.append(Bond(tie, Linear(non_negative(of_spring, kappa, _TIE))))
    if at is None:
        return Lattice(mass, terms, sites=sites, units=units)
    sizes = {"bead": sites, "resonator": count}
    mass = {name: m if m.ndim else jnp.full(sizes[name], m) for name, m in mass.items()}
    return Lattice(mass, terms, units=units)


def _places(sites, at):
    at = several("at", at, "a sequence of beads")
    places = [site % sites for site in at if -sites <= site < sites]
    if not places or len(set(places)) < len(at):
        wanted = f"sites from 0 to {sites - 1}, or negative from the end, each once, one at least"
        refuse("at", wanted, repr([*at]))
    return places
