"""The sound of a thermal chain, to half a per cent of the closed form; the gallery shows it to two."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx
from granjax.theory.thermal import bond_state


def test_sound_of_a_thermal_chain():
    """The correlation of strains has two peaks that move with the adiabatic speed of sound."""
    law = gx.Polynomial(1.0, -2.0, 1.0)
    T = 0.5
    N = 512
    lanes = 16
    mean = bond_state(law, T, 1.0)
    # a ring is held at its mean length: the same law about its mean compression
    e = float(mean.strain)
    K3 = -2.0
    K4 = 1.0
    about = gx.Polynomial(1 + 2 * K3 * e + 3 * K4 * e * e, K3 + 3 * K4 * e, K4)
    ring = lambda mass: gx.Lattice(mass, gx.Bond(gx.Shift(1, "periodic"), about), sites=N)
    rings = jax.vmap(ring, out_axes=-1)(jnp.ones(lanes))
    state = gx.states.gibbs(rings, T, seed=5, moves=4)
    run = gx.simulate(rings, state, 3000.0, step=0.2, save_at=601)
    found = gx.measures.correlation(run.us - jnp.roll(run.us, -1, 1), dt=5.0, lags=31)
    speed = float(mean.sound_speed)
    seen = []
    for lag in range(12, 31, 3):
        t = float(found.lag[lag])
        # peaks are as wide as t^(2/3)
        window = np.hanning(2 * round(2 + 0.6 * t ** (2 / 3)) + 1)
        value = np.convolve(found.value[lag], window, "same")
        for side in (-1, 1):
            there = np.flatnonzero(found.offset * side > 0.5 * speed * t)
            i = there[np.argmax(value[there])]
            before, top, after = value[i - 1 : i + 2]
            place = found.offset[i] + (before - after) / (2 * (before - 2 * top + after))
            seen.append(abs(float(place)) / t)
    assert np.mean(seen) == pytest.approx(speed, rel=5e-3)
