"""Histories: space-time maps and stacked traces."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize, TwoSlopeNorm
from matplotlib.ticker import MaxNLocator

from ..checks import one_of, positive, within
from ..types import Parameter, Scalar
from ..units import SCALED, UnitsOrWords
from .arrays import Samples, history, is_run, numbers, rising
from .quantities import Axis, drawn_in, scaled_by, units_of
from .style import AxesOrNone, add_colour_bar, axes_or_new, colour

SCALES = ("linear", "log")
LABELS = {"u": "displacement", "v": "velocity"}
EVEN = 1e-6
SIGNED = 0.02
# more rows or columns than this are averaged over a pixel, not picked
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
    units: UnitsOrWords = None,
    site_label: str = "site",
    colour_bar: bool = True,
) -> Axes:
    """Space-time map of a history: site on x, time on y, the quantity in colour.

    **Arguments:**

    - `run_or_array`: a run (anything with `ts`, `us`, `vs`, or the dataset of one), or an array
      (T, N), NumPy or JAX.
    - `quantity`: with a run `"v"`, `"u"` or an array (T, N), such as `gx.measures.along(gx.measures.strain, ...)`.
    - `ts`: times (T,), rising; those of the run by default, frame numbers for an array. `sites`: places (N,), rising,
      0 ... N-1 by default.
    - `scale`: `"linear"`, with zero in white where the data have both signs; `"log"`, the absolute value, cut at
      `floor` in (0, 1) times the limit.
    - `limit`: value of the full colour > 0, in units of the data; the largest absolute value by default.
    - `label`: of the quantity, of an array none by default; one that ends with a known word, such as "contact force",
      also says its dimension. `site_label`: of the axis.
    - `units`: `("ms", "mm/s")`, as in `granjax.plots`.

    **Returns:** the Axes; the image is `ax.images[0]` (`ax.collections[0]` where times or places are uneven).
    **Raises** ValueError for another scale, shapes that do not fit, a floor outside (0, 1).

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> ax = gx.plots.space_time(gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=11))
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('site', 'time (scaled)')
    """
    one_of("scale", scale, SCALES)
    given, said = quantity if isinstance(quantity, str) else None, units_of(run_or_array)
    ts, data = history(run_or_array, quantity, ts)
    y = np.arange(data.shape[0], dtype=float) if ts is None else rising("ts", ts, data.shape[0])
    x = (
        np.arange(data.shape[1], dtype=float)
        if sites is None
        else rising("sites", sites, data.shape[1])
    )
    if label is None:
        label = LABELS.get(given if is_run(run_or_array) else None, "quantity")
    top = _limit(data, limit)
    frames = ts is None
    by_time, by_quantity = drawn_in(
        units, said, Axis("frame" if frames else "time", y), Axis(label, top)
    )
    y, data, top = (
        scaled_by(y, by_time.factor),
        scaled_by(data, by_quantity.factor),
        top * by_quantity.factor,
    )
    label = by_quantity.label
    ax = axes_or_new(ax, 5.2, 3.8)
    if scale == "log":
        low = float(within("floor", floor, 0, 1, open_low=True, open_high=True)) * top
        data, norm, map_name, label = (
            np.maximum(np.abs(data), low),
            LogNorm(low, top),
            "magma",
            _size(label),
        )
    else:
        norm, map_name = colours_of(data, top)
    image = _draw(ax, x, y, data, norm, map_name)
    ax.set_xlabel(site_label)
    ax.set_ylabel(by_time.label)
    if sites is None or np.all(2 * x % 1 == 0):
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    if frames:
        ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    for spine in ax.spines.values():
        spine.set_visible(True)
    if colour_bar:
        beyond = EVEN * (norm.vmax - norm.vmin)
        above, below = np.nanmax(data) > norm.vmax + beyond, np.nanmin(data) < norm.vmin - beyond
        cut = ("neither", "max", "min", "both")[int(above) + 2 * int(below)]
        add_colour_bar(ax, image, label, extend=cut)
    return ax


def _size(label):
    """The label of absolute values."""
    name, bracket, unit = label.partition(" (")
    return f"|{name}|{bracket}{unit}"


def _limit(data, limit):
    if limit is not None:
        return float(positive("limit", limit))
    seen = np.abs(data[np.isfinite(data)])
    return float(seen.max()) if seen.size and seen.max() > 0 else 1.0


def colours_of(data: Float[np.ndarray, "T N"], top: Scalar) -> tuple[Normalize, str]:
    """Norm and map: a diverging map about zero where both signs matter."""
    low = np.nanmin(data) if np.isfinite(data).any() else 0.0
    high = np.nanmax(data) if np.isfinite(data).any() else 1.0
    if low >= -SIGNED * top:
        return Normalize(0.0, top), "viridis"
    if high <= SIGNED * top:
        return Normalize(-top, 0.0), "viridis_r"
    return TwoSlopeNorm(0.0, -top, top), "RdBu_r"


def _draw(ax, x, y, data, norm, map_name):
    if _even(x) and _even(y):
        (left, right), (bottom, top) = _ends(x), _ends(y)
        return ax.imshow(
            data,
            origin="lower",
            aspect="auto",
            extent=(left, right, bottom, top),
            norm=norm,
            cmap=map_name,
            interpolation="nearest" if max(data.shape) <= FINE else "antialiased",
            interpolation_stage="data",
        )
    return ax.pcolormesh(x, y, data, norm=norm, cmap=map_name, shading="nearest", rasterized=True)


def _even(x):
    steps = np.diff(x)
    return len(x) < 2 or np.ptp(steps) <= EVEN * abs(steps.mean())


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
    units: UnitsOrWords = None,
    site_label: str = "site",
) -> Axes:
    """Traces of some sites over time, stacked, the first at the bottom.

    **Arguments:**

    - `ts`: times (T,), rising, and `qs`: history (T, N), NumPy or JAX; or a run, and `qs` as `quantity` of
      `space_time`. `sites`: indices of the sites to show, negative from the end; `None` for all.
    - `offset`: distance between traces [units of q]; `None` takes the largest span of one; 0 lays them over each
      other, with a legend. `labels`: one per trace, by default the site's index.
    - `label`: of the quantity, on the scale bar or the axis, as in `space_time`. `site_label`: of the axis.
      `units`: `("ms", "mm/s")`, as in `granjax.plots`.

    **Returns:** the Axes; `ax.lines` holds the traces first, in order.
    **Raises** ValueError for shapes that do not fit, an offset below zero.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=11)
    >>> len(gx.plots.traces(run, "v", [0, 2, 4]).lines)
    4
    """
    said, given = units_of(ts), qs if isinstance(qs, str) else None
    if is_run(ts) or isinstance(qs, str):
        ts, qs = history(ts, qs, None)
    label = LABELS.get(given, "quantity") if label is None else label
    qs = numbers("qs", qs, 2, finite=False)
    ts = rising("ts", ts, len(qs))
    sites = _sites(sites, qs.shape[1])
    known = qs[:, sites][np.isfinite(qs[:, sites])]
    by_time, by_quantity = drawn_in(units, said, Axis("time", ts), Axis(label, known))
    ts, qs = scaled_by(ts, by_time.factor), scaled_by(qs, by_quantity.factor)
    offset = None if offset is None else offset * by_quantity.factor
    names = [str(n) for n in sites] if labels is None else [str(name) for name in labels]
    chosen = qs[:, sites]
    span = float(np.nanmax(np.nanmax(chosen, 0) - np.nanmin(chosen, 0))) or 1.0
    offset = span if offset is None else float(within("offset", offset, 0, np.inf))
    ax = axes_or_new(ax, 5.2, 3.8)
    for i, name in enumerate(names):
        trace = chosen[:, i] + i * offset
        ax.plot(
            ts, trace, color=colour(i), lw=1.3, label=f"{site_label} {name}", zorder=3 - i / 1e3
        )
    ax.set_xlabel(by_time.label)
    ax.set_xlim(ts[0], ts[-1])
    if offset == 0:
        ax.set_ylabel(by_quantity.label)
        ax.legend(frameon=False)
        return ax
    places = offset * np.arange(len(names))
    every = -(-len(names) // 16)
    ax.set_yticks(places[::every], names[::every])
    ax.set_ylabel(site_label)
    _scale_bar(ax, span, label, by_quantity.unit)
    return ax


def _sites(sites, size):
    return np.arange(size) if sites is None else np.arange(size)[np.asarray(sites)]


def _scale_bar(ax, span, label, unit):
    """A bar of a round height beside the traces, in place of a second axis."""
    height = _round_below(span)
    low, high = ax.get_ylim()
    bottom = (low + high - height) / 2
    transform = ax.get_yaxis_transform()
    ax.plot(
        [1.02, 1.02],
        [bottom, bottom + height],
        color="black",
        lw=2,
        transform=transform,
        clip_on=False,
    )
    text = f"{label} {height:g} {unit}" if unit and unit != SCALED else f"{label} {height:g}"
    ax.text(
        1.04,
        bottom + height / 2,
        text,
        rotation=90,
        va="center",
        ha="left",
        transform=transform,
        fontsize="small",
    )
    ax.set_ylim(low, high)


def _round_below(x):
    power = 10.0 ** np.floor(np.log10(x))
    return float(max(m for m in (1, 2, 5) if m * power <= x * (1 + 1e-12)) * power)
