"""A chain that lets power through one way: a light defect near one end, driven from either."""

import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..checks import held_in_memory, non_negative, one_of, positive, refuse, whole, within
from ..checks import tolerance as checked_tolerance
from ..driven import Sweep, driven_chain, sweep
from ..flow import Flow
from ..forced import Branch, forced_branch
from ..lattice import Lattice
from ..linear import normal_modes
from ..orbits.attractors import steps_per_period
from ..orbits.driven_chain import SIDES
from ..orbits.steps import history
from ..programs import shared_size
from ..results import SI, Held, Result
from ..scenes import beads
from ..solvers import SRKN11b
from ..types import AnyArray, Count, Parameter, Scalar

RADIUS, DEFECT_RADIUS, DEFECT = 9.53e-3, 7e-3, 1
# periods over which power is taken, frames of each, and how often more of a motion that does not repeat
WATCH, FRAMES, AGAIN = 60, 32, 3


class Rectifier(Result):
    """What `rectifier` returns, in SI.

    - `amplitudes` (P,) [m] of the driven wall. `near`, `far`: the two `Sweep`s, with the wall beside the defect moving,
      and with the other; their response is the transmitted power [W].
    - `threshold_near`, `threshold_far`: the amplitude [m] from which on the motion does not repeat every period, to
      1 %; infinity where it always does. `asymmetry` (P,): power from the defect's side over that from the other;
      `asymmetry_error` (P,): estimated distance from the truth, by those of the two powers (`Way.response_error`; of a
      motion that does not repeat, by how much the next 60 periods differ).
    - `frequency` of the drive, `defect` mode, `cutoff` of the band [Hz].

    **Example:**

    >>> amplitudes = np.array([2e-8, 4e-8])
    >>> found = gx.studies.rectifier(amplitudes, sites=6, periods=8)
    >>> found.asymmetry.shape == amplitudes.shape, round(float(found.frequency / found.defect), 6)
    (True, 0.98)
    """

    _else: ClassVar[str | None] = SI
    held: ClassVar[dict[str, Held]] = {
        "amplitudes": Held("amplitudes", "m"), "asymmetry": Held("amplitudes", "1"),
        "asymmetry_error": Held("amplitudes", "1"),
        "threshold_near": Held(unit="m"), "threshold_far": Held(unit="m"), "frequency": Held(unit="Hz"),
        "defect": Held(unit="Hz"), "cutoff": Held(unit="Hz"),
    }
    amplitudes: Float[np.ndarray, " P"]
    near: Sweep
    far: Sweep
    threshold_near: float
    threshold_far: float
    asymmetry: Float[np.ndarray, " P"]
    asymmetry_error: Float[np.ndarray, " P"]
    frequency: float
    defect: float
    cutoff: float

    @property
    def outcome(self) -> str:
        least = np.nanmax(self.asymmetry - self.asymmetry_error, initial=0.0)
        times = f"up to at least {least:.3g} times" if least > 0 else "within its error"
        near, far = (self._repeating(x) for x in (self.threshold_near, self.threshold_far))
        return (f"From the defect's side {times} the power from the other; there the motion repeats every period "
                f"{near}, from the other side {far}.")

    def _repeating(self, threshold):
        if threshold <= self.amplitudes[0]:
            return "at no amplitude"
        return f"below {threshold:.3g} m (to 1 %)" if math.isfinite(threshold) else "at all amplitudes"


class _Driven(eqx.Module):
    """The chain over the drive's amplitude; equal ones compile once, as those of `_Power` do."""

    lattice: Lattice
    omega: AnyArray
    damping: AnyArray
    end: str = eqx.field(static=True)

    def __call__(self, amplitude):
        return driven_chain(self.lattice, amplitude, self.omega, ends=self.end, damping=self.damping)


class _Power(eqx.Module):
    """What the beads from `first` to `last` dissipate: the mean of the sum of gamma m v^2."""

    damping: AnyArray
    first: int = eqx.field(static=True)
    last: int = eqx.field(static=True)

    def __call__(self, lattice, u, v, t):
        return self.damping * jnp.mean(jnp.sum((lattice.mass * v * v)[:, self.first : self.last], 1))


def rectifier(
    amplitudes: Parameter, *, sites: Count = 20, detuning: Scalar = -0.02, defect_radius: Scalar = DEFECT_RADIUS,
    precompression: Scalar = 8.0, damping_time: Scalar = 1.75e-3, periods: Count = 1500, tolerance: Scalar = 1e-6,
) -> Rectifier:
    r"""Transmitted power against the drive's amplitude, with the defect beside the driver and at the far end.

    Steel beads, the second of them smaller: its mode lies above the band. Driven just below that mode, in the gap, a
    chain lets nothing through. From the defect's side the mode is reached directly; above a threshold its orbit
    bifurcates, and what it then sends out at low frequencies passes the band. From the other side the drive decays
    before it gets there. The transmitted power is what the far half of the beads dissipates, the time mean of the sum
    of gamma m v^2; that is, the mean flow of energy into that half.

    **Arguments:** `amplitudes` (P,): ascending [m], followed upwards from rest. `detuning`: of the drive, relative to
    the defect's mode. `defect_radius` [m], below 9.53 mm; `precompression` [N]; `damping_time`: tau [s]; `periods`,
    `tolerance`: as in `sweep`.

    **Returns:** `Rectifier`; its picture is `gx.plots.rectifier`. **Raises** ValueError as `sweep` does.
    Typical: amplitudes of 0.02 to 0.4 um. Measured: from the defect's side the motion ceases to be periodic at 0.177
    um and transmits 4 to 12 mW from 0.2 um on; from the other side it stays periodic to 0.48 um and transmits 1e-14 W
    there, an asymmetry of 1e12 in the absence of noise.
    Source: Boechler, Theocharis, Daraio, Nature Materials 10, 665 (2011).

    **Example:**

    >>> amplitudes = np.array([2e-8, 4e-8])
    >>> found = gx.studies.rectifier(amplitudes, sites=6, periods=8)
    >>> bool(found.defect > found.cutoff)  # the defect's mode lies above the band
    True
    """
    tolerance = checked_tolerance("tolerance", tolerance)
    amplitudes = np.asarray(non_negative("amplitudes", amplitudes), float)
    lattice, modes, omega, damping = _chain(sites, detuning, defect_radius, precompression, damping_time)

    T = 2 * math.pi / omega
    steps = shared_size(int(steps_per_period(lattice, T)))
    ways = []
    for end, *beyond in ("left", sites // 2, sites), ("right", 0, sites // 2):
        driven = _Driven(lattice, *map(jnp.asarray, (omega, damping)), end)
        power = _Power(jnp.asarray(damping), *beyond)
        found = sweep(driven, amplitudes, T, response=power, periods=periods, tolerance=tolerance, watch=WATCH,
                      steps=steps, down=False, jump=0.5, accuracy=0.01)
        ways.append((found, _errors(found.up, driven, power, amplitudes, T, steps)))
    (near, near_error), (far, far_error) = ways
    asymmetry = near.up.response / far.up.response
    error = asymmetry * (near_error / near.up.response + far_error / far.up.response)
    return Rectifier(
        amplitudes, near, far, _threshold(near), _threshold(far), asymmetry, error, 1 / T,
        float(modes[-1]) / (2 * math.pi), float(modes[-2]) / (2 * math.pi),
    )


def _errors(way, driven, power, amplitudes, period, steps):
    """Errors of the power: of a motion that does not repeat the largest change in the times that follow."""
    errors = np.array(way.response_error)
    for i in np.flatnonzero(way.multiple == 0):
        y = jax.tree.map(lambda x, i=i: jnp.asarray(x[i]), way.states)
        after = _later(driven, power, jnp.asarray(amplitudes[i]), y, jnp.asarray(period), jnp.asarray(steps))
        errors[i] = np.abs(np.asarray(after) - way.response[i]).max()
    return errors


@eqx.filter_jit
def _later(driven, power, amplitude, y, period, steps):
    """The power over each of the next `AGAIN` stretches of `WATCH` periods, (AGAIN,)."""
    lattice, flow = driven(amplitude), Flow(steps, SRKN11b())

    def one(y, _):
        end, ts, ys = history(flow, lattice, y, 0.0, period, FRAMES, WATCH)
        return end, power(lattice, ys.u, ys.v, ts)

    return jax.lax.scan(one, y, length=AGAIN)[1]


def rectifier_branch(
    low: Scalar, high: Scalar, *, sites: Count = 20, detuning: Scalar = -0.02, defect_radius: Scalar = DEFECT_RADIUS,
    precompression: Scalar = 8.0, damping_time: Scalar = 1.75e-3, end: str = "left", transient: Count = 0,
    arclength: Scalar = 0.1,
) -> Branch:
    r"""Periodic orbits of the same chain over the drive's amplitude, stable or not, with their multipliers.

    Where a pair of multipliers leaves the unit circle (`"Neimark-Sacker"`) the motion becomes quasi-periodic; that is
    what `rectifier` finds by settling as `threshold_near`.

    **Arguments:** `low`, `high`: amplitudes [m], from the one to the other, whichever is larger. `end`: the wall that
    moves, `"left"` beside the defect or `"right"`. `transient`: periods from
    rest at `low` before Newton begins; where two orbits are stable it chooses between them. `arclength`: the first
    step's, a fifth of the longest, as in `gx.forced.forced_branch`. Others as in `rectifier`.

    **Returns:** `Branch`, whose picture is `gx.plots.branch(found, p_label="drive amplitude")`; `gx.plots.rectifier`
    marks its onset. **Raises** ValueError and RuntimeError as `forced_branch`.
    Measured: from 0.02 um on, folds at 0.0828 and 0.0511 um (two stable orbits between), onset of quasi-periodicity at
    0.1792 um. Source: as `rectifier`.

    **Example:**

    >>> low, high = 2e-8, 2.1e-8
    >>> branch = gx.studies.rectifier_branch(low, high, sites=6)
    >>> str(branch.verdict[0])
    'stable'
    """
    low, high = (float(positive(name, x)) for name, x in (("low", low), ("high", high)))
    if low == high:
        refuse("high", "another amplitude than low", repr(high))
    lattice, _, omega, damping = _chain(sites, detuning, defect_radius, precompression, damping_time)
    driven = _Driven(lattice, *map(jnp.asarray, (omega, damping)), one_of("end", end, SIDES))
    return forced_branch(driven, low, high, period=2 * math.pi / omega, transient=transient, arclength=arclength)


def _chain(sites, detuning, defect_radius, precompression, damping_time):
    """The chain, its linear modes, the frequency of the drive and the damping."""
    sites = whole("sites", sites, 6)
    held_in_memory("sites", sites)
    detuning = float(within("detuning", detuning, -1, 1, open_low=True, open_high=True))
    radii = np.full(sites, RADIUS)
    radii[DEFECT] = float(within("defect_radius", defect_radius, 0, RADIUS, open_low=True, open_high=True))
    lattice = beads("steel 316", radii, precompression)
    modes = np.asarray(normal_modes(lattice).omega)
    return lattice, modes, float(modes[-1]) * (1 + detuning), 1 / float(positive("damping_time", damping_time))


def _threshold(found):
    if found.up.multiple[0] != 1:
        return float(found.values[0])
    lost = [change.p for change in found.up.bifurcations if change.before == 1]
    return lost[0] if lost else math.inf
