"""What is printed as code runs: every block of the README, in the order of the page, and of all docstrings."""

import ast
import contextlib
import io
import re
import textwrap
from pathlib import Path

import pytest

import granjax as gx

ROOT = Path(__file__).parents[1]
README = re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(), re.M | re.S)
FIT = next(block for block in README if "gx.fit(" in block)
BUILDERS = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def indented(docstring):
    """Blocks of a docstring that are set in."""
    block = []
    for line in [*docstring.splitlines(), "."]:
        if line.startswith("    ") or block and not line.strip():
            block.append(line)
        elif block:
            yield textwrap.dedent("\n".join(block)).strip() + "\n"
            block = []


def is_code(block):
    """Whether a block is Python that calls or imports something: tables, lists and equations are none."""
    try:
        nodes = [*ast.walk(ast.parse(block))]
    except SyntaxError:
        return "gx." in block
    return any(isinstance(node, (ast.Call, ast.Import, ast.ImportFrom)) for node in nodes)


def builders(node):
    """What may have a docstring, at any depth; expressions, most of a tree, are not looked into."""
    if isinstance(node, BUILDERS):
        yield node
    for name in ("body", "orelse", "handlers", "finalbody", "cases"):
        for inner in getattr(node, name, ()):
            yield from builders(inner)


def docstrings():
    """(where, block) of every block of code in a docstring."""
    for path in sorted((ROOT / "granjax").rglob("*.py")):
        for node in builders(ast.parse(path.read_text())):
            for block in indented(ast.get_docstring(node) or ""):
                if is_code(block):
                    yield f"{path.relative_to(ROOT)}: {getattr(node, 'name', 'module')}", block


DOCSTRINGS = list(docstrings())


def run(blocks, **names):
    """What the blocks leave and print, one after the other, where nothing is known but `names`."""
    space = {**names}
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        for block in blocks:
            exec(compile(block, "<a document>", "exec"), space)
    return space, printed.getvalue()


def test_the_pages_have_blocks_and_docstrings_too():
    assert len(README) >= 5 and "gx.Traces(" in FIT and len(dict(DOCSTRINGS)) >= 2
    page = (ROOT / "README.md").read_text()
    assert page.count("```") == 2 * len(README), "a block of the README without a language"


def fit_is_that_of_the_file(fit, printed):
    """The README's fit of the traces that are shipped finds what they were made with."""
    assert fit.converged and not fit.undetermined and 0.8 < fit.reduced_chi_square < 1.2
    truth = {"stiffness": 9.1e9, "precompression": 8.4, "damping_time": 1.8e-3, "velocity": 0.05}
    assert all(
        abs(fit.parameters[name] - x) < 4 * fit.deviations[name] for name, x in truth.items()
    )
    assert "stiffness" in printed and "+-" in printed


@pytest.mark.slow
def test_the_readme_runs_from_top_to_bottom(elsewhere):
    space, printed = run(README[:-1])
    fit_is_that_of_the_file(space["fit"], printed)
    assert (elsewhere / "dimer.png").stat().st_size > 1e4 and space["run"].completed
    assert space["branch"].verdict[0] == "stable" and "multiplier" in printed


@pytest.mark.slow
def test_the_last_block_of_the_readme_runs_many_solvers_at_many_steps(elsewhere, optimised):
    assert "For 1e-06" in run(README[-1:], gx=gx)[1]


@pytest.mark.parametrize(
    "where, block",
    [
        # the face's is in the fast set
        pytest.param(*found, marks=[pytest.mark.slow] * ("granjax/__init__" not in found[0]))
        for found in DOCSTRINGS
    ],
    ids=lambda x: x if ": " in x and "\n" not in x else "",
)
def test_a_docstring_s_block_runs(where, block, elsewhere):
    space, printed = run([block], gx=gx)
    assert len(space) > 2 or printed
