"""A dark breather: a gap in a vibrating chain

In a chain of equal beads all beads oscillate against their neighbours, except for a dip in the middle, where the phase
jumps by half a period. Chains with Hertz contacts have only breathers of this kind, below the upper edge of the band.

:systems: dark breathers in a monomer
:part: Breathers
:number: energy of 82 beads at 0.990 of the band's edge, ends at constant force
:expected: 9.321099312
:within: 1e-7
:source: shooting with DOP853 at 1e-13; Chong, Kevrekidis, Theocharis, Daraio, Phys. Rev. E 87, 042202 (2013)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.scenes.monomer(82, precompression=1.0, boundary="free")
omega = 0.99 * 6**0.5
guess = gx.breathers.dark_guess(chain, omega)
breather = gx.breathers.breather(chain, omega, guess, steps=96, check=False)
number = float(breather.energy)
contact = np.arange(81) - 40
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.plot(contact, gx.measures.strain(chain, breather.state), "o-", ms=3, lw=0.6)
ax.set(
    xlabel="contact from the middle", ylabel="strain / static overlap", title=f"energy {number:.6f}"
)
