"""An exponent of spreading energy that is fitted before it has converged: a small standard error, and wrong."""

import numpy as np
import pytest
from gallery import left_by

import granjax as gx

SITES, T1 = 260, 100.0


def chain(seed):
    return gx.scenes.disordered(SITES, 0.3, seed, law=gx.Linear, distribution="binary")


@pytest.mark.slow
def test_an_exponent_fitted_before_it_has_converged():
    """Weak disorder, of which early waves know nothing yet: a line through logarithms looks perfect, and is not 3/2."""
    device, times = left_by("superdiffusion"), T1 * np.geomspace(1 / 64, 1, 24)
    found = device.moments(chain, np.arange(64), times, 0.5, chunk=32)
    early, moment = times <= T1 / 2, found.mean(0)
    log_t, log_m = np.log(times[early]), np.log(moment[early])
    (naive, _), (residual,) = np.polyfit(log_t, log_m, 1, full=True)[:2]
    # correlation of the logarithms, and what the scatter of the samples says of the slope
    assert 1 - residual / ((log_m - log_m.mean()) ** 2).sum() > 0.999 and naive > 1.75
    value, error = device.fitted(device.slope, times, found, (T1 / 8, T1))
    assert error < 0.01 < abs(value - 1.5) / 10
    # the slope still falls, and its change says so, in every window
    change, uncertain = device.fitted(device.drift, times, found, (T1 / 8, T1))
    assert abs(change) - 2 * uncertain > 0.075 and change < -0.1
    change, uncertain = device.fitted(device.drift, times, found, (T1 / 4, T1))
    assert abs(change) + 2 * uncertain > 0.075
    local = np.gradient(np.log(moment), np.log(times))
    assert local[-4:].mean() < local[9:16].mean() - 0.05
