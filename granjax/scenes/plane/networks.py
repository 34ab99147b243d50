"""Chains of beads that meet: Y-junctions."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from ...checks import concrete, one_of, refuse, whole
from ...entry import checked
from ...lattice import Lattice
from ...laws import Law
from ...strains import Pairs
from ...terms import Bond
from ...types import Count, Parameter
from ...units import SCALED
from ..chains import _contact, _number


@checked
def junction(
    stem: Count, branches: Sequence[Count], *, angles: Sequence | None = None, mass: Parameter = 1.0,
    stiffness: Parameter = 1.0, exponent: Parameter = 1.5, precompression: Parameter = 0.0, boundary: str = "fixed",
    law: Law | None = None, units: str = SCALED,
) -> Lattice:
    r"""Y-junction: a chain of beads whose last one touches the first of each of several chains, all in guides.

    Each bead moves along its guide; u counts away from the stem's first bead. The contacts of the junction are
    e = cos(angle) u_last - u_first, so that the stem's last bead feels cos(angle) of their forces. Two equal branches
    at angle 0 are one chain with 2m and 2A.

    **Arguments:**

    - `stem`: beads of the chain that comes in; `branches`: beads of each chain that goes out.
    - `angles`: between the stem and each branch [rad], within -pi/2 ... pi/2, zero by default; 0.26 ... 0.8 in
      experiments.
    - `mass`: a number, or one per bead: the stem's, then those of each branch. `stiffness`, `exponent`,
      `precompression`: of all contacts, as in `monomer`, or `law` in their place.
    - `boundary`: `"fixed"` (walls at all ends) or `"free"`. With a static load and angles the last bead is held by its
      guide and by the stem's wall: F0 is that of the contacts of one chain, and the difference a force on that bead.

    **Returns:** a `Lattice`, u of shape (beads,), with positions in the plane; branches begin at `stem`, `stem +
    branches[0]`, ... **Raises** ValueError for fewer than two beads in the stem, one in a branch, or an angle beyond.
    Source: Daraio, Ngo, Nesterenko, Fraternali, Phys. Rev. E 82, 036603 (2010); Leonard, Ponson, Daraio, Phys. Rev. E
    86, 031305 (2012).
    """
    stem = whole("stem", stem, 2)
    counts = [whole(f"branches[{i}]", n, 1) for i, n in enumerate(branches)]
    if not counts:
        refuse("branches", "the beads of at least one branch", "none")
    turned = [0.0] * len(counts) if angles is None else list(angles)
    if len(turned) != len(counts):
        refuse("angles", f"{len(counts)}, one per branch", f"{len(turned)}")
    turned = [_number(f"angles[{i}]", a) for i, a in enumerate(turned)]
    known = [concrete(a) for a in turned]
    if any(a is not None and not np.cos(a) > 0 for a in known):
        refuse("angles", "angles within -pi/2 ... pi/2", repr(known), "A bead does not push backwards.")
    cosines = jnp.cos(jnp.stack(turned))
    one_of("boundary", boundary, ("fixed", "free"))
    law = _contact(stiffness, exponent, precompression) if law is None else law
    starts = stem + np.concatenate([[0], np.cumsum(counts)])[:-1]
    tails, heads = list(range(stem - 1)), list(range(1, stem))
    for start, n in zip(starts, counts):
        tails += range(start, start + n - 1)
        heads += range(start + 1, start + n)
    if boundary == "fixed":
        tails, heads = [-1, *tails, *(s + n - 1 for s, n in zip(starts, counts))], [0, *heads, *([-1] * len(counts))]
    total = stem + sum(counts)
    meeting = Pairs([stem - 1] * len(counts), starts, sites=total, weights=(cosines, jnp.ones(len(counts))))
    sites = None if np.ndim(mass) else total
    return Lattice(mass, (Bond(Pairs(tails, heads, sites=total), law), Bond(meeting, law)), sites=sites,
                   positions=_positions(stem, counts, np.array([0.0 if a is None else a for a in known])),
                   units=units)


def _positions(stem, counts, angles):
    """Beads of diameter 1: along x, then each branch at its angle; those at angle 0 side by side."""
    places = [np.stack([np.arange(stem), np.zeros(stem)], -1)]
    same = len(counts) > 1 and np.ptp(angles) == 0
    for i, (n, angle) in enumerate(zip(counts, angles)):
        shown = angle if not same else angle + 0.3 * (i - (len(counts) - 1) / 2)
        places.append([stem - 1, 0] + np.arange(1, n + 1)[:, None] * [np.cos(shown), np.sin(shown)])
    return np.concatenate(places)
