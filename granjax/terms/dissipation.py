"""Forces that depend on velocities or the past: damping, dashpots, drag, inelastic contacts."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.arrays import cubic_top
from ..base.checks import (
    concrete,
    non_negative,
    parameter,
    per_lane,
    positive,
    refuse,
    require,
    show,
    within,
)
from ..base.types import Count, Counts, Parameter, Scalar
from ..base.units import PART
from ..laws import Hertz, Indented, PlasticLaw, plus_power
from ..laws.base import Derived
from ..strains import StrainMap
from .base import Remembering, Term, only, wider
from .bonds import Bond, Joined


class Damping(Term):
    """Linear damping of each site: acceleration -gamma v, force -gamma m v; gamma = 1/tau.

    **Arguments:** `rate`: gamma >= 0 [1/s], scalar or one per site; `field`: as in `OnSite`, `None`
    for all. Splitting solvers treat it exactly. Typical: tau = 0.2 ... 5 ms for steel
    beads, gamma = 0.01 ... 0.1 in scaled units. **Raises** ValueError for gamma < 0.

    **Example:**

    >>> spring = gx.Bond(gx.Shift(1, "fixed"), gx.Linear())
    >>> chain = gx.Lattice(1.0, (spring, gx.Damping(0.1)), sites=20)
    >>> v, a = gx.vector_field(0.0, gx.states.impact(chain), chain)
    >>> float(a[0])
    -0.1
    """

    dimensions = {"rate": (0, 0, -1)}
    linear_in: ClassVar[str | None] = "rate"
    per_site: ClassVar[bool] = True
    span: ClassVar[tuple[int, ...]] = ()
    rate: jax.Array
    field: str | None = eqx.field(static=True)

    def __init__(self, rate: Parameter, field: str | None = None):
        self.rate = non_negative("rate", rate, "A negative rate would feed the lattice.")
        self.field = field

    def force(self, t, u, v, mass):
        own = only(v, self.field), only(mass, self.field)
        return jax.tree.map(lambda v, m: -self.rate * m * v, *own)

    def exact_damping(self):
        return self.field, self.rate

    def linearised(self, lattice, t, u, v):
        return wider(self)


class Langevin(Damping):
    r"""A heat bath: m dv = -gamma m v dt + sqrt(2 gamma m k_B T) dW, plus the other forces.

    `gx.simulate` solves it exactly, by a splitting solver with a fixed step h: v becomes
    c v + sqrt((1 - c^2) k_B T/m) xi, c = exp(-gamma h), xi Gaussian. With `VelocityVerlet` this
    happens in the middle of the drift (the BAOAB scheme: <u^2> of a harmonic lattice is exact at
    any stable step, <v^2> has the relative error -h^2 omega^2/4); with any other splitting half of
    it before and half after the step: moments have the solver's order at one temperature, an error
    of order gamma h^2 omega between several. Save at equal spacings, which the steps hit. `Peak`
    and its like see the path between the baths; `VelocityVerlet` allows none. Linear theory and
    `Flow` see the mean motion, that of `Damping`.

    **Arguments:** `rate`: gamma >= 0 [1/s], and `temperature`: k_B T >= 0 [J], numbers or one per
    site. `seed`: an integer, possibly traced, or one per lane. Lanes of one seed differ; the first
    has the noise of a single run. Another start time gives other numbers. `field`: as in `OnSite`.
    **Raises** ValueError for negative rates or temperatures, or a fractional seed.
    Source: B. Leimkuhler, C. Matthews, Appl. Math. Res. Express 2013, 34 (2013).

    **Example:**

    >>> spring = gx.Bond(gx.Shift(1, "fixed"), gx.Linear())
    >>> chain = gx.Lattice(1.0, (spring, gx.Langevin(0.5, temperature=2.0, seed=1)), sites=20)
    >>> run = gx.simulate(chain, gx.states.rest(chain), 2000.0, step=0.2, save_at=401)
    >>> bool(abs(jnp.mean(run.vs[50:] ** 2) - 2.0) < 0.2)
    True
    """

    dimensions = {"rate": (0, 0, -1), "temperature": (1, 1, 0), "seed": None}
    temperature: jax.Array
    seed: jax.Array

    def __init__(
        self,
        rate: Parameter,
        temperature: Parameter,
        seed: Counts | Count = 0,
        field: str | None = None,
    ):
        super().__init__(rate, field)
        self.temperature = non_negative("temperature", temperature)
        self.seed = jnp.asarray(seed)
        if not jnp.issubdtype(self.seed.dtype, jnp.integer):
            refuse("seed", "a whole number", show(seed), "Equal seeds give equal noise.")

    def check(self, name, lattice):
        per_lane(f"{name}: seed", self.seed, lattice.lanes)

    def force(self, t, u, v, mass):
        # The temperature adds nothing, but must fit the sites.
        mean = super().force(t, u, v, mass)
        return jax.tree.map(lambda force: force + 0 * self.temperature, mean)

    def linearised(self, lattice, t, u, v):
        return wider(Damping(self.rate, self.field))


class _Viscous(Joined):
    linear_in: ClassVar[str | None] = "coefficient"
    coefficient: eqx.AbstractVar[jax.Array]

    def _resistance(self, u):
        return self.coefficient

    def force(self, t, u, v, mass):
        pull = self.strain_map.pull(u, self._resistance(u) * self.strain_map.rate(u, v))
        return jax.tree.map(jnp.negative, pull)

    def stiffness_bound(self, lattice, reach, factor=1.0):
        return jnp.zeros((), lattice.dtype)


class Dashpot(_Viscous):
    """Dashpots between sites: force -(de/du)^T c de/dt, from the velocity difference of the ends.

    **Arguments:** `strain_map`: which sites are joined; `coefficient`: c >= 0 [N s/m], scalar or
    one per bond. Splitting solvers refuse it, since it reads the velocities of neighbours: use
    diffrax's Tsit5 or Dopri8. **Raises** ValueError for c < 0.

    **Example:**

    >>> shift = gx.Shift(1, "free")
    >>> chain = gx.Lattice(1.0, (gx.Bond(shift, gx.Hertz()), gx.Dashpot(shift, 0.1)), sites=2)
    >>> v, a = gx.vector_field(0.0, gx.states.impact(chain), chain)
    >>> a
    Array([-0.1,  0.1], dtype=float64)
    """

    dimensions = {"strain_map": PART, "coefficient": (1, -1, 1)}
    strain_map: StrainMap
    coefficient: jax.Array

    def __init__(self, strain_map: StrainMap, coefficient: Parameter):
        self.strain_map = strain_map
        self.coefficient = non_negative("coefficient", coefficient)


class ViscousContact(_Viscous):
    r"""Viscoelastic contacts: force -(de/du)^T c [d0 + e]_+^q de/dt.

    **Arguments:** `strain_map`; `coefficient`: c >= 0 [N s/m^{1+q}], scalar or (bonds,);
    `exponent`: q > 0, 1/2 for viscoelastic spheres; `overlap`: d0 >= 0 at equilibrium [m].
    Splitting solvers refuse it. **Raises** ValueError for c, d0 < 0 or q <= 0. Source: Kuwabara,
    Kono, Jpn. J. Appl. Phys. 26, 1230 (1987).
    """

    dimensions = {
        "strain_map": PART,
        "coefficient": lambda term: (1, -1 - term.exponent, 1),
        "overlap": (0, 1, 0),
    }
    strain_map: StrainMap
    coefficient: jax.Array
    overlap: jax.Array
    exponent: float = eqx.field(static=True)

    def __init__(
        self,
        strain_map: StrainMap,
        coefficient: Parameter,
        exponent: Scalar = 0.5,
        overlap: Parameter = 0.0,
    ):
        self.strain_map = strain_map
        self.coefficient = non_negative("coefficient", coefficient)
        self.overlap = non_negative("overlap", overlap)
        self.exponent = float(positive("exponent", exponent))

    def _resistance(self, u):
        overlap = self.overlap + self.strain_map.strain(u)
        return self.coefficient * plus_power(overlap, self.exponent)


class Lagging(Derived):
    """Hertz's law with the lag tau ds/dt at known speeds."""

    dimensions = {"law": PART, "lag": (0, 1, 0)}
    law: Hertz
    lag: jax.Array

    def force(self, e):
        overlap = self.law.overlap(e)
        slope = 1.5 * plus_power(overlap, 0.5)
        total = self.law.stiffness * (plus_power(overlap, 1.5) + slope * self.lag)
        return jnp.where(total > 0, total, 0) - self.preload

    def energy(self, e):
        return self.law.energy(e)


class BrilliantovContact(Bond):
    r"""Viscoelastic spheres of Brilliantov, Spahn, Hertzsch and Poeschel: contact and dissipation.

    F = [A (s^{3/2} + (3/2) tau s^{1/2} ds/dt)]_+, s = d0 + e; force on the sites -(de/du)^T
    (F - F0). As `Hertz(A)` with `ViscousContact(3 A tau/2)`, of Kuwabara and Kono, but a contact
    that separates quickly has zero force instead of pulling.

    **Arguments:** `strain_map`; `stiffness`: A > 0 [N/m^{3/2}]; `dissipative_time`: tau >= 0 [s],
    from the material's viscosities and moduli; `precompression`: F0 >= 0 [N]. Numbers or one per
    bond. Typical: tau (A/m)^{2/5} V^{1/5} = 0.01 ... 0.3; the restitution falls as 1 - 1.730 tau
    (A/m)^{2/5} V^{1/5} (`gx.theory.restitution.viscoelastic`). Splitting solvers refuse it;
    `simulate` chooses Dopri8. **Raises** ValueError for A <= 0, tau or F0 < 0.
    Source: N. V. Brilliantov et al., Phys. Rev. E 53, 5382 (1996); T. Schwager, T. Poeschel, Phys.
    Rev. E 78, 051304 (2008).
    """

    dimensions = {"strain_map": PART, "law": PART, "dissipative_time": (0, 0, 1)}
    linear_in: ClassVar[str | None] = None
    dissipative_time: jax.Array

    def __init__(
        self,
        strain_map: StrainMap,
        stiffness: Parameter,
        dissipative_time: Parameter,
        precompression: Parameter = 0.0,
    ):
        super().__init__(strain_map, Hertz(stiffness, precompression))
        self.dissipative_time = non_negative("dissipative_time", dissipative_time)

    def moving(self, u, v):
        lag = self.dissipative_time * self.strain_map.rate(u, v)
        return Bond(self.strain_map, Lagging(self.law, lag))

    def force(self, t, u, v, mass):
        return self.moving(u, v).force(t, u, v, mass)


class CaputoDamping(Remembering):
    r"""Damping of each site with memory: force -c D^a u, Caputo's derivative of order 0 < a < 1.

    D^a u(t) is 1/Gamma(1 - a) times the integral over s < t of v(s)/(t - s)^a, between a spring
    (a = 0) and a damper (a = 1), as for polymers. `gx.simulate` uses velocity Verlet with the whole
    history since t0, before which the lattice is at rest: error ~ h^2, memory T N, cost T^2 N for T
    steps and N sites. Functions that assume a motion without memory refuse it.

    **Arguments:** `coefficient`: c >= 0 [N s^a/m], scalar or one per site; `order`: a in (0, 1),
    one number (or one per lane); `field`: as in `OnSite`, `None` for all. Typical: a = 0.2 ... 0.6
    for rubber and PTFE. **Raises** ValueError for c < 0, or a outside (0, 1): order 1 is `Damping`.
    Source: M. Caputo, Geophys. J. R. Astr. Soc. 13, 529 (1967).

    **Example:**

    >>> spring = gx.Bond(gx.Shift(1, "fixed"), gx.Linear())
    >>> chain = gx.Lattice(1.0, (spring, gx.CaputoDamping(0.1, order=0.5)), sites=20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05)
    >>> round(float(run.work[-1]), 3)
    -0.134
    """

    dimensions = {"coefficient": lambda term: (1, -1, term.order), "order": (0, 0, 0)}
    memory: ClassVar[dict[str, str]] = {"velocity": "m/s"}
    per_site: ClassVar[bool] = True
    span: ClassVar[tuple[int, ...]] = ()
    coefficient: jax.Array
    order: jax.Array
    field: str | None = eqx.field(static=True)

    def __init__(self, coefficient: Parameter, order: Parameter, field: str | None = None):
        self.coefficient = non_negative("coefficient", coefficient)
        self.field = field
        remedy = "Order 1 is gx.Damping, order 0 a spring."
        self.order = within("order", order, 0, 1, open_low=True, open_high=True, remedy=remedy)

    def check(self, name, lattice):
        if jnp.ndim(self.order) > len(lattice.lanes):
            refuse(
                name,
                "one order for all sites",
                f"orders of shape {jnp.shape(self.order)}",
                "Several dampings may stand side by side, each of some fields.",
            )

    def force(self, t, u, v, mass):
        """Return zero; the solver adds the force of the past."""
        return jax.tree.map(lambda v: 0 * self.coefficient * v, only(v, self.field))


class Drag(Term):
    """Quadratic drag of each site: force -c v|v|.

    **Arguments:** `coefficient`: c >= 0 [kg/m], scalar or one per site. Splitting solvers refuse
    it. **Raises** ValueError for c < 0.
    """

    dimensions = {"coefficient": (1, -2, 2)}
    span: ClassVar[tuple[int, ...]] = ()
    coefficient: jax.Array

    def __init__(self, coefficient: Parameter):
        self.coefficient = non_negative("coefficient", coefficient)

    def check(self, name, lattice):
        if lattice.dimension is not None:
            refuse(
                name,
                "a lattice with scalar displacements",
                f"vectors of {lattice.dimension}",
                "In the plane drag couples the components: write a term of your own.",
            )

    def force(self, t, u, v, mass):
        return jax.tree.map(lambda v: -self.coefficient * v * jnp.abs(v), v)


class PlasticContact(Bond, Remembering):
    r"""Elastic-plastic contacts: the force reads the largest overlap P(t) = max s(t') over t' <= t.

    Force on the sites: -(de/du)^T (F(s, P) - F0), s = d0 + e; F0 = F(d0, d0) is the static force of
    a virgin contact. `gx.simulate` carries P, one per bond, and returns a `RunWithMemory`;
    functions that assume a motion without memory refuse such a lattice. Measures of a state use the
    P of the lattice, at least the present overlap. `run.lattice` holds the P at the end of a run;
    `gx.measures.along(measure, lattice, run)` uses the P of each frame.

    **Arguments:** `strain_map`, such as `Shift(1, "fixed")`; `law`: `gx.WaltonBraun`,
    `gx.Thornton`, or a user-defined `gx.PlasticLaw`; `overlap`: d0 >= 0 at equilibrium [m], zero
    without precompression; `largest`: P at the start, `None` for d0 (virgin). Numbers or one per
    bond. **Raises** ValueError for d0 < 0, P < d0, or another kind of law.
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
        low = concrete(overlap)
        wanted = f"at least the overlap at equilibrium, {show(overlap)}"
        require("largest", largest, lambda P: low is None or P >= low, wanted)
        super().__init__(strain_map, Indented(law, overlap, largest))

    def variables(self, lattice):
        e = jax.eval_shape(self.strain_map.strain, lattice.template())
        return {"largest_overlap": jnp.broadcast_to(self.law.largest, e.shape).astype(e.dtype)}

    def recalling(self, variables):
        return eqx.tree_at(lambda term: term.law.largest, self, variables["largest_overlap"])

    def advanced(self, variables, step, y0, y1):
        overlaps = (self.law.rest + self.strain_map.strain(u) for u, _ in (y0, y1))
        slopes = (step * self.strain_map.rate(u, v) for u, v in (y0, y1))
        top = cubic_top(*overlaps, *slopes)
        return {"largest_overlap": jnp.maximum(variables["largest_overlap"], top)}

    def lost(self, variables):
        law = self.recalling(variables).law
        return jnp.broadcast_to(law.lost(), variables["largest_overlap"].shape)
