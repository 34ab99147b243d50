"""Devices: what passes both ways, logic gates, a switch."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import granjax as gx

DAMPING = 1 / 1.75e-3


def with_defect(sites=6):
    radii = np.full(sites, 9.53e-3)
    radii[1] = 7e-3
    return gx.scenes.beads("steel 316", radii, 8.0)


@pytest.mark.study
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


TIMES = {"settling": 20e-3, "watch": 20e-3}


def steel():
    chain = gx.scenes.beads("steel 316", np.full(10, 9.53e-3), 8.0)
    return chain, float(gx.linear.normal_modes(chain).omega[-1])


@pytest.mark.slow
def test_gates():
    chain, cutoff = steel()
    common = {"damping": DAMPING, **TIMES}
    # in the gap neither signal passes, their difference does; in the band each does, and both more
    gap = gx.studies.truth_table(chain, [0.1e-6, 0.1e-6], cutoff * np.array([1.5, 1.1]), **common)
    band = gx.studies.truth_table(chain, [0.05e-6, 0.05e-6], cutoff * np.array([0.4, 0.7]), **common)
    low, high = gap.thresholds("AND")
    assert gap.inputs.tolist() == [[0, 0], [0, 1], [1, 0], [1, 1]] and high > 40 * low
    assert gap.table((low * high) ** 0.5).tolist() == [0, 0, 0, 1] and gap.thresholds("XOR") is None
    assert band.thresholds("OR")[1] > 5e-4 and band.table(1e-4).tolist() == [0, 1, 1, 1]
    assert "AND for a threshold between 1." in gap.outcome and gap.outcome.endswith(" m/s.")
    exact = by_scipy(chain, [0.1e-6, 0.1e-6], cutoff * np.array([1.5, 1.1]))
    assert abs(gap.output[3] - exact) < gap.output_error[3] < 0.01 * exact
    # what the difference carries is proportional to either
    half = gx.studies.truth_table(chain, [0.05e-6, 0.1e-6], cutoff * np.array([1.5, 1.1]), **common)
    assert half.output[3] == pytest.approx(gap.output[3] / 2, rel=0.1)
    with pytest.raises(ValueError, match="threshold"):
        gap.table(gap.output[3])
    with pytest.raises(ValueError, match="omegas"):
        gx.studies.truth_table(chain, [1e-7, 1e-7], cutoff, **common)


def by_scipy(chain, amplitudes, omegas):
    """Root mean square velocity of the last bead, by an integrator and forces of its own."""
    law, m = chain.terms[0].law, np.asarray(chain.mass)
    A, F0 = (np.broadcast_to(x, (len(m) + 1,)) for x in (law.stiffness, law.precompression))
    overlap = (F0 / A) ** (2 / 3)

    def rate(t, y):
        u, v = np.split(y, 2)
        wall = np.sum(amplitudes * np.sin(omegas * t))
        force = A * np.maximum(overlap - np.diff(u, prepend=wall, append=0.0), 0) ** 1.5
        return np.append(v, -np.diff(force) / m - DAMPING * v)

    begin, end = TIMES["settling"], TIMES["settling"] + TIMES["watch"]
    run = solve_ivp(rate, (0, end), np.zeros(2 * len(m)), method="DOP853", rtol=1e-9, atol=1e-13,
                    t_eval=np.linspace(begin, end, 8193))
    return np.sqrt(np.mean(run.y[-1, :-1] ** 2))


@pytest.mark.slow
def test_a_switch():
    chain, cutoff = steel()
    signal, controls = (0.1e-6, 1.5 * cutoff), np.linspace(0, 0.2e-6, 9)
    found = gx.studies.switch(chain, signal, controls, 1.1 * cutoff, damping=DAMPING, **TIMES)
    both = gx.studies.truth_table(chain, [0.1e-6, 0.1e-6], cutoff * np.array([1.5, 1.1]), damping=DAMPING, **TIMES)
    # as much as both signals of the gate give, next to nothing of it from the control alone
    assert found.output[4] == pytest.approx(both.output[3], rel=1e-12)
    assert (found.alone[1:] + found.alone_error[1:] < 0.04 * found.output[1:]).all()
    # the difference is proportional to the control at first, and more than that later
    assert found.output[2] / found.output[1] == pytest.approx(2, rel=0.05) and found.output[8] > 2.2 * found.output[4]
    # without a control nothing passes but its error, so that the contrast has a bound below alone
    assert found.contrast == pytest.approx(
        (found.output[8] - found.output_error[8]) / (found.output[0] + found.output_error[0]), rel=1e-12)
    assert 250 < found.contrast < found.output[8] / found.output[0] and "at least" in found.outcome
    # known to half of the controls' spacing, and so by controls twice as far apart
    low, high = found.threshold - found.threshold_error, found.threshold + found.threshold_error
    assert (low, high) == pytest.approx((1.0e-7, 1.25e-7), rel=1e-12)
    coarse = gx.studies.switch(chain, signal, controls[::2], 1.1 * cutoff, damping=DAMPING, **TIMES)
    assert abs(coarse.threshold - found.threshold) <= coarse.threshold_error + found.threshold_error
    # from a control on at which it is open there is no threshold
    open_ = gx.studies.switch(chain, signal, controls[6:], 1.1 * cutoff, damping=DAMPING, **TIMES)
    assert np.isnan(open_.threshold) and "from the first on" in open_.outcome
    with pytest.raises(ValueError, match="ascending"):
        gx.studies.switch(chain, signal, controls[::-1], 1.1 * cutoff, **TIMES)


class Cubic(gx.Law):
    """F(e) = k e + c e^2 + d e^3, a law of the user's own, in SI."""

    k: jax.Array
    c: jax.Array
    d: jax.Array

    def force(self, e):
        return e * (self.k + e * (self.c + e * self.d))

    def energy(self, e):
        return e * e * (self.k / 2 + e * (self.c / 3 + e * self.d / 4))


@pytest.mark.slow
def test_gates_of_a_law_of_ones_own():
    """The contact's Taylor series carries the difference too, and is at work where the law is no contact."""
    chain, cutoff = steel()
    k2, k3, k4 = (jnp.asarray(x) for x in gx.laws.taylor(chain.terms[0].law))
    own = gx.Lattice(chain.mass, gx.Bond(gx.Shift(1, "fixed"), Cubic(k2, k3, k4)), units="SI")
    omegas = cutoff * np.array([1.5, 1.1])
    found, hertz = (gx.studies.truth_table(c, [2e-8, 2e-8], omegas, damping=DAMPING, **TIMES) for c in (own, chain))
    assert found.units == "SI" and found.outcome.endswith("m/s.") and found.thresholds("AND")
    assert abs(found.output[3] - hertz.output[3]) < 0.01 * hertz.output[3]
