"""The chunks of a sweep as one dataset."""

import json
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import numpy as np
import xarray

from .chunk import Chunk
from .function import joined
from .points import TAKEN, Points

CITE = (
    "granjax: a differentiable simulator of nonlinear lattices, The granjax developers; "
    "Chong and Kevrekidis, Dynamics of Nonlinear Lattices"
)
NOT_YET = "not computed yet"


def assembled(
    found: dict[int, Chunk], parts: list[np.ndarray], points: Points, units: dict[str, str], identity: dict,
    remarks: Sequence[str] = (),
) -> xarray.Dataset:
    """The chunks that there are as one dataset, lanes in the order of the design."""
    back = np.empty(points.count, int)
    back[np.concatenate(parts)] = np.arange(points.count)
    counts = list(map(len, parts))
    names = list(dict.fromkeys(name for n in sorted(found) for name in found[n].columns))
    told = {name: found[n].told.get(name, {}) for n in sorted(found, reverse=True) for name in found[n].columns}
    variables = {}
    for name in names:
        columns = [found[n].columns.get(name) if n in found else None for n in range(len(parts))]
        x = joined(columns, counts)[back].reshape(*points.shape, *joined_shape(columns))
        dims = told[name].get("dims", [])
        over = x.ndim - len(points.shape)
        dims = dims if len(dims) == over else [f"{name}_{k}" for k in range(over)]
        dims = [f"{name}_{d}" if d in points.axes else d for d in dims]
        attrs = {k: u for k, u in told[name].items() if k != "dims"}
        attrs |= {"units": units[name]} if name in units else {}
        key = f"{name}_found" if name in points.axes or name in TAKEN else name
        variables[key] = _alike((*points.dims, *dims), x, attrs) if dims == [key] else ((*points.dims, *dims), x, attrs)
    reasons = [r for n, size in enumerate(counts) for r in (found[n].reasons if n in found else [NOT_YET] * size)]
    reasons = np.array(reasons, dtype=str)[back].reshape(points.shape)
    variables["reason"] = points.dims, reasons, {}
    own = points.dims if points.design == "list" else None
    coordinates = {name: (own or (name,), x, {"units": units[name]} if name in units else {})
                   for name, x in points.axes.items()}
    _agree(variables)
    attributes = {
        "result": "Sweep", "outcome": _outcome(points, reasons, remarks),
        "function": identity["function"].get("name", ""), **identity["versions"], "commit": _commit(), "cite": CITE,
        "sweep": json.dumps(brief(identity)),
    } | ({"scene": identity["scene"]} if identity.get("scene") else {})
    return xarray.Dataset(variables, coordinates, attributes)


def brief(identity: dict) -> dict:
    """What a sweep is without what its coordinates hold, and without the order of chunks: short for an attribute."""
    told = {name: {k: v for k, v in x.items() if k != "values"} for name, x in identity["parameters"].items()}
    return {**identity, "parameters": told, "order": None, "how": {**identity["how"], "apart": []}, "scene": ""}


def _alike(dims, x, attrs):
    """What has the name of its axis: a coordinate where it is the same in all lanes that have it."""
    rows = x.reshape(-1, x.shape[-1])
    there = rows[[i for i, row in enumerate(rows) if row.dtype.kind != "f" or np.isfinite(row).any()]]
    return (dims[-1:], there[0], attrs) if len(there) and (there == there[0]).all() else (dims, x, attrs)


def joined_shape(columns: list[np.ndarray | None]) -> tuple[int, ...]:
    """The axes beyond the lanes that arrays have together."""
    there = [x for x in columns if x is not None]
    axes = max(x.ndim for x in there)
    return tuple(max(x.shape[k] if k < x.ndim else 1 for x in there) for k in range(1, axes))


def _agree(variables):
    """Axes of one name and several lengths get names of their own."""
    sizes = {}
    for name, (dims, x, _) in variables.items():
        for k, dim in enumerate(dims):
            if sizes.setdefault(dim, x.shape[k]) != x.shape[k]:
                dims = (*dims[:k], f"{name}_{dim}", *dims[k + 1 :])
                variables[name] = dims, x, variables[name][2]


def _outcome(points, reasons, remarks):
    flat = reasons.reshape(-1)
    bad = np.flatnonzero(flat != "")
    over = ", ".join(f"{name} ({len(x)})" for name, x in points.axes.items())
    said = f"{points.count} lane{'s' * (points.count != 1)} over {over}"
    if bad.size:
        at = ", ".join(f"{name} = {x:.6g}" if isinstance(x, float) else f"{name} = {x}"
                       for name, x in points.at(int(bad[0])).items())
        said += f"; {bad.size} marked, the first at {at}: {flat[bad[0]]}"
    return " ".join([said if said.endswith(".") else f"{said}.", *remarks])


def _commit():
    """The commit of the package, where that is known: of a checkout, or of what pip has installed from one."""
    try:
        told = json.loads(metadata.distribution("granjax").read_text("direct_url.json") or "{}")
        if "vcs_info" in told:
            return str(told["vcs_info"].get("commit_id", "unknown"))
    except (metadata.PackageNotFoundError, ValueError, OSError):
        pass
    git = Path(__file__).resolve().parents[2] / ".git"
    try:
        git = Path(git.read_text().split(":", 1)[1].strip()) if git.is_file() else git
        head = (git / "HEAD").read_text().strip()
        if not head.startswith("ref: "):
            return head
        common = git / "commondir"
        base = git / common.read_text().strip() if common.is_file() else git
        return (base / head[5:]).read_text().strip()
    except (OSError, IndexError, ValueError):
        return "unknown"
