"""Time-periodic orbits, y(t0 + T) = S y(t0): finding, following and judging them; attractors.

`gx.breathers`, `gx.forced`, `gx.floquet` and `gx.driven` re-export it. Where to look:

- One orbit: `problems` (the equations, a `Shooting`), `orbit` (Newton's method, doubling of the
  steps, errors), `guesses`, `backbone`, `asked` (checks of the inputs).
- Several orbits or equilibria from the same guesses: `solutions`.
- A branch: `problems` (a `Family` of shooting problems over a parameter, which `continuation`
  follows), `branch` (the result, bifurcations; forced orbits), `families` (breathers).
- What leaves a branch: `leaving` (normal forms, the first step), `loci` (bifurcations in two
  parameters), `tori`, `diagram` (all of them).
- Stability: `floquet`, `spectrum`. Motions that settle or do not: `attractors`. Waves that grow in
  a gap and return: `gap_breather`.
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
