"""Pictures of kinks show the numbers of their results, with units."""

import numpy as np
import pytest

import granjax as gx
from granjax import plots


def labels(ax):
    return ax.get_xlabel(), ax.get_ylabel()


@pytest.fixture(scope="module")
def kinks():
    chain = gx.scenes.sine_gordon(24, 0.5)
    return gx.kinks.kink(chain, 2 * np.pi), gx.kinks.peierls_nabarro(chain, 2 * np.pi)


@pytest.mark.slow
def test_a_kink_with_its_frequencies_or_its_barrier(kinks):
    found, barrier = kinks
    profile, modes = plots.kink(found)
    np.testing.assert_array_equal(profile.lines[0].get_ydata(), found.state.u)
    assert labels(profile) == ("site $n$", "displacement $u_n$ (scaled)")
    assert profile.get_title(loc="left") == f"stable, energy {float(found.energy):.5g}"
    np.testing.assert_array_equal(modes.lines[0].get_ydata(), found.omega)
    _, wells = plots.kink(found, barrier=barrier)
    site, bond = (container[0].get_ydata()[0] for container in wells.containers)
    assert (site, bond) == pytest.approx((float(barrier.barrier), 0.0))
    assert labels(wells) == ("centre of the kink (sites)", "energy above the lower kink (scaled)")
