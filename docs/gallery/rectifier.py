"""A rectifier: what passes from left and from right is not the same

A chain of steel beads under load has a smaller second bead. It is driven from either wall in the gap, just below the
mode of this defect. A weak drive is transmitted equally in both directions, by reciprocity; the difference grows as the
square of the amplitude. From the defect's side the drive excites the mode directly. The orbit of the mode loses
stability, and then emits low frequencies that pass through the band.

:systems: rectifier
:part: Devices
:number: log-log slope of the difference over the drive's amplitude, six beads, 0.1 to 1 nm
:expected: 2.0
:within: 2 %
:source: third order of the forces; Rayleigh, The Theory of Sound, 107; Boechler et al., Nature Mater. 10, 665 (2011)
"""

from functools import partial

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx


def with_defect(sites):
    radii = np.full(sites, 9.53e-3)
    radii[1] = 7e-3
    chain = gx.scenes.beads("steel 316", radii, 8.0)
    return chain, np.asarray(gx.linear.normal_modes(chain).omega)


def driven(chain, omega, end, amplitude):
    return gx.driven.driven_chain(chain, amplitude, omega, ends=end, damping=1 / 1.75e-3)


def passed(chain, omega, end, amplitude, steps=96):
    """Return the amplitude at omega of the force on the wall at rest while the other wall moves."""
    lattice = driven(chain, omega, end, amplitude)
    wall = {"left": 2, "right": 1}[end]
    run = gx.forced.forced_orbit(lattice, 2 * np.pi / omega, steps=steps).run(64)
    force = gx.measures.along(gx.measures.contact_force, lattice, run, bond=wall)
    return 2 * abs(np.mean(np.ravel(force) * np.exp(-2j * np.pi * np.arange(64) / 64)))


short, modes = with_defect(6)
amplitudes = np.array([1e-11, 1e-10, 1e-9])
left, right = (
    [passed(short, 0.98 * modes[-1], end, a) for a in amplitudes] for end in ("left", "right")
)
apart = np.abs(np.array(left) / right - 1)
number = float(np.log10(apart[2] / apart[1]))
assert apart[0] < 1e-8


def power(beyond, lattice, u, v, t):
    """Return the mean power that the beads `beyond` dissipate."""
    return jnp.mean(jnp.sum((lattice.mass * v * v)[:, beyond], 1)) / 1.75e-3


long, modes = with_defect(20)
omega = 0.98 * modes[-1]
period = 2 * np.pi / omega
drives = np.linspace(0.05e-6, 0.35e-6, 7)
how = {"down": False, "jump": 0.5, "accuracy": 0.01, "periods": 1500, "watch": 60}
near, far = (
    gx.driven.response(
        partial(driven, long, omega, end), drives, period, response=partial(power, beyond), **how
    ).up
    for end, beyond in (("left", slice(10, 20)), ("right", slice(0, 10)))
)
from_left = partial(driven, long, omega, "left")
branch = gx.forced.forced_branch(
    from_left, 0.16e-6, 0.19e-6, period=period, transient=600, arclength=0.5
)
(onset,) = branch.bifurcations
(ceased,) = [x.p for x in near.bifurcations if x.before == 1][:1]
assert onset.kind == "Neimark-Sacker" and abs(onset.p / 0.17919e-6 - 1) < 1e-4
# settling finds this onset too; from the other side all motions repeat; milliwatts against femtowatts
assert (
    abs(ceased / onset.p - 1) < 0.02 and (far.multiple == 1).all() and modes[-2] < omega < modes[-1]
)
assert near.response[-2:].min() > 1e-4 and far.response.max() < 1e-13
axes = plt.subplots(1, 2, figsize=(7.0, 3.2), layout="constrained")[1]
axes[0].loglog(1e9 * amplitudes, apart, "o", label="left against right")
axes[0].loglog(1e9 * amplitudes, apart[2] * (amplitudes / 1e-9) ** 2, "k:", label="$a^2$")
axes[0].set(xlabel="amplitude of the drive (nm)", ylabel="relative difference of what passes")
for way, name in ((near, "from the defect's side"), (far, "from the other side")):
    axes[1].semilogy(1e6 * drives, way.response, "o-", label=name)
axes[1].axvline(1e6 * onset.p, color="0.6", ls="--", label=r"$|\rho| = 1$")
axes[1].set(xlabel=r"amplitude of the drive ($\mu$m)", ylabel="transmitted power (W)")
for ax in axes:
    ax.legend()
