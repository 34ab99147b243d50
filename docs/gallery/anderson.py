"""Anderson localisation: in a disordered chain every wave decays

The masses vary at random by 20 %. A wave of any frequency decays along the chain, and it decays faster the higher its
frequency; long waves reach furthest. If neighbouring masses deviate in opposite directions, long waves reach further
still. The lines are the theory of weak disorder.

:systems: Anderson localisation
:part: Disorder and losses
:number: inverse localisation length at omega = 0.5, uncorrelated masses (1/site)
:expected: 1.33333e-3
:within: 3 %
:source: <dm^2> omega^2/(8 (1 - omega^2/4)); Ishii, Prog. Theor. Phys. Suppl. 53, 77 (1973); three standard errors
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import granjax as gx


def chain(seed, correlation="none"):
    return gx.scenes.disordered(
        10000, 0.2, seed, law=gx.Linear, distribution="binary", correlation=correlation
    )


omega = np.linspace(0.3, 1.8, 7)
fine = np.linspace(0.2, 1.9, 100)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
for correlation, c in (("none", []), ("opposite", [-0.5])):
    chains = jax.vmap(lambda n: chain(n, correlation), out_axes=-1)(np.arange(16))
    found = gx.linear.localisation_length(chains, omega)
    line = ax.errorbar(
        omega, found.gamma, found.error, fmt="o", ms=4, label=f"correlation: {correlation}"
    )
    known = gx.theory.localisation.lyapunov_exponent(fine, mass_deviation=0.2, correlations=c)
    ax.semilogy(fine, known, color=line[0].get_color())
many = jax.vmap(chain, out_axes=-1)(np.arange(1000))
number = float(gx.linear.localisation_length(many, [0.5]).gamma[0])
ax.set(
    xlabel=r"angular frequency $\omega$ (scaled)",
    ylabel=r"1/localisation length (1/site)",
    ylim=(1e-5, 0.2),
)
ax.legend()
