"""Writing files: whole or not at all, beside their place and then moved into it.

What was there stays as it was until then, and where writing fails; who reads it meanwhile keeps what it reads, and two
processes that write one file leave that of the one that ended last. The content is made in memory: a library that
writes by itself leaves half a file on a full disk, and HDF5 then ends the process.
"""

import contextlib
import io
import os
import re
import secrets
import stat
import tempfile
import threading
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .checks import refuse

if TYPE_CHECKING:
    import xarray

# bytes of a file's name that are kept in the name of what is written beside it
LONGEST = 64
# the last files that were written, for who is interrupted
written: deque[Path] = deque(maxlen=100)
_lock = threading.Lock()
_underway: set[Path] = set()


def folder(argument: str, path: str | Path) -> Path:
    """A folder that files can be written to, made where it is missing. **Raises** ValueError, with the reason."""
    place = _path(argument, path, "a folder")
    try:
        place.mkdir(parents=True, exist_ok=True)
        _try_beside(place / "file")
    except (OSError, ValueError) as error:
        refuse(argument, "a folder that can be made and written", f"{str(place)!r} ({reason(error)})")
    return place


def target(argument: str, path: str | Path) -> Path:
    """A path at which a file can be written, looked at before anything is computed.

    **Raises** ValueError where its folder is missing or cannot be written, or where something stands there that is no
    file or must not be overwritten.
    """
    path = _path(argument, path, "a file's path")
    expected, got = "a file that can be written", repr(str(path))
    try:
        if path.is_dir():
            refuse(argument, expected, got, "It is a folder: add a name.")
        if path.exists() and not path.is_file():
            refuse(argument, expected, got, "It is no ordinary file.")
        if not path.parent.is_dir():
            refuse(argument, expected, got, f"There is no folder {str(path.parent)!r}: make it first.")
        if path.exists() and not os.access(path, os.W_OK):
            refuse(argument, expected, got, "It is protected against writing.")
        _try_beside(path)
    except OSError as error:
        refuse(argument, expected, got, f"{reason(error)}.")
    return path


def _path(argument, path, expected):
    if not isinstance(path, (str, os.PathLike)) or "\0" in os.fspath(path) or not os.fspath(path):
        refuse(argument, expected, repr(path))
    return Path(path)


def reason(error: BaseException) -> str:
    """Why the system refused, in its words, without a path or a number."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def _beside(path):
    """A free name beside a file: hidden, and of its folder, so that moving is a change of names alone."""
    path = Path(os.path.realpath(path))
    name = os.fsencode(path.name)[:LONGEST].decode(errors="ignore")
    return path, path.with_name(f".{name}.{secrets.token_hex(6)}.part")


def _try_beside(path):
    _, part = _beside(path)
    with _lock, _made(part):
        pass


@contextlib.contextmanager
def _made(part):
    _underway.add(part)
    try:
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        with open(descriptor, "wb") as file:
            yield file
    finally:
        part.unlink(missing_ok=True)
        _underway.discard(part)


def write(path: str | Path, content: bytes | str) -> Path:
    """A file of this content at a path, whole or not at all; what was there stays where writing fails.

    A link is followed, the permissions of what was there are kept. **Raises** OSError with a sentence.
    """
    try:
        return _write(Path(path), content)
    except OSError as error:
        raise OSError(f"{_unwritten(path, error)}; what was there before is as it was.") from None


def rescue(path: str | Path, content: bytes | str) -> tuple[Path | None, str]:
    """`write`, or the same into a new temporary folder where that fails: where it is, and a sentence if so."""
    path = Path(path)
    try:
        return _write(path, content), ""
    except OSError as error:
        said = _unwritten(path, error)
    place = None
    try:
        place = Path(tempfile.mkdtemp(prefix="granjax-"))
        return _write(place / path.name, content), f"{said}; it is at {str(place / path.name)!r} instead."
    except OSError as error:
        if place is not None:
            place.rmdir()
        return None, f"{said}, nor into a temporary folder ({reason(error)}): it is lost."


def _unwritten(path, error):
    return f"{str(path)!r} could not be written ({reason(error)})"


def _write(path, content):
    content = content.encode() if isinstance(content, str) else content
    goal, part = _beside(path)
    with _lock, _made(part) as file:
        file.write(content)
        file.flush()
        # a full disk may show no earlier
        os.fsync(file.fileno())
        file.close()
        if goal.is_file():
            os.chmod(part, stat.S_IMODE(goal.stat().st_mode))
        os.replace(part, goal)
        written.append(path)
    return path


def stop_writing(timeout: float = 0.5) -> None:
    """No file is written any more, and none is left half-written: what a process does before it ends at once."""
    if not _lock.acquire(timeout=timeout):
        for part in list(_underway):
            with contextlib.suppress(OSError):
                part.unlink()


def save(data: "xarray.Dataset", path: str | Path) -> Path:
    """Write a dataset to a `.nc` or a `.mat` file, whole or not at all. **Raises** ValueError for another ending."""
    path = target("path", path)
    makers = {".nc": netcdf, ".mat": matlab}
    if path.suffix.lower() not in makers:
        refuse("path", "a name that ends in .nc or .mat", repr(path.name))
    return write(path, makers[path.suffix.lower()](data))


def netcdf(data: "xarray.Dataset") -> bytes:
    """A dataset as the bytes of a netCDF file, complex numbers as NAME_real and NAME_imag, arrays with checksums."""
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    data, buffer = real_parts(data).drop_encoding(), io.BytesIO()
    sums = {name: {"fletcher32": True} for name, x in data.variables.items()
            if x.dtype.kind in "biuf" and x.ndim and x.size}
    # netCDF has no truth values among its attributes
    data.attrs = {name: int(x) if isinstance(x, (bool, np.bool_)) else x for name, x in data.attrs.items()}
    with h5netcdf.File(buffer, "w") as file:
        data.dump_to_store(H5NetCDFStore(file), encoding=sums)
    return buffer.getvalue()


def matlab(data: "xarray.Dataset") -> bytes:
    """A dataset as the bytes of a MATLAB file of version 5: arrays by name, attributes in a struct `attributes`."""
    from scipy.io import savemat

    def called(name):
        # MATLAB's names are letters, digits and underscores, at most 63, and begin with a letter
        name = re.sub(r"\W", "_", str(name), flags=re.ASCII)[:61]
        return name if name[:1].isalpha() else f"x_{name}"

    data, buffer = real_parts(data), io.BytesIO()
    arrays = {called(name): x.values.astype(object) if x.dtype.kind == "U" else x.values
              for name, x in data.variables.items()}
    arrays["attributes"] = {called(name): x for name, x in data.attrs.items()}
    savemat(buffer, arrays, long_field_names=True)
    return buffer.getvalue()


def real_parts(data: "xarray.Dataset") -> "xarray.Dataset":
    """A dataset with complex numbers as two, NAME_real and NAME_imag, attributes too.

    **Raises** ValueError where something else is called so.
    """
    variables = {name: x for name, x in data.variables.items() if x.dtype.kind == "c"}
    attributes = {name: np.asarray(x) for name, x in data.attrs.items() if np.asarray(x).dtype.kind == "c"}
    for name in (*variables, *attributes):
        taken = {f"{name}_real", f"{name}_imag"} & {*data.variables, *data.attrs}
        if taken:
            refuse("data", f"no other {min(taken)!r} beside the complex {name!r}", "one", "Call it otherwise.")
    if not variables and not attributes:
        return data
    coordinates = {*data.coords}
    made = data.drop_vars([*variables]).assign({
        f"{name}_{part}": (x.dims, getattr(x.values, part), x.attrs) for name, x in variables.items()
        for part in ("real", "imag")})
    made.attrs = {key: x for key, x in data.attrs.items() if key not in attributes} | {
        f"{key}_{part}": getattr(x, part).tolist() for key, x in attributes.items() for part in ("real", "imag")}
    return made.set_coords([f"{name}_{part}" for name in variables if name in coordinates for part in ("real", "imag")])
