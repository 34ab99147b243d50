"""Devices: what passes a chain both ways, a rectifier's power, a gate's truth table, a switch, a sound bullet."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from ..units import UnitsOrWords
from .arrays import numbers
from .quantities import Axis, drawn_in, scaled_by, units_of, units_of_both
from .style import COLOURS, FAINT, AxesOrNone, axes_or_new, colour, several_axes

VELOCITY, POWER, CONTROL, DRIVE = "rms velocity", "transmitted power", "control amplitude", "drive amplitude"
# decades below the largest at which an axis ends, if nothing larger says where
DECADES = 4
SIDES = ("defect's side", "other side")


def truth_table(found: Any, ax: AxesOrNone = None, *, units: UnitsOrWords = None) -> Axes:
    """Output of a gate for every combination of its inputs, with the thresholds that make it an OR, an AND, a XOR.

    **Arguments:** `found`: a `TruthTable`, the result of `gx.studies.truth_table`, or anything with `inputs` (rows, K),
    `output`, `output_error` (rows,) and `thresholds(gate)`. `units`: `"mm/s"`, as in `granjax.plots`.

    **Returns:** the Axes; the outputs are `ax.containers[0]`, the shaded bands are the thresholds' ranges.

    **Example:**

    >>> from types import SimpleNamespace
    >>> inputs, output = np.array([[0, 0], [0, 1], [1, 0], [1, 1]]), np.array([0.0, 1e-3, 1e-3, 2e-3])
    >>> found = SimpleNamespace(inputs=inputs, output=output, output_error=np.zeros(4),
    ...                         thresholds=lambda gate: (1e-4, 9e-4) if gate == "OR" else None)
    >>> [label.get_text() for label in gx.plots.truth_table(found).get_xticklabels()]
    ['00', '01', '10', '11']
    """
    inputs, output = numbers("found.inputs", found.inputs, 2), numbers("found.output", found.output, 1)
    error = numbers("found.output_error", found.output_error, 1)
    (by,) = drawn_in(units, units_of(found), Axis(VELOCITY, output, "m/s"))
    output, error = scaled_by(output, by.factor), scaled_by(error, by.factor)
    ranges = {gate: found.thresholds(gate) for gate in ("OR", "AND", "XOR")}
    ax = axes_or_new(ax, max(4.4, 0.55 * len(output) + 2.4), 3.6)
    place = np.arange(len(output))
    ax.bar(place, output, 0.55, color=COLOURS[0], zorder=2)
    ax.errorbar(place, output, _down_and_up(output, error), fmt="none", ecolor="black", lw=1, capsize=3, zorder=3)
    for i, (gate, span) in enumerate((gate, span) for gate, span in ranges.items() if span):
        low, high = (by.factor * x for x in span)
        ax.axhspan(low, high, color=colour(2 + i), alpha=0.25, lw=0, zorder=1)
        ax.text(len(output) - 0.45, np.sqrt(max(low, high * 10.0**-DECADES) * high), gate, color=colour(2 + i),
                weight="bold", va="center", ha="left")
    _decades(ax, output)
    ax.set_xticks(place, ["".join(str(int(x)) for x in row) for row in inputs])
    ax.set_xlim(-0.6, len(output) + 0.15)
    ax.set_xlabel("signals that are on (inputs)")
    ax.set_ylabel(by.label)
    return ax


def switch(found: Any, ax: AxesOrNone = None, *, units: UnitsOrWords = None) -> Axes:
    """Output of a switch over its control, with and without the signal; where it passes half of its largest is shaded.

    **Arguments:** `found`: a `Switch`, the result of `gx.studies.switch`, or anything with `amplitudes`, `output`,
    `output_error`, `alone`, `alone_error` (P,), `threshold` and `threshold_error`. `units`: `("nm", "mm/s")`, as in
    `granjax.plots`.

    **Returns:** the Axes; the two curves are `ax.containers`.

    **Example:**

    >>> from types import SimpleNamespace
    >>> found = SimpleNamespace(amplitudes=np.array([1e-8, 2e-8]), output=np.array([1e-6, 1e-3]),
    ...                         output_error=np.zeros(2), alone=np.array([1e-6, 2e-6]), alone_error=np.zeros(2),
    ...                         threshold=1.5e-8, threshold_error=5e-9)
    >>> len(gx.plots.switch(found).containers)  # with the signal and without
    2
    """
    x = numbers("found.amplitudes", found.amplitudes, 1)
    curves = [[numbers(f"found.{name}{end}", getattr(found, name + end), 1) for end in ("", "_error")]
              for name in ("output", "alone")]
    by_x, by_y = drawn_in(units, units_of(found), Axis(CONTROL, x, "m"), Axis(VELOCITY, curves[0][0], "m/s"))
    ax = axes_or_new(ax, 5.4, 3.6)
    for i, ((y, error), name) in enumerate(zip(curves, ("signal and control", "control alone"))):
        y, error = scaled_by(y, by_y.factor), scaled_by(error, by_y.factor)
        ax.errorbar(scaled_by(x, by_x.factor), y, _down_and_up(y, error), fmt="o-", color=colour(i), ms=4, lw=1.2,
                    capsize=2.5, label=name)
    middle, half = (by_x.factor * float(x) for x in (found.threshold, found.threshold_error))
    if np.isfinite(middle):
        ax.axvspan(middle - half, middle + half, color=COLOURS[3], alpha=0.25, lw=0, zorder=0, label="threshold")
    _decades(ax, scaled_by(curves[0][0], by_y.factor))
    ax.set_xlabel(by_x.label)
    ax.set_ylabel(by_y.label)
    ax.legend(loc="best", frameon=False)
    return ax


def rectifier(found: Any, ax: AxesOrNone = None, *, orbits: Any = None, units: UnitsOrWords = None) -> Axes:
    """Power that a rectifier transmits from either side over the drive's amplitude; rings where it does not repeat.

    **Arguments:** `found`: a `Rectifier`, the result of `gx.studies.rectifier`, or anything with `amplitudes` (P,),
    `near` and `far` (each with `up.response`, `up.multiple`), `threshold_near`, `threshold_far`. `orbits`: the result
    of `gx.studies.rectifier_branch`, whose Neimark-Sacker bifurcations are marked. `units`: `("um", "mW")`, as in
    `granjax.plots`.

    **Returns:** the Axes; the two curves are `ax.lines[0]` and `[2]`.

    **Example:**

    >>> from types import SimpleNamespace
    >>> sides = [SimpleNamespace(up=SimpleNamespace(response=np.array(p), multiple=np.array([1.0, 1.0])))
    ...          for p in ([1e-6, 4e-3], [1e-14, 1e-14])]
    >>> found = SimpleNamespace(amplitudes=np.array([1e-7, 2e-7]), near=sides[0], far=sides[1],
    ...                         threshold_near=1.8e-7, threshold_far=np.inf)
    >>> gx.plots.rectifier(found).get_ylabel()
    'transmitted power'
    """
    x = numbers("found.amplitudes", found.amplitudes, 1)
    ways = [(numbers(f"found.{name}.up.response", getattr(found, name).up.response, 1),
             np.asarray(getattr(found, name).up.multiple) == 0) for name in ("near", "far")]
    said = units_of_both(found, orbits, "orbits", "rectifier")
    by_x, by_y = drawn_in(units, said, Axis(DRIVE, x, "m"), Axis(POWER, ways[0][0], "W"))
    x = scaled_by(x, by_x.factor)
    ax = axes_or_new(ax, 5.6, 3.8)
    for i, ((power, wild), side) in enumerate(zip(ways, SIDES)):
        power = scaled_by(power, by_y.factor)
        ax.plot(x, power, "o-", color=colour(i), ms=4, lw=1.2, label=f"from the {side}")
        ax.plot(x[wild], power[wild], "o", mfc="none", mec=colour(i), ms=9,
                label="does not repeat" if wild.any() else None)
    if np.isfinite(found.threshold_near):
        ax.axvline(by_x.factor * found.threshold_near, color=FAINT, ls="--", lw=1.0, zorder=0, label="ceases to repeat")
    marks = [e.p for e in getattr(orbits, "bifurcations", ()) if e.kind == "Neimark-Sacker"]
    for k, p in enumerate(marks):
        ax.axvline(by_x.factor * p, color=COLOURS[2], ls=":", lw=1.4, zorder=0, label=None if k else r"$|\rho| = 1$")
    ax.set_yscale("log")
    ax.set_xlabel(by_x.label)
    ax.set_ylabel(by_y.label)
    ax.legend(loc="center right", frameon=False)
    return ax


def sound_bullet(found: Any, ax: AxesOrNone = None) -> Axes:
    """How much higher a focus is driven by one, two, ... channels that meet there than by one, and without delays.

    **Arguments:** `found`: a `SoundBullet`, the result of `gx.studies.sound_bullet`, or anything with `gain`,
    `gain_error`, `bound`, `alone` (N,) and `at_once`. **Returns:** the Axes; the gain is `ax.containers[0]`, what
    pulses could add up to `ax.lines[-2]`.

    **Example:**

    >>> from types import SimpleNamespace
    >>> found = SimpleNamespace(gain=np.array([1.0, 1.9]), gain_error=np.zeros(2), bound=np.array([1.0, 2.0]),
    ...                         alone=np.ones(2), at_once=1.2)
    >>> gx.plots.sound_bullet(found).get_ylabel()
    'gain at the focus'
    """
    gain, error, bound, alone = (numbers(f"found.{name}", getattr(found, name), 1)
                                 for name in ("gain", "gain_error", "bound", "alone"))
    count = 1 + np.arange(len(gain))
    ax = axes_or_new(ax, 4.8, 3.6)
    ax.errorbar(count, gain, _down_and_up(gain, error), fmt="o", color=COLOURS[0], ms=5, capsize=3,
                label="with delays")
    ax.plot(count, bound, "--", color=FAINT, lw=1.2, zorder=0, label="if pulses add up")
    ax.plot(count[-1], float(found.at_once) / alone.max(), "s", color=COLOURS[1], ms=6, label="all at once")
    ax.set_xlim(0, count[-1] + 1)
    ax.set_ylim(bottom=0)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel("channels")
    ax.set_ylabel("gain at the focus")
    ax.legend(loc="upper left", frameon=False)
    return ax


def two_way(
    found: Any, axes: Sequence[Axes] | np.ndarray | None = None, *, units: UnitsOrWords = None
) -> np.ndarray:
    """What passes a chain from the left and from the right over the drive's amplitude, and by how much they differ.

    **Arguments:** `found`: a `TwoWay`, the result of `gx.studies.two_way`, or anything with `amplitudes`, `from_left`,
    `from_right`, `asymmetry` and `asymmetry_error` (P,). `axes`: two Axes; by default those of a new figure. `units`:
    `("nm", "mN")`, as in `granjax.plots`.

    **Returns:** the two Axes, (2,) or as given; the error of the difference is shaded.

    **Example:**

    >>> from types import SimpleNamespace
    >>> found = SimpleNamespace(amplitudes=np.array([1e-8, 2e-8]), from_left=np.array([1e-3, 2e-3]),
    ...                         from_right=np.array([1e-3, 1.8e-3]), asymmetry=np.array([0.01, 0.11]),
    ...                         asymmetry_error=np.array([1e-3, 1e-3]))
    >>> [ax.get_ylabel() for ax in gx.plots.two_way(found)]
    ['force on the wall at rest', 'asymmetry']
    """
    names = "amplitudes", "from_left", "from_right", "asymmetry", "asymmetry_error"
    x, left, right, apart, error = (numbers(f"found.{name}", getattr(found, name), 1) for name in names)
    by_x, by_y = drawn_in(units, units_of(found), Axis(DRIVE, x, "m"), Axis("force on the wall at rest", left, "N"))
    x = scaled_by(x, by_x.factor)
    axes = several_axes(axes, 1, 2, 8.4, 3.4)
    both, difference = axes.ravel()
    both.loglog(x, scaled_by(left, by_y.factor), "o-", color=COLOURS[0], ms=6, lw=1.2, label="from the left")
    both.loglog(x, scaled_by(right, by_y.factor), "s--", color=COLOURS[1], ms=3, lw=1.2, label="from the right")
    both.legend(loc="best", frameon=False)
    difference.loglog(x, np.abs(apart), "o-", color=COLOURS[0], ms=4, lw=1.2, label="|left / right - 1|")
    difference.fill_between(x, 1e-3 * error.min(), error, color=FAINT, alpha=0.3, lw=0, label="its error")
    difference.set_ylim(0.3 * error.min(), 3 * max(np.abs(apart).max(), error.max()))
    difference.legend(loc="best", frameon=False)
    both.set_ylabel(by_y.label)
    difference.set_ylabel("asymmetry")
    for ax in (both, difference):
        ax.set_xlabel(by_x.label)
    return axes


def _down_and_up(y, error):
    """Errors of numbers on a logarithmic axis: downwards at most to a thousandth."""
    return np.stack([np.minimum(error, 0.999 * y), error])


def _decades(ax, y):
    """A logarithmic axis that ends some decades below the largest, higher where nothing is as low."""
    top = float(y.max())
    ax.set_yscale("log")
    ax.set_ylim(max(10.0**-DECADES * top, 0.3 * float(y.min())), 3 * top)
