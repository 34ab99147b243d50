"""Kinks between two wells of the on-site force: at rest, Peierls-Nabarro barrier, moving."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ..base.checks import refuse, traced
from ..base.programs import compiled
from ..base.types import Number, Numbers, Scalar
from ..continuation.newton import newton
from ..lattice import Lattice, State, spread_mass
from ..results import Result, array, part
from .asked import force_at, one_lattice, stiffness_at

# A kink may be pushed by this share of the largest force between the wells and still count as at
# rest, as in the continuum.
PUSHED = 1e-9
# Where kinks are held and released, in sites from the centre. Between wells that are mirror images
# the first one is at rest; between others two kinds of kinks rest anywhere in each cell.
STARTS = (0, 1 / 8, -1 / 8, 1 / 4, -1 / 4, 3 / 8, -3 / 8, 1 / 2, -1 / 2)
# Points of a cell.
CELL = (np.arange(16) - 7.5) / 16
# No other start is tried if the kink is found at this distance from the centre.
CLOSE = 0.05
# A kink counts as the one at the centre up to this distance: half a site away rests another kind.
WITHIN = 0.45
# The distance that the ends of a chain with a kink may have from the wells, as the same share.
ENDS = 0.05

# The sites in a well that are added to each end before a kink is interpolated.
FAR = 12


class Kink(Result):
    """A kink at rest: F(u) = 0 with one well far left and another far right."""

    state: State = part("The kink at rest.", "site")
    energy: Number = array("The energy above that of the left well.", "J")
    error: Numbers = array("The estimated error of each displacement.", "m", "site")
    energy_error: Number = array("The estimated error of the energy.", "J")
    omega: Numbers = array(
        "The frequencies of small oscillations, ascending, zero where the kink is unstable. The "
        "lowest one of a stable kink is the Peierls-Nabarro frequency.",
        "rad/s",
        "mode",
    )
    growth: Number = array("The growth rate of an unstable kink, else zero.", "1/s")
    residual: Number = array("The largest force over that between the wells.", "1")
    verdict: str = array(
        '"stable", "unstable" or "undecided" (the curvature is zero within its error: a chain '
        "near the continuum).",
        static=True,
    )

    @property
    def outcome(self) -> str:
        """The stability and the energy."""
        return f"A kink at rest, {self.verdict}: its energy is {float(self.energy):.6g}."


class PeierlsNabarro(Result):
    """The barrier against moving a kink by one site."""

    barrier: Number = array("The energy of the higher kink minus that of the lower one.", "J")
    error: Number = array("The error of the barrier.", "J")
    site: Number = array("The energy of the kink nearest to a site.", "J")
    bond: Number = array("The energy of the kink nearest to a bond.", "J")
    omega: Number = array(
        "The Peierls-Nabarro frequency: that of small oscillations of the lower kink in its "
        "valley.",
        "rad/s",
    )
    higher: str = array("The verdict on the higher kink.", static=True)

    @property
    def outcome(self) -> str:
        """Where the kink rests."""
        if self.barrier <= self.error:
            return "The barrier is below its error: the kink moves as in the continuum."
        low = "a site" if self.site < self.bond else "a bond"
        return f"The kink rests on {low} or near it; the other one is {self.higher}."


def kink(
    lattice: Lattice, right: Scalar, left: Scalar = 0.0, *, centre: Scalar | None = None
) -> Kink:
    r"""Find a kink at rest, u -> left and u -> right at the two ends, by Newton's method.

    **Arguments:**

    - `lattice`: a conservative chain of scalar displacements with free ends and a force on every
      site.
    - `left`, `right`: wells, displacements of the whole chain without forces: 0 and 2 pi of
      `scenes.sine_gordon`, 0 and -2 of `scenes.klein_gordon(stiffness=2.0, alpha=3.0, beta=1.0)`.
      `right` < `left` gives an antikink.
    - `centre`: a site, or 10.5 for a bond, to which others are rounded; `None` is the bond in the
      middle. The nearest kink is found; between mirrored wells it rests there.

    **Returns:** `Kink`. **Raises** ValueError for a place that is not a well and for other
    lattices; RuntimeError if Newton's method does not converge, or the ends are too near.
    Typical: an energy of 8 sqrt(C) in the sine-Gordon continuum.
    Source: Braun, Kivshar, The Frenkel-Kontorova Model (2004), chapter 2.

    **Example:**

    >>> chain = gx.scenes.sine_gordon(20)
    >>> found = gx.kinks.kink(chain, 2 * np.pi)
    >>> found.verdict, round(float(found.energy), 4)  # 8 in the continuum
    ('stable', 7.8666)
    """
    wells = _checked_wells(lattice, right, left)
    left = wells.left
    right = wells.right
    sites = lattice.sites[0]
    middle = (sites - 1) // 2 + 0.5 if centre is None else centre
    if not 0 < middle < sites - 1:
        wanted = f"a place between the first and the last of {sites} sites"
        refuse("centre", wanted, f"{middle:g}")
    middle = round(2 * middle) / 2
    # By NumPy, so that nothing is compiled.
    size = np.asarray(abs(right - left), lattice.dtype)
    scene = lattice, *jax.device_put((size, np.asarray(wells.force, lattice.dtype)))
    # The residual of Newton's method, relative to the largest force between the wells.
    rounding = 50 * float(jnp.finfo(lattice.dtype).eps)
    wanted = max(1e-13, rounding * float(wells.stiffest * size / wells.force))
    nearest = np.inf
    for off in STARTS:
        held, push, free = _released(scene, wells, middle, off, wanted)
        if off == 0:
            first = held
            pushed = push
            # A wide kink is hardly pushed anywhere.
            rests = first.converged and pushed <= PUSHED + rounding
        rise = (free.x * size - left) / (right - left)
        away = abs(np.interp(0.5, rise, np.arange(sites)) - middle)
        if free.converged and away < nearest:
            nearest = away
            best = np.asarray(free.x)
        if nearest <= CLOSE or rests:
            break
    if not (nearest <= WITHIN or rests):
        why = f"{pushed:.1g} of the largest force pushes it there"
        _refuse_ends(why if first.converged else first.outcome, middle, sites)
    x = best if nearest <= WITHIN else np.asarray(first.x)[:-1]
    *found, squares = _known(scene, x, np.asarray(left, lattice.dtype))
    squares = np.asarray(squares)
    away = abs(float(x[0] * size) - left), abs(float(x[-1] * size) - right)
    if max(away) > ENDS * float(size):
        _refuse_ends(f"its ends are {max(away):.3g} from the wells", middle, sites)
    least = float(squares[0])
    known = abs(least) > max(1e-9, rounding) * np.abs(squares).max()
    return Kink(
        *found,
        ("stable" if least > 0 else "unstable") if known else "undecided",
        **lattice.origin,
    )


def _released(scene, wells, middle, off, tolerance):
    # A kink is first held at a place, along which a wide kink is hardly pushed, and then released:
    # the roots of both, and the push on the held one.
    lattice, size, _ = scene
    width = max(np.sqrt(max(wells.coupling, 0) / wells.own), 0.1)
    places = np.arange(lattice.sites[0])
    # Averaged over a cell the steps of a narrow kink become a ramp: no start is like another.
    cell = CELL if off else np.zeros(1)
    x = (places[:, None] - middle - off - cell) / width
    rise = np.arctan(np.exp(np.minimum(x, 99))).mean(1)  # e^99: arctan knows no difference
    guess = wells.left + (wells.right - wells.left) * 2 / np.pi * rise
    begin = guess.astype(lattice.dtype) / np.asarray(size)
    # One site alone holds a narrow kink at each place between two sites.
    slope = np.gradient(begin) if off == 0 else 1.0 * (places == round(middle + off))
    held = newton(
        _held,
        np.append(begin, np.zeros(1, begin.dtype)),
        (*scene, *jax.device_put((begin, slope.astype(begin.dtype)))),
        tolerance=tolerance,
        max_steps=60,
        throw=False,
    )
    there = np.asarray(held.x)[:-1]
    steps = 60 if off else 10
    free = newton(_forces, there, scene, tolerance=tolerance, max_steps=steps, throw=False)
    return held, float(np.abs(held.x[-1] * slope).max()), free


def _refuse_ends(why, middle, sites):
    elsewhere = "" if middle == (sites - 1) / 2 else f", or the kink the centre {(sites - 1) / 2:g}"
    raise RuntimeError(
        f"No kink at rest was found at {middle:g}: {why}. Where the wells are mirror images, the ends "
        f"are too near: give the chain more sites and free ends{elsewhere}."
    )


def peierls_nabarro(lattice: Lattice, right: Scalar, left: Scalar = 0.0) -> PeierlsNabarro:
    """Compute the Peierls-Nabarro barrier from kinks on a site and on a bond.

    Both are in the middle of a chain. `lattice`, `right`, `left`: as in `kink`. **Returns:**
    `PeierlsNabarro`. The barrier falls exponentially with the width of the kink; the outcome says
    if it is below its `error`.
    **Raises** as `kink`.

    **Example:**

    >>> found = gx.kinks.peierls_nabarro(gx.scenes.sine_gordon(20), 2 * np.pi)
    >>> round(float(found.barrier), 4)
    0.0254
    """
    _checked_wells(lattice, right, left)
    place = (lattice.sites[0] - 1) // 2
    site, bond = (kink(lattice, right, left, centre=place + off) for off in (0.0, 0.5))
    # Kinks of one kind, a cell apart, have equal rates.
    rates = [float(one.omega[0] + one.growth) for one in (site, bond)]
    if site.verdict == bond.verdict != "undecided" and np.isclose(*rates, rtol=1e-3):
        raise RuntimeError(f"Only {site.verdict} kinks were found: the barrier is not known.")
    low, high = (site, bond) if float(site.energy) < float(bond.energy) else (bond, site)
    return PeierlsNabarro(
        high.energy - low.energy,
        low.energy_error + high.energy_error,
        site.energy,
        bond.energy,
        low.omega[0],
        high.verdict,
        **lattice.origin,
    )


def moving(
    lattice: Lattice,
    velocity: Scalar,
    right: Scalar,
    left: Scalar = 0.0,
    *,
    centre: Scalar | None = None,
) -> State:
    r"""Return a moving kink: the one at rest, contracted.

    u_n = U(g (n - c)),  v_n = -V g U'(g (n - c)),  g = 1/sqrt(1 - V^2/c0^2),

    with `c0 = sqrt(C/m)` the speed of long waves without the on-site force. On a chain a moving
    kink radiates, slows down, and rests at last where it can no longer pass the barrier.

    **Arguments:** `velocity`: V [sites/s], |V| < c0. The others as in `kink`; `centre` is any
    place.
    **Returns:** a `State` for `gx.simulate`. **Raises** ValueError for |V| >= c0, and as `kink`.
    """
    rest = kink(lattice, right, left)
    wells = _checked_wells(lattice, right, left)
    middle = (lattice.sites[0] - 1) // 2
    speed = float(velocity)
    mass = np.asarray(spread_mass(lattice))[lattice.sites[0] // 2]
    top = float(np.sqrt(max(wells.coupling, 0) / mass))
    if not abs(speed) < top:
        refuse("velocity", f"a speed below {top:.6g}, that of long waves", f"{speed:g}")
    begin = middle + 0.5 if centre is None else centre
    stretch = 1 / np.sqrt(1 - (speed / top) ** 2)
    x = stretch * (np.arange(lattice.sites[0]) - begin) + middle + 0.5
    # A spline between the sites; the wells continue beyond the ends.
    u = np.pad(rest.state.u, FAR, constant_values=(wells.left, wells.right))
    places = np.arange(len(u)) - FAR
    spline = scipy.interpolate.make_interp_spline(places, u, k=5)
    inside = np.clip(x, places[0], places[-1])
    slope = np.where(inside == x, spline(inside, 1), 0)
    uv = spline(inside), -speed * stretch * slope
    return State(*(jnp.asarray(y, lattice.dtype) for y in uv))


def _forces(x, scene):
    # Forces over their scale at displacements over theirs.
    lattice, size, scale = scene
    return force_at(lattice, size * x) / scale


def _held(z, scene):
    # The same for a kink that is held at the place of a guess by a force along `slope`, whose size
    # is the last unknown.
    *free, guess, slope = scene
    x = z[:-1]
    return jnp.append(_forces(x, free) + z[-1] * slope, slope @ (x - guess))


@compiled
def _uniform(lattice, levels):
    # The largest force on the whole chain, displaced to each level.
    ones = jnp.ones_like(lattice.zeros())
    return jax.lax.map(lambda level: jnp.max(jnp.abs(force_at(lattice, level * ones))), levels)


@compiled
def _known(scene, x, left):
    # The fields of a `Kink` before its verdict, and the squares of the frequencies.
    lattice, size, _ = scene
    u = size * x
    stiffness = stiffness_at(lattice, u)
    inverse = jnp.linalg.inv(stiffness)
    force = force_at(lattice, u)
    # The rounding of a sum of forces or energies, in units of its last place.
    eps = 16 * jnp.finfo(u.dtype).eps
    rounding = eps * jnp.max(jnp.sum(jnp.abs(stiffness), 1)) * jnp.max(jnp.abs(u))
    error = jnp.abs(inverse @ force) + jnp.sum(jnp.abs(inverse), 1) * rounding
    zero = jnp.zeros_like(u)
    there, well = (lattice.energy(0.0, y, zero) for y in (u, left * jnp.ones_like(u)))
    # At rest the error of the energy is of second order, apart from rounding.
    energy_error = jnp.sum(jnp.abs(force) * error) + eps * (jnp.abs(there) + jnp.abs(well))
    root = jnp.sqrt(spread_mass(lattice))
    squares = jnp.linalg.eigvalsh((stiffness + stiffness.T) / 2 / root[:, None] / root)
    omega = jnp.sqrt(jnp.maximum(squares, 0))
    growth = jnp.sqrt(jnp.maximum(-squares[0], 0))
    residual = jnp.max(jnp.abs(_forces(x, scene)))
    return State(u, zero), there - well, error, energy_error, omega, growth, residual, squares


class _Wells(NamedTuple):
    # `force`: the largest one between the wells. In the left well, `stiffest`: the largest entry of
    # the stiffness; `coupling`: that of the middle site to all others, sum j^2 k_j/2; `own`: the
    # slope of its own force.

    left: float
    right: float
    force: float
    stiffest: float
    coupling: float
    own: float


def _checked_wells(lattice, right, left):
    if traced((lattice, right, left)):
        expected = "a lattice and wells of known numbers"
        refuse("lattice", expected, "traced ones", "A kink has no derivatives.")
    if one_lattice(lattice).fields or lattice.dimension is not None or lattice.axes != 1:
        refuse("lattice", "one chain of scalar displacements", f"one of shape {lattice.shape}")
    if not lattice.conserves:
        refuse("lattice", "forces that depend on positions alone", ", ".join(lattice.unkept()))
    left = float(left)
    right = float(right)
    if left == right:
        refuse("right", "a well other than the left one", f"{right:g}")
    forces = np.asarray(_uniform(lattice, np.linspace(left, right, 65)))
    scale = forces[1:-1].max()
    if not scale > 0:
        refuse("lattice", "a force on the sites between the wells", "none")
    found = []
    for name, x, force in (("left", left, forces[0]), ("right", right, forces[-1])):
        if not force <= max(1e-9, 50 * float(jnp.finfo(lattice.dtype).eps)) * scale:
            refuse(
                name,
                "a well, where the force is zero",
                f"{x:g}, with {force / scale:.2g} of the largest force on the way",
                "Ends must be free: walls at u = 0 hold no other well.",
            )
        stiffness = np.asarray(stiffness_at(lattice, np.full(lattice.shape, x, lattice.dtype)))
        place = len(stiffness) // 2
        row = stiffness[place]
        if not row.sum() > 0:
            refuse(name, "a well, whose force drives sites back", f"{x:g}, the top of a barrier")
        coupling = -np.sum((np.arange(len(row)) - place) ** 2 * row) / 2
        found.append((np.abs(stiffness).max(), coupling, row.sum()))
    return _Wells(left, right, scale, *found[0])
