"""One breather at a given frequency, and whether its lattice's waves let it be."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jaxtyping import Float

from ..checks import one_of, refuse, traced
from ..flow import Flow
from ..lattice import Lattice, State
from ..linear import bands, normal_modes
from ..programs import compiled
from ..solvers import KahanLi8
from ..tuning import one_thread
from ..types import Count, Counts, Numbers, Scalar, StateLike
from .confirm import TOLERANCE, confirmed
from .families import even_steps, family, flat_modes, half_steps
from .guesses import (
    bright_guess,
    dark_guess,
    edge_of,
    edges_beside,
    local_guesses,
    refuse_bright,
)
from .localised import checked_localised, localisation
from .orbit import Orbit, orbit_of
from .problems import Family, Shooting, over_omega
from .repeats import checked_lattice, checked_state, largest

# relative distance to a frequency of the finite lattice that is a resonance by itself
MEETS = 1e-9
# neighbouring extended modes this much closer than the spectrum's width belong to one band
SPACING = 8
GUESSES = ("bright", "dark")
# lengths by which parts of a chain are moved apart
FAR = 10.0 ** np.arange(-9, 7, 3)
# displacements at which forces are compared with those of the opposite ones, whatever the unit of length
LENGTHS = 2.0 ** np.arange(-100, 101, 2)
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
    r"""A time-reversible breather of frequency omega: v(0) = 0, v(T/2) = 0, T = 2 pi/omega.

    **Arguments:**

    - `lattice`: a conservative, autonomous `Lattice`. `omega`: [rad/s].
    - `energy`: where given, the breather of this energy, above zero, is sought from the one at omega on, and has its
      own frequency, which is then differentiable too: d omega/d parameter at constant energy.
    - `guess`: where Newton's method starts. `None`: the family from the linear mode next to omega, or where that is a
      wave (on a ring) or none (a sonic vacuum), the envelope's breather or one about a site. `"bright"`,
      `"dark"`: the envelope's soliton of a periodic chain, centred on `centre` (a site, or 3.5 for a bond; `None` the
      middle); dark with the ends that the chain has (free: constant force; walls or a ring: fixed length). Another
      breather, or a `State`, such as that of `guesses.single_site` or a simulated one, whose velocities are dropped.
    - `steps`: time steps in a period, an even number, which may be traced; `None` doubles them until a second step size
      confirms the orbit.
    - `tolerance`: of that, relative to the guess's largest displacement; Newton's method goes on to a thousandth of it.
    - `check`: refuse a frequency of which a harmonic meets a band, or whose gap has no bright breathers, and an orbit
      that is no breather: one that more than 0.6 of the cells share, 0.4 in the plane (participation number of their
      energies at rest; a wave between walls has 2/3, 4/9 in the plane), or half and twice what the guess had; of a
      dark one, no background or no dip in it. Of fewer than five cells the share is said and not judged.
    - `throw`: raise where Newton's method does not converge; `None` does so outside of transformations.

    With a `State` and `steps` it works inside `jit` and `vmap`, and its state and energy are differentiable in every
    parameter of the lattice and in omega, by the implicit function theorem.

    **Returns:** `Orbit`, which says how many cells share its energy; `throw=False` returns the best iterate.
    **Raises** ValueError for a frequency that has no such breather, with the reason; RuntimeError where Newton's method
    does not converge, or leads to rest or to a wave, with the participation number.

    **Example:**

    >>> chain = gx.scenes.klein_gordon(5, 0.02)
    >>> guess = gx.breathers.guesses.single_site(chain, 1.4, 2)
    >>> found = gx.breathers.breather(chain, 1.4, guess, steps=64)
    >>> bool(found.converged), round(float(found.energy), 4)
    (True, 1.0427)
    """
    first = None
    if isinstance(guess, Orbit):
        guess, first = guess.state, even_steps(guess)
    unknown = traced((lattice, omega, guess, energy))
    if not unknown:
        checked_lattice(lattice)
    kind = "bright"
    if isinstance(guess, str):
        kind = one_of("guess", guess, GUESSES)
    elif guess is not None:
        guess = checked_state(lattice, guess, "guess")
        if not unknown and not largest(guess.u) > 0:
            refuse(
                "guess.u",
                "displacements that are not all zero",
                "the state at rest",
                "Velocities are dropped: of a motion take a state where it turns.",
            )
        kind = kind if unknown else _kind(lattice, guess)
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
        guess, first = _unguessed(lattice, float(omega), steps, solver, tolerance, check)
    known = guess if isinstance(guess, State) else None
    count = half_steps(lattice, 2 * np.pi / omega, first if steps is None else steps, known)
    flow = Flow(count if unknown else jnp.asarray(count), solver or KahanLi8())
    if isinstance(guess, str):
        guess = _from_envelope(lattice, flow, float(omega), guess, centre, tolerance)
    settings = {"tolerance": tolerance, "max_steps": max_steps}
    settings |= {"refine": steps is None, "throw": throw}
    if energy is None:
        try:
            found = _solve(lattice, flow, guess, omega, **settings)
        except RuntimeError as failed:
            raise RuntimeError(f"{failed}{_why_none(lattice)}") from None
    else:
        if not unknown:  # a step of its own to omega: the guess's energy may be far off
            guess = _solve(lattice, flow, guess, omega, **settings | {"refine": False}).state
        found = _solve(lattice, flow, guess, omega, jnp.asarray(energy, float), **settings)
    return checked_localised(found, kind, guess, throw) if check else found


def _unguessed(lattice, omega, steps, solver, tolerance, check):
    """(a State to start at, steps): the family's, or where that is a wave or none, a breather about a site."""
    start, failed = None, None
    try:
        found = family(lattice, omega, stability=False, points=400, steps=steps, solver=solver)
        if "reached" not in found.outcome:
            raise RuntimeError(f"The family did not reach omega = {omega:.6g}: {found.outcome}")
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
        found = _solve(
            lattice,
            flow,
            guess,
            omega,
            tolerance=tolerance,
            max_steps=30,
            refine=False,
            throw=False,
        )
        if found.converged and localisation(lattice, found.state).bright:
            return found.state, 2 * count
    if failed is not None:
        said = f"{failed} No breather about a site was found either.{_why_none(lattice)}"
        raise type(failed)(said) from None
    return start


def _why_none(lattice):
    """A reason why no bright breather can be found, where one is known."""
    return f" {PUSHES}" if not traced(lattice) and _only_pushes(lattice) else ""


def _only_pushes(lattice):
    """Whether all sites beyond some place can be moved away from the others without any force."""
    shapes = set(lattice.sites.values()) if lattice.fields else {lattice.sites}
    if lattice.dimension or len(shapes) > 1 or lattice.axes != 1:
        return False
    zero = lattice.zeros()
    apart = jax.tree.map(lambda x: (jnp.arange(len(x)) >= len(x) // 2).astype(x.dtype), zero)
    forces = [lattice.force(0.0, jax.tree.map(lambda x: far * x, apart), zero) for far in FAR]
    # a wall has a force of its own at the end
    return not any(np.any(np.asarray(f)[1:-1]) for f in jax.tree.leaves(forces))


def _half(lattice, flow, guess, omega):
    """Half a period in the units of the guess."""
    length, omega = jax.lax.stop_gradient((largest(guess[0]), omega))
    return Shooting.half(lattice, flow, length=jnp.where(length > 0, length, 1), omega=omega)


def _from_envelope(lattice, flow, omega, kind, centre, tolerance):
    """A State to start at: the envelope's soliton, or one nearer to the edge followed to omega."""
    make = dark_guess if kind == "dark" else bright_guess
    guess = make(lattice, omega, centre)
    settings = {"tolerance": tolerance, "refine": False, "throw": False}
    found = _solve(lattice, flow, guess, omega, max_steps=20, **settings)
    if found.converged:
        return found.state
    edge = edge_of(lattice, omega, kind)
    for fraction in (0.5, 0.2, 0.1):  # nearer to the edge the envelope is a better guess
        near = edge + fraction * (omega - edge)
        found = _solve(lattice, flow, make(lattice, near, centre), near, max_steps=30, **settings)
        if found.converged:
            branch = family(
                lattice, omega, guess=found, stability=False, points=400, steps=2 * int(flow.steps)
            )
            return branch.orbit(-1).state
    return guess


def _solve(lattice, flow, guess, omega, energy=None, *, throw, **settings):
    """The `Orbit` at a frequency, or from there at an energy."""
    half, settings = _half(lattice, flow, guess, omega), {"throw": throw} | settings
    x, in_omega = half.guess(guess), 0.0
    if energy is None:
        half, root, apart = confirmed(half, x, (lattice, 2 * jnp.pi / omega), **settings)
    else:
        problem = AtEnergy(half, jax.lax.stop_gradient(omega))
        problem, root, apart = confirmed(problem, jnp.append(x, 1.0), (lattice, energy), **settings)
        half, omega = problem.half, root.x[-1] * problem.omega
        apart, in_omega = apart[:-1], apart[-1] * problem.omega
    # at rest, whatever the velocities of the guess
    begin, scene = half.state(half.guess(guess)), (lattice, 2 * jnp.pi / omega)
    return orbit_of(half, scene, root, apart, begin, throw, in_omega)


class AtEnergy(eqx.Module):
    """F(x, q; lattice, energy) = 0: half a period from rest to rest at q omega, and the energy's relative error."""

    half: Shooting
    omega: Scalar

    def finer(self, by: Scalar) -> "AtEnergy":
        """The same with so many times the time steps."""
        return AtEnergy(self.half.finer(by), self.omega)

    def _family(self, lattice):
        return Family(self.half, lattice, over_omega, 0.0, self.omega)

    def _excess(self, x, scene):
        lattice, energy = scene
        state = self.half.state(x)
        return lattice.energy(0.0, state.u, state.v) / energy - 1

    def residual(self, z: Numbers, scene: tuple) -> Numbers:
        """The half period's gaps at the last unknown times omega, and the energy's."""
        gaps = self._family(scene[0]).residual(z[:-1], z[-1])
        return jnp.append(gaps, self._excess(z[:-1], scene))

    def linearise(self, z: Numbers, scene: tuple) -> tuple:
        """The residual and its derivative."""
        x = z[:-1]
        gaps, in_x, in_omega = self._family(scene[0]).linearise(x, z[-1])
        excess, gradient = jax.value_and_grad(self._excess)(x, scene)
        return jnp.append(gaps, excess), jnp.block(
            [[in_x, in_omega[:, None]], [gradient, jnp.zeros(1, x.dtype)]]
        )


def _kind(lattice, guess):
    """What a State may lead to: one that fills the lattice to a bright breather or a dark one."""
    return "any" if localisation(lattice, guess).fills else "bright"


def _check(lattice, omega, guess, kind):
    # the first harmonic of a wave with a dip is in the band by nature
    refuse_resonance(lattice, omega, kind != "bright")
    edges = [] if guess == "dark" or isinstance(guess, tuple) else edges_beside(lattice, omega)
    # a finite chain may have modes in a gap, at its ends, from which families leave too
    if (
        edges
        and not any(e.bright for e in edges)
        and (guess or len(edges[0].coefficients.mode) == 1)
    ):
        refuse_bright(lattice, omega)


def bands_of(lattice: Lattice) -> tuple[Float[np.ndarray, "bands 2"], Float[np.ndarray, " modes"]]:
    """Intervals of omega that waves fill, (bands, 2), and the discrete spectrum.

    Of the unit cell where there is one; else of the extended modes of the finite lattice: runs of neighbours closer
    than 8 mean spacings, of modes that spread over a fifth of the sites.
    """
    modes = normal_modes(lattice)
    omega = np.asarray(modes.omega)
    try:
        found = bands(lattice)
        return np.stack([np.asarray(found.lower), np.asarray(found.upper)], -1), omega
    except ValueError:
        pass
    shapes = flat_modes(modes) ** 2
    participation = shapes.sum(0) ** 2 / (shapes**2).sum(0)
    extended = np.sort(omega[participation > len(omega) / 5])
    if not len(extended):
        return np.zeros((0, 2)), omega
    apart = np.flatnonzero(
        np.diff(extended) > SPACING * (extended[-1] - extended[0]) / len(extended)
    )
    return np.array([[run[0], run[-1]] for run in np.split(extended, apart + 1)]), omega


@compiled
def _asymmetry(lattice):
    """|F(u) + F(-u)| over |F(u)|, largest of all sites, at displacements of one shape and of many sizes."""
    rng = np.random.default_rng(0)
    shape = jax.tree.map(
        lambda x: jnp.asarray(rng.uniform(-1, 1, x.shape), x.dtype), lattice.template()
    )

    def one(size):
        force = lambda s: lattice.force(0.0, jax.tree.map(lambda x: s * x, shape), lattice.zeros())
        there = force(size)
        return largest(jax.tree.map(jnp.add, there, force(-size))) / largest(there)

    return jax.lax.map(one, jnp.asarray(LENGTHS, lattice.dtype))


def _is_odd(lattice):
    """Whether the forces change their sign with the displacements, as they are at displacements of every size."""
    found = np.asarray(_asymmetry(lattice))
    # a size may be beyond a law's range
    found = found[np.isfinite(found)]
    return found.size > 0 and found.max() <= np.sqrt(np.finfo(found.dtype).eps)


def resonant_harmonic(lattice: Lattice, omega: Scalar, first: Count = 1) -> tuple | None:
    """The least n >= first with n omega in a band, with that band and the nearest frequency of the finite lattice.

    `None` where no harmonic meets a wave. Where all forces are odd, F(-u) = -F(u), as of `scenes.sine_gordon`, a
    breather is its own negative half a period later: it has no even harmonics, and these do not count.
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


def refuse_resonance(
    lattice: Lattice,
    omega: Scalar,
    dark: bool,
    remedy: str = " check=False tries all the same.",
) -> None:
    """Refuse a frequency one of whose harmonics (of a dark breather from the second on) is a wave of the chain."""
    found = resonant_harmonic(lattice, omega, 2 if dark else 1)
    if found is None:
        return
    n, (low, high), nearest = found
    refuse(
        "omega",
        f"a frequency whose harmonics lie in gaps, for a {'dark' if dark else 'bright'} breather",
        f"{omega:.6g}",
        f"n = {n}: {n} omega = {n * omega:.6g} lies in the band {low:.6g} ... {high:.6g}, where waves "
        f"carry energy away; the finite lattice's nearest frequency is {nearest:.6g}.{remedy}",
    )
