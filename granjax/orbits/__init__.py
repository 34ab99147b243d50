"""Time-periodic orbits, y(t0 + T) = S y(t0): found by Newton's method, followed, judged; and where motions settle.

`gx.breathers`, `gx.forced`, `gx.floquet` and `gx.driven` are faces of this room. Where to look:

- one orbit: `problems` (the equations, a `Shooting`), `orbit` (Newton's method, steps that are doubled, errors),
  `guesses`, `backbone`, `asked` (what is asked with: lattice, state, period, symmetry, steps).
- several orbits or states of rest from the same guesses: `solutions`.
- a branch: `problems` (a `Family` of shooting problems over a parameter, which `continuation` follows), `branch` (the
  result, what there is to say of each point, what lies between two; forced orbits), `families` (breathers).
- what leaves a branch: `leaving` (normal forms, the first step), `loci` (bifurcations in two parameters), `tori`,
  `diagram` (all of them).
- stability: `floquet`, `spectrum`. Motions that settle or do not: `attractors`; waves that grow in a gap and return:
  `gap_breather`.
"""

from .asked import Mirror, Sign, Symmetry, Translation, default_steps, history, shifts
from .branch import Bifurcation, Branch
from .diagram import Diagram, diagram
from .leaving import NormalForm
from .loci import Locus, LocusPoint
from .orbit import Orbit, orbit
from .problems import Shooting
from .solutions import Solutions, find_all, problem
from .tori import Torus, TorusBranch, torus

__all__ = [
    "Bifurcation",
    "Branch",
    "Diagram",
    "Locus",
    "LocusPoint",
    "Mirror",
    "NormalForm",
    "Orbit",
    "Shooting",
    "Sign",
    "Solutions",
    "Symmetry",
    "Torus",
    "TorusBranch",
    "Translation",
    "diagram",
    "find_all",
    "history",
    "orbit",
    "problem",
    "torus",
]
