"""Datasets whose variables are read from the file when they are asked for."""

from typing import Any

import numpy as np
import xarray
from xarray.backends import BackendArray
from xarray.core import indexing

from ..reading import Stored
from .structure import Pair, together

# entries of a coordinate beyond which it is not read to look up places by it
INDEXED = 2**20


class Lazy(BackendArray):
    """A stored array as xarray asks for it; complex where it is stored as two."""

    def __init__(self, array: Stored | Pair):
        self.array = array
        one = array.real if isinstance(array, Pair) else array
        self.shape = one.shape
        self.dtype = np.result_type(one.dtype, np.complex64) if isinstance(array, Pair) else one.dtype

    def __getitem__(self, key: Any) -> np.ndarray:
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.OUTER_1VECTOR, self.read)

    def read(self, key: Any) -> np.ndarray:
        """What whole numbers, slices or a list ask for."""
        return together(*(part[key] for part in self.array)) if isinstance(self.array, Pair) else self.array[key]


def opened(variables: dict, coordinates: list[str], attributes: dict) -> xarray.Dataset:
    """The dataset. Coordinates that are not read have no index, nor has what stands beside them."""
    indexed, beyond, others = {}, {}, {}
    for name, (axes, told, x) in variables.items():
        own = name in coordinates and list(axes) == [name]
        x = x if isinstance(x, np.ndarray) else Lazy(x)
        if isinstance(x, Lazy):
            x = x.read((slice(None),)) if own and x.shape[0] <= INDEXED else indexing.LazilyIndexedArray(x)
        kept = others if not own else indexed if isinstance(x, np.ndarray) else beyond
        kept[name] = xarray.Variable(axes, x, told)
    data = xarray.Dataset(others | indexed, attrs=attributes)
    data = data.assign_coords(xarray.Coordinates(beyond, indexes={})) if beyond else data
    return data.set_coords(coordinates)
