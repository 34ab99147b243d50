"""DSW.3: granular velocity shock and its KdV prediction.

A granular chain with precompression is scaled to the speed of sound 1 and K3 = 1/2. The figure
shows it after a velocity shock of half velocity c = 0.1, at T_f = 1200 of the slow time t eps^3/24,
eps^2 = 24 c, with the edges of KdV and its modulated wave at n = t, whose phase is fitted. By
symmetry only one half is simulated, pushed by a piston of speed 2c. The expected value is from
converged simulations by another method, t = 2000 and 8000.
"""

import functools

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

C = 0.1
TIME = 7746.0
LAW = gx.Hertz(2 * 2**0.5 / 3, 1 / 3)
K2, K3 = map(float, gx.laws.taylor(LAW)[:2])
KDV = gx.theory.kdv.velocity_shock(C, K2, K3)
TODA = gx.theory.toda.velocity_shock(C)


def pushed():
    """Return a chain with a piston of speed 2c, long enough that no wave reaches its other end."""
    sites = int(float(TODA.leading_speed) * TIME) + 60
    chain = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "free"), LAW),), sites=sites, units="scaled")
    return gx.shocks.piston(chain, 2 * C)


@functools.cache
def collided():
    """Return places and strains of the bonds; the first is the contact with the piston."""
    problem = pushed()
    # steps twice as long as the default give errors below 1e-6
    u = problem.run(TIME, step=0.4).final.u
    strain = np.append(2 * C * TIME - float(u[0]), np.asarray(problem.strain(u)))
    return np.arange(strain.size) + 0.5, strain


def draw(name, edges, wave):
    """Draw the shock with a theory's edges, and its modulated wave `wave(n, phase)` at n = t."""
    places, strain = collided()
    canvas = plt.figure(figsize=(9.6, 3.8), layout="constrained")
    whole, zoom = canvas.subplots(1, 2, width_ratios=(1.5, 1))
    gx.plots.shock(strain, edges, whole, places=places, time=TIME)
    whole.set_title(f"Edges, mean and amplitude of {name}", pad=8)
    near = np.abs(places - TIME) < 13
    first, last = places[near][[0, -1]]
    fine = np.linspace(first, last, 16 * (near.sum() - 1) + 1)
    waves = np.asarray(wave(fine[:, None], 2 * np.pi * np.arange(360) / 360).strain)
    best = waves[:, ((waves[::16] - strain[near, None]) ** 2).sum(0).argmin()]
    zoom.plot(places[near], strain[near], "o", ms=3.5, label="lattice")
    zoom.plot(fine, best, label=name)
    zoom.set(xlabel="bond from the step $n$", ylabel="strain (scaled)")
    zoom.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2)


def make():
    draw("KdV", KDV, lambda n, phase: gx.theory.kdv.shock_wave(n, TIME, C, K2, K3, phase=phase))
    places, strain = collided()
    # weighted by Hann's window over |n/t| < s_-/2
    x = places / (float(TODA.trailing_speed) / 2 * TIME)
    weight = np.where(x < 1, np.cos(np.pi * x / 2) ** 2, 0.0)
    return {"mean strain of the plateau": (weight @ strain / weight.sum(), 0.19157239, 1e-6)}


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
