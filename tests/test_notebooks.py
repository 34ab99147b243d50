"""Every notebook runs, in its own kernel, and its closing check holds."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook(path):
    notebook = nbformat.read(path, as_version=4)
    assert len(notebook.cells) < 25
    assert "assert" in notebook.cells[-1].source
    NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
