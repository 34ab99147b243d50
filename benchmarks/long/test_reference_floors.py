"""References of `gx.work_precision` against references in extended precision, by hand: pytest benchmarks/long.

That of the impact fails today: its floor is 5.5e-11, and 5e-11 is asked.
"""

import pytest
import scenes

from granjax.work_precision import distance, find_reference


@pytest.mark.parametrize("name", ["impact", "driven"])
def test_the_floor_is_above_the_error_of_the_reference(name):
    scene = scenes.scene(name)
    end, floor, _ = find_reference(scene.lattice, scene.state, scene.t0, scene.t1)
    assert distance(end, scene.reference) < 2 * floor < 1e-10
