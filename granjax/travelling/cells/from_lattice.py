"""The cell of a chain: what `cell_wave` asks for, from a lattice that repeats."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import refuse
from ...lattice import Lattice
from ...laws import Law
from ...profiles.medium import law_between

# relative difference of numbers that repeat
ALIKE = 1e-12


def repeated_in(lattice: Lattice) -> tuple[Law, np.ndarray, dict]:
    """The law of a cell's bonds, its masses (P,), and what a result keeps of the lattice.

    Walls and their contacts do not count. **Raises** ValueError for what is no chain of bonds to the next site, whose
    masses and bonds repeat at least twice.
    """
    wanted = "a chain of bonds between neighbours that repeats"
    law, (sites,) = law_between(lattice, wanted), lattice.sites
    rows = [np.broadcast_to(np.asarray(lattice.mass, float), sites)]
    rows += [np.asarray(x) for x in jax.tree.leaves(law) if np.ndim(x) and np.shape(x)[0] > 1]
    period = next(
        (p for p in range(1, sites // 2 + 1) if all(_repeats(row, p) for row in rows)), None
    )
    if period is None:
        refuse(
            "law", wanted, f"{sites} sites that do not", "Give the law and the masses of a cell."
        )
    return jax.tree.map(lambda x: _of_cell(x, period), law), rows[0][:period], lattice.origin


def _repeats(row, period):
    return np.allclose(row[period:], row[:-period], rtol=ALIKE, atol=0)


def _of_cell(x: Any, period):
    if not np.ndim(x):
        return x
    x = jnp.asarray(x)
    return x.reshape(-1)[0] if x.shape[0] == 1 or period == 1 else x[:period]
