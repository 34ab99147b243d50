"""Damaged files: small valid ones of every format that is read, and mutants of them by a seeded generator."""

import io
import struct

import h5py
import numpy as np
from scipy.io import savemat

T = np.arange(12) * 1e-4
VOLTS = np.stack([np.sin(9000 * T), np.cos(7000 * T)], axis=1)
HEADS = {
    "comma": ("Model,XY 12\ntime,one,two\ns,V,V\n", ",", "."),
    "semicolon": ('"Time [s]";"One [V]";"Two [V]"\r\n', ";", ","),
    "tab": ("# Vibrometer 7\n# time\tone\ttwo\n", "\t", "."),
    "blanks": ("", " ", "."),
}
# counts and sizes that no file holds, or that almost fit
NASTY = (0, 1, 2, 7, 255, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**32 - 8, 2**16, 2**20, 24, 12, 13)
TEXTS = (b",", b";", b"\t", b" ", b".", b'"', b"'", b"#", b"-", b"e", b"OVER", b"nan", b"inf", b"\n", b"\r", b"\0",
         b"1e999", b"\xb5", b"\xff\xfe", b"\xc2\xa0", b"0x1", b"1_0", b"9.9E+37", b"0")


def matlab_7_3(data):
    """What MATLAB writes: 512 bytes in front, arrays with columns first, a struct as a group, chunks deflated."""
    made = io.BytesIO()
    with h5py.File(made, "w", userblock_size=512) as file:
        file["t"], file["Fs"] = data["t"].T, [[data["Fs"]]]
        file.create_dataset("data", data=data["data"].T, chunks=(1, 6), compression="gzip")
        file["scan/gate"] = data["scan"]["gate"][None]
        for name in ("t", "Fs", "data", "scan/gate"):
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    return b"MATLAB 7.3 MAT-file".ljust(512) + made.getvalue()[512:]


def written(save, *args, **keywords):
    made = io.BytesIO()
    save(made, *args, **keywords)
    return made.getvalue()


def valid():
    """{(format, variant): bytes} of files that are read right."""
    files = {}
    for name, (head, delimiter, decimal) in HEADS.items():
        rows = [delimiter.join(f"{x:.9g}" for x in row).replace(".", decimal) for row in np.column_stack([T, VOLTS])]
        files["csv", name] = (head + "\n".join(rows) + "\n").encode()
    files["csv", "utf-16"] = files["csv", "tab"].decode().encode("utf-16")
    plain = {"t": T[:, None], "data": VOLTS, "Fs": 1e4}
    data = plain | {"scan": {"gate": VOLTS[:, 0]}}
    files["mat", "4"] = written(savemat, plain, format="4")
    big = b"".join(struct.pack(">5i", 1000, *np.atleast_2d(x).shape, 0, len(name) + 1) + name.encode() + b"\0"
                   + np.atleast_2d(x).astype(">f8").tobytes("F") for name, x in plain.items())
    files["mat", "4 big-endian"] = big
    files["mat", "5"] = written(savemat, data)
    files["mat", "5 deflated"] = written(savemat, data, do_compression=True)
    files["mat", "7.3"] = matlab_7_3(data)
    return files


def mutant(rng, whole, text):
    """A damaged copy of a file's bytes: one to three accidents."""
    made = bytearray(whole)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        accident = rng.choice(len(ACCIDENTS) if text else len(ACCIDENTS) - 3)
        made = bytearray(ACCIDENTS[accident](rng, made)) or made
    return bytes(made)


def _place(rng, made, most=64):
    start = int(rng.integers(len(made)))
    return start, start + 1 + int(rng.integers(min(most, len(made) - start)))


def flipped(rng, made):
    for _ in range(rng.integers(1, 5)):
        made[rng.integers(len(made))] ^= 1 << int(rng.integers(8))
    return made


def overwritten(rng, made):
    start, stop = _place(rng, made, 8)
    made[start:stop] = rng.integers(256, size=stop - start, dtype=np.uint8).tobytes()
    return made


def counted(rng, made):
    """A four- or eight-byte word on its boundary becomes a count that cannot be, more often near the beginning."""
    size = int(rng.choice([2, 4, 8]))
    end = len(made) if rng.integers(2) else min(len(made), 512)
    start = size * int(rng.integers(max(end // size, 1)))
    value = int(rng.choice(NASTY)) if rng.integers(3) else int(rng.integers(2**32))
    made[start : start + size] = (value % 2 ** (8 * size)).to_bytes(size, "little" if rng.integers(4) else "big")
    return made


def truncated(rng, made):
    return made[: int(rng.integers(len(made)))]


def inserted(rng, made):
    start = int(rng.integers(len(made) + 1))
    return made[:start] + rng.integers(256, size=rng.integers(1, 9), dtype=np.uint8).tobytes() + made[start:]


def deleted(rng, made):
    start, stop = _place(rng, made)
    return made[:start] + made[stop:]


def doubled(rng, made):
    start, stop = _place(rng, made, 256)
    return made[:stop] + made[start:stop] + made[stop:]


def moved(rng, made):
    start, stop = _place(rng, made)
    block, rest = made[start:stop], made[:start] + made[stop:]
    to = int(rng.integers(len(rest) + 1))
    return rest[:to] + block + rest[to:]


def delimited(rng, made):
    """Delimiters and decimal marks change places, everywhere or in one line."""
    old, new = (b",;\t .\n"[int(k)] for k in rng.integers(6, size=2))
    lines = made.split(b"\n")
    chosen = range(len(lines)) if rng.integers(2) else [int(rng.integers(len(lines)))]
    for k in chosen:
        lines[k] = bytes(lines[k]).replace(bytes([old]), bytes([new]))
    return b"\n".join(lines)


def reworded(rng, made):
    start = int(rng.integers(len(made) + 1))
    return made[:start] + TEXTS[int(rng.integers(len(TEXTS)))] + made[start + int(rng.integers(4)) :]


def relined(rng, made):
    """A line is lost, doubled or moved, or loses its last field."""
    lines = made.split(b"\n")
    k = int(rng.integers(len(lines)))
    line = lines.pop(k)
    kind = rng.integers(4)
    if kind == 1:
        lines[k:k] = [line, line]
    elif kind == 2:
        lines.insert(int(rng.integers(len(lines) + 1)), line)
    elif kind == 3:
        cut = max(line.rfind(mark) for mark in (b",", b";", b"\t", b" "))
        lines.insert(k, line[: max(cut, 0)])
    return b"\n".join(lines)


ACCIDENTS = (flipped, overwritten, counted, truncated, inserted, deleted, doubled, moved, delimited, reworded, relined)
