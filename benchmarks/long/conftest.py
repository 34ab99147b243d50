"""Checks that take minutes, run by hand before a release: `pytest benchmarks/long`.

They use the tests' own helpers. Programs are compiled as a user's are.
"""

import sys
from pathlib import Path

import pytest

import granjax  # noqa: F401

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT / folder) for folder in ("tests", "benchmarks", "docs/gallery", "docs")]


@pytest.fixture
def optimised():
    """Nothing: tests ask for it where programs must be optimised, as they are here."""
