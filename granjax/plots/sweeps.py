"""Sweeps: lines over one parameter, maps over two, dots of a list."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, CenteredNorm, ListedColormap, Normalize

from ..checks import one_of, refuse
from ..units import SCALED, SI
from .style import (
    COLOURS,
    AxesOrNone,
    Shown,
    add_colour_bar,
    add_legend,
    axes_or_new,
    colour,
    log_ticks,
    shown,
)

REASON = "reason"
LANE = "lane"
NOT_YET = "not computed yet"
GAP = "0.85"
# words that have the same colours everywhere, and what tells their bands apart without colours
KNOWN = {"stable": 0, "unstable": 1, "undecided": 3, "yes": 0, "no": 1}
HATCHES = ("", "///", "xx", "...", "---", "|||", "++")
# how even the steps of an axis are
EVEN = 1e-6
# largest over smallest value of a parameter of a list, from which on its axis is logarithmic
WIDE = 100
# lines of more points have no dots
MANY = 64


class Along(NamedTuple):
    """A parameter on an axis: where its values stand; words stand one after the other, each at one place."""

    at: np.ndarray
    log: bool
    name: str
    label: str
    unit: str = ""
    words: tuple[str, ...] = ()


class Field(NamedTuple):
    """What is drawn of a sweep: numbers or words, lanes first; what failed; the parameters, the axes of a grid.

    `grid`: whether the parameters span a grid; else lanes lie side by side. `by`: how the numbers are drawn.
    """

    name: str
    values: np.ndarray
    failed: np.ndarray
    axes: list[Along]
    grid: bool
    by: Shown
    errors: np.ndarray | None


def sweep(
    data: Any,
    name: str | None = None,
    ax: AxesOrNone = None,
    *,
    lines: str | None = None,
    bands: str | None = None,
) -> Axes:
    """Draw a sweep: a line over one parameter, a map over two.

    Lanes of a list or a random design are dots: over one parameter, or coloured over two. Words are dots, one row each,
    or cells of a colour each. A lane that failed is a cross, and what is not known a gap. Axes are logarithmic where
    their values are spaced so.

    **Arguments:**

    - `data`: what `gx.sweep` returns, or any `xarray.Dataset` of its form: parameters are coordinates of the dimensions
      (or all of one dimension), units the attribute `units`, failures words of a variable `reason`.
    - `name`: of the variable, by default the first that holds a number per lane. Complex numbers are drawn by modulus;
      one parameter and an axis of the variable's own are several lines. A line of NAME has bars of NAME_error, where
      the sweep holds that.
    - `lines`: a parameter of a grid whose values are a line each, in place of an axis of a map.
    - `bands`: of a line, the variable of words that colours its background, such as a verdict.

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
    field = _field(data, name, lines)
    count = len(field.axes)
    if count > 2:
        remedy = "Fix some: data.sel(load=1.0, method='nearest')."
        refuse("data", "one or two parameters that vary", f"{count}", remedy)
    if bands is not None and (count != 1 or not field.grid):
        refuse("bands", "None, but for a line over one parameter of a grid", repr(bands))
    if field.values.ndim > field.failed.ndim and not (field.grid and count == 1):
        remedy = f"Pick one: data.isel({field.name}_0=0)."
        refuse("name", "a variable with one value per lane", repr(field.name), remedy)
    if count == 1 or lines is not None:
        ax = axes_or_new(ax, 5.4, 3.6)
        if bands is not None:
            _draw_bands(ax, field.axes[0], _field(data, bands))
        _draw_over_one(field, ax)
    else:
        ax = axes_or_new(ax, 5.4, 4.0)
        _draw_over_two(field, ax)
    add_legend(ax)
    return ax


def _field(data, name, last=None):
    """The `Field` of a variable of a dataset, with a parameter as its last axis."""
    parameters, grid, dims = _parameters(data)
    if last is not None:
        if not grid or len(dims) != 2:
            refuse("lines", "None, but for a grid of two parameters", f"{last!r} of {len(dims)}")
        one_of("lines", last, dims)
        dims = tuple(sorted(dims, key=lambda dim: dim == last))
        parameters = {dim: parameters[dim] for dim in dims}
    known = [k for k, x in data.data_vars.items() if k != REASON and set(dims) <= set(x.dims)]
    if name is None:
        scalar = [k for k in known if data[k].ndim == len(dims)] or known
        name = next((k for k in scalar if data[k].dtype.kind in "fiuc"), scalar[0])
    values = np.asarray(data[one_of("name", name, known)].transpose(*dims, ...).values)
    reason = np.full(values.shape[: len(dims)], "")
    if REASON in data:
        reason = np.asarray(data[REASON].transpose(*dims).values).astype(str)
    label = _words(data, name)
    if values.dtype.kind == "c":
        values, label = np.abs(values), f"|{label}|"
    elif values.dtype.kind == "b":
        computed = (reason == "").reshape(reason.shape + (1,) * (values.ndim - reason.ndim))
        values = np.where(computed, np.where(values, "yes", "no"), "")
    elif values.dtype.kind in "OSU":
        values = values.astype(str)
    else:
        values = np.where(np.isfinite(values), values, np.nan)
    by, errors = _shown(data, name, label, values), data.get(f"{name}_error")
    if errors is not None:
        errors = (
            np.asarray(errors.transpose(*dims).values) if set(errors.dims) == set(dims) else None
        )
    axes = [_along(data, key, x, grid) for key, x in parameters.items()]
    failed = (reason != "") & (reason != NOT_YET)
    return Field(name, values, failed, axes, grid, by, errors)


def _parameters(data):
    """Values of the parameters by name, whether they span a grid, and the dimensions of the lanes."""
    own = [key for key in data.coords if data[key].ndim == 1]
    if LANE in data.dims:
        along = {key: data[key].values for key in own if data[key].dims == (LANE,) and key != LANE}
        return along or {LANE: np.arange(data.sizes[LANE])}, False, (LANE,)
    if REASON in data:
        dims = data[REASON].dims
    else:
        shared = [set(x.dims) for x in data.data_vars.values()] or [set()]
        dims = tuple(key for key in data.dims if key in set.intersection(*shared) and key in own)
    if not dims:
        wanted = "coordinates by the names of the parameters that vary"
        refuse("data", wanted, f"dimensions {tuple(data.dims)}")
    return {key: data[key].values for key in dims}, True, dims


def _words(data, name):
    return str(data[name].attrs.get("long_name", name)).replace("_", " ")


def _shown(data, name, label, x):
    """How numbers of a dataset are drawn; words as they are."""
    unit = data[name].attrs.get("units", "")
    x = x if x.dtype.kind in "fiu" else np.zeros(1)
    return shown(label, x, unit, SCALED if unit == SCALED else SI)


def _along(data, name, x, grid):
    """A parameter on an axis. Of a logarithmic one the middle has to be readable."""
    x, label = np.asarray(x), _words(data, name)
    if x.dtype.kind not in "fiu":
        words = [str(value) for value in x]
        found = tuple(dict.fromkeys(words))
        at = np.array([found.index(word) for word in words], float)
        return Along(at, False, label, label, words=found)
    log = _is_log(x, grid)
    typical = np.exp(np.log(x.astype(float)).mean(keepdims=True)) if log else x
    by = _shown(data, name, label, typical)
    return Along(by(x), log, label, by.label, by.unit)


def _is_log(x, grid):
    """Whether the numbers of a grid are spaced by their logarithm, or those of a list span more than an axis shows."""
    x = np.sort(x[np.isfinite(x)])
    if len(x) < 3 or x[0] <= 0:
        return False
    if not grid:
        return bool(WIDE * x[0] <= x[-1])
    ratios, steps = np.diff(np.log(x)), np.diff(x)
    return bool(np.ptp(ratios) <= EVEN * ratios.mean() and np.ptp(steps) > EVEN * steps.mean())


def _dress(ax, which, along):
    """Label, words and scale of the axis "x" or "y"."""
    ax.set(**{f"{which}label": along.label})
    if along.words:
        ax.set(**{f"{which}ticks": range(len(along.words)), f"{which}ticklabels": along.words})
    if along.log:
        ax.set(**{f"{which}scale": "log"})
        log_ticks(getattr(ax, f"{which}axis"), along.at)


def _edges(along, order):
    """Ends of the cells about rising places."""
    x = np.log(along.at[order]) if along.log else along.at[order]
    if len(x) == 1:
        x = np.array([x[0] - 0.5, x[0] + 0.5])
    else:
        middle = (x[1:] + x[:-1]) / 2
        x = np.concatenate([[2 * x[0] - middle[0]], middle, [2 * x[-1] - middle[-1]]])
    return np.exp(x) if along.log else x


def _kinds(field):
    """The different words, and a number for each that says its colour: known ones have the same everywhere."""
    words = {str(word) for word in field.values.flat} - {""}
    if len(words) > len(COLOURS):
        wanted = f"a variable of at most {len(COLOURS)} different words"
        refuse("name", wanted, f"{field.name!r}, with {len(words)}")
    if words <= KNOWN.keys():
        return {word: KNOWN[word] for word in KNOWN if word in words}
    return {word: i for i, word in enumerate(sorted(words))}


def _draw_bands(ax, along, field):
    """Words along an axis, as bands of a colour and a pattern each."""
    order = np.argsort(along.at)
    words, edges, kinds = field.values[order], _edges(along, order), _kinds(field)
    ends = [*np.flatnonzero(words[1:] != words[:-1]) + 1, len(words)]
    named = set()
    for begin, end in zip([0, *ends], ends):
        word = str(words[begin])
        if word:
            tone, label = colour(kinds[word]), None if word in named else word
            look = {"fc": (tone, 0.18), "ec": (tone, 0.35), "hatch": HATCHES[kinds[word]]}
            ax.axvspan(edges[begin], edges[end], lw=0, zorder=0, label=label, **look)
            named.add(word)


def _draw_over_one(field, ax):
    """Lines or dots over one parameter: of a variable, of its own axis, or of the values of a second parameter."""
    along, *second = field.axes
    if field.values.dtype.kind == "U":
        kinds = _kinds(field)
        for y, (word, i) in enumerate(kinds.items()):
            x = along.at[field.values == word]
            ax.plot(x, np.full(len(x), y), "o", ms=3.5, color=colour(i))
        ax.set_yticks(range(len(kinds)), list(kinds))
        ax.set_ylim(-0.5, len(kinds) - 0.5)
    else:
        order = np.argsort(along.at)
        x, y = along.at[order], field.by(field.values.reshape(len(order), -1)[order])
        names = [None] if y.shape[1] == 1 else [f"{field.name} {i}" for i in range(y.shape[1])]
        for other in second:
            each = other.words or [f"{value:.4g} {other.unit}".rstrip() for value in other.at]
            names = [f"{other.name} {value}" for value in each]
        look = {"marker": "o", "ms": 3} if len(x) <= MANY or not field.grid else {}
        for i, name in enumerate(names):
            line = "-" if field.grid else "none"
            ax.plot(x, y[:, i], color=colour(i), lw=1.4, ls=line, label=name, **look)
        if field.errors is not None and y.shape[1] == 1:
            errors = field.by(np.nan_to_num(np.abs(field.errors[order]), posinf=0.0))
            ax.errorbar(x, y[:, 0], errors, fmt="none", ecolor=colour(0), lw=1)
    ax.set_ylabel(field.by.label)
    _dress(ax, "x", along)
    x = along.at[field.failed.reshape(len(along.at), -1).any(1)]
    _draw_crosses(ax, x, np.full(len(x), 0.03), field.failed, transform=ax.get_xaxis_transform())


def _draw_crosses(ax, x, y, failed, **where):
    """Crosses where lanes failed, said in the legend."""
    if failed.any():
        label = f"failed: {np.count_nonzero(failed)} of {failed.size}"
        look = {"color": "black", "ms": 4, "mew": 1, "clip_on": False, "zorder": 4}
        ax.plot(x, y, "x", label=label, **look, **where)


def _draw_over_two(field, ax):
    """A map over two parameters, the first to the right; coloured dots of a list."""
    (x, y), words = field.axes, field.values.dtype.kind == "U"
    if words:
        kinds = _kinds(field)
        rows = np.array([[word == other for other in kinds] for word in field.values.flat])
        numbers = np.where(rows.any(1), rows.argmax(1), np.nan).reshape(field.values.shape)
        norm = BoundaryNorm(np.arange(len(kinds) + 1) - 0.5, len(kinds))
        tones = ListedColormap([colour(i) for i in kinds.values()])
    else:
        numbers = field.by(field.values)
        norm, tones = _colours(numbers[np.isfinite(numbers)])
    if field.grid:
        i, j = np.argsort(x.at), np.argsort(y.at)
        look = {"norm": norm, "cmap": tones, "rasterized": True}
        image = ax.pcolormesh(_edges(x, i), _edges(y, j), numbers[np.ix_(i, j)].T, **look)
        ax.set_facecolor(GAP)
        i, j = np.nonzero(field.failed)
    else:
        i, known = field.failed, np.isfinite(numbers)
        look = {"norm": norm, "cmap": tones, "s": 18, "linewidths": 0}
        image, j = ax.scatter(x.at[known], y.at[known], c=numbers[known], **look), i
    _draw_crosses(ax, x.at[i], y.at[j], field.failed)
    _dress(ax, "x", x)
    _dress(ax, "y", y)
    bar = add_colour_bar(ax, image, field.by.label)
    if words:
        bar.set_ticks(np.arange(len(kinds)), labels=list(kinds))
        bar.ax.tick_params(length=0)


def _colours(seen):
    """Norm and map of numbers."""
    low, high = (seen.min(), seen.max()) if seen.size else (0.1, 1.0)
    if low < 0 < high:
        return CenteredNorm(halfrange=max(-low, high)), "RdBu_r"
    return Normalize(low, high), "viridis"
