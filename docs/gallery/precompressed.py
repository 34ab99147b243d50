"""A precompressed chain: solitary waves just above the speed of sound

Precompression makes sound possible, and solitary waves that are faster than sound. Near the speed of sound the exact
wave (lines) is close to the Korteweg-de Vries soliton (dashes). At 1.2 times that speed it is 40 % higher, and wider.

:systems: precompressed granular chain
:part: Travelling waves
:number: peak strain over the static overlap at 1.05 times the speed of sound
:expected: 0.653311577638
:within: 1e-10
:source: the exact wave by two other methods; Friesecke, Pego, Nonlinearity 12, 1601 (1999)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

law = gx.Hertz(precompression=1.0)
K2, K3, _ = gx.laws.taylor(law)
xi = np.linspace(-8, 8, 401)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for i, ratio in enumerate((1.2, 1.05)):
    wave = gx.travelling.solitary_wave(law, speed=ratio * K2**0.5)
    soliton = gx.theory.kdv.soliton(xi, 0.0, K2, K3, speed=wave.speed)
    ax.plot(xi, wave.strain(xi), color=f"C{i}", label=f"{ratio} times sound")
    ax.plot(xi, soliton.strain, "--", color=f"C{i}")
number = float(wave.amplitude)
ax.set(xlabel="place n - ct (contacts)", ylabel="strain / static overlap")
ax.legend()
