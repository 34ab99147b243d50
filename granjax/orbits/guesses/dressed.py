"""Chains of equal sites that carry linear resonators: what the envelope equation needs of them."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...lattice import Lattice, State
from ...laws import Law, taylor
from ...linear.cell import unit_cell
from ...theory import nls

# relative differences that are rounding; sizes of displacements at which forces are asked whether they are linear
ROUNDING, SIZES = 1e-9, 10.0 ** np.arange(-9, 4, 3)


class Dressed(NamedTuple):
    """A chain of one field that linear resonators dress: 4 K2 sin^2(k/2) = G(omega^2), G(x) = x times a mass.

    With `tie` the stiffness of all but the chain's own bonds over the fields, and its parts b (the chain) and r,
    G(x) = x m - tie_bb + tie_br (tie_rr - x mu)^{-1} tie_rb.
    """

    field: str
    fields: tuple[str, ...]
    law: Law
    boundary: str
    mass: np.ndarray
    tie: np.ndarray
    tops: np.ndarray

    def _parts(self, x):
        """What the other fields answer to a displacement 1 of the chain's at omega^2 = x, and which they are."""
        b = self.fields.index(self.field)
        r = [i for i in range(len(self.fields)) if i != b]
        return (
            b,
            r,
            -np.linalg.lstsq(
                self.tie[np.ix_(r, r)] - x * np.diag(self.mass[r]), self.tie[r, b], rcond=None
            )[0],
        )

    def excess(self, x: float) -> float:
        """G at omega^2 = x."""
        b, r, answer = self._parts(x)
        return x * self.mass[b] - self.tie[b, b] - self.tie[b, r] @ answer

    def slope(self, x: float) -> float:
        """dG/dx, above zero."""
        b, r, answer = self._parts(x)
        return self.mass[b] + answer @ (self.mass[r] * answer)

    def coefficients(self, branch: int, constraint: str = "force") -> nls.Coefficients:
        """The envelope's at k = pi, where the second harmonic strains no bond: those of the chain, over dG/d omega."""
        m = self.mass[self.fields.index(self.field)]
        c = nls.coefficients(m, *(np.ravel(x)[:1] for x in taylor(self.law)), np.pi, 0, constraint)
        omega = self.tops[branch]
        ratio = m * c.omega / (omega * self.slope(omega**2))
        scaled = (ratio * x for x in (c.nu2, c.nu3, c.nu3_force, c.group_velocity))
        return eqx.tree_at(
            lambda c: (c.omega, c.nu2, c.nu3, c.nu3_force, c.group_velocity),
            c,
            (jnp.asarray(omega), *scaled),
        )

    def state(self, profile: nls.Profile) -> State:
        """A breather of the chain's field and what the others do, at rest."""
        drift = -jnp.append(0, jnp.cumsum(profile.mean_strain)[:-1])
        mean = drift - jnp.mean(drift)
        _, r, answer = self._parts(float(profile.omega) ** 2)
        swing = profile.displacement - mean
        u = {self.field: profile.displacement}
        u |= {self.fields[i]: mean + a * swing for i, a in zip(r, answer)}
        return State(u, jax.tree.map(jnp.zeros_like, u))


def dressed(lattice: Lattice) -> Dressed | None:
    """The chain of a lattice of several fields, or `None` where it is no uniform one with free linear resonators."""
    if not lattice.fields or lattice.axes != 1 or lattice.dimension:
        return None
    found = [
        (i, name, *bonds)
        for i, term in enumerate(lattice.terms)
        for name in lattice.fields
        if (bonds := term.next_neighbours(name)) is not None
    ]
    try:
        cell = unit_cell(lattice)
    except ValueError:
        return None
    if len(found) != 1 or cell.cell != (1,):
        return None
    (own, field, law, boundary), fields = found[0], tuple(sorted(lattice.fields))
    coefficients = [np.asarray(x) for x in taylor(law)]
    if not np.all(coefficients[0] > 0) or any(
        np.ptp(x) > ROUNDING * np.abs(x).max() for x in coefficients
    ):
        return None
    if not _linear(
        eqx.tree_at(lambda x: x.terms, lattice, lattice.terms[:own] + lattice.terms[own + 1 :])
    ):
        return None
    mass, b = np.asarray(cell.mass), fields.index(field)
    tie = np.asarray(cell.coupling)[cell.shells.index((0,))] * np.sqrt(mass[:, None] * mass)
    K2 = float(np.ravel(coefficients[0])[0])
    tie[b, b] -= 2 * K2
    squares = np.linalg.eigvalsh(np.asarray(cell.dynamical_matrix(np.array([np.pi]))))
    chain = Dressed(field, fields, law, boundary, mass, tie, np.sqrt(np.maximum(squares, 0)))
    free = np.abs(chain.excess(0.0)) <= ROUNDING * K2
    return chain if free else None


def _linear(rest):
    """Whether forces are linear in the displacements, at all sizes."""
    rng, zero = np.random.default_rng(0), rest.zeros()
    u = jax.tree.map(lambda s: jnp.asarray(rng.uniform(-1, 1, s.shape), s.dtype), rest.template())
    force = jax.vmap(lambda size: rest.force(0.0, jax.tree.map(lambda x: size * x, u), zero))
    for once, twice in zip(
        *(jax.tree.leaves(force(jnp.asarray(sizes))) for sizes in (SIZES, -2 * SIZES))
    ):
        once, twice = np.asarray(once), np.asarray(twice)
        if np.any(np.abs(twice + 2 * once).max(1) > ROUNDING * np.abs(once).max(1)):
            return False
    return True
