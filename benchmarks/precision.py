"""What error for what time, beside everybody else? `python benchmarks/precision.py [--quick]`

Writes precision.json (every point of every method, and what follows from them) and a chart for each scene beside this
file. `--quick` is a smoke test that everything runs and agrees, on shorter scenes; it writes nothing unless `--out`
names a folder. Needs `pip install granjax[bench]`; who is not installed is left out, with a note.

Everything runs in one process on one core; calls take turns; medians count; what compiles is timed apart.
"""

import argparse
import json
import os
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

if hasattr(os, "sched_setaffinity"):
    # before JAX starts, so that its pools have one thread
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

import jax
import numpy as np
import peers
import scenes
from curves import by_method, chart, figures
from machine import as_dict, machine
from peers.chain import SPLITTING
from peers.native import compiler

import granjax as gx
from granjax.work_precision import Ladder, highest_frequency, measure, stable_step

HERE = Path(__file__).parent
SCENES = {"impact": "impact", "smooth": "smooth", "sweep": "dimer_sweep"}
# of steps: half a decade of error each, where the force is smooth (its own order) and where contacts open (5/2)
RUNG = 0.5
OPENING = 2.5
# seconds of a run at which a ladder ends
LONGEST = {"impact": 0.3, "smooth": 0.6, "sweep": 2.0}
FIRST_STEP = 0.95
MOST_STEPS = 40
TOLERANCES = 10.0 ** -np.arange(3, 14.5, 0.5)
# what another compiles for every tolerance
FEW = 10.0 ** -np.arange(4.0, 15.0, 2.0)
# what --quick takes of steps and of tolerances, and where it ends; everybody must come as near as this
QUICK = slice(8, 10)
QUICK_TOLERANCE = 1e-8
SHORT = 10
AGREEMENT = 1e-2


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="shorter scenes, few points; numbers mean nothing"
    )
    parser.add_argument(
        "--only", nargs="*", choices=list(SCENES), default=list(SCENES), help="these scenes alone"
    )
    parser.add_argument(
        "--kinds", nargs="*", choices=peers.KINDS, default=peers.KINDS, help="these peers alone"
    )
    parser.add_argument("--out", type=Path, help="folder for precision.json and the charts")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument(
        "--draw", action="store_true", help="only the charts, from the JSON that is there"
    )
    options = parser.parse_args()
    folder = options.out or (None if options.quick else HERE)
    if options.draw:
        for name, scene in json.loads((folder / "precision.json").read_text())["scenes"].items():
            chart(scene, folder / f"precision_{name}.png")
        return
    result = {
        **machine(),
        "peers": versions(),
        "quick": options.quick,
        "load": os.getloadavg(),
        "scenes": {},
    }
    for name in options.only:
        result["scenes"][name] = measured(name, options)
        print(words(name, result["scenes"][name]), flush=True)
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "precision.json").write_text(
                json.dumps(result, indent=1, allow_nan=False) + "\n"
            )
            chart(result["scenes"][name], folder / f"precision_{name}.png")
    away = [x for scene in result["scenes"].values() for x in scene["disagreeing"]]
    if away:
        sys.exit(f"Never within {AGREEMENT:g} of the reference: {', '.join(away)}.")


def measured(name, options):
    """All points of a scene, and what follows from them."""
    scene = problem(SCENES[name], options.quick)
    found, left_out = peers.gather(
        peers.Chain.of(scene.lattice, scene.state, scene.t1, scene.smooth), options.kinds
    )
    ladders = [
        *own(scene, options.quick),
        *(others(scene, *x, options.quick) for x in found.items()),
    ]
    repeats = 1 if options.quick else options.repeats
    table = as_dict(
        measure(
            ladders,
            tuple(scene.reference),
            scene.uncertainty,
            repeats,
            longest=LONGEST[name],
            note=scene.note,
        )
    )
    ratios = [p["seconds"] / p["fastest"] for p in table["points"] if p["drawn"]]
    return {
        "title": scene.title,
        "t1": scene.t1,
        "left_out": left_out,
        "disagreeing": disagreeing(table, ladders),
        "median_over_fastest": float(np.median(ratios)),
        "figures": figures(table, "seconds"),
        "figures_of_fastest": figures(table, "fastest"),
        **table,
    }


def disagreeing(table, ladders):
    """The methods that never come near the reference, though no time was short."""
    methods = by_method(table)
    tried = {ladder.name: len(ladder.values) for ladder in ladders}
    nearest = {name: min(p["error"] or np.inf for p in points) for name, points in methods.items()}
    return [
        name
        for name, error in nearest.items()
        if not error < AGREEMENT and len(methods[name]) == tried[name]
    ]


def problem(name, quick):
    """The canonical scene; the start of it, with a reference of its own, where quick."""
    scene = scenes.scene(name)
    if not quick:
        return scene
    t1 = scene.t1 / SHORT
    end = gx.simulate(scene.lattice, scene.state, t1, tolerance=1e-13, solver=gx.RKN1210())
    return scene._replace(t1=t1, reference=end.final, uncertainty=1e-10)


def own(scene, quick):
    """granjax through `simulate`: splitting methods at fixed steps, Nystrom pairs with step control."""

    def of(solver, parameter):
        def call(value):
            run = gx.simulate(
                scene.lattice, scene.state, scene.t1, solver=solver, **{parameter: value}
            )
            return run.final, run.stats["force_evaluations"], run.stats["steps"]

        return call

    for name in SPLITTING:
        yield Ladder(
            f"granjax {name}",
            "step",
            steps(scene, name, quick),
            of(getattr(gx, name)(), "step"),
            True,
        )
    for name in ("RKN86", "RKN1210"):
        solver = getattr(gx, name)()
        values = [QUICK_TOLERANCE] if quick else TOLERANCES
        yield Ladder(f"granjax {name}", "tolerance", values, of(solver, "tolerance"), True)
        if scene.smooth:
            fixed = of(solver, "step")
            yield Ladder(
                f"granjax {name}, fixed step", "step", steps(scene, name, quick), fixed, True
            )
        if scene.lattice.lanes:
            yield Ladder(
                f"granjax {name}, vmap", "tolerance", values, lane_by_lane(scene, solver), True
            )


def lane_by_lane(scene, solver):
    """A step of its own for every lane, by `jax.vmap` over `simulate`."""

    def one(lattice, state, tolerance):
        return gx.simulate(lattice, state, scene.t1, solver=solver, tolerance=tolerance).final

    run = jax.jit(jax.vmap(one, in_axes=(-1, -1, None), out_axes=-1))
    return lambda tolerance: (run(scene.lattice, scene.state, tolerance), None)


def others(scene, name, peer, quick):
    """A peer with the same steps as granjax's method of that name, or with tolerances."""
    parameter, call = peer
    if parameter == "step":
        values = steps(scene, name.split()[-1], quick)
        return Ladder(name, "step", values, lambda h: (call(round(scene.t1 / h)), None), True)
    values = [QUICK_TOLERANCE] if quick else FEW if name.startswith("heyoka") else TOLERANCES
    return Ladder(name, "tolerance", values, lambda x: (call(x), None), True)


def steps(scene, name, quick):
    """Steps that divide the time, from the stability limit down."""
    limit = stable_step(
        getattr(gx, name)(), highest_frequency(scene.lattice, scene.state, 0.0, scene.t1)
    )
    order = getattr(gx, name).table().order
    order = order if scene.smooth else min(OPENING, order)
    ladder = FIRST_STEP * limit * 10.0 ** (-RUNG * np.arange(MOST_STEPS) / order)
    return scene.t1 / np.ceil(scene.t1 / (ladder[QUICK] if quick else ladder))


def versions():
    """Versions of the peers; `None` for what is not there."""
    found = {}
    for name in peers.PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return {**found, "C compiler": compiler()}


def words(name, scene):
    """Who is first, for the terminal."""
    lines = [f"{name}: {scene['title']}, t = {scene['t1']:g}"]
    for error, row in scene["figures"].items():
        times = ", ".join(
            f"{family} {1e3 * x['seconds']:.3g} ms" for family, x in row["families"].items()
        )
        lines.append(f"  {error}: first {row['first']}; {times}")
    return "\n".join(
        lines + [f"  left out: {kind}: {why}" for kind, why in scene["left_out"].items()]
    )


if __name__ == "__main__":
    main()
