"""The charts of `stability.py`, each from one part of its JSON."""

import numpy as np
from matplotlib.colors import LogNorm

import granjax as gx
from granjax.plots.style import COLOURS, DASHES, FAINT, figure, save, style
from granjax.solvers import stability

KIND = {"keeps": COLOURS[0], "damps": COLOURS[2], "amplifies": COLOURS[1]}


def _solver(name):
    import diffrax

    return getattr(gx, name, None) or getattr(diffrax, name)


def _look(name, names):
    """Colour and dashes by place in a list."""
    k = names.index(name)
    return {"color": COLOURS[k % len(COLOURS)], "ls": DASHES[k // len(COLOURS)]}


def limits(part, path):
    """Bars of the limit per force, and the growth around it with the measured points."""
    rows = sorted(part["rows"], key=lambda row: row["per_evaluation"])
    made = figure(11, 5.6)
    with style():
        left, right = made.subplots(1, 2, width_ratios=(1.05, 1))
        y = np.arange(len(rows))
        colours = [KIND[row["near_zero"]] for row in rows]
        left.barh(y, [row["per_evaluation"] for row in rows], color=colours, height=0.7)
        for k, row in enumerate(rows):
            text = f" {row['limit']:.5g} / {row['evaluations']:g}"
            left.text(row["per_evaluation"], k, text, va="center", fontsize=7.5)
        left.set_yticks(y, [row["solver"] for row in rows], fontsize=8.5)
        left.set_xscale("log")
        left.set_xlim(1e-5, 9)
        left.set_xlabel(r"stable $h\omega$ per force evaluation")
        for kind, colour in KIND.items():
            left.barh(
                0,
                0,
                color=colour,
                label={
                    "keeps": "keeps the amplitude",
                    "damps": "damps from zero on",
                    "amplifies": "amplifies from zero on",
                }[kind],
            )
        left.legend(loc="upper center", bbox_to_anchor=(0.35, -0.11), ncols=2)
        left.set_title(
            f"Linear limit: growth below {part['allowed_growth']:g} per radian", loc="left"
        )
        shown = [row for row in part["rows"] if row["solver"] != "Euler"]
        for k, row in enumerate(shown):
            for name, marker, colour in (("inside", "o", COLOURS[0]), ("outside", "s", COLOURS[1])):
                point = row[name]
                right.plot(point["growth"], k, "|", ms=13, mew=1.6, color="0.35")
                right.plot(point["measured_growth"], k, marker, ms=4.5, color=colour)
        right.set_xscale("symlog", linthresh=1e-7)
        right.set_xticks([s * 10.0**k for s in (-1, 1) for k in (-6, -4, -2, 0)] + [0])
        right.set_xlim(-0.1, 1)
        right.axvline(part["allowed_growth"], color=FAINT, lw=0.8, ls="--")
        right.invert_yaxis()
        right.set_yticks(np.arange(len(shown)), [row["solver"] for row in shown], fontsize=8.5)
        right.set_xlabel("growth of the highest mode per radian")
        right.plot([], [], "|", ms=12, mew=1.6, color="0.35", label="computed")
        right.plot([], [], "o", ms=4.5, color=COLOURS[0], label="run at 0.99 of the limit")
        right.plot([], [], "s", ms=4.5, color=COLOURS[1], label="run just outside, 1 % at most")
        right.plot([], [], color=FAINT, lw=0.8, ls="--", label="allowed")
        right.legend(loc="upper center", bbox_to_anchor=(0.45, -0.11), ncols=2)
        right.set_title("Confirmed on a linear chain of 16", loc="left")
    save(made, path, dpi=130)


def amplification(part, path, until=9.5, columns=5):
    """Growth per radian against h omega, solver by solver, with every narrow window."""
    rows = [
        row
        for row in part["rows"]
        if row["solver"] not in ("Midpoint", "Ralston", "ReversibleHeun", "Euler")
    ]
    lines = -(-len(rows) // columns)
    made = figure(12, 2.1 * lines + 0.5)
    with style():
        axes = made.subplots(lines, columns, sharex=True, sharey=True).ravel()
        for ax, row in zip(axes, rows):
            solver = _solver(row["solver"])
            z = stability.places(solver, until)
            rate = stability.growth(solver, z)
            for sign, colour in ((1, COLOURS[1]), (-1, COLOURS[2])):
                ax.plot(z, np.where(sign * rate > 1e-10, sign * rate, np.nan), color=colour, lw=1.1)
            ax.axvline(row["limit"], color=COLOURS[0], lw=0.8, ls="--", zorder=0)
            for place, window in enumerate(row["windows"]):
                middle = (window["start"] + window["end"]) / 2
                width = window["end"] - window["start"]
                if width < 0.1:
                    ax.vlines(middle, 1e-10, window["growth"], color=COLOURS[1], lw=2)
                    ax.text(middle + 0.15, 3e-10 * 30**place, f"{width:.1e} wide", fontsize=7)
            ax.plot(
                row["outside"]["h_omega"],
                row["outside"]["measured_growth"],
                "s",
                ms=3.5,
                color="black",
            )
            ax.set_title(f"{row['solver']}: {row['limit']:.5g}", fontsize=8.5, loc="left")
        for ax in axes[len(rows) :]:
            ax.set_visible(False)
        axes[0].set_yscale("log")
        axes[0].set_ylim(1e-10, 3)
        for ax in axes[-columns - (lines * columns - len(rows)) : len(rows)]:
            ax.tick_params(labelbottom=True)
        axes[0].plot([], [], color=COLOURS[1], label="growth")
        axes[0].plot([], [], color=COLOURS[2], label="decay")
        axes[0].plot([], [], "s", ms=3.5, color="black", label="run outside")
        axes[0].plot([], [], color=COLOURS[0], lw=0.8, ls="--", label="limit")
        made.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
        made.supxlabel(r"$h\omega$", fontsize=10)
        made.supylabel("growth or decay per radian", fontsize=10)
    save(made, path, dpi=130)


def finite_amplitude(part, path):
    """Energy error by solver, amplitude and fraction of the linear limit; black where stability is lost."""
    made = figure(11, 6.4)
    with style():
        axes = made.subplots(1, len(part["scenes"]), sharey=True, squeeze=False)[0]
        for ax, (name, rows) in zip(axes, part["scenes"].items()):
            fractions = rows[0]["fractions"]
            sizes = rows[0]["amplitudes"]
            errors = np.array(
                [
                    [np.inf if e is None else e for e in line]
                    for row in rows
                    for line in row["error"]
                ]
            )
            errors = np.where(errors >= 10, np.nan, np.maximum(errors, 1e-16))
            ax.set_facecolor("black")
            edges = np.arange(len(fractions) + 1) - 0.5
            mesh = ax.pcolormesh(
                edges,
                np.arange(len(errors) + 1) - 0.5,
                errors,
                cmap="viridis_r",
                norm=LogNorm(1e-5, 10),
            )
            ax.set_xticks(
                range(len(fractions)), [f"{f:g}" for f in fractions], rotation=90, fontsize=7.5
            )
            within = sum(f < 1 for f in fractions) - 0.5
            ax.axvline(within, color="tab:red", lw=1.2)
            for k in range(1, len(rows)):
                ax.axhline(k * len(sizes) - 0.5, color="white", lw=2)
            ax.set_title(f"{name} chain, N = {part['sites']}, t = {part['t1']:g}", loc="left")
            ax.set_xlabel("step over the linear limit (red: the limit)")
            labels = [
                f"{row['solver']}  {size:g}" if k == 0 else f"{size:g}"
                for row in rows
                for k, size in enumerate(sizes)
            ]
            ax.set_yticks(range(len(labels)), labels, fontsize=7.5)
        axes[0].invert_yaxis()
        axes[0].set_ylabel("solver, and amplitude of random displacements ($d_0 = 1$)")
        made.colorbar(
            mesh, ax=axes, label="largest $|E/E_0 - 1|$ (black: above 10, lost)", fraction=0.03
        )
    save(made, path, dpi=130)


def energy(part, path):
    """Band and drift against cost."""
    made = figure(11, 8.2)
    with style():
        grid = made.subplots(2, len(part["scenes"]), sharex=True, sharey="row", squeeze=False)
        for column, (name, scene) in zip(grid.T, part["scenes"].items()):
            names = list(dict.fromkeys(row["solver"] for row in scene["rows"]))
            for k, solver in enumerate(names):
                rows = [row for row in scene["rows"] if row["solver"] == solver and "drift" in row]
                look = _look(solver, names)
                cost = np.array([row["cost"] for row in rows]) * 1.03 ** (k - len(names) / 2)
                column[0].plot(
                    cost,
                    [row["band"] for row in rows],
                    marker="o",
                    ms=3.5,
                    lw=1.1,
                    label=solver,
                    **look,
                )
                drift, error = (
                    np.array([row[key] for row in rows]) for key in ("drift", "drift_error")
                )
                sure = np.abs(drift) > 2 * error
                column[1].plot(cost, np.abs(drift), lw=0.8, alpha=0.5, **look)
                bars = np.where(sure, error, 0), error
                column[1].errorbar(
                    cost, np.abs(drift), bars, ls="", marker="", lw=0.9, color=look["color"]
                )
                column[1].plot(cost[sure], np.abs(drift)[sure], "o", ms=4.5, color=look["color"])
                column[1].plot(
                    cost[~sure], np.abs(drift)[~sure], "o", ms=4.5, color=look["color"], mfc="white"
                )
            column[0].set_title(f"{name}: random displacements ±{scene['amplitude']:g}", loc="left")
            column[1].set_xlabel("force evaluations per unit time")
            for ax in column:
                ax.set_xscale("log")
                ax.set_yscale("log")
                ticks = sorted({row["cost"] for row in scene["rows"]})
                ax.set_xticks(ticks, [f"{cost:g}" for cost in ticks])
                ax.minorticks_off()
        grid[0, 0].set_ylabel(r"band: scatter of $E/E_0$ about its line")
        grid[1, 0].set_ylabel(r"|drift| of $E/E_0$ (open: below 2 standard errors)")
        grid[1, 0].set_ylim(1e-14, 3)
        made.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside right center")
        made.suptitle(
            f"Precompressed Hertz chain, N = {part['sites']}, t = {part['t1']:,.0f}, three random starts",
            fontsize=10.5,
        )
    save(made, path, dpi=130)


def resonances(part, path):
    """Energy error against h omega_max with the resonances that were expected and found."""
    made = figure(11, 7.2)
    tints = {
        2: "black",
        3: COLOURS[1],
        4: COLOURS[2],
        5: COLOURS[5],
        6: COLOURS[3],
        7: FAINT,
        8: FAINT,
    }
    with style():
        for ax, row in zip(made.subplots(len(part["solvers"]), 1), part["solvers"]):
            z, slow, largest = (
                np.array([np.nan if x is None else x for x in row[key]])
                for key in ("h_omega", "slow", "largest")
            )
            ax.semilogy(z, largest, color=COLOURS[4], lw=1, label=r"largest $|E/E_0-1|$")
            ax.semilogy(
                z, slow, color=COLOURS[0], lw=0.9, label="range of its means over 256 steps"
            )
            lost = np.flatnonzero(np.isnan(slow))
            if lost.size:
                ax.axvspan(z[lost[0]], z[lost[-1]], color="0.8", label="run lost")
            top = np.nanmax(largest)
            for peak in row["peaks"]:
                found = peak["expected"]
                if found is not None:
                    ax.axvline(
                        found["h_omega"], color=tints[found["order"]], lw=0.8, alpha=0.7, zorder=0
                    )
                if found is not None and found["order"] <= 6:
                    c1, c2 = found["c"]
                    ax.text(
                        found["h_omega"],
                        30 * top,
                        f"{c1}, {c2}" + (f" : {found['n']}" if found["n"] > 1 else ""),
                        rotation=90,
                        fontsize=7,
                        ha="center",
                        va="bottom",
                        color=tints[found["order"]],
                    )
            ax.set_ylim(np.nanmin(slow) / 2, 30 * top)
            ax.set_xlim(z[0], z[-1] * 1.002)
            matched = sum(peak["expected"] is not None for peak in row["peaks"])
            ax.set_title(
                f"{row['solver']}: {len(row['peaks'])} peaks, {matched} of them at resonances "
                f"$c_1\\theta_1 + c_2\\theta_2 = 2\\pi n$ (lines, marked $c_1, c_2 : n$)",
                loc="left",
                pad=38,
            )
            ax.set_ylabel("energy error")
        ax.set_xlabel(r"$h\omega_{\max}$")
        made.legend(*made.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    save(made, path, dpi=130)
