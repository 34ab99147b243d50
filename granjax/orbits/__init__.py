"""Time-periodic orbits, y(t0 + T) = S y(t0): found by Newton's method, followed, judged; and where motions settle.

`gx.breathers`, `gx.forced`, `gx.floquet` and `gx.driven` are faces of this room. Where to look:

- one orbit: `problems` (the equations, a `Shooting`), `confirm` (Newton's method, steps that are doubled, errors),
  `orbit` and `breather` (how to ask), `guesses`, `backbone`, `symmetry`, `repeats` and `steps` (what is asked with).
- a branch: `problems` (a `Family` of shooting problems over a parameter, which `continuation` follows), `families`,
  `anticontinuous` and `forced_branch` (where it begins and ends), `examined` (what there is to say of each point),
  `bifurcations` (what lies between two points), `branch` (the results).
- stability: `floquet`, `leading`, `spectrum`, `structure`. Motions that settle or do not: `attractors`, `sweep`,
  `lyapunov`, `driven_chain`; waves that grow in a gap and return: `gap_breather`.
"""

from .branch import Bifurcation, Branch
from .orbit import Orbit, orbit
from .problems import Shooting
from .steps import default_steps, history
from .symmetry import Mirror, Sign, Symmetry, Translation, shifts

__all__ = [
    "Bifurcation",
    "Branch",
    "Mirror",
    "Orbit",
    "Shooting",
    "Sign",
    "Symmetry",
    "Translation",
    "default_steps",
    "history",
    "orbit",
    "shifts",
]
