"""Wave packets of the linear chain, and solitary waves."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import concrete, described, per_lane, positive, refuse, within
from ..base.programs import by_rows, compiled
from ..base.types import Parameter, Scalar
from ..lattice import Lattice, State
from ..profiles import medium_of, one_given, wave_of
from .places import chain_only, column, crest, inside, numbers, state_of

# the largest residual of the carrier in a uniform chain, over its omega^2, apart from rounding
UNIFORM = 1e-6


def wave_packet(
    lattice: Lattice,
    k: Parameter,
    centre: Parameter | None = None,
    width: Parameter = 10.0,
    amplitude: Parameter = 0.01,
    *,
    omega: Parameter | Callable[[Any], Any] | None = None,
    direction: str = "right",
) -> State:
    r"""Return a Gaussian packet of the linear chain that runs one way.

    u_n = a exp(-(n - n0)^2/(2 w^2)) cos(k (n - n0)). The velocities are those of sum_q U_q exp(i(q
    n - omega(q) t)) at t = 0, with omega odd in q and the chain taken as a ring. This is exact for
    the linear infinite chain of equal masses if the packet is five widths from the ends. A
    nonlinear chain sheds other waves of the order of amplitude times K3/K2.

    **Arguments:**

    - `k`: carrier wave number, in (0, pi) [rad/site].
    - `centre`: n0 [sites], `None` for a quarter of the chain from where it starts; `width`: w
      [sites], well above 1.
    - `amplitude`: a [m], small against the precompression's overlap.
    - `omega`: frequency of the wave. `None`: from the stiffness about the middle site of a uniform
      chain, with further neighbours and on-site springs. A function omega(q) >= 0 for 0 <= q <= pi.
      A number: that of the carrier, v = a omega sin(k (n - n0)) g with the envelope g, whose drift
      is neglected: an error of v_group/(omega w) runs the other way. In a chain with several sites
      per cell the packet excites all branches, because a cosine is no Bloch mode.
    - `direction`: `"right"` or `"left"`, of the phase velocity; energy runs along where d
      omega/dk > 0.

    **Raises** ValueError for a lattice that is no plain chain, arguments outside these ranges, or,
    with `omega=None`, a chain that is not uniform or has no linear stiffness.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0, boundary="periodic")
    >>> state = gx.states.wave_packet(chain, k=2.0, centre=10, width=2.0)
    >>> round(float(state.u[10]), 6)
    0.01
    """
    size = chain_only(lattice, "wave_packet")
    lanes = lattice.lanes
    k = per_lane("k", k, lanes, partial(within, low=0, high=np.pi, open_low=True, open_high=True))
    width = per_lane("width", width, lanes, positive)
    amplitude = per_lane("amplitude", amplitude, lanes)
    x = numbers(lattice) - crest(lattice, centre, direction)
    envelope = amplitude * jnp.exp(-((x / width) ** 2) / 2)
    u = envelope * jnp.cos(k * x)
    if omega is not None and not callable(omega):
        v = per_lane("omega", omega, lanes, positive) * envelope * jnp.sin(k * x)
    else:
        q = column(lattice, 2 * jnp.pi * jnp.fft.rfftfreq(size))
        frequency = (
            _local_frequency(lattice, q, k)
            if omega is None
            else _given_frequency(omega, q, u.shape[1:])
        )
        v = by_rows(jnp.fft.irfft, -1j * frequency * by_rows(jnp.fft.rfft, u, axis=0), size, axis=0)
    return state_of(lattice, u, v if direction == "right" else -v)


def solitary_wave(
    lattice: Lattice,
    centre: Parameter | None = None,
    *,
    speed: Scalar | None = None,
    amplitude: Scalar | None = None,
    energy: Scalar | None = None,
    side: str | None = None,
) -> State:
    """Return a chain in which its own solitary wave runs, exact on the lattice.

    See `gx.travelling.solitary_wave`. All beads behind the wave are displaced by its compression:
    meant for free ends, or a wall ahead.

    **Arguments:** `lattice`: a uniform chain of bonds to the next site. `centre`: contact of the
    peak, a real number, `None` for the middle, (N - 2)/2; for several waves add states that are far
    apart. Exactly one of `speed` (contacts per time, negative to the left), `amplitude`, `energy`.
    **Raises** ValueError for a centre outside the chain, and where `gx.travelling.solitary_wave`
    does.

    **Example:**

    >>> chain = gx.scenes.monomer(20, boundary="free")
    >>> state = gx.states.solitary_wave(chain, centre=9, speed=1.0)
    >>> round(float(gx.measures.strain(chain, state)[9]), 6)
    1.487359
    """
    sites = chain_only(lattice, "solitary_wave")
    one_given(speed=speed, amplitude=amplitude, energy=energy)
    centre = inside("centre", (sites - 2) / 2 if centre is None else centre, sites - 1)
    shape = wave_of(medium_of(lattice), speed, amplitude, energy, side).shape
    xi = jnp.arange(sites) - centre
    return state_of(lattice, shape.at("displacement", xi), shape.at("velocity", xi))


def _given_frequency(omega, q, lanes):
    found = omega(q)
    shape = np.shape(found)
    if len(shape) > len(q.shape[:1] + lanes) or shape and shape[0] not in (1, len(q)):
        wanted = f"a function of wave numbers {q.shape} that gives as many frequencies"
        refuse("omega", wanted, f"one that gives {described(found)}")
    return jnp.asarray(found)


def _local_frequency(lattice, q, k):
    squares, *others = _local_squares(lattice, q, k)
    carrier, wrong, rounding = map(concrete, others)
    if carrier is not None and not np.all(carrier > 0):
        remedy = "Give its contacts a precompression."
        refuse("lattice", "a linear stiffness", "none (a sonic vacuum)", remedy)
    if wrong is not None and np.any(wrong > UNIFORM * carrier + rounding):
        refuse(
            "omega",
            "the wave's frequency",
            "None",
            "This chain is not uniform, so its stiffness gives no frequency; give a number or omega(q).",
        )
    return jnp.sqrt(jnp.maximum(squares, 0))


@compiled
def _local_squares(lattice, q, k):
    zeros = lattice.zeros()
    size = zeros.shape[0]
    mass = lattice.mass + zeros
    offset = column(lattice, jnp.arange(size) - size // 2)

    def pull(x):
        return -jax.jvp(lambda u: lattice.force(jnp.zeros(()), u, zeros), (zeros,), (x,))[1]

    answer = pull(zeros.at[size // 2].set(1.0)) / mass[size // 2]
    squares = jax.lax.map(lambda q: jnp.sum(answer * jnp.cos(q * offset), 0), q.reshape(-1))
    carrier = jnp.sum(answer * jnp.cos(k * offset), 0)
    wave = (jnp.cos(k * offset) + zeros).astype(zeros.dtype)
    inner = (pull(wave) / mass - carrier * wave)[size // 4 : size - size // 4]
    # Forces round, and so do the phases k n of the wave, by their own size.
    eps = jnp.finfo(zeros.dtype).eps
    rounding = (4 + k * size / 4) * eps * jnp.abs(answer).sum(0)
    return squares, carrier, jnp.abs(inner).max(0), rounding
