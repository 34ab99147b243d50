"""Any `xarray.Dataset` to a file and back, and arrays of files of others."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import reading
from ..checks import one_of, refuse
from ..entry import checked
from ..files import write
from . import csv_table, formats, structure

if TYPE_CHECKING:
    import xarray

TEXTS = (".csv", ".txt", ".dat", ".tsv")


@checked
def save(data: Any, path: str | Path, *, version: str | None = None) -> Path:
    """Write an `xarray.Dataset`: netCDF (`.nc`), NumPy (`.npz`), MATLAB (`.mat`) or a table (`.csv`).

    Each holds names, axes, coordinates, units and attributes too, so that `load` makes the same dataset of it; numbers
    come back bit by bit. Complex numbers are two variables, NAME_real and NAME_imag. The file is there whole or not at
    all, and what was there before stays where writing fails.

    - `.nc`: for long waveforms too; any software of netCDF or HDF5 reads it.
    - `.npz`: arrays by name for `numpy.load(path, allow_pickle=False)`, all else as JSON in `granjax_structure`.
    - `.mat`: arrays by name, attributes in a struct. `version`: "5", which every MATLAB, Octave and SciPy reads, or
      "7.3", which is HDF5 (MATLAB from 2006 on, `h5read`); `None` takes 5 unless an array has 2 GiB or more.
    - `.csv`: the variables as columns under their names and units, time first, then one for each site: `v_3 (m/s)`; of
      a batch or a sweep one row for each lane (and time), with the parameters as columns. Attributes and what has no
      place in the table stand in comments (#) below it: `pandas.read_csv(path, comment="#")`,
      `numpy.genfromtxt(path, delimiter=",", names=True)` and `gx.Traces.from_csv` read it.

    **Returns:** the path. **Raises** ValueError for another ending or version, what the format does not hold, or where
    nothing can be written (no such folder, no right to); OSError where writing fails (a full disk).

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=11)
    >>> path = gx.exchange.save(run.to_xarray(), "run.npz")
    >>> np.load(path)["v"].shape
    (11, 20)
    """
    import xarray

    if not isinstance(data, xarray.Dataset):
        refuse("data", "an xarray.Dataset", type(data).__name__,
               "result.to_xarray() is one, array.to_dataset(name='u') too.")
    path = formats.place(path, version)
    return write(path, formats.content(data, path.suffix.lower(), version))


@checked
def load(path: str | Path, *, lazy: bool = False, complex: bool = False) -> "xarray.Dataset":
    """The `xarray.Dataset` of a file that `save` wrote, by its ending.

    It is in memory and the file closed. It is read in a process of its own: a damaged file costs a sentence, the first
    one of a session 0.6 s; at most 2 GiB of numbers.

    - `lazy`: numbers are read when they are asked for, by that process: `data.v[-1].values` costs one frame of
      a trajectory of any length, and 2 GiB may be asked for at once. Coordinates of more than 2^20 entries are not read
      either, so that places are counted (`data.v.isel(time=slice(10, 20))`) and not looked up. The file has to stay as
      it is: another one of its name is refused. Not for `.csv` and MATLAB's version 5, which are read whole.
    - `complex`: NAME_real and NAME_imag, of one shape, are joined to a complex NAME.

    **Raises** ValueError for a file that is not there, is no such one or is damaged.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=11)
    >>> path = gx.exchange.save(run.to_xarray(), "run.npz")
    >>> dict(gx.exchange.load(path).v.sizes)
    {'time': 11, 'site': 20}
    """
    import xarray

    if isinstance(path, (str, os.PathLike)) and os.fsdecode(path).lower().endswith(".csv"):
        if lazy:
            refuse("lazy", "a .nc, .npz or .mat file", f"{os.fsdecode(path)!r}, a text, which is read whole",
                   "Leave lazy= out, or save as .nc.")
        variables, coordinates, attributes = csv_table.read(path)
    else:
        variables, coordinates, attributes = reading.dataset(path, lazy)
    coordinates = sorted({*coordinates, *map(str, np.atleast_1d(attributes.pop(formats.SPACED, [])))})
    if lazy and any(isinstance(x, np.ndarray) and x.dtype.kind in "biuf" for *_, x in variables.values()):
        refuse("lazy", "a .nc, .npz or .mat file of version 7.3",
               f"{os.fsdecode(path)!r} of an older version, which is read whole",
               "Leave lazy= out, or save it with version='7.3'.")
    if complex:
        variables, coordinates, attributes = structure.joined(variables, coordinates, attributes)
    try:
        if lazy:
            from .lazily import opened

            return opened(variables, coordinates, attributes)
        made = {name: (axes, x, told) for name, (axes, told, x) in variables.items()}
        return xarray.Dataset(made, attrs=attributes).set_coords(coordinates)
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        said = str(error)[:200]
        refuse("path", "a file that `save` wrote", f"{os.fsdecode(path)!r}, whose parts do not fit ({said})")


@checked
def arrays(path: str | Path, *names: str) -> dict[str, np.ndarray | str]:
    """Arrays by name of a file of somebody else, by its ending: MATLAB's `.mat` (any version), `.npz`, netCDF, a text.

    A field of a struct is "scan.gate"; matrices are shaped as in MATLAB, logical ones are bool, complex ones complex; a
    char array is a text, a cell array of them an array of words. `names`: those that are read, by default all that
    are numbers or words. No pickle is read. Columns of a text (`.csv`, `.txt`, `.dat`, `.tsv`) have the names of its
    header, or their numbers; `gx.Traces.from_csv` takes more of how they are written.

    **Raises** ValueError for a file that is not there, is none or is damaged, for names that are not there, and for
    more than 2 GiB.

    **Example:**

    >>> np.savez("scan.npz", gate=np.arange(3), unit="mm/s")
    >>> found = gx.exchange.arrays("scan.npz")
    >>> found["gate"], found["unit"]
    (array([0, 1, 2]), 'mm/s')
    """
    ending = os.path.splitext(os.fsdecode(path))[1].lower() if isinstance(path, (str, os.PathLike)) else ""
    if ending in TEXTS:
        return _columns(path, names)
    kinds = {".mat": "matlab", ".npz": "npz"}
    found, others = reading.arrays(kinds.get(ending, "netcdf"), path, list(names) or None)
    for name in names:
        if name not in found and others.get(name):
            refuse("names", "an array of numbers or words", f"{name!r}, which is {others[name]}")
        if name not in found:
            one_of("names", name, sorted({*found, *(other for other, kind in others.items() if not kind)}))
    found = {name: x for name, x in found.items() if not names or name in names}
    return {name: x.item() if x.ndim == 0 and x.dtype.kind in "OU" else x for name, x in found.items()}


def _columns(path, names):
    """The columns of a text by name."""
    try:
        table = reading.table(path, asked=names)
    except ValueError as error:
        raise ValueError(f"{error} gx.Traces.from_csv takes such words.") from None
    called = table.names[-1] if table.names else [str(k) for k in range(table.numbers.shape[1])]
    if not names:
        # the second column of a name has its number too
        own = [name if name not in called[:k] else f"{name}_{k}" for k, name in enumerate(called)]
        return {name: table.numbers[:, k] for k, name in enumerate(own)}
    found = {name: reading.named(name, table.names or [called]) for name in names}
    for name, places in found.items():
        if len(places) != 1:
            one_of("names", name, sorted({*called} - {name}))
    return {name: table.numbers[:, places[0]] for name, places in found.items()}
