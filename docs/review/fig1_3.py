"""Fig. 1.3: space-time evolution of the exact travelling wave, strain, c = 1.

The fixed point of phi = tent * phi^(3/2) is set on a Hertz chain of 90 beads without
precompression, A = m = 1. The figure shows its profile after it has travelled along 60 contacts.
The wave has to keep the speed and the profile for which it was computed.
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

BEADS = 90
# contact of the crest at the start, and number of contacts that the wave travels
START = 12
TRAVEL = 60
# strain at 3, 2, 1 and 0 contacts from the crest
KNOWN = [9.79950180919572e-5, 0.0290981220754717273, 0.583929165288747316, 1.48735937434940207]


def strain(t, y, lattice):
    return gx.measures.strain(lattice, y)


def make():
    wave = gx.travelling.solitary_wave(gx.Hertz(), speed=1.0)
    chain = gx.scenes.monomer(BEADS, boundary="free")
    passed = gx.Arrival(strain, float(wave.strain(0.5)))
    start = wave.state(BEADS, centre=START)
    options = {"save_at": 4 * TRAVEL + 1, "tolerance": 1e-11}
    run = gx.simulate(chain, start, float(TRAVEL), record={"passed": passed}, **options)
    strains = np.asarray(gx.measures.along(gx.measures.strain, chain, run))

    canvas = plt.figure(figsize=(9.2, 3.8), layout="constrained")
    left, right = canvas.subplots(1, 2, width_ratios=(1.15, 1))
    options = {"label": "strain", "site_label": "contact $n$"}
    gx.plots.space_time(strains, left, ts=run.ts, **options)
    left.set_title("Strain of every contact")
    end = START + TRAVEL
    last = strains[-1]
    xi = np.linspace(-6, 6, 385)
    right.plot(xi, wave.strain(xi), label="exact")
    nodes = np.arange(-6, 7)
    right.plot(nodes, last[end - 6 : end + 7], "o", label=f"simulated, $t = {TRAVEL}$")
    right.set(xlabel=r"$\xi = n - n_0 - c\,t$", ylabel="strain (scaled)")
    right.legend(frameon=False)
    right.set_title(f"Profile after {TRAVEL} contacts")

    n = np.arange(START + 1, end)
    slowness = np.polyfit(n, np.asarray(run.recorded["passed"])[n], 1)[0]
    rising = last[end - 3 : end + 1]
    falling = last[end : end + 4][::-1]
    ahead = abs(falling - KNOWN).max()
    behind = abs(rising - KNOWN).max()
    return {
        "speed [contacts/time]": (1 / slowness, 1.0, 1e-9),
        "strain ahead of the crest less the exact one, at most": (ahead, 0.0, 1e-10),
        "strain behind the crest less the exact one, at most": (behind, 0.0, 1e-10),
        "strain that is left behind, at most": (abs(last[: end - 5]).max(), 0.0, 1e-10),
    }


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
