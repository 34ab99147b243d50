"""Datasets and arrays to and from files: netCDF, `.npz`, MATLAB's `.mat` (versions 5 and 7.3) and CSV.

`gx.Result.save` and `gx.Result.load` are these for a result; a sweep, and any `xarray.Dataset`, goes the same way.
"""

from .datasets import arrays, load, save
