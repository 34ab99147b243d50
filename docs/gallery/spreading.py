"""Spreading by chaos: a packet in a disordered nonlinear chain never stops, and slows down

Disorder localises all linear waves. If the chain is also nonlinear, chaos spreads the energy, and its second moment
grows like t^(1/3). As the packet becomes more dilute, the chaos weakens: the rate at which nearby trajectories separate
decays like t^(-1/4), a law that is reached only late. Data of 64 chains up to t = 2e6 are stored
(`stored/spreading.py`, some 25 minutes).

:systems: Klein-Gordon chain (phi^4)
:part: Thermal chains and chaos
:number: exponent of the second moment, 1e4 < t < 2e6
:expected: 0.3333
:within: 0.05
:source: Flach, Krimer, Skokos, Phys. Rev. Lett. 102, 024101 (2009); Skokos, Gkolias, Flach, ibid. 111, 064101 (2013)
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

table = np.loadtxt(Path(__file__).parent / "stored" / "spreading.csv", delimiter=",", skiprows=1)
lanes = round(table[:, 1].max()) + 1
t, _, m2, growth = (x.reshape(-1, lanes) for x in table.T)
t = t[:, 0]


def exponent(t, x, since):
    """Return the slope of the mean over the chains from the time `since` on, and its jackknife error."""
    late = t >= since
    slope = lambda x: np.polyfit(np.log(t[late]), np.log(x[late].mean(1)), 1)[0]
    without = [slope(np.delete(x, i, 1)) for i in range(lanes)]
    return slope(x), np.std(without) * (lanes - 1) ** 0.5


figure, (ax, below) = plt.subplots(2, figsize=(5.4, 4.4), layout="constrained", sharex=True)
rate = np.diff(growth, axis=0) / np.diff(t)[:, None]
middle = np.sqrt(t[1:] * t[:-1])
for axes, times, x, since, name in (
    (ax, t, m2, 1e4, "second moment (sites$^2$)"),
    (below, middle, rate, 1e5, "growth rate (scaled)"),
):
    value, error = exponent(times, x, since)
    axes.loglog(times, x.mean(1), ".-")
    late = times >= since
    mean = x.mean(1)
    line = times[late] ** value
    line *= np.exp(np.mean(np.log(mean[late] / line)))
    axes.loglog(times[late], line, "k--", label=f"$t^{{{value:.3f} \\pm {error:.3f}}}$")
    axes.set(ylabel=name)
    axes.legend()
number = exponent(t, m2, 1e4)[0]
below.set(xlabel="time (scaled)")
