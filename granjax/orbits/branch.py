"""A branch of periodic orbits over a parameter, and the bifurcations on it."""

from collections.abc import Iterator
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Inexact, Shaped

from ..continuation import Curve
from ..flow import Flow
from ..lattice import Lattice, State
from ..newton import Root
from ..results import STATE, Held, Result
from ..types import Count, Displacements
from .confirm import OrbitError
from .floquet import decide
from .orbit import Orbit
from .problems import Family

FOLD, BRANCH_POINT, DOUBLING, TORUS = "fold", "branch point", "period doubling", "Neimark-Sacker"


class Bifurcation(Result):
    """A change along a parameter.

    - `kind`: "fold" (dp = 0), "branch point" (another branch crosses, as where a symmetry breaks), "period doubling"
      (a multiplier -1), "Neimark-Sacker" (a complex pair on the unit circle); of conservative families also "real pair
      at +1", "Krein collision" and "extremum of energy"; of a sweep "repetition".
    - `p`: value of the parameter. `after`: index of the point before it. `state`: of the orbit there, at t0.
    - `multiplier`: on the unit circle, of a pair the one above the real axis; as far as its modulus is from 1, so far
      was it located. `before`, `behind`: what the kind counts on the two sides: real pairs beyond +1 or -1, complex
      quadruples; of a sweep the periods after which the motion repeats, 0 where it does not.

    **Example:**

    >>> gx.breathers.Bifurcation("fold", p=1.2, after=3)
    Bifurcation(Fold at p = 1.2)
    """

    held: ClassVar[dict[str, Held]] = {"state": Held("site", STATE)}
    kind: str = eqx.field(static=True)
    p: float
    after: int
    state: State | None = None
    multiplier: complex | None = None
    before: int | None = None
    behind: int | None = None

    def __repr__(self) -> str:
        return f"Bifurcation({self.outcome[:-1]})"

    @property
    def outcome(self) -> str:
        """Where what happens, a sentence."""
        counts = "" if self.before is None else f", {self.before} before and {self.behind} behind"
        return f"{self.kind[0].upper()}{self.kind[1:]} at p = {self.p:.9g}{counts}."


class Branch(Result):
    r"""Orbits along a parameter, P of them, as `family`, `anticontinuous` or `forced_branch` has found them.

    **Fields:** `p` (P,): the parameter, of a family of breathers their frequency, from the anticontinuous limit the
    coupling. `periods` (P,). `states` at t0, a
    `State` of (P, N). `energy` (P,) at t0. `response` (P,): the chosen number, of a forced branch. `state_error`,
    `energy_error`, `response_error`: estimated distances from the truth, in the same units. `multipliers` (P, 2n), the
    largest modulus first, and `error` of each. `step_error` (P,): change of the tangent map when the steps are doubled.
    `verdict`: P words "stable", "unstable", "undecided", or "" where they were not computed.
    `bifurcations`: a tuple of `Bifurcation` in the order of the branch. `outcome`: why it ended. `t0`.

    **Example:**

    >>> chain = gx.scenes.klein_gordon(5, 0.02)
    >>> branch = gx.breathers.family(chain, points=3, arclength=0.3, steps=64, stability=False)
    >>> len(branch), branch.u.shape
    (3, (3, 5))
    >>> branch.energy.round(4).tolist()
    [0.0001, 0.0003, 0.0009]
    """

    held: ClassVar[dict[str, Held]] = {
        "p": Held("point"),
        "periods": Held("point", "s", "period"),
        "states": Held("point site", STATE, "state"),
        "energy": Held("point", "J"),
        "response": Held("point"),
        "state_error": Held("point site", STATE),
        "energy_error": Held("point", "J"),
        "response_error": Held("point"),
        "multipliers": Held("point multiplier", "1", "multiplier"),
        "error": Held("point multiplier", "1"),
        "step_error": Held("point", "1"),
        "verdict": Held("point"),
        "bifurcations": Held("bifurcation"),
        "omega": Held("point", "rad/s"),
        "amplitude": Held("point", "m"),
        "folds": Held(None),
    }
    p: Float[np.ndarray, " P"]
    periods: Float[np.ndarray, " P"]
    states: State
    energy: Float[np.ndarray, " P"]
    response: Float[np.ndarray, " P"] | None
    state_error: State
    energy_error: Float[np.ndarray, " P"]
    response_error: Float[np.ndarray, " P"] | None
    multipliers: Inexact[np.ndarray, "P two_n"]
    error: Float[np.ndarray, "P two_n"]
    step_error: Float[np.ndarray, " P"]
    verdict: Shaped[np.ndarray, " P"]
    bifurcations: tuple[Bifurcation, ...]
    outcome: str = eqx.field(static=True)
    t0: float
    _flow: Flow
    _family: Family
    _curve: Curve

    def __len__(self) -> int:
        return len(self.p)

    def _fields(self) -> Iterator[tuple[str, object]]:
        yield from super()._fields()
        yield from ((name, getattr(self, name)) for name in ("omega", "amplitude", "folds"))

    def _rows(self) -> Iterator[tuple[str, str]]:
        yield "points", str(len(self))
        for name in ("p", "omega", "energy", "amplitude", "response"):
            x, error = getattr(self, name), getattr(self, f"{name}_error", None)
            if x is not None:
                known = "" if error is None else f", known to {self._told(name, np.max(error))}"
                yield name, f"{x[0]:.6g} ... {self._told(name, x[-1])}{known}"
        if np.isfinite(self.multipliers).all():
            yield "multipliers", f"largest modulus {np.abs(self.multipliers[:, 0]).max():.6g}"
        kinds, counts = np.unique(self.verdict, return_counts=True)
        yield (
            "verdict",
            ", ".join(f"{n} {kind or 'not computed'}" for kind, n in zip(kinds, counts)),
        )
        for one in self.bifurcations:
            yield "bifurcation", one.outcome
        yield "outcome", self.outcome

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
            self._flow,
            jnp.asarray(self.t0),
            self._family.shooting.symmetry,
            OrbitError(*apart, exact, exact, **lattice.origin),
        )


@eqx.filter_jit
def _residual(family, x, q):
    return jnp.max(jnp.abs(family.residual(x, q)))


def verdicts_of(spectra: list, expected: int, conserves: bool) -> tuple:
    """(multipliers, error, verdict) of several orbits from pairs of multipliers and errors."""
    words = [decide(rho, error, expected, conserves)[0] for rho, error in spectra]
    return (
        np.stack([rho for rho, _ in spectra]),
        np.stack([error for _, error in spectra]),
        np.array(words),
    )


def special_of(family: Family, curve: Curve) -> list[Bifurcation]:
    """The folds and branch points that continuation has met, as `Bifurcation`s."""
    return [
        Bifurcation(
            s.kind,
            float(family.value(s.p)),
            s.after,
            State(*family.shooting.state(jnp.asarray(s.x))),
            **family.scene(jnp.asarray(s.p))[0].origin,
        )
        for s in curve.special
    ]
