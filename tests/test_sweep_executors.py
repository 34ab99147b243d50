"""Chunks of a sweep on threads, processes, clusters; workers that die. The task is a fake one, of NumPy."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from jax._src.config import enable_x64

import granjax as gx
from granjax.sweeps import Chunk, workers
from granjax.sweeps.executors import completed

ROOT = Path(__file__).parents[1]


class Squares:
    """A task: squares. At some values it raises, or ends its process, always or but for the first time."""

    def __init__(self, raises=(), dies=(), dies_once=None, pause=0.0):
        self.raises, self.dies, self.dies_once, self.pause = raises, dies, dies_once, pause

    def __call__(self, values):
        x = values["x"]
        time.sleep(self.pause)
        if any(i in x for i in self.raises):
            raise ZeroDivisionError("not this one")
        if any(i in x for i in self.dies) or self.dies_once and 5 in x and not Path(self.dies_once).exists():
            if self.dies_once:
                Path(self.dies_once).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return Chunk({"y": x**2, "process": np.full(len(x), os.getpid())}, [""] * len(x), {"y": {"units": "m"}})


def chunks(count=4, lanes=3):
    return [(k, {"x": np.arange(k * lanes, (k + 1) * lanes)}) for k in range(count)]


def complete(found, given, without=()):
    """Every chunk once, with its squares; of some the reason alone."""
    found = dict(found)
    assert sorted(found) == [k for k, _ in given]
    for k, values in given:
        if k in without:
            assert not found[k].columns and len(found[k].reasons) == len(values["x"]) and all(found[k].reasons)
        else:
            assert np.array_equal(found[k].columns["y"], values["x"] ** 2) and not any(found[k].reasons)
    return found


class Now(Executor):
    """An executor of a user's own: it computes as it is asked."""

    def submit(self, fn, *args):
        future = Future()
        future.set_result(fn(*args))
        return future


@pytest.mark.parametrize("executor, threads", [(None, 1), (None, 3), (Now(), 1)], ids=["in turn", "threads", "own"])
def test_chunks_in_this_process(executor, threads):
    complete(completed(Squares(), chunks(7), executor, threads), chunks(7))


def test_an_exception_is_the_reason_of_every_lane():
    for threads in (1, 2):
        found = complete(completed(Squares(raises=[4]), chunks(), None, threads), chunks(), without=[1])
        assert found[1].reasons[0] == "ZeroDivisionError: not this one"


def test_threads_of_the_users_stay_open():
    task = Squares()
    task.lock = threading.Lock()  # nothing is pickled
    with ThreadPoolExecutor(2) as threads:
        complete(completed(task, chunks(), threads, 1), chunks())
        assert threads.submit(len, "ab").result() == 2


def test_few_chunks_are_given_away_at_a_time():
    begun = []

    class Counting(ThreadPoolExecutor):
        def submit(self, fn, *args):
            begun.append(fn)
            return super().submit(fn, *args)

    with Counting(2) as threads:
        found = completed(Squares(), chunks(40), threads, 1)
        for k in range(1, 5):
            next(found)
            assert len(begun) <= 4 * k
        found.close()
        assert len(begun) < 20


def test_what_is_no_executor():
    class Client:
        def get_executor(self):
            raise AssertionError

    for given, said in (
        (0, "not below 1"), (10**6, "at most .* processes"), (True, "concurrent.futures"),
        ("dask", "a number of processes"), (Client(), r"client.get_executor\(\)"),
    ):
        with pytest.raises(ValueError, match="executor: expected .*" + said):
            completed(Squares(), chunks(), given, 1)


def test_a_task_that_cannot_be_sent():
    task = Squares()
    task.lock = threading.Lock()
    with pytest.raises(ValueError, match="function: expected one that can be sent .* leave executor=None"):
        completed(task, chunks(), 2, 1)


def test_without_cloudpickle_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "cloudpickle", None)
    complete(completed(Squares(), chunks(), Now(), 1), chunks())
    with pytest.raises(ValueError, match="functions of notebooks: pip install .*cluster"):
        completed(lambda values: None, chunks(), Now(), 1)


def test_a_function_that_a_worker_does_not_find(monkeypatch):
    content, digest = workers.packed(Squares(pause=1e-9))
    monkeypatch.delattr(sys.modules[__name__], "Squares")
    with pytest.raises(workers.NotThere, match="cannot load the function .*register_pickle_by_value"):
        workers.far(content, digest, workers.setting(), chunks()[0][1], "")


def test_other_versions_are_told():
    class Elsewhere(Now):
        def submit(self, fn, *args):
            future = Future()
            future.set_exception(workers.NotThere("a worker has jax 0.1, here 0.2."))
            return future

    with pytest.raises(workers.NotThere, match="a worker has jax .*, here 0.1. Install"):
        workers.far(*workers.packed(Squares()), {**workers.setting(), "jax": "0.1"}, chunks()[0][1], "")
    with pytest.raises(RuntimeError, match="executor: a worker has jax 0.1, here 0.2"):
        list(completed(Squares(), chunks(), Elsewhere(), 1))


def test_numbers_have_as_many_bits_wherever_they_are_computed():
    def task(values):
        return Chunk({"x": np.asarray(jnp.asarray(values["x"]) * 1.5)}, [""] * 3, {})

    for bits in (32, 64):
        with enable_x64(bits == 64):
            for executor, threads in ((None, 1), (None, 2), (Now(), 1)):
                found = dict(completed(task, chunks(), executor, threads))
                assert {chunk.columns["x"].dtype for chunk in found.values()} == {np.dtype(f"f{bits // 8}")}


def test_an_executor_that_is_closed():
    threads = ThreadPoolExecutor(1)
    threads.shutdown()
    with pytest.raises(RuntimeError, match="it takes no chunks any more"):
        list(completed(Squares(), chunks(), threads, 1))


def killed(executor, given, task, told=None):
    """Chunks of which one kills its worker in mid-chunk; and, where it is told why, one that always does."""
    found = complete(completed(task, given, executor, 1), given, without=[4] if told else [])
    assert task.dies_once.exists()
    if told:
        assert found[4].reasons[0].startswith(f"A worker died at this chunk, 3 times ({told}")
    assert os.getpid() not in {chunk.columns["process"][0] for chunk in found.values() if chunk.columns}


@pytest.mark.study
def test_a_process_that_is_killed_in_mid_chunk(tmp_path):
    killed(2, chunks(6), Squares(dies_once=tmp_path / "died"))


@pytest.mark.study
def test_a_chunk_that_always_kills_its_process(tmp_path):
    pool = ProcessPoolExecutor(2, multiprocessing.get_context("spawn"), initializer=time.sleep, initargs=(0.01,))
    killed(pool, chunks(6), Squares(dies=[13], dies_once=tmp_path / "died"), "BrokenProcessPool")
    # a pool that is broken already
    complete(completed(Squares(), chunks(), pool, 1), chunks())


@pytest.mark.study
def test_a_fork_is_not_made():
    with ProcessPoolExecutor(2) as pool:
        if pool._mp_context.get_start_method() != "fork":
            pytest.skip("processes of this Python start afresh")
        with pytest.warns(UserWarning, match="would be forked"):
            complete(completed(Squares(), chunks(), pool, 1), chunks())


SCRIPT = """
import os, sys, time
import numpy as np
from granjax.sweeps import Chunk
from granjax.sweeps.executors import completed

def task(values):
    time.sleep(PAUSE)
    return Chunk({"y": values["x"] ** 2}, [""] * len(values["x"]), {})

def main():
    given = [(k, {"x": np.arange(3)}) for k in range(20)]
    for number, chunk in completed(task, given, EXECUTOR, 2):
        print(number, *chunk.columns["y"], flush=True)
"""


def script(tmp_path, last, executor, pause):
    path = tmp_path / "script.py"
    path.write_text(SCRIPT.replace("EXECUTOR", executor).replace("PAUSE", str(pause)) + last)
    return subprocess.Popen([sys.executable, path], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                            start_new_session=True, env={**os.environ, "PYTHONPATH": str(ROOT)})


@pytest.mark.study
def test_a_script_without_a_guard_is_told(tmp_path):
    ended = script(tmp_path, "main()", "2", 0)
    out, err = ended.communicate(timeout=60)
    assert ended.returncode == 1 and not out
    assert err.count("Traceback") == 1 and 'if __name__ == "__main__":' in err.splitlines()[-1]


def alive(group):
    """Processes of a group that are at work."""
    found = subprocess.run(["ps", "-A", "-o", "pgid=,stat=,pid="], capture_output=True, text=True).stdout.split("\n")
    return [line for line in found if line.split()[:1] == [str(group)] and "Z" not in line]


@pytest.mark.study
@pytest.mark.parametrize(
    "executor, key", [("None", signal.SIGINT), ("2", signal.SIGINT), ("2", signal.SIGKILL)],
    ids=["threads, Ctrl-C", "processes, Ctrl-C", "processes, killed"],
)
def test_an_interrupted_sweep_ends_at_once_with_its_processes(tmp_path, executor, key):
    running = script(tmp_path, "if __name__ == '__main__':\n    main()", executor, 3.0)
    running.stdout.readline()  # the first chunk
    begin = time.monotonic()
    if key == signal.SIGINT:
        os.killpg(running.pid, key)
    else:
        running.kill()
    out, err = running.communicate(timeout=60)
    assert running.returncode == -key, err
    if key == signal.SIGINT:
        assert err.splitlines()[-1] == "KeyboardInterrupt" and err.count("Traceback") == 1
    while alive(running.pid) and time.monotonic() < begin + 2:
        time.sleep(0.05)
    assert not alive(running.pid)


@pytest.fixture(scope="module")
def client():
    """A cluster of two processes on this machine, whose scheduler tries nothing again by itself."""
    dask, distributed = pytest.importorskip("dask"), pytest.importorskip("distributed")
    settings = {"distributed.scheduler.allowed-failures": 0, "distributed.worker.multiprocessing-method": "spawn"}
    where = {"host": "127.0.0.1", "dashboard_address": None}
    with dask.config.set(settings), distributed.LocalCluster(2, threads_per_worker=1, **where) as cluster:
        with distributed.Client(cluster) as client:
            yield client


@pytest.mark.study
def test_a_worker_of_a_cluster_that_is_killed_in_mid_chunk(client, tmp_path):
    killed(client.get_executor(), chunks(6), Squares(dies_once=tmp_path / "died"))


@pytest.mark.study
def test_a_chunk_that_always_kills_its_worker_of_a_cluster(client, tmp_path):
    task = Squares(dies=[13], dies_once=tmp_path / "died")
    killed(client.get_executor(), chunks(6), task, "KilledWorker")
    # the same sweep once more: nothing that a cluster remembers of it counts
    task = Squares(dies_once=tmp_path / "died")
    complete(completed(task, chunks(), client.get_executor(), 1), chunks())


def pulse(ratio):
    chain = gx.scenes.dimer(5, ratio=ratio)
    run = gx.simulate(chain, gx.states.impact(chain), 2.0, solver=gx.SRKN6b())
    return {"end": run.final.v[-1], "bead": run.final.u}


def called(ratio):
    return {"word": "light" if float(ratio) < 0.5 else "heavy"}  # nothing that can be traced


@pytest.mark.slow
def test_a_sweep_is_the_same_on_a_cluster(client, tmp_path):
    """Bit by bit, of a function by its name and of one without; the cluster's with a store."""
    ratios = {"ratio": np.linspace(0.2, 0.9, 6)}
    here = gx.sweep(pulse, ratios, chunk=2, progress=False)
    there = gx.sweep(
        lambda ratio: pulse(ratio), ratios, chunk=2, progress=False, executor=client.get_executor(),
        store=tmp_path / "there.nc",
    )
    assert np.array_equal(here.end, there.end) and np.array_equal(here.bead, there.bead)
    assert np.array_equal(gx.sweeps.read(tmp_path / "there.nc").end, here.end)
    words = gx.sweep(called, ratios, progress=False, executor=client.get_executor()).word
    assert words.values.tolist() == ["light"] * 3 + ["heavy"] * 3


@pytest.mark.slow
def test_a_sweep_is_the_same_in_processes():
    ratios = {"ratio": np.linspace(0.2, 0.9, 6)}
    here, there = (gx.sweep(pulse, ratios, chunk=2, progress=False, executor=x) for x in (None, 2))
    assert np.array_equal(here.end, there.end) and np.array_equal(here.bead, there.bead)
