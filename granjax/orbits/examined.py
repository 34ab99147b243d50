"""What there is to say of each orbit of a branch: its energy and errors, its tangent maps and multipliers."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..continuation import Curve
from ..flow import Flow
from ..lattice import State, spread_mass
from ..newton import nearby
from ..types import Numbers
from .branch import Bifurcation, Branch
from .confirm import OrbitError, covering, error_of, neighbours, rounding
from .floquet import decide
from .orbit import FRAMES
from .problems import Family
from .spectrum import reversible_multipliers, spectrum
from .steps import answered, history
from .structure import structure, weights


class Examined(NamedTuple):
    """An orbit of a branch, its errors, and its tangent maps by several numbers of steps, the most first.

    Of a breather the maps are over half a period, over u and m v without units; else they are monodromy matrices.
    `changes`: of a breather how far its unknowns may be off; else of the state (3, 2n), by other steps.
    """

    state: State
    period: Numbers
    energy: Numbers
    response: Numbers | None
    error: OrbitError
    response_error: Numbers | None
    maps: Numbers | None
    changes: Numbers

    @property
    def step_error(self) -> float:
        """The change of the tangent map between the most steps and the least."""
        return float(np.abs(np.asarray(self.maps[0]) - np.asarray(self.maps[-1])).max())


def examined(family: Family, z: np.ndarray, response: Callable | None = None) -> Examined:
    """The orbit z = (x, q) of a family."""
    z = jnp.asarray(z)
    return _half(family, z) if family.shooting.reversible else _whole(family, z, response)


@eqx.filter_jit
def _half(family, z):
    """By the steps of the family, and twice as many; of x at this frequency, as far as the derivative tells."""
    x, shooting, (lattice, period) = z[:-1], family.shooting, family.scene(z[-1])
    y, flow, n, moves = shooting.state(x), shooting.flow, shooting.count, shooting.moves
    mass = ravel_pytree(spread_mass(lattice))[0]
    weight = jnp.concatenate([jnp.ones_like(mass), mass / mass.mean() * period])

    def mapped(steps):
        end, map_ = Flow(steps, flow.solver, flow.field).derivative(y, 0.0, period / 2, lattice)
        return map_ * weight[:, None] / weight, ravel_pytree(end.v)[0]

    maps, ends = jax.lax.map(mapped, flow.steps * jnp.array([2, 1]))
    # the velocities at the end are zero, and the mean displacement, but for what an idle unknown adds
    unit = shooting.scale[:n, None] / shooting.scale[n:, None]
    slope = maps[0][n:, :n] * unit / weight[n:, None]
    joined = jnp.block(
        [[slope, moves], [moves.T * mass / mass.sum(), jnp.zeros((moves.shape[1],) * 2)]]
    )
    inverse = jnp.linalg.inv(joined)
    change = inverse[:, :n] @ ((ends[0] - ends[1]) / shooting.scale[n:])
    apart = covering(change[None], rounding(inverse))
    state = shooting.state(nearby(x, -inverse[:, :n] @ (ends[1] / shooting.scale[n:])))
    off = shooting.apart(apart)
    error = error_of(lattice, 0.0, state, off, 2 * jnp.pi / period, jnp.zeros(()))
    period, energy = jnp.broadcast_to(period, ()), lattice.energy(0.0, *state)
    return Examined(state, period, energy, None, error, None, maps, apart)


@eqx.filter_jit
def _whole(family, z, response):
    """By the steps of the family, 3/4 and 1/2 of them; the error is the most that the other steps change."""
    (lattice, period), state = family.scene(z[-1]), family.shooting.state(z[:-1])
    t0, period, flow = (
        family.shooting.t0,
        jnp.asarray(period, lattice.dtype),
        family.shooting.whole,
    )

    def responded(y, n):
        _, ts, ys = history(Flow(n, flow.solver), lattice, y, t0, period, FRAMES)
        return answered(response, lattice, ys, ts)

    def mapped(n):
        end, map_ = Flow(n, flow.solver).derivative(state, t0, t0 + period, lattice)
        return ravel_pytree(end)[0], map_

    counts = jnp.stack([flow.steps, 3 * flow.steps // 4, flow.steps // 2])
    ends, maps = jax.lax.map(mapped, counts)
    # in one unit for displacements and one for velocities
    flat, unravel = ravel_pytree(state)
    scale = jnp.where(jnp.arange(flat.size) < flat.size // 2, 2 * jnp.pi, period)
    inverse = jnp.linalg.inv(jnp.eye(flat.size) - maps[0] * scale[:, None] / scale)
    changes = (
        jnp.stack([ends[1] - ends[0], ends[2] - ends[0], ends[2] - ends[1]]) * scale @ inverse.T
    )
    # of each flow's own orbit
    others = flat + jnp.concatenate([jnp.zeros_like(changes[:1]), changes[:2]]) / scale
    numbers = jax.lax.map(lambda x: responded(unravel(x[0]), x[1]), (others, counts))
    about = covering((numbers[1:] - numbers[0])[:, None], rounding(inverse, jnp.abs(numbers[0])))[0]
    state = unravel(nearby(flat * scale, inverse @ ((ends[0] - flat) * scale)) / scale)
    apart = covering(changes, rounding(inverse, jnp.max(jnp.abs(flat * scale))))
    error = error_of(lattice, t0, state, unravel(apart / scale), 2 * jnp.pi / period, jnp.zeros(()))
    return Examined(
        state, period, lattice.energy(t0, *state), numbers[0], error, about, maps, changes / scale
    )


def examined_along(
    family: Family, curve: Curve, response: Callable | None = None, stability: bool = True
) -> tuple[list[Examined], list[tuple], list[float]]:
    """Each orbit of a curve without its maps, its (multipliers, error, verdict), and its `step_error`.

    While one is decomposed the next one's maps are on their way.
    """
    n, reversible = family.shooting.count, family.shooting.reversible
    known = structure(family.scene(jnp.asarray(curve.p[0]))[0])
    unknown = np.full(2 * n, np.nan, complex), np.full(2 * n, np.nan), ""

    def launched(i):
        return examined(family, np.append(curve.x[i], curve.p[i]), response)

    found, spectra, steps, coming = [], [], [], launched(0)
    for i in range(len(curve.p)):
        here, coming = coming, launched(i + 1) if i + 1 < len(curve.p) else None
        maps = np.asarray(here.maps)
        if not reversible:
            scale = weights(known.mass, here.period)
            maps = maps * scale[:, None] / scale
        here = here._replace(maps=maps)
        found.append(jax.tree.map(np.asarray, here._replace(maps=None)))
        steps.append(here.step_error)
        if stability:
            values, error = (
                reversible_multipliers(*maps)[1:] if reversible else spectrum(*maps)[::2]
            )
            verdict, _ = decide(values, error, known.expected, reversible)
        spectra.append((values, error, verdict) if stability else unknown)
    return found, spectra, steps


def branch_of(
    family: Family,
    curve: Curve,
    along: tuple,
    bifurcations: tuple[Bifurcation, ...] | list[Bifurcation],
) -> Branch:
    """The branch that a curve of a family is, from what `examined_along` gives and its bifurcations."""
    found, spectra, steps = along
    found = jax.tree.map(lambda *x: np.stack(x), *found)
    # an error that is small by accident is as large as its neighbours
    error, about = jax.tree.map(neighbours, (found.error, found.response_error))
    multipliers, multiplier_error, verdict = (np.stack(part) for part in zip(*spectra))
    return Branch(
        family.values(curve.p),
        found.period,
        found.state,
        found.energy,
        found.response,
        error.state,
        error.energy,
        about,
        multipliers,
        multiplier_error,
        np.array(steps),
        verdict,
        tuple(bifurcations),
        family.outcome(curve),
        float(family.shooting.t0),
        family,
        curve,
        **family.scene(jnp.asarray(curve.p[0]))[0].origin,
    )
