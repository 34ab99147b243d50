"""Fitting: parameters of a scene from measured traces, with what the data determine and what they do not."""

from .files import read_csv, read_mat
from .fit import fit
from .fitted import Fit
from .problem import Problem, prepared
from .solve import linearised
from .traces import Traces

Traces.from_csv, Traces.from_mat = staticmethod(read_csv), staticmethod(read_mat)

__all__ = ["Fit", "Problem", "Traces", "fit", "linearised", "prepared", "read_csv", "read_mat"]
