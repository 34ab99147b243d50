"""What a sweep has found: arrays in memory, or a zarr store that is filled chunk by chunk and resumed.

Each file of a store is replaced atomically, nothing larger is. So the order is: arrays without values, then `done`,
whose absence marks an unfinished store; then, for each chunk, its values, and its flag in `done` last.
"""

import json
import warnings

import numpy as np
import xarray

from ..checks import refuse
from ..printing import numbers
from .function import ODD, Chunk
from .points import Points

NOT_YET = "not computed yet"


class Target:
    """Arrays by name over the design, and which of its blocks are there; in memory."""

    def __init__(
        self,
        points: Points,
        chunk: tuple[int, ...],
        blocks: list,
        units: dict[str, str],
        attrs: dict,
    ):
        self.points, self.chunk, self.blocks, self.units, self.attrs = (
            points,
            chunk,
            blocks,
            units,
            attrs,
        )
        self.arrays, self.dims, self.waiting = {}, {}, []
        self.done = np.zeros(len(blocks), bool)

    def put(self, number: int, chunk: Chunk) -> None:
        """Keep a chunk. Those in which every point failed wait for one that tells names and shapes."""
        self.waiting.append((number, chunk))
        if not self.arrays and chunk.columns:
            self._begin(chunk)
        while self.arrays and self.waiting:
            self._write(*self.waiting.pop())

    def _write(self, number, chunk):
        block, over = self.blocks[number], len(self.points.shape)
        shape = tuple(part.stop - part.start for part in block)
        found, reasons = {self._key(name): x for name, x in chunk.columns.items()}, chunk.reasons
        got = {key: x.shape[1:] for key, x in found.items()}
        wanted = {key: x.shape[over:] for key, x in self.arrays.items() if key != "reason"}
        if got and got != wanted:
            found, reasons = {}, np.where(reasons == "", ODD.format(got, wanted), reasons)
        for key, x in found.items():
            self.arrays[key][block] = x.reshape(*shape, *x.shape[1:])
        self.arrays["reason"][block] = reasons.reshape(shape)
        self.done[number] = True

    def _key(self, name):
        return f"{name}_found" if name in self.points.axes or name in ("reason", "done") else name

    def _begin(self, chunk):
        """Arrays for what a first chunk holds."""
        sizes = dict(zip(self.points.dims, self.points.shape))
        for name, x in chunk.columns.items():
            told, key, own = chunk.told[name], self._key(name), x.shape[1:]
            dims = told.get("dims", [f"{key}_{k}" for k in range(len(own))])
            taken = [
                dim in self.points.dims or sizes.setdefault(dim, n) != n
                for dim, n in zip(dims, own)
            ]
            dims = [f"{key}_{dim}" if other else dim for dim, other in zip(dims, taken)]
            unit = self.units.get(name, told.get("units"))
            self.dims[key] = (*self.points.dims, *dims), {} if unit is None else {"units": unit}
            self.arrays[key] = self._array(key, own, x.dtype, "" if x.dtype.kind == "O" else np.nan)
        self.dims["reason"] = self.points.dims, {}
        self.arrays["reason"] = self._array("reason", (), np.dtype(object), NOT_YET)

    def _array(self, key, own, dtype, fill):
        return np.full((*self.points.shape, *own), fill, dtype)

    @property
    def coordinates(self) -> dict[str, tuple]:
        """The parameters: along an axis each, or all along the lanes of a list."""
        attrs = lambda name: {"units": self.units[name]} if name in self.units else {}
        dims = lambda name: (name,) if self.points.design == "grid" else self.points.dims
        return {name: (dims(name), x, attrs(name)) for name, x in self.points.axes.items()}

    def dataset(self) -> xarray.Dataset:
        """What there is."""
        found = {key: (dims, self.arrays[key], attrs) for key, (dims, attrs) in self.dims.items()}
        return _spelt(xarray.Dataset(found, self.coordinates, self.attrs))


class Store(Target):
    """The same in a zarr store, a folder or a URL. `identity` tells a sweep from others; another `source` is a warning.

    **Raises** ValueError for a store of another sweep, and for what is none.
    """

    def __init__(self, root: str, identity: dict, source: str, *arguments):
        super().__init__(*arguments)
        self.root = root
        self.attrs |= {"sweep": json.dumps(identity), "source": source}
        found = opened(root)
        self.unfinished = found is not None and "done" not in found
        if found is None or self.unfinished:
            return
        refuse_another(root, json.loads(found.attrs["sweep"]), identity)
        if source and found.attrs["source"] and source != found.attrs["source"]:
            warnings.warn(
                f"The source of the function has changed since the store {root} was begun, and what is in it was "
                "computed by the earlier one. Give another store to compute everything anew.",
                stacklevel=3,
            )
        keys = [name for name in found if name not in self.points.axes and name != "done"]
        self.arrays = {key: found[key] for key in keys}
        self.flags = found["done"]
        self.done = self.flags[:]

    def _begin(self, chunk):
        import zarr

        mode = "w" if self.unfinished else "w-"
        self.group = zarr.open_group(self.root, mode=mode, zarr_format=2, attributes=self.attrs)
        for name, (dims, x, attrs) in self.coordinates.items():
            self.dims[name] = dims, attrs
            self._made(
                name, x.shape, x.shape, np.dtype(object) if x.dtype.kind == "U" else x.dtype
            )[...] = x
        super()._begin(chunk)
        zarr.consolidate_metadata(self.group.store)
        self.flags = self._made("done", self.done.shape, self.done.shape, np.dtype(bool))
        self.flags[...] = self.done

    def _array(self, key, own, dtype, fill):
        made = self._made(key, (*self.points.shape, *own), (*self.chunk, *own), dtype)
        if dtype.kind == "O":
            made[...] = np.full(made.shape, fill, object)
        return made

    def _made(self, key, shape, chunks, dtype):
        dims, attrs = self.dims.get(key, (("chunk",), {}))
        fill = (
            complex(np.nan, np.nan) if dtype.kind == "c" else np.nan if dtype.kind == "f" else None
        )
        return self.group.create_array(
            key,
            shape=shape,
            chunks=tuple(max(n, 1) for n in chunks),
            dtype=str if dtype.kind == "O" else dtype,
            fill_value=fill,
            attributes={"_ARRAY_DIMENSIONS": list(dims), **attrs},
        )

    def _write(self, number, chunk):
        super()._write(number, chunk)
        self.flags[number] = True

    def dataset(self) -> xarray.Dataset:
        """What there is; values are read when they are asked for."""
        found = xarray.open_zarr(self.root, chunks=None, consolidated=True)
        return _spelt(
            found[[*(name for name in self.arrays if name != "reason"), "reason"]]
        ).assign_attrs(self.attrs)


def _spelt(data):
    """Words as NumPy's own, whatever the store or the version made of them."""
    kinds = {name: x for name, x in data.variables.items() if x.dtype.kind not in "biufcU"}
    return data.assign(
        {name: (x.dims, np.array(x.values.tolist(), str), x.attrs) for name, x in kinds.items()}
    )


def opened(root: str):
    """The group of a store, `None` where there is nothing. **Raises** ValueError for what is no store of a sweep."""
    import zarr

    try:
        group = zarr.open_group(root, mode="r+", use_consolidated=False)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        refuse(
            "store",
            "a new path, or the store of this sweep",
            f"{root!r}, which is neither ({error})",
        )
    if "sweep" not in group.attrs and list(group):
        refuse(
            "store",
            "a new path, or the store of this sweep",
            f"{root!r}, a zarr group that holds something else",
        )
    return group


def refuse_another(root: str, there: dict, here: dict) -> None:
    """Refuse the store of another sweep, with what differs."""
    before, now = there["parameters"], here["parameters"]
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
