"""Time-periodic orbits of damped, driven lattices by Newton's method."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import positive, refuse, whole
from ..floquet import floquet
from ..flow import Flow
from ..lattice import Lattice, State
from ..newton import Root, newton
from ..orbits import flow_over, history
from ..solvers import SRKN14a
from ..tuning import one_thread
from .shooting import Shooting

FRAMES = 32


class OrbitRun(eqx.Module):
    """One period of an orbit at equal distances, without its end: `ts` (F,), `us` and `vs` (F, N), `lattice`.

    Means over these frames are integrals over the period to the accuracy of a Fourier series.
    """

    ts: jax.Array
    us: object
    vs: object


class ForcedOrbit(eqx.Module):
    """A periodic orbit of a forced lattice; what `forced_orbit` returns.

    **Fields:** `state`: at `t0`. `period`: T. `lattice`. `root`: how Newton's method ended, its residual relative to
    the orbit's size. `flow`: steps and solver over a period.
    """

    state: State
    period: jax.Array
    lattice: Lattice
    root: Root
    flow: Flow
    t0: jax.Array

    @property
    def residual(self):
        """max |y(t0 + T) - y(t0)|, relative to the largest displacement, and to velocities of that times 2 pi/T."""
        return self.root.residual

    @property
    def converged(self):
        """Whether the residual came below the tolerance."""
        return self.root.converged

    @property
    def outcome(self):
        """What became of Newton's method, a sentence."""
        return self.root.outcome

    def run(self, frames=FRAMES):
        """The orbit in time, `OrbitRun`."""
        _, ts, ys = _history(self.flow, self.lattice, self.state, self.t0, self.period, whole("frames", frames, 2))
        return OrbitRun(ts, ys.u, ys.v)

    def harmonics(self, count=1, frames=FRAMES):
        r"""Complex Fourier amplitudes c_k of every displacement, u = Re sum_k c_k exp(2 pi i k t/T), k = 0 ... count.

        **Returns:** (count + 1, N), or a dict of such. Wants count < frames/2.
        """
        if not whole("count", count, 0) < whole("frames", frames, 2) / 2:
            refuse("count", f"fewer than half of the {frames} frames", repr(count))
        run = self.run(frames)
        k = jnp.arange(count + 1)
        weights = jnp.exp(-2j * jnp.pi * k[:, None] * run.ts / self.period) * jnp.where(k, 2, 1)[:, None] / frames
        return jax.tree.map(lambda u: jnp.tensordot(weights, u, 1), run.us)

    @property
    def amplitude(self):
        """Amplitude of every site at the frequency of the drive, |c_1|, (N,)."""
        return jax.tree.map(lambda c: jnp.abs(c[1]), self.harmonics())

    @property
    def rms_velocity(self):
        """Root mean square velocity of every site over a period, (N,)."""
        return jax.tree.map(lambda v: jnp.sqrt(jnp.mean(v * v, 0)), self.run().vs)

    @property
    def energy_input(self):
        """Energy that the drive gives in a period, which is what damping takes: -int sum v . F_damping dt [J]."""
        run, lattice = self.run(), self.lattice
        lossy = [term for term in lattice.terms if term.reads_velocity]

        def power(t, u, v):
            force = lattice.sum_forces(t, u, v, lossy)
            return -sum(jnp.sum(f * v) for f, v in zip(jax.tree.leaves(force), jax.tree.leaves(v)))

        return self.period * jnp.mean(jax.vmap(power)(run.ts, run.us, run.vs))

    def floquet(self, **keywords):
        """Multipliers and stability, from `granjax.floquet.floquet` with its keywords."""
        return floquet(self.lattice, self.state, float(self.period), t0=float(self.t0), **keywords)


@one_thread
def forced_orbit(lattice, period, guess=None, *, t0=0.0, steps=None, segments=1, transient=0, solver=SRKN14a(),
                 tolerance=1e-10, max_steps=20, throw=None):
    r"""A T-periodic orbit of a lattice under T-periodic forcing: y(t0 + T) = y(t0), by Newton's method.

    The root is isolated, since the drive sets the phase. It need not be stable, and where several orbits exist the
    guess decides. From rest Newton's first iterate is the linear response, as far as one period from rest is linear.
    Works under `jit` and `vmap` and is differentiable in the lattice and the period: in forward mode, and in reverse
    where `steps` is given.

    **Arguments:**

    - `lattice`: with `Wall` in motion, `Drive` or `Modulated` terms of period T (or T/2, T/3 ...); damping makes the
      orbit unique at small amplitude.
    - `period`: T > 0. A multiple of the drive's gives orbits after a period doubling.
    - `guess`: a `State` at t0; `None` is rest. `transient`: periods that are run from it before Newton begins; some
      1/(gamma T) of them lead to the orbit that a run would settle to.
    - `t0`: phase of the drive at which the state is taken.
    - `steps` per period; `None` takes h omega_max <= 0.3, with omega_max the highest linear frequency, which gives
      displacements to about 1e-9; scenes whose contacts open need more.
    - `segments`: of multiple shooting, for long or strongly unstable orbits. `solver`: at a fixed step.
    - `tolerance`: of the residual, relative to the amplitude (of the guess, or what a period makes of it).
    - `max_steps`: the most Jacobians. `throw`: raise where it does not converge; `None` does so outside of
      transformations.

    **Returns:** `ForcedOrbit`. **Raises** ValueError for a period that is not positive, a batch of lattices, steps
    that the segments do not divide, or a sonic vacuum without `steps`; RuntimeError where `throw` and it did not
    converge.
    """
    if not isinstance(lattice, Lattice) or lattice.lanes:
        refuse("lattice", "one Lattice", "a batch" if isinstance(lattice, Lattice) else repr(lattice),
               "For a batch use jax.vmap(lambda c: forced_orbit(c, T, throw=False), in_axes=-1).")
    period, segments = positive("period", period), whole("segments", segments, 1)
    transient = whole("transient", transient, 0)
    guess = State(lattice.zeros(), lattice.zeros()) if guess is None else checked_guess(lattice, guess)
    flow = flow_over(lattice, period, steps, solver, segments)
    t0 = jnp.asarray(t0, lattice.dtype)
    shooting, x = prepared(lattice, period, guess, flow, t0, segments, jnp.asarray(transient))
    root = newton(shooting.residual, x, (lattice, period), tolerance=tolerance, max_steps=max_steps,
                  linearise=shooting.linearise, throw=throw)
    return ForcedOrbit(shooting.state(root.x), period, lattice, root, flow, t0)


def checked_guess(lattice, guess):
    """The guess as a `State` of the lattice's type."""
    u, v = guess
    wanted = [x.shape for x in jax.tree.leaves(lattice.template())]
    for name, part in (("u", u), ("v", v)):
        got = [np.shape(x) for x in jax.tree.leaves(part)]
        if got != wanted:
            refuse(f"guess.{name}", f"shape {lattice.shape}", f"{got}")
    return jax.tree.map(lambda x: jnp.asarray(x, lattice.dtype), State(u, v))


@eqx.filter_jit
def prepared(lattice, period, guess, flow, t0, segments, transient):
    """The problem and the unknowns of the guess, neither of which is differentiated."""
    still = jax.lax.stop_gradient((lattice, period, guess))
    lattice, period, guess = still
    advance = lambda i, y: flow(y, t0, t0 + period, lattice)
    guess = jax.lax.fori_loop(0, transient, advance, guess)
    shooting = Shooting.of(lattice, period, guess, flow, t0, segments)
    return shooting, shooting.guess(guess, (lattice, period))


_history = eqx.filter_jit(history)
