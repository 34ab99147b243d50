"""The formats that a dataset is written in, by the ending of a file."""

from pathlib import Path
from typing import TYPE_CHECKING

from ..checks import one_of, refuse
from ..files import netcdf, real_parts, target
from .by_name import matlab, npz
from .csv_table import csv_text
from .structure import refuse_what_no_file_holds

if TYPE_CHECKING:
    import xarray

ENDINGS = (".nc", ".npz", ".mat", ".csv")
VERSIONS = ("5", "7.3")


def content(data: "xarray.Dataset", ending: str, version: str | None = None) -> bytes:
    """A dataset as the bytes of a file with this ending: see `save`."""
    refuse_what_no_file_holds(data)
    if ending == ".nc":
        # how another file held the numbers is not how this one does
        return netcdf(data.drop_encoding())
    data = real_parts(data)
    if ending == ".csv":
        return csv_text(data).encode()
    return npz(data) if ending == ".npz" else matlab(data, version)


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
