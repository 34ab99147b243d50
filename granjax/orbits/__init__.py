"""Time-periodic orbits, y(t0 + T) = S y(t0): found by Newton's method, followed, judged; and where motions settle.

`gx.breathers`, `gx.forced`, `gx.floquet` and `gx.driven` are faces of this room.
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
