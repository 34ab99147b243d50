"""The unit cells of the named lattices: vectors, sites and bonds, in bond lengths."""

from typing import NamedTuple

import numpy as np

# one half, such as half the side of an equilateral triangle of bonds
HALF = 0.5
# the height of this triangle
ROOT = np.sqrt(3.0) / 2


class Tie(NamedTuple):
    """A bond from the site `tail` of each cell to the site `head` of the cell at `offset`."""

    tail: str
    head: str
    offset: tuple[int, ...]


class CrystalCell(NamedTuple):
    """A unit cell: lattice `vectors` (axes, 2), `sites` by name, and `ties`, each once per cell.

    In space vectors and sites have three components.
    """

    vectors: tuple
    sites: dict
    ties: tuple

    @property
    def alone(self):
        """Whether the cell has one site; displacements are then a plain array."""
        return len(self.sites) == 1

    def spans(self) -> np.ndarray:
        """Return the vector from tail to head of every tie, (ties, 2 or 3)."""
        a = np.array(self.vectors)
        at = {name: np.array(x) for name, x in self.sites.items()}
        return np.array(
            [at[tie.head] + np.array(tie.offset) @ a - at[tie.tail] for tie in self.ties]
        )


def _ties(pairs, *offsets):
    # The ties of each pair of sites, two letters, to the cells at the offsets.
    return tuple(Tie(*pair, offset) for pair in pairs.split() for offset in offsets)


TRIANGULAR = CrystalCell(
    ((1.0, 0.0), (HALF, ROOT)), {"a": (0.0, 0.0)}, _ties("aa", (1, 0), (0, 1), (-1, 1))
)
SQUARE = CrystalCell(((1.0, 0.0), (0.0, 1.0)), {"a": (0.0, 0.0)}, _ties("aa", (1, 0), (0, 1)))
# the second site is at a third of the sum of the vectors
HONEYCOMB = CrystalCell(
    ((2 * ROOT, 0.0), (ROOT, 1.5)),
    {"a": (0.0, 0.0), "b": ((2 * ROOT + ROOT) / 3, 1.5 / 3)},
    _ties("ab", (0, 0)) + _ties("ba", (1, 0), (0, 1)),
)
KAGOME = CrystalCell(
    ((2.0, 0.0), (1.0, 2 * ROOT)),
    {"a": (0.0, 0.0), "b": (1.0, 0.0), "c": (HALF, ROOT)},
    _ties("ab ac bc", (0, 0)) + _ties("ba", (1, 0)) + _ties("ca", (0, 1)) + _ties("cb", (-1, 1)),
)
LIEB = CrystalCell(
    ((2.0, 0.0), (0.0, 2.0)),
    {"a": (0.0, 0.0), "b": (1.0, 0.0), "c": (0.0, 1.0)},
    _ties("ab ac", (0, 0)) + _ties("ba", (1, 0)) + _ties("ca", (0, 1)),
)
# the square of Benalcazar, Bernevig and Hughes: bonds within the cell come first
QUADRUPOLE = CrystalCell(
    LIEB.vectors,
    {**LIEB.sites, "d": (1.0, 1.0)},
    _ties("ab cd ac bd", (0, 0)) + _ties("ba dc", (1, 0)) + _ties("ca db", (0, 1)),
)
# packings of spheres in space
CUBIC = CrystalCell(
    ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    {"a": (0.0, 0.0, 0.0)},
    _ties("aa", (1, 0, 0), (0, 1, 0), (0, 0, 1)),
)
FCC = CrystalCell(
    tuple(tuple(np.sqrt(HALF) * np.array(v)) for v in ((0, 1, 1), (1, 0, 1), (1, 1, 0))),
    CUBIC.sites,
    CUBIC.ties + _ties("aa", (1, -1, 0), (0, 1, -1), (1, 0, -1)),
)
HCP = CrystalCell(
    ((1.0, 0.0, 0.0), (HALF, ROOT, 0.0), (0.0, 0.0, np.sqrt(8 / 3))),
    {"a": (0.0, 0.0, 0.0), "b": (HALF, ROOT / 3, np.sqrt(2 / 3))},
    _ties("aa bb", (1, 0, 0), (0, 1, 0), (-1, 1, 0))
    + _ties("ab", (0, 0, 0), (-1, 0, 0), (0, -1, 0), (0, 0, -1), (-1, 0, -1), (0, -1, -1)),
)
# chains, with positions in the plane
CHAIN = CrystalCell(((1.0, 0.0),), {"a": (0.0, 0.0)}, _ties("aa", (1,)))
SAWTOOTH = CrystalCell(
    CHAIN.vectors,
    {"a": (0.0, 0.0), "b": (HALF, ROOT)},
    _ties("aa", (1,)) + _ties("ab", (0,)) + _ties("ba", (1,)),
)
STUB = CrystalCell(
    ((2.0, 0.0),), LIEB.sites, _ties("ab", (0,)) + _ties("ba", (1,)) + _ties("ac", (0,))
)
DIAMOND = CrystalCell(
    ((2.0, 0.0),),
    {"a": (0.0, 0.0), "b": (1.0, 1.0), "c": (1.0, -1.0)},
    _ties("ab ac", (0,)) + _ties("ba ca", (1,)),
)
SSH = CrystalCell(
    ((2.0, 0.0),), {"a": (0.0, 0.0), "b": (1.0, 0.0)}, _ties("ab", (0,)) + _ties("ba", (1,))
)
