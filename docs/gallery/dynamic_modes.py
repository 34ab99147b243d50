"""Dynamic modes: frequencies of a chain from two of its masses

A chain of Su, Schrieffer and Heeger swings at random, and the first masses of two cells are watched. Without any
model the decomposition of the delayed snapshots finds all twenty frequencies, with the two in the gap, which are a
thousandth apart.

:systems: dynamic mode decomposition
:part: Data
:number: square of the lower gap frequency (k/m)
:expected: 2.99853515
:within: 1e-8
:source: closed form of the open chain; Arbabi, Mezic, SIAM J. Appl. Dyn. Syst. 16, 2096 (2017)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.scenes.ssh(10, 1.0, 2.0)
run = gx.simulate(
    chain, gx.states.random(chain, seed=0), 120.0, save_at=401, solver=gx.SRKN14a(), step=0.05
)
seen = gx.identify.snapshots(run)[:, :2]
found = gx.identify.dmd(seen, 0.3, delays=150)
omega = np.sort(found.omega.imag[found.omega.imag > 1e-3])
number = float(omega[9] ** 2)
known = gx.linear.normal_modes(chain).omega
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.plot(known, "ko", mfc="none", ms=9, label="modes of the chain")
ax.plot(omega, "C3.", label="from two traces")
ax.set(xlabel="mode", ylabel=r"$\omega$ (scaled)")
ax.legend()
