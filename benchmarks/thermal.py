"""Thermal chains beside numba loops and diffrax's Langevin solvers. `python benchmarks/thermal.py [--quick]`

- An ensemble of beta-FPUT chains as lanes, and all tangents of one chain, as for its whole Lyapunov spectrum, each over
  the time of a fused numba loop of the same splitting.
- beta-FPUT chains between free ends, every site in a heat bath, from a Gibbs state: how far the mean squares of
  strains and velocities are from those of quadrature, against time, beside diffrax's ALIGN, ShARK and QUICSORT.

Writes thermal.json and thermal.png beside this file; `--quick` is a smoke test that everything runs and agrees, and
writes nothing unless `--out` names a folder. Needs `pip install granjax[bench]`.
"""

import argparse
import json
import os
import statistics
import time
from pathlib import Path

if hasattr(os, "sched_setaffinity"):
    # before JAX starts, so that its pools have one thread
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import diffrax
import jax
import jax.numpy as jnp
import numba
import numpy as np
from machine import machine
from peers.tangents import STAGES, WIDTH, follow, stages

import granjax as gx
from granjax.plots.style import figure, save, style

HERE = Path(__file__).parent
METHODS = ("SRKN11b", "SRKN14a", "ABA864")
LANES = 1024
SITES = 128
TANGENTS_AT = 64
STEP = 0.1
STEPS = 400
# relative to the largest entry
AGREEMENT = 1e-9
# of the chains in baths
BATHED = 256
COPIES = 32
TEMPERATURE = 1.0
RATE = 1.0
END = 1000.0
EVERY = 2.0
LADDER = (0.5, 1 / 3, 0.25, 1 / 6, 0.125, 1 / 12, 1 / 16)
SOLVERS = ("VelocityVerlet", "SRKN6b", "SRKN11b")
PEERS = ("ALIGN", "ShARK", "QUICSORT")
LAW = gx.Polynomial(1.0, 0.0, 1.0)


@numba.njit(fastmath=True)
def _forces(u, f, K):
    """Forces and stiffnesses of the bonds, those to the walls among them."""
    N = u.size
    for i in range(1, N):
        e = u[i - 1] - u[i]
        f[i], K[i] = e * (1 + e * e), 1 + 3 * e * e
    for i, e in ((0, -u[0]), (N, u[N - 1])):
        f[i], K[i] = e * (1 + e * e), 1 + 3 * e * e


@numba.njit(fastmath=True)
def _ensemble(us, vs, drift, kick):
    """Chains one after the other, each in the nearest cache; (chains, sites), in place."""
    for m in range(len(us)):
        u = us[m]
        v = vs[m]
        N = u.size
        f = np.zeros(N + 1)
        for j in range(kick.size):
            f[0] = -u[0] * (1 + u[0] * u[0])
            for i in range(1, N):
                e = u[i - 1] - u[i]
                f[i] = e * (1 + e * e)
            f[N] = u[N - 1] * (1 + u[N - 1] * u[N - 1])
            # a kick, and the drift that follows it
            after = drift[j + 1] if j + 1 < kick.size else 0.0
            for i in range(N):
                w = v[i] + kick[j] * (f[i] - f[i + 1])
                v[i] = w
                u[i] += after * w


@numba.njit(fastmath=True)
def _tangents(u, v, rows, drift, kick):
    """The state through some stages, then the tangents through them, `WIDTH` at a time, as in `peers.tangents`."""
    N = u.size
    f = np.zeros(N + 1)
    K = np.zeros((STAGES, N + 1))
    inverse_mass = np.ones(N)
    for start in range(0, kick.size, STAGES):
        a = drift[start : start + STAGES]
        b = kick[start : start + STAGES]
        for j in range(b.size):
            for i in range(N):
                u[i] += a[j] * v[i]
            _forces(u, f, K[j])
            for i in range(N):
                v[i] += b[j] * (f[i] - f[i + 1])
        for block in range(rows.shape[0]):
            follow(rows[block].reshape(-1), K, inverse_mass, a, b)


def ensemble(name, steps, lanes):
    """{who: a call that returns the last displacements}."""
    draw = np.random.default_rng(0)
    u = 0.3 * draw.normal(size=(lanes, SITES))
    v = draw.normal(size=(lanes, SITES))
    make = lambda stiffness: gx.scenes.fput(SITES, 0.0, 1.0, stiffness=stiffness)
    chains = jax.vmap(make, out_axes=-1)(jnp.ones(lanes))
    start = gx.State(jnp.asarray(u.T), jnp.asarray(v.T))
    solver = getattr(gx, name)()
    table = stages(name, STEP, steps)

    def own():
        run = gx.simulate(chains, start, steps * STEP, step=STEP, solver=solver)
        return np.asarray(run.final.u)

    def loop():
        us = u.copy()
        vs = v.copy()
        _ensemble(us, vs, *table)
        return us.T

    return {"granjax": own, "numba": loop}


def tangents(name, steps):
    """{who: a call that returns all tangents of one chain at the end}."""
    N = TANGENTS_AT
    draw = np.random.default_rng(0)
    u, v = draw.normal(0, 0.3, (2, N))
    Q = np.linalg.qr(draw.normal(size=(2 * N, 2 * N)))[0]
    chain = gx.scenes.fput(N, 0.0, 1.0)
    flow = gx.Flow(steps, getattr(gx, name)())
    y = gx.State(jnp.asarray(u), jnp.asarray(v))
    columns = gx.State(jnp.asarray(Q[:N]), jnp.asarray(Q[N:]))
    go = jax.jit(lambda y, columns: flow.tangents(y, columns, 0.0, steps * STEP, chain)[1])
    table = stages(name, STEP, steps)

    def own():
        return np.concatenate(jax.block_until_ready(go(y, columns)))

    def loop():
        blocks = -(-2 * N // WIDTH)
        filled = np.zeros((2 * N, blocks * WIDTH))
        filled[:, : 2 * N] = Q
        rows = np.zeros((blocks, N + 2, 2, WIDTH))
        rows[:, 1:-1] = filled.reshape(2, N, blocks, WIDTH).transpose(2, 1, 0, 3)
        _tangents(u.copy(), v.copy(), rows, *table)
        return rows[:, 1:-1].transpose(2, 1, 0, 3).reshape(2 * N, -1)[:, : 2 * N]

    return {"granjax": own, "numba": loop}


def compared(calls, repeats):
    """How far both answers are apart, seconds of each (medians of rounds in turn), and the median ratio."""
    first = {who: call() for who, call in calls.items()}
    own, other = first.values()
    apart = float(np.abs(own - other).max() / np.abs(other).max())
    if not apart < AGREEMENT:
        raise SystemExit(f"The answers differ by {apart:.1g}.")
    times = {who: [] for who in calls}
    for _ in range(repeats):
        for who, call in calls.items():
            since = time.perf_counter()
            call()
            times[who].append(time.perf_counter() - since)
    ratio = statistics.median(a / b for a, b in zip(*times.values()))
    return {
        "apart": apart,
        **{who: statistics.median(x) for who, x in times.items()},
        "ratio": ratio,
    }


def baths(copies, end):
    """{method: a call of the step that returns the saved displacements and velocities}, and the start's lattice."""
    bond = gx.Bond(gx.Shift(1, "free"), LAW)
    bath = gx.Langevin(RATE, TEMPERATURE, seed=1)
    lanes = lambda *terms: jax.vmap(
        lambda mass: gx.Lattice(mass, (bond, *terms), sites=BATHED), out_axes=-1
    )(jnp.ones(copies))
    alone = lanes()
    bathed = lanes(bath)
    frames = round(end / EVERY) + 1
    start = gx.states.gibbs(alone, TEMPERATURE, seed=3)

    def own(name):
        solver = getattr(gx, name)()

        def call(step):
            run = gx.simulate(bathed, start, end, step=step, solver=solver, save_at=frames)
            return run.us, run.vs

        return call

    def peer(name):
        # of the series for small steps, as diffrax's examples have it
        solver = getattr(diffrax, name)(0.1)
        still = jnp.zeros((BATHED, copies))
        field = lambda x, args: -alone.force(0.0, x, still) / TEMPERATURE
        gamma = jnp.asarray(RATE)
        scale = jnp.asarray(TEMPERATURE)
        shape = jax.ShapeDtypeStruct(still.shape, still.dtype)

        @jax.jit
        def call(step):
            noise = diffrax.UnsafeBrownianPath(
                shape, jax.random.key(0), diffrax.SpaceTimeTimeLevyArea
            )
            terms = diffrax.MultiTerm(
                diffrax.UnderdampedLangevinDriftTerm(gamma, scale, field),
                diffrax.UnderdampedLangevinDiffusionTerm(gamma, scale, noise),
            )
            return diffrax.diffeqsolve(
                terms,
                solver,
                0.0,
                end,
                step,
                tuple(start),
                saveat=diffrax.SaveAt(ts=jnp.linspace(0.0, end, frames)),
                max_steps=None,
                adjoint=diffrax.ForwardMode(),
            ).ys

        return call

    return {x: own(x) for x in SOLVERS} | {f"diffrax {x}": peer(x) for x in PEERS}


def moments(us, vs, known):
    """(relative error, standard error over the chains) of <e^2> and of <v^2>, without the first tenth."""
    left = len(us) // 10
    e2 = np.asarray((us[left:, 1:] - us[left:, :-1]) ** 2).mean((0, 1))
    v2 = np.asarray(vs[left:] ** 2).mean((0, 1))
    found = {}
    for name, x, want in (
        ("strain", e2, float(known.strain_variance)),
        ("velocity", v2, TEMPERATURE),
    ):
        error = x.std(ddof=1) / len(x) ** 0.5
        found[name] = {"off": float(x.mean() / want - 1), "error": float(error / want)}
    return found


def measured_baths(quick, repeats):
    known = gx.theory.thermal.bond_state(LAW, TEMPERATURE)
    points, copies, end = {}, *((4, 20.0) if quick else (COPIES, END))
    for name, call in baths(copies, end).items():
        points[name] = []
        for step in LADDER[-1:] if quick else LADDER:
            try:
                found = moments(*jax.block_until_ready(call(step)), known)
            except RuntimeError:
                continue
            if not np.isfinite(found["strain"]["off"]):
                continue
            times = []
            for _ in range(repeats):
                since = time.perf_counter()
                jax.block_until_ready(call(step))
                times.append(time.perf_counter() - since)
            points[name].append({"step": step, "seconds": statistics.median(times), **found})
    return points


def drawn(points, path):
    """The error of either mean square against time; what is within two standard errors has a bar down."""
    with style():
        made = figure(7.2, 3.4)
        axes = made.subplots(1, 2, sharey=True)
        for ax, moment in zip(axes, ("strain", "velocity")):
            for i, (name, row) in enumerate(points.items()):
                seconds = [p["seconds"] for p in row]
                off = [abs(p[moment]["off"]) for p in row]
                error = [2 * p[moment]["error"] for p in row]
                line = "--" if name.startswith("diffrax") else "-"
                ax.errorbar(
                    seconds, off, error, fmt=line, marker=".", color=f"C{i}", label=name, lw=1
                )
            ax.set(xscale="log", yscale="log", ylim=(1e-4, 0.3), xlabel="time of the run (s)")
            ax.set_xticks([0.3, 1, 3, 10], ["0.3", "1", "3", "10"])
            ax.minorticks_off()
            ax.set_title(f"mean square {moment}")
        axes[0].set_ylabel("relative error, two standard errors")
        made.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
    save(made, path)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="short runs, nothing written")
    parser.add_argument("--out", type=Path, help="folder for thermal.json and the chart")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    folder = options.out or (None if options.quick else HERE)
    steps, lanes = (4, 16) if options.quick else (STEPS, LANES)
    repeats = 1 if options.quick else options.repeats
    result = {"load": os.getloadavg()}
    for name in METHODS:
        result[name] = {
            "ensemble": compared(ensemble(name, steps, lanes), repeats),
            "tangents": compared(tangents(name, steps), repeats),
        }
        print(
            name, {kind: round(row["ratio"], 2) for kind, row in result[name].items()}, flush=True
        )
    result["baths"] = measured_baths(options.quick, min(repeats, 3))
    for name, row in result["baths"].items():
        for p in row:
            told = [f"{p[x]['off']:+.1e} +- {p[x]['error']:.0e}" for x in ("strain", "velocity")]
            print(f"{name}: step {p['step']:.3g}, {p['seconds']:.3g} s", *told)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "thermal.json").write_text(json.dumps({**machine(), **result}, indent=1) + "\n")
        drawn(result["baths"], folder / "thermal.png")


if __name__ == "__main__":
    main()
