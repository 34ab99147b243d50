"""A topological edge state that bends with its amplitude

The springs of a Su-Schrieffer-Heeger chain harden with the cube of their strain, and the chain has one state, at its
left end. The backbone curve of this state (line) is where the family of breathers (dots) starts, which crosses the gap
towards the upper band. The Floquet multipliers of the last breather tell whether it is stable.

:systems: nonlinear topological edge states
:part: Topology and flat bands
:number: d omega^2 / d a^2 of the edge state, springs k y + c y^3 with k = 1, 2 and c = 0.5, 1
:expected: 0.9
:within: 1e-5
:source: (3/4) (c1 + c2)/(1 + (k1/k2)^2), first order in the mode a_n = (-k1/k2)^n of a half-infinite chain
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

last = np.r_[np.full(10, 2.0), 1.0]  # a soft spring at the right wall: no state there
chain = gx.scenes.ssh(10, law=[gx.Polynomial(1.0, 0.0, 0.5), gx.Polynomial(last, 0.0, last / 2)])
edge = gx.breathers.backbone(chain, 10)
number = float(edge.curvature)
branch = gx.breathers.family(chain, mode=10, until=1.95, points=20, arclength=0.2)
figure, (left, right) = plt.subplots(
    1, 2, figsize=(5.4, 3.0), width_ratios=(3, 2), layout="constrained"
)
a = np.linspace(0, 1.2, 50)
left.plot(a, [edge.omega_at(x) for x in a], label="backbone")
left.plot(branch.amplitude, branch.omega, "o", ms=4, label="breathers")
left.text(0.05, 2.01, "waves")
left.axhspan(2.0, 2.1, color="0.8")
left.set(xlabel="amplitude (scaled)", ylabel="angular frequency (scaled)", ylim=(1.7, 2.04))
left.legend(loc="lower right")
turn = np.exp(1j * np.linspace(0, 2 * np.pi, 200))
rho = np.asarray(branch.multipliers[-1])
right.plot(turn.real, turn.imag, color="0.7")
right.plot(rho.real, rho.imag, ".")
right.set(
    title=f"multipliers: {branch.verdict[-1]}",
    xlabel=r"Re $\rho$",
    ylabel=r"Im $\rho$",
    aspect="equal",
)
ax = left
