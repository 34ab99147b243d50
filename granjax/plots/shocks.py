"""Dispersive shocks: the strain with its edges, and its modulation."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ..base.checks import one_of, positive, refuse
from ..base.types import Parameter, Scalar
from .arrays import numbers, rising
from .style import COLOURS, DASHES, AxesOrNone, add_legend, axes_or_new, colour, shown, units_of

BOND = r"bond from the step $n$"
SPEED = r"speed $n/t$, bonds per time"
OVER = ("place", "speed")
# For `modulation`: the field of a `Shock`, that of a theory, the label, and the SI unit.
QUANTITIES = {
    "m": ("m", "m", r"modulation parameter $m$", ""),
    "mean": ("means", "mean", "mean strain", "m"),
    "amplitude": ("amplitudes", "amplitude", "strain amplitude", "m"),
    "wavelength": ("wavelengths", "wavelength", "wavelength (bonds)", ""),
}


def shock(
    run_or_strain: Any,
    shock: Any = None,
    ax: AxesOrNone = None,
    *,
    problem: Any = None,
    places: Parameter | None = None,
    time: Scalar | None = None,
    over: str = "place",
) -> Axes:
    r"""Draw the strain after a step over position or n/t, with the edges and mean of a shock.

    **Arguments:**

    - `run_or_strain`: a run of `problem.run(...)`, whose last state is drawn; or strains (B,).
      `problem`: what was run, `None` for the one that the run remembers.
    - `shock`: anything with `trailing_speed`, `leading_speed`, `mean` and `amplitude`, such as
      `gx.shocks.measure(run)` or a theory's `velocity_shock(c)`; all four are marked.
    - `places` (B,): increasing, from the step, for strains; `time`: of the strains, needed for
      edges or `over="speed"`.
    - `over`: "place" or "speed", bonds per time.

    **Returns:** the Axes; the strain is `ax.lines[0]`. **Raises** ValueError for a batch.

    **Example:**

    >>> n = np.arange(-100.0, 100.0)
    >>> wave = gx.theory.kdv.velocity_shock(0.05, 1.0, 0.5)
    >>> ax = gx.plots.shock(0.05 - 0.05 * np.tanh(n - 50), wave, places=n, time=50.0)
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('bond from the step $n$', 'strain')
    """
    one_of("over", over, OVER)
    places, strain, time = _profile(run_or_strain, problem, places, time)
    said = units_of(run_or_strain, shock)
    if time is None and (shock is not None or over == "speed"):
        refuse("time", "that of the strains", "None", "Edges are n/t.")
    x = places if over == "place" else places / time
    by_x = shown(BOND, x, "") if over == "place" else shown(SPEED, x, "1/s", said)
    by_y = shown("strain", strain, "m", said)
    ax = axes_or_new(ax, 6.4, 3.6)
    ax.plot(by_x(x), by_y(strain), color=COLOURS[0], lw=0.9, label="strain")
    ax.set(xlim=by_x(x[[0, -1]]), xlabel=by_x.label, ylabel=by_y.label)
    if shock is not None:
        _mark(ax, shock, by_x.factor * (time if over == "place" else 1.0), by_y)
    return ax


def _mark(ax, shock, along, by_y):
    trailing = along * float(shock.trailing_speed)
    leading = along * float(shock.leading_speed)
    ahead = float(getattr(shock, "ahead", 0.0))
    mean = float(shock.mean)
    way = np.sign(leading)
    ground, level, crest = by_y(
        [ahead, mean, ahead + np.copysign(float(shock.amplitude), mean - ahead)]
    )
    seen = [*ax.get_ylim(), level, crest]
    low = np.nanmin(seen)
    high = np.nanmax(seen)
    ax.set_ylim(low, high + 0.16 * (high - low))

    def write(words, place, offset, tone, side, **where):
        look = {"size": "small", "color": tone, "ha": ("center", "left", "right")[int(side)]}
        where = {"xycoords": "data", "textcoords": "offset points", **where}
        ax.annotate(words, place, offset, **look, **where)

    for name, edge, side in (("trailing edge", trailing, -way), ("leading edge", leading, way)):
        if np.isfinite(edge):
            ax.axvline(edge, color=COLOURS[1], ls="--", lw=1.0, zorder=1)
            coords = ("data", "axes fraction")
            write(name, (edge, 1.0), (5 * side, -3), COLOURS[1], side, xycoords=coords, va="top")
    behind = trailing if np.isfinite(trailing) else 0.0
    across = sorted((0.0, behind)) if behind else ax.get_xlim()
    ax.hlines(level, *across, color=COLOURS[2], ls="--", lw=1.8, zorder=3)
    paper = {"fc": "white", "ec": "none", "alpha": 0.8, "pad": 0.5}
    words = f"mean {level:.4g} {by_y.unit}".strip()
    write(words, (behind / 2, level), (0, -4), COLOURS[2], 0, va="top", bbox=paper)
    if not np.isfinite(leading):
        return
    if np.isfinite(crest):
        arrow = {"arrowstyle": "<->", "color": COLOURS[3], "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", (leading, ground), (leading, crest), arrowprops=arrow)
        words = f"amplitude {abs(crest - ground):.4g} {by_y.unit}".strip()
        middle = (leading, (crest + ground) / 2)
        write(words, middle, (6 * way, 0), COLOURS[3], way, va="center")
    # Make room for the text ahead of the leading edge.
    first, last = ax.get_xlim()
    space = 0.4 * (leading - (first if way > 0 else last))
    ax.set_xlim(min(first, leading + space), max(last, leading + space))


def modulation(
    shock: Any,
    ax: AxesOrNone = None,
    *,
    quantity: str = "m",
    beside: Mapping[str, Any] | None = None,
) -> Axes:
    """Draw the modulation of a shock's waves over n/t, measured in windows, beside theories.

    **Arguments:**

    - `shock`: anything with `s` (W,) and `m`, `means`, `amplitudes` or `wavelengths` (W,), such as
      `gx.shocks.measure(run)`. For `m` the speeds of the fitted theory, `speeds_of_m`, are also
      drawn.
    - `quantity`: "m", "mean", "amplitude" (crest minus trough) or "wavelength".
    - `beside`: dict from a name to anything with `speed` (X,) and the quantity (X,), such as
      `gx.theory.toda.modulation(m, c)`; to the result of `gx.shocks.whitham`; or to a pair
      (speeds, values).

    **Returns:** the Axes; the measured values are `ax.lines[0]`.
    """
    measured, field, label, unit = QUANTITIES[one_of("quantity", quantity, tuple(QUANTITIES))]
    s = np.asarray(shock.s)
    values = np.asarray(getattr(shock, measured))
    if not np.isfinite(values).any():
        said = f"none: {getattr(shock, 'outcome', '')}".rstrip(" .:")
        refuse("shock", f"one with {measured}", said, "Draw another quantity, such as 'mean'.")
    curves = {}
    if quantity == "m" and hasattr(shock, "speeds_of_m"):
        name = {"toda": "Toda", "kdv": "KdV"}.get(shock.theory, "theory")
        curves[name] = np.asarray(shock.speeds_of_m), values
    for name, one in (beside or {}).items():
        if not isinstance(one, (tuple, list)) or hasattr(one, "_fields"):
            places, wanted = ("s", measured) if hasattr(one, "s") else ("speed", field)
            if not hasattr(one, wanted):
                remedy = "Draw another quantity, such as 'mean'."
                refuse(f"beside[{name!r}]", f"a result with {wanted}", type(one).__name__, remedy)
            one = getattr(one, places), getattr(one, wanted)
        # At m = 1 a wavelength is infinite.
        curves[name] = [numbers(f"beside[{name!r}]", x, 1, finite=False) for x in one]
    said = units_of(shock)
    by_x = shown(SPEED, s, "1/s", said)
    by_y = shown(label, values, unit, said)
    ax = axes_or_new(ax, 5.2, 3.6)
    ax.plot(by_x(s), by_y(values), "o", color=COLOURS[0], ms=5, label="measured", zorder=3)
    for i, (name, (x, y)) in enumerate(curves.items()):
        order = np.argsort(x)
        dash = DASHES[i % len(DASHES)]
        ax.plot(by_x(x[order]), by_y(y[order]), dash, color=colour(i + 1), label=name)
    ax.set(xlabel=by_x.label, ylabel=by_y.label)
    add_legend(ax, inside=True)
    return ax


def _profile(given, problem, places, time):
    if hasattr(given, "final"):
        problem = getattr(given, "started", None) if problem is None else problem
        if problem is None:
            wanted = "what was run, as gx.shocks.velocity_shock returns it"
            refuse("problem", wanted, "None, and the run does not hold it")
        strain = problem.strain(given.final.u)
        time = np.asarray(given.ts)[-1]
        places = np.arange(len(strain)) - np.asarray(problem.centre, float)
    else:
        strain = given
    strain = numbers("run_or_strain", strain, 1)
    places = rising("places", places, strain.size)
    return places, strain, None if time is None else float(positive("time", time))
