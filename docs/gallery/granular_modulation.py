"""Waves inside a granular shock, from Whitham's equations for the contact law

Between its edges a dispersive shock is a train of periodic waves that changes slowly. The lines are the solution of
Whitham's modulation equations for the waves of the contact law itself, obtained without a closed form. The dots are
measured in windows of a chain, and approach the lines like 1/t.

:systems: granular dispersive shock
:part: Shocks
:number: speed of the trailing edge at c = 0.5, overlap 1/2, sound 1; fitting says 0.715
:expected: 0.7806
:within: 0.0022
:source: measured of a chain at t = 4000
"""

import matplotlib.pyplot as plt

import granjax as gx

law = gx.Hertz(2 * 2**0.5 / 3, precompression=1 / 3)
theory = gx.shocks.whitham(law, 0.5)
number = theory.trailing_speed
chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), law), sites=620)
# a piston produces one half of the shock of two colliding half-chains
run = gx.shocks.piston(chain, 1.0).run(500.0)
measured = gx.shocks.measure(run)
ax, axes = plt.subplots(1, 2, figsize=(7.2, 3.2), layout="constrained")
for one, quantity in zip(axes, ("amplitude", "wavelength")):
    gx.plots.modulation(measured, one, quantity=quantity, beside={"Whitham": theory})
axes[1].set_ylim(3, 12)
