"""Fractional chains: FPUT and sine-Gordon with a discrete fractional Laplacian."""

import jax.numpy as jnp

from ..base.checks import non_negative, one_of, positive, refuse
from ..base.types import Count, Parameter
from ..lattice import Lattice
from ..laws import Law, Linear, Polynomial, Scaled
from ..strains import BOUNDARIES, Shift
from ..terms import Bond, LongRange, OnSite
from ..terms.fractional import checked_order, kernel, ring_kernel, to_the_right
from .chains import a_chain, number
from .on_site import COUPLED, pendula


def fractional(
    sites: Count,
    order: Parameter = 0.5,
    *,
    law: Law | None = None,
    on_site: Law | None = None,
    mass: Parameter = 1.0,
    boundary: str = "periodic",
) -> Lattice:
    r"""Build a fractional chain, with the discrete fractional Laplacian of order s.

    m u_n'' = -sum_{m != 0} K_s(m) F(u_n - u_{n+m}) = -k ((-Delta)^s u)_n for a linear law,
    omega^2 = (k/m)(4 sin^2 (q/2))^s.

    K_s is `gx.fractional.kernel`, with a tail m^{-1-2s}. s = 1 is the chain of next neighbours.

    **Arguments:**

    - `sites`: N >= 2, on a ring >= 3. `order`: s in (0, 1]; may be traced, differentiated and, by
      `jax.vmap`, batched.
    - `law`: F of every bond, `Linear(1)` by default, or any other. `on_site`: -on_site.force(u) on
      each site.
    - `mass`: m > 0, a number, or one per site.
    - `boundary`: `"periodic"`: the weights are summed over all images, so that the frequencies
      above are exact. `"fixed"`: the infinite chain, with all sites beyond the ends held at u = 0.
      `"free"`: only bonds within the chain.

    **Returns:** a `Lattice`; polynomial laws cost a few FFTs per force. Typical: s = 0.3 ... 1.
    **Raises** ValueError for s outside (0, 1] and as `monomer` does.
    Sources: Ciaurri et al., Adv. Math. 330, 688 (2018); Molina, Phys. Lett. A 384, 126180 (2020);
    Cuevas-Maraver, Kevrekidis (eds.), Fractional Dispersive Models and Applications (2024).

    **Example:**

    >>> chain = gx.scenes.fractional(20, order=0.5)
    >>> round(float(gx.linear.normal_modes(chain).omega[-1]), 6)  # 4^{1/4}
    1.414214
    """
    one_of("boundary", boundary, BOUNDARIES)
    sites = a_chain(sites)
    if boundary == "periodic" and sites < 3:
        refuse("sites", "at least 3 on a ring", f"{sites}")
    order = checked_order(number("order", order))
    law = Linear(1.0) if law is None else law
    weights = _around(sites, order, law) if boundary == "periodic" else kernel(order, sites - 1)
    terms = [LongRange(weights, law, boundary)]
    if boundary == "fixed":
        # the sites beyond an end: K(M + 1) + K(M + 2) + ... = K(M) (M - s)/(2 s)
        rest = weights[-1] * (sites - 1 - order) / (2 * order)
        # from both ends, F(u) - F(-u)
        terms.append(OnSite(Scaled(law, rest) + Scaled(law, -rest, -1.0)))
    if on_site is not None:
        terms.append(OnSite(on_site))
    return Lattice(mass, terms, sites=sites)


def _around(sites, order, law):
    """Return the weights of the offsets on a ring.

    A nonlinear law needs both ways to a site; for a linear one the shorter suffices.
    """
    if not law.is_linear:
        return to_the_right(order, sites)
    both = ring_kernel(order, sites)[: sites // 2]
    return both if sites % 2 else both.at[-1].divide(2)


def fractional_fput(
    sites: Count,
    order: Parameter = 0.5,
    *,
    alpha: Parameter = 0.25,
    beta: Parameter = 0.0,
    nonlinear: str = "all",
    mass: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    boundary: str = "fixed",
) -> Lattice:
    r"""Build a fractional FPUT chain: F(e) = k e + alpha e^2 + beta e^3 with fractional weights.

    With `nonlinear="all"` every bond has F with its weight. With `"neighbours"` alpha e^2 + beta
    e^3 acts only between next neighbours. s = 1 is `fput` either way.

    **Arguments:** `alpha` [N/m^2], `beta` [N/m^3], `stiffness`: k > 0 [N/m], one number each; the
    others as in `fractional`.
    **Raises** ValueError as `fractional` does, and for k <= 0.
    Source: Macias-Diaz, Bountis, Commun. Nonlinear Sci. Numer. Simul. 102, 105917 (2021).
    """
    stiffness = positive("stiffness", number("stiffness", stiffness))
    alpha = number("alpha", alpha)
    beta = number("beta", beta)
    every = one_of("nonlinear", nonlinear, ("all", "neighbours")) == "all"
    law = Polynomial(stiffness, alpha, beta) if every else Linear(stiffness)
    chain = fractional(sites, order, law=law, mass=mass, boundary=boundary)
    if every:
        return chain
    local = Bond(Shift(1, boundary), Polynomial(jnp.zeros_like(stiffness), alpha, beta))
    return Lattice(mass, (*chain.terms, local), sites=sites)


def fractional_sine_gordon(
    sites: Count,
    order: Parameter = 0.5,
    coupling: Parameter = 1.0,
    *,
    mass: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    wavenumber: Parameter = 1.0,
    boundary: str = "periodic",
) -> Lattice:
    r"""Build a fractional sine-Gordon chain: m u_n'' = -C ((-Delta)^s u)_n - (k/q) sin(q u_n).

    For s < 1 tails are algebraic, n^{-2s} for kinks and n^{-1-2s} for breathers. At s = 1/2 and C
    k >> 1 the kink is that of Peierls and Nabarro, pi + 2 atan(k x/C) for q = 1. The band is
    k/m <= omega^2 <= (k + 4^s C)/m.

    **Arguments:** `coupling`: C >= 0 [N/m], one number. `stiffness`: k > 0 [N/m], `wavenumber`:
    q > 0, a number, or one per site. The others as in `fractional`; a kink needs free ends.
    **Raises** ValueError as `fractional` and `sine_gordon` do.
    Source: Alfimov, Pierantozzi, Vazquez, Fractional Differentiation and its Applications, 644
    (2004).
    """
    coupling = non_negative("coupling", number("coupling", coupling), COUPLED)
    on_site = pendula(stiffness, wavenumber)
    return fractional(
        sites, order, law=Linear(coupling), on_site=on_site, mass=mass, boundary=boundary
    )
