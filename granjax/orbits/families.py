"""Breathers: single ones, families, and branches from the anticontinuous limit."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver

from ..base.checks import described, is_site, one_of, positive, refuse, traced
from ..base.programs import compiled, in_numpy, library
from ..base.tuning import one_thread
from ..base.types import Count, Counts, Numbers, Scalar, Scene, Site, StateLike
from ..base.units import SI
from ..continuation.arclength import bordered
from ..flow import Flow
from ..flow.stepping import matrix
from ..lattice import Lattice, State
from ..linear import bands, normal_modes
from ..measures import modal_energy
from ..results import Result, array, hidden, part
from ..solvers import KahanLi8
from ..states import rest
from .asked import (
    Sign,
    checked_lattice,
    checked_state,
    checked_symmetry,
    default_steps,
    known_lattice,
    largest,
)
from .branch import Branch, branch_of, examined, examined_along
from .floquet import raveled
from .guesses import (
    bright_guess,
    dark_guess,
    edge_of,
    edges_beside,
    local_guesses,
    named_sites,
    refuse_bright,
    single_site,
)
from .localised import FEWEST, checked_localised, localisation
from .orbit import BRANCH, LEFT_ON_BRANCH, TOLERANCE, Orbit, confirmed, newtons, orbit_of, stays
from .problems import Family, Shooting, over_omega
from .scales import nonlinear_length


@one_thread
def family(
    lattice: Lattice,
    until: Scalar | None = None,
    *,
    guess: Orbit | None = None,
    amplitude: Scalar | None = None,
    mode: Count | None = None,
    arclength: Scalar = 0.05,
    longest_arclength: Scalar | None = None,
    points: Count = 200,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
    tolerance: Scalar = BRANCH,
    stability: bool = True,
    stop: Callable[[Any, Any], Any] | None = None,
) -> Branch:
    r"""Follow a family of time-reversible breathers in (u, omega), with its stability.

    Without a `guess` it begins at a linear mode (a Lyapunov family) at zero amplitude and the
    mode's frequency. The branch is followed by pseudo-arclength through folds. Modes are waves,
    except those of defects. Between walls or free ends their families localise as they grow; on a
    ring they may stay waves, which `gx.breathers.localisation` tells. A `guess` from
    `gx.breathers.breather` begins at a localised breather.

    **Arguments:**

    - `lattice`: a conservative, autonomous `Lattice`; bright families need a gap, and a mode that
      shifts into it.
    - `until`: the frequency at which to end; `amplitude`: the largest |u| at which to end. One of
      them, or `points`.
    - `guess`: a breather (an `Orbit`) to begin at. `mode`: index of the linear mode; `None` takes
      the mode next to `until` whose frequency moves towards it, and without `until` the highest.
    - `arclength`, `longest_arclength`: first and longest step along the branch (7.5 times the
      first), in (u, omega). The unit of omega is the first frequency; that of u is
      `scales.nonlinear_length`: the amplitude at which a contact's stiffness has changed by a half
      (3/8 of the overlap for Hertz and neighbours in opposite phase).
    - `points`: the most breathers. `solver`: of fixed steps. `steps`: per period, even; `None`
      begins at h omega_max = 0.3 and doubles them until the largest breather is known to
      `tolerance`, relative to its amplitude, and its tangent map to 1e-8, or as well as opening
      contacts allow.
    - `stability`: whether to compute the multipliers. `stop(u, omega)`: returns a reason to end the
      family there, or `None`.

    **Returns:** `Branch`. **Raises** ValueError for a lattice that is damped, driven or a batch, a
    mode that does not exist, both `mode` and `guess`, and an `until` that is not above zero;
    RuntimeError if the first breather is not found.
    Source: Flach, Gorbach, Phys. Rep. 467, 1 (2008); Theocharis et al., Phys. Rev. E 82, 056604
    (2010).

    **Example:**

    >>> chain = gx.scenes.klein_gordon(5, 0.02)
    >>> branch = gx.breathers.family(chain, points=3, arclength=0.3, steps=64, stability=False)
    >>> branch.outcome
    'The 3 points that were asked for.'
    >>> branch.omega.round(4).tolist()
    [1.0356, 1.0356, 1.0357]
    """
    checked_lattice(known_lattice(lattice))
    if guess is not None and mode is not None:
        refuse("mode", "a mode or a guess", "both", "A guess says where the family begins.")
    if until is not None:
        positive("until", until)
    ways = _modes(lattice, until, mode) if guess is None else [_from(guess, until)]
    longest_arclength = 7.5 * arclength if longest_arclength is None else longest_arclength

    def follow(way, count, most=points):
        # The frequency is in units of that at the start.
        unit = jax.device_put(np.asarray(way.omega, float))
        scene = {"make": lattice, "period": over_omega, "span": unit}
        problem = _family(lattice, count, solver, way.length, way.omega, tolerance, **scene)
        free = np.zeros(problem.shooting.moves.shape[1])
        direction = way.direction
        if np.ndim(direction):
            direction = np.concatenate([direction, free, [0.0]])
        return problem, problem.follow(
            np.append(way.x, free),
            1.0,
            until=None if until is None else until / way.omega,
            direction=direction,
            points=most,
            # The step to the first orbit beside a linear mode is shorter.
            arclength=arclength if guess is not None else 0.1 * arclength,
            longest_arclength=longest_arclength,
            least_arclength=1e-6 * arclength,
            stop=_ends(problem, amplitude, stop),
        )

    count = half_steps(lattice, 2 * np.pi / ways[0].omega, steps or ways[0].steps)
    # Four points show which way a family goes.
    chosen = (
        ways[0] if len(ways) == 1 else _towards(ways, until, lambda way: follow(way, count, 4)[1])
    )
    return _confirmed_branch(
        lambda count: follow(chosen, count), count, steps is None, tolerance, stability
    )


def _confirmed_branch(follow, count, refine, tolerance, stability):
    # `follow(count)` takes `count` steps in half a period; with `refine` more are used if needed.
    problem, curve = follow(count)
    enough = _enough_steps(problem, curve, count, tolerance, stability) if refine else count
    if enough > count:
        problem, curve = follow(enough)
    along = examined_along(problem, curve, stability=stability)
    return branch_of(problem, curve, along)


def _enough_steps(problem, curve, count, tolerance, stability):
    # Enough for the largest breather and its tangent map, or as many as help.
    before = np.inf
    changes = []
    i = np.argmax(np.abs(curve.x).max(1))
    z = np.append(curve.x[i], curve.p[i])
    # At most eight doublings.
    for doubled in count * 2 ** np.arange(8):
        found = examined(problem.with_steps(doubled), z)
        error = found.step_error
        # If a doubling lowers the change of the map only a little, a contact opens.
        passes = not stability or error <= 1e-8 or error > before / 20
        changes.append(float(largest(found.error.state.u)))
        enough = changes[-1] <= tolerance * float(largest(found.state.u))
        if passes and (enough or stays(changes)):
            break
        before = error
    return int(doubled)


class _Way(NamedTuple):
    # The start of a family: beside a linear mode, or at a breather. `omega`, `length`: its units.
    # `x`: displacements at rest over the length. `direction`: +1 or -1, the way the frequency goes,
    # or displacements. `steps`: per period, where known.

    omega: float
    length: float
    x: np.ndarray
    direction: np.ndarray | float
    steps: int | None = None


def _from(guess, until):
    omega = float(guess.omega)
    u = guess.state.u
    size = float(largest(u))
    length = nonlinear_length(guess.lattice, u)
    length = max(size, length) if np.isfinite(length) else size
    direction = np.sign((until or np.inf) - omega)
    return _Way(omega, length, raveled(u) / length, direction or 1.0, _even_steps(guess))


def _modes(lattice, until, mode):
    modes = in_numpy(normal_modes(lattice))
    omega = modes.omega
    if mode is not None:
        if not is_site((mode,), (len(omega),)):
            refuse("mode", f"a whole number, that of one of {len(omega)} modes", described(mode))
        chosen = [mode]
    elif until is None:
        chosen = [len(omega) - 1]
    else:
        above = np.flatnonzero(omega > until)
        below = np.flatnonzero((omega < until) & (omega > 0))
        chosen = sorted([*above[:1], *below[-1:]], key=lambda i: abs(omega[i] - until))
    if not chosen or not omega[chosen[0]] > 0:
        squared = modes.omega_squared[chosen[0] if chosen else -1]
        refuse(
            "lattice",
            "a linear mode that oscillates",
            f"one of omega^2 = {squared:.3g} ({'unstable' if squared < 0 else 'a sonic vacuum?'})",
            "Give guess=, from gx.breathers.breather.",
        )
    return [
        _beside(lattice, float(omega[i]), jax.tree.map(lambda x: x[..., i], modes.modes))
        for i in chosen
    ]


def _beside(lattice, omega, mode):
    shape = raveled(mode)
    # The first of those that are equal to 1e-6, so that rounding does not choose the largest one.
    peak = shape[np.argmax(np.abs(shape) > (1 - 1e-6) * np.abs(shape).max())]
    length = nonlinear_length(lattice, jax.tree.map(lambda w: w / peak, mode))
    if not 0 < length < np.inf:
        refuse(
            "lattice",
            "a mode that becomes nonlinear at a finite amplitude above zero",
            f"the amplitude {length}",
            "Give guess=, from gx.breathers.breather.",
        )
    return _Way(omega, length, 0 * shape, shape / peak)


def _towards(ways, until, probe):
    said = []
    for way in ways:
        try:
            found = probe(way)
        except RuntimeError as failed:
            said.append(f"the family from the mode at {way.omega:.6g} was not found ({failed})")
            continue
        if (found.p[-1] - found.p[0]) * (until / way.omega - found.p[0]) > 0 or found.end == "p":
            return way
        said.append(
            f"the frequency of the mode at {way.omega:.6g} moves away from it with amplitude"
        )
    refuse(
        "until",
        "a frequency that a family moves to",
        f"{until:.6g}",
        f"Give mode= or guess=: {'; '.join(said)}.",
    )


def _ends(problem, amplitude, stop):
    # Ends a family early, with `amplitude` and `stop` in the lattice's own units.
    half = problem.shooting

    def why(x, q):
        u = half.state(x).u
        if amplitude is not None and float(largest(u)) >= amplitude:
            return f"the amplitude is {float(largest(u)):.4g}"
        return None if stop is None else stop(u, float(problem.value(q)))

    return None if amplitude is None and stop is None else why


def _even_steps(orbit):
    return 2 * -(-int(orbit.flow.steps) // 2)


def half_steps(
    lattice: Lattice,
    period: Scalar,
    steps: Count | Counts | None = None,
    guess: StateLike | None = None,
) -> Count | Counts:
    """Return the steps of half a period, from those of a whole one or by default.

    `guess`: as in `default_steps`.
    """
    if traced(steps):
        return steps // 2
    steps = default_steps(lattice, period, 2, doubled=True, guess=guess) if steps is None else steps
    if steps % 2:
        refuse("steps", "an even number, since half a period takes half of them", repr(steps))
    return steps // 2


def _family(lattice, steps, solver, length, omega, tolerance, **scene):
    # Half periods in units of `length` and `omega`. Another number of steps compiles nothing new.
    flow = Flow(jax.device_put(np.asarray(steps, int)), solver or KahanLi8())
    half = Shooting.half(lattice, flow, length=length, omega=omega)
    return Family(half, left=newtons(tolerance, lattice.dtype, LEFT_ON_BRANCH), **scene)


# A harmonic this close (relatively) to a frequency of the finite lattice is a resonance.
MEETS = 1e-9
# Neighbouring extended modes belong to one band if they are closer than this many mean spacings of
# the spectrum.
SPACING = 8
PUSHES = (
    "Its contacts push and never pull, and nothing else holds its parts together: over a period the mean force of "
    "every contact is the same, so zero where a motion is localised, and none of them ever closes. Give a "
    "precompression; breathers without one last long where resonators are heavy, and not forever."
)


@one_thread
def breather(
    lattice: Lattice,
    omega: Scalar,
    guess: StateLike | Orbit | str | None = None,
    *,
    energy: Scalar | None = None,
    centre: Scalar | None = None,
    steps: Count | Counts | None = None,
    solver: AbstractSolver | None = None,
    tolerance: Scalar = TOLERANCE,
    max_steps: Count = 30,
    check: bool = True,
    throw: bool | None = None,
) -> Orbit:
    r"""Find a time-reversible breather of frequency omega: v(0) = 0, v(T/2) = 0, T = 2 pi/omega.

    **Arguments:**

    - `lattice`: a conservative, autonomous `Lattice`. `omega`: [rad/s].
    - `energy`: if given (above zero), the breather of this energy is sought, starting from the one
      at omega. Its own frequency is then differentiable too: d omega/d parameter at constant
      energy.
    - `guess`: where Newton's method starts. `None`: the family from the linear mode next to omega;
      where that is a wave (on a ring) or does not exist (a sonic vacuum), the envelope's breather
      or one about a site. `"bright"`, `"dark"`: the envelope's soliton of a periodic chain, centred
      on `centre` (a site, or 3.5 for a bond; `None` is the middle); a dark one has the ends of the
      chain (free: constant force; walls or a ring: fixed length). Another breather; or a `State`,
      such as that of `guesses.single_site` or a simulated one, whose velocities are dropped.
    - `steps`: time steps per period, an even number, which may be traced; `None` doubles them until
      a second step size confirms the orbit.
    - `tolerance`: for that, over the guess's largest displacement (Newton's method: a thousandth).
      `max_steps`: the most Jacobians. `solver`: of fixed steps.
    - `check`: refuse a frequency with a harmonic in a band, or whose gap has no bright breathers,
      and an orbit that is not a breather: one whose participation number (of the cells' energies at
      rest) is above 0.6 of the cells, 0.4 in the plane (a wave between walls has 2/3, 4/9 in the
      plane), or above both half of the cells and twice that of the guess; for a dark one, no
      background or no dip in it. With fewer than five cells the share is reported but not judged.
    - `throw`: raise if Newton's method does not converge; `None` does so outside of
      transformations.

    With a `State` and `steps` it works inside `jit` and `vmap`. Its state and energy are then
    differentiable in every parameter of the lattice and in omega, by the implicit function theorem.

    **Returns:** `Orbit`, which reports how many cells share its energy; `throw=False` returns the
    best iterate.
    **Raises** ValueError for a frequency that has no such breather, with the reason, and for an
    energy that is not above zero; RuntimeError if Newton's method does not converge, or leads to
    rest or to a wave, with the participation number.

    **Example:**

    >>> chain = gx.scenes.klein_gordon(5, 0.02)
    >>> guess = gx.breathers.guesses.single_site(chain, 1.4, 2)
    >>> found = gx.breathers.breather(chain, 1.4, guess, steps=64)
    >>> bool(found.converged), round(float(found.energy), 4)
    (True, 1.0427)
    """
    if energy is not None:
        energy = positive("energy", energy)
    first = None
    if isinstance(guess, Orbit):
        first = _even_steps(guess)
        guess = guess.state
    unknown = traced((lattice, omega, guess, energy))
    if not unknown:
        checked_lattice(lattice)
    kind = "bright"
    if isinstance(guess, str):
        kind = one_of("guess", guess, ("bright", "dark"))
    elif guess is not None:
        guess = checked_state(lattice, guess, "guess")
        if not unknown and not largest(guess.u) > 0:
            refuse(
                "guess.u",
                "displacements that are not all zero",
                "the state at rest",
                "Velocities are not used: give a turning point of the motion.",
            )
        # A guess that fills the lattice may lead to a bright or a dark breather.
        if not unknown and localisation(lattice, guess).fills:
            kind = "any"
    if not unknown:
        if not omega > 0:
            refuse("omega", "a frequency above zero", repr(omega))
        if check:
            _check(lattice, float(omega), guess, kind)
    elif guess is None or isinstance(guess, str) or steps is None:
        refuse(
            "guess",
            "a State, and steps=, under a transformation",
            repr(guess),
            "Find one outside first.",
        )
    if guess is None:
        # Branches are followed in float64.
        wide = lattice.astype(jnp.result_type(float))
        guess, first = _unguessed(wide, float(omega), steps, solver, tolerance, check)
        guess = jax.tree.map(lambda x: x.astype(lattice.dtype), guess)
    known = guess if isinstance(guess, State) else None
    count = half_steps(lattice, 2 * np.pi / omega, first if steps is None else steps, known)
    flow = Flow(count if unknown else jax.device_put(np.asarray(count)), solver or KahanLi8())
    if isinstance(guess, str):
        guess = _from_envelope(lattice, flow, float(omega), guess, centre, tolerance)
    settings = {
        "tolerance": tolerance,
        "max_steps": max_steps,
        "refine": steps is None,
        "throw": throw,
    }
    if energy is None:
        try:
            found = _solve(lattice, flow, guess, omega, **settings)
        except RuntimeError as failed:
            raise RuntimeError(f"{failed}{_why_none(lattice)}") from None
    else:
        if not unknown:  # First a breather at omega: the energy of the guess may be far off.
            guess = _solve(lattice, flow, guess, omega, **settings | {"refine": False}).state
        found = _solve(lattice, flow, guess, omega, jnp.asarray(energy, float), **settings)
    return checked_localised(found, kind, guess, throw) if check else found


def _unguessed(lattice, omega, steps, solver, tolerance, check):
    # Returns (a State to start at, steps).
    start = None
    failed = None
    try:
        found = family(lattice, omega, stability=False, points=400, steps=steps, solver=solver)
        if found._curve.end != "p":
            # The number of points was not asked for.
            why = "" if found._curve.end == "points" else f" {found.outcome}"
            raise RuntimeError(
                f"The family did not reach omega = {omega:.6g}: its frequency goes from "
                f"{found.omega[0]:.6g} at a linear mode to {found.omega[-1]:.6g} at the amplitude "
                f"{found.amplitude[-1]:.3g}.{why}"
            )
        start = found.orbit(-1).state, int(found._family.shooting.whole.steps)
        if not check or localisation(lattice, start[0]).bright:
            return start
    except (RuntimeError, ValueError) as error:
        if not check:
            raise
        failed = error
    for guess in local_guesses(lattice, omega):
        count = half_steps(lattice, 2 * np.pi / omega, steps, guess)
        flow = Flow(jnp.asarray(count), solver or KahanLi8())
        found = _solve(lattice, flow, guess, omega, tolerance=tolerance)
        if found.converged and localisation(lattice, found.state).bright:
            return found.state, 2 * count
    if failed is not None:
        said = f"{failed} No breather about a site was found either.{_why_none(lattice)}"
        raise type(failed)(said) from None
    return start


def _why_none(lattice):
    return f" {PUSHES}" if not traced(lattice) and _only_pushes(lattice) else ""


def _only_pushes(lattice):
    # Whether all sites beyond some place can be moved away from the others without any force.
    zero = lattice.zeros()
    shapes = {x.shape for x in jax.tree.leaves(zero)}
    if len(shapes) > 1 or len(shapes.pop()) > 1:
        return False
    apart = jax.tree.map(lambda x: (jnp.arange(len(x)) >= len(x) // 2).astype(x.dtype), zero)
    lengths = 10.0 ** np.arange(-9, 7, 3)
    forces = [lattice.force(0.0, jax.tree.map(lambda x: far * x, apart), zero) for far in lengths]
    # A wall exerts its own force on the last site.
    return not any(np.any(np.asarray(f)[1:-1]) for f in jax.tree.leaves(forces))


def _from_envelope(lattice, flow, omega, kind, centre, tolerance):
    make = dark_guess if kind == "dark" else bright_guess
    guess = make(lattice, omega, centre)
    edge = edge_of(lattice, omega, kind)
    for fraction in (1.0, 0.5, 0.2, 0.1):  # Nearer to the edge the envelope is a better guess.
        near = edge + fraction * (omega - edge)
        found = _solve(lattice, flow, make(lattice, near, centre), near, tolerance=tolerance)
        if found.converged and fraction == 1:
            return found.state
        if found.converged:
            branch = family(
                lattice, omega, guess=found, stability=False, points=400, steps=2 * int(flow.steps)
            )
            return branch.orbit(-1).state
    return guess


def _solve(lattice, flow, guess, omega, energy=None, **settings):
    settings = {"max_steps": 30, "refine": False, "throw": False} | settings
    # Half a period in the units of the guess.
    length, unit = jax.lax.stop_gradient((largest(guess[0]), omega))
    length = library(length).where(length > 0, length, 1)
    half = Shooting.half(lattice, flow, length=length, omega=unit)
    x = half.guess(guess)
    in_omega = 0.0
    if energy is None:
        period = jnp.asarray(2 * jnp.pi / omega, lattice.dtype)
        half, root, apart = confirmed(half, x, (lattice, period), **settings)
    else:
        problem = _AtEnergy(half, jax.lax.stop_gradient(omega))
        problem, root, apart = confirmed(problem, jnp.append(x, 1.0), (lattice, energy), **settings)
        half = problem.half
        omega = root.x[-1] * problem.omega
        in_omega = apart[-1] * problem.omega
        apart = apart[:-1]
    # At rest: the velocities of the guess are dropped.
    begin = half.state(half.guess(guess))
    scene = (lattice, 2 * jnp.pi / omega)
    return orbit_of(half, scene, root, apart, begin, settings["throw"], in_omega)


class _AtEnergy(eqx.Module):
    # F(x, q; lattice, energy) = 0: half a period between rests at q omega, and the energy's
    # relative error.

    half: Shooting
    omega: Scalar

    def finer(self, by):
        return _AtEnergy(self.half.finer(by), self.omega)

    def _family(self, lattice):
        return Family(self.half, lattice, over_omega, 0.0, self.omega)

    def _excess(self, z, scene):
        lattice, energy = scene
        return lattice.energy(0.0, *self.half.state(z[:-1])) / energy - 1

    def residual(self, z, scene):
        gaps = self._family(scene[0]).residual(z[:-1], z[-1])
        return jnp.append(gaps, self._excess(z, scene))

    def linearise(self, z, scene):
        return bordered(self._family(scene[0]), lambda z: self._excess(z, scene), z)


def _check(lattice, omega, guess, kind):
    # The first harmonic of a wave with a dip always lies in the band.
    _refuse_resonance(lattice, omega, kind != "bright")
    edges = [] if guess == "dark" or isinstance(guess, tuple) else edges_beside(lattice, omega)
    # A finite chain may have end modes in a gap, from which families leave too.
    if (
        edges
        and not any(e.bright for e in edges)
        and (guess or len(edges[0].coefficients.mode) == 1)
    ):
        refuse_bright(lattice, omega)


def bands_of(lattice: Lattice) -> tuple[Numbers, Numbers]:
    """Return the intervals of omega that waves fill, (bands, 2), and the frequencies (modes,).

    The intervals are those of the unit cell if there is one. Else they are runs of extended modes
    of the finite lattice: modes that spread over a fifth of the sites, with neighbours closer than
    8 mean spacings.
    """
    modes = normal_modes(lattice)
    omega = np.asarray(modes.omega)
    try:
        found = bands(lattice)
        return np.stack([found.lower, found.upper], -1), omega
    except ValueError:
        pass
    shapes = np.asarray(matrix(in_numpy(modes.modes))) ** 2
    participation = shapes.sum(0) ** 2 / (shapes**2).sum(0)
    extended = np.sort(omega[participation > len(omega) / 5])
    if not len(extended):
        return np.zeros((0, 2)), omega
    apart = np.flatnonzero(
        np.diff(extended) > SPACING * (extended[-1] - extended[0]) / len(extended)
    )
    return np.array([[run[0], run[-1]] for run in np.split(extended, apart + 1)]), omega


def _is_odd(lattice):
    # Whether the forces change their sign with the displacements, at every size.
    try:
        checked_symmetry(lattice, Sign(), rest(lattice), 0.0, 1.0)
    except ValueError:
        return False
    return True


def resonant_harmonic(lattice: Lattice, omega: Scalar, first: Count = 1) -> tuple | None:
    """Return the least n >= first with n omega in a band, that band, and the nearest frequency.

    The latter is one of the finite lattice. `None` if no harmonic meets a wave. Where all forces
    are odd, F(-u) = -F(u), as in `scenes.sine_gordon`, a breather is its own negative half a period
    later: it has no even harmonics, and these do not count.
    """
    intervals, discrete = bands_of(lattice)
    top = max(intervals.max(initial=0.0), discrete.max())
    harmonics = range(first, int(top / omega) + 1)
    if len(harmonics) > 1 and _is_odd(lattice):
        harmonics = [n for n in harmonics if n % 2]
    for n in harmonics:
        nearest = discrete[np.argmin(np.abs(discrete - n * omega))]
        inside = [
            (low, high)
            for low, high in intervals
            if low * (1 + MEETS) < n * omega < high * (1 - MEETS)
        ]
        if inside or abs(nearest - n * omega) < MEETS * nearest:
            return n, inside[0] if inside else (nearest, nearest), float(nearest)
    return None


def _refuse_resonance(lattice, omega, dark, remedy=" check=False tries all the same."):
    # Of a dark breather only the harmonics from the second on count.
    found = resonant_harmonic(lattice, omega, 2 if dark else 1)
    if found is None:
        return
    n, (low, high), nearest = found
    unit = " rad/s" * (lattice.units == SI)
    refuse(
        "omega",
        f"a frequency whose harmonics lie in gaps, for a {'dark' if dark else 'bright'} breather",
        f"{omega:.6g}{unit}",
        f"n = {n}: {n} omega = {n * omega:.6g} lies in the band {low:.6g} ... {high:.6g}{unit}, where waves "
        f"carry energy away; the finite lattice's nearest frequency is {nearest:.6g}.{remedy}",
    )


class QBreather(Result):
    """A q-breather: one normal mode of a finite chain continued to an energy, and the way there."""

    orbit: Orbit = part("The orbit at the energy that was asked for.")
    branch: Branch = hidden("The family from the mode to its first orbit of that energy or more.")
    mode: int = array("The index of the mode.")
    modal_energy: Numbers = array(
        "The energy of every normal mode of the linear chain, its mean over a period.", "J", "mode"
    )
    along: Numbers = array("The same along the family.", "J", "point mode")

    @property
    def outcome(self) -> str:
        """The share of the energy that stays in the mode."""
        share = self.modal_energy[self.mode] / self.modal_energy.sum()
        return f"Mode {self.mode} holds {share:.4g} of the modal energy. {self.orbit.outcome}"


def q_breather(lattice: Lattice, mode: Count, energy: Scalar, **keywords: Any) -> QBreather:
    r"""Follow a normal mode of a finite chain to an energy: a q-breather.

    This Lyapunov family begins at the linear mode, whether its frequency lies in a band or not. The
    energies of all modes are recorded along the way:

    E_k = (a_k'^2 + omega_k^2 a_k^2)/2,

    means over a period. They fall off exponentially with the distance in q.

    **Arguments:** `lattice`: conservative and autonomous. `mode`: an index into
    `gx.linear.normal_modes`, from the lowest. `energy`: above zero [J]. `keywords`: of
    `gx.breathers.family` except `stop`, such as `arclength`.

    **Returns:** `QBreather`; `found.orbit.floquet()` gives its stability, `found.branch` the
    family.
    **Raises** ValueError as `family`, and for an energy not above zero; RuntimeError if the family
    ends before it, or the orbit is not found.
    Typical: energies of 0.01 to 1 in FPUT chains of 32 sites.
    Source: Flach, Ivanchenko, Kanakov, Phys. Rev. Lett. 95, 064102 (2005).

    **Example:**

    >>> chain = gx.scenes.fput(5, alpha=0.25)
    >>> found = gx.breathers.q_breather(chain, 0, 0.01, steps=64, stability=False)
    >>> found.modal_energy.round(6).tolist()
    [0.009945, 5.2e-05, 0.0, 0.0, 0.0]
    """
    wanted = float(positive("energy", energy))
    modes = normal_modes(lattice)

    def reached(u, omega):
        state = State(u, lattice.zeros())
        return "the energy is reached" if float(lattice.energy(0.0, *state)) >= wanted else None

    branch = family(lattice, mode=mode, stop=reached, **keywords)
    if branch._curve.end != "stop":
        raise RuntimeError(f"The family ends before the energy {wanted:.6g}: {branch.outcome}")
    shared = {name: keywords[name] for name in ("steps", "solver", "tolerance") if name in keywords}
    last = branch.orbit(-1)
    found = breather(lattice, float(last.omega), last, energy=wanted, check=False, **shared)

    shapes = np.asarray(matrix(in_numpy(modes.modes)))

    def shares(orbit):
        run = orbit.run()
        one = lambda u, v: modal_energy(lattice, State(u, v), shapes, modes.omega)
        return np.asarray(jnp.mean(jax.vmap(one)(run.us, run.vs), 0))

    along = np.stack([shares(branch.orbit(i)) for i in range(len(branch))])
    return QBreather(found, branch, mode % len(along[0]), shares(found), along, **lattice.origin)


@one_thread
def anticontinuous(
    scene: Scene,
    coupling: Scalar,
    omega: Scalar,
    sites: Site | Sequence[Site] | str | None = None,
    *,
    amplitudes: Sequence[Scalar] | None = None,
    field: str | None = None,
    arclength: Scalar = 0.1,
    points: Count = 100,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
    tolerance: Scalar = 1e-10,
    stability: bool = True,
) -> Branch:
    r"""Follow breathers of one frequency over the coupling, from the limit of uncoupled sites.

    At coupling zero the named sites oscillate at omega, each as its own nonlinear oscillator, and
    all others rest. If no harmonic of omega is a frequency of small oscillations, this orbit has
    one continuation (MacKay and Aubry), which is followed by pseudo-arclength through folds. The
    branch ends, and reports it, before a point at which a harmonic meets the band of the waves, or
    where the orbit is no longer localised.

    **Arguments:**

    - `scene(coupling)`: the `Lattice`, traced: `lambda c: gx.scenes.klein_gordon(21, c)`;
      conservative, with sites that are not coupled at 0. The same function again compiles nothing.
      Contacts can couple too; their breathers decay faster than exponentially:
      `lambda A: gx.scenes.cradle(9, stiffness=A, length=1.0)`.
    - `coupling`: where the branch ends, not zero, in the unit of the scene.
    - `omega` [rad/s]: above the frequency of small oscillations if the on-site force hardens, below
      it if it softens.
    - `sites`: an index or several (on a grid a pair or several pairs), which oscillate in the
      limit; `None` is the middle. `amplitudes`: their signs +-1 (None: all in phase). Or `sites` is
      a code such as "+-0+", placed in the middle of a chain: a multibreather of neighbours in
      phase, in opposite phase, or at rest. `field`: where a cell holds several. All sites but one
      make a dark breather.
    - `arclength`: first step along the branch, in which the whole range of the coupling counts 1,
      and so does a change of a displacement by the amplitude in the limit. `points`: the most
      breathers.
    - `steps`: time steps per period, an even number; `None` doubles them until half as many confirm
      the largest breather to `tolerance`, relative to its amplitude, and its tangent map to 1e-8:
      many where contacts open. `solver`: a splitting method.
    - `stability`: whether to compute the multipliers.

    **Returns:** `Branch`, with the coupling as `p`; `branch.orbit(-1)` is the last breather, which
    `gx.breathers.breather(scene(c), omega, guess=...)` refines, and with `energy=` takes to an
    energy. The branch has no derivative; the refined orbit has.
    **Raises** ValueError for a coupling of zero, a frequency that no oscillation of the sites has
    or with a harmonic that is a wave already in the limit, sites that are coupled there, and as
    `family`; RuntimeError if the first breather is not found.
    Typical: 11 to 41 sites, couplings up to a tenth of the stiffness of the sites.
    Source: MacKay, Aubry, Nonlinearity 7, 1623 (1994); Marin, Aubry, Nonlinearity 9, 1501 (1996).

    **Example:**

    >>> scene = lambda coupling: gx.scenes.klein_gordon(5, coupling)
    >>> branch = gx.breathers.anticontinuous(scene, 0.02, 1.4, points=10, steps=64, stability=False)
    >>> branch.outcome
    'p reached 0.02.'
    >>> branch.u[-1].round(4).tolist()
    [0.0005, -0.0239, 1.1182, -0.0239, 0.0005]
    """
    omega = float(positive("omega", omega))
    end = float(coupling)
    if end == 0:
        refuse(
            "coupling",
            "a coupling other than zero",
            repr(end),
            "At zero coupling no site feels another.",
        )
    period = 2 * np.pi / omega
    scene = eqx.Partial(_traced, scene)
    lattices = [checked_lattice(scene(jnp.asarray(c))) for c in (0.0, end)]
    limit = _limit(lattices[0], omega, sites, amplitudes, field)
    length = float(largest(limit.u))
    count = max(half_steps(lattice, period, steps, limit) for lattice in lattices)
    along = {"make": scene, "period": jnp.asarray(period), "span": jnp.asarray(end)}
    family = _family(lattices[0], count, solver, length, omega, tolerance, **along)
    start = np.asarray(family.shooting.guess(limit))

    def follow(count):
        problem = family.with_steps(count)
        curve = problem.follow(
            start,
            0.0,
            until=(0.0, 1.0),
            arclength=arclength,
            longest_arclength=4 * arclength,
            least_arclength=1e-4 * arclength,
            points=points,
            veto=_veto(problem, omega, limit),
        )
        _, vetoed, why = curve.reason.partition("vetoed, ")
        if vetoed:
            why = f"beyond its last point {why}"
        elif len(curve.p) > 1 and curve.p[-1] == 0:
            fold = f"{curve.p.max() * end:.6g}, a fold"
            why = f"turned back at the coupling {fold}, to another breather without; none leads to {end:.6g}"
        if why:
            curve = dataclasses.replace(curve, end="other", reason=why)
        return problem, curve

    return _confirmed_branch(follow, count, steps is None, tolerance, stability)


@compiled
def _traced(scene, coupling):
    # The scene sees only traced couplings, so that one which refuses a coupling of zero is built
    # too.
    return scene(coupling)


def _limit(lattice, omega, sites, amplitudes, field):
    _refuse_resonance(lattice, omega, False, "")
    state = single_site(lattice, omega, sites, amplitudes=amplitudes, field=field)
    u, force = map(raveled, (state.u, lattice.force(jnp.zeros(()), *state)))
    places, _ = named_sites(lattice, sites, amplitudes, field)
    others = np.argsort(-np.abs(u))[len(places) :]
    # Anything below 1e-9 of the largest is rounding.
    acts = lambda x: largest(x[others]) > 1e-9 * largest(x)
    if others.size and (acts(u) or acts(force)):
        refuse(
            "scene",
            "sites on which no neighbour acts at coupling 0",
            "sites on which neighbours act",
            "A breather of a lattice without such a limit: gx.breathers.breather.",
        )
    return state


def _veto(problem, omega, limit):
    # Why a point of the branch is not a breather: a harmonic among the waves, or an orbit that has
    # spread.
    first = localisation(problem.scene(jnp.zeros(()))[0], limit)
    # An orbit that fills the lattice may be a dark breather, whose first harmonic is that of a
    # wave.
    kind, least = ("any", 2) if first.fills else ("bright", 1)

    def why(x, q, *before):
        lattice = problem.scene(jnp.asarray(q))[0]
        found = resonant_harmonic(lattice, omega, least)
        if found is not None:
            n, (low, high), _ = found
            return f"{n} omega = {n * omega:.6g} meets the waves of {low:.6g} ... {high:.6g}"
        spread = localisation(lattice, problem.shooting.state(x))
        if spread.cells < FEWEST or spread.why_not(kind, first) is None:
            return None
        return f"it is not localised, {spread} (participation number; {first.participation:.3g} in the limit)"

    return why
