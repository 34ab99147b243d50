"""Files that compiled libraries read: MATLAB's, HDF5, NumPy's, in a process that may be lost."""

import atexit
import contextlib
import difflib
import json
import math
import os
import stat
import subprocess
import sys
import threading
import time
from multiprocessing.spawn import get_executable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..checks import refuse
from ..printing import told

# bytes of numbers that a file may hold, in all and for each of its own (deflate shrinks zeros to a thousandth); the
# reader's memory may grow by thrice as many, as they lie in the file, as floating numbers and turned, and by these
MOST, RATIO = 2**31, 1100
MEMORY = 2**28
# seconds that reading may take, beside 1 s for 10 MB, and from a disk that is slow to begin with
SECONDS, RATE, STARTING = 10, 1e7, 60
WORDS = 2**26
REMEDY = "Copy or write it anew if it is damaged; arrays that are read by other means go to gx.Traces."


KINDS = {".mat": ("matlab", "a .mat"), ".npz": ("npz", "an .npz"), ".nc": ("netcdf", "a netCDF")}
FILES = {"matlab": "a MATLAB file", "npz": "an .npz file", "netcdf": "a netCDF file"}


class Stored:
    """An array in a file: `shape`, `dtype`, and by a key (whole numbers, slices, lists) the numbers that it asks for.

    **Raises** ValueError where the file is no longer the one that was opened, is damaged, or more than 2 GiB are asked
    for at once.
    """

    def __init__(self, request: dict, what: str, name: str, shape: tuple[int, ...], dtype: str):
        self.request, self.what, self.name, self.shape = request, what, name, shape
        self.dtype = np.dtype(dtype)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: object) -> np.ndarray:
        told = [_told(k) for k in (key if isinstance(key, tuple) else (key,))]
        told += [_told(slice(None))] * (len(self.shape) - len(told))
        return np.asarray(_asked(self.request | {"name": self.name, "key": told}, self.what))


class Column(NamedTuple):
    """An array of a file: what it is there ("" for real numbers), its unit, names of its axes ("" and none unknown)."""

    array: np.ndarray | Stored
    word: str
    units: str
    axes: tuple[str, ...]
    __repr__ = told


def _told(k):
    """A key as JSON has it."""
    if isinstance(k, slice):
        return {"slice": [None if x is None else int(x) for x in (k.start, k.stop, k.step)]}
    return {"one": int(k)} if np.ndim(k) == 0 else {"at": np.asarray(k).tolist()}


def arrays(kind: str, path: str | Path, names: list[str] | None = None) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """({name: array}, {name: what it is}) of a file of arrays by name: those that are asked for, `None` all; all else.

    `kind`: "matlab", "npz" or "netcdf". "scan.gate" is a field of a struct; what it is is "" for numbers that were not
    asked for. Arrays are shaped as in MATLAB; texts and cells of words are arrays of words.
    **Raises** ValueError for a file that is none, is damaged or states more than 2 GiB of numbers.
    """
    told, others, _ = _read(kind, path, FILES[kind], names)
    left = {name: "" for name, (*_, x) in told.items() if x is None}
    return {name: x for name, (*_, x) in told.items() if x is not None}, others | left


def columns(
    kind: str, path: str | Path, names: list[str],
) -> tuple[dict[str, "Column"], dict[str, str]]:
    """The same, where numbers are read when they are asked for: {name: column} of all arrays.

    What a MATLAB file up to version 7 holds is read at once, if it is asked for.
    """
    told, others, stamp = _read(kind, path, FILES[kind], names, lazy=True)
    request = _request(kind, path, FILES[kind], names, lazy=True) | {"stamp": stamp}
    return {name: Column(Stored(request, FILES[kind], name, tuple(shape), dtype) if x is None else x, word, units,
                         tuple(axes))
            for name, (shape, dtype, word, units, axes, x) in told.items()}, others


def dataset(
    path: str | Path, lazy: bool = False,
) -> tuple[dict[str, tuple[list[str], dict, np.ndarray | Stored]], list[str], dict]:
    """({variable: (axes, attributes, array)}, coordinates, attributes) of a file that `save` wrote, by its ending.

    `lazy`: arrays of numbers are `Stored`. **Raises** ValueError as `arrays` does.
    """
    kind, what = KINDS.get(os.path.splitext(os.fsdecode(path))[1].lower(), KINDS[".nc"])
    what = f"{what} file that `save` wrote"
    told, coordinates, attributes, stamp = _read(kind, path, what, None, saved=True, lazy=lazy)
    request = _request(kind, path, what, None, saved=True, lazy=True) | {"stamp": stamp}
    found = {name: (axes, attrs, Stored(request, what, name, tuple(shape), dtype) if x is None else x)
             for name, (axes, attrs, shape, dtype, x) in told.items()}
    return found, coordinates, attributes


def regular(path: str | Path, what: str) -> tuple[Path, int]:
    """A path and how many bytes are there. **Raises** ValueError where that is no file, or an empty one."""
    try:
        path = Path(os.fsdecode(path))
        found = path.stat()
    except TypeError:
        refuse("path", "the path of a file", f"{path!r} of type {type(path).__name__}")
    except FileNotFoundError:
        refuse("path", what, f"{str(path)!r}, where there is nothing", _near(path))
    except (OSError, ValueError) as error:
        refuse("path", what, f"{str(path)[:200]!r} ({getattr(error, 'strerror', None) or error})")
    if not stat.S_ISREG(found.st_mode):
        refuse("path", what, f"{str(path)!r}, a {'folder' if stat.S_ISDIR(found.st_mode) else 'device or pipe'}")
    if not found.st_size:
        refuse("path", what, f"{str(path)!r}, which is empty")
    return path, found.st_size


def _near(path):
    try:
        near = difflib.get_close_matches(path.name, os.listdir(path.parent))
    except OSError:
        return f"There is no folder {str(path.parent)!r} that can be read."
    return f"Did you mean {' or '.join(map(repr, near))}?" if near else ""


# ------------------------------------------------------------------------------------------------- the other process


class _Running:
    """The process that reads, where one runs: whose child it is, whether it has answered before and owes an answer."""

    process: subprocess.Popen | None = None
    owner, used, busy = 0, False, False
    lock = threading.Lock()


def _request(kind, path, what, names, saved=False, lazy=False):
    """What is asked of a file: its numbers may take so much memory and time."""
    path, size = regular(path, what)
    most = MOST if lazy else min(MOST, RATIO * size)
    return {"kind": kind, "path": str(path.absolute()), "names": names, "saved": saved, "lazy": lazy, "most": most,
            "seconds": SECONDS + size / RATE, "memory": MEMORY + size + 3 * min(MOST, RATIO * size)}


def _read(kind, path, what, names, **how):
    return _asked(_request(kind, path, what, names, **how), what)


def _asked(request, what):
    """What the other process answers. One that fails after it has read other files is not taken as this one's word."""
    path, seconds = request["path"], request["seconds"]
    with _Running.lock:
        while True:
            _start()
            again, began = _Running.used, time.monotonic()
            try:
                answer = _exchanged(request)
                break
            except (EOFError, OSError):
                late = time.monotonic() - began > seconds
                code = _close()
            if late:
                refuse("path", what, f"{path!r}, which is not read within {seconds:.3g} s", REMEDY)
            if not again:
                refuse("path", what, f"{path!r}, at which reading broke down (exit code {code})", REMEDY)
    if "error" in answer:
        refuse("path", what, f"{path!r}, at which reading ended with {answer['error']!r}", REMEDY)
    return answer["answer"]


def _start():
    """Have a process that waits for requests."""
    if _Running.owner != os.getpid():
        # one of the process that this one was forked from, and not to be spoken to
        _Running.process = None
    if _Running.process is not None and _Running.process.poll() is None and not _Running.busy:
        return
    _close()
    folders = [os.path.abspath(folder) for folder in sys.path if folder]
    command = [os.fsdecode(get_executable() or ""), "-sSP", str(Path(__file__).with_name("child.py")), *folders]
    # nothing that changes what Python does, but where it is
    kept = {name: x for name, x in os.environ.items() if not name.startswith("PYTHON") or name == "PYTHONHOME"}
    threads = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}
    # a file that stays open here may be written elsewhere
    threads["HDF5_USE_FILE_LOCKING"] = "FALSE"
    try:
        _Running.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            env=kept | threads, creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except OSError as error:
        refuse("path", "that files can be read in a process of their own",
               f"{error} from {command[0]!r}", "multiprocessing.set_executable(path) says where Python is.")
    _Running.owner, _Running.used, _Running.busy = os.getpid(), False, False


def _close():
    """End the process and return its exit code."""
    process, _Running.process = _Running.process, None
    if process is None or _Running.owner != os.getpid():
        return None
    with contextlib.suppress(OSError):
        process.stdin.close()
    process.stdout.close()
    try:
        # one that has nothing to do ends, and one that breaks down takes a moment to
        return process.wait(0.5)
    except subprocess.TimeoutExpired:
        process.kill()
    return process.wait()


atexit.register(_close)


def _exchanged(request):
    """Send a request and take the answer. An interrupt ends the process: what is left of the answer is nobody's."""
    _Running.busy = True
    # it ends itself before, if it is what should run
    timer = threading.Timer(STARTING + request["seconds"] + 1, _Running.process.kill)
    timer.daemon = True
    timer.start()
    try:
        _Running.process.stdin.write(json.dumps(request).encode() + b"\n")
        _Running.process.stdin.flush()
        count = int.from_bytes(_bytes(8), "little")
        if count > WORDS:
            raise EOFError
        answer = json.loads(_bytes(count).tobytes())
        answer = answer if "error" in answer else {"answer": _unpacked(answer["answer"])}
        _Running.used, _Running.busy = True, False
        return answer
    except (KeyError, TypeError, ValueError, MemoryError):
        raise EOFError from None
    except KeyboardInterrupt:
        _close()
        raise
    finally:
        timer.cancel()


def _bytes(count):
    """The next bytes of an answer."""
    found = np.empty(count, np.uint8)
    view, done = memoryview(found), 0
    while done < count:
        more = _Running.process.stdout.readinto(view[done:])
        if not more:
            raise EOFError
        done += more
    return found


def _unpacked(x):
    if "dict" in x:
        return {name: _unpacked(value) for name, value in x["dict"]}
    if "list" in x:
        return [_unpacked(value) for value in x["list"]]
    if "plain" in x:
        return x["plain"]
    if "words" in x:
        array = np.array(x["words"], object).astype(x["type"]).reshape(x["shape"])
        return array[()] if x["scalar"] else array
    kind = np.dtype(x["type"])
    array = _bytes(kind.itemsize * math.prod(x["shape"])).view(kind).reshape(x["shape"])
    return array[()] if x["scalar"] else array
