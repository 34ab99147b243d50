"""The sites of a crystal: whole cells, a rectangle, a hexagon, or those that a function selects."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...base.checks import one_of, refuse
from ...strains import WALL
from .cells import CrystalCell, Tie

OUTLINES = ("cells", "rectangle", "hexagon")
# marks an empty place inside a hole: neither a site nor a wall
VACANCY = WALL - 1


class Cut(NamedTuple):
    """The sites of a crystal and their positions.

    `number`: for each name an array over the cells and a margin: the number of the site, `WALL`
    beyond the rim, `VACANCY` in a hole.
    """

    number: dict
    positions: dict

    def count(self, name: str) -> int:
        """Return the number of sites of a name."""
        return len(self.positions[name])

    def bonds(self, tie: Tie, fixed: bool) -> tuple:
        """Return the tails and heads of all bonds of a tie.

        With `fixed`, an end beyond the rim is `WALL`.
        """
        tail = self.number[tie.tail]
        # np.roll wraps around, but only entries of the margin, which holds no sites
        head = np.roll(self.number[tie.head], [-k for k in tie.offset], range(tail.ndim))
        there = (np.maximum(tail, head) > WALL) & (np.minimum(tail, head) >= (WALL if fixed else 0))
        return tail[there], head[there]


def positions_of(cell: CrystalCell, counts: tuple, corner: Any = 0) -> dict:
    """Return the positions (cells..., 2) by name, in bond lengths."""
    index = np.moveaxis(np.indices(counts), 0, -1) + corner
    return {
        name: index @ np.array(cell.vectors) + np.array(site) for name, site in cell.sites.items()
    }


def cut(cell: CrystalCell, counts: tuple, outline: str | Callable) -> Cut:
    """Return the sites and bonds within an outline.

    `"rectangle"`: counts[1] rows of counts[0] cells; `"hexagon"`: counts[0] rings of cells around
    one; a function of positions (..., 2), in bond lengths, selects sites of a parallelogram of
    `counts` cells.
    """
    if not callable(outline):
        one_of("outline", outline, OUTLINES if len(counts) > 1 else OUTLINES[:1])
    slanted = len(cell.vectors) > 1 and abs(cell.vectors[1][0]) > 1e-9
    if outline == "hexagon":
        if not slanted:
            refuse(
                "outline",
                "'rectangle', or a function of positions",
                "'hexagon'",
                "The cells are square.",
            )
        rings = counts[0]
        counts = (2 * rings + 1, 2 * rings + 1)
        corner = (-rings, -rings)
        i, j = np.indices(counts) - rings
        kept = np.abs(i + j) <= rings
    elif outline == "rectangle":
        n, rows = counts
        back = (rows - 1) // 2 if slanted else 0
        counts = (n + back, rows)
        corner = (-back, 0)
        i, j = np.indices(counts)
        left = back - j // 2 if slanted else 0 * j
        kept = (i >= left) & (i < left + n)
    else:
        corner = (0, 0)
        kept = np.ones(counts, bool)
    number = {}
    places = {}
    for name, x in positions_of(cell, counts, corner).items():
        there = kept & _asked(outline, x) if callable(outline) else kept
        order = np.full(counts, VACANCY)
        order[there] = np.arange(there.sum())
        number[name] = np.pad(order, 1, constant_values=WALL)
        places[name] = x[there]
    if sum(map(len, places.values())) < 2:
        refuse("outline", "one that holds at least two sites", f"{sum(map(len, places.values()))}")
    _open_to_the_rim(cell, number)
    return Cut(number, places)


def _open_to_the_rim(cell, number):
    # Mark as `WALL` the empty places that bonds over empty places join to the margin.
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
