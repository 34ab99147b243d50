"""What a file of plain arrays cannot say by itself, as JSON: names, axes, coordinates, types, units, attributes."""

import json
import re
import secrets
import zlib
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..checks import refuse

if TYPE_CHECKING:
    import xarray

# of a type that every format holds
KINDS, LARGEST = "biufUO", 8


def refuse_what_no_file_holds(data: "xarray.Dataset") -> None:
    """Refuse names that are no words, indices of several levels, attributes that are no numbers or words."""
    for name in (*data.variables, *data.dims, *data.attrs):
        if not isinstance(name, str) or not name or "/" in name and name in (*data.variables, *data.dims):
            refuse("data", "names that are words, without a slash", repr(name), "data.rename(...) gives others.")
    levels = [name for name, index in data.indexes.items() if getattr(index, "nlevels", 1) > 1]
    if levels:
        refuse("data", "coordinates of one level", f"{levels[0]!r} of several", "data.reset_index(...) makes them so.")
    for where in (data, *data.variables.values()):
        for name, x in where.attrs.items():
            try:
                kind = np.asarray(x).dtype.kind
            except ValueError:
                kind = "O"
            if kind not in "biufU" and not (kind == "c" and where is data):
                refuse("data", "attributes that are numbers, words or lists of such", f"{name}={str(x)[:60]}")


def described(data: "xarray.Dataset", names: dict[str, str]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """(the structure, {key: array}) of a dataset whose variables have these keys in the file; words are arrays of them.

    Complex numbers have become two. **Raises** ValueError for values that are no numbers and no words.
    """
    variables, arrays = {}, {}
    for name, x in data.variables.items():
        value = np.asarray(x.values)
        words = value.dtype.kind in "UO"
        good = value.dtype.kind in KINDS and (words or value.dtype.itemsize <= LARGEST)
        if not good or words and not all(isinstance(word, str) for word in value.flat):
            refuse("path", "variables of numbers or words", f"{name} of type {value.dtype}", "A .nc file may hold it.")
        arrays[names[name]] = value.astype(object) if words else value
        variables[str(name)] = {
            "key": names[name], "axes": [str(axis) for axis in x.dims], "type": "O" if words else value.dtype.str,
            "shape": list(value.shape), "told": {str(key): plain(a) for key, a in x.attrs.items()},
        } | ({"words": value.ravel().tolist()} if words else {})
    structure = {"variables": variables, "coordinates": sorted(map(str, data.coords)),
                 "attributes": {str(key): plain(x) for key, x in data.attrs.items()}}
    return structure, arrays


def text(structure: dict[str, Any]) -> str:
    """The structure as one line, with a sum by which it is known to be whole."""
    # what JSON makes of it has the sum
    structure = json.loads(json.dumps(structure))
    return json.dumps(structure | {"digest": zlib.crc32(json.dumps(structure).encode())})


def plain(x: Any) -> Any:
    """An attribute as JSON has it."""
    return x if isinstance(x, (str, bool, int, float)) and not isinstance(x, np.generic) else np.asarray(x).tolist()


def keys(names: list[str], most: int = 63, letters: str = r"\W") -> dict[str, str]:
    """Names in a file of names, each once; as MATLAB has them: letters, digits and underscores, a letter first."""
    found, taken = {}, set()
    for name in names:
        made = re.sub(letters, "_", name, flags=re.ASCII)
        made = (made if made[:1].isalpha() or letters != r"\W" else f"x_{made}")[:most]
        while made in taken:
            made = f"{made[: most - 7]}_{secrets.token_hex(3)}"
        found[name] = made
        taken.add(made)
    return found


class Pair(NamedTuple):
    """Two arrays that are read when they are asked for: the real and the imaginary parts of one."""

    real: Any
    imag: Any


def together(real: np.ndarray, imag: np.ndarray) -> np.ndarray:
    """A complex array of two, bit by bit: 1j times infinity is no number."""
    made = np.empty(np.shape(real), np.result_type(real, np.complex64))
    made.real, made.imag = real, imag
    return made


def joined(variables: dict, coordinates: list[str], attributes: dict) -> tuple[dict, list[str], dict]:
    """A dataset's parts, where NAME_real and NAME_imag of the same axes have become NAME."""
    pairs = {name: name[:-5] for name in variables if name.endswith("_real") and _are_pair(variables, name[:-5])}
    made = {}
    for name, (axes, told, real) in variables.items():
        if name in pairs:
            imag = variables[f"{pairs[name]}_imag"][2]
            whole = isinstance(real, np.ndarray)
            made[pairs[name]] = axes, told, together(real, imag) if whole else Pair(real, imag)
        elif name[:-5] not in pairs.values() or not name.endswith("_imag"):
            made[name] = axes, told, real
    coordinates = sorted({pairs.get(name, name) for name in coordinates} & made.keys())
    found = dict(attributes)
    for name in [x[:-5] for x in attributes if x.endswith("_real")]:
        parts = [np.asarray(attributes.get(f"{name}_{part}", "")) for part in ("real", "imag")]
        if name not in found and all(x.dtype.kind in "fi" and x.shape == parts[0].shape for x in parts):
            found[name] = together(*(x.astype(float) for x in parts))[()]
            del found[f"{name}_real"], found[f"{name}_imag"]
    return made, coordinates, found


def _are_pair(variables, name):
    if name in variables or f"{name}_imag" not in variables:
        return False
    (axes, _, real), (others, _, imag) = variables[f"{name}_real"], variables[f"{name}_imag"]
    return list(axes) == list(others) and real.dtype == imag.dtype and real.dtype.kind == "f"
