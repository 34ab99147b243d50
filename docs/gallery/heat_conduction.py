"""Heat conduction: longer beta chains conduct better

Between baths at k_B T = 1.2 and 0.8 the beta-FPUT chain carries a heat current that falls more slowly than 1/N: the
conductivity J N/dT grows like a power of the length, as momentum is kept. The temperature is not a straight line.

:systems: FPUT chain
:part: Thermal chains and chaos
:number: exponent of the conductivity, 32 to 256 sites
:expected: 0.40
:within: 0.1
:source: 0.33 to 0.5 at such lengths; Lepri, Livi, Politi, Phys. Rep. 377, 1 (2003)
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

HOT, COLD, LANES = 1.2, 0.8, 16


def chain(seed, N):
    ends = np.r_[1.0, np.zeros(N - 2), 1.0] + 0.0 * seed
    heat = np.r_[HOT, np.zeros(N - 2), COLD] + 0.0 * seed
    bond = gx.Bond(gx.Shift(1, "fixed"), gx.Polynomial(1.0 + 0.0 * seed, 0.0, 1.0))
    return gx.Lattice(1.0, (bond, gx.Langevin(ends, heat, seed)), sites=N)


sizes, found = np.array([32, 64, 128, 256]), []
left, right = plt.subplots(1, 2, figsize=(7.2, 3.2), layout="constrained")[1]
for N in sizes.tolist():
    chains = jax.vmap(lambda seed, N=N: chain(seed, N), out_axes=-1)(jnp.arange(LANES))
    start, time = gx.states.gibbs(chains, 1.0, seed=N, moves=4), 40.0 * N
    warm = gx.simulate(chains, start, time, step=0.1)
    run = gx.simulate(chains, warm.final, 3 * time, t0=time, step=0.1, save_at=1001)
    current = gx.measures.along(gx.measures.heat_current, chains, run).mean(1)
    means = np.asarray(current.mean(0)) * N / (HOT - COLD)
    found.append((means.mean(), means.std(ddof=1) / LANES**0.5))
    profile = np.asarray((run.vs**2).mean((0, 2)))
    left.plot((np.arange(N) + 0.5) / N, profile, label=f"{N} sites")
value, error = np.array(found).T
number = np.polyfit(np.log(sizes), np.log(value), 1, w=value / error)[0]
right.errorbar(sizes, value, error, fmt="o")
right.loglog(sizes, value[-1] * (sizes / sizes[-1]) ** number, label=f"N^{number:.2f}")
left.set(xlabel="place along the chain", ylabel="temperature (scaled)")
right.set(xlabel="sites", ylabel="conductivity (scaled)")
left.legend()
right.legend()
ax = left
