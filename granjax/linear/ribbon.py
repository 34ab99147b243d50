"""Strips of a two-dimensional lattice: their bands, and which waves run along an edge."""

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import described, is_whole, parameter, refuse, whole
from ..base.programs import compiled
from ..base.types import ComplexNumbers, Count, Numbers, Parameter
from ..lattice import Lattice
from ..results import Result, array, note
from .cell import blocks_of, by_lanes, cut_out, in_lanes
from .modes import signed_root
from .stiffness import grid, or_one, turning_at_rest

# waves whose omega^2 differ by less than this part of the largest |D| are combined, since they beat
# over 10^4 periods
TOGETHER = 1e-4
# the next waves in the spectrum must be further away by this factor
ALONE = 100
# a difference below this part of the largest |D| is rounding: such waves are always combined
EQUAL = 1e-10


class RibbonBands(Result):
    """Bands of a strip, periodic along one axis and with its own ends along the other.

    Nearly degenerate waves, such as those at the two edges of a symmetric strip, are combined into
    the eigenvectors of the position across it: where their omega^2 differ by less than 1e-4 of the
    largest |D| and a hundredth of their distance to the next waves. Such `modes` miss (D - omega^2)
    q = 0 by no more than that difference; they beat over more than 10^4 periods.
    """

    k: Numbers = array("The phase per cell along the strip.", "rad", "wave")
    omega: Numbers = array("The frequencies.", "rad/s", "wave band")
    omega_squared: Numbers = array("omega^2.", "rad^2/s^2", "wave band")
    modes: ComplexNumbers | dict[str, ComplexNumbers] = array(
        "Bloch vectors over the width, normalised with the masses.", axes="wave across ... band"
    )
    edge: Numbers = array(
        "The mean position of the kinetic energy across the strip, from -1 (all at the first "
        "site) to 1 (the last).",
        axes="wave band",
    )
    participation: Numbers = array(
        "The number of sites across the strip over which the wave is spread, (sum e)^2/sum e^2.",
        axes="wave band",
    )
    axis: int = note("The axis along which the strip runs.", static=True)
    width: int = note("The number of sites across the strip.", static=True)

    @property
    def outcome(self) -> str:
        """The number of bands, and how many are bound to a place across the strip."""
        within = (by_lanes(self, self.participation) < 0.2 * self.width).any(1)
        _, waves, bands = by_lanes(self, self.omega).shape
        return (
            f"{bands} bands at {waves} wave numbers{in_lanes(self)}; {int(within.sum())} within a fifth of the width "
            "at some of them."
        )


def ribbon(
    lattice: Lattice,
    k: Parameter | None = None,
    *,
    axis: Count | None = None,
    cell: Count | None = None,
) -> RibbonBands:
    r"""Compute the bands of a strip: waves exp(ikR) along one axis of a two-dimensional lattice.

    Damping is left out, as in `dispersion`.

    **Arguments:**

    - `lattice`: one `Lattice` on a grid of two axes, such as `gx.scenes.honeycomb(6, 30,
      boundary=("periodic", "free"))`. The strip has its width and its ends, with any disorder,
      walls, or interface of two phases.
    - `k`: phases per cell along the strip (K,) [rad]; `None` for 121 of the whole zone.
    - `axis`: along the strip, `None` for the periodic one. `cell`: sites per cell along it, `None`
      for the fewest.

    **Returns:** `RibbonBands`, for `gx.plots.bands`. Differentiable between crossings.
    **Raises** ValueError for another kind of lattice, and where `unit_cell` does.

    **Example:**

    >>> strip = gx.scenes.honeycomb(4, 6, out_of_plane=True, boundary=("periodic", "free"))
    >>> found = gx.linear.ribbon(strip, [np.pi])
    >>> found.omega.shape, round(float(abs(found.edge).max()), 3)  # an edge mode
    ((1, 12), 1.0)
    """
    lattice, turns = turning_at_rest(lattice)
    sites = grid(lattice)
    if len(sites) != 2:
        refuse(
            "lattice",
            "a lattice of two axes",
            f"one of {len(sites)}",
            "gx.linear.dispersion is for chains.",
        )
    blocks = blocks_of(lattice, damped=turns)
    rings = blocks.rings
    if axis is None:
        axis = 0 if rings[0] else 1
    elif not is_whole(axis) or axis not in (0, 1):
        refuse("axis", "0 or 1, or None for the periodic one", described(axis))
    across = 1 - axis
    if rings[across] or not rings[axis]:
        refuse(
            "lattice",
            f"a ring along axis {axis}, the strip's, and ends along axis {across}, across it",
            f"a ring along axis {across}" if rings[across] else f"ends along axis {axis}",
            "One axis alone is to be periodic: boundary=('periodic', 'free').",
        )
    # the cell spans the whole width
    sizes = [sites[across], None if cell is None else whole("cell", cell, 1)]
    found = cut_out(lattice, blocks, tuple(sizes if across == 0 else sizes[::-1]), [True, True])
    given = 2 * np.pi * np.arange(121) / 120 - np.pi if k is None else parameter("k", k)
    if np.ndim(given) != 1 or not np.size(given):
        refuse("k", "phases along the strip, (K,)", f"shape {np.shape(given)}")
    squared, omega, q, edge, participation = _solved(
        found, jnp.asarray(given, found.mass.dtype), axis
    )
    modes = found.displacements(q)
    if found.cell[axis] == 1:
        modes = jax.tree.map(lambda x: jnp.squeeze(x, 1 + axis), modes)
    return RibbonBands(
        jnp.asarray(given),
        omega,
        squared,
        modes,
        edge,
        participation,
        axis,
        found.cell[across],
        **lattice.origin,
    )


@compiled
def _solved(found, k, axis):
    # omega^2, omega, vectors, and the mean place and the participation of the kinetic energy
    place = np.linspace(-1, 1, found.cell[1 - axis])
    of_site = place[np.indices(found.cell)[1 - axis].ravel()]
    of_each = np.repeat(of_site, found.mass.size // len(of_site))

    def one(k):
        k = jnp.zeros(2, k.dtype).at[axis].set(k)
        squared, q = found.waves(k)
        scale = jnp.abs(found.dynamical_matrix(k)).max()
        q = _apart(squared / or_one(scale), q, of_each)
        share = (jnp.abs(q) ** 2).reshape(*found.cell, -1, squared.size).sum((axis, 2))
        spread = share.sum(0) ** 2 / (share**2).sum(0)
        return squared, signed_root(squared, scale, squared.size), q, place @ share, spread

    return jax.lax.map(one, k, batch_size=16)


def _apart(squared, q, place):
    # nearly degenerate vectors are combined into eigenvectors of the position
    step = jnp.diff(squared)
    beside = jnp.concatenate([jnp.full(1, jnp.inf), step, jnp.full(1, jnp.inf)])
    alone = ALONE * step <= jnp.minimum(beside[:-2], beside[2:])
    together = (step <= max(EQUAL, 64 * jnp.finfo(step.dtype).eps)) | (alone & (step <= TOGETHER))
    group = jnp.concatenate([jnp.zeros(1), jnp.cumsum(~together)])
    same = group[:, None] == group
    # places are within (-1, 1), so that shifts of 3 keep the groups apart and in order
    own = jnp.where(same, q.conj().T @ (place[:, None] * q), 0) + 3 * jnp.diag(group)
    turn = jax.lax.stop_gradient(jnp.where(same, jnp.linalg.eigh(own)[1], 0))
    return jnp.where(same.sum(0) > 1, q @ turn, q)
