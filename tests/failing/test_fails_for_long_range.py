"""Long range: an FFT that wraps around a finite chain, and a kernel cut short, which loses the algebraic tail."""

import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx

N = 451
S = 3.0
CENTRE = N // 2
FAR = np.arange(20, 201)


def test_an_fft_without_room_joins_the_ends_of_a_chain():
    kernel = np.arange(1.0, 40) ** -2
    u = jnp.zeros(40).at[0].set(0.1)
    naive, ours = (
        gx.Lattice(1.0, gx.LongRange(kernel, gx.Linear(), boundary), sites=40).force(0.0, u, 0 * u)
        for boundary in ("periodic", "free")
    )
    true = 0.1 * kernel
    np.testing.assert_allclose(ours[1:], true, rtol=0, atol=1e-13)
    assert naive[-1] > 100 * true[-1]


def tail(reach):
    mass = np.ones(N)
    mass[CENTRE] = 0.4
    chain = gx.scenes.long_range(N, S, mass=mass, reach=reach)
    return np.abs(np.asarray(gx.linear.normal_modes(chain).modes)[:, -1])[CENTRE:] + 1e-300


@pytest.mark.slow
def test_a_kernel_cut_short_loses_the_algebraic_tail():
    whole = tail(None)
    cut = tail(1)
    slope = np.polyfit(np.log(FAR), np.log(whole[FAR]), 1)[0]
    assert abs(slope + S) < 0.05
    # next neighbours alone: exponential, five orders of magnitude in ten sites
    assert cut[10] < 1e-5 * cut[0] and cut[20] < 1e-10 * cut[0] < whole[20]
