"""Reductions along a run, found between steps from the dense output, so that a sweep stores no trajectory."""

from .kinds import (
    CLOSEST,
    EXTREMES,
    FORMS,
    Arrival,
    AtEnds,
    Integral,
    Lowest,
    Peak,
    PeakTime,
    Record,
)
from .solver import Recorded, leaf_by_leaf
