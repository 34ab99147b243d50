"""A strided space-time map of the strain of a shock, computed without keeping the trajectory."""

import jax.numpy as jnp
import numpy as np

from ..base.checks import refuse, show, whole
from ..base.programs import compiled
from ..base.types import Count, Counts, Number, Numbers, Scalar, Times, Values
from ..flow import simulate
from ..flow.arguments import checked_method
from ..flow.steps import fixed_step
from ..lattice import Lattice, State
from ..results import Result, array, note
from .riemann import Riemann


class SpaceTime(Result):
    """A map of the strain at the times `ts` and the `bonds`, by their indices."""

    ts: Times = array("The times.", "s", "time", name="time")
    bonds: Counts = array("The indices of the bonds.", axes="bond", name="bond")
    strain: Numbers = array("The strain.", "m", "time bond")
    centre: Number = note(
        "The place of the step on the scale of bonds, so that n/t of the theory is `places/t`."
    )
    c: Number = note("The velocity c of the `Riemann` problem.", "m/s")
    final: State = note("The `State` at t1.")
    step: Number = note("The time step; the mean one if adaptive.", "s")
    energy_error: Numbers = note(
        "The energy error as of a `Run`, at the times of the map; NaN where a term does not "
        "conserve energy."
    )
    kind: str = array("The kind of the `Riemann` problem.", static=True)

    @property
    def outcome(self) -> str:
        """The size of the map."""
        return (
            f"{len(self.ts)} frames of {len(self.bonds)} bonds, at time steps of {self.step:.4g}."
        )

    @property
    def places(self) -> Numbers:
        """The distances of the bonds from the step, bond - centre, (B,), then lanes of centres."""
        return np.subtract.outer(np.asarray(self.bonds, float), np.asarray(self.centre))


def space_time(
    problem: Riemann,
    t1: Scalar | None = None,
    frames: Count = 400,
    sites: Count | Values = 400,
    *,
    step: Scalar | None = None,
) -> SpaceTime:
    """Run a shock and keep only a strided map of its strain.

    The memory is that of the map and of one state. The run goes from frame to frame with the time
    step of the whole run. A terminal shows a progress bar.

    **Arguments:** `problem`: a `Riemann`; `t1`: as in its `run`. `frames`: the number of times from
    0 to t1, two or more. `sites`: the most bonds, evenly spaced over the chain, or their indices.
    If the stride exceeds half a wavelength the map shows an aliased wave (waves behind a shock are
    about 3 ... 10 bonds long), though each number is correct. `step`: as in `gx.simulate`.
    **Returns:** `SpaceTime`. **Raises** ValueError for bonds that do not exist; RuntimeError where
    the run does not complete.
    """
    from tqdm import tqdm

    bonds = _bonds(sites, problem.lattice.shape[0] - 1)
    frames = whole("frames", frames, 2)
    lattice, state = problem
    t1 = problem.horizon() if t1 is None else t1
    # A force that depends on the velocity takes adaptive steps unless a step is given.
    solver, step, tolerance = checked_method(lattice, None, step, None)
    if tolerance is None:
        step = float(fixed_step(lattice, state, 0.0, float(t1), step, solver, frames - 1)[0])
    ts = np.linspace(0.0, float(t1), frames)
    seen = lambda: np.asarray(problem.strain(state.u))[bonds]
    rows = [seen()]
    energy = _energy(lattice, 0.0, state)
    size = jnp.maximum(jnp.abs(energy), lattice.kinetic_energy(state.v))
    size = jnp.where(size > 0, size, 1)
    lost = 0.0
    # disable=None shows the bar only on a terminal.
    bar = tqdm(ts[1:], desc="shock", unit="frame", leave=False, disable=None)
    for low, high in zip(ts[:-1], bar):
        run = simulate(lattice, state, high, t0=low, solver=solver, step=step, tolerance=tolerance)
        state = State(*run.final)
        rows.append(seen())
        lost = jnp.maximum(lost, jnp.abs(_energy(lattice, high, state) - energy) / size)
    return SpaceTime(
        ts,
        bonds,
        np.stack(rows),
        problem.centre,
        problem.c,
        state,
        np.asarray(step if tolerance is None else run.stats["step"]),
        lost if lattice.conserves else jnp.full_like(lost, jnp.nan),
        problem.kind,
        **lattice.origin,
    )


def _bonds(sites, count):
    if np.ndim(sites) == 0:
        return np.arange(0, count, -(-count // whole("sites", sites, 1)))
    bonds = np.asarray(sites)
    if bonds.dtype.kind not in "iu" or np.any((bonds < 0) | (bonds >= count)):
        refuse("sites", f"how many bonds, or their indices from 0 to {count - 1}", show(bonds))
    return bonds


@compiled
def _energy(lattice: Lattice, t: Scalar, y: State):
    return lattice.energy(t, y.u, y.v)
