"""Dynamic modes: frequencies of a chain from two of its masses

A Su-Schrieffer-Heeger chain moves at random, and only the first masses of two cells are observed. Without a model,
dynamic mode decomposition of the delayed snapshots by PyDMD finds all twenty frequencies. These include the two
frequencies in the gap, which differ by a thousandth.

:systems: dynamic mode decomposition
:part: Data
:number: square of the lower gap frequency (k/m)
:expected: 2.99853515
:within: 1e-8
:source: closed form of the open chain; Arbabi, Mezic, SIAM J. Appl. Dyn. Syst. 16, 2096 (2017)
"""

import matplotlib.pyplot as plt
import numpy as np
from pydmd import DMD
from pydmd.preprocessing import hankel_preprocessing

import granjax as gx

chain = gx.scenes.ssh(10, 1.0, 2.0)
run = gx.simulate(
    chain, gx.states.random(chain, seed=0), 120.0, save_at=401, solver=gx.SRKN14a(), step=0.05
)
seen = np.asarray(run.us["a"])[:, :2]
# snapshots along the last axis, each stacked with the next 149; twenty frequencies need forty modes
found = hankel_preprocessing(DMD(svd_rank=40, exact=True), d=150).fit(seen.T)
omega = np.log(found.eigs).imag / 0.3
omega = np.sort(omega[omega > 1e-3])
number = float(omega[9] ** 2)
known = gx.linear.normal_modes(chain).omega
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.plot(known, "ko", mfc="none", ms=9, label="modes of the chain")
ax.plot(omega, "C3.", label="from two traces")
ax.set(xlabel="mode", ylabel=r"$\omega$ (scaled)")
ax.legend()
