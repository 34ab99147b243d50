"""Time-periodic orbits: Floquet multipliers, breathers, branches, response curves up and down, strain over time."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from scipy.interpolate import Akima1DInterpolator

from ..checks import one_of, refuse
from ..types import Count
from ..units import UnitsOrWords
from .arrays import history, numbers, rising
from .histories import space_time
from .quantities import Axis, drawn_in, scaled_by, units_of, units_of_both
from .style import COLOURS, FAINT, AxesOrNone, add_colour_bar, axes_or_new, several_axes

# Krein signature -> colour, mark, what it is called
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
# between two verdicts; points of a line in a step
UNKNOWN, FINE = (FAINT, ":"), 12
# of its length, how far apart points of a line count that coincide
COINCIDING = 1e-9
# of one frequency: rounding
SAME = 1e-12
_ORBITS = {
    "stable": ("0.2", "-", "orbit, stable"),
    "unstable": ("0.2", "--", "orbit, unstable"),
    "undecided": ("0.2", ":", "orbit, undecided"),
}


def floquet_circle(
    fl: Any, ax: AxesOrNone = None, *, legend: bool = True, units: UnitsOrWords = None
) -> Axes:
    r"""Floquet multipliers in the complex plane with the unit circle.

    Colours and marks tell the Krein signature; 0 is off the circle, at a meeting of two signs, or of a flow without
    one. Unstable multipliers, but for those that symmetry puts at +1, have a ring. With uniform damping the circle of
    radius exp(-gamma T/2), about which multipliers pair, is dotted.

    **Arguments:** `fl`: a `Floquet`, or anything with `multipliers` (2n,), `krein` (2n,), `error` (2n,), `expected`,
    `rate` and `period`. `legend`: whether signatures are named. `units`: as in `granjax.plots`; multipliers are pure
    numbers, which take no words.

    **Returns:** the Axes; the rings are the last of `ax.lines`, labelled "unstable".

    **Example:**

    >>> from types import SimpleNamespace
    >>> fl = SimpleNamespace(multipliers=np.array([2.0, 0.5]), krein=[0, 0], error=np.zeros(2), expected=0,
    ...                      rate=0.0, period=1.0)
    >>> gx.plots.floquet_circle(fl).lines[-1].get_label()
    'unstable'
    """
    drawn_in(units, units_of(fl))
    rho, signature = np.asarray(fl.multipliers), np.nan_to_num(np.asarray(fl.krein))
    ax = axes_or_new(ax, 4.2, 4.0)
    angle = np.linspace(0, 2 * np.pi, 361)
    ax.plot(np.cos(angle), np.sin(angle), color=FAINT, lw=0.8, zorder=1)
    if fl.rate:
        radius = np.exp(-fl.rate * fl.period / 2)
        ax.plot(radius * np.cos(angle), radius * np.sin(angle), ":", color=FAINT, lw=1.0, zorder=1)
    for sign, (tone, mark, name) in _KREIN.items():
        own = signature == sign
        if own.any():
            ax.plot(
                rho[own].real,
                rho[own].imag,
                mark,
                color=tone,
                ms=4,
                mec="white",
                mew=0.3,
                label=name,
                zorder=2,
            )
    outside = unstable_of(fl)
    if len(outside):
        ax.plot(
            rho[outside].real,
            rho[outside].imag,
            "o",
            ms=10,
            mfc="none",
            mec=COLOURS[6],
            mew=1.2,
            label="unstable",
            zorder=3,
        )
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel(r"Re $\rho$")
    ax.set_ylabel(r"Im $\rho$")
    if legend:
        ax.legend(loc="center", handletextpad=0.2, frameon=False)
    return ax


def unstable_of(fl: Any) -> np.ndarray:
    """Indices of the multipliers outside the unit circle by more than their error, symmetries' at +1 left out."""
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
    units: UnitsOrWords = None,
) -> np.ndarray:
    """A breather in four panels: displacements, Floquet multipliers, displacement and velocity of an eigenvector.

    Of a stable one, of which nothing grows, strain and a period of the velocities instead.

    **Arguments:**

    - `breather`: an `Orbit` of a chain with scalar displacements, or anything with `state` (u, v), and `floquet()`
      unless `fl` is given. `fl`: its `Floquet`.
    - `axes`: four Axes in any shape, for (a) to (d); by default those of a new figure.
    - `mode`: index of the multiplier whose eigenvector is shown; by default the largest unstable one. A stable orbit
      has none: (c) then is the strain u_n - u_{n+1}, and (d), where the breather has `run()`, the velocity over a
      period. The eigenvector is turned so that its largest displacement is real, positive and 1; imaginary parts, of
      complex multipliers, are dashed.
    - `field`: which is shown, where a cell holds several; by default `"bead"`.
    - `units`: `("um", "us", "mm/s")`, as in `granjax.plots`.

    **Returns:** the Axes, (2, 2) or as given. **Raises** ValueError for several fields without a name of one, lanes,
    a mode that is not there.

    **Example:**

    >>> from types import SimpleNamespace
    >>> fl = SimpleNamespace(multipliers=np.exp([0.5j, -0.5j, 1j, -1j]), vectors=np.eye(4), krein=[1, -1, 1, -1],
    ...                      error=np.zeros(4), expected=0, rate=0.0, period=2.0)
    >>> axes = gx.plots.breather(SimpleNamespace(state=gx.State(np.array([0.1, -0.1]), np.zeros(2))), fl)
    >>> axes.shape
    (2, 2)
    """
    fl = breather.floquet() if fl is None else fl
    axes = several_axes(axes, 2, 2, 8.4, 6.4)
    a, b, c, d = axes.ravel()
    if field is None and isinstance(breather.state[0], dict) and "bead" in breather.state[0]:
        field = "bead"
    u = numbers("breather.state.u", _field_of(breather.state[0], field), 1)
    site = np.arange(len(u))
    mode = _mode(fl, mode)
    history = breather.run() if mode is None and hasattr(breather, "run") else None
    still = [Axis("displacement $u_n(0)$", u), Axis("strain $u_n - u_{n+1}$", u[:-1] - u[1:])]
    # what a stable orbit shows takes its words of another one too
    ts, vs = (0.0, 0.0) if history is None else (history.ts, _field_of(history.vs, field))
    moving = [Axis("time", ts), Axis("velocity", vs)]
    u_part, v_part = (None, None) if mode is None else _parts(fl, mode, breather.state[0], field)
    growing = [] if mode is None else [Axis("velocity of the mode", np.abs(v_part), "1/s")]
    by = drawn_in(units, units_of(breather), *still, *moving, *growing)
    _bars(a, site, scaled_by(u, by[0].factor), COLOURS[0])
    a.set_ylabel(by[0].label)
    floquet_circle(fl, b)
    if mode is None:
        _bars(c, site[:-1] + 0.5, scaled_by(u[:-1] - u[1:], by[1].factor), COLOURS[0])
        c.set_ylabel(by[1].label)
        c.set_title("no mode grows", loc="left")
        _period(d, history, by[2:4], field)
    else:
        shown = (
            ("displacement of the mode", c, u_part),
            (by[4].label, d, scaled_by(v_part, by[4].factor)),
        )
        complex_pair = abs(fl.multipliers[mode].imag) > fl.error[mode]
        for name, ax, part in shown:
            _bars(ax, site, part.real, COLOURS[0])
            if complex_pair:
                ax.plot(site, part.imag, "--", color=COLOURS[1], lw=1.0, label="imaginary part")
                ax.legend(loc="upper right", frameon=False)
            ax.set_ylabel(name)
        c.set_title(rf"$\rho$ = {_written(fl.multipliers[mode], complex_pair)}", loc="left")
    for letter, ax in zip("abcd", (a, b, c, d)):
        if ax is not b:
            ax.set_xlabel("site $n$")
            ax.set_xlim(-0.5, len(u) - 0.5)
        ax.annotate(f"({letter})", (0.02, 0.98), xycoords="axes fraction", va="top", zorder=5)
    return axes


def _field_of(u, field):
    """One field of displacements or velocities, those of the plain array where there is one."""
    if not isinstance(u, dict):
        return u
    return u[one_of("field", field, tuple(u))]


def _parts(fl, mode, u, field):
    """Displacements and velocities of an eigenvector, of the field shown, whose largest displacement there is 1."""
    vector = np.asarray(fl.vectors)[:, mode]
    if isinstance(u, dict):
        sizes = {name: np.size(u[name]) for name in sorted(u)}
        first = sum(sizes[name] for name in sizes if name < field)
        own = first + np.arange(sizes[field])
        vector = vector[np.concatenate([own, len(vector) // 2 + own])]
    return np.split(vector / vector[np.argmax(np.abs(vector[: len(vector) // 2]))], 2)


def _period(ax, run, by, field):
    """A period of the velocities over sites and time, where there is a run of it."""
    if run is None:
        ax.text(
            0.5,
            0.5,
            "no growing mode",
            ha="center",
            va="center",
            color="0.35",
            transform=ax.transAxes,
        )
        return
    by_time, by_velocity = by
    ts, vs = (
        scaled_by(numbers("run", x), way.factor)
        for x, way in zip((run.ts, _field_of(run.vs, field)), by)
    )
    top = float(np.abs(vs).max()) or 1.0
    ends = (-0.5, vs.shape[1] - 0.5, ts[0], 2 * ts[-1] - ts[-2])
    image = ax.imshow(
        vs, origin="lower", aspect="auto", extent=ends, cmap="RdBu_r", vmin=-top, vmax=top
    )
    ax.set_ylabel(by_time.label)
    add_colour_bar(ax, image, by_velocity.label)


def _mode(fl, mode):
    if mode is None:
        outside = unstable_of(fl)
        return (
            outside[np.argmax(np.abs(np.asarray(fl.multipliers)[outside]))]
            if len(outside)
            else None
        )
    if not -len(fl.multipliers) <= mode < len(fl.multipliers):
        refuse("mode", f"an index of {len(fl.multipliers)} multipliers", repr(mode))
    return mode


def _bars(ax, site, u, tone):
    ax.axhline(0, color=FAINT, lw=0.8, zorder=0)
    ax.plot(site, u, "-", color=FAINT, lw=0.8, zorder=1)
    ax.plot(site, u, "o", color=tone, ms=3.5, mec="white", mew=0.3, zorder=2)


def _written(rho, complex_pair):
    if not complex_pair:
        return f"{rho.real:.6f}"
    return f"{rho.real:.6f} {'-' if rho.imag < 0 else '+'} {abs(rho.imag):.6f}i"


def branch(
    br: Any,
    axes: Sequence[Axes] | np.ndarray | None = None,
    *,
    bands: Any = None,
    marks: Any = None,
    units: UnitsOrWords = None,
    omega_label: str = r"angular frequency $\omega_b$",
    p_label: str = "coupling",
) -> np.ndarray:
    """A family of breathers: energy and amplitude over frequency, stable and unstable parts, bands, bifurcations.

    Breathers of one frequency, as from `gx.breathers.anticontinuous`, are drawn over their parameter `p`.

    Smooth curves through the points. A part of one stability ends at the bifurcation between two points, of
    `br.bifurcations` or `marks`; where none is known (or several are) the curve between the two points is dotted.

    **Arguments:**

    - `br`: a `Branch`, or anything with `omega`, `energy`, `amplitude`, (P,) each, and `verdict`: P words "stable",
      "unstable", "undecided", or ""; `p` (P,) and `bifurcations` count where it has them.
    - `axes`: two Axes; by default those of a new figure. `bands`: intervals (B, 2) of the linear spectrum to shade,
      such as `gx.breathers.bands_of(chain)[0]`; `marks`: bifurcations to mark, those of
      `gx.breathers.bifurcations(br)`, or frequencies.
    - `units`: `("kHz", "uJ", "um")`, as in `granjax.plots`. `omega_label`: of the frequencies' axis; `p_label`: of the
      parameter's, where all have one frequency.

    **Returns:** the two Axes. **Raises** ValueError for shapes that do not fit.

    **Example:**

    >>> from types import SimpleNamespace
    >>> omega = np.array([1.6, 1.65, 1.7])
    >>> found = SimpleNamespace(omega=omega, energy=1.73 - omega, amplitude=1.73 - omega, verdict=["stable"] * 3)
    >>> axes = gx.plots.branch(found)
    >>> axes[0].get_ylabel()
    'energy'
    """
    omega = numbers("br.omega", br.omega, 1)
    heights = [numbers(f"br.{name}", getattr(br, name), 1) for name in ("energy", "amplitude")]
    bands = np.zeros((0, 2)) if bands is None else numbers("bands", bands, 2)
    marks = [] if marks is None else list(np.atleast_1d(np.asarray(marks, object)))
    over = Axis(omega_label, omega, "rad/s")
    if hasattr(br, "p") and len(omega) > 1 and np.ptp(omega) <= SAME * np.abs(omega).max():
        omega = numbers("br.p", br.p, 1)
        over = Axis(p_label, omega)
    by, *by_height = drawn_in(
        units,
        units_of(br),
        over,
        Axis("energy", heights[0]),
        Axis(r"amplitude $\max_n |u_n|$", heights[1]),
    )
    omega, drawn = (
        scaled_by(omega, by.factor),
        [scaled_by(x, way.factor) for x, way in zip(heights, by_height)],
    )
    axes = several_axes(axes, 1, 2, 8.4, 3.4)
    room = 0.06 * (np.ptp(omega) or omega[0])
    for ax, height, name in zip(axes.ravel(), drawn, [way.label for way in by_height]):
        _line(ax, omega, height, br, _VERDICTS, marks)
        ax.set_ylabel(name)
        for low, high in scaled_by(bands, by.factor):
            ax.axvspan(low, high, color=FAINT, alpha=0.3, lw=0, zorder=0)
        for i, mark in enumerate(marks):
            name = None if i else "bifurcation"
            ax.axvline(
                by.factor * getattr(mark, "p", mark),
                color=COLOURS[2],
                ls=":",
                lw=1.0,
                zorder=1,
                label=name,
            )
        ax.set_xlim(omega.min() - room, omega.max() + room)
        ax.set_ylim(0, 1.06 * height.max())
        ax.set_xlabel(by.label)
    if axes.ravel()[0].get_legend_handles_labels()[0]:
        axes.ravel()[0].legend(loc="best", frameon=False)
    return axes


def _line(ax, x, y, br, looks, marks=()):
    """A smooth line through points in parts of one verdict each, cut where a located bifurcation changes it.

    Where the verdict changes and nothing is located in between, or several bifurcations are, nobody knows which one the
    orbits between have: dotted.
    """
    verdict, p = np.asarray(br.verdict), np.asarray(getattr(br, "p", x), float)
    curve = np.column_stack([x, y, p])
    step = np.linalg.norm(
        np.diff(curve[:, :2], axis=0) / (np.ptp(curve[:, :2], axis=0) + np.finfo(float).tiny),
        axis=1,
    )
    s = np.concatenate([[0.0], np.cumsum(np.maximum(step, COINCIDING * (step.sum() or 1.0)))])
    at = Akima1DInterpolator(s, curve) if len(s) > 1 else lambda s: curve[[0] * len(s)]
    events = [*getattr(br, "bifurcations", ()), *marks]
    begin, named = 0.0, set()

    def part(low, high, tone, dash, name=None):
        inner = np.concatenate(
            [np.linspace(a, b, FINE, endpoint=False) for a, b in zip(s[:-1], s[1:])] + [s[-1:]]
        )
        drawn = at(
            np.unique(np.concatenate([[low], inner[(inner > low) & (inner < high)], [high]]))
        )
        ax.plot(
            drawn[:, 0],
            drawn[:, 1],
            dash,
            color=tone,
            lw=1.4,
            zorder=2,
            label=None if name in named else name,
        )
        named.add(name)

    for i in [*np.flatnonzero(verdict[1:] != verdict[:-1]), len(s) - 1]:
        found = (
            [_within(at, s[i], s[i + 1], event, i) for event in events] if i < len(s) - 1 else []
        )
        found = [place for place in found if place is not None]
        end, resumed = (min(found), max(found)) if found else s[[i, min(i + 1, len(s) - 1)]]
        part(begin, end, *looks[str(verdict[i])])
        if resumed > end:
            part(end, resumed, *UNKNOWN)
        begin = resumed


def _within(at, low, high, event, i):
    """Where in the i-th step an event lies, a `Bifurcation` or a value of the parameter; `None` where it does not."""
    if getattr(event, "kind", "") == "extremum of energy":  # changes nothing by itself
        return None
    places = np.linspace(low, high, 1001)
    away = at(places)[:, 2] - getattr(event, "p", event)
    inside = (
        away.min() <= 0 <= away.max() if getattr(event, "after", None) is None else event.after == i
    )
    return places[np.argmin(np.abs(away))] if inside else None


def hysteresis(
    sweep: Any,
    ax: AxesOrNone = None,
    *,
    orbits: Any = None,
    units: UnitsOrWords = None,
    x_label: str = "parameter",
    y_label: str = "response",
) -> Axes:
    """Response while a parameter goes up and down again; where the two differ is shaded.

    **Arguments:**

    - `sweep`: a `gx.driven.Sweep`, or arrays (values, up, down), (P,) each, values ascending; `down` may be `None`.
    - `orbits`: a `Branch`, or anything with `p`, `response` and `verdict` (P,), drawn behind, unstable parts
      dashed, in smooth curves that change where its `bifurcations` are.
    - `x_label`, `y_label`: of the axes. One that ends with a known word says what was swept and measured: "frequency"
      (of numbers in Hz), "angular frequency" (rad/s), "amplitude", "rms velocity". `units`: `("kHz", "mm/s")`, as in
      `granjax.plots`.

    **Returns:** the Axes. **Raises** ValueError for shapes that do not fit, or values that do not ascend.

    **Example:**

    >>> ax = gx.plots.hysteresis(([1.0, 2.0, 3.0], [0.1, 0.2, 0.9], [0.1, 0.7, 0.9]), x_label="frequency")
    >>> ax.get_xlabel()
    'frequency'
    """
    values, up, down, intervals = _ways(sweep)
    said = units_of_both(sweep, orbits, "orbits", "sweep")
    by_x, by_y = drawn_in(units, said, Axis(x_label, values), Axis(y_label, up))
    values, up, down = (
        scaled_by(values, by_x.factor),
        by_y.factor * up,
        None if down is None else by_y.factor * down,
    )
    ax = axes_or_new(ax, 5.6, 3.6)
    for low, high in scaled_by(np.reshape(intervals, (-1, 2)), by_x.factor):
        ax.axvspan(low, high, color=FAINT, alpha=0.2, lw=0, zorder=0)
    if orbits is not None:
        p, response = (
            numbers("orbits.p", orbits.p, 1),
            numbers("orbits.response", orbits.response, 1),
        )
        _line(ax, by_x.factor * p, by_y.factor * response, orbits, _ORBITS)
    ax.plot(values, up, ">-", color=COLOURS[0], ms=5, lw=1.2, mec="white", mew=0.3, label="up")
    if down is not None:
        ax.plot(
            values, down, "<--", color=COLOURS[1], ms=5, lw=1.2, mec="white", mew=0.3, label="down"
        )
    ax.set_xlabel(by_x.label)
    ax.set_ylabel(by_y.label)
    ax.legend(loc="best", frameon=False)
    return ax


def _ways(sweep):
    if all(hasattr(sweep, name) for name in ("values", "up", "down")):
        values, up, intervals = sweep.values, sweep.up.response, sweep.hysteresis
        down = None if sweep.down is None else sweep.down.response
    else:
        (values, up, down), intervals = sweep, []
    up = numbers("up", up, 1)
    values = rising("values", values, len(up))
    down = None if down is None else numbers("down", down, 1)
    return values, up, down, intervals


def strain_map(run: Any, ax: AxesOrNone = None, **options: Any) -> Axes:
    """Space-time map of the strain of a chain, y_n = u_n - u_{n+1} (compression positive) at n + 1/2.

    Contacts with walls are left out. **Arguments:** `run`: anything with `ts`, `us`, `vs`; `options`: as in
    `space_time`. **Returns:** the Axes. **Raises** ValueError for several fields, lanes or components.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> ax = gx.plots.strain_map(gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=11))
    >>> ax.images[0].get_array().shape  # times, bonds between beads
    (11, 19)
    """
    ts, u = history(run, "u", options.pop("ts", None))
    own = {"label": "strain", "site_label": "contact", "sites": np.arange(u.shape[1] - 1) + 0.5}
    return space_time(
        _Strains(ts, None, None, units_of(run)), ax, quantity=u[:, :-1] - u[:, 1:], **own | options
    )


class _Strains(NamedTuple):
    """What `space_time` asks of a run whose quantity is given."""

    ts: object
    us: object
    vs: object
    units: str | None
