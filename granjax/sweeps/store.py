"""Where a sweep is kept: a manifest that says what it is, a file for each chunk that is done, at the end one file.

Nothing that is read is trusted before a digest says that it is what was written; no pickle is read. Every file is
written beside its place and moved there, so that a process killed at any moment loses the chunks that it was at.
"""

import contextlib
import hashlib
import io
import json
import math
import os
import re
import weakref
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import xarray

from .. import exchange
from ..checks import refuse
from ..files import LONGEST, netcdf, reason, target, write
from ..files import folder as made
from .chunk import Chunk
from .identity import CHOSEN, differences

MANIFEST, LOCK, CHUNK = "sweep.json", "lock", re.compile(r"chunk-(\d{6,})")
# what writing leaves beside a file where the process was killed
PART = re.compile(r"\..*\.[0-9a-f]{12}\.part")
MAGIC = b"granjax chunk 1\n"
DTYPE = re.compile(r"(u?int|float)(8|16|32|64)|bool|<U[1-9][0-9]{0,5}")
REMEDY = "Give another store, or remove this one to begin anew."
# bytes of a manifest; lanes of a sweep; bytes that say how many follow
MOST, LANES, LENGTH = 2**28, 10**8, 8
# an attribute of a file: the digest of all else in it
DIGEST = "sha256"
# files by which stores are locked: a forked process shares them, and may outlive the one that holds the lock
_locks: weakref.WeakSet = weakref.WeakSet()


def _let_go():
    for file in list(_locks):
        file.close()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go)


class Store:
    """The store of a sweep at a path, begun or gone on with.

    NAME.nc: at the end one file, until then a folder NAME.nc.chunks beside it. A path without an ending: a folder.

    - `identity`: what the sweep is; what is chosen by itself as the store was begun with.
    - `result`: the `xarray.Dataset` of a sweep that is complete, else `None`.
    - `remarks`: sentences about files that were found and not trusted.

    **Raises** ValueError for a store of another sweep, with the difference; one that another process is at; one that
    cannot be written; a manifest or a file of that name that is damaged or something else.
    """

    def __init__(self, path: str | Path, identity: dict):
        self._place(path)
        self.identity = identity
        if self._completed():
            self._same(_told(self.result, self.file))
            self._tidy()
            return
        made("store", self.folder)
        if self.file is not None:
            target("store", self.file)
        self._lock()
        with contextlib.ExitStack() as refused:
            refused.callback(self.close)
            self._resume()
            refused.pop_all()

    def _resume(self):
        # another process may just have ended
        if self._completed():
            self._same(_told(self.result, self.file))
            self._remove()
            return
        if self._held is not None:
            self._remove_parts()
        manifest = self.folder / MANIFEST
        if manifest.exists() or manifest.is_symlink():
            self._same(_manifest(manifest))
        else:
            self._begin(manifest)

    @classmethod
    def opened(cls, path: str | Path) -> "Store":
        """One that is there, to be read. **Raises** ValueError where there is none."""
        self = cls.__new__(cls)
        self._place(path)
        if self._completed():
            self.identity = _told(self.result, self.file)
        elif (self.folder / MANIFEST).is_file():
            self.identity = _manifest(self.folder / MANIFEST)
        else:
            refuse("store", "the store of a sweep", f"{str(path)!r}, where there is none")
        return self

    def _place(self, path):
        self.path, self.remarks, self.result, self._held = Path(path), [], None, None
        ending = self.path.suffix.lower()
        if ending not in ("", ".nc"):
            refuse("store", "a name that ends in .nc, or a folder's without an ending", repr(self.path.name))
        self.file = self.path if ending else None
        self.folder = self.path.with_name(f"{self.path.name}.chunks") if ending else self.path

    def _completed(self):
        """Read the file of a sweep that is complete, where it is there."""
        try:
            if self.file is None or not self.file.exists():
                return False
        except OSError as error:
            refuse("store", "a path", f"{str(self.path)[:200]!r} ({reason(error)})")
        try:
            data = exchange.load(self.file)
        except ValueError as error:
            got = f"{str(self.file)!r}, which is none ({error})"
            refuse("store", "the file of a sweep, or a free name", got, REMEDY)
        digest = data.attrs.pop(DIGEST, None)
        if digest is not None and digest != _content(data):
            refuse("store", "the file of a sweep", f"{str(self.file)!r}, which is damaged", REMEDY)
        self.result = data
        return True

    def _tidy(self):
        """Remove the chunks of a sweep that is complete, where the process was killed before it did."""
        if not (self.folder / MANIFEST).is_file():
            return
        try:
            same = not differences(_manifest(self.folder / MANIFEST), self.identity)
            self._lock()
        except ValueError:  # of something else, or another process does so now
            return
        if same:
            self._remove()
        self.close()

    def _same(self, stored):
        """Take over what was chosen for the stored sweep. **Raises** ValueError where it is another one."""
        if not isinstance(stored, dict) or not _complete(stored):
            refuse("store", "the store of a sweep", f"{str(self.path)!r}, which says too little of itself", REMEDY)
        found = differences(stored, self.identity)
        if found:
            few = "; ".join(found[:4]) + (f"; and {len(found) - 4} more" if len(found) > 4 else "")
            refuse("store", f"{str(self.path)!r} of this sweep", f"one of another: {few}", REMEDY)
        self.identity = {**self.identity, **{key: stored.get(key) for key in CHOSEN}}

    def _begin(self, manifest):
        try:
            own = [p.name for p in self.folder.iterdir() if p.name != LOCK and not PART.fullmatch(p.name)]
        except OSError as error:
            refuse("store", "a folder", f"{str(self.folder)!r} ({reason(error)})", "Call it again.")
        if own:
            refuse("store", "an empty folder, or the store of this sweep",
                   f"{str(self.folder)!r} with {own[0]!r} in it and no {MANIFEST}", REMEDY)
        text = json.dumps(self.identity)
        self._write(manifest, json.dumps({"identity": text, "sha256": _sha(text.encode())}))

    def _lock(self):
        """Keep other processes away for as long as this one is at work: the system lets go where it is killed."""
        try:
            import fcntl
        except ImportError:  # where there is none, the last to write a chunk stays, and both have the same
            return
        lock = self.folder / LOCK
        try:
            if lock.is_symlink() or lock.exists() and not lock.is_file():
                refuse("store", "a folder of a sweep's", f"{str(lock)!r}, which is no ordinary file", REMEDY)
            self._held = open(lock, "ab")
            _locks.add(self._held)
        except OSError as error:
            refuse("store", "a folder that can be written", f"{str(lock)!r} ({reason(error)})")
        try:
            fcntl.flock(self._held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not lock.exists() or not os.path.samestat(os.fstat(self._held.fileno()), lock.stat()):
                # the one that was at it has just completed it, and removed the folder
                raise BlockingIOError
        except BlockingIOError:
            self.close()
            refuse("store", "one that nobody else is at work at", f"{str(self.path)!r}, which another sweep writes now",
                   "Wait for that one, or give another store.")
        except OSError:  # a file system without locks
            self.close()

    def close(self) -> None:
        """Let others at it."""
        if self._held is not None:
            self._held.close()
            self._held = None

    def chunks(self, counts: list[int]) -> dict[int, Chunk]:
        """The chunks that are done, by their numbers; `counts`: of the lanes that each of them has."""
        found = {}
        try:
            places = sorted(self.folder.iterdir())
        except OSError as error:
            refuse("store", "a folder that can be read", f"{str(self.folder)!r} ({reason(error)})")
        for place in places:
            number = CHUNK.fullmatch(place.name)
            if number is not None and int(number[1]) < len(counts):
                try:
                    found[int(number[1])] = self._read(place, int(number[1]), counts[int(number[1])])
                except (ValueError, KeyError, TypeError, EOFError, OSError, NotImplementedError, MemoryError,
                        zipfile.BadZipFile, RecursionError, AttributeError, IndexError, OverflowError) as error:
                    why = reason(error) if isinstance(error, (OSError, ValueError)) else type(error).__name__
                    self.remarks.append(f"{str(place)!r} is not to be trusted ({why}): it is computed anew.")
            elif place.name not in (MANIFEST, LOCK) and not PART.fullmatch(place.name):
                self.remarks.append(f"{str(place)!r} is no part of the sweep: it is left alone.")
        return found

    def _key(self):
        return _sha(json.dumps(self.identity, sort_keys=True).encode())

    def _read(self, place, number, count):
        if place.is_symlink() or not place.is_file():
            raise ValueError("no ordinary file")
        begin = len(MAGIC) + 32
        with open(place, "rb") as file:
            head = file.read(begin + LENGTH)
            if head[: len(MAGIC)] != MAGIC:
                raise ValueError("no chunk of a sweep")
            # before so many bytes are read
            if place.stat().st_size - begin != int.from_bytes(head[begin:], "big"):
                raise ValueError("truncated or damaged")
            held = head + file.read()
        if hashlib.sha256(held[begin:]).digest() != held[len(MAGIC) : begin]:
            raise ValueError("truncated or damaged")
        begin += LENGTH
        if held[begin : begin + 64] != self._key().encode():
            raise ValueError("of another sweep")
        chunk, own = unpacked(held[begin + 64 :])
        if own != number or len(chunk.reasons) != count or any(x.shape[:1] != (count,) for x in chunk.columns.values()):
            raise ValueError("of another part of the sweep")
        return chunk

    def write(self, number: int, chunk: Chunk) -> None:
        """Keep a chunk. **Raises** RuntimeError where that fails (a full disk); what was kept before stays."""
        content = self._key().encode() + packed(chunk, number)
        content = (LENGTH + len(content)).to_bytes(LENGTH, "big") + content
        self._write(self.folder / f"chunk-{number:06d}", MAGIC + hashlib.sha256(content).digest() + content)

    def _write(self, place, content):
        try:
            if place != self.file and place.is_symlink():  # what it leads to is another's
                place.unlink()
            write(place, content)
        except OSError as error:
            raise RuntimeError(
                f"store: {str(place)!r} could not be written ({reason(error)}). What is done stays in "
                f"{str(self.folder)!r}: the same call goes on from there."
            ) from error

    def finish(self, data: xarray.Dataset) -> None:
        """Write the file of a sweep that is complete, and then remove its chunks. A folder stays as it is."""
        if self.file is None:
            return
        if self.file.exists():
            refuse("store", "the name of no other file", f"{str(self.file)!r}, which has come to be meanwhile",
                   f"It is left as it is: move it away and call again; the results are in {str(self.folder)!r}.")
        self._write(self.file, netcdf(data.assign_attrs({DIGEST: _content(data)})))
        self._remove()

    def _remove_parts(self):
        """What a killed process has left half-written; who holds the lock is the only one that writes."""
        beside = []
        if self.file is not None:
            begin = f".{os.fsencode(self.file.name)[:LONGEST].decode(errors='ignore')}."
            beside = [place for place in self.file.parent.iterdir() if place.name.startswith(begin)]
        for place in [*self.folder.iterdir(), *beside]:
            if PART.fullmatch(place.name):
                with contextlib.suppress(OSError):
                    place.unlink()

    def _remove(self):
        # the manifest last: what is left by a process that is killed here is still known
        for place in sorted(self.folder.glob("*"), key=lambda place: place.name == MANIFEST):
            if place.name in (MANIFEST, LOCK) or CHUNK.fullmatch(place.name) or PART.fullmatch(place.name):
                with contextlib.suppress(OSError):
                    place.unlink()
        with contextlib.suppress(OSError):
            self.folder.rmdir()


def _sha(held):
    return hashlib.sha256(held).hexdigest()


def _content(data: xarray.Dataset) -> str:
    """A digest of all that a dataset holds, the same before it is written and after it was read."""
    digest = hashlib.sha256(repr(sorted((str(k), str(x)) for k, x in data.attrs.items())).encode())
    for name in sorted(map(str, data.variables)):
        x = data.variables[name]
        held = x.values
        digest.update(repr((name, x.dims, x.shape, sorted((str(k), str(u)) for k, u in x.attrs.items()))).encode())
        if held.dtype.kind in "iufc":
            digest.update(held.astype(held.dtype.newbyteorder("<")).tobytes())
        else:
            digest.update(repr(held.astype(int if held.dtype.kind == "b" else str).tolist()).encode())
    return digest.hexdigest()


def _complete(identity):
    """Whether an identity has what every one has, of the kinds that these are."""
    kinds = {"function": dict, "parameters": dict, "versions": dict, "how": dict, "chunk": int, "design": str}
    if any(not isinstance(identity.get(name), kind) for name, kind in kinds.items()) or identity.get("format") != 1:
        return False
    function, how, order, parameters = (identity.get(name) for name in ("function", "how", "order", "parameters"))
    rows = parameters.values()
    if not (
        isinstance(function.get("reads"), dict) and isinstance(function.get("name"), str) and "code" in function
        and rows and all(isinstance(x, dict) and isinstance(x.get("values"), list) and x["values"]
                         and isinstance(x.get("dtype"), str) and DTYPE.fullmatch(x["dtype"])
                         and isinstance(x.get("units"), str) for x in rows)
        and identity["design"] in ("grid", "list") and type(identity["chunk"]) is int and identity["chunk"] > 0
    ):
        return False
    sizes = [len(x["values"]) for x in rows]
    count = math.prod(sizes) if identity["design"] == "grid" else sizes[0]
    return (
        0 < count <= LANES and (identity["design"] == "grid" or len(set(sizes)) == 1)
        and how.get("kind") in ("lanes", "vmap", "each") and isinstance(how.get("errors"), bool)
        and all(isinstance(how.get(key), list) and all(name in list(parameters) for name in how[key])
                for key in ("static", "shared"))
        and _numbers(how.get("apart"), count) and len(set(how["apart"])) == len(how["apart"])
        and (order is None or _numbers(order, count) and len(order) == len(set(order)) == count)
        and isinstance(identity.get("scene", ""), str)
    )


def _numbers(x, count):
    """Whether it is a list of numbers of lanes."""
    return isinstance(x, list) and all(type(n) is int and 0 <= n < count for n in x)


def _manifest(place):
    """The identity in a manifest. **Raises** ValueError for one that is damaged."""
    expected = "the manifest of a sweep"
    if place.is_symlink() or not place.is_file():
        refuse("store", expected, f"{str(place)!r}, which is no ordinary file", REMEDY)
    try:
        if place.stat().st_size > MOST:
            refuse("store", expected, f"{str(place)!r} of {place.stat().st_size} bytes", REMEDY)
        told = json.loads(place.read_bytes().decode())
        text = told["identity"]
        whole = told["sha256"] == _sha(text.encode())
        found = json.loads(text) if whole else None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        whole = False
    except OSError as error:
        refuse("store", expected, f"{str(place)!r} ({reason(error)})", REMEDY)
    if not whole or not isinstance(found, dict) or not _complete(found):
        refuse("store", expected, f"{str(place)!r}, which is truncated, damaged or something else", REMEDY)
    return found


def _told(data: xarray.Dataset, file) -> Any:
    """What the file of a sweep says that it is of."""
    try:
        found = json.loads(data.attrs["sweep"])
        for name, x in found["parameters"].items():
            x["values"] = data[name].values.astype(x["dtype"]).tolist()
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError, OverflowError, MemoryError):
        found = None
    if not isinstance(found, dict) or not _complete(found):
        refuse("store", "the file of a sweep, or a free name", f"{str(file)!r}, which is something else", REMEDY)
    return found


def _words(told):
    """Whether it is what is known of a column: words, and names of axes."""
    return isinstance(told, dict) and all(
        isinstance(x, str) if name != "dims" else isinstance(x, list) and all(isinstance(dim, str) for dim in x)
        and len(set(x)) == len(x) for name, x in told.items())


def packed(chunk: Chunk, number: int) -> bytes:
    """A chunk as the bytes of an `.npz` of numbers and words, the rest as JSON in it."""
    told = {"number": number, "names": list(chunk.columns), "reasons": chunk.reasons, "told": chunk.told}
    arrays = {f"x{i}": np.asarray(x) for i, x in enumerate(chunk.columns.values())}
    buffer = io.BytesIO()
    np.savez(buffer, told=np.frombuffer(json.dumps(told).encode(), np.uint8), **arrays)
    return buffer.getvalue()


def unpacked(held: bytes) -> tuple[Chunk, int]:
    """The chunk that `packed` made these bytes of, and its number. **Raises** what NumPy does for other ones."""
    with zipfile.ZipFile(io.BytesIO(held)) as members:
        if sum(member.file_size for member in members.infolist()) > len(held):
            raise ValueError("it states more than it holds")
    with np.load(io.BytesIO(held), allow_pickle=False) as arrays:
        told = json.loads(arrays["told"].tobytes())
        columns = {str(name): arrays[f"x{i}"] for i, name in enumerate(told["names"])}
    if any(x.dtype.kind not in "biufcU" for x in columns.values()):
        raise ValueError("values of another kind")
    reasons = told["reasons"]
    if not isinstance(reasons, list) or not all(isinstance(x, str) for x in reasons) or type(told["number"]) is not int:
        raise ValueError("reasons of another kind")
    if not isinstance(told["told"], dict) or not all(map(_words, told["told"].values())):
        raise ValueError("told of another kind")
    return Chunk(columns, reasons, told["told"]), told["number"]
