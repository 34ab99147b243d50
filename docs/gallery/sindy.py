"""Sparse identification: a force law from a list of candidates

Eight beads between walls are observed with 1 % of noise. The list of candidate terms contains powers of the strain,
contacts, dashpots and dampings. Sparse regression selects two of them, a contact of exponent 3/2 and a damping, and
gives their coefficients.

:systems: sparse identification (SINDy)
:part: Data
:number: stiffness of the contacts (scaled)
:expected: 1.3
:within: 0.1 %
:source: what the data were made with; Brunton, Proctor, Kutz, PNAS 113, 3932 (2016)
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

walls = gx.Shift(1, "fixed")
rng = np.random.default_rng(3)
chain = gx.Lattice(np.ones(8), (gx.Bond(walls, gx.Hertz(1.3)), gx.Damping(0.05)))
run = gx.simulate(chain, gx.State(np.zeros(8), rng.normal(size=8)), 30.0, save_at=301, step=0.01)
a = np.array(jax.vmap(chain.acceleration)(run.ts, run.us, run.vs))
a += 0.01 * np.sqrt(np.mean(a**2)) * rng.normal(size=a.shape)
candidates = gx.identify.library(walls)
found = gx.identify.regression(np.ones(8), candidates, run.ts, run.us, run.vs, a)
number = float(found.coefficients["[e]_+^1.5"].value)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.bar(
    range(len(candidates)),
    [found.coefficients[x].value if x in found.coefficients else 0 for x in candidates],
)
ax.set_xticks(range(len(candidates)), candidates, rotation=60, ha="right")
ax.set(ylabel="coefficient (scaled)", title=f"stiffness {number:.4f}")
