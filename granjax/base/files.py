"""Files: a dataset as netCDF or MATLAB, written completely or not at all."""

import io
import os
import re
import secrets
from pathlib import Path
from typing import TYPE_CHECKING

import scipy

from .checks import refuse

if TYPE_CHECKING:
    import xarray

# The bytes of a file's name that its temporary file keeps.
LONGEST = 64


def folder(argument: str, path: str | Path) -> Path:
    """Return a folder, created if missing. **Raises** ValueError if that fails."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        refuse(argument, "a folder that can be created", f"{str(path)!r} ({reason(error)})")
    return Path(path)


def target(argument: str, path: str | Path) -> Path:
    """Return the path of a file to write.

    **Raises** ValueError for a folder, or a path whose folder is missing.
    """
    path = Path(path)
    if path.is_dir():
        refuse(argument, "a file's path", f"{str(path)!r}, which is a folder", "Add a name.")
    if not path.parent.is_dir():
        refuse(
            argument,
            "a file's path",
            f"{str(path)!r}",
            f"Make the folder {str(path.parent)!r} first.",
        )
    return path


def reason(error: BaseException) -> str:
    """Return the system's reason for an error, without a path or a number."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def write(path: str | Path, content: bytes | str) -> Path:
    """Write a temporary file and move it into place, so that the file is complete or unchanged."""
    path = Path(path)
    name = os.fsencode(path.name)[:LONGEST].decode(errors="ignore")
    part = path.with_name(f".{name}.{secrets.token_hex(6)}.part")
    try:
        part.write_bytes(content.encode() if isinstance(content, str) else content)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
    return path


def save(data: "xarray.Dataset", path: str | Path) -> Path:
    """Write a dataset to a `.nc` or a `.mat` file, completely or not at all.

    **Raises** ValueError for another ending.
    """
    path = target("path", path)
    makers = {".nc": netcdf, ".mat": matlab}
    if path.suffix.lower() not in makers:
        refuse("path", "a name that ends in .nc or .mat", repr(path.name))
    return write(path, makers[path.suffix.lower()](data))


def netcdf(data: "xarray.Dataset") -> bytes:
    """Return a dataset of real numbers and words as a netCDF file's bytes, with checksums."""
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    data = data.drop_encoding()
    buffer = io.BytesIO()
    sums = {
        name: {"fletcher32": True}
        for name, x in data.variables.items()
        if x.dtype.kind in "biuf" and x.ndim and x.size
    }
    with h5netcdf.File(buffer, "w") as file:
        data.dump_to_store(H5NetCDFStore(file), encoding=sums)
    return buffer.getvalue()


def matlab(data: "xarray.Dataset") -> bytes:
    """Return a dataset as the bytes of a MATLAB 5 file.

    Arrays keep their names; attributes are in a struct `attributes`.
    """

    def called(name):
        # MATLAB's names are letters, digits and underscores, at most 63, and begin with a letter.
        name = re.sub(r"\W", "_", name, flags=re.ASCII)[:61]
        return name if name[:1].isalpha() else f"x_{name}"

    buffer = io.BytesIO()
    arrays = {
        called(name): x.values.astype(object) if x.dtype.kind == "U" else x.values
        for name, x in data.variables.items()
    }
    arrays["attributes"] = {called(name): x for name, x in data.attrs.items()}
    scipy.io.savemat(buffer, arrays, long_field_names=True)
    return buffer.getvalue()
