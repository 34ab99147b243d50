"""The plane: beads as circles with their forces, films, bands along a path, the zone's frequencies."""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.animation import FuncAnimation
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.patches import Polygon

from ..checks import one_of, positive, refuse, whole
from ..entry import checked
from ..types import Count, Scalar
from ..units import UnitsOrWords
from .arrays import having, is_run, numbers
from .histories import LABELS, colours_of
from .quantities import OMEGA, Axis, drawn_in, scaled_by, units_of, units_of_both
from .style import COLOURS, FAINT, AxesOrNone, add_colour_bar, axes_or_new, figure, style

CLOSED = 1e-9
# beads whose outlines would hide them
MANY = 3000


@checked
def beads(
    places: Any, values: Any = None, ax: AxesOrNone = None, *, network: Any = None, radius: Scalar | None = None,
    label: str = "quantity", limit: Scalar | None = None, units: UnitsOrWords = None, colour_bar: bool = True,
) -> Axes:
    """Beads of a lattice of the plane as circles, coloured by a quantity, with the forces between them as lines.

    **Arguments:**

    - `places`: anything with `positions`, such as a `Lattice`; or an array (..., 2), or a dict of such.
    - `values`: one number for each bead, shaped as the places without their last axis (a dict of such for fields), such
      as the energies of `gx.measures.site_energy`; `None` draws the beads alone. `label`: what they are; one that ends
      with a known word, "kinetic energy", has units. `limit` > 0: the value of the full colour.
    - `network`: anything with `segments` (bonds, 2, 2) and `force` (bonds,), such as `gx.measures.force_network`: lines
      as wide as the force is large, of the second colour where it pulls.
    - `radius`: of the circles, in the unit of the places; half of the least distance by default.
    - `units`: as in `granjax.plots`.

    **Returns:** the Axes; the circles are `ax.collections[0]`. **Raises** ValueError for shapes that do not fit.
    """
    said = units_of(places)
    at, data = _flat(places, values)
    x, *by = drawn_in(units, said, Axis("length", at), *(() if data is None else (Axis(label, data),)))
    ax = axes_or_new(ax, 4.8, 4.2)
    radius = _radius(at) if radius is None else float(positive("radius", radius))
    circles = _circles(ax, scaled_by(at, x.factor), radius * x.factor)
    if network is not None:
        _lines(ax, network, x.factor, radius * x.factor)
    if data is None:
        circles.set_facecolor("0.85")
    else:
        data = scaled_by(data, by[0].factor)
        top = np.nanmax(np.abs(data)) if limit is None else float(positive("limit", limit)) * by[0].factor
        norm, name = colours_of(data[None], top or 1.0)
        circles.set(array=data, norm=norm, cmap=name)
        if colour_bar:
            add_colour_bar(ax, circles, by[0].label)
    _frame(ax, scaled_by(at, x.factor), radius * x.factor, x)
    return ax


def _flat(places, values):
    """Places (N, 2) and numbers (N,) of all fields, one after the other."""
    places = getattr(places, "positions", places)
    if places is None:
        refuse("places", "a lattice with positions, or an array (..., 2)", "a lattice without positions")
    fields = places if isinstance(places, dict) else {"": places}
    held = values if isinstance(values, dict) else {"": values}
    if values is not None and held.keys() != fields.keys():
        refuse("values", f"numbers for each of {sorted(fields)}", f"{sorted(held)}")
    at, data = [], []
    for name, x in fields.items():
        x = numbers("places", x)
        if x.ndim < 2 or x.shape[-1] != 2:
            refuse("places", "an array (..., 2)", f"shape {x.shape}")
        at.append(x.reshape(-1, 2))
        if values is not None:
            value = numbers("values", held[name], finite=False)
            if value.shape != x.shape[:-1]:
                refuse("values", f"shape {x.shape[:-1]}, one number per bead", f"shape {value.shape}")
            data.append(value.ravel())
    return np.concatenate(at), np.concatenate(data) if data else None


def _radius(at):
    """Half of the least distance between some of the beads and all others."""
    some = at[:: max(1, len(at) // 64)]
    apart = np.linalg.norm(some[:, None] - at, axis=-1)
    apart[apart < CLOSED * (np.ptp(at) or 1.0)] = np.inf
    return float(apart.min()) / 2 if np.isfinite(apart.min()) else 0.5


def _circles(ax, at, radius):
    size = np.full(len(at), 2 * radius)
    circles = EllipseCollection(size, size, np.zeros(len(at)), units="xy", offsets=at, offset_transform=ax.transData,
                                edgecolor="0.35", linewidth=0.4 if len(at) < MANY else 0)
    return ax.add_collection(circles)


def _lines(ax, network, factor, radius):
    having("network", network, "a network of forces", "segments", "force")
    lines, force = numbers("network.segments", network.segments, 3, finite=False), np.asarray(network.force, float)
    drawn = np.isfinite(lines).all((1, 2))
    lines, force = lines[drawn] * factor, force[drawn]
    top = np.abs(force).max(initial=0.0)
    if top > 0:
        shown = np.abs(force) > 1e-3 * top
        tones = np.where(force[shown] >= 0, COLOURS[0], COLOURS[1])
        ax.add_collection(LineCollection(lines[shown], linewidths=4 * np.abs(force[shown]) / top, colors=tones,
                                         capstyle="round", zorder=2))


def _frame(ax, at, radius, by):
    low, high = at.min(0) - 1.5 * radius, at.max(0) + 1.5 * radius
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    ax.set_aspect("equal")
    ax.set_xlabel(by.label.replace("length", "x"))
    ax.set_ylabel(by.label.replace("length", "y"))


@checked
def film(
    run: Any, places: Any = None, *, quantity: Any = "v", limit: Scalar | None = None, label: str | None = None,
    frames: Count | None = None, rate: Count = 20, move: Scalar = 0.0, radius: Scalar | None = None,
    units: UnitsOrWords = None,
) -> FuncAnimation:
    """A film of a run: a chain as a curve over its sites, a lattice of the plane as beads.

    `gx.plots.save(film(run, lattice), "impact.gif")`, or .mp4 where ffmpeg is installed.

    **Arguments:**

    - `run`: anything with `ts`, `us`, `vs`, of more than one time.
    - `places`: of the plane, as in `beads`; `None` for a chain.
    - `quantity`: `"v"`, `"u"` (of vectors in the plane their length), or an array over times and sites.
    - `limit` > 0: of the colour or the axis, the largest of all frames by default. `label`: as in `beads`.
    - `frames`: how many, spread over the times; all by default. `rate` a second. `move`: beads are drawn displaced by
      so many times u. `radius`, `units`: as in `beads`.

    **Returns:** an animation of matplotlib's, for `gx.plots.save`. **Raises** ValueError for a run of one time, and
    shapes that do not fit.
    """
    if not is_run(run):
        refuse("run", "a run, with ts, us and vs", f"a {type(run).__name__}")
    ts = np.asarray(run.ts, float)
    if ts.ndim != 1 or len(ts) < 2:
        refuse("run", "a run of one scene that saved several times", f"{ts.size} of shape {ts.shape}",
               "Give simulate(..., save_at=100).")
    given = quantity if isinstance(quantity, str) else None
    if given is not None:
        one_of("quantity", given, ("u", "v"))
        quantity = run.us if given == "u" else run.vs
    count = len(ts) if frames is None else min(whole("frames", frames, 2), len(ts))
    chosen = np.unique(np.round(np.linspace(0, len(ts) - 1, count)).astype(int))
    name = LABELS.get(given, "quantity") if label is None else label
    if places is None:
        return _chain_film(run, ts, chosen, quantity, limit, name, rate, units)
    return _plane_film(run, ts, chosen, places, quantity, limit, name, rate, move, radius, units, given)


def _empty(width, height):
    """A figure of its own, that no notebook shows beside the film."""
    made = figure(width, height)
    with style():
        return made, made.subplots()


def _chain_film(run, ts, chosen, quantity, limit, label, rate, units):
    data = numbers("quantity", quantity, 2, finite=False)
    if len(data) != len(ts):
        refuse("quantity", f"{len(ts)} frames, one per time of the run", f"shape {data.shape}")
    top = float(np.nanmax(np.abs(data)) or 1.0) if limit is None else float(positive("limit", limit))
    by_time, by = drawn_in(units, units_of(run), Axis("time", ts), Axis(label, top))
    made, ax = _empty(5.4, 3.0)
    (line,) = ax.plot(np.arange(data.shape[1]), scaled_by(data[0], by.factor), "o-", ms=2.5, lw=0.8, color=COLOURS[0])
    low = 0.0 if np.nanmin(data) >= 0 else -top
    ax.set(xlabel="site", ylabel=by.label, ylim=(1.08 * low * by.factor, 1.08 * top * by.factor))
    title = ax.set_title(" ")

    def show(i):
        line.set_ydata(scaled_by(data[i], by.factor))
        title.set_text(_time(ts[i], by_time))
        return line, title

    return FuncAnimation(made, show, frames=chosen, interval=1000 / whole("rate", rate, 1), blit=False)


def _time(t, by):
    unit = by.label.partition("(")[2].rstrip(")")
    return f"t = {t * by.factor:.4g}" + (f" {unit}" if unit and unit != "scaled" else "")


def _plane_film(run, ts, chosen, places, quantity, limit, label, rate, move, radius, units, given):
    at, _ = _flat(places, None)
    fields = getattr(places, "positions", places)
    names = list(fields) if isinstance(fields, dict) else [None]
    data = np.concatenate([_frames(quantity, name, fields, len(ts), given is not None) for name in names], 1)
    shift = 0.0
    if move:
        moves = [np.asarray(run.us if name is None else run.us[name], float) for name in names]
        if any(m.ndim < 3 or m.shape[-1] < 2 for m in moves):
            refuse("move", "0 for displacements out of the plane", f"{move}")
        shift = float(move) * np.concatenate([m[..., :2].reshape(len(ts), -1, 2) for m in moves], 1)
    top = float(np.nanmax(np.abs(data)) or 1.0) if limit is None else float(positive("limit", limit))
    said = units_of_both(run, None if units_of(places) is None else places, "places", "run")
    by_time, x, by = drawn_in(units, said, Axis("time", ts), Axis("length", at), Axis(label, top))
    made, ax = _empty(4.8, 4.2)
    radius = (_radius(at) if radius is None else float(positive("radius", radius))) * x.factor
    circles = _circles(ax, scaled_by(at, x.factor), radius)
    norm, name = colours_of(scaled_by(data, by.factor), top * by.factor)
    circles.set(norm=norm, cmap=name, array=data[0] * by.factor)
    add_colour_bar(ax, circles, by.label)
    _frame(ax, scaled_by(at, x.factor), radius, x)
    title = ax.set_title(" ")

    def show(i):
        circles.set_array(scaled_by(data[i], by.factor))
        if move:
            circles.set_offsets(scaled_by(at + shift[i], x.factor))
        title.set_text(_time(ts[i], by_time))
        return circles, title

    return FuncAnimation(made, show, frames=chosen, interval=1000 / whole("rate", rate, 1), blit=False)


def _frames(quantity, name, places, times, of_run):
    """Numbers (T, beads of one field); the length of vectors of a run."""
    x = np.asarray(quantity if name is None else quantity[name], float)
    shape = np.shape(places if name is None else places[name])[:-1]
    if of_run and x.ndim == len(shape) + 2:
        x = np.linalg.norm(x[..., :2], axis=-1)
    if x.shape != (times, *shape):
        refuse("quantity", f"shape {(times, *shape)}, over times and sites", f"shape {x.shape}")
    return x.reshape(times, -1)


@checked
def bands(record: Any, ax: AxesOrNone = None, *, units: UnitsOrWords = None, colour_bar: bool = True) -> Axes:
    """Bands along a path through the zone, or those of a strip coloured by the edge to which a wave is bound.

    **Arguments:** `record`: anything with `distance`, `omega` (K, bands), `names` and `marks`, such as the result of
    `gx.linear.path`; or with `k`, `omega` and `edge` (K, bands), such as that of `gx.linear.ribbon`. `units`: `"kHz"`,
    as in `granjax.plots`.

    **Returns:** the Axes; of a path `ax.lines` begins with the bands, of a strip `ax.collections[0]` are its waves.
    **Raises** ValueError for a record without these arrays.
    """
    strip = hasattr(record, "edge")
    having("record", record, "bands along a path or of a strip", "omega",
           *(("k", "edge") if strip else ("distance", "names", "marks")))
    omega = numbers("record.omega", record.omega, 2)
    (by,) = drawn_in(units, units_of(record), Axis(OMEGA, omega, "rad/s"))
    omega = scaled_by(omega, by.factor)
    ax = axes_or_new(ax, 5.0, 4.0)
    if strip:
        k, edge = numbers("record.k", record.k, 1), numbers("record.edge", record.edge, 2)
        shown = ax.scatter(np.broadcast_to(k[:, None], omega.shape), omega, c=edge, s=3, cmap="coolwarm", vmin=-1,
                           vmax=1, linewidths=0)
        ax.set_xlabel("wave number $k$ (rad/cell)")
        ax.set_xlim(k.min(), k.max())
        if colour_bar:
            add_colour_bar(ax, shown, "place across the strip")
    else:
        x = numbers("record.distance", record.distance, 1)
        for band in omega.T:
            ax.plot(x, band, color=COLOURS[0])
        marks = x[np.asarray(record.marks, int)]
        for mark in marks[1:-1]:
            ax.axvline(mark, color=FAINT, lw=0.6, zorder=0)
        ax.set_xticks(marks, [r"$\Gamma$" if name == "G" else name for name in record.names])
        ax.set_xlim(x[0], x[-1])
    ax.set_ylim(min(0.0, 1.05 * float(np.nanmin(omega))), 1.05 * float(np.nanmax(omega)) or 1.0)
    ax.set_ylabel(by.label)
    return ax


@checked
def zone(
    record: Any, band: Count = 0, ax: AxesOrNone = None, *, levels: Count = 12, velocity: bool = False,
    units: UnitsOrWords = None, colour_bar: bool = True,
) -> Axes:
    """Contours of equal frequency of a band over the Brillouin zone, whose edge is drawn.

    **Arguments:** `record`: anything with `q` (n, m, 2), `omega` (n, m, bands), `velocity` (n, m, bands, 2) and
    `corners` (c, 2), such as the result of `gx.linear.zone_map`. `band`: counted from the lowest. `levels`: how many
    contours. `velocity`: whether arrows show the group velocity. `units`: `"kHz"`, as in `granjax.plots`.

    **Returns:** the Axes; the frequencies are `ax.collections[0]`. **Raises** ValueError for a record without these
    arrays, or a band that is not there.
    """
    having("record", record, "frequencies over a zone", "q", "omega", "velocity", "corners")
    q, omega = numbers("record.q", record.q, 3), numbers("record.omega", record.omega, 3)
    if not 0 <= whole("band", band) < omega.shape[-1]:
        refuse("band", f"a number below {omega.shape[-1]}", f"{band}")
    by, place = drawn_in(units, units_of(record), Axis(OMEGA, omega, "rad/s"), Axis("wave number", q, "1/m"))
    w = scaled_by(omega[..., band], by.factor)
    x = scaled_by(q, place.factor)
    ax = axes_or_new(ax, 5.0, 4.2)
    shown = ax.pcolormesh(x[..., 0], x[..., 1], w, cmap="viridis", shading="nearest", rasterized=True)
    ax.contour(x[..., 0], x[..., 1], w, levels=whole("levels", levels, 1), colors="white", linewidths=0.7)
    if velocity:
        v = numbers("record.velocity", record.velocity, 4, finite=False)[..., band, :]
        step = max(1, len(x) // 14)
        some = (slice(step // 2, None, step),) * 2
        ax.quiver(x[some][..., 0], x[some][..., 1], v[some][..., 0], v[some][..., 1], color="white", width=0.004)
    ax.add_patch(Polygon(scaled_by(np.asarray(record.corners), place.factor), fill=False, edgecolor="black", lw=1.2))
    ax.set_aspect("equal")
    ax.set_xlabel(place.label.replace("wave number", "$q_x$"))
    ax.set_ylabel(place.label.replace("wave number", "$q_y$"))
    if colour_bar:
        add_colour_bar(ax, shown, by.label)
    return ax


@checked
def radial_profile(
    record: Any, ax: AxesOrNone = None, *, label: str = "quantity", units: UnitsOrWords = None,
) -> Axes:
    """Means of rings over the distance from a point, with the span of each ring; of several times from pale to dark.

    **Arguments:** `record`: anything with `distance` (rings,), `mean`, `lowest` and `highest` ([times], rings), such as
    the result of `gx.measures.radial_profile`. `label`: of the quantity; one that ends with a known word, "energy", has
    units. `units`: `("mm", "uJ")`, as in `granjax.plots`.

    **Returns:** the Axes; the means are `ax.lines`. **Raises** ValueError for a record without these arrays.
    """
    having("record", record, "the result of gx.measures.radial_profile", "distance", "mean", "lowest", "highest")
    x = numbers("record.distance", record.distance, 1)
    mean, low, high = (np.atleast_2d(numbers(f"record.{name}", getattr(record, name)))
                       for name in ("mean", "lowest", "highest"))
    by_x, by_y = drawn_in(units, units_of(record), Axis("distance", x, "m"), Axis(label, mean))
    ax = axes_or_new(ax, 5.4, 3.6)
    x = scaled_by(x, by_x.factor)
    tones = colormaps["viridis"](np.linspace(0.85, 0.15, len(mean)) if len(mean) > 1 else [0.3])
    for one, bottom, top, tone in zip(*(scaled_by(a, by_y.factor) for a in (mean, low, high)), tones):
        ax.plot(x, one, color=tone, lw=1.4)
        ax.fill_between(x, bottom, top, color=tone, alpha=0.2, lw=0)
    ax.set_xlim(0, x[-1])
    ax.set_xlabel(by_x.label)
    ax.set_ylabel(by_y.label)
    return ax
