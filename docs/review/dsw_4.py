"""DSW.4: granular velocity shock and its Toda approximation.

The figure shows the shock of DSW.3 with the edges of Toda and its modulated wave at n = t, whose
phase is fitted. The expected value is from an independent integration by SciPy's DOP853 at 1e-12.
"""

import matplotlib.pyplot as plt
from dsw_1 import crests
from dsw_3 import TIME, TODA, C, collided, draw

import granjax as gx


def make():
    draw("Toda", TODA, lambda n, phase: gx.theory.toda.shock_wave(n, TIME, C, phase=phase))
    return {"height of the leading crest": (crests(*collided())[1][-1], 0.368775975, 1e-6)}


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
