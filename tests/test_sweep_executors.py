"""Chunks of a sweep on threads, processes, clusters; workers that die. The task is a fake one, of NumPy."""

import os
import signal
import threading
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from granjax.sweeps import Chunk
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

    for given, said in ((0, "not below 1"), (True, "concurrent.futures"), ("dask", "a number of processes"),
                        (Client(), r"client.get_executor\(\)")):
        with pytest.raises(ValueError, match="executor: expected .*" + said):
            completed(Squares(), chunks(), given, 1)


def test_a_task_that_cannot_be_sent():
    task = Squares()
    task.lock = threading.Lock()
    with pytest.raises(ValueError, match="function: expected one that can be sent .* leave executor=None"):
        completed(task, chunks(), 2, 1)


def test_an_executor_that_is_closed():
    threads = ThreadPoolExecutor(1)
    threads.shutdown()
    with pytest.raises(RuntimeError, match="it takes no chunks any more"):
        list(completed(Squares(), chunks(), threads, 1))


def test_processes_lose_no_chunk(tmp_path):
    """One that dies in mid-chunk, one of whose chunks always kills: others stand, and it is told why."""
    task = Squares(dies=[13], dies_once=tmp_path / "died")
    found = complete(completed(task, chunks(8), 2, 1), chunks(8), without=[4])
    assert (tmp_path / "died").exists()
    assert found[4].reasons[0].startswith("The worker died at this chunk, 3 times (BrokenProcessPool")
    assert os.getpid() not in {chunk.columns["process"][0] for k, chunk in found.items() if k != 4}
