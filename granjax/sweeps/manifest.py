"""What the store of a sweep says of itself, read without trust."""

import hashlib
import json
import math
import re
from pathlib import Path

import xarray

from ..checks import refuse
from ..files import reason

DTYPE = re.compile(r"(u?int|float)(8|16|32|64)|bool|<U[1-9][0-9]{0,5}")
REMEDY = "Give another store, or remove this one to begin anew."
# bytes of a manifest; lanes of a sweep
MOST, LANES = 2**28, 10**8


def digest(held: bytes) -> str:
    """What no other bytes have."""
    return hashlib.sha256(held).hexdigest()


def written(identity: dict) -> str:
    """A manifest of what a sweep is."""
    text = json.dumps(identity)
    return json.dumps({"identity": text, "sha256": digest(text.encode())})


def content_of(data: xarray.Dataset) -> str:
    """A digest of all that a dataset holds, the same before it is written and after it was read."""
    found = hashlib.sha256(repr(sorted((str(k), str(x)) for k, x in data.attrs.items())).encode())
    for name in sorted(map(str, data.variables)):
        x = data.variables[name]
        held = x.values
        found.update(repr((name, x.dims, x.shape, sorted((str(k), str(u)) for k, u in x.attrs.items()))).encode())
        if held.dtype.kind in "iufc":
            found.update(held.astype(held.dtype.newbyteorder("<")).tobytes())
        else:
            found.update(repr(held.astype(int if held.dtype.kind == "b" else str).tolist()).encode())
    return found.hexdigest()


def complete(identity: dict) -> bool:
    """Whether an identity has what every one has, of the kinds that these are."""
    kinds = {"function": dict, "parameters": dict, "versions": dict, "how": dict, "chunk": int, "design": str}
    if any(not isinstance(identity.get(name), kind) for name, kind in kinds.items()) or identity.get("format") != 1:
        return False
    function, how, order, parameters = (identity.get(name) for name in ("function", "how", "order", "parameters"))
    rows = parameters.values()
    if not (
        isinstance(function.get("reads"), dict) and isinstance(function.get("name"), str) and "code" in function
        and rows and all(isinstance(x, dict) and isinstance(x.get("values"), list) and x["values"]
                         and isinstance(x.get("dtype"), str) and DTYPE.fullmatch(x["dtype"])
                         and isinstance(x.get("units"), str) for x in rows)
        and identity["design"] in ("grid", "list") and type(identity["chunk"]) is int and identity["chunk"] > 0
    ):
        return False
    sizes = [len(x["values"]) for x in rows]
    count = math.prod(sizes) if identity["design"] == "grid" else sizes[0]
    return (
        0 < count <= LANES and (identity["design"] == "grid" or len(set(sizes)) == 1)
        and how.get("kind") in ("lanes", "vmap", "each") and isinstance(how.get("errors"), bool)
        and all(isinstance(how.get(key), list) and all(name in list(parameters) for name in how[key])
                for key in ("static", "shared"))
        and _numbers(how.get("apart"), count) and len(set(how["apart"])) == len(how["apart"])
        and (order is None or _numbers(order, count) and len(order) == len(set(order)) == count)
        and isinstance(identity.get("scene", ""), str)
    )


def _numbers(x, count):
    """Whether it is a list of numbers of lanes."""
    return isinstance(x, list) and all(type(n) is int and 0 <= n < count for n in x)


def manifest(place: Path) -> dict:
    """The identity in a manifest. **Raises** ValueError for one that is damaged."""
    expected = "the manifest of a sweep"
    if place.is_symlink() or not place.is_file():
        refuse("store", expected, f"{str(place)!r}, which is no ordinary file", REMEDY)
    try:
        if place.stat().st_size > MOST:
            refuse("store", expected, f"{str(place)!r} of {place.stat().st_size} bytes", REMEDY)
        told = json.loads(place.read_bytes().decode())
        text = told["identity"]
        whole = told["sha256"] == digest(text.encode())
        found = json.loads(text) if whole else None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        whole = False
    except OSError as error:
        refuse("store", expected, f"{str(place)!r} ({reason(error)})", REMEDY)
    if not whole or not isinstance(found, dict) or not complete(found):
        refuse("store", expected, f"{str(place)!r}, which is truncated, damaged or something else", REMEDY)
    return found


def told_by(data: xarray.Dataset, file: Path) -> dict:
    """What the file of a sweep says that it is of."""
    try:
        found = json.loads(data.attrs["sweep"])
        for name, x in found["parameters"].items():
            x["values"] = data[name].values.astype(x["dtype"]).tolist()
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError, OverflowError, MemoryError):
        found = None
    if not isinstance(found, dict) or not complete(found):
        refuse("store", "the file of a sweep, or a free name", f"{str(file)!r}, which is something else", REMEDY)
    return found
