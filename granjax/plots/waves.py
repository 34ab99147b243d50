"""Linear waves: dispersion with spectra, Floquet-Bloch bands, bands of the plane, transmission."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.patches import Polygon

from ..base.checks import refuse, within
from ..base.types import Count, Parameter, Scalar
from ..base.units.names import known_unit
from .arrays import Samples, numbers
from .style import (
    COLOURS,
    FAINT,
    OMEGA,
    AxesOrNone,
    Shown,
    add_colour_bar,
    add_legend,
    axes_or_new,
    colour,
    new_label,
    shown,
    units_of,
)

# The smallest gap that is drawn, as a fraction of the largest frequency.
CLOSED = 1e-6
# The smallest gap below all bands that is drawn, as the same fraction.
FOOT = 0.05
# The rounding of the imaginary part of a real wave number, of either sign.
TRAVELS = 1e-7


def dispersion(
    dispersion_record: Any,
    ax: AxesOrNone = None,
    *,
    spectrum: Any = None,
    floor: Scalar = 1e-6,
) -> Axes:
    """Draw the dispersion relation of a chain with its gaps, optionally over a spectrum.

    **Arguments:**

    - `dispersion_record`: anything with `k` (K,) [rad per cell], `omega` (K, bands) and `cell`,
      such as from `gx.linear.dispersion`. A gap is shaded where one band lies below the next at all
      given k, so give at least half a zone.
    - `spectrum`: anything with `k` (S,) [rad per site], `omega` (W,) and `power` (S, W), such as
      from `gx.measures.spectrum`; drawn on a logarithmic scale down to `floor` in (0, 1) of its
      largest power. The axis is then the wave number per site, with the bands repeated over the
      zones of the spectrum.

    **Returns:** the Axes; `ax.lines` holds the bands, the spectrum is `ax.collections[0]`.
    **Raises** ValueError for a lattice with more than one axis.

    **Example:**

    >>> chain = gx.scenes.dimer(20, ratio=0.5, precompression=1.0, boundary="periodic")
    >>> ax = gx.plots.dispersion(gx.linear.dispersion(chain, np.linspace(0, np.pi, 31)))
    >>> len(ax.lines)  # two bands
    2
    """
    record = dispersion_record
    k = np.asarray(record.k)
    omega = numbers("dispersion_record.omega", record.omega, finite=False)
    if k.ndim != 1 or omega.shape[:-1] != k.shape or len(k) < 2:
        refuse(
            "dispersion_record",
            "k of shape (K,) and omega (K, bands), of a chain",
            f"shapes {k.shape} and {omega.shape}",
            "Draw a path through a plane's zone with plots.bands(linear.path(...)).",
        )
    by, _ = _frequencies(record, spectrum)
    order = np.argsort(k)
    cell = int(np.prod(record.cell))
    k = k[order]
    omega = by(omega[order])
    ax = axes_or_new(ax, 5.4, 4.0)
    if spectrum is None:
        span = k[0], k[-1]
        _along(ax, cell, span)
        ax.plot(k, omega, color=COLOURS[0], lw=1.6, zorder=2)
    else:
        low = float(within("floor", floor, 0, 1, open_low=True, open_high=True))
        image, span = _under(ax, spectrum, by, low)
        _along(ax, 1, span)
        _zones(ax, k, omega, cell, span)
        add_colour_bar(ax, image, "power (relative)")
    for low, high in _gaps(omega):
        ax.axhspan(low, high, color=COLOURS[3], alpha=0.22, lw=0, zorder=1.5)
        where = {"transform": ax.get_yaxis_transform(), "ha": "right", "va": "center"}
        ax.text(0.98, (low + high) / 2, "gap", size="small", color="0.35", **where)
    _from_zero(ax, by, omega, 1.15)
    return ax


def _frequencies(record, *others):
    # Return the scale of the frequencies and these as they are drawn.
    by = shown(OMEGA, record.omega, "rad/s", units_of(record, *others))
    return by, by(record.omega)


def _from_zero(ax, by, omega, room):
    ax.set_ylabel(by.label)
    ax.set_ylim(min(0.0, 1.1 * np.nanmin(omega)), room * np.nanmax(omega) or 1.0)


def _along(ax, cell, span):
    per = "site" if cell == 1 else f"cell of {cell} sites"
    ax.set_xlabel(f"wave number $k$ (rad/{per})")
    ax.set_xlim(*span)
    first, last = np.array(span) / (np.pi / 2)
    places = np.arange(np.ceil(first - 1e-6), np.floor(last + 1e-6) + 1).astype(int)
    if 2 <= len(places) <= 9:
        ax.set_xticks(places * np.pi / 2, [_name(n) for n in places])


def _name(halves):
    if halves == 0:
        return "0"
    n, under = (halves // 2, "") if halves % 2 == 0 else (halves, "/2")
    return rf"${'-' if n < 0 else ''}{'' if abs(n) == 1 else abs(n)}\pi{under}$"


def _under(ax, spectrum, by, floor):
    k = np.asarray(spectrum.k)
    w = np.asarray(spectrum.omega)
    power = np.asarray(spectrum.power)
    if power.shape != (len(k), len(w)):
        wanted = f"shape {(len(k), len(w))}, wave numbers by frequencies"
        remedy = "Of a batch pick one lane."
        refuse("spectrum.power", wanted, f"shape {power.shape}", remedy)
    share = np.maximum(power.T / np.nanmax(power), floor)
    look = {"norm": LogNorm(floor, 1.0), "cmap": "Blues", "shading": "nearest"}
    image = ax.pcolormesh(k, by(w), share, rasterized=True, zorder=0, **look)
    half = (k.max() - k.min()) / (2 * max(len(k) - 1, 1))
    return image, (k.min() - half, k.max() + half)


def _zones(ax, k, omega, cell, span):
    if k.min() >= 0 or k.max() <= 0:
        k = np.concatenate([-k, k])
        omega = np.concatenate([omega, omega])
        order = np.argsort(k, kind="stable")
        k = k[order]
        omega = omega[order]
    reach = int(np.ceil(max(map(abs, span)) * cell / (2 * np.pi))) if cell > 1 else 0
    for shift in range(-reach, reach + 1):
        ax.plot((k + 2 * np.pi * shift) / cell, omega, color=COLOURS[1], lw=0.8, zorder=2)


def _gaps(omega):
    low = np.nanmin(omega, 0)
    high = np.nanmax(omega, 0)
    least = CLOSED * np.nanmax(np.abs(omega))
    gaps = [(a, b) for a, b in zip(high[:-1], low[1:]) if b - a > least]
    # Also below the lowest band, unless the gap is there only because k = 0 was not sampled.
    below = [(0.0, low[0])] if low[0] > max(least, FOOT * high[-1]) else []
    return below + gaps


def floquet_bands(bands: Any, ax: AxesOrNone = None) -> Axes:
    """Draw the quasi-frequencies and growth rate of a modulated chain, k-gaps shaded.

    **Arguments:** `bands`: anything with `k` (K,), `omega` and `growth` (K, multipliers), `edges`
    (gaps, 2) or `None`, `period`, `cell`, such as from `gx.linear.floquet_bands`.

    **Returns:** the Axes; `ax.lines[0]` holds the waves that do not grow, `ax.lines[1]` the growing
    ones; the axis of the largest growth rate is the last of `ax.figure.axes`. **Raises** ValueError
    for several axes.
    """
    k = np.asarray(bands.k)
    rate = np.asarray(bands.growth)
    by, omega = _frequencies(bands)
    grows = np.asarray(getattr(bands, "grows", rate > 0))
    span = k.min(), k.max()
    along = np.broadcast_to(k[:, None], omega.shape)
    ax = axes_or_new(ax, 5.4, 4.0)
    for which, tone in ((~grows, COLOURS[0]), (grows, COLOURS[1])):
        ax.plot(along[which], omega[which], ".", ms=3, color=tone, zorder=2)
    for low, high in () if bands.edges is None else np.asarray(bands.edges):
        low, high = np.clip((low, high), *span)
        ax.axvspan(low, high, color=COLOURS[3], alpha=0.22, lw=0, zorder=1)
    half = by(np.pi / float(bands.period))
    _along(ax, int(np.prod(bands.cell)), span)
    ax.set_ylim(-1.05 * half, 1.05 * half)
    ax.set_ylabel(by.label)
    by = shown("growth rate", bands.growth, "1/s", units_of(bands))
    largest = by(np.maximum(rate.max(-1), 0))
    right = ax.twinx()
    right.spines["right"].set(visible=True, color=COLOURS[2])
    right.tick_params(axis="y", colors=COLOURS[2])
    order = np.argsort(k)
    right.plot(k[order], largest[order], color=COLOURS[2], lw=1.2)
    right.set_ylim(0, 2.5 * largest.max() or 1.0)
    right.set_ylabel(by.label, color=COLOURS[2])
    return ax


def bands(record: Any, ax: AxesOrNone = None) -> Axes:
    """Draw bands along a path through the zone, or those of a strip coloured by edge.

    **Arguments:** `record`: anything with `distance`, `omega` (K, bands), `names` and `marks`, such
    as from `gx.linear.path`; or with `k`, `omega` and `edge` (K, bands), such as from
    `gx.linear.ribbon`.

    **Returns:** the Axes; for a path `ax.lines` begins with the bands, for a strip
    `ax.collections[0]` holds the waves.
    """
    if not (hasattr(record, "omega") and (hasattr(record, "edge") or hasattr(record, "distance"))):
        remedy = "Draw gx.linear.path(...), or gx.linear.dispersion(...) by gx.plots.dispersion."
        refuse("record", "bands along a path or of a strip", f"a {type(record).__name__}", remedy)
    by, omega = _frequencies(record)
    ax = axes_or_new(ax, 5.0, 4.0)
    if hasattr(record, "edge"):
        x = np.asarray(record.k)
        edge = np.asarray(record.edge)
        ax.plot(x, omega, color=FAINT, lw=0.5, zorder=0)
        look = {"c": edge, "s": 3, "cmap": "coolwarm", "vmin": -1, "vmax": 1, "linewidths": 0}
        strip = ax.scatter(np.broadcast_to(x[:, None], omega.shape), omega, **look)
        _along(ax, 1, (x.min(), x.max()))
        ax.set_xlabel("wave number $k$ (rad/cell)")
        add_colour_bar(ax, strip, "place across the strip")
    else:
        x = np.asarray(record.distance)
        ax.plot(x, omega, color=COLOURS[0])
        marks = x[np.asarray(record.marks, int)]
        for mark in marks[1:-1]:
            ax.axvline(mark, color=FAINT, lw=0.6, zorder=0)
        ax.set_xticks(marks, [r"$\Gamma$" if name == "G" else name for name in record.names])
        ax.set_xlim(x.min(), x.max())
    _from_zero(ax, by, omega, 1.05)
    return ax


def zone(
    record: Any,
    band: Count = 0,
    ax: AxesOrNone = None,
    *,
    levels: Count = 12,
    velocity: bool = False,
) -> Axes:
    """Draw contours of equal frequency of a band over the Brillouin zone.

    **Arguments:** `record`: anything with `q` (n, m, 2), `omega` (n, m, bands), `velocity`
    (n, m, bands, 2) and `corners` (c, 2), such as from `gx.linear.zone_map`. `band`: counted from
    the lowest. `levels`: number of contours. `velocity`: whether arrows show the group velocity.

    **Returns:** the Axes; the frequencies are `ax.collections[0]`.
    """
    by, omega = _frequencies(record)
    place = shown("wave number", record.q, "1/m", units_of(record))
    x, y = np.moveaxis(place(record.q), -1, 0)
    w = omega[..., band]
    ax = axes_or_new(ax, 5.0, 4.2)
    image = ax.pcolormesh(x, y, w, cmap="viridis", shading="nearest", rasterized=True)
    ax.contour(x, y, w, levels=levels, colors="white", linewidths=0.7)
    if velocity:
        v = np.asarray(record.velocity)[..., band, :]
        step = max(1, len(x) // 14)
        some = (slice(step // 2, None, step),) * 2
        ax.quiver(x[some], y[some], v[some][..., 0], v[some][..., 1], color="white", width=0.004)
    ax.add_patch(Polygon(place(record.corners), fill=False, edgecolor="black", lw=1.2))
    names = {f"{x}label": place.label.replace("wave number", f"$q_{x}$") for x in "xy"}
    ax.set(aspect="equal", **names)
    add_colour_bar(ax, image, by.label)
    return ax


def density_of_states(record: Any, ax: AxesOrNone = None) -> Axes:
    """Draw a density of states over frequency, with its error as a band.

    **Arguments:** `record`: anything with `omega`, `density` and `error` (W,), such as from
    `gx.linear.density_of_states`. **Returns:** the Axes; `ax.lines[0]` is the density.
    """
    x, omega = _frequencies(record)
    y = shown("density of states", record.density, "s/rad", units_of(record))
    own = known_unit(y.unit)
    per = x.unit and known_unit(x.unit).inverse
    if own and per and own.dimension == per.dimension:
        y = Shown(own.size / per.size, f"density of states ({per.label})", per.label)
    density = y(record.density)
    error = y(record.error)
    ax = axes_or_new(ax, 5.0, 3.4)
    ax.step(omega, density, where="mid", color=COLOURS[0])
    ax.fill_between(omega, density - error, density + error, step="mid", color=FAINT, lw=0)
    ax.set(xlabel=x.label, ylabel=y.label, xlim=(omega.min(), omega.max()))
    ax.set_ylim(0, None)
    return ax


def complex_bands(record: Any, ax: AxesOrNone = None) -> Axes:
    """Draw complex wave numbers against frequency: Re k right of zero, -Im k left.

    **Arguments:** `record`: anything with `omega` (W,) and `k` (W, waves), such as from
    `gx.linear.complex_bands`; of each pair only the wave that decays to the right is drawn.
    **Returns:** the Axes; `ax.collections` are the real and the imaginary parts.
    """
    by, omega = _frequencies(record)
    k = np.asarray(record.k)
    at = np.broadcast_to(omega[:, None], k.shape)
    right = k.imag >= -TRAVELS
    ax = axes_or_new(ax, 5.0, 4.0)
    look = {"s": 4, "linewidths": 0}
    for part, tone, name in (
        (np.abs(k.real), COLOURS[0], "Re $k$"),
        (-k.imag, COLOURS[1], "-Im $k$"),
    ):
        ax.scatter(part[right], at[right], color=tone, label=name, **look)
    ax.axvline(0, color=FAINT, lw=0.8, zorder=0)
    ax.set_xlabel("wave number $k$ (rad/cell)")
    _from_zero(ax, by, omega, 1.05)
    add_legend(ax)
    return ax


def transmission(
    mass_ratio: Parameter,
    transmission: Samples,
    ax: AxesOrNone = None,
    *,
    resonances: Parameter | None = None,
    anti_resonances: Parameter | None = None,
    label: str | Sequence[str] | None = None,
    y_label: str = "force / monomer's force",
) -> Axes:
    """Draw the transmitted force of a dimer chain over the mass ratio, relative to the monomer's.

    **Arguments:** `mass_ratio`: light over heavy, (R,), in (0, 1]; `transmission`: (R,), or (R, C)
    for C curves; `resonances`, `anti_resonances`: mass ratios to mark, with dashed and dotted
    lines; `label`: of the curve, or one per curve; `y_label`: of the axis; a unit in it, "peak
    force (N)", marks absolute values.

    **Returns:** the Axes. **Raises** ValueError for ratios outside (0, 1] or shapes that do not
    fit.
    """
    ratios = np.asarray(within("mass_ratio", mass_ratio, 0, 1, open_low=True))
    by = shown(y_label, transmission)
    values = by(numbers("transmission", transmission, finite=False)).reshape(len(ratios), -1)
    labels = [label] * values.shape[1] if label is None or isinstance(label, str) else label
    ax = axes_or_new(ax, 5.6, 3.6)
    order = np.argsort(ratios)
    for i, (column, name) in enumerate(zip(values.T, labels)):
        ax.plot(ratios[order], column[order], color=colour(i), label=name)
    for places, name, tone, dash in (
        (resonances, "resonance", COLOURS[1], "--"),
        (anti_resonances, "anti-resonance", COLOURS[2], ":"),
    ):
        for place in np.ravel([] if places is None else places):
            ax.axvline(place, color=tone, ls=dash, lw=1.2, zorder=1, label=new_label(ax, name))
    ax.set(xlabel=r"mass ratio $\varepsilon$ (light / heavy)", ylabel=by.label, xlim=(0, 1.01))
    ax.set_ylim(0, 1.12 * max(0.0 if by.unit else 1.0, np.nanmax(values)))
    if not by.unit:
        ax.axhline(1.0, color=FAINT, lw=0.8, zorder=0)
    add_legend(ax)
    return ax
