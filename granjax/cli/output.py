"""What a command says, and where: results on standard output, all else on standard error, files in their place."""

import contextlib
import os
import sys
from pathlib import Path

from ..files import reason, write

# as of a process that a closed pipe ends
UNREAD = 141

# pages of the documentation by their titles, which hold for an installed package too: what help and errors name
START = "Start here"
OUTCOMES = "Errors, outcomes and verdicts"


def see(title: str) -> str:
    """The sentence that names a page."""
    return f"See the page '{title}'."


def pointed(error: object, title: str) -> str:
    """An error that names a page: its own, or the one given."""
    said = str(error).rstrip()
    return (
        said
        if "See the page '" in said
        else f"{said}{'' if said.endswith(('.', '!', '?')) else '.'} {see(title)}"
    )


def complain(error: object, code: int = 0) -> int:
    """The exit code; the sentence goes to standard error, or to standard output where that is closed."""
    stream = sys.stdout if sys.stderr is None else sys.stderr
    with contextlib.suppress(OSError):
        print(f"granjax: {error}", file=stream, flush=True)
    return code


def say(text: str) -> int:
    """A result on standard output; the exit code that follows from what became of it."""
    if sys.stdout is None:
        return complain("standard output is closed: results are not printed", 1)
    try:
        print(text, end="\n" if text else "", flush=True)
    except OSError as error:
        # said once: nothing more comes there
        sys.stdout = open(os.devnull, "w")
        if isinstance(error, BrokenPipeError):
            return UNREAD
        return complain(f"standard output could not be written ({reason(error)})", 1)
    return 0


def keep(path: Path, content: bytes | str) -> int:
    """Write a file; a sentence and exit code 1 where it could not be written."""
    try:
        write(path, content)
    except OSError as error:
        return complain(f"{str(path)!r} could not be written ({reason(error)})", 1)
    return 0
