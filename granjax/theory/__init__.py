"""Closed forms: what theory says about a chain, without a lattice.

- `elliptic`: Jacobi's functions and Legendre's integrals.
- `compacton`: solitary waves of continuum equations without linear sound.
- `kdv`: the Korteweg-de Vries equation of long, weak waves; solitons, periodic waves, dispersive shocks on a chain.
- `linear_shock`: steps of velocity and of strain in a linear chain.
- `localisation`: how far waves reach in a weakly disordered chain.
- `long_wave`: the long-wave equations of a chain: residuals, linear waves, the wave of the regularised one.
- `nls`: the nonlinear Schroedinger equation of wave packets in a periodic chain; its solitons and instability.
- `mittag_leffler`: of fractional relaxation.
- `restitution`: of two bodies that collide, plastic ones.
- `simple_wave`: the state behind a velocity step of any law, rarefaction fans.
- `thermal`: averages of a bond at a temperature and a pressure.
- `toda`: the Toda chain: solitons, periodic waves, dispersive shocks, eigenvalues of its Lax matrix.
- `shock_edges`: the edges of a dispersive shock of any convex law, by fitting.
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
