"""The formats that a dataset is written in, by the ending of a file."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..checks import one_of, refuse
from ..files import netcdf, real_parts, target
from .by_name import matlab, npz
from .csv_table import csv_text
from .structure import refuse_what_no_file_holds

if TYPE_CHECKING:
    import xarray

ENDINGS = (".nc", ".npz", ".mat", ".csv")
SPACED = "granjax_coordinates"
VERSIONS = ("5", "7.3")
# attributes by which readers of netCDF turn numbers into others
CONVENTIONS = ("_FillValue", "_Unsigned", "add_offset", "coordinates", "dtype", "missing_value", "scale_factor")


def content(data: "xarray.Dataset", ending: str, version: str | None = None) -> bytes:
    """A dataset as the bytes of a file with this ending: see `save`."""
    refuse_what_no_file_holds(data)
    if ending == ".nc":
        return _netcdf(data)
    data = real_parts(data)
    if ending == ".csv":
        return csv_text(data).encode()
    return npz(data) if ending == ".npz" else matlab(data, version)


def _netcdf(data):
    """netCDF, where numbers come back as they are."""
    data = data.copy()
    for name, x in [("", data), *data.variables.items()]:
        taken = {*CONVENTIONS} & {*x.attrs} if name else ()
        times = " since " in str(x.attrs.get("units", "")) and name and x.dtype.kind != "M"
        if taken or times:
            refuse("data", "attributes that do not change numbers in a .nc file", f"{name} with "
                   f"{min(taken) if taken else 'units'}", "Call it otherwise, or write a .npz or .mat file.")
        x.attrs = {key: _attribute(np.asarray(a)) for key, a in x.attrs.items()}
    # netCDF lists the names of coordinates between spaces
    spaced = [name for name in data.coords if " " in name and data[name].dims != (name,)]
    data = data.reset_coords(spaced).assign_attrs({SPACED: spaced} if spaced else {})
    try:
        # how another file held the numbers is not how this one does
        return netcdf(data.drop_encoding())
    except (AttributeError, RuntimeError, TypeError, ValueError) as error:
        refuse("data", "what netCDF holds", str(error)[:200], "Write a .npz or .mat file.")


def _attribute(x):
    """An attribute as netCDF has it, which knows no truth."""
    return x.tolist() if x.dtype.kind == "U" else x.astype(int) if x.dtype.kind == "b" else x[()]


def place(path: str | Path, version: str | None = None) -> Path:
    """The path of a file that can be written in one of the formats. **Raises** ValueError as `save` does."""
    path = target("path", path)
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        refuse("path", "a name that ends in .nc, .npz, .mat or .csv", repr(path.name))
    if version is not None:
        one_of("version", version, VERSIONS)
        if ending != ".mat":
            refuse("version", "a name that ends in .mat", repr(path.name), "Leave version= out.")
    return path
