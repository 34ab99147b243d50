"""How energy spreads in a disordered chain, from a thousand samples: by hand, pytest benchmarks/long."""

import numpy as np
from gallery import left_by

import granjax as gx

disordered = gx.scenes.disordered


def told(of, samples, window, times):
    """A number of the samples' mean by the name of the script's function, and its standard error."""
    device = left_by("superdiffusion")
    return device.fitted(getattr(device, of) if isinstance(of, str) else of, times, samples, window)


def beside_constant(x, y):
    """gamma of A t^gamma + B over x = log t, by least squares of relative deviations; a fit for each row of y."""
    grid = np.linspace(0.02, 3.0, 597)
    rows = np.atleast_2d(y)
    weight = 1 / rows[0]
    basis = (
        np.stack([np.exp(grid[:, None] * (x - x[-1])), np.ones((len(grid), len(x)))], -1)
        * weight[:, None]
    )
    basis = np.linalg.qr(basis)[0]
    seen = np.einsum("gka,dk->gda", basis, rows * weight)
    left = ((rows * weight) ** 2).sum(1) - (seen**2).sum(-1)
    least = np.clip(left.argmin(0), 1, len(grid) - 2)
    before, here, after = (left[least + k, np.arange(len(rows))] for k in (-1, 0, 1))
    found = grid[least] + (grid[1] - grid[0]) * (before - after) / (2 * (before - 2 * here + after))
    return found if np.ndim(y) > 1 else found[0]


def test_a_thousand_samples():
    """After a kick of momentum 3/2; after a displacement 1/2 beside a constant, while the plain slope still falls."""

    def many(sites, spread, displaced, t1, step):
        def chain(seed):
            return disordered(sites, spread, seed, law=gx.Linear, distribution="binary")

        times = t1 * np.geomspace(1 / 64, 1, 40)
        found = left_by("superdiffusion").moments(
            chain, np.arange(1000), times, step, displaced=displaced, chunk=100
        )
        return found, times

    found, times = many(2300, 0.7, False, 1000.0, 0.5)
    window = (1000 / 8, 1000.0)
    (exponent, error), (change, uncertain) = (
        told(of, found, window, times) for of in ("slope", "drift")
    )
    assert abs(change) + 2 * uncertain <= 0.075 and abs(exponent - 1.5) < 0.04 and error < 0.005
    found, times = many(2740, 0.9, True, 1200.0, 0.3)
    change, uncertain = told("drift", found, (150.0, 1200.0), times)
    assert abs(change) - 2 * uncertain > 0.075
    assert told("slope", found, (times[-4], 1200.0), times)[0] < 0.66
    late, error = told(beside_constant, found, (300.0, 1200.0), times)
    assert abs(late - 0.5) < 2 * error < 0.1
