"""Fig. 2.4: velocities of the heavy beads at the first resonance.

This simulates the experiment: a heavy bead strikes a 1:1 dimer chain of mass ratio 0.59 without
precompression, with Hertz contacts and no friction, rotation or losses. The review does not give
the rest, which is chosen here: 120 beads of chrome steel, the heavy ones and the striker (bead 0)
of 19.05 mm, at 0.4 m/s; the light beads are smaller. Behind the pulse the motion is chaotic. After
a time of 100 in units of A = m = v = 1 (2.9 ms here) its detail depends on rounding, but the pulse
does not. The expected value is from SciPy's DOP853, where relative tolerances of 1e-10 and 1e-12
agree to 1e-7.
"""

import functools

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

MATERIAL = "chrome steel"
RADIUS = 9.525e-3
STRIKER = 0.4
RATIO = 0.59
BEADS = 120


def force(t, y, lattice):
    return gx.measures.contact_force(lattice, y)


def velocity(t, y, lattice):
    return y.v


@functools.cache
def struck():
    """Return the chain, its run with the records, and the units of time and force."""
    light = RADIUS * RATIO ** (1 / 3)
    A = float(gx.materials.hertz_coefficient(MATERIAL, RADIUS, MATERIAL, light))
    m = float(gx.materials.bead_mass(MATERIAL, RADIUS))
    second = (m * m / (A * A * STRIKER)) ** 0.2
    newton = A**0.4 * (m * STRIKER**2) ** 0.6
    radii = [light if n % 2 else RADIUS for n in range(BEADS)]
    chain = gx.scenes.beads(MATERIAL, radii, boundary="free")
    start = gx.states.impact(chain, STRIKER)
    seen = {"force": gx.Peak(force), "velocity": gx.Peak(velocity)}
    end = 1.17 * BEADS * second
    run = gx.simulate(chain, start, end, step=0.05 * second, save_at=3201, record=seen)
    return chain, run, second, newton


def draw(first, kind):
    """Draw the velocities of every eighth bead, starting with bead `first`."""
    _, run, second, _ = struck()
    until = slice(0, np.searchsorted(run.ts, 100 * second), 4)
    ax = plt.figure(figsize=(5.6, 4.6), layout="constrained").subplots()
    beads = np.arange(first, 85, 8)
    options = {"label": "velocity (m/s)", "site_label": "bead"}
    gx.plots.traces(1e3 * run.ts[until], run.vs[until], beads, ax, **options)
    ax.set_xlabel("time (ms)")
    ax.set_title(rf"{kind} beads, every fourth of them, $\varepsilon = {RATIO}$")


def make():
    draw(4, "Heavy")
    peak = float(struck()[1].recorded["velocity"][40]) / STRIKER
    return {"peak velocity of the heavy bead 40 / striker velocity": (peak, 0.426448, 1e-5)}


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
