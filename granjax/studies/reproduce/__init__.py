"""The review's figures, each by a simulation, a picture and one number beside its expected value.

The review is C. Chong and P. G. Kevrekidis, Dynamics of Nonlinear Lattices; labels are those of its figures. What it
does not state is chosen here, said to be so, and can be set.

`figures()` is the registry; `listing()` a table of it; `run(labels, out, plots=granjax.plots)` makes them.
"""

from .figure import Choice, Figure
from .making import Made, one_by_one, run
from .registry import figure, figures, listing

__all__ = ["Choice", "Figure", "Made", "figure", "figures", "listing", "one_by_one", "run"]
