"""The plane: beads as circles with their forces, bands along a path, the zone's frequencies."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.patches import Polygon

from ..checks import positive, refuse, whole
from ..types import Count, Scalar
from ..units import UnitsOrWords
from .arrays import numbers
from .histories import colours_of
from .quantities import OMEGA, Axis, Shown, drawn_in, scaled_by, units_of
from .style import COLOURS, FAINT, AxesOrNone, add_colour_bar, axes_or_new

CLOSED = 1e-9
# beads whose outlines would hide them
MANY = 3000


def beads(
    places: Any,
    values: Any = None,
    ax: AxesOrNone = None,
    *,
    network: Any = None,
    radius: Scalar | None = None,
    label: str = "quantity",
    limit: Scalar | None = None,
    units: UnitsOrWords = None,
    colour_bar: bool = True,
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

    **Example:**

    >>> places, values = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.87]]), np.array([1.0, 0.5, 0.0])
    >>> ax = gx.plots.beads(places, values, label="energy")
    >>> len(ax.collections[0].get_offsets())
    3
    """
    said = units_of(places)
    at, data = flat(places, values)
    x, *by = drawn_in(
        units, said, Axis("length", at), *(() if data is None else (Axis(label, data),))
    )
    ax = axes_or_new(ax, 4.8, 4.2)
    radius = half_spacing(at) if radius is None else float(positive("radius", radius))
    circles = circles_of(ax, scaled_by(at, x.factor), radius * x.factor)
    if network is not None:
        _lines(ax, network, x.factor, radius * x.factor)
    if data is None:
        circles.set_facecolor("0.85")
    else:
        data = scaled_by(data, by[0].factor)
        top = (
            np.nanmax(np.abs(data))
            if limit is None
            else float(positive("limit", limit)) * by[0].factor
        )
        norm, name = colours_of(data[None], top or 1.0)
        circles.set(array=data, norm=norm, cmap=name)
        if colour_bar:
            add_colour_bar(ax, circles, by[0].label)
    frame(ax, scaled_by(at, x.factor), radius * x.factor, x)
    return ax


def flat(
    places: Any, values: Any
) -> tuple[Float[np.ndarray, "N 2"], Float[np.ndarray, " N"] | None]:
    """Places (N, 2) and numbers (N,), `None` of none, of all fields, one after the other."""
    if getattr(places, "lanes", ()):
        refuse(
            "places", "one lattice", f"a batch of {places.lanes}", "Take a lane, or its positions."
        )
    places = getattr(places, "positions", places)
    if places is None:
        refuse(
            "places",
            "a lattice with positions, or an array (..., 2)",
            "a lattice without positions",
        )
    fields = places if isinstance(places, dict) else {"": places}
    held = values if isinstance(values, dict) else {"": values}
    at, data = [], []
    for name, x in fields.items():
        x = numbers("places", x)
        if x.ndim < 2 or x.shape[-1] != 2:
            more = (
                "Of places in space give two components: positions[:, :2]."
                if x.shape[-1:] == (3,)
                else ""
            )
            refuse("places", "an array (..., 2)", f"shape {x.shape}", more)
        at.append(x.reshape(-1, 2))
        if values is not None:
            value = numbers("values", held[name], finite=False)
            if value.shape != x.shape[:-1]:
                refuse(
                    "values", f"shape {x.shape[:-1]}, one number per bead", f"shape {value.shape}"
                )
            data.append(value.ravel())
    return np.concatenate(at), np.concatenate(data) if data else None


def half_spacing(at: Float[np.ndarray, "N 2"]) -> float:
    """Half of the least distance between some of the beads and all others."""
    some = at[:: max(1, len(at) // 64)]
    apart = np.linalg.norm(some[:, None] - at, axis=-1)
    apart[apart < CLOSED * (np.ptp(at) or 1.0)] = np.inf
    return float(apart.min()) / 2 if np.isfinite(apart.min()) else 0.5


def circles_of(ax: Axes, at: Float[np.ndarray, "N 2"], radius: Scalar) -> EllipseCollection:
    """Circles of one radius at some places."""
    size = np.full(len(at), 2 * radius)
    circles = EllipseCollection(
        size,
        size,
        np.zeros(len(at)),
        units="xy",
        offsets=at,
        offset_transform=ax.transData,
        edgecolor="0.35",
        linewidth=0.4 if len(at) < MANY else 0,
    )
    return ax.add_collection(circles)


def _lines(ax, network, factor, radius):
    lines, force = (
        numbers("network.segments", network.segments, 3, finite=False),
        np.asarray(network.force, float),
    )
    drawn = np.isfinite(lines).all((1, 2))
    lines, force = lines[drawn] * factor, force[drawn]
    top = np.abs(force).max(initial=0.0)
    if top > 0:
        shown = np.abs(force) > 1e-3 * top
        tones = np.where(force[shown] >= 0, COLOURS[0], COLOURS[1])
        ax.add_collection(
            LineCollection(
                lines[shown],
                linewidths=4 * np.abs(force[shown]) / top,
                colors=tones,
                capstyle="round",
                zorder=2,
            )
        )


def frame(ax: Axes, at: Float[np.ndarray, "N 2"], radius: Scalar, by: Shown) -> None:
    """Limits about all beads, equal scales, labels x and y."""
    low, high = at.min(0) - 1.5 * radius, at.max(0) + 1.5 * radius
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    ax.set_aspect("equal")
    ax.set_xlabel(by.label.replace("length", "x"))
    ax.set_ylabel(by.label.replace("length", "y"))


def bands(
    record: Any, ax: AxesOrNone = None, *, units: UnitsOrWords = None, colour_bar: bool = True
) -> Axes:
    """Bands along a path through the zone, or those of a strip coloured by the edge to which a wave is bound.

    **Arguments:** `record`: anything with `distance`, `omega` (K, bands), `names` and `marks`, such as the result of
    `gx.linear.path`; or with `k`, `omega` and `edge` (K, bands), such as that of `gx.linear.ribbon`. `units`: `"kHz"`,
    as in `granjax.plots`.

    **Returns:** the Axes; of a path `ax.lines` begins with the bands, of a strip `ax.collections[0]` are its waves.

    **Example:**

    >>> strip = gx.scenes.honeycomb(4, 6, out_of_plane=True, boundary=("periodic", "free"))
    >>> ax = gx.plots.bands(gx.linear.ribbon(strip, np.linspace(0, 2 * np.pi, 13)))
    >>> ax.get_xlabel()
    'wave number $k$ (rad/cell)'
    """
    strip = hasattr(record, "edge")
    omega = numbers("record.omega", record.omega, 2)
    (by,) = drawn_in(units, units_of(record), Axis(OMEGA, omega, "rad/s"))
    omega = scaled_by(omega, by.factor)
    ax = axes_or_new(ax, 5.0, 4.0)
    if strip:
        k, edge = numbers("record.k", record.k, 1), numbers("record.edge", record.edge, 2)
        shown = ax.scatter(
            np.broadcast_to(k[:, None], omega.shape),
            omega,
            c=edge,
            s=3,
            cmap="coolwarm",
            vmin=-1,
            vmax=1,
            linewidths=0,
        )
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


def zone(
    record: Any,
    band: Count = 0,
    ax: AxesOrNone = None,
    *,
    levels: Count = 12,
    velocity: bool = False,
    units: UnitsOrWords = None,
    colour_bar: bool = True,
) -> Axes:
    """Contours of equal frequency of a band over the Brillouin zone, whose edge is drawn.

    **Arguments:** `record`: anything with `q` (n, m, 2), `omega` (n, m, bands), `velocity` (n, m, bands, 2) and
    `corners` (c, 2), such as the result of `gx.linear.zone_map`. `band`: counted from the lowest. `levels`: how many
    contours. `velocity`: whether arrows show the group velocity. `units`: `"kHz"`, as in `granjax.plots`.

    **Returns:** the Axes; the frequencies are `ax.collections[0]`.

    **Example:**

    >>> from types import SimpleNamespace
    >>> q = np.stack(np.meshgrid(*[np.linspace(-np.pi, np.pi, 9)] * 2, indexing="ij"), axis=-1)
    >>> omega = 2 * np.sqrt(np.sin(q / 2) ** 2 @ np.ones((2, 1)))  # a square of springs
    >>> corners = np.pi * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    >>> ax = gx.plots.zone(SimpleNamespace(q=q, omega=omega, velocity=0 * q[:, :, None], corners=corners))
    >>> len(ax.collections) > 1  # colours and contours
    True
    """
    q, omega = numbers("record.q", record.q, 3), numbers("record.omega", record.omega, 3)
    by, place = drawn_in(
        units, units_of(record), Axis(OMEGA, omega, "rad/s"), Axis("wave number", q, "1/m")
    )
    w = scaled_by(omega[..., band], by.factor)
    x = scaled_by(q, place.factor)
    ax = axes_or_new(ax, 5.0, 4.2)
    shown = ax.pcolormesh(
        x[..., 0], x[..., 1], w, cmap="viridis", shading="nearest", rasterized=True
    )
    ax.contour(
        x[..., 0], x[..., 1], w, levels=whole("levels", levels, 1), colors="white", linewidths=0.7
    )
    if velocity:
        v = numbers("record.velocity", record.velocity, 4, finite=False)[..., band, :]
        step = max(1, len(x) // 14)
        some = (slice(step // 2, None, step),) * 2
        ax.quiver(
            x[some][..., 0],
            x[some][..., 1],
            v[some][..., 0],
            v[some][..., 1],
            color="white",
            width=0.004,
        )
    ax.add_patch(
        Polygon(
            scaled_by(np.asarray(record.corners), place.factor),
            fill=False,
            edgecolor="black",
            lw=1.2,
        )
    )
    ax.set_aspect("equal")
    ax.set_xlabel(place.label.replace("wave number", "$q_x$"))
    ax.set_ylabel(place.label.replace("wave number", "$q_y$"))
    if colour_bar:
        add_colour_bar(ax, shown, by.label)
    return ax


def radial_profile(
    record: Any,
    ax: AxesOrNone = None,
    *,
    label: str = "quantity",
    units: UnitsOrWords = None,
) -> Axes:
    """Means of rings over the distance from a point, with the span of each ring; of several times from pale to dark.

    **Arguments:** `record`: anything with `distance` (rings,), `mean`, `lowest` and `highest` ([times], rings), such as
    the result of `gx.measures.radial_profile`. `label`: of the quantity; one that ends with a known word, "energy", has
    units. `units`: `("mm", "uJ")`, as in `granjax.plots`.

    **Returns:** the Axes; the means are `ax.lines`.

    **Example:**

    >>> from types import SimpleNamespace
    >>> rings = SimpleNamespace(distance=np.arange(1.0, 5.0), mean=1 / np.arange(1.0, 5.0), lowest=np.zeros(4),
    ...                         highest=np.ones(4))
    >>> ax = gx.plots.radial_profile(rings, label="energy")
    >>> ax.get_ylabel()
    'energy'
    """
    x = numbers("record.distance", record.distance, 1)
    mean, low, high = (
        np.atleast_2d(numbers(f"record.{name}", getattr(record, name)))
        for name in ("mean", "lowest", "highest")
    )
    by_x, by_y = drawn_in(units, units_of(record), Axis("distance", x, "m"), Axis(label, mean))
    ax = axes_or_new(ax, 5.4, 3.6)
    x = scaled_by(x, by_x.factor)
    tones = colormaps["viridis"](np.linspace(0.85, 0.15, len(mean)) if len(mean) > 1 else [0.3])
    for one, bottom, top, tone in zip(
        *(scaled_by(a, by_y.factor) for a in (mean, low, high)), tones
    ):
        ax.plot(x, one, color=tone, lw=1.4)
        ax.fill_between(x, bottom, top, color=tone, alpha=0.2, lw=0)
    ax.set_xlim(0, x[-1])
    ax.set_xlabel(by_x.label)
    ax.set_ylabel(by_y.label)
    return ax
