"""The gallery: one small script for each system, with its picture and one number beside the expected value.

`python docs/gallery/examples.py NAME ...` runs the named scripts, or all without a name, and stores pictures, numbers
and times for the site (`pictures/`, `made.json`); the site's build runs none of them.
"""

import json
import re
import sys
import time
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
PICTURES = HERE / "pictures"
MADE = HERE / "made.json"
MOST_LINES = 80
FIELDS = ("systems", "part", "number", "expected", "within", "source")


class Example(NamedTuple):
    """A script of the gallery.

    Its docstring holds a title, some words, and lines `:field: value`. `systems`: the systems of the review that it
    shows, comma-separated; `part`: of the gallery; `number`: what the script's `number` is; `expected`: its value, by
    `source`; `within`: the largest difference that is allowed (`3 %`: relative). The script leaves `number` and the
    matplotlib axes or figure `ax`.
    """

    name: str
    title: str
    words: str
    code: str
    systems: tuple[str, ...]
    part: str
    number: str
    expected: float
    within: float
    source: str

    @property
    def lines(self) -> int:
        """The number of lines of code, without empty lines."""
        return sum(bool(line.strip()) for line in self.code.splitlines())

    def agrees(self, number: float) -> bool:
        """Return whether a number is as expected."""
        return abs(number - self.expected) <= self.within

    def run(self) -> dict:
        """Run the script and return its namespace."""
        path = HERE / f"{self.name}.py"
        space = {"__name__": self.name, "__file__": str(path)}
        exec(compile(path.read_text(), str(path), "exec"), space)
        return space


def read(path: Path) -> Example:
    """Read an example from its file."""
    text = path.read_text()
    _, words, code = text.split('"""', 2)
    fields = dict(re.findall(r"^:(\w+): (.*)$", words, re.M))
    missing = [name for name in FIELDS if name not in fields]
    if missing:
        raise ValueError(f"{path.name}: no :{missing[0]}:")
    title, _, rest = re.sub(r"^:\w+: .*\n?", "", words, flags=re.M).strip().partition("\n")
    expected = float(fields["expected"])
    within = fields["within"]
    bound = abs(expected) * float(within[:-1]) / 100 if within.endswith("%") else float(within)
    systems = tuple(x.strip() for x in fields["systems"].split(","))
    return Example(
        path.stem,
        title.rstrip("."),
        rest.strip(),
        code.strip() + "\n",
        systems,
        fields["part"],
        fields["number"],
        expected,
        bound,
        fields["source"],
    )


def every() -> dict[str, Example]:
    """Return all examples by name."""
    own = Path(__file__).name
    return {path.stem: read(path) for path in sorted(HERE.glob("*.py")) if path.name != own}


def systems() -> list[str]:
    """The systems of the review, each of which has to have an example."""
    return [
        line.strip()
        for line in (HERE / "systems.txt").read_text().splitlines()
        if line.startswith("  ")
    ]


def make(example: Example) -> dict:
    """Run an example and save its picture. Return its number and the seconds that it took."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    start = time.perf_counter()
    space = example.run()
    seconds = time.perf_counter() - start
    figure = getattr(space["ax"], "figure", space["ax"])
    PICTURES.mkdir(exist_ok=True)
    figure.savefig(PICTURES / f"{example.name}.png", dpi=110, bbox_inches="tight")
    plt.close("all")
    return {"number": float(space["number"]), "seconds": round(seconds, 1)}


def main(names: list[str]) -> int:
    """Run examples by name. Return 1 if a number is not as expected, else 0."""
    known = every()
    wrong = 0
    for name in names or known:
        one = known[name]
        made = make(one)
        # read the table again: another process may have written it since
        table = json.loads(MADE.read_text()) if MADE.exists() else {}
        MADE.write_text(json.dumps({**table, name: made}, indent=1, sort_keys=True) + "\n")
        verdict = "agrees" if one.agrees(made["number"]) else "DIFFERS"
        wrong += verdict != "agrees"
        print(
            f"{name}: {one.number} = {made['number']:.8g}, {one.expected:.8g} expected (+- {one.within:.2g}): "
            f"{verdict}; {one.lines} lines, {made['seconds']:.1f} s"
        )
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
