"""Caputo's derivative in time: relaxation with a memory

The relaxation equation of fractional order, D^a y = -y, has a memory of its whole past. The solution begins faster than
an exponential and then decays as the power t^(-a). The curves are the simulation, the dots are the Mittag-Leffler
function.

:systems: Caputo derivative in time
:part: Beyond the granular chain
:number: y at t = 20 for a = 1/2
:expected: 0.12321394
:within: 0.05 %
:source: E_1/2(-t^(1/2)) = exp(t) erfc(t^(1/2)); Gorenflo, Kilbas, Mainardi, Rogosin, Mittag-Leffler Functions (2014)
"""

import matplotlib.pyplot as plt

import granjax as gx


def relax(t, y, args):
    return -y


ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for order in (0.9, 0.7, 0.5):
    run = gx.caputo(relax, 1.0, 20.0, order=order, steps=400)
    line = ax.loglog(run.ts[1:], run.ys[1:], label=f"a = {order}")[0]
    some = run.ts[40::30]
    ax.loglog(
        some, gx.theory.mittag_leffler(-(some**order), order), "o", ms=4, color=line.get_color()
    )
number = float(run.ys[-1])
ax.set(xlabel="time (scaled)", ylabel="y", xlim=(0.01, 25), ylim=(5e-3, 1.2))
ax.legend()
