"""Waves of chains with a cell, and maps of resonances."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import CenteredNorm

from ..types import Count
from ..units import UnitsOrWords
from .arrays import numbers, rising
from .quantities import Axis, drawn_in, scaled_by, units_of
from .style import AxesOrNone, add_colour_bar, axes_or_new, colour


def cell_wave(
    wave: Any, ax: AxesOrNone = None, *, tail: bool = True, units: UnitsOrWords = None
) -> Axes:
    """Strain of a wave as each contact of its cell sees it, with an inset of the tail on a logarithmic scale.

    **Arguments:** `wave`: anything with `xi` (X,), `strains` (P, X) and `amplitude`, such as the result of
    `gx.travelling.cell_wave`. `tail`: whether the inset is drawn. `units`: `"um"`, as in `granjax.plots`.

    **Returns:** the Axes; `ax.lines` holds the contacts' curves, the inset is `ax.child_axes[0]`.

    **Example:**

    >>> wave = gx.travelling.cell_wave(gx.Hertz(), [1.0, 0.342845781150], speed=1.0)
    >>> ax = gx.plots.cell_wave(wave)
    >>> len(ax.lines)  # one for each contact of the cell
    2
    """
    strains = numbers("wave.strains", wave.strains, 2)
    xi = rising("wave.xi", wave.xi, strains.shape[1])
    (by,) = drawn_in(units, units_of(wave), Axis("strain", strains, "m"))
    ax = axes_or_new(ax, 5.4, 3.6)
    # the core, with as much on either side
    high = np.abs(xi[np.abs(strains).max(0) > 0.02 * np.abs(strains).max()])
    reach = min(3 * float(high.max(initial=1.0)), float(xi[-1]))
    near = np.abs(xi) <= reach
    for j, row in enumerate(strains):
        ax.plot(xi[near], scaled_by(row[near], by.factor), color=colour(j), label=f"contact {j}")
    ax.set_xlim(-reach, reach)
    ax.set_xlabel(r"place $\xi = n - ct$ (sites)")
    ax.set_ylabel(by.label)
    if len(strains) > 1:
        ax.legend(loc="upper right", frameon=False)
    if tail:
        inset = ax.inset_axes((0.12, 0.55, 0.26, 0.36))
        top = np.abs(strains).max()
        for j, row in enumerate(strains):
            inset.semilogy(xi, np.maximum(np.abs(row) / top, 1e-17), color=colour(j), lw=0.7)
        inset.set_ylim(1e-17, 3)
        inset.set_yticks([1e-16, 1e-8, 1.0])
        inset.tick_params(labelsize="xx-small")
        inset.set_title("of the peak", size="x-small", loc="center")
    return ax


def resonance_map(
    record: Any,
    ax: AxesOrNone = None,
    *,
    marks: Count = 0,
    units: UnitsOrWords = None,
    colour_bar: bool = True,
) -> Axes:
    """Map of a pulse's decay rate over two parameters: white where it travels without loss.

    **Arguments:** `record`: anything with `first` (p,), `second` (q,), `rate` (p, q) and `names`, such as the result of
    `gx.resonance.resonance_map`. `marks`: so many of the lowest local minima are marked. `units`: none, since all axes
    are pure numbers.

    **Returns:** the Axes; the map is `ax.collections[0]`.

    **Example:**

    >>> from types import SimpleNamespace
    >>> found = SimpleNamespace(first=np.array([0.3, 0.6]), second=np.array([0.5, 1.0]),
    ...                         rate=np.array([[0.0, 0.1], [0.2, 0.1]]), names=("ratio", "stiffness"))
    >>> gx.plots.resonance_map(found, marks=1).get_xlabel()
    'mass ratio, odd bead over the others'
    """
    rate = numbers("record.rate", record.rate, 2, finite=False)
    first = rising("record.first", record.first, len(rate))
    second = rising("record.second", record.second, rate.shape[1])
    drawn_in(units, None)
    ax = axes_or_new(ax, 5.2, 4.0)
    image = ax.pcolormesh(
        first,
        second,
        rate.T,
        norm=CenteredNorm(),
        cmap="RdBu_r",
        shading="nearest",
        rasterized=True,
    )
    for i, j in _minima(rate)[:marks]:
        ax.plot(first[i], second[j], "o", mfc="none", color="black", ms=6)
    ax.set_xlabel(_axis(record, 0))
    ax.set_ylabel(_axis(record, 1))
    if colour_bar:
        add_colour_bar(ax, image, "decay rate per cell")
    return ax


def _axis(record, i):
    name = record.names[i].replace("_", " ")
    words = {
        "ratio": "mass ratio, odd bead over the others",
        "stiffness": "stiffness ratio, its contacts over the others",
        "second": "second mass over the first",
        "third": "third mass over the first",
    }
    return words.get(name, name)


def _minima(rate):
    """Places of local minima, lowest first."""
    padded = np.pad(np.where(np.isnan(rate), np.inf, rate), 1, constant_values=np.inf)
    p, q = rate.shape
    around = [
        padded[1 + a : 1 + a + p, 1 + b : 1 + b + q]
        for a in (-1, 0, 1)
        for b in (-1, 0, 1)
        if a or b
    ]
    places = np.argwhere(np.isfinite(rate) & (rate < np.min(around, axis=0)))
    return sorted(map(tuple, places), key=lambda place: rate[place])
