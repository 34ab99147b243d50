"""Closed-form results of theory, which need no lattice.

- `elliptic`: Jacobi's elliptic functions and Legendre's integrals.
- `compacton`: solitary waves of continuum equations without linear sound.
- `kdv`: the Korteweg-de Vries equation of long, weak waves: solitons, periodic waves, shocks.
- `linear_shock`: steps of velocity and of strain in a linear chain.
- `localisation`: the localisation length of waves in a weakly disordered chain.
- `long_wave`: long-wave equations of a chain: residuals, linear waves, a solitary wave.
- `nls`: the nonlinear Schroedinger equation of wave packets: solitons, modulational instability.
- `mittag_leffler`: the Mittag-Leffler function of fractional relaxation.
- `restitution`: coefficients of restitution of two colliding bodies.
- `simple_wave`: the state behind a velocity step for any law, and rarefaction fans.
- `thermal`: averages of a bond at a temperature and a pressure.
- `toda`: the Toda chain: solitons, periodic waves, dispersive shocks, Lax eigenvalues.
- `shock_edges`: the edges of a dispersive shock for any convex law, by fitting.
"""

from . import (
    compacton,
    elliptic,
    kdv,
    linear_shock,
    localisation,
    long_wave,
    nls,
    restitution,
    simple_wave,
    thermal,
    toda,
)
from .fitting import FittedEdges, shock_edges
from .relaxation import mittag_leffler

__all__ = [
    "FittedEdges",
    "compacton",
    "elliptic",
    "kdv",
    "linear_shock",
    "localisation",
    "long_wave",
    "mittag_leffler",
    "nls",
    "restitution",
    "shock_edges",
    "simple_wave",
    "thermal",
    "toda",
]
