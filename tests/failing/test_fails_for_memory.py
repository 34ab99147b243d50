"""Forces that read the past: a history cut short, and a largest overlap looked up at the ends of steps alone."""

from math import gamma

import numpy as np

import granjax as gx

ORDER = 0.5
T = 40.0


def relaxed(steps, window):
    """D^a y = -y by the L1 scheme with equal steps, whose history goes back a time `window`."""
    h = T / steps
    kept = round(window / h)
    powers = np.arange(0.0, steps + 1) ** (1 - ORDER)
    b = np.diff(powers)
    unit = h**-ORDER / gamma(2 - ORDER)
    y = np.ones(steps + 1)
    for n in range(1, steps + 1):
        past = np.diff(y[max(n - kept, 0) : n])[::-1]
        y[n] = unit * (y[n - 1] - b[1 : past.size + 1] @ past) / (unit + 1)
    return y[-1]


def relax(t, y, args):
    return -y


def test_a_history_cut_short():
    """The short-memory principle: what it leaves out decays as slowly as the solution, at any step."""
    true = float(gx.theory.mittag_leffler(-(T**ORDER), ORDER))
    cut, whole = (
        [abs(relaxed(steps, window) / true - 1) for steps in (400, 1600)] for window in (T / 10, T)
    )
    # a tenth of the history: wrong by half, and no better with a quarter of the step
    assert min(cut) > 0.4 and abs(cut[1] - cut[0]) < 0.1 * cut[0]
    assert whole[1] < whole[0] / 3.5 and whole[1] < 2e-3
    run = gx.caputo(relax, 1.0, T, order=ORDER, steps=400)
    assert abs(run.ys[-1] / true - 1) < 1e-4 and abs(run.ys[-1] - true) < run.error


def bounced(steps):
    """The energy that a plastic impact loses beyond its history, by Verlet and the largest overlap at ends of steps."""
    k1 = 1.0
    k2 = 3.0
    h = 6.0 / steps
    s = 0.0
    v = 1.0
    largest = 0.0
    force = 0.0
    for _ in range(steps):
        v -= h / 2 * force
        s += h * v
        largest = max(largest, s)
        force = k2 * max(s - (1 - k1 / k2) * largest, 0.0)
        v -= h / 2 * force
    lost = k1 / 2 * (1 - k1 / k2) * largest**2
    return abs(v * v / 2 + lost - 0.5) / 0.5


def test_a_largest_overlap_at_the_ends_of_steps():
    """Where a contact turns within a step and where it opens, energy goes astray: of the order of the step's square."""
    assert bounced(100) > 1e-4 and bounced(1000) > 1e-8
    contact = gx.PlasticContact(gx.Shift(1, "free"), gx.WaltonBraun(1.0, 3.0))
    lattice = gx.Lattice(2.0, contact, sites=2)
    run = gx.simulate(lattice, gx.states.impact(lattice), 9.0)
    assert run.energy_error < 1e-9 and run.stats["steps"] < 150
