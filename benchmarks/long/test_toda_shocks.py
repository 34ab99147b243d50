"""A dispersive shock of Toda's chain comes to Whitham's theory like 1/t."""

import numpy as np
from test_shocks import piston, theory_of

import granjax as gx


def test_toda_shocks_converge_to_the_theory():
    c = 0.5
    theory = theory_of(0.5)
    problem = piston(gx.Toda(), c, int(2000 * theory.leading_speed) + 80)
    early, late = (gx.shocks.measure(problem.run(t)) for t in (500.0, 2000.0))
    assert np.all(np.abs(late.speeds_of_m - late.s) < 2e-3)
    for shock in (early, late):
        assert abs(shock.trailing_speed - theory.trailing_speed) < shock.trailing_speed_error
    known = np.asarray(gx.theory.toda.modulation(gx.theory.toda.modulus(late.s, c), c).phase)
    assert np.abs(np.angle(np.exp(1j * (late.phases - known))))[1:].max() < 0.03
    # the leading crest rises to s_+; what remains of the core after the fit of the phase falls like 1/t
    left = [theory.leading_speed - x.leading_speed for x in (early, late)]
    assert 0 < left[1] < left[0] / 3
    rest = [x.theory_errors[2:8].mean() for x in (early, late)]
    assert abs(np.log(rest[0] / rest[1]) / np.log(4) - 1) < 0.25
