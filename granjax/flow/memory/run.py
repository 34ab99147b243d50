"""The record of a run of a lattice that remembers."""

from collections.abc import Iterator

import equinox as eqx
import numpy as np

from ...lattice import Lattice
from ...printing import text
from ...results import Held, array, entries, hidden
from ...types import Numbers
from ..run import Run


class RunWithMemory(Run):
    """A `Run` of a lattice with terms that remember, from `simulate`.

    Its `energy_error` is the largest |E - E0 - work| over the largest of |E0|, the kinetic energy at t0 and |work|,
    where E counts `lost`: what the balance misses. NaN where the work is not known.

    Whether a contact opened is looked at at the saved times alone.
    """

    lattice: Lattice | None = hidden(
        "The lattice with its internal variables as they are at the end, from which a run goes on: "
        "`gx.simulate(run.lattice, run.final, t1, t0=...)`.",
        default=None,
    )
    memory: dict[str, Numbers] | None = entries(
        "The internal variables at the saved times, (T, bonds), such as `largest_overlap` [m] of `PlasticContact`; of "
        "several such terms the second is `largest_overlap_1`.",
        axes="time bond",
        default=None,
    )
    lost: Numbers | None = array(
        "The energy that terms with internal variables have dissipated since their virgin state.",
        "J",
        "time",
        default=None,
    )
    work: Numbers | None = array(
        "The work on the lattice, since t0, of all terms that do not keep the energy: of drives above zero, of "
        "dashpots below.",
        "J",
        "time",
        default=None,
    )
    _kinds: tuple = eqx.field(static=True, default=())

    @property
    def by_term(self) -> tuple[dict[str, Numbers] | None, ...]:
        """The internal variables at the saved times, one dict for each term of the lattice; `None` for the others."""
        names = iter(name for name, _ in self._kinds)
        found = []
        for term in self.lattice.terms:
            own = term.variables(self.lattice) if term.memory else None
            found.append(None if own is None else {key: self.memory[next(names)] for key in own})
        return tuple(found)

    def _held(self, name: str) -> Held:
        held = super()._held(name)
        return held._replace(unit=dict(self._kinds)) if name == "memory" else held

    def _rows(self) -> Iterator[tuple[str, str]]:
        *rows, outcome = super()._rows()
        yield from rows
        last = {"lost", "work", *(self.memory or {})}
        for name, x, held in self._fields():
            if name in last:
                yield name.replace("_", " "), text(np.asarray(x)[-1], self._unit(held))
        yield outcome
