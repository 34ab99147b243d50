"""Fitting: parameters of a scene from measured traces, with what the data determine and what they do not."""

from .files import read_csv, read_mat
from .fit import fit
from .record import Fit
from .traces import Traces

Traces.from_csv, Traces.from_mat = staticmethod(read_csv), staticmethod(read_mat)

__all__ = ["Fit", "Traces", "fit", "read_csv", "read_mat"]
