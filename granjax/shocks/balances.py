"""What flows into a box of a chain against what gathers there."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..checks import refuse
from ..flow import Integral
from ..flow.method import GATHERED, STEP_FRACTION, frequency_bound
from ..lattice import Lattice, State
from ..results import Result, array
from ..terms.chain import next_neighbours
from ..types import Number, Numbers, Scalar
from .riemann import Riemann
from .scenes import over_bonds

KINDS = "strain", "momentum", "energy"
# units of rounding of a sum, over the sum of the sizes of its parts
ROUNDED = 8


class Balances(Result):
    """Strain, momentum and energy of a box of sites, from 0 to t1: what gathered, what flowed in, and what is missing.

    The box holds the sites from `first` to `last` and the bonds between them; f_n is the force of bond n beyond the
    preload, and what flows in is

    - strain, sum of y_n: v_first - v_last;
    - momentum, sum of m v_n: f_{first-1} - f_last;
    - energy, sum of m v_n^2/2 and of the bonds' energies: f_{first-1} v_first - f_last v_last.

    Errors are found by a run of half the step, and from the rounding of the sums. Numbers, or one per lane.
    """

    strain_change: Numbers = array("Strain at the end less at the start.", "m")
    strain_inflow: Numbers = array(
        "Strain that flowed in through both ends, integrated along the run.", "m"
    )
    strain_residual: Numbers = array("Strain that is missing, change less inflow.", "m")
    strain_error: Numbers = array("Strain by which the inflow may err.", "m")
    momentum_change: Numbers = array("Momentum at the end less at the start.", "N s")
    momentum_inflow: Numbers = array(
        "Momentum that flowed in through both ends, integrated along the run.", "N s"
    )
    momentum_residual: Numbers = array("Momentum that is missing, change less inflow.", "N s")
    momentum_error: Numbers = array("Momentum by which the inflow may err.", "N s")
    energy_change: Numbers = array("Energy at the end less at the start.", "J")
    energy_inflow: Numbers = array(
        "Energy that flowed in through both ends, integrated along the run.", "J"
    )
    energy_residual: Numbers = array("Energy that is missing, change less inflow.", "J")
    energy_error: Numbers = array("Energy by which the inflow may err.", "J")
    t1: Number = array("The end of the run.", "s")
    first: int = array("The first site of the box.", static=True)
    last: int = array("The last site of the box.", static=True)

    @property
    def outcome(self) -> str:
        """Whether the balances close, each to the error of what flowed in."""
        missed = [
            kind
            for kind in KINDS
            if np.any(
                np.abs(getattr(self, f"{kind}_residual"))
                > np.asarray(getattr(self, f"{kind}_error"))
            )
        ]
        if missed:
            return f"The balance of {' and '.join(missed)} does not close to the error of the run: give a smaller step."
        return "The balances of strain, momentum and energy close to the error of the run."


class Inflow(eqx.Module):
    """What flows into a box of sites in a unit of time: strain, momentum, energy."""

    first: int = eqx.field(static=True)
    last: int = eqx.field(static=True)

    def __call__(self, t: Number, y: State, lattice: Lattice) -> dict[str, Numbers]:
        """The three rates by their names, each one number or one per lane."""
        left, right = (_force(lattice, y.u, bond) for bond in (self.first - 1, self.last))
        at_left, at_right = y.v[self.first], y.v[self.last]
        return {
            "strain": at_left - at_right,
            "momentum": left - right,
            "energy": left * at_left - right * at_right,
        }


def balances(
    problem: Riemann,
    t1: Scalar | None = None,
    box: tuple[int, int] | None = None,
    **keywords: Any,
) -> Balances:
    """Run a shock and hold what gathers in a box against the fluxes of strain, momentum and energy through its ends.

    **Arguments:** `problem`: a `Riemann`; `t1`: as in its `run`; `box`: first and last site, away from the ends of the
    chain; `None` for the quarter of the chain right of the step (of a piston, right of the first few sites).
    `keywords`: those of `gx.simulate`, such as `step`; without any the step is half of the default one.
    **Returns:** `Balances`. **Raises** ValueError for a box that is none or touches an end, and for forces inside of it
    other than those of bonds to the next site, such as damping.

    **Example:**

    >>> problem = gx.shocks.velocity_shock(gx.scenes.toda(40), 0.1)
    >>> found = gx.shocks.balances(problem, 5.0, step=0.05)
    >>> bool(abs(found.momentum_residual) < 1e-6)
    True
    """
    lattice, size = problem.lattice, problem.lattice.shape[0]
    first, last = _box(problem, box, size)
    t1 = problem.horizon() if t1 is None else t1
    if not keywords.keys() & {"step", "tolerance"}:
        keywords["step"] = (
            STEP_FRACTION / 2 / frequency_bound(lattice, problem.state, 0.0, t1, GATHERED[0])
        )
    run = problem.run(
        t1, record={"inflow": Integral(Inflow(first, last))}, confirm=True, **keywords
    )
    y = State(*run.final)
    for i, term in enumerate(lattice.terms):
        if next_neighbours(term) is None:
            force = np.asarray(term.force(run.ts[-1], y.u, y.v, lattice.mass))
            if np.any(force[first : last + 1]):
                refuse(
                    "problem",
                    "bonds to the next site alone inside of the box",
                    f"terms[{i}] ({type(term).__name__})",
                    "What it takes or gives is no flux through the ends.",
                )
    before, after = (_content(lattice, state, first, last) for state in (problem.state, y))
    found = {}
    for kind in KINDS:
        inflow, change = run.recorded["inflow"][kind], after[kind][0] - before[kind][0]
        size = before[kind][1] + after[kind][1] + jnp.abs(inflow)
        rounding = ROUNDED * jnp.finfo(change.dtype).eps * size
        found |= {
            f"{kind}_change": change,
            f"{kind}_inflow": inflow,
            f"{kind}_residual": change - inflow,
            f"{kind}_error": run.error.records["inflow"][kind] + rounding,
        }
    return Balances(**found, t1=run.ts[-1], first=first, last=last, **lattice.origin)


def _box(problem, box, size):
    """The first and the last site of the box, which have a bond on either side."""
    if box is None:
        low = max(min(int(np.asarray(problem.centre).max()) + 2, size - 3), 1)
        box = low, low + max((size - 2 - low) // 4, 1)
    if len(box) != 2 or not 1 <= box[0] < box[1] <= size - 2:
        refuse(
            "box", f"its first and its last site, rising, from 1 to {size - 2}", repr(tuple(box))
        )
    return int(box[0]), int(box[1])


def _laws(lattice, low, high):
    """The laws of the bonds from one to another, by bonds between sites, of all terms."""
    for law, boundary in filter(None, map(next_neighbours, lattice.terms)):
        shift = 1 if boundary == "fixed" else 0
        yield over_bonds(law, lattice, lambda x, by=shift: x[low + by : high + by])


def _force(lattice, u, bond):
    """The force of one bond beyond the preload."""
    e = u[bond : bond + 1] - u[bond + 1 : bond + 2]
    return sum(law.force(e)[0] for law in _laws(lattice, bond, bond + 1))


@eqx.filter_jit
def _content(lattice, y, first, last):
    """What the box holds of each kind, and the sum of the sizes of its parts."""
    u, v = y.u[first : last + 1], y.v[first : last + 1]
    mass = (
        lattice.mass if lattice.mass.ndim == len(lattice.lanes) else lattice.mass[first : last + 1]
    )
    stored = sum(law.energy(u[:-1] - u[1:]) for law in _laws(lattice, first, last))
    momentum, kinetic = mass * v, mass * v * v / 2
    return {
        "strain": (u[0] - u[-1], jnp.abs(u[0]) + jnp.abs(u[-1])),
        "momentum": (momentum.sum(0), jnp.abs(momentum).sum(0)),
        "energy": (kinetic.sum(0) + stored.sum(0), kinetic.sum(0) + jnp.abs(stored).sum(0)),
    }
