"""The lattice linearised about a state: the equation of its tangents, many at once in a trailing axis."""

import equinox as eqx
import jax
import jax.numpy as jnp

from ..laws import Linear
from ..strains import Pairs, Shift
from ..terms import Bond, Damping, Dashpot, Drive, Modulated, OnSite, Term, Wall


def linearised(lattice, t, u, v=None):
    r"""The lattice of small perturbations U about u(t): m U'' = (dF/du) U + (dF/dv) U'.

    A `Lattice` with the same sites and one more lane: its displacements have a trailing axis for the tangents, so
    that one evaluation serves all of them. Bonds, walls and sites become linear springs of the present stiffness
    F'(e); drives are gone; any other term is differentiated by `jax.jvp`.

    **Arguments:** `lattice`, time `t` and displacements `u`; `v`: velocities, where a force reads them other than
    linearly (zero by default).
    """
    v = jax.tree.map(jnp.zeros_like, u) if v is None else v
    terms = tuple(_linear(term, t, u, v, lattice.mass) for term in lattice.terms if not isinstance(term, Drive))
    return eqx.tree_at(lambda x: (x.mass, x.terms), lattice, (_wider(lattice.mass), terms))


def slope(law, e):
    """Stiffness F'(e), elementwise."""
    e = jnp.asarray(e)
    return jax.jvp(law.force, (e,), (jnp.ones_like(e),))[1]


def _wider(tree):
    """Arrays with a trailing axis for tangents; single numbers as they are."""
    return jax.tree.map(lambda x: x[..., None] if jnp.ndim(x) else x, tree)


def _spring(law, e):
    # not by the constructor, whose checks cost time at every step that is not compiled
    return eqx.tree_at(lambda spring: spring.stiffness, Linear(), slope(law, e)[..., None])


def _linear(term, t, u, v, mass):
    if isinstance(term, Modulated):
        return _linear(term.at(t), t, u, v, mass)
    if isinstance(term, Bond) and isinstance(term.strain_map, (Shift, Pairs)):
        return eqx.tree_at(lambda x: x.law, term, _spring(term.law, term.strain_map.strain(u)))
    if isinstance(term, OnSite):
        return eqx.tree_at(lambda x: x.law, term, _spring(term.law, u if term.field is None else u[term.field]))
    if isinstance(term, Wall):
        spring = _spring(term.law, term.compression(t, u))
        return eqx.tree_at(lambda x: (x.law, x.motion), term, (spring, None), is_leaf=lambda x: x is None)
    if isinstance(term, Damping) or isinstance(term, Dashpot) and isinstance(term.strain_map, (Shift, Pairs)):
        return _wider(term)
    return Tangent(term, t, u, v, mass)


class Tangent(Term):
    """The derivative of any term, lane by lane."""

    term: Term
    t: jax.Array
    u: object
    v: object
    mass: object

    @property
    def reads_velocity(self):
        return self.term.reads_velocity

    def force(self, t, u, v, mass):
        def push(u, v):
            return self.term.force(self.t, u, v, self.mass)

        return jax.vmap(lambda *du: jax.jvp(push, (self.u, self.v), du)[1], in_axes=-1, out_axes=-1)(u, v)
