"""One Hertz chain between rigid walls in plain numbers, as the peers take it."""

from typing import NamedTuple

import numpy as np

SPLITTING = ("VelocityVerlet", "SRKN6b", "SRKN11b", "SRKN14a", "KahanLi8", "SofroniouSpaletta10")


class Unfit(Exception):
    """A peer that cannot do this chain, or is not there; the message says why."""


class Chain(NamedTuple):
    """m u_n'' = F_n - F_{n+1}, F_n = A [d0 + u_{n-1} - u_n]_+^{3/2} - F0, from (u, v) at time 0 to t1.

    - `u`, `v`: (N,), or (N, B) for B chains of the same contacts. `inverse_mass`: a number, or (N, B).
    - `stiffness`, `overlap`, `force`: A, d0 and F0. `closed`: whether no contact ever opens.
    - `lattice`, `state`: the same for granjax and diffrax.
    """

    lattice: object
    state: object
    t1: float
    closed: bool
    u: np.ndarray
    v: np.ndarray
    inverse_mass: object
    stiffness: float
    overlap: float
    force: float

    @classmethod
    def of(cls, lattice, state, t1, closed):
        """The numbers of a lattice whose only term is a Hertz bond, alike everywhere, between rigid walls.

        **Raises** `Unfit` for other contacts or ends.
        """
        (bond,) = lattice.terms
        if set(bond.strain_map.boundary) != {"fixed"}:
            raise Unfit("no rigid walls")
        law = bond.law
        A = _one(law.stiffness)
        F0 = _one(0.0 if law.precompression is None else law.precompression)
        u, v = (np.array(x, order="C") for x in state)
        mass = np.asarray(lattice.mass)
        inverse = 1 / float(mass) if mass.ndim == 0 else np.broadcast_to(1 / mass, u.shape)
        return cls(lattice, state, float(t1), closed, u, v, inverse, A, (F0 / A) ** (2 / 3), F0)

    @property
    def batch(self):
        """Whether there are many."""
        return self.u.ndim == 2

    def single(self, peer):
        """The chain itself. **Raises** `Unfit` where there are many, or masses differ."""
        if self.batch or not isinstance(self.inverse_mass, float):
            raise Unfit(f"{peer} takes one chain of equal beads here")
        return self


def _one(x):
    """The number of which an array is full."""
    low = float(np.min(x))
    high = float(np.max(x))
    if low != high:
        raise Unfit("contacts that differ")
    return low
