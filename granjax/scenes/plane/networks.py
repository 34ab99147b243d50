"""Chains of beads in guides that meet: Y-junctions, and networks in the plane or in space."""

from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from ...base.checks import concrete, known_value, one_of, parameter, refuse, several, whole
from ...base.types import Count, Parameter
from ...base.units import SCALED
from ...lattice import Lattice
from ...laws import Law
from ...strains import WALL, Pairs
from ...terms import Bond
from ..chains import contact, number

# a cosine below this counts as that of a right angle
SQUARE_ON = 1e-9


def _guided(tail, head, direction, counts, laws: Callable, mass, positions, boundary, units):
    meetings, weights, begin, end = _meet(tail, head, direction)
    last = np.cumsum(counts) - 1
    first = last + 1 - counts
    rows = [(n, n + 1, i) for i in range(len(counts)) for n in range(first[i], last[i])]
    if one_of("boundary", boundary, ("fixed", "free")) == "fixed":
        rows = [(WALL, first[i], i) for i in begin] + rows + [(last[i], WALL, i) for i in end]
    total = int(last[-1]) + 1
    terms = []
    if rows:
        tails, heads, guides = (list(map(int, column)) for column in zip(*rows))
        terms.append(Bond(Pairs(tails, heads, sites=total), laws(guides)))
    if meetings:
        come, leave, guides = (list(column) for column in zip(*meetings))
        pairs = Pairs(last[come], first[leave], sites=total, weights=weights)
        terms.append(Bond(pairs, laws(guides)))
    return Lattice(mass, terms, sites=total, positions=positions, units=units)


def junction(
    stem: Count,
    branches: Sequence[Count],
    *,
    angles: Sequence | None = None,
    mass: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    exponent: Parameter = 1.5,
    precompression: Parameter = 0.0,
    boundary: str = "fixed",
    law: Law | None = None,
    units: str = SCALED,
) -> Lattice:
    r"""Build a Y-junction: a chain of beads in a guide that splits into several chains.

    The last bead of the stem touches the first of each branch. Each bead moves along its guide, u
    pointing away from the stem's first bead. At the junction e = cos(angle) u_last - u_first, so
    the last bead feels cos(angle) of the force. Two equal branches at angle 0 are one chain with 2m
    and 2A.

    **Arguments:**

    - `stem`: beads of the incoming chain; `branches`: beads of each outgoing chain.
    - `angles`: between the stem and each branch [rad], within -pi/2 ... pi/2, zero by default;
      0.26 ... 0.8 in experiments.
    - `mass`: a number, or one per bead: the stem's, then those of each branch. `stiffness`,
      `exponent`, `precompression`: of all contacts, as in `monomer`; or a `law` in their place.
    - `boundary`: `"fixed"` (walls at all ends) or `"free"`. F0 is the static force of each contact;
      a constant force on the stem's last bead makes up the difference.

    **Returns:** a `Lattice`, u of shape (beads,), with positions in the plane; the branches begin
    at `stem`, `stem + branches[0]`, ...
    **Raises** ValueError for a stem of fewer than two beads, an empty branch, or an angle out of
    range.
    Source: Daraio, Ngo, Nesterenko, Fraternali, Phys. Rev. E 82, 036603 (2010); Leonard, Ponson,
    Daraio, Phys. Rev. E 86, 031305 (2012).
    """
    stem = whole("stem", stem, 2)
    branches = several("branches", branches, "numbers of beads, one per branch")
    counts = [whole(f"branches[{i}]", n, 1) for i, n in enumerate(branches)]
    turned = [0.0] * len(counts) if angles is None else angles
    turned = several("angles", turned, f"{len(counts)}, one per branch")
    if len(turned) != len(counts):
        refuse("angles", f"{len(counts)}, one per branch", f"{len(turned)}")
    turned = [number(f"angles[{i}]", a) for i, a in enumerate(turned)]
    known = [concrete(a) for a in turned]
    if any(a is not None and not np.cos(a) > 0 for a in known):
        remedy = "A bead does not push backwards."
        refuse("angles", "angles within -pi/2 ... pi/2", repr(known), remedy)
    law = contact(stiffness, exponent, precompression) if law is None else law
    angle = jnp.stack([jnp.zeros(()), *turned])
    direction = jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
    tail = np.minimum(np.arange(len(angle)), 1)
    head = np.arange(len(angle)) + 1
    places = _positions(stem, counts, np.array([0.0 if a is None else a for a in known]))
    guides = tail, head, direction, [stem, *counts]
    return _guided(*guides, lambda _: law, mass, places, boundary, units)


def _positions(stem, counts, angles):
    places = [np.stack([np.arange(stem), np.zeros(stem)], -1)]
    same = len(counts) > 1 and np.ptp(angles) == 0
    for i, (n, angle) in enumerate(zip(counts, angles)):
        shown = angle if not same else angle + 0.3 * (i - (len(counts) - 1) / 2)
        places.append([stem - 1, 0] + np.arange(1, n + 1)[:, None] * [np.cos(shown), np.sin(shown)])
    return np.concatenate(places)


def network(
    nodes: Parameter | dict[str, Parameter],
    edges: Sequence,
    beads: Count | Sequence[Count] = 10,
    *,
    mass: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    exponent: Parameter = 1.5,
    precompression: Parameter = 0.0,
    boundary: str = "fixed",
    law: Law | None = None,
    units: str = SCALED,
) -> Lattice:
    r"""Build a network: chains of beads in straight guides between nodes in the plane or in space.

    Each bead moves along its guide; u counts from the guide's tail to its head. At a node the last
    bead of each incoming guide touches the first bead of each outgoing guide within 90 degrees of
    its direction: e = n . (d_in u_last - d_out u_first), with the directions d of the guides and
    the normal n of the contact.

    - One incoming guide: its last bead lies at the node, n = d_out, e = cos(angle)
      u_last - u_first, as in `junction`.
    - Several incoming guides, one outgoing: its first bead lies at the node, n = d_in, e =
      u_last - cos(angle) u_first.
    - Several of both: n halves the angle.

    At 90 degrees beads do not touch: a rigid contact passes no force on at first order.

    **Arguments:**

    - `nodes`: positions (nodes, 2) or (nodes, 3) [m], or a dict of them. `edges`: guides, pairs
      (tail, head) of numbers or names of nodes. `beads` in each guide: one number or one per guide.
    - `mass`: a number, one per guide, or one per bead, guide by guide. `stiffness`, `exponent`,
      `precompression`: as in `monomer`, the first and the last a number or one per guide. A contact
      at a node takes those of the guide along its normal, or of the outgoing guide where several
      meet several. `law`: a law of all contacts in their place.
    - `boundary`: `"fixed"` (walls at nodes where guides only begin or only end) or `"free"`.

    Static contact forces that do not balance at a node are held by a constant force
    (`lattice.unbalanced()`). It is zero for F0_in = sum of cos(angle) F0_out, such as half of F0 in
    each of two branches at angle 0.

    **Returns:** a `Lattice`, u of shape (beads,), guide by guide in the order of `edges`, with
    `positions` evenly along each guide, the first half a diameter from the node (in space
    `gx.plots.beads` needs a projection, such as `lattice.positions[:, :2]`). Differentiable in all
    numbers, also in `nodes`.
    **Raises** ValueError for unknown nodes, a guide without length, or one whose end touches
    nothing at a node where guides begin and end.
    Source: Leonard, Ponson, Daraio, J. Mech. Phys. Solids 73, 103 (2014).

    **Example:**

    >>> nodes = {"in": (0, 0, 0), "fork": (10, 0, 0), "up": (18, 4, 3), "down": (18, -4, -3)}
    >>> tree = gx.scenes.network(nodes, [("in", "fork"), ("fork", "up"), ("fork", "down")], (6, 9, 9))
    >>> tree.shape, tree.positions.shape
    ((24,), (24, 3))
    """
    names = list(nodes) if isinstance(nodes, dict) else None
    if names:
        nodes = jnp.stack([jnp.asarray(x, float) for x in nodes.values()])
    at = parameter("nodes", nodes)
    if at.ndim != 2 or at.shape[-1] not in (2, 3) or not len(at):
        refuse("nodes", "positions (nodes, 2) or (nodes, 3)", f"shape {at.shape}")
    known = known_value(at)
    if known is None:
        refuse(
            "nodes",
            "positions that are known",
            "traced ones",
            "Which guides touch follows from them: leave jit and vmap; jax.grad may stay.",
        )
    ends = [_ends(f"edges[{i}]", edge, names, len(at)) for i, edge in enumerate(edges)]
    several = not isinstance(beads, (int, np.integer))
    counts = [whole("beads", n, 1) for n in (beads if several else [beads] * len(ends))]
    if len(counts) != len(ends):
        refuse("beads", f"one number, or {len(ends)}, one per guide", f"{len(counts)}")
    tail, head = np.array(ends).T
    if not np.all(np.linalg.norm(known[head] - known[tail], axis=-1) > 0):
        refuse("edges", "guides between different places", "one without length")
    span = at[head] - at[tail]
    direction = span / jnp.linalg.norm(span, axis=-1, keepdims=True)
    for name, x in {"mass": mass, "stiffness": stiffness, "precompression": precompression}.items():
        shapes = [(len(ends),)] + [(sum(counts),)] * (name == "mass")
        if np.ndim(x) and np.shape(x)[:1] not in shapes:
            wanted = f"one number, or an array of shape {' or '.join(map(str, shapes))}"
            refuse(name, wanted, f"{np.shape(x)}")
    if np.shape(mass)[:1] == (len(ends),):
        mass = jnp.asarray(mass)[np.repeat(np.arange(len(ends)), counts)]

    def laws(owners):
        if law is not None:
            return law
        own = lambda x: jnp.asarray(x)[np.array(owners)] if np.ndim(x) else x
        return contact(own(stiffness), exponent, own(precompression))

    along = [(np.arange(n) + 0.5)[:, None] / n for n in counts]
    places = jnp.concatenate([at[a] + x * (at[b] - at[a]) for a, b, x in zip(tail, head, along)])
    return _guided(tail, head, direction, counts, laws, mass, places, boundary, units)


def _ends(name, edge, names, count):
    tail, head = (one_of(name, node, range(count) if names is None else names) for node in edge)
    return (tail, head) if names is None else (names.index(tail), names.index(head))


def _meet(tail, head, direction):
    # Return the contacts at the nodes, their weights, and the guides with loose ends.
    #
    # A contact is (incoming guide, outgoing guide, guide whose law it has). Loose ends touch a wall.
    # If the directions are traced, all guides at a node touch.
    known = known_value(direction)
    meetings = []
    kinds = []
    begin = []
    end = []
    for node in sorted({*tail.tolist(), *head.tolist()}):
        come = np.flatnonzero(head == node)
        leave = np.flatnonzero(tail == node)
        if not len(come) or not len(leave):
            begin += leave.tolist()
            end += come.tolist()
            continue
        touching = np.ones((len(come), len(leave)), bool)
        if known is not None:
            touching = known[come] @ known[leave].T > SQUARE_ON
        lost = [*come[~touching.any(1)], *leave[~touching.any(0)]]
        if lost:
            i = int(lost[0])
            refuse(
                "edges",
                "guides whose ends touch another within 90 degrees, at nodes where guides begin and end",
                f"edges[{i}], ({tail[i]}, {head[i]}), which touches none at node {node}",
                "At a right angle a rigid contact passes no force on at first order: turn the guide, or the "
                "direction in which it is counted, or end it at a node of its own.",
            )
        # 0: one incoming guide, 1: several incoming and one outgoing, 2: several of both
        kind = 0 if len(come) == 1 else 1 if len(leave) == 1 else 2
        for i, j in np.argwhere(touching):
            kinds.append(kind)
            meetings.append((int(come[i]), int(leave[j]), int(come[i] if kind == 1 else leave[j])))
    weights: Any = ()
    if meetings:
        last, first, _ = np.array(meetings).T
        cosine = (direction[last] * direction[first]).sum(-1)
        kind = np.array(kinds)
        half = jnp.sqrt((1 + cosine) / 2)
        weights = tuple(
            jnp.choose(kind, x, mode="clip") for x in ((cosine, 1.0, half), (1.0, cosine, half))
        )
    return meetings, weights, sorted(begin), sorted(end)
