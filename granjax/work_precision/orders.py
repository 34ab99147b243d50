"""Observed orders."""

import numpy as np

# where the error is small enough to fall as a power of the step, and far enough above the reference's own
ASYMPTOTIC, CLEAR = 1e-2, 10.0
LEAST_POINTS = 3


def observed_order(steps, errors, floor):
    r"""Slope of log(error) over log(step), by least squares, and its standard error.

    Only errors below 1e-2 and above ten floors count; where the error rises again towards the shortest steps, so that
    rounding has taken over, only those before, and above ten times the smallest.

    **Arguments:** `steps`, `errors` (P,); `floor`: uncertainty of the reference, or NaN.
    **Returns:** (order, standard error), NaN where fewer than three points are left.
    """
    along = np.argsort(steps)[::-1]
    steps, errors = np.asarray(steps)[along], np.asarray(errors)[along]
    keep = np.isfinite(errors) & (errors > 0) & (errors < ASYMPTOTIC)
    if np.isfinite(floor):
        keep &= errors > CLEAR * floor
    if keep.any():
        least = int(np.argmin(np.where(keep, errors, np.inf)))
        if keep[least + 1 :].any():
            keep &= (errors > CLEAR * errors[least]) & (np.arange(len(errors)) < least)
    if np.count_nonzero(keep) < LEAST_POINTS:
        return np.nan, np.nan
    x, y = np.log(steps[keep]), np.log(errors[keep])
    x = x - x.mean()
    spread = x @ x
    slope = float(x @ y / spread)
    rest = y - y.mean() - slope * x
    return slope, float(np.sqrt(rest @ rest / (len(x) - 2) / spread))
