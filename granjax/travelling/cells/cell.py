"""The cell of a chain, from a law and masses or from a lattice that repeats."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...base.checks import positive, refuse, show
from ...base.types import Parameter, Scalar
from ...lattice import Lattice
from ...laws import Law
from ...profiles.fourier import Chain
from ...profiles.medium import in_float64, law_between, values
from .resonator import Resonator

# The relative difference below which two numbers are equal.
ALIKE = 1e-12


def repeated_in(lattice: Lattice) -> tuple[Law, np.ndarray, dict]:
    """Return the law of a cell's bonds, its masses (P,), and the metadata of the lattice.

    Walls and their contacts are ignored. **Raises** ValueError unless the lattice is a chain of
    bonds to the next site whose masses and bonds repeat at least twice.
    """
    wanted = "a chain of bonds between neighbours that repeats"
    law = law_between(lattice, wanted)
    (sites,) = lattice.sites
    masses = np.broadcast_to(np.asarray(lattice.mass, float), sites)
    period = _period(masses, *(np.ravel(x) for x in jax.tree.leaves(law) if np.size(x) > 1))
    if period is None:
        refuse(
            "law", wanted, f"{sites} sites that do not", "Give the law and the masses of a cell."
        )
    cut = lambda x: jnp.ravel(x)[:period] if np.size(x) > 1 else x
    return jax.tree.map(cut, law), masses[:period], lattice.origin


def chain_of(
    law: Law, masses: Parameter, speed: Scalar, resonator: Resonator | None = None
) -> Chain:
    """Build the chain of a law and a cell's masses, with its smallest period and its mirror."""
    in_float64()
    masses = np.atleast_1d(np.asarray(positive("masses", masses), float))
    if masses.ndim != 1:
        refuse(
            "masses",
            "one row of masses, those of a cell",
            f"shape {masses.shape}",
            "One wave at a time.",
        )
    P = len(masses)
    wrong = [np.shape(x) for x in jax.tree.leaves(law) if np.shape(x) not in ((), (1,), (P,))]
    if wrong:
        refuse(
            "law",
            f"parameters that are numbers or one per bond of the cell, ({P},)",
            f"shape {wrong[0]}",
            "One wave at a time.",
        )
    rows = [np.resize(x, P) for x in jax.tree.leaves(law)]
    period = _period(np.tile(masses, 2), *(np.tile(row, 2) for row in rows))
    masses = masses[:period]
    own = np.arange(period)
    laws = tuple(jax.tree.map(lambda x: jnp.resize(jnp.asarray(x), P)[j], law) for j in own)
    stiffness = np.array([values(one, np.zeros(1))[1][0] for one in laws])
    stiff = stiffness > 0
    if not (np.isfinite(stiffness).all() and (stiffness >= 0).all() and stiff.all() == stiff.any()):
        refuse(
            "law",
            "a stiffness at rest that is finite, above zero at all bonds or zero at all",
            show(stiffness),
        )
    mirrored = lambda s: (
        _alike(masses, masses[(s - own) % period])
        and all(_alike(row[:period], row[(s - 1 - own) % period]) for row in rows)
    )
    mass = masses.mean()
    attached = None
    if resonator is not None:
        attached = float(resonator.mass) / mass, float(resonator.stiffness)
    return Chain(
        laws,
        masses / mass,
        masses,
        mass * speed**2,
        stiffness,
        attached,
        next(filter(mirrored, range(period)), None),
    )


def _period(*rows: Any) -> int | None:
    # Return the least common period, at most half of the first row; `None` without one.
    shorter = range(1, len(rows[0]) // 2 + 1)
    return next((p for p in shorter if all(_alike(row[p:], row[:-p]) for row in rows)), None)


def _alike(one, other):
    return np.allclose(one, other, rtol=ALIKE, atol=0)
