"""Ctrl-C is answered at any moment: one line, code 130, no broken file."""

import random
import signal
import subprocess
import sys
import time

import matplotlib.image
import pytest
import xarray as xr

from granjax import interrupts

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")

RESONANCE = ["resonance", "--beads", "41", "--ratios", "60"]
REPRODUCE = ["reproduce", "fig1.3", "fig1.5"]
# the interpreter itself starts; it knows no granjax before
STARTING = 0.3


def started(arguments, folder):
    """`python -m granjax` in a fresh process, which Ctrl-C reaches whatever started the tests."""
    folder.mkdir()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return subprocess.Popen(
            [sys.executable, "-m", "granjax", *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            cwd=folder,
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
    if process.returncode != 0:  # it may be past the last line
        assert process.returncode == 130, lines
        (line,) = lines
        assert line.startswith("granjax: interrupted; ") and line.endswith(".")
        assert all(path.name in line for path in folder.iterdir())
    whole(folder)


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
