"""Steel beads in SI: a blow of 0.1 m/s and its force

Forty steel beads of 9.53 mm radius touch without load, and the first is struck at 0.1 m/s. The force that travels along
the chain follows from the elastic constants alone: F = 0.63955 (A^2 m^3 v^6)^(1/5).

:systems: materials and beads in SI
:part: Travelling waves
:number: largest force in contact 30, in newton
:expected: 47.76769
:within: 0.0005
:source: A = E (2R)^(1/2)/(3 (1 - nu^2)), m = (4/3) pi R^3 rho of steel 316; Nesterenko (2001)
"""

import matplotlib.pyplot as plt

import granjax as gx

chain = gx.scenes.beads("steel 316", 9.53e-3, cells=40, boundary="free")
run = gx.simulate(
    chain,
    gx.states.impact(chain, velocity=0.1),
    1.7e-3,
    tolerance=1e-9,
    save_at=201,
    record={"force": gx.Peak(gx.measures.contact_force)},
)
number = float(run.recorded["force"][30])
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.space_time(run, ax)
ax.set_title(f"{number:.3f} N at contact 30")
