"""The notebooks that CI does not run: each runs in its own kernel, and its closing check holds."""

import pytest
from test_notebooks import FIRST, FOLDER, run

OTHERS = sorted(path.stem for path in FOLDER.glob("*.ipynb") if path.stem not in FIRST)


@pytest.mark.parametrize("name", OTHERS)
def test_notebook(name):
    run(FOLDER / f"{name}.ipynb")
