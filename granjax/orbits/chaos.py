"""Chaos: Lyapunov exponents, alignment indices, frequencies and averages."""

import dataclasses
from functools import partial
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from ..base.arrays import trailing
from ..base.checks import parameter, positive, refuse, whole
from ..base.printing import told
from ..base.programs import compiled
from ..base.types import Count, Numbers, Parameter, Scalar, StateLike
from ..flow.stepping import columns, matrix
from ..lattice import Lattice, State
from ..measures.transport import birkhoff
from ..results import Held, Result, array, hidden, part
from .asked import asked
from .attractors import slowly

__all__ = ["Frequency", "Gali", "Lyapunov", "birkhoff", "frequency", "gali", "lyapunov"]

# Parts of a run; the spread of their exponents gives the uncertainty.
WINDOWS = 10
# The rounding of a growth over one period, in units of the last place.
ROUNDING = 4


class Lyapunov(Result):
    """The result of `lyapunov`."""

    exponents: Float[np.ndarray, " exponent"] = array("The exponents, the largest first.", "1/s")
    uncertainty: Float[np.ndarray, " exponent"] = array(
        "The standard error of the mean over tenths of the run, plus the difference between both "
        "halves of the run; ln(P)/(P T) for exponents between 0 and that, if it is more. Where "
        "none exceeds these, plus the change of the last tenth with twice as many steps.",
        "1/s",
    )
    rates: Float[np.ndarray, "run exponent"] = array("The growth rate over each interval.", "1/s")
    state: State = part("The state at the end.", "site")
    forced: bool = hidden("Whether the lattice depends on time.", static=True)
    near: str = hidden(
        "A sentence on an orbit that is near, or that the motion is on.", static=True
    )
    exported: ClassVar[dict[str, Held]] = {
        "verdict": Held(
            doc='"chaotic", "unstable" (a regular motion), "periodic", '
            '"quasi-periodic", "regular", "at rest", "not finite", or "undecided" (the exponent is '
            "zero within its uncertainty and a stable orbit is near)."
        )
    }

    @property
    def verdict(self) -> str:
        """The motion according to the largest exponent, one or two words."""
        if not np.isfinite(self.exponents).all():
            return "not finite"
        if self.exponents[0] > self.uncertainty[0]:
            return "chaotic" if self.chaotic else "unstable"
        if self.exponents[0] < -self.uncertainty[0]:
            return "periodic" if self.forced else "at rest"
        if not self.forced:
            return "regular"
        return "undecided" if self.near else "quasi-periodic"

    @property
    def outcome(self) -> str:
        """The motion according to the largest exponent, in one sentence."""
        verdict = self.verdict
        if verdict == "not finite":
            return "The state ceased to be finite: take more steps per period."
        edge = ", or periodic at the edge of stability" * (verdict == "quasi-periodic")
        value = f"the largest exponent is {self.exponents[0]:.3g} +- {self.uncertainty[0]:.1g}"
        zero = ", zero within that" * (verdict in ("regular", "quasi-periodic", "undecided"))
        return f"{verdict.capitalize()}{edge}: {value}{zero}. {self.near}".strip()

    @property
    def chaotic(self) -> bool:
        """Whether the largest exponent exceeds its uncertainty, and the motion is not regular."""
        return bool(self.exponents[0] > self.uncertainty[0]) and not self.near


def lyapunov(
    lattice: Lattice,
    state: StateLike,
    period: Scalar,
    *,
    periods: Count = 1000,
    transient: Count = 100,
    number: Count = 1,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
    seed: Count = 0,
) -> Lyapunov:
    r"""Compute the k largest Lyapunov exponents: mean growth rates of tangents.

    The tangents are orthonormalised every period. With Q_0 random and Phi_i the derivative of the
    flow over period i,

    Phi_i Q_i = Q_{i+1} R_i,  lambda_j = (1/(P T)) sum_i ln (R_i)_jj.

    Displacements are multiplied by the step rate: both halves of a tangent have similar size.

    Exact relations: damping gamma of all sites makes the exponents pair, lambda_j + lambda_{2N+1-j}
    = -gamma, and the whole spectrum sum to -gamma N. An autonomous lattice has one zero exponent
    along the orbit unless it is at rest.

    **Arguments:**

    - `lattice`, `state` at t = 0; forced or not. `period`: T of the forcing; for an autonomous
      lattice any time between two orthonormalisations, short compared with 1/lambda.
    - `periods`: the number P that counts, at least 10; `transient`: periods before that, in which
      state and tangents settle.
    - `number`: k, from 1 to twice the number of displacements.
    - `steps`, `solver`: as in `settle`. `seed`: for the first tangents.

    **Returns:** `Lyapunov`. **Raises** ValueError for numbers that do not fit, a period after which
    the forces do not repeat, or a batch of lattices.

    Exponents below ln(P)/(P T) are not told from zero: nearby orbits of an integrable lattice
    separate linearly.
    Source: Benettin, Galgani, Giorgilli, Strelcyn, Meccanica 15, 9 (1980); pairing: Dressler, Phys.
    Rev. A 38, 2103 (1988).

    **Example:**

    >>> chain = gx.driven.driven_chain(gx.scenes.monomer(3, precompression=1.0), 0.01, 0.5, damping=0.5)
    >>> rest = gx.states.rest(chain)
    >>> found = gx.chaos.lyapunov(chain, rest, 4 * np.pi, periods=40, transient=10, number=6, steps=64)
    >>> found.verdict, round(float(found.exponents.sum()), 4)  # -3 gamma
    ('periodic', -1.5)
    """
    state, period, flow, start = _begun(lattice, state, period, number, steps, solver, seed)
    periods = whole("periods", periods, WINDOWS)
    transient = whole("transient", transient, 0)
    tenth = periods // WINDOWS
    end, (logs, _, squares) = _grow(flow, lattice, state, start, period, transient + periods, tenth)
    rates = np.asarray(logs)[transient:] / period
    finer = slice(-2 * tenth, -tenth)
    change = np.abs(rates[finer].mean(0) - rates[-tenth:].mean(0))
    rates = np.delete(rates, finer, 0)
    order = np.argsort(-rates.mean(0), kind="stable")
    rates = rates[:, order]
    exponents = rates.mean(0)
    uncertainty = _uncertainty(rates)
    linear = np.log(periods) / (periods * float(period))
    sheared = (exponents > 0) & (exponents < linear)
    uncertainty = np.where(sheared, np.maximum(uncertainty, linear), uncertainty)
    # With other steps a chaotic orbit becomes another one, and the change is as large as the spread
    # of the tenths.
    if not exponents[0] > uncertainty[0]:
        uncertainty += change[order]
    rounding = ROUNDING * np.finfo(rates.dtype).eps * (np.abs(exponents) + 1 / period)
    uncertainty = np.maximum(uncertainty, rounding)
    found = Lyapunov(exponents, uncertainty, rates, end, lattice.reads_time, "", **lattice.origin)
    if found.verdict == "quasi-periodic":
        near = slowly(lattice, flow, end, period)
        found = dataclasses.replace(found, near=near)
    elif found.chaotic and _regular(np.delete(squares[transient:], finer, 0)):
        near = "The motion itself is regular: it is on an unstable orbit."
        found = dataclasses.replace(found, near=near)
    return found


def _regular(squares):
    # Whether a motion is at rest, periodic or quasi-periodic: averages of the squared velocities and
    # accelerations over both halves agree to half of the digits. A site that a symmetry holds has
    # rounding alone, which may have grown by an eighth power of its unit.
    motion = birkhoff(np.repeat(squares, 2, 0))
    eps = np.finfo(squares.dtype).eps
    return np.all(motion.error <= np.sqrt(eps) * motion.value + eps**1.5 * motion.value.max())


def _begun(lattice, state, period, number, steps, solver, seed):
    state, period, flow = asked(lattice, state, period, steps, solver)
    size = ravel_pytree(state)[0].size
    number = whole("number", number, 1)
    if number > size:
        refuse("number", f"1 to {size}, twice the number of displacements", f"{number}")
    start = np.random.default_rng(whole("seed", seed)).normal(size=(size, number))
    return state, period, flow, jnp.asarray(start, lattice.dtype)


@compiled
def _grow(flow, lattice, state, start, period, periods, finer=0):
    # Returns the state at the end, and for each period the logarithms by which the volumes and the
    # lengths of the tangents grew. The last `finer` periods are run twice from the same state and
    # tangents, first with twice as many steps. One loop runs them all, so that it compiles once.
    first = periods - finer
    period = jnp.asarray(period, start.dtype)
    rate = jax.tree.map(lambda x: jnp.full(x.shape, flow.steps / period), state.u)
    rate = ravel_pytree(rate)[0]
    one = jnp.ones(ravel_pytree(state.v)[0].size)
    weight = jnp.concatenate([rate, one]).astype(start.dtype)[:, None]

    def grown(carry, i):
        now, kept = carry
        kept = jax.tree.map(partial(jnp.where, i == first), now, kept)
        y, Q, C = jax.tree.map(partial(jnp.where, i == periods), kept, now)
        factor = jnp.where((first <= i) & (i < periods), 2, 1)
        run = dataclasses.replace(flow, steps=factor * flow.steps)
        y, tangents = run.tangents(y, columns(y, Q / weight), 0.0, period, lattice)
        Q, R = jnp.linalg.qr(weight * matrix(tangents))
        # The tangents themselves are Q C, each of length 1.
        C = R @ C
        lengths = jnp.linalg.norm(C, axis=0)
        logs = jnp.log(jnp.abs(jnp.diagonal(R))), jnp.log(lengths)
        # The velocities alone are rounding where a period ends at a turning point.
        parts = y.v, jax.tree.map(lambda a: period / (2 * np.pi) * a, lattice.acceleration(0.0, *y))
        squares = sum(jnp.square(ravel_pytree(x)[0]) for x in parts)
        return ((y, Q, C / lengths), kept), (*logs, squares)

    begin = state, jnp.linalg.qr(start)[0], jnp.eye(start.shape[1], dtype=start.dtype)
    ((state, _, _), _), logs = jax.lax.scan(grown, (begin, begin), jnp.arange(periods + finer))
    return state, logs


def _uncertainty(rates):
    means = np.stack([part.mean(0) for part in np.array_split(rates, WINDOWS)])
    half = len(rates) // 2
    return means.std(0, ddof=1) / np.sqrt(WINDOWS) + np.abs(
        rates[:half].mean(0) - rates[half:].mean(0)
    )


class Gali(Result):
    """The result of `gali`."""

    t: Float[np.ndarray, " t"] = array("The ends of the periods.", "s", name="t")
    order: Float[np.ndarray, " order"] = array("The number k of tangents.", name="order")
    log_gali: Float[np.ndarray, "t order"] = array("The natural logarithm of GALI_k.")
    state: State = part("The state at the end.", "site")

    @property
    def outcome(self) -> str:
        """The first and the last index at the end."""
        ends = [f"GALI_{self.order[i]:.0f} = exp({self.log_gali[-1, i]:.4g})" for i in (0, -1)]
        return f"After {len(self.t)} periods {' and '.join(dict.fromkeys(ends))}."


def gali(
    lattice: Lattice,
    state: StateLike,
    period: Scalar,
    *,
    number: Count = 2,
    periods: Count = 1000,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
    seed: Count = 0,
) -> Gali:
    r"""Compute generalised alignment indices GALI_k = |w_1 ^ ... ^ w_k|, k = 2 ... K.

    They are volumes that k unit tangents span. On a torus of s dimensions of a lattice of N
    displacements GALI_k stays level for k <= s and falls like a power beyond, t^-2(k-N) for s = N.
    Along a chaotic orbit it falls like exp(-[(l_1 - l_2) + ... + (l_1 - l_k)] t) with the Lyapunov
    exponents l. Its logarithm is computed, so that it does not end at rounding.

    **Arguments:** as for `lyapunov`; `number`: K, from 2 to twice the number of displacements. The
    index is 1 at the start. **Returns:** `Gali`. **Raises** ValueError as `lyapunov`, and for fewer
    than two tangents.
    Source: Skokos, Bountis, Antonopoulos, Physica D 231, 30 (2007).

    **Example:**

    >>> chain = gx.scenes.fput(4, alpha=0.0, beta=1.0)
    >>> found = gx.chaos.gali(chain, gx.states.sine_mode(chain, 1, 0.5), 1.0, number=4, periods=20)
    >>> found.log_gali.shape, found.order.tolist()
    ((20, 3), [2.0, 3.0, 4.0])
    """
    whole("number", number, 2, "One tangent spans no volume; its growth is lyapunov's.")
    state, period, flow, start = _begun(lattice, state, period, number, steps, solver, seed)
    end, logs = _grow(flow, lattice, state, start, period, whole("periods", periods, 1))
    volume, lengths = (np.cumsum(np.cumsum(np.asarray(x), 0), 1) for x in logs[:2])
    t = period * np.arange(1, periods + 1)
    order = np.arange(2.0, number + 1)
    return Gali(t, order, (volume - lengths)[:, 1:], end, **lattice.origin)


class Frequency(NamedTuple):
    """The strongest frequency of a signal [rad/s].

    `amplitude`: that of this frequency. `drift`: the change of the frequency over half of the time.
    A constant has the amplitude 0, and NaN for the others.
    """

    omega: Numbers
    amplitude: Numbers
    drift: Numbers
    __repr__ = told


# Steps of Newton's method on the power, from the largest line of the transform.
REFINEMENTS = 12
# Points of the transform per line, by zeros behind the signal. With one, a line halfway between two
# points would lose 15 % of its amplitude, with 8 at most 0.25 %.
PADDING = 8
# A half of a signal takes a line other than the found one only if that is so many times as large:
# lines that a half does not resolve beat, and a line that moved far is not near the found one.
FAVOUR = 2


def frequency(q: Parameter, dt: Scalar) -> Frequency:
    """Return the strongest frequency of a real signal by Laskar's method.

    Its power under a Hann window is the largest within 0.5 %. For a quasi-periodic signal over time
    T its error is about T^-4. With fewer than two cycles, or within two lines (2 pi/T) of pi/dt,
    the error is up to a line. The drift, its change between both halves, is rounding for regular
    motion. Many initial states, in lanes, give a frequency map.

    **Arguments:** `q`: (T,) and trailing axes, frames equally spaced by `dt`. **Raises** ValueError
    for fewer than 16.
    Source: J. Laskar, Icarus 88, 266 (1990).

    **Example:**

    >>> t = 0.1 * np.arange(2000)
    >>> found = gx.chaos.frequency(np.cos(1.2345 * t) + 0.3 * np.cos(2.7 * t), 0.1)
    >>> round(float(found.omega), 6), round(float(found.amplitude), 4)
    (1.2345, 1.0)
    """
    q = parameter("q", q)
    dt = positive("dt", dt)
    if q.ndim == 0 or len(q) < 16:
        refuse("q", "a history of at least 16 frames", f"shape {q.shape}")
    half = len(q) // 2
    omega, amplitude = _strongest(q, dt, jnp.nan)
    (first, _), (second, _) = (_strongest(part, dt, omega) for part in (q[:half], q[-half:]))
    return Frequency(omega, amplitude, second - first)


@jax.jit
def _strongest(q, dt, near):
    size = len(q)
    along = lambda x: trailing(x, q.ndim)
    window = along(1 - jnp.cos(2 * jnp.pi * (jnp.arange(size) + 0.5) / size)) / size
    # The mean under the window is removed, so that none of it leaks.
    signal = window * (q - jnp.sum(window * q, 0))
    t = along(dt * (jnp.arange(size) - (size - 1) / 2))
    lines = jnp.fft.rfft(signal, PADDING * size, axis=0)
    width = 2 * jnp.pi / (size * dt)
    omegas = along(width / PADDING * jnp.arange(len(lines)))
    favour = jnp.where(jnp.abs(omegas - near) < 2 * width, FAVOUR, 1)
    start = width / PADDING * jnp.maximum(jnp.argmax(favour * jnp.abs(lines), 0), PADDING)

    def closer(_, omega):
        turned = signal * jnp.exp(-1j * omega * t)
        A, A1, A2 = (jnp.sum(turned * (-1j * t) ** k, 0) for k in range(3))
        # Derivatives of the logarithm of the power, which is concave over the whole line.
        slope = jnp.real(A1 / A)
        bend = jnp.real(A2 / A - (A1 / A) ** 2)
        step = -slope / jnp.where(bend < 0, bend, -jnp.inf)
        return jnp.clip(omega + step, start - width, start + width)

    omega = jax.lax.fori_loop(0, REFINEMENTS, closer, start)
    # At pi/dt, within rounding, the line is its own mirror image.
    alone = jnp.abs(omega * dt - jnp.pi) < 8 * jnp.finfo(omega.dtype).eps
    images = jnp.where(alone, 1, 2)
    amplitude = images * jnp.abs(jnp.sum(signal * jnp.exp(-1j * omega * t), 0))
    # A constant has no frequency.
    moves = jnp.any(q != q[0], 0)
    return jnp.where(moves, omega, jnp.nan), jnp.where(moves, amplitude, 0)
