"""The spreading of energy: second moment over time, log-log, with the window of the fit and local exponents."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ..checks import one_of
from ..units import UnitsOrWords
from .quantities import Axis, drawn_in, scaled_by, units_of
from .style import COLOURS, FAINT, AxesOrNone, axes_or_new

MEASURES = {
    "moment": ("second moment (sites$^2$)", "exponent"),
    "participation": ("participation number (sites)", "participation_exponent"),
}


def spreading(
    found: Any, ax: AxesOrNone = None, *, measure: str = "moment", label: str | None = None, inset: bool = True,
    units: UnitsOrWords = None,
) -> Axes:
    """Second moment (or participation number) of the energy over time, log-log, with the power law of its window.

    The window of the fit is shaded, the band about the curve is the standard error. The inset shows the local exponent
    d log m2/d log t: where it is level over the window the fit has converged.

    **Arguments:** `found`: what `gx.studies.spreading` returns. `measure`: `"moment"` or `"participation"` (whose local
    exponent is not shown). `label`: of the curve; by default its exponent. `inset`: whether to show it. `units`: of the
    time, as in `granjax.plots`.

    **Returns:** the Axes; the curve and the fit are `ax.lines`, the inset `ax.child_axes[0]`.

    **Example:**

    >>> from types import SimpleNamespace
    >>> t = np.array([1.0, 10.0, 100.0])
    >>> found = SimpleNamespace(times=t, window=np.array([1.0, 100.0]), moment=t, moment_error=0 * t,
    ...                         exponent=SimpleNamespace(value=1.0, error=0.02, verdict="diffusive"),
    ...                         local_exponent=np.ones(3), local_error=np.zeros(3))
    >>> gx.plots.spreading(found).get_xscale()
    'log'
    """
    one_of("measure", measure, tuple(MEASURES))
    y_label, name = MEASURES[measure]
    values, error, fit = (np.asarray(getattr(found, measure)), np.asarray(getattr(found, f"{measure}_error")),
                          getattr(found, name))
    (by,) = drawn_in(units, units_of(found), Axis("time", found.times, "s"))
    t, window = scaled_by(np.asarray(found.times), by.factor), scaled_by(np.asarray(found.window), by.factor)
    ax = axes_or_new(ax, 5.4, 4.0)
    first = len(ax.lines) == 0
    shown = COLOURS[len(ax.lines) // 2 % len(COLOURS)]
    ax.fill_between(t, values - error, values + error, color=shown, alpha=0.25, lw=0)
    told = f"$t^{{{fit.value:.2f} \\pm {max(fit.error, 0.01):.2f}}}$, {fit.verdict}" if label is None else label
    ax.plot(t, values, color=shown, lw=1.6, label=told)
    inside = (t >= window[0] * (1 - 1e-9)) & (t <= window[1] * (1 + 1e-9))
    level = np.exp(np.mean(np.log(values[inside]) - fit.value * np.log(t[inside])))
    ax.plot(t[inside], level * t[inside] ** fit.value, color="black", ls="--", lw=1.0)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel(by.label)
    ax.set_ylabel(y_label)
    if first:
        ax.axvspan(*window, color=FAINT, alpha=0.2, lw=0)
    ax.legend(loc="upper left", frameon=False)
    if inset and measure == "moment":
        _local(ax, t, found, window, shown)
    return ax


def _local(ax, t, found, window, shown):
    fresh = not ax.child_axes
    small = ax.inset_axes([0.64, 0.1, 0.34, 0.34]) if fresh else ax.child_axes[0]
    local, error = np.asarray(found.local_exponent), np.asarray(found.local_error)
    small.fill_between(t, local - error, local + error, color=shown, alpha=0.25, lw=0)
    small.plot(t, local, color=shown, lw=1.1)
    if fresh:
        small.axvspan(*window, color=FAINT, alpha=0.2, lw=0)
        small.set_xscale("log")
        small.set_title("local exponent", fontsize=7)
        small.tick_params(labelsize=7)
