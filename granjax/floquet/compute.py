"""The monodromy matrix and what follows from it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..checks import refuse, whole
from ..flow import Flow, linear_frequency
from ..lattice import Lattice, vector_field
from ..orbits import Symmetry, default_steps, free_moves, shifts
from ..solvers import KahanLi8
from .record import RESOLUTION, Floquet, decide
from .spectrum import product_spectrum, spectrum
from .structure import NOTHING, defect, krein, structure

# where refinement ends
MOST_STEPS = 2**14
TOLERANCE = 1e-9


@eqx.filter_jit
def _derivative(flow, y, t0, t1, args):
    return flow.derivative(y, t0, t1, args)


def floquet(lattice, state, period, *, t0=0.0, steps=None, solver=None, segments=1, tolerance=TOLERANCE, args=None,
            symmetry=Symmetry(), expected=None, resolution=RESOLUTION):
    r"""Monodromy matrix, multipliers and stability of a periodic orbit.

    M = d y(t0 + T)/d y(t0) by tangents through a fixed-step flow, with two step sizes whose difference is the error.

    **Arguments:**

    - `lattice`: a `Lattice`, or a `Flow` of any vector field together with `args` (of which neither masses nor
      symmetries are known).
    - `state`: the orbit at t0. `period`: T > 0. `t0`: phase of a drive.
    - `steps`: steps of the finer flow over the period; `None` doubles them until the matrix is known to `tolerance`
      (relative to its largest entry) or 16384 steps are reached, as may happen where contacts open.
    - `solver`: `None` is KahanLi8, or the flow's own. `segments`: factors of which M is the product; several keep
      multipliers that lie far below the largest one's rounding.
    - `symmetry`: S of an orbit with y(t0 + T) = S y(t0); M is then S^-1 times that derivative.
    - `expected`: multipliers that symmetry puts at +1; `None` is what the terms of a lattice say, and none for a
      `Flow`: give 1 for a limit cycle of an autonomous one.
    - `resolution`: what an undetected instability may be; an error above it leaves the verdict open.

    **Returns:** `Floquet`. **Raises** ValueError for a period that is not positive, a state of another shape, and
    segments that do not divide the steps.
    """
    if not period > 0:
        refuse("period", "a time above zero", repr(period))
    segments = whole("segments", segments, 1)
    known = NOTHING
    if isinstance(lattice, Lattice):
        _check_state(lattice, state)
        known, args = structure(lattice), lattice
        if known.autonomous and _rests(lattice, state, t0):  # has neither phase nor energy
            known = known._replace(expected=known.expected - (2 if known.rate == 0 else 1))
        turned = shifts(lattice).shape[1] - free_moves(lattice, symmetry).shape[1]
        known = known._replace(expected=known.expected - turned * (2 if known.rate == 0 else 1))
        solver, field = solver or KahanLi8(), {}
        start = steps or default_steps(lattice, period, 2 * segments, doubled=True)
    else:
        solver, field = solver or lattice.solver, {"field": lattice.field}
        start = steps or lattice.steps
    if expected is not None:
        known = known._replace(expected=whole("expected", expected, 0))
    if start % (2 * segments):
        refuse("steps", f"a multiple of {2 * segments}, twice the segments", repr(start))

    def factors(count):
        flow = Flow(jnp.asarray(count // segments), solver, **field)
        found = _factors(flow, state, t0, period, segments, args)
        return found if symmetry.trivial else [*found[:-1], symmetry.matrix(state).T @ found[-1]]

    count, coarse, fine = start, factors(start // 2), factors(start)
    while steps is None and 2 * count <= MOST_STEPS:
        size = max(np.abs(f).max() for f in fine)
        if np.abs(_product(fine) - _product(coarse)).max() <= tolerance * max(size, np.abs(_product(fine)).max()):
            break
        count, coarse, fine = 2 * count, fine, factors(2 * count)
    return _record(known, fine, coarse, state, period, count, resolution)


def _record(known, fine, coarse, state, period, steps, resolution):
    monodromy, rough = _product(fine), _product(coarse)
    multipliers, vectors, error = spectrum(monodromy, rough) if len(fine) == 1 else product_spectrum(fine, coarse)
    conserves = known.rate == 0
    verdict, outcome = decide(multipliers, error, known.expected, conserves, resolution)
    signature = krein(multipliers, vectors, known.mass, np.maximum(error, 1e-12))
    signature[np.argsort(np.abs(multipliers - 1))[: known.expected]] *= 0.0  # those of symmetry have none
    return Floquet(
        monodromy, multipliers, vectors, error, signature,
        defect(monodromy, known.mass, known.rate, float(period)), float(np.abs(monodromy - rough).max()),
        known.expected, verdict, outcome, float(period), int(steps), known.rate, state,
    )


def _check_state(lattice, state):
    shapes = [x.shape for x in jax.tree.leaves(lattice.template())]
    for name, part in zip("uv", state):
        got = [np.shape(x) for x in jax.tree.leaves(part)]
        if got != shapes:
            refuse(f"state.{name}", f"shape {lattice.shape}", f"{got}", "One orbit of one lattice at a time.")


def _rests(lattice, state, t0):
    """Whether the state is an equilibrium, to rounding."""
    (v, a), omega = vector_field(t0, state, lattice), linear_frequency(lattice)
    u, v, a = (np.abs(ravel_pytree(x)[0]).max() for x in (state[0], v, a))
    return bool(max(v * omega, a) <= 1e-12 * omega**2 * u)


def _factors(flow, state, t0, period, segments, args):
    found, length = [], period / segments
    for i in range(segments):
        times = jnp.asarray(t0 + i * length), jnp.asarray(t0 + (i + 1) * length)
        state, factor = _derivative(flow, state, *times, args)
        found.append(np.asarray(factor))
    return found


def _product(factors):
    total = factors[0]
    for factor in factors[1:]:
        total = factor @ total
    return total


def multipliers(flow, state, t0, period, args):
    """Floquet multipliers alone, a pure function: (2n,) complex, for `jax.jacfwd`, `vmap` and `jit`.

    **Arguments:** `flow`: a `Flow` over one period; `state`: the orbit at `t0`; `args`: of its field, such as the
    lattice. In the order that LAPACK gives. Differentiate a simple one, `multipliers(...)[i]`.
    """
    _, monodromy = flow.derivative(state, t0, t0 + period, args)
    return jnp.linalg.eigvals(monodromy)
