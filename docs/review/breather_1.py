"""Breather.1: dark breather of the granular chain and its NLS approximation.

The figure shows the strain of the bond-centred dark breather of a monomer chain at its turning
point, from Newton's method (dots) and from the defocusing NLS equation (line), with A = d0 = m = 1.
The force at the ends is constant, so the strain vanishes there too. Chosen here: 82 beads. Right:
the error of the NLS amplitude at a quarter of the chain, for the part of the strain that contains
the odd harmonics. The next order of the envelope is epsilon^2 = 1 - omega_b/omega_0, so the error
decreases with its first power.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

BEADS = 82
# 1 - omega_b/omega_0; the figure shows the profile of the first
DETUNINGS = np.array([0.01, 0.015, 0.02, 0.03, 0.04])


def make():
    chain = gx.scenes.monomer(BEADS, precompression=1.0, boundary="free")
    edge = float(gx.linear.bands(chain).upper[0])
    nls = gx.theory.nls.coefficients(1.0, *gx.laws.taylor(chain.terms[0].law), math.pi)
    found = []
    dark = []
    error = []
    for omega in (1 - DETUNINGS) * edge:
        found.append(gx.breathers.breather(chain, omega, "dark"))
        dark.append(gx.theory.nls.dark_profile(nls, omega, BEADS))
        u = np.asarray(found[-1].run(2).us)[:, BEADS // 4 :]
        size = abs(u[0, 0] - u[0, 1] - u[1, 0] + u[1, 1]) / 2
        error.append(2 * float(dark[-1].amplitude) / size - 1)
    order = float(np.polyfit(np.log(DETUNINGS), np.log(error), 1)[0])

    canvas = plt.figure(figsize=(8.8, 3.6), layout="constrained")
    left, right = canvas.subplots(1, 2, width_ratios=(1.5, 1))
    contact = np.arange(BEADS - 1) + 0.5
    left.plot(contact, dark[0].strain[:-1], "C1-", lw=1.0, label="NLS")
    left.plot(contact, gx.measures.strain(chain, found[0].state), "C0o", ms=3, label="Newton")
    left.set(xlabel="contact", ylabel="strain $y_n$ (compression positive)")
    left.set_title(rf"$\omega_b = {float(found[0].omega):.4f}$")
    left.legend(loc="upper right", ncols=2, bbox_to_anchor=(1.0, 1.12))
    x = 100 * DETUNINGS
    y = 100 * np.array(error)
    right.loglog(x, y, "o-", label=f"slope {order:.2f}")
    right.loglog(x, y[0] * x / x[0], "--", color="0.55", label="slope 1")
    right.xaxis.set_ticks([1, 2, 3, 4], list("1234"))
    right.yaxis.set_ticks([3, 5, 10], ["3", "5", "10"])
    right.minorticks_off()
    right.set(xlabel=r"$1 - \omega_b/\omega_0$ (%)", ylabel="error of the NLS amplitude (%)")
    right.legend()
    return {"order in 1 - omega_b/omega_0 of the error of the NLS amplitude": (order, 1.0, 0.1)}


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
