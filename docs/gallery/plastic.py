"""Contacts that yield: how fast two beads part

Spheres that yield keep a dent, and so separate more slowly than they approached. Below the speed at which they first
yield the coefficient of restitution is 1. Far above it the coefficient decreases as v^(-1/4), Thornton's law.

:systems: dissipation and plastic contacts
:part: Disorder and losses
:number: restitution at ten times the speed of first yield
:expected: 0.6585583367
:within: 1e-8
:source: (6 sqrt3/5)^(1/2) (1 - r^2/6)^(1/2) (r/(r + 2 sqrt(6/5 - r^2/5)))^(1/4), r = 1/10; Thornton (1997)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

stiffness = 1.0
yields = 0.02
first = np.sqrt(8 * stiffness * yields**2.5 / 5)
pair = gx.Lattice(
    1.0, gx.PlasticContact(gx.Shift(1, "free"), gx.Thornton(stiffness, yields)), sites=2
)
speeds = first * np.array([0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 100.0])
found = []
for speed in speeds:
    run = gx.simulate(pair, gx.states.impact(pair, velocity=speed), 20 * speed**-0.5 + 5)
    found.append(float(run.final.v[1] - run.final.v[0]) / speed)
number = found[4]
fine = first * np.geomspace(0.3, 200, 200)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.loglog(fine / first, gx.theory.restitution.thornton(fine, first), "k-", lw=1, label="Thornton")
ax.loglog(speeds / first, found, "o", label="simulated")
ax.set(xlabel="speed of impact over that of first yield", ylabel="restitution")
ax.legend()
