"""Fronts: when a pulse arrives and peaks at each site, and its speed."""

from math import prod

import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import trailing
from ..base.checks import one_of, parameter, refuse, require, show, within
from ..base.derivatives import with_slope
from ..base.types import Flags, Number, Numbers, Parameter, Scalar
from ..results import Result, array

# The steps of Newton's method, bisections included, that close in on a root.
ROOT_STEPS = 12
# A site whose slope at the end, times the time since its arrival, makes up this share of its largest
# value has not reached its maximum: an exponential foot has log 2, a ramp from zero 1/2.
RISING = 0.3
# A site at rest moves by less than this times eps of the largest value.
QUIET = 4096


class Peaks(Result):
    """Time and height of the highest maximum of every site, NaN where it lies at an end."""

    times: Numbers = array("The time of the maximum.", "s", "site")
    heights: Numbers = array("The height of the maximum.", axes="site")

    @property
    def outcome(self) -> str:
        there = np.isfinite(self.times)
        return f"{there.sum()} of {there.size} maxima lie inside the record."


class Front(Result):
    """The speed of a front, and the arrival times."""

    speed: Number = array("The speed in sites per time.", "1/s")
    error: Number = array("The standard error of the speed.", "1/s")
    arrivals: Numbers = array("The arrival times.", "s", "site")

    @property
    def outcome(self) -> str:
        there = np.isfinite(self.arrivals)
        return f"A line through {there.sum()} of {there.size} arrivals."


def arrival_times(
    ts: Parameter,
    q: Parameter,
    threshold: Parameter | None = None,
    *,
    fraction: Scalar = 0.5,
) -> Numbers:
    """Return the time at which a quantity first reaches a threshold, at every site.

    It is that of the cubic through the four frames about it, of fourth order in the frame spacing
    for a given threshold. It is differentiable in `q`, `ts` and `threshold`, but for the choice of
    frames.

    **Arguments:** `ts`: times (T,), rising. `q`: (T, N) and trailing axes, such as contact forces.
    `threshold`: a number, or one per site [units of q]; `None` takes `fraction`, in (0, 1], of each
    site's largest frame: second order.
    **Returns:** times of the shape of one frame; `ts[0]` where q starts above, NaN where it never
    does or is far from its maximum at the end.
    **Raises** ValueError for times that do not rise, or a fraction outside (0, 1].

    **Example:**

    >>> ts, n = np.linspace(0.0, 10.0, 101), np.arange(8)
    >>> q = np.tanh(ts[:, None] - 2 - n / 2)
    >>> np.array(gx.measures.arrival_times(ts, q, threshold=0.0)[:3]).round(4).tolist()
    [2.0, 2.5, 3.0]
    """
    ts, q = _history(ts, q)
    fraction = within("fraction", fraction, 0, 1, open_low=True)
    if threshold is None:
        return _crossings_of_share(ts, q, fraction)
    threshold = parameter("threshold", threshold)
    own = q.shape[1:]
    try:
        threshold = jnp.broadcast_to(threshold, own)
    except ValueError:
        wanted = f"one number, or one per site, shape {own}"
        refuse("threshold", wanted, f"shape {threshold.shape}")
    return _crossings(ts, q, threshold)


def peak_times(ts: Parameter, q: Parameter) -> Peaks:
    """Return time and height of the highest maximum of a quantity at every site.

    The maximum is that of the quartic through the five frames about the highest (of three frames, a
    parabola).

    **Arguments:** as in `arrival_times`. **Returns:** `Peaks`, NaN where the highest frame is the
    first or last.
    **Raises** ValueError as `arrival_times`, and for fewer than three frames.
    """
    return _maxima(*_history(ts, q, 3))


def front_speed(
    ts: Parameter,
    q: Parameter,
    sites: Parameter | None = None,
    *,
    by: str = "peak",
) -> Front:
    """Compute the speed c of a front by a least-squares line t = t0 + n/c through arrival times.

    **Arguments:** `ts`, `q`: as in `arrival_times`. `sites`: indices, not near the ends, `None` for
    all. `by`: `"peak"`, the time of the maximum, or `"arrival"`, that of half of each site's
    largest frame, above the first one where that is higher. Sites without arrival (NaN) are left
    out.
    **Returns:** `Front(speed, error, arrivals)`; speed in sites per time, positive towards higher
    index; `error` is from the scatter about the line, NaN for fewer than three arrivals.
    **Raises** ValueError for another `by`, and sites that are not indices or fewer than two.

    **Example:**

    >>> ts, n = np.linspace(0.0, 10.0, 101), np.arange(8)
    >>> front = gx.measures.front_speed(ts, np.exp(-((ts[:, None] - 2 - n / 2) ** 2)))
    >>> round(float(front.speed), 4)
    2.0
    """
    ts, q = _history(ts, q, 3)
    if q.ndim < 2:
        refuse("q", "frames of several sites, shape (T, N)", f"shape {q.shape}")
    n = _indices(sites, q.shape[1])
    chosen = q[:, n]
    if one_of("by", by, ("peak", "arrival")) == "peak":
        arrivals = peak_times(ts, chosen).times
    else:
        # A preload is there before the front.
        begin = chosen[0]
        arrivals = arrival_times(ts, chosen - jnp.where(begin >= chosen.max(0) / 2, begin, 0))
    n = trailing(jnp.asarray(n, ts.dtype), arrivals.ndim)
    slowness, error = line(n, arrivals, jnp.isfinite(arrivals))
    return Front(1 / slowness, error / slowness**2, arrivals)


@jax.jit
def line(x: Numbers, y: Numbers, kept: Flags) -> tuple[Numbers, Numbers]:
    """Fit a line through the points kept, along the first axis: its slope, and the error of it."""
    count = kept.sum(0)
    x, y = (jnp.where(kept, z - jnp.where(kept, z, 0).sum(0) / count, 0) for z in (x, y))
    square = (x * x).sum(0)
    slope = (x * y).sum(0) / square
    freedom = jnp.where(count > 2, count - 2, jnp.nan)
    return slope, jnp.sqrt(((y - slope * x) ** 2).sum(0) / freedom / square)


def _history(ts, q, least=2):
    ts = parameter("ts", ts)
    q = parameter("q", q)
    if ts.ndim != 1 or len(ts) < least:
        refuse("ts", f"at least {least} times in one row", f"shape {ts.shape}")
    if q.shape[:1] != ts.shape:
        refuse(
            "q",
            f"{len(ts)} frames on the first axis, one per time",
            f"shape {q.shape}",
            "Time comes first.",
        )
    return require("ts", ts, lambda ts: np.diff(ts) > 0, "rising times"), q


def _indices(sites, size):
    n = np.arange(size) if sites is None else np.asarray(sites)
    if n.ndim != 1 or n.dtype.kind not in "iu" or len(n) < 2 or n.min() < 0 or n.max() >= size:
        refuse("sites", f"two indices or more within 0 ... {size - 1}", show(n))
    return n


def _stencil(ts, q, first, size):
    # frames from `first` on, kept inside the record; times in units of their span
    size = min(size, len(ts))
    first = jnp.clip(first, 0, len(ts) - size)
    index = first + trailing(jnp.arange(size), q.ndim)
    nodes = ts[index]
    start = nodes[0]
    scale = nodes[-1] - start
    return (nodes - start) / scale, jnp.take_along_axis(q, index, 0), start, scale


def _polynomial(nodes, values):
    # by Lagrange's formula, along the first axis
    nodes = list(nodes)
    except_at = lambda x, node: prod(x - other for other in nodes if other is not node)
    weights = [value / except_at(node, node) for node, value in zip(nodes, values)]
    return lambda x: sum(w * except_at(x, node) for node, w in zip(nodes, weights))


@jax.jit
def _crossings(ts, q, threshold):
    reached = q >= threshold
    first = jnp.argmax(reached, 0)
    nodes, values, start, scale = _stencil(ts, q, first - 2, 4)
    # the frames before and after the crossing, in the stencil's units of time
    low = (ts[jnp.maximum(first - 1, 0)] - start) / scale
    high = (ts[first] - start) / scale
    x = _root(_polynomial(nodes, values - threshold), low, high)
    return jnp.where(reached.any(0), jnp.where(first == 0, ts[0], start + scale * x), jnp.nan)


@jax.jit
def _crossings_of_share(ts, q, fraction):
    highest = q.max(0)
    arrivals = _crossings(ts, q, fraction * highest)
    rise = (q[-1] - q[-2]) / (ts[-1] - ts[-2]) * (ts[-1] - arrivals)
    largest = jnp.abs(q).max((0, 1) if q.ndim > 1 else 0)
    moves = highest > QUIET * jnp.finfo(q.dtype).eps * largest
    reached = moves & ((highest > q[-1]) | (rise < RISING * highest))
    return jnp.where(reached, arrivals, jnp.nan)


@jax.jit
def _maxima(ts, q):
    top = jnp.argmax(q, 0)
    nodes, values, start, scale = _stencil(ts, q, top - 2, 5)
    at = jnp.clip(top, 1, len(ts) - 2)
    low = (ts[at - 1] - start) / scale
    high = (ts[at + 1] - start) / scale

    height = _polynomial(nodes, values)
    x = _root(lambda x: -with_slope(height, x)[1], low, high)
    inside = (top > 0) & (top < len(ts) - 1)
    return Peaks(
        jnp.where(inside, start + scale * x, jnp.nan), jnp.where(inside, height(x), jnp.nan)
    )


def _root(f, low, high):
    # where f rises through zero: by Newton's method, with bisection where that leaves the bracket
    def newton(_, carry):
        x, a, b = carry
        g, slope = with_slope(f, x)
        a = jnp.where(g < 0, x, a)
        b = jnp.where(g < 0, b, x)
        new = x - g / jnp.where(slope == 0, 1, slope)
        return jnp.where((new >= a) & (new <= b) & (slope != 0), new, (a + b) / 2), a, b

    bracket = jax.lax.stop_gradient((low, high))
    x, _, _ = jax.lax.fori_loop(0, ROOT_STEPS, newton, ((bracket[0] + bracket[1]) / 2, *bracket))
    # two more steps from a fixed point carry the first and second derivatives of the root
    x = jax.lax.stop_gradient(x)
    for _ in range(2):
        g, slope = with_slope(f, x)
        x = x - jnp.where(slope > 0, g / jnp.where(slope > 0, slope, 1), 0)
    return x
