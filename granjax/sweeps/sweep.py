"""`sweep`: compute a function over many parameters."""

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

from ..base.checks import described, refuse, whole
from ..base.programs import bar
from ..base.tuning import cores
from ..base.types import Count
from . import function as own
from .points import Parameters, points_of
from .store import Store, opened

# the least number of points of a chunk
LEAST = 64
# the most points of a chunk, which fit a core's cache
MOST = 256
# the number of chunks to aim at
CHUNKS = 16
# the most chunks for a function that cannot be traced; each is stored as soon as it is done
KEPT = 256
# the number of chunks submitted per worker
AHEAD = 2
# the assumed number of workers of an executor that does not tell it
WORKERS = 16


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
    r"""Compute a function at all values of its parameters.

        def pulse(ratio):
            chain = gx.scenes.dimer(11, ratio=ratio)
            force = gx.Peak(gx.measures.contact_force)
            run = gx.simulate(chain, gx.states.impact(chain), 25.0, record={"force": force})
            return {"wall": run.recorded["force"][-1]}

        data = gx.sweep(pulse, {"ratio": [0.2, 0.4, 0.6, 0.8, 1.0]}, store="wall.zarr")
        gx.plots.sweep(data, "wall")

    **Arguments:**

    - `function`: takes the parameters by name, or one dict. It must be pure and for a single
      scene; random numbers come from `jax.random` and a parameter `seed`. It returns a number, a
      word, an array, a dict of these, or a granjax result, always with equal names and shapes.
      Traceable functions are compiled for many points at a time, with lanes last; words stay
      static, and whole numbers if they set a size or exponent. Others (breathers, fits, shocks)
      are called point by point.
    - `parameters`: {name: values}, numbers or words, for all combinations; `gx.sweeps.paired` for
      lists entry by entry; or a list of dicts.
    - `store`: a folder or fsspec URL (`"s3://bucket/map.zarr"`) of a zarr store, which
      `xarray.open_zarr` reads at any time. The same call resumes after an interruption.
    - `chunk`: points at a time. They share a default step, that of the stiffest, so that results
      depend on `chunk` by rounding and integration errors. `None`: 64 to 256, or as in the store.
    - `executor`: of `concurrent.futures`, or a Dask client. `None`: threads for compiled functions,
      one per core.
    - `progress`: a bar with the time left, after two seconds.
    - `units`: {name: unit} of parameters and results.

    A point that fails (invalid scene, error, incomplete run, non-finite result) has its reason in
    `reason`, and NaN if it gave no result. Scenes are checked at the corners of each chunk.

    **Returns:** an `xarray.Dataset` over the parameters, with units, versions and an `outcome`.
    **Raises** ValueError for parameters that the function does not take, units of unknown names,
    a function that differs when called again, or the store of another sweep; RuntimeError if no
    point gave a result, or a process of the executor died.

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
    source = _source(function)
    function = own.called(function, tuple(points.axes))
    shared = tuple(
        name for name, x in points.axes.items() if points.count > 1 and (x == x[0]).all()
    )
    static = _static(function, points, shared)
    root = None if store is None else os.fspath(store).removeprefix("file://")
    there = None if root is None else opened(root)
    shape = _chunk(there, chunk, points, static)
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
    target = Store(root, there, identity, source, points, blocks, units or {}, attributes)
    sent = b"" if executor is None else own.packed(function)
    task = own.Task(sent, static, shared, chunk or math.prod(shape))
    todo = [i for i in range(len(blocks)) if not target.done[i]]
    lanes = np.arange(points.count).reshape(points.shape)
    done = points.count - sum(lanes[blocks[i]].size for i in todo)
    values = {i: points.values(lanes[blocks[i]].ravel()) for i in todo}
    with bar(points.count, "point", "sweep", progress, done) as shown:
        for i, found in _results(task, function, executor, values):
            target.put(i, found)
            shown.update(lanes[blocks[i]].size)
    if not target.arrays:
        said = f"Every point failed. The first: {target.waiting[0][1].reasons[0]}"
        if not function.by_names:
            said += f" The function was given one dict, since no argument is named {', '.join(points.axes)}."
        raise RuntimeError(said)
    data = target.dataset()
    return data.assign_attrs(outcome=_outcome(points, data.reason.values.ravel()))


def _static(function, points, shared):
    # Return the static parameters of a compiled program; `None` if tracing fails.
    first = {name: x[:1] for name, x in points.axes.items()}
    held = lambda kinds: tuple(name for name, x in first.items() if x.dtype.kind in kinds)
    # words alone, or whole numbers too
    for static in dict.fromkeys(map(held, ("U", "Uiub"))):
        known = tuple((name, first[name][0].item()) for name in static)
        try:
            own.program(function, known, shared, own.kinds(first))
            return static
        except Exception as error:
            if own.DRAWS in str(error):
                raise
    return None


def _chunk(there, chunk, points, static):
    if chunk is not None:
        room = whole("chunk", chunk, 1)
    else:
        if there is not None and "sweep" in there.attrs:
            kept = json.loads(there.attrs["sweep"])["chunk"]
            if len(kept) == len(points.shape):
                return tuple(kept)
        many = min(max(points.count // CHUNKS, LEAST), MOST)
        room = -(-points.count // KEPT) if static is None else many
    shape = []
    for name, n in zip(reversed(points.dims), reversed(points.shape)):
        # Each value of a static parameter needs its own program.
        size = 1 if name in (static or ()) else min(n, room) if chunk else -(-n // -(-n // room))
        shape.insert(0, size)
        room = max(room // size, 1)
    return tuple(shape)


def _results(task, function, executor, values):
    # Yield (number, chunk) as they finish; after an error, cancel pending ones.
    mine = executor is None
    workers = cores()
    if mine and (
        task.static is None or min(workers, len(values)) < 2 or jax.default_backend() != "cpu"
    ):
        yield from ((i, own.computed(task, function, x)) for i, x in values.items())
        return
    executor = ThreadPoolExecutor(workers) if mine else executor
    flying = {}
    left = iter(values.items())
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
