"""Flat bands, whose omega does not depend on k, and their compact localised states."""

from itertools import product

import jax.numpy as jnp
import numpy as np
import scipy

from ..base.checks import refuse
from ..base.types import AnyArray, Cell, Count, Numbers
from ..lattice import Lattice, State
from ..results import Result, array, note
from .cell import UnitCell, by_sites, matrices, unit_cell
from .modes import signed_root
from .stiffness import grid, mesh, unpack

# the variation of a flat band, relative to the largest omega^2
FLAT = 1e-12
# the most cells of a compact state along each axis
WIDEST = 4
# the samples of the zone along each axis, for one, two and three axes
MESH = {1: 48, 2: 12, 3: 6}


class FlatBands(Result):
    """The flat bands of a lattice, and a compact `state(lattice, number)` of each frequency."""

    omega: Numbers = array("The frequency of each flat band.", "rad/s", "flat")
    omega_squared: Numbers = array("omega^2 of each flat band.", "rad^2/s^2", "flat")
    width: Numbers = array("The variation of omega^2 over the zone.", "rad^2/s^2", "flat")
    degeneracy: AnyArray = array("The number of flat bands at each frequency.", axes="flat")
    support: AnyArray = array(
        "The number of degrees of freedom where the compact state is not zero.", axes="flat"
    )
    residual: Numbers = array(
        "The residual of (D - omega^2) q = 0, relative to the largest omega^2.", "1", "flat"
    )
    _states: tuple
    cell: tuple[int, ...] = note("The number of sites per cell along each axis.", static=True)

    @property
    def outcome(self) -> str:
        """The flat bands, and the size of their compact states."""
        if not len(self.omega):
            return "No band is flat."
        what = "degrees of freedom" if self._space[1] > 1 else "sites"
        told = ", ".join(
            f"{self._told('omega', w)} (on {n} {what})" for w, n in zip(self.omega, self.support)
        )
        count = int(np.sum(self.degeneracy))
        return f"{count} flat band{'s' * (count > 1)}: omega = {told}."

    def state(self, lattice: Lattice, number: Count = 0, at: Cell = None) -> State:
        """Return the compact state of one frequency, at rest, with largest displacement 1.

        **Arguments:** `lattice`: that of the bands, or a longer one; `number`: index into `omega`;
        `at`: the cell where it begins, `None` for the middle. **Raises** ValueError where it does
        not fit.
        """
        count = len(self._states)
        if not -count <= number < count:
            refuse("number", f"one of {count} flat bands" if count else "a flat band", repr(number))
        sizes = grid(lattice)
        found = self._states[number]
        axes = len(self.cell)
        counts = found.shape[:axes]
        cells = tuple(n // c for n, c in zip(sizes, self.cell))
        at = np.subtract(cells, counts) // 2 if at is None else at
        at = tuple(map(int, np.broadcast_to(at, axes)))
        if any(not 0 <= a <= n - m for a, n, m in zip(at, cells, counts)):
            refuse("at", f"a cell from which {counts} cells lie within {cells}", f"{at}")
        block = np.asarray(by_sites(found, axes))
        u = np.zeros(sizes + (found.shape[-1],))
        u[tuple(slice(a * c, a * c + n) for a, c, n in zip(at, self.cell, block.shape))] = block
        u = jnp.asarray(u / np.abs(u).max(), lattice.dtype)
        return State(unpack(u, lattice.fields, lattice.dimension), lattice.zeros())


def flat_bands(lattice: Lattice) -> FlatBands:
    r"""Find the flat bands of a lattice and their compact localised states.

    A band is flat where omega^2 varies over the zone by rounding alone. Its compact state is sought
    on 1 to 4 cells along each axis, as a null vector of (D - omega^2) q = 0 at all sites that it
    touches, so that its neighbours feel no force. Of states on equally few cells the sparsest
    is returned.

    **Returns:** `FlatBands`, empty where no band is flat. `.state(lattice)` is an initial state.
    **Raises** ValueError where `unit_cell` does, and where no compact state is found.
    Source: Leykam, Andreanov, Flach, Advances in Physics: X 3, 1473052 (2018); Maimaiti, Andreanov,
    Park, Gendelman, Flach, Phys. Rev. B 95, 115135 (2017).

    **Example:**

    >>> found = gx.linear.flat_bands(gx.scenes.stub(6, boundary="periodic"))
    >>> print(found.omega.round(4))
    [1.7321]
    """
    found = unit_cell(lattice)
    axes = len(found.cell)
    line = 2 * np.pi * (np.arange(MESH[axes]) + 0.3) / MESH[axes]
    k = mesh(*[line] * axes).reshape(-1, axes)
    squared = np.linalg.eigvalsh(matrices(found.dynamical_matrix, k))
    scale = np.abs(squared).max() or 1.0
    width = np.ptp(squared, axis=0)
    flat = np.flatnonzero(width <= FLAT * scale)
    mean = squared[:, flat].mean(0)
    groups = np.split(flat, np.flatnonzero(np.diff(mean) > FLAT * scale) + 1) if len(flat) else []
    values = squared.mean(0)[[group[0] for group in groups]]
    compact = [_compact(found, value, scale) for value in values]
    states, residual = zip(*compact) if compact else ((), ())
    support = [np.count_nonzero(np.abs(s) > 1e-9 * np.abs(s).max()) for s in states]
    return FlatBands(
        np.asarray(signed_root(values, scale, squared.shape[1])),
        values,
        np.array([width[g].max() for g in groups]),
        np.array([len(g) for g in groups], int),
        np.array(support, int),
        np.array(residual),
        tuple(states),
        found.cell,
        **lattice.origin,
    )


def _compact(found: UnitCell, squared: float, scale: float) -> tuple:
    # displacements on as few cells as possible, and the residual
    axes = len(found.cell)
    size = found.mass.size
    blocks = dict(zip(found.shells, np.asarray(found.coupling)))
    blocks[(0,) * axes] = blocks[(0,) * axes] - squared * np.eye(size)
    none = np.zeros((size, size))
    for counts in sorted(
        product(range(1, WIDEST + 1), repeat=axes), key=lambda c: (np.prod(c), max(c), c)
    ):
        places = list(np.ndindex(counts))
        # all cells on which the state exerts a force
        touched = {tuple(np.subtract(place, R)) for place in places for R in found.shells}
        equations = np.block(
            [
                [blocks.get(tuple(np.subtract(place, cell)), none) for place in places]
                for cell in sorted(touched)
            ]
        )
        null = scipy.linalg.null_space(equations, rcond=1e-10)
        if null.shape[1]:
            q = _sparsest(null)
            left = np.abs(equations @ q).max() / (scale * np.abs(q).max())
            u = q.reshape(*counts, size) / np.sqrt(np.asarray(found.mass))
            width = size // int(np.prod(found.cell))
            return u.reshape(*counts, *found.cell, width), left
    refuse(
        "lattice",
        f"flat bands whose compact states live on at most {WIDEST} cells along each axis",
        "one whose state was not found",
        "A band that is flat only by accident of the mesh has none.",
    )


def _sparsest(null):
    # a null vector with as many zeros as possible; rounding is set to exact zeros
    # reduced echelon form: in each pivot row all vectors but one are zero
    pivots = scipy.linalg.qr(null.T, pivoting=True)[2][: null.shape[1]]
    rows = null @ np.linalg.inv(null[pivots])
    rows = np.where(np.abs(rows) < 1e-10 * np.abs(rows).max(0), 0, rows)
    q = rows[:, np.argmin(np.count_nonzero(rows, axis=0))]
    # make the first of the largest entries positive
    return q * np.sign(q[np.argmax(np.abs(q).round(9))]) + 0.0
