"""Travelling waves against known values."""

import numpy as np
import pytest

import granjax as gx


def test_the_wave_is_the_known_fixed_point():
    x, phi, velocity = gx.travelling.hertz_wave()
    at = {place: int(np.flatnonzero(x == place)[0]) for place in (0, 0.5, 1, 1.5, 2, 3, 4)}
    # tent integral by Newton's method with quadruple quadrature, and by Fourier series; both agree to all digits
    known = {0: 1.48735937434940207, 0.5: 1.18075956495107221, 1: 0.583929165288747316, 1.5: 0.173535703605945646,
             2: 0.0290981220754717273, 3: 9.79950180919572e-5, 4: 6.98188008742393e-9}
    for place, value in known.items():
        assert phi[at[place]] == pytest.approx(value, abs=1e-14, rel=0)
    # a bead is fastest midway between the contacts' peaks
    assert velocity[at[0.5]] == velocity.max() == pytest.approx(1.62494411458652483, abs=1e-14)
    # total compression
    assert phi.sum() / 32 == pytest.approx(2.71360995307778758, abs=1e-13)
