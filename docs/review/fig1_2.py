"""Fig. 1.2: the travelling wave's profile, its derivative and its tail.

The figure shows the exact wave of a Hertz chain without precompression (A = m = 1) at speed 1, its
slope, the strains of the contacts of the lattice, and both compactons. The compactons end where the
tail of the wave continues to decay doubly exponentially (inset). The expected values are from the
same equation, solved by two other methods.
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

PEAK = 1.48735937434940207
TAIL = 1.66653015582526e-15
# number of points between two contacts, and of contacts shown on each side
POINTS = 32
REACH = 6


def make():
    wave = gx.travelling.solitary_wave(gx.Hertz(), speed=1.0)
    xi = np.linspace(-REACH, REACH, 2 * REACH * POINTS + 1)
    strain = np.asarray(wave.strain(xi))
    # by the wave equation the slope of the strain is the difference of neighbouring velocities
    slope = np.asarray(wave.velocity(xi + 1) - wave.velocity(xi))
    nesterenko = np.asarray(gx.theory.compacton.nesterenko(xi, speed=1.0).strain)
    ahnert = np.asarray(gx.theory.compacton.ahnert_pikovsky(xi, speed=1.0).strain)

    contact = np.arange(0, len(xi), POINTS)
    ax = plt.figure(figsize=(6.4, 4.4), layout="constrained").subplots()
    tail = ax.inset_axes([0.7, 0.6, 0.29, 0.38])
    curves = {
        "exact": strain,
        "its slope": slope,
        "Nesterenko": nesterenko,
        "Ahnert-Pikovsky": ahnert,
    }
    for (name, y), dash in zip(curves.items(), ("-", "--", "-.", ":")):
        ax.plot(xi, y, dash, label=name)
        tail.semilogy(xi, np.abs(y), dash, lw=1)
    ax.plot(xi[contact], strain[contact], "o", label="lattice")
    tail.set_ylim(1e-30, 10)
    ax.set(xlabel=r"$\xi = n - c\,t$", ylabel="strain (scaled)")
    ax.legend(loc="upper left", frameon=False)
    top, five, three = (REACH * POINTS + n * POINTS for n in (0, 5, 3))
    missed = np.abs(slope - np.gradient(strain, xi)).max()
    return {
        "peak strain over c^4": (strain[top], PEAK, 1e-13),
        "strain at xi = 5": (strain[five], TAIL, 1e-12 * TAIL),
        "Nesterenko's peak over the exact one, less 1": (
            nesterenko[top] / strain[top] - 1,
            0.05052,
            5e-6,
        ),
        "Ahnert and Pikovsky's, less 1": (ahnert[top] / strain[top] - 1, -0.03184, 5e-6),
        "Nesterenko's strain at xi = 3": (nesterenko[three], 0.0, 0.0),
        "Ahnert and Pikovsky's strain at xi = 3": (ahnert[three], 0.0, 0.0),
        "slope less the finite difference of the strain, at most": (missed, 0.0, 3e-3),
    }


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
