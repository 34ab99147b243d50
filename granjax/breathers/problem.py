"""Breathers of conservative lattices as roots, and what is computed at each: energy, step error, multipliers."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..checks import refuse, whole
from ..floquet import reversible_multipliers
from ..flow import Flow
from ..lattice import Lattice, spread_mass
from ..orbits import Shooting, default_steps
from ..solvers import KahanLi8

# the error of half a period that is let pass, and how often the steps are doubled for it
LET_PASS, DOUBLINGS = 1e-8, 5
TOLERANCE = 1e-11


class ByFrequency(eqx.Module):
    """F(x, omega; lattice) = 0: half a period from rest to rest, for Newton's method and for continuation."""

    half: Shooting

    def residual(self, x, omega, lattice):
        """The half period's gaps at a frequency."""
        return self.half.residual(x, (lattice, 2 * jnp.pi / omega))

    def linearise(self, x, omega, lattice):
        """Gaps and their derivatives in x and in omega."""
        gaps, in_x, in_period = self.half.slopes(x, (lattice, 2 * jnp.pi / omega))
        return gaps, in_x, -2 * jnp.pi / omega**2 * in_period


def checked_lattice(lattice):
    """A lattice that has time-reversible, isolated families: single, conservative, autonomous."""
    if not isinstance(lattice, Lattice):
        refuse("lattice", "a Lattice", f"a {type(lattice).__name__}")
    if lattice.lanes:
        remedy = "Use jax.vmap(function, in_axes=-1)(lattice) for gx.breathers.breather with a guess."
        refuse("lattice", "one lattice", f"a batch with lanes {lattice.lanes}", remedy)
    timeless = lattice.conserves
    if not timeless:
        names = ", ".join(type(t).__name__ for t in lattice.terms if not t.dependence(lattice).conserves)
        remedy = "Orbits of damped or driven chains: gx.forced.forced_orbit."
        refuse("lattice", "forces that depend on positions alone", names, remedy)
    return lattice


def half_steps(lattice, period, steps=None):
    """Steps of half a period, from those of a whole one or by default."""
    steps = default_steps(lattice, period, 2, doubled=True) if steps is None else whole("steps", steps, 2)
    if steps % 2:
        refuse("steps", "an even number, of which half a period takes half", repr(steps))
    return steps // 2


def by_frequency(lattice, steps, solver=None):
    """The root problem with a number of steps that may change without compiling anew."""
    return ByFrequency(Shooting.half(lattice, Flow(jnp.asarray(steps, int), solver or KahanLi8())))


@eqx.filter_jit
def energy(lattice, state):
    """Energy from equilibrium."""
    return lattice.energy(0.0, state.u, state.v)


@eqx.filter_jit
def states_of(problem, lattice, xs):
    """States and energies of several unknowns along a leading axis."""
    states = jax.vmap(problem.half.state)(xs)
    return states, jax.lax.map(lambda y: lattice.energy(0.0, y.u, y.v), states)


@eqx.filter_jit
def energy_slope(problem, lattice, x, tangent):
    """dE/ds along a tangent (x, omega) of a branch."""
    total = lambda x: (lambda y: lattice.energy(0.0, y.u, y.v))(problem.half.state(x))
    return jax.jvp(total, (x,), (tangent[:-1],))[1]


@eqx.filter_jit
def _half_maps(flow, x, half, omega, lattice):
    """Tangent maps over half a period by `flow` and by twice its steps, in (u, m v)."""
    y = half.state(x)
    mass = ravel_pytree(spread_mass(lattice))[0]
    weight = jnp.concatenate([jnp.ones_like(mass), mass])

    def scaled(steps):
        _, map_ = Flow(steps, flow.solver, flow.field).derivative(y, 0.0, jnp.pi / omega, lattice)
        return map_ * weight[:, None] / weight

    return jax.lax.map(scaled, flow.steps * jnp.array([1, 2]))


class Spectrum(eqx.Module):
    """Half-traces (n,), multipliers (2n,) and their errors, the error of a step, the symmetries' multipliers."""

    half_traces: np.ndarray
    multipliers: np.ndarray
    error: np.ndarray
    step_error: float
    expected: int


def spectrum_of(problem, lattice, x, omega):
    """Multipliers of the orbit x, from half a period, with twice the steps of the problem and its own for the error."""
    return next(spectra_of(problem, lattice, [x], [omega]))


def spectra_of(problem, lattice, xs, omegas):
    """The `Spectrum` of each of several orbits; while one is decomposed the next one's maps are on their way."""
    flow = eqx.tree_at(lambda f: f.steps, problem.half.flow, jnp.asarray(problem.half.flow.steps, int))
    expected = 2 + 2 * problem.half.moves.shape[1]

    def launched(i):
        return _half_maps(flow, jnp.asarray(xs[i]), problem.half, jnp.asarray(omegas[i]), lattice)

    coming = launched(0)
    for i in range(len(xs)):
        maps, coming = coming, launched(i + 1) if i + 1 < len(xs) else None
        coarse, fine = np.asarray(maps)
        traces, multipliers, error = reversible_multipliers(fine, coarse)
        yield Spectrum(traces, multipliers, error, float(np.abs(fine - coarse).max()), expected)


__all__ = [
    "ByFrequency", "by_frequency", "checked_lattice", "energy", "energy_slope", "half_steps", "spectra_of",
    "spectrum_of", "states_of",
]
