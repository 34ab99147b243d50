"""Fits: data beside the fitted signals, corner plots of what is known, laws with their bands, phase planes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Shaped
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator

from ..checks import one_of, refuse, show
from ..types import Count, Parameter, Scalar
from ..units import UnitsOrWords
from .arrays import numbers, rising
from .quantities import Axis, drawn_in, quantity, scaled_by, units_of
from .style import COLOURS, FAINT, AxesOrNone, style

# half-width of a corner plot's axes, in standard deviations
REACH = 3.5


def fit(
    result: Any,
    ax: Axes | Shaped[np.ndarray, "..."] | None = None,
    *,
    sensors: Sequence[Count] | None = None,
    units: UnitsOrWords = None,
    x_label: str = "time",
    y_label: str | None = None,
) -> Shaped[np.ndarray, "2 columns"]:
    """Data and fitted signal of every sensor, with the residuals below.

    **Arguments:**

    - `result`: a `Fit`, or anything with `traces` (each with `times` (T,), `data` (T, S), `sensors`, S names),
      `signals` and `residuals`, one (T, S) per trace.
    - `ax`: Axes of shape (2, columns); `None` makes them in a new figure.
    - `sensors`: which columns, counted through all traces; `None` is all.
    - `units`: `("ms", "mm/s")`, as in `granjax.plots`. `x_label`, `y_label`: of the axes; `None` is the kind, first
      word of a sensor's name.

    **Returns:** an array of Axes (2, columns).

    **Example:**

    >>> from types import SimpleNamespace
    >>> traces = SimpleNamespace(times=np.arange(3.0), data=np.array([[0.0], [1.1], [0.2]]), sensors=["velocity 5"])
    >>> found = SimpleNamespace(traces=[traces], signals=[np.array([[0.0], [1.0], [0.3]])],
    ...                         residuals=[np.array([[0.0], [1.0], [-1.0]])])
    >>> gx.plots.fit(found)[0, 0].get_ylabel()
    'velocity'
    """
    columns = [
        (trace, k, trace.sensors[k], signal, residual)
        for trace, signal, residual in zip(result.traces, result.signals, result.residuals)
        for k in range(np.shape(signal)[1])
    ]
    if sensors is not None:
        columns = [columns[k] for k in sensors]
    size = 2.9 * len(columns) + 0.7, 3.6
    drawn = _counted(units, units_of(result), x_label, y_label, columns)
    one = len({quantity.label for *_, quantity in drawn}) == 1
    axes = _grid(
        ax,
        2,
        len(columns),
        size,
        height_ratios=(3, 1),
        sharex="col",
        sharey="row" if one else "none",
    )
    for k, ((upper, lower), (_, sensor, name, _, residual)) in enumerate(zip(axes.T, columns)):
        times, data, fitted, by_time, by_quantity = drawn[k]
        left = numbers("residuals", residual, 2, finite=False)[:, sensor]
        upper.plot(times, data, ".", color=FAINT, ms=3, label="data")
        upper.plot(times, fitted, color=COLOURS[0], lw=1.2, label="fit")
        upper.set_title(name)
        lower.axhspan(-1, 1, color="0.9", lw=0, zorder=0)
        known = np.isfinite(data)
        lower.plot(times[known], left[known], ".", color=COLOURS[0], ms=2)
        lower.set_xlabel(by_time.label)
        lower.set_xlim(times[0], times[-1])
        for ax in (upper, lower):
            ax.xaxis.set_major_locator(MaxNLocator(5))
        if k == 0 or by_quantity.label != drawn[k - 1][-1].label:
            upper.set_ylabel(by_quantity.label)
        if k == 0:
            lower.set_ylabel(r"residual / $\sigma$")
            upper.legend(loc="best", frameon=False, markerscale=2)
    return axes


def _counted(units, said, x_label, y_label, columns):
    """Of every column times, data and fit in the units of the picture, and how both axes are drawn.

    Sensors of one kind share a unit.
    """
    plain = []
    for trace, sensor, name, signal, _ in columns:
        data, fitted = (
            numbers("data", x, 2, finite=False)[:, sensor] for x in (trace.data, signal)
        )
        raw = getattr(trace, "unit", None) == ""
        kind = f"{name.split()[0]}{' signal' * raw}" if y_label is None else y_label
        plain.append((numbers("times", trace.times, 1), data, fitted, (kind, raw)))
    kinds = {
        kind: np.concatenate([x for *_, x, other in plain if other == kind]) for *_, kind in plain
    }
    shown = (
        Axis(kind, x, "" if raw and quantity(kind) else None) for (kind, raw), x in kinds.items()
    )
    by_time, *by_kind = drawn_in(
        units, said, Axis(x_label, np.concatenate([times for times, *_ in plain])), *shown
    )
    by_kind = dict(zip(kinds, by_kind))
    return [
        (
            scaled_by(times, by_time.factor),
            *(scaled_by(x, by_kind[kind].factor) for x in (data, fitted)),
            by_time,
            by_kind[kind],
        )
        for times, data, fitted, kind in plain
    ]


def corner(
    result: Any,
    axes: Axes | Shaped[np.ndarray, "..."] | None = None,
    *,
    truths: dict[str, Scalar] | None = None,
    labels: Sequence[str] | None = None,
    units: UnitsOrWords = None,
) -> Shaped[np.ndarray, "P P"]:
    """What is known of each pair of parameters: ellipses of one and two standard deviations, Gaussians on the diagonal.

    The ellipses are contours of the Gaussian with the fit's covariance; the inner one holds 39 % and the outer one
    86 % of the probability of a pair.

    **Arguments:** `result`: a `Fit`, or anything with `parameters` (a dict), `names` (P,) of its numbers, "a" or
    "a[0]", "a[1]", ..., and `covariance` (P, P) in their order. `axes`: Axes (P, P). `truths`: dict of known values to
    mark, with names as in `names`. `labels`: one per parameter, in place of `names`. `units`: `("mm/s", "us")`, as in
    `granjax.plots`, for labels that end with a known word, such as "damping_time"; by default none is assumed.

    **Returns:** the Axes (P, P), hidden above the diagonal. **Raises** ValueError for a covariance that is not finite
    (parameters that are not determined).

    **Example:**

    >>> from types import SimpleNamespace
    >>> found = SimpleNamespace(parameters={"stiffness": 1.0, "damping": 0.02}, names=["stiffness", "damping"],
    ...                         covariance=np.diag([1e-4, 1e-6]))
    >>> gx.plots.corner(found, truths={"stiffness": 1.01, "damping": 0.02}).shape
    (2, 2)
    """
    # a tree of parameters may have been sorted on the way: their places are those of their names
    order = sorted(
        result.parameters,
        key=lambda k: next(
            i for i, name in enumerate(result.names) if name == k or name.startswith(f"{k}[")
        ),
    )
    values = np.concatenate([numbers(k, result.parameters[k]).ravel() for k in order])
    names, matrix = list(result.names), numbers("covariance", result.covariance, 2, finite=False)
    deviations = np.sqrt(np.diag(matrix))
    if not np.isfinite(matrix).all():
        unknown = ", ".join(name for name, d in zip(names, deviations) if not np.isfinite(d))
        refuse(
            "result",
            "parameters that the data determine",
            f"an infinite deviation of {unknown}",
            "Leave it out.",
        )
    labels = names if labels is None else list(labels)
    kinds = ["" if units is None else quantity(label.replace("_", " ")) or "" for label in labels]
    by = drawn_in(units, units_of(result), *map(Axis, labels, values, kinds))
    sizes = np.array([way.factor for way in by])
    labels, values, deviations = [x.label for x in by], values * sizes, deviations * sizes
    matrix = matrix * np.outer(sizes, sizes)
    for name in truths or {}:
        one_of("truths", name, names)
    marks = [
        None if (truths or {}).get(name) is None else truths[name] * x
        for name, x in zip(names, sizes)
    ]
    count = len(names)
    axes = _grid(axes, count, count, (1.7 * count + 0.8, 1.7 * count + 0.5))
    powers = [_power(value) for value in values]
    shown = [
        label if power == 0 else rf"{label} ($10^{{{power}}}$)"
        for label, power in zip(labels, powers)
    ]
    size = 10.0 ** -np.array(powers)
    centre, matrix, deviations = values * size, matrix * np.outer(size, size), deviations * size
    marks = [None if mark is None else float(mark) * s for mark, s in zip(marks, size)]
    for i in range(count):
        for j in range(count):
            ax = axes[i, j]
            if j > i:
                ax.set_visible(False)
                continue
            ax.set_xlim(centre[j] - REACH * deviations[j], centre[j] + REACH * deviations[j])
            if i == j:
                _marginal(ax, centre[i], deviations[i], powers[i])
            else:
                ax.set_ylim(centre[i] - REACH * deviations[i], centre[i] + REACH * deviations[i])
                _ellipses(ax, centre[[j, i]], matrix[np.ix_([j, i], [j, i])])
                ax.yaxis.set_major_locator(MaxNLocator(3))
                if marks[i] is not None:
                    ax.axhline(marks[i], color=COLOURS[1], lw=0.9)
            if marks[j] is not None:
                ax.axvline(marks[j], color=COLOURS[1], lw=0.9)
            ax.xaxis.set_major_locator(MaxNLocator(3))
            ax.ticklabel_format(useOffset=False)
            ax.tick_params(axis="x", rotation=45, labelbottom=i == count - 1)
            ax.tick_params(axis="y", labelleft=j == 0 and i > 0)
            if i == count - 1:
                ax.set_xlabel(shown[j])
            if j == 0 and i > 0:
                ax.set_ylabel(shown[i])
    axes[0, 0].figure.align_labels()
    return axes


def law(
    strain: Parameter,
    force: Parameter,
    low: Parameter,
    high: Parameter,
    ax: AxesOrNone = None,
    *,
    label: str = "identified",
    band: str | None = None,
    truth: Parameter | None = None,
    truth_label: str = "true",
    units: UnitsOrWords = None,
    x_label: str = "compression",
    y_label: str = "force",
) -> Axes:
    """An identified law with its band, over the strains that were visited and nowhere else.

    **Arguments:** `strain` (n,), rising, the strains that the motion visited; `force` (n,); `low`, `high` (n,): the
    band; `label`, `band`: names of curve and band; `truth` (n,): a law to compare with; `x_label`, `y_label`; `units`:
    `("um", "N")`, as in `granjax.plots`.

    **Returns:** the Axes. **Raises** ValueError for shapes that do not fit, strains that do not rise, low > high.

    **Example:**

    >>> y = np.linspace(0.0, 1.0, 11)
    >>> ax = gx.plots.law(y, y**1.5, 0.9 * y**1.5, 1.1 * y**1.5)
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('compression', 'force')
    """
    force = numbers("force", force, 1)
    strain = rising("strain", strain, len(force))
    low, high = numbers("low", low, 1), numbers("high", high, 1)
    truth = None if truth is None else numbers("truth", truth, 1)
    if (low > high).any():
        refuse("low", "numbers not above high", show(low), "Swap low and high.")
    by_x, by_y = drawn_in(units, None, Axis(x_label, strain), Axis(y_label, force))
    strain = scaled_by(strain, by_x.factor)
    force, low, high, truth = (
        None if x is None else scaled_by(x, by_y.factor) for x in (force, low, high, truth)
    )
    ax = _grid(ax, 1, 1, (5.0, 3.6))[0, 0]
    ax.fill_between(strain, low, high, color=COLOURS[4], alpha=0.4, lw=0, label=band)
    ax.plot(strain, force, color=COLOURS[0], label=label)
    if truth is not None:
        ax.plot(strain, truth, "--", color=COLOURS[1], lw=1.2, label=truth_label)
    ax.axhline(0, color=FAINT, lw=0.8, zorder=0)
    ax.axvline(0, color=FAINT, lw=0.8, zorder=0)
    ax.set_xlim(strain[0], strain[-1])
    ax.set_xlabel(by_x.label)
    ax.set_ylabel(by_y.label)
    ax.legend(loc="upper left", frameon=False)
    return ax


def _grid(axes, rows, columns, size, **how):
    """The Axes that were given, as an array, or those of a new pyplot figure in the house style."""
    if axes is None:
        import matplotlib.pyplot as plt

        with style():
            axes = plt.figure(figsize=size, layout="constrained").subplots(
                rows, columns, squeeze=False, **how
            )
    axes = np.asarray(axes, dtype=object)
    return axes.reshape(rows, columns)


def _power(value):
    """The power of ten that is put in front of a number, 0 where it reads well without."""
    power = int(np.floor(np.log10(abs(value)))) if value != 0 else 0
    return 0 if -1 <= power <= 3 else power


def _marginal(ax, centre, deviation, power):
    x = np.linspace(-REACH, REACH, 121)
    y = np.exp(-(x**2) / 2)
    ax.fill_between(
        centre + x * deviation, y, where=np.abs(x) <= 1, color=COLOURS[0], alpha=0.3, lw=0
    )
    ax.plot(centre + x * deviation, y, color=COLOURS[0], lw=1.2)
    ax.set_ylim(0, 1.1)
    ax.set_yticks([])
    digits = max(0, 1 - int(np.floor(np.log10(deviation)))) if deviation > 0 else 3
    said = rf"{centre:.{digits}f} $\pm$ {deviation:.{digits}f}"
    ax.set_title(said if power == 0 else rf"({said})$\,10^{{{power}}}$", fontsize=8, loc="center")


def _ellipses(ax, centre, matrix):
    variances, vectors = np.linalg.eigh(matrix)
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    height, width = 2 * np.sqrt(np.maximum(variances, 0))
    for sigma, alpha in ((2, 0.15), (1, 0.3)):
        ax.add_patch(
            Ellipse(
                centre, sigma * width, sigma * height, angle=angle, fc=COLOURS[0], alpha=alpha, lw=0
            )
        )
        ax.add_patch(
            Ellipse(
                centre,
                sigma * width,
                sigma * height,
                angle=angle,
                fill=False,
                ec=COLOURS[0],
                lw=1.0,
            )
        )
    ax.plot(*centre, ".", color=COLOURS[0], ms=4)


def planar(record: Any, ax: AxesOrNone = None, *, units: UnitsOrWords = None) -> Axes:
    """Phase plane of a planar equation: the measured wave, its homoclinic and periodic orbit, and the equilibria.

    **Arguments:** `record`: anything with `strains`, `slopes`, `window` (P,), `equilibria`, `homoclinic()` and
    `periodic()`, such as the result of `gx.identify.planar_ode`. `units`: `"um"`, as in `granjax.plots`.

    **Returns:** the Axes; `ax.lines`: the orbits that there are, the windows of the data, saddles and centres.

    **Example:**

    >>> from types import SimpleNamespace
    >>> xi = np.linspace(-3, 3, 61)
    >>> y, slope = 1 / np.cosh(xi) ** 2, -2 * np.tanh(xi) / np.cosh(xi) ** 2
    >>> orbit = SimpleNamespace(xi=xi, strains=y)
    >>> found = SimpleNamespace(strains=y, slopes=slope, window=0 * xi, equilibria=[], homoclinic=lambda: orbit,
    ...                         periodic=lambda: None)
    >>> gx.plots.planar(found).lines[0].get_label()
    'homoclinic orbit'
    """
    y, slope = (
        numbers("record.strains", record.strains, 1),
        numbers("record.slopes", record.slopes, 1),
    )
    by_x, by_y = drawn_in(
        units, units_of(record), Axis("strain", y), Axis("slope of the strain", slope, "m")
    )
    if ax is None:
        import matplotlib.pyplot as plt

        with style():
            ax = plt.subplots(figsize=(5.2, 4.2), layout="constrained")[1]
    for name, tone in (("homoclinic", COLOURS[1]), ("periodic", COLOURS[0])):
        try:
            orbit = getattr(record, name)()
        except ValueError:
            orbit = None
        if orbit is not None:
            table = np.asarray(orbit.strains)
            steep = scaled_by(np.gradient(table, orbit.xi), by_y.factor)
            ax.plot(scaled_by(table, by_x.factor), steep, color=tone, lw=1.2, label=f"{name} orbit")
    for k in np.unique(record.window):
        own = record.window == k
        ax.plot(
            scaled_by(y[own], by_x.factor),
            scaled_by(slope[own], by_y.factor),
            "o",
            ms=3,
            color=COLOURS[2],
            label=None if k else "measured wave",
        )
    for kind, mark in (("saddle", "x"), ("centre", "+")):
        at = np.array([point.strain for point in record.equilibria if point.kind == kind])
        near = at[np.abs(at - y.mean()) < 1.5 * np.ptp(y)] if at.size else at
        ax.plot(
            scaled_by(near, by_x.factor),
            np.zeros(len(near)),
            mark,
            color=COLOURS[6],
            ms=8,
            label=kind,
        )
    ax.axhline(0.0, color=FAINT, lw=0.6, zorder=0)
    ax.set_xlabel(by_x.label)
    ax.set_ylabel(by_y.label)
    ax.legend(frameon=False, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return ax
