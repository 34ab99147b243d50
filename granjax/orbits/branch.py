"""A branch of periodic orbits over a parameter, and the bifurcations on it."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Inexact, Shaped

from ..continuation import Curve
from ..lattice import Lattice, State
from ..newton import Root
from ..results import Held, Result, array, part
from ..types import Count, Displacements
from .confirm import OrbitError
from .orbit import Orbit
from .problems import Family

FOLD = "fold"
BRANCH_POINT = "branch point"
DOUBLING = "period doubling"
TORUS = "Neimark-Sacker"


class Bifurcation(Result):
    """A change along a parameter."""

    kind: str = array(
        '"fold" (dp = 0), "branch point" (another branch crosses), "period doubling" (a '
        'multiplier -1), "Neimark-Sacker" (a complex pair on the unit circle); of '
        'conservative families also "real pair at +1", "Krein collision" and "extremum of '
        'energy"; of a sweep "repetition".',
        static=True,
    )
    p: float = array("The value of the parameter.")
    after: int = array("The index of the point before it.")
    state: State | None = part("The state of the orbit there, at t0.", "site", default=None)
    multiplier: complex | None = array(
        "The multiplier on the unit circle, of a pair the one above the real axis; its "
        "modulus differs from 1 by as much as it is located to.",
        default=None,
    )
    before: int | None = array(
        "What the kind counts before: real pairs beyond +1 or -1, complex quadruples; of a "
        "sweep the periods after which the motion repeats, 0 where it does not.",
        default=None,
    )
    behind: int | None = array("What the kind counts behind.", default=None)

    def __repr__(self) -> str:
        return f"Bifurcation({self.outcome[:-1]})"

    @property
    def outcome(self) -> str:
        """Where what happens, a sentence."""
        counts = "" if self.before is None else f", {self.before} before and {self.behind} behind"
        return f"{self.kind[0].upper()}{self.kind[1:]} at p = {self.p:.9g}{counts}."


class Branch(Result):
    r"""Orbits along a parameter, as `family`, `anticontinuous` or `forced_branch` has found them.

    P points; errors are estimated distances from the truth, in the units of what they are of.
    """

    p: Float[np.ndarray, " point"] = array(
        "The parameter: of a family of breathers their frequency, from the anticontinuous "
        "limit the coupling."
    )
    periods: Float[np.ndarray, " point"] = array("The period of each orbit.", "s", name="period")
    states: State = part("The state of each orbit at t0.", "point site", name="state")
    energy: Float[np.ndarray, " point"] = array("The energy of each orbit at t0.", "J")
    response: Float[np.ndarray, " point"] | None = array(
        "The chosen number of each orbit of a forced branch."
    )
    state_error: State = part("The error of each state.", "point site")
    energy_error: Float[np.ndarray, " point"] = array("The error of each energy.", "J")
    response_error: Float[np.ndarray, " point"] | None = array("The error of each response.")
    multipliers: Inexact[np.ndarray, "point multiplier"] = array(
        "The Floquet multipliers of each orbit, the largest modulus first.", "1", name="multiplier"
    )
    error: Float[np.ndarray, "point multiplier"] = array("The error of each multiplier.", "1")
    step_error: Float[np.ndarray, " point"] = array(
        "The change of the tangent map when the steps are doubled.", "1"
    )
    verdict: Shaped[np.ndarray, " point"] = array(
        '"stable", "unstable" or "undecided", or "" where the multipliers were not computed.'
    )
    bifurcations: tuple[Bifurcation, ...] = array(
        "The bifurcations in the order of the branch.", axes="bifurcation"
    )
    outcome: str = eqx.field(static=True)
    t0: float = array("The time at which the orbits begin.")
    exported: ClassVar[dict[str, Held]] = {
        "omega": Held("point", "rad/s"),
        "amplitude": Held("point", "m"),
        "folds": Held(None),
    }
    _family: Family
    _curve: Curve

    def __len__(self) -> int:
        return len(self.p)

    @property
    def omega(self) -> Float[np.ndarray, " P"]:
        """Angular frequencies 2 pi/T, (P,)."""
        return self.p if isinstance(self._family.make, Lattice) else 2 * np.pi / self.periods

    @property
    def u(self) -> Displacements:
        """Displacements at t0, (P, N): of a breather at its turning point."""
        return self.states.u

    @property
    def amplitude(self) -> Float[np.ndarray, " P"]:
        """max |u| at t0, (P,)."""
        return np.max(
            [np.abs(x).reshape(len(self), -1).max(1) for x in jax.tree.leaves(self.u)], axis=0
        )

    @property
    def folds(self) -> Float[np.ndarray, " F"]:
        """Values of the parameter where the branch turns back."""
        return np.array([b.p for b in self.bifurcations if b.kind == FOLD])

    @property
    def branch_points(self) -> Float[np.ndarray, " B"]:
        """Values of the parameter where another branch crosses."""
        return np.array([b.p for b in self.bifurcations if b.kind == BRANCH_POINT])

    @property
    def stable(self) -> Bool[np.ndarray, " P"]:
        """Which points are stable, (P,)."""
        return self.verdict == "stable"

    def orbit(self, i: Count) -> Orbit:
        """The `Orbit` at point i; -1 is the last."""
        x, q = jnp.asarray(self._curve.x[i]), jnp.asarray(self._curve.p[i])
        lattice, _ = self._family.scene(q)
        residual = _residual(self._family, x, q)
        none = jnp.zeros((), int)
        root = Root(x, jnp.full((x.size,) * 2, jnp.nan), residual, residual, none, none, residual)
        state = jax.tree.map(lambda y: jnp.asarray(y[i]), self.states)
        apart, exact = (
            jax.tree.map(lambda e: jnp.asarray(e[i]), (self.state_error, self.energy_error)),
            jnp.zeros(()),
        )
        return Orbit(
            state,
            jnp.asarray(self.periods[i]),
            lattice,
            root,
            self._family.shooting.whole,
            jnp.asarray(self.t0),
            jnp.asarray(self.energy[i]),
            self._family.shooting.symmetry,
            OrbitError(*apart, exact, exact, **lattice.origin),
        )


@eqx.filter_jit
def _residual(family, x, q):
    return jnp.max(jnp.abs(family.residual(x, q)))


def bifurcation_at(
    family: Family, kind: str, z: np.ndarray, after: Count, *known: Any
) -> Bifurcation:
    """A bifurcation at z = (x, q). `known`: its multiplier and what is counted before and behind, if any."""
    x, q = jnp.asarray(z[:-1]), jnp.asarray(z[-1])
    state = State(*family.shooting.state(x))
    origin = family.scene(q)[0].origin
    return Bifurcation(kind, float(family.value(q)), int(after), state, *known, **origin)


def special_of(family: Family, curve: Curve) -> list[Bifurcation]:
    """The folds and branch points that continuation has met, as `Bifurcation`s."""
    return [bifurcation_at(family, s.kind, np.append(s.x, s.p), s.after) for s in curve.special]
