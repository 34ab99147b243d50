"""A bifurcation diagram: a branch, and the branches that leave it."""

from typing import Any

from ..base.checks import whole
from ..base.types import Count
from ..results import Result, hidden, note
from .branch import BRANCH_POINT, DOUBLING, TORUS, Branch


class Diagram(Result):
    """Connected branches: what `gx.orbits.diagram` returns. `gx.plots.diagram` draws it."""

    branches: tuple[Any, ...] = hidden(
        "The branches, `Branch` or `TorusBranch`, the given one first."
    )
    parents: tuple[tuple[int, int], ...] = note(
        "For each branch the index of the branch that it leaves and of the bifurcation there; "
        "(-1, -1) for the first."
    )
    failed: tuple[str, ...] = note("A sentence on each branch that was not found.")
    complete: bool = note("Whether `most` was enough for all branches that leave these.")

    @property
    def outcome(self) -> str:
        """The number of branches, and of those not found."""
        lost = f" {len(self.failed)} were not found." if self.failed else ""
        rest = "" if self.complete else " More leave them: give most=."
        return f"{len(self.branches)} branches.{lost}{rest}"


def diagram(branch: Branch, depth: Count = 1, *, most: Count = 20, **keywords: Any) -> Diagram:
    """Follow what leaves a branch, and what leaves those branches, to a depth.

    `branch.switch` follows both sides of branch points, doubled orbits and tori. A branch that two
    points share is followed from both.

    **Arguments:** `branch`: from `gx.forced.forced_branch` or `gx.breathers.family`. `depth`: 1 for
    what leaves this branch, 2 for what leaves those too. `most`: the most branches. `keywords`: of
    `branch.switch`.
    **Returns:** `Diagram`; branches that are not found are listed in `failed`.

    **Example:**

    >>> well, beside = gx.OnSite(gx.Polynomial(-1.0, 0.0, 1.0)), gx.State(jnp.ones(2), jnp.zeros(2))
    >>> make = lambda f: gx.Lattice(jnp.ones(2), (well, gx.Damping(0.3), gx.Drive(gx.Harmonic(f, 1.2), 0)))
    >>> branch = gx.forced.forced_branch(make, 0.25, 0.28, period=2 * np.pi / 1.2, guess=beside, transient=60)
    >>> gx.orbits.diagram(branch, points=3).outcome
    '2 branches.'
    """
    depth = whole("depth", depth)
    most = whole("most", most, 1)
    branches = [branch]
    parents = [(-1, -1)]
    failed = []
    complete = True
    levels = [0]
    for i, here in enumerate(branches):  # It grows on the way.
        level = levels[i]
        events = getattr(here, "bifurcations", ()) if level < depth else ()
        for j, event in enumerate(events):
            sides = {BRANCH_POINT: (1, -1), DOUBLING: (1,), TORUS: (1,)}.get(event.kind, ())
            for side in sides:
                if len(branches) == most:
                    complete = False
                    break
                try:
                    found = here.switch(j, side=side, **keywords)
                except RuntimeError as error:
                    failed.append(f"{event.outcome} {error}")
                    continue
                branches.append(found)
                parents.append((i, j))
                levels.append(level + 1)
    return Diagram(
        tuple(branches),
        tuple(parents),
        tuple(failed),
        complete,
        _mark=branch._mark,
        _space=branch._space,
    )
