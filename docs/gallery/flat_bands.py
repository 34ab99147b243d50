"""Flat bands of chains: sawtooth, stub and diamond

If the contributions of two paths to a site cancel, a wave cannot leave. One band is then flat, and its energy stays on
two or three sites. Lines are the bands of the spring chains, dots the closed forms Omega^2 - E of the hopping models.

:systems: flat bands of chains
:part: Topology and flat bands
:number: largest distance of omega^2 of the eight bands from the closed forms (k/m)
:expected: 0
:within: 1e-12
:source: E = -2, 2 + 2 cos k; 0, +-(3 + 2 cos k)^(1/2); 0, +-8^(1/2) cos(k/2): Leykam et al., Adv. Phys. X 3 (2018)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

k = np.linspace(0, np.pi, 41)
flat = 0 * k
root = np.sqrt(3 + 2 * np.cos(k))
known = {
    "sawtooth": 2 + 8**0.5 - np.stack([2 + 2 * np.cos(k), flat - 2], 1),
    "stub": 3 - np.stack([root, flat, -root], 1),
    "diamond": 4 - np.sqrt(8) * np.stack([np.cos(k / 2), flat, -np.cos(k / 2)], 1),
}
figure, axes = plt.subplots(1, 3, figsize=(5.4, 2.8), layout="constrained", sharex=True)
number = 0.0
for (name, squared), ax in zip(known.items(), axes):
    lattice = getattr(gx.scenes, name)(8)
    found = np.asarray(gx.linear.dispersion(lattice, k).omega_squared)
    number = max(number, float(np.abs(found - squared).max()))
    ax.plot(k, found, color="0.6")
    ax.plot(k, np.full_like(k, gx.linear.flat_bands(lattice).omega_squared[0]), color="C3", lw=2)
    ax.plot(k[::5], squared[::5], "k.", ms=4)
    ax.set(title=name, xlabel="k (rad/cell)", ylim=(0, 7.2))
axes[0].set_ylabel(r"$\omega^2$ (scaled)")
