"""The results of a sweep: arrays in memory, or a zarr store that is filled chunk by chunk.

Only single files of a store are replaced atomically. The order is therefore: empty arrays; then
`done`, whose absence marks an unfinished store; then the values of each chunk, and its flag in
`done` last.
"""

import json
import warnings
from typing import Any

import numpy as np
import xarray

from ..base.checks import one_of, refuse
from ..base.printing import numbers
from .function import ODD, Chunk
from .points import Points

NOT_YET = "not computed yet"
# the attributes that name the versions of programs
VERSIONS = "granjax", "jax", "numpy"


class Store:
    """Arrays by name over the design, and flags of its finished blocks.

    `root`: a folder or a URL, `None` for memory; `found`: its group, if any. `identity`
    identifies the sweep; a changed `source` only causes a warning.
    **Raises** ValueError for the store of another sweep.
    """

    def __init__(
        self,
        root: str | None,
        found: Any,
        identity: dict,
        source: str,
        points: Points,
        blocks: list,
        units: dict[str, str],
        attrs: dict,
    ):
        self.points = points
        self.blocks = blocks
        self.units = units
        self.attrs = attrs
        self.chunk = identity["chunk"]
        self.root = root
        self.arrays = {}
        self.variables = {}
        self.waiting = []
        self.done = np.zeros(len(blocks), bool)
        self.unfinished = found is not None and "done" not in found
        if root is not None:
            self.attrs |= {"sweep": json.dumps(identity), "source": source}
        if found is None or self.unfinished:
            return
        _refuse_another(root, json.loads(found.attrs["sweep"]), identity)
        if source and found.attrs["source"] and source != found.attrs["source"]:
            warnings.warn(
                f"The source of the function has changed since the store {root} was begun, and what is in it was "
                "computed by the earlier one. Give another store to compute everything anew.",
                stacklevel=3,
            )
        keys = [name for name in found if name not in points.axes and name != "done"]
        self.arrays = {key: found[key] for key in keys}
        self._check_units(keys)
        self.flags = found["done"]
        self.done = self.flags[:]
        earlier = [f"{x} {found.attrs[x]}" for x in VERSIONS if found.attrs[x] != attrs[x]]
        if earlier and not self.done.all():
            warnings.warn(
                f"The store {root} was begun with {', '.join(earlier)}. The points that were missing are computed by "
                "the present versions. Give another store to compute everything anew.",
                stacklevel=3,
            )

    def put(self, number: int, chunk: Chunk) -> None:
        """Store a chunk. Chunks without results wait for one that gives names and shapes."""
        self.waiting.append((number, chunk))
        if not self.arrays and chunk.columns:
            self._begin(chunk.columns)
        while self.arrays and self.waiting:
            self._write(*self.waiting.pop())

    def _begin(self, columns):
        import zarr

        self._check_units(columns)
        if self.root is not None:
            mode = "w" if self.unfinished else "w-"
            self.group = zarr.open_group(self.root, mode=mode, zarr_format=2, attributes=self.attrs)
        over = self.points.dims
        shape = self.points.shape
        for name, x in self.points.axes.items():
            dims = (name,) if self.points.design == "grid" else over
            self._made(name, dims, x.shape, x.shape, x.dtype)[...] = x
        sizes = dict(zip(over, shape))
        for name, x in columns.items():
            own = x.shape[1:]
            dims = [
                f"{name}_{dim}" if dim in over or sizes.setdefault(dim, n) != n else dim
                for dim, n in zip(x.dims[1:], own)
            ]
            layout = (*over, *dims), (*shape, *own), (*self.chunk, *own)
            self.arrays[name] = self._made(name, *layout, x.dtype, **x.attrs)
        self.arrays["reason"] = self._made("reason", over, shape, self.chunk, np.dtype(str))
        self.arrays["reason"][...] = np.full(shape, NOT_YET)
        if self.root is not None:
            # before `done` is made, so that xarray does not read it
            zarr.consolidate_metadata(self.group.store)
            flags = ("chunk",), self.done.shape, self.done.shape
            self.flags = self._made("done", *flags, np.dtype(bool))
            self.flags[...] = self.done

    def _check_units(self, columns):
        known = [*self.points.axes, *(x.removesuffix("_found") for x in columns if x != "reason")]
        for name in self.units:
            one_of("units", name, known)

    def _unit(self, name):
        own = name.removesuffix("_found")
        return {"units": self.units[own]} if own in self.units else {}

    def _made(self, name, dims, shape, chunks, dtype, **attrs):
        attrs |= self._unit(name)
        words = dtype.kind == "U"
        fill = {"f": np.nan, "c": complex(np.nan, np.nan)}.get(dtype.kind)
        if self.root is None:
            blank = "" if words else fill or 0
            made = np.full(shape, blank, object if words else dtype)
            self.variables[name] = dims, made, attrs
            return made
        made = self.group.create_array(
            name,
            shape=shape,
            chunks=tuple(max(n, 1) for n in chunks),
            dtype=str if words else dtype,
            fill_value=fill,
            attributes={"_ARRAY_DIMENSIONS": list(dims), **attrs},
        )
        if words:
            made[...] = np.full(shape, "")
        return made

    def _write(self, number, chunk):
        block = self.blocks[number]
        over = len(self.points.shape)
        shape = tuple(part.stop - part.start for part in block)
        found, reasons = chunk
        got = {name: x.shape[1:] for name, x in found.items()}
        wanted = {name: x.shape[over:] for name, x in self.arrays.items() if name != "reason"}
        if got and got != wanted:
            found = {}
            reasons = np.where(reasons == "", ODD.format(got, wanted), reasons)
        for name, x in found.items():
            self.arrays[name][block] = x.values.reshape(*shape, *x.shape[1:])
        self.arrays["reason"][block] = reasons.reshape(shape)
        if self.root is not None:
            self.flags[number] = True

    def dataset(self) -> xarray.Dataset:
        """Return the results; values on disk are read lazily."""
        if self.root is None:
            data = xarray.Dataset(self.variables, attrs=self.attrs)
        else:
            # with the attributes of the call that began the store
            data = xarray.open_zarr(self.root, chunks=None, consolidated=True)
        data = data.set_coords(self.points.axes)[[*self.arrays]]
        # Words become NumPy strings; their type depends on the store and the versions.
        for name, x in data.variables.items():
            if x.dtype.kind not in "biufcU":
                data[name] = x.dims, np.array(x.values.tolist(), str), x.attrs
            data[name].attrs.update(self._unit(name))
        return data


def opened(root: str):
    """Open the group of a store; `None` if there is none. **Raises** ValueError for other paths."""
    import zarr

    try:
        group = zarr.open_group(root, mode="r+", use_consolidated=False)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        odd = f"which is neither ({error})"
    else:
        if "sweep" in group.attrs or not list(group):
            return group
        odd = "a zarr group that holds something else"
    refuse("store", "a new path, or the store of this sweep", f"{root!r}, {odd}")


def _refuse_another(root, there, here):
    before = there["parameters"]
    now = here["parameters"]
    row = lambda x: numbers(np.asarray(x)).removeprefix("shape ")
    if list(before) != list(now):
        differ = [f"the parameters {', '.join(before)} instead of {', '.join(now)}"]
    else:
        differ = [
            f"{name} {row(before[name])} instead of {row(x)}"
            for name, x in now.items()
            if x != before[name]
        ]
    differ += [
        f"{name} {there[name]} instead of {x}"
        for name, x in here.items()
        if name != "parameters" and there[name] != x
    ]
    if differ:
        refuse(
            "store",
            "the store of this sweep",
            f"{root!r}, which holds {'; '.join(differ)}",
            "Give another store.",
        )
