"""Symplectic splitting methods as diffrax solvers.

The equation is m a = F(t, u), H = T(v) + V(t, u). One step composes the two exact flows, kick
(v += b h a) and drift (u += a h v), with a table of coefficients. A solver works on a *split
system*, which the vector field offers as `split_system(args)`, or as `in_blocks(args, y)` if it
takes whole steps; any other f(t, (u, v), args) = (v, a(t, u)) gets `FieldSplit`.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

import diffrax
import jax.numpy as jnp
import numpy as np

from ..base.types import Number
from . import tables
from .interpolation import QuinticHermite
from .split_system import FieldSplit, by_stages
from .stability import stability_limit


def unwrap(terms: Any) -> tuple[Callable, Number]:
    """Return the vector field inside diffrax's terms, and the direction of time around it."""
    direction = 1
    while hasattr(terms, "term"):
        direction = direction * terms.direction
        terms = terms.term
    return terms.vector_field, direction


def offered(terms: Any, args: Any) -> tuple:
    """Return the split system of the vector field inside diffrax's terms, and that direction."""
    field, direction = unwrap(terms)
    offer = getattr(field, "split_system", None)
    return (FieldSplit(field, args) if offer is None else offer(args)), direction


class Tabulated(diffrax.AbstractSolver):
    """A method with a table of coefficients."""

    term_structure: ClassVar = diffrax.AbstractTerm

    @classmethod
    def stability_limit(cls) -> float | None:
        """Largest h omega of a stable step on u'' = -omega^2 u: `granjax.solvers.stability`."""
        return stability_limit(cls)

    def order(self, terms):
        return self.table().order

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)


class AbstractSplitting(Tabulated):
    """A symmetric composition of kicks and drifts; a subclass adds a name and a table."""

    interpolation_cls: ClassVar = QuinticHermite

    @classmethod
    def table(cls) -> tables.Splitting:
        """The method's coefficients, `granjax.solvers.tables.Splitting`."""
        return tables.splitting(cls.__name__)

    @classmethod
    def evaluations(cls) -> Number:
        """Force evaluations per step; the last kick's force is reused by the next step."""
        return int(np.count_nonzero(cls.table().b)) - (cls.table().b[0] != 0)

    def _system(self, terms, args, y):
        system, direction = offered(terms, args)
        whole = getattr(unwrap(terms)[0], "in_blocks", lambda args, y: None)
        return whole(args, y) or system, direction

    def init(self, terms, t0, t1, y0, args):
        system, direction = self._system(terms, args, y0)
        return system.start(t0 * direction, y0)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        # These methods take fixed steps only, and their controllers report no jump, so the kept
        # force is never stale.
        del made_jump
        system, direction = self._system(terms, args, y0)
        table = self.table()
        h = (t1 - t0) * direction
        t = t0 * direction
        compose = getattr(system, "compose", partial(by_stages, system))
        w = compose(system.enter(y0, solver_state), table, t, h)
        y1, kept = system.leave(w, y0)
        kicks_last = table.b[-1] != 0
        a0 = system.acceleration(y0, solver_state if kicks_last else system.start(t, y0))
        a1 = system.acceleration(y1, kept if kicks_last else system.start(t + h, y1))
        dense = dict(y0=y0, y1=y1, a0=a0, a1=a1, direction=jnp.asarray(direction, h.dtype))
        return y1, None, dense, kept, diffrax.RESULTS.successful


class VelocityVerlet(AbstractSplitting):
    """Velocity Verlet, order 2, one force per step: robust, and cheap for rough results.

    Source: Verlet (1967).
    """


class SRKN6b(AbstractSplitting):
    """Blanes and Moan's SRKN6b, order 4, six forces per step.

    Source: J. Comput. Appl. Math. 142, 313 (2002).
    """


class ABA864(AbstractSplitting):
    """Blanes and others' ABA864, order 4, seven forces per step, drift first.

    For H = A + eps B with exact flows of both, its error is of order
    eps h^8 + eps^2 h^6 + eps^3 h^4. In a weakly nonlinear FPUT chain, with equally many forces, its
    energy error is a seventh of SRKN6b's and its error of the state three times as large. Source:
    Appl. Numer. Math. 68, 58 (2013).
    """


class SRKN11b(AbstractSplitting):
    """Blanes and Moan's SRKN11b, order 6, eleven forces per step: the default of `simulate`.

    Source: as SRKN6b.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, solver=gx.SRKN11b(), step=0.05, save_at=11)
    >>> bool(run.energy_error < 1e-6), int(gx.SRKN11b.evaluations())
    (True, 11)
    """


class SRKN14a(AbstractSplitting):
    """Blanes and Moan's SRKN14a, order 6, fourteen forces per step, drift first.

    Source: as SRKN6b.
    """


class KahanLi8(AbstractSplitting):
    """Kahan and Li's composition, order 8, seventeen forces per step.

    Source: Math. Comput. 66, 1089 (1997).

    **Example:**

    >>> flow = gx.Flow(20, gx.KahanLi8(), lambda t, y, args: (y[1], -y[0]))
    >>> u, v = flow((jnp.array([1.0]), jnp.array([0.0])), 0.0, 2 * jnp.pi, None)
    >>> abs(float(v[0])) < 1e-8
    True
    """


class SofroniouSpaletta10(AbstractSplitting):
    """Sofroniou and Spaletta's composition, order 10, 35 forces per step, for errors near rounding.

    Source: Optim. Methods Softw. 20, 597 (2005).
    """
