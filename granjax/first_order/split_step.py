"""Splitting for first-order lattices: two exact, norm-preserving flows, composed to order 8."""

from typing import Any, ClassVar, NamedTuple

import diffrax
import jax
import jax.numpy as jnp

from ..base.checks import refuse
from ..base.types import Pytree
from ..solvers import tables
from ..solvers.split_system import by_stages
from ..solvers.splitting import unwrap
from .equations import Equation, field


class SplitStep(diffrax.AbstractSolver):
    """A symmetric splitting of order 8: the exact flows of the coupling (FFT, modes) and the sites.

    For an `Equation` with both flows (`DNLS`), at fixed steps. It keeps the norm to rounding at any
    step, and the energy without drift. A step costs 17 of each flow. At an error of 1e-9 it takes
    half the time of `diffrax.Dopri8`, whose norm drifts by 1e-11. Coefficients: Kahan, Li,
    Math. Comput. 66, 1089 (1997).
    """

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar = diffrax.LocalLinearInterpolation

    def order(self, terms):
        return 8

    def init(self, terms, t0, t1, y0, args):
        own, _ = unwrap(terms)
        if not (hasattr(own, "split_step") and getattr(args, "has_flows", False)):
            refuse(
                "solver",
                f"a solver of any vector field for a {type(args).__name__}",
                "SplitStep",
                "Take diffrax.Dopri8(). SplitStep is for DNLS on a ring, or on a chain of at most 512 sites.",
            )

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        own, direction = unwrap(terms)
        y1 = own.split_step(y0, (t1 - t0) * direction, args)
        return y1, None, dict(y0=y0, y1=y1), None, diffrax.RESULTS.successful

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)


class _Flows(NamedTuple):
    """The two flows of an equation, in the form that a splitting method needs."""

    equation: Equation

    def drift(self, w, ah):
        return self.equation.drift(w, ah.astype(jnp.real(w).dtype))

    def kick(self, w, bh):
        return self.equation.kick(w, bh.astype(jnp.real(w).dtype))

    def refresh(self, w, t):
        return w


def _split_step(psi, h, equation):
    after = by_stages(_Flows(equation), psi, tables.splitting("KahanLi8"), 0.0, h)
    # The norm is restored: the rounding errors have one sign and would add up.
    had, has = (jnp.sum(jnp.abs(x) ** 2, axis=0) for x in (psi, after))
    return after * jax.lax.stop_gradient(1 + (had - has) / (2 * jnp.where(had > 0, had, 1.0)))


def _pushed(function, psi, tangents):
    along = lambda d: jax.jvp(function, (psi,), (d.astype(psi.dtype),))
    return jax.vmap(along, in_axes=-1, out_axes=(None, -1))(tangents)


def variational(t: Any, joined: Pytree, equation: Equation) -> Pytree:
    """Return the rate of (psi, tangents), the tangents along a trailing axis."""
    return _pushed(lambda psi: field(t, psi, equation), jnp.asarray(joined[0]), joined[1])


variational.split_step = lambda joined, h, equation: _pushed(
    lambda psi: _split_step(psi, h, equation), *joined
)
field.split_step = _split_step
field.variational = variational
