"""The record of a run of a lattice that remembers."""

from collections.abc import Iterator
from typing import Any

import equinox as eqx
import numpy as np

from ...lattice import Lattice
from ...printing import text
from ...results import array, hidden
from ...terms.base import Remembering
from ...types import Numbers
from ...variables import Held
from ..run import Run


class RunWithMemory(Run):
    """A `Run` of a lattice with terms that remember, from `simulate`.

    - `energy_error`: largest |E - E0 - work| over the largest of |E0|, the kinetic energy at t0 and |work|, where E
      counts `lost`: what the balance misses. NaN where the work is not known.

    Whether a contact opened is looked at at the saved times alone.
    """

    lattice: Lattice | None = hidden(
        "The lattice with its internal variables as they are at the end, from which a run goes on: "
        "`gx.simulate(run.lattice, run.final, t1, t0=...)`.",
        default=None,
    )
    memory: dict[str, Numbers] | None = hidden(
        "The internal variables at the saved times, (T, bonds), such as `largest_overlap` [m] of `PlasticContact`; of "
        "several such terms the second is `largest_overlap_1`.",
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
            own = term.variables(self.lattice) if isinstance(term, Remembering) else None
            found.append(None if own is None else {key: self.memory[next(names)] for key in own})
        return tuple(found)

    def _memory(self):
        units = dict(self._kinds)
        for name, x in (self.memory or {}).items():
            yield name, x, Held("time bond", units[name])

    def _fields(self) -> Iterator[tuple[str, Any, Held]]:
        yield from super()._fields()
        yield from self._memory()

    def _rows(self) -> Iterator[tuple[str, str]]:
        *rows, outcome = super()._rows()
        yield from rows
        own = [("lost", self.lost, Held(unit="J")), ("work", self.work, Held(unit="J"))]
        for name, x, held in (*own, *self._memory()):
            if x is not None:
                yield name.replace("_", " "), text(np.asarray(x)[-1], self._unit(held))
        yield outcome
