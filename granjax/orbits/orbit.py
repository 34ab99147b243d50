"""A periodic orbit, y(t0 + T) = S y(t0): how to find one, and its error by doubled steps."""

import dataclasses
import math
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree
from jax.typing import DTypeLike

from ..base.checks import concrete, positive, refuse, traced
from ..base.checks import tolerance as checked_tolerance
from ..base.programs import compiled, in_numpy, library
from ..base.tuning import one_thread
from ..base.types import (
    Count,
    Counts,
    Displacements,
    Flags,
    Number,
    Numbers,
    Pytree,
    Scalar,
    StateLike,
    Times,
)
from ..continuation.newton import CONVERGED, SPENT, STALLED, Root, newton
from ..flow import Flow
from ..lattice import Lattice, State, vector_field
from ..results import Held, Result, array, hidden, part
from ..states import rest
from ..terms.reach import reads
from .asked import (
    Symmetry,
    checked_state,
    checked_symmetry,
    flow_over,
    history,
    largest,
    one_lattice,
    phases,
)
from .floquet import Floquet, floquet
from .problems import Shooting

# The default tolerance of an orbit, relative to its size.
TOLERANCE = 1e-8
# The same for the orbits of a branch.
BRANCH = 1e-7
# The share of the tolerance that Newton's method may leave.
LEFT_ON_BRANCH = 1e-4
# The most doublings of the steps.
DOUBLINGS = 10
# The safety factor for a change by other steps, where they are not half as many.
SAFETY = 2
# The rounding of a residual, in units of its last place.
ROUNDING = 16
# An orbit known no better than to this share of its size may be one of many.
UNKNOWN = 0.03
# No unknown counts as known better than this share of the largest error.
SHARED = 0.1


class OrbitError(Result):
    """The estimated distance of an orbit from the true one at the same frequency (or energy).

    It is estimated from two step sizes: zero for a number that was prescribed, NaN if no orbit was
    found.
    """

    state: State = part("The error of every entry of the state.", "site")
    energy: Number = array("The error of the energy.", "J")
    omega: Number = array("The error of the frequency.", "rad/s")
    period: Number = array("The error of the period.", "s")

    @property
    def outcome(self) -> str:
        """The errors of displacements and energy, in one sentence."""
        if traced(self.energy) or np.ndim(self.energy):
            return "By what other steps change."
        return (
            f"Displacements to {largest(self.state.u):.1e}, the energy to {float(self.energy):.1e}."
        )


def newtons(tolerance: Scalar, dtype: DTypeLike, share: float = 1e-3) -> Scalar:
    """Return the residual that Newton's method may leave for an orbit of this tolerance.

    Tolerances that the number type cannot hold are refused.
    """
    # A residual resolves fifty units in the last place.
    least = 50 * float(jnp.finfo(dtype).eps)
    tolerance = checked_tolerance("tolerance", tolerance)
    if not traced(tolerance) and tolerance < least:
        refuse(
            "tolerance",
            f"at least {least:.1e}, what {jnp.dtype(dtype).name} can hold",
            repr(float(tolerance)),
        )
    # Not below 1e-12, the rounding of long flows.
    xp = library(tolerance)
    return xp.maximum(share * xp.asarray(tolerance), xp.minimum(tolerance, max(1e-12, least)))


def covering(changes: Numbers, rounding: Number) -> Numbers:
    """Return the error of unknowns (n,) from their changes (k, n) by other steps, and rounding."""
    xp = library(changes)
    change = SAFETY * xp.max(abs(changes), 0)
    return xp.maximum(change, SHARED * xp.max(change)) + rounding


def rounding(inverse: Numbers, size: Scalar = 1.0) -> Numbers:
    """Return the effect on the unknowns of rounding a residual of this size.

    `inverse`: that of the residual's derivative.
    """
    return ROUNDING * jnp.finfo(inverse.dtype).eps * size * jnp.max(jnp.sum(jnp.abs(inverse), 1))


def stays(changes: list) -> bool:
    """Return whether doubled steps no longer help."""
    # Where contacts open, one of them may be small by accident.
    return len(changes) > 3 and bool(min(changes[-2:]) > max(changes[-4:-2]) / 2)


@compiled
def _corrected(problem, root, scene):
    # The change of the unknowns that finer steps would make, by a Newton step.
    problem, root, scene = jax.lax.stop_gradient((problem, root, scene))
    inverse = jnp.linalg.inv(root.jacobian)
    # Where contacts open, the change between two step sizes may be small by accident.
    finer = jnp.asarray((1.25, 1.5, 2.0))
    changes = jax.lax.map(lambda by: inverse @ problem.finer(by).residual(root.x, scene), finer)
    return jnp.where(root.code == CONVERGED, covering(changes, rounding(inverse)), jnp.nan)


def confirmed(
    problem: Any,
    x: Numbers,
    scene: Pytree,
    *,
    tolerance: Scalar,
    max_steps: Count,
    throw: bool | None,
    refine: bool = True,
    spread: float = 1.0,
) -> tuple[Any, Root, Numbers]:
    """Solve, then solve with twice the steps until nothing changes: (problem, root, error).

    `problem` has `residual`, `linearise` and `finer(by)`. Without `refine` its steps stay, and only
    the error of the unknowns is estimated. If Newton's method fails with the first steps, more are
    tried. The orbit's size in the unknowns is 1/`spread`.
    """

    def solve(problem, x):
        root = newton(
            problem.residual,
            x,
            scene,
            tolerance=newtons(tolerance, x.dtype),
            max_steps=max_steps,
            linearise=problem.linearise,
            throw=False,
        )
        # The error covers rounding and an almost singular derivative.
        code, left = in_numpy((root.code, root.residual))
        enough = ((code == STALLED) | (code == SPENT)) & (left <= tolerance)
        code = library(code).where(enough, CONVERGED, code)
        return dataclasses.replace(root, code=jax.device_put(code))

    problem = problem.finer(1) if refine else problem
    root = solve(problem, x)
    # A function may hide tracers, which the root then shows.
    known = not traced(root.code)
    finer = problem
    # Steps that are too long for Newton's method are halved up to four times.
    for _ in range(4 if refine and known else 0):
        if root.converged:
            break
        finer = finer.finer(2)
        found = solve(finer, x)
        # If more steps change nothing, the steps are not the cause.
        same = abs(found.residual - root.residual) <= 1e-3 * root.residual
        if found.converged or found.residual < root.residual:
            problem = finer
            root = found
        if same:
            break
    if known and not root.converged and (throw is None or throw):
        raise RuntimeError(root.outcome)
    if not (known and refine and root.converged):
        return problem, root, _corrected(problem, root, scene)
    first = root.first
    iterations = root.iterations
    changes = []
    for _ in range(DOUBLINGS):
        finer = problem.finer(2)
        found = solve(finer, root.x)
        if not found.converged:
            return problem, root, _corrected(problem, root, scene)
        change = np.abs(np.asarray(found.x) - np.asarray(root.x))
        iterations = jax.device_put(np.asarray(iterations) + np.asarray(found.iterations))
        found = dataclasses.replace(found, first=first, iterations=iterations)
        problem = finer
        root = found
        if spread * change.max() <= tolerance:
            change = np.maximum(change, _corrected(problem, root, scene))
        changes.append(change.max())
        if spread * changes[-1] <= tolerance or stays(changes):
            break
    return problem, root, jnp.asarray(np.maximum(change, SHARED * change.max()))


@compiled
def error_of(
    lattice: Lattice, t0: Scalar, state: State, apart: State, period: Scalar, in_omega: Scalar = 0.0
) -> OrbitError:
    """Return the `OrbitError` of a state known up to `apart`, at a frequency up to `in_omega`."""
    in_omega = jnp.asarray(in_omega)
    omega = 2 * jnp.pi / period
    apart = jax.tree.map(jnp.abs, apart)
    slope = jax.grad(lambda y: jnp.sum(lattice.energy(t0, y.u, y.v)))(state)
    energy = sum(
        jnp.sum(jnp.abs(g) * e) for g, e in zip(jax.tree.leaves(slope), jax.tree.leaves(apart))
    )
    return OrbitError(apart, energy, in_omega, 2 * jnp.pi / omega**2 * in_omega, **lattice.origin)


# The default number of frames of a period, over which means are taken.
FRAMES = 32
# An orbit below this share of its unit of length counts as rest: the guess's size, or the amplitude
# at which forces become nonlinear.
AT_REST = 1e-6
# The code of an orbit at rest, in addition to the codes of `newton`.
FELL = 4
# The code of an orbit that is not a breather.
SPREAD = 5
# The code of a motion that drifts away.
DRIFTS = 6
# The code of a state whose energy returns, while the state does not.
UNCLOSED = 7
# A gap of the mean velocity above this share of the orbit's size is a drift, and one along the
# energy's gradient no rounding.
DRIFT = 1e-6
DRIFTING = (
    "No orbit was found: the forces drive the lattice away, and nothing holds it. Hold a site, or "
    "take forces whose mean over a period is zero."
)
NOT_CLOSED = (
    "No orbit of this period was found near the guess: after one period the energy is the same, but "
    "not the state. Try a larger guess, or a period on the other side of that of the linear mode."
)


class OrbitRun(Result):
    """One period of an orbit in frames of equal distance, without the end.

    Means over them are integrals over the period to the accuracy of a Fourier series.
    """

    ts: Times = array("The times.", "s", "time", name="time")
    us: Displacements = array("The displacements.", "m", "time site", name="u")
    vs: Displacements = array("The velocities.", "m/s", "time site", name="v")

    @property
    def outcome(self) -> str:
        """The number of frames."""
        return f"One period in {self.ts.shape[-1]} frames."


class Orbit(Result):
    """A periodic orbit of a lattice, driven or not: y(t0 + T) = S y(t0)."""

    exported: ClassVar[dict[str, Held]] = {"omega": Held(unit="rad/s")}
    state: State = part("The state at `t0`; a breather is at rest there.", "site")
    period: Number = array("The period T.", "s")
    lattice: Lattice = hidden("The lattice.")
    root: Root = hidden("How Newton's method ended.")
    flow: Flow = hidden("The steps and the solver over a period.")
    t0: Number = array("The time at which the orbit begins.", "s")
    energy: Number = array("The energy at `t0`, from equilibrium.", "J")
    symmetry: Symmetry = hidden(
        "S. The state itself returns after T times the order of S.", default=Symmetry()
    )
    error: OrbitError | None = array(
        "The estimated distance from the true orbit, from two step sizes.", default=None
    )
    remark: str = hidden(
        "What the outcome adds; for a breather how many cells share its energy.",
        static=True,
        default="",
    )

    def _fields(self):
        yield from super()._fields()
        yield "steps", self.flow.steps, Held()
        if not self.symmetry.trivial:
            yield "symmetry", repr(self.symmetry), Held()

    @property
    def omega(self) -> Number:
        """2 pi/T; the motion itself repeats after T times the order of S."""
        return 2 * np.pi / self.period

    @property
    def residual(self) -> Numbers:
        """The residual that Newton's method left.

        It is max |v(T/2)| for a breather, else max |y(t0 + T) - S y(t0)| relative to the orbit's
        size: displacements to the largest one, velocities to that times 2 pi/T.
        """
        return self.root.residual

    @property
    def converged(self) -> Flags:
        """Whether the residual is below the tolerance, and the orbit neither rest nor a wave.

        A wave is excluded for breathers only.
        """
        return self.root.converged

    @property
    def outcome(self) -> str:
        """How Newton's method ended, in one sentence."""
        code = in_numpy(self.root.code)
        if traced(code) or not np.any(code >= FELL):
            return " ".join(
                said for said in (self.root.outcome, self._known(), self.remark) if said
            )
        code_of_root = np.where(code >= FELL, CONVERGED, code)
        went = dataclasses.replace(self.root, code=code_of_root).outcome
        return {
            FELL: f"The guess fell to rest, where every time is a period: {went}",
            SPREAD: f"{self.remark} {went}",
            DRIFTS: DRIFTING,
            UNCLOSED: NOT_CLOSED,
        }[int(np.max(code))]

    def _known(self):
        if self.error is None or traced(self.error.energy) or jnp.ndim(self.period):
            return ""
        pair = self.state, self.error.state
        size, error = (max(largest(y.u), largest(y.v) / float(self.omega)) for y in pair)
        if not (size > 0 and np.isfinite(error)):
            return ""
        known = f"It is known to {error / size:.1e} of its size."
        many = " It may be one of many, as in an integrable lattice."
        return known + many if error > UNKNOWN * size else known

    def run(self, frames: Count = FRAMES) -> OrbitRun:
        """Return the orbit in time, an `OrbitRun`."""
        _, ts, ys = _history(self.flow, self.lattice, self.state, self.t0, self.period, frames)
        return OrbitRun(ts, ys.u, ys.v, **self.lattice.origin)

    def harmonics(self, count: Count = 1, frames: Count = FRAMES) -> Displacements:
        r"""Return complex Fourier amplitudes c_k of every displacement, k = 0 ... count.

        u = Re sum_k c_k exp(2 pi i k t/T). **Returns:** (count + 1, N), or a dict of such. It needs
        count < frames/2. **Raises** ValueError if S is not the identity, as `amplitude` and
        `rms_velocity` do: u then repeats only after T times the order of S.
        """
        self._refuse_symmetry()
        if not count < frames / 2:
            refuse("count", f"fewer than half of the {frames} frames", repr(count))
        run = self.run(frames)
        k = jnp.arange(count + 1)
        weights = (
            jnp.exp(-2j * jnp.pi * k[:, None] * run.ts / self.period)
            * jnp.where(k, 2, 1)[:, None]
            / frames
        )
        return jax.tree.map(lambda u: jnp.tensordot(weights, u, 1), run.us)

    @property
    def amplitude(self) -> Displacements:
        """The amplitude |c_1| of every site at the frequency 2 pi/T, (N,)."""
        return jax.tree.map(lambda c: jnp.abs(c[1]), self.harmonics())

    @property
    def rms_velocity(self) -> Displacements:
        """The root mean square velocity of every site over a period, (N,)."""
        self._refuse_symmetry()
        return jax.tree.map(lambda v: jnp.sqrt(jnp.mean(v * v, 0)), self.run().vs)

    def _refuse_symmetry(self):
        if not self.symmetry.trivial:
            refuse(
                "orbit",
                "one that returns itself after T",
                f"one that returns up to {self.symmetry!r}",
                "Ask gx.orbits.orbit(lattice, state, T times the order of the symmetry) for it.",
            )

    @property
    def energy_input(self) -> Number:
        """The energy that damping takes in a period: -int sum v . F_damping dt [J].

        The drive supplies as much.
        """
        run = self.run()
        lattice = self.lattice
        lossy = [term for term in lattice.terms if reads(term, lattice).velocity]

        def power(t, u, v):
            force = lattice.sum_forces(t, u, v, lossy)
            return -sum(jnp.sum(f * v) for f, v in zip(jax.tree.leaves(force), jax.tree.leaves(v)))

        return self.period * jnp.mean(jax.vmap(power)(run.ts, run.us, run.vs))

    def floquet(self, **keywords: Any) -> Floquet:
        """Return multipliers of S^-1 y(t0 + T) and stability, from `granjax.floquet.floquet`.

        `keywords`: of that function.
        """
        keywords = {"symmetry": self.symmetry} | keywords
        return floquet(self.lattice, self.state, self.period, t0=self.t0, **keywords)


@one_thread
def orbit(
    lattice: Lattice,
    guess: StateLike,
    period: Scalar,
    *,
    symmetry: Symmetry = Symmetry(),
    t0: Scalar = 0.0,
    steps: Count | Counts | None = None,
    segments: Count = 1,
    transient: Count = 0,
    solver: AbstractSolver | None = None,
    tolerance: Scalar = TOLERANCE,
    max_steps: Count = 20,
    throw: bool | None = None,
) -> Orbit:
    r"""Find an orbit of a lattice, y(t0 + T) = S y(t0), by Newton's method.

    Under T-periodic forcing the root is isolated, since the drive sets the phase. Without forcing
    and damping the orbits form a family over T, and the phase is that of the guess. The mean
    displacement of a freely moving lattice is zero. With `Translation(1)` on a ring the wave
    reappears one site further after T, at the speed 1/T: a rotating wave. The root need not be
    stable. Where several orbits exist the guess decides. It works under `jit` and `vmap` and is
    differentiable in the lattice and the period: in forward mode, and in reverse mode if `steps` is
    given.

    **Arguments:**

    - `lattice`: under T-periodic forcing (or T/2, T/3 ...), or with neither forcing nor damping.
    - `guess`: a `State` at t0. `transient`: periods that are run from it before Newton begins; in a
      driven, damped lattice some 1/(gamma T) of them lead to the orbit to which a run would settle.
    - `period`: T > 0. A multiple of the drive's period gives orbits after a period doubling.
    - `symmetry`: S, built from `Translation(cells)`, `Mirror()` and `Sign()`; by default the
      identity.
    - `t0`: phase of the drive at which the state is taken.
    - `steps`: per period; `None` begins at h omega_max <= 0.3, with omega_max the highest linear
      frequency, and doubles them until a second step size confirms the orbit (not under a
      transformation). They may be traced.
    - `segments`: of multiple shooting, for long or strongly unstable orbits. `solver`: with a fixed
      step; `None` is SRKN14a, or diffrax's Dopri8 where a force reads velocities other than by
      `Damping`.
    - `tolerance`: of the orbit, relative to the amplitude (of the guess, or its image after a
      period); Newton's method goes to a thousandth of it.
    - `max_steps`: the most Jacobians. `throw`: raise if it does not converge; `None` does so
      outside of transformations.

    **Returns:** `Orbit`. **Raises** ValueError for a period that is not positive or not one of the
    forcing, a batch of lattices, steps that the segments do not divide, a map that is not a
    symmetry of the lattice, or a guess at rest where nothing moves it; RuntimeError if `throw` and
    it did not converge, fell to such rest, or does not return.

    **Example:**

    >>> chain = gx.driven.driven_chain(gx.scenes.monomer(3, precompression=1.0), 0.01, 0.5, damping=0.5)
    >>> found = gx.orbits.orbit(chain, gx.states.rest(chain), 2 * np.pi / 0.5, steps=64)
    >>> bool(found.converged), round(float(found.omega), 6)
    (True, 0.5)
    """
    one_lattice(lattice)
    period = positive("period", period)
    guess = checked_state(lattice, guess, "guess")
    flow = flow_over(lattice, period, steps, solver, segments, guess)
    checked_symmetry(lattice, symmetry, guess, t0, period)
    t0 = jnp.asarray(t0, lattice.dtype)
    free = checked_free(lattice)
    unknown = traced((lattice, period, guess))
    if free and not unknown and not largest(vector_field(t0, guess, lattice)):
        refuse("guess", "a state that moves, since nothing drives the lattice", "rest")
    shooting, x = prepared(
        lattice, period, guess, flow, t0, segments, jnp.asarray(transient), symmetry, free
    )
    shooting, root, apart = confirmed(
        shooting,
        x,
        (lattice, period),
        tolerance=tolerance,
        max_steps=max_steps,
        throw=throw,
        refine=steps is None and not unknown,
        spread=math.sqrt(2 * shooting.count * segments),
    )
    return orbit_of(shooting, (lattice, period), root, apart, guess, throw)


def forced_orbit(
    lattice: Lattice, period: Scalar, guess: StateLike | None = None, **keywords: Any
) -> Orbit:
    """Find a T-periodic orbit of a lattice under T-periodic forcing: `gx.orbits.orbit`.

    `guess`: a `State` at t0. `None` is rest, from which Newton's first iterate is the linear
    response, as far as one period from rest is linear. `keywords`: of `gx.orbits.orbit`.
    **Returns:** `Orbit`. **Raises** ValueError as there, and without a guess if nothing moves a
    lattice at rest, for example if only its stiffness changes in time.

    **Example:**

    >>> chain = gx.driven.driven_chain(gx.scenes.monomer(3, precompression=1.0), 0.01, 0.5, damping=0.5)
    >>> found = gx.forced.forced_orbit(chain, 2 * np.pi / 0.5, steps=64)
    >>> bool(found.converged), np.array(found.state.v).round(4).tolist()
    (True, [0.0021, 0.0028, 0.0021])
    """
    one_lattice(lattice)
    if guess is None:
        guess = rest(lattice)
        pushed = (
            concrete(_pushed(lattice, keywords.get("t0", 0.0), period))
            if lattice.reads_time
            else None
        )
        if pushed is not None and not pushed > 0:
            refuse(
                "guess",
                "a State that moves",
                "None, rest, which is an orbit of its own",
                "No force acts there at any time: stiffness alone changes. Waves that grow are those of "
                "gx.linear.floquet_bands; a breather of a k-gap is gx.breathers.k_gap_breather's.",
            )
    return orbit(lattice, guess, period, **keywords)


@compiled
def _pushed(lattice, t0, period):
    ts = phases(t0, period, (np.arange(16) + 0.5) / 16)
    return largest(jax.vmap(lambda t: vector_field(t, rest(lattice), lattice)[1])(ts))


def checked_free(lattice: Lattice) -> bool:
    """Return whether nothing drives the lattice. **Raises** ValueError for damping alone."""
    if not lattice.reads_time and not lattice.conserves:
        remedy = "A damped lattice without forcing comes to rest."
        refuse("lattice", "forcing, or neither forcing nor damping", "damping alone", remedy)
    return not lattice.reads_time


def orbit_of(
    shooting: Shooting,
    scene: tuple,
    root: Root,
    apart: Numbers,
    guess: State,
    throw: bool | None,
    in_omega: Scalar = 0.0,
) -> Orbit:
    """Return the orbit of a root that is known up to `apart`, and in its frequency `in_omega`.

    Rest from a moving guess, and a motion that does not return, are marked.
    """
    lattice = scene[0]
    period = jnp.asarray(scene[1], lattice.dtype)
    numbers = root.x, root.code, root.residual, apart, in_omega
    found = _reached(shooting, lattice, period, guess, *numbers)
    state, t0, energy, error, code, residual = found
    root = dataclasses.replace(root, code=code, residual=residual)
    orbit = Orbit(
        state, period, lattice, root, shooting.whole, t0, energy, shooting.symmetry, error
    )
    lost = not traced(root.code) and np.asarray(root.code) in (FELL, DRIFTS, UNCLOSED)
    if lost and (throw is None or throw):
        raise RuntimeError(orbit.outcome)
    return orbit


@compiled
def _reached(shooting, lattice, period, guess, x, code, residual, apart, in_omega):
    # Returns the state at t0, the energy, the error, and the code and the residual of the root:
    # FELL if the orbit is at rest, DRIFTS or UNCLOSED if it does not return.
    state = shooting.state(x)
    t0 = jnp.asarray(shooting.t0, lattice.dtype)
    omega = 2 * jnp.pi / period

    def speed(y, t=t0):
        v, a = vector_field(t, y, lattice)
        return jnp.maximum(omega * largest(v), largest(a))

    found = speed(state)
    before = speed(guess)
    fell = (code == CONVERGED) & (before > 0) & (found <= AT_REST * before)
    if lattice.reads_time:  # A lattice that is driven at rest may well move only a little.
        ts = phases(t0, period)
        fell = fell & (
            largest(jax.vmap(lambda t: speed(rest(lattice), t))(ts)) <= AT_REST**2 * before
        )
    code = jnp.where(fell, FELL, code)
    gap = shooting.gap(lattice, x)
    allowed = DRIFT
    if not shooting.driven:  # The orbit may be much smaller than the guess, and steps too few.
        allowed = DRIFT * found / (omega * shooting.scale[-1]) + shooting.gap(lattice, apart)
    unclosed = (code == CONVERGED) & (gap > allowed)
    code = jnp.where(unclosed, DRIFTS if shooting.driven else UNCLOSED, code)
    residual = jnp.where(unclosed, gap, residual)
    apart = shooting.state(jnp.where(unclosed, jnp.nan, apart))
    error = error_of(lattice, t0, state, apart, period, in_omega)
    energy = lattice.energy(t0, state.u, state.v)
    return state, t0, energy, error, code, residual


def prepared(
    lattice: Lattice,
    period: Scalar,
    guess: State,
    flow: Flow,
    t0: Scalar,
    segments: int,
    transient: Counts,
    symmetry: Symmetry = Symmetry(),
    free: bool = False,
) -> tuple[Shooting, Numbers]:
    """Return the problem and the unknowns of the guess; neither is differentiated.

    The norm of the unknowns is the relative amplitude, whatever the units of the lattice: their
    unit is the size of the guess, or that a period later if it is larger.
    """
    shooting, x = _prepared(lattice, period, guess, flow, t0, segments, transient, symmetry, free)
    # A program returns arrays. A loop over a known number of steps has derivatives in reverse mode.
    if isinstance(flow.steps, int):
        shooting = eqx.tree_at(lambda s: s.flow.steps, shooting, flow.steps // segments)
    return shooting, x


@compiled
def _prepared(lattice, period, guess, flow, t0, segments, transient, symmetry, free):
    lattice, period, guess = jax.lax.stop_gradient((lattice, period, guess))
    guess = jax.lax.fori_loop(0, transient, lambda i, y: flow(y, t0, t0 + period, lattice), guess)
    end = flow(guess, t0, t0 + period, lattice)
    n = ravel_pytree(guess.u)[0].size
    omega = 2 * jnp.pi / period
    x = jnp.stack([ravel_pytree(y)[0] for y in (guess, end)])
    size = jnp.maximum(jnp.max(jnp.abs(x[:, :n])), jnp.max(jnp.abs(x[:, n:])) / omega)
    size = jnp.where((size > 0) & jnp.isfinite(size), size, 1) * math.sqrt(2 * n * segments)
    scale = jnp.concatenate([jnp.full(n, size), jnp.full(n, size * omega)])
    shooting = Shooting.of(
        lattice,
        Flow(flow.steps // segments, flow.solver),
        guess if free else None,
        t0,
        segments,
        scale=scale,
        symmetry=symmetry,
    )
    return shooting, shooting.guess(guess, (lattice, period))


_history = compiled(history)
