"""Devices of the gallery: what their scripts leave, beside other methods and further numbers."""

import jax
import jax.numpy as jnp
import numpy as np
from gallery import left_by
from numpy.testing import assert_allclose
from pytest import mark

import granjax as gx

DAMPING = 1 / 1.75e-3


def linear_gain(chain, omega):
    """Force on the far wall over the displacement of the near one: k_0 (K - omega^2 M + i omega C)^{-1}_{1N} k_N."""
    law = chain.terms[0].law
    m = np.asarray(chain.mass)
    k = 1.5 * np.asarray(law.stiffness) ** (2 / 3) * np.asarray(law.precompression) ** (1 / 3)
    D = np.diag(k[:-1] + k[1:] - omega**2 * m + 1j * omega * DAMPING * m)
    D = D - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    return abs(k[0] * np.linalg.inv(D)[0, -1] * k[-1])


@mark.slow
def test_left_is_right_at_small_amplitude():
    """The rectifier's chain of six beads; beyond, the difference grows as the square of the amplitude."""
    chain = gx.scenes.beads("steel 316", np.array([9.53e-3, 7e-3] + 4 * [9.53e-3]), 8.0)
    modes = np.asarray(gx.linear.normal_modes(chain).omega)

    def passed(omega, end, amplitude, steps=96):
        """The amplitude at omega of the force on the wall at rest."""
        lattice = gx.driven.driven_chain(chain, amplitude, omega, ends=end, damping=DAMPING)
        run = gx.forced.forced_orbit(lattice, 2 * np.pi / omega, steps=steps).run(64)
        wall = {"left": 2, "right": 1}[end]
        force = gx.measures.along(gx.measures.contact_force, lattice, run, bond=wall)
        return 2 * abs(np.fft.fft(np.ravel(force))[1]) / 64

    # in the band, and in the gap just below the defect's mode
    for omega in (float(modes[2]), 0.98 * float(modes[-1])):
        left, right = (
            np.array([passed(omega, end, a) for a in (1e-11, 1e-10, 1e-9)])
            for end in ("left", "right")
        )
        asymmetry = left / right - 1
        error = abs(left[2] / passed(omega, "left", 1e-9, 192) - 1)
        assert abs(asymmetry[0]) < 1e-8 and abs(asymmetry[2]) > 1e3 * error
        assert_allclose(asymmetry[2], 100 * asymmetry[1], rtol=0.1)
        assert_allclose(left[0], 1e-11 * linear_gain(chain, omega), rtol=1e-7)


class Cubic(gx.Law):
    """F(e) = k e + c e^2 + d e^3, a law of the user's own, in SI."""

    k: jax.Array
    c: jax.Array
    d: jax.Array

    def force(self, e):
        return e * (self.k + e * (self.c + e * self.d))

    def energy(self, e):
        return e * e * (self.k / 2 + e * (self.c / 3 + e * self.d / 4))


@mark.slow
def test_gates_work_at_first_order_in_either_signal_and_of_a_law_of_ones_own():
    """The contact's Taylor series carries the difference too, and is at work where the law is no contact."""
    device = left_by("gates")
    steel = device.steel
    output = device.output
    # proportional to either, and to the control of a switch, then more than that
    _, half, _ = device.outputs(steel, np.array([[0.05e-6, 0.1e-6]]), device.gap[None])
    assert_allclose(half[0], output[3] / 2, rtol=0.1)
    on = output[device.on]
    assert_allclose(on[2] / on[1], 2, rtol=0.05)
    assert on[8] > 2.2 * on[4] and device.error[3] < 0.01 * output[3]
    own = Cubic(*map(jnp.asarray, gx.laws.taylor(steel.terms[0].law)))
    own = gx.Lattice(steel.mass, gx.Bond(gx.Shift(1, "fixed"), own), units="SI")
    omegas = np.tile(device.gap, (4, 1))
    (_, found, error), (_, hertz, _) = (
        device.outputs(chain, 2e-8 * device.rows, omegas) for chain in (own, steel)
    )
    assert (found - error)[3] > (found + error)[:3].max()
    assert abs(found[3] - hertz[3]) < 0.01 * hertz[3]


@mark.slow
def test_a_dark_breather_strains_its_middle_least_and_other_phases_make_an_antinode():
    device = left_by("driven_dark_breather")
    wall = 0.2e-6 * np.cos(2 * np.pi * 7290 * np.asarray(device.dark.ts))[:, None]
    strain = np.abs(np.diff(np.concatenate([wall, device.u, -wall], 1), axis=1)).max(0)
    assert np.argmin(strain) in (10, 11) and strain.max() < 0.55e-6
    found = device.settled(0.05e-6, (0.0, 0.0))
    speed = np.asarray(found.amplitude)
    background = speed[np.abs(np.arange(21) - 10) > 5].mean()
    assert found.multiple == 1 and abs(1 - speed[10] / background + 0.455) < 0.01
    assert np.argmax(speed[10:] > background / 2) == 0
