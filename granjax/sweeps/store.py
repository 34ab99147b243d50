"""Where a sweep is kept: a manifest that says what it is, a file for each chunk that is done, at the end one file.

Nothing that is read is trusted before a digest says that it is what was written; no pickle is read. Every file is
written beside its place and moved there, so that a process killed at any moment loses the chunks that it was at.
"""

import contextlib
import hashlib
import io
import json
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import xarray

from .. import exchange
from ..checks import refuse
from ..files import folder as made
from ..files import netcdf, reason, target, write
from .chunk import Chunk
from .identity import CHOSEN, differences

MANIFEST, LOCK, CHUNK = "sweep.json", "lock", re.compile(r"chunk-(\d{6,})")
# what writing leaves beside a file where the process was killed
PART = re.compile(r"\..*\.[0-9a-f]{12}\.part")
MAGIC = b"granjax chunk 1\n"
REMEDY = "Give another store, or remove this one to begin anew."
# bytes of a manifest
MOST = 2**28


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
            return
        made("store", self.folder)
        if self.file is not None:
            target("store", self.file)
        self._lock()
        manifest = self.folder / MANIFEST
        if manifest.exists():
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
        if self.file is None or not self.file.exists():
            return False
        self.result = exchange.load(self.file)
        return True

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
        own = [p.name for p in self.folder.iterdir() if p.name != LOCK and not PART.fullmatch(p.name)]
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
        self._held = open(self.folder / LOCK, "ab")
        try:
            fcntl.flock(self._held, fcntl.LOCK_EX | fcntl.LOCK_NB)
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
        for place in sorted(self.folder.iterdir()):
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
        if not place.is_file():
            raise ValueError("no file")
        held = place.read_bytes()
        begin = len(MAGIC) + 32
        if held[: len(MAGIC)] != MAGIC:
            raise ValueError("no chunk of a sweep")
        if hashlib.sha256(held[begin:]).digest() != held[len(MAGIC) : begin]:
            raise ValueError("truncated or damaged")
        if held[begin : begin + 64] != self._key().encode():
            raise ValueError("of another sweep")
        chunk, own = unpacked(held[begin + 64 :])
        if own != number or len(chunk.reasons) != count or any(x.shape[:1] != (count,) for x in chunk.columns.values()):
            raise ValueError("of another part of the sweep")
        return chunk

    def write(self, number: int, chunk: Chunk) -> None:
        """Keep a chunk. **Raises** RuntimeError where that fails (a full disk); what was kept before stays."""
        content = self._key().encode() + packed(chunk, number)
        self._write(self.folder / f"chunk-{number:06d}", MAGIC + hashlib.sha256(content).digest() + content)

    def _write(self, place, content):
        try:
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
        self._write(self.file, netcdf(data))
        for place in list(self.folder.iterdir()):
            if place.name in (MANIFEST, LOCK) or CHUNK.fullmatch(place.name) or PART.fullmatch(place.name):
                with contextlib.suppress(OSError):
                    place.unlink()
        with contextlib.suppress(OSError):
            self.folder.rmdir()


def _sha(held):
    return hashlib.sha256(held).hexdigest()


def _complete(identity):
    """Whether an identity has what every one has, of the kinds that these are."""
    kinds = {"function": dict, "parameters": dict, "versions": dict, "how": dict, "chunk": int, "design": str}
    if any(not isinstance(identity.get(name), kind) for name, kind in kinds.items()):
        return False
    function, how, order = identity["function"], identity["how"], identity.get("order", 0)
    rows = identity["parameters"].values()
    return (
        isinstance(function.get("reads"), dict) and {"name", "code"} <= function.keys()
        and all(isinstance(x, dict) and isinstance(x.get("values"), list) and x["values"]
                and {"dtype", "units"} <= x.keys() for x in rows)
        and {"kind", "static", "errors", "apart", "shared"} <= how.keys() and identity["chunk"] > 0
        and (order is None or isinstance(order, list))
    )


def _manifest(place):
    """The identity in a manifest. **Raises** ValueError for one that is damaged."""
    expected = "the manifest of a sweep"
    try:
        if place.stat().st_size > MOST:
            refuse("store", expected, f"{str(place)!r} of {place.stat().st_size} bytes", REMEDY)
        told = json.loads(place.read_bytes())
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
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError):
        found = None
    if not isinstance(found, dict) or not _complete(found):
        refuse("store", "the file of a sweep, or a free name", f"{str(file)!r}, which is something else", REMEDY)
    return found


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
    if not isinstance(told["told"], dict) or not all(isinstance(x, dict) for x in told["told"].values()):
        raise ValueError("told of another kind")
    return Chunk(columns, reasons, told["told"]), told["number"]
