"""Ctrl-C is answered at any moment: one line, code 130, no broken file."""

import contextlib
import random
import signal
import subprocess
import sys
import threading
import time

import jax
import jax.numpy as jnp
import matplotlib.image
import numpy as np
import pytest
import xarray as xr
from jax._src import compiler

import granjax as gx
from granjax import interrupts, programs
from granjax.entry import checked

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")

RESONANCE = ["resonance", "--beads", "41", "--ratios", "60"]
REPRODUCE = ["reproduce", "fig1.3", "fig1.5"]
# the interpreter itself starts; it knows no granjax before
STARTING = 0.3
FIT = """
import granjax as gx, numpy as np
def scene(p):
    return gx.scenes.monomer(20, stiffness=p["stiffness"])
t, state = np.linspace(0, 30, 100), gx.states.impact(scene({"stiffness": 1.0}))
seen = np.asarray(gx.simulate(scene({"stiffness": 1.2}), state, 30.0, save_at=t).vs)[:, [5, 9]]
for k in range(20):
    traces = gx.Traces(times=t, velocity=seen, sites=[5, 9], sigma=0.01)
    gx.fit(scene, {"stiffness": 1 + 0.01 * k}, traces, state=state, step=0.02).save("fit.nc")
"""
FAMILY = """
import granjax as gx
chain = gx.scenes.pattern(13, (1.0, 2.96), precompression=1.0, boundary="free")
gx.breathers.family(chain, until=0.985 * 3**0.5).save("family.nc")
"""


def started(arguments, folder):
    """`python -m granjax`, or a script, in a fresh process, which Ctrl-C reaches whatever started the tests."""
    folder.mkdir()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return subprocess.Popen(
            [sys.executable, *(["-c", arguments] if isinstance(arguments, str) else ["-m", "granjax", *arguments])],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder,
        )
    finally:
        signal.signal(signal.SIGINT, before)


def interrupted(process):
    """Seconds that the answer took, and the lines of standard error."""
    begin = time.perf_counter()
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    return time.perf_counter() - begin, said.splitlines()


def whole(folder):
    """Every file is a picture or data that can be read."""
    for path in folder.iterdir():
        if path.suffix == ".png":
            matplotlib.image.imread(path)
        else:
            assert path.suffix == ".nc", path.name
            xr.load_dataset(path, engine="h5netcdf")


def check(process, folder):
    if process.poll() is not None:  # sooner done than interrupted
        process.communicate()
        assert process.returncode == 0
        return
    _, lines = interrupted(process)
    if process.returncode == -signal.SIGINT:  # the interpreter was not ready yet
        assert not any("granjax/" in line for line in lines), lines
    elif process.returncode != 0:  # it may be past the last line
        assert process.returncode == 130, lines
        (line,) = lines
        assert line.startswith("granjax: interrupted; ") and line.endswith(".")
        assert all(path.name in line for path in folder.iterdir())
    whole(folder)


@pytest.mark.slow
def test_the_command_line_is_interrupted(tmp_path):
    draw = random.Random(1)
    moments = sorted(draw.uniform(STARTING, 5) for _ in range(4))
    begin, running = time.perf_counter(), []
    for i, command in enumerate([RESONANCE, REPRODUCE] * 2):
        running.append((started(command, tmp_path / str(i)), tmp_path / str(i)))
    for moment, (process, folder) in zip(moments, running):
        time.sleep(max(0, begin + moment - time.perf_counter()))
        check(process, folder)


@pytest.mark.study
@pytest.mark.parametrize("script, kept", [(FIT, "fit.nc"), (FAMILY, "family.nc")], ids=["fit", "family"])
def test_python_is_interrupted_at_twenty_moments(script, kept, tmp_path):
    begin = time.perf_counter()
    started(script, tmp_path / "whole").communicate()
    draw, lasts = random.Random(3), time.perf_counter() - begin
    for i in range(20):
        process, folder = started(script, tmp_path / str(i)), tmp_path / str(i)
        time.sleep(draw.uniform(STARTING, lasts))
        if process.poll() is None:
            _, lines = interrupted(process)
            # Python ends with the signal; what comes behind the last line may be too late, or find no handler any more
            assert process.returncode in (-signal.SIGINT, 0), lines
            over = (folder / kept).exists()
            assert lines[-1].startswith("KeyboardInterrupt") if lines else over or process.returncode == 0, lines
        whole(folder)


@pytest.mark.study
@pytest.mark.parametrize("arguments", [RESONANCE, REPRODUCE], ids=["resonance", "reproduce"])
def test_the_command_line_is_interrupted_at_fifty_moments(arguments, tmp_path):
    begin = time.perf_counter()
    process = started(arguments, tmp_path / "whole")
    process.communicate()
    draw, lasts = random.Random(2), time.perf_counter() - begin
    for i in range(50):
        process, folder = started(arguments, tmp_path / str(i)), tmp_path / str(i)
        time.sleep(draw.uniform(STARTING, lasts))
        check(process, folder)


def test_an_interrupt_that_is_ignored_stays_so():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        interrupts.prepare_command()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("argv, orig, expected", [
    (["-m", "resonance"], ["python", "-m", "granjax", "resonance"], True),
    (["-m"], ["python", "-Im", "granjax"], True),
    (["-m", "x"], ["python", "-m", "timeit", "import granjax"], False),
    (["/venv/bin/granjax", "bench"], ["python", "/venv/bin/granjax", "bench"], True),
    (["C:\\granjax.exe".replace("C:\\", "C:/")], ["granjax.exe"], True),
    (["script.py"], ["python", "script.py"], False), (["-c"], ["python", "-c", "granjax"], False), ([], [], False),
])
def test_which_process_is_the_command_line(argv, orig, expected, monkeypatch):
    monkeypatch.setattr(sys, "argv", argv)
    monkeypatch.setattr(sys, "orig_argv", orig)
    assert interrupts.is_command() is expected


def test_python_keeps_its_own_interrupt():
    assert signal.getsignal(signal.SIGINT) is not interrupts._answered_elsewhere


@contextlib.contextmanager
def default_interrupt():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        signal.signal(signal.SIGINT, before)


def pressed(after=0.05):
    """Ctrl-C, a moment from now."""
    thread = threading.Timer(after, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT))
    thread.start()
    return thread


def test_a_program_of_few_operations_that_takes_long_hears_an_interrupt():
    @programs.waited
    def turned(x, count):
        return jax.lax.fori_loop(0, count, lambda i, x: jnp.sin(x) + 1e-9 * i, x), "words", turned

    x, count = np.ones(2), np.asarray
    assert turned(x, count(3))[1:] == ("words", turned), "of what it returns only arrays are computed"
    with default_interrupt():
        thread = pressed()
        with pytest.raises(KeyboardInterrupt):
            turned(x, count=count(30_000_000))
        thread.join()
        assert interrupts._at_work()
    np.testing.assert_allclose(turned(x, count(3))[0], np.sin(np.sin(np.sin(x)) + 1e-9) + 2e-9, rtol=1e-12)


def test_waiting_leaves_values_as_they_are():
    x = jnp.ones(3) * 2
    assert programs.wait(()) == () and programs.wait({"a": (1, x)})["a"][1] is x
    assert jax.jit(programs.waited(lambda x: 2 * x))(x)[0] == 4


def test_compiling_hears_an_interrupt(monkeypatch):
    over, aside = threading.Event(), interrupts._aside
    monkeypatch.setattr(interrupts, "_aside", lambda work: aside(lambda: (over.wait(60), work())[1]))
    program, x = jax.jit(lambda x: random.random() * x), jnp.ones(3)
    with default_interrupt():
        thread = pressed()
        with pytest.raises(KeyboardInterrupt):
            program(x)
        thread.join()
        assert interrupts._at_work()
        over.set()
        np.testing.assert_allclose(program(x), program(x))
    assert program._cache_size() == 1, "compiled once, as if nothing had been"


def test_compiling_is_in_place_where_nothing_would_be_raised(monkeypatch):
    monkeypatch.setattr(interrupts, "_aside", None)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        jax.jit(lambda x: random.random() * x)(1.0)
    finally:
        signal.signal(signal.SIGINT, before)
    thread = threading.Thread(target=lambda: jax.jit(lambda x: random.random() * x)(1.0))
    thread.start()
    thread.join()


def test_what_was_left_at_work_is_let_go_when_it_is_done():
    class Array:
        ready = False
        is_deleted, is_ready = lambda self: False, lambda self: self.ready

    for done in (lambda: programs.wait(jnp.ones(3)), gx.clear):
        array = Array()
        interrupts.leave([array])
        programs.wait(jnp.ones(3))
        assert interrupts._at_work() and interrupts._left == [array]
        array.ready = True
        done()
        assert not interrupts._left


def test_the_compiler_is_left_as_it_is_where_the_environment_says_so(monkeypatch):
    monkeypatch.setenv("GRANJAX_INTERRUPT", "0")
    before = compiler.backend_compile_and_load, sys.unraisablehook
    interrupts.prepare_python()
    assert before == (compiler.backend_compile_and_load, sys.unraisablehook)


def test_what_a_compiler_raises_is_raised():
    with pytest.raises(ZeroDivisionError):
        interrupts._aside(lambda: 1 / 0)
    assert interrupts._aside(lambda: 3) == 3


def test_an_interrupt_in_a_callback_comes_again():
    hooked, before = [], sys.unraisablehook
    sys.unraisablehook = lambda x: interrupts._raised_again(hooked.append, x)

    class Callback:
        error = KeyboardInterrupt

        def __del__(self):
            raise self.error

    try:
        with default_interrupt(), pytest.raises(KeyboardInterrupt):
            Callback()
            time.sleep(60)
        Callback.error = ZeroDivisionError
        Callback()
    finally:
        sys.unraisablehook = before
    assert [x.exc_type for x in hooked] == [ZeroDivisionError], "others go where they went"


LEFT = """
import logging.handlers, sys, tempfile, threading, time, _thread
folder = tempfile.TemporaryDirectory(dir=".")
held = logging.handlers.MemoryHandler(9, target=logging.FileHandler("log"))
logging.getLogger().addHandler(held)
logging.warning("held")
import granjax as gx
threading.Timer(0.1, _thread.interrupt_main).start()
try:
    gx._interrupts._aside(lambda: time.sleep({seconds}))
except KeyboardInterrupt:
    {then}
"""


@pytest.mark.slow
@pytest.mark.parametrize("seconds, then, code, last", [
    (300, "raise", -signal.SIGINT, "KeyboardInterrupt"), (0.5, "sys.exit(3)", 3, ""),
], ids=["not caught", "caught"])
def test_a_process_ends_though_the_compiler_is_at_work(seconds, then, code, last, tmp_path):
    process = started(LEFT.format(seconds=seconds, then=then), tmp_path / "x")
    _, said = process.communicate(timeout=60)
    assert process.returncode == code, said
    # what the standard library does at exit is done
    assert [x.name for x in (tmp_path / "x").iterdir()] == ["log"] and (tmp_path / "x" / "log").read_text() == "held\n"
    assert said.splitlines()[-1:] == [last] * bool(last)


def test_a_library_is_imported_to_its_end(tmp_path, monkeypatch):
    (tmp_path / "interrupted_library.py").write_text("import signal\nsignal.raise_signal(2)\nwhole = True\n")
    monkeypatch.syspath_prepend(tmp_path)
    with default_interrupt():
        with pytest.raises(KeyboardInterrupt, match="granjax was interrupted as it was imported"):
            interrupts.load("interrupted_library", "this_is_not_there")
    assert sys.modules.pop("interrupted_library").whole


def test_an_interrupt_is_told_in_one_line_unless_it_came_in_a_function_of_the_users(monkeypatch):
    def within():
        raise KeyboardInterrupt

    monkeypatch.setitem(within.__globals__, "__name__", "granjax.within")
    outer, inner = checked(lambda function: function()), checked(lambda function: function())
    outer.__wrapped__.__name__, inner.__wrapped__.__name__ = "outer", "inner"
    for function in (outer, inner):
        function.__wrapped__.__module__ = "granjax.within"
    with pytest.raises(KeyboardInterrupt, match="^outer was interrupted; nothing of it is kept$") as told:
        outer(lambda: inner(within))
    assert told.traceback[-1].path.name == "checked.py" and told.value.__cause__ is None
    monkeypatch.setitem(within.__globals__, "__name__", "somebody")
    with pytest.raises(KeyboardInterrupt, match="^$"):
        outer(lambda: inner(within))
