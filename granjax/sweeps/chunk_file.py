"""The file of a chunk: a digest, the key of its sweep, an `.npz` of numbers and words. No pickle is read."""

import hashlib
import io
import json
import zipfile
from pathlib import Path

import numpy as np

from .chunk import Chunk

MAGIC = b"granjax chunk 1\n"
# bytes that say how many follow
LENGTH = 8


def written(chunk: Chunk, number: int, key: str) -> bytes:
    """The content of the file of a chunk."""
    content = key.encode() + packed(chunk, number)
    content = (LENGTH + len(content)).to_bytes(LENGTH, "big") + content
    return MAGIC + hashlib.sha256(content).digest() + content


def read(place: Path, number: int, count: int, key: str) -> Chunk:
    """The chunk of a number, of so many lanes, of the sweep of a key. **Raises** what tells that it is not that."""
    if place.is_symlink() or not place.is_file():
        raise ValueError("no ordinary file")
    begin = len(MAGIC) + 32
    with open(place, "rb") as file:
        head = file.read(begin + LENGTH)
        if head[: len(MAGIC)] != MAGIC:
            raise ValueError("no chunk of a sweep")
        # before so many bytes are read
        if place.stat().st_size - begin != int.from_bytes(head[begin:], "big"):
            raise ValueError("truncated or damaged")
        held = head + file.read()
    if hashlib.sha256(held[begin:]).digest() != held[len(MAGIC) : begin]:
        raise ValueError("truncated or damaged")
    begin += LENGTH
    if held[begin : begin + 64] != key.encode():
        raise ValueError("of another sweep")
    chunk, own = unpacked(held[begin + 64 :])
    if own != number or len(chunk.reasons) != count or any(x.shape[:1] != (count,) for x in chunk.columns.values()):
        raise ValueError("of another part of the sweep")
    return chunk


def _words(told):
    """Whether it is what is known of a column: words, and names of axes."""
    return isinstance(told, dict) and all(
        isinstance(x, str) if name != "dims" else isinstance(x, list) and all(isinstance(dim, str) for dim in x)
        and len(set(x)) == len(x) for name, x in told.items())


def packed(chunk: Chunk, number: int) -> bytes:
    """A chunk as the bytes of an `.npz` of numbers and words, the rest as JSON in it."""
    told = {"number": number, "names": list(chunk.columns), "reasons": chunk.reasons, "told": chunk.told}
    arrays = {f"x{i}": np.asarray(x) for i, x in enumerate(chunk.columns.values())}
    buffer = io.BytesIO()
    np.savez(buffer, told=np.frombuffer(json.dumps(told).encode(), np.uint8), **arrays)
    return buffer.getvalue()


def unpacked(held: bytes) -> tuple[Chunk, int]:
    """The chunk that `packed` made these bytes of, and its number. **Raises** what NumPy does for other ones."""
    with zipfile.ZipFile(io.BytesIO(held)) as members:
        if sum(member.file_size for member in members.infolist()) > len(held):
            raise ValueError("it states more than it holds")
    with np.load(io.BytesIO(held), allow_pickle=False) as arrays:
        told = json.loads(arrays["told"].tobytes())
        columns = {str(name): arrays[f"x{i}"] for i, name in enumerate(told["names"])}
    if any(x.dtype.kind not in "biufcU" for x in columns.values()):
        raise ValueError("values of another kind")
    reasons = told["reasons"]
    if not isinstance(reasons, list) or not all(isinstance(x, str) for x in reasons) or type(told["number"]) is not int:
        raise ValueError("reasons of another kind")
    if not isinstance(told["told"], dict) or not all(map(_words, told["told"].values())):
        raise ValueError("told of another kind")
    return Chunk(columns, reasons, told["told"]), told["number"]
