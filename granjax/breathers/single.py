"""One breather at a given frequency."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import one_of, positive, refuse
from ..flow import Flow
from ..lattice import State
from ..newton import newton
from ..orbits import Shooting
from ..solvers import KahanLi8
from ..tuning import one_thread
from .branch import Breather
from .envelope import bright_guess, cell_of, dark_guess, edge_of, edges_beside, refuse_bright, supports_bright
from .family import family
from .problem import TOLERANCE, ByFrequency, checked_lattice, half_steps
from .problem import energy as energy_of
from .resonances import refuse_resonance

GUESSES = ("bright", "dark")
# share of the sites over which a state must spread (as a participation) to count as a background
FILLS = 0.4
# of the distance from the edge, where the envelope is a better guess
NEARER = (0.5, 0.2, 0.1)
# of the guess's size, below which an orbit is none; and its code, beside those of `newton`
AT_REST, FELL = 1e-6, 4


@one_thread
def breather(lattice, omega, guess=None, *, energy=None, centre=None, steps=None, solver=None, tolerance=TOLERANCE,
             max_steps=30, check=True, throw=None):
    r"""A time-reversible breather of frequency omega: v(0) = 0, v(T/2) = 0, T = 2 pi/omega.

    **Arguments:**

    - `lattice`: a conservative, autonomous `Lattice`. `omega`: [rad/s].
    - `energy`: where given, the breather of this energy, above zero, is sought from the one at omega on, and has its
      own frequency, which is then differentiable too: d omega/d parameter at constant energy.
    - `guess`: where Newton's method starts. `None`: the family from the linear mode next to omega. `"bright"`,
      `"dark"`: the envelope's soliton of a periodic chain, centred on `centre` (a site, or 3.5 for a bond; `None` the
      middle); dark with the ends that the chain has (free: constant force; walls or a ring: fixed length). A `State`,
      such as that of another breather, of `guesses.single_site`, or a simulated one, whose velocities are dropped.
    - `steps`: time steps in a period, an even number; `None` takes h omega_max = 0.3. `tolerance`: of max |v(T/2)|.
    - `check`: refuse a frequency of which a harmonic meets a band, or whose gap has no bright breathers.
    - `throw`: raise where Newton's method does not converge; `None` does so outside of transformations.

    With a `State` and `steps` it works inside `jit` and `vmap`, and its state and energy are differentiable in every
    parameter of the lattice and in omega, by the implicit function theorem.

    **Returns:** `Breather`; `throw=False` returns the best iterate. **Raises** ValueError for a frequency that has no
    such breather, with the reason; RuntimeError where Newton's method does not converge.
    """
    if isinstance(guess, str):
        one_of("guess", guess, GUESSES)
    elif guess is not None and not (isinstance(guess, tuple) and len(guess) == 2):
        refuse("guess", "None, 'bright', 'dark' or a State", f"a {type(guess).__name__}")
    traced = any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves((lattice, omega, guess, energy)))
    if not traced:
        checked_lattice(lattice)
        if not omega > 0:
            refuse("omega", "a frequency above zero", repr(omega))
        if energy is not None:
            positive("energy", energy)
        if check:
            _check(lattice, float(omega), guess)
    elif guess is None or isinstance(guess, str) or steps is None:
        refuse("guess", "a State, and steps=, under a transformation", repr(guess), "Find one outside first.")
    if guess is None:
        found = family(lattice, float(omega), stability=False, points=400, steps=steps, solver=solver)
        if "reached" not in found.outcome:
            raise RuntimeError(f"The family did not reach omega = {float(omega):.6g}: {found.outcome}")
        guess = found.breather(-1).state
    count = half_steps(lattice, 2 * np.pi / omega, steps)
    half = Shooting.half(lattice, Flow(count if traced else jnp.asarray(count), solver or KahanLi8()))
    if isinstance(guess, str):
        guess = _from_envelope(lattice, half, float(omega), guess, centre, tolerance)
    if energy is None:
        return _solve(lattice, half, State(*guess), omega, tolerance, max_steps, throw)
    if not traced:  # a step of its own to omega: the guess's energy may be far off
        guess = _solve(lattice, half, State(*guess), omega, tolerance, max_steps, throw).state
    problem, x = AtEnergy(ByFrequency(half)), jnp.append(half.guess(State(*guess)), omega)
    root = newton(problem.residual, x, (lattice, jnp.asarray(energy, float)), tolerance=tolerance,
                  max_steps=max_steps, linearise=problem.linearise, throw=throw)
    state = half.state(root.x[:-1])
    return Breather(state, root.x[-1], energy_of(lattice, state), root.residual, lattice, root.code, root.outcome)


def _from_envelope(lattice, half, omega, kind, centre, tolerance):
    """A State to start at: the envelope's soliton, or one nearer to the edge followed to omega."""
    make = dark_guess if kind == "dark" else bright_guess
    guess = make(lattice, omega, centre)
    found = _solve(lattice, half, guess, omega, tolerance, 20, False)
    if found.converged:
        return found.state
    edge = edge_of(lattice, omega, kind)
    for fraction in NEARER:
        near = edge + fraction * (omega - edge)
        found = _solve(lattice, half, make(lattice, near, centre), near, tolerance, 30, False)
        if found.converged:
            branch = family(lattice, omega, guess=found, stability=False, points=400, steps=2 * int(half.flow.steps))
            return branch.breather(-1).state
    return guess


def _solve(lattice, half, guess, omega, tolerance, max_steps, throw):
    x = half.guess(guess)
    root = newton(half.residual, x, (lattice, 2 * jnp.pi / omega), tolerance=tolerance,
                  max_steps=max_steps, linearise=half.linearise, throw=throw)
    state, code, outcome = half.state(root.x), root.code, root.outcome
    if not any(isinstance(x, jax.core.Tracer) for x in (x, root.x)) and _fell(x, root):
        code, outcome = FELL, f"The guess fell to rest, where every frequency is a period's: {root.outcome}"
        if throw is None or throw:
            raise RuntimeError(outcome)
    return Breather(state, omega, energy_of(lattice, state), root.residual, lattice, code, outcome)


def _fell(guess, root):
    """Whether Newton's method has found the equilibrium in place of an orbit."""
    return bool(root.converged) and float(jnp.abs(root.x).max()) <= AT_REST * float(jnp.abs(guess).max())


class AtEnergy(eqx.Module):
    """F(x, omega; lattice, energy) = 0: half a period from rest to rest, and the energy's relative error."""

    orbits: ByFrequency

    def _excess(self, x, scene):
        lattice, energy = scene
        state = self.orbits.half.state(x)
        return lattice.energy(0.0, state.u, state.v) / energy - 1

    def residual(self, z, scene):
        """The half period's gaps at the frequency that is the last unknown, and the energy's."""
        return jnp.append(self.orbits.residual(z[:-1], z[-1], scene[0]), self._excess(z[:-1], scene))

    def linearise(self, z, scene):
        """The residual and its derivative."""
        x = z[:-1]
        gaps, in_x, in_omega = self.orbits.linearise(x, z[-1], scene[0])
        excess, gradient = jax.value_and_grad(self._excess)(x, scene)
        return jnp.append(gaps, excess), jnp.block([[in_x, in_omega[:, None]], [gradient, jnp.zeros(1, x.dtype)]])


def _check(lattice, omega, guess):
    # a State that fills the lattice is a wave with a dip: its first harmonic is in the band by nature
    fills = isinstance(guess, tuple) and _spread(guess) > FILLS
    refuse_resonance(lattice, omega, fills or guess == "dark")
    if guess == "dark" or isinstance(guess, tuple) or cell_of(lattice) is None:
        return
    edges = edges_beside(lattice, omega)
    # a finite chain may have modes in a gap, at its ends, from which families leave too
    if edges and not any(supports_bright(edge) for edge in edges) and (guess or len(edges[0].coefficients.mode) == 1):
        refuse_bright(lattice, omega)


def _spread(guess):
    u = np.concatenate([np.ravel(x) for x in jax.tree.leaves(guess[0])])
    weight = (u - u.mean()) ** 2
    return weight.sum() ** 2 / max((weight**2).sum() * len(u), np.finfo(float).tiny)
