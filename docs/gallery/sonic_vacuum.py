"""A struck chain without precompression: one solitary wave

In a chain of beads that barely touch there is no sound. A blow on the first bead becomes a single solitary wave about
five beads wide, which carries 99.4 % of the energy. The beads behind it separate.

:systems: granular chain in a sonic vacuum
:part: Travelling waves
:number: largest force in contact 40, in units (A^2 m^3 v^6)^(1/5) of the blow
:expected: 0.63955423
:within: 1e-6
:source: Nesterenko, J. Appl. Mech. Tech. Phys. 24, 733 (1983); the value by DOP853 at 1e-13
"""

import matplotlib.pyplot as plt

import granjax as gx

chain = gx.scenes.monomer(60, boundary="free")
run = gx.simulate(
    chain,
    gx.states.impact(chain, velocity=1.0),
    60.0,
    tolerance=1e-9,
    save_at=201,
    record={"force": gx.Peak(gx.measures.contact_force)},
)
number = float(run.recorded["force"][40])
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.space_time(run, ax)
ax.set_title(f"force plateau {number:.6f}")
