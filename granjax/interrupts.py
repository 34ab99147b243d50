"""Ctrl-C: what the command line answers at any moment, imports included, and what Python hears while JAX is at work.

Compiled programs, the compiler and libraries hold the thread that Python would interrupt, and what is raised while
they are loaded or at work ends in a traceback of theirs, or in a segmentation fault while the interpreter is taken
down. So the command line raises nothing: a second thread, which the signal reaches at once, says one line and ends
the process.

In Python the compiler works in a thread of its own while the main one waits in a way that a signal reaches; how it
waits for programs is in `programs`. What Ctrl-C has left at work cannot be stopped, and must not meet the end of the
interpreter.

Nothing here is imported that takes time.
"""

import _thread
import atexit
import contextlib
import functools
import importlib
import os
import signal
import socket
import sys
import threading
import time
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

INTERRUPTED = 130
# seconds between two looks at what is at work, and at a signal where the system does not wake a thread that waits
LOOK = 0.05
# seconds until an interrupt that came in a callback comes again
AGAIN = 0.01
# what the line that ends the command says, where that is more than what it has written
advice: list[str] = []


def is_command() -> bool:
    """Whether this process was started as `granjax` or `python -m granjax`."""
    first = sys.argv[0] if sys.argv else ""
    if first == "-m":  # its name is not known yet
        started = sys.orig_argv
        return any(a[:1] == "-" and a[-1:] == "m" and b == __package__ for a, b in zip(started, started[1:]))
    main = Path(__file__).with_name("__main__.py")
    # asked of the files: the working folder, which a relative path is of, may have been deleted
    module = os.path.exists(first) and os.path.samefile(first, main)
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
    said = advice[-1] if advice else said
    tell(f"granjax: interrupted; {said}.")
    os._exit(INTERRUPTED)


def tell(text: str) -> None:
    """A line on standard error, or on standard output where that is closed; over a progress bar, if there is one."""
    number = 2 if sys.stderr is not None else 1
    with contextlib.suppress(OSError):
        bar = "\r\x1b[K" if os.isatty(number) else ""
        os.write(number, f"{bar}{text}\n".encode(errors="replace"))


def load(*names: str) -> None:
    """Import libraries, each to its end: some tell an interrupt that comes within as a failure of their own."""
    if not _hears():
        return
    pressed = []
    signal.signal(signal.SIGINT, lambda number, frame: pressed.append(number))
    try:
        for name in names:
            importlib.import_module(name)
            if pressed:
                raise KeyboardInterrupt("granjax was interrupted as it was imported")
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def prepare_python() -> None:
    """Ctrl-C is heard in Python while JAX compiles, is not lost in a callback, and ends a process that it leaves.

    Unless the environment holds `GRANJAX_INTERRUPT=0`: JAX's compiler and Python's hooks then stay as they are.
    """
    if os.environ.get("GRANJAX_INTERRUPT", "1") == "0":
        return
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
    return _is_main() and signal.getsignal(signal.SIGINT) is signal.default_int_handler


class Aside(threading.Thread):
    """A thread for what knows nothing of signals. It may be left at work."""

    def __init__(self, work: Callable[[], Any], name: str = "granjax: compiling"):
        super().__init__(name=name, daemon=True)
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
    thread = Aside(work)
    thread.start()
    while not thread.done.wait(LOOK):
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
            time.sleep(LOOK)
        if not interrupted:
            return
    _run_exits_of_before()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, OSError, ValueError):
            stream.flush()
    # as Python itself ends then
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.raise_signal(signal.SIGINT)
    os._exit(INTERRUPTED)


def _run_exits_of_before():
    """What the standard library does at exit and may have registered before granjax: temporary folders, logs."""
    exits = getattr(weakref.finalize, "_exitfunc", None), getattr(sys.modules.get("logging"), "shutdown", None)
    for own in filter(None, exits):
        try:
            own()
        except BaseException as error:
            sys.excepthook(type(error), error, error.__traceback__)


# arrays of programs that Ctrl-C has left at work
_left: list[Any] = []


def leave(arrays: list[Any]) -> None:
    """Remember arrays that are not there yet, of a program whose end nobody waits for any more."""
    _left.extend(arrays)
    let_go()


def let_go() -> None:
    """Forget the arrays that are there by now."""
    if _left:
        _left[:] = filter(_unfinished, _left)


# what `gx.clear` calls
leave.cache_clear = let_go


def _unfinished(x):
    return not (x.is_deleted() or x.is_ready())


def _at_work():
    return any(isinstance(thread, Aside) for thread in threading.enumerate()) or any(map(_unfinished, _left))


def _is_main():
    return threading.current_thread() is threading.main_thread()
