"""An exponent of spreading energy that is fitted before it has converged: a small standard error, and wrong."""

import jax
import numpy as np
import pytest

import granjax as gx

T1 = 100.0
SAMPLES = 64
TIMES = T1 * np.geomspace(1 / 64, 1, 24)


def slope(x, y):
    return np.polyfit(x, y, 1)[0]


def drift(x, y):
    """The change of the slope between the two halves, per decade of time."""
    n = len(x) // 2
    change = slope(x[-n:], y[-n:]) - slope(x[:n], y[:n])
    return change * np.log(10) / (x[-n:].mean() - x[:n].mean())


@pytest.mark.slow
def test_an_exponent_fitted_before_it_has_converged():
    """Weak disorder, of which early waves know nothing yet: a line through logarithms looks perfect, and is not 3/2."""
    chain = lambda n: gx.scenes.disordered(260, 0.3, n, law=gx.Linear, distribution="binary")
    chains = jax.vmap(chain, out_axes=-1)(np.arange(SAMPLES))
    kick = gx.State(chains.zeros(), chains.zeros().at[130].set(1.0))
    run = gx.simulate(chains, kick, T1, save_at=TIMES, step=0.5, solver=gx.SRKN6b())
    moments = np.asarray(gx.measures.along(gx.measures.second_moment, chains, run))
    weights = np.random.default_rng(0).multinomial(SAMPLES, np.full(SAMPLES, 1 / SAMPLES), 400)
    x = np.log(TIMES)
    y = np.log(moments.mean(1))
    drawn = np.log(moments @ weights.T / SAMPLES)

    def told(of, start):
        """A number of the samples' mean after `start`, and its standard error by bootstrap."""
        late = TIMES >= start * (1 - 1e-9)
        return of(x[late], y[late]), of(x[late], drawn[late]).std(ddof=1)

    early = TIMES <= T1 / 2
    assert np.corrcoef(x[early], y[early])[0, 1] ** 2 > 0.999 and slope(x[early], y[early]) > 1.75
    value, error = told(slope, T1 / 8)
    assert error < 0.01 < abs(value - 1.5) / 10
    # the slope still falls, and its change says so, in every window
    change, uncertain = told(drift, T1 / 8)
    assert abs(change) - 2 * uncertain > 0.075 and change < -0.1
    change, uncertain = told(drift, T1 / 4)
    assert abs(change) + 2 * uncertain > 0.075
    local = np.gradient(y, x)
    assert local[-4:].mean() < local[9:16].mean() - 0.05
