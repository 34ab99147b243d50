"""Closed forms: what theory says about a chain, without a lattice.

- `nls`: the nonlinear Schroedinger equation of wave packets in a periodic chain; its solitons and instability.
"""

from . import nls

__all__ = ["nls"]
