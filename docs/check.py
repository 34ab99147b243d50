"""What the built site has to hold: `python docs/check.py docs/_build/html`.

No link within it is dead, no page with all that it loads is above 2 MB, every public name is in the reference, every
system of the review is in the gallery, and the pages ask nothing of another host while they load.
"""

import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent / "gallery")]

import examples  # noqa: E402
import public  # noqa: E402
from sphinx.util.inventory import InventoryFile  # noqa: E402

import granjax as gx  # noqa: E402

# of 2 MB the letters of icons, which a style sheet asks for, are the rest
MOST = 2_000_000 - 115_000
LOADED = {("img", "src"), ("script", "src"), ("source", "src"), ("link", "href")}


class Page(HTMLParser):
    """Identifiers and links of a page."""

    def __init__(self, path: Path):
        super().__init__()
        self.path, self.names, self.links, self.loaded = path, set(), [], []
        self.feed(path.read_text())

    def handle_starttag(self, tag, attrs):
        """Collect one tag's identifiers and links."""
        found = dict(attrs)
        self.names |= {found[key] for key in ("id", "name") if found.get(key)}
        for key in ("href", "src"):
            if found.get(key):
                self.links.append(found[key])
                if (tag, key) in LOADED and found.get("rel") not in (
                    "search",
                    "next",
                    "prev",
                    "index",
                    "author",
                ):
                    self.loaded.append(found[key])


def problems(site: Path) -> list[str]:
    """What is wrong with a built site, a line each."""
    pages = {
        path.resolve(): Page(path) for path in site.rglob("*.html") if "_static" not in path.parts
    }
    wrong = []
    for path, page in pages.items():
        where = path.relative_to(site.resolve())
        for link in dict.fromkeys(page.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists():
                wrong.append(f"{where}: no file for {link}")
            elif (
                parts.fragment
                and target in pages
                and unquote(parts.fragment) not in pages[target].names
            ):
                wrong.append(f"{where}: nothing is called {link}")
        own = path.stat().st_size
        for link in dict.fromkeys(page.loaded):
            parts = urlsplit(link)
            if parts.netloc:
                wrong.append(f"{where}: loads {link}")
            elif parts.path:
                file = (path.parent / unquote(parts.path)).resolve()
                own += file.stat().st_size if file.is_file() else 0
        if own > MOST:
            wrong.append(f"{where}: {own / 1e6:.1f} MB with what it loads")
    with (site / "objects.inv").open("rb") as f:
        known = InventoryFile.load(f, "", lambda base, uri: uri)
    listed = {name for kind, names in known.items() if kind.startswith("py:") for name in names}
    wrong += [
        f"{page}.{name} is not in the reference"
        for page, name, _ in public.objects(gx)
        if f"{page}.{name}" not in listed
    ]
    made = json.loads(examples.MADE.read_text())
    wrong += [
        f"{name} of the gallery has no page"
        for name in made
        if not (site / "gallery" / f"{name}.html").exists()
    ]
    shown = " ".join((site / "gallery" / f"{name}.html").read_text() for name in made)
    words = re.sub(r"&#x27;|’", "'", shown)
    return wrong + [
        f"{system} is not in the gallery" for system in examples.systems() if system not in words
    ]


if __name__ == "__main__":
    found = problems(Path(sys.argv[1]))
    print("\n".join(found) or "The site is whole.")
    sys.exit(bool(found))
