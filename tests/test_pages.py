"""The pages of docs/: their blocks run, from top to bottom of each; their names and links exist."""

import contextlib
import io
import re
from pathlib import Path

import public
import pytest

import granjax as gx

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [
    *(
        DOCS / f"{name}.md"
        for name in ("start", "methods", "matlab", "compare", "formulas", "cite")
    ),
    *sorted((DOCS / "concepts").glob("*.md")),
    *sorted((DOCS / "how-to").glob("*.md")),
]
IDS = [str(page.relative_to(DOCS).with_suffix("")) for page in PAGES]
FENCE = re.compile(r"^```(\S*)[^\n]*\n(.*?)^```$", re.M | re.S)
# of what a reader runs, and of what only shows
LANGUAGES = {"python", "text", "toml", "matlab", "bibtex", "{toctree}"}

NAMES = {f"{page}.{name}" for page, name, _ in public.objects(gx)}


def blocks(page):
    return [code for language, code in FENCE.findall(page.read_text()) if language == "python"]


@pytest.mark.site
@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if blocks(page)],
    ids=[name for page, name in zip(PAGES, IDS) if blocks(page)],
)
def test_a_page_runs_from_top_to_bottom(page, elsewhere):
    space = {}
    with contextlib.redirect_stdout(io.StringIO()):
        for number, block in enumerate(blocks(page), 1):
            exec(compile(block, f"{page.name}, block {number}", "exec"), space)


def test_there_are_pages():
    assert len(PAGES) > 25 and sum(map(len, map(blocks, PAGES))) > 60 and len(NAMES) > 450


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_names_and_links_of_a_page_exist(page):
    text = page.read_text()
    assert re.match(r"# [^\n]+\n\n[A-Z][^#`|]+[.:]\s", text), "a title, and then a sentence"
    assert {language for language, _ in FENCE.findall(text)} <= LANGUAGES
    assert text.count("```") == 2 * len(FENCE.findall(text))
    unknown = set(re.findall(r"{py:\w+}`([^`]+)`", text)) - NAMES
    assert not unknown
    for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", FENCE.sub("", text)):
        assert (page.parent / target).exists(), target


@pytest.mark.parametrize("folder", ["concepts", "how-to"])
def test_a_folder_s_index_names_its_pages(folder):
    lists = re.findall(
        r"```{toctree}\n(?::[^\n]*\n)*\n(.*?)```", (DOCS / folder / "index.md").read_text(), re.S
    )
    assert sorted([*" ".join(lists).split(), "index"]) == sorted(
        page.stem for page in (DOCS / folder).glob("*.md")
    )
