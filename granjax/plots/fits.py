"""Fits: data beside the fitted signals, and corner plots of the parameters."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Shaped
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator

from ..base.checks import one_of, refuse
from ..base.types import Count, Scalar
from .arrays import numbers
from .style import COLOURS, FAINT, axes_or_new, shown, units_of

# Half-width of a corner plot's axes, in standard deviations.
REACH = 3.5


def fit(
    result: Any,
    ax: Axes | Shaped[np.ndarray, "..."] | None = None,
    *,
    sensors: Sequence[Count] | None = None,
) -> Shaped[np.ndarray, "2 columns"]:
    """Draw the data and fitted signal of every sensor, with the residuals below.

    **Arguments:** `result`: a `Fit`, or anything with `traces` (each with `times` (T,), `data`
    (T, S), `sensors`, S names), `signals` and `residuals`, one (T, S) per trace. `ax`: Axes of
    shape (2, columns). `sensors`: which columns, counted through all traces; `None` for all.
    **Returns:** the Axes (2, columns).

    **Example:**

    >>> from types import SimpleNamespace
    >>> traces = SimpleNamespace(times=np.arange(3.0), data=np.array([[0.0], [1.1], [0.2]]), sensors=["velocity 5"])
    >>> found = SimpleNamespace(traces=[traces], signals=[np.array([[0.0], [1.0], [0.3]])],
    ...                         residuals=[np.array([[0.0], [1.0], [-1.0]])])
    >>> gx.plots.fit(found)[0, 0].get_ylabel()
    'velocity'
    """
    columns = [
        (trace, name, *(np.asarray(x)[:, k] for x in (trace.data, signal, residual)))
        for trace, signal, residual in zip(result.traces, result.signals, result.residuals)
        for k, name in enumerate(trace.sensors)
    ]
    if sensors is not None:
        columns = [columns[k] for k in sensors]
    by_time, by_kind = _axes_of(result, columns)
    one = len({by.label for by in by_kind}) == 1
    how = {"height_ratios": (3, 1), "sharex": "col", "sharey": "row" if one else "none"}
    count = len(columns)
    axes = axes_or_new(ax, 2.9 * count + 0.7, 3.6, 2, count, squeeze=False, **how)
    axes = axes.reshape(2, count)
    for k, ((upper, lower), column) in enumerate(zip(axes.T, columns)):
        trace, name, data, signal, residual = column
        times = by_time(trace.times)
        upper.plot(times, by_kind[k](data), ".", color=FAINT, ms=3, label="data")
        upper.plot(times, by_kind[k](signal), color=COLOURS[0], lw=1.2, label="fit")
        upper.set_title(name, size="medium")
        lower.axhspan(-1, 1, color="0.9", lw=0, zorder=0)
        known = np.isfinite(data)
        lower.plot(times[known], residual[known], ".", color=COLOURS[0], ms=2)
        lower.set(xlabel=by_time.label, xlim=(times[0], times[-1]))
        for ax in (upper, lower):
            ax.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        if k == 0 or by_kind[k].label != by_kind[k - 1].label:
            upper.set_ylabel(by_kind[k].label)
    axes[1, 0].set_ylabel(r"residual / $\sigma$")
    axes[0, 0].legend(loc="best", frameon=False, markerscale=2)
    return axes


def _axes_of(result, columns):
    # The scale of the times and of each column; sensors with the same first word share a unit.
    said = units_of(result)
    kinds = {}
    keys = [(name.split()[0], getattr(trace, "unit", None)) for trace, name, *_ in columns]
    for key, (_, _, *shown_numbers, _) in zip(keys, columns):
        kinds.setdefault(key, []).extend(shown_numbers)
    by = {
        # Raw numbers of a recorder have no unit.
        (kind, unit): shown(f"{kind} signal" if unit == "" else kind, np.concatenate(x), unit, said)
        for (kind, unit), x in kinds.items()
    }
    times = np.concatenate([np.asarray(trace.times) for trace, *_ in columns])
    return shown("time", times, "s", said), [by[key] for key in keys]


def corner(
    result: Any,
    axes: Axes | Shaped[np.ndarray, "..."] | None = None,
    *,
    truths: dict[str, Scalar] | None = None,
) -> Shaped[np.ndarray, "P P"]:
    """Draw the covariance of each pair of parameters as ellipses, Gaussians on the diagonal.

    The ellipses of one and two deviations hold 39 % and 86 % of the probability of a pair.

    **Arguments:** `result`: a `Fit`, or anything with `parameters` (a dict), `names` (P,) of its
    numbers, "a" or "a[0]", "a[1]", ..., and `covariance` (P, P) in their order. `axes`: Axes
    (P, P). `truths`: dict of known values to mark, with names as in `names`.

    **Returns:** the Axes (P, P), hidden above the diagonal. **Raises** ValueError for a covariance
    that is not finite (undetermined parameters).
    """
    # A tree of parameters may have been sorted; the order is that of `names`.
    first = [name.partition("[")[0] for name in result.names]
    order = sorted(result.parameters, key=first.index)
    values = np.concatenate([numbers(k, result.parameters[k]).ravel() for k in order])
    names = list(result.names)
    matrix = numbers("covariance", result.covariance, 2, finite=False)
    if not np.isfinite(matrix).all():
        unknown = ", ".join(itertools.compress(names, ~np.isfinite(np.diag(matrix))))
        wanted = "parameters that the data determine"
        refuse("result", wanted, f"an infinite deviation of {unknown}", "Leave it out.")
    truths = {one_of("truths", name, names): x for name, x in (truths or {}).items()}
    count = len(names)
    size = (1.7 * count + 0.8, 1.7 * count + 0.5)
    axes = axes_or_new(axes, *size, count, count, squeeze=False).reshape(count, count)
    powers = [_power(value) for value in values]
    titles = [
        label if power == 0 else rf"{label} ($10^{{{power}}}$)"
        for label, power in zip(names, powers)
    ]
    unit = 10.0 ** np.array(powers)
    centre = values / unit
    matrix = matrix / np.outer(unit, unit)
    deviations = np.sqrt(np.diag(matrix))
    marks = {names.index(name): x / unit[names.index(name)] for name, x in truths.items()}
    ends = centre + REACH * np.array([[-1], [1]]) * deviations
    for i, j in np.ndindex(count, count):
        ax = axes[i, j]
        if j > i:
            ax.set_visible(False)
            continue
        if i == j:
            _marginal(ax, centre[i], deviations[i], powers[i])
        else:
            _ellipses(ax, centre[[j, i]], matrix[np.ix_([j, i], [j, i])])
            ax.set_ylim(ends[:, i])
            ax.yaxis.set_major_locator(MaxNLocator(3))
            if i in marks:
                ax.axhline(marks[i], color=COLOURS[1], lw=0.9)
        ax.set_xlim(ends[:, j])
        ax.xaxis.set_major_locator(MaxNLocator(3))
        if j in marks:
            ax.axvline(marks[j], color=COLOURS[1], lw=0.9)
        ax.ticklabel_format(useOffset=False)
        ax.tick_params(axis="x", rotation=45, labelbottom=i == count - 1)
        ax.tick_params(axis="y", labelleft=j == 0 and i > 0)
        if i == count - 1:
            ax.set_xlabel(titles[j])
        if j == 0 and i > 0:
            ax.set_ylabel(titles[i])
    axes[0, 0].figure.align_labels()
    return axes


def _power(value):
    power = int(np.floor(np.log10(abs(value)))) if value != 0 else 0
    return 0 if -1 <= power <= 3 else power


def _marginal(ax, centre, deviation, power):
    x = np.linspace(-REACH, REACH, 121)
    places = centre + x * deviation
    y = np.exp(-(x**2) / 2)
    inner = np.abs(x) <= 1
    ax.fill_between(places, y, where=inner, color=COLOURS[0], alpha=0.3, lw=0)
    ax.plot(places, y, color=COLOURS[0], lw=1.2)
    ax.set(ylim=(0, 1.1), yticks=[])
    digits = max(0, 1 - int(np.floor(np.log10(deviation)))) if deviation > 0 else 3
    said = rf"{centre:.{digits}f} $\pm$ {deviation:.{digits}f}"
    ax.set_title(said if power == 0 else rf"({said})$\,10^{{{power}}}$", fontsize=8, loc="center")


def _ellipses(ax, centre, matrix):
    variances, vectors = np.linalg.eigh(matrix)
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    height, width = 2 * np.sqrt(np.maximum(variances, 0))
    for sigma, alpha in ((2, 0.15), (1, 0.3)):
        look = {"angle": angle, "fc": to_rgba(COLOURS[0], alpha), "ec": COLOURS[0]}
        ax.add_patch(Ellipse(centre, sigma * width, sigma * height, **look))
    ax.plot(*centre, ".", color=COLOURS[0], ms=4)
