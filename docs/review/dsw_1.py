"""DSW.1: dispersive shock from a step in the strain.

A granular chain with A = d0 = m = 1 starts at rest, with the strain 4 left of the step and 0 right
of it. The figure shows it at t = 150: a rarefaction wave travels to the left, a dispersive shock to
the right. The expected value is from an independent integration by SciPy's DOP853 at 1e-12.
"""

import functools
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
from scipy.interpolate import CubicSpline

import granjax as gx

STRAIN = 4.0
TIME = 150.0
# sites beyond those that have moved
SPARE = 60


def crests(places, strain):
    """Return places and heights of the spline crests right of the step, without ripples."""
    spline = CubicSpline(places, strain)
    top = spline.derivative().roots(extrapolate=False)
    top = top[(spline(top, 2) < 0) & (top > 0) & (spline(top) > 0.3 * strain[places > 0].max())]
    return top, spline(top)


@functools.cache
def stepped():
    """Return the places of the bonds from the step, their strains, and the edges of the shock."""
    law = gx.Hertz(1.0, 1.0)
    sound = lambda y: float(law.derivative(y)) ** 0.5
    sites = 2 * (int(1.15 * sound(STRAIN) * TIME) + SPARE)
    chain = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "free"), law),), sites=sites)
    problem = gx.shocks.step(chain, STRAIN)
    strain = np.asarray(problem.strain(problem.run(TIME).final.u))
    places = np.arange(strain.size) - float(problem.centre)
    top, height = crests(places, strain)
    # between the rarefaction fan, whose tail has the plateau's speed of sound, and the shock
    mean = strain[(places > 0) & (places < 0.1 * TIME)].mean()
    edges = SimpleNamespace(
        trailing_speed=2 * sound(0.0) - sound(mean),
        leading_speed=top[-1] / TIME,
        mean=mean,
        amplitude=height[-1],
    )
    return places, strain, edges


def make():
    places, strain, edges = stepped()
    ax = plt.figure(figsize=(7.2, 3.8), layout="constrained").subplots()
    gx.plots.shock(strain, edges, ax, places=places, time=TIME)
    return {"largest strain of the shock": (strain[places > 0].max(), 3.736772586, 1e-6)}


if __name__ == "__main__":
    print(*make().items(), sep="\n")
    plt.show()
