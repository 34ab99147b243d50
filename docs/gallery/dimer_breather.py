"""A breather in the gap of a dimer chain

In a precompressed steel and aluminium chain a few beads oscillate in one place, at a frequency between the bands. The
energy stays on a few light beads, and the two halves of the chain are pushed apart.

:systems: breathers in a dimer
:part: Breathers
:number: energy at 0.9850 of the optical band's lower edge, 61 beads
:expected: 2.7015770
:within: 1e-4
:source: shooting in 121 beads, in other code (61 beads lack 9e-5); Theocharis et al., Phys. Rev. E 82, 056604 (2010)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.scenes.pattern(61, (1.0, 2.957949), precompression=1.0, boundary="free")
breather = gx.breathers.bright_guess(chain, 0.995 * 3**0.5)
for ratio in (0.995, 0.99, 0.985):
    breather = gx.breathers.breather(chain, ratio * 3**0.5, breather, steps=64, check=False)
number = float(breather.energy)
bead = np.arange(61) - 30
light = np.arange(61) % 2 == 0
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.axhline(0, color="0.7", lw=0.8)
ax.plot(bead[light], breather.state.u[light], "o", label="light beads")
ax.plot(bead[~light], breather.state.u[~light], "s", label="heavy beads")
ax.set(xlabel="bead from the middle", ylabel="displacement (scaled)", title=f"energy {number:.5f}")
ax.legend()
