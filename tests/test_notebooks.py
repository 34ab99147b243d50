"""Every notebook runs, in its own kernel, and its closing check holds; kernels find what was compiled before.

The first ones that a reader opens run always, the others as a study (`pytest -m study tests/test_notebooks.py`).
"""

import os
from pathlib import Path

import jax
import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
ALWAYS = {"first_steps", "vibrometer", "breather_at_frequency"}


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(
            path, id=path.stem, marks=pytest.mark.slow if path.stem in ALWAYS else pytest.mark.study
        )
        for path in NOTEBOOKS
    ],
)
def test_notebook(path):
    notebook = nbformat.read(path, as_version=4)
    assert len(notebook.cells) < 25
    assert "assert" in notebook.cells[-1].source
    kept = {"JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir or ""}
    kept |= {
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_TRACEBACK_IN_LOCATIONS_LIMIT": "0",
    }
    NotebookClient(notebook, timeout=300, kernel_name="python3").execute(env=os.environ | kept)
