"""What an instrument would show: a laser vibrometer's trace of one bead."""

from typing import ClassVar

import numpy as np

from ..checks import non_negative, parameter, positive, refuse, show, whole
from ..results import Result, array
from ..types import Count, Numbers, Parameter, Scalar
from ..units import SI, Units


class Trace(Result):
    """A sampled signal."""

    _else: ClassVar[str | None] = SI
    time: Numbers = array("The times of the samples.", "s", "time")
    velocity: Numbers = array("The velocity.", "m/s", "time")

    @property
    def outcome(self) -> str:
        """How many samples."""
        return f"{self.time.size} samples over {np.ptp(self.time):.6g} s."


def velocity_trace(
    ts: Parameter,
    vs: Parameter,
    bead: Count,
    *,
    sampling: Scalar,
    noise: Scalar = 0.0,
    seed: Count = 0,
    units: Units | None = None,
) -> Trace:
    """Velocity of one bead as a laser vibrometer gives it: sampled at a fixed rate, with Gaussian noise.

    Between frames the velocity is a cubic spline, so the frames must resolve the motion (at least ten to a period of
    the fastest); a rate above theirs adds samples, not information.

    **Arguments:**

    - `ts`, `vs`: times (T,) and velocities (T, N) and further axes, such as `run.ts`, `run.vs`.
    - `bead`: index, negative from the end.
    - `sampling`: samples per second [Hz].
    - `noise`: standard deviation of the noise [m/s].
    - `seed`: whole number of the noise; the same seed gives the same trace.
    - `units`: a `gx.Units`, such as `gx.scenes.scaled` gives, where the run is in scaled numbers. `None`: it is in SI.

    **Returns:** `Trace(time, velocity)` from the first frame on, NumPy arrays.
    **Raises** ValueError for fewer than four frames, a bead that is not there, a record that holds fewer than two
    samples, a noise below zero, or traced input.

    **Example:**

    >>> ts = np.linspace(0.0, 1.0, 51)
    >>> trace = gx.measures.velocity_trace(ts, np.sin(ts)[:, None], bead=0, sampling=20.0)
    >>> round(float(trace.velocity[10]), 6)  # sin(0.5)
    0.479426
    """
    ts, vs = np.asarray(parameter("ts", ts)), np.asarray(parameter("vs", vs))
    if ts.ndim != 1 or len(ts) < 4 or not np.all(np.diff(ts) > 0):
        refuse("ts", "at least four rising times", show(ts))
    if vs.ndim < 2 or len(vs) != len(ts):
        refuse("vs", f"shape ({len(ts)}, N), frames first", f"shape {vs.shape}")
    units = Units() if units is None else units
    second, metre = float(units.time), float(units.length)
    time = ts * second
    interval = 1 / float(positive("sampling", sampling))
    samples = int(np.floor((time[-1] - time[0]) / interval * (1 + 1e-12))) + 1
    if samples < 2:
        refuse(
            "sampling",
            f"at least {1 / (time[-1] - time[0]):g} Hz, two samples in the record",
            f"{sampling}",
        )
    at = np.minimum(time[0] + interval * np.arange(samples), time[-1])
    from scipy.interpolate import CubicSpline

    velocity = CubicSpline(time, vs[:, bead] * (metre / second), axis=0)(at)
    sigma, seed = float(non_negative("noise", noise)), whole("seed", seed)
    if sigma:
        velocity = velocity + sigma * np.random.default_rng(seed).standard_normal(velocity.shape)
    return Trace(at, velocity)
