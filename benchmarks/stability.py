"""Which step is stable, and what does it do to the energy? `python benchmarks/stability.py [--quick]`

Writes stability.json and, beside this file, five charts: stability.png (the linear limit per force evaluation, and the
growth near it), amplification.png (growth against h omega, solver by solver), finite_amplitude.png (where chains of
finite amplitude lose stability), energy.png (band and drift over t = 1e5 against cost) and resonances.png (resonances
of the step with the modes). `--only` measures some parts again and keeps the others of the JSON; `--quick` is a smoke
test that writes nothing unless `--out` names a folder.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import stability_charts as charts
import stability_runs as runs
from speed import circumstances

import granjax as gx
from granjax.solvers.stability import GROWTH

HERE = Path(__file__).parent
AGREEMENT = 0.02


def limits(quick):
    """The table, each line confirmed by two runs."""
    solvers = (gx.VelocityVerlet, gx.SRKN6b) if quick else runs.EVERY
    rows = runs.table(solvers, max_steps=20_000 if quick else 400_000)
    for row in rows:
        row["confirmed"] = _confirmed(row)
        print(
            f"{row['solver']:<20} h omega < {row['limit']:<11.6g} per force {row['per_evaluation']:<9.4g}"
            f" {row['near_zero']:<9} refused from {row['refused_from']:<9.4g}"
            f" confirmed: {row['confirmed']}",
            flush=True,
        )
    return {"allowed_growth": GROWTH, "rows": rows}


def _confirmed(row):
    """Growth as computed on either side, below what is allowed inside and above it outside; refused as tabled."""
    for name in ("inside", "outside"):
        point = row[name]
        if (
            abs(point["measured_growth"] - point["growth"])
            > AGREEMENT * abs(point["growth"]) + GROWTH / 100
        ):
            return False
    below = row["inside"]["measured_growth"] <= GROWTH < row["outside"]["measured_growth"]
    taken, refused = row["refused"]
    return bool(below and taken is None and refused and "is stable" in refused)


def finite_amplitude(quick):
    """A Hertz chain and a Toda chain, N = 128, t = 1e4."""
    sites, t1 = (8, 50.0) if quick else (128, 1e4)
    solvers = (gx.SRKN6b,) if quick else runs.SYMPLECTIC + runs.PAIRS
    scenes = {"Hertz, precompressed": runs.smooth_chain(sites), "Toda": runs.toda_chain(sites)}
    out = {
        "sites": sites,
        "t1": t1,
        "lost_means": f"energy error above {runs.LOST:g}",
        "scenes": {},
    }
    for name, make in scenes.items():
        out["scenes"][name] = []
        for solver in solvers:
            row = runs.finite_amplitude(make, solver, sites, t1)
            out["scenes"][name].append(row)
            print(
                f"{name:<22}{row['solver']:<20} lost at these fractions of the limit: {row['lost_at']}",
                flush=True,
            )
    return out


def long_energy(quick):
    """Closed and opening contacts, N = 128, t = 1e5."""
    sites, t1 = (8, 200.0) if quick else (128, 1e5)
    solvers = (gx.SRKN6b,) if quick else (*runs.SYMPLECTIC, *runs.PAIRS, runs.RUNGE_KUTTA[2])
    out = {"sites": sites, "t1": t1, "scenes": {}}
    for name, amplitude in (("contacts closed", 0.1), ("contacts open", 0.6)):
        rows = out["scenes"].setdefault(name, {"amplitude": amplitude, "rows": []})["rows"]
        costs = runs.COSTS[1:2] if quick else runs.COSTS
        for row in (
            row
            for solver in solvers
            for row in runs.long_energy(solver, amplitude, sites, t1, costs)
        ):
            rows.append(row)
            text = row.get("outcome", "")[:60]
            if "drift" in row:
                text = (
                    f"drift {row['drift']:+.1e} +- {row['drift_error']:.0e}, band {row['band']:.1e}"
                )
            print(
                f"{name:<16}{row['solver']:<20} {row['cost']:4g} forces per unit time: {text}",
                flush=True,
            )
    return out


def resonances(quick):
    """Two precompressed beads, Verlet and SRKN11b."""
    count, steps = (50, 2000) if quick else (3000, 20_000)
    out = []
    for solver, low in ((gx.VelocityVerlet, 0.5), (gx.SRKN11b, 0.8)):
        out.append(
            runs.resonances(
                solver, low, count, steps, **({"blocks": 4, "per": 64} if quick else {})
            )
        )
        found = [p for p in out[-1]["peaks"] if p["expected"]]
        print(
            f"{solver.__name__}: {len(out[-1]['peaks'])} peaks, {len(found)} of them where expected",
            flush=True,
        )
    return {
        "start": runs.START,
        "steps": steps,
        "highest_order": runs.HIGHEST_ORDER,
        "solvers": out,
    }


PARTS = {f.__name__: f for f in (limits, finite_amplitude, long_energy, resonances)}
CHARTS = {
    "limits": {"stability.png": charts.limits, "amplification.png": charts.amplification},
    "finite_amplitude": {"finite_amplitude.png": charts.finite_amplitude},
    "long_energy": {"energy.png": charts.energy},
    "resonances": {"resonances.png": charts.resonances},
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="tiny sizes; numbers mean nothing")
    parser.add_argument(
        "--only", nargs="*", choices=list(PARTS), help="these parts; the JSON keeps the others"
    )
    parser.add_argument(
        "--charts", action="store_true", help="draw the JSON again, measure nothing"
    )
    parser.add_argument("--out", type=Path, help="folder for stability.json and the charts")
    options = parser.parse_args()
    folder = options.out or (None if options.quick else HERE)
    path = None if folder is None else folder / "stability.json"
    result = (
        json.loads(path.read_text())
        if path and path.is_file() and not options.quick
        else {"parts": {}}
    )
    for name in () if options.charts else options.only or PARTS:
        start = time.perf_counter()
        spent = time.process_time()
        measured = PARTS[name](options.quick)
        taken = {
            "seconds": time.perf_counter() - start,
            "processor_seconds": time.process_time() - spent,
        }
        result["parts"][name] = {
            **circumstances(),
            "quick": options.quick,
            **rounded(taken),
            **rounded(measured),
        }
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(result) + "\n")
    if folder is not None:
        for part, drawn in CHARTS.items():
            for name, draw in drawn.items() if part in result["parts"] else ():
                draw(result["parts"][part], folder / name)
    wrong = [
        row["solver"]
        for row in result["parts"].get("limits", {}).get("rows", ())
        if not row["confirmed"]
    ]
    if wrong:
        sys.exit(f"Limits that the runs do not confirm: {', '.join(wrong)}.")


def rounded(x):
    """Ten digits of every number, so that the file stays small; JSON has no infinity: `None`."""
    if isinstance(x, dict):
        return {key: rounded(value) for key, value in x.items()}
    if isinstance(x, (list, tuple)):
        return [rounded(value) for value in x]
    if isinstance(x, float):
        return float(f"{x:.10g}") if abs(x) < float("inf") else None
    return x


if __name__ == "__main__":
    main()
