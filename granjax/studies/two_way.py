"""What passes a chain from the left and from the right: reciprocity, rectifiers, diodes."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..checks import positive, refuse, traced
from ..forced import forced_orbit
from ..lattice import Lattice
from ..measures import contacts
from ..orbits.driven_chain import driven_chain
from ..results import Held, Result
from ..types import Count, Parameter, Scalar

FRAMES = 64


class TwoWay(Result):
    """What `two_way` returns.

    - `amplitudes` (P,) of the driven wall, `omega` of the drive.
    - `from_left`, `from_right` (P,): amplitude, at the drive's frequency, of the force on the wall at rest while the
      left one moves, or the right one. `from_left_error`, `from_right_error` (P,): estimated distances from the truth.
    - `asymmetry` (P,): from_left/from_right - 1, zero for a linear chain; `asymmetry_error` (P,).

    **Example:**

    >>> chain = gx.scenes.monomer(4, precompression=1.0)
    >>> found = gx.studies.two_way(chain, [1e-3], 1.0, damping=0.2)
    >>> bool(abs(found.asymmetry[0]) < 1e-6)  # a chain that is its own mirror image
    True
    >>> chain.shape
    (4,)
    """

    held: ClassVar[dict[str, Held]] = {
        "amplitudes": Held("amplitudes", "m"), "omega": Held(unit="rad/s"),
        "from_left": Held("amplitudes", "N"), "from_right": Held("amplitudes", "N"),
        "from_left_error": Held("amplitudes", "N"), "from_right_error": Held("amplitudes", "N"),
        "asymmetry": Held("amplitudes", "1"), "asymmetry_error": Held("amplitudes", "1"),
    }
    amplitudes: Float[np.ndarray, " P"]
    omega: float
    from_left: Float[np.ndarray, " P"]
    from_right: Float[np.ndarray, " P"]
    from_left_error: Float[np.ndarray, " P"]
    from_right_error: Float[np.ndarray, " P"]

    @property
    def asymmetry(self) -> Float[np.ndarray, " P"]:
        """from_left/from_right - 1, (P,)."""
        return self.from_left / self.from_right - 1

    @property
    def asymmetry_error(self) -> Float[np.ndarray, " P"]:
        """Its estimated distance from the truth, (P,)."""
        return (1 + self.asymmetry) * (self.from_left_error / self.from_left + self.from_right_error / self.from_right)

    @property
    def outcome(self) -> str:
        worst = int(np.argmax(np.abs(self.asymmetry)))
        return (f"Left and right differ by up to {abs(self.asymmetry[worst]):.3g} of what passes, known to "
                f"{self.asymmetry_error[worst]:.1g}.")


def two_way(
    lattice: Lattice, amplitudes: Parameter, omega: Scalar, *, damping: Parameter | None = None,
    field: str | None = None, steps: Count | None = None,
) -> TwoWay:
    r"""What a chain lets through, driven at its left wall, and at its right one: the periodic orbits of either drive.

    w(t) = a cos(omega t) at one wall; the number is the amplitude at omega of the force on the other, which is at
    rest. A linear chain, whatever its masses, stiffnesses and dampings, gives the same both ways (the matrix
    K - omega^2 M + i omega C is symmetric), and a nonlinear one does up to O(a^2): what differs beyond is
    rectification. The orbits are followed over the amplitudes, stable or not (`gx.forced.forced_branch` tells).

    **Arguments:** `lattice`: a chain between fixed walls. `amplitudes` (P,): ascending [m]. `omega` of the drive
    [rad/s]. `damping`: gamma [1/s] of every site, a number or (N,), beside what the lattice has. `field`: the one that
    the walls touch, where a cell holds several. `steps`: per period, as in `forced_orbit`.

    **Returns:** `TwoWay`; its picture is `gx.plots.two_way`. **Raises** ValueError as `driven_chain` does, for
    amplitudes that do not ascend from above zero, or a batch of lattices; RuntimeError where an orbit is not found. Not
    under a transformation: it continues from orbit to orbit.
    Typical: 1e-5 ... 1e-2 of the static overlap. Source: Rayleigh, The Theory of Sound, section 107 (reciprocity);
    Boechler, Theocharis, Daraio, Nature Materials 10, 665 (2011) (its end).

    **Example:**

    >>> chain = gx.scenes.monomer(4, precompression=1.0)
    >>> found = gx.studies.two_way(chain, [1e-3], 1.0, damping=0.2)
    >>> bool(abs(found.from_left / found.from_right - 1).max() < 1e-6)  # its own mirror image
    True
    >>> chain.shape
    (4,)
    """
    if traced((lattice, amplitudes, omega)):
        refuse("lattice", "numbers known before tracing", "traced ones", "Differentiate gx.forced.forced_orbit.")
    amplitudes, omega = np.atleast_1d(np.asarray(positive("amplitudes", amplitudes), float)), positive("omega", omega)
    if amplitudes.ndim != 1 or not (np.diff(amplitudes) > 0).all():
        refuse("amplitudes", "ascending numbers above zero", f"shape {amplitudes.shape}")
    still = driven_chain(lattice, 0.0, omega, damping=damping, field=field)
    period = 2 * np.pi / float(omega)
    ways = np.array([_one_way(still, moves, amplitudes, period, steps) for moves in (0, 1)])
    (left, left_error), (right, right_error) = ways
    return TwoWay(amplitudes, float(omega), left, right, left_error, right_error, **lattice.origin)


def _one_way(still, moves, amplitudes, period, steps):
    """Amplitudes of the force on the wall that does not move, and their errors: (2, P)."""
    found, guess = [], None
    for amplitude in amplitudes:
        shaken = [jnp.asarray(amplitude if i == moves else 0.0, still.dtype) for i in (0, 1)]
        lattice = eqx.tree_at(lambda c: [wall.motion.amplitude for wall in c.terms[-2:]], still, shaken)
        orbit = forced_orbit(lattice, period, guess, steps=steps)
        guess, run = orbit.state, orbit.run(FRAMES)
        # what the state is known to, along the force's slope
        found.append(_force(lattice, run.us, run.vs, run.ts, orbit.error.state.u, 1 - moves))
    return np.array(found).T


@eqx.filter_jit
def _force(lattice, us, vs, ts, error, wall):
    """Amplitude at the drive's frequency of the force on a wall, beyond the static one, and its error."""
    def force(u, v, t):
        return jnp.stack([c.law.force(c.compression)[0] for c in contacts(lattice, (u, v), t)[-2:]])[wall]

    f = jax.vmap(force)(us, vs, ts)
    turns = jnp.exp(-2j * jnp.pi * jnp.arange(FRAMES) / FRAMES)
    _, change = jax.jvp(lambda u: force(u, jax.tree.map(jnp.zeros_like, u), ts[0]),
                        (jax.tree.map(jnp.zeros_like, error),), (error,))
    return 2 * jnp.abs(jnp.mean(f * turns)), jnp.abs(change)
