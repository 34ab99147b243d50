"""Peak contact forces of many dimer chains: a sweep over the mass ratio.

A chunk has eight lanes: one vector of float64, whose step follows its stiffest lane. All calls
share one compiled program.
"""

from functools import cache

import diffrax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.checks import refuse, within
from ..base.types import Count, Parameter, Scalar
from ..flow import Peak, simulate
from ..measures import contact_force
from ..scenes import dimer
from ..states import impact
from ..sweeps import paired, sweep

# lanes of a chunk: one vector of float64
LANES = 8


def row(argument: str, x: Parameter) -> Float[np.ndarray, " n"]:
    """Return numbers in a row as an array (n,)."""
    x = np.asarray(x, float)
    if x.ndim != 1 or not x.size:
        refuse(argument, "a list of numbers", f"shape {x.shape}", "For one number: [0.5].")
    return x


def checked_ratios(ratios: Parameter) -> Float[np.ndarray, " n"]:
    """Return mass ratios as a NumPy array (n,), each in (0, 1]."""
    remedy = "The ratio is light over heavy."
    return row("ratios", within("ratios", ratios, 0, 1, open_low=True, remedy=remedy))


def peak_forces(
    ratios: Float[np.ndarray, " n"],
    beads: Count,
    boundary: str,
    bonds: tuple[int, ...],
    t1: Scalar,
) -> Float[np.ndarray, "bonds n"]:
    """Return the largest forces (bonds, n) of some bonds until t1; NaN for incomplete runs.

    **Arguments:** `ratios` (n,), checked; `bonds`: indices into the chain's bonds.
    """
    points = paired({"ratio": ratios, "t1": np.full(len(ratios), t1)})
    return sweep(_struck(beads, boundary, bonds), points, chunk=LANES)["force"].values.T


@cache
def _struck(beads, boundary, bonds):
    def forces(t, y, lattice):
        return contact_force(lattice, y)[jnp.asarray(bonds)]

    def struck(ratio, t1):
        chain = dimer(beads, ratio, boundary=boundary)
        run = simulate(
            chain,
            impact(chain, 1.0),
            t1,
            record={"force": Peak(forces)},
            adjoint=diffrax.ForwardMode(),
        )
        return {"force": jnp.where(run.completed, run.recorded["force"], jnp.nan)}

    return struck
