"""Beads in the plane as circles with the forces between them; films of runs."""

from typing import Any

import numpy as np
from matplotlib.animation import FuncAnimation
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.lines import Line2D

from ..base.checks import positive, refuse, whole
from ..base.types import Count, Scalar
from .arrays import frames_of, history, numbers
from .histories import SIGNED, colours_of, full_scale
from .style import (
    COLOURS,
    AxesOrNone,
    add_colour_bar,
    add_legend,
    axes_or_new,
    figure,
    shown,
    style,
    units_of,
)

# Beads closer than this fraction of the lattice's size count as coincident.
CLOSED = 1e-9
# From this number of beads on, outlines would hide them.
MANY = 3000
# The width of the line of the largest force, as a fraction of a bead's diameter.
SHARE = 0.13
# The largest width of this line [points].
WIDEST = 2.5
# Forces below this fraction of the largest are not drawn.
LEAST = 1e-3


def beads(
    places: Any,
    values: Any = None,
    ax: AxesOrNone = None,
    *,
    network: Any = None,
    radius: Scalar | None = None,
    label: str = "quantity",
    limit: Scalar | None = None,
    colour_bar: bool = True,
) -> Axes:
    """Draw the beads of a plane lattice as circles, coloured by a quantity, with force lines.

    **Arguments:**

    - `places`: anything with `positions`, such as a `Lattice`; or an array (..., 2), or a dict of
      arrays.
    - `values`: one number per bead, shaped as the places without their last axis
      (a dict for fields), such as `gx.measures.site_energy`; `None` draws only the beads. `label`:
      names them; an SI unit at its end, "energy (J)", gets a prefix. `limit` > 0: the value of the
      full colour.
    - `network`: anything with `segments` (bonds, 2, 2) and `force` (bonds,), such as
      `gx.measures.force_network`: lines with a width proportional to the force, in the second
      colour if it pulls, with a legend of the largest.
    - `radius`: of the circles, in the unit of the places; by default half of the least distance.

    **Returns:** the Axes; the circles are `ax.collections[0]`. **Raises** ValueError for shapes
    that do not fit.

    **Example:**

    >>> places, values = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.87]]), np.array([1.0, 0.5, 0.0])
    >>> ax = gx.plots.beads(places, values, label="energy")
    >>> len(ax.collections[0].get_offsets())
    3
    """
    by, at, radius = _places(places, radius)
    ax = axes_or_new(ax, 4.8, 4.2)
    circles = _circles(ax, at, radius)
    lines = np.zeros((0, 2, 2))
    if network is not None:
        lines = by(numbers("network.segments", network.segments, 3, finite=False))
    _frame(ax, np.concatenate([at, lines.reshape(-1, 2)]), radius, by.label)
    if network is not None:
        _lines(ax, lines, network.force, radius, units_of(places))
    if values is None:
        circles.set_facecolor("0.85")
        return ax
    data = _numbers(values, places, ())
    of_values = shown(label, data, None, units_of(places))
    norm, name = colours_of(of_values(data), of_values.factor * full_scale(data, limit))
    circles.set(array=of_values(data), norm=norm, cmap=name)
    if colour_bar:
        add_colour_bar(ax, circles, of_values.label)
    return ax


def _fields(places):
    if getattr(places, "lanes", ()):
        refuse("places", "one lattice", f"a batch of {places.lanes}", "Take a lane.")
    places = getattr(places, "positions", places)
    fields = places if isinstance(places, dict) else {"": places}
    for x in fields.values():
        if np.shape(x)[-1:] != (2,) or np.ndim(x) < 2:
            refuse(
                "places",
                "a lattice with positions in the plane, or an array (..., 2)",
                "none" if x is None else f"shape {np.shape(x)}",
                "For places in space give two components: positions[:, :2]." * (x is not None),
            )
    return fields


def _places(places, radius, units=None):
    # The scale of places, and these and the radius of circles as they are drawn.
    at = np.concatenate([numbers("places", x).reshape(-1, 2) for x in _fields(places).values()])
    if radius is None:
        some = at[:: max(1, len(at) // 64)]
        apart = np.linalg.norm(some[:, None] - at, axis=-1)
        apart[apart < CLOSED * (np.ptp(at) or 1.0)] = np.inf
        radius = apart.min() / 2 if np.isfinite(apart.min()) else 0.5
    by = shown("x", at, "m", units_of(places) or units)
    return by, by(at), by.factor * float(positive("radius", radius))


def _numbers(values, places, times, length=False):
    columns = []
    for name, x in _fields(places).items():
        shape = (*times, *np.shape(x)[:-1])
        value = numbers("values", values[name] if name else values, finite=False)
        if length and value.ndim == len(shape) + 1:
            value = np.linalg.norm(value[..., :2], axis=-1)
        if value.shape != shape:
            refuse("values", f"shape {shape}, one number per bead", f"shape {value.shape}")
        columns.append(value.reshape(*times, -1))
    return np.concatenate(columns, -1)


def _circles(ax, at, radius) -> EllipseCollection:
    size = np.full(len(at), 2 * radius)
    look = {"edgecolor": "0.35", "linewidth": 0.4 if len(at) < MANY else 0}
    where = {"units": "xy", "offsets": at, "offset_transform": ax.transData}
    return ax.add_collection(EllipseCollection(size, size, 0 * size, **where, **look))


def _lines(ax, lines, force, radius, units):
    # Draw forces as lines over the beads, thin enough to see these, and a legend of the widest.
    by = shown("force", force, "N", units)
    force = by(force)
    top = np.nanmax(np.abs(force), initial=0.0)
    drawn = np.isfinite(lines).all((1, 2)) & (np.abs(force) > LEAST * top)
    lines = lines[drawn]
    force = force[drawn]
    if not len(force):
        return
    ax.apply_aspect()
    across = np.diff(ax.transData.transform([[0.0, 0.0], [2 * radius, 0.0]])[:, 0])[0]
    widest = min(WIDEST, max(0.4, SHARE * across * 72 / ax.figure.dpi))
    tones = np.where(force >= 0, "0.1", COLOURS[1])
    width = widest * np.abs(force) / top
    ax.add_collection(LineCollection(lines, linewidths=width, colors=tones, zorder=2))
    keys = []
    for tone, word, largest in (("0.1", "force", force.max()), (COLOURS[1], "pull", -force.min())):
        if largest > 0:
            name = f"{word} {largest:.3g} {by.after}".strip()
            keys.append(Line2D([], [], color=tone, lw=widest * largest / top, label=name))
    add_legend(ax, keys)


def _frame(ax, at, radius, label):
    low = np.nanmin(at, 0) - 1.5 * radius
    high = np.nanmax(at, 0) + 1.5 * radius
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    ax.set(xlabel=label, ylabel="y" + label[1:])
    ax.locator_params(nbins=5)


def film(
    run: Any,
    places: Any = None,
    *,
    quantity: Any = "v",
    limit: Scalar | None = None,
    label: str | None = None,
    rate: Count = 20,
    move: Scalar = 0.0,
    ax: AxesOrNone = None,
) -> FuncAnimation:
    """Make a film of a run: a chain as a curve over its sites, a plane lattice as beads.

    `gx.plots.save(film(run, lattice), "impact.gif")`, or .mp4 if ffmpeg is installed.

    **Arguments:**

    - `run`: anything with `ts`, `us`, `vs` and several times, or its dataset.
    - `places`: of a plane lattice, as in `beads`; `None` for a chain.
    - `quantity`: `"v"`, `"u"` (for vectors in the plane their length), or an array over times and
      sites.
    - `limit` > 0: of the colour or the axis, by default the largest value. `label`: as in `beads`.
    - `rate`: frames per second. `move`: the factor that magnifies displacements u. `ax`: by default
      in a new figure.

    **Returns:** a matplotlib animation, for `gx.plots.save`. **Raises** ValueError for a run with a
    single time, and shapes that do not fit.
    """
    found = history(run, quantity, label)
    by_time = shown("time", found.ts, "s", found.units)
    ts = by_time(found.ts)
    if places is None:
        data = frames_of(found.data)
    else:
        data = _numbers(found.data, places, (len(ts),), isinstance(quantity, str))
    if len(data) != len(ts):
        refuse("quantity", f"{len(ts)} frames, one per time of the run", f"shape {data.shape}")
    top = full_scale(data, limit)
    by = shown(found.label, top, found.unit, found.units)
    data = by(data)
    top = top * by.factor
    if ax is None:  # a figure that a notebook does not show beside the film
        with style():
            ax = figure(*((5.4, 3.0) if places is None else (4.8, 4.2))).subplots()
    title = ax.set_title(" ")
    unit = by_time.after
    if places is None:
        (line,) = ax.plot(data[0], "o-", ms=2.5, lw=0.8, color=COLOURS[0])
        low = 0.0 if np.nanmin(data) >= -SIGNED * top else -top
        ax.set(xlabel="site", ylabel=by.label, ylim=(1.08 * low, 1.08 * top))
        show = lambda i: line.set_ydata(data[i])
    else:
        show = _moving(ax, run, places, move, data, top, by, found.units)

    def frame(i):
        show(i)
        title.set_text(f"t = {ts[i]:.4g} {unit}".rstrip())

    pause = 1000 / whole("rate", rate, 1)
    return FuncAnimation(ax.figure, frame, frames=len(ts), interval=pause, blit=False)


def _moving(ax, run, places, move, data, top, by, units):
    place, at, radius = _places(places, None, units)
    circles = _circles(ax, at, radius)
    norm, name = colours_of(data, top)
    circles.set(norm=norm, cmap=name, array=data[0])
    add_colour_bar(ax, circles, by.label, data)
    shift = np.zeros((len(data), 1, 2))
    if move:
        us = history(run, "u").data
        each = [np.asarray(us[key] if key else us, float) for key in _fields(places)]
        shift = np.concatenate([x[..., :2].reshape(len(data), -1, 2) for x in each], 1)
        shift = float(move) * place(shift)
    _frame(ax, at, radius, place.label)

    def show(i):
        circles.set_array(data[i])
        circles.set_offsets(at + shift[i])

    return show
