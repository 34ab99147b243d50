"""The record of a run of a lattice that remembers."""

from collections.abc import Iterator
from typing import Any, ClassVar

import equinox as eqx
import numpy as np

from ...lattice import Lattice
from ...types import Numbers
from ...variables import Held
from ..run import Run


class RunWithMemory(Run):
    """A `Run` of a lattice with terms that remember, from `simulate`.

    - `lattice`: the lattice with its internal variables as they are at the end, from which a run goes on:
      `gx.simulate(run.lattice, run.final, t1, t0=...)`.
    - `memory`: dict of the internal variables at the saved times, (T, bonds), such as `largest_overlap` [m] of
      `PlasticContact`; of several such terms the second is `largest_overlap_1`.
    - `lost` (T,): energy dissipated by terms with internal variables since their virgin state [J]. `work` (T,): work
      on the lattice, since t0, of all terms that do not keep the energy: drives above zero, dashpots below [J].
    - `energy_error`: largest |E - E0 - work| over the largest of |E0|, the kinetic energy at t0 and |work|, where E
      counts `lost`: what the balance misses. NaN where the work is not known.

    Whether a contact opened is looked at at the saved times alone.
    """

    _table: ClassVar[dict[str, Held]] = {
        **Run._table,
        "lost": Held("time", "J"),
        "work": Held("time", "J"),
    }
    lattice: Lattice | None = None
    memory: dict[str, Numbers] | None = None
    lost: Numbers | None = None
    work: Numbers | None = None
    _kinds: tuple = eqx.field(static=True, default=())

    @property
    def by_term(self) -> tuple[dict[str, Numbers] | None, ...]:
        """The internal variables at the saved times, one dict for each term of the lattice; `None` for the others."""
        names = iter(name for name, _ in self._kinds)
        found = []
        for term in self.lattice.terms:
            own = term.variables(self.lattice)
            found.append(None if own is None else {key: self.memory[next(names)] for key in own})
        return tuple(found)

    @property
    def held(self) -> dict[str, Held]:
        return {**super().held, **{name: Held("time bond", unit) for name, unit in self._kinds}}

    def _fields(self) -> Iterator[tuple[str, Any]]:
        yield from super()._fields()
        yield from (
            (name, x) for name, x in (("lost", self.lost), ("work", self.work)) if x is not None
        )
        yield from (self.memory or {}).items()

    def _rows(self) -> Iterator[tuple[str, str]]:
        *rows, outcome = super()._rows()
        yield from rows
        for name, x in (("lost", self.lost), ("work", self.work)):
            if x is not None:
                yield name, self._told(name, np.asarray(x)[-1])
        for name, x in (self.memory or {}).items():
            yield name.replace("_", " "), self._told(name, np.asarray(x)[-1])
        yield outcome
