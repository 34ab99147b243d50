"""What evolves: runs of first-order lattices, breathers of k-gaps."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ..checks import refuse
from ..units import UnitsOrWords
from .arrays import numbers, rising
from .histories import space_time
from .quantities import Axis, drawn_in, scaled_by, units_of
from .style import COLOURS, AxesOrNone, add_colour_bar, axes_or_new, several_axes

# lowest relative change that is drawn
FLOOR = 1e-17


def evolution(
    found: Any,
    axes: Sequence[Axes] | np.ndarray | None = None,
    *,
    scale: str = "linear",
    units: UnitsOrWords = None,
) -> np.ndarray:
    r"""A run of a first-order lattice: space-time map of |psi_n|^2, and how well norm, energy and psi are known.

    **Arguments:** `found`: an `Evolution`, the result of `gx.first_order.evolve` with `save_at`, or anything with `ts`,
    `densities` (T, N), `norm`, `energy` and `error` (T,), `norm_error` and `energy_error`. `axes`: two Axes; by default
    those of a new figure. `scale`: of the map, `"linear"` or `"log"`. `units`: of the time, `"SI"` or `"us"`, as in
    `granjax.plots`.

    **Returns:** the two Axes, (2,) or as given: `axes[0].images[0]` is the map, `axes[1].lines` the changes of norm and
    energy since the start, relative as `norm_error` and `energy_error` are, and the error of psi over the root of the
    norm.
    **Raises** ValueError for lanes, or a single time.

    **Example:**

    >>> from types import SimpleNamespace
    >>> ones, zeros = np.ones(3), np.zeros(3)
    >>> found = SimpleNamespace(ts=np.arange(3.0), densities=np.ones((3, 5)), norm=ones, energy=ones, error=zeros,
    ...                         norm_error=1e-12, energy_error=1e-12)
    >>> [ax.get_ylabel() for ax in gx.plots.evolution(found)]
    ['time', 'relative change, error']
    """
    density = numbers("found.densities", found.densities, finite=False)
    if density.ndim != 2 or len(density) < 2:
        refuse(
            "found",
            "several times of one lattice: densities (T, N)",
            f"shape {density.shape}",
            "Give evolve save_at=, and of a batch draw one lane.",
        )
    ts = rising("found.ts", found.ts, len(density))
    norm, energy, error = (
        numbers(f"found.{name}", getattr(found, name), 1, finite=False)
        for name in ("norm", "energy", "error")
    )
    (by,) = drawn_in(units, units_of(found), Axis("time", ts, "s"))
    axes = several_axes(axes, 1, 2, 8.8, 3.6)
    shown, known = axes.ravel()
    t = scaled_by(ts, by.factor)
    space_time(density, shown, ts=t, scale=scale, colour_bar=False)
    add_colour_bar(
        shown, shown.images[0] if shown.images else shown.collections[0], r"$|\psi_n|^2$"
    )
    shown.set_ylabel(by.label)
    size = np.sqrt(norm[0]) or 1.0
    moved = _change(norm, found.norm_error), _change(energy, found.energy_error)
    curves = (
        (moved[0], "norm", "-"),
        (moved[1], "energy", "--"),
        (error / size, r"error of $\psi$", ":"),
    )
    for k, (y, name, dash) in enumerate(curves):
        known.semilogy(t, np.maximum(y, FLOOR), dash, color=COLOURS[k], lw=1.3, label=name)
    known.set_xlim(t[0], t[-1])
    known.set_ylim(FLOOR / 3, None)
    known.set_xlabel(by.label)
    known.set_ylabel("relative change, error")
    known.legend(loc="best", frameon=False)
    return axes


def _change(x, most):
    """Changes since the start, the largest of which is known relative to something."""
    moved = np.abs(x - x[0])
    return moved * (float(most) / (moved.max() or 1.0))


def gap_breather(found: Any, ax: AxesOrNone = None, *, units: UnitsOrWords = None) -> Axes:
    """Energy of a breather of a k-gap once a period, beside the growth and decay of the linear waves.

    **Arguments:** `found`: a `GapBreather`, the result of `gx.breathers.k_gap_breather`, or anything with `ts`,
    `energy` (P,) and `growth`. `units`: `("ms", "uJ")`, as in `granjax.plots`.

    **Returns:** the Axes; `ax.lines[0]` is the energy.

    **Example:**

    >>> from types import SimpleNamespace
    >>> found = SimpleNamespace(ts=np.arange(5.0), energy=np.array([0.1, 0.5, 1.0, 0.5, 0.1]), growth=0.8)
    >>> ax = gx.plots.gap_breather(found)
    >>> ax.get_yscale()
    'log'
    """
    energy = numbers("found.energy", found.energy, 1)
    ts, growth = rising("found.ts", found.ts, len(energy)), float(found.growth)
    by_t, by_e = drawn_in(
        units, units_of(found), Axis("time", ts, "s"), Axis("energy", energy, "J")
    )
    t, e = scaled_by(ts, by_t.factor), scaled_by(energy, by_e.factor)
    ax = axes_or_new(ax, 5.6, 3.6)
    ax.semilogy(t, e, "o-", color=COLOURS[0], ms=3, lw=1.0, label="once a period")
    for sign, since, name in ((1, ts - ts[0], "linear waves"), (-1, ts - ts[-1], None)):
        ax.semilogy(
            t,
            e[0 if sign > 0 else -1] * np.exp(sign * 2 * growth * since),
            "--",
            color=COLOURS[1],
            lw=1.0,
            label=name,
        )
    ax.set_ylim(e.min() / 3, 5 * e.max())
    ax.set_xlabel(by_t.label)
    ax.set_ylabel(by_e.label)
    ax.legend(loc="best", frameon=False)
    return ax
