"""The first notebooks that a reader opens run, each in its own kernel, and their closing checks hold.

`pytest benchmarks/long` runs the others.
"""

import os
from pathlib import Path

import jax
import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[1] / "notebooks"
FIRST = ("first_steps", "vibrometer", "breather_at_frequency")


def run(path):
    """Run a notebook, which ends with a check; its kernel finds what was compiled before."""
    notebook = nbformat.read(path, as_version=4)
    assert len(notebook.cells) < 25
    assert "assert" in notebook.cells[-1].source
    kept = {
        "JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir or "",
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_TRACEBACK_IN_LOCATIONS_LIMIT": "0",
    }
    NotebookClient(notebook, timeout=300, kernel_name="python3").execute(env=os.environ | kept)


@pytest.mark.slow
@pytest.mark.parametrize("name", FIRST)
def test_notebook(name):
    run(FOLDER / f"{name}.ipynb")
