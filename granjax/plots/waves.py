"""Dispersion with the spectrum of a simulation under it; Floquet-Bloch bands with their growth."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from ..checks import refuse, within
from ..types import Scalar
from ..units import UnitsOrWords
from .arrays import numbers
from .quantities import OMEGA, Axis, drawn_in, scaled_by, units_of, units_of_both
from .style import COLOURS, AxesOrNone, add_colour_bar, axes_or_new

CLOSED = 1e-6


def dispersion(
    dispersion_record: Any,
    ax: AxesOrNone = None,
    *,
    spectrum: Any = None,
    floor: Scalar = 1e-6,
    units: UnitsOrWords = None,
    colour_bar: bool = True,
) -> Axes:
    """Dispersion relation of a chain, with a spectrum over wave number and frequency under it and gaps shaded.

    **Arguments:**

    - `dispersion_record`: anything with `k` (K,) [rad per cell], `omega` (K, bands) and `cell`, such as the result of
      `gx.linear.dispersion`. A gap is shaded where all frequencies of one band lie below those of the next over the
      given k, so give half a zone at least.
    - `spectrum`: anything with `k` (S,) [rad per site], `omega` (W,) and `power` (S, W), such as the result of
      `gx.measures.spectrum`; drawn on a logarithmic scale down to `floor` in (0, 1) of its largest power. The axis is
      then the wave number per site, with the bands repeated over the zones that the spectrum spans.
    - `units`: `"kHz"` or `"rad/s"`, as in `granjax.plots`.

    **Returns:** the Axes; `ax.lines` holds the bands, the spectrum is `ax.collections[0]`.
    **Raises** ValueError for the record of a lattice with more than one axis.

    **Example:**

    >>> chain = gx.scenes.dimer(20, ratio=0.5, precompression=1.0, boundary="periodic")
    >>> ax = gx.plots.dispersion(gx.linear.dispersion(chain, np.linspace(0, np.pi, 31)))
    >>> len(ax.lines)  # two bands
    2
    """
    k, omega, cell = _bands(dispersion_record)
    said = units_of_both(dispersion_record, spectrum, "spectrum", "dispersion")
    (by,) = drawn_in(units, said, Axis(OMEGA, omega, "rad/s"))
    omega = scaled_by(omega, by.factor)
    ax = axes_or_new(ax, 5.4, 4.0)
    if spectrum is None:
        span = float(k.min()), float(k.max())
        ax.set_xlabel(
            "wave number $k$ (rad/site)"
            if cell == 1
            else f"wave number $k$ (rad/cell of {cell} sites)"
        )
        _lines(ax, k, omega, COLOURS[0], lw=1.6)
    else:
        image, span = _under(
            ax,
            spectrum,
            by.factor,
            float(within("floor", floor, 0, 1, open_low=True, open_high=True)),
        )
        ax.set_xlabel("wave number $k$ (rad/site)")
        _zones(ax, k, omega, cell, span)
        if colour_bar:
            add_colour_bar(ax, image, "power (relative)")
    top = 1.15 * float(np.nanmax(omega)) or 1.0
    shaded = False
    for low, high in _gaps(omega):
        ax.axhspan(
            low,
            high,
            color=COLOURS[3],
            alpha=0.22,
            lw=0,
            zorder=1.5,
            label=None if shaded else "gap",
        )
        shaded = True
    ax.set_xlim(*span)
    ax.set_ylim(min(0.0, 1.1 * float(np.nanmin(omega))), top)
    _ticks(ax, span)
    ax.set_ylabel(by.label)
    return ax


def floquet_bands(
    bands: Any, ax: AxesOrNone = None, *, growth: bool = True, units: UnitsOrWords = None
) -> Axes:
    """Quasi-frequencies of a modulated chain over the wave number, k-gaps shaded, with the growth rate on the right.

    **Arguments:** `bands`: anything with `k` (K,), `omega` and `growth` (K, multipliers), `edges` (gaps, 2) or `None`,
    `period`, `cell`, such as the result of `gx.linear.floquet_bands`. `growth`: whether the largest growth rate is
    drawn, on an axis of its own. `units`: `"kHz"`, `"rad/s"`, `"1/ms"`, as in `granjax.plots`.

    **Returns:** the Axes; `ax.lines[0]` holds the waves that do not grow, `ax.lines[1]` those that do, the axis of the
    growth is `ax.child_axes[0]`. **Raises** ValueError for the record of several axes.

    **Example:**

    >>> crystal = gx.scenes.modulated(12, amplitude=0.1, omega=2.0, shape="square")
    >>> ax = gx.plots.floquet_bands(gx.linear.floquet_bands(crystal, np.linspace(0, np.pi, 13), period=np.pi))
    >>> ax.child_axes[0].get_ylabel()
    'growth rate (scaled)'
    """
    omega = numbers("bands.omega", bands.omega, 2)
    k, rate = numbers("bands.k", bands.k, 1), numbers("bands.growth", bands.growth, 2)
    axes = [Axis(OMEGA, omega, "rad/s"), Axis("growth rate", rate, "1/s")][: 1 + growth]
    by, *grown = drawn_in(units, units_of(bands), *axes)
    ax = axes_or_new(ax, 5.4, 4.0)
    order = np.argsort(k)
    k, omega, rate = k[order], omega[order], rate[order]
    grows = np.asarray(bands.grows)[order] if hasattr(bands, "grows") else rate > 0
    along = np.broadcast_to(k[:, None], omega.shape)
    for which, tone in ((~grows, COLOURS[0]), (grows, COLOURS[1])):
        ax.plot(along[which], scaled_by(omega[which], by.factor), ".", ms=3, color=tone, zorder=2)
    for low, high in () if bands.edges is None else np.asarray(bands.edges):
        ax.axvspan(max(low, k[0]), min(high, k[-1]), color=COLOURS[3], alpha=0.22, lw=0, zorder=1)
    half = scaled_by(np.pi / float(bands.period), by.factor)
    cell = int(np.prod(bands.cell))
    ax.set_xlabel(
        "wave number $k$ (rad/site)" if cell == 1 else f"wave number $k$ (rad/cell of {cell} sites)"
    )
    ax.set_xlim(k[0], k[-1])
    ax.set_ylim(-1.05 * half, 1.05 * half)
    _ticks(ax, (k[0], k[-1]))
    ax.set_ylabel(by.label)
    if growth:
        _growth(ax, k, scaled_by(np.maximum(rate.max(-1), 0), grown[0].factor), grown[0].label)
    return ax


def _growth(ax, k, rate, label):
    """The largest growth over k, on an axis of its own at the right."""
    right = ax.inset_axes((0, 0, 1, 1), sharex=ax)
    right.patch.set_visible(False)
    right.plot(k, rate, color=COLOURS[2], lw=1.2)
    right.set_ylim(0, 2.5 * float(rate.max()) or 1.0)
    right.yaxis.tick_right()
    right.yaxis.set_label_position("right")
    right.xaxis.set_visible(False)
    right.spines["right"].set_visible(True)
    right.spines["right"].set_color(COLOURS[2])
    right.tick_params(axis="y", colors=COLOURS[2])
    right.set_ylabel(label, color=COLOURS[2])


def _bands(record):
    omega = numbers("dispersion_record.omega", record.omega, finite=False)
    k = numbers("dispersion_record.k", record.k)
    if k.ndim != 1 or omega.ndim != 2 or len(k) != len(omega) or len(k) < 2:
        got = f"shapes {k.shape} and {omega.shape}"
        refuse(
            "dispersion_record",
            "k of shape (K,) and omega (K, bands), of a chain",
            got,
            "Draw a path through a plane's zone with plots.profile(path, omega).",
        )
    order = np.argsort(k)
    return k[order], omega[order], int(np.prod(record.cell))


def _lines(ax, k, omega, tone, **options):
    for band in omega.T:
        ax.plot(k, band, color=tone, zorder=2, **options)


def _under(ax, spectrum, factor, floor):
    k, w = numbers("spectrum.k", spectrum.k, 1), numbers("spectrum.omega", spectrum.omega, 1)
    power = numbers("spectrum.power", spectrum.power, finite=False)
    if power.shape != (len(k), len(w)):
        refuse(
            "spectrum.power",
            f"shape {(len(k), len(w))}, wave numbers by frequencies",
            f"shape {power.shape}",
            "Of a batch pick one lane.",
        )
    top = float(np.nanmax(power))
    if not top > 0:
        refuse("spectrum.power", "some power above zero", f"a largest of {top:g}")
    scaled = np.maximum(power.T / top, floor)
    norm = LogNorm(floor, 1.0)
    image = ax.pcolormesh(
        k, factor * w, scaled, norm=norm, cmap="Blues", shading="nearest", rasterized=True, zorder=0
    )
    half = (k.max() - k.min()) / (2 * max(len(k) - 1, 1))
    return image, (float(k.min() - half), float(k.max() + half))


def _zones(ax, k, omega, cell, span):
    """Bands over the wave number per site, both ways from zero, repeated over the zones of a larger cell."""
    if k.min() >= 0 or k.max() <= 0:
        k, omega = np.concatenate([-k[::-1], k]), np.concatenate([omega[::-1], omega])
        order = np.argsort(k, kind="stable")
        k, omega = k[order], omega[order]
    zone = 2 * np.pi
    reach = int(np.ceil(max(map(abs, span)) * cell / zone)) if cell > 1 else 0
    for shift in range(-reach, reach + 1):
        _lines(ax, (k + zone * shift) / cell, omega, COLOURS[1], lw=0.8)


def _gaps(omega):
    low, high = np.nanmin(omega, 0), np.nanmax(omega, 0)
    least = CLOSED * np.nanmax(np.abs(omega))
    edges = [(0.0, low[0])] + list(zip(high[:-1], low[1:]))
    return [
        (float(a), float(b))
        for a, b in edges
        if b - a > least and not (a == 0.0 and b <= 0.05 * high[-1])
    ]


def _ticks(ax, span):
    """Ticks at multiples of pi/2, where the span is a zone or half of one."""
    places = np.arange(
        np.ceil(span[0] / (np.pi / 2) - 1e-6), np.floor(span[1] / (np.pi / 2) + 1e-6) + 1
    )
    if not 2 <= len(places) <= 9:
        return
    ax.set_xticks(places * np.pi / 2, [_name(int(p)) for p in places])


def _name(halves):
    if halves == 0:
        return "0"
    sign, n = ("-" if halves < 0 else ""), abs(halves)
    if n % 2 == 0:
        return rf"${sign}{'' if n == 2 else n // 2}\pi$"
    return rf"${sign}{'' if n == 1 else n}\pi/2$"
