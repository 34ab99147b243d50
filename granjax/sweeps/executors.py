"""Where the chunks of a sweep are computed: threads, processes of our own, any executor; and workers that die."""

import contextlib
import math
import os
import time
import uuid
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, ProcessPoolExecutor, ThreadPoolExecutor, wait
from typing import Any

from ..checks import described, is_whole, refuse, whole
from ..tuning import pools
from . import workers
from .chunk import Chunk

# deaths of a worker after which a chunk is given up; those after which it is alone at work
DEATHS, SUSPECT = 3, 2
# chunks that are given to every worker; seconds between two looks at how many workers a cluster has, and until it is
# said that there is none
AHEAD, RECOUNT, PATIENCE = 2, 1.0, 10.0
# seconds between two looks at the chunks that are at work, between which Ctrl-C is answered
LOOK = 0.05
# processes per core
CROWD = 8
UNGUARDED = (
    "executor: the processes ended as they started. A script that starts processes must hold what it does under "
    '`if __name__ == "__main__":`, because each of them imports the script. Or leave executor=None: threads.'
)
FORKED = (
    "The processes of this executor would be forked, which JAX's threads do not survive: as many fresh ones take their "
    'place. Give executor=N, or ProcessPoolExecutor(N, multiprocessing.get_context("spawn")).'
)


def completed(
    task: Callable[[dict], Chunk], chunks: Sequence[tuple[int, dict]], executor: Any = None, threads: int = 1
) -> Iterator[tuple[int, Chunk]]:
    """The chunks of a sweep as they are finished, in any order.

    - `executor`: `None` is `threads` threads of this process (JAX runs their programs side by side on one device); a
      whole number as many processes of our own, started afresh ("spawn"); or any `concurrent.futures.Executor`, Dask's
      `Client.get_executor()` among them, which is left open.
    - A chunk whose worker dies is computed again, the third time with nothing else at work; then it is given up, and
      every lane of it has the reason. What `task` raises is the reason, too. Finished chunks are never lost.
    - At most two chunks per worker are given away at a time. Ctrl-C, or closing the iterator, takes back what has not
      begun, and ends processes of our own.

    **Raises** ValueError for what is no executor, a task that cannot be sent; RuntimeError where workers cannot begin.
    """
    checked_executor(executor)
    chunks = list(chunks)
    if executor is None and (threads == 1 or len(chunks) < 2):
        return _in_turn(task, chunks)
    return _limited(_Crew(task, executor, threads, max(len(chunks), 1)), chunks)


def checked_executor(executor: Any) -> None:
    """Refuse what is no executor, before anything is computed.

    A process that imports a script without a guard would begin the script's sweep, and touch its store. It ends here,
    silently: where the script was started it is said why.
    """
    if is_whole(executor):
        most = CROWD * (os.cpu_count() or 1)
        if whole("executor", executor, 1) > most:
            refuse("executor", f"at most {most} processes on {os.cpu_count()} cores", str(executor))
    elif executor is not None and not isinstance(executor, Executor):
        remedy = "Give None for threads, a number of processes, or a concurrent.futures.Executor."
        if hasattr(executor, "get_executor"):
            remedy = "Give its executor: client.get_executor()."
        refuse("executor", "None, a whole number, or a concurrent.futures.Executor", described(executor), remedy)
    if (is_whole(executor) or isinstance(executor, ProcessPoolExecutor)) and workers.imports_script():
        raise SystemExit(1)


def _in_turn(task, chunks):
    for number, values in chunks:
        with pools().limit(limits=1):
            chunk = workers.attempt(task, values)
        yield number, chunk


def _limited(crew, chunks):
    """LAPACK on one thread wherever chunks are computed, so that they do not depend on where that is."""
    with pools().limit(limits=1) if crew.near else contextlib.nullcontext():
        yield from _finished(crew, chunks)


def _finished(crew, chunks):
    """Give chunks away, a few at a time, and hand on what comes back."""
    waiting, suspects, flying, deaths = deque(chunks), deque(), {}, Counter()
    try:
        while waiting or suspects or flying:
            while crew.takes(flying, waiting):
                crew.send(flying, waiting)
            if suspects and not waiting and not flying and not crew.broken:
                crew.send(flying, suspects)
            for future in wait(flying, LOOK, FIRST_COMPLETED).done:
                number, values = flying.pop(future)
                error = crew.lost(future)
                if error is None:
                    yield number, future.result()
                    continue
                deaths[number] += SUSPECT if type(error).__name__ == "KilledWorker" else 1
                if deaths[number] >= DEATHS:
                    yield number, workers.given_up(values, _reason(error))
                else:
                    (suspects if deaths[number] >= SUSPECT else waiting).append((number, values))
            if crew.broken and not flying:
                crew.renew()
    except BaseException:
        crew.leave(flying)
        raise
    crew.end()


def _reason(error):
    said = workers.told(error)
    return f"A worker died at this chunk, {DEATHS} times ({said}). Did it crash, or run out of memory?"


class _Crew:
    """An executor, what is sent to it, and what is done where it breaks."""

    def __init__(self, task, executor, threads, most):
        self.own, self.broken, self.greeted = False, False, None
        self.counted, self.manned = (-math.inf, 0), time.monotonic()
        if executor is None:
            executor = workers.Threads(threads)
        elif not isinstance(executor, Executor):
            executor, self.own = workers.processes(min(int(executor), most)), True
        elif isinstance(executor, ProcessPoolExecutor) and workers.forks(executor):
            warnings.warn(FORKED, stacklevel=3)
            executor, self.own = workers.alike(executor), True
        self.executor, self.near = executor, isinstance(executor, (workers.Threads, ThreadPoolExecutor))
        if self.near:
            self.work, self.sent = workers.near, (task, workers.float64())
        else:
            self.work, self.sent = workers.far, (*workers.packed(task), workers.setting())

    def workers(self):
        """How many chunks the executor works at, at a time. That of a cluster may change."""
        (asked, count), now = self.counted, time.monotonic()
        if now - asked > RECOUNT:
            count = _workers(self.executor)
            self.counted = now, count
        if count:
            self.manned = now
        elif now - self.manned > PATIENCE:
            warnings.warn("executor: the cluster has no workers; the sweep waits for some.", stacklevel=2)
            self.manned = math.inf
        return count

    def takes(self, flying, waiting):
        ahead = 1 if isinstance(self.executor, workers.Threads) else AHEAD
        most = ahead * max(self.workers(), 1)
        return waiting and not self.broken and len(flying) < most

    def send(self, flying, waiting):
        try:
            if self.greeted is None and isinstance(self.executor, ProcessPoolExecutor):
                with workers.undisturbed():
                    self.greeted = self.executor.submit(os.getpid)
            # a cluster takes a call with the same arguments for the same call, whatever became of it
            future = self.executor.submit(self.work, *self.sent, waiting[0][1], uuid.uuid4().hex)
        except BrokenExecutor:
            self._break()
        except RuntimeError as error:
            raise RuntimeError(f"executor: it takes no chunks any more ({error}). Give one that is open.") from error
        else:
            flying[future] = waiting.popleft()

    def lost(self, future):
        """What has become of a chunk that did not come back, `None` where it did."""
        error = RuntimeError("cancelled") if future.cancelled() else future.exception()
        if isinstance(error, workers.NotThere):
            raise RuntimeError(f"executor: {error}") from None
        if isinstance(error, ImportError):
            raise RuntimeError(f"executor: a worker cannot load granjax ({error}). Install the same versions there.")
        if isinstance(error, BrokenExecutor):
            self._break()
        client = getattr(self.executor, "_client", None)
        if error is not None and getattr(client, "status", "running") != "running":
            raise RuntimeError(f"executor: the cluster is gone (its client is {client.status}).") from error
        return error

    def _break(self):
        """Processes that end before one of them has answered end in what they import: fresh ones would, too."""
        self.broken, greeted = True, self.greeted
        if greeted is not None and wait([greeted], 1.0).done and (greeted.cancelled() or greeted.exception()):
            self.end()
            raise RuntimeError(UNGUARDED)

    def renew(self):
        """A fresh executor in place of one that broke."""
        old = self.executor
        self.end()
        if isinstance(old, ProcessPoolExecutor):
            self.executor = workers.alike(old)
        elif type(old).__module__.split(".")[0] == "loky":
            self.executor = workers.processes(_workers(old))
        else:
            raise RuntimeError(f"executor: {type(old).__name__} broke and takes no chunks any more. Give a fresh one.")
        self.own, self.broken, self.greeted = True, False, None

    def leave(self, flying):
        """Take back what has not begun, and wait for nothing."""
        if not self.broken:  # its own thread ends the chunks of a broken one, and would find them cancelled
            for future in flying:
                future.cancel()
        if self.own:
            processes = list((getattr(self.executor, "_processes", None) or {}).values())
            self.executor.shutdown(wait=False, cancel_futures=not self.broken)
            for process in processes:
                process.terminate()

    def end(self):
        if self.own:
            self.executor.shutdown(wait=not self.broken)


def _workers(executor):
    client = getattr(executor, "_client", None)
    if client is not None:
        with contextlib.suppress(Exception):
            return sum(client.nthreads().values())
    counts = (getattr(executor, name, None) for name in ("_max_workers", "num_workers"))
    return next((n for n in counts if isinstance(n, int) and n > 0), os.cpu_count() or 1)


