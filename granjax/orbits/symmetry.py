"""Symmetries of orbits, and uniform displacements that a lattice does not resist."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from ..checks import whole
from ..flow.dispatch import facts
from ..lattice import Lattice, uniform_moves
from ..types import Count, Numbers, Pytree, StateLike


class Symmetry(eqx.Module):
    r"""S of y(t0 + T) = S y(t0): displacements moved by some cells, reflected, with a sign; velocities alike.

    (S u)_n = sign u_{n - cells}, and with `mirror` first u_n -> -u_{N-1-n}: displacements along a chain turn around
    with it, so that compressions are reflected. `cells` counts places along the first axis of every field.

    `Translation(1)`, `Mirror()` and `Sign()` make one, and `a @ b` is b, then a.
    """

    cells: int = eqx.field(static=True, default=0)
    mirror: bool = eqx.field(static=True, default=False)
    sign: int = eqx.field(static=True, default=1)

    def __repr__(self) -> str:
        parts = {
            "Sign()": self.sign < 0,
            f"Translation({self.cells})": self.cells,
            "Mirror()": self.mirror,
        }
        return " @ ".join(name for name, there in parts.items() if there) or "the identity"

    @property
    def trivial(self) -> bool:
        """Whether it is the identity."""
        return self == Symmetry()

    def matrix(self, like: StateLike) -> Float[np.ndarray, "two_n two_n"]:
        """S over the raveled state, (2n, 2n); S^-1 is its transpose."""
        flat, unravel = ravel_pytree(like)
        return np.asarray(
            jax.vmap(lambda x: ravel_pytree(self(unravel(x)))[0], 1, 1)(jnp.eye(flat.size))
        )

    def __matmul__(self, other: "Symmetry") -> "Symmetry":
        turned = -other.cells if self.mirror else other.cells
        return Symmetry(self.cells + turned, self.mirror != other.mirror, self.sign * other.sign)

    def __call__(self, y: Pytree) -> Pytree:
        """S of displacements, or of a state."""

        def one(x):
            x = -x[::-1] if self.mirror else x
            return self.sign * (jnp.roll(x, self.cells, 0) if self.cells else x)

        return y if self.trivial else jax.tree.map(one, y)


def Translation(cells: Count = 1) -> Symmetry:
    """The wave reappears `cells` further on after a period: a rotating wave of a ring, or one that travels.

    **Example:**

    >>> gx.orbits.Translation(1)(jnp.array([1.0, 2.0, 3.0])).tolist()
    [3.0, 1.0, 2.0]
    """
    return Symmetry(cells=whole("cells", cells, -(2**31)))


def Mirror() -> Symmetry:
    """The motion is its own mirror image half of its full period later.

    **Example:**

    >>> gx.orbits.Mirror()(jnp.array([1.0, 2.0, 3.0])).tolist()
    [-3.0, -2.0, -1.0]
    """
    return Symmetry(mirror=True)


def Sign() -> Symmetry:
    """The motion is its own negative half of its full period later, in lattices of odd forces."""
    return Symmetry(sign=-1)


def shifts(lattice: Lattice) -> Float[jax.Array, "n k"]:
    """`uniform_moves` of a lattice, found once while it lives."""
    known = facts(lattice).known
    if "shifts" not in known:
        known["shifts"] = uniform_moves(lattice)
    return jnp.asarray(known["shifts"], lattice.dtype)


def free_moves(lattice: Lattice, symmetry: Symmetry) -> Numbers:
    """Uniform displacements that cost nothing and that S leaves alone, as columns (n, k)."""
    moves = shifts(lattice)
    return moves if symmetry.sign * (-1 if symmetry.mirror else 1) > 0 else moves[:, :0]
