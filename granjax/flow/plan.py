"""How a run is integrated: what `simulate` has chosen."""

from typing import NamedTuple

import diffrax

from ..types import Number, Times
from .record import Record

# where it is looked for the smallest overlap of a contact: at the ends of steps, also on the cubic through both ends of
# each step, or on the dense output
ENDS, CUBICS, DENSE = "ends", "cubics", "dense output"


class Plan(NamedTuple):
    """How a run is integrated. As a pytree its arrays are those of `step`, `tolerance`, `save_ts` and `records`.

    `step` [s]: the fixed step; with a `tolerance` the longest, or `None`. `save_ts`: times to save at, `None` for the
    end alone; `every`: save the end of each step. `max_steps`: `None` for a loop that may go on, which has no reverse
    mode. `watch`: follow every compression, for the highest frequency that the run reaches. `openings`: where it is
    looked for contacts that open.
    """

    solver: diffrax.AbstractSolver
    step: Number | None
    tolerance: Number | None
    save_ts: Times | None
    records: dict[str, Record]
    adjoint: diffrax.AbstractAdjoint
    max_steps: int | None = None
    every: bool = False
    progress: bool = False
    watch: bool = False
    openings: str = ENDS

    @property
    def has_pieces(self) -> bool:
        """Whether a run may have pieces: it is not saved at each step, and its adjoint keeps nothing of it."""
        return isinstance(self.adjoint, diffrax.ForwardMode) and not self.every
