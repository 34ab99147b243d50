"""Maps of shocks in chains of a million sites: the memory of the map and of one state."""

import subprocess
import sys

import pytest

MILLION = """
from pathlib import Path
import granjax as gx
chain = gx.scenes.monomer(10**6, precompression=1.0)
problem = gx.shocks.{problem}
assert gx.shocks.space_time(problem, 0.6, 3, 1000).strain.shape == (3, 1000)
# of this process alone: what it was started from does not count
told = Path("/proc/self/status").read_text()
print(int(told.split("VmHWM:")[1].split()[0]) / 1e6)
"""


@pytest.mark.parametrize("problem", ["velocity_shock(chain, 0.3)", "step(chain, 0.5, 0.1)"])
def test_a_million_sites_need_less_than_two_gigabytes(problem):
    script = MILLION.format(problem=problem)
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert float(found.stdout) < 2
