"""Count the swings of a light bead between its heavy neighbours while a pulse squeezes them."""

from functools import cache

import diffrax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from ..base.checks import refuse, whole
from ..base.types import Count, Parameter
from ..flow import simulate
from ..results import Result, array, note
from ..scenes import dimer
from ..states import impact
from ..sweeps import paired, sweep
from .decay import MARGIN
from .lanes import LANES, checked_ratios

# the least approach of the heavy beads that counts as squeezed, as a share of the largest
SQUEEZED = 1e-3
# the least prominence of a turn of the light bead, as the same share
TURN = 1e-4
# number of times at which the compressions of both contacts of the light bead are saved
FRAMES = 2400


class Oscillations(Result):
    """The result of `oscillations`, for each mass ratio."""

    mass_ratio: Float[np.ndarray, " mass_ratio"] = array("The mass ratios.", "1")
    count: Float[np.ndarray, " mass_ratio"] = array(
        "The swings of the light bead during a squeeze, to half a swing: 1, 2, 3, 4 at the "
        "anti-resonances 1, 0.342846, 0.154751, 0.090128.",
        "1",
    )
    bead: int = note("The number of the bead.")

    @property
    def outcome(self) -> str:
        return (
            f"Light bead {self.bead} swings {np.nanmin(self.count):g} to {np.nanmax(self.count):g} times while its "
            f"neighbours are squeezed, at {len(self.count)} mass ratios."
        )


def oscillations(ratios: Parameter, *, bead: Count = 41) -> Oscillations:
    """Count the swings of a light bead during the squeeze by the leading pulse.

    The dimer chain is long and struck at its heavy end.
    **Arguments:** `ratios`: light over heavy, in (0, 1], (n,); `bead`: an odd number, far from the
    struck end.

    **Returns:** `Oscillations`; NaN for a run that did not complete. Between anti-resonances the
    count passes through a half-integer. **Raises** ValueError for ratios outside (0, 1] or a bead
    that is not light.
    Source: Jayaprakash, Starosvetsky, Vakakis, Phys. Rev. E 83, 036606 (2011).
    """
    ratios = checked_ratios(ratios)
    bead = whole("bead", bead, 1)
    if bead % 2 == 0:
        refuse("bead", "a light bead, whose number is odd", str(bead))
    beads = bead + 2 + MARGIN
    found = sweep(_squeezed(beads, bead), paired({"ratio": ratios}), chunk=LANES)
    counts = map(squeeze_count, found.left.values, found.right.values)
    return Oscillations(ratios, np.array(list(counts)), bead)


@cache
def _squeezed(beads, bead):
    ts = np.linspace(0.5 * bead, 1.4 * bead + 12, FRAMES)

    def strains(ratio):
        lattice = dimer(beads, ratio, boundary="free")
        run = simulate(lattice, impact(lattice), ts[-1], save_at=ts, adjoint=diffrax.ForwardMode())
        compressions = jnp.where(run.completed, -jnp.diff(run.us[:, bead - 1 : bead + 2]), jnp.nan)
        return {"left": compressions[:, 0], "right": compressions[:, 1]}

    return strains


def squeeze_count(left: Parameter, right: Parameter) -> float:
    """Count the swings of a bead during a squeeze, from the compressions of its two contacts.

    The turns of the bead's position z = (left - right)/2 are counted, two per swing, while the
    neighbours' approach left + right exceeds a thousandth of its largest value. The count ends at
    the first minimum of the approach after the peak, so that later rattling does not count.

    **Arguments:** `left`, `right` (T,): compressions of one pulse in the order of time (or of -xi
    of a wave), dense enough to show the swings.
    **Returns:** a multiple of 1/2; NaN for input that is not finite or never compressed.
    **Raises** ValueError for arrays that are not two such rows.
    """
    left = np.asarray(left, float)
    right = np.asarray(right, float)
    if left.ndim != 1 or left.shape != right.shape or len(left) < 3:
        refuse(
            "right",
            "two rows of compressions of one length, three or more",
            f"shapes {left.shape}, {right.shape}",
        )
    approach = left + right
    z = (left - right) / 2
    top = int(np.argmax(approach))
    if not np.isfinite(approach).all() or not approach[top] > 0:
        return np.nan
    low = approach < SQUEEZED * approach[top]
    begin = max(np.flatnonzero(low[:top]), default=0)
    rising = np.append(np.diff(approach[top:]) > 0, True)
    end = top + int(np.argmax(low[top:] | rising))
    z = z[begin : end + 1]
    least = TURN * approach[top]
    turns = sum(len(scipy.signal.find_peaks(way * z, prominence=least)[0]) for way in (1, -1))
    return turns / 2
