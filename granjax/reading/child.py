"""Reads MATLAB's, HDF5 and NumPy files in a process of its own: `reader` runs it, nobody imports it.

SciPy's and HDF5's compiled readers trust the counts that a file states: a damaged one can end the process, hang it or
ask for terabytes. Here that costs nothing. A line of JSON on standard input is a request; the answer is the length of
a JSON text (8 bytes), the text, and the bytes of the arrays in the order in which the text names them. The arguments
are the folders where modules are looked for.
"""

import contextlib
import faulthandler
import importlib.util
import json
import math
import os
import signal
import sys
from pathlib import Path

sys.path[:] = sys.argv[1:]

import numpy as np  # noqa: E402

# seconds for imports, from a slow disk too, and without a request until the process ends
STARTING, IDLE = 60, 120
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


def loaded():
    """The module beside this one that knows the formats."""
    place = importlib.util.spec_from_file_location("granjax_formats", Path(__file__).with_name("formats.py"))
    made = importlib.util.module_from_spec(place)
    place.loader.exec_module(made)
    return made


FORMATS = loaded()


class Opened:
    """The file that was asked for last, which may be asked for more."""

    asked, found, closing = None, None, contextlib.ExitStack()

    @classmethod
    def close(cls):
        """Let go of it."""
        cls.asked = cls.found = None
        cls.closing.close()


def opened(request):
    """What a file holds, by its name, size and time. One that was read before and is another now is refused."""
    found = os.stat(request["path"])
    stamp = [found.st_size, found.st_mtime_ns, found.st_ino]
    if request.get("stamp", stamp) != stamp:
        raise ValueError("it is no longer the file that was opened")
    asked = request["kind"], request["path"], stamp, request["names"], request["saved"]
    if Opened.asked != asked:
        Opened.close()
        read = FORMATS.dataset if request["saved"] else getattr(FORMATS, request["kind"])
        given = (request["kind"], request["path"]) if request["saved"] else (request["path"], request["names"])
        Opened.found = read(*given, Opened.closing)
        Opened.asked = asked
    return Opened.found, stamp


def key_of(told, shape):
    """A key of an array: whole numbers, slices, lists of places."""
    if told is None:
        return (slice(None),) * len(shape)
    return tuple(slice(*k["slice"]) if "slice" in k else np.array(k.get("at", k.get("one")), int)[()] for k in told)


def outline(request):
    """What a file holds: of each array its shape and type, and the numbers of those that are wanted whole."""
    found, stamp = opened(request)
    if request["saved"]:
        variables, coordinates, attributes = found
        whole = {name: not request["lazy"] or x.whole or x.dtype.kind in "OUST"
                 for name, (_, _, x) in variables.items()}
        FORMATS.small(sum(max(x.dtype.itemsize, 8) * math.prod(x.shape) for name, (_, _, x) in variables.items()
                          if whole[name]), request["most"])
        told = {name: (list(axes), dict(attrs), list(x.shape), x.dtype.str,
                       np.asarray(x.read(key_of(None, x.shape))) if whole[name] else None)
                for name, (axes, attrs, x) in variables.items()}
        return told, coordinates, dict(attributes), stamp
    parts, others = found
    asked = {name: x for name, x in parts.items() if x.read and (request["names"] is None or name in request["names"])}
    whole = {name: x for name, x in asked.items() if x.whole or not request["lazy"]}
    FORMATS.small(sum(max(x.dtype.itemsize, 8) * math.prod(x.shape) for x in whole.values()), request["most"])
    parts = FORMATS.named(parts) if request["lazy"] else parts
    arrays = {name: np.asarray(x.read(key_of(None, x.shape))) for name, x in whole.items()}
    told = {name: (list(x.shape), x.dtype.str, x.word, x.units, list(x.axes), arrays.get(name))
            for name, x in parts.items()}
    return told, others, stamp


def part(request):
    """Some numbers of one array."""
    found, _ = opened(request)
    x = found[0][request["name"]]
    x = x[2] if request["saved"] else x
    key = key_of(request["key"], x.shape)
    key = tuple(int(k) % n if np.ndim(k) == 0 and not isinstance(k, slice) else k for k, n in zip(key, x.shape))
    sizes = [len(range(*k.indices(n))) if isinstance(k, slice) else np.size(k) for k, n in zip(key, x.shape)]
    count = max(x.dtype.itemsize, 8) * math.prod(sizes)
    if count > request["most"]:
        raise ValueError(f"{count / 2**20:.4g} MiB are asked for at once, more than {request['most'] / 2**20:.4g}")
    # a number beside a list would turn the axes round
    found = np.asarray(x.read(tuple(k if isinstance(k, slice) or np.ndim(k) else slice(k, k + 1) for k in key)))
    return found[tuple(slice(None) if isinstance(k, slice) or np.ndim(k) else 0 for k in key)]


def packed(x, blocks):
    """`x` as JSON can hold it, its arrays of numbers put to `blocks`."""
    if isinstance(x, dict):
        return {"dict": [[str(name), packed(value, blocks)] for name, value in x.items()]}
    if isinstance(x, list | tuple):
        return {"list": [packed(value, blocks) for value in x]}
    if (x is None or isinstance(x, str | int | float)) and not isinstance(x, np.generic):
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
    elif request["kind"] == "matlab":
        import h5py  # noqa: F401
        import scipy.io  # noqa: F401
    limited(request["memory"])
    watched(request["seconds"])
    blocks, read = [], part if "name" in request else outline
    try:
        answer = {"answer": packed(read(request), blocks)}
        if not request["lazy"]:
            Opened.close()
        return answer, blocks
    except Exception as error:
        # whatever it is, it is the file's: `reader` makes a sentence of it
        Opened.close()
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
