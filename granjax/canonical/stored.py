"""Reading of the data files."""

import zlib
from functools import cache
from importlib import resources
from typing import NamedTuple
from zipfile import BadZipFile

import numpy as np

from ..checks import refuse


class Stored(NamedTuple):
    """What a data file holds.

    `start_u`, `start_v`: where the scene starts, if that is not a matter of exact numbers. `u`, `v`: the reference at
    `t1`, `matrix` for a map of tangents. `uncertainty`, `growth`: see `Scene`. `method`, `date`: how and when it was
    made.
    """

    start_u: np.ndarray | None = None
    start_v: np.ndarray | None = None
    u: np.ndarray | None = None
    v: np.ndarray | None = None
    matrix: np.ndarray | None = None
    t1: float = np.nan
    uncertainty: float = np.nan
    growth: float = np.nan
    method: str = ""
    date: str = ""


@cache
def read(name: str) -> Stored:
    """The data of a scene, arrays that cannot be written to. **Raises** ValueError for a file that is damaged."""
    path = resources.files(__package__).joinpath("data", f"{name}.npz")
    try:
        with path.open("rb") as file, np.load(file) as data:
            arrays = {key: data[key] for key in data.files}
    except (OSError, ValueError, EOFError, LookupError, BadZipFile, zlib.error) as error:
        refuse("name", "data that were installed with granjax", f"{path} ({error})", "Install granjax anew.")
    for x in arrays.values():
        x.flags.writeable = False
    return Stored(**{key: x if x.ndim else x.item() for key, x in arrays.items()})


def unfolded(data: Stored, sites: int) -> tuple[np.ndarray, np.ndarray]:
    """Displacements and velocities of all sites.

    A window shorter than the chain is the half right of the middle of an odd motion, u(-n) = -u(n); further out all
    moves with the velocity it started with.
    """
    if data.u.shape[0] == sites:
        return data.u, data.v
    inner, half = data.u.shape[0], sites // 2
    out = []
    for x, far in ((data.u, data.v[-1] * data.t1), (data.v, data.v[-1])):
        right = np.full(half, far)
        right[:inner] = x
        out.append(np.concatenate([-right[::-1], right]))
    return tuple(out)
