"""Breather.3: bright breather of a dimer chain, its multipliers and its unstable mode.

(a) Displacements of the light-centred breather of a precompressed dimer, with A = d0 = light mass =
1 and constant force at the ends, in the gap below the optical band; (b) Floquet multipliers; (c)
displacements and (d) velocities of the unstable mode. Chosen here: 121 beads, with light beads at
both ends and in the middle, heavy beads of mass 2.957949, and a frequency of 0.985 times the
optical edge sqrt(3). The expected multiplier is from an independent shooting method with a
converged step.
"""

import matplotlib.pyplot as plt

import granjax as gx


def make():
    chain = gx.scenes.pattern(121, (1.0, 2.957949), precompression=1.0, boundary="free")
    breather = gx.breathers.breather(chain, 0.985 * float(gx.linear.bands(chain).lower[1]))
    floquet = breather.floquet()
    axes = plt.figure(figsize=(8.4, 6.4), layout="constrained").subplots(2, 2)
    gx.plots.breather(breather, floquet, axes)
    omega = float(breather.omega)
    energy = float(breather.energy)
    axes[0, 0].set_title(rf"$\omega_b = {omega:.5f}$, $E = {energy:.6f}$")
    return {"largest Floquet multiplier (real)": (abs(floquet.multipliers[0]), 1.126536, 2e-6)}


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
