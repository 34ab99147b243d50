"""Travelling waves with their tails."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, MaxNLocator

from ..base.types import Numbers, Scalar
from .arrays import numbers
from .style import COLOURS, DASHES, AxesOrNone, axes_or_new, colour, shown, units_of

# The core of a wave is where the strain exceeds this fraction of its largest value.
CORE = 0.02


def wave(
    wave_record: Any,
    ax: AxesOrNone = None,
    *,
    beside: Mapping[str, Numbers] | None = None,
    floor: Scalar = 1e-16,
) -> Axes:
    """Draw the strain of a travelling wave over position, contacts as dots, its tail in an inset.

    **Arguments:**

    - `wave_record`: anything with `xi` (X,), `strain(xi)`, `velocity(xi)` and `speed`, such as from
      `gx.travelling.solitary_wave`, whose slope d strain/d xi = (v(xi + 1) - v(xi))/c is also
      drawn; or with `strains` (P, X) at each contact of a cell, such as from
      `gx.travelling.cell_wave`.
    - `beside`: dict from a name to strains (X,) at `wave_record.xi`, such as compactons.
    - `floor`: lower limit of the inset, relative to the largest value.

    **Returns:** the Axes; `ax.lines` are strain, slope, `beside`, dots. The inset with the absolute
    values is `ax.child_axes[0]`.
    """
    record = wave_record
    xi = np.asarray(record.xi)
    is_cell = np.ndim(getattr(record, "strains", 0)) == 2
    if is_cell:
        curves = {f"contact {j}": row for j, row in enumerate(np.asarray(record.strains))}
    else:
        curves = {"strain": np.asarray(record.strain(xi))}
    core = max(np.abs(xi[np.abs(y) > CORE * np.abs(y).max()]).max() for y in curves.values())
    if not is_cell:
        rise = np.asarray(record.velocity(xi + 1)) - np.asarray(record.velocity(xi))
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
    reach = min(max(3 * core, 3.0), np.abs(xi).max())
    ax.set(xlim=(-reach, reach), ylabel=by.label)
    ax.set_xlabel(r"place $\xi = n - c\,t$ (contacts)")
    low, top = ax.get_ylim()
    ax.set_ylim(low, top + 0.35 * (top - low))  # room for the legend and the tail
    ax.legend(loc="upper left", frameon=False, fontsize="small", handlelength=1.4)
    tail = ax.inset_axes([0.71, 0.6, 0.28, 0.37])
    _curves(tail, xi, {name: np.abs(y) for name, y in curves.items()}, 0.7)
    largest = max(np.nanmax(np.abs(y)) for y in curves.values()) or 1.0
    tail.set(yscale="log", ylim=(floor * largest, 10 * largest), xlim=(xi.min(), xi.max()))
    # few ticks with small labels
    tail.xaxis.set_major_locator(MaxNLocator(3))
    tail.yaxis.set_major_locator(LogLocator(numticks=4))
    tail.tick_params(labelsize="x-small")
    return ax


def _curves(ax, x, curves, scale=1.0):
    for i, (name, y) in enumerate(curves.items()):
        ax.plot(x, y, DASHES[i % len(DASHES)], color=colour(i), lw=1.6 * scale, label=name)
