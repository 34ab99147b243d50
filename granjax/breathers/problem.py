"""Breathers of conservative lattices as roots, and what is computed at each: energy, step error, multipliers."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..checks import refuse
from ..floquet import reversible_multipliers, structure
from ..flow import Flow, linear_frequency
from ..lattice import Lattice
from ..orbits import HalfPeriod
from ..solvers import KahanLi8

# h omega_max of a step, the error of half a period that is let pass, and how often the steps are doubled for it
FINE, LET_PASS, DOUBLINGS = 0.3, 1e-8, 5
TOLERANCE = 1e-11


class ByFrequency(eqx.Module):
    """F(x, omega; lattice) = 0: half a period from rest to rest, for Newton's method and for continuation."""

    half: HalfPeriod

    def residual(self, x, omega, lattice):
        """The half period's gaps at a frequency."""
        return self.half.residual(x, (lattice, 2 * jnp.pi / omega))

    def linearise(self, x, omega, lattice):
        """Gaps and their derivative in x."""
        return self.half.linearise(x, (lattice, 2 * jnp.pi / omega))


def checked_lattice(lattice):
    """A lattice that has time-reversible, isolated families: single, conservative, autonomous."""
    if not isinstance(lattice, Lattice):
        refuse("chain", "a Lattice", f"a {type(lattice).__name__}")
    if lattice.lanes:
        remedy = "Use jax.vmap(function, in_axes=-1)(chain) for gx.breathers.breather with a seed."
        refuse("chain", "one lattice", f"a batch with lanes {lattice.lanes}", remedy)
    timeless = all(term.conserves and not term.reads_velocity for term in lattice.terms)
    if not timeless:
        names = ", ".join(type(t).__name__ for t in lattice.terms if not t.conserves or t.reads_velocity)
        remedy = "Orbits of damped or driven chains: gx.forced.forced_orbit."
        refuse("chain", "forces that depend on positions alone", names, remedy)
    return lattice


def half_steps(lattice, period):
    """Steps of half a period for which h omega_max is at most `FINE`, with omega_max that of small motion."""
    omega = float(linear_frequency(lattice))
    return max(int(np.ceil(period / 2 * omega / FINE)), 8)


def by_frequency(lattice, steps, solver=None):
    """The root problem with a number of steps that may change without compiling anew."""
    return ByFrequency(HalfPeriod.of(lattice, Flow(jnp.asarray(steps), solver or KahanLi8())))


@eqx.filter_jit
def energy(lattice, state):
    """Energy from equilibrium."""
    return lattice.energy(0.0, state.u, state.v)


@eqx.filter_jit
def energy_slope(problem, lattice, x, tangent):
    """dE/ds along a tangent (x, omega) of a branch."""
    total = lambda x: (lambda y: lattice.energy(0.0, y.u, y.v))(problem.half.state(x))
    return jax.jvp(total, (x,), (tangent[:-1],))[1]


@eqx.filter_jit
def _half_maps(flow, x, half, omega, lattice):
    """Tangent maps over half a period by `flow` and by twice its steps, in (u, m v)."""
    y = half.state(x)
    mass = ravel_pytree(jax.tree.map(lambda m, u: m + jnp.zeros_like(u), lattice.mass, y.u))[0]
    weight = jnp.concatenate([jnp.ones_like(mass), mass])
    maps = []
    for factor in (1, 2):
        finer = Flow(flow.steps * factor, flow.solver, flow.field)
        end, map_ = finer.derivative(y, 0.0, jnp.pi / omega, lattice)
        maps.append(map_ * weight[:, None] / weight)
    return *maps, end


class Spectrum(eqx.Module):
    """Half-traces (n,), multipliers (2n,) and their errors, the error of a step, the symmetries' multipliers."""

    half_traces: np.ndarray
    multipliers: np.ndarray
    error: np.ndarray
    step_error: float
    expected: int


def spectrum_of(problem, lattice, x, omega):
    """Multipliers of the orbit x, from half a period, with twice the steps of the problem and its own for the error."""
    coarse, fine, _ = _half_maps(problem.half.flow, jnp.asarray(x), problem.half, omega, lattice)
    coarse, fine = np.asarray(coarse), np.asarray(fine)
    traces, multipliers, error = reversible_multipliers(fine, coarse)
    expected = 2 + 2 * problem.half.moves.shape[1]
    return Spectrum(traces, multipliers, error, float(np.abs(fine - coarse).max()), expected)


__all__ = ["ByFrequency", "by_frequency", "checked_lattice", "energy", "energy_slope", "half_steps", "spectrum_of",
           "structure"]
