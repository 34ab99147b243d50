"""Films of runs: a chain as a curve over its sites, a lattice of the plane as beads."""

from typing import Any

import numpy as np
from matplotlib.animation import FuncAnimation

from ..checks import one_of, positive, refuse, whole
from ..types import Count, Scalar
from ..units import UnitsOrWords
from .arrays import numbers, opened
from .histories import LABELS, SIGNED, colours_of
from .plane import circles_of, flat, frame, half_spacing
from .quantities import Axis, drawn_in, scaled_by, units_of, units_of_both
from .style import COLOURS, AxesOrNone, add_colour_bar, figure, style


def film(
    run: Any,
    places: Any = None,
    *,
    quantity: Any = "v",
    limit: Scalar | None = None,
    label: str | None = None,
    frames: Count | None = None,
    rate: Count = 20,
    move: Scalar = 0.0,
    radius: Scalar | None = None,
    units: UnitsOrWords = None,
    ax: AxesOrNone = None,
) -> FuncAnimation:
    """A film of a run: a chain as a curve over its sites, a lattice of the plane as beads.

    `gx.plots.save(film(run, lattice), "impact.gif")`, or .mp4 where ffmpeg is installed.

    **Arguments:**

    - `run`: anything with `ts`, `us`, `vs`, of more than one time, or the dataset of one.
    - `places`: of the plane, as in `beads`; `None` for a chain.
    - `quantity`: `"v"`, `"u"` (of vectors in the plane their length), or an array over times and sites.
    - `limit` > 0: of the colour or the axis, the largest of all frames by default. `label`: as in `beads`.
    - `frames`: how many, spread over the times; all by default. `rate` a second. `move`: beads are drawn displaced by
      so many times u. `radius`, `units`: as in `beads`. `ax`: where it is drawn, by default in a figure of its own.

    **Returns:** an animation of matplotlib's, for `gx.plots.save`. **Raises** ValueError for a run of one time, and
    shapes that do not fit.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=11)
    >>> gx.plots.save(gx.plots.film(run, frames=2), "impact.gif").name
    'impact.gif'
    """
    run = opened(run)
    ts = np.asarray(run.ts, float)
    if ts.ndim != 1 or len(ts) < 2:
        refuse(
            "run",
            "a run of one scene that saved several times",
            f"{ts.size} of shape {ts.shape}",
            "Give simulate(..., save_at=100).",
        )
    given = quantity if isinstance(quantity, str) else None
    if given is not None:
        one_of("quantity", given, ("u", "v"))
        quantity = run.us if given == "u" else run.vs
    count = len(ts) if frames is None else min(whole("frames", frames, 2), len(ts))
    chosen = np.unique(np.round(np.linspace(0, len(ts) - 1, count)).astype(int))
    name = LABELS.get(given, "quantity") if label is None else label
    if places is None:
        return _chain_film(run, ts, chosen, quantity, limit, name, rate, units, ax)
    return _plane_film(
        run, ts, chosen, places, quantity, limit, name, rate, move, radius, units, given, ax
    )


def _axes(ax, width, height):
    """The Axes that were given, or those of a figure that no notebook shows beside the film."""
    if ax is not None:
        return ax
    with style():
        return figure(width, height).subplots()


def _top(data, limit):
    return (
        float(np.nanmax(np.abs(data)) or 1.0) if limit is None else float(positive("limit", limit))
    )


def _film(ax, show, chosen, rate):
    return FuncAnimation(
        ax.figure, show, frames=chosen, interval=1000 / whole("rate", rate, 1), blit=False
    )


def _chain_film(run, ts, chosen, quantity, limit, label, rate, units, ax):
    data = numbers("quantity", quantity, 2, finite=False)
    if len(data) != len(ts):
        refuse("quantity", f"{len(ts)} frames, one per time of the run", f"shape {data.shape}")
    top = _top(data, limit)
    by_time, by = drawn_in(units, units_of(run), Axis("time", ts), Axis(label, top))
    ax = _axes(ax, 5.4, 3.0)
    (line,) = ax.plot(
        np.arange(data.shape[1]),
        scaled_by(data[0], by.factor),
        "o-",
        ms=2.5,
        lw=0.8,
        color=COLOURS[0],
    )
    low = 0.0 if np.nanmin(data) >= -SIGNED * top else -top
    ax.set(xlabel="site", ylabel=by.label, ylim=(1.08 * low * by.factor, 1.08 * top * by.factor))
    title = ax.set_title(" ")

    def show(i):
        line.set_ydata(scaled_by(data[i], by.factor))
        title.set_text(_time(ts[i], by_time))
        return line, title

    return _film(ax, show, chosen, rate)


def _time(t, by):
    unit = by.label.partition("(")[2].rstrip(")")
    return f"t = {t * by.factor:.4g}" + (f" {unit}" if unit and unit != "scaled" else "")


def _plane_film(
    run, ts, chosen, places, quantity, limit, label, rate, move, radius, units, given, ax
):
    at, _ = flat(places, None)
    fields = getattr(places, "positions", places)
    names = list(fields) if isinstance(fields, dict) else [None]
    data = np.concatenate(
        [_frames(quantity, name, fields, len(ts), given is not None) for name in names], 1
    )
    shift = 0.0
    if move:
        moves = [np.asarray(run.us if name is None else run.us[name], float) for name in names]
        shift = float(move) * np.concatenate([m[..., :2].reshape(len(ts), -1, 2) for m in moves], 1)
    top = _top(data, limit)
    said = units_of_both(run, None if units_of(places) is None else places, "places", "run")
    by_time, x, by = drawn_in(units, said, Axis("time", ts), Axis("length", at), Axis(label, top))
    ax = _axes(ax, 4.8, 4.2)
    radius = (half_spacing(at) if radius is None else float(positive("radius", radius))) * x.factor
    circles = circles_of(ax, scaled_by(at, x.factor), radius)
    norm, name = colours_of(scaled_by(data, by.factor), top * by.factor)
    circles.set(norm=norm, cmap=name, array=data[0] * by.factor)
    add_colour_bar(ax, circles, by.label)
    frame(ax, scaled_by(at, x.factor), radius, x)
    title = ax.set_title(" ")

    def show(i):
        circles.set_array(scaled_by(data[i], by.factor))
        if move:
            circles.set_offsets(scaled_by(at + shift[i], x.factor))
        title.set_text(_time(ts[i], by_time))
        return circles, title

    return _film(ax, show, chosen, rate)


def _frames(quantity, name, places, times, of_run):
    """Numbers (T, beads of one field); the length of vectors of a run."""
    x = np.asarray(quantity if name is None else quantity[name], float)
    shape = np.shape(places if name is None else places[name])[:-1]
    if of_run and x.ndim == len(shape) + 2:
        x = np.linalg.norm(x[..., :2], axis=-1)
    if x.shape != (times, *shape):
        refuse("quantity", f"shape {(times, *shape)}, over times and sites", f"shape {x.shape}")
    return x.reshape(times, -1)
