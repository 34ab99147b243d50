"""Where the chunks of a sweep are computed: threads, processes of our own, any executor; and workers that die."""

import contextlib
import hashlib
import importlib.util
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
import uuid
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from typing import Any

import jax

from ..checks import described, is_whole, refuse, whole
from ..interrupts import LOOK, Aside
from ..tuning import pools
from .chunk import Chunk

# deaths of a worker after which a chunk is given up; those after which it is alone at work
DEATHS, SUSPECT = 3, 2
# chunks that are given to every worker; seconds between two looks at how many workers a cluster has
AHEAD, RECOUNT = 2, 1.0
# tasks that a process of a worker keeps
KEPT = 4
UNGUARDED = (
    "executor: the processes ended as they started. A script that starts processes must hold what it does under "
    '`if __name__ == "__main__":`, because each of them imports the script. Or leave executor=None: threads.'
)
CLUSTER = "pip install 'granjax[cluster]'"


class NotThere(RuntimeError):
    """What a worker says where the task cannot begin there at all."""


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
    chunks = list(chunks)
    if executor is None and (threads == 1 or len(chunks) < 2):
        return _in_turn(task, chunks)
    crew = _Crew(task, executor, threads)
    return _limited(crew, chunks)


def _in_turn(task, chunks):
    for number, values in chunks:
        with pools().limit(limits=1):
            chunk = _attempt(task, values)
        yield number, chunk


def _attempt(task, values):
    """A chunk; what the task raises is the reason of every lane."""
    try:
        return task(values)
    except (Exception, SystemExit) as error:
        return _given_up(values, f"{type(error).__name__}: {error}".strip(": "))


def _given_up(values, reason):
    return Chunk({}, [reason] * (len(next(iter(values.values()))) if values else 1), {})


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
            if suspects and not waiting and not flying and crew.whole():
                crew.send(flying, suspects)
            for future in wait(flying, LOOK, FIRST_COMPLETED).done:
                number, values = flying.pop(future)
                error = crew.lost(future)
                if error is None:
                    yield number, future.result()
                    continue
                deaths[number] += SUSPECT if type(error).__name__ == "KilledWorker" else 1
                if deaths[number] >= DEATHS:
                    yield number, _given_up(values, _reason(error))
                else:
                    (suspects if deaths[number] >= SUSPECT else waiting).append((number, values))
            if crew.broken and not flying:
                crew.renew()
    except BaseException:
        crew.leave(flying)
        raise
    crew.end()


def _reason(error):
    told = f"{type(error).__name__}: {error}".strip(": ").splitlines()[0]
    return f"The worker died at this chunk, {DEATHS} times ({told}). A crash, or more memory than there is?"


class _Crew:
    """An executor, what is sent to it, and what is done where it breaks."""

    def __init__(self, task, executor, threads):
        self.own, self.broken, self.greeted, self.counted = False, False, None, (-RECOUNT, 0)
        if executor is None:
            executor = _Threads(threads)
        elif not isinstance(executor, Executor):
            count = whole("executor", executor, 1) if is_whole(executor) else _no_executor(executor)
            executor, self.own = _processes(count), True
        if isinstance(executor, ProcessPoolExecutor) and _imports_script():
            raise SystemExit(1)  # where the script was started it is said why
        self.executor, self.near = executor, isinstance(executor, (_Threads, ThreadPoolExecutor))
        if self.near:
            self.work, self.sent = _near, (task, _float64())
        else:
            packed = _packed(task)
            self.work, self.sent = _far, (packed, hashlib.sha256(packed).hexdigest(), _setting())

    def workers(self):
        """How many chunks the executor works at, at a time. That of a cluster may change."""
        asked, count = self.counted
        if time.monotonic() - asked > RECOUNT:
            count = _workers(self.executor)
            self.counted = time.monotonic(), count
        return count

    def takes(self, flying, waiting):
        ahead = 1 if isinstance(self.executor, _Threads) else AHEAD
        return bool(waiting) and self.whole() and len(flying) < ahead * self.workers()

    def whole(self):
        return not self.broken

    def send(self, flying, waiting):
        try:
            if self.greeted is None and isinstance(self.executor, ProcessPoolExecutor):
                self.greeted = self.executor.submit(os.getpid)
            # a cluster takes a call with the same arguments for the same call, whatever became of it
            future = self.executor.submit(self.work, *self.sent, waiting[0][1], uuid.uuid4().hex)
        except BrokenExecutor:
            self.broken = True
        except RuntimeError as error:
            raise RuntimeError(f"executor: it takes no chunks any more ({error}). Give one that is open.") from error
        else:
            flying[future] = waiting.popleft()

    def lost(self, future):
        """What has become of a chunk that did not come back, `None` where it did."""
        error = RuntimeError("cancelled") if future.cancelled() else future.exception()
        if isinstance(error, NotThere):
            raise RuntimeError(f"executor: {error}") from None
        if isinstance(error, ImportError):
            raise RuntimeError(f"executor: a worker cannot load granjax ({error}). Install the same versions there.")
        if isinstance(error, BrokenExecutor):
            self.broken = True
            self._look_at_greeting()
        client = getattr(self.executor, "_client", None)
        if error is not None and getattr(client, "status", "running") != "running":
            raise RuntimeError(f"executor: the cluster is gone (its client is {client.status}).") from error
        return error

    def _look_at_greeting(self):
        """Processes that end before one of them has answered end in what they import."""
        greeted = self.greeted
        if greeted is not None and wait([greeted], 1.0).done and (greeted.cancelled() or greeted.exception()):
            self.end()
            raise RuntimeError(UNGUARDED)

    def renew(self):
        """A fresh executor in place of one that broke."""
        old = self.executor
        self.end()
        if isinstance(old, ProcessPoolExecutor):
            self.executor = _processes(old._max_workers, old._mp_context, old._initializer, old._initargs)
        elif type(old).__module__.split(".")[0] == "loky":
            self.executor = _processes(_workers(old))
        else:
            raise RuntimeError(f"executor: {type(old).__name__} broke and takes no chunks any more. Give a fresh one.")
        self.own, self.broken, self.greeted = True, False, None

    def leave(self, flying):
        """Take back what has not begun, and wait for nothing."""
        for future in flying:
            future.cancel()
        if self.own:
            processes = list((getattr(self.executor, "_processes", None) or {}).values())
            self.executor.shutdown(wait=False, cancel_futures=True)
            for process in processes:
                process.terminate()

    def end(self):
        if self.own:
            self.executor.shutdown(wait=not self.broken)


def _imports_script():
    """Whether this is a process that imports the script, before it does what it was started for."""
    return getattr(multiprocessing.current_process(), "_inheriting", False)


def _no_executor(executor):
    remedy = "Give None for threads, a number of processes, or a concurrent.futures.Executor."
    if hasattr(executor, "get_executor"):
        remedy = "Give its executor: client.get_executor()."
    refuse("executor", "None, a whole number, or a concurrent.futures.Executor", described(executor), remedy)


def _workers(executor):
    client = getattr(executor, "_client", None)
    if client is not None:
        with contextlib.suppress(Exception):
            return max(sum(client.nthreads().values()), 1)
    counts = (getattr(executor, name, None) for name in ("_max_workers", "num_workers"))
    return next((n for n in counts if isinstance(n, int) and n > 0), os.cpu_count() or 1)


class _Threads(Executor):
    """A thread for each chunk, which may be left at work after Ctrl-C. Nobody gives it more than it has threads."""

    def __init__(self, threads):
        self._max_workers = threads

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        future.set_running_or_notify_cancel()

        def work():
            try:
                found = fn(*args, **kwargs)
            except BaseException as error:
                future.set_exception(error)
            else:
                future.set_result(found)

        Aside(work, "granjax: sweep").start()
        return future


def _processes(count, context=None, begin=None, given=()):
    """Processes that start afresh: JAX holds threads, which a fork would break."""
    context = context or multiprocessing.get_context("spawn")
    begin, given = (begin, given) if begin else (_begin, (_kept_programs(),))
    return ProcessPoolExecutor(count, context, begin, given)


def _kept_programs():
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs", "jax_platforms")
    return {name: getattr(jax.config, name) for name in names}


def _begin(settings):
    """What a process of ours does first: leave Ctrl-C to the one that started it, and end when that one does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    for name, value in settings.items():
        jax.config.update(name, value)


def _end_with_parent():
    multiprocessing.parent_process().join()
    os._exit(1)


def _pickler():
    if importlib.util.find_spec("cloudpickle") is None:
        return pickle
    import cloudpickle

    return cloudpickle


def _packed(task):
    """The bytes of a task."""
    try:
        return _pickler().dumps(task)
    except Exception as error:
        told = f"{type(error).__name__}: {error}".splitlines()[0]
        remedy = "Make files, locks and the like within the function, or leave executor=None: threads."
        if _pickler() is pickle:
            remedy = f"For functions of notebooks and lambdas {CLUSTER}. {remedy}"
        refuse("function", "one that can be sent to another process", f"one that cannot ({told})", remedy)


def _float64():
    return bool(jax.config.jax_enable_x64)


def _setting():
    """What must be alike where a chunk is computed."""
    own = sys.modules[__package__.split(".")[0]].__version__
    return {"granjax": own, "jax": jax.__version__, "float64": _float64()}


def _near(task, float64, values, _):
    with _floats(float64):
        return _attempt(task, values)


def _floats(float64):
    """Numbers of so many bits in this thread."""
    if _float64() == float64:
        return contextlib.nullcontext()
    from jax._src import config

    return config.enable_x64(float64)


def _far(packed, digest, setting, values, _):
    """A chunk, in a process of a worker."""
    with pools().limit(limits=1), _floats(setting["float64"]):
        differ = [f"{name} {x}, here {setting[name]}" for name, x in _setting().items() if x != setting[name]]
        if differ:
            raise NotThere(f"a worker has {', '.join(differ)}. Install the same versions there.")
        return _attempt(_unpacked(packed, digest), values)


_tasks: OrderedDict[str, Any] = OrderedDict()
_unpacking = threading.Lock()


def _unpacked(packed, digest):
    """The task; once in a process, so that it compiles once."""
    with _unpacking:
        if digest not in _tasks:
            try:
                _tasks[digest] = pickle.loads(packed)
            except Exception as error:
                told = f"{type(error).__name__}: {error}".splitlines()[0]
                raise NotThere(
                    f"a worker cannot load the function ({told}). Install the module there, or have it sent: "
                    f"{CLUSTER}, and cloudpickle.register_pickle_by_value(module) for a module of your own."
                ) from None
            while len(_tasks) > KEPT:
                _tasks.popitem(last=False)
        return _tasks[digest]
