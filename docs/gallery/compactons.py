"""Compactons beside the exact solitary wave of a sonic vacuum

Two long-wave equations have solitary waves of finite support. Nesterenko's compacton is 5 % too high, that of Ahnert
and Pikovsky 3 % too low. The exact wave has a tail that decays doubly exponentially, faster than any exponential, and
never ends (inset).

:systems: compactons
:part: Travelling waves
:number: how much higher than the exact wave Nesterenko's compacton is, in per cent
:expected: 5.05195
:within: 0.00001
:source: 25/16 over the peak 1.48735937434940 of the exact wave; Ahnert, Pikovsky, Phys. Rev. E 79, 026209 (2009)
"""

import matplotlib.pyplot as plt

import granjax as gx

wave = gx.travelling.solitary_wave(gx.Hertz(), speed=1.0)
nesterenko = gx.theory.compacton.nesterenko(wave.xi).strain
pikovsky = gx.theory.compacton.ahnert_pikovsky(wave.xi).strain
number = 100 * float(nesterenko.max() / wave.amplitude - 1)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.wave(
    wave,
    ax,
    beside={"Nesterenko": nesterenko, "Ahnert, Pikovsky": pikovsky},
    floor=1e-30,
)
