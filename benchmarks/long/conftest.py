"""Checks that take minutes, run by hand before a release: `pytest benchmarks/long`.

They use the tests' own helpers.
"""

import sys
from pathlib import Path

import granjax  # noqa: F401

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT / folder) for folder in ("tests", "benchmarks", "docs/gallery", "docs")]
