"""Where a sweep is kept: a manifest that says what it is, a file for each chunk that is done, at the end one file.

Nothing that is read is trusted before a digest says that it is what was written; no pickle is read. Every file is
written beside its place and moved there, so that a process killed at any moment loses the chunks that it was at.
"""

import contextlib
import json
import os
import re
import weakref
import zipfile
from pathlib import Path

import xarray

from ..checks import refuse
from ..files import LONGEST, netcdf, reason, target, write
from ..files import folder as made
from . import chunk_file
from .chunk import Chunk
from .identity import CHOSEN, differences
from .manifest import REMEDY, complete, content_of, digest, manifest, told_by, written

MANIFEST, LOCK, CHUNK = "sweep.json", "lock", re.compile(r"chunk-(\d{6,})")
# what writing leaves beside a file where the process was killed
PART = re.compile(r"\..*\.[0-9a-f]{12}\.part")
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
            self._same(told_by(self.result, self.file))
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
            self._same(told_by(self.result, self.file))
            self._remove()
            return
        if self._held is not None:
            self._remove_parts()
        place = self.folder / MANIFEST
        if place.exists() or place.is_symlink():
            self._same(manifest(place))
        else:
            self._begin(place)

    @classmethod
    def opened(cls, path: str | Path) -> "Store":
        """One that is there, to be read. **Raises** ValueError where there is none."""
        self = cls.__new__(cls)
        self._place(path)
        if self._completed():
            self.identity = told_by(self.result, self.file)
        elif (self.folder / MANIFEST).is_file():
            self.identity = manifest(self.folder / MANIFEST)
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
            data = xarray.load_dataset(self.file, engine="h5netcdf")
        except (AttributeError, KeyError, OSError, RuntimeError, ValueError) as error:
            got = f"{str(self.file)!r}, which could not be read ({error})"
            refuse("store", "the file of a sweep, or a free name", got, REMEDY)
        digest = data.attrs.pop(DIGEST, None)
        if digest is not None and digest != content_of(data):
            refuse("store", "the file of a sweep", f"{str(self.file)!r}, which is damaged", REMEDY)
        self.result = data
        return True

    def _tidy(self):
        """Remove the chunks of a sweep that is complete, where the process was killed before it did."""
        if not (self.folder / MANIFEST).is_file():
            return
        try:
            same = not differences(manifest(self.folder / MANIFEST), self.identity)
            self._lock()
        except ValueError:  # of something else, or another process does so now
            return
        if same:
            self._remove()
        self.close()

    def _same(self, stored):
        """Take over what was chosen for the stored sweep. **Raises** ValueError where it is another one."""
        if not isinstance(stored, dict) or not complete(stored):
            refuse("store", "the store of a sweep", f"{str(self.path)!r}, which says too little of itself", REMEDY)
        found = differences(stored, self.identity)
        if found:
            few = "; ".join(found[:4]) + (f"; and {len(found) - 4} more" if len(found) > 4 else "")
            refuse("store", f"{str(self.path)!r} of this sweep", f"one of another: {few}", REMEDY)
        self.identity = {**self.identity, **{key: stored.get(key) for key in CHOSEN}}

    def _begin(self, place):
        try:
            own = [p.name for p in self.folder.iterdir() if p.name != LOCK and not PART.fullmatch(p.name)]
        except OSError as error:
            refuse("store", "a folder", f"{str(self.folder)!r} ({reason(error)})", "Call it again.")
        if own:
            refuse("store", "an empty folder, or the store of this sweep",
                   f"{str(self.folder)!r} with {own[0]!r} in it and no {MANIFEST}", REMEDY)
        self._write(place, written(self.identity))

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
            self._held = os.fdopen(os.open(lock, os.O_RDWR | os.O_CREAT, 0o666), "rb")
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
                    n = int(number[1])
                    found[n] = chunk_file.read(place, n, counts[n], self._key())
                except (ValueError, KeyError, TypeError, EOFError, OSError, NotImplementedError, MemoryError,
                        zipfile.BadZipFile, RecursionError, AttributeError, IndexError, OverflowError) as error:
                    why = reason(error) if isinstance(error, (OSError, ValueError)) else type(error).__name__
                    self.remarks.append(f"{str(place)!r} is not to be trusted ({why}): it is computed anew.")
            elif place.name not in (MANIFEST, LOCK) and not PART.fullmatch(place.name):
                self.remarks.append(f"{str(place)!r} is no part of the sweep: it is left alone.")
        return found

    def _key(self):
        return digest(json.dumps(self.identity, sort_keys=True).encode())

    def write(self, number: int, chunk: Chunk) -> None:
        """Keep a chunk. **Raises** RuntimeError where that fails (a full disk); what was kept before stays."""
        self._write(self.folder / f"chunk-{number:06d}", chunk_file.written(chunk, number, self._key()))

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
        self._write(self.file, netcdf(data.assign_attrs({DIGEST: content_of(data)})))
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
