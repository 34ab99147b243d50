"""What `child` reads: MATLAB's files, HDF5's and NumPy's, whole or a part at a time, in its process alone.

Whatever is wrong with a file may raise anything here, or end the process. It imports nothing of the library.
"""

import json
import math
import os
import warnings
import zipfile
import zlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

NUMERIC = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
NO_NUMBERS = b"This is a netCDF dimension but not a netCDF variable"
STRUCTURE, COMPLEX = "granjax_structure", ("real", "imag")
# deflate shrinks zeros to a thousandth
RATIO = 1100


class Part(NamedTuple):
    """An array in a file: shape, type, a function of a key that reads some of it, what it is there, its unit.

    `read=None` where it was not asked for; `whole`: it is in memory already; `axes`: their names, if it has such.
    """

    shape: tuple[int, ...]
    dtype: np.dtype
    read: Callable | None
    word: str = ""
    units: str = ""
    whole: bool = False
    axes: tuple[str, ...] = ()


def small(count, most):
    """Refuse more bytes than may be held."""
    if count > most:
        raise ValueError(f"it states {count / 2**20:.3g} MiB of numbers, more than {most / 2**20:.3g}")


def complete(item):
    """Refuse a dataset of which parts were never written: HDF5 would fill them in."""
    small(item.size * item.dtype.itemsize, RATIO * os.path.getsize(item.file.filename))
    if item.chunks is None:
        # words lie elsewhere
        missing = item.id.get_storage_size() < item.size * (1 if item.dtype.kind == "O" else item.dtype.itemsize)
    else:
        missing = item.id.get_num_chunks() < math.prod(-(-n // c) for n, c in zip(item.shape, item.chunks))
    if item.size and missing:
        raise ValueError(f"numbers of {item.name!r} are not there")


# ------------------------------------------------------------------------------------------------ arrays by their names


def matlab(path, names, closing):
    """({name: part}, {name: what it is}) of a MATLAB file, "scan.gate" a field of a struct, arrays shaped as there.

    `names`: those that are asked for, which have to be whole; `None`: all. `closing` closes what stays open.
    """
    import h5py

    if not h5py.is_hdf5(path):
        return _matlab_5(path, names)
    return _matlab_7_3(closing.enter_context(h5py.File(path, "r")), names)


def _matlab_7_3(file, names):
    import h5py

    parts, others = {}, {}

    def visit(name, item):
        if name.startswith("#") or not isinstance(item, h5py.Dataset):
            return
        name, word = name.replace("/", "."), item.attrs.get("MATLAB_class", b"")
        word = word.decode("latin-1") if isinstance(word, bytes) else str(word)
        made = None if item.shape is None else _hdf5_part(item, word)
        if made is None:
            others[name] = word or f"HDF5's {item.dtype}"
        else:
            parts[name] = made
            if names is None or name in names:
                complete(item)

    file.visititems(visit)
    return parts, others


def _hdf5_part(item, word):
    """A dataset as MATLAB has it, which counts columns first; `None` for what is no numbers and no words."""
    if "MATLAB_empty" in item.attrs:
        shape = tuple(int(n) for n in np.ravel(item[()])) if item.size < 33 else (0, 0)
        shape = shape if 0 in shape else (0, 0)
        return Part(shape, np.dtype(float), lambda key: np.zeros(shape)[key], word)
    shape = item.shape[::-1]
    if word == "char" and item.dtype.kind == "u" and item.ndim == 2:
        return Part((), np.dtype(object), lambda key: _texts(item[()].T), word)
    if word == "cell" and item.dtype.kind == "O":
        return Part(shape, np.dtype(object), lambda key: _cells(item).T[key], word)
    if item.dtype.names == COMPLEX and all(item.dtype[part].kind == "f" for part in COMPLEX):
        kind = np.result_type(item.dtype["real"], np.complex64)
        return Part(shape, kind, lambda key: _joined(item[key[::-1]].T, kind), "complex")
    if item.dtype.kind not in "fiu" or word not in NUMERIC | {""}:
        return None
    kind = np.dtype(bool) if word == "logical" else item.dtype
    return Part(shape, kind, lambda key: np.asarray(item[key[::-1]]).T.astype(kind, copy=False))


def _texts(codes):
    """A text, or several lines of it, of the codes of letters."""
    if codes.size > 2**24:
        raise ValueError(f"a text of {codes.size} letters")
    lines = [np.ascontiguousarray(row, "<u2").tobytes().decode("utf-16-le", "replace") for row in codes]
    return np.array(lines[0] if len(lines) == 1 else lines, object)


def _cells(item):
    """The words of a cell array; a cell of something else makes it none."""
    if item.size > 2**20:
        raise ValueError(f"a cell array of {item.size} entries")
    words = np.empty(item.shape, object)
    for place, reference in np.ndenumerate(item[()]):
        cell = item.file[reference]
        empty, word = "MATLAB_empty" in cell.attrs, bytes(cell.attrs.get("MATLAB_class", b""))
        if word != b"char":
            raise ValueError(f"cells of {item.name!r} that are no words")
        words[place] = "" if empty else str(_texts(cell[()].T))
    return words


def _joined(x, kind):
    made = np.empty(x.shape, kind)
    made.real, made.imag = x["real"], x["imag"]
    return made


def _matlab_5(path, names):
    """The same of versions 4 to 7, which are read whole, what is asked for."""
    from scipy.io import loadmat, matlab, whosmat

    # a variable that cannot be read is but a warning
    warnings.simplefilter("error", matlab.MatReadWarning)
    held = whosmat(path)
    parts, others = {}, {}
    for name, shape, word in held:
        if word in NUMERIC:
            parts[name] = Part(shape, np.dtype(float), None)
        else:
            others[name] = word
    tops = [name for name, *_ in held
            if names is None or any(asked == name or asked.startswith(f"{name}.") for asked in [*names, STRUCTURE])]
    small(sum(8 * math.prod(shape) for name, shape, _ in held if name in tops), RATIO * os.path.getsize(path))

    logical = {name for name, _, word in held if word == "logical"}

    def add(name, x):
        if name in logical:
            x = np.asarray(x, bool)
        if not isinstance(x, np.ndarray):
            others[name] = others.get(name, type(x).__name__)
        elif x.dtype.names:
            for field in x.dtype.names if x.size == 1 else ():
                add(f"{name}.{field}", x[field].item())
        elif x.dtype.kind in "fiubc":
            parts[name] = Part(x.shape, x.dtype, x.__getitem__, "complex" if x.dtype.kind == "c" else "", "", True)
            others.pop(name, None)
        elif x.dtype.kind == "U":
            text = np.array(x.item() if x.size == 1 else x.tolist() if x.size else "", object)
            parts[name] = Part(text.shape, text.dtype, text.__getitem__, "char", "", True)
        elif x.dtype.kind == "O" and all(isinstance(y, np.ndarray) and y.dtype.kind == "U" for y in x.flat):
            words = np.array([y.item() if y.size == 1 else "" for y in x.flat], object).reshape(x.shape)
            parts[name] = Part(words.shape, words.dtype, words.__getitem__, "cell", "", True)
        else:
            others[name] = {"O": "cell"}.get(x.dtype.kind, str(x.dtype))

    for name, x in loadmat(path, variable_names=tops).items() if tops else ():
        if name in tops:
            add(name, x)
    return parts, others


def npz(path, names, closing):
    """The same of NumPy's `.npz`, without pickles: members that are not deflated are read where they lie."""
    parts, others = {}, {}
    with zipfile.ZipFile(path) as file:
        for member in file.infolist():
            name = member.filename.removesuffix(".npy")
            if name == member.filename:
                others[name] = "no array"
                continue
            made = _npy(path, file, member, names is None or name in names)
            if made is None:
                others[name] = "a pickled object, which is not read"
            else:
                parts[name] = made
    return parts, others


def _npy(path, file, member, whole):
    """A member of an `.npz`, `None` where it holds what only a pickle can."""
    with file.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read = {(1, 0): np.lib.format.read_array_header_1_0}.get(version, np.lib.format.read_array_header_2_0)
        shape, turned, kind = read(stream)
        head = stream.tell()
    if kind.kind not in "biufcUSmM":
        return None
    size = kind.itemsize * math.prod(shape)
    if whole and (member.file_size != head + size or member.compress_size * RATIO < size):
        raise ValueError(f"{member.filename!r} is of {member.file_size - head} bytes, and states {size}")
    word = {"U": "char", "S": "char", "c": "complex"}.get(kind.kind, "")
    if member.compress_type != zipfile.ZIP_STORED or not size:
        return Part(shape, kind, lambda key: _inflated(path, member.filename)[key], word)
    with open(path, "rb") as raw:
        raw.seek(member.header_offset)
        local = raw.read(30)
    if local[:4] != b"PK\3\4":
        raise ValueError(f"{member.filename!r} is not where the file says")
    start = member.header_offset + 30 + int.from_bytes(local[26:28], "little") + int.from_bytes(local[28:30], "little")

    def mapped(key):
        if all(isinstance(k, slice) and k.indices(n) == (0, n, 1) for k, n in zip(key, shape)):
            # all of it: with its check sum
            return _inflated(path, member.filename)
        x = np.memmap(path, kind, "r", start + head, shape, "F" if turned else "C")
        return np.array(x[key])

    return Part(shape, kind, mapped, word)


def _inflated(path, name):
    with zipfile.ZipFile(path) as file, file.open(name) as stream:
        found = np.lib.format.read_array(stream, allow_pickle=False)
        # to the end, where the sum is looked at
        stream.read(1)
    return found


def netcdf(path, names, closing):
    """The same of a netCDF file, which names axes and coordinates too: see `dataset`."""
    variables, _, _ = _netcdf(path, names, closing)
    parts = {}
    for name, x in variables.items():
        word = {"O": "char", "U": "char", "S": "char", "c": "complex"}.get(x.dtype.kind, "")
        parts[name] = Part(x.shape, x.dtype, _of(x), word, str(x.attrs.get("units", "")), axes=x.dims)
    return parts, {}


def named(parts):
    """The same parts with units and names of axes, where `save` has written them."""
    if STRUCTURE not in parts or parts[STRUCTURE].read is None:
        return parts
    told_by = told(str(parts[STRUCTURE].read(())))["variables"].values()
    known = {x["key"]: (str(x["told"].get("units", "")), tuple(x["axes"])) for x in told_by}
    for key, (units, axes) in known.items():
        fits = key in parts and len(axes) == len(parts[key].shape)
        parts = parts | {key: parts[key]._replace(units=units, axes=axes if fits else ())} if key in parts else parts
    return parts


def _of(x):
    return lambda key: x[key].values


def _netcdf(path, names, closing):
    """Variables, names of coordinates and attributes, decoded as xarray does, none of them in memory."""
    import h5py
    import xarray
    from xarray.backends import H5NetCDFStore

    with h5py.File(path, "r") as file:
        for name, item in file.items():
            if isinstance(item, h5py.Dataset) and item.shape is not None and (names is None or name in names):
                if not bytes(item.attrs.get("NAME", b"")).startswith(NO_NUMBERS):
                    complete(item)
    store = H5NetCDFStore.open(path)
    closing.callback(store.close)
    variables, attributes = store.load()
    variables, attributes, coordinates = xarray.conventions.decode_cf_variables(variables, attributes)
    coordinates = {*coordinates, *(name for name, x in variables.items() if name in x.dims)}
    return variables, sorted(coordinates), attributes


# ------------------------------------------------------------------------------------------------- what `save` wrote


def dataset(kind, path, closing):
    """({variable: (axes, attributes, part)}, names of coordinates, attributes) of a file that `save` wrote."""
    if kind == "netcdf":
        variables, coordinates, attributes = _netcdf(path, None, closing)
        found = {name: (x.dims, x.attrs, Part(x.shape, x.dtype, _of(x))) for name, x in variables.items()}
        return found, coordinates, attributes
    parts, _ = (matlab if kind == "matlab" else npz)(path, None, closing)
    if STRUCTURE not in parts:
        raise ValueError(f"it has no {STRUCTURE}: granjax did not write it")
    structure = told(str(parts[STRUCTURE].read(())))
    variables = {}
    for name, x in structure["variables"].items():
        held = _words(x) if "words" in x else _shaped(parts[x["key"]], x, kind)
        variables[name] = x["axes"], listed(x["told"]), held
    return variables, structure["coordinates"], listed(structure["attributes"])


def told(text: str) -> dict:
    """The structure that a text says. **Raises** ValueError where it is not as it was written."""
    structure = json.loads(text)
    digest = structure.pop("digest")
    if digest != zlib.crc32(json.dumps(structure).encode()):
        raise ValueError(f"its {STRUCTURE} has been changed")
    variables = structure["variables"].values()
    words = [*structure["coordinates"], *(axis for x in variables for axis in x["axes"])]
    lists = [structure["coordinates"], *(x[key] for x in variables for key in ("axes", "shape"))]
    dicts = [structure["attributes"], *(x["told"] for x in variables)]
    if not (all(isinstance(x, str) for x in words) and all(isinstance(x, list) for x in lists)
            and all(isinstance(x, dict) for x in dicts)):
        raise ValueError(f"its {STRUCTURE} is none")
    return structure


def _words(x):
    words = np.array([None, *x["words"]], object)[1:].reshape(x["shape"])
    return Part(words.shape, words.dtype, words.__getitem__)


def _shaped(part, x, kind):
    """A part as the variable that it was: MATLAB has two axes at least, and fewer types."""
    shape, dtype = tuple(x["shape"]), np.dtype(x["type"])
    stored = (1,) * (2 - len(shape)) + shape if kind == "matlab" else shape
    if part.shape != stored and (math.prod(shape) or math.prod(part.shape)) or dtype.kind not in "biuf":
        raise ValueError(f"{x['key']!r} of shape {part.shape}, where {stored} is said")
    before = (0,) * (len(stored) - len(shape))

    def read(key):
        if not math.prod(shape):
            return np.zeros(shape, dtype)[key]
        if before and not shape:
            return np.asarray(part.read((0, 0)), dtype)[()]
        return np.asarray(part.read(before + key), dtype)

    return Part(shape, dtype, read, whole=part.whole)


def listed(attributes: dict) -> dict:
    """Attributes as netCDF has them."""
    return {name: np.asarray(x) if isinstance(x, list) else x for name, x in attributes.items()}
