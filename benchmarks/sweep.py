"""What does a sweep cost beside the runs in it, and what do more workers bring? `python benchmarks/sweep.py`

Writes sweep.json and sweep.png beside this file. Dimers of 101 beads at mass ratios from 0.1 to 1, struck, to t = 400:

- time per bead, lane and force evaluation of `gx.sweep` over that of a batch of 64 through `gx.simulate`, which is run
  before and after it, and the peak of resident memory; each number of lanes in a process of its own, on all cores;
- the same chunks by two processes and by one, by two workers of a Dask cluster and by one, by turns, started and
  compiled before; chunks of 5 s or more. `overhead` is how much longer one worker is at it than its chunks take.
  Workers on cores that others use, too, gain less: `busy_loops` is what two loops of Python gain in the same rounds,
  and `processor` what a chunk's processor time becomes beside another chunk.

`--quick` is a smoke test that everything runs and agrees; it writes nothing.
"""

import argparse
import contextlib
import json
import multiprocessing
import os
import resource
import statistics
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache, partial
from pathlib import Path

import jax
import numpy as np
from machine import machine

import granjax as gx

HERE = Path(__file__).parent
BEADS = 101
TIME = 400.0
BATCH = 64
# points of a chunk of the sweeps
SIZE = 256
SWEPT = (512, 1024, 2048, 4096)
LOW = 0.1
HIGH = 1.0
# lanes of a chunk, 5 s or more, and chunks of a round
CHUNK = 1024
CHUNKS = 2


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few lanes; numbers mean nothing")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument(
        "--draw", action="store_true", help="only the chart, from the JSON that is there"
    )
    parser.add_argument(
        "--only",
        choices=("lanes", "workers"),
        help="one half; the other stays as it is in the JSON",
    )
    parser.add_argument("--lanes", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.lanes:
        print(json.dumps(cost(options.lanes, 4.0 if options.quick else TIME)))
        return
    if options.draw:
        drawn(json.loads((HERE / "sweep.json").read_text()))
        return
    halves = {"lanes": lambda: list(costs(options)), "workers": lambda: workers(options)}
    result = json.loads((HERE / "sweep.json").read_text()) if options.only else {}
    result.update(machine())
    for name in [options.only] if options.only else halves:
        result[f"load_at_{name}"] = os.getloadavg()
        result[name] = halves[name]()
    for row in result["lanes"]:
        print(
            "{lanes:5d} lanes  {seconds:7.1f} s  {nanoseconds:.2f} ns, small batch {batch:.2f}: {ratio:.2f}  "
            "{megabytes:.0f} MB".format(**row)
        )
    for name, row in result["workers"].items():
        free = max(row["busy_loops"])
        own = row["processor"]
        print(
            f"{name}: two workers {row['gain']:.2f} times one (two busy loops {free:.2f}), processor time of a chunk "
            f"{own:.2f} times one's, {row['overhead']:.1%} beside the chunks"
        )
    if not options.quick:
        (HERE / "sweep.json").write_text(json.dumps(result, indent=1) + "\n")
        drawn(result)


def pulse(ratio, t1):
    chain = gx.scenes.dimer(BEADS, ratio=ratio)
    run = gx.simulate(chain, gx.states.impact(chain), t1)
    return {
        "energy": gx.measures.site_energy(chain, run.final)[-1],
        "forces": run.stats["force_evaluations"],
    }


def costs(options):
    """A row for every number of lanes, from a process of its own."""
    for lanes in (16, 32) if options.quick else SWEPT:
        call = [sys.executable, __file__, "--lanes", str(lanes)] + ["--quick"] * options.quick
        done = subprocess.run(call, capture_output=True, text=True, check=True)
        yield json.loads(done.stdout.splitlines()[-1])


def cost(lanes, t1):
    """Seconds of processor time per bead, lane and force, of a sweep and of a small batch; peak memory."""
    ratios = np.linspace(LOW, HIGH, lanes)
    batch = jax.vmap(lambda x: gx.scenes.dimer(BEADS, ratio=x), out_axes=-1)(
        ratios[:: max(lanes // BATCH, 1)][:BATCH]
    )
    state = gx.states.impact(batch)
    function = partial(pulse, t1=t1)
    small = []

    def small_batch():
        begin = time.process_time()
        run = gx.simulate(batch, state, t1)
        forces = float(run.stats["force_evaluations"])
        small.append((time.process_time() - begin) / (BEADS * batch.lanes[0] * forces) * 1e9)

    small_batch()
    gx.sweep(
        function, {"ratio": ratios[:SIZE]}, progress=False, chunk=SIZE
    )  # compiles, as the batch before
    for _ in range(3):
        small_batch()
    begin = time.perf_counter()
    cpu = time.process_time()
    data = gx.sweep(function, {"ratio": ratios}, progress=False, chunk=SIZE)
    times = time.perf_counter() - begin, time.process_time() - cpu
    for _ in range(3):
        small_batch()
    own = times[1] / (BEADS * float(data.forces.sum())) * 1e9
    wanted = statistics.median(small[1:])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
        1e6 if sys.platform == "darwin" else 1e3
    )
    return {
        "lanes": lanes,
        "seconds": times[0],
        "processor_seconds": times[1],
        "nanoseconds": own,
        "batch": wanted,
        "ratio": own / wanted,
        "megabytes": peak,
    }


def busy(_):
    """A loop that needs nothing but a core: two at a time tell what cores others leave free."""
    sum(i * i for i in range(10_000_000))


def gain_of_busy(one, two):
    """Time of two busy loops one after the other over that of two at a time."""
    times = []
    for pool in (one, two):
        begin = time.perf_counter()
        list(pool.map(busy, range(2)))
        times.append(time.perf_counter() - begin)
    return times[0] / times[1]


def timed(ratio, copy, t1):
    """A pulse that is called by itself, with the seconds that pass and those of the processor."""
    begin = time.perf_counter()
    used = time.process_time()
    jax.block_until_ready(_lanes(t1)(np.linspace(LOW, HIGH, int(ratio))))
    return {"seconds": time.perf_counter() - begin, "processor": time.process_time() - used}


@lru_cache
def _lanes(t1):
    return jax.jit(jax.vmap(partial(pulse, t1=t1)))


def workers(options):
    """Two workers against one, of processes and of a cluster, by turns."""
    import distributed

    lanes, t1, rounds = (8, 4.0, 1) if options.quick else (CHUNK, TIME, options.rounds)
    # alike, so that no worker has more to do than another
    points = {"ratio": [float(lanes)], "copy": np.arange(float(CHUNKS))}
    function = partial(timed, t1=t1)
    context = multiprocessing.get_context("spawn")
    found = {}
    with contextlib.ExitStack() as stack:
        one, two = (stack.enter_context(ProcessPoolExecutor(n, context)) for n in (1, 2))
        local = {"threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": None}
        cluster = stack.enter_context(distributed.LocalCluster(2, **local))
        client = stack.enter_context(distributed.Client(cluster))
        first = client.get_executor(workers=[next(iter(client.nthreads()))])
        pairs = {"processes": (one, two), "cluster": (first, client.get_executor())}
        for executor in (one, two, first, client.get_executor()):  # starts, compiles
            walled(function, points, executor)
        turns = []
        free = []
        for _ in range(rounds):
            turns.append(
                {name: [walled(function, points, x) for x in pair] for name, pair in pairs.items()}
            )
            free.append(gain_of_busy(one, two))
    for name in pairs:
        own = [turn[name] for turn in turns]
        found[name] = {
            "gain": statistics.median(one[0] / two[0] for one, two in own),
            "gains": [o[0] / t[0] for o, t in own],
            "overhead": statistics.median(one[0] / one[1] - 1 for one, _ in own),
            "chunk_seconds": min(one[1] for one, _ in own) / CHUNKS,
            "busy_loops": free,
            # of a chunk beside another one, over that of one by itself: 1 where workers share nothing but the cores
            "processor": statistics.median(two[2] / one[2] for one, two in own),
        }
    return found


def walled(function, points, executor):
    """Seconds that pass, those that the chunks take, and those of the processor in them."""
    begin = time.perf_counter()
    data = gx.sweep(function, points, chunk=1, executor=executor, progress=False)
    return time.perf_counter() - begin, float(data.seconds.sum()), float(data.processor.sum())


def drawn(result):
    import matplotlib

    matplotlib.use("Agg")
    with gx.plots.style():
        import matplotlib.pyplot as plt

        figure, axes = plt.subplots(1, 3, figsize=(10, 3.2), layout="constrained")
        rows = result["lanes"]
        few = result["workers"]
        lanes = [row["lanes"] for row in rows]
        axes[0].plot(lanes, [row["nanoseconds"] for row in rows], "o-", label="sweep, all cores")
        axes[0].plot(
            lanes, [row["batch"] for row in rows], "s--", label=f"batch of {BATCH}, one core"
        )
        axes[0].set_ylabel("processor time [ns]")
        axes[0].set_title("per bead, lane and force")
        axes[1].plot(lanes, [row["megabytes"] for row in rows], "o-")
        axes[1].set_ylabel("resident memory [MB]")
        axes[1].set_title("peak of the process")
        for ax in axes[:2]:
            ax.set_xscale("log", base=2)
            ax.set_xticks(lanes, [str(n) for n in lanes])
            ax.set_xlabel("lanes")
            ax.set_ylim(0, 1.15 * ax.get_ylim()[1])
        axes[0].legend(loc="lower right")
        for k, row in enumerate(few.values()):
            axes[2].plot([k] * len(row["gains"]), row["gains"], "o", color="C0")
        free = few["processes"]["busy_loops"]
        axes[2].plot([len(few)] * len(free), free, "s", color="0.5")
        for k, row in enumerate(few.values()):
            axes[2].text(
                k,
                0.15,
                f"{max(row['overhead'], 0):.1%} beside\nchunks of {row['chunk_seconds']:.0f} s",
                ha="center",
                fontsize=8,
            )
        axes[2].axhline(2.0, color="0.7", linewidth=1)
        axes[2].set_xticks(range(len(few) + 1), [*few, "busy loops"])
        axes[2].set_xlim(-0.6, len(few) + 0.4)
        axes[2].set_ylim(0, 2.4)
        axes[2].set_ylabel("time of one / time of two")
        axes[2].set_title("two workers, every round")
        figure.savefig(HERE / "sweep.png", dpi=150)


if __name__ == "__main__":
    main()
