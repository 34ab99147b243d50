"""Closed forms: what theory says about a chain, without a lattice.

- `elliptic`: Jacobi's functions and Legendre's integrals.
- `compacton`: solitary waves of continuum equations without linear sound.
- `kdv`: the Korteweg-de Vries equation of long, weak waves; solitons and periodic waves on a chain.
- `nls`: the nonlinear Schroedinger equation of wave packets in a periodic chain; its solitons and instability.
- `toda`: the Toda chain: solitons, periodic waves, eigenvalues of its Lax matrix.
"""

from . import compacton, elliptic, kdv, nls, toda

__all__ = ["compacton", "elliptic", "kdv", "nls", "toda"]
