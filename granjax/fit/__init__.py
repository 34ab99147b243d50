"""Fitting: parameters of a scene from measured traces, with what the data determine and what they do not."""

from .files import read_arrays, read_csv
from .fit import fit
from .fitted import Fit
from .problem import Problem, prepared
from .solve import linearised
from .traces import Traces

Traces.from_csv = staticmethod(read_csv)
# what a file of arrays is, it says itself
Traces.from_mat = Traces.from_npz = Traces.from_netcdf = staticmethod(read_arrays)

__all__ = ["Fit", "Problem", "Traces", "fit", "linearised", "prepared", "read_arrays", "read_csv"]
