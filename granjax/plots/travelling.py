"""Travelling waves: a profile with its slope, how far closed forms are from it, what a wall sends back; fronts."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ..checks import one_of, positive, within
from ..types import Numbers, Parameter, Scalar
from ..units import UnitsOrWords
from .arrays import numbers
from .curves import profile
from .quantities import Axis, drawn_in, quantity, scaled_by, units_of
from .style import COLOURS, FAINT, AxesOrNone, axes_or_new

# of e that a front's tails are drawn over; what is drawn of a family, and the unit of its numbers in SI
POWERS = 8.0
MEASURED = {"energy": "J", "amplitude": "m", "momentum": "N s", "compression": "m", "width": ""}


def wave(
    wave_record: Any,
    ax: AxesOrNone = None,
    *,
    beside: Mapping[str, Numbers] | None = None,
    slope: bool = True,
    floor: Scalar = 1e-16,
    units: UnitsOrWords = None,
) -> Axes:
    """Strain of a travelling wave over the place, its slope, the lattice's contacts as dots, and the tail in an inset.

    **Arguments:**

    - `wave_record`: anything with `xi` (X,), `strain(xi)`, `velocity(xi)` and `speed`, such as the result of
      `gx.travelling.solitary_wave`.
    - `beside`: dict from a name to strains (X,) at `wave_record.xi`, such as compactons. `slope`: whether
      d strain/d xi = (v(xi + 1) - v(xi))/c is drawn, per contact.
    - `floor`: lowest decade of the inset, a share of the largest value. `units`: `"um"`, as in `granjax.plots`.

    **Returns:** the Axes; the inset is `ax.child_axes[0]`, the curves `ax.lines`: strain, slope, what is beside, dots.

    **Example:**

    >>> ax = gx.plots.wave(gx.travelling.solitary_wave(gx.Hertz(), speed=1.0))
    >>> ax.child_axes[0].get_yscale()  # the tail
    'log'
    """
    xi = numbers("wave_record.xi", wave_record.xi, 1)
    curves = {"strain": wave_record.strain(xi)}
    if slope:
        velocity = wave_record.velocity
        curves["slope, per contact"] = (
            np.asarray(velocity(xi + 1)) - np.asarray(velocity(xi))
        ) / wave_record.speed
    for name, y in (beside or {}).items():
        y = numbers(f"beside[{name!r}]", y)
        curves[name] = y
    nodes = np.arange(np.ceil(xi.min()), np.floor(xi.max()) + 1)
    return profile(
        xi,
        np.stack([np.asarray(y) for y in curves.values()], -1),
        ax,
        labels=list(curves),
        points=(nodes, np.asarray(wave_record.strain(nodes))),
        points_label="contacts",
        floor=floor,
        x_label=r"place $\xi = n - c\,t$ (contacts)",
        y_label="strain",
        units=units if units is not None else units_of(wave_record),
    )


def front(record: Any, ax: AxesOrNone = None, *, units: UnitsOrWords = None) -> Axes:
    """Strain of a front over the place, the lattice's contacts as dots, both far states, and both tails in insets.

    **Arguments:** `record`: anything with `xi` (X,), `strain(xi)`, `behind`, `ahead`, `decay_behind`, `decay_ahead`,
    `wavenumber_behind` and `kind`, such as the result of `gx.shocks.dissipative_front`. `units`: `"um"`, as in
    `granjax.plots`.

    **Returns:** the Axes; `ax.child_axes[0]` shows how far the strain is from that behind over the places, on a
    logarithmic axis, and the slope at which it falls, `ax.child_axes[1]` the same ahead.

    **Example:**

    >>> ax = gx.plots.front(gx.shocks.dissipative_front(gx.Hertz(), 1.0, dashpot=0.3))
    >>> len(ax.child_axes)  # both tails
    2
    """
    end = np.abs(numbers("record.xi", record.xi, 1)).max()
    # as far ahead as behind: room for the insets
    xi = np.linspace(-end, end, 2 * len(record.xi))
    y, behind, ahead = (
        np.asarray(x, float) for x in (record.strain(xi), record.behind, record.ahead)
    )
    by_x, by_y = drawn_in(
        units, units_of(record), Axis(r"place $\xi = n - s\,t$ (contacts)", xi), Axis("strain", y)
    )
    ax = axes_or_new(ax, 6.4, 4.0)
    nodes = np.arange(np.ceil(-end), np.floor(end) + 1)
    ax.plot(xi, scaled_by(y, by_y.factor), color=COLOURS[0])
    ax.plot(
        nodes,
        scaled_by(np.asarray(record.strain(nodes)), by_y.factor),
        "o",
        color=COLOURS[2],
        ms=4,
        mec="white",
        mew=0.5,
        label="contacts",
    )
    for level in (behind, ahead):
        ax.axhline(scaled_by(level, by_y.factor), color=FAINT, lw=0.8, ls=":", zorder=0)
    rates = float(record.decay_behind), float(record.decay_ahead)
    name = (
        rf"behind: $\lambda$ = {rates[0]:.4g}"
        + rf", $k$ = {float(record.wavenumber_behind):.4g}" * (record.kind == "oscillatory"),
        rf"ahead: $\mu$ = {rates[1]:.4g}",
    )
    for k, (level, rate, side) in enumerate(
        ((behind, rates[0], xi < 0), (ahead, -rates[1], xi > 0))
    ):
        small = ax.inset_axes([0.07 + 0.55 * k, 0.16 + 0.38 * k, 0.36, 0.36])
        side &= np.abs(rate * xi) < POWERS
        x, d = xi[side], scaled_by(np.abs(y - level)[side], by_y.factor)
        _tail(small, x, d, rate, name[k])
    ax.set_xlabel(by_x.label)
    ax.set_ylabel(by_y.label)
    ax.set_xlim(-end, end)
    return ax


def _tail(ax, x, d, rate, name):
    """What is left of a far state, and the slope at which its envelope falls."""
    ax.semilogy(x, np.where(d > 0, d, np.nan), color=COLOURS[0], lw=1.0)
    line = np.exp(rate * x)
    ax.semilogy(
        x,
        line * np.nanmax((d / line)[np.abs(rate * x) > np.abs(rate * x).max() / 2]),
        "--",
        color=COLOURS[1],
        lw=1.0,
    )
    ax.set_ylim(0.3 * d[d > 0].min() if (d > 0).any() else None, 3 * d.max())
    ax.set_title(name, fontsize=8)
    ax.tick_params(labelsize=7)
    ax.patch.set_alpha(0.9)


def wave_errors(
    record: Any, ax: AxesOrNone = None, *, floor: Scalar = 1e-12, units: UnitsOrWords = None
) -> Axes:
    """Errors of closed forms against the exact wave over how much faster than sound it is, both logarithmic.

    **Arguments:** `record`: anything with `speed` (S,), `sound`, and `kdv_error`, `toda_error` (S,), relative to the
    peak, such as the result of `gx.travelling.closed_forms`. `floor`: lowest error drawn. `units`: both axes are pure
    numbers, so that it changes nothing; words that name a unit are refused.

    **Returns:** the Axes. **Raises** ValueError for a `floor` outside (0, 1).

    **Example:**

    >>> from types import SimpleNamespace
    >>> found = SimpleNamespace(speed=np.array([1.01, 1.1]), sound=1.0, kdv_error=np.array([0.013, 0.12]),
    ...                         toda_error=np.array([1e-6, 1e-5]))
    >>> gx.plots.wave_errors(found).get_yscale()
    'log'
    """
    floor = float(within("floor", floor, 0, 1, open_low=True, open_high=True))
    faster = np.abs(numbers("record.speed", record.speed, 1)) / float(record.sound) - 1
    label = r"speed over that of sound, less one, $c/c_0 - 1$"
    by, _ = drawn_in(
        units, None, Axis(label, faster, ""), Axis("largest error over the peak", np.ones(1), "")
    )
    ax = axes_or_new(ax, 5.2, 3.8)
    order = np.argsort(faster)
    for tone, mark, name, values in (
        (COLOURS[1], "s--", "Korteweg-de Vries", record.kdv_error),
        (COLOURS[0], "o-", "Toda", record.toda_error),
    ):
        values = numbers("record", values, 1, finite=False)[order]
        ax.plot(
            scaled_by(faster[order], by.factor),
            np.maximum(values, floor),
            mark,
            color=tone,
            ms=4,
            label=name,
        )
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel(label)
    ax.set_ylabel("largest error of the strain over the peak")
    ax.legend(frameon=False)
    return ax


def wave_family(
    record: Any,
    ax: AxesOrNone = None,
    *,
    quantity: str = "energy",
    units: UnitsOrWords = None,
) -> Axes:
    """A quantity of a family of waves over their speed, with the speeds at which the energy turns marked.

    **Arguments:** `record`: anything with `speed` (P,), `turns` and the quantity (P,), such as the result of
    `gx.travelling.family`. `quantity`: `"energy"`, `"amplitude"`, `"momentum"`, `"compression"` or `"width"`.
    `units`: `"kHz"`, `"um"`, as in `granjax.plots`; a speed counts contacts per time.

    **Returns:** the Axes. **Raises** ValueError for another quantity.

    **Example:**

    >>> from types import SimpleNamespace
    >>> c = np.array([1.0, 1.5, 2.0])
    >>> ax = gx.plots.wave_family(SimpleNamespace(speed=c, energy=2.8235 * c**10, turns=np.array([])))
    >>> ax.get_ylabel()
    'energy'
    """
    one_of("quantity", quantity, tuple(MEASURED))
    speed, y = (
        numbers("record.speed", record.speed, 1),
        numbers(f"record.{quantity}", getattr(record, quantity), 1),
    )
    turns = numbers("record.turns", record.turns, 1)
    by_x, by_y = drawn_in(
        units,
        units_of(record),
        Axis("speed, contacts per time", speed, "1/s"),
        Axis(quantity, y, MEASURED[quantity]),
    )
    ax = axes_or_new(ax, 5.2, 3.6)
    order = np.argsort(speed)
    ax.plot(
        scaled_by(speed[order], by_x.factor),
        scaled_by(y[order], by_y.factor),
        "o-",
        ms=4,
        color=COLOURS[0],
    )
    for i, turn in enumerate(turns):
        ax.axvline(
            scaled_by(turn, by_x.factor), color=COLOURS[1], ls=":", label=None if i else "dE/dc = 0"
        )
    if turns.size:
        ax.legend(frameon=False)
    ax.set_xlabel(by_x.label)
    ax.set_ylabel(by_y.label)
    return ax


def reflection(
    record: Any,
    stiffness: Parameter,
    ax: AxesOrNone = None,
    *,
    rigid: Any = None,
    x_label: str = "stiffness of the wall's contact",
    units: UnitsOrWords = None,
) -> Axes:
    """Delay (left axis) and amplitude (right axis) of the wave that a wall reflects, over the wall's stiffness.

    **Arguments:**

    - `record`: anything with `delay`, `delay_error`, `amplitudes` (B,) and `amplitude`, such as the result of
      `gx.travelling.reflect`. `stiffness` (B,) > 0: what the lanes of the wall were made of; Young's moduli with
      `x_label="modulus"`, whose units then are drawn as well.
    - `rigid`: a record of a rigid wall, drawn as the lines that the curves approach.
    - `units`: `"us"`, `("um", "GPa")`, as in `granjax.plots`.

    **Returns:** the Axes of the delay, with error bars; that of the amplitude over `record.amplitude`, the wave's own,
    is `ax.child_axes[0]`.

    **Example:**

    >>> from types import SimpleNamespace
    >>> found = SimpleNamespace(delay=np.array([0.5, 0.1]), delay_error=np.zeros(2),
    ...                         amplitudes=np.array([0.9, 0.95]), amplitude=1.0)
    >>> ax = gx.plots.reflection(found, [0.1, 1.0])
    >>> ax.child_axes[0].get_ylabel()
    'reflected amplitude / that sent'
    """
    over = np.asarray(positive("stiffness", stiffness))
    measured = "delay", "delay_error", "amplitudes"
    delay, error, amplitude = (
        numbers(f"record.{name}", getattr(record, name), finite=False) for name in measured
    )
    by_x, by_y = drawn_in(
        units,
        units_of(record),
        Axis(x_label, over, quantity(x_label) or ""),
        Axis("delay", delay, "s"),
    )
    ax = axes_or_new(ax, 5.6, 3.8)
    order = np.argsort(over)
    x, y = scaled_by(over[order], by_x.factor), scaled_by(delay[order], by_y.factor)
    ax.errorbar(
        x, y, scaled_by(error[order], by_y.factor), fmt="o-", ms=4, color=COLOURS[0], label="delay"
    )
    beside = ax.inset_axes([0, 0, 1, 1])
    beside.patch.set_alpha(0.0)
    beside.yaxis.tick_right()
    beside.yaxis.set_label_position("right")
    beside.plot(
        x,
        amplitude[order] / float(record.amplitude),
        "s--",
        ms=4,
        color=COLOURS[1],
        label="amplitude",
    )
    beside.tick_params(axis="x", which="both", bottom=False, labelbottom=False)
    beside.set_ylabel("reflected amplitude / that sent")
    if rigid is not None:
        ax.axhline(scaled_by(float(rigid.delay), by_y.factor), color=COLOURS[0], lw=0.8, ls=":")
        beside.axhline(
            float(rigid.amplitudes) / float(rigid.amplitude), color=COLOURS[1], lw=0.8, ls=":"
        )
    for one in (ax, beside):
        one.set_xscale("log")
    beside.set_xlim(ax.get_xlim())
    ax.set_xlabel(by_x.label)
    ax.set_ylabel(by_y.label)
    ax.legend(
        [*ax.containers, *beside.lines[:1]],
        ["delay", "amplitude"],
        frameon=False,
        loc="center right",
    )
    return ax
