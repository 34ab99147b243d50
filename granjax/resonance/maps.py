"""Decay of a pulse in uncompressed chains of larger cells, over two parameters of the cell."""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.checks import described, one_of, positive, refuse, whole
from ..base.types import Parameter
from ..flow import Peak, simulate
from ..lattice import Lattice
from ..laws import Hertz
from ..measures import contact_force
from ..results import Result, array, note
from ..states import impact
from ..strains import Shift
from ..sweeps import paired, sweep
from ..terms import Bond
from .lanes import LANES, row

# beads behind the last cell that is read
MARGIN = 12
# the longest time of a pulse per bead
PACE = 1.4
# the time in which the force of the pulse rises and falls
PASSING = 6.0
KINDS = ("1:1", "2:1", "3:1", "4:1", "5:1", "trimer")


def _mixed(alike):
    def cell(ratio, stiffness):
        return [1.0] * alike + [ratio], [1.0] * (alike - 1) + [stiffness, stiffness]

    return cell


def _trimer(second, third):
    return [1.0, second, third], [1.0] * 3


class ResonanceMap(Result):
    """The result of `resonance_map`."""

    first: Float[np.ndarray, " first"] = array("The values of the first parameter.", "1")
    second: Float[np.ndarray, " second"] = array("The values of the second parameter.", "1")
    rate: Float[np.ndarray, "first second"] = array(
        "The decay rate of the leading pulse per cell; 0 if it travels without loss, NaN"
        " if a run failed.",
        "1",
    )
    force: Float[np.ndarray, "first second"] = array(
        "The largest contact force of the pulse in the last of the cells.", "A^(2/5) (m v^2)^(3/5)"
    )
    kind: str = note("The kind of the chain.", static=True)
    cells: tuple[int, int] = note("The cells between which the decay was read.", static=True)

    @property
    def outcome(self) -> str:
        lost = np.count_nonzero(np.isnan(self.rate))
        if lost == self.rate.size:
            return "No run completed."
        i, j = np.unravel_index(np.nanargmin(self.rate), self.rate.shape)
        k, m = np.unravel_index(np.nanargmax(self.rate), self.rate.shape)
        failed = f" {lost} runs failed." if lost else ""
        return (
            f"{self.rate.size} chains ({self.kind}): the pulse decays least, by {self.rate[i, j]:.2g} a cell, at "
            f"({self.first[i]:.4g}, {self.second[j]:.4g}); most, by {self.rate[k, m]:.2g}, at "
            f"({self.first[k]:.4g}, {self.second[m]:.4g}).{failed}"
        )


Cell = Callable[[Any, Any], Any]


def resonance_map(
    kind: str | Cell,
    first: Parameter,
    second: Parameter,
    *,
    cells: tuple[int, int] = (8, 20),
) -> ResonanceMap:
    r"""Compute the decay rate of the leading pulse over two parameters of the chain's cell.

    The chains have Hertz contacts without precompression and free ends; the first bead is struck
    with v = 1. The rate is -ln(F_b/F_a)/(b - a), where F is the largest force of the first contact
    of the cells a and b until 1.4 n + 6 for contact n [units of (m^2/(A^2 v))^{1/5}]. If the
    leading pulse decays fast, F is that of the one behind it, which may grow (a rate below zero).
    The rate is zero without loss, as at anti-resonances of dimers; larger cells come close only at
    special values of both parameters.

    **Arguments:**

    - `kind`: `"1:1"`, `"2:1"` ... `"5:1"`: that many beads of mass 1, then one of mass `ratio`
      (first parameter), whose two contacts have `stiffness` (second) relative to the others;
      `"trimer"`: masses 1, `first`, `second`, equal contacts. Or a function of two numbers that
      returns masses (P,) and stiffnesses (P,) of the contacts behind them, with largest mass 1.
    - `first` (p,), `second` (q,): values of the parameters, above zero.
    - `cells`: (a, b), a < b; further down the chain is closer to the limit.

    Fixed steps with h omega_max = 1/2, eight chains at a time, on every core: rates are good to
    about 4e-6.

    **Returns:** `ResonanceMap`. **Raises** ValueError for another kind, values not above zero,
    cells that are no such pair.
    Source: Jayaprakash, Starosvetsky, Vakakis, Phys. Rev. E 83, 036606 (2011), and the review's
    references for N:1.

    **Example:**

    >>> record = gx.resonance.resonance_map("2:1", [0.5, 1.0], [1.0], cells=(2, 4))
    >>> bool(abs(record.rate[1, 0]) < 0.01)  # a monomer
    True
    """
    if not callable(kind):
        one_of("kind", kind, KINDS)
    make = kind if callable(kind) else _trimer if kind == "trimer" else _mixed(int(kind[0]))
    first = row("first", positive("first", first))
    second = row("second", positive("second", second))
    pair = [whole(f"cells[{i}]", n, 0) for i, n in enumerate(np.atleast_1d(cells).tolist())]
    if len(pair) != 2 or not pair[0] < pair[1]:
        refuse("cells", "two cells (a, b), a < b", repr(cells), "Typical: (8, 20).")
    a, b = pair
    made = [_cell(make, p, q) for p in first for q in second]
    P = len(made[0][0])
    if any(len(masses) != P for masses, _ in made):
        refuse(
            "kind", "cells of one size", "cells of several", "Their sizes are that of the program."
        )
    masses, stiffness = (np.array(x) for x in zip(*made))
    # with the same end for all runs, one loop serves many lanes
    until = float(_slow(masses.T, stiffness.T).max()) * (PACE * P * b + PASSING)
    lanes = {f"mass_{i}": x for i, x in enumerate(masses.T)} | {
        f"stiffness_{i}": x for i, x in enumerate(stiffness.T)
    }
    points = paired(lanes | {"until": np.full(len(masses), until)})
    found = sweep(_pulse(P, (b + 1) * P + MARGIN, P * a, P * b), points, chunk=LANES)
    forces = found["forces"].values.T
    shape = len(first), len(second)
    rate = -np.log(forces[1] / forces[0]) / (b - a)
    told = kind if isinstance(kind, str) else getattr(kind, "__name__", "a user-defined cell")
    return ResonanceMap(first, second, rate.reshape(shape), forces[1].reshape(shape), told, (a, b))


def _cell(make, p, q):
    found = make(float(p), float(q))
    if not isinstance(found, tuple) or len(found) != 2:
        refuse(
            "kind",
            "a function that gives (masses, stiffnesses)",
            f"one that gives {described(found)}",
        )
    masses, stiffness = (np.atleast_1d(np.asarray(positive("kind", x), float)) for x in found)
    if masses.ndim != 1 or masses.shape != stiffness.shape:
        refuse(
            "kind", "as many stiffnesses as masses", f"shapes {masses.shape} and {stiffness.shape}"
        )
    return masses, stiffness


def _slow(masses, stiffness):
    # Return the most that a pulse is slower than in equal beads, m = A = 1; cells on axis 0.
    return jnp.maximum((masses.max(0) / stiffness.min(0)) ** 0.4, 1.0)


@cache
def _pulse(P, beads, *contacts):
    def leading(t, y, lattice):
        # forces long after the leading pulse do not count
        slow = _slow(lattice.mass, lattice.terms[0].law.stiffness)
        force = contact_force(lattice, y)
        return jnp.stack(
            [jnp.where(t <= slow * (PACE * n + PASSING), force[n], 0.0) for n in contacts]
        )

    def pulse(p):
        masses, stiffness = (
            jnp.stack([p[f"{name}_{i}"] for i in range(P)]) for name in ("mass", "stiffness")
        )
        along = jnp.arange(beads) % P
        lattice = Lattice(masses[along], Bond(Shift(1, "free"), Hertz(stiffness[along[:-1]])))
        run = simulate(lattice, impact(lattice), p["until"], record={"peak": Peak(leading)})
        return {"forces": run.recorded["peak"]}

    return pulse
