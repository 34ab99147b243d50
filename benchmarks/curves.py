"""Time at equal error, from points of error and time; and the chart of `precision.py`."""

import numpy as np
from scipy.optimize import isotonic_regression

from granjax.plots.style import FAINT, figure, save, style

ERRORS = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
# family: how the names of its methods start, colour, line
FAMILIES = {
    "granjax": (("granjax",), "#0072B2", "-"),
    "numba, splitting": (tuple(f"numba {x}" for x in ("V", "SR", "K", "So")), "#D55E00", "-"),
    "C, splitting": (("C ",), "#E69F00", "-"),
    "numba, Nyström": (("numba RKN",), "#D55E00", ":"),
    "numbalsoda": (("numbalsoda",), "#009E73", "-"),
    "heyoka": (("heyoka",), "#CC79A7", "-"),
    "diffrax's own": (("diffrax",), "#56B4E9", "-"),
    "scipy": (("scipy",), "0.3", "-"),
}
MUTED = 0.75
COARSEST = 1e-2
FINEST = 1e-12


def curve(points, column):
    """(errors, seconds) of one method, the errors rising, the seconds falling.

    Along its steps or tolerances the error should fall and the time rise. Where a point breaks that, neighbours are
    averaged (isotonic regression of the logarithms), so that an error that is small by chance does not count.
    """
    use = sorted((-p["value"], p["error"], p[column]) for p in points if p["drawn"])
    if not use:
        return np.empty((2, 0))
    _, error, time = np.log(np.abs(use)).T
    blocks = isotonic_regression(error, increasing=False).blocks
    time = isotonic_regression(time).x
    return np.exp([[x[i:j].mean() for i, j in zip(blocks, blocks[1:])] for x in (error, time)])[
        :, ::-1
    ]


def time_at(points, error, column):
    """Seconds for at most an error, log-log between the points; the coarsest point's where that is better than asked,
    `None` where no point is good enough."""
    errors, seconds = curve(points, column)
    if not errors.size or error < errors[0]:
        return None
    return float(np.exp(np.interp(np.log(error), np.log(errors), np.log(seconds))))


def by_method(table):
    """The points of every method."""
    found = {method["name"]: [] for method in table["methods"]}
    for point in table["points"]:
        found[point["method"]].append(point)
    return found


def members(names, family):
    """The names of a family."""
    return [name for name in names if name.startswith(FAMILIES[family][0])]


def figures(table, column):
    """At every error: the time of every method, the best of every family, granjax's best over them, who is first."""
    methods = by_method(table)
    out = {}
    for error in ERRORS:
        times = {name: time_at(points, error, column) for name, points in methods.items()}
        times = {name: seconds for name, seconds in times.items() if seconds is not None}
        best = {}
        for family in FAMILIES:
            name = min(members(times, family), key=times.get, default=None)
            if name is not None:
                best[family] = {"method": name, "seconds": times[name]}
        if not times:
            continue
        out[f"{error:.0e}"] = row = {
            "first": min(times, key=times.get),
            "families": best,
            "seconds": times,
        }
        if "granjax" in best:
            ours = best["granjax"]["seconds"]
            row["granjax_over_family"] = {family: ours / x["seconds"] for family, x in best.items()}
            row["granjax_over_method"] = {name: ours / seconds for name, seconds in times.items()}
    return out


def envelope(curves, errors):
    """The least time of several methods at every error; NaN where none gets there."""
    times = np.full((len(curves) + 1, len(errors)), np.inf)
    for row, (own, seconds) in zip(times, curves):
        if own.size:
            row[:] = np.exp(np.interp(np.log(errors), np.log(own), np.log(seconds)))
            row[errors < own[0]] = np.inf
    best = times.min(axis=0)
    return np.where(np.isfinite(best), best, np.nan)


def chart(scene, path, of="the final state"):
    """Error against time: of every family the method that is best at the error."""
    methods = by_method(scene)
    errors = np.geomspace(FINEST, COARSEST, 600)
    with style():
        made = figure(6.4, 4.0)
        ax = made.subplots()
        for family, (_, shade, dashes) in FAMILIES.items():
            best = envelope(
                [curve(methods[name], "seconds") for name in members(methods, family)], errors
            )
            if np.isnan(best).all():
                continue
            ours = family == "granjax"
            ax.plot(
                best,
                errors,
                color=shade,
                ls=dashes,
                lw=3.0 if ours else 1.4,
                alpha=1.0 if ours else MUTED,
                label=family,
                zorder=4 if ours else 3,
            )
        ax.set(
            xscale="log",
            yscale="log",
            xlabel="time of one run on one core (s)",
            ylabel=f"relative error of {of}",
            title=scene["title"],
        )
        ax.grid(True, which="major", color=FAINT, alpha=0.25, lw=0.6)
        made.legend(loc="outside right center")
    save(made, path)
