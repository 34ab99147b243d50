"""Text files of columns: how they are written is decided by the whole file, and what can be read in two ways is not."""

import csv
import itertools
import math
import re
from array import array
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..checks import one_of, refuse, whole
from ..printing import told
from ..types import Count
from .reader import regular

COMMENTS = ("#", "%", "//")
# a delimiter of `None` is one blank or more
DELIMITERS = ("\t", ";", ",", None)
WHAT = "a text file of numbers in columns"
REMEDY = "Is it damaged or cut? header= says how many lines of the file are its header."
# bytes of text, which take ten times as many while they are read
LARGEST = 2**29
# nothing that is matched is given back: a line of a million digits takes a millisecond
DIGITS = {
    ".": r"[+-]?+(?:\d++(?:\.\d*+)?+|\.\d++)(?:[eE][+-]?+\d++)?+",
    ",": r"[+-]?+(?:\d++(?:,\d++)?+|,\d++)(?:[eE][+-]?+\d++)?+",
}
NUMBER = {decimal: re.compile(digits, re.ASCII) for decimal, digits in DIGITS.items()}
# how instruments write a sample that is not there or beyond their range
MISSING = {
    "", "-", "--", "---", "*", "***", "?", "nan", "+nan", "-nan", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#ind",
    "na", "n/a", "#n/a", "null", "none", "missing", "inf", "+inf", "-inf", "infinity", "-infinity", "1.#inf", "-1.#inf",
    "∞", "+∞", "-∞", "ol", "+ol", "-ol", "ovl", "ovr", "over", "+over", "-over", "overflow", "overload", "overrange",
    "under", "clip", "clipped",
}
# a damaged number too
LIKE_A_NUMBER = re.compile(r"[\"'+-]*[.,]?[0-9]")
HALVED = re.compile(r"(?:^|,) *[+-]?\d+,0\d+ *(?:,|$)", re.ASCII)
# from here on SCPI writes infinity and no number
BEYOND = 9.9e37


class Table(NamedTuple):
    """What a text file holds.

    `names`: the header's lines that have as many fields as there are columns. `numbers` (rows, columns), NaN where a
    sample is missing and for words in columns that are not asked for. `header`: the lines before the first row as they
    stand in the file. `remark`: what was passed over, "" for nothing.
    """

    names: list[list[str]]
    numbers: np.ndarray
    header: tuple[str, ...]
    remark: str
    __repr__ = told


class _Reading(NamedTuple):
    """A file as columns, in one of the ways it may be written: `names` and `numbers` as above, what they come from."""

    delimiter: str | None
    decimal: str
    names: list[list[str]]
    numbers: np.ndarray
    first: int
    lines: list[tuple[int, str]]
    words: list[str]


class _Failure(NamedTuple):
    """Why a file is no table when it is read in one way, and after how many rows."""

    rows: int
    got: str
    remedy: str


def table(
    path: str | Path, *, delimiter: str | None = None, decimal: str | None = None, header: Count | None = None,
    asked: tuple[int | str, ...] = (), time: int | str | None = None,
) -> Table:
    """The columns of a text file.

    **Arguments:** `delimiter`, `decimal`, `header` (lines of the file before the first row): what the file does not
    tell; words in columns that are not asked for by index matter only where `header` is not said. `asked`: columns
    that are wanted, by index or name, and `time`, one of them, whose numbers rise: a reading without them is none.
    **Raises** ValueError for a file that is no table, or two.
    """
    path, text = _text(path)
    if delimiter is not None and (not isinstance(delimiter, str) or len(delimiter) != 1 or delimiter in "\"'.\r\n"
                                  or delimiter.isalnum()):
        refuse("delimiter", "one character that is part of no number, or None", repr(delimiter))
    if decimal is not None:
        one_of("decimal", decimal, (".", ","))
    delimiters = DELIMITERS if delimiter is None else (None if delimiter == " " else delimiter,)
    lines = [(k, line) for k, line in enumerate(re.split("\r\n|\n|\r", text), 1) if line.strip()]
    header = None if header is None else whole("header", header)
    needed = {key for key in asked if not isinstance(key, str)}
    tried = [
        _read(lines, *way, header, needed if len(needed) == len(set(asked)) else None)
        for way in itertools.product(delimiters, (".", ",") if decimal is None else (decimal,))
    ]
    dropped = []
    if delimiter is None or decimal is None:
        before = tried
        tried = [_split(reading) if isinstance(reading, _Reading) else reading for reading in tried]
        dropped = [(x, y) for x, y in zip(before, tried) if x is not y]
    readings = [reading for reading in tried if isinstance(reading, _Reading)]
    if any(reading.delimiter == "\t" for reading in readings):
        # a tab is a blank too
        readings = [reading for reading in readings if reading.delimiter is not None]
    distinct = []
    for reading in readings:
        if not any(np.array_equal(reading.numbers, other.numbers, equal_nan=True) for other in distinct):
            distinct.append(reading)
    if not distinct:
        failure = max((x for x in tried if isinstance(x, _Failure)), key=lambda x: x.rows)
        refuse("path", WHAT, f"{str(path)!r}, {failure.got}", failure.remedy)
    fitting = [reading for reading in distinct if _has(reading, asked, time)]
    for reading, failure in () if fitting else dropped:
        if _has(reading, asked, time):
            refuse("path", WHAT, f"{str(path)!r}, {failure.got}", failure.remedy)
    if len(distinct) > 1 and len(fitting) != 1:
        ways = " or ".join(_said(reading) for reading in (fitting or distinct))
        refuse("path", "columns that can be read in one way", f"{str(path)!r}, which is {ways}",
               "Say which by delimiter= or decimal=.")
    (reading,) = fitting or distinct
    if header is None:
        _first_row_is_one(path, reading, time)
    return Table(reading.names, reading.numbers, tuple(line for _, line in reading.lines[: reading.first]),
                 _remark(text, reading))


def named(name: str, names: list[list[str]]) -> list[int]:
    """Indices of the columns that a line of the header calls so, the last line first; case and units do not count."""
    for plain in (str.strip, _plain):
        for line in reversed(names):
            found = [k for k, other in enumerate(line) if plain(other) == plain(name)]
            if found:
                return found
    return []


def _plain(name):
    for bracket in "([":
        name = name.split(bracket)[0]
    return name.strip().lower()


def _text(path):
    """The path of a file and its text, by its byte order mark, as UTF-8, or byte by byte."""
    path, size = regular(path, WHAT)
    if size > LARGEST:
        refuse("path", f"{WHAT} of at most {LARGEST / 2**30:g} GiB", f"{str(path)!r} of {size / 2**30:.3g} GiB",
               "Write it as .mat or .npy, or in parts.")
    try:
        data = path.read_bytes()
    except OSError as error:
        refuse("path", WHAT, f"{str(path)!r} ({error.strerror})")
    wide = data.startswith((b"\xff\xfe", b"\xfe\xff"))
    try:
        text = data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("utf-16" if wide else "latin-1", errors="replace")
    # where a file of DOS ends
    text = text.rstrip("\x1a")
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        refuse("path", WHAT, f"{str(path)!r} with a zero byte in line {line}",
               "It is a binary file, is damaged, or is UTF-16 without a mark: write it as UTF-8.")
    return path, text


def _fields(line, delimiter):
    """The fields of a line. In quotes a delimiter is a letter."""
    if delimiter is None:
        fields = line.split()
    elif '"' in line or "'" in line:
        quote = '"' if '"' in line else "'"
        try:
            fields = next(csv.reader([line], delimiter=delimiter, quotechar=quote, skipinitialspace=True, strict=True))
        except csv.Error:
            return [line]
    else:
        fields = line.split(delimiter)
    fields = [field.strip() for field in fields]
    return [x[1:-1].strip() if len(x) > 1 and x[0] == x[-1] and x[0] in "\"'" else x for x in fields]


def _number(field, decimal):
    """A number, NaN for a sample that is missing, `None` for a word."""
    if not NUMBER[decimal].fullmatch(field):
        return math.nan if field.lower() in MISSING else None
    x = float(field.replace(",", "."))
    return x if abs(x) < BEYOND else math.nan


def _rows(delimiter, decimal, needed):
    """A function of a line that gives its fields and their values; words pass in columns that are not `needed`."""
    digits, between = DIGITS[decimal], " ++" if delimiter is None else f" *+{re.escape(delimiter)} *+"
    plain = re.compile(f" *+{digits}(?:{between}{digits})*+ *+", re.ASCII)

    def row(line):
        if delimiter != decimal and plain.fullmatch(line):
            fields = line.split(delimiter)
            values = [float(x) for x in (line if decimal == "." else line.replace(",", ".")).split(delimiter)]
            if max(values) < BEYOND and min(values) > -BEYOND:
                return fields, values
        fields = _fields(line, delimiter)
        while fields and not fields[-1]:
            fields.pop()
        values = [_number(field, decimal) for field in fields]
        if needed:
            values = [math.nan if x is None and k not in needed else x for k, x in enumerate(values)]
        return fields, values

    return row


def _read(lines, delimiter, decimal, header, needed):
    """The lines as rows of numbers below a header, or why they are not.

    Where `header` and all columns that are `needed` are known, words in other columns are passed over.
    """
    row, end = _rows(delimiter, decimal, None if header is None else needed), len(lines)
    while end and (lines[end - 1][1].lstrip().startswith(COMMENTS) or not any(_fields(lines[end - 1][1], delimiter))):
        # a table of a spreadsheet ends with lines of delimiters
        end -= 1
    if not end:
        return _Failure(-1, f"whose line {lines[0][0]} says {lines[0][1][:60]!r}" if lines else "which is blank", "")
    last = lines[end - 1][1]
    if None in row(last)[1] or delimiter == decimal and "'" not in last and '"' not in last:
        return _Failure(0, f"that ends with {last[:60]!r}",
                        "Give header=, its lines above the first row, and columns by index where others hold words or "
                        "stamps of time; delimiter= where it is another than tab, semicolon, comma or blanks; cut what "
                        "follows the last row.")
    lines, first, words, places, counts, flat = lines[:end], None, [], [], [], array("d")
    for k, (place, line) in enumerate(lines):
        if line.lstrip().startswith(COMMENTS) or header is not None and place <= header:
            continue
        fields, values = row(line)
        if None in values or first is None and not fields:
            if first is None and header is None:
                continue
            return _Failure(len(counts), f"whose line {place} is {line[:60]!r}, no row of numbers", REMEDY)
        first = k if first is None else first
        words += [x for x, value in zip(fields, values) if x and value != value]
        places.append(k)
        counts.append(len(values))
        flat.extend(values)
    if not counts:
        return _Failure(1, f"without a row below line {header}", "header= counts lines of the file.")
    counts, width = np.array(counts), max(counts)
    for k in np.flatnonzero(counts < width):
        place, line = lines[places[k]]
        count = len(_fields(line, delimiter))
        if count < width:
            return _Failure(len(counts), f"whose line {place}, {line[:60]!r}, has {count} field{'s' * (count > 1)} "
                            f"where others have {width}", REMEDY)
    numbers = np.full((len(counts), width), np.nan)
    numbers[np.arange(width) < counts[:, None]] = flat
    names, may_be = _above(lines[:first], delimiter, width, len(_fields(lines[first][1], delimiter)), needed)
    if may_be and header is None:
        return _Failure(len(counts), f"whose line {may_be[0]} is {may_be[1][:60]!r}, which may be a row", REMEDY)
    return _Reading(delimiter, decimal, names, numbers, first, lines, words)


def _above(lines, delimiter, width, count, needed):
    """Lines of names for `width` columns above a first row of `count` fields, and the line that may be a row itself."""
    names, may_be = [], None
    for place, line in lines:
        comment = line.lstrip().startswith(COMMENTS)
        fields = _fields(line.lstrip("".join(COMMENTS) + " "), delimiter)
        fits = len(fields) >= width and (len(fields) == count or not any(fields[width:]))
        like = {k for k, field in enumerate(fields[:width] if fits else fields) if LIKE_A_NUMBER.match(field)}
        seen = like if names else {0, *needed} if fits and needed is not None else {0}
        if fits:
            names.append(fields[:width])
            # above a line of names there is no row, and below it no number that is none
            may_be = may_be if like else None
        if like & seen and not comment:
            may_be = may_be or (place, line)
    return names, may_be


def _split(reading):
    """The reading, if it does not take decimals for columns: those of 1,05 begin with a zero, whole numbers do not."""
    rows = reading.lines[reading.first :] if reading.delimiter == "," else ()
    if rows and not any("." in line for _, line in rows):
        for place, line in rows:
            if HALVED.search(line):
                return _Failure(len(rows), f"whose line {place}, {line[:60]!r}, may be decimal commas between commas",
                                "Say delimiter=',' and decimal='.' where it is whole numbers.")
    return reading


def _has(reading, asked, time):
    """Whether a reading has the columns that are asked for, and times that rise."""
    if any(_column(reading, key) is None for key in asked):
        return False
    return time is None or bool((np.diff(_column(reading, time)) > 0).all())


def _column(reading, key):
    """The numbers under a name or index, `None` where there are none."""
    found = named(key, reading.names) if isinstance(key, str) else [key]
    return reading.numbers[:, found[0]] if found and 0 <= found[0] < reading.numbers.shape[1] else None


def _said(reading):
    columns, first = reading.numbers.shape[1], ", ".join(f"{x:.6g}" for x in reading.numbers[0][:4])
    if columns == 1:
        return f"one column with decimal={reading.decimal!r} (first {first})"
    return f"{columns} columns with delimiter={reading.delimiter or ' '!r}, decimal={reading.decimal!r} (first {first})"


def _first_row_is_one(path, reading, time):
    """Refuse a first row of numbers that may be names of columns: 0,1,2 or what is out of step with the times."""
    rows, columns = reading.numbers.shape
    if rows < 2:
        return
    place, line = reading.lines[reading.first]
    fields, first = _fields(line, reading.delimiter), reading.numbers[0]
    counted = columns > 1 and not reading.names and all(x.isdigit() for x in fields[:columns])
    counted = counted and any((first == np.arange(columns) + k).all() for k in (0, 1))
    times = None if time is None or rows < 3 else _column(reading, time)
    steps = np.full(2, np.nan) if times is None else np.diff(times)
    even = bool(np.ptp(steps[1:]) <= 1e-2 * abs(steps[1]))
    fits = even and bool(abs(steps[0] - steps[1]) <= 0.1 * abs(steps[1]))
    if counted and (columns > 2 or not fits) or even and not fits:
        refuse("path", "a first row that is no line of names", f"{str(path)!r}, whose line {place} is {line[:60]!r}",
               f"Give header={place} to pass over it, header={place - 1} where it is a sample.")


def _remark(text, reading):
    """What was passed over."""
    within = [line for _, line in reading.lines[reading.first :]]
    comments = sum(line.lstrip().startswith(COMMENTS) for line in within)
    missing = int(np.isnan(reading.numbers).sum())
    words = dict.fromkeys(word[:20] for word in reading.words)
    words = ", ".join(map(repr, itertools.islice(words, 5))) + ", ..." * (len(words) > 5)
    said = [
        f"{reading.first} line{'s' * (reading.first > 1)} of header" if reading.first else "",
        f"{comments} comment{'s' * (comments > 1)} between rows" if comments else "",
        f"{missing} missing sample{'s' * (missing > 1)}" + (f" ({words})" if words else "") if missing else "",
    ]
    return "; ".join(x for x in said if x)
