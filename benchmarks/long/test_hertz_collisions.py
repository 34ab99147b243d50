"""Waves of a sonic vacuum that shed for long: collisions followed for as long as `collide` goes."""

import numpy as np

from granjax.laws import Hertz
from granjax.travelling import collide, solitary_wave


def test_what_has_not_parted_has_no_shift():
    """What two Hertz waves shed stays about them for long; the fits of a short run say so."""
    one, two = (solitary_wave(Hertz(), speed=c) for c in (1.0, -1.1))
    found = collide(one, two)
    assert (np.isnan(found.shifts) | (found.shift_errors < 1e-4)).all()
