"""Makes the references of the canonical scenes: `python benchmarks/make_references.py [--only NAME] [--out DIR]`.

Masses, states and times come from the scenes, the forces from `equations`, the numbers from `integrators`: collocation
gives the reference, extrapolation the check. It takes minutes a scene and needs 80-bit numbers (Linux on x86-64).
"""

import argparse
import datetime
import logging
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from references import equations
from references.integrators import EXTENDED, collocation, extrapolation
from references.starts import soliton, starts
from scenes import DATA, RECIPES, SHOCK, Stored, measure, names

REFERENCE = 1e-19
CHECK = 3e-18
NOISE = 1e-12
# what rounding to float64 alone may do to a number
ROUNDED = 2.0**-53
SEED = 2
# sites ahead of the fastest front of the shock
MARGIN = 40
FRONT = 1.3152
BLOCK = 32
METHOD = (
    f"collocation at 16 Gauss points, tolerance {REFERENCE:g}; checked by extrapolated midpoint rule of order 16, "
    f"tolerance {CHECK:g}; both in 80-bit numbers"
)

# of many lanes these are made both ways
MANY = 64
EVERY = 17
SAMPLED = f"all lanes by the second, every {EVERY}th also by the first"

log = logging.getLogger(__name__)


class Problem(NamedTuple):
    """An equation and where it starts. `together`: lanes share their steps; `scale`: of the numbers, for rounding."""

    equation: object
    u: np.ndarray
    v: np.ndarray
    together: bool = False
    scale: float = 1.0

    def run(self, method, t1, tolerance):
        """(u, v) at t1, from 0; many lanes in blocks that fit the cache."""
        lanes = np.arange(self.u.shape[-1])
        if self.together or len(lanes) <= BLOCK:
            return method(
                self.equation, 0, t1, self.u, self.v, self.scale * tolerance, together=self.together
            )
        blocks = [
            Problem(self.equation.of_lanes(b), self.u[:, b], self.v[:, b], scale=self.scale)
            for b in np.split(lanes, range(BLOCK, len(lanes), BLOCK))
        ]
        return tuple(
            np.concatenate(x, 1)
            for x in zip(*(block.run(method, t1, tolerance) for block in blocks))
        )


def make(name):
    """The data of one scene, a `Stored`. **Raises** ValueError where numbers have less than 18 digits."""
    recipe = RECIPES[name]
    start = Stored(**starts(name))
    lattice, state = recipe.build(start)
    problem = _problem(name, lattice, state, recipe.t1)
    common = start._replace(t1=recipe.t1, method=METHOD, date=datetime.date.today().isoformat())
    if problem.u.shape[-1] > MANY and not problem.together:
        return common._replace(method=f"{METHOD}; {SAMPLED}", **_sampled(problem, recipe.t1))
    first = problem.run(collocation, recipe.t1, REFERENCE)
    second = problem.run(extrapolation, recipe.t1, CHECK)
    if recipe.tangents:
        first = _matrix(first)
        second = _matrix(second)
        data = {"matrix": first.astype(float), "growth": float(np.abs(first).max())}
    else:
        data = {"growth": _growth(problem, recipe.t1, first)}
        first, second = (_own_frame(name, y, recipe.t1) for y in (first, second))
        if name == "toda_soliton":
            first = soliton(recipe.t1)
        data |= {"u": first[0].astype(float), "v": first[1].astype(float)}
    return common._replace(uncertainty=max(measure(second, first), ROUNDED), **data)


def _sampled(problem, t1):
    """What is stored of a batch whose lanes would take hours twice."""
    u, v = problem.run(extrapolation, t1, CHECK)
    lanes = np.arange(0, u.shape[-1], EVERY)
    own = problem._replace(
        equation=problem.equation.of_lanes(lanes), u=problem.u[:, lanes], v=problem.v[:, lanes]
    )
    exact = own.run(collocation, t1, REFERENCE)
    uncertainty = max(measure((u[:, lanes], v[:, lanes]), exact), ROUNDED)
    return {
        "u": u.astype(float),
        "v": v.astype(float),
        "growth": _growth(own, t1, exact),
        "uncertainty": uncertainty,
    }


def _problem(name, lattice, state, t1):
    """The scene in extended precision."""
    u, v = (np.asarray(x, EXTENDED) for x in state)
    mass = np.asarray(lattice.mass, EXTENDED) + np.zeros(u.shape, EXTENDED)
    if name == "monodromy":
        return _tangents(mass, u, v)
    if name.startswith("toda_shock"):
        rest = np.zeros((int(FRONT * t1) + MARGIN, 1), EXTENDED)
        return Problem(
            equations.Chain(equations.toda, np.ones_like(rest), equations.mirror(2 * SHOCK)),
            rest,
            rest,
            scale=2 * SHOCK * t1,
        )
    if u.ndim == 1:
        u = u[:, None]
        v = v[:, None]
    return Problem(_EQUATIONS[name](mass), u, v, scale=_SCALES.get(name, 1.0))


def _tangents(mass, u, v):
    """The state in lane 0, then a unit displacement in every site, then a unit velocity."""
    size = len(u)
    one = np.eye(size, dtype=EXTENDED)
    none = np.zeros((size, size), EXTENDED)
    lanes = np.concatenate([u[:, None], one, none], 1), np.concatenate([v[:, None], none, one], 1)
    return Problem(equations.Tangents(mass), *lanes, together=True, scale=10.0)


_EQUATIONS = {
    "impact": lambda mass: equations.Chain(equations.hertz, mass, equations.walls),
    "impact_free": lambda mass: equations.Chain(equations.hertz, mass),
    "smooth": lambda mass: equations.Chain(equations.loaded_hertz, mass, equations.walls),
    "dimer_sweep": lambda mass: equations.Chain(equations.hertz, mass, equations.walls),
    "toda_soliton": lambda mass: equations.Chain(equations.toda, mass),
    "fput": lambda mass: equations.Chain(equations.fput, mass, equations.walls),
    "driven": lambda mass: equations.Damped(
        equations.loaded_hertz, mass, equations.driven_wall(0.1, 1.0, -np.pi / 2), 0.02, 0.05
    ),
    "light_dimer": lambda mass: equations.Chain(equations.loaded_hertz, mass, equations.walls),
    "softening": lambda mass: equations.Chain(equations.softening, mass),
    "magnets": lambda mass: equations.Chain(equations.magnets, mass),
    "modulated": lambda mass: equations.Modulated(
        equations.loaded_hertz, mass, equations.walls, 0.1, 1.875
    ),
}

# light beads have accelerations a hundred times those of the others; many lanes take long
_SCALES = {"light_dimer": 10.0, "dimer_sweep": 10.0}


def _matrix(y):
    """The map of tangents, rows and columns (u, v), from lanes."""
    return np.concatenate([y[0][:, 1:], y[1][:, 1:]])


def _growth(problem, t1, reference):
    """How much noise on every site has grown at t1."""
    noise = np.random.default_rng(SEED).uniform(-NOISE, NOISE, (2, *problem.u.shape))
    u, v = (x + n * np.abs(y).max() for x, n, y in zip(problem[1:3], noise, reference))
    return measure(problem._replace(u=u, v=v).run(extrapolation, t1, CHECK), reference) / NOISE


def _own_frame(name, y, t1):
    """The state as the scene has it: without the axis of a single lane, a shock in the frame of its middle."""
    u, v = y
    if name.startswith("toda_shock"):
        u = u - 2 * SHOCK * EXTENDED(t1)
        v = v - 2 * SHOCK
    return (u[:, 0], v[:, 0]) if u.shape[1] == 1 else (u, v)


def write(folder, name, data):
    """Write the data of a scene; returns the path."""
    path = folder / f"{name}.npz"
    np.savez_compressed(path, **{key: x for key, x in data._asdict().items() if x is not None})
    return path


def main(argv=None):
    """Make the files of all scenes, or of some."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--only", action="append", choices=names(), metavar="NAME", help="a scene; may be repeated"
    )
    parser.add_argument("--out", type=Path, default=DATA, help="folder for the files")
    arguments = parser.parse_args(argv)
    log.addHandler(logging.StreamHandler())
    log.setLevel(logging.INFO)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.only or names():
        began = time.perf_counter()
        data = make(name)
        path = write(arguments.out, name, data)
        log.info(
            "%-15s uncertainty %.1e  growth %.1e  %6.1f kB  %6.1f s",
            name,
            data.uncertainty,
            data.growth,
            path.stat().st_size / 1e3,
            time.perf_counter() - began,
        )


if __name__ == "__main__":
    main()
