"""A dark breather from rest: two shaken walls

Both walls of a steel chain push inwards at the same time, just below the cut-off frequency. The two waves cancel at the
middle bead, whose neighbours move against each other: a dark breather. A drive with a tenth of the amplitude produces
the arches of a sine instead.

:systems: dark breathers in a monomer, driven and damped chain
:part: Breathers
:number: root mean square of all velocities, walls at 0.2 um and 7290 Hz, mm/s
:expected: 6.69536459
:within: 1e-6
:source: harmonic balance, benchmarks/references/harmonic_balance.py; Chong et al., Phys. Rev. E 89, 032924 (2014)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

steel = gx.materials.Material("steel", 200e9, 0.3, 28.2e-3 / (4 / 3 * np.pi * 9.53e-3**3))
A = gx.materials.hertz_coefficient(steel, 9.53e-3)
chain = gx.scenes.monomer(21, 28.2e-3, A, precompression=10.0).counted_in("SI")
highest = float(gx.linear.normal_modes(chain).omega[-1]) / (2 * np.pi)
assert abs(float(A) / 1.0114e10 - 1) < 1e-4 and abs(highest - 7350.3) < 0.1


def settled(amplitude, phase=(0.0, np.pi)):
    """Drive both walls at 7290 Hz from rest until the motion repeats."""
    omega = 2 * np.pi * 7290
    driven = gx.driven.driven_chain(chain, amplitude, omega, damping=1 / 5e-3, phase=phase)
    return gx.driven.settle(
        driven, gx.states.rest(chain), 2 * np.pi / omega, periods=8000, steps=48
    )


dark = settled(0.2e-6)
arches = settled(0.02e-6)
u, v, speed = (np.asarray(x) for x in (dark.us, dark.vs, dark.amplitude))
number = 1e3 * float(np.sqrt((v**2).mean()))
background = speed[np.abs(np.arange(21) - 10) > 5].mean()
# at rest in the middle; half of the background 1.8 sites away; the ends reach 0.89 of the largest speed
half = 10 + np.argmax(speed[10:] > background / 2)
width = 2 * (half - 11 + (background / 2 - speed[half - 1]) / (speed[half] - speed[half - 1]))
assert dark.multiple == 1 and speed[10] < 1e-6 * background and abs(width - 3.678) < 0.01
assert abs(background / 0.01111 - 1) < 1e-3 and speed[0] > 0.88 * speed.max()
# neighbours move in opposite directions, with one frequency: its harmonics are below half a percent
pairs = (v[:, :-1] * v[:, 1:]).mean(0) / np.sqrt((v**2).mean(0)[:-1] * (v**2).mean(0)[1:])
assert np.delete(pairs, [9, 10]).mean() < -0.99
spectrum = np.abs(np.fft.rfft(v, axis=0))[:: len(v) // 48]
assert abs(spectrum[2:7].max() / spectrum[1].max() / 4.8e-3 - 1) < 0.05
linear = np.asarray(arches.amplitude)
assert abs(linear[0] / linear.max() / 0.380 - 1) < 0.01

ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for y, name in ((speed, r"walls at 0.2 $\mu$m"), (linear, r"0.02 $\mu$m")):
    ax.plot(np.arange(-10, 11), y / y.max(), "o-", ms=4, lw=0.8, label=name)
ax.set(xlabel="bead from the middle", ylabel="largest speed / that of the fastest bead")
ax.legend()
