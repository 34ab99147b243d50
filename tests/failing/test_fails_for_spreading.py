"""An exponent of spreading energy that is fitted before it has converged: a small standard error, and wrong."""

import numpy as np
import pytest

import granjax as gx

SITES, T1 = 260, 100.0


def chain(seed):
    return gx.scenes.disordered(SITES, 0.3, seed, law=gx.Linear, distribution="binary")


@pytest.mark.slow
def test_an_exponent_fitted_before_it_has_converged():
    """Weak disorder, of which early waves know nothing yet: a line through logarithms looks perfect, and is not 3/2."""
    found = gx.studies.spreading(chain, T1, samples=64, step=0.5, frames=24, chunk=32, progress=False)
    early = found.times <= T1 / 2
    log_t, log_m = np.log(found.times[early]), np.log(found.moment[early])
    (naive, _), (residual,) = np.polyfit(log_t, log_m, 1, full=True)[:2]
    # correlation of the logarithms, and what the scatter of the samples says of the slope
    assert 1 - residual / ((log_m - log_m.mean()) ** 2).sum() > 0.999 and naive > 1.75
    assert found.exponent.error < 0.01 < abs(found.exponent.value - 1.5) / 10
    # the slope still falls, and the result says so, in every window
    assert found.verdict == "drifting" and found.exponent.drift < -0.1
    assert "has NOT converged" in found.outcome and "drifts" in found.outcome
    assert found.within((T1 / 4, T1)).verdict != "converged"
    assert found.local_exponent[-1] < found.local_exponent[12] - 0.05
