"""Error against time or force evaluations, one line per method."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ..base.checks import one_of, refuse
from .style import FAINT, AxesOrNone, add_legend, axes_or_new, colour

# The column that is drawn, and its label.
AGAINST = {
    "time": ("seconds", "time of one run (s)"),
    "evaluations": ("evaluations", "force evaluations of one run"),
}
MARKS = ("o", "s", "^", "D", "v", "P", "X")
DEFAULT = "default"


def work_precision(wp: Any, ax: AxesOrNone = None, *, against: str = "time") -> Axes:
    """Draw the error against the work, both logarithmic: down and to the left is better.

    **Arguments:**

    - `wp`: the result of `gx.work_precision`, or a table with one entry per point: `method`,
      `error`, `seconds`, `evaluations`, `drawn`; with `methods`, their names in order, and `floor`,
      the uncertainty of the reference, which is shaded (NaN: none). A method named `"default"` is a
      star.
    - `against`: `"time"` or `"evaluations"`; methods that do not count evaluations are left out.

    **Returns:** the Axes; one line per method in `ax.lines`. **Raises** ValueError for another
    `against`, or a table without points to draw.
    """
    column, label = AGAINST[one_of("against", against, tuple(AGAINST))]
    work = np.asarray(getattr(wp, column))
    error = np.asarray(wp.error)
    method = np.array(wp.method, dtype=object)
    shown = np.asarray(wp.drawn, bool) & (work > 0) & (error > 0)
    if not shown.any():
        refuse("wp", "a table with points to draw", "none", "Its notes say why; print it.")
    ax = axes_or_new(ax, 6.6, 4.0)
    ax.set(xscale="log", yscale="log", xlabel=label, ylabel="relative error")
    for i, name in enumerate(wp.methods):
        own = shown & (method == name)
        look = {"color": colour(i), "marker": MARKS[i // 7 % 7], "ls": ("-", "--", ":")[i // 7 % 3]}
        if name == DEFAULT:
            look = {"color": "black", "marker": "*", "ms": 12, "ls": "none", "zorder": 4}
        if own.any():
            look = {"ms": 4, "mec": "white", "mew": 0.4, "lw": 1.2, "label": name} | look
            ax.plot(work[own], error[own], **look)
    floor = float(wp.floor)
    if floor > 0:
        top = ax.get_ylim()[1]
        bottom = min(floor, error[shown].min()) / 10
        ax.axhspan(bottom, floor, color=FAINT, alpha=0.3, lw=0, zorder=0)
        look = {"size": "x-small", "color": "0.35", "va": "bottom"}
        where = ax.get_yaxis_transform()
        ax.text(0.01, floor, "uncertainty of the reference", transform=where, **look)
        ax.set_ylim(bottom, top)
    ax.grid(True, which="major", color=FAINT, alpha=0.25, lw=0.6)
    add_legend(ax)
    return ax
