"""Sound in a thermal chain: fluctuations run with the adiabatic speed

In a chain in thermal equilibrium the correlation of strains has two peaks. They move with the speed of sound at the
given temperature and pressure, and widen like t^(2/3), as for the Kardar-Parisi-Zhang equation. With this scaling the
peaks at late times approach one shape.

:systems: FPUT chain
:part: Thermal chains and chaos
:number: speed of the peaks, V(r) = r^2/2 + 2 r^3/3 + r^4/4 of the stretch r at k_B T = 1/2 and pressure 1
:expected: 1.454680309
:within: 2 %
:source: quadrature, gx.theory.thermal.bond_state; H. Spohn, J. Stat. Phys. 154, 1191 (2014)
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

law = gx.Polynomial(1.0, -2.0, 1.0)
T = 0.5
N = 320
bond = gx.theory.thermal.bond_state(law, T, 1.0)
# a ring has a fixed length, so the law is expanded about its mean compression
e = float(bond.strain)
about = gx.Polynomial(1 - 4 * e + 3 * e * e, -2 + 3 * e, 1.0)


def ring(mass):
    return gx.Lattice(mass, (gx.Bond(gx.Shift(1, "periodic"), about),), sites=N)


rings = jax.vmap(ring, out_axes=-1)(jnp.ones(48))
state = gx.states.gibbs(rings, T, seed=1)
run = gx.simulate(rings, state, 2000.0, step=0.2, save_at=1001)
# a ring keeps the sum of its strains, which lowers the correlation by a constant
held = float(bond.strain_variance) / N
found = gx.measures.correlation(run.us - jnp.roll(run.us, -1, 1), dt=2.0, lags=39)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
c = float(bond.sound_speed)
speeds = []
for lag in (15, 20, 26, 32, 38):
    t = float(found.lag[lag])
    right = np.asarray(found.offset) > c * t / 2
    place = np.asarray(found.offset)[right]
    value = np.asarray(found.value[lag])[right] + held
    # the vertex of the parabola through the upper third of the peak
    bend, slope, _ = np.polyfit(place, value, 2, w=value > 0.67 * value.max())
    speeds.append(-slope / (2 * bend) / t)
    ax.plot((place - c * t) / t ** (2 / 3), t ** (2 / 3) * value, label=f"t = {t:.0f}")
number = np.mean(speeds)
ax.set(xlim=(-3, 3), xlabel="$(j - c t)/t^{2/3}$", ylabel="$t^{2/3}$ correlation of strains")
ax.legend()
