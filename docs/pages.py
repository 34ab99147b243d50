"""What the code of the pages prints and draws, kept in docs/outputs and shown under each block.

`python docs/pages.py` makes all of it anew, `python docs/pages.py how-to/batch` that of one page.
"""

import contextlib
import io
import json
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

DOCS = Path(__file__).parent
OUTPUTS = DOCS / "outputs"
KEPT = OUTPUTS / "printed.json"
# pages that stand alone; the others are in a folder
ALONE = ("start", "methods", "matlab", "compare", "formulas", "cite")
PAGES = [
    *ALONE,
    *sorted(f"concepts/{path.stem}" for path in (DOCS / "concepts").glob("*.md")),
    *sorted(f"how-to/{path.stem}" for path in (DOCS / "how-to").glob("*.md")),
]
BLOCK = re.compile(r"^```python\n(.*?)^```\n", re.M | re.S)
# lines of a dataset that say with which versions it was made
VERSION = re.compile(r"^ +(granjax|jax|numpy): .*$", re.M)
NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?")
# what may differ in a printed number, relatively; numbers below SMALL are errors, of which the size may differ
NEAR = 1e-3
SMALL = 1e-5
# pixels per inch of a kept picture
SHARP = 80


def blocks(page: str) -> list[str]:
    """The Python blocks of a page."""
    return BLOCK.findall((DOCS / f"{page}.md").read_text())


def run(page: str) -> Iterator[tuple[str, Any]]:
    """Run the blocks of a page from top to bottom: what each prints, and the last figure or None."""
    space = {}
    for number, block in enumerate(blocks(page), 1):
        plt.close("all")
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            exec(compile(block, f"{page}, block {number}", "exec"), space)
        yield said.getvalue(), plt.figure(plt.get_fignums()[-1]) if plt.get_fignums() else None
    plt.close("all")


def alike(kept: str, found: str) -> bool:
    """Whether two printed texts have the same words, and numbers that agree."""
    kept, found = (VERSION.sub("", text) for text in (kept, found))
    words = lambda text: NUMBER.sub("#", text).split()
    numbers = lambda text: [float(x) for x in NUMBER.findall(text)]
    return words(kept) == words(found) and all(
        abs(a - b) <= NEAR * max(abs(a), abs(b)) or max(abs(a), abs(b)) < SMALL
        for a, b in zip(numbers(kept), numbers(found))
    )


def picture(page: str, number: int) -> Path:
    """The file of the figure that a block of a page draws."""
    return OUTPUTS / f"{page.replace('/', '-')}-{number}.png"


def with_outputs(app: Any, page: str, source: list[str]) -> None:
    """Insert what is kept under the blocks of a page (an event of Sphinx)."""
    kept = iter(json.loads(KEPT.read_text()).get(page, []))
    number = iter(range(1, 1000))

    def extended(block):
        said = next(kept, "")
        picture_of = picture(page, next(number))
        text = f"\n```{{code-block}} text\n:class: printed\n\n{said}```\n" if said else ""
        drawn = f"\n![What the code above draws](/outputs/{picture_of.name})\n"
        return block[0] + text + drawn * picture_of.exists()

    source[0] = BLOCK.sub(extended, source[0])


def make(page: str) -> None:
    """Run a page and keep what it prints and draws."""
    everything = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    everything[page] = []
    for number, (said, figure) in enumerate(run(page), 1):
        everything[page].append(said)
        picture(page, number).unlink(missing_ok=True)
        if figure is not None:
            figure.savefig(picture(page, number), dpi=SHARP)
    if not any(everything[page]):
        del everything[page]
    KEPT.write_text(json.dumps(everything, indent=1, sort_keys=True) + "\n")


if __name__ == "__main__":
    OUTPUTS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for name in ("notebooks", "benchmarks"):
            (Path(folder) / name).symlink_to(DOCS.parent / name)
        os.chdir(folder)
        for page in sys.argv[1:] or PAGES:
            make(page)
            print(page)
