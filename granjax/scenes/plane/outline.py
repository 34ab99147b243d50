"""Which sites of a crystal are there: whole cells, a rectangle, a hexagon, or whatever a function says."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...checks import one_of, refuse
from ...strains import WALL
from .cells import CrystalCell, Tie

OUTLINES = ("cells", "rectangle", "hexagon")
# a place without a site within a hole: nothing is there, no wall either
VACANCY = WALL - 1


class Cut(NamedTuple):
    """The sites that are there, over cells with a margin, and their positions.

    `number`: for each name the number of a site, `WALL` beyond the rim and `VACANCY` in a hole.
    """

    number: dict
    positions: dict

    def count(self, name: str) -> int:
        """How many sites of a name there are."""
        return len(self.positions[name])

    def bonds(self, tie: Tie, fixed: bool) -> tuple:
        """Indices of the tails and heads of one tie of all cells; `WALL` for one beyond the rim, where it is fixed."""
        tail = self.number[tie.tail]
        # nothing is there in the margin, so that what comes around is nothing
        head = np.roll(self.number[tie.head], [-k for k in tie.offset], range(tail.ndim))
        there = (np.maximum(tail, head) > WALL) & (np.minimum(tail, head) >= (WALL if fixed else 0))
        return tail[there], head[there]


def positions_of(cell: CrystalCell, counts: tuple, corner: Any = 0) -> dict:
    """Places of the sites of a parallelogram of cells, by name: (cells..., 2), in lengths of a bond."""
    index = np.moveaxis(np.indices(counts), 0, -1) + corner
    return {
        name: index @ np.array(cell.vectors) + np.array(site) for name, site in cell.sites.items()
    }


def cut(cell: CrystalCell, counts: tuple, outline: str | Callable) -> Cut:
    """The crystal within an outline, as a graph.

    "rectangle": counts[0] cells in each of counts[1] rows; "hexagon": counts[0] rings of cells around one; a function
    of positions (..., 2), in lengths of a bond, is asked for each site of a parallelogram of `counts` cells.
    """
    if not callable(outline):
        one_of("outline", outline, OUTLINES if len(counts) > 1 else OUTLINES[:1])
    slanted = abs(cell.vectors[1][0]) > 1e-9 if len(cell.vectors) > 1 else False
    if outline == "hexagon":
        if not slanted:
            refuse(
                "outline",
                "'rectangle', or a function of positions",
                "'hexagon'",
                "The cells are square.",
            )
        rings = counts[0]
        counts, corner = (2 * rings + 1, 2 * rings + 1), (-rings, -rings)
        i, j = np.indices(counts) - rings
        kept = np.abs(i + j) <= rings
    elif outline == "rectangle":
        n, rows = counts
        back = (rows - 1) // 2 if slanted else 0
        counts, corner = (n + back, rows), (-back, 0)
        i, j = np.indices(counts)
        left = back - j // 2 if slanted else 0 * j
        kept = (i >= left) & (i < left + n)
    else:
        corner, kept = (0, 0), np.ones(counts, bool)
    number, places = {}, {}
    for name, x in positions_of(cell, counts, corner).items():
        there = kept & _asked(outline, x) if callable(outline) else kept
        order = np.full(counts, VACANCY)
        order[there] = np.arange(there.sum())
        number[name], places[name] = np.pad(order, 1, constant_values=WALL), x[there]
    if sum(map(len, places.values())) < 2:
        refuse("outline", "one that holds at least two sites", f"{sum(map(len, places.values()))}")
    _open_to_the_rim(cell, number)
    return Cut(number, places)


def _open_to_the_rim(cell, number):
    """Mark as `WALL` what the margin reaches from bond to bond over places without a site: the rest are holes."""
    ends = [(number[tie.tail], number[tie.head], [-k for k in tie.offset]) for tie in cell.ties]
    grown = True
    while grown:
        grown = False
        for tail, head, offset in ends:
            there = np.roll(head, offset, range(tail.ndim))
            reached = (np.maximum(tail, there) == WALL) & (np.minimum(tail, there) == VACANCY)
            grown |= bool(reached.any())
            tail[reached] = WALL
            head[np.roll(reached, [-k for k in offset], range(tail.ndim))] = WALL


def _asked(outline, x):
    inside = np.asarray(outline(x))
    if inside.shape != x.shape[:-1] or inside.dtype != bool:
        refuse(
            "outline",
            f"a function from positions (..., 2) to whether they are inside, of shape {x.shape[:-1]}",
            f"{inside.dtype} of shape {inside.shape}",
            "Write lambda x: numpy.hypot(x[..., 0], x[..., 1]) < 10.",
        )
    return inside
