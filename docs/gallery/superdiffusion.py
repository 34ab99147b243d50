"""Disordered chains: energy spreads between diffusion and flight

In an ordered chain the energy of a kick spreads freely, and its second moment grows as t^2. Disorder stops all waves
except the long ones, which carry a share that decreases with time: the moment grows as t^(3/2). The slope still
decreases slowly. It is given with the scatter of the samples and with its change from the first to the second half of
the window, per decade of time.

:systems: superdiffusive transport
:part: Disorder and losses
:number: exponent of the second moment of energy, 50 < t < 200, 192 chains
:expected: 1.5
:within: 0.06
:source: Datta, Kundu, Phys. Rev. B 51, 6287 (1995), for long times, which is approached from above
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx


def moments(chain, seeds, times, step, site=None, displaced=False, chunk=96):
    """Return the second moment of the energy after a kick of one site of each chain, (samples, times)."""
    found = []
    for part in np.split(np.asarray(seeds), range(chunk, len(seeds), chunk)):
        chains = jax.vmap(chain, out_axes=-1)(part)
        rest = chains.zeros()
        kick = rest.at[len(rest) // 2 if site is None else site].set(1.0)
        state = gx.State(kick, rest) if displaced else gx.State(rest, kick)
        run = gx.simulate(chains, state, times[-1], save_at=times, step=step, solver=gx.SRKN6b())
        found.append(np.asarray(gx.measures.along(gx.measures.second_moment, chains, run)).T)
        e = np.asarray(gx.measures.site_energy(chains, run.final))
        ends = (e[0] + e[-1]) / e.sum(0) * (len(e) / 2) ** 2 / found[-1][:, -1]
        assert ends.max() < 1e-4, "waves have reached the ends: longer chains or shorter times"
        assert np.max(run.energy_error) < 0.01
    return np.concatenate(found)


def slope(x, y):
    """Return the slope of log y, (..., times), over log time."""
    x = x - x.mean()
    return np.log(y) @ x / (x @ x)


def drift(x, y):
    """Return the change of the slope between the two halves of the times, per decade of time."""
    n = len(x) // 2
    apart = (x[-n:].mean() - x[:n].mean()) / np.log(10)
    return (slope(x[-n:], y[..., -n:]) - slope(x[:n], y[..., :n])) / apart


def fitted(of, times, samples, window):
    """Return `of` applied to the mean of the samples in a window, and its standard error by bootstrap."""
    inside = (times >= window[0] * (1 - 1e-9)) & (times <= window[1] * (1 + 1e-9))
    n = len(samples)
    weights = np.random.default_rng(0).multinomial(n, np.full(n, 1 / n), 400) / n
    x = np.log(times[inside])
    y = samples[:, inside]
    return float(of(x, y.mean(0))), float(of(x, weights @ y).std(ddof=1))


times = 200 * np.geomspace(1 / 64, 1, 40)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for spread, samples, name in ((0.0, 96, "ordered"), (0.8, 192, "disordered")):

    def chain(seed, spread=spread):
        return gx.scenes.disordered(600, spread, seed, law=gx.Linear, distribution="binary")

    found = moments(chain, 1000 + jnp.arange(samples), times, 0.5)
    number, error = fitted(slope, times, found, (50.0, 200.0))
    change, uncertain = fitted(drift, times, found, (50.0, 200.0))
    label = f"{name}: $t^{{{number:.2f} \\pm {max(error, 0.01):.2f}}}$, {change:+.2f} a decade"
    ax.loglog(times, found.mean(0), label=label)
ax.axvspan(50, 200, color="0.9")
ax.set(xlabel="time (scaled)", ylabel="second moment (sites$^2$)")
ax.legend()
