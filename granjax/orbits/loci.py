"""Curves of bifurcations in two parameters: the orbit and its critical direction together."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..base.checks import refuse
from ..base.printing import told
from ..base.programs import compiled
from ..base.types import Along, Count, Numbers, Scalar
from ..continuation.arclength import Curve, Problem, System, continuation, linearised, residual_of
from ..lattice import Lattice, State
from ..results import Result, array, hidden, part
from .asked import stacked
from .problems import Family

KINDS = ("fold", "branch point", "period doubling", "Neimark-Sacker", "Krein collision")
# The residual of the extended system may exceed that of an orbit of the branch by this factor.
LEFT = 10
# A disturbance, relative to the orbit's size, above which a symmetry is lost.
SYMMETRIC = 1e-6
# The special points that a curve of each kind may meet.
MET = {
    "fold": ("cusp", "1:1"),
    "period doubling": ("1:2",),
    "Neimark-Sacker": ("1:1", "1:2", "1:3", "1:4"),
}
# The angles of the multiplier at which a Neimark-Sacker curve meets a strong resonance.
RESONANT = {"1:1": 0.0, "1:2": np.pi, "1:3": 2 * np.pi / 3, "1:4": np.pi / 2}


class LocusPoint(NamedTuple):
    """A point of codimension two.

    `kind`: "cusp", or "1:1", "1:2", "1:3", "1:4" (a strong resonance). `p`: the branch's parameter;
    `other`: the second one. `after`: the index of the point before.
    """

    kind: str
    p: float
    other: float
    state: State
    after: int
    __repr__ = told


class Locus(Result):
    """Bifurcations of one kind in two parameters: what `branch.locus(i, ...)` returns."""

    kind: str = array("The bifurcation.", static=True)
    p: Along = array("The branch's parameter.")
    other: Along = array("The second parameter.")
    p_error: Along = array(
        "The error of `p` at this value of `other`, from twice the steps. It is large where the "
        "curve turns back."
    )
    states: State = part("The states of the orbits at t0.", "point site", name="state")
    angle: Along = array(
        "The angle of the critical multiplier: 0, pi, or that of a Neimark-Sacker point or a "
        "Krein collision.",
        "rad",
    )
    special: tuple[LocusPoint, ...] = array(
        "Cusps and strong resonances, in the order of the curve.", axes="special"
    )
    curve: Curve = hidden("The curve that continuation has followed.")
    _span: tuple[float, float] = hidden(
        "The start of the second parameter, and its range.", static=True
    )

    @property
    def folds(self) -> Numbers:
        """Values of the second parameter where the curve turns back, as where an isola is born."""
        return np.array([self._span[0] + s.p * self._span[1] for s in self.curve.special])

    @property
    def outcome(self) -> str:
        """Why the curve ended, and what was met."""
        met = ", ".join(s.kind for s in self.special)
        end = (
            f"The second parameter reached {self.other[-1]:.6g}."
            if self.curve.end == "p"
            else self.curve.outcome
        )
        return f"{end} Met: {met}." if met else end


class _With(eqx.Module):
    function: Callable
    other: Scalar

    def __call__(self, p):
        return self.function(p, self.other)


class _Critical(Problem):
    """Orbits at a bifurcation, F(x; r) = 0 over a second parameter start + r span.

    x holds the orbit's unknowns X, its parameter q, and:

    - v, the direction that a multiplier rho keeps: A(rho) v = 0 with fixed . v = 1. A(rho) is the
      derivative of the orbit's residual with rho times the start in place of the start (fold,
      branch point: rho = 1; doubling: -1).
    - At a branch point: mu, the size of a disturbance along `left`, zero while the lattice has the
      symmetry that is broken; and h of A h + D^2 F [v, v] = 0, which places X along v where the
      branches that leave have no slope.
    - At a Neimark-Sacker point: theta of rho = exp(i theta), and k, s, a, b of v = a + i s b,
      |b| = 1, sin(theta) = k s.
    - For a reversible orbit: mu = Re rho, and v of (T - mu) v = 0; at a Krein collision also w of
      (T - mu) w = v. T maps displacements over a period; its eigenvalues are (rho + 1/rho)/2.

    Source: Moore, Spence, SIAM J. Numer. Anal. 17, 567 (1980); Werner, Spence, SIAM J. Numer. Anal.
    21, 388 (1984).
    """

    family: Family
    make: Callable
    period: Callable | None
    kind: str = eqx.field(static=True)
    start: Scalar
    span: Scalar
    fixed: Numbers
    left: Numbers
    size: int = eqx.field(static=True)

    def at(self, r):
        # The branch's family at a value of the second parameter.
        old = self.family
        other = self.start + r * self.span
        if isinstance(old.make, Lattice):  # A family over the frequency.
            return dataclasses.replace(old, make=self.make(other))
        period = old.period if self.period is None else _With(self.period, other)
        return dataclasses.replace(old, make=_With(self.make, other), period=period)

    def residual(self, x, p):
        family = self.at(p)
        size = self.size
        X = x[:size]
        q = x[size]
        rest = x[size + 1 :]
        orbit = family.residual(X, q)
        moved = lambda v: _moved(family, X, q, v)
        if self.kind == "Neimark-Sacker":
            theta, k, s = rest[:3]
            a, b = rest[3:].reshape(2, size)
            turned = 1 - jnp.cos(theta)
            # The real part of A v, and its imaginary part over s. A v = 0 alone is solved by every
            # fold and doubling, with a real v and theta = 0 or pi: the curve would turn into them.
            critical = [
                moved(a) + self.started(turned * a + jnp.sin(theta) * s * b),
                moved(b) + self.started(turned * b - k * a),
            ]
            more = [self.fixed @ a - 1, self.fixed @ b, b @ b - 1, jnp.sin(theta) - k * s]
        elif self.of_displacements:
            n = self.fixed.size
            mu, rest = (rest[0], rest[1:]) if self.kind == "Krein collision" else (-1.0, rest)
            v, *w = rest.reshape(-1, n)
            apart = lambda v: self.turned(family, X, q, v) - mu * v
            critical = [apart(v), *(apart(w) - v for w in w)]
            more = [self.fixed @ v - 1, *(self.fixed @ w for w in w)]
        else:
            v = rest[:size]
            critical = [moved(v) + (2 * self.started(v) if self.kind == "period doubling" else 0)]
            more = [self.fixed @ v - 1]
            if self.kind == "branch point":
                h = rest[size + 1 :]
                orbit = orbit + rest[size] * self.left
                critical.append(_curvature(family, X, q, v) + moved(h))
                more.append(self.fixed @ h)
        return jnp.concatenate([orbit, *critical, jnp.stack(more)])

    @property
    def of_displacements(self):
        # Whether the critical direction is one of displacements alone.
        doubles = self.kind == "period doubling" and self.family.shooting.reversible
        return doubles or self.kind == "Krein collision"

    def started(self, v):
        # The first state of v in the place of the last gap.
        first = v[: 2 * self.family.shooting.count]
        last = (self.family.shooting.segments - 1) * first.size
        return jnp.zeros_like(v).at[last : last + first.size].set(first)

    @compiled
    def turned(self, family, X, q, v):
        # T v: the displacements a period after a displacement v.
        shooting = family.shooting
        lattice, period = family.scene(q)
        y = shooting.state(X)
        unravel = ravel_pytree(shooting.like)[1]
        along = unravel(jnp.concatenate([v, jnp.zeros_like(v)]))
        run = lambda y: shooting.whole(y, 0.0, period, lattice)
        return ravel_pytree(jax.jvp(run, (y,), (along,))[1].u)[0]


def locus(
    family: Family,
    found: Any,
    make: Callable[..., Any],
    start: Scalar,
    until: Scalar,
    period: Callable[..., Any] | None,
    arclength: Scalar,
    points: Count,
) -> Locus:
    """Follow a `Bifurcation` of a family in a second parameter, as `Branch.locus`."""
    kind = found.kind
    start = float(start)
    until = float(until)
    if start == until:
        refuse("until", "a value other than start", repr(until))
    span = until - start
    problem, x = _begun(family, found, make, period, jnp.asarray(start), jnp.asarray(span))
    names = MET.get(kind, ())
    if family.shooting.reversible:  # Multipliers of a reversible orbit always come in pairs.
        names = tuple(name for name in names if name == "cusp")
    size = problem.size

    def ends(x, r):
        if kind == "Neimark-Sacker" and not 0 < x[size + 1] < np.pi:
            return "the multipliers met on the real axis"
        if kind == "branch point" and abs(x[2 * size + 1]) > SYMMETRIC:
            return "the lattice no longer has the symmetry that the branch point breaks"
        return None

    curve = continuation(
        problem,
        x,
        0.0,
        until=(0.0, 1.0),
        arclength=arclength,
        longest_arclength=5 * arclength,
        points=points,
        tolerance=LEFT * float(family.left),
        stop=ends,
        find=("fold",),
    )
    system = System(problem, LEFT * float(family.left))
    special = []
    tested = None
    for i, (here, there) in enumerate(curve.steps):
        before, left = tested or _tested(problem, here, names)
        tested = behind, _ = _tested(problem, there, names, left)
        for name in names:
            if before[name] * behind[name] < 0:
                test = lambda point: _tested(problem, point, names, left)[0][name]
                found = system.zero(here, there, test)
                state = family.shooting.state(found.x[:size])
                at = float(family.value(found.x[size])), start + found.p * span
                special.append(LocusPoint(name, *at, jax.tree.map(np.asarray, state), i))
    known = [_known(problem, x, r) for x, r in zip(curve.x, curve.p)]
    states = [family.shooting.state(x[:size]) for x in curve.x]
    own = curve.x[:, size + 1]
    angles = {
        # The last point may lie beyond the real axis, on the same curve.
        "Neimark-Sacker": np.abs((own + np.pi) % (2 * np.pi) - np.pi),
        "Krein collision": np.arccos(np.clip(own, -1, 1)),
        "period doubling": np.pi,
    }
    return Locus(
        kind,
        np.asarray(family.value(curve.x[:, size])),
        start + curve.p * span,
        np.abs(float(family.span)) * np.array(known),
        stacked(states),
        angles.get(kind, 0.0) + np.zeros(len(own)),
        tuple(special),
        curve,
        (start, span),
        **family.scene(jnp.zeros(()))[0].origin,
    )


def _begun(family, bifurcation, make, period, start, span):
    z = bifurcation._z
    kind = bifurcation.kind
    X = z[:-1]
    q = z[-1]
    empty = jnp.zeros(0)
    problem = _Critical(family, make, period, kind, start, span, empty, empty, X.size)
    here = problem.at(0.0)
    # The two-parameter function must begin with the branch.
    size = np.abs(residual_of(here, X, q)).max()
    if not size <= 1e4 * max(float(family.left), np.abs(residual_of(family, X, q)).max()):
        refuse(
            "make",
            "lattices that at `start` are those of the branch",
            f"an orbit off by {size:.1e}",
        )
    angle = float(np.angle(bifurcation.multiplier)) if kind == "Neimark-Sacker" else 0.0
    if problem.of_displacements:
        eye = np.eye(family.shooting.count)
        T = np.stack([problem.turned(here, X, q, e) for e in eye], 1)
        mu = -1.0
        if kind == "Krein collision":
            found = np.linalg.eigvals(T)
            alone = np.eye(len(found)) + (np.abs(1 - found**2) < 1e-3)
            apart = np.abs(found[:, None] - found) + 1e9 * alone
            i, j = np.unravel_index(np.argmin(apart), apart.shape)
            mu = float((found[i] + found[j]).real / 2)
        A = T - mu * eye
    else:
        rho = {"period doubling": -1.0, "Neimark-Sacker": np.exp(1j * angle)}.get(kind, 1.0)
        A = _matrix(problem, here, X, q, rho)
    left, _, right = np.linalg.svd(A)
    v = right[-1].conj()

    def across(b):
        # A solution of A x = b, orthogonal to v.
        x = np.linalg.lstsq(A, b, rcond=1e-6)[0]
        return x - (v @ x) * v

    rest = [v]
    if kind == "Krein collision":
        rest = [[mu], v, across(v)]
    elif kind == "branch point":
        rest = [v, [0.0], across(np.negative(_curvature(here, X, q, v)))]
    elif kind == "Neimark-Sacker":
        # The phase is chosen so that real and imaginary part are orthogonal.
        v = v * np.exp(-0.5j * np.angle(v @ v))
        v = v / np.linalg.norm(v.real)
        s = np.linalg.norm(v.imag)
        rest = [[angle, np.sin(angle) / s, s], v.real, v.imag / s]
    x = np.concatenate([z, *rest])
    return dataclasses.replace(problem, fixed=v.real, left=left[:, -1].real), x


def _matrix(problem, family, X, q, rho):
    E = np.stack([problem.started(e) for e in jnp.eye(X.size)], 1)
    return np.asarray(linearised(family, X, q)[1]) + (1 - rho) * E


def _tested(problem, point, names, before=None):
    # Numbers of a point that change their sign at special points, and the left null vector that
    # they use, in the direction of `before`.
    size = problem.size
    if problem.kind == "Neimark-Sacker" or not names:
        return {name: point.x[size + 1] - RESONANT[name] for name in names}, None
    X, q, v = np.split(point.x[: 2 * size + 1], [size, size + 1])
    family = problem.at(point.p)
    rho = -1.0 if problem.kind == "period doubling" else 1.0
    w = np.linalg.svd(_matrix(problem, family, X, q[0], rho))[0][:, -1]
    w = w if before is None else w * np.sign(w @ before)
    along = lambda name: _curvature(family, X, q[0], v) if name == "cusp" else problem.started(v)
    return {name: float(w @ np.asarray(along(name))) for name in names}, w


def _moved(family, X, q, v):
    # dF/dX v of the orbit's residual.
    return jax.jvp(lambda X: family.residual(X, q), (X,), (v,))[1]


@compiled
def _curvature(family, X, q, v):
    # D^2 F [v, v].
    return jax.jvp(lambda X: _moved(family, X, q, v), (X,), (v,))[1]


@compiled
def _known(problem, x, r):
    # By how much twice the steps move the parameter q at this r.
    jacobian = problem.linearise(x, r)[1]
    finer = eqx.tree_at(lambda p: p.family.shooting, problem, problem.family.shooting.finer(2))
    inverse = jnp.linalg.inv(jacobian)[problem.size]
    rounding = 16 * jnp.finfo(x.dtype).eps * jnp.sum(jnp.abs(inverse))
    return 2 * jnp.abs(inverse @ finer.residual(x, r)) + rounding
