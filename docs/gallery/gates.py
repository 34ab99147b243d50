"""A switch and logic gates made of beads

Sinusoidal signals in the gap of a chain under load do not pass. Two of them together do: the nonlinear contacts
generate their difference frequency, which lies in the band. A threshold on the output therefore makes an AND gate, and
one signal can switch the other. Signals in the band pass individually, which makes an OR gate.

:systems: switch and logic gates
:part: Devices
:number: root mean square velocity of the last bead with both signals, mm/s, 20 to 30 ms after they begin
:expected: 0.085625
:within: 0.5 %
:source: SciPy's DOP853 with forces of its own; Li, Anzel, Yang, Kevrekidis, Daraio, Nature Commun. 5, 5311 (2014)
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

steel = gx.scenes.beads("steel 316", np.full(10, 9.53e-3), 8.0)
cutoff = float(gx.linear.normal_modes(steel).omega[-1])
rows = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])


class Signals(eqx.Module):
    amplitudes: jax.Array
    omegas: jax.Array

    def __call__(self, t):
        return jnp.sum(self.amplitudes * jnp.sin(self.omegas * t), 0)


def last_squared(t, y, lattice):
    return y.v[-1] ** 2


def outputs(chain, amplitudes, omegas):
    """Return the last bead's rms velocity in each half of the window and in all of it, and its error."""
    still = gx.driven.driven_chain(chain, 0.0, 1.0, ends="left", damping=1 / 1.75e-3)
    wall = lambda a, w: eqx.tree_at(lambda c: c.terms[-2].motion, still, Signals(a, w))
    lanes = jax.vmap(wall, out_axes=-1)(amplitudes, omegas)
    found = []
    for steps in (12, 24):  # steps per period of the fastest signal
        state = gx.states.rest(lanes)
        step = 2 * np.pi / omegas.max() / steps
        for begin, end in ((0.0, 20e-3), (20e-3, 30e-3), (30e-3, 40e-3)):
            run = gx.simulate(
                lanes, state, end, t0=begin, step=step, record={"square": gx.Integral(last_squared)}
            )
            state = run.final
            found.append(np.array(run.recorded["square"]) / (end - begin))
    halves, coarse, fine = (
        np.sqrt(found[4:]),
        *(np.sqrt((found[i] + found[i + 1]) / 2) for i in (1, 4)),
    )
    return halves, fine, np.abs(fine - coarse) + np.abs(halves[1] - halves[0])


gap = cutoff * np.array([1.5, 1.1])
band = cutoff * np.array([0.4, 0.7])
controls = np.linspace(0, 0.2e-6, 9)
switch = np.stack([np.repeat([0.1e-6, 0], 9), np.tile(controls, 2)], 1)
amplitudes = np.concatenate([0.1e-6 * rows, 0.05e-6 * rows, switch])
omegas = np.concatenate([np.tile(gap, (4, 1)), np.tile(band, (4, 1)), np.tile(gap, (18, 1))])
halves, output, error = outputs(steel, amplitudes, omegas)
number = 1e3 * float(halves[0, 3])
low = output - error
high = output + error
AND, OR, on, alone = (slice(a, b) for a, b in ((0, 4), (4, 8), (8, 17), (17, 26)))
# the threshold for AND may vary by a factor of forty, none gives XOR, one of 0.1 mm/s gives OR
assert low[3] > 40 * high[:3].max() and low[1:3].min() < high[3]
assert ((output[OR] > 1e-4) == rows.any(1)).all() and low[OR][1:].min() > 5e-4
# the control switches the signal but does not pass alone; the output is half its maximum at 112 nm
assert (high[alone][1:] < 0.04 * output[on][1:]).all() and low[on][8] > 250 * high[on][0]
half = output[on][8] / 2 + np.array([-1, 1]) * error[on][8] / 2
assert (
    high[on][4] < half[0] and low[on][5] > half[1] and abs(controls[4:6].mean() - 1.125e-7) < 1e-12
)
axes = plt.subplots(1, 2, figsize=(7.0, 3.2), layout="constrained")[1]
for place, part, name in ((-0.2, AND, "in the gap"), (0.2, OR, "in the band")):
    y = 1e3 * output[part]
    e = 1e3 * error[part]
    axes[0].bar(np.arange(4) + place, y, 0.4, yerr=np.minimum(e, 0.99 * y), label=name)
axes[0].set(xticks=range(4), xticklabels=["00", "01", "10", "11"], yscale="log", ylim=(1e-5, 1e3))
axes[0].set(xlabel="signals that are on", ylabel="output (mm/s)")
for part, name in ((on, "signal and control"), (alone, "control alone")):
    axes[1].semilogy(1e9 * controls[1:], 1e3 * output[part][1:], "o-", label=name)
axes[1].set(xlabel="control (nm)", ylabel="output (mm/s)")
for ax in axes:
    ax.legend()
