"""Sweeps: lines over one parameter, maps over two, dots of a list."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, CenteredNorm, ListedColormap, LogNorm, Normalize

from ..checks import one_of, refuse
from .style import COLOURS, AxesOrNone, add_colour_bar, axes_or_new, colour
from .sweep_fields import edges_of, field_of, name_axis, places, with_lines

SCALES = ("linear", "log")
# words with a colour each
WORDS = len(COLOURS)
GAP = "0.85"
# letters in a row of a legend, and of what stands before each label
ROW, HANDLE = 64, 6
# words that have the same colours everywhere
KNOWN = {"stable": 0, "unstable": 1, "undecided": 3, "yes": 0, "no": 1}


def sweep(
    data: Any,
    name: str | None = None,
    ax: AxesOrNone = None,
    *,
    lines: str | None = None,
    bands: str | None = None,
    scale: str = "linear",
    colour_bar: bool = True,
) -> Axes:
    """Picture of a sweep: a line over one parameter, a map over two.

    Lanes of a list or a random design are dots: over one parameter, or coloured over two. Words are bands, cells or
    dots of a colour each. A lane that failed is a cross, and what is not known a gap. Axes are
    logarithmic where their values are spaced so.

    **Arguments:**

    - `data`: what `gx.sweep` returns, or any `xarray.Dataset` of its form: parameters are coordinates of the dimensions
      (or all of one dimension), units the attribute `units`, failures words of a variable `reason`.
    - `name`: of the variable, by default the first that holds a number per lane. Complex numbers are drawn by modulus;
      one parameter and an axis of the variable's own are several lines. A line of NAME has bars of NAME_error, where
      the sweep holds that.
    - `lines`: a parameter of a grid whose values are a line each, in place of an axis of a map.
    - `bands`: of a line, the variable of words that colours its background, such as a verdict.
    - `scale`: of the variable, `"linear"` or `"log"`.

    Of more parameters fix some, `data.sel(load=1.0)`; small multiples are xarray's, `data.peak.plot(col="load")`.

    **Returns:** the Axes. The map is `ax.collections[0]`, the lines `ax.lines`.
    **Raises** ValueError for a name that is not there, and for more than two parameters.

    **Example:**

    >>> ratios = jnp.linspace(0.2, 1.0, 5)
    >>> data = gx.sweep(lambda ratio: {"cutoff": jnp.sqrt(3 * (1 + 1 / ratio))}, {"ratio": ratios})
    >>> ax = gx.plots.sweep(data)
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('ratio', 'cutoff')
    """
    one_of("scale", scale, SCALES)
    field = field_of(data, name)
    count = len(field.parameters)
    if count > 2:
        remedy = "Fix some: data.sel(load=1.0, method='nearest')."
        refuse("data", "one or two parameters that vary", f"{count}", remedy)
    if lines is not None:
        field = with_lines(field, lines)
    if bands is not None and (count != 1 or not field.grid):
        refuse("bands", "None, but for a line over one parameter of a grid", repr(bands))
    if field.values.ndim > field.failed.ndim and count > 1:
        refuse(
            "name",
            "a variable with one value per lane, where several parameters vary",
            repr(field.name),
            f"Pick one: data.isel({field.name}_0=0).",
        )
    if not field.grid:
        return _scattered(field, ax, scale, colour_bar)
    if lines is not None or count == 1:
        return _lines(field, ax, None if bands is None else field_of(data, bands), scale)
    return _map(field, axes_or_new(ax, 5.4, 4.0), scale, colour_bar)


def _lines(field, ax, bands, scale):
    """Lines over one parameter: of a variable, of its own axis, or of the values of a second parameter."""
    names = list(field.parameters)
    by_x, by_y = field.by[names[0]], field.by[field.name]
    ax = axes_or_new(ax, 5.4, 3.6)
    x, log = places(field.parameters[names[0]], by_x)
    order = np.argsort(x)
    if bands is not None:
        _bands(ax, x[order], bands.values[order], log, bands.name)
    if field.values.dtype.kind == "U":
        _bands(ax, x[order], field.values[order], log, field.name)
        ax.set_yticks([])
        ax.set_ylabel(by_y.label)
    else:
        _drawn_lines(ax, field, x, order, by_y, names)
        ax.set_ylabel(by_y.label)
        if scale == "log" and (field.values > 0).any():
            ax.set_yscale("log")
    name_axis(ax.xaxis, field.parameters[names[0]], by_x.label, log)
    if len(x) > 1:
        edges = x.min(), x.max()
        ax.set_xlim(edges if edges[0] < edges[1] else None)
    failed = field.failed if field.failed.ndim == 1 else field.failed.any(axis=1)
    _crosses(
        ax,
        x[failed],
        np.full(np.count_nonzero(failed), 0.03),
        field.failed,
        ax.get_xaxis_transform(),
    )
    _legend(ax)
    return ax


def _drawn_lines(ax, field, x, order, by, names):
    values = field.values.reshape(len(x), -1)
    said = [None] if values.shape[1] == 1 else [str(i) for i in range(values.shape[1])]
    if len(names) == 2:
        said = _each(field, names[1])
    dots = {"marker": "o", "ms": 3} if len(x) <= 64 else {}
    for i, label in enumerate(said):
        seen = np.where(np.isfinite(values[order, i]), values[order, i], np.nan)
        ax.plot(x[order], by(seen), color=colour(i), label=label, lw=1.4, **dots)
    if field.errors is not None and values.shape[1] == 1:
        errors = by(np.where(np.isfinite(field.errors), np.abs(field.errors), 0.0))
        y = by(values[order, 0])
        ax.errorbar(x[order], y, errors[order], fmt="none", ecolor=colour(0), lw=1)


def _each(field, name):
    """Each value of a parameter in words."""
    by, x = field.by[name], field.parameters[name]
    said = [f"{value:.4g}" for value in by(x)] if x.dtype.kind in "fiu" else x
    return [f"{field.labels[name]} {value} {by.unit}".rstrip() for value in said]


def _bands(ax, x, words, log, name):
    """Words along an axis, as bands of a colour each."""
    (found, tones), edges = _kinds(words, name), edges_of(x, log)
    begin = 0
    for i in range(1, len(words) + 1):
        if i == len(words) or words[i] != words[begin]:
            if words[begin]:
                tone = tones[found.index(words[begin])]
                label = None if words[begin] in words[:begin] else words[begin]
                ax.axvspan(
                    edges[begin], edges[i], color=tone, alpha=0.18, lw=0, label=label, zorder=0
                )
            begin = i


def _kinds(words, name):
    """The different words and their colours: known ones in the order and the colours of `KNOWN`."""
    order = list(KNOWN)
    found = sorted(
        {str(word) for word in words.flat} - {""},
        key=lambda x: (order.index(x) if x in KNOWN else 9, x),
    )
    if len(found) > WORDS:
        refuse(
            "name", f"a variable of at most {WORDS} different words", f"{name!r}, with {len(found)}"
        )
    known = KNOWN.keys() >= {*found}
    return found, [colour(KNOWN[word] if known else i) for i, word in enumerate(found)]


def _crosses(ax, x, y, failed, transform=None):
    """Crosses where lanes failed, said in the legend."""
    if failed.any():
        label = f"failed: {np.count_nonzero(failed)} of {failed.size}"
        more = {} if transform is None else {"transform": transform}
        ax.plot(x, y, "x", color="black", ms=4, mew=1, label=label, clip_on=False, zorder=4, **more)


def _legend(ax):
    """A legend above, of so many columns that it is no wider than the Axes."""
    said = ax.get_legend_handles_labels()[1]
    if said:
        columns = min(max(ROW // (HANDLE + max(map(len, said))), 1), 4)
        ax.legend(
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=columns,
            borderaxespad=0.2,
            frameon=False,
        )


def _colours(field, by, scale):
    """Numbers to be coloured, their norm and map, and the words that they stand for."""
    values = field.values
    if values.dtype.kind == "U":
        found, tones = _kinds(values, field.name)
        numbers = np.full(values.shape, np.nan)
        for i, word in enumerate(found):
            numbers[values == word] = i
        norm = (
            BoundaryNorm(np.arange(len(found) + 1) - 0.5, max(len(found), 1))
            if found
            else Normalize()
        )
        return numbers, norm, ListedColormap(tones or [GAP]), found
    numbers = by(np.where(np.isfinite(values), values, np.nan))
    seen = numbers[np.isfinite(numbers)]
    if scale == "log":
        positive = seen[seen > 0]
        low, high = (positive.min(), positive.max()) if positive.size else (0.1, 1.0)
        return (
            np.where(numbers > 0, numbers, np.nan),
            LogNorm(low, high if high > low else 10 * low),
            "viridis",
            None,
        )
    if seen.size and seen.min() < 0 < seen.max():
        return numbers, CenteredNorm(halfrange=np.abs(seen).max()), "RdBu_r", None
    return (
        numbers,
        Normalize(*((seen.min(), seen.max()) if seen.size else (0.0, 1.0))),
        "viridis",
        None,
    )


def _bar(ax, image, label, words):
    bar = add_colour_bar(ax, image, label)
    if words:
        bar.set_ticks(np.arange(len(words)), labels=words)
        bar.ax.tick_params(length=0)


def _map(field, ax, scale, colour_bar):
    """A map over two parameters, the first to the right."""
    first, second = field.parameters
    by_x, by_y, by = (field.by[key] for key in (first, second, field.name))
    numbers, norm, colours, words = _colours(field, by, scale)
    (x, x_log), (y, y_log) = (
        places(field.parameters[key], b) for key, b in ((first, by_x), (second, by_y))
    )
    rows, columns = np.argsort(x), np.argsort(y)
    image = ax.pcolormesh(
        edges_of(x[rows], x_log),
        edges_of(y[columns], y_log),
        numbers[np.ix_(rows, columns)].T,
        norm=norm,
        cmap=colours,
        rasterized=True,
    )
    ax.set_facecolor(GAP)
    name_axis(ax.xaxis, field.parameters[first], by_x.label, x_log)
    name_axis(ax.yaxis, field.parameters[second], by_y.label, y_log)
    i, j = np.nonzero(field.failed)
    _crosses(ax, x[i], y[j], field.failed)
    _legend(ax)
    if colour_bar:
        _bar(ax, image, by.label, words)
    return ax


def _scattered(field, ax, scale, colour_bar):
    """Dots of lanes side by side: over one parameter, or coloured over two."""
    names = list(field.parameters)
    if field.values.ndim > 1:
        refuse(
            "name",
            "a variable with one value per lane",
            repr(field.name),
            f"Pick one: data.isel({field.name}_0=0).",
        )
    if len(names) == 2:
        return _dots(field, axes_or_new(ax, 5.4, 4.0), names, scale, colour_bar)
    (name,), ax = names, axes_or_new(ax, 5.4, 3.6)
    by_x, by_y = field.by[name], field.by[field.name]
    x, log = places(field.parameters[name], by_x, True)
    if field.values.dtype.kind == "U":
        found, tones = _kinds(field.values, field.name)
        y = np.array([found.index(word) if word else np.nan for word in field.values])
        ax.set_yticks(np.arange(len(found)), found)
        ax.set_ylim(-0.5, len(found) - 0.5)
        for i in range(len(found)):
            ax.plot(x[y == i], y[y == i], "o", ms=3.5, color=tones[i])
    else:
        ax.plot(
            x,
            by_y(np.where(np.isfinite(field.values), field.values, np.nan)),
            "o",
            ms=3.5,
            color=colour(0),
        )
        if scale == "log" and (field.values > 0).any():
            ax.set_yscale("log")
    ax.set_ylabel(by_y.label)
    name_axis(ax.xaxis, field.parameters[name], by_x.label, log)
    failed = field.failed
    _crosses(
        ax, x[failed], np.full(np.count_nonzero(failed), 0.03), failed, ax.get_xaxis_transform()
    )
    _legend(ax)
    return ax


def _dots(field, ax, names, scale, colour_bar):
    """Dots over two parameters, coloured by the variable."""
    by_x, by_y, by = (field.by[key] for key in (*names, field.name))
    (x, x_log), (y, y_log) = (
        places(field.parameters[key], b, True) for key, b in zip(names, (by_x, by_y))
    )
    numbers, norm, colours, words = _colours(field, by, scale)
    known = np.isfinite(numbers)
    image = ax.scatter(
        x[known], y[known], c=numbers[known], norm=norm, cmap=colours, s=18, linewidths=0
    )
    name_axis(ax.xaxis, field.parameters[names[0]], by_x.label, x_log)
    name_axis(ax.yaxis, field.parameters[names[1]], by_y.label, y_log)
    _crosses(ax, x[field.failed], y[field.failed], field.failed)
    _legend(ax)
    if colour_bar:
        _bar(ax, image, by.label, words)
    return ax
