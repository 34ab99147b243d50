"""Switches and logic gates: signals on one wall of a chain, and what comes out at its other end."""

import itertools
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Integer

from ..checks import non_negative, one_of, positive, refuse, traced
from ..driven import driven_chain
from ..flow import Integral, simulate
from ..lattice import Lattice, State
from ..orbits import repeats
from ..orbits.attractors import steps_per_period
from ..orbits.driven_chain import SIDES
from ..results import Held, Result
from ..states import places
from ..types import AnyArray, Number, Numbers, Parameter, Scalar, StateLike

# lanes of a run: any number of signals and controls is one program
LANES = 8
GATES = {"OR": lambda row: any(row), "AND": lambda row: all(row), "XOR": lambda row: sum(row) % 2 == 1}


class _Signals(eqx.Module):
    """w(t) = sum_k a_k sin(omega_k t): `amplitudes` (K,), then lanes; `omegas` (K,)."""

    amplitudes: AnyArray
    omegas: AnyArray

    def __call__(self, t):
        return jnp.sum(self.amplitudes * jnp.sin(self.omegas * t), 0)


class TruthTable(Result):
    """What `truth_table` returns.

    - `inputs` (rows, K): which signals are on, 0 or 1. `output` (rows,): root mean square velocity of the site that is
      watched [m/s]. `output_error` (rows,): estimated distance from the truth.
    - `amplitudes`, `omegas` (K,) of the signals.

    **Example:**

    >>> chain = gx.scenes.monomer(6, precompression=1.0)
    >>> found = gx.studies.truth_table(chain, [0.01, 0.01], [0.5, 1.0], damping=0.2, settling=20.0, watch=20.0)
    >>> found.inputs.tolist()
    [[0, 0], [0, 1], [1, 0], [1, 1]]
    """

    held: ClassVar[dict[str, Held]] = {
        "inputs": Held("row signal"), "output": Held("row", "m/s"), "output_error": Held("row", "m/s"),
        "amplitudes": Held("signal", "m"), "omegas": Held("signal", "rad/s"),
    }
    inputs: Integer[np.ndarray, "rows K"]
    output: Float[np.ndarray, " rows"]
    output_error: Float[np.ndarray, " rows"]
    amplitudes: Float[np.ndarray, " K"]
    omegas: Float[np.ndarray, " K"]

    def thresholds(self, gate: str) -> tuple[float, float] | None:
        """Between which outputs [m/s] a threshold makes it an `"OR"`, `"AND"` or `"XOR"`, errors off; or `None`."""
        true = np.array([GATES[one_of("gate", gate, tuple(GATES))](row) for row in self.inputs.tolist()])
        low = float((self.output + self.output_error)[~true].max())
        high = float((self.output - self.output_error)[true].min())
        return (low, high) if low < high else None

    def table(self, threshold: Scalar) -> Integer[np.ndarray, " rows"]:
        """The gate's output, 0 or 1, (rows,). **Raises** ValueError for a threshold within the error of an output."""
        threshold = float(positive("threshold", threshold))
        if (np.abs(self.output - threshold) <= self.output_error).any():
            refuse("threshold", "one that no output may equal", f"{threshold:.6g}",
                   "Ask thresholds(gate) for its range.")
        return (self.output > threshold).astype(int)

    @property
    def outcome(self) -> str:
        """As which gates it serves, a sentence."""
        found = {gate: self.thresholds(gate) for gate in GATES}
        said = [f"{gate} for a threshold between {' and '.join(self._told('output', one) for one in x)}"
                for gate, x in found.items() if x]
        return f"{', '.join(said)}." if said else "No threshold makes it an OR, an AND or a XOR."


class Switch(Result):
    """What `switch` returns.

    - `amplitudes` (P,) of the control [m]. `output` (P,): root mean square velocity [m/s] of the site that is watched,
      with signal and control; `alone` (P,): with the control alone. `output_error`, `alone_error` (P,).
    - `contrast`: the largest output is at least so many times the least, errors off.
    - `threshold`: control [m] at which the output first passes half of its largest, `threshold_error` [m]: half of the
      way between the controls, of those that were run, where it is below and above for certain. NaN where there are
      none.

    **Example:**

    >>> chain = gx.scenes.monomer(6, precompression=1.0)
    >>> found = gx.studies.switch(chain, (0.01, 0.5), [0.01, 0.02], 1.0, damping=0.2, settling=20.0, watch=20.0)
    >>> found.output.shape, found.alone.shape
    ((2,), (2,))
    """

    held: ClassVar[dict[str, Held]] = {
        "amplitudes": Held("amplitudes", "m"), "output": Held("amplitudes", "m/s"),
        "output_error": Held("amplitudes", "m/s"), "alone": Held("amplitudes", "m/s"),
        "alone_error": Held("amplitudes", "m/s"), "contrast": Held(unit="1"), "threshold": Held(unit="m"),
        "threshold_error": Held(unit="m"),
    }
    amplitudes: Float[np.ndarray, " P"]
    output: Float[np.ndarray, " P"]
    output_error: Float[np.ndarray, " P"]
    alone: Float[np.ndarray, " P"]
    alone_error: Float[np.ndarray, " P"]

    @property
    def contrast(self) -> float:
        """By how many times the largest output exceeds the least, at least."""
        return float((self.output - self.output_error).max() / (self.output + self.output_error).min())

    @property
    def threshold(self) -> float:
        """Control at which the output passes half of its largest [m]."""
        return float(np.mean(self._bracket))

    @property
    def threshold_error(self) -> float:
        """Half of the way between the controls about the threshold [m]."""
        return float(np.diff(self._bracket)[0] / 2)

    @property
    def _bracket(self):
        """The last control at which the output is below half of its largest for certain, the first that is above."""
        top = int(np.argmax(self.output))
        half, error = self.output[top] / 2, self.output_error[top] / 2
        above = int(np.argmax(self.output - self.output_error > half + error))
        below = np.flatnonzero(self.output[:above] + self.output_error[:above] < half - error)
        return self.amplitudes[[below[-1], above]] if len(below) else np.full(2, np.nan)

    @property
    def outcome(self) -> str:
        """What was found, a sentence."""
        if not self.contrast > 1:
            return "It does not switch: the output changes by no more than its error."
        said = f"The control raises the output at least {self.contrast:.4g} times"
        if np.isnan(self.threshold):
            return f"{said}; from the first on it is not below half of the largest."
        between = " and ".join(self._told("amplitudes", x) for x in self._bracket)
        return f"{said}; it passes half of the largest between {between}."


def truth_table(
    lattice: Lattice, amplitudes: Parameter, omegas: Parameter, *, end: str = "left", site: int | None = None,
    damping: Parameter | None = None, settling: Scalar, watch: Scalar,
) -> TruthTable:
    r"""Output of a chain for every combination of signals on one wall: a logic gate with a threshold.

    w(t) = sum of a_k sin(omega_k t) over the signals that are on; the output is the root mean square velocity of one
    site after the start has died out. All 2^K combinations are lanes of one run. Signals in the band pass each by
    itself: an OR. Of two in the gap neither does, but their difference in frequency, which the contacts make, may lie
    in the band: an AND. A chain whose contacts make both serves as either, by its threshold.

    **Arguments:** `lattice`: a chain between fixed walls. `amplitudes`, `omegas` (K,): [m], [rad/s], of 1 to 6
    signals. `end`: the wall that moves; `site`: the one that is watched, by default the last from there. `damping`:
    gamma [1/s] of every site, beside what the lattice has. `settling`, `watch`: times [s] before and while the output
    is taken, some 10/gamma, and many beats of the signals.

    **Returns:** `TruthTable` (`gx.plots.truth_table`); its errors are what half the step changes, and by how much the
    halves of `watch` differ.
    **Raises** ValueError as `driven_chain` does, for another number of frequencies than amplitudes, a batch, or numbers
    that are not above zero. For derivatives, `gx.simulate` the chain of `gx.driven.driven_chain`.
    Source: Li, Anzel, Yang, Kevrekidis, Daraio, Nature Communications 5, 5311 (2014).

    **Example:**

    >>> chain = gx.scenes.monomer(6, precompression=1.0)
    >>> found = gx.studies.truth_table(chain, [0.01, 0.01], [0.5, 1.0], damping=0.2, settling=20.0, watch=20.0)
    >>> bool(found.output[0] < found.output[1:].min())  # silent where no signal is on
    True
    """
    amplitudes = np.atleast_1d(np.asarray(_known("amplitudes", amplitudes, positive), float))
    if amplitudes.ndim != 1 or not 1 <= len(amplitudes) <= 6:
        refuse("amplitudes", "one number for each of 1 to 6 signals", f"shape {amplitudes.shape}")
    inputs = np.array(list(itertools.product((0, 1), repeat=len(amplitudes))))
    output, error, omegas = _outputs(lattice, inputs * amplitudes, omegas, end, site, damping, settling, watch)
    return TruthTable(inputs, output, error, amplitudes, omegas, **lattice.origin)


def switch(
    lattice: Lattice, signal: tuple[Scalar, Scalar], amplitudes: Parameter, omega: Scalar, *, end: str = "left",
    site: int | None = None, damping: Parameter | None = None, settling: Scalar, watch: Scalar,
) -> Switch:
    r"""Output of a chain against the amplitude of a control beside the signal: an acoustic switch.

    A signal in the gap does not pass; with a control beside it their difference in frequency does, which the contacts
    make of both. The output with the control alone shows that it is the signal that is switched.

    **Arguments:** `signal`: its amplitude [m] and angular frequency [rad/s]. `amplitudes` (P,): of the control,
    ascending, P >= 2 [m]; `omega`: its angular frequency. Others, errors and source as in `truth_table`.

    **Returns:** `Switch`; its picture is `gx.plots.switch`. **Raises** ValueError as `truth_table` does.

    **Example:**

    >>> chain = gx.scenes.monomer(6, precompression=1.0)
    >>> found = gx.studies.switch(chain, (0.01, 0.5), [0.01, 0.02], 1.0, damping=0.2, settling=20.0, watch=20.0)
    >>> bool(found.output[1] > found.output[0])
    True
    """
    own = [float(_known(f"signal[{i}]", x, positive)) for i, x in enumerate(signal)]
    amplitudes = np.asarray(_known("amplitudes", amplitudes, non_negative), float)
    if amplitudes.ndim != 1 or len(amplitudes) < 2 or not (np.diff(amplitudes) > 0).all():
        refuse("amplitudes", "at least two, ascending", f"shape {amplitudes.shape}")
    lanes = np.stack([np.repeat([own[0], 0.0], len(amplitudes)), np.tile(amplitudes, 2)], 1)
    omegas = [own[1], float(_known("omega", omega, positive))]
    output, error, _ = _outputs(lattice, lanes, omegas, end, site, damping, settling, watch)
    parts = [x for pair in zip(np.split(output, 2), np.split(error, 2)) for x in pair]
    return Switch(amplitudes, *parts, **lattice.origin)


def _known(name, x, check: Callable):
    if traced(x):
        refuse(name, "numbers known before tracing", "traced ones", "A study runs outside of transformations.")
    return check(name, x)


def _outputs(lattice, amplitudes, omegas, end, site, damping, settling, watch):
    """Root mean square velocities of one site, (lanes,), their errors and the frequencies; amplitudes (lanes, K)."""
    if traced(lattice):
        refuse("lattice", "numbers known before tracing", "traced ones", "A study runs outside of transformations.")
    omegas = np.atleast_1d(np.asarray(_known("omegas", omegas, positive), float))
    if omegas.shape != amplitudes.shape[1:]:
        refuse("omegas", f"one for each signal, shape {amplitudes.shape[1:]}", f"shape {omegas.shape}")
    end = one_of("end", end, SIDES)
    settling, watch = (float(_known(name, x, positive)) for name, x in (("settling", settling), ("watch", watch)))
    still = driven_chain(repeats.one_lattice(lattice), 0.0, 1.0, ends=end, damping=damping)
    if not isinstance(still.template(), jax.Array | jax.ShapeDtypeStruct):
        refuse("lattice", "one displacement a site", "several fields")
    (site,) = places.site_of(still, (-1 if end == "left" else 0) if site is None else site, None)

    def moved(a):
        wall = -2 if end == "left" else -1
        return eqx.tree_at(lambda c: c.terms[wall].motion, still, _Signals(a, jnp.asarray(omegas)))

    period = 2 * np.pi / float(omegas.max())
    step = period / int(steps_per_period(still, period))
    # as many lanes for any number of rows
    padded = np.zeros((-(-len(amplitudes) // LANES) * LANES, len(omegas)))
    padded[: len(amplitudes)] = amplitudes
    parts = [jax.vmap(moved, in_axes=-1, out_axes=-1)(jnp.asarray(part.T))
             for part in np.split(padded, len(padded) // LANES)]
    halves = [np.concatenate([_halves(part, step / n, settling, watch, site) for part in parts], 1) for n in (1, 2)]
    halves = np.array(halves)[..., : len(amplitudes)]
    coarse, fine = np.sqrt(halves.mean(1))
    return fine, np.abs(fine - coarse) + np.abs(np.diff(np.sqrt(halves[1]), axis=0)[0]), omegas


def _squared(t: Number, y: StateLike, lattice: Lattice) -> Numbers:
    """v^2 of every site, lanes last."""
    return y[1] ** 2


def _halves(lanes, step, settling, watch, site):
    """Mean square velocity of a site over either half of the watch, (2, lanes)."""
    ends = [0.0, settling, settling + watch / 2, settling + watch]
    state, means = State(lanes.zeros(), lanes.zeros()), []
    for begin, end in itertools.pairwise(ends):
        run = simulate(lanes, state, end, t0=begin, step=step, record={"mean": Integral(_squared)})
        state = run.final
        means.append(np.asarray(run.recorded["mean"])[site] / (end - begin))
    return means[1:]
