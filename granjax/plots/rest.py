"""States of rest: kinks with their barrier, equilibria with what holds them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ..checks import one_of, refuse
from ..units import SCALED, UnitsOrWords
from .arrays import numbers
from .quantities import OMEGA, Axis, drawn_in, scaled_by, units_of, units_of_both
from .style import COLOURS, FAINT, several_axes

COMPONENTS = "xyz"


def kink(
    found: Any,
    axes: Sequence[Axes] | np.ndarray | None = None,
    *,
    barrier: Any = None,
    units: UnitsOrWords = None,
) -> np.ndarray:
    """A kink at rest between its wells; beside it its small oscillations, or the Peierls-Nabarro barrier.

    **Arguments:**

    - `found`: a `Kink`, the result of `gx.kinks.kink`, or anything with `state` (u, v), `energy`, `omega` (N,),
      `growth` and `verdict`; where it grows the frequency is drawn at zero.
    - `barrier`: the result of `gx.kinks.peierls_nabarro`, or anything with `site`, `bond`, `barrier` and `error`: its
      two energies are then drawn over the place of the centre, with the sine through both to guide the eye.
    - `axes`: two Axes; by default those of a new figure. `units`: `("kHz", "uJ", "um")`, as in `granjax.plots`.

    **Returns:** the two Axes, (2,) or as given; the profile is `axes[0].lines[0]`.

    **Example:**

    >>> from types import SimpleNamespace
    >>> n = np.arange(20) - 9.5
    >>> found = SimpleNamespace(state=gx.State(4 * np.arctan(np.exp(n)), 0 * n), energy=8.0,
    ...                         omega=np.linspace(0.1, 2.0, 20), growth=0.0, verdict="stable")
    >>> axes = gx.plots.kink(found)
    >>> len(axes[0].lines[0].get_xdata())
    20
    """
    u, omega = numbers("found.state.u", found.state[0], 1), numbers("found.omega", found.omega, 1)
    energy = float(numbers("found.energy", found.energy, 0))
    beside = [Axis(OMEGA, omega, "rad/s")]
    if barrier is not None:
        ends = np.array([float(barrier.site), float(barrier.bond)])
        beside = [Axis("energy", ends - ends.min(), "J")]
    said = units_of_both(found, barrier, "barrier", "kink")
    shown = Axis("displacement $u_n$", u, "m"), *beside, Axis("energy", energy, "J")
    by_u, by, by_energy = drawn_in(units, said, *shown)
    axes = several_axes(axes, 1, 2, 8.4, 3.4)
    profile, other = axes.ravel()
    n, u = np.arange(len(u)), scaled_by(u, by_u.factor)
    profile.plot(n, u, "o-", color=COLOURS[0], ms=4, lw=0.8, mec="white", mew=0.4)
    for well in (u[0], u[-1]):
        profile.axhline(well, color=FAINT, lw=0.8, ls=":", zorder=0)
    profile.set_xlim(*_core(u))
    profile.set_xlabel("site $n$")
    profile.set_ylabel(by_u.label)
    unit = f" {by_energy.unit}" if by_energy.unit not in ("", SCALED) else ""
    profile.set_title(f"{found.verdict}, energy {by_energy.factor * energy:.5g}{unit}", loc="left")
    if barrier is None:
        _oscillations(other, omega, by, float(found.growth))
    else:
        _barrier(other, barrier, ends, by)
    return axes


def _core(u):
    """First and last site about what lies between the wells, with as much on either side."""
    inside = np.flatnonzero(np.abs(np.diff(u)) > 1e-3 * np.abs(u[-1] - u[0]))
    low, high = (inside[0], inside[-1] + 1) if len(inside) else (0, len(u) - 1)
    more = max(3, high - low)
    return max(low - more, 0) - 0.5, min(high + more, len(u) - 1) + 0.5


def _oscillations(ax, omega, by, growth):
    n, omega = np.arange(len(omega)), scaled_by(omega, by.factor)
    ax.plot(n, omega, ".", color=COLOURS[0], ms=4)
    name = "Peierls-Nabarro frequency" if growth == 0 else "unstable, drawn at zero"
    ax.plot(n[:1], omega[:1], "o", color=COLOURS[1], ms=6, label=name)
    ax.set_ylim(0, 1.1 * omega.max())
    ax.set_xlabel("mode")
    ax.set_ylabel(by.label)
    ax.legend(loc="lower right", frameon=False)


def _barrier(ax, barrier, ends, by):
    """Energies of the kink on a site and on a bond, above the lower one."""
    x = np.linspace(-0.6, 1.1, 171)
    above = scaled_by(ends - ends.min(), by.factor)
    middle, half = above.mean(), (above[0] - above[1]) / 2
    ax.plot(
        x,
        middle + half * np.cos(2 * np.pi * x),
        "--",
        color=FAINT,
        lw=1.0,
        zorder=1,
        label="sine through both",
    )
    error = scaled_by(float(barrier.error), by.factor)
    for at, value, tone, name in (
        (np.array([0, 1]), above[0], COLOURS[0], "on a site"),
        (np.array([-0.5, 0.5]), above[1], COLOURS[1], "on a bond"),
    ):
        ax.errorbar(
            at, np.full(2, value), error, fmt="o", color=tone, ms=6, capsize=3, zorder=2, label=name
        )
    ax.set_xlim(-0.6, 1.1)
    ax.set_xlabel("centre of the kink (sites)")
    ax.set_ylabel(f"{by.label.replace('energy', 'energy above the lower kink', 1)}")
    ax.set_ylim(-0.15 * above.max() - error, 1.6 * above.max() + error)
    ax.legend(
        loc="upper center",
        ncols=3,
        frameon=False,
        fontsize="small",
        columnspacing=1.0,
        handletextpad=0.4,
    )


def equilibrium(
    found: Any,
    axes: Sequence[Axes] | np.ndarray | None = None,
    *,
    field: str | None = None,
    units: UnitsOrWords = None,
) -> np.ndarray:
    """Where a chain rests, and the loads that hold it: displacements from where it was built, forces from outside.

    **Arguments:** `found`: an `Equilibrium`, the result of `gx.equilibrium`, of a chain, or anything with `state`
    (u, v), `loads`, `ends` ((2,) or `None`) and `verdict`. `axes`: two Axes; by default those of a new figure. `field`:
    which is shown, where a cell holds several. `units`: `("um", "N")`, as in `granjax.plots`.

    **Returns:** the two Axes, (2,) or as given; what presses on a chain's ends is drawn beside its first and last site.
    **Raises** ValueError for a lattice of more than one axis, several fields without a name.

    **Example:**

    >>> from types import SimpleNamespace
    >>> zeros = np.zeros(5)
    >>> found = SimpleNamespace(state=gx.State(zeros, zeros), loads=zeros, ends=None, verdict="stable")
    >>> [ax.get_ylabel() for ax in gx.plots.equilibrium(found)]
    ['displacement $u_n$', 'load']
    """
    u, loads = (_chosen(x, field) for x in (found.state[0], found.loads))
    if (
        u.ndim not in (1, 2)
        or u.shape != loads.shape
        or u.ndim == 2
        and u.shape[1] > len(COMPONENTS)
    ):
        refuse(
            "found",
            "a chain's displacements, shape (N,), or (N, components)",
            f"shape {u.shape}",
            "Of a plane draw one row: an equilibrium of anything with state, loads, ends and verdict will do.",
        )
    ends = None if found.ends is None else numbers("found.ends", found.ends, 1)
    forces = np.concatenate([loads.ravel(), [] if ends is None else ends])
    by_u, by = drawn_in(
        units, units_of(found), Axis("displacement $u_n$", u, "m"), Axis("load", forces, "N")
    )
    u, loads = scaled_by(u, by_u.factor), scaled_by(loads, by.factor)
    axes = several_axes(axes, 1, 2, 8.4, 3.4)
    rest, held = axes.ravel()
    n = np.arange(len(u))
    for k, column in enumerate(u.reshape(len(u), -1).T):
        rest.plot(
            n,
            column,
            "o-",
            color=COLOURS[k],
            ms=4,
            lw=0.8,
            mec="white",
            mew=0.4,
            label=COMPONENTS[k] if u.ndim == 2 else None,
        )
    rest.axhline(0, color=FAINT, lw=0.8, zorder=0)
    rest.set_title(found.verdict, loc="left")
    for k, column in enumerate(loads.reshape(len(u), -1).T):
        name = "on the sites" if u.ndim == 1 else f"{COMPONENTS[k]}, on the sites"
        held.bar(n, column, 0.8, color=COLOURS[k], label=name)
    if ends is not None:
        held.plot(
            [-1, len(u)],
            scaled_by(ends, by.factor),
            "s",
            color=COLOURS[1 + (u.ndim == 2)],
            ms=6,
            label="presses on the ends",
        )
    held.axhline(0, color=FAINT, lw=0.8, zorder=0)
    held.legend(loc="best", frameon=False)
    if u.ndim == 2:
        rest.legend(loc="best", frameon=False)
    for ax, shown in ((rest, by_u), (held, by)):
        ax.set_xlim(-1.6, len(u) + 0.6)
        ax.set_xlabel("site $n$")
        ax.set_ylabel(shown.label)
    return axes


def _chosen(x, field):
    """One field, or the only one."""
    if isinstance(x, dict):
        return numbers("found", x[one_of("field", field, tuple(x))])
    return numbers("found", x)
