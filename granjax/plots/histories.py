"""Histories: space-time maps and stacked traces."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize, TwoSlopeNorm
from matplotlib.ticker import MaxNLocator

from ..base.checks import one_of, positive, refuse, within
from ..base.types import Parameter, Scalar
from .arrays import Samples, even, frames_of, history, rising
from .style import AxesOrNone, add_colour_bar, add_legend, axes_or_new, colour, shown

SCALES = ("linear", "log")
# Numbers of the other sign up to this share of the scale's end do not make the colours diverge.
SIGNED = 0.02
# Images with more rows or columns than this are averaged over each pixel, not sampled.
FINE = 1000


def space_time(
    run_or_array: Any,
    ax: AxesOrNone = None,
    *,
    quantity: str | Samples = "v",
    ts: Parameter | None = None,
    sites: Parameter | None = None,
    scale: str = "linear",
    floor: Scalar = 1e-4,
    limit: Scalar | None = None,
    label: str | None = None,
    site_label: str = "site",
    colour_bar: bool = True,
) -> Axes:
    """Draw a space-time map: site on x, time on y, the quantity in colour.

    **Arguments:**

    - `run_or_array`: a run (anything with `ts`, `us`, `vs`, or its dataset), or an array (T, N),
      NumPy or JAX.
    - `quantity`: with a run `"v"`, `"u"` or an array (T, N), such as
      `gx.measures.along(gx.measures.strain, ...)`; with a dataset any variable over times and
      sites.
    - `ts`: increasing times (T,), by default of the run, or frame numbers. `sites`: increasing
      positions (N,), by default 0 ... N-1.
    - `scale`: `"linear"`, with zero in white if the data have both signs; `"log"`, the absolute
      value, cut at `floor` in (0, 1) times the limit.
    - `limit` > 0: value of the full colour, in units of the data; by default the largest absolute
      value.
    - `label`: of the quantity; an SI unit at its end, "contact force (N)", gets a prefix.
      `site_label`: of the axis.

    **Returns:** the Axes; the image is `ax.images[0]` (`ax.collections[0]` for uneven times or
    sites). **Raises** ValueError for another scale, shapes that do not fit, a floor outside (0, 1).

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> ax = gx.plots.space_time(gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=11))
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('site', 'time (scaled)')
    """
    one_of("scale", scale, SCALES)
    found = history(run_or_array, quantity, label)
    data = frames_of(found.data)
    ts = found.ts if ts is None else ts
    y = rising("ts", ts, len(data))
    x = rising("sites", sites, data.shape[1])
    top = full_scale(data, limit)
    by = shown(found.label, top, found.unit, found.units)
    by_time = shown("frame", y, "") if ts is None else shown("time", ts, "s", found.units)
    y = by_time(y)
    data = by(data)
    top = top * by.factor
    label = by.label
    ax = axes_or_new(ax, 5.2, 3.8)
    if scale == "log":
        low = float(within("floor", floor, 0, 1, open_low=True, open_high=True)) * top
        data = np.maximum(np.abs(data), low)
        norm = LogNorm(low, top)
        map_name = "magma"
        name, bracket, unit = label.partition(" (")
        label = f"|{name}|{bracket}{unit}"
    else:
        norm, map_name = colours_of(data, top)
    image = _draw(ax, x, y, data, norm, map_name)
    ax.set(xlabel=site_label, ylabel=by_time.label)
    # Few enough ticks for a journal column.
    ticks = {"nbins": 6, "steps": [1, 2, 5, 10], "integer": True}
    if sites is None or np.all(2 * x % 1 == 0):
        ax.xaxis.set_major_locator(MaxNLocator(**ticks))
    if ts is None:
        ax.yaxis.set_major_locator(MaxNLocator(**ticks))
    ax.spines[:].set_visible(True)
    if colour_bar:
        add_colour_bar(ax, image, label)
    return ax


def full_scale(data: Float[np.ndarray, "..."], limit: Scalar | None) -> float:
    """Return the limit, or the largest absolute value, or 1 for zeros."""
    if limit is not None:
        return float(positive("limit", limit))
    return float(np.abs(data[np.isfinite(data)]).max(initial=0.0)) or 1.0


def colours_of(data: Float[np.ndarray, "..."], top: Scalar) -> tuple[Normalize, str]:
    """Return norm and map; diverging about zero if the data have both signs."""
    seen = data[np.isfinite(data)]
    low = seen.min(initial=0.0)
    high = seen.max(initial=0.0)
    if low >= -SIGNED * top:
        return Normalize(0.0, top), "viridis"
    if high <= SIGNED * top:
        return Normalize(-top, 0.0), "viridis_r"
    return TwoSlopeNorm(0.0, -top, top), "RdBu_r"


def _draw(ax, x, y, data, norm, map_name):
    colours = {"norm": norm, "cmap": map_name}
    if not (even(x) and even(y)):
        return ax.pcolormesh(x, y, data, shading="nearest", rasterized=True, **colours)
    fine = "nearest" if max(data.shape) <= FINE else "antialiased"
    look = {"origin": "lower", "aspect": "auto", "interpolation": fine}
    ends = (*_ends(x), *_ends(y))
    return ax.imshow(data, extent=ends, interpolation_stage="data", **look, **colours)


def _ends(x):
    half = (x[-1] - x[0]) / (2 * (len(x) - 1)) if len(x) > 1 else 0.5
    return x[0] - half, x[-1] + half


def traces(
    ts: Any,
    qs: str | Samples = "v",
    sites: Parameter | None = None,
    ax: AxesOrNone = None,
    *,
    offset: Scalar | None = None,
    labels: Sequence | None = None,
    label: str | None = None,
    site_label: str = "site",
) -> Axes:
    """Draw traces of some sites over time, stacked, the first at the bottom.

    **Arguments:**

    - `ts`: increasing times (T,), and `qs`: history (T, N), NumPy or JAX; or a run or its dataset,
      and `qs` as `quantity` of `space_time`. `sites`: indices of the sites to show, negative from
      the end; `None` for all.
    - `offset`: distance between traces [units of q]; `None` for the largest span of one; 0 overlays
      them, with a legend. `labels`: one per trace, by default the site's index.
    - `label`, `site_label`: of the scale bar or axis, as in `space_time`.

    **Returns:** the Axes; `ax.lines` holds the traces first, in order. **Raises** ValueError for
    shapes that do not fit, an offset below zero.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=11)
    >>> len(gx.plots.traces(run, "v", [0, 2, 4]).lines)
    4
    """
    found = history(ts, qs, label)
    if found.ts is None:  # arrays instead of a run
        found = found._replace(ts=ts, data=qs)
    qs = frames_of(found.data, "qs")
    by_time = shown("time", found.ts, "s", found.units)
    ts = by_time(rising("ts", found.ts, len(qs)))
    count = qs.shape[1]
    sites = np.arange(count) if sites is None else np.atleast_1d(sites)
    if sites.dtype.kind not in "iub" or np.any((sites < -count) | (sites >= count)):
        refuse("sites", f"whole numbers within {-count} ... {count - 1}", repr(sites.tolist()))
    sites = np.arange(count)[sites]
    chosen = qs[:, sites]
    by = shown(found.label, chosen, found.unit, found.units)
    chosen = by(chosen)
    names = [str(name) for name in (sites if labels is None else labels)]
    span = np.nanmax(np.nanmax(chosen, 0) - np.nanmin(chosen, 0)) or 1.0
    if offset is None:
        offset = span
    else:
        offset = by.factor * float(within("offset", offset, 0, np.inf))
    ax = axes_or_new(ax, 5.2, 3.8)
    for i, name in enumerate(names):
        look = {"color": colour(i), "lw": 1.3, "zorder": 3 - i / 1e3}
        ax.plot(ts, chosen[:, i] + i * offset, label=f"{site_label} {name}", **look)
    ax.set(xlabel=by_time.label, xlim=(ts[0], ts[-1]))
    if offset == 0:
        ax.set_ylabel(by.label)
        add_legend(ax, inside=True)
        return ax
    every = -(-len(names) // 16)
    ax.set_yticks((offset * np.arange(len(names)))[::every], names[::every])
    ax.set_ylabel(site_label)
    _scale_bar(ax, span, by)
    return ax


def _scale_bar(ax, span, by):
    power = 10.0 ** np.floor(np.log10(span))
    height = max(m for m in (1, 2, 5) if m * power <= span * (1 + 1e-12)) * power
    limits = low, high = ax.get_ylim()
    middle = (low + high) / 2
    transform = ax.get_yaxis_transform()
    bar = [middle - height / 2, middle + height / 2]
    ax.plot([1.02, 1.02], bar, color="black", lw=2, transform=transform, clip_on=False)
    said = f"{by.label.partition(' (')[0]} {height:g} {by.after}".strip()
    ax.text(1.04, middle, said, rotation=90, va="center", fontsize="small", transform=transform)
    ax.set_ylim(limits)
