"""What the JSON files of the benchmarks say: on which machine, and every point of a table of `measure`."""

import datetime
import math
import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path

import numpy as np

from granjax.base.tuning import cores

PACKAGES = ("granjax", "jax", "jaxlib", "diffrax", "equinox", "numpy")
ROOT = Path(__file__).parents[1]
POINT = ("method", "parameter", "value", "error", "seconds", "fastest", "evaluations", "steps")
POINT += ("drawn", "note")
METHOD = ("compile_seconds", "limit", "order", "order_error")


def machine():
    """A dict: processor, cores that this process may use, system, versions, XLA's flags, date (UTC), commit."""
    return {
        "processor": _processor(),
        "cores": cores(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in PACKAGES},
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "commit": _commit(),
    }


def _processor():
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.is_file() else []
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor() or platform.machine()


def _commit():
    """The checkout's commit, `-dirty` where files differ from it; `None` without one."""
    command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=12"]
    done = subprocess.run([*command, "--exclude", "*"], capture_output=True, text=True, check=False)
    return done.stdout.strip() or None


def as_dict(table):
    """A `WorkPrecision` as plain numbers, strings, lists and dicts; what is not a number is `None`."""
    methods = zip(table.methods, *(getattr(table, name) for name in METHOD))
    points = zip(*(getattr(table, name) for name in POINT))
    found = {
        "floor": table.floor,
        "reference": table.reference_note,
        "repeats": table.repeats,
        "methods": [dict(zip(("name", *METHOD), row)) for row in methods],
        "points": [dict(zip(POINT, row)) for row in points],
    }
    return _plain(found)


def _plain(x):
    if isinstance(x, dict):
        return {name: _plain(value) for name, value in x.items()}
    if isinstance(x, list):
        return [_plain(value) for value in x]
    if isinstance(x, np.generic):
        x = x.item()
    return None if isinstance(x, float) and not math.isfinite(x) else x
