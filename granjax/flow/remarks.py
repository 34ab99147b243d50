"""What is said of a run that has ended: a loose tolerance, energy that was lost, a pulse between two steps."""

from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import show
from ..lattice import Lattice
from ..programs import compiled, once
from ..solvers.stability import refused_from
from ..terms.base import functions_of_time
from ..terms.energies import energy_gap
from ..types import Scalar, StateLike
from .dispatch import facts
from .method import reachable
from .run import Found

# tolerance from which on a run is remarked upon, and relative energy error
LOOSE, SUSPICIOUS = 1e-2, 0.02
# where an energy is told again, over the displacements at the end, and how much of it may be lost over what is seen
NEARBY, ROUNDED = 1e-3, 10
# places at which a function of time is looked at: in all, about, and in each step; steps at a time
MOST_PLACES = 2**18
PLACES = 8, 2048
BLOCK = 64
# of its range, from which on it leaves what the ends of steps show
LEAP = 0.25


def doubts(
    lattice: Lattice,
    state: StateLike,
    t0: Scalar,
    t1: Scalar,
    step: Scalar | None,
    tolerance: Any,
    solver: diffrax.AbstractSolver,
    run: Found,
) -> str:
    """Remarks on a run that has ended: a loose tolerance, much energy lost, an energy that is none; empty without."""
    said = []
    if tolerance is not None and tolerance > LOOSE:
        said.append(
            f"A tolerance of {show(tolerance)} is loose: a step may err by that part of the motion."
        )
    lost = np.asarray(run.energy_error)
    # as a rule; the rest takes longer
    if lost.max() <= SUSPICIOUS or not lattice.conserves:
        return " ".join(said)
    if np.isnan(lost).any() and np.all(run.completed):
        ends = [lattice.energy(t, *y) for t, y in ((t0, state), (t1, run.final))]
        gaps = {
            type(term).__name__: np.max(energy_gap(term, lattice, t1, run.final.u))
            for term in lattice.terms
        }
        if not np.isfinite(ends).all() or not np.isfinite(list(gaps.values())).all():
            dtype = facts(lattice).dtype
            said.append(
                f"The energy is larger than any number of {dtype}, or no number at all, so what is lost of it "
                "is not known. Count lengths and times in larger units."
            )
        else:
            said.append(
                f"The force of {max(gaps, key=gaps.get)} is not the slope of its `energy`, so none is kept."
            )
    if not np.isnan(lost).all() and np.nanmax(lost) > SUSPICIOUS:
        if _resolved(lattice, state, t0, t1, run):
            said.append(
                _lost(lattice, state, t0, t1, step, tolerance, solver, float(np.nanmax(lost)))
            )
        else:
            said.append(
                "The energy error is the rounding of `energy`, which does not resolve so small a motion."
            )
    return " ".join(said)


def missed(lattice: Lattice, t0: Scalar, t1: Scalar, step: Any, tolerance: Any) -> str:
    """A remark where a function of time, of which no breaks are told, has a pulse that steps of a run may pass over.

    Between the ends of a step it goes beyond what it is at four ends around by a quarter of its range, or more. An
    adaptive step is tried at many places, so that a quarter of its mean length counts. Pulses are looked for at 8 to
    2048 places in each step: shorter ones nobody sees.
    """
    if not _signals(lattice):
        return ""
    step = np.max(step) / (1 if tolerance is None else 4)
    count = max(int(np.ceil((t1 - t0) / step * (1 - 1e-9))), 1)
    places = int(np.clip(4 ** int(np.log2(MOST_PLACES / count) / 2), *PLACES))
    t0, t1 = (jnp.asarray(t, facts(lattice).dtype) for t in (t0, t1))
    for i, function in _signals(lattice):
        if _leap(function, t0, t1, jnp.asarray(count), places) > LEAP:
            name = type(lattice.terms[i]).__name__
            return (
                f"terms[{i}] ({name}) has a pulse that is shorter than the steps, or swings within one: the run "
                f"may have missed it. Give {name} breaks= where the pulse begins and ends, or simulate a shorter "
                "step=."
            )
    return ""


@once
def _signals(lattice):
    """The functions of time of a lattice, each with the number of its term."""
    return [(i, f) for i, term in enumerate(lattice.terms) for f in functions_of_time(term)]


@compiled
def _leap(function, t0, t1, count, places):
    """How far a function of time leaves, within one of equal steps, what it is at their ends; over its range."""
    at, h = jax.vmap(function), (t1 - t0) / count
    inner = (np.arange(places) + 0.5) / places

    def one(k):
        ends, inside = (
            at(jnp.clip(t0 + h * (k + np.arange(-1, 3)), t0, t1)),
            at(t0 + h * (k + inner)),
        )
        low, high = jnp.minimum(ends.min(0), inside.min(0)), jnp.maximum(ends.max(0), inside.max(0))
        return jnp.maximum(high - ends.max(0), ends.min(0) - low), low, high

    def block(b, found):
        beyond, low, high = jax.vmap(one)(jnp.minimum(b * BLOCK + np.arange(BLOCK), count - 1))
        own = beyond.max(0), low.min(0), high.max(0)
        return tuple(f(*x) for f, *x in zip((jnp.maximum, jnp.minimum, jnp.maximum), found, own))

    beyond, low, high = jax.lax.fori_loop(0, (count - 1) // BLOCK + 1, block, one(0))
    return jnp.max(beyond / jnp.where(high > low, high - low, 1))


def _resolved(lattice, state, t0, t1, run):
    """Whether some lane lost more energy than what its terms' arithmetic leaves uncertain.

    That shows where the energy is told along a short straight line through the end, on which it hardly bends.
    """
    scale = np.maximum(np.abs(lattice.energy(t0, *state)), lattice.kinetic_energy(state.v))
    parts = 1 + NEARBY * np.linspace(-1, 1, 9)
    line = [
        lattice.potential_energy(t1, jax.tree.map(lambda u: u * part, run.final.u))
        for part in parts
    ]
    rounding = ROUNDED * np.abs(np.diff(np.asarray(line), 2, axis=0)).max(axis=0)
    lost = np.asarray(run.energy_error) * scale
    return bool(np.any((lost > SUSPICIOUS * scale) & ~(lost <= rounding)))


def _lost(lattice, state, t0, t1, step, tolerance, solver, lost):
    limit = None if tolerance is not None else refused_from(solver)
    if limit is not None and step is not None:
        omega, _ = reachable(lattice, state, t0, t1)
        if step * omega > limit:
            return (
                f"Much energy was lost: the step is past stability for frequencies that this energy can reach, "
                f"h omega <= {step * omega:.3g}, where {type(solver).__name__} is stable below {limit:.3g}."
            )
    way = "a shorter step=" if tolerance is None else "a smaller tolerance="
    return f"Much energy was lost or won, {lost:.2g} of it: the run is not accurate; give {way}."
