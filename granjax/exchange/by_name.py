"""Files of arrays by name: NumPy's `.npz`, MATLAB's `.mat` of version 5 and, which is HDF5, of version 7.3."""

import io
import zipfile
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import refuse
from ..reading.formats import STRUCTURE
from . import structure

if TYPE_CHECKING:
    import xarray

# bytes of an array beyond which MATLAB reads no .mat file of version 5
MOST = 2**31
# classes of MATLAB by type
CLASSES = {"f8": "double", "f4": "single", "b1": "logical", **{f"i{n}": f"int{8 * n}" for n in (1, 2, 4, 8)},
           **{f"u{n}": f"uint{8 * n}" for n in (1, 2, 4, 8)}}
HEAD = b"MATLAB 7.3 MAT-file, Platform: granjax, HDF5 schema 1.00 ."


def npz(data: "xarray.Dataset") -> bytes:
    """A dataset as the bytes of an `.npz` file: arrays by name, none deflated, and the text `granjax_structure`.

    `numpy.load(path, allow_pickle=False)` reads it; words are arrays of them.
    """
    names = structure.keys([STRUCTURE, *map(str, data.variables)], 200, r"[\x00-\x1f/\\:]|\.npy$")
    told, arrays = structure.described(data, names)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as file:
        for name, x in (arrays | {STRUCTURE: np.array(structure.text(told))}).items():
            member = io.BytesIO()
            x = x.astype(str) if x.dtype.kind == "O" else x
            np.lib.format.write_array(member, np.asarray(x, order="C"), allow_pickle=False)
            # without a time: the same data are the same bytes
            file.writestr(zipfile.ZipInfo(f"{name}.npy"), member.getbuffer())
    return buffer.getvalue()


def matlab(data: "xarray.Dataset", version: str | None = None) -> bytes:
    """A dataset as the bytes of a MATLAB file: arrays by name, attributes as fields of a struct `attributes`.

    Names are made such as MATLAB has; the text `granjax_structure` holds what makes the same dataset of it again.
    `version`: "5", "7.3", or `None`, which is 7.3 where an array has 2 GiB or more.
    """
    keys = structure.keys([*map(str, data.variables), STRUCTURE, "attributes"])
    told, arrays = structure.described(data, keys)
    names = structure.keys([*told["attributes"]])
    arrays |= {"attributes": {names[key]: x for key, x in told["attributes"].items()},
               STRUCTURE: structure.text(told)}
    large = any(getattr(x, "nbytes", 0) >= MOST for x in arrays.values())
    return _version_7_3(arrays) if version == "7.3" or version is None and large else _version_5(arrays)


def _version_5(arrays):
    from scipy.io import savemat
    from scipy.io.matlab import MatWriteError

    buffer = io.BytesIO()
    try:
        savemat(buffer, {name: _as_matlab(x) for name, x in arrays.items()}, long_field_names=True)
    except MatWriteError as error:
        refuse("version", "arrays that a .mat file of version 5 holds", f"larger ones ({error})", "version='7.3'.")
    return buffer.getvalue()


def _as_matlab(x):
    """An array of a type that MATLAB has."""
    return x.astype(np.float32) if isinstance(x, np.ndarray) and x.dtype == np.float16 else x


def _version_7_3(arrays):
    import h5py

    buffer = io.BytesIO()
    with h5py.File(buffer, "w", userblock_size=512) as file:
        for name, x in arrays.items():
            _put(file, file, name, x)
    # version and byte order of the file
    head = HEAD.ljust(116) + bytes(8) + b"\x00\x02IM"
    buffer.seek(0)
    buffer.write(head)
    return buffer.getvalue()


def _put(file: Any, group: Any, name: str, x: Any) -> Any:
    """An array, text, list of words or struct, as MATLAB lays it out: columns first, two axes at least."""
    import h5py

    if isinstance(x, dict):
        made = group.create_group(name, track_order=True)
        for key, value in x.items():
            _put(file, made, key, value)
        fields = np.empty(len(x), object)
        fields[:] = [np.frombuffer(key.encode(), "S1") for key in x]
        if x:
            made.attrs.create("MATLAB_fields", fields, dtype=h5py.vlen_dtype(np.dtype("S1")))
        return _called(made, "struct")
    if isinstance(x, str):
        codes = np.frombuffer(x.encode("utf-16-le", "surrogatepass"), "<u2")[:, None]
        return _called(_filled(group, name, codes), "char", MATLAB_int_decode=np.int32(2))
    x = np.asarray(x)
    if x.dtype.kind in "UO":
        cells = np.atleast_2d(x)
        held = np.empty(cells.shape[::-1], h5py.ref_dtype)
        inside = file.require_group("#refs#")
        for place, word in np.ndenumerate(cells):
            held[place[::-1]] = _put(file, inside, f"w{len(inside)}", str(word)).ref
        return _called(_filled(group, name, held, h5py.ref_dtype), "cell")
    x = np.atleast_2d(_as_matlab(x))
    kind = CLASSES[f"{x.dtype.kind}{x.dtype.itemsize}"]
    if kind == "logical":
        return _called(_filled(group, name, x.T.astype(np.uint8)), kind, MATLAB_int_decode=np.int32(1))
    return _called(_filled(group, name, x.T.astype(x.dtype.newbyteorder("<"), copy=False)), kind)


def _filled(group, name, x, kind=None):
    """A dataset; of an empty array MATLAB keeps the shape."""
    if x.size:
        return group.create_dataset(name, data=x, dtype=kind)
    made = group.create_dataset(name, data=np.array(x.shape[::-1], np.uint64))
    made.attrs["MATLAB_empty"] = np.uint8(1)
    return made


def _called(made, kind, **more):
    made.attrs["MATLAB_class"] = np.bytes_(kind)
    for name, value in more.items():
        made.attrs[name] = value
    return made
