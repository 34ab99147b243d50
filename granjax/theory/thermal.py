r"""Thermal equilibrium of one bond by quadrature: averages, fluctuations, the speed of sound.

In a chain with a free end the bonds are independent. At temperature T (k_B T [J]) and pressure P,
the mean total contact force, the compression e of each has the density exp(-(V(e) - P e)/(k_B T)),
where V' is the total contact force.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ..base.arrays import trailing
from ..base.checks import parameter, positive, refuse
from ..base.programs import compiled
from ..base.types import Count, Number, Numbers, Parameter
from ..results import Result, array

__all__ = ["BondState", "bond_state"]

# compressions at which the density is first looked for: powers of two, for any unit of length
LADDER = 2.0 ** np.arange(-140, 70)
# the density is neglected where its logarithm is this far below the maximum: exp(-45) is 3e-20
DEPTH = 45.0
# the number of zooms onto the interval of the density
ZOOMS = 8
# the number of compressions that each further zoom evaluates
PLACES = 64
# the nodes of a quadrature
NODES = 1025
# the nodes of a table from which compressions are drawn
TABLE = 257
# passes that spread the nodes over length, the logarithm of the density and the density itself
SPREADINGS = 4
# the rule for a cell between two nodes
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(5)
# Error estimate over the difference of the two rules. In the cell where a contact opens both rules
# have a similar error: in 60 scenes it was at most 13 times their difference.
COVER = 30.0
# the rule with fewer nodes, with which that for a cell is compared
FEWER, FEWER_WEIGHTS = np.polynomial.legendre.leggauss(3)


class BondState(Result):
    """Averages over the canonical distribution of a bond, of the shape of the law's parameters."""

    temperature: Numbers = array("The temperature k_B T.", "J")
    pressure: Numbers = array("The mean total contact force.", "N")
    strain: Numbers = array("Mean compression from the law's equilibrium.", "m")
    energy: Numbers = array(
        "Mean energy of the bond above equilibrium, without the work of the preload.", "J"
    )
    strain_variance: Numbers = array("Variance of the compression.", "m^2")
    energy_variance: Numbers = array("Variance of the energy V - P e.", "J^2")
    covariance: Numbers = array("Covariance of compression and energy V - P e.", "J m")
    sound_speed: Numbers = array(
        "Adiabatic speed of sound of a chain of such bonds and equal masses, in sites.", "1/s"
    )
    error: Numbers = array(
        "The largest relative error of the quadratures; that of the mean compression is relative "
        "to its standard deviation."
    )

    @property
    def outcome(self) -> str:
        """The distribution, in a sentence."""
        return "The canonical distribution of one bond."


def bond_state(
    law: Any, temperature: Parameter, pressure: Parameter | None = None, *, mass: Parameter = 1.0
) -> BondState:
    r"""Compute the averages of a bond at a temperature and a pressure.

    With U = V(e) - P e and beta = 1/(k_B T) the adiabatic speed of sound, in sites per time, is

    $$c^2 = \frac{1/(2\beta^2) + \langle U;U\rangle}{m\,\Gamma},\quad
    \Gamma = \beta(\langle e;e\rangle\langle U;U\rangle - \langle e;U\rangle^2) + \langle e;e\rangle/(2\beta).$$

    **Arguments:** `law`; `temperature`: k_B T > 0 [J]; `pressure`: P [N], by default the law's
    preload, which balances a chain with free ends; `mass` [kg]. They broadcast with the law's
    parameters.

    **Raises** ValueError for a temperature or mass that is not positive, and where no canonical
    distribution exists: V(e) - P e has no lower bound (FPUT-alpha) or does not rise (an unloaded
    contact at P = 0).

    Source: H. Spohn, J. Stat. Phys. 154, 1191 (2014).

    **Example:**

    >>> found = gx.theory.thermal.bond_state(gx.Linear(2.0), 0.5)
    >>> round(float(found.strain_variance), 10), round(float(found.sound_speed), 10)
    (0.25, 1.4142135624)
    """
    T = positive("temperature", temperature)
    m = positive("mass", mass)
    P = jnp.asarray(law.preload, float) if pressure is None else parameter("pressure", pressure)
    nodes = checked_nodes(law, T, P)
    moments, error = _moments(law, T, P, nodes)
    e, V, ee, UU, eU = moments
    gamma = (ee * UU - eU**2) / T + ee * T / 2
    c = jnp.sqrt((T**2 / 2 + UU) / (m * gamma))
    return BondState(T, P, e, V, ee, UU, eU, c, error)


def checked_nodes(law: Any, T: Numbers, P: Numbers, count: Count = NODES) -> Numbers:
    """Return mesh nodes (count, ...) that resolve the density; refuse laws without a density."""
    nodes, confined = jax.lax.stop_gradient(_nodes(law, T, P, count))
    if not isinstance(confined, jax.core.Tracer) and not np.all(confined):
        refuse(
            "law",
            "an energy V(e) - P e that rises without bound on both sides",
            "one that falls or stays level",
            "It has no thermal equilibrium: give a pressure, or a law with a stiffening term.",
        )
    return nodes


def potential(law: Any, T: Number, P: Number, e: Numbers) -> Numbers:
    """Return (V - P e)/(k_B T), infinite where the law is not defined."""
    room = law.room(e)
    outside = False if room is None else room <= 0
    inside = jnp.where(outside, 0, e)
    g = (law.energy(inside) - (P - law.preload) * inside) / T
    return jnp.where(jnp.isnan(g) | outside, jnp.inf, g)


@compiled
def _nodes(law, T, P, count):
    zero = jnp.zeros(()) * potential(law, T, P, jnp.zeros(()))
    ladder = jnp.concatenate([-LADDER[::-1], jnp.zeros(1), LADDER])
    e = trailing(ladder, 1 + zero.ndim) + zero
    confined = None
    for _ in range(ZOOMS):
        g = potential(law, T, P, e)
        there = g < jnp.min(g, 0) + DEPTH
        first = jnp.argmax(there, 0)
        last = len(e) - 1 - jnp.argmax(there[::-1], 0)
        if confined is None:
            confined = (first > 0) & (last < len(e) - 1) & ~jnp.isneginf(g).any(0)
        take = lambda i: jnp.take_along_axis(e, i[None], 0)[0]
        low = take(jnp.maximum(first - 1, 0))
        high = take(jnp.minimum(last + 1, len(e) - 1))
        e = low + trailing(jnp.linspace(0, 1, PLACES), e.ndim) * (high - low)
    share = jnp.linspace(0, 1, count)
    e = low + trailing(share, e.ndim) * (high - low)
    for _ in range(SPREADINGS):
        g = potential(law, T, P, e)
        density = jnp.exp(jnp.min(g, 0) - g)
        cells = jnp.diff(e, axis=0)
        steps = jnp.abs(jnp.diff(jnp.minimum(g, jnp.min(g, 0) + DEPTH), axis=0))
        middle = cells * (density[1:] + density[:-1]) / 2
        parts = [x / jnp.sum(x, 0) for x in (cells, steps, middle)]
        filled = jnp.cumsum(sum(parts) / 3, 0)
        filled = jnp.concatenate([jnp.zeros_like(filled[:1]), filled / filled[-1:]])
        e = _interpolated(share, filled, e)
    # Contacts that are mostly open press in a small part of one cell, between the points of both
    # rules: add nodes where they open.
    lengths = [length for part in law.parts if (length := part.overlap(e)) is not None]
    openings = [_interpolated(np.zeros(1), length, e) for length in lengths]
    return jnp.sort(jnp.concatenate([e, *openings]), 0), confined


def _interpolated(x, xs, ys):
    flat = jax.vmap(jnp.interp, (None, 1, 1), 1)(x, *(a.reshape(len(a), -1) for a in (xs, ys)))
    return flat.reshape((len(x),) + ys.shape[1:])


def masses(law: Any, T: Numbers, P: Numbers, nodes: Numbers, weighted: Any = None) -> tuple:
    """Integrate the density, times `weighted(e)`, over each cell of the mesh.

    **Returns:** the integrals, and their differences from a rule with fewer points.
    """
    low = nodes[:-1]
    width = jnp.diff(nodes, axis=0)
    floor = jnp.min(potential(law, T, P, nodes), 0)

    # The loop traces the law once for the points of both rules.
    def add(total, point):
        x, weights = point
        e = low + (1 + x) / 2 * width
        density = width / 2 * jnp.exp(floor - potential(law, T, P, e))
        if weighted is not None:
            # The last cell may end where the law is not defined.
            density = density * weighted(jnp.where(density > 0, e, 0))
        return tuple(part + w * density for part, w in zip(total, weights)), None

    x = np.concatenate([POINTS, FEWER])
    rules = scipy.linalg.block_diag(WEIGHTS, FEWER_WEIGHTS).T
    zero = jnp.zeros_like(width)
    (fine, rough), _ = jax.lax.scan(add, (zero, zero), (x, rules))
    return fine, fine - rough


@compiled
def _moments(law, T, P, nodes):
    average = partial(_average, law, T, P, nodes, masses(law, T, P, nodes))
    mean_e = average(lambda e: e)
    energy = average(law.energy)
    U = lambda e: law.energy(e) - (P - law.preload) * e
    middle = mean_e[0]
    level = average(U)[0]
    ee = average(lambda e: (e - middle) ** 2)
    UU = average(lambda e: (U(e) - level) ** 2)
    eU = average(lambda e: (e - middle) * (U(e) - level))
    found = mean_e, energy, ee, UU, eU
    sizes = jnp.sqrt(ee[0]), energy[0], ee[0], UU[0], jnp.sqrt(ee[0] * UU[0])
    errors = [wrong / jnp.abs(size) for (_, wrong), size in zip(found, sizes)]
    error = jnp.max(jnp.stack(errors), 0) + len(nodes) * jnp.finfo(nodes.dtype).eps
    return tuple(x[0] for x in found), error


def _average(law, T, P, nodes, plain, quantity):
    weight, missed = plain
    value, wrong = masses(law, T, P, nodes, quantity)
    total = jnp.sum(weight, 0)
    mean = jnp.sum(value, 0) / total
    off = COVER * jnp.sum(jnp.abs(wrong - mean * missed), 0)
    return mean, off / total
