"""The solitary wave of a law: a first shape by iteration, then Newton's method."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ..base.checks import refuse, traced
from ..base.printing import told
from ..base.programs import compiled
from .existence import Bounds, reached, side_of, twice_energy
from .medium import Medium, fine, fine_force, implicit, in_float64, one_number, values
from .shape import TentShape
from .tent import PIECES, STENCIL, Found, Places, Tent, iterated, left_between, solve

# The numbers of places, one after the other.
PLACES = (160, 320, 640, 1280)
# The error, over the peak, at which they suffice.
ENOUGH = 1e-13
# The largest residual of Newton's method.
CONVERGED = 1e-9
# The largest residual of ln(strain) between places, so that the tail is accurate too.
TAIL = 1e-12
# ln of the strain over its peak where places end, for an exponential tail.
DEEP = -42.0
# The same for a tail that falls faster.
DEEPEST = -560.0
# ln of the strain over its peak where the exponential tail of a first shape begins.
FAR = -18.0
# The width of a first shape without exponential tail, over (p - 1)^(-1/2) of the power p.
WIDTH = 0.45
# The most secant steps for a peak of given energy.
SECANTS = 8
# The tolerance of the logarithm of this peak.
NEAR = 1e-3
# The slope of ln F per contact times the length of a piece, at first.
STEEP = 2.0
# The error of an equation in units of rounding.
LAST = 2.0
# A strain, over its unit, at which the force has its power law from zero.
SMALL = 1e-6


class Solved(NamedTuple):
    """A solved wave: shape, residual, error, the tail's decay rate and exponent, integrals."""

    shape: TentShape
    residual: float
    error: float
    decay: float
    exponent: float
    energy: Any
    momentum: Any
    compression: Any
    __repr__ = told


class _Problem(NamedTuple):
    """The wave to find: strains in `unit`, m c^2 in `level`."""

    medium: Medium
    unit: float
    level: float
    linear: float
    given: str
    target: float

    def force(self, e):
        F, slope, _ = values(self.medium.law, self.unit * e)
        return F / (self.unit * self.level), slope / self.level

    def exponent(self, e):
        f, slope = self.force(np.array([e]))
        return float(e * slope[0] / f[0])

    def decay(self, level):
        # Return the rate of the tail at the logarithm of a level, 0 for a tail that falls faster.
        return decay_rate(np.exp(level) / self.linear) if self.linear > 0 else 0.0

    def held(self, places: Places) -> Callable:
        first = np.eye(1, places.count)[0]

        def energy(q, level):
            e = self.unit * np.exp(q)
            F, slope, W = values(self.medium.law, e)
            whole = 2 * places.weights @ (e * F / 2 + W)
            grows = 2 * places.weights * (3 * e * F + e * e * slope) / 2
            return np.log(whole / self.target), grows / whole, 0.0

        return {
            "speed": lambda q, level: (level, 0 * first, 1.0),
            "amplitude": lambda q, level: (q[0], first, 0.0),
            "energy": energy,
        }[self.given]


def decay_rate(ratio: float) -> float:
    """Return kappa > 0 with sinh^2(kappa/2) = ratio (kappa/2)^2, ratio = m c^2/K2 > 1."""
    if not 1 < ratio < np.inf:
        return np.inf if ratio == np.inf else np.nan
    size = np.log1p(ratio - 1) / 2

    def over(x):
        # ln sinh(x)/x, which does not overflow, or cancel where x is small
        grown = x + np.log(-np.expm1(-2 * x) / (2 * x)) if x > 1e-3 else x * x / 6
        return grown - size

    return 2 * scipy.optimize.brentq(over, 0.0, 2 * size + 2, xtol=1e-300, rtol=1e-15)


def one_given(**numbers: Any) -> tuple[str, Any]:
    """Return the name and the value of the one number given; the others are `None`.

    **Raises** ValueError for none or several.
    """
    given = {name: x for name, x in numbers.items() if x is not None}
    if len(given) != 1:
        refuse(
            ", ".join(numbers),
            "exactly one of them",
            ", ".join(given) or "none",
            "One number says which wave of the family.",
        )
    return given.popitem()


def wave_of(
    medium: Medium,
    speed: Any = None,
    amplitude: Any = None,
    energy: Any = None,
    side: str | None = None,
) -> Solved:
    """Find the solitary wave of one speed (negative to the left), peak strain or energy.

    **Raises** ValueError, with the reason, where there is none.
    """
    numbers = {"speed": speed, "amplitude": amplitude, "energy": energy}
    return assembled(medium, *searched(medium, side, **numbers), numbers)


def searched(
    medium: Medium, side: str | None, speed: Any = None, amplitude: Any = None, energy: Any = None
) -> tuple:
    """Search for a wave in known numbers, for `assembled`."""
    in_float64()
    known = medium.known
    c, a, E = map(one_number, ("speed", "amplitude", "energy"), (speed, amplitude, energy))
    problem = _problem(known, side_of(known.law, side, a), c, a, E)
    return problem, *_finished(problem, *_first(problem))


def _problem(medium, found: Bounds, c, a, E):
    mass = float(medium.mass)
    sound = np.sqrt(max(found.linear, 0.0) / mass)
    if c is not None:
        level = mass * c * c
        if not level > 0:
            refuse("speed", "one that is not zero", f"{c:g}")
        if found.linear and level / found.linear < 1 + 1e-9:
            refuse(
                "speed",
                f"one above that of sound, {sound:g} contacts per time, by a part in 1e9 or more",
                f"{c!r}",
                "Slower waves are periodic; closer to it a wave is a soliton of the Korteweg-de Vries equation "
                "to all digits.",
            )
        unit = reached(medium.law, found, level)
        if unit is None:
            fastest = np.sqrt(found.secant[np.isfinite(found.secant)].max() / mass)
            refuse(
                "speed",
                f"one below {fastest:.6g}",
                f"{c:g}",
                "Beyond, the energy that the law stores, at most m c^2 e^2/2, does not balance the motion.",
            )
        return _Problem(medium, unit, level, found.linear / level, "speed", c)
    if a is not None:
        level = float(twice_energy(medium.law, np.array([a]))[0])
        if not np.isfinite(level) or not level > found.linear:
            refuse(
                "amplitude",
                "a strain at which the law has stiffened",
                f"{a:g}",
                "At this strain the law has ended, or is softer than at rest.",
            )
        return _Problem(medium, a, level, found.linear / level, "amplitude", a)
    if not E > 0:
        refuse("energy", "a number above zero", f"{E:g}", "This is the chain at rest.")
    return _by_energy(medium, found, E)


def _by_energy(medium, found, E):
    usable = np.isfinite(found.secant) & (found.secant > found.linear * (1 + 1e-9))
    strains = found.strains[usable]
    secant = found.secant[usable]
    rate = [decay_rate(s / found.linear) if found.linear else 3.0 for s in secant]
    with np.errstate(over="ignore"):
        crude = 2 * secant * strains**2 * (0.5 + 1 / np.array(rate))

    def of_peak(log):
        a = found.side * np.exp(log)
        level = float(twice_energy(medium.law, np.array([a]))[0])
        return _Problem(medium, a, level, found.linear / level, "energy", E)

    def over(log):
        problem = of_peak(log)
        places, q, _ = _settled(problem)
        e = problem.unit * np.exp(q)
        F, _, W = values(medium.law, e)
        return np.log(2 * places.weights @ (e * F / 2 + W) / E)

    start = np.interp(np.log(E), np.log(crude), np.log(np.abs(strains)))
    with np.errstate(all="ignore"):
        near = scipy.optimize.root_scalar(
            over, x0=start, xtol=NEAR, method="secant", maxiter=SECANTS
        ).root
    return of_peak(near if np.isfinite(over(near)) else start)


def _settled(problem: _Problem) -> tuple[Places, np.ndarray, float]:
    # Return places, ln of strain over peak and ln of the level, by a coarse iteration.
    #
    # The start is sech^(2/s)(s rate x/2), the limit of weak waves where the force grows beyond its
    # linear part as e^(1 + s). Without a linear part it is a Gaussian, which lies above a tail that
    # falls faster.
    rate = problem.decay(0.0)
    steep = max(rate, problem.exponent(1.0))
    if rate:
        end = -DEEP / rate + 4
        sweeps = 0
    else:
        over = max(problem.exponent(SMALL) - 1, 1e-6)
        if not np.isfinite(over):  # steeper than numbers hold
            return Places(PLACES[0], 1.0, rate), np.zeros(PLACES[0]), np.inf
        end = 3 + 5 / over**0.5 + np.log(-DEEPEST / 10) / np.log1p(over)
        # Each iteration extends the tail by one contact.
        sweeps = int(np.ceil(end))
    # The places are close enough to resolve the corner of a strong wave.
    count = max(PLACES[0], int(2 * end * max(rate, steep - 1)))
    places = Places(count, end / (count - 1), rate)
    x = places.nodes
    if rate:
        grown = (problem.force(np.ones(1))[0][0] - problem.linear) / (1 - problem.linear)
        power = np.clip(2 * (grown - 1), 0.05, min(6.0, 3.2 / rate**2))
        q = 2 / power * (np.log(2) + power * rate * x / 2 - np.logaddexp(power * rate * x, 0))
    else:
        q = -0.8 * (x / max(1.0, WIDTH / over**0.5)) ** 2
    return places, *iterated(Tent.of(places, _pieces(steep / 2)), problem.force, q, sweeps)


def _pieces(steep, finer=1):
    return np.linspace(0, 1, 1 + finer * int(np.ceil(max(steep / STEEP, 1))))


def _first(problem):
    places, q, level = _settled(problem)
    if not np.isfinite(level):
        refuse(
            "law",
            "a law for which the iteration of the first shape converges",
            "one for which it does not",
            "Try another speed or amplitude.",
        )
    x = places.nodes
    within = partial(places.interpolated, q)
    level = 0.0 if problem.given == "speed" else level
    if not problem.linear > 0:
        return within, level, 0.0, x[np.argmax(q < DEEPEST) or -1]
    rate = decay_rate(max(np.exp(level) / problem.linear, 1 + 1e-9))
    k = np.argmax(q < FAR) or len(x) - 1

    def first(y):
        return within(np.minimum(y, x[k])) - rate * np.maximum(y - x[k], 0.0)

    return first, level, rate, x[k] + (q[k] - DEEP) / rate


def _finished(problem, first, level, rate, end) -> tuple[Tent, Found, float]:
    for count in PLACES:
        pieces = PIECES
        if problem.linear > 0:
            pieces = _pieces(max(rate, problem.exponent(1.0)), count // PLACES[0])
        tent = Tent.of(Places(count, end / (count - 1), rate), pieces)
        found = solve(
            tent, problem.force, first(tent.places.nodes), level, problem.held(tent.places)
        )
        if not found.residual < CONVERGED:
            if count == PLACES[-1]:
                refuse(
                    "law",
                    "a law whose wave is found",
                    f"a residual of {found.residual:.1e} after Newton's method",
                    "The search failed, which does not say that there is none. Try another speed or amplitude.",
                )
            continue
        places = tent.places
        level = found.level
        rate = problem.decay(level)
        first = partial(places.interpolated, found.q)
        strain = np.exp(found.q)
        moves = np.abs(np.linalg.inv(found.jacobian))[:count, :count]
        # The effect on the strain of the rounding of each equation's logarithms and of the level.
        rounding = np.finfo(float).eps * (LAST + problem.exponent(strain[0]) + np.abs(found.q))
        left = left_between(tent, pieces, problem.force, found)
        least, more = (float((strain * (moves @ gap)).max()) for gap in (rounding, left))
        if more <= max(ENOUGH * strain[0], least) and left.max() <= TAIL:
            break
    # Pieces half as long show at least half of the error of the pieces.
    return tent, found._replace(residual=float(left.max())), (2 * more + least) * abs(problem.unit)


def assembled(
    medium: Medium, problem: Any, tent: Tent, found: Found, error: float, numbers: dict[str, Any]
) -> Solved:
    """Return the wave that `searched` found."""
    law = medium.law
    mass = medium.mass
    # device_put, because a conversion would compile a program.
    q, level, unit = map(_put, (found.q, found.level, problem.unit))
    if traced((law, mass, numbers)):
        q, level = _implicit(medium, problem, tent, found, numbers)
    if problem.given == "speed":
        speed = jnp.asarray(numbers["speed"], float)
    else:
        speed = jnp.sqrt(jnp.exp(level) * problem.level / mass)
    places = tent.places
    rate = problem.decay(found.level)
    steep = rate or (found.q[-2] - found.q[-1]) / places.apart
    shape, energy, compression = _whole(law, mass, speed, unit, q, _put(places.apart), _put(steep))
    exponent = np.nan if problem.linear > 0 else problem.exponent(SMALL)
    if traced((law, mass, numbers)):
        rate, exponent = _tails(law, mass * speed**2, rate, exponent, unit)
    return Solved(
        shape,
        found.residual,
        error,
        rate if problem.linear > 0 else np.nan,
        exponent,
        energy,
        mass * speed * compression,
        compression,
    )


def _put(x):
    return jax.device_put(np.asarray(x))


def _tails(law, level, rate, exponent, unit):
    if np.isfinite(exponent):
        e = unit * SMALL
        return rate, implicit(lambda p: p - e * law.derivative(e) / law.force(e), exponent, 1.0)

    gap = partial(_tail, law, level)
    return implicit(gap, rate, 1 / jax.grad(gap)(rate)), exponent


@compiled
def _tail(law, level, kappa):
    ratio = level / law.derivative(jnp.zeros(()))
    return 2 * jnp.log(jnp.sinh(kappa / 2) / (kappa / 2)) - jnp.log(ratio)


@compiled
def _whole(law, mass, speed, unit, q, apart, steep):
    places = Places(len(q), apart, 0.0)
    shape = TentShape(law, mass, speed, places.coefficients(q), apart, unit, steep).with_tail()
    e = unit * jnp.exp(q)
    F, _, W = fine(law, e)
    return shape, 2 * places.weights @ (e * F / 2 + W), 2 * places.weights @ e


def _implicit(medium, problem, tent, found, numbers):
    rows, nodes = (x.reshape(-1, STENCIL) for x in (tent.matrix.data, tent.matrix.indices))
    given = jnp.asarray(numbers[problem.given], float)
    parts = rows, nodes, tent.shift, tent.weights, tent.places.weights
    gap = partial(_gap, medium.law, medium.mass, problem.given, given, _put(problem.unit), parts)
    x = implicit(gap, np.append(found.q, found.level), np.linalg.inv(found.jacobian))
    return x[:-1], x[-1]


# Without compiling each operation of its derivatives would be a program.
@compiled
def _gap(law, mass, name, given, unit, parts, x):
    rows, nodes, shift, weights, within = parts
    q = x[:-1]
    level = x[-1]
    strain = unit * jnp.exp((rows * q[nodes]).sum(1) + shift)
    integral = (weights * fine_force(law, strain.reshape(weights.shape))).sum(1) / unit
    if name == "speed":
        more = level - jnp.log(mass * given**2)
    elif name == "amplitude":
        more = q[0] - jnp.log(given / unit)
    else:
        e = unit * jnp.exp(q)
        F, _, W = fine(law, e)
        more = jnp.log(within @ (e * F / 2 + W) / given)
    # Only derivatives are taken, so that constants are left out. The square of an integral far in
    # the tail underflows, which second derivatives of its logarithm divide by.
    over = integral / jax.lax.stop_gradient(integral)
    return jnp.append(jnp.log(over) - level - q, more)
