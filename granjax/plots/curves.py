"""Curves: profiles with a logarithmic inset, transmission over the mass ratio."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from ..checks import one_of, parameter, refuse, within
from ..types import Parameter, Scalar
from ..units import UnitsOrWords
from .arrays import Samples, numbers
from .quantities import Axis, drawn_in, quantity, scaled_by
from .style import COLOURS, DASHES, FAINT, AxesOrNone, axes_or_new, colour

INSETS = ("log", "none")


def profile(
    x: Parameter,
    y: Samples,
    ax: AxesOrNone = None,
    *,
    labels: str | Sequence[str] | None = None,
    points: tuple | list | None = None,
    points_label: str | None = None,
    inset: str | None = "log",
    floor: Scalar = 1e-16,
    x_label: str = "site",
    y_label: str = "strain",
    units: UnitsOrWords = None,
) -> Axes:
    """Profiles over space, with their absolute values on a logarithmic axis in an inset.

    **Arguments:**

    - `x`: places (X,); `y`: values (X,), or (X, C) for C curves; `labels`: one per curve, for a legend.
    - `points`: a pair (places, values), such as lattice nodes, drawn as dots; `points_label`: theirs.
    - `inset`: `"log"` or `"none"`; `floor` in (0, 1): lowest decade of the inset, a share of the largest value.
    - `x_label`, `y_label`: of the axes; one that ends with a known word, such as "peak velocity", says the dimension.
      `units`: `"SI"`, `"scaled"`, `"mm/s"`, as in `granjax.plots`.

    **Returns:** the Axes; the inset is `ax.child_axes[0]`, the curves `ax.lines`.
    **Raises** ValueError for another inset, shapes that do not fit, a floor outside (0, 1).

    **Example:**

    >>> x = np.linspace(-10, 10, 201)
    >>> ax = gx.plots.profile(x, 1 / np.cosh(x) ** 2)
    >>> ax.child_axes[0].get_yscale()
    'log'
    """
    inset = one_of("inset", "none" if inset is None else inset, INSETS)
    x, y = numbers("x", x, 1), numbers("y", y, finite=False)
    if y.ndim not in (1, 2) or len(y) != len(x):
        refuse(
            "x and y",
            "places, shape (X,), and values, (X,) or (X, curves), one value per place",
            f"shapes {x.shape} and {y.shape}",
        )
    y = y.reshape(len(x), -1)
    if isinstance(labels, str):
        labels = [labels]
    floor = float(within("floor", floor, 0, 1, open_low=True, open_high=True))
    by_x, by_y = drawn_in(units, None, Axis(x_label, x, quantity(x_label) or ""), Axis(y_label, y))
    x, y = scaled_by(x, by_x.factor), scaled_by(y, by_y.factor)
    if points is not None:
        points = tuple(scaled_by(p, by.factor) for p, by in zip(_points(points), (by_x, by_y)))
    ax = axes_or_new(ax)
    _curves(ax, x, y, points, labels, points_label)
    ax.set_xlabel(by_x.label)
    ax.set_ylabel(by_y.label)
    ax.set_xlim(x.min(), x.max())
    if labels is not None or points_label is not None:
        ax.legend(loc="upper left", frameon=False)
    if inset == "log":
        small = ax.inset_axes([0.7, 0.6, 0.29, 0.38])
        _curves(small, x, np.abs(y), points and (points[0], np.abs(points[1])), None, None, 0.7)
        small.set_yscale("log")
        top = np.nanmax(np.abs(y))
        top = top if top > 0 else 1.0
        small.set_ylim(floor * top, 10 * top)
        small.set_xlim(x.min(), x.max())
        small.xaxis.set_major_locator(MaxNLocator(3))
        small.tick_params(labelsize=7)
        small.patch.set_alpha(0.9)
    return ax


def _points(points):
    places, values = (
        numbers("points[0]", points[0], 1),
        numbers("points[1]", points[1], 1, finite=False),
    )
    return places, values


def _curves(ax, x, y, points, labels, points_label, scale=1.0):
    for i in range(y.shape[1]):
        name = None if labels is None else labels[i]
        ax.plot(x, y[:, i], DASHES[i % len(DASHES)], color=colour(i), lw=1.6 * scale, label=name)
    if points is not None:
        style = {"ms": 5 * scale, "mec": "white", "mew": 0.5 * scale, "zorder": 3}
        ax.plot(*points, "o", color=COLOURS[2], label=points_label, **style)


def transmission(
    mass_ratio: Parameter,
    transmission: Samples,
    ax: AxesOrNone = None,
    *,
    resonances: Parameter | None = None,
    anti_resonances: Parameter | None = None,
    label: str | Sequence[str] | None = None,
    y_label: str = "transmitted force / that of the monomer",
    units: UnitsOrWords = None,
) -> Axes:
    """Transmitted force of a dimer chain over the mass ratio, relative to the monomer's.

    **Arguments:** `mass_ratio`: light over heavy, (R,), in (0, 1]; `transmission`: (R,), or (R, C) for C curves;
    `resonances`, `anti_resonances`: mass ratios to mark, with dashed and dotted lines; `label`: of the curve, or one
    per curve; `y_label`: of the axis; `units`: of what it names, such as "peak force", as in `granjax.plots`.

    **Returns:** the Axes. **Raises** ValueError for ratios outside (0, 1] or shapes that do not fit.

    **Example:**

    >>> ax = gx.plots.transmission([0.3, 0.6, 1.0], [0.6, 0.2, 1.0], resonances=[0.59])
    >>> ax.get_xlabel().startswith("mass ratio")
    True
    """
    ratios = np.asarray(within("mass_ratio", mass_ratio, 0, 1, open_low=True))
    values = numbers("transmission", transmission, finite=False)
    values = values.reshape(len(ratios), -1)
    labels = [label] * values.shape[1] if label is None or isinstance(label, str) else list(label)
    (by,) = drawn_in(units, None, Axis(y_label, values, quantity(y_label) or ""))
    values = scaled_by(values, by.factor)
    ax = axes_or_new(ax, 5.6, 3.6)
    order = np.argsort(ratios)
    for i in range(values.shape[1]):
        ax.plot(ratios[order], values[order, i], color=colour(i), label=labels[i])
    _marks(ax, "resonances", resonances, "resonance", COLOURS[1], "--")
    _marks(ax, "anti_resonances", anti_resonances, "anti-resonance", COLOURS[2], ":")
    ax.set_xlabel(r"mass ratio $\varepsilon$ (light / heavy)")
    ax.set_ylabel(by.label)
    ax.set_xlim(0, 1.01)
    relative = not by.unit
    ax.set_ylim(0, 1.12 * max(1.0 if relative else 0.0, float(np.nanmax(values))))
    if relative:
        ax.axhline(1.0, color=FAINT, lw=0.8, zorder=0)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(
            loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.2, frameon=False
        )
    return ax


def _marks(ax, argument, places, name, tone, dash):
    if places is None:
        return
    places = np.atleast_1d(np.asarray(parameter(argument, places)))
    for i, place in enumerate(places):
        ax.axvline(place, color=tone, ls=dash, lw=1.2, zorder=1, label=name if i == 0 else None)
