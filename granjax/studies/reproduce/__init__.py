"""The review's figures, each by a simulation, a picture and one number beside its expected value.

The review is C. Chong and P. G. Kevrekidis, Dynamics of Nonlinear Lattices; labels are those of its figures. What it
does not state is chosen here, said to be so, and can be set.

`figures()` is the registry; `listing()` a table of it; `run(labels, out, plots=granjax.plots)` makes them.
"""

from .figure import Awaited, Choice, Figure
from .making import Made, one_by_one, run
from .registry import figure, figures, listing, made

__all__ = ["Awaited", "Choice", "Figure", "Made", "figure", "figures", "listing", "made", "one_by_one", "run"]
