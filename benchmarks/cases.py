"""What `speed.py` measures, one function a case; each runs in a process of its own.

Calls alternate (A B C A B C ...), so that a drift of the machine's clock cancels in the ratios. `wall` is elapsed time
and `cpu` the processor time of the process; they agree on a quiet machine.
"""

import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import peers

import granjax as gx
from granjax.solvers import tables

STEP = 0.1
AMPLITUDE = 0.1
CHECKED_STEPS = 200
LANES = 256
BEADS = 60
TABLE = tables.splitting("SRKN11b")


def alternate(calls, rounds):
    """Median wall and processor time of each call [s], and ratios to the last one, round by round."""
    for call in calls.values():
        call()
    wall = {name: [] for name in calls}
    cpu = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            start = time.perf_counter()
            spent = time.process_time()
            call()
            wall[name].append(time.perf_counter() - start)
            cpu[name].append(time.process_time() - spent)
    last = list(calls)[-1]
    return {
        name: {
            "wall": float(np.median(wall[name])),
            "cpu": float(np.median(cpu[name])),
            "ratio": float(np.median(np.divide(wall[name], wall[last]))),
            "cpu_ratio": float(np.median(np.divide(cpu[name], cpu[last]))),
        }
        for name in calls
    }


def run(lattice, state, steps, step=STEP):
    """`gx.simulate`, complete: it reads the outcome, so that it returns when the run has ended."""
    return jax.block_until_ready(
        gx.simulate(lattice, state, steps * step, solver=gx.SRKN11b(), step=step)
    )


@jax.jit
def _bare(lattice, state, t1, step):
    return diffrax.diffeqsolve(
        diffrax.ODETerm(gx.vector_field),
        gx.SRKN11b(),
        0.0,
        t1,
        step,
        state,
        args=lattice,
        max_steps=None,
        adjoint=diffrax.ForwardMode(),
    ).ys


def _start(shape, dtype=float):
    u = np.random.default_rng(0).uniform(-AMPLITUDE, AMPLITUDE, shape).astype(dtype)
    return u, gx.State(jnp.asarray(u), jnp.zeros_like(u))


def _compared(
    lattice,
    state,
    steps,
    rounds,
    peer,
    evaluations,
    arrange=lambda x: x,
    step=STEP,
    checked=CHECKED_STEPS,
):
    """granjax through `simulate` and through diffrax alone, against `peer(steps)`, which returns its final u."""
    end = run(lattice, state, checked, step)
    if end.final.u.dtype != state.u.dtype:
        raise TypeError(f"a run in {state.u.dtype} ended in {end.final.u.dtype}")
    difference = np.abs(np.asarray(end.final.u) - arrange(peer(checked))).max()
    t1 = steps * step
    times = alternate(
        {
            "simulate": lambda: run(lattice, state, steps, step),
            "diffeqsolve": lambda: jax.block_until_ready(_bare(lattice, state, t1, step)),
            "numba": lambda: peer(steps),
        },
        rounds,
    )
    ns = {name: 1e9 * x["wall"] / (steps * evaluations) for name, x in times.items()}
    cpu_ns = {name: 1e9 * x["cpu"] / (steps * evaluations) for name, x in times.items()}
    return {
        "ratio": times["simulate"]["ratio"],
        "cpu_ratio": times["simulate"]["cpu_ratio"],
        "without_record": times["diffeqsolve"]["ratio"],
        "without_record_cpu": times["diffeqsolve"]["cpu_ratio"],
        "ns_per_bead_force": ns,
        "cpu_ns_per_bead_force": cpu_ns,
        "seconds": times["numba"]["wall"],
        "steps": steps,
        "steps_taken": int(run(lattice, state, steps, step).stats["steps"]),
        "difference": float(difference),
        "checked_steps": checked,
        "busy": times["numba"]["wall"] / times["numba"]["cpu"],
    }


def chain(rounds, sites, steps, dtype=float, exponent=1.5, traced=False):
    """One precompressed chain, A = m = d0 = 1, rigid walls, displacements uniform in +-0.1; p `traced` is an array."""
    u, state = _start(sites, dtype)
    p = jnp.asarray(exponent) if traced else exponent
    lattice = gx.scenes.monomer(sites, exponent=p, precompression=1.0).astype(dtype)
    one = np.dtype(dtype).type(1)
    loop = peers.hertz if exponent == 1.5 else peers.power
    a = TABLE.a.astype(dtype)
    b = TABLE.b.astype(dtype)

    def peer(steps):
        end = u.copy()
        v = np.zeros_like(u)
        loop(end, v, steps, one * STEP, one, one, one, one * exponent, one, a, b)
        return end

    return _compared(lattice, state, steps, rounds, peer, sites * 11)


def shock(rounds, sites, steps, step=0.5, c=0.1):
    """A velocity shock in a precompressed chain, A = m = d0 = 1, free ends."""
    lattice, state = gx.shocks.velocity_shock(
        gx.scenes.monomer(sites, precompression=1.0, boundary="free"), c
    )
    one = np.float64(1)
    start = np.asarray(state.v)

    def peer(steps):
        u = np.zeros(sites)
        v = start.copy()
        peers.hertz_free(u, v, steps, step, one, one, one, 1.5, one, TABLE.a, TABLE.b)
        return u

    return _compared(lattice, state, steps, rounds, peer, sites * 11, step=step)


def packing(rounds, name, cells, steps, step=0.2, d0=0.0, checked=30):
    """Beads of diameter 10 in the plane, A = m = 1, in a square or triangular packing within beads at rest."""
    vectors = {
        "square": [(1, 0), (0, 1)],
        "triangular": [(1, 0), (0.5, 0.75**0.5), (-0.5, 0.75**0.5)],
    }[name]
    offsets = np.array([(1, 0), (0, 1), (-1, 1)][: len(vectors)])
    lattice = getattr(gx.scenes, name)(*cells, exponent=1.5, precompression=d0**1.5, spacing=10.0)
    u, state = _start((*cells, 2))
    # the peer's first axis advances
    offsets = np.where(offsets[:, :1] < 0, -offsets, offsets)
    spans = np.array(vectors) * 10.0
    spans[len(spans) - 1] *= -1 if name == "triangular" else 1

    def peer(steps):
        end = u.copy()
        v = np.zeros_like(u)
        peers.packing(end, v, steps, step, 1.0, d0, offsets, spans, TABLE.a, TABLE.b)
        return end

    return _compared(
        lattice, state, steps, rounds, peer, cells[0] * cells[1] * 11, step=step, checked=checked
    )


def lengths(rounds, lengths, steps):
    """The mean over chains of several lengths: one past a whole number of vectors is the worst."""
    found = [chain(rounds, sites, steps) for sites in lengths]
    mean = {
        key: float(np.mean([x[key] for x in found]))
        for key in ("ratio", "cpu_ratio", "without_record")
    }
    worst = {key: max(x[key] for x in found) for key in ("difference", "busy")}
    return {**mean, **worst, "ratios": {n: x["ratio"] for n, x in zip(lengths, found)}}


def single(rounds, sites, steps):
    """The chain in float32, against a float32 loop."""
    return chain(rounds, sites, steps, np.float32)


def precisions(rounds, sites, steps):
    """A run in float32 over the same run in float64."""
    chains = {
        dtype: gx.scenes.monomer(sites, precompression=1.0).astype(dtype)
        for dtype in ("float32", "float64")
    }
    states = {dtype: _start(sites, dtype)[1] for dtype in chains}
    times = alternate(
        {dtype: lambda d=dtype: run(chains[d], states[d], steps) for dtype in chains}, rounds
    )
    return {"ratio": times["float32"]["ratio"], "cpu_ratio": times["float32"]["cpu_ratio"]}


def _dimers(lanes):
    """The dimers of a slice of the lanes."""
    ratios = jnp.linspace(0.2, 1.0, LANES)[lanes]
    return jax.vmap(lambda r: gx.scenes.dimer(BEADS, ratio=r, precompression=1.0), out_axes=-1)(
        ratios
    )


def batch(rounds, steps):
    """Dimers of 60 beads with mass ratios 0.2 ... 1 as lanes, against one chain after the other."""
    u, state = _start((BEADS, LANES))
    lattice = _dimers(slice(None))
    us = np.ascontiguousarray(u.T)
    inverse = np.ascontiguousarray(1 / np.asarray(lattice.mass).T)

    def peer(steps):
        end = us.copy()
        peers.hertz_batch(
            end, np.zeros_like(us), steps, STEP, 1.0, 1.0, 1.0, inverse, TABLE.a, TABLE.b
        )
        return end

    return _compared(lattice, state, steps, rounds, peer, u.size * 11, np.transpose)


def lanes_apart(rounds, lanes, beads, end, tolerance=1e-8):
    """An adaptive run of dimers as lanes, against a Python loop of single calls."""
    scene = lambda r: gx.scenes.dimer(beads, ratio=r, precompression=1.0)
    ratios = np.linspace(0.2, 1.0, lanes)
    lattice = jax.vmap(scene, out_axes=-1)(jnp.asarray(ratios))
    singles = [scene(jnp.asarray(r)) for r in ratios]
    states = [gx.states.impact(x, velocity=0.1) for x in (lattice, *singles)]

    def all_lanes():
        return np.asarray(gx.simulate(lattice, states[0], end, tolerance=tolerance).final.u)

    def loop():
        runs = [gx.simulate(x, y, end, tolerance=tolerance) for x, y in zip(singles, states[1:])]
        return np.stack([np.asarray(x.final.u) for x in runs], axis=-1)

    difference = np.abs(all_lanes() - loop()).max()
    times = alternate({"lanes": all_lanes, "loop": loop}, rounds)
    return {
        "ratio": times["lanes"]["ratio"],
        "cpu_ratio": times["lanes"]["cpu_ratio"],
        "difference": float(difference),
        "seconds": {name: x["wall"] for name, x in times.items()},
        "busy": times["loop"]["wall"] / times["loop"]["cpu"],
    }


def two_devices(rounds, steps):
    """The batch on one JAX device of the CPU, and in two chunks of lanes on two devices, one thread each.

    `cpu_ratio`: what two free cores would give, from the processor time that both ways take.
    """
    u, _ = _start((BEADS, LANES))
    first, second = jax.devices("cpu")[:2]
    halves = [slice(0, LANES // 2), slice(LANES // 2, LANES)]
    places = [(slice(0, LANES), first), (halves[0], first), (halves[1], second)]
    work = [
        (jax.device_put((_dimers(s), gx.State(u[:, s], np.zeros_like(u[:, s]))), d), d)
        for s, d in places
    ]

    def one(item):
        (lattice, state), device = item
        with jax.default_device(device):
            return run(lattice, gx.State(*state), steps).final.u

    # without the flags XLA shares one device's work among all cores: one core is one only where every thread is held
    cores = sorted(os.sched_getaffinity(0))[:2]

    def alone():
        hold(cores[:1])
        return one(work[0])

    ran = []
    waited = []

    def together():
        hold(cores)
        before = scheduled()
        ends = list(pool.map(one, work[1:]))
        after = scheduled()
        ran.append(after[0] - before[0])
        waited.append(after[1] - before[1])
        return ends

    with ThreadPoolExecutor(2) as pool:
        both = np.concatenate([np.asarray(x) for x in pool.map(one, work[1:])], axis=1)
        difference = np.abs(both - np.asarray(one(work[0]))).max()
        times = alternate({"one": alone, "two": together}, rounds)
    return {
        "ratio": times["one"]["ratio"],
        "cpu_ratio": 2 * times["one"]["cpu"] / times["two"]["cpu"],
        "seconds": {name: x["wall"] for name, x in times.items()},
        "cores_used": {name: x["cpu"] / x["wall"] for name, x in times.items()},
        "difference": float(difference),
        # threads that wait for one another sleep; only those that lack a core count as waiting
        "busy": max(
            times["one"]["wall"] / times["one"]["cpu"],
            1 + float(np.median(waited) / np.median(ran)),
        ),
    }


def overhead(rounds, options, calls=50, further=1000):
    """Microseconds that one `simulate` of a 4-bead chain takes beyond its steps.

    The steps' own time is the slope between a short run and one that is `further` times longer.
    """
    _, state = _start(4)
    lattice = gx.scenes.monomer(4, precompression=1.0)

    def repeated(t1, calls):
        return lambda: [
            jax.block_until_ready(gx.simulate(lattice, state, t1, **options)) for _ in range(calls)
        ]

    times = alternate({"long": repeated(further * STEP, 1), "short": repeated(STEP, calls)}, rounds)
    beyond = {}
    for clock in ("wall", "cpu"):
        short = times["short"][clock] / calls
        long = times["long"][clock]
        beyond[clock] = 1e6 * (short - (long - short) / (further - 1))
    return {
        "ratio": beyond["wall"],
        "cpu_ratio": beyond["cpu"],
        "call": 1e6 * times["short"]["wall"] / calls,
    }


def scheduled():
    """Seconds that the threads of this process have run, and waited for a core while ready to run."""
    times = [
        Path(f"/proc/self/task/{thread}/schedstat") for thread in os.listdir("/proc/self/task")
    ]
    return np.sum([[int(x) for x in path.read_text().split()[:2]] for path in times], axis=0) * 1e-9


def hold(cores):
    """Keep every thread of this process on these cores."""
    for thread in os.listdir("/proc/self/task"):
        os.sched_setaffinity(int(thread), cores)
