"""Devices: what passes both ways, logic gates, a switch."""

import numpy as np
import pytest

import granjax as gx

DAMPING = 1 / 1.75e-3


def with_defect(sites=6):
    radii = np.full(sites, 9.53e-3)
    radii[1] = 7e-3
    return gx.scenes.beads("steel 316", radii, 8.0)


@pytest.mark.slow
def test_left_is_right_at_small_amplitude():
    chain = with_defect()
    modes = np.asarray(gx.linear.normal_modes(chain).omega)
    # in the band, and in the gap just below the defect's mode; the steps are common, so one program does both
    for omega in (float(modes[2]), 0.98 * float(modes[-1])):
        found = gx.studies.two_way(chain, [1e-11, 1e-10, 1e-9], omega, damping=DAMPING, steps=96)
        assert abs(found.asymmetry[0]) < 1e-8 and found.asymmetry_error[0] < 1e-8
        # beyond, the difference grows as the square of the amplitude, and is known
        assert abs(found.asymmetry[2]) > 1e3 * found.asymmetry_error[2]
        assert found.asymmetry[2] == pytest.approx(100 * found.asymmetry[1], rel=0.1)
        assert found.from_left[0] == pytest.approx(1e-11 * linear_gain(chain, omega), rel=1e-7)


def linear_gain(chain, omega):
    """Force on the far wall over the displacement of the near one: k_0 (K - omega^2 M + i omega C)^{-1}_{1N} k_N."""
    law, m = chain.terms[0].law, np.asarray(chain.mass)
    k = 1.5 * np.asarray(law.stiffness) ** (2 / 3) * np.asarray(law.precompression) ** (1 / 3)
    D = np.diag(k[:-1] + k[1:] - omega**2 * m + 1j * omega * DAMPING * m)
    D = D - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    return abs(k[0] * np.linalg.inv(D)[0, -1] * k[-1])


def test_two_way_refuses_what_it_cannot_follow():
    chain = with_defect()
    with pytest.raises(ValueError, match="ascending"):
        gx.studies.two_way(chain, [2e-9, 1e-9], 1e4)
    with pytest.raises(ValueError, match="fixed"):
        gx.studies.two_way(gx.scenes.monomer(6, boundary="free"), [1e-3], 1.0)


@pytest.mark.slow
def test_gates_and_a_switch():
    chain = gx.scenes.beads("steel 316", np.full(10, 9.53e-3), 8.0)
    cutoff = float(gx.linear.normal_modes(chain).omega[-1])
    common = {"damping": DAMPING, "settling": 20e-3, "watch": 20e-3}
    # in the gap neither signal passes, their difference does; in the band each does, and both more
    gap = gx.studies.truth_table(chain, [0.1e-6, 0.1e-6], cutoff * np.array([1.5, 1.1]), **common)
    band = gx.studies.truth_table(chain, [0.05e-6, 0.05e-6], cutoff * np.array([0.4, 0.7]), **common)
    low, high = gap.thresholds("AND")
    assert gap.inputs.tolist() == [[0, 0], [0, 1], [1, 0], [1, 1]] and high > 40 * low
    assert gap.table((low * high) ** 0.5).tolist() == [0, 0, 0, 1] and gap.thresholds("XOR") is None
    assert band.thresholds("OR")[1] > 5e-4 and band.table(1e-4).tolist() == [0, 1, 1, 1]
    assert gap.output[3] == pytest.approx(8.5774e-5, rel=0.01)
    # what the difference carries is proportional to either
    half = gx.studies.truth_table(chain, [0.05e-6, 0.1e-6], cutoff * np.array([1.5, 1.1]), **common)
    assert half.output[3] == pytest.approx(gap.output[3] / 2, rel=0.1)
    with pytest.raises(ValueError, match="threshold"):
        gap.table(gap.output[3])
    with pytest.raises(ValueError, match="omegas"):
        gx.studies.truth_table(chain, [1e-7, 1e-7], cutoff, **common)
