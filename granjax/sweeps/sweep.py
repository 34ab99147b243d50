"""`sweep`: a function of parameters over all their values."""

import os
import sys
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import closing
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ..checks import refuse, whole
from ..entry import checked
from ..programs import bar
from ..types import Count
from .chunk import LOST
from .dataset import assembled
from .executors import checked_executor, completed
from .function import by_keywords
from .identity import function_identity
from .plan import parts_of, plan_of, planned
from .points import Parameters, Points, points_of
from .result import Sweep, known
from .store import Store
from .task import EACH, Task


@checked
def sweep(
    function: Callable[..., Any], parameters: Parameters, *, store: str | Path | None = None,
    chunk: Count | None = None, executor: Executor | Count | None = None,
    devices: Count | Sequence[Any] | None = None, progress: bool = True, units: dict[str, str] | None = None,
    lanes: bool | None = None,
) -> Sweep:
    r"""A function of parameters at all of their values, on every core; kept on disk and resumed where `store` is given.

        def pulse(ratio):
            chain = gx.scenes.dimer(11, ratio=ratio)
            force = gx.Peak(gx.measures.contact_force)
            run = gx.simulate(chain, gx.states.impact(chain), 25.0, record={"force": force})
            return {"wall": run.recorded["force"][-1]}

        data = gx.sweep(pulse, {"ratio": [0.2, 0.4, 0.6, 0.8, 1.0]}, store="wall.nc")
        gx.plots.sweep(data, "wall")

    **Arguments:**

    - `function`: of the parameters by their names, or of one dict of them; pure, for a single scene: it draws random
      numbers by `jax.random`, from a parameter `seed`. It returns a number, a word, an array, a dict of such, or a
      result of granjax. What can be traced is compiled for many lanes at a time, and its runs have their lanes last;
      parameters that are words stay as they are, and whole numbers where they decide a size. All else (breathers, fits,
      shocks) is called for one lane after another; NumPy's random numbers are drawn anew for each there, and are others
      when the sweep is resumed or repeated.
    - `parameters`: {name: values}, all combinations of numbers or words; `gx.sweeps.paired` for lists side by side, or
      a list of dicts; `gx.sweeps.random` for a random design.
    - `store`: a path. NAME.nc is written at the end, and what is done until then kept in the folder NAME.nc.chunks;
      another path is a folder. The same call resumes after any interruption; a store of another sweep is refused.
    - `chunk`: lanes at a time, which share their default step, that of the stiffest; `None`: as many as fit a core's
      cache, 64 at most, one of what is called lane by lane. Results depend on it by rounding and the error of steps.
    - `executor`: any of `concurrent.futures` (processes, a Dask cluster's), or so many processes of one's own; a worker
      that dies loses the chunk that it was at, which is tried again. `None`: threads in this process.
    - `devices`: so many threads, or devices of JAX; `None`: every core, one where the function is called lane by lane.
    - `progress`: a bar with the time left, after two seconds. `units`: {name: unit} of parameters and results.
    - `lanes`: `False` calls the function lane by lane, `True` refuses where it cannot be compiled.

    A lane that is refused, raises, does not complete or gives what is not finite is marked in `reason`; the others
    stand. Costs are predicted from the bound on the stiffness: the longest lanes come first, alike ones together. The
    function has no derivative through a sweep: take it within, or `gx.derivative`.

    **Returns:** `Sweep`, an `xarray.Dataset`. **Raises** ValueError for parameters that the function does not take,
    for a compiled function that computes something else when it is traced again, as one that draws random numbers of
    NumPy does, and for a store that is not this sweep's; RuntimeError where every lane failed.

    **Example:**

    >>> def pulse(ratio):
    ...     chain = gx.scenes.dimer(20, ratio=ratio)
    ...     return {"v": gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05).final.v[0]}
    >>> data = gx.sweep(pulse, {"ratio": [0.5, 1.0]})
    >>> data.v.values.round(4)
    array([-0.1827, -0.0711])
    """
    checked_executor(executor)
    points = points_of(parameters)
    told = function_identity(function)
    units = _units(units)
    chunk = None if chunk is None else whole("chunk", chunk, 1)
    plan = planned(function, points, lanes, chunk)
    if lanes and plan.how.kind == EACH:
        refuse("lanes", "None or False for this function", "True", "It cannot be compiled: it is called lane by lane.")
    identity = _identity(told, points, plan, units)
    if store is None:
        return known(_computed(function, points, units, identity, None, executor, devices, progress), function, points)
    kept = Store(store, identity)
    try:
        if chunk is not None and kept.identity["chunk"] != chunk:
            refuse("chunk", f"{kept.identity['chunk']}, with which the store was begun", str(chunk))
        data = kept.result
        if data is None:
            data = _computed(function, points, units, kept.identity, kept, executor, devices, progress)
    finally:
        kept.close()
    return known(data, function, points)


def _computed(function, points, units, identity, kept, executor, devices, progress):
    """The dataset, of chunks that are kept and those that are to come."""
    plan = plan_of(identity)
    parts = parts_of(points, plan)
    task = Task(function, tuple(points.axes), plan.how, min(plan.chunk, max(map(len, parts))))
    found = {} if kept is None else kept.chunks(list(map(len, parts)))
    remarks = [] if kept is None else kept.remarks
    for remark in remarks:
        warnings.warn(remark, stacklevel=4)
    threads = _threads(devices, plan)
    count = threads if isinstance(threads, int) else len(threads)
    work = task if isinstance(threads, int) or executor is not None else _OnDevices(task, threads)
    todo = [(n, _values(points, plan, part)) for n, part in enumerate(parts) if n not in found]
    lost = False
    done = sum(len(parts[n]) for n in found)
    shown = bar(points.count, "lane", "sweep", progress, done)
    with shown, closing(completed(work, todo, executor, count)) as results:
        for number, chunk in results:
            lost = lost or LOST in chunk.told
            if kept is not None and LOST not in chunk.told:
                kept.write(number, chunk)
            found[number] = chunk
            shown.update(len(parts[number]))
    failed = [reason for chunk in found.values() for reason in chunk.reasons]
    if all(failed) and not any(_any_number(chunk) for chunk in found.values()):
        raise RuntimeError(f"Every lane failed. The first: {failed[0]}{_hint(function, points)}")
    data = assembled(found, parts, points, units, identity, remarks)
    if kept is not None and not lost:
        kept.finish(data)
    return data


def _hint(function, points):
    """What helps who has taken one dict of parameters for the only one of them."""
    if by_keywords(function, tuple(points.axes)) or len(points.axes) > 1:
        return ""
    name = next(iter(points.axes))
    return f" (Its argument is no parameter, so it is given a dict of all; called {name!r} it is given numbers.)"


def _any_number(chunk):
    return any(x.size and (x.dtype.kind not in "fU" or x.dtype.kind == "f" and np.isfinite(x).any()
                           or x.dtype.kind == "U" and (x != "").any()) for x in chunk.columns.values())


def _units(units):
    units = {} if units is None else dict(units)
    for name, unit in units.items():
        if not isinstance(name, str) or not isinstance(unit, str):
            refuse("units", "{name: unit}, both words", f"{name!r}: {unit!r}")
    return units


def _identity(told, points, plan, units):
    versions = {"granjax": sys.modules["granjax"].__version__, "jax": jax.__version__, "numpy": np.__version__,
                "python": "{}.{}".format(*sys.version_info)}
    return {
        "format": 1, "function": told, "design": points.design,
        "parameters": {name: {"values": x.tolist(), "dtype": str(x.dtype), "units": units.get(name, "")}
                       for name, x in points.axes.items()},
        "how": {name: list(x) if isinstance(x, tuple) else x for name, x in plan.how._asdict().items()},
        "chunk": int(plan.chunk), "order": None if plan.order is None else plan.order.tolist(),
        "scene": plan.scene, "float": str(jax.numpy.zeros(0).dtype), "platform": jax.default_backend(),
        "versions": versions,
    }


def _values(points, plan, part):
    values = points.values(part)
    if set(part.tolist()) & set(plan.how.apart):
        values[""] = np.ones(len(part), bool)
    return values


def _threads(devices, plan):
    """How many threads, or a tuple of devices."""
    if devices is None:
        if plan.how.kind == EACH:
            return 1
        return _cores() if jax.default_backend() == "cpu" else tuple(jax.devices())
    if isinstance(devices, (int, np.integer)):
        return whole("devices", devices, 1)
    if not devices or not all(isinstance(device, jax.Device) for device in devices):
        refuse("devices", "a whole number of threads, or devices of JAX", repr(devices)[:80], "Such as jax.devices().")
    return tuple(devices)


def _cores():
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _OnDevices:
    """A task on whichever of some devices is free."""

    def __init__(self, task, devices):
        import queue

        self.task, self.free = task, queue.SimpleQueue()
        for device in devices:
            self.free.put(device)

    def __call__(self, values):
        device = self.free.get()
        try:
            with jax.default_device(device):
                return self.task(values)
        finally:
            self.free.put(device)


@checked
def read(store: str | Path) -> Sweep:
    """What a store holds so far: `Sweep`, with the reason "not computed yet" where a lane is to come.

    It does not know the function. **Raises** ValueError for what is no store of a sweep, or is damaged.

    **Example:**

    >>> data = gx.sweep(lambda x: {"y": x**2}, {"x": [1.0, 2.0, 3.0]}, store="squares.nc")
    >>> gx.sweeps.read("squares.nc").y.values
    array([1., 4., 9.])
    """
    kept = Store.opened(store)
    if kept.result is not None:
        return known(kept.result, None, None)
    identity = kept.identity
    try:
        axes = {name: np.array(x["values"], x["dtype"]) for name, x in identity["parameters"].items()}
        points, plan = Points(axes, identity["design"]), plan_of(identity)
        parts = parts_of(points, plan)
        units = {name: x["units"] for name, x in identity["parameters"].items() if x["units"]}
        found = kept.chunks(list(map(len, parts)))
        return known(assembled(found, parts, points, units, identity, kept.remarks), None, None)
    except (TypeError, ValueError, LookupError, AttributeError, OverflowError, MemoryError) as error:
        if str(error).startswith("store: "):
            raise
        refuse("store", "the store of a sweep", f"{str(store)!r}, which contradicts itself ({error})")
