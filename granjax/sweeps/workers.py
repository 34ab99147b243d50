"""What computes the chunks of a sweep: threads, processes, what is sent to them and what they do first."""

import contextlib
import hashlib
import importlib.util
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from typing import Any

import jax

from ..checks import refuse
from ..tuning import pools
from .chunk import LOST, Chunk

# tasks that a process keeps; letters of a reason
KEPT, SENTENCE = 4, 500
CLUSTER = "pip install 'granjax[cluster]'"


class NotThere(RuntimeError):
    """What a worker says where the task cannot begin there at all."""


def attempt(task: Callable[[dict], Chunk], values: dict) -> Chunk:
    """A chunk; what the task raises is the reason of every lane."""
    try:
        return task(values)
    except (Exception, SystemExit) as error:
        return given_up(values, told(error))


def told(error: BaseException) -> str:
    """An error in a line."""
    return " ".join(f"{type(error).__name__}: {error}".strip(": ").split())[:SENTENCE]


def given_up(values: dict, reason: str) -> Chunk:
    """A chunk without columns."""
    return Chunk({}, [reason] * (len(next(iter(values.values()))) if values else 1), {LOST: {}})


class Threads(Executor):
    """A thread for each chunk, which may be left at work after Ctrl-C. Nobody gives it more than it has threads."""

    def __init__(self, threads: int):
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

        threading.Thread(target=work, name="granjax: sweep", daemon=True).start()
        return future


def near(task: Callable[[dict], Chunk], float64: bool, values: dict, _: str) -> Chunk:
    """A chunk, in a thread of this process."""
    with _floats(float64):
        return attempt(task, values)


def float64() -> bool:
    """Whether numbers have 64 bits in this thread."""
    return bool(jax.config.jax_enable_x64)


def _floats(wanted):
    if float64() == wanted:
        return contextlib.nullcontext()
    return jax.enable_x64(wanted)


def processes(
    count: int, context: Any = None, begin: Callable | None = None, given: tuple = ()
) -> ProcessPoolExecutor:
    """Processes that start afresh: JAX holds threads, which a fork would break."""
    context = context or multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(count, context, _begin, (_kept_programs(), begin, given))


def alike(pool: ProcessPoolExecutor) -> ProcessPoolExecutor:
    """Fresh processes of our own, as many as in a pool, which begin as those did."""
    begin, given = pool._initializer, pool._initargs
    if begin is _begin:
        begin, given = given[1:]
    return processes(pool._max_workers, None if forks(pool) else pool._mp_context, begin, given)


def forks(pool: ProcessPoolExecutor) -> bool:
    """Whether its processes are copies of this one."""
    return pool._mp_context.get_start_method() == "fork"


def _kept_programs():
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs", "jax_platforms")
    return {name: getattr(jax.config, name) for name in names}


def _begin(settings, begin, given):
    """What a process of ours does first: leave Ctrl-C to the one that started it, and end when that one does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    # several processes share a GPU's memory
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    for name, value in settings.items():
        jax.config.update(name, value)
    if begin is not None:
        begin(*given)


def _end_with_parent():
    multiprocessing.parent_process().join()
    os._exit(1)


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Processes that start here hear no Ctrl-C, from their first moment on; this one hears it a moment later."""
    block = getattr(signal, "pthread_sigmask", lambda *_: ())
    before = block(getattr(signal, "SIG_BLOCK", 0), [signal.SIGINT])
    try:
        yield
    finally:
        block(getattr(signal, "SIG_SETMASK", 0), before)


def imports_script() -> bool:
    """Whether this is a process that imports the script, before it does what it was started for."""
    return getattr(multiprocessing.current_process(), "_inheriting", False)


def packed(task: Callable[[dict], Chunk]) -> tuple[bytes, str]:
    """The bytes of a task, and what tells them from others."""
    by_value = importlib.util.find_spec("cloudpickle") is not None
    try:
        content = importlib.import_module("cloudpickle" if by_value else "pickle").dumps(task)
    except Exception as error:
        remedy = "Make files, locks and the like within the function, or leave executor=None: threads."
        if not by_value:
            remedy = f"For lambdas and functions of notebooks: {CLUSTER}. {remedy}"
        refuse("function", "one that can be sent to another process", f"one that cannot ({told(error)})", remedy)
    return content, hashlib.sha256(content).hexdigest()


def setting() -> dict[str, Any]:
    """What must be alike wherever chunks are computed."""
    own = sys.modules[__package__.split(".")[0]].__version__
    return {"granjax": own, "jax": jax.__version__, "float64": float64()}


def far(content: bytes, digest: str, wanted: dict, values: dict, _: str) -> Chunk:
    """A chunk, in a process of a worker."""
    with pools().limit(limits=1), _floats(wanted["float64"]):
        differ = [f"{name} {x}, here {wanted[name]}" for name, x in setting().items() if x != wanted[name]]
        if differ:
            raise NotThere(f"a worker has {', '.join(differ)}. Install the same versions there.")
        return attempt(_unpacked(content, digest), values)


_tasks: OrderedDict[str, Any] = OrderedDict()
_unpacking = threading.Lock()


def _unpacked(content, digest):
    """The task; once in a process, so that it compiles once."""
    with _unpacking:
        if digest not in _tasks:
            try:
                _tasks[digest] = pickle.loads(content)
            except Exception as error:
                raise NotThere(
                    f"a worker cannot load the function ({told(error)}). Install its module there, or have it sent: "
                    f"{CLUSTER}, and cloudpickle.register_pickle_by_value(module) for a module of your own."
                ) from None
            while len(_tasks) > KEPT:
                _tasks.popitem(last=False)
        return _tasks[digest]
