"""Tangent maps over half a period of each breather of a family, and what follows from them."""

from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Complex, Float, Inexact

from ..flow import Flow
from ..lattice import spread_mass
from ..newton import nearby
from .confirm import covering, rounding
from .problems import Family
from .spectrum import reversible_multipliers


@eqx.filter_jit
def _half_maps(problem, x, q):
    """Tangent maps over half a period by the problem's flow and by twice its steps, and how far x moves between them.

    With them x itself at this frequency, as far as the derivative tells beyond Newton's tolerance.

    Over u and m v, in the mean mass and the frequency, so that all entries are numbers.
    """
    shooting, (lattice, period) = problem.shooting, problem.scene(q)
    y, flow, n, moves = shooting.state(x), shooting.flow, shooting.count, shooting.moves
    mass = ravel_pytree(spread_mass(lattice))[0]
    weight = jnp.concatenate([jnp.ones_like(mass), mass / mass.mean() * period])

    def mapped(steps):
        end, map_ = Flow(steps, flow.solver, flow.field).derivative(y, 0.0, period / 2, lattice)
        return map_ * weight[:, None] / weight, ravel_pytree(end.v)[0]

    maps, ends = jax.lax.map(mapped, flow.steps * jnp.array([1, 2]))
    # the velocities at the end are zero, and the mean displacement, but for what an idle unknown adds
    unit = shooting.scale[:n, None] / shooting.scale[n:, None]
    slope = maps[1][n:, :n] * unit / weight[n:, None]
    joined = jnp.block(
        [[slope, moves], [moves.T * mass / mass.sum(), jnp.zeros((moves.shape[1],) * 2)]]
    )
    inverse = jnp.linalg.inv(joined)
    change = inverse[:, :n] @ ((ends[1] - ends[0]) / shooting.scale[n:])
    x = nearby(x, -inverse[:, :n] @ (ends[0] / shooting.scale[n:]))
    return x, maps, covering(change[None], rounding(inverse))


class Spectrum(eqx.Module):
    """Half-traces (n,), multipliers (2n,) and their errors, the error of a step, the symmetries' multipliers.

    `apart`: error of the unknowns `x`.
    """

    half_traces: Inexact[np.ndarray, " n"]
    multipliers: Complex[np.ndarray, " two_n"]
    error: Float[np.ndarray, " two_n"]
    step_error: float
    expected: int
    apart: Float[np.ndarray, " unknowns"]
    x: Float[np.ndarray, " unknowns"]


def spectra_of(
    problem: Family, xs: np.ndarray, qs: np.ndarray, stability: bool = True
) -> Iterator[Spectrum]:
    """The `Spectrum` of each of several orbits, from half a period with the problem's steps and with twice as many.

    While one is decomposed the next one's maps are on their way.
    """
    expected = 2 + 2 * problem.shooting.moves.shape[1]
    none = (np.zeros(0), np.zeros(0, complex), np.zeros(0))

    def launched(i):
        return _half_maps(problem, jnp.asarray(xs[i]), jnp.asarray(qs[i]))

    coming = launched(0)
    for i in range(len(xs)):
        (x, maps, apart), coming = coming, launched(i + 1) if i + 1 < len(xs) else None
        coarse, fine = np.asarray(maps)
        found = reversible_multipliers(fine, coarse) if stability else none
        yield Spectrum(
            *found, float(np.abs(fine - coarse).max()), expected, np.asarray(apart), np.asarray(x)
        )
