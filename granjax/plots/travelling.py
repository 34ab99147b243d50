"""Travelling waves and fronts with their tails."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, MaxNLocator

from ..types import Numbers, Scalar
from .arrays import numbers
from .style import (
    COLOURS,
    DASHES,
    FAINT,
    AxesOrNone,
    axes_or_new,
    colour,
    shown,
    units_of,
)

# of e that a front's tails are drawn over
POWERS = 8.0
# of a wave's largest strain, what belongs to its core
CORE = 0.02


def wave(
    wave_record: Any,
    ax: AxesOrNone = None,
    *,
    beside: Mapping[str, Numbers] | None = None,
    floor: Scalar = 1e-16,
) -> Axes:
    """Draw the strain of a travelling wave or a front over the place, contacts as dots, and the tails in insets.

    **Arguments:**

    - `wave_record`: anything with `xi` (X,), `strain(xi)`, `velocity(xi)` and `speed`, such as the result of
      `gx.travelling.solitary_wave`, whose slope d strain/d xi = (v(xi + 1) - v(xi))/c is drawn too; with `strains`
      (P, X), as each contact of a cell sees the wave, such as that of `gx.travelling.cell_wave`; or with `behind`,
      `ahead`, `decay_behind`, `decay_ahead`, such as that of `gx.shocks.dissipative_front`.
    - `beside`: dict from a name to strains (X,) at `wave_record.xi`, such as compactons.
    - `floor`: lowest decade of a wave's inset, a share of the largest value.

    **Returns:** the Axes; the curves are `ax.lines`: strain, slope, what is beside, dots. `ax.child_axes` are the
    insets: absolute values of a wave; how far a front is from the state behind and from that ahead, with the slopes
    at which these fall.
    """
    record = wave_record
    xi, is_front = np.asarray(record.xi), hasattr(record, "decay_behind")
    is_cell = np.ndim(getattr(record, "strains", 0)) == 2
    end = np.abs(xi).max()
    if is_cell:
        curves = {f"contact {j}": row for j, row in enumerate(np.asarray(record.strains))}
    else:
        xi = np.linspace(-end, end, 2 * len(xi)) if is_front else xi
        curves = {"strain": np.asarray(record.strain(xi))}
    core = max(np.abs(xi[np.abs(y) > CORE * np.abs(y).max()]).max() for y in curves.values())
    if not is_front and not is_cell:
        v = record.velocity
        rise = np.asarray(v(xi + 1)) - np.asarray(v(xi))
        curves["slope"] = rise / float(record.speed)
    curves |= {name: numbers(f"beside[{name!r}]", y, 1) for name, y in (beside or {}).items()}
    by = shown("strain", np.stack(list(curves.values())), "m", units_of(record))
    curves = {name: by(y) for name, y in curves.items()}
    ax = axes_or_new(ax, 5.4, 3.8)
    _curves(ax, xi, curves)
    if not is_cell:
        nodes = np.arange(np.ceil(xi.min()), np.floor(xi.max()) + 1)
        dots = {"color": COLOURS[2], "ms": 4.5, "mec": "white", "mew": 0.5, "zorder": 3}
        ax.plot(nodes, by(record.strain(nodes)), "o", label="contacts", **dots)
    reach = end if is_front else min(max(3 * core, 3.0), end)
    ax.set(xlim=(-reach, reach), ylabel=by.label)
    ax.set_xlabel(rf"place $\xi = n - {'s' if is_front else 'c'}\,t$ (contacts)")
    if is_front:
        _front_tails(ax, record, by, xi, curves["strain"])
        return ax
    low, top = ax.get_ylim()
    ax.set_ylim(low, top + 0.35 * (top - low))  # room for the legend and the tail
    ax.legend(loc="upper left", frameon=False, fontsize="small", handlelength=1.4)
    tail = ax.inset_axes([0.71, 0.6, 0.28, 0.37])
    _curves(tail, xi, {name: np.abs(y) for name, y in curves.items()}, 0.7)
    largest = max(np.nanmax(np.abs(y)) for y in curves.values()) or 1.0
    tail.set(yscale="log", ylim=(floor * largest, 10 * largest), xlim=(xi.min(), xi.max()))
    _small(tail)
    return ax


def _small(tail):
    """Letters of an inset, few and small."""
    tail.xaxis.set_major_locator(MaxNLocator(3))
    tail.yaxis.set_major_locator(LogLocator(numticks=4))
    tail.tick_params(labelsize="x-small")


def _curves(ax, x, curves, scale=1.0):
    for i, (name, y) in enumerate(curves.items()):
        ax.plot(x, y, DASHES[i % len(DASHES)], color=colour(i), lw=1.6 * scale, label=name)


def _front_tails(ax, record, by, xi, y):
    """What is left of both far states, and the slopes at which the envelopes fall."""
    behind, ahead = float(record.decay_behind), float(record.decay_ahead)
    waves = f"\n$k$ = {float(record.wavenumber_behind):.4g}" * (record.kind == "oscillatory")
    for far, rate, side, name, where in (
        (record.behind, behind, xi < 0, rf"$\lambda$ = {behind:.4g}{waves}", (0.16, 0.12)),
        (record.ahead, -ahead, xi > 0, rf"$\mu$ = {ahead:.4g}", (0.68, 0.48)),
    ):
        level = float(by(far))
        ax.axhline(level, color=FAINT, lw=0.8, ls=":", zorder=0)
        side = side & (np.abs(rate * xi) < POWERS)
        x, d, line = xi[side], np.abs(y - level)[side], np.exp(rate * xi[side])
        outer = np.abs(rate * x) > np.abs(rate * x).max() / 2
        tail = ax.inset_axes([*where, 0.3, 0.32])
        tail.semilogy(x, np.where(d > 0, d, np.nan), color=COLOURS[0], lw=1.0)
        tail.semilogy(x, line * np.nanmax((d / line)[outer]), "--", color=COLOURS[1], lw=1.0)
        tail.set_ylim(d[d > 0].min() / 3, 3 * d.max())
        tail.set_title(name, size="x-small")
        _small(tail)
