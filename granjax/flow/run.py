"""The record of a run."""

from collections.abc import Iterator
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, traced
from ..lattice import State
from ..results import Held, Result
from ..types import Counts, Displacements, Flags, Number, Numbers, Pytree, Times
from ..variables import Layout

COMPLETED, NOT_FINITE, TOO_MANY_STEPS, STEP_TOO_SMALL, FAILED, NOTHING, MET, UNRESOLVED = range(8)
# how far beyond touch, over how far it came from rest, a contact is certainly open
OPENED = 0.05
# what has become of a run, by its code
WHY = {
    NOT_FINITE: "The state is not finite: the motion left the law's domain, or the step is too long.",
    TOO_MANY_STEPS: "Stopped at the most steps allowed; give max_steps= or a looser tolerance.",
    STEP_TOO_SMALL: "Stopped: the tolerance asks for steps below what the floating type resolves.",
    FAILED: "The solver reported a failure.",
    MET: "Magnets met in bond {} of terms[{}] near t = {:g}{}, where their law ends. Powers p <= -1 keep them apart at "
    "any energy: there the step was too long.",
    NOTHING: "Nothing was integrated: t1 is not after t0, the step or the tolerance is not above zero, or one of them "
    "is no finite number.",
    UNRESOLVED: "The floating type does not resolve the steps at these times: count time from t0=0.",
}


class Run(Result):
    """What `simulate` returns. It prints itself.

    - `ts` (T,), `us`, `vs` (T, N): times, displacements and velocities that were saved (T = 1, the end, by default).
    - `final`: `State` at the last time, of a lane that stopped where it did; `recorded`: dict of the records' results,
      `record_error`: of their errors.
    - `energy_error`: largest |E - E0|/max(|E0|, kinetic energy) over the saved times, NaN where a term does not keep
      the energy (says so, or its force is not the slope of its energy); shape of the lanes.
    - `contact_opened`: whether any contact was open, one that never closed included; `opening`: the same in a word,
      with "unsure" and "unknown". `unseen`: the terms that may have contacts of which nobody knows whether they opened.
    - `outcome`: a sentence. It also names beads that have no bond and overlap, at the saved times or at the end,
      where a scene knows the size of its beads by its positions and contacts: bonds are fixed, and such beads
      pass through one another.
    - `completed`: whether the run reached t1 with finite numbers: each lane where they have
      steps of their own (what a lane that stopped would have to show at later times is NaN), else every lane.
    - `met`: where magnets met, (bond, number of its term, time, lane, () where the outcome names it); else `None`.
    - `stats`: dict, per lane where they have steps of their own, of `steps`, `accepted`, `rejected`, `step` (the
      fixed one, or the mean of adaptive ones),
      `force_evaluations` (NaN for diffrax's own solvers), and where energy might gather beyond the default step's
      bound `omega`, that of what was reached. `solver`: its name; `choice`: what was chosen and why.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=11)
    >>> run.us.shape, run.solver, run.opening
    ((11, 20), 'SRKN11b', 'yes')
    >>> bool(run.energy_error < 1e-6)
    True
    """

    _table: ClassVar[dict[str, Held]] = {
        "ts": Held("time", "s", "time"),
        "us": Held("time site", "m", "u"),
        "vs": Held("time site", "m/s", "v"),
        "energy_error": Held(None),
        "contact_opened": Held(None),
        "completed": Held(None),
        "stats_step": Held(unit="s"),
        "stats_omega": Held(unit="rad/s"),
    }
    ts: Times
    us: Displacements
    vs: Displacements
    final: State
    recorded: dict[str, Pytree]
    energy_error: Numbers
    _margin: Numbers
    _short: dict[str, Pytree]
    code: Counts
    stats: dict[str, Number]
    failed_at: tuple[float, float, tuple[int, ...]] | None
    solver: str = eqx.field(static=True)
    choice: str = eqx.field(static=True)
    remark: str = eqx.field(static=True)
    unseen: str = eqx.field(static=True)
    _zone: float = eqx.field(static=True)
    _confirmation: Any = None
    met: tuple[int, int, float, tuple[int, ...]] | None = None

    @property
    def held(self) -> dict[str, Held]:
        """Axes and units; the error of a record has the axes of the record."""
        lanes, held = np.ndim(self.energy_error), dict(self._table)
        for name, said in self._names.items():
            own = 0 if isinstance(self.recorded[name], dict) else _axes(self.recorded[name]) - lanes
            held[f"{said}_error"] = Held(" ".join(f"{said}_{k}" for k in range(own)))
        return held

    @property
    def _names(self):
        """The names of the records in a file, where a run has names of its own too."""
        taken = {*self._table, "opening", "stats", "solver", "choice"}
        return {
            name: f"recorded_{name}" if {name, f"{name}_error"} & taken else name
            for name in self.recorded
        }

    @property
    def completed(self) -> Flags:
        return self.code == COMPLETED

    @property
    def record_error(self) -> dict[str, Pytree]:
        """The error of each record, of its shape and in its unit: how far it may be from the truth.

        Found by a second run with steps of half the length (a quarter where contacts opened; or a tolerance 100 times
        smaller), when it is first asked for, by `to_xarray` too: a run whose errors nobody reads costs nothing more. It
        covers the error of the run and what is lost between its steps. NaN for an `Arrival` that did not happen;
        infinite where only one of the two runs has seen it, or both missed it by no more than they are known to, or
        one has not completed, or where a pulse of a drive may lie between the steps of both. Under `jax.jit` it is
        part of the program where it is read; it has no derivative. A pickled run has lost it where a record holds a
        lambda and nobody had asked for it.
        """
        known = self.__dict__.get("_known_error")
        if known is None and self._confirmation is None:
            return {}
        if known is None:
            good = self.completed & ("_hidden" not in self.__dict__)
            known = self._confirmation.errors(self.recorded, self._short, good, self._margin < 0)
            if not traced(known):
                object.__setattr__(self, "_known_error", known)
        return known

    @property
    def outcome(self) -> str:
        """What became of the run, in a sentence (only where the run is not traced)."""
        code = concrete(self.code)
        if code is None:
            return "Not known while traced."
        worst = code.max()
        t = float(np.max(np.asarray(self.ts)[..., -1]))
        steps = int(np.max(np.asarray(self.stats["steps"]), where=code == worst, initial=0))
        sentence = WHY | {
            COMPLETED: f"Completed at t = {t:g} after {steps} steps.",
            NOT_FINITE: WHY[NOT_FINITE].replace(":", f"{self._where()}:", 1),
            TOO_MANY_STEPS: WHY[TOO_MANY_STEPS].replace(
                "at the most steps", f"after {steps} steps, the most", 1
            ),
        }
        sentence = sentence[int(worst)] if self.met is None else self._met_in_words()
        if code.ndim and worst:
            first = ", ".join(map(str, np.unravel_index(np.argmax(code), code.shape)))
            sentence = f"{np.count_nonzero(code)} of {code.size} lanes did not complete. Lane {first}: {sentence}"
        return f"{sentence} {self.remark}".strip()

    @property
    def started(self) -> tuple[Any, State] | None:
        """The lattice and the state that the run began with; `None` of one that was traced or has been stored."""
        look = self.__dict__.get("_look")
        return None if look is None else look.args[:2]

    @property
    def contact_opened(self) -> Flags:
        """Whether a contact was open at any time, per lane; `opening` says how sure that is.

        Where at the ends of the steps a contact came near it, two more runs decide when this is first read: between
        steps, by steps of half the length. Under a transformation the cubic through both ends of each step says it.
        """
        found = self._approach
        return (
            self._margin < 0
            if found is None
            else jnp.where(self._near, found[0] < 0, self._margin < 0)
        )

    @property
    def opening(self) -> str:
        """Whether a contact opened, in a word: yes, no, unsure, unknown.

        Unsure where the closest approach is within its error of zero, or could not be looked at between steps; unknown
        where a law or a term does not say when its contacts open.
        """
        closest, error = (0.0, np.inf) if self._approach is None else self._approach
        sure = np.where(self._near, np.abs(closest) > error, True)
        if np.any(sure & np.asarray(self.contact_opened)):
            return "yes"
        return "unsure" if not np.all(sure) else "unknown" if self.unseen else "no"

    @property
    def _near(self):
        return (self._margin > -OPENED) & (self._margin < self._zone)

    @property
    def _approach(self):
        """(the closest approach, its error), per lane; `None` where no contact came near, or nothing can be run."""
        look = self.__dict__.get("_look")
        if look is None or not np.any(self._near):
            return None
        if "_found" not in self.__dict__:
            object.__setattr__(self, "_found", jax.tree.map(np.asarray, look()))
        return self.__dict__["_found"]

    def _approach_in_words(self):
        if self.opening == "unknown":
            return f" ({self.unseen})"
        if self._approach is None:
            return ""
        closest, error = (np.ravel(x)[np.argmin(self._approach[0])] for x in self._approach)
        return f" (smallest overlap {closest:.3g}, known to {error:.1g})"

    def _met_in_words(self):
        bond, term, time, lane = self.met
        return WHY[MET].format(
            bond, term, time, f" of lane {', '.join(map(str, lane))}" if lane else ""
        )

    def _where(self):
        if self.failed_at is None:
            return ""
        before, after, sites = self.failed_at
        return f" (first between t = {before:g} and {after:g}, at sites {sites})"

    def _rows(self) -> Iterator[tuple[str, str]]:
        yield "solver", self.solver
        yield "choice", self.choice
        taken, rejected = np.asarray(self.stats["steps"]), int(np.max(self.stats["rejected"]))
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
        yield (
            "saved",
            f"{self.ts.shape[-1]} times"
            + (f", records {', '.join(self.recorded)}" if self.recorded else ""),
        )
        yield "outcome", self.outcome

    def to_numpy(self) -> dict:
        """A dict of NumPy arrays: ts, us, vs and the records."""
        tree = {"ts": self.ts, "us": self.us, "vs": self.vs, **self.recorded}
        return jax.tree.map(np.asarray, tree)

    def _fields(self) -> Iterator[tuple[str, object]]:
        own = (
            "ts",
            "us",
            "vs",
            "energy_error",
            "contact_opened",
            "completed",
            "opening",
            "stats",
            "solver",
            "choice",
        )
        yield from ((name, getattr(self, name)) for name in own)
        names = self._names
        yield from ((names[name], x) for name, x in self.recorded.items())
        if self._confirmation is None or self._confirmation.tells:
            yield from (
                (f"{names[name]}_error", error) for name, error in self.record_error.items()
            )

    def _layout(self, fields: dict[str, object], space: tuple[int, int] | None) -> Layout:
        """Lanes are those of the energy's error: behind the sites, and of `jax.vmap` before them."""
        lanes, mapped = np.shape(self.energy_error), np.ndim(self.ts) - 1
        first = mapped if lanes[:mapped] == np.shape(self.ts)[:mapped] else 0
        return Layout(*(space or (None, 0)), lanes, first)


def _axes(x):
    """Axes of an array; none of what is no array, such as a tuple of unequal parts."""
    return np.ndim(x) if hasattr(x, "shape") else 0


def named(
    run: Run, solver: str, choice: str, remark: str, zone: float = 0.0, mark: Any = None
) -> Run:
    """A run that a compiled function has just returned, with its names and the mark of its units.

    Written into it, which nobody else holds yet: making a Module anew takes longer than a short run.
    """
    zone, names = zone or run._zone, {"solver": solver, "choice": choice, "remark": remark}
    for field, value in (*names.items(), ("_zone", zone), ("_mark", mark)):
        object.__setattr__(run, field, value)
    return run


def finite(tree: Pytree) -> Flags:
    """Whether every number of a tree is finite."""
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves(tree)]))
