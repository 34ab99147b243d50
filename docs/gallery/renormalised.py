"""Renormalised waves: heat stiffens the beta chain

In thermal equilibrium the waves of the beta-FPUT chain have the dispersion of the linear chain times one factor, which
is 1.46 at k_B T = 1 and zero pressure. The spectrum of a run shows this dispersion; <v_k^2>/<u_k^2> of Gibbs states
measures the factor.

:systems: FPUT chain
:part: Thermal chains and chaos
:number: renormalised over bare frequency, all wave numbers of 1024 rings of 64 sites
:expected: 1.461888448
:within: 1 %
:source: quadrature over the canonical distribution; Gershgorin, Lvov, Cai, PRL 95, 264302 (2005)
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

N = 64


def ring(stiffness):
    return gx.scenes.fput(N, 0.0, 1.0, stiffness=stiffness, boundary="periodic")


rings = jax.vmap(ring, out_axes=-1)(jnp.ones(1024))
state = gx.states.gibbs(rings, 1.0, seed=1)
u2, v2 = (np.mean(np.abs(np.fft.fft(np.asarray(x), axis=0)) ** 2, 1) for x in state)
k = 2 * np.pi * np.arange(1, N // 2 + 1) / N
ratio = np.sqrt(v2 / np.where(u2 > 0, u2, 1))[1 : N // 2 + 1] / (2 * np.sin(k / 2))
number = ratio.mean()

few = jax.vmap(ring, out_axes=-1)(jnp.ones(32))
start = gx.State(state.u[:, :32], state.v[:, :32])
run = gx.simulate(few, start, 200.0, step=0.1, save_at=801)
seen = gx.measures.spectrum(run.vs, 0.25, space_window="none")
power = np.asarray(seen.power).mean(2)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
shown = seen.k > 0
ax.pcolormesh(seen.k[shown], seen.omega, np.log10(power[shown]).T, vmin=-6, rasterized=True)
ax.plot(k, 2 * np.sin(k / 2), "w--", label="linear chain")
ax.plot(k, number * 2 * np.sin(k / 2), "r", label=f"{number:.3f} times that")
ax.set(
    xlabel="wave number (1/site)",
    ylabel="angular frequency (scaled)",
    xlim=(0, seen.k[-1]),
    ylim=(0, 6),
)
ax.legend(loc="upper left")
