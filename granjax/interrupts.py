"""Ctrl-C: what the command line answers at any moment, imports included, and what Python hears while JAX is at work.

Compiled programs, the compiler and libraries hold the thread that Python would interrupt, and what is raised while
they are loaded or at work ends in a traceback of theirs, or in a segmentation fault while the interpreter is taken
down. So the command line raises nothing: a second thread, which the signal reaches at once, says one line and ends
the process.

In Python the compiler works in a thread of its own while the main one waits in a way that a signal reaches, and so
does `wait` for a program. What Ctrl-C has left at work cannot be stopped, and must not meet the end of the interpreter.

Nothing here is imported that takes time.
"""

import _thread
import atexit
import contextlib
import functools
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

INTERRUPTED = 130
# seconds for which an array is asked again and again; then pauses, of a share of what has passed, and the longest
EAGER, SHARE, LONGEST = 5e-4, 0.02, 0.02
# seconds between two looks at a signal on systems that do not wake a thread that waits; and until one comes again
LONGEST_WAIT, AGAIN = 0.1, 0.01


def is_command() -> bool:
    """Whether this process was started as `granjax` or `python -m granjax`."""
    first = sys.argv[0] if sys.argv else ""
    if first == "-m":  # its name is not known yet
        started = sys.orig_argv
        return any(a[:1] == "-" and a[-1:] == "m" and b == __package__ for a, b in zip(started, started[1:]))
    module = Path(os.path.abspath(first)) == Path(__file__).with_name("__main__.py")
    return module or Path(first).name.removesuffix(".exe") == __package__


def prepare_command() -> None:
    """Standard streams that are there, and Ctrl-C that ends this process with one line and code 130."""
    _open_streams()
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:  # ignored, or somebody else's, or done
        return
    reading, writing = socket.socketpair()
    writing.setblocking(False)
    signal.set_wakeup_fd(writing.fileno(), warn_on_full_buffer=False)
    signal.signal(signal.SIGINT, _answered_elsewhere)
    threading.Thread(target=_watch, args=(reading, writing), daemon=True).start()


def _open_streams():
    """Streams that were closed lead nowhere: a file opened later would take their place, and their messages."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)


def _answered_elsewhere(number, frame):
    """What Python itself does at the signal."""


def _watch(reading, writing):
    while signal.SIGINT not in reading.recv(64):
        pass
    end_interrupted()


def end_interrupted() -> NoReturn:
    """One line, with the files that were written, and the end of the process; nothing is taken down."""
    files = sys.modules.get(f"{__package__}.files")
    names = []
    if files is not None:
        files.stop_writing()
        names = list(map(str, files.written))
    said = f"written until then: {', '.join(names)}" if names else "nothing was written"
    tell(f"granjax: interrupted; {said}.")
    os._exit(INTERRUPTED)


def tell(text: str) -> None:
    """A line on standard error, or on standard output where that is closed; over a progress bar, if there is one."""
    number = 2 if sys.stderr is not None else 1
    with contextlib.suppress(OSError):
        bar = "\r\x1b[K" if os.isatty(number) else ""
        os.write(number, f"{bar}{text}\n".encode(errors="replace"))


def prepare_python() -> None:
    """Ctrl-C is heard in Python while JAX compiles, is not lost in a callback, and ends a process that it leaves."""
    from jax._src import compiler

    backend = getattr(compiler, "backend_compile_and_load", None)
    if backend is not None:  # a private name: without it, compiling ends before Ctrl-C is answered

        @functools.wraps(backend)
        def compile(*args, **kwargs):
            work = functools.partial(backend, *args, **kwargs)
            return _aside(work) if _hears() else work()

        compiler.backend_compile_and_load = compile
    # of JAX's own, which would wait for what is at work, it is before
    atexit.register(_end_with_what_is_left)
    sys.unraisablehook = functools.partial(_raised_again, sys.unraisablehook)


def _hears():
    """Whether Ctrl-C raises KeyboardInterrupt here."""
    return _is_main() and signal.getsignal(signal.SIGINT) in (signal.default_int_handler, _noted)


class _Aside(threading.Thread):
    """A thread for what knows nothing of signals. It may be left at work."""

    def __init__(self, work):
        super().__init__(name="granjax: compiling", daemon=True)
        self.work, self.done, self.found, self.error = work, threading.Event(), None, None

    def run(self):
        try:
            self.found = self.work()
        except BaseException as error:
            self.error = error
        finally:
            self.done.set()


def _aside(work):
    """What a function returns or raises, from a thread of its own, while Ctrl-C is heard in this one."""
    thread = _Aside(work)
    thread.start()
    while not thread.done.wait(LONGEST_WAIT):
        pass
    if thread.error is not None:
        raise thread.error
    return thread.found


def _raised_again(before, unraisable):
    """An interrupt that came in a callback, where Python can raise nothing, comes again a moment later."""
    if unraisable.exc_type is KeyboardInterrupt and _is_main() and not sys.is_finalizing():
        threading.Timer(AGAIN, _press).start()
    else:
        before(unraisable)


def _press():
    """Ctrl-C, which wakes the main thread where the system can."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
    else:
        _thread.interrupt_main()


def _end_with_what_is_left():
    """Wait for what is at work; end at once where an interrupt that nobody has caught ends this process."""
    if not _at_work():
        return
    interrupted = isinstance(getattr(sys, "last_value", None), KeyboardInterrupt) and not hasattr(sys, "ps1")
    with contextlib.suppress(KeyboardInterrupt):
        while not interrupted and _at_work():
            time.sleep(LONGEST)
        if not interrupted:
            return
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, OSError, ValueError):
            stream.flush()
    # as Python itself ends then
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.raise_signal(signal.SIGINT)
    os._exit(INTERRUPTED)


def _at_work():
    return any(isinstance(thread, _Aside) for thread in threading.enumerate())


# whether Ctrl-C was pressed since the outermost function that is `interruptible` began
_pressed: list[bool] = []
_inside = False


def wait(tree: Any) -> Any:
    """What a compiled program returns, when all of it is there. Nothing happens to what is traced.

    JAX itself waits in a way that no signal reaches. An interrupt leaves the program at work, so that what is computed
    next waits for it. One that Python has lost, because it came while a callback of a library ran, is raised here.
    """
    import jax

    if _inside and _pressed and _is_main():
        raise KeyboardInterrupt
    arrays = [x for x in jax.tree.leaves(tree) if hasattr(x, "is_ready")]
    begin = time.perf_counter()
    while not all(x.is_ready() for x in arrays):
        passed = time.perf_counter() - begin
        time.sleep(0 if passed < EAGER else min(SHARE * passed, LONGEST))
    return tree


def waited(program: Callable) -> Callable:
    """A compiled program that Ctrl-C reaches while it runs: `wait` for what it returns."""

    @functools.wraps(program)
    def call(*args, **kwargs):
        return wait(program(*args, **kwargs))

    return call


def interruptible(function: Callable) -> Callable:
    """A function of many programs in which Ctrl-C is not lost: what a library swallows is raised at the next `wait`."""

    @functools.wraps(function)
    def call(*args, **kwargs):
        global _inside
        if _inside or not _is_main() or signal.getsignal(signal.SIGINT) not in (signal.default_int_handler, _noted):
            return function(*args, **kwargs)
        try:
            _inside = True
            _pressed.clear()
            signal.signal(signal.SIGINT, _noted)
            result = function(*args, **kwargs)
            if _pressed:
                raise KeyboardInterrupt
            return result
        finally:
            # an interrupt that comes between these lines leaves the handler, which the next call takes over
            _inside = False
            _pressed.clear()
            signal.signal(signal.SIGINT, signal.default_int_handler)

    return call


def _is_main():
    return threading.current_thread() is threading.main_thread()


def _noted(number, frame):
    if _inside:
        _pressed.append(True)
    raise KeyboardInterrupt
