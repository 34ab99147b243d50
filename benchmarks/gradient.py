"""What does a gradient of a run cost, in time and in memory? `python benchmarks/gradient.py`

Writes gradient.json and gradient.png beside this file. A precompressed chain of 100 beads and a sonic vacuum of 20; the
loss reads the last state, the parameters are one stiffness, or a mass for each bead and a stiffness for each contact.
Time is the median over rounds of gradient (with value) over run, by turns; memory is what the compiled program needs
beside its input and output. And how long `gx.fit` takes: 20 beads, 4 sensors, 4 parameters. `--quick` is a smoke test
that everything runs and agrees; it writes nothing.
"""

import argparse
import json
import os
import statistics
import time
from pathlib import Path

if hasattr(os, "sched_setaffinity"):
    cores = os.sched_getaffinity(0)
    # before JAX starts, so that its pools have one thread
    os.sched_setaffinity(0, {min(cores)})

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from machine import machine

import granjax as gx

HERE = Path(__file__).parent
ADJOINTS = {
    "Reversible": gx.Reversible(),
    "RecursiveCheckpointAdjoint": diffrax.RecursiveCheckpointAdjoint(),
    "default": None,
}
FORWARD = diffrax.ForwardMode()
STEPS = (100, 1000, 10_000, 100_000)
# steps above which a way that is not the subject takes too long
MOST = {"RecursiveCheckpointAdjoint": 10_000, "default": 10_000}
ONE = "one stiffness"
MANY = "every mass and stiffness"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few steps; numbers mean nothing")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument(
        "--draw", action="store_true", help="only the chart, from the JSON that is there"
    )
    options = parser.parse_args()
    if options.draw:
        drawn(json.loads((HERE / "gradient.json").read_text()))
        return
    steps = STEPS[:2] if options.quick else STEPS
    scenes = {"precompressed": precompressed, "sonic vacuum": vacuum}
    rows = [
        row
        for name, scene in scenes.items()
        for n in steps
        for row in costs(name, scene, n, options)
    ]
    result = {**machine(), "load": os.getloadavg(), "rows": rows, "fit": fitted(options)}
    for row in rows:
        print(
            "{scene:14s}{parameters:26s}{adjoint:28s}{steps:7d} steps  {ratio:6.2f} runs  {bytes:9d} bytes  "
            "{}".format(row["disagreement"], **row)
        )
    print(f"a fit after compilation: {result['fit']['seconds']:.2f} s")
    if not options.quick:
        (HERE / "gradient.json").write_text(json.dumps(result, indent=1) + "\n")
        drawn(result)


def precompressed(p):
    chain = gx.scenes.monomer(100, mass=p["mass"], stiffness=p["stiffness"], precompression=1.0)
    return chain, gx.states.impact(chain, 0.3), 0.15


def vacuum(p):
    chain = gx.scenes.monomer(20, mass=p["mass"], stiffness=p["stiffness"])
    return chain, gx.states.impact(chain, 1.0), 0.1


def parameters(scene, kind):
    beads = {precompressed: 100, vacuum: 20}[scene]
    if kind == ONE:
        return {"stiffness": 1.0}, {"mass": 1.0}
    return {"mass": np.ones(beads), "stiffness": np.ones(beads + 1)}, {}


def loss(scene, n, fixed):
    def f(free, adjoint):
        chain, state, step = scene({**fixed, **free})
        run = gx.simulate(chain, state, n * step, step=step, adjoint=adjoint, throw=False)
        return jnp.sum(run.final.u**2) + jnp.sum(run.final.v[::2])

    return f


def costs(name, scene, n, options):
    """One row for every kind of parameters and every adjoint that lasts."""
    for kind in (ONE, MANY):
        free, fixed = parameters(scene, kind)
        f = loss(scene, n, fixed)
        run = jax.jit(lambda free: f(free, FORWARD))
        # no uniform change, under which masses and stiffnesses would make up for each other
        way = {
            key: x * (1 + 0.5 * np.sin(np.arange(np.size(x)).reshape(np.shape(x))))
            for key, x in free.items()
        }
        wanted = float(
            jax.jit(lambda free: jax.jvp(lambda x: f(x, FORWARD), (free,), (way,))[1])(free)
        )
        for label, adjoint in ADJOINTS.items():
            if n > MOST.get(label, n) or (kind == MANY and label != "Reversible"):
                continue
            gradient = jax.jit(lambda free, adjoint: jax.value_and_grad(f)(free, adjoint))
            used = gradient.lower(free, adjoint).compile().memory_analysis().temp_size_in_bytes
            found = gradient(free, adjoint)[1]
            got = sum(float(jnp.sum(found[k] * way[k])) for k in free)
            yield {
                "scene": name,
                "parameters": kind,
                "adjoint": label,
                "steps": n,
                "bytes": int(used),
                "ratio": ratio(lambda: gradient(free, adjoint), lambda: run(free), options.repeats),
                "disagreement": abs(got / wanted - 1) if np.isfinite(got) else None,
            }


def ratio(first, second, repeats):
    """Median over rounds of the time of one call over that of another, by turns."""

    def timed(call):
        start = time.perf_counter()
        jax.block_until_ready(call())
        return time.perf_counter() - start

    timed(first), timed(second)
    return statistics.median(timed(first) / timed(second) for _ in range(repeats))


def fitted(options):
    """Seconds of a fit with 4 parameters to 1600 samples, after the first."""

    def scene(p):
        law = gx.PowerLaw(p["stiffness"], p["exponent"], p["precompression"])
        return gx.Lattice(
            1.0, (gx.Bond(gx.Shift(1, "fixed"), law), gx.Damping(p["damping"])), sites=20
        )

    truth = {"stiffness": 1.0, "exponent": jnp.asarray(1.5), "damping": 0.05, "precompression": 1.0}
    start = {"stiffness": 1.15, "exponent": 1.4, "damping": 0.03, "precompression": 0.85}
    state = gx.states.impact(scene(truth), 1.0)
    times = np.linspace(0.1, 40.0, 400)
    clean = np.asarray(
        gx.simulate(
            scene(truth), state, 40.0, save_at=times, tolerance=1e-10, solver=diffrax.Dopri8()
        ).vs
    )[:, [2, 7, 12, 17]]
    seconds = []
    for seed in range(2 if options.quick else 10):
        data = clean + 0.005 * np.random.default_rng(seed).normal(size=clean.shape)
        begin = time.perf_counter()
        gx.fit(
            scene,
            start,
            gx.Traces(times, velocity=data, sites=[2, 7, 12, 17], sigma=0.005),
            state=state,
        )
        seconds.append(time.perf_counter() - begin)
    return {
        "first": seconds[0],
        "seconds": statistics.median(seconds[1:]),
        "longest": max(seconds[1:]),
    }


def drawn(result):
    import matplotlib

    matplotlib.use("Agg")
    with gx.plots.style():
        import matplotlib.pyplot as plt

        figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
        for ax, key, label in zip(
            axes, ("bytes", "ratio"), ("memory [bytes]", "time / time of the run")
        ):
            kinds = sorted({(r["scene"], r["parameters"], r["adjoint"]) for r in result["rows"]})
            for scene, parameters, adjoint in kinds:
                own = [
                    r
                    for r in result["rows"]
                    if (r["scene"], r["parameters"], r["adjoint"]) == (scene, parameters, adjoint)
                ]
                if scene == "sonic vacuum" and (adjoint == "Reversible" or parameters == MANY):
                    continue
                many = ", every mass and stiffness" if parameters == MANY else ""
                ax.plot(
                    [r["steps"] for r in own],
                    [r[key] for r in own],
                    "o-" if scene == "precompressed" else "s--",
                    label=f"{scene}, {adjoint}{many}",
                )
            ax.set_xscale("log")
            ax.set_xlabel("steps")
            ax.set_ylabel(label)
        axes[0].set_yscale("log")
        axes[1].set_ylim(0)
        axes[1].legend(fontsize=6.5, loc="lower right")
        figure.savefig(HERE / "gradient.png", dpi=150)


if __name__ == "__main__":
    main()
