"""Pages of what is stored: the gallery with its pictures and numbers, the review's figures, notebooks."""

import ast
import json
import shutil
import sys
from pathlib import Path

from PIL import Image
from reference import keep

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "gallery"))

import examples  # noqa: E402

PARTS = (
    "Lattices",
    "Travelling waves",
    "Breathers",
    "Shocks",
    "Beyond the granular chain",
    "Disorder and losses",
    "Thermal chains and chaos",
    "Topology and flat bands",
    "The plane",
    "Data",
    "Devices",
)
# a card is at most 260 wide, and screens have more points than that
THUMB = (420, 290)


def write(docs: Path) -> None:
    """All pages."""
    made = json.loads((docs / "gallery" / "made.json").read_text())
    # what was not made yet has no page (tests/test_gallery.py asks for all of them)
    known = {name: one for name, one in examples.every().items() if name in made}
    thumbs = docs / "gallery" / "thumbs"
    thumbs.mkdir(exist_ok=True)
    for name in known:
        _thumb(docs / "gallery" / "pictures" / f"{name}.png", thumbs / f"{name}.webp")
    pages = {f"{name}.md": _page(one, made[name]) for name, one in known.items()}
    keep(docs / "gallery", {"index.md": _sheet(known), **pages})
    (docs / "gallery" / "sheet.txt").write_text("\n".join(sheet(known, "/gallery/", "###")))
    (docs / "review" / "index.md").write_text(
        _review(json.loads((docs / "review" / "made.json").read_text()))
    )
    _notebooks(docs)


def _thumb(picture, thumb):
    if not thumb.exists() or thumb.stat().st_mtime < picture.stat().st_mtime:
        image = Image.open(picture).convert("RGB")
        image.thumbnail(THUMB)
        image.save(thumb, quality=60, method=6)


def sheet(known: dict, root: str = "", mark: str = "##") -> list[str]:
    """The contact sheet: a card with a thumbnail for each example, by parts."""
    lines = []
    for part in PARTS:
        inside = [one for one in known.values() if one.part == part]
        if not inside:
            continue
        lines += [f"{mark} {part}", "", "::::{grid} 2 3 4 4", ":gutter: 2", ""]
        for one in inside:
            lines += [
                f":::{{grid-item-card}} {one.title}",
                f":link: {root}{one.name}",
                ":link-type: doc",
                f":img-top: {root}thumbs/{one.name}.webp",
                f":img-alt: {one.title}",
                ":class-card: thumb",
                ":::",
                "",
            ]
        lines += ["::::", ""]
    return lines


def _sheet(known):
    head = [
        "# Gallery",
        "",
        f"Every system that the review *Dynamics of Nonlinear Lattices* names, each in at most "
        f"{examples.MOST_LINES} lines: {len(known)} scripts,",
        "each with a picture and one number beside its source.",
        "",
        "```{toctree}",
        ":hidden:",
        *known,
        "```",
        "",
    ]
    return "\n".join(head + sheet(known))


def _page(one, made):
    return "\n".join(
        [
            f"# {one.title}",
            "",
            one.words,
            "",
            f"```{{image}} pictures/{one.name}.png",
            f":alt: {one.title}",
            "```",
            "",
            "```{list-table}",
            f"* - {one.number}",
            f"  - {made['number']:.10g}",
            "* - expected",
            f"  - {one.expected:.10g}, within {one.within:.2g}",
            "* - source",
            f"  - {one.source}",
            "* - time",
            f"  - {made['seconds']:.0f} s on one core, compiling included",
            "* - systems",
            f"  - {', '.join(one.systems)}",
            "```",
            "",
            f"```{{literalinclude}} {one.name}.py",
            ":language: python",
            f":lines: {_begin(one)}-",
            "```",
            "",
        ]
    )


def _begin(one):
    """The first line of an example's file after its docstring."""
    text = (HERE / "gallery" / f"{one.name}.py").read_text()
    head = text[: text.index('"""', 3)]
    return head.count("\n") + 2


def _review(made):
    """The scripts of the review's figures, with their pictures and numbers."""
    lines = [
        "# The review's figures",
        "",
        "The sixteen figures of *Dynamics of Nonlinear Lattices* (C. Chong and P. G. Kevrekidis), each",
        "computed anew by a script of its own, with its numbers beside what is expected of them.",
        "`python docs/review/fig2_2.py` makes one, `python docs/review/all.py` all of them, and with",
        "`--check` it only compares the numbers.",
        "",
        "```{contents}",
        ":local:",
        ":depth: 1",
        "```",
        "",
    ]
    for name, rows in made.items():
        code = (HERE / "review" / f"{name}.py").read_text()
        title, _, words = ast.get_docstring(ast.parse(code)).partition(".\n\n")
        lines += [
            f"## {title}",
            "",
            words,
            "",
            f"```{{image}} {name}.webp",
            f":alt: {title}",
            "```",
            "",
        ]
        lines += ["| | computed | expected | within |", "|---|---|---|---|"]
        lines += ["| {} | {:.10g} | {:.10g} | {:.2g} |".format(*row) for row in rows]
        lines += [
            "",
            f":::{{dropdown}} {name}.py",
            f"```{{literalinclude}} {name}.py",
            "```",
            ":::",
            "",
        ]
    return "\n".join(lines)


def _notebooks(docs):
    """Copies of the notebooks with their stored outputs, and a page that lists them."""
    folder = docs / "notebooks"
    folder.mkdir(exist_ok=True)
    names = []
    for path in sorted((docs.parent / "notebooks").iterdir()):
        if path.suffix == ".ipynb":
            names.append(path.stem)
        copy = folder / path.name
        if not copy.exists() or copy.read_bytes() != path.read_bytes():
            shutil.copy(path, copy)
    for old in folder.glob("*.ipynb"):
        if old.stem not in names:
            old.unlink()
    page = [
        "# Notebooks",
        "",
        "One published result each, with its number; shown as they ran.",
        "",
        "```{toctree}",
        ":maxdepth: 1",
        *names,
        "```",
        "",
    ]
    (folder / "index.md").write_text("\n".join(page))
