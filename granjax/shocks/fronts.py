"""`dissipative_front`: the stationary front of a chain with dashpots."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ..base.checks import positive, refuse, traced
from ..base.derivatives import once
from ..base.programs import compiled
from ..base.types import Count, Number, Scalar
from ..lattice import Lattice, State
from ..laws import Law, Strained
from ..profiles import Profile, medium_of, places, tabled, tails
from ..profiles import front as solver
from ..profiles.existence import STRAINS
from ..profiles.highest import highest
from ..profiles.medium import fine_force, implicit, in_float64, one_number, single, values
from ..results import array
from ..terms import Dashpot
from ..terms.chain import boundary_of

# The places of the table.
TABLE = 513
# The powers of e by which the slowest part falls on either side within the table.
REACH = 8.0
# The most contacts of the table behind the front.
LONGEST = 300.0
# The strains between both states at which the side of the force's chord is checked.
BETWEEN = 1023
# The relative difference up to which stiffness and chord, or two strains, count as equal.
ROUNDING = 1e-12
# The least relative difference of stiffness and chord that a front needs.
LEAST = 1e-5
# The error of the integrated equation in units of rounding, of the force and of the sum over the
# tent.
UNITS = 2


class _Step(NamedTuple):
    """A front's K/(m s^2) - 1 behind, 1 - K/(m s^2) ahead, force and strain jump, speed, zeta."""

    excess: Any
    short: Any
    force: Any
    jump: Any
    speed: Any
    zeta: Any


class DissipativeFront(Profile):
    r"""A front that runs without changing its shape: contact n has the strain y(n - s t).

    It goes from `behind` to `ahead`: m s^2 (y - ahead) = tent * (F(y) - F(ahead) - eta s y'),
    tent(x) = [1 - |x|]_+. The beads ahead are at rest, and `displacement` counts from their places
    there, -ahead n. At xi = 0 the strain is half way between both states, for the first time as the
    front arrives. m s^2 = [F]/[y], whatever the dashpot. The slowest part is exp(lambda xi) cos(k
    xi) behind, xi < 0, and exp(-mu xi) ahead.

    Differentiable once in the parameters of the law, the mass, the strains (or the piston) and the
    dashpot, by the implicit function theorem (`jax.grad`, `jax.jvp`, `jax.jacfwd`). `jax.jit` and
    `jax.vmap` around it are refused.
    """

    behind: Number = array("The strain behind.", "m")
    ahead: Number = array("The strain ahead.", "m")
    piston: Number = array("The velocity of the beads behind, s [y].", "m/s")
    dashpot: Number = array("The dashpot eta.", "N s/m")
    critical: Number = array(
        "The dashpot above which the strain behind approaches its value without oscillating.",
        "N s/m",
    )
    kind: str = array('"oscillatory" or "monotone".', static=True)
    decay_behind: Number = array("lambda.", "1")
    wavenumber_behind: Number = array("k.", "1")
    decay_ahead: Number = array("mu.", "1")
    overshoot: Number = array("How far the strain goes beyond `behind`.", "m")
    power: Number = array("The power that the dashpots dissipate.", "W")

    def _said(self):
        # Only the power of ten is told, because the digits are those of rounding.
        power = np.ceil(np.log10(self.error / abs(self.behind - self.ahead)))
        part = self.dashpot / self.critical
        return (
            f"Found to {10.0 ** max(power, -13.0):.0e} of its jump; {self.kind}, with {part:.4g} of the critical "
            "dashpot."
        )

    def state(self, sites: Count, centre: Scalar | None = None) -> State:
        """Return displacements and velocities (sites,) with the front at contact `centre`.

        `centre`: a real number; `None` is the middle, (sites - 2)/2. The chain must hold the far
        states at its ends: with forces F(behind) on the first bead and -F(ahead) on the last one of
        free ends, say, or with ends that are far enough.
        """
        u, v = super().state(sites, centre)
        return State(u - self.ahead * places(sites, centre), v)


def dissipative_front(
    law: Law | Lattice,
    behind: Scalar | None = None,
    ahead: Scalar = 0.0,
    *,
    dashpot: Scalar | None = None,
    piston: Scalar | None = None,
    mass: Scalar = 1.0,
) -> DissipativeFront:
    r"""Compute the stationary front of a uniform chain with dashpots between neighbours.

    The front is exact on the lattice. m u_n'' = F(y_{n-1}) - F(y_n) + eta (y'_{n-1} - y'_n), y_n =
    u_n - u_{n+1}, has waves y(n - s t) that join two uniform strains. Momentum gives s = ([F]/(m
    [y]))^{1/2}. Small e^{lambda xi} about either state obey m s^2 lambda^2 = 4 sinh(lambda/2)^2
    (K - eta s lambda). A weak front is monotone behind where eta exceeds the value at which two
    real roots meet, eta s = (m s^2 (K - m s^2)/3)^{1/2} in the limit. Where K exceeds 1.18772 m s^2
    behind, no two meet: the oscillatory pair decays more slowly than the real root below
    `critical`, and faster above. Newton's method solves the equation's integrated form, by
    continuation from a larger damping. With small damping the front is a long train of waves and
    needs about 1/eta places.

    **Arguments:**

    - `law`: any law, from equilibrium (it includes a precompression), with `mass`; or a chain
      `Lattice` of equal masses and bonds to the next site, whose walls and boundary are ignored and
      whose units the result has.
    - `behind`, `ahead`: strains, positive in compression. Instead of `behind`, `piston`: the
      velocity of the beads behind [m/s], s (behind - ahead). A law that stiffens has fronts with
      behind > ahead, one that softens with behind < ahead.
    - `dashpot`: eta > 0 between neighbours [N s/m], the `coefficient` of `gx.Dashpot`; `None`: that
      of the lattice.

    **Returns:** `DissipativeFront`. Hertz (A = m = 1) from 0 to 1: s = 1, critical 0.394869; at
    eta = 0.3 it overshoots by 0.0137. Just below `critical` the oscillation of a strong front may
    be too small to see: check `overshoot`.

        import diffrax

        front = gx.shocks.dissipative_front(gx.Hertz(), piston=1.0, dashpot=0.3)
        bonds = gx.Shift(1, "free")
        chain = gx.Lattice(1.0, (gx.Bond(bonds, gx.Hertz()), gx.Dashpot(bonds, 0.3)), sites=60)
        run = gx.simulate(chain, front.state(60, 20.0), 5.0, solver=diffrax.Dopri8(), tolerance=1e-8)

    **Raises** ValueError where there is no such front: without dissipation; where it is not faster
    than sound ahead and slower than sound behind (Lax), as for a linear law; where the law crosses
    its chord between both states; where stiffness and chord differ by less than 1e-5; where the
    damping is too small to find a profile; for a lattice that is not a uniform chain, a batch, both
    or none of `behind` and `piston`.
    Source: G. B. Whitham, Linear and Nonlinear Waves (Wiley 1974), 4.3 and 13.15; A. Molinari, C.
    Daraio, Phys. Rev. E 80, 056602 (2009); E. B. Herbold, V. F. Nesterenko, Phys. Rev. E 75, 021304
    (2007).

    **Example:**

    >>> front = gx.shocks.dissipative_front(gx.Hertz(), 1.0, dashpot=0.3)
    >>> round(float(front.speed), 6), round(float(front.overshoot), 4)
    (1.0, 0.0137)
    """
    if (behind is None) == (piston is None):
        refuse("behind, piston", "exactly one of them", "none" if behind is None else "both")
    law, mass, behind, ahead, piston, dashpot = once(
        (law, mass, behind, ahead, piston, dashpot), _refuse_second
    )
    in_float64()
    law, dashpot = _with_dashpot(law, dashpot)
    medium = medium_of(law, mass)
    remedy = "Without one a step becomes a dispersive shock, which gx.theory.shock_edges describes."
    positive("dashpot", dashpot, remedy)
    given = behind, ahead, piston, dashpot
    known = list(map(one_number, ("behind", "ahead", "piston", "dashpot"), given))
    plain = medium.known
    plain = plain._replace(law=Strained(plain.law, jnp.asarray(known[1], float)))
    jump = _jump(plain, known[2]) if behind is None else known[0] - known[1]
    step = _checked_step(plain, jump, known)
    critical = tails.critical(step.excess)
    trial = lambda zeta: solver.Trial(
        zeta, tails.behind(step.excess, zeta), tails.ahead(step.short, zeta)
    )
    front = _solved(plain.law, step, trial, critical)
    return _recorded(medium, given, step, front, critical, trial(step.zeta))


def _refuse_second():
    refuse("law", "one derivative of a front", "a second one", "Take differences of the first.")


def _with_dashpot(law, dashpot):
    own = None
    if isinstance(law, Lattice):
        between = lambda term: isinstance(term, Dashpot) and boundary_of(term)
        found = [term.coefficient for term in law.terms if between(term)]
        if found:
            own = sum(single("law", "dashpots", one) for one in found)
            rest = tuple(term for term in law.terms if not between(term))
            law = eqx.tree_at(lambda x: x.terms, law, rest)
    if (own is None) == (dashpot is None):
        refuse("dashpot", "one, of the lattice or given here", "none" if own is None else "both")
    return law, own if dashpot is None else dashpot


def _jump(medium, piston):
    wanted = float(medium.mass) * piston**2
    side = np.sign(piston)
    strains = side * STRAINS
    with np.errstate(all="ignore"):
        k = int(np.argmax(values(medium.law, strains)[0] * strains >= wanted))
    if k == 0:
        refuse(
            "piston",
            "a velocity that some strain of the law has",
            f"{piston:g}",
            "At this strain the force ends, or does not grow.",
        )

    def over(e):
        return values(medium.law, np.array([e]))[0][0] * e / wanted - 1

    return scipy.optimize.brentq(
        over, strains[k - 1], strains[k], xtol=1e-300, rtol=4 * np.finfo(float).eps
    )


def _checked_step(medium, jump, given):
    behind, ahead, _, dashpot = given
    if not jump or behind is not None and abs(jump) <= ROUNDING * abs(ahead):
        refuse("behind", "a strain other than ahead", f"{behind:g}", "A front joins two strains.")
    step = _Step(*map(float, _sides(medium.law, medium.mass, jnp.asarray(jump), dashpot)))
    chord = step.force / jump
    excess = step.excess
    short = step.short
    if not (np.isfinite(chord) and chord > 0 and np.isfinite(excess + short)):
        refuse(
            "behind",
            "a strain to which the law's force grows from that ahead, both stiff by finite amounts",
            f"forces that differ by {step.force:g} and stiffness {(1 + excess) * chord:g} behind, "
            f"{(1 - short) * chord:g} ahead",
        )
    sound = ", ".join(
        f"{name} {step.speed * np.sqrt(max(k, 0.0)):.6g}"
        for name, k in (("behind", 1 + excess), ("ahead", 1 - short))
    )
    if not (excess > ROUNDING and short > ROUNDING):
        other = "below" if jump > 0 else "above"
        refuse(
            "behind",
            "a strain whose front is faster than sound ahead and slower than sound behind",
            f"the speed {step.speed:.6g} and sound {sound}",
            f"Such a step spreads out as it runs; of this law there may be fronts from strains {other} that ahead.",
        )
    if not (excess > LEAST and short > LEAST):
        refuse(
            "behind",
            f"a strain whose stiffness differs from the chord's by a part in {1 / LEAST:.0e} or more",
            f"differences of {excess:.1e} and {short:.1e}",
            "Such fronts are very wide: solutions of the Korteweg-de Vries-Burgers equation.",
        )
    z = np.arange(1, BETWEEN + 1) / (BETWEEN + 1)
    if not (values(medium.law, jump * z)[0] / step.force < z).all():
        refuse(
            "behind",
            "a strain whose chord to that ahead the force does not cross",
            "one whose force crosses it",
            "Such a step falls apart into several waves.",
        )
    return step


def _solved(law, step, trial, critical):
    def force(z):
        F, slope, _ = values(law, step.jump * z)
        return F / step.force, slope * (step.jump / step.force)

    with np.errstate(all="ignore"):
        shape, residual = solver.followed(force, trial, step.zeta, critical.zeta)
        found = (
            solver.finished(force, trial(step.zeta), shape) if residual < solver.CONVERGED else None
        )
    if found is None or not found.residual < solver.CONVERGED:
        refuse(
            "dashpot",
            "a dashpot whose front is found",
            f"{step.zeta / critical.zeta:.2g} of the critical one",
            "Of a smaller damping the train of waves behind is longer, and may reach where the law ends.",
        )
    return found


def _recorded(medium, given, known_step, front, critical, trial):
    behind, ahead, piston, dashpot = (None if x is None else jnp.asarray(x, float) for x in given)
    law = Strained(medium.law, ahead)
    mass = medium.mass
    if behind is None:
        gap = lambda jump: fine_force(law, jump) * jump - mass * piston**2
        jump = implicit(gap, known_step.jump, 1 / jax.grad(gap)(known_step.jump))
    else:
        jump = behind - ahead
    step = _sides(law, mass, jump, dashpot)
    z = jnp.asarray(solver.padded(front))
    if traced((medium, given)):
        z = _implicit(z, front, law, (mass, jump, dashpot), known_step)
    numbers = dict(
        law=law,
        mass=mass,
        speed=step.speed,
        length=jnp.asarray(front.apart),
        centre=jnp.asarray(float(front.centre)),
        dashpot=dashpot,
        ahead=ahead,
        jump=step.jump,
    )
    shape = solver.shape_of(z, numbers)
    root, rate, limit = _rates(step, known_step, critical, trial)
    place = front.places[np.argmax(front.z)]
    top, most = highest(front.at, place - front.apart, place + front.apart)
    overshoot = jnp.sign(known_step.jump) * (shape.at("strain", top) - ahead - step.jump)
    # The residual and its rounding move the tails by themselves over the distance from sound.
    left = front.residual + UNITS * np.finfo(float).eps
    error = front.error + left / min(known_step.excess, known_step.short)
    above = most - 1 > 2 * error
    reaches = (REACH / float(jax.lax.stop_gradient(x)) for x in (jnp.real(root), rate))
    xi = np.linspace(-min(LONGEST, next(reaches)), next(reaches), TABLE)
    kind = "oscillatory" if known_step.zeta < critical.zeta else "monotone"
    return DissipativeFront(
        speed=step.speed,
        behind=ahead + step.jump,
        ahead=ahead,
        piston=step.speed * step.jump,
        dashpot=dashpot,
        critical=limit * mass * step.speed,
        kind=kind,
        decay_behind=jnp.real(root),
        wavenumber_behind=jnp.imag(root),
        decay_ahead=rate,
        overshoot=overshoot if above else jnp.zeros(()),
        power=_power(law, step),
        residual=jnp.asarray(front.residual),
        error=jnp.asarray(error * abs(known_step.jump)),
        law=medium.law,
        mass=mass,
        **tabled(shape, xi),
        **medium.origin,
    )


def _rates(step, known, critical, trial):
    more = step.excess - known.excess
    less = step.short - known.short
    zeta = step.zeta - known.zeta
    root = trial.behind
    rate = trial.ahead
    steep = complex(tails.lack_slope(root)) - known.zeta, float(tails.lack_slope(rate)) + known.zeta
    return (
        root - (more - root * zeta) / steep[0],
        rate + (less - rate * zeta) / steep[1],
        critical.zeta + critical.slope * more,
    )


@compiled
def _sides(law, mass, jump, dashpot):
    force = fine_force(law, jump)
    chord = force / jump
    speed = jnp.sqrt(chord / mass)
    return _Step(
        law.derivative(jump) / chord - 1,
        1 - law.derivative(jnp.zeros(())) / chord,
        force,
        jump,
        speed,
        dashpot / (mass * speed),
    )


@compiled
def _power(law, step):
    # Return the work of both forces less what the law stores and the beads keep. This is y^3/2
    # int_0^1 s (1 - s) F''(y s) ds, which does not cancel for weak fronts.
    plain = step.force * step.jump / 2 - law.energy(step.jump)
    full, half = (step.jump**3 * _curved(law, step.jump, n) for n in (32, 16))
    smooth = jnp.abs(full - half) <= ROUNDING * jnp.abs(full)
    return step.speed * jnp.where(smooth, full, plain)


def _curved(law, jump, count):
    nodes, weights = np.polynomial.legendre.leggauss(count)
    _, curvature = jax.jvp(law.derivative, (jump * (1 + nodes) / 2,), (np.ones(count),))
    return (weights * (1 - nodes**2) / 16) @ curvature


def _implicit(table, front, law, numbers, known):
    fixed = jax.lax.stop_gradient((law, numbers))
    parts = _slopes(*fixed, table)
    force, zeta = (np.stack([np.asarray(x) for x in jax.tree.leaves(part)], -1) for part in parts)
    slope = values(fixed[0], known.jump * front.z)[1] * (known.jump / known.force)
    change = np.zeros((len(table), force.shape[1]))
    change[: len(front.z)] = solver.moved(front, slope, known.zeta, force[: len(front.z)], zeta)
    moving = jax.tree.leaves((eqx.filter(law, eqx.is_inexact_array), numbers))
    return table + sum(row * (x - jax.lax.stop_gradient(x)) for row, x in zip(change.T, moving))


@compiled
def _slopes(law, numbers, z):
    moving, rest = eqx.partition(law, eqx.is_inexact_array)

    def both(x):
        own = eqx.combine(x[0], rest)
        mass, jump, dashpot = x[1]
        force = fine_force(own, jump)
        return fine_force(own, jump * z) / force, dashpot / jnp.sqrt(mass * force / jump)

    return jax.jacfwd(both)((moving, numbers))
