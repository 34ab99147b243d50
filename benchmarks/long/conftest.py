"""Checks that take minutes, run by hand before a release: `pytest benchmarks/long`.

They use the tests' own helpers.
"""

import sys
from pathlib import Path

import granjax  # noqa: F401

sys.path.append(str(Path(__file__).parents[2] / "tests"))
