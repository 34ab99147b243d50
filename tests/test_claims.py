"""What the README and the docstrings say about speed and accuracy stands in the benchmarks' JSONs."""

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_every_claim_stands_where_it_should_and_follows_from_the_jsons():
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "claims.py"), "--check"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_there_are_claims_and_each_has_figures():
    claims = json.loads((ROOT / "benchmarks" / "claims.json").read_text())
    assert len(claims) > 5
    assert all(claim["figures"] and claim["source"] for claim in claims)
