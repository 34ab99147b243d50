"""Sweeps: lines over one parameter, maps over two."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import CenteredNorm, Normalize

from ..base.checks import one_of, refuse
from ..base.units import SCALED, SI
from .arrays import even
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
NOT_YET = "not computed yet"
GAP = "0.85"
# Words with fixed colours, and hatches that distinguish bands without colours.
KNOWN = {"stable": 0, "unstable": 1, "undecided": 3}
HATCHES = ("", "///", "xx", "...", "---", "|||", "++")
# Lines with more points have no dots.
MANY = 64


class Along(NamedTuple):
    """A parameter on an axis: its positions, whether the axis is logarithmic, its scale."""

    at: np.ndarray
    log: bool
    by: Shown

    @property
    def edges(self) -> np.ndarray:
        """Ends of the cells about increasing positions."""
        x = np.log(self.at) if self.log else self.at
        half = np.diff(x) / 2 if len(x) > 1 else np.array([0.5])
        x = np.concatenate([x[:1] - half[:1], x[:-1] + half, x[-1:] + half[-1:]])
        return np.exp(x) if self.log else x

    def dress(self, ax: Axes, which: str) -> None:
        """Set the label and scale of the axis "x" or "y"."""
        ax.set(**{f"{which}label": self.by.label})
        if self.log:
            ax.set(**{f"{which}scale": "log"})
            log_ticks(getattr(ax, f"{which}axis"), self.at)


def sweep(
    data: Any,
    name: str | None = None,
    ax: AxesOrNone = None,
    *,
    lines: str | None = None,
    bands: str | None = None,
) -> Axes:
    """Draw a sweep of a grid: a line over one parameter, a map over two.

    A failed lane is a cross, an unknown value a gap. Axes with logarithmically spaced values are
    logarithmic.

    **Arguments:**

    - `data`: the result of `gx.sweep`, or an `xarray.Dataset` of its form: parameters are
      coordinates of the dimensions, units the attribute `units`, failures words in a variable
      `reason`.
    - `name`: a variable with one number per lane, by default the first. A line of NAME has error
      bars from NAME_error, if present.
    - `lines`: a parameter of a grid whose values are a line each, instead of an axis of a map.
    - `bands`: for a line, the variable of words that colours its background, such as a verdict.

    xarray draws the rest: lanes of a list `data.plot.scatter(x="speed", y="drop", hue="peak")`,
    words `(data.verdict == "stable").plot()`, variables with their own axis
    `data.strain.plot.line(x="ratio")`. Fix further parameters, `data.sel(load=1.0)`, or draw small
    multiples, `data.peak.plot(col="load")`.

    **Returns:** the Axes. The map is `ax.collections[0]`, the lines `ax.lines`. **Raises**
    ValueError for an unknown name, more than two parameters, the lanes of a list, parameters that
    are words, and a dataset without a variable of one real number per point.

    **Example:**

    >>> ratios = jnp.linspace(0.2, 1.0, 5)
    >>> data = gx.sweep(lambda ratio: {"cutoff": jnp.sqrt(3 * (1 + 1 / ratio))}, {"ratio": ratios})
    >>> ax = gx.plots.sweep(data)
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('ratio', 'cutoff')
    """
    if not hasattr(data, "data_vars"):
        remedy = 'Give the dataset and a name: gx.plots.sweep(data, "peak").'
        refuse("data", "a dataset, such as from gx.sweep", f"a {type(data).__name__}", remedy)
    dims = _parameters(data)
    if lines is not None:
        if len(dims) != 2:
            refuse(
                "lines", "None, except for a grid of two parameters", f"{lines!r} of {len(dims)}"
            )
        dims = sorted(dims, key=lambda dim: dim == one_of("lines", lines, dims))
    if len(dims) > 2:
        remedy = "Fix some: data.sel(load=1.0, method='nearest')."
        refuse("data", "one or two parameters that vary", f"{len(dims)}", remedy)
    if bands is not None and len(dims) != 1:
        refuse("bands", "None, except for a line over one parameter of a grid", repr(bands))
    data = data.sortby(list(dims))
    known = [
        key for key, x in data.data_vars.items() if {*x.dims} == {*dims} and x.dtype.kind in "fiub"
    ]
    if not known:
        refuse("data", "a variable with one real number for each point", "none")
    name = one_of("name", known[0] if name is None else name, known)
    values = np.asarray(data[name].transpose(*dims), float)
    by = _shown(data, name, values)
    values = np.where(np.isfinite(values), values, np.nan)
    failed = np.zeros(values.shape, bool)
    if REASON in data:
        failed = ~data[REASON].transpose(*dims).isin(["", NOT_YET]).values
    along = [_along(data, dim) for dim in dims]
    if len(dims) == 1 or lines is not None:
        ax = axes_or_new(ax, 5.4, 3.6)
        if bands is not None:
            _draw_bands(
                ax, along[0], data[one_of("bands", bands, [*data.data_vars])].values.astype(str)
            )
        _draw_lines(ax, along, by(values), lines)
        errors = data.get(f"{name}_error")
        if errors is not None and len(dims) == 1 and errors.dims == data[name].dims:
            errors = by(np.nan_to_num(np.abs(errors.values), posinf=0.0))
            ax.errorbar(along[0].at, by(values), errors, fmt="none", ecolor=colour(0), lw=1)
        ax.set_ylabel(by.label)
        x = along[0].at[failed.reshape(len(failed), -1).any(1)]
        _draw_crosses(ax, x, np.full(len(x), 0.03), failed, transform=ax.get_xaxis_transform())
    else:
        ax = axes_or_new(ax, 5.4, 4.0)
        _draw_map(ax, along, by(values), by.label)
        i, j = np.nonzero(failed)
        _draw_crosses(ax, along[0].at[i], along[1].at[j], failed)
        along[1].dress(ax, "y")
    along[0].dress(ax, "x")
    add_legend(ax)
    return ax


def _parameters(data):
    own = [key for key in data.coords if data[key].dims == (key,)]
    shared = [{*x.dims} for x in data.data_vars.values()] or [set()]
    lanes = data[REASON].dims if REASON in data else set.intersection(*shared)
    dims = [key for key in data.dims if key in own and key in lanes]
    if not dims:
        wanted = "coordinates by the names of the parameters that vary"
        remedy = "Lanes of a list: data.plot.scatter(x=..., y=...)."
        refuse("data", wanted, f"dimensions {tuple(data.dims)}", remedy)
    return dims


def _shown(data, name, x):
    told = data[name].attrs
    label = str(told.get("long_name", name)).replace("_", " ")
    unit = told.get("units", "")
    return shown(label, x, unit, SCALED if unit == SCALED else SI)


def _along(data, name):
    # A parameter on an axis; a logarithmic one has the prefix of its geometric mean.
    if data[name].dtype.kind not in "fiub":
        refuse(
            "data", "parameters that are numbers", f"words of {name!r}", "Choose one by data.sel."
        )
    x = data[name].values.astype(float)
    log = len(x) > 2 and bool(x[0] > 0) and even(np.log(x)) and not even(x)
    by = _shown(data, name, np.exp(np.log(x).mean(keepdims=True)) if log else x)
    return Along(by(x), log, by)


def _draw_bands(ax, along, words):
    found = sorted({*words} - {""})
    if len(found) > len(COLOURS):
        wanted = f"a variable of at most {len(COLOURS)} different words"
        refuse("bands", wanted, f"one with {len(found)}")
    kinds = KNOWN if {*found} <= {*KNOWN} else {word: i for i, word in enumerate(found)}
    ends = [*np.flatnonzero(words[1:] != words[:-1]) + 1, len(words)]
    # Of this call alone: the same word may have another colour in the next.
    named = set()
    for begin, end in zip([0, *ends], ends):
        word = str(words[begin])
        if word:
            tone = colour(kinds[word])
            label = None if word in named else word
            look = {"fc": (tone, 0.18), "ec": (tone, 0.35), "hatch": HATCHES[kinds[word]]}
            ax.axvspan(along.edges[begin], along.edges[end], lw=0, zorder=0, label=label, **look)
            named.add(word)


def _draw_lines(ax, along, y, lines):
    x, *others = along
    names = [
        f"{lines} {value:.4g} {second.by.unit}".rstrip() for second in others for value in second.at
    ]
    look = {"marker": "o", "ms": 3} if len(x.at) <= MANY else {}
    for i, column in enumerate(y.reshape(len(x.at), -1).T):
        ax.plot(x.at, column, color=colour(i), lw=1.4, label=names[i] if names else None, **look)


def _draw_crosses(ax, x, y, failed, **where):
    if failed.any():
        label = f"failed: {np.count_nonzero(failed)} of {failed.size}"
        ax.plot(
            x, y, "x", label=label, color="black", ms=4, mew=1, clip_on=False, zorder=4, **where
        )


def _draw_map(ax, along, z, label):
    seen = z[np.isfinite(z)]
    low, high = (seen.min(), seen.max()) if seen.size else (0.1, 1.0)
    norm = Normalize(low, high)
    tones = "viridis"
    if low < 0 < high:
        norm = CenteredNorm(halfrange=max(-low, high))
        tones = "RdBu_r"
    x, y = (one.edges for one in along)
    image = ax.pcolormesh(x, y, z.T, norm=norm, cmap=tones, rasterized=True)
    ax.set_facecolor(GAP)
    add_colour_bar(ax, image, label)
