r"""The nonlinear Schroedinger equation of wave packets in a periodic chain, its solitons and its instability.

A cell of P sites of mass m_j; bond j joins site j to site j+1 (the last one to the next cell) with the force
F_j(y) = K2_j y + K3_j y^2 + K4_j y^3 of the strain y_j = u_j - u_{j+1}, compression positive, as
`granjax.laws.taylor` gives them. A packet at wave number k per cell,

    y_j(n, t) = eps [s_j Y(X, T) e^{i (k n + omega t)} + c.c.] + O(eps^2),   X = eps (n - c t),  T = eps^2 t,

with c = -d omega/dk obeys

    i Y_T + nu2 Y_XX + nu3 |Y|^2 Y = 0,   nu2 = -(d^2 omega/dk^2)/2,

so that a uniform wave has the frequency omega + nu3 |eps Y|^2 (nu3 > 0: hardening). **Amplitude**: the mean of |s_j|^2
over the bonds of a cell is 1, so 2 |eps Y| is the amplitude of oscillation of a bond, in the root mean square where the
bonds of a cell differ. X counts cells. Neither enters the sign of nu2 nu3: bright solitons where it is positive, dark
ones where it is negative.

**Constant force or fixed length.** The wave also strains the chain in the mean, at second order. At constant force
this strain is free to follow the envelope. At fixed length it is zero in the mean over the chain, which changes the
frequency of a wave that fills the chain, and nothing else: what modulates it (the dip of a dark soliton, the
instability) still carries its mean strain along, and keeps the nu3 of constant force.

Source: G. Huang, B. Hu, Phys. Rev. B 57, 5746 (1998); C. Chong, P. G. Kevrekidis, Coherent Structures in Granular
Crystals (Springer, 2018). The fixed-length relation is tested against periodic orbits of rings.
"""

from .coefficients import B, Coefficients, band_edges, coefficients
from .solitons import Profile, bright, bright_profile, dark, dark_profile, growth_rate

__all__ = [
    "B", "Coefficients", "Profile", "band_edges", "bright", "bright_profile", "coefficients", "dark", "dark_profile",
    "growth_rate",
]
