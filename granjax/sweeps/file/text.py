"""TOML as tables: a file of any content gives a dict, or a sentence that says what is wrong and where."""

import re
import tomllib
from pathlib import Path
from typing import Any

from ...checks import refuse
from ...files import reason

# bytes of a file; tables within tables; parts of a dotted key, for which tomllib's time grows as their square
LONGEST, DEEPEST = 1_000_000, 12
_DOTTED = re.compile(r"(?:\.[^.,\n=\[\]{}#]{0,2000}){20}")


def tables(path: str | Path) -> dict[str, Any]:
    """The tables of a TOML file. Nothing in it is executed. **Raises** ValueError for what is no such file."""
    try:
        with open(path, "rb") as file:
            content = file.read(LONGEST + 1)
    except (OSError, ValueError) as error:
        refuse("FILE", "a TOML file that can be read", f"{str(path)!r} ({reason(error)})")
    return parsed(content)


def parsed(content: bytes) -> dict[str, Any]:
    """The tables of a TOML file's content."""
    if len(content) > LONGEST:
        refuse("FILE", f"at most {LONGEST / 1e6:g} MB", "more", "Long lists: {from = ..., to = ..., count = ...}.")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        refuse("FILE", "text in UTF-8", f"other bytes in line {line}", "Save it as UTF-8 in your editor.")
    if _DOTTED.search(text):
        refuse("FILE", "keys of a few parts", "one of twenty or more")
    try:
        found = tomllib.loads(text)
    except RecursionError:
        refuse("FILE", f"tables within tables, {DEEPEST} deep at most", "deeper ones")
    except ValueError as error:  # of the syntax, and of numbers and dates that Python does not hold
        raise ValueError(f"FILE: it is no TOML: {' '.join(str(error).split())[:200]}.") from None
    if _depth(found) > DEEPEST:
        refuse("FILE", f"tables within tables, {DEEPEST} deep at most", "deeper ones")
    return found


def _depth(tree):
    """How deep lists and tables are nested, by level."""
    depth, level = 0, [tree]
    while level:
        inner = [x.values() if isinstance(x, dict) else x for x in level if isinstance(x, (dict, list))]
        level, depth = [y for x in inner for y in x], depth + bool(inner)
    return depth
