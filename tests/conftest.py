"""granjax is imported before JAX starts computing, so that its float type and XLA flags are in force for every test.

Before that the import hook is set for the fast tests, with which every annotation is checked (tests/typed.py); it
lengthens traces. A process that only hands tests to others imports neither.

Most of the tests' time is compiling programs that run once. So they are compiled cheaply, unless XLA_FLAGS is set
(`XLA_FLAGS= pytest` compiles as a user's programs are; the numbers are the same to rounding) or tests compute for long,
as the review's figures do. What was compiled is kept in the user's cache folder for the next run, unless GRANJAX_CACHE
is 0.
"""

import gc
import os
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# scripts beside the library, which tests import
sys.path += [str(ROOT / folder) for folder in ("benchmarks", "docs", "docs/gallery")]

KEPT_FOR = 14 * 24 * 3600
# a worker of more bytes than these, or than its part of this share of the machine's, lets programs go where a module
# ends; anywhere from twice as many on
MUCH = 1.2e9
SHARE = 0.2
WORKER = os.environ.get("PYTEST_XDIST_WORKER")


def pytest_configure(config):
    """What has to come before the first computation, and before a module of tests is imported."""
    hands_out = config.getoption("numprocesses", None) and not config.getoption("collectonly")
    # figures are drawn for files alone
    os.environ["MPLBACKEND"] = "Agg"
    if hands_out:
        # a worker for each core: threads of LAPACK would wait for each other, and take three times as long
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if WORKER or not hands_out:
        asked = config.getoption("markexpr")
        config.programs = _prepare(typed_too="not slow" in asked)
        _forget(config.programs)


def _prepare(typed_too):
    """Flags, import hook, granjax; the folder of compiled programs, or None."""
    import jax

    if "XLA_FLAGS" not in os.environ:
        cheap = "--xla_cpu_parallel_codegen_split_count=1"
        # XLA ends a process whose flags it does not know, and has let go of the last one
        if jax.__version_info__ < (0, 12):
            cheap += " --xla_cpu_use_fusion_emitters=false"
        os.environ["XLA_FLAGS"] = cheap
        # for the processes that tests start too
        os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"
        jax.config.update("jax_disable_most_optimizations", True)
    # older versions trace literals of a class of their own, which no annotation knows
    if typed_too and jax.__version_info__ >= (0, 10):
        import typed

        typed.install()

    from granjax.base import tuning

    # a folder of the tests' own, whose name processes that tests start inherit, and the command line's switch below
    own = os.environ.get("GRANJAX_CACHE") or str(tuning._user_cache() / "granjax")
    os.environ.setdefault("GRANJAX_TESTS_CACHE", own if own == "0" else str(Path(own) / "tests"))
    kept = tuning.keep_compiled(os.environ["GRANJAX_TESTS_CACHE"])
    if kept:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    # where an operation was written is read by nobody here: a fourteenth
    jax.config.update("jax_traceback_in_locations_limit", 0)
    # the command line, called by tests, keeps nothing in the user's cache folder
    os.environ["GRANJAX_CACHE"] = "0"
    # traces are trees of many small objects that live long: rarer collections save a twentieth
    gc.set_threshold(100_000, 20, 50)
    return kept


def _forget(kept):
    """What no run of the last days has written again is let go, in the tests' own folder alone."""
    if kept and kept.parent == Path(os.environ["GRANJAX_TESTS_CACHE"]) and WORKER in (None, "gw0"):
        for program in kept.glob("*-cache"):
            if program.stat().st_mtime < time.time() - KEPT_FOR:
                program.unlink(missing_ok=True)


def pytest_report_header(config):
    if not hasattr(config, "programs"):
        return None
    import granjax

    return f"granjax {granjax.__version__}: {granjax.tune().outcome} Compiled programs are kept in {config.programs}."


def pytest_collection_finish():
    """What was imported stays: no collection looks at it again."""
    gc.freeze()


def _much():
    """Bytes above which a worker lets programs go."""
    try:
        there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        return max(MUCH, SHARE * there / int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", 1)))
    except (AttributeError, ValueError):
        return MUCH


def _memory():
    """Resident bytes of this process; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def pytest_runtest_teardown(item, nextitem):
    """Figures are closed; compiled programs are let go, most where a module ends: a worker would grow to many GB."""
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")
    if nextitem is not None and _memory() > _much() * (1 if item.path != nextitem.path else 2):
        import granjax

        granjax.clear()


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """A folder that looks like the repository's, to run in and to write to."""
    for name in ("notebooks", "benchmarks"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def optimised():
    """Programs are optimised: they compute for longer than that takes."""
    import jax

    jax.config.update("jax_disable_most_optimizations", False)
    yield
    cheap = os.environ.get("JAX_DISABLE_MOST_OPTIMIZATIONS") == "1"
    jax.config.update("jax_disable_most_optimizations", cheap)


@pytest.fixture
def ax():
    import matplotlib.pyplot as plt

    return plt.subplots()[1]
