"""Reads MATLAB's and HDF5 files in a process of its own: `reader` runs it, nobody imports it.

SciPy's and HDF5's compiled readers trust the counts that a file states: a damaged one can end the process, hang it or
ask for terabytes. Here that costs nothing. A line of JSON on standard input is a request; the answer is the length of
a JSON text (8 bytes), the text, and the bytes of the arrays in the order in which the text names them. The arguments
are the folders where modules are looked for.
"""

import contextlib
import faulthandler
import json
import math
import os
import signal
import sys
import warnings

sys.path[:] = sys.argv[1:]

import numpy as np  # noqa: E402

# seconds for imports, from a slow disk too, and without a request until the process ends
STARTING, IDLE = 60, 120
NUMERIC = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
NO_NUMBERS = b"This is a netCDF dimension but not a netCDF variable"
STRUCTURE = "granjax_structure"
NOWHERE = open(os.devnull, "w")  # noqa: SIM115


def limited(memory):
    """Let this process grow by so many bytes at most, where the system can, and leave no core file."""
    with contextlib.suppress(ImportError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
        with open("/proc/self/statm") as file:
            most = memory + int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        resource.setrlimit(resource.RLIMIT_AS, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
    with contextlib.suppress(ImportError, AttributeError):
        import ctypes

        # no window that waits for an answer where the process breaks down
        ctypes.windll.kernel32.SetErrorMode(3)


def watched(seconds):
    """End this process after so many seconds, whatever code it hangs in."""
    faulthandler.dump_traceback_later(seconds, exit=True, file=NOWHERE)


def small(count, most):
    """Refuse more bytes than may be held."""
    if count > most:
        raise ValueError(f"it states {count / 2**20:.3g} MiB of numbers, more than {most / 2**20:.3g}")


def complete(item):
    """Refuse a dataset of which parts were never written: HDF5 would fill them in."""
    if item.chunks is None:
        # words lie elsewhere
        missing = item.id.get_storage_size() < item.size * (1 if item.dtype.kind == "O" else item.dtype.itemsize)
    else:
        missing = item.id.get_num_chunks() < math.prod(-(-n // c) for n, c in zip(item.shape, item.chunks))
    if item.size and missing:
        raise ValueError(f"numbers of {item.name!r} are not there")


def matlab(path, names, most):
    """{name: array} of those that are asked for, {name: what it is} of all others. "scan.gate" is a field of a struct.

    Arrays are shaped as in MATLAB.
    """
    import h5py

    if not h5py.is_hdf5(path):
        return matlab_5(path, names, most)
    arrays, others = {}, {}

    def visit(name, item):
        if name.startswith("#") or not isinstance(item, h5py.Dataset):
            return
        name, word = name.replace("/", "."), item.attrs.get("MATLAB_class", b"")
        word = word.decode("latin-1") if isinstance(word, bytes) else ""
        if item.dtype.kind not in "fiu" or word == "char" or item.shape is None:
            others[name] = word or f"HDF5's {item.dtype}"
        elif name not in names:
            others[name] = ""
        elif "MATLAB_empty" in item.attrs:
            arrays[name] = np.zeros((0, 0))
        else:
            small(8 * item.size + sum(x.nbytes for x in arrays.values()), most)
            complete(item)
            # MATLAB counts columns first
            arrays[name] = np.asarray(item[()], float).T

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return arrays, others


def matlab_5(path, names, most):
    """The same of versions 4 to 7."""
    from scipy.io import loadmat, matlab, whosmat

    # a variable that cannot be read is but a warning
    warnings.simplefilter("error", matlab.MatReadWarning)
    held = whosmat(path)
    others = {name: "" if word in NUMERIC else word for name, _, word in held}
    tops = [name for name in others if any(asked == name or asked.startswith(f"{name}.") for asked in names)]
    small(sum(8 * math.prod(shape) for name, shape, _ in held if name in tops), most)
    arrays = {}

    def add(name, x):
        if not isinstance(x, np.ndarray):
            return
        if x.dtype.names:
            for field in x.dtype.names if x.size == 1 else ():
                add(f"{name}.{field}", x[field].item())
        elif x.dtype.kind in "fiu":
            arrays[name] = np.asarray(x, float)
            others.pop(name, None)
        else:
            others[name] = {"c": "complex", "U": "char", "O": "cell"}.get(x.dtype.kind, str(x.dtype))

    for name, x in loadmat(path, variable_names=tops).items() if tops else ():
        if name in tops:
            add(name, x)
    return arrays, others


def netcdf(path, names, most):
    """{variable: (axes, array, attributes)}, names of coordinates, attributes of the file."""
    import h5py
    import xarray

    with h5py.File(path, "r") as file:
        items = [x for x in file.values() if isinstance(x, h5py.Dataset) and x.shape is not None]
        items = [x for x in items if not bytes(x.attrs.get("NAME", b"")).startswith(NO_NUMBERS)]
        small(sum(max(x.dtype.itemsize, 8) * x.size for x in items), most)
        for item in items:
            complete(item)
    data = xarray.load_dataset(path, engine="h5netcdf")
    variables = {name: (x.dims, x.values, x.attrs) for name, x in data.variables.items()}
    return variables, sorted(data.coords), data.attrs


def saved(path, names, most):
    """The same of a .mat file that `save` wrote."""
    from scipy.io import loadmat, matlab, whosmat

    warnings.simplefilter("error", matlab.MatReadWarning)
    held = whosmat(path)
    if STRUCTURE not in [name for name, *_ in held]:
        raise ValueError(f"it has no {STRUCTURE}: granjax did not write it")
    small(sum(8 * math.prod(shape) for _, shape, _ in held), most)
    structure = json.loads(loadmat(path, variable_names=[STRUCTURE])[STRUCTURE].item())
    told = structure["variables"]
    arrays = loadmat(path, variable_names=[x["key"] for x in told.values() if "words" not in x])
    variables = {}
    for name, x in told.items():
        array = np.asarray(x["words"] if "words" in x else arrays[x["key"]])
        kind = object if "words" in x else x["type"]
        variables[name] = x["axes"], array.astype(kind).reshape(x["shape"]), attributes(x["told"])
    return variables, structure["coordinates"], attributes(structure["attributes"])


def attributes(told):
    """Attributes as netCDF has them."""
    return {name: np.asarray(x) if isinstance(x, list) else x for name, x in told.items()}


def packed(x, blocks):
    """`x` as JSON can hold it, its arrays of numbers put to `blocks`."""
    if isinstance(x, dict):
        return {"dict": [[str(name), packed(value, blocks)] for name, value in x.items()]}
    if isinstance(x, list | tuple):
        return {"list": [packed(value, blocks) for value in x]}
    if isinstance(x, str | int | float) and not isinstance(x, np.generic):
        return {"plain": x}
    array = np.asarray(x)
    if array.dtype.kind in "OSUT":
        words = [w.decode() if isinstance(w, bytes) else w for w in array.ravel().tolist()]
        if all(isinstance(w, str) for w in words):
            return {"words": words, "type": "O" if array.dtype.kind == "T" else array.dtype.str,
                    "shape": array.shape, "scalar": isinstance(x, np.generic)}
    if array.dtype.kind not in "biufcmM":
        raise TypeError(f"values of type {array.dtype}")
    blocks.append(np.ascontiguousarray(array))
    return {"type": array.dtype.str, "shape": array.shape, "scalar": isinstance(x, np.generic)}


def answered(request):
    """The answer to a request, and its arrays."""
    watched(STARTING)
    if request["kind"] == "netcdf":
        import h5netcdf  # noqa: F401
        import xarray  # noqa: F401
    else:
        import h5py  # noqa: F401
        import scipy.io  # noqa: F401
    limited(request["memory"])
    watched(request["seconds"])
    blocks, read = [], {"netcdf": netcdf, "matlab": matlab, "saved": saved}[request["kind"]]
    try:
        return {"answer": packed(read(request["path"], request["names"], request["most"]), blocks)}, blocks
    except Exception as error:
        # whatever it is, it is the file's: `reader` makes a sentence of it
        return {"error": f"{type(error).__name__}: {error}".rstrip(": ")[:300]}, []


def serve():
    """Answer requests until none is left."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    out = os.fdopen(os.dup(1), "wb")
    # whatever libraries print goes nowhere
    os.dup2(NOWHERE.fileno(), 1)
    watched(IDLE)
    for line in sys.stdin.buffer:
        answer, blocks = answered(json.loads(line))
        text = json.dumps(answer).encode()
        out.write(len(text).to_bytes(8, "little") + text)
        for block in blocks:
            out.write(block.reshape(-1).view("u1"))
        out.flush()
        watched(IDLE)


if __name__ == "__main__":
    serve()
