"""What does the map of tangents over a period cost, to what error, beside others? `python benchmarks/monodromy.py`

Writes monodromy.json and monodromy.png beside this file: the canonical monodromy (162 x 162, a gap breather of a dimer
of 81 beads, contacts closed), and a family of 100 such breathers with all multipliers in a fresh process. `--quick` is
a smoke test that everything runs and agrees; it writes nothing unless `--out` names a folder. Needs
`pip install granjax[bench]`; who is not installed is left out, with a note.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

if hasattr(os, "sched_setaffinity"):
    cores = os.sched_getaffinity(0)
    # before JAX starts, so that its pools have one thread
    os.sched_setaffinity(0, {min(cores)})

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scenes
from curves import chart, figures
from machine import as_dict, machine
from peers import PACKAGES
from peers.tangents import METHODS, Orbit
from precision import AGREEMENT, disagreeing, versions

import granjax as gx
from granjax.work_precision import Ladder, measure

HERE = Path(__file__).parent
MODULES = ("tangents", "taylor_tangents")
FEWEST = 8
MOST = 130
RUNG = 1.12
TOLERANCES = 10.0 ** -np.arange(3, 14.5, 0.5)
FEW = 10.0 ** -np.arange(4.0, 15.0, 2.0)
# the error at which like is compared with like
ERROR = 1e-9
POINTS = 100
LONGEST_ARCLENGTH = 0.0415
PROCESSES = 5
FAMILY = """
import granjax as gx
chain = gx.scenes.pattern(81, (1.0, 2.957949), precompression=1.0, boundary="free")
branch = gx.breathers.family(chain, until=0.985 * 3**0.5, longest_arclength={arclength}, points={points})
assert branch.multipliers.shape == (len(branch), 162)
print(len(branch))
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few points; numbers mean nothing")
    parser.add_argument("--out", type=Path, help="folder for monodromy.json and the chart")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument(
        "--draw", action="store_true", help="only the chart, from the JSON that is there"
    )
    options = parser.parse_args()
    folder = options.out or (None if options.quick else HERE)
    if options.draw:
        drawn(json.loads((folder / "monodromy.json").read_text()), folder)
        return
    result = {
        **machine(),
        "peers": versions(),
        "load": os.getloadavg(),
        "monodromy": monodromy(options),
    }
    if not options.quick:
        result["family"] = family()
    print(words(result))
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "monodromy.json").write_text(json.dumps(result, indent=1, allow_nan=False) + "\n")
        drawn(result, folder)
    if result["monodromy"]["disagreeing"]:
        sys.exit(
            f"Never within {AGREEMENT:g} of the reference: {', '.join(result['monodromy']['disagreeing'])}."
        )


def drawn(result, folder):
    chart(result["monodromy"], folder / "monodromy.png", "the monodromy matrix")


def monodromy(options):
    """All points, and what follows from them."""
    scene = scenes.scene("monodromy")
    orbit = Orbit.of(scene.lattice, scene.state, scene.t1)
    left_out = {}
    ladders = []
    counts = np.unique(np.round(FEWEST * RUNG ** np.arange(40)).astype(int))
    counts = counts[counts <= MOST][slice(10, 12) if options.quick else slice(None)]
    for name in METHODS:
        solver = getattr(gx, name)()
        ladders.append(
            Ladder(f"granjax {name}", "step", scene.t1 / counts, own(scene, solver), True)
        )
        ladders.append(
            Ladder(
                f"granjax {name}, half a period",
                "step",
                scene.t1 / counts,
                halved(scene, solver),
                True,
            )
        )
    for module in MODULES:
        try:
            found = import_module(f"peers.{module}").calls(orbit)
        except (ImportError, OSError) as error:
            left_out[module] = str(error)
            continue
        ladders += [peer(scene, name, *x, counts, options.quick) for name, x in found.items()]
    reference = parts(np.asarray(scene.reference))
    table = as_dict(
        measure(
            ladders,
            reference,
            scene.uncertainty,
            1 if options.quick else options.repeats,
            longest=2.0,
            note=scene.note,
        )
    )
    return {
        "title": scene.title,
        "t1": scene.t1,
        "left_out": left_out,
        "disagreeing": disagreeing(table, ladders),
        "figures": figures(table, "seconds"),
        "figures_of_fastest": figures(table, "fastest"),
        "like_with_like": like_with_like(table),
        **table,
    }


def parts(matrix):
    """Rows of u and rows of v: an error is relative to the largest of its half."""
    return tuple(np.split(matrix, 2))


def steps_of(scene, h):
    return int(round(scene.t1 / h))


def own(scene, solver):
    """`Flow.derivative` over the period, the number of steps an input of one compiled function."""

    @eqx.filter_jit
    def map_of(steps, lattice, state):
        return gx.Flow(steps, solver).derivative(state, 0.0, scene.t1, lattice)[1]

    def call(h):
        matrix = map_of(jnp.asarray(steps_of(scene, h)), scene.lattice, scene.state)
        return parts(np.asarray(matrix)), None

    return call


def halved(scene, solver):
    """The same from half a period: an orbit that is at rest twice retraces its path, M = R H^{-1} R H.

    H is symplectic in (u, m v), H^{-1} = J^T H^T J, and R reverses velocities; a convenience of such orbits alone.
    """
    mass = np.broadcast_to(np.asarray(scene.lattice.mass), np.shape(scene.state[0]))

    @eqx.filter_jit
    def map_of(steps, lattice, state):
        return gx.Flow(steps, solver).derivative(state, 0.0, scene.t1 / 2, lattice)[1]

    def call(h):
        half = np.asarray(
            map_of(jnp.asarray(-(-steps_of(scene, h) // 2)), scene.lattice, scene.state)
        )
        n = len(mass)
        a = half[:n, :n]
        b = half[:n, n:]
        c = half[n:, :n]
        d = half[n:, n:]
        # of (u, v): the inverse of [[a, b], [c, d]] is [[D, -B], [-C, A]] with A = m^{-1} a^T m and so on
        scaled = lambda x: x.T * mass / mass[:, None]
        back = np.block([[scaled(d), scaled(b)], [scaled(c), scaled(a)]])
        return parts(back @ half), None

    return call


def peer(scene, name, parameter, call, counts, quick):
    """A peer with the same steps, or with tolerances."""
    if parameter == "step":
        return Ladder(
            name, "step", scene.t1 / counts, lambda h: (parts(call(steps_of(scene, h))), None), True
        )
    values = [1e-10] if quick else FEW if name.startswith("heyoka") else TOLERANCES
    return Ladder(name, "tolerance", values, lambda x: (parts(call(x)), None), True)


def like_with_like(table):
    """granjax's time over the numba loop's, method by method, each with the fewest steps for an error of 1e-9."""
    found = {}
    for name in METHODS:
        rows = []
        for who in ("granjax", "numba"):
            good = [
                p
                for p in table["points"]
                if p["method"] == f"{who} {name}" and p["drawn"] and p["error"] <= ERROR
            ]
            rows.append(max(good, key=lambda p: p["value"], default=None))
        if None not in rows:
            ours, theirs = rows
            found[name] = {
                "seconds": ours["seconds"],
                "numba": theirs["seconds"],
                "ratio": ours["seconds"] / theirs["seconds"],
                "ratio_of_fastest": ours["fastest"] / theirs["fastest"],
                "errors": [ours["error"], theirs["error"]],
            }
    return found


def family():
    """Seconds of a fresh process for some hundred breathers with all their multipliers, import and compiling included.

    With the compilation cache off, and with what an earlier process has left there.
    """
    code = FAMILY.format(arclength=LONGEST_ARCLENGTH, points=4 * POINTS)
    cached = f"import granjax.base.tuning; granjax.base.tuning.keep_compiled(){code}"
    fresh, points = processes(code, {"GRANJAX_CACHE": "0"})
    return {"points": points, "fresh": fresh, "with_cache": processes(cached, {})[0]}


def processes(code, environment):
    """(seconds of every process, what it printed), on all cores."""
    seconds = []
    free = lambda: os.sched_setaffinity(0, cores) if hasattr(os, "sched_setaffinity") else None
    for _ in range(PROCESSES):
        start = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, **environment},
            preexec_fn=free,
            capture_output=True,
            text=True,
            check=True,
        )
        seconds.append(time.perf_counter() - start)
    return {"seconds": seconds, "median": statistics.median(seconds), "least": min(seconds)}, int(
        done.stdout
    )


def words(result):
    """For the terminal."""
    lines = []
    for error, row in result["monodromy"]["figures"].items():
        times = ", ".join(
            f"{family} {1e3 * x['seconds']:.3g} ms" for family, x in row["families"].items()
        )
        lines.append(f"  {error}: first {row['first']}; {times}")
    lines += [
        f"  {name}: {x['ratio']:.2f} of numba ({x['ratio_of_fastest']:.2f} by the fastest)"
        for name, x in result["monodromy"]["like_with_like"].items()
    ]
    lines += [f"  left out: {kind}: {why}" for kind, why in result["monodromy"]["left_out"].items()]
    if "family" in result:
        x = result["family"]
        lines.append(
            f"  {x['points']} breathers: {x['fresh']['median']:.1f} s, "
            f"with the cache {x['with_cache']['median']:.1f} s"
        )
    return "\n".join([f"{result['monodromy']['title']} ({', '.join(PACKAGES)})", *lines])


if __name__ == "__main__":
    main()
