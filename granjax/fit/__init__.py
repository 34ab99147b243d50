"""Fits of scene parameters to measured traces, and what the data determine."""

from .fit import fit
from .fitted import Fit
from .information import Information, information
from .problem import Problem
from .solve import linearised
from .traces import Traces

__all__ = ["Fit", "Information", "Problem", "Traces", "fit", "information", "linearised"]
