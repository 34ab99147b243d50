"""Closed forms: what theory says about a chain, without a lattice.

- `elliptic`: Jacobi's functions and Legendre's integrals.
- `nls`: the nonlinear Schroedinger equation of wave packets in a periodic chain; its solitons and instability.
"""

from . import elliptic, nls

__all__ = ["elliptic", "nls"]
