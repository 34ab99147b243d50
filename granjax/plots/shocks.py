"""Dispersive shocks: the strain with its edges, a few waves of it, its modulation, edges in space and time."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from scipy.interpolate import CubicSpline

from ..checks import one_of, positive, refuse
from ..types import Parameter, Scalar
from ..units import UnitsOrWords
from .arrays import numbers, rising
from .histories import space_time
from .quantities import Axis, drawn_in, scaled_by, units_of, units_of_both
from .style import COLOURS, DASHES, AxesOrNone, axes_or_new, colour

BOND, SPEED = r"bond from the step $n$", r"speed $n/t$, bonds per time"
OVER = ("place", "speed")
EDGES = ("trailing_speed", "leading_speed")
# of `modulation`: the field of a `Shock`, that of a theory, what it is called, and the unit of its numbers in SI
QUANTITIES = {
    "m": ("m", "m", r"modulation parameter $m$", ""),
    "mean": ("means", "mean", "mean strain", "m"),
    "amplitude": ("amplitudes", "amplitude", "strain, crest less trough", "m"),
    "wavelength": ("wavelengths", "wavelength", "wavelength (bonds)", ""),
}
# points of a line from bond to bond; bonds of a zoom at least
FINE, LEAST = 16, 4


def shock(
    run_or_strain: Any,
    shock: Any = None,
    ax: AxesOrNone = None,
    *,
    problem: Any = None,
    places: Parameter | None = None,
    time: Scalar | None = None,
    over: str = "place",
    units: UnitsOrWords = None,
) -> Axes:
    r"""Strain after a step over the place, or over n/t, with edges, plateau and amplitude of a shock.

    **Arguments:**

    - `run_or_strain`: a run of `problem.run(...)`, whose last state is drawn; a `SpaceTime`, its last frame; or
      strains (B,). `problem`: what was run, `None` for what the run remembers.
    - `shock`: anything with `trailing_speed`, `leading_speed`, `mean` and `amplitude`, such as `gx.shocks.measure(run)`
      or a theory's `velocity_shock(c)`: its edges are dashed, its mean and its amplitude drawn and written beside.
    - `places` (B,), rising: of strains, from the step; `time`: theirs, needed where edges are drawn or `over="speed"`.
    - `over`: "place" or "speed". `units`: `"um"`, as in `granjax.plots`; a speed counts bonds per time.

    **Returns:** the Axes; the strain is `ax.lines[0]`. **Raises** ValueError for a batch.

    **Example:**

    >>> n = np.arange(-100.0, 100.0)
    >>> wave = gx.theory.kdv.velocity_shock(0.05, 1.0, 0.5)
    >>> ax = gx.plots.shock(0.05 - 0.05 * np.tanh(n - 50), wave, places=n, time=50.0)
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('bond from the step $n$', 'strain')
    """
    one_of("over", over, OVER)
    places, strain, time, said = _profile(run_or_strain, problem, places, time)
    if shock is not None:
        said = units_of_both(run_or_strain, shock, "shock", "run") or said
    if time is None and (shock is not None or over == "speed"):
        refuse("time", "that of the strains", "None", "Edges are n/t.")
    x = places if over == "place" else places / time
    by_x, by_y = drawn_in(
        units,
        said,
        Axis(BOND, x, "") if over == "place" else Axis(SPEED, x, "1/s"),
        Axis("strain", strain),
    )
    ax = axes_or_new(ax, 6.4, 3.6)
    ax.plot(
        scaled_by(x, by_x.factor),
        scaled_by(strain, by_y.factor),
        color=COLOURS[0],
        lw=0.9,
        label="strain",
    )
    ax.set_xlim(*scaled_by(x[[0, -1]], by_x.factor))
    ax.set_xlabel(by_x.label)
    ax.set_ylabel(by_y.label)
    if shock is not None:
        _mark(ax, shock, by_x.factor * (time if over == "place" else 1.0), by_y, strain)
    return ax


def _mark(ax, shock, along, by_y, strain):
    """Edges, plateau and amplitude; `along`: what a speed is multiplied with to be a place of the picture."""
    trailing, leading, mean, amplitude = (
        _number(f"shock.{name}", getattr(shock, name)) for name in (*EDGES, "mean", "amplitude")
    )
    ahead, way = float(getattr(shock, "ahead", 0.0)), np.sign(leading)
    level, top = (
        scaled_by(y, by_y.factor) for y in (mean, ahead + np.copysign(amplitude, mean - ahead))
    )
    low, high = (
        pick([y, *(x for x in (level, top) if np.isfinite(x))])
        for pick, y in zip((min, max), ax.get_ylim())
    )
    ax.set_ylim(low, high + 0.16 * (high - low))
    for name, speed, side in (("trailing edge", trailing, -way), ("leading edge", leading, way)):
        if np.isfinite(speed):
            ax.axvline(along * speed, color=COLOURS[1], ls="--", lw=1.0, zorder=1)
            ax.annotate(
                f"{name} ",
                (along * speed, 1.0),
                (5 * side, -3),
                ("data", "axes fraction"),
                "offset points",
                color=COLOURS[1],
                size="small",
                va="top",
                ha="left" if side > 0 else "right",
            )
    unit = f" {by_y.unit}" if by_y.unit and by_y.unit != "scaled" else ""
    behind = along * (trailing if np.isfinite(trailing) else 0.0)
    ax.hlines(
        level,
        *sorted((0.0, behind)) if behind else ax.get_xlim(),
        color=COLOURS[2],
        ls="--",
        lw=1.2,
        zorder=3,
    )
    ax.annotate(
        f"mean {level:.4g}{unit}",
        (behind / 2, level),
        (0, -4),
        "data",
        "offset points",
        color=COLOURS[2],
        size="small",
        va="top",
        ha="center",
        bbox={"fc": "white", "ec": "none", "alpha": 0.8, "pad": 0.5},
    )
    if np.isfinite(leading) and np.isfinite(top):
        ends = [(along * leading, y) for y in (scaled_by(ahead, by_y.factor), top)]
        ax.annotate(
            "",
            *ends,
            arrowprops={"arrowstyle": "<->", "color": COLOURS[3], "shrinkA": 0, "shrinkB": 0},
        )
        ax.annotate(
            f" amplitude {abs(top - ends[0][1]):.4g}{unit}",
            (along * leading, (top + ends[0][1]) / 2),
            (6 * way, 0),
            "data",
            "offset points",
            color=COLOURS[3],
            size="small",
            ha="left" if way > 0 else "right",
            va="center",
        )
    _room(ax, along * leading, way)


def _room(ax, edge, way):
    """Place for what is written ahead of the leading edge."""
    low, high = ax.get_xlim()
    if not np.isfinite(edge):
        return
    space = 0.3 * abs(edge - (low if way > 0 else high))
    ax.set_xlim(*(low, max(high, edge + space)) if way > 0 else (min(low, edge - space), high))


def shock_core(
    run_or_strain: Any,
    window: Parameter,
    ax: AxesOrNone = None,
    *,
    beside: Mapping[str, Any] | None = None,
    problem: Any = None,
    places: Parameter | None = None,
    units: UnitsOrWords = None,
) -> Axes:
    """A few waves of a shock: the strain of each bond as a dot, and waves through or beside them.

    **Arguments:**

    - `run_or_strain`, `problem`, `places`: as of `shock`. `window`: a pair, the first and the last place that is shown.
    - `beside`: dict from a name to a pair (places (X,), strains (X,)), rising, such as modulated waves of KdV and
      Toda, `gx.theory.toda.shock_wave(n, t, c).strain`; `None` draws the interpolating spline through the dots.

    **Returns:** the Axes; the dots are `ax.lines[0]`. **Raises** ValueError for a window of fewer than four bonds.

    **Example:**

    >>> n = np.arange(20.0)
    >>> ax = gx.plots.shock_core(0.1 + 0.05 * np.cos(n), (0.0, 12.0), places=n)
    >>> len(ax.lines[0].get_xdata())
    13
    """
    places, strain, _, said = _profile(run_or_strain, problem, places, None)
    low, high = _pair("window", window)
    inside = (places >= low) & (places <= high)
    if inside.sum() < LEAST:
        refuse(
            "window",
            f"{LEAST} bonds or more of those from {places[0]:g} to {places[-1]:g}",
            f"{low:g} to {high:g}",
        )
    curves = {}
    if beside is None:
        fine = np.linspace(*places[inside][[0, -1]], FINE * (inside.sum() - 1) + 1)
        curves["spline"] = fine, CubicSpline(places, strain)(fine)
    for name, given in (beside or {}).items():
        x, y = _pair(f"beside[{name!r}]", given, 1)
        x = rising(f"beside[{name!r}]", x, y.size)
        cut = (x >= low) & (x <= high)
        curves[name] = x[cut], y[cut]
    by_x, by_y = drawn_in(units, said, Axis(BOND, places, ""), Axis("strain", strain))
    ax = axes_or_new(ax, 5.2, 3.4)
    ax.plot(
        places[inside],
        scaled_by(strain[inside], by_y.factor),
        "o",
        color=COLOURS[0],
        ms=3.5,
        label="lattice",
        zorder=3,
    )
    for i, (name, (x, y)) in enumerate(curves.items()):
        ax.plot(
            x,
            scaled_by(y, by_y.factor),
            DASHES[i % len(DASHES)],
            color=colour(i + 1),
            lw=1.2,
            label=name,
        )
    ax.set_xlim(low, high)
    ax.set_xlabel(by_x.label)
    ax.set_ylabel(by_y.label)
    if beside:
        ax.legend(
            loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.2, frameon=False
        )
    return ax


def shock_map(
    record: Any,
    ax: AxesOrNone = None,
    *,
    edges: Mapping[str, Any] | None = None,
    ts: Parameter | None = None,
    places: Parameter | None = None,
    limit: Scalar | None = None,
    units: UnitsOrWords = None,
) -> Axes:
    """Map of the strain in space and time, with the lines n = s t of the edges that theories give.

    **Arguments:**

    - `record`: a `SpaceTime`, or anything with `strain` (T, B), `ts` and `places`; or strains (T, B), with `ts` (T,)
      and `places` (B,) beside them.
    - `edges`: dict from a name to anything with `trailing_speed` and `leading_speed`, such as a theory's
      `velocity_shock(c)` or a `Shock`: the first solid, the second dashed. A speed that is NaN is left out.
    - `limit`: strain of the full colour; `units`: `("us", "nm")`, as in `granjax.plots`.

    **Returns:** the Axes; the image is `ax.images[0]` (`ax.collections[0]` where places are uneven), the lines
    `ax.lines`. **Raises** ValueError for a batch, or shapes that do not fit.

    **Example:**

    >>> t, n = np.arange(5.0), np.arange(-10.0, 11.0)
    >>> edges = gx.theory.kdv.velocity_shock(0.05, 1.0, 0.5)
    >>> ax = gx.plots.shock_map(0.1 * (n < t[:, None]), ts=t, places=n, edges={"KdV": edges})
    >>> len(ax.lines)  # the trailing edge and the leading one
    2
    """
    if ts is None and places is None:
        strain, ts, places = record.strain, record.ts, record.places
    else:
        strain = record
    strain = numbers("record", strain, 2, finite=False)
    ts, places = rising("ts", ts, strain.shape[0]), rising("places", places, strain.shape[1])
    lines, said = {}, units_of(record)
    for name, one in (edges or {}).items():
        lines[name] = [_number(f"edges[{name!r}].{end}", getattr(one, end)) for end in EDGES]
        said = units_of_both(record, one, f"edges[{name!r}]", "map") or said
    by_time, _ = drawn_in(None, said, Axis("time", ts), Axis("strain", strain))
    ax = space_time(
        _Map(ts, strain, strain, said),
        ax,
        quantity=strain,
        sites=places,
        label="strain (m)" if said else "strain",
        site_label=BOND,
        limit=limit,
    )
    ax.set_xlim(*ax.get_xlim())
    ax.set_ylim(*ax.get_ylim())
    image = (*ax.images, *ax.collections)[0]
    tone = "white" if image.cmap.name.startswith("viridis") else "black"
    for i, (name, speeds) in enumerate(lines.items()):
        for j, speed in enumerate(s for s in speeds if np.isfinite(s)):
            ax.plot(
                speed * ts,
                scaled_by(ts, by_time.factor),
                DASHES[i % len(DASHES)],
                color=tone,
                lw=1.2,
                label=None if j else name,
            )
    if lines:
        ax.legend(loc="lower right", frameon=False, labelcolor=tone)
    return ax


class _Map(NamedTuple):
    """What `space_time` takes for a run."""

    ts: Any
    us: Any
    vs: Any
    units: str | None


def modulation(
    shock: Any,
    ax: AxesOrNone = None,
    *,
    quantity: str = "m",
    beside: Mapping[str, Any] | None = None,
    units: UnitsOrWords = None,
) -> Axes:
    """How the waves of a shock change along it: as measured in windows, over n/t, beside theories.

    **Arguments:**

    - `shock`: anything with `s` (W,) and what is drawn, `m`, `means`, `amplitudes` or `wavelengths` (W,), such as
      `gx.shocks.measure(run)`. Of `m` what the theory that it was fitted with has at n/t, `speeds_of_m`, is drawn too.
    - `quantity`: "m", "mean", "amplitude" (crest less trough) or "wavelength".
    - `beside`: dict from a name to anything with `speed` (X,) and the quantity (X,), such as
      `gx.theory.toda.modulation(m, c)`; or to a pair (speeds, values).
    - `units`: `("1/ms", "nm")`, as in `granjax.plots`.

    **Returns:** the Axes; what was measured is `ax.lines[0]`.

    **Example:**

    >>> from types import SimpleNamespace
    >>> wave = gx.theory.toda.modulation(0.5, 0.5)
    >>> shock = SimpleNamespace(s=np.array([wave.speed]), amplitudes=np.array([wave.amplitude]))
    >>> ax = gx.plots.modulation(shock, quantity="amplitude")
    >>> ax.get_ylabel()
    'strain, crest less trough'
    """
    measured, field, label, unit = QUANTITIES[one_of("quantity", quantity, tuple(QUANTITIES))]
    s = numbers("shock.s", shock.s, 1)
    values = numbers(f"shock.{measured}", getattr(shock, measured), 1, finite=False)
    curves = {}
    if quantity == "m" and hasattr(shock, "speeds_of_m"):
        name = {"toda": "Toda", "kdv": "KdV"}.get(shock.theory, "theory")
        curves[name] = numbers("shock.speeds_of_m", shock.speeds_of_m, 1, finite=False), values
    for name, one in (beside or {}).items():
        if not isinstance(one, (tuple, list)) or hasattr(one, "_fields"):
            one = one.speed, getattr(one, field)
        # where m = 1 a wavelength is infinite
        curves[name] = _pair(f"beside[{name!r}]", one, 1, finite=False)
    by_x, by_y = drawn_in(units, units_of(shock), Axis(SPEED, s, "1/s"), Axis(label, values, unit))
    ax = axes_or_new(ax, 5.2, 3.6)
    ax.plot(
        scaled_by(s, by_x.factor),
        scaled_by(values, by_y.factor),
        "o",
        color=COLOURS[0],
        ms=5,
        label="measured",
        zorder=3,
    )
    for i, (name, (x, y)) in enumerate(curves.items()):
        order = np.argsort(x)
        ax.plot(
            scaled_by(x[order], by_x.factor),
            scaled_by(y[order], by_y.factor),
            DASHES[i % len(DASHES)],
            color=colour(i + 1),
            label=name,
        )
    ax.set_xlabel(by_x.label)
    ax.set_ylabel(by_y.label)
    ax.legend(frameon=False)
    return ax


def _number(argument, x):
    """One number, or NaN."""
    return float(numbers(argument, x, 0, finite=False))


def _pair(argument, given, ndim=0, finite=True):
    """Two arrays of a pair."""
    first, second = given
    return numbers(argument, first, ndim, finite), numbers(argument, second, ndim, finite)


def _profile(given, problem, places, time):
    """Places, strains, time (`None` where nobody says) and units of what is drawn."""
    if hasattr(given, "final") and hasattr(given, "ts") and not hasattr(given, "strain"):
        problem = getattr(given, "started", None) if problem is None else problem
        if problem is None:
            refuse(
                "problem",
                "what was run, as gx.shocks.velocity_shock returns it",
                "None, and the run does not know",
            )
        strain = problem.strain(given.final.u)
        places, time = (
            np.arange(len(strain)) - np.asarray(problem.centre, float),
            np.asarray(given.ts)[-1],
        )
    elif hasattr(given, "strain") and hasattr(given, "places") and hasattr(given, "ts"):
        strain, places, time = np.asarray(given.strain)[-1], given.places, np.asarray(given.ts)[-1]
    else:
        strain = given
    strain = numbers("run_or_strain", strain, 1)
    places = rising("places", np.arange(strain.size) if places is None else places, strain.size)
    return places, strain, None if time is None else float(positive("time", time)), units_of(given)
