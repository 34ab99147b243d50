"""A woodpile with losses: wave numbers of given frequencies

In the gap above a rod's resonance every wave decays within some rods. With losses, waves of all frequencies decay; here
the losses are viscoelastic, with the memory of `gx.CaputoDamping`. At the resonance a wave decays within one rod.

:systems: woodpile chain
:part: Disorder and losses
:number: decay of a wave at omega = 1 over one rod
:expected: 0.0130423
:within: 1e-6
:source: cos k = 1 + (c (-i omega)^a - m(omega) omega^2)/(2 K2), m = 1 + mu kappa/(kappa - mu omega^2)
"""

import equinox as eqx
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

plain = gx.scenes.woodpile(20, [0.3], [0.5], precompression=1.0)
losses = gx.CaputoDamping(0.05, 0.5, field="bead")
damped = eqx.tree_at(lambda lattice: lattice.terms, plain, (*plain.terms, losses))
omega = np.linspace(0.05, 3.2, 316)
number = float(gx.linear.complex_bands(damped, 1.0).decay[0])
figure, (ax, beside) = plt.subplots(1, 2, sharey=True, width_ratios=(3, 1), figsize=(6.4, 4.0))
gx.plots.complex_bands(gx.linear.complex_bands(damped, omega), ax)
density = gx.linear.density_of_states(plain, bins=160)
beside.plot(density.density, density.omega, color="0.4")
beside.set(xlabel="density of states", xlim=(0, 8))
