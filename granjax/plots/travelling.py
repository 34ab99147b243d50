"""Travelling waves and fronts with their tails; kinks with their barrier."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, MaxNLocator

from ..types import Numbers, Scalar
from .arrays import numbers
from .style import (
    COLOURS,
    DASHES,
    FAINT,
    OMEGA,
    AxesOrNone,
    axes_or_new,
    colour,
    legend_above,
    shown,
    units_of,
)

# of e that a front's tails are drawn over
POWERS = 8.0
# of a wave's largest strain, what belongs to its core
CORE = 0.02


def wave(
    wave_record: Any,
    ax: AxesOrNone = None,
    *,
    beside: Mapping[str, Numbers] | None = None,
    floor: Scalar = 1e-16,
) -> Axes:
    """Draw the strain of a travelling wave or a front over the place, contacts as dots, and the tails in insets.

    **Arguments:**

    - `wave_record`: anything with `xi` (X,), `strain(xi)`, `velocity(xi)` and `speed`, such as the result of
      `gx.travelling.solitary_wave`, whose slope d strain/d xi = (v(xi + 1) - v(xi))/c is drawn too; with `strains`
      (P, X), as each contact of a cell sees the wave, such as that of `gx.travelling.cell_wave`; or with `behind`,
      `ahead`, `decay_behind`, `decay_ahead`, such as that of `gx.shocks.dissipative_front`.
    - `beside`: dict from a name to strains (X,) at `wave_record.xi`, such as compactons.
    - `floor`: lowest decade of a wave's inset, a share of the largest value.

    **Returns:** the Axes; the curves are `ax.lines`: strain, slope, what is beside, dots. `ax.child_axes` are the
    insets: absolute values of a wave; how far a front is from the state behind and from that ahead, with the slopes
    at which these fall.
    """
    record = wave_record
    xi, is_front = numbers("wave_record.xi", record.xi, 1), hasattr(record, "decay_behind")
    is_cell = np.ndim(getattr(record, "strains", 0)) == 2
    end = np.abs(xi).max()
    if is_cell:
        curves = {f"contact {j}": row for j, row in enumerate(np.asarray(record.strains))}
    else:
        xi = np.linspace(-end, end, 2 * len(xi)) if is_front else xi
        curves = {"strain": np.asarray(record.strain(xi))}
    core = max(np.abs(xi[np.abs(y) > CORE * np.abs(y).max()]).max() for y in curves.values())
    if not is_front and not is_cell:
        v = record.velocity
        rise = np.asarray(v(xi + 1)) - np.asarray(v(xi))
        curves["slope"] = rise / float(record.speed)
    curves |= {name: numbers(f"beside[{name!r}]", y, 1) for name, y in (beside or {}).items()}
    by = shown("strain", np.stack(list(curves.values())), "m", units_of(record))
    curves = {name: by(y) for name, y in curves.items()}
    ax = axes_or_new(ax, 5.4, 3.8)
    _curves(ax, xi, curves)
    if not is_cell:
        nodes = np.arange(np.ceil(xi.min()), np.floor(xi.max()) + 1)
        dots = {"color": COLOURS[2], "ms": 4.5, "mec": "white", "mew": 0.5, "zorder": 3}
        ax.plot(nodes, by(record.strain(nodes)), "o", label="contacts", **dots)
    reach = end if is_front else min(max(3 * core, 3.0), end)
    ax.set(xlim=(-reach, reach), ylabel=by.label)
    ax.set_xlabel(rf"place $\xi = n - {'s' if is_front else 'c'}\,t$ (contacts)")
    legend_above(ax)
    if is_front:
        _front_tails(ax, record, by, xi, curves["strain"])
        return ax
    low, top = ax.get_ylim()
    ax.set_ylim(low, top + 0.35 * (top - low))  # room for the tail
    tail = ax.inset_axes([0.71, 0.6, 0.28, 0.37])
    _curves(tail, xi, {name: np.abs(y) for name, y in curves.items()}, 0.7)
    largest = max(np.nanmax(np.abs(y)) for y in curves.values()) or 1.0
    tail.set(yscale="log", ylim=(floor * largest, 10 * largest), xlim=(xi.min(), xi.max()))
    _small(tail)
    return ax


def _small(tail):
    """Letters of an inset, few and small."""
    tail.xaxis.set_major_locator(MaxNLocator(3))
    tail.yaxis.set_major_locator(LogLocator(numticks=4))
    tail.tick_params(labelsize="x-small")


def _curves(ax, x, curves, scale=1.0):
    for i, (name, y) in enumerate(curves.items()):
        ax.plot(x, y, DASHES[i % len(DASHES)], color=colour(i), lw=1.6 * scale, label=name)


def _front_tails(ax, record, by, xi, y):
    """What is left of both far states, and the slopes at which the envelopes fall."""
    behind, ahead = float(record.decay_behind), float(record.decay_ahead)
    waves = f"\n$k$ = {float(record.wavenumber_behind):.4g}" * (record.kind == "oscillatory")
    for far, rate, side, name, where in (
        (record.behind, behind, xi < 0, rf"$\lambda$ = {behind:.4g}{waves}", (0.16, 0.12)),
        (record.ahead, -ahead, xi > 0, rf"$\mu$ = {ahead:.4g}", (0.68, 0.48)),
    ):
        level = float(by(far))
        ax.axhline(level, color=FAINT, lw=0.8, ls=":", zorder=0)
        side = side & (np.abs(rate * xi) < POWERS)
        x, d, line = xi[side], np.abs(y - level)[side], np.exp(rate * xi[side])
        outer = np.abs(rate * x) > np.abs(rate * x).max() / 2
        tail = ax.inset_axes([*where, 0.3, 0.32])
        tail.semilogy(x, np.where(d > 0, d, np.nan), color=COLOURS[0], lw=1.0)
        tail.semilogy(x, line * np.nanmax((d / line)[outer]), "--", color=COLOURS[1], lw=1.0)
        tail.set_ylim(d[d > 0].min() / 3, 3 * d.max())
        tail.set_title(name, size="x-small")
        _small(tail)


def kink(
    found: Any,
    axes: Sequence[Axes] | np.ndarray | None = None,
    *,
    barrier: Any = None,
) -> np.ndarray:
    """Draw a kink at rest between its wells; beside it its small oscillations, or the Peierls-Nabarro barrier.

    **Arguments:**

    - `found`: a `Kink`, the result of `gx.kinks.kink`, or anything with `state` (u, v), `energy`, `omega` (N,),
      `growth` and `verdict`; where it grows the frequency is drawn at zero.
    - `barrier`: the result of `gx.kinks.peierls_nabarro`, or anything with `site`, `bond`, `barrier` and `error`: its
      two energies are then drawn over the place of the centre, with the sine through both to guide the eye.
    - `axes`: two Axes; by default those of a new figure.

    **Returns:** the two Axes, (2,) or as given; the profile is `axes[0].lines[0]`.
    """
    units = units_of(found, barrier)
    by = shown("$u_n$", found.state[0], "m", units)
    u = by(numbers("found.state.u", found.state[0], 1))
    axes = axes_or_new(axes, 8.4, 3.4, 1, 2)
    profile, other = axes.ravel()
    profile.plot(np.arange(len(u)), u, "o-", color=COLOURS[0], ms=4, lw=0.8, mec="white", mew=0.4)
    for well in (u[0], u[-1]):
        profile.axhline(well, color=FAINT, lw=0.8, ls=":", zorder=0)
    # what lies between the wells, with as much on either side
    inside = np.flatnonzero(np.abs(np.diff(u)) > 1e-3 * np.abs(u[-1] - u[0]))
    low, high = (inside[0], inside[-1] + 1) if len(inside) else (0, len(u) - 1)
    more = max(3, high - low)
    profile.set_xlim(max(low - more, 0) - 0.5, min(high + more, len(u) - 1) + 0.5)
    profile.set(xlabel="site $n$", ylabel=by.label)
    by = shown("energy", found.energy, "J", units)
    energy = f"{found.verdict}, energy {float(by(found.energy)):.5g} {by.unit}"
    profile.set_title(energy.strip(), loc="left", size="medium")
    if barrier is not None:
        _barrier(other, barrier, units)
        return axes
    by = shown(OMEGA, found.omega, "rad/s", units)
    omega = by(numbers("found.omega", found.omega, 1))
    other.plot(omega, ".", color=COLOURS[0], ms=4)
    name = "unstable, drawn at zero" if found.growth else "Peierls-Nabarro frequency"
    other.plot([0], omega[:1], "o", color=COLOURS[1], ms=6, label=name)
    other.set(xlabel="mode", ylabel=by.label, ylim=(0, 1.1 * omega.max()))
    legend_above(other)
    return axes


def _barrier(ax, barrier, units):
    """Energies of the kink on a site and on a bond, above the lower one."""
    ends = np.array([float(barrier.site), float(barrier.bond)])
    by = shown("energy - lowest", ends - ends.min(), "J", units)
    above, error, x = by(ends - ends.min()), float(by(barrier.error)), np.linspace(-0.6, 1.1, 171)
    sine = above.mean() + (above[0] - above[1]) / 2 * np.cos(2 * np.pi * x)
    ax.plot(x, sine, "--", color=FAINT, lw=1.0, zorder=1, label="sine")
    for at, value, tone, name in (
        ([0, 1], above[0], COLOURS[0], "on a site"),
        ([-0.5, 0.5], above[1], COLOURS[1], "on a bond"),
    ):
        ax.errorbar(at, [value] * 2, error, fmt="o", color=tone, ms=6, capsize=3, label=name)
    ax.set(xlabel="centre of the kink (sites)", ylabel=by.label, xlim=(-0.6, 1.1))
    legend_above(ax)
