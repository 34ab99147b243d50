"""The result of a run."""

import dataclasses
from functools import cache
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import concrete
from ..base.programs import in_numpy
from ..base.types import Counts, Displacements, Flags, Number, Numbers, Pytree, Times
from ..lattice import Lattice, State
from ..results import Held, Result, array, entries, hidden, note, part

COMPLETED, NOT_FINITE, TOO_MANY_STEPS, STEP_TOO_SMALL, FAILED, NOTHING, MET, UNRESOLVED = range(8)
# A contact is certainly open beyond this margin (see `Found`).
OPENED = 0.05
# How a run ended, by its code.
WHY = {
    COMPLETED: "Completed at t = {t:g} after {steps} steps.",
    NOT_FINITE: "The state is not finite{where}: the motion left the law's domain, or the step is too long.",
    TOO_MANY_STEPS: "Stopped after {steps} steps, the most allowed; give max_steps= or a looser tolerance.",
    STEP_TOO_SMALL: "Stopped{where}: the tolerance asks for steps below what the floating type resolves, "
    "as where the motion grows without bound.",
    FAILED: "The solver reported a failure.",
    MET: "Magnets met{where}, where their law ends. Powers p <= -1 keep them apart at "
    "any energy: there the step was too long.",
    NOTHING: "Nothing was integrated: t1 is not after t0, the step or the tolerance is not above zero, the times of "
    "save_at do not increase from t0 to t1, or one of these numbers is not finite.",
    UNRESOLVED: "The floating type does not resolve the steps at these times: count time from t0=0.",
}


class Errors(Result):
    """Estimated errors of a run: `run.error`, from a second run at another step.

    Each has the shape and unit of its quantity. It is infinite if one of both runs did not
    complete, if only one saw an `Arrival`, or if a pulse of a drive may lie between the steps of
    both; NaN for an `Arrival` that did not happen. Errors have no derivative.
    """

    us: Displacements = array("The errors of the displacements.", "m", "time site", name="u")
    vs: Displacements = array("The errors of the velocities.", "m/s", "time site", name="v")
    final: State = part("The errors of the last state.", "site")
    energy: Numbers = array("The error of the energy at the saved times.", "J", "time")
    overlap: Numbers = array(
        "The smallest overlap of the contacts that can open, also between steps, per lane: "
        "negative if one opened, infinite without such contacts.",
        "m",
    )
    overlap_error: Numbers = array("The error of the smallest overlap.", "m")
    records: dict[str, Pytree] = entries("The errors of the records, by name.", name="record")
    how: str = array("How the second run was made.", static=True)

    @property
    def outcome(self) -> str:
        """A sentence about the largest errors (not available while traced)."""
        if isinstance(self.energy, jax.core.Tracer):
            return "Not known while traced."
        u, v = (max(float(np.max(x)) for x in jax.tree.leaves(tree)) for tree in (self.us, self.vs))
        return f"displacements within {u:.2g}, velocities within {v:.2g}, by {self.how}"


class Run(Result):
    """The result of `simulate`. It prints as text.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=11)
    >>> run.us.shape, run.solver, run.opening
    ((11, 20), 'SRKN11b', 'yes')
    >>> bool(run.energy_error < 1e-6)
    True
    """

    ts: Numbers = array("The saved times; by default only the end.", "s", "time", name="time")
    us: Displacements = array("The displacements at these times.", "m", "time site", name="u")
    vs: Displacements = array("The velocities at these times.", "m/s", "time site", name="v")
    final: State = hidden("The `State` at t1, or where a lane stopped.")
    energy_error: Numbers = note(
        "The largest |E - E0|/max(|E0|, kinetic energy) over the saved times, per lane; NaN if a "
        "term does not conserve energy (it says so, or its force is not the slope of its energy)."
    )
    _margin: Numbers
    _t1: Number
    code: Counts = hidden("How the run ended: a number per lane.")
    stats: dict[str, Number] = entries(
        "`steps`, `accepted`, `rejected`, `step` (the fixed one, or the mean of adaptive ones), "
        "`force_evaluations` (NaN for solvers of diffrax). If energy might gather beyond the "
        "bound of the default step, `omega` is the bound for the motion that was reached. Per "
        "lane where lanes have their own steps.",
        {"step": "s", "omega": "rad/s"},
        named="stats_{}",
    )
    recorded: dict[str, Pytree] = entries("The results of the records, by name.")
    failed_at: tuple[float, float, tuple[int, ...]] | None = hidden(
        "The times between which a run first was not finite, and the sites; none where it stopped.",
        default=None,
    )
    met: tuple[int, int, float, tuple[int, ...]] | None = hidden(
        "Where magnets met: (bond, number of the term, time, lane), with () for the lane if the "
        "outcome names it; else `None`.",
        default=None,
    )
    error: Errors | None = array(
        "The errors of the run with `simulate(..., confirm=True)`; else `None`.", default=None
    )
    started: Any = hidden(
        "The (lattice, state) at the start, or the problem that made them; `None` if traced.",
        default=None,
    )
    solver: str = array("The name of the solver.", static=True, default="")
    choice: str = array("How the steps were chosen.", static=True, default="")
    remark: str = hidden("Further remarks of the outcome.", static=True, default="")
    unseen: str = hidden(
        "The terms whose contacts do not tell whether they open.",
        static=True,
        default="",
    )
    _zone: float = eqx.field(static=True, default=0.0)
    exported: ClassVar[dict[str, Held]] = dict.fromkeys(
        ("contact_opened", "completed", "opening"), Held(None)
    )

    @property
    def completed(self) -> Flags:
        """Whether the run reached t1 with finite numbers, per lane.

        Values of a lane at times after it stopped are NaN.
        """
        # With NumPy if possible, since JAX compiles a program for each comparison.
        return in_numpy(self.code) == COMPLETED

    @property
    def outcome(self) -> str:
        """A sentence about how the run ended (not available while traced).

        It also names beads that overlap without a bond, at the saved times or the end, if positions
        and contacts tell the radii: bonds are fixed, and such beads pass through one another.
        """
        code = concrete(self.code)
        if code is None:
            return "Not known while traced."
        worst = code.max()
        t = float(np.max(self._t1))
        # Steps that lanes share have no axis for each of them.
        steps = np.asarray(self.stats["steps"])
        steps = steps[code == worst] if steps.shape == code.shape else steps
        why = WHY[int(worst) if self.met is None else MET]
        sentence = why.format(t=t, steps=steps.max(), where=self._where())
        if code.ndim and worst:
            if self.met is None or not self.met[-1]:
                first = np.unravel_index(np.argmax(code), code.shape)
                sentence = f"Lane {', '.join(map(str, first))}: {sentence}"
            lost = np.count_nonzero(code)
            sentence = f"{lost} of {code.size} lanes did not complete. {sentence}"
        return f"{sentence} {self.remark}".strip()

    @property
    def contact_opened(self) -> Flags:
        """Whether a contact was open at any time, per lane; `opening` says how certain that is.

        It is checked at the ends of steps. With `confirm=True` the finer run decides, also between
        steps.
        """
        return in_numpy(self._margin if self.error is None else self.error.overlap) < 0

    @property
    def opening(self) -> str:
        """Whether a contact opened, in one word: yes, no, unsure, unknown.

        Unsure: with `confirm=True`, the closest approach is within its error of zero; otherwise it
        is so close at the ends of steps that a contact may open between them. Unknown: a law or a
        term does not tell when its contacts open.
        """
        if self.error is None:
            sure = (self._margin <= -OPENED) | (self._margin >= self._zone)
        else:
            # A contact whose overlap never fell below that at rest has not opened.
            sure = np.abs(self.error.overlap) > self.error.overlap_error
            sure = sure | (np.asarray(self._margin) == np.inf)
        if np.any(np.asarray(sure) & np.asarray(self.contact_opened)):
            return "yes"
        return "unsure" if not np.all(sure) else "unknown" if self.unseen else "no"

    def _approach_in_words(self):
        if self.opening == "unknown":
            return f" ({self.unseen})"
        if self.error is None or not np.any(np.isfinite(self.error.overlap)):
            return ""
        closest = np.ravel(self.error.overlap)
        error = np.ravel(self.error.overlap_error)[np.argmin(closest)]
        return f" (smallest overlap {closest.min():.3g}, known to {error:.1g})"

    def _where(self):
        if self.met is not None:
            bond, term, time, lane = self.met
            lane = f" of lane {', '.join(map(str, lane))}" if lane else ""
            return f" in bond {bond} of terms[{term}] near t = {time:g}{lane}"
        if self.failed_at is None:
            return ""
        before, after, sites = self.failed_at
        if not sites:
            return f" near t = {after:g}"
        return f" (first between t = {before:g} and {after:g}, at sites {sites})"

    def _rows(self):
        yield "solver", self.solver
        yield "choice", self.choice
        taken = np.asarray(self.stats["steps"])
        rejected = int(np.max(self.stats["rejected"]))
        steps = (
            f"{taken.max()}"
            if taken.min() == taken.max()
            else f"{taken.min()} to {taken.max()}, lane by lane"
        )
        yield "steps", steps + (f", {rejected} of them rejected" if rejected else "")
        yield "step", f"{float(np.max(self.stats['step'])):.6g}"
        lost = float(np.fmax.reduce(self.energy_error, axis=None))
        yield "energy error", "no energy is kept" if np.isnan(lost) else f"{lost:.2g}"
        yield "contact opened", self.opening + self._approach_in_words()
        if self.error is not None:
            yield "error", self.error.outcome
        yield (
            "saved",
            f"{self.ts.shape[-1]} times"
            + (f", records {', '.join(self.recorded)}" if self.recorded else ""),
        )
        yield "outcome", self.outcome


class Found(NamedTuple):
    """What the compiled part of a run returns.

    - `margin`: the least overlap, divided by the distance that it moved from rest, per lane
    - `closest`: the least overlap
    - `short`: by how much records stayed below their thresholds
    - `last`: the state and times at the start of the last piece
    """

    ts: Times
    us: Displacements
    vs: Displacements
    final: State
    recorded: dict[str, Pytree]
    energy_error: Numbers
    margin: Numbers
    closest: Numbers
    short: dict[str, Pytree]
    code: Counts
    stats: dict[str, Number]
    last: tuple | None = None

    @property
    def completed(self) -> Flags:
        """As of a `Run`."""
        return self.code == COMPLETED


_STRUCTURES: dict = {}
# The most structures of runs that are kept. One more clears them all.
MOST_STRUCTURES = 256


def failed(found: Found) -> bool:
    """Return whether a run that is not traced, or a lane of it, did not complete."""
    return bool((np.asarray(found.code) != COMPLETED).any())


def run_of(
    kind: type[Run], found: Found, lattice: Lattice, names: tuple, more: dict, throw: bool
) -> Run:
    """Build the run of a class from what the integration returned, or raise with its outcome.

    `names`: solver, choice, remark, unseen, zone; `more`: other fields.
    """
    key = kind, names, lattice.space
    own = found._asdict() | {"_margin": found.margin, "_mark": lattice._mark} | more
    fields = {name: own.get(name) for name in _fields(kind)}
    structure = _STRUCTURES.get(key)
    # Filling a structure takes a tenth of the time of calling the class.
    if structure is not None:
        run = jax.tree.unflatten(structure, fields.values())
    else:
        named = dict(zip(("solver", "choice", "remark", "unseen", "_zone"), names))
        run = kind(**fields, **named, _space=lattice.space)
        if len(_STRUCTURES) >= MOST_STRUCTURES:
            _STRUCTURES.clear()
        _STRUCTURES[key] = jax.tree.structure(run, is_leaf=lambda x: x is not run)
    if throw:
        raise RuntimeError(run.outcome)
    return run


@cache
def _fields(kind):
    return [f.name for f in dataclasses.fields(kind) if not f.metadata.get("static")]


def finite(tree: Pytree, lanes: tuple[int, ...]) -> Flags:
    """Return whether every number of a tree is finite, per lane."""
    own = [
        jnp.all(jnp.isfinite(x), axis=tuple(range(x.ndim - len(lanes))))
        for x in jax.tree.leaves(tree)
    ]
    return jnp.all(jnp.stack(own), 0)
