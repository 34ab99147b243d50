"""The gallery of the site: every system of the review has an example, and each example's number is what is expected."""

import json
from pathlib import Path

import examples
import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "gallery"

EXAMPLES = examples.every()
SYSTEMS = set(examples.systems())
# examples that compute for longer than their programs take to be optimised
LONG = ("equipartition", "renormalised", "thermal_sound")


def test_every_system_of_the_review_has_an_example():
    shown = {system for one in EXAMPLES.values() for system in one.systems}
    assert len(SYSTEMS) > 60
    assert shown == SYSTEMS


def test_examples_are_short_and_have_a_picture_and_a_number_that_is_stored():
    made = json.loads((FOLDER / "made.json").read_text())
    assert made.keys() == EXAMPLES.keys() == {path.stem for path in (FOLDER / "pictures").iterdir()}
    for name, one in EXAMPLES.items():
        assert one.lines <= examples.MOST_LINES, name
        assert one.agrees(made[name]["number"]), name
        assert one.source and 0 < one.within < max(abs(one.expected), 1.0), name


@pytest.mark.site
@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_gives_its_number(name, tmp_path, monkeypatch, request):
    monkeypatch.chdir(tmp_path)
    if name in LONG:
        request.getfixturevalue("optimised")
    space = EXAMPLES[name].run()
    assert EXAMPLES[name].agrees(float(space["number"]))
    figure = getattr(space["ax"], "figure", space["ax"])
    assert figure.axes and any(ax.has_data() for ax in figure.axes)
