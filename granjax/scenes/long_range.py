"""Chains in which every site interacts with every other: repelling magnets, algebraic kernels."""

from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import (
    concrete,
    non_negative,
    one_of,
    parameter,
    positive,
    refuse,
    require,
    show,
    whole,
)
from ..base.programs import in_numpy
from ..base.types import Count, Parameter, Scalar
from ..base.units import SCALED
from ..lattice import Lattice
from ..laws import Polynomial, PowerLaw
from ..strains import BOUNDARIES
from ..terms import LongRange
from .chains import a_chain, number

# largest number of magnets of a finite chain whose equilibrium is computed
MANY = 2000
# limit on the steps of Newton's method, which needs four to nine
ITERATIONS = 50
# Newton's method stops at a step below this, in spacings: the next step would square it.
SETTLED = 1e-9
# In a long chain rounding keeps the steps at about this many units in the last place.
ROUNDING = 1000


def magnets(
    sites: Count,
    exponent: Scalar = -4.0,
    *,
    mass: Parameter = 1.0,
    stiffness: Scalar = 1.0,
    spacing: Scalar = 1.0,
    diameter: Scalar = 0.0,
    reach: Count | None = None,
    boundary: str = "fixed",
    units: str = SCALED,
) -> Lattice:
    r"""Build a chain of magnets that all repel each other: force A r^p at a distance r, p < 0.

    m_n u_n'' = sum over j < n of A (x_n - x_j)^p - sum over j > n of A (x_j - x_n)^p.

    A finite chain of equal spacings is not in equilibrium, because magnets near an end feel fewer
    others: u is measured from the computed equilibrium (`gx.equilibrium`).

    **Arguments:**

    - `sites`: number of moving magnets N >= 2; `mass`: a number, or one per magnet (a light one is
      a defect).
    - `exponent`: p < 0: -4 for two distant dipoles, about -2.7 to -4.5 as fitted to ring magnets.
      `stiffness`: A > 0.
    - `spacing`: mean distance d of neighbours; `diameter`: of a magnet, less than d.
    - `reach`: neighbours on either side that a magnet feels, `None` for all (on a ring those nearer
      than half way round); 1 is the chain of next neighbours, `PowerLaw(A, p, A d^p)`.
    - `boundary`: `"fixed"` (two more magnets are held at the ends, (N + 1) d apart), `"free"` (a
      load on the outermost ones holds them at rest (N - 1) d apart), `"periodic"`.
    - `units`: `"scaled"` or `"SI"`.

    The end loads are `gx.equilibrium(lattice).ends`. A run reports magnets that meet as its
    outcome.

    **Returns:** a `Lattice`, differentiable in all numbers but `diameter`.
    **Raises** ValueError for arguments outside these ranges, a ring too short for its reach, or
    more than 2000 magnets between ends.
    Source: Moleron, Leonard, Daraio, J. Appl. Phys. 115, 184901 (2014); Chong et al., Phys. Rev.
    Lett. 131, 117201 (2023).

    **Example:**

    >>> chain = gx.scenes.magnets(20, reach=1)
    >>> round(float(gx.linear.sound_speed(chain)), 6)  # (4 A/m)^{1/2}
    2.0
    """
    sites = a_chain(sites)
    boundary = one_of("boundary", boundary, BOUNDARIES)
    p = number("exponent", exponent)
    A = positive("stiffness", stiffness)
    d = positive("spacing", spacing)
    size = concrete(non_negative("diameter", diameter))
    require("exponent", p, lambda p: p < 0, "p < 0, magnets that repel less further apart")
    wanted = f"more than the diameter of a magnet, {show(diameter)}"
    require("spacing", d, lambda d: size is None or d > size, wanted, "These touch.")
    power = exponent if isinstance(exponent, (int, float)) else p
    # Known numbers use NumPy, because JAX compiles a program for each operation.
    A, d, p = in_numpy((A, d, p))
    reach, kernel = _kernel(sites, p, reach, boundary)
    beyond = 1 if boundary == "fixed" and reach > 1 else None
    rest = None
    if boundary != "periodic" and reach > 1:
        rest = d * _rest(sites, power, reach, boundary)
    law = PowerLaw(A, power, A * d**p)
    term = LongRange(kernel, law, boundary, takes="strain", beyond=beyond, rest=rest)
    return Lattice(mass, term, sites=sites, units=units)


def _kernel(sites, p, reach, boundary):
    most = {"fixed": sites + 1, "free": sites - 1, "periodic": max((sites - 1) // 2, 1)}[boundary]
    reach = most if reach is None else whole("reach", reach, 1)
    if boundary == "periodic" and reach > most:
        refuse(
            "reach", f"at most {most}, less than half way round a ring of {sites} sites", f"{reach}"
        )
    return min(reach, most), np.arange(1.0, min(reach, most) + 1) ** p


def _rest(sites, p, reach, boundary):
    if sites > MANY:
        refuse(
            "sites",
            f"at most {MANY} magnets between ends",
            f"{sites}",
            "A ring is at rest in equal spacings: boundary='periodic'; or let them feel next neighbours, reach=1.",
        )
    value = concrete(p)
    if value is None:
        return _found_rest(sites, p, reach, boundary)
    return _known_rest(sites, float(value), reach, boundary)


@lru_cache(maxsize=64)
def _known_rest(sites, p, reach, boundary):
    u, step, kept = _towards_rest(np, sites, reach, boundary)
    for _ in range(ITERATIONS):
        u, change = step(u, p)
        if change <= SETTLED:
            return u[kept]
    refuse(
        "exponent",
        f"magnets that Newton's method brings to rest in {ITERATIONS} steps",
        f"{sites} magnets of exponent {p:g}, which are not at rest by then",
        "Take fewer magnets, or a shorter reach: such forces act on the whole chain.",
    )


# The rest displacements for a traced exponent. Two more Newton steps carry derivatives up to the
# third order.
@partial(jax.jit, static_argnums=(0, 2, 3))
def _found_rest(sites, p, reach, boundary):
    u, step, kept = _towards_rest(jnp, sites, reach, boundary)
    p = p.astype(u.dtype)
    there = jax.lax.stop_gradient(p)
    settled = max(SETTLED, ROUNDING * float(jnp.finfo(there.dtype).eps))
    u, change, _ = jax.lax.while_loop(
        lambda x: (x[1] > settled) & (x[2] < ITERATIONS),
        lambda x: (*step(x[0], there), x[2] + 1),
        (u + 0 * there, 1 + 0 * there, 0),
    )
    u = jnp.where(change <= settled, u, jnp.nan)
    return jax.lax.scan(lambda u, _: (step(u, p)[0], None), u, None, length=2)[0][kept]


def _towards_rest(numpy, sites, reach, boundary):
    """Return the starting point, a step of Newton's method, and the slice of the sites.

    The outermost two magnets stay. The energy is convex while magnets stay in order, so no step
    brings two of them closer than half of their distance.
    """
    more = int(boundary == "fixed")
    place = np.arange(-more, sites + more, dtype=float)
    inner = slice(1, -1)
    away = place[:, None] - place
    pushes = (away != 0) & (np.abs(away) <= reach)

    def step(u, p):
        r = numpy.where(pushes, np.abs(away) + np.sign(away) * (u[:, None] - u), 1)
        force = numpy.where(pushes, r**p, 0)
        slope = p * force / r
        stiffness = (numpy.diag(slope.sum(1)) - slope)[inner, inner]
        change = numpy.pad(numpy.linalg.solve(stiffness, -(np.sign(away) * force).sum(1)[inner]), 1)
        closer = numpy.max(-numpy.diff(change) / (1 + numpy.diff(u)))
        return u + change / numpy.maximum(1, 2 * closer), numpy.max(numpy.abs(change))

    return numpy.zeros(sites + 2 * more), step, slice(more, sites + more)


def long_range(
    sites: Count,
    exponent: Scalar = 3.0,
    *,
    mass: Parameter = 1.0,
    stiffness: Scalar = 1.0,
    alpha: Scalar = 0.0,
    beta: Scalar = 0.0,
    reach: Count | None = None,
    boundary: str = "fixed",
    units: str = SCALED,
) -> Lattice:
    r"""Build a chain with springs to all neighbours, weaker by m^{-s} at the distance m.

    The spring between n and n + m has the force m^{-s} (K e + alpha e^2 + beta e^3), e =
    u_n - u_{n+m}, computed by FFT. Breathers have algebraic tails, |u_n| ~ |n|^{-s}. For the mass
    M, omega^2(k) = (2K/M) sum_m m^{-s} (1 - cos k m).

    **Arguments:** `sites`: N; `exponent`: s > 0; `mass`: a number, or one per site; `stiffness`:
    K > 0; `alpha`, `beta`; `reach`: as in `magnets`. `boundary`: `"fixed"` (one site at rest beyond
    either end), `"free"`, `"periodic"`. `units`: as in `Lattice`. Typical: s = 3.

    **Raises** ValueError for arguments outside these ranges, or a ring too short for its reach.
    Source: Flach, Phys. Rev. E 58, R4116 (1998).

    **Example:**

    >>> chain = gx.scenes.long_range(20, exponent=3.0, reach=2, boundary="periodic")
    >>> round(float(gx.linear.normal_modes(chain).omega_squared[-1]), 6)  # 4 at k = pi
    4.0
    """
    sites = a_chain(sites)
    boundary = one_of("boundary", boundary, BOUNDARIES)
    s = positive("exponent", number("exponent", exponent), "Interactions weaken with the distance.")
    K = positive("stiffness", stiffness, "At rest the springs hold the chain.")
    for name, x in (("alpha", alpha), ("beta", beta)):
        parameter(name, x)
    _, kernel = _kernel(sites, -s, reach, boundary)
    beyond = 1 if boundary == "fixed" else None
    term = LongRange(kernel, Polynomial(K, alpha, beta), boundary, beyond=beyond)
    return Lattice(mass, term, sites=sites, units=units)
