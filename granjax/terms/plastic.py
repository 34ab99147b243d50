"""Elastic-plastic contacts: bonds that remember the largest overlap they had."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from ..checks import concrete, non_negative, parameter, refuse, show
from ..laws import Indented, PlasticLaw
from ..strains import StrainMap
from ..types import Parameter
from ..units import PART
from .base import Remembering
from .bonds import Bond


class PlasticContact(Bond, Remembering):
    r"""Elastic-plastic contacts: bonds whose force reads the largest overlap P(t) = max s(t') over t' <= t.

    Force on the sites: -(de/du)^T (F(s, P) - F0), s = d0 + e, F0 = F(d0, d0) the static force of a contact that has
    never been pressed further. P is an internal variable, one per bond. `gx.simulate` carries it, and returns a
    `RunWithMemory`; whatever needs a motion that depends on its present state alone refuses such a lattice. Measures
    of a state take P as the lattice holds it, at least the present overlap: that of `run.lattice` is the one at the
    end of a run, and `gx.measures.along(measure, lattice, run)` puts in that of each frame.

    **Arguments:** `strain_map`, such as `Shift(1, "fixed")`; `law`: `gx.WaltonBraun`, `gx.Thornton`, or a
    `gx.PlasticLaw` of one's own; `overlap`: d0 >= 0 at equilibrium [m], zero without precompression; `largest`: P at
    the start, `None` for d0 (virgin contacts). Numbers or one per bond.
    **Raises** ValueError for d0 < 0, P < d0, or what is no such law.
    """

    dimensions = {"strain_map": PART, "law": PART}
    linear_in: ClassVar[str | None] = None
    memory: ClassVar[dict[str, str]] = {"largest_overlap": "m"}

    def __init__(
        self,
        strain_map: StrainMap,
        law: PlasticLaw,
        overlap: Parameter = 0.0,
        largest: Parameter | None = None,
    ):
        overlap = non_negative("overlap", overlap, "A chain under tension falls apart.")
        largest = overlap if largest is None else parameter("largest", largest)
        low, high = concrete(overlap), concrete(largest)
        if low is not None and high is not None and not (high >= low).all():
            refuse("largest", f"at least the overlap at equilibrium, {show(low)}", show(high))
        super().__init__(strain_map, Indented(law, overlap, largest))

    def variables(self, lattice):
        e = jax.eval_shape(self.strain_map.strain, lattice.template())
        return {"largest_overlap": jnp.broadcast_to(self.law.largest, e.shape).astype(e.dtype)}

    def recalling(self, variables):
        return eqx.tree_at(lambda term: term.law.largest, self, variables["largest_overlap"])

    def advanced(self, variables, step, y0, y1):
        (u0, v0), (u1, v1) = y0, y1
        s0, s1 = (self.law.rest + self.strain_map.strain(u) for u in (u0, u1))
        slopes = step * self.strain_map.rate(u0, v0), step * self.strain_map.rate(u1, v1)
        return {
            "largest_overlap": jnp.maximum(variables["largest_overlap"], _highest(s0, s1, *slopes))
        }

    def lost(self, variables):
        law = self.recalling(variables).law
        return jnp.broadcast_to(law.lost(), variables["largest_overlap"].shape)


def _highest(x0, x1, d0, d1):
    """The largest value within a step of the cubic through values and slopes (times the step) at its ends."""
    rise = x1 - x0
    a, b = 3 * (d0 + d1 - 2 * rise), 3 * rise - 2 * d0 - d1
    square = b * b - a * d0
    turns = square > 0
    # of the two places where the slope a x^2 + 2 b x + d0 is zero, that where it falls: x = d0/(-b + root)
    below = jnp.sqrt(jnp.where(turns, square, 1)) - b
    place = jnp.where(turns & (below != 0), d0 / jnp.where(below != 0, below, 1), 0)
    # where a maximum lies does not count to first order
    x = jax.lax.stop_gradient(jnp.clip(place, 0, 1))
    inside = x0 + x * (d0 + x * (b + x * a / 3))
    return jnp.maximum(jnp.maximum(x0, x1), inside)
