"""`sweep`: a function of parameters over all their values."""

import inspect
import itertools
import json
import math
import os
import sys
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray

from ..checks import described, refuse, whole
from ..programs import bar
from ..tuning import cores
from ..types import Count
from . import function as own
from .points import Parameters, points_of
from .store import Store, opened

# points of a chunk: as many fit a core's cache, and no more chunks than that many
LEAST, MOST, CHUNKS = 64, 256, 16
# chunks of a function that holds Python, of which each is kept as soon as it is done
KEPT = 256
# chunks that are given to each worker, and workers where an executor does not say how many it has
AHEAD, WORKERS = 2, 16


def sweep(
    function: Callable[..., Any],
    parameters: Parameters,
    *,
    store: str | Path | None = None,
    chunk: Count | None = None,
    executor: Any = None,
    progress: bool = True,
    units: dict[str, str] | None = None,
) -> xarray.Dataset:
    r"""Compute a function of parameters at all of their values; kept and resumed where `store` is given.

        def pulse(ratio):
            chain = gx.scenes.dimer(11, ratio=ratio)
            force = gx.Peak(gx.measures.contact_force)
            run = gx.simulate(chain, gx.states.impact(chain), 25.0, record={"force": force})
            return {"wall": run.recorded["force"][-1]}

        data = gx.sweep(pulse, {"ratio": [0.2, 0.4, 0.6, 0.8, 1.0]}, store="wall.zarr")
        gx.plots.sweep(data, "wall")

    **Arguments:**

    - `function`: of the parameters by their names, or of one dict of them; pure, for a single scene: it draws random
      numbers by `jax.random`, from a parameter `seed`. It returns a number, a word, an array, a dict of such, or a
      result of granjax, always of the same names and shapes. What can be traced is compiled for many points at a
      time, and its runs have their lanes last; words stay as they are, and whole numbers where they decide a size. A
      function that holds Python (breathers, fits, shocks) is called for one point after another.
    - `parameters`: {name: values}, all combinations of numbers or words; `gx.sweeps.paired` for lists side by side, or
      a list of dicts.
    - `store`: a folder, or a URL that fsspec knows (`"s3://bucket/map.zarr"`), for a zarr store, which
      `xarray.open_zarr` reads at any time. The same call resumes after any interruption.
    - `chunk`: points at a time, which share their default step, that of the stiffest; `None`: 64 to 256, or that of the
      store. Results depend on it by rounding and the error of steps.
    - `executor`: any of `concurrent.futures`, or a Dask client. `None`: threads, one a core, for what is compiled.
    - `progress`: a bar with the time left, after two seconds. `units`: {name: unit} of parameters and results.

    A point that is refused, raises, does not complete or gives what is not finite has a sentence in `reason` and NaN;
    the others stand.

    **Returns:** an `xarray.Dataset` over the parameters, with units, and the versions and an `outcome` as attributes.
    **Raises** ValueError for parameters that the function does not take, for one that computes something else when it
    is called again, and for a store of another sweep; RuntimeError where every point failed, or a process of the
    executor died.

    **Example:**

    >>> def pulse(ratio):
    ...     chain = gx.scenes.dimer(20, ratio=ratio)
    ...     return {"v": gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05).final.v[0]}
    >>> data = gx.sweep(pulse, {"ratio": [0.5, 1.0]})
    >>> data.v.values.round(4)
    array([-0.1827, -0.0711])
    """
    executor = executor.get_executor() if hasattr(executor, "get_executor") else executor
    if executor is not None and not isinstance(executor, Executor):
        remedy = "Give a concurrent.futures.Executor or a Dask client, or None for threads."
        refuse("executor", "an executor", described(executor), remedy)
    if getattr(getattr(executor, "_mp_context", None), "get_start_method", str)() == "fork":
        remedy = 'Give ProcessPoolExecutor(N, multiprocessing.get_context("spawn")).'
        refuse(
            "executor",
            "processes that start afresh",
            "forked ones, which JAX's threads do not survive",
            remedy,
        )
    points = points_of(parameters)
    keywords = own.by_keywords(function, tuple(points.axes))
    shared = tuple(
        name for name, x in points.axes.items() if points.count > 1 and (x == x[0]).all()
    )
    static = _static(function, keywords, points, shared)
    root = None if store is None else os.fspath(store).removeprefix("file://")
    shape = _chunk(root, chunk, points, static)
    cuts = [range(0, n, size) for n, size in zip(points.shape, shape)]
    blocks = [
        tuple(slice(i, min(i + size, n)) for i, size, n in zip(at, shape, points.shape))
        for at in itertools.product(*cuts)
    ]
    identity = {
        "parameters": {name: x.tolist() for name, x in points.axes.items()},
        "design": points.design,
        "chunk": list(shape),
    }
    attributes = {
        "function": own.name_of(function),
        "granjax": sys.modules["granjax"].__version__,
        "jax": jax.__version__,
        "numpy": np.__version__,
    }
    target = Store(root, identity, _source(function), points, blocks, dict(units or {}), attributes)
    sent = b"" if executor is None else own.packed(function)
    task = own.Task(sent, keywords, static, shared, chunk or math.prod(shape))
    todo = [i for i in range(len(blocks)) if not target.done[i]]
    lanes = np.arange(points.count).reshape(points.shape)
    done = points.count - sum(lanes[blocks[i]].size for i in todo)
    values = {i: points.values(lanes[blocks[i]].ravel()) for i in todo}
    with bar(points.count, "point", "sweep", progress, done) as shown:
        for i, found in _results(task, function, executor, values):
            target.put(i, found)
            shown.update(lanes[blocks[i]].size)
    if not target.arrays:
        raise RuntimeError(f"Every point failed. The first: {target.waiting[0][1].reasons[0]}")
    data = target.dataset()
    return data.assign_attrs(outcome=_outcome(points, data.reason.values.ravel()))


def _static(function, keywords, points, shared):
    """The parameters that are no arrays in a compiled program; `None` where the function holds Python."""
    words = tuple(name for name, x in points.axes.items() if x.dtype.kind == "U")
    sizes = tuple(name for name, x in points.axes.items() if x.dtype.kind in "Uiub")
    first = {name: x[:1] for name, x in points.axes.items()}
    for static in dict.fromkeys((words, sizes)):
        known = tuple((name, first[name][0].item()) for name in static)
        try:
            own.program(function, keywords, known, shared, own.kinds(first))
            return static
        except Exception as error:
            if own.DRAWS in str(error):
                raise
    return None


def _chunk(root, chunk, points, static):
    """The points of a chunk along each axis of the design."""
    there = None if root is None else opened(root)
    if chunk is None and there is not None and "sweep" in there.attrs:
        kept = json.loads(there.attrs["sweep"])["chunk"]
        if len(kept) == len(points.shape):
            return tuple(kept)
    if chunk is None:
        room = (
            -(-points.count // KEPT)
            if static is None
            else min(max(points.count // CHUNKS, LEAST), MOST)
        )
    else:
        room = whole("chunk", chunk, 1)
    shape = []
    for name, n in zip(reversed(points.dims), reversed(points.shape)):
        # a program for each value of a static parameter
        size = 1 if name in (static or ()) else min(n, room) if chunk else -(-n // -(-n // room))
        shape.insert(0, size)
        room = max(room // size, 1)
    return tuple(shape)


def _results(task, function, executor, values):
    """(number, chunk) as they are finished; what has not begun is taken back when something goes wrong."""
    mine, workers = executor is None, cores()
    if mine and (
        task.static is None or min(workers, len(values)) < 2 or jax.default_backend() != "cpu"
    ):
        yield from ((i, own.computed(task, function, x)) for i, x in values.items())
        return
    executor = ThreadPoolExecutor(workers) if mine else executor
    flying, left = {}, iter(values.items())
    try:
        while True:
            room = AHEAD * getattr(executor, "_max_workers", WORKERS) - len(flying)
            for i, x in itertools.islice(left, max(room, 0)):
                flying[executor.submit(own.computed, task, function if mine else None, x)] = i
            if not flying:
                return
            for future in wait(flying, return_when=FIRST_COMPLETED).done:
                yield flying.pop(future), future.result()
    except BrokenExecutor as error:
        raise RuntimeError(
            "A process of the executor died, and the sweep stopped. What was finished is in the store, if there is "
            "one: make a new executor and call again. If no process has begun, put the call under "
            '`if __name__ == "__main__":`.'
        ) from error
    finally:
        for future in flying:
            future.cancel()
        if mine:
            executor.shutdown(wait=False, cancel_futures=True)


def _source(function):
    try:
        return inspect.getsource(function)
    except (OSError, TypeError):
        return ""


def _outcome(points, reasons):
    over = ", ".join(f"{name} ({len(x)})" for name, x in points.axes.items())
    said = f"{points.count} point{'s' * (points.count != 1)} over {over}"
    bad = np.flatnonzero(reasons != "")
    if not bad.size:
        return f"{said}."
    at = ", ".join(
        f"{name} = {x:.6g}" if isinstance(x, float) else f"{name} = {x}"
        for name, x in points.at(int(bad[0])).items()
    )
    return f"{said}; {bad.size} marked, the first at {at}: {reasons[bad[0]]}"
