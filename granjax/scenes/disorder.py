"""Disordered chains: random masses, radii, stiffnesses or positions, independent or in dimers."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp

from ..base.checks import concrete, one_of, positive, random_key, refuse, require, within
from ..base.types import Count, Parameter, Scalar, Seed
from ..base.units import SCALED
from ..lattice import Lattice
from ..laws import Law
from .chains import MANY, a_chain, chain, contacts_of, monomer, number

DISORDERED = ("mass", "radius", "stiffness", "position")
CORRELATIONS = ("none", "alike", "opposite")


def disordered(
    sites: Count,
    spread: Scalar,
    seed: Seed = 0,
    *,
    of: str = "mass",
    distribution: str = "uniform",
    correlation: str = "none",
    law: Callable[..., Law] | None = None,
    mass: Scalar = 1.0,
    stiffness: Parameter = 1.0,
    exponent: Parameter = 1.5,
    precompression: Parameter = 0.0,
    boundary: str = "fixed",
    units: str = SCALED,
) -> Lattice:
    r"""Build a granular chain of random masses, radii, stiffnesses or positions.

    With random numbers x_n in [-1, 1] of mean 0 and the spread s, `of` chooses what is random:

    - `"mass"`: m_n = m (1 + s x_n), one per bead;
    - `"radius"`: spheres of one material with R_n = 1 + s x_n, m_n = m R_n^3 and Hertz coefficients
      A_n = A (2 R_n R_{n+1}/(R_n + R_{n+1}))^{1/2}; a wall acts as a bead of the end bead's radius;
    - `"stiffness"`: A_n = A (1 + s x_n), one per contact;
    - `"position"`: static loads hold the beads at s x_n d0/2 from their places, so that contacts
      overlap by d0 (1 + s (x_n - x_{n+1})/2), between 0 and 2 d0; walls stay in place. Needs
      F0 > 0.

    **Arguments:**

    - `spread`: s in [0, 1). `seed`: a whole number or a JAX key. Both may be traced, for
      realisations in lanes:
      `jax.vmap(lambda n: disordered(500, 0.3, n), out_axes=-1)(jnp.arange(64))`.
    - `distribution`: `"uniform"`, x in [-1, 1] of standard deviation 1/sqrt(3); `"binary"`, -1 or 1
      with equal chance.
    - `correlation`: `"none"`: independent x_n (Anderson); `"alike"`, `"opposite"`: pairs of
      neighbours x, x or x, -x (random dimers; binary: AA or BB, AB or BA).
    - `law`: a function from the stiffness to the contact law, in place of `exponent` and
      `precompression`: `law=gx.Linear` is the linear chain,
      `law=lambda A: gx.Polynomial(A, 0.0, A)` the beta chain of FPUT.
    - `mass`: m; the others as in `monomer`. `units`: `"scaled"` or `"SI"`.

    **Returns:** a `Lattice`; equal seeds give equal chains. Waves localise with strong
    precompression, where the chain is nearly linear, and do not in the sonic vacuum, F0 = 0:
    `gx.linear.localisation_length`, `gx.measures.second_moment`. In SI:
    `gx.scenes.beads(material, radii)`.
    **Raises** ValueError for arguments outside these ranges, radii without Hertz contacts,
    positions without F0 or with a `law`, and as `monomer` does.
    Source: Martinez, Kevrekidis, Porter, Phys. Rev. E 93, 022902 (2016); random dimers: Dunlap, Wu,
    Phillips, Phys. Rev. Lett. 65, 88 (1990).

    **Example:**

    >>> chain = gx.scenes.disordered(20, 0.3, seed=1)
    >>> bool((abs(chain.mass - 1) <= 0.3).all()), bool(chain.mass.std() > 0.1)
    (True, True)
    """
    sites, contacts = a_chain(sites), contacts_of(sites, boundary)
    one_of("of", of, DISORDERED)
    remedy = "What is random lies between 1 - spread and 1 + spread times its mean."
    spread = within("spread", number("spread", spread), 0, 1, open_high=True, remedy=remedy)
    draw = _DRAWS[one_of("distribution", distribution, _DRAWS)]
    one_of("correlation", correlation, CORRELATIONS)
    count = contacts if of == "stiffness" else sites
    key = random_key(seed, MANY)
    if correlation == "none":
        x = draw(key, (count,), spread.dtype)
    else:
        x = draw(key, (-(-count // 2),), spread.dtype)
        x = jnp.stack([x, x if correlation == "alike" else -x], -1).ravel()[:count]
    x = spread * x
    m = positive(
        "mass", number("mass", mass), "It is the mean mass, or that of a bead of mean radius."
    )
    A = positive("stiffness", stiffness, "Contacts push.")
    if of == "mass":
        m = m * (1 + x)
    elif of == "radius":
        known = concrete(exponent)
        if law is None and (known is None or (known != 1.5).any()):
            remedy = "How a contact follows from radii is Hertz's law."
            refuse("exponent", "3/2 with of='radius'", f"{exponent}", remedy)
        m = m * (1 + x) ** 3
        A = A * _hertz_share(1 + x, boundary)
    elif of == "stiffness":
        A = A * (1 + x)
    elif law is not None:
        remedy = "Positions change the static force, which is part of a law."
        refuse("law", "None with of='position'", "a law", remedy)
    else:
        precompression = _displaced(x, exponent, precompression, boundary)
    if law is None:
        return monomer(sites, m, A, exponent, precompression, boundary).counted_in(units)
    known = concrete(precompression)
    if known is None or known.any():
        wanted = "0 with a law of your own"
        refuse("precompression", wanted, f"{precompression}", "Give it to the law.")
    return chain(sites, m, law(A), boundary=boundary, units=units)


_DRAWS = {
    "uniform": partial(jax.random.uniform, minval=-1.0, maxval=1.0),
    "binary": jax.random.rademacher,
}


def _around(x, boundary):
    # Append the first number on a ring, so that neighbours are one apart.
    return jnp.append(x, x[0]) if boundary == "periodic" else x


def _hertz_share(R, boundary):
    R = _around(R, boundary)
    share = 2 * R[:-1] * R[1:] / (R[:-1] + R[1:])
    return jnp.sqrt(jnp.concatenate([R[:1], share, R[-1:]]) if boundary == "fixed" else share)


def _displaced(x, exponent, precompression, boundary):
    require(
        "precompression",
        precompression,
        lambda F0: F0 > 0,
        "a static force above zero with of='position'",
        "Without overlap at rest positions change no force.",
    )
    x = jnp.pad(x, 1) if boundary == "fixed" else _around(x, boundary)
    change = x[:-1] - x[1:]
    # Beads that approach each other raise the overlap of a contact but lower the distance of
    # magnets, which have p < 0: hence the sign of p.
    p = jnp.asarray(exponent)
    return precompression * (1 + jnp.sign(p) * change / 2) ** p
