"""The pages of docs/: their blocks run and print what is shown under them; their names and links exist."""

import json
import re
from pathlib import Path

import pages
import public
import pytest

import granjax as gx

DOCS = Path(__file__).parents[1] / "docs"
PAGES = [DOCS / f"{page}.md" for page in pages.PAGES]
FENCE = re.compile(r"^```(\S*)[^\n]*\n(.*?)^```$", re.M | re.S)
# of what a reader runs, and of what only shows
LANGUAGES = {"python", "text", "toml", "matlab", "bibtex", "{toctree}"}

NAMES = {f"{page}.{name}" for page, name, _ in public.objects(gx)}


@pytest.mark.site
@pytest.mark.parametrize("page", [page for page in pages.PAGES if pages.blocks(page)])
def test_a_page_runs_from_top_to_bottom_and_prints_what_it_shows(page, elsewhere):
    kept = json.loads(pages.KEPT.read_text()).get(page, [])
    for number, (said, figure) in enumerate(pages.run(page), 1):
        shown = kept[number - 1] if kept else ""
        assert pages.alike(shown, said), f"block {number} prints {said}"
        assert pages.picture(page, number).exists() == (figure is not None)


def test_there_are_pages():
    assert (
        len(PAGES) > 25
        and sum(len(pages.blocks(page)) for page in pages.PAGES) > 60
        and len(NAMES) > 450
    )


@pytest.mark.parametrize("page", PAGES, ids=pages.PAGES)
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
