"""Time-periodic orbits: Floquet multipliers, breathers, branches, response curves."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy
from matplotlib.axes import Axes

from ..base.checks import one_of
from ..base.types import Count
from .arrays import numbers
from .histories import space_time
from .style import (
    COLOURS,
    FAINT,
    AxesOrNone,
    add_legend,
    axes_or_new,
    colour,
    new_label,
    shown,
    units_of,
)

# Krein signature -> colour, mark, label
_KREIN = {
    1: (COLOURS[0], "o", "Krein +"),
    -1: (COLOURS[1], "s", "Krein $-$"),
    0: ("0.25", "^", "Krein 0"),
}
_VERDICTS = {
    "stable": (COLOURS[0], "-", "stable"),
    "unstable": (COLOURS[1], "--", "unstable"),
    "undecided": (FAINT, ":", "undecided"),
    "": (COLOURS[0], "-", None),
}
# Line between two points of different verdicts.
UNKNOWN = (FAINT, ":")
# Points of a smooth line per step.
FINE = 12
# Distance between coincident points of a line, as a fraction of its length.
COINCIDING = 1e-9
# Relative difference within which frequencies count as equal.
SAME = 1e-12
# The fields of a `Branch` that are drawn, their labels, their units.
AXES_OF_A_BRANCH = ("energy", "amplitude"), ("energy", r"amplitude $\max|u_n|$"), ("J", "m")
VELOCITY = "velocity (m/s)"
# The `kind` of an event that does not change the stability by itself.
EXTREMUM = "extremum of energy"
_ORBITS = {
    word: ("0.2", dash, name and f"orbit, {name}") for word, (_, dash, name) in _VERDICTS.items()
}


def floquet_circle(fl: Any, ax: AxesOrNone = None, *, legend: bool = True) -> Axes:
    r"""Draw Floquet multipliers in the complex plane with the unit circle.

    Colours and marks show the Krein signature; 0 is off the circle, at a collision of two signs, or
    for a flow without signature. Unstable multipliers have a ring, except those that symmetry puts
    at +1. With uniform damping the circle of radius exp(-gamma T/2), about which multipliers pair,
    is dotted.

    **Arguments:** `fl`: a `Floquet`, or anything with `multipliers` (2n,), `krein` (2n,), `error`
    (2n,), `expected`, `rate` and `period`. `legend`: whether signatures are named. **Returns:** the
    Axes; the rings are the last of `ax.lines`, labelled "unstable".

    **Example:**

    >>> from types import SimpleNamespace
    >>> fl = SimpleNamespace(multipliers=np.array([2.0, 0.5]), krein=[0, 0], error=np.zeros(2), expected=0,
    ...                      rate=0.0, period=1.0)
    >>> gx.plots.floquet_circle(fl).lines[-1].get_label()
    'unstable'
    """
    rho = np.asarray(fl.multipliers)
    signature = np.nan_to_num(np.asarray(fl.krein))
    ax = axes_or_new(ax, 4.2, 4.0)
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 361))
    ax.plot(circle.real, circle.imag, color=FAINT, lw=0.8, zorder=1)
    if fl.rate:
        circle = np.exp(-fl.rate * fl.period / 2) * circle
        ax.plot(circle.real, circle.imag, ":", color=FAINT, lw=1.0, zorder=1)
    for sign, (tone, mark, name) in _KREIN.items():
        own = rho[signature == sign]
        if own.size:
            look = {"color": tone, "ms": 4, "mec": "white", "mew": 0.3, "zorder": 2}
            ax.plot(own.real, own.imag, mark, label=name, **look)
    out = rho[unstable_of(fl)]
    if out.size:
        look = {"ms": 10, "mfc": "none", "mec": COLOURS[6], "mew": 1.2, "zorder": 3}
        ax.plot(out.real, out.imag, "o", label="unstable", **look)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel=r"Re $\rho$", ylabel=r"Im $\rho$")
    if legend:
        add_legend(ax)
    return ax


def unstable_of(fl: Any) -> np.ndarray:
    """Return the indices of unstable multipliers, beyond their error and symmetry."""
    rho = np.asarray(fl.multipliers)
    symmetry = np.argsort(np.abs(rho - 1))[: fl.expected]
    outside = np.flatnonzero(np.abs(rho) - 1 > np.asarray(fl.error))
    return np.setdiff1d(outside, symmetry)


def breather(
    breather: Any,
    fl: Any = None,
    axes: Sequence[Axes] | np.ndarray | None = None,
    *,
    mode: Count | None = None,
    field: str | None = None,
) -> np.ndarray:
    """Draw a breather in four panels: displacements, Floquet multipliers, an eigenvector's halves.

    **Arguments:**

    - `breather`: an `Orbit` of a chain with scalar displacements, or anything with `state` (u, v),
      and `floquet()` unless `fl` is given. `fl`: its `Floquet`.
    - `axes`: four Axes in any shape, for (a) to (d); by default a new figure.
    - `mode`: index of the multiplier whose eigenvector is shown; by default the largest unstable
      one. For a stable orbit (c) is the strain u_n - u_{n+1}, and (d) the velocity over a period,
      from `breather.run()`. The eigenvector is scaled so that its largest displacement is 1;
      imaginary parts, for complex multipliers, are dashed.
    - `field`: which is shown, if a cell has several; by default `"bead"`.

    **Returns:** the Axes, (2, 2) or as given. **Raises** ValueError for several fields without a
    name of one, lanes.
    """
    fl = breather.floquet() if fl is None else fl
    units = units_of(breather)
    axes = axes_or_new(axes, 8.4, 6.4, 2, 2)
    a, b, c, d = axes.ravel()
    at_start = breather.state[0]
    if field is None and isinstance(at_start, dict) and "bead" in at_start:
        field = "bead"
    u = numbers("breather.state.u", _field_of(at_start, field), 1)
    site = np.arange(len(u))
    strain = u[:-1] - u[1:]
    by = shown("$u_n(0)$", u, "m", units)
    _bars(a, site, by(u), by.label)
    floquet_circle(fl, b)
    rho = np.asarray(fl.multipliers)
    outside = unstable_of(fl)
    if mode is None and len(outside):
        mode = outside[np.argmax(np.abs(rho[outside]))]
    if mode is None:
        by = shown("$u_n - u_{n+1}$", strain, "m", units)
        _bars(c, site[:-1] + 0.5, by(strain), by.label)
        c.set_title("no mode grows", loc="left")
        run = breather.run()
        space_time(run, d, quantity=_field_of(run.vs, field), label=VELOCITY, site_label="")
    else:
        u_part, v_part = _parts(fl, mode, at_start, field)
        pair = abs(rho[mode].imag) > fl.error[mode]
        by = shown(r"mode $\delta v_n$", np.abs(v_part), "1/s", units)
        _bars(c, site, u_part, r"mode $\delta u_n$", pair)
        _bars(d, site, by(v_part.real) + 1j * by(v_part.imag), by.label, pair)
        sign = "-" if rho[mode].imag < 0 else "+"
        value = f"{rho[mode].real:.6f}" + f" {sign} {abs(rho[mode].imag):.6f}i" * bool(pair)
        c.set_title(rf"$\rho$ = {value}", loc="left")
    paper = {"fc": "white", "ec": "none", "alpha": 0.8, "pad": 1}
    for letter, ax in zip("abcd", axes.ravel()):
        if ax is not b:
            ax.set(xlabel="site $n$", xlim=(-0.5, len(u) - 0.5))
        ax.annotate(
            f"({letter})", (0.02, 0.98), bbox=paper, xycoords="axes fraction", va="top", zorder=5
        )
    return axes


def _field_of(u, field):
    return u[one_of("field", field, tuple(u))] if isinstance(u, dict) else u


def _parts(fl, mode, u, field):
    halves = np.split(np.asarray(fl.vectors)[:, mode], 2)
    if isinstance(u, dict):
        names = sorted(u)
        ends = np.cumsum([np.size(u[name]) for name in names])[:-1]
        halves = [np.split(half, ends)[names.index(field)] for half in halves]
    largest = halves[0][np.argmax(np.abs(halves[0]))]
    return [half / largest for half in halves]


def _bars(ax, site, u, label, imaginary=False):
    ax.axhline(0, color=FAINT, lw=0.8, zorder=0)
    ax.plot(site, u.real, "-", color=FAINT, lw=0.8, zorder=1)
    ax.plot(site, u.real, "o", color=COLOURS[0], ms=3.5, mec="white", mew=0.3, zorder=2)
    if imaginary:
        ax.plot(site, u.imag, "--", color=COLOURS[1], lw=1.0, label="imaginary part")
        # Room for the legend above the curves.
        ax.set_ymargin(0.2)
        ax.legend(loc="upper right", frameon=False)
    ax.set_ylabel(label)


def branch(
    br: Any,
    axes: Sequence[Axes] | np.ndarray | None = None,
    *,
    bands: Any = None,
    marks: Any = None,
    omega_label: str = r"angular frequency $\omega_b$",
) -> np.ndarray:
    """Draw a family of breathers: energy and amplitude over frequency, stability, bifurcations.

    Breathers of one frequency, as from `gx.breathers.anticontinuous`, are drawn over their
    parameter `p`. Curves through the points are smooth. The stability changes at the bifurcation
    between two points, from `br.bifurcations` or `marks`; with none or several the curve between
    the two points is dotted.

    **Arguments:**

    - `br`: a `Branch`, or anything with `omega`, `energy`, `amplitude`, (P,) each, and `verdict`: P
      words "stable", "unstable", "undecided", or ""; optionally `p` (P,) and `bifurcations`.
    - `axes`: two Axes; by default a new figure. `bands`: intervals (B, 2) of the linear spectrum to
      shade, such as `gx.breathers.bands_of(chain)[0]`; `marks`: bifurcations to mark, from
      `gx.breathers.bifurcations(br)`, or frequencies. Energy extrema, where stability may change,
      are diamonds.
    - `omega_label`: of the frequency axis.

    **Returns:** the two Axes. **Raises** ValueError for shapes that do not fit.

    **Example:**

    >>> from types import SimpleNamespace
    >>> omega = np.array([1.6, 1.65, 1.7])
    >>> found = SimpleNamespace(omega=omega, energy=1.73 - omega, amplitude=1.73 - omega, verdict=["stable"] * 3)
    >>> axes = gx.plots.branch(found)
    >>> axes[0].get_ylabel()
    'energy'
    """
    units = units_of(br)
    x = np.asarray(br.omega)
    over = shown(omega_label, br.omega, "rad/s", units)
    if hasattr(br, "p") and len(x) > 1 and np.ptp(x) <= SAME * np.abs(x).max():
        x = np.asarray(br.p)
        over = shown("coupling", br.p, None, units)
    x = over(x)
    bands = () if bands is None else over(bands)
    marks = () if marks is None else np.ravel(np.asarray(marks, object))
    axes = axes_or_new(axes, 8.4, 3.4, 1, 2)
    room = 0.06 * (np.ptp(x) or x[0])
    for ax, name, label, unit in zip(axes.ravel(), *AXES_OF_A_BRANCH):
        values = getattr(br, name)
        by = shown(label, values, unit, units)
        height = by(values)
        _line(ax, x, height, br, _VERDICTS, marks)
        for low, high in bands:
            ax.axvspan(low, high, color=FAINT, alpha=0.3, lw=0, zorder=0)
        for mark in marks:
            if getattr(mark, "kind", "") == EXTREMUM:
                continue
            place = over.factor * getattr(mark, "p", mark)
            look = {"color": COLOURS[2], "ls": ":", "lw": 1.0, "zorder": 1}
            ax.axvline(place, label=new_label(ax, "bifurcation"), **look)
        ax.set_xlim(x.min() - room, x.max() + room)
        # A family of similar energies fills the axis, so that its extremum is visible.
        low = height.min()
        high = height.max()
        ax.set_ylim(0 if high - low > 0.5 * high else low - 0.1 * (high - low or 1), None)
        ax.set_ylim(None, high + 0.06 * (high - ax.get_ylim()[0]))
        ax.set(xlabel=over.label, ylabel=by.label)
        # Few enough ticks for a journal column, since frequencies have many digits.
        ax.locator_params(axis="x", nbins=5)
    add_legend(ax, inside=True)
    return axes


def diagram(found: Any, ax: AxesOrNone = None, *, label: str = "parameter") -> Axes:
    """Draw the branches of `gx.orbits.diagram`: the largest |u| at t0 over the parameter.

    Stable orbits are solid, others dashed; tori have dots. Each kind of bifurcation has its own
    mark.

    **Arguments:** `found`: a `Diagram`, or anything with `branches`, each with `p`, `amplitude`,
    `verdict`. `label`: of the parameter axis. **Returns:** the Axes.

    **Example:**

    >>> from types import SimpleNamespace
    >>> one = SimpleNamespace(p=np.arange(3.0), amplitude=np.ones(3), verdict=["stable"] * 3, bifurcations=())
    >>> ax = gx.plots.diagram(SimpleNamespace(branches=[one]))
    """
    units = units_of(found.branches[0])
    by = shown("max |u|", found.branches[0].amplitude, "m", units)
    over = shown(label, np.concatenate([one.p for one in found.branches]), None, units)
    ax = axes_or_new(ax, 5.4, 3.4)
    marks = {"fold": "s", "branch point": "o", "period doubling": "^", "Neimark-Sacker": "D"}
    for i, one in enumerate(found.branches):
        x = over(one.p)
        y = by(one.amplitude)
        tone = colour(i)
        torus = not hasattr(one, "bifurcations")
        stable = np.asarray(one.verdict) == "stable"
        for whole, dash in ((stable, "-"), (~stable, "--")):
            # A step belongs to the part of its first point.
            kept = whole | np.append(False, whole[:-1])
            look = {"color": tone, "lw": 1.3, "marker": "." if torus else None}
            ax.plot(x, np.where(kept, y, np.nan), dash, **look)
        for event in getattr(one, "bifurcations", ()):
            if event.kind in marks:
                step = slice(event.after, event.after + 2)
                order = step.start + np.argsort(x[step])
                at = np.interp(over(event.p), x[order], y[order])
                look = {"color": "k", "ms": 5, "mfc": "w", "zorder": 3}
                name = new_label(ax, event.kind)
                ax.plot(over(event.p), at, marks[event.kind], label=name, **look)
    ax.set(xlabel=over.label, ylabel=by.label)
    add_legend(ax, inside=True)
    return ax


def _line(ax, x, y, br, looks, marks=()):
    """Draw a smooth line in parts of one verdict each, cut at the located bifurcation.

    Where the verdict changes without one, or with several, the verdict in between is unknown:
    dotted.
    """
    verdict = np.asarray(br.verdict)
    p = np.asarray(br.p if hasattr(br, "p") else br.omega, float)
    curve = np.column_stack([x, y, p])
    span = np.ptp(curve[:, :2], axis=0) + np.finfo(float).tiny
    step = np.linalg.norm(np.diff(curve[:, :2], axis=0) / span, axis=1)
    s = np.concatenate([[0.0], np.cumsum(np.maximum(step, COINCIDING * (step.sum() or 1.0)))])
    last = len(s) - 1
    fine = np.interp(np.linspace(0, last, FINE * last + 1), np.arange(last + 1), s)
    at = (
        scipy.interpolate.Akima1DInterpolator(s, curve)
        if len(s) > 1
        else lambda s: curve[[0] * len(s)]
    )
    events = [*getattr(br, "bifurcations", ()), *marks]
    begin = 0.0

    def part(low, high, tone, dash, name=None):
        drawn = at(np.unique(np.clip(fine, low, high)))
        look = {"color": tone, "lw": 1.4, "zorder": 2, "label": new_label(ax, name)}
        ax.plot(*drawn.T[:2], dash, **look)

    # The steps of events, where they lie along the line, and whether they are extrema.
    placed = []
    for event in events:
        extremum = getattr(event, "kind", "") == EXTREMUM
        after = getattr(event, "after", None)
        for i in range(last) if after is None else [after]:
            places = np.linspace(s[i], s[min(i + 1, last)], 1001)
            away = at(places)[:, 2] - getattr(event, "p", event)
            if after == i or away.min() <= 0 <= away.max():
                placed.append((i, places[np.argmin(np.abs(away))], extremum))
    for i in [*np.flatnonzero(verdict[1:] != verdict[:-1]), last]:
        found = [z for step, z, extremum in placed if step == i and not extremum]
        end, resumed = (min(found), max(found)) if found else s[[i, min(i + 1, last)]]
        part(begin, end, *looks[str(verdict[i])])
        if resumed > end:
            part(end, resumed, *UNKNOWN)
        begin = resumed
    tops = [z for _, z, extremum in placed if extremum]
    if tops:
        drawn = at(np.unique(tops))
        look = {"ms": 6, "mfc": "white", "zorder": 4, "ls": ""}
        ax.plot(*drawn.T[:2], "D", color="black", label=EXTREMUM, **look)


def hysteresis(
    sweep: Any,
    ax: AxesOrNone = None,
    *,
    orbits: Any = None,
    x_label: str = "parameter",
    y_label: str = "response",
) -> Axes:
    """Draw the response to a parameter swept up and down; the difference is shaded.

    **Arguments:**

    - `sweep`: a `gx.driven.ResponseCurve`, or anything with its `values` (P,), `up`, `down` and
      `hysteresis`.
    - `orbits`: a `Branch`, or anything with `p`, `response` and `verdict` (P,), drawn behind in
      smooth curves that change at its `bifurcations`, unstable parts dashed.
    - `x_label`, `y_label`: of the axes. An SI unit at the end, "angular frequency (rad/s)" or "rms
      velocity (m/s)", gets a prefix.

    **Returns:** the Axes.
    """
    values = np.asarray(sweep.values)
    up = sweep.up.response
    units = units_of(sweep, orbits)
    by_x = shown(x_label, values, None, units)
    by_y = shown(y_label, up, None, units)
    ax = axes_or_new(ax, 5.6, 3.6)
    for low, high in by_x(np.reshape(sweep.hysteresis, (-1, 2))):
        ax.axvspan(low, high, color=FAINT, alpha=0.2, lw=0, zorder=0)
    if orbits is not None:
        _line(ax, by_x(orbits.p), by_y(orbits.response), orbits, _ORBITS)
    look = {"ms": 5, "lw": 1.2, "mec": "white", "mew": 0.3}
    ax.plot(by_x(values), by_y(up), ">-", color=COLOURS[0], label="up", **look)
    if sweep.down is not None:
        ax.plot(
            by_x(values), by_y(sweep.down.response), "<--", color=COLOURS[1], label="down", **look
        )
    ax.set(xlabel=by_x.label, ylabel=by_y.label)
    add_legend(ax, inside=True)
    return ax
