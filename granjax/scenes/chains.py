"""Chains in scaled units: mass 1, contact coefficient 1, compression positive, at rest at u = 0."""

import jax
import jax.numpy as jnp

from ..checks import concrete, one_of, parameter, positive, refuse, whole, within
from ..lattice import Lattice
from ..laws import Hertz, Polynomial, PowerLaw, Toda
from ..strains import BOUNDARIES, Shift
from ..terms import Bond

_MANY = "For many at once: jax.vmap(lambda x: scene(..., x), out_axes=-1)(values)."
_RATIO = "The ratio is light over heavy; the heavy bead has mass 1."


def _number(argument, x):
    """A parameter that is one number, traced or not."""
    x = parameter(argument, x)
    if x.ndim:
        refuse(argument, "one number", f"an array of shape {x.shape}", _MANY)
    return x


def _ratio(argument, x):
    return within(argument, _number(argument, x), 0, 1, open_low=True, remedy=_RATIO)


def _contact(stiffness, exponent, precompression):
    if isinstance(exponent, (int, float)) and exponent == 1.5:
        return Hertz(stiffness, precompression)
    return PowerLaw(stiffness, exponent, precompression)


def _chain(sites, mass, law, boundary):
    bond = Bond(Shift(1, one_of("boundary", boundary, BOUNDARIES)), law)
    return Lattice(mass, (bond,), sites=_sites(sites))


def _sites(sites):
    return whole("sites", sites, 2, "A chain has at least two beads.")


def monomer(sites, mass=1.0, stiffness=1.0, exponent=1.5, precompression=0.0, boundary="fixed"):
    r"""Chain of equal beads: m u_n'' = A [d0 + u_{n-1} - u_n]_+^p - A [d0 + u_n - u_{n+1}]_+^p, d0 = (F0/A)^{1/p}.

    **Arguments:**

    - `sites`: number of beads N >= 2.
    - `mass`: m > 0, a number, or one per bead (N,).
    - `stiffness`: A > 0, a number, or one per contact: (N + 1,), (N - 1,) or (N,) for the boundaries below.
    - `exponent`: p; 3/2 is Hertz; another number is static, an array can be swept and differentiated.
    - `precompression`: static force F0 >= 0; the number 0 is a sonic vacuum.
    - `boundary`: `"fixed"` (rigid walls, contacts as between beads), `"free"` (F0 held at the ends), `"periodic"`
      (a ring).

    Any of the numbers may be traced. A batch: `jax.vmap(lambda A: monomer(60, stiffness=A), out_axes=-1)(values)`.

    **Returns:** a `Lattice`. **Raises** ValueError for N < 2, an unknown boundary, m or A <= 0, F0 < 0.
    Source: Nesterenko, J. Appl. Mech. Tech. Phys. 24, 733 (1983).
    """
    return _chain(sites, mass, _contact(stiffness, exponent, precompression), boundary)


def pattern(sites, masses, *, stiffness=1.0, exponent=1.5, precompression=0.0, boundary="fixed"):
    """Chain whose masses repeat: m_n = masses[n mod len(masses)]; the last cell may be cut short.

    **Arguments:** `masses`: the masses of one cell, m > 0, numbers or traced; the others as in `monomer`.

    **Returns:** a `Lattice`. **Raises** ValueError as `monomer` does, and for a ring that the cell does not fill.
    """
    sites = _sites(sites)
    masses = tuple(masses) if isinstance(masses, (tuple, list)) else tuple(parameter("masses", masses))
    cell = [positive(f"masses[{i}]", _number(f"masses[{i}]", m), "A bead needs a mass.") for i, m in enumerate(masses)]
    if not cell:
        refuse("masses", "at least one mass", "none")
    if boundary == "periodic" and sites % len(cell):
        refuse("sites", f"a multiple of {len(cell)}, whole cells on a ring", repr(sites))
    mass = jnp.tile(jnp.stack(cell), -(-sites // len(cell)))[:sites]
    return _chain(sites, mass, _contact(stiffness, exponent, precompression), boundary)


def dimer(sites, ratio=0.5, *, stiffness=1.0, exponent=1.5, precompression=0.0, boundary="fixed"):
    """Chain of heavy and light beads in turn: masses 1, ratio, 1, ratio, ...; the heavy one first.

    With F0 > 0 and K2 = p A^{1/p} F0^{1-1/p} the bands are [0, sqrt(2 K2)] and
    [sqrt(2 K2/ratio), sqrt(2 K2 (1 + 1/ratio))].

    **Arguments:** `ratio`: light over heavy, in (0, 1]; the others as in `monomer`. Typical: ratio 0.3428 (first
    anti-resonance), 0.59 (first resonance) with F0 = 0; 0.338 for steel and aluminium beads of one size.

    **Returns:** a `Lattice`. **Raises** ValueError as `monomer` does, and for a ratio outside (0, 1].
    Source: Jayaprakash, Starosvetsky, Vakakis, Phys. Rev. E 83, 036606 (2011).
    """
    return pattern(sites, (1.0, _ratio("ratio", ratio)), stiffness=stiffness, exponent=exponent,
                   precompression=precompression, boundary=boundary)


def fput(sites, alpha=0.25, beta=0.0, *, mass=1.0, stiffness=1.0, boundary="fixed"):
    r"""Fermi-Pasta-Ulam-Tsingou chain: F(e) = K e + alpha e^2 + beta e^3 in the compression e = u_n - u_{n+1}.

    Compression is positive, so alpha > 0 stiffens under compression; the original chain stiffens under extension,
    which is the same chain with u -> -u. The N = 32 of the literature counts intervals: 31 moving masses.

    **Arguments:** `sites`: number of moving masses; `alpha`, `beta`: K3 and K4; `stiffness`: K; `mass`, `boundary`:
    as in `monomer`. Typical: alpha = 1/4, beta = 0; alpha = 0, beta = 1.

    **Returns:** a `Lattice`. **Raises** ValueError for N < 2, an unknown boundary, m or K <= 0.
    Source: Fermi, Pasta, Ulam (with Tsingou), Los Alamos report LA-1940 (1955).
    """
    stiffness = positive("stiffness", stiffness, "At rest the springs hold the chain.")
    return _chain(sites, mass, Polynomial(stiffness, alpha, beta), boundary)


def toda(sites, *, mass=1.0, strength=1.0, rate=1.0, boundary="free"):
    """Toda chain: F(e) = a (exp(b e) - 1); m u_n'' = a exp(b (u_{n-1} - u_n)) - a exp(b (u_n - u_{n+1})).

    Integrable with `"free"` and `"periodic"` ends. Free ends are held by the constant force a.

    **Arguments:** `strength`: a > 0; `rate`: b > 0; `mass`, `boundary`: as in `monomer`.

    **Returns:** a `Lattice`. **Raises** ValueError for N < 2, an unknown boundary, m, a or b <= 0.
    Source: Toda, J. Phys. Soc. Japan 22, 431 (1967).
    """
    return _chain(sites, mass, Toda(strength, rate), boundary)
