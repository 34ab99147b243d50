"""Two-frequency tori: circles of states that a period rotates by an angle."""

import dataclasses
import math
from fractions import Fraction
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree
from jaxtyping import Shaped

from ..base.checks import described, positive, refuse, traced, whole
from ..base.checks import tolerance as checked_tolerance
from ..base.programs import compiled
from ..base.tuning import one_thread
from ..base.types import Along, Count, Numbers, Scalar
from ..continuation.arclength import Curve
from ..flow import Flow
from ..flow.stepping import matrix
from ..lattice import Lattice, State, vector_field
from ..linear import normal_modes
from ..measures.transport import birkhoff
from ..results import Result, array, hidden, part
from ..states import rest
from .asked import (
    checked_lattice,
    flow_over,
    largest,
    largest_of_each,
    masses,
    shifts,
    stacked,
)
from .orbit import covering
from .problems import Family, Shooting

# The number of points on the circle at first. It is odd, as are the later ones, so that each
# harmonic has both a sine and a cosine.
FIRST = 15
# The most points on the circle for a single displacement. For n displacements it is divided by n,
# and along a branch by 2 n.
MOST = 511
# The most steps per period, relative to the first number.
FINEST = 64
# The relative residual that the Gauss-Newton method may leave with the first angles.
CLOSE = 1e-4
# Singular values below this share of the largest count as zero.
FLAT = 1e-7
# The smallest fraction of a step that is tried.
SHORTEST = 2.0**-6
# The most Newton steps.
STEPS = 40
# The factor by which errors are enlarged.
SAFETY = 2
# The number of periods from which Lyapunov exponents are taken.
ITERATES = 2000
# The number of further periods at the start that do not count.
IDLE = 200
# The number of errors up to which a Lyapunov exponent counts as zero.
SURE = 5
# The relative error of the states along a branch, if the most angles and steps suffice.
ENOUGH = 1e-6
# Rotation numbers with denominators up to this are reported where a branch passes them.
STRONG = 8


class Torus(Result):
    """A two-frequency motion of a lattice: what `gx.orbits.torus` returns.

    It holds K states of a circle at t0; Fourier interpolation gives those between.
    """

    states: State = part("The states at the angles 2 pi j/K.", "angle site", name="state")
    period: float = array("The time T after which the circle returns, rotated.", "s")
    rotation: float = array("The angle rho of that rotation.", "rad")
    error: State = part("The error of the states, one for all angles.", "site")
    period_error: float = array("The error of T.", "s")
    rotation_error: float = array("The error of rho.", "rad")
    energy: float = array("The energy from equilibrium, its mean over the angles.", "J")
    lattice: Lattice = hidden("The lattice.")
    flow: Flow = hidden("The steps and the solver over a period.")
    t0: float = array("The time at which the circle is taken.", "s", default=0.0)

    @property
    def omega(self) -> tuple[float, float]:
        """Both frequencies, 2 pi/T and rho/T [rad/s]."""
        return 2 * math.pi / self.period, self.rotation / self.period

    @property
    def outcome(self) -> str:
        """The frequencies and the error, in one sentence."""
        first, second = self.omega
        count = jax.tree.leaves(self.states.u)[0].shape[0]
        return (
            f"Frequencies {first:.9g} and {second:.9g}; {count} angles; displacements known to "
            f"{largest(self.error.u):.1e}."
        )

    def state(self, theta: Scalar, periods: Count = 0) -> State:
        """Return the state at an angle, after a number of periods T."""
        theta = float(theta) + periods * self.rotation
        return jax.tree.map(lambda x: _at(np.asarray(x), [theta])[0], self.states)

    def exponents(self, iterates: Count = ITERATES) -> tuple[np.ndarray, np.ndarray]:
        """Return Lyapunov exponents [1/s], the largest first, and their errors.

        The run covers `iterates` periods; both its halves give the errors. One is zero for each
        frequency that nothing drives, and so is its partner in a conservative lattice.
        """
        lattice = self.lattice
        scale = np.repeat([1.0, self.omega[0]], masses(lattice).size)
        rows = jax.vmap(lambda y: ravel_pytree(y)[0] / scale)
        own = [_slopes(rows(self.states))]
        if not lattice.reads_time:
            own.append(rows(jax.vmap(lambda y: vector_field(0.0, y, lattice))(self.states)))
        scene = lattice, np.float64(self.period)
        maps = _maps(self.flow, self.states, self.t0, scene, scale)
        return _cocycle(maps, self.rotation, self.period, iterates, own)


class TorusBranch(Result):
    """Tori along a parameter, from `branch.switch(i)` at a Neimark-Sacker point."""

    p: Along = array("The parameter.")
    periods: Along = array("The period of the drive.", "s", name="period")
    rotation: Along = array("The angle by which a period rotates the circle.", "rad")
    rotation_error: Along = array("The errors of the angles.", "rad")
    states: State = part(
        "K states of each circle, at the angles 2 pi j/K.", "point angle site", name="state"
    )
    error: State = part("The error of the states, one for all angles.", "point site")
    exponents: Numbers = array(
        "The Lyapunov exponents, the largest first. One is zero, along the circle.",
        "1/s",
        "point exponent",
    )
    exponents_error: Numbers = array("The errors of the exponents.", "1/s", "point exponent")
    verdict: Shaped[np.ndarray, " point"] = array(
        '"stable" if all exponents but one are below zero, "unstable" or "undecided".'
    )
    lockings: tuple[tuple[float, str], ...] = array(
        "Where the rotation number rho/2 pi passes a fraction of a small denominator, "
        "(p, fraction). The motion may lock to a periodic orbit there, in a gap that is narrower "
        "than the step if the branch continues.",
        axes="locking",
    )
    curve: Curve = hidden("The curve that continuation has followed.")
    _tori: tuple[Torus, ...]

    def __len__(self) -> int:
        return len(self.p)

    @property
    def amplitude(self) -> Along:
        """max |u| over the circle at t0, (P,)."""
        return largest_of_each(self.states.u)

    @property
    def outcome(self) -> str:
        """Why the branch ended, in one sentence."""
        end = f"p reached {self.p[-1]:.6g}." if self.curve.end == "p" else self.curve.outcome
        known = largest(self.error.u)
        if known > ENOUGH * self.amplitude.max():
            count = jax.tree.leaves(self.states.u)[0].shape[1]
            end += f" Displacements are known to {known:.1e} only, from {count} angles."
        if self.curve.end == "step":
            turn = self.rotation[-1] / (2 * np.pi)
            near = Fraction(turn).limit_denominator(STRONG)
            end += f" The torus breaks, or locks: rho/2 pi = {turn:.6g}, near {near}."
        return end

    def torus(self, i: Count) -> Torus:
        """The `Torus` at point i."""
        return self._tori[i]


class _Circle(Shooting):
    """K states at t0 that a period rotates by rho, y_j(t0 + T) = y(theta_j + rho), as segments.

    The unknowns are Y, the states over `scale`, and rho, with `conditions` . Y = `values`.
    Source: Schilder, Osinga, Vogt, SIAM J. Appl. Dyn. Syst. 4, 459 (2005).
    """

    conditions: Numbers | None = None
    values: Numbers | None = None

    @property
    def parts(self):
        # Each segment has the whole period.
        return 1

    def _each(self, function, starts):
        return jax.vmap(function)((starts, jnp.zeros(self.segments, starts.dtype)))

    def _conditions(self, starts, idle, ends, lattice):
        # Fourier interpolation to the angles plus rho.
        waves = jnp.fft.rfft(starts, axis=0)
        turn = jnp.exp(1j * jnp.arange(len(waves)) * idle)
        turned = jnp.fft.irfft(waves * turn[:, None], self.segments, axis=0)
        more = self.conditions @ starts.ravel() - self.values
        return jnp.append((ends - turned).ravel(), more)


@compiled
def _maps(flow, states, t0, scene, scale):
    # The derivatives (K, 2n, 2n), in units of `scale`, of the map over a period at states (K, ...).
    lattice, period = scene
    map_at = lambda y: flow.derivative(y, t0, t0 + period, lattice)[1]
    return jax.vmap(map_at)(states) * scale / scale[:, None]


def _at(x, angles):
    # Values over a circle (K, ...) at other angles, by Fourier interpolation.
    size = len(x)
    wave = np.exp(1j * np.outer(angles, np.fft.fftfreq(size, 1 / size)))
    flat = np.fft.fft(x.reshape(size, -1), axis=0) / size
    return (wave @ flat).real.reshape(-1, *x.shape[1:])


def _angles(count, first=0.0):
    return first + 2 * np.pi * np.arange(count) / count


def _worst(circle, off):
    # The largest errors over the angles, from those of all unknowns, as a `State`.
    off = off.reshape(-1, circle.scale.size).max(0)
    return jax.tree.map(np.asarray, ravel_pytree(circle.like)[1](off * circle.scale))


def _states(circle, Y):
    # From the unknowns of a circle to a `State` with angles first.
    unravel = ravel_pytree(circle.like)[1]
    return stacked([unravel(y * circle.scale) for y in Y.reshape(circle.segments, -1)])


def _itself(period):
    return period


def torus(
    lattice: Lattice,
    modes: tuple[Count, Count],
    amplitudes: tuple[Scalar, Scalar],
    *,
    angles: Count | None = None,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
    tolerance: Scalar = 1e-9,
) -> Torus:
    r"""Find a two-frequency motion of a conservative lattice, from two of its linear modes.

    K states of a circle and the unknowns T, rho solve y_j(T) = y(theta_j + rho) by the Gauss-Newton
    method. The amplitudes and phases of both modes are given. The mean of a freely moving lattice
    stays fixed.

    **Arguments:**

    - `lattice`: conservative and autonomous. `modes`: two indices of `gx.linear.normal_modes`; the
      first mode returns after T.
    - `amplitudes`: of each mode, the largest displacement that its share makes [m]: the share of
      the first in the mean over the circle at t0, that of the second in the first harmonic.
    - `angles`: K, an odd number; `steps` in T; each `None` is doubled until the error is below
      `tolerance` times the larger amplitude. `solver`: as in `gx.orbits.orbit`.

    **Returns:** `Torus`, known to its `error`. **Raises** ValueError for a lattice that is damped,
    driven or traced, the same mode twice, modes without a frequency; RuntimeError if Newton's
    method finds none, as at a resonance of the two, or the angles do not suffice.
    Source: Gomez, Mondelo, Physica D 157, 283 (2001); Schilder, Osinga, Vogt (2005).

    **Example:**

    >>> chain = gx.scenes.fput(3, beta=1.0)
    >>> found = gx.orbits.torus(chain, (0, 2), (0.3, 0.1))
    >>> np.round(found.omega, 4).tolist()
    [0.7815, 1.8834]
    """
    if traced((lattice, amplitudes)):
        refuse(
            "lattice", "a lattice of known numbers", "a traced one", "A torus has no derivatives."
        )
    checked_lattice(lattice)
    share = checked_tolerance("tolerance", tolerance)
    problem, z = _posed(lattice, modes, amplitudes, angles or FIRST, steps, solver)
    problem, z, off = _refined(problem, _climbed(problem, z), share, angles is None, steps is None)
    return _torus_of(problem, z, off)


def _two(name, pair):
    if np.shape(pair) != (2,):
        refuse(name, "two, one per frequency", described(pair))
    return pair


def _posed(lattice, modes, amplitudes, count, steps, solver):
    # The unknowns z = (Y, rho, T over that of the first mode) are those of the linear motion.
    first, second = (whole("modes", k, 0) for k in _two("modes", modes))
    a, b = (float(positive("amplitudes", x)) for x in _two("amplitudes", amplitudes))
    found = normal_modes(lattice)
    omega = np.asarray(found.omega)
    shapes = np.asarray(matrix(found.modes)).T
    if first == second or max(first, second) >= len(omega):
        refuse("modes", f"two modes of {len(omega)}", f"{modes}")
    one, two = omega[[first, second]]
    if not min(one, two) > 0:
        refuse("modes", "modes of frequencies above zero", f"{one:.6g} and {two:.6g}")
    if not whole("angles", count, 3) % 2:
        refuse("angles", "an odd number", f"{count}")
    e, f = (shapes[k] / np.abs(shapes[k]).max() for k in (first, second))
    n = len(e)
    size = max(a, b)
    T = 2 * np.pi / one
    scale = size * np.repeat([1.0, one], n)
    mass = np.asarray(masses(lattice))
    share = lambda shape: shape * mass / (shape @ (mass * shape))
    # The mean over the circle: the first mode at its turning point, a freely moving lattice at its
    # place.
    mean = [share(e), *(np.asarray(shifts(lattice)).T * mass / mass.sum())]
    mean = np.kron(np.eye(2), mean)
    values = np.concatenate([[a], np.zeros(len(mean) - 1), [b, 0.0]]) / size
    flow = flow_over(lattice, T, steps, solver, 1, rest(lattice))
    theta = _angles(count)[:, None]
    Y = np.column_stack([a * e + b * np.cos(theta) * f, -b * two * np.sin(theta) * f]) / scale
    # Rows over the mean state, and over the first harmonic.
    conditions = [np.tile(row, count) / count for row in mean]
    harmonic = 2 * np.append(share(f), 0 * f)
    conditions += [(wave(theta) * harmonic).ravel() / count for wave in (np.cos, np.sin)]
    circle = _Circle.of(lattice, flow, None, jnp.asarray(0.0), count, scale=jnp.asarray(scale))
    circle = dataclasses.replace(circle.finer(1), conditions=np.array(conditions), values=values)
    problem = Family(circle, lattice, _itself, span=T)
    return problem, np.append(Y.ravel(), [2 * np.pi * two / one, 1.0])


def _refined(problem, z, share, more_angles, more_steps):
    # Doubles angles and steps until the error is below a share of the size; also returns the error.
    size = problem.shooting.scale.size
    begun = int(problem.shooting.flow.steps)
    while True:
        # The error by the angles alone, and by the steps as well.
        own, off = (_apart(problem, z, by) for by in (1, 2))
        worst = own[:-2].max()
        both = off[:-2].max()
        count = problem.shooting.segments
        steps = 2 * int(problem.shooting.flow.steps)
        longer = 2 * count + 1
        if both <= share:
            return problem, z, off
        if more_angles and worst > share / 2 and longer <= 2 * MOST // size:
            problem, z = _at_angles(problem, z, _angles(longer))
        elif more_steps and 2 * worst < both and steps <= FINEST * begun:
            problem = _finer(problem, 2)
        elif more_angles and more_steps:
            raise RuntimeError(
                f"The torus has the relative error {both:.1e}, above {share:.1e}: rounding limits it, or a "
                f"resonance needs more than {count} angles."
            )
        else:
            return problem, z, off
        z, _ = _newtons(problem, z)


def _climbed(problem, z):
    # From the linear motion to the full amplitudes, by way of smaller ones if needed.
    for parts in (4, 8, 16):
        found = z
        before = 1.0
        for share in np.arange(1, parts + 1) / parts:
            found = np.append(found[:-2] * share / before, found[-2:])
            values = share * problem.shooting.values
            smaller = eqx.tree_at(lambda p: p.shooting.values, problem, values)
            found, left = _newtons(smaller, found)
            before = share
            if not left <= share * CLOSE:
                break
        else:
            return found
    raise RuntimeError(
        f"Newton's method found no torus: {left:.1e} of its size is left. The two frequencies may be in resonance, "
        "or the amplitudes too large."
    )


def _newtons(problem, z):
    # Gauss-Newton steps as long as they lower the residual; also returns the residual.
    tried = z
    left = np.inf
    share = 1.0
    step = 0 * z
    for _ in range(STEPS + 1):
        gap, slope = map(np.asarray, _equations(problem, tried))
        now = np.abs(gap).max()
        if now < left:
            z = tried
            left = now
            share = 1.0
            step = np.linalg.lstsq(slope, gap, rcond=FLAT)[0]
        elif share > SHORTEST and left > CLOSE:
            share /= 2
        else:
            break
        tried = z - share * step
    return z, left


@compiled
def _equations(problem, z):
    # The residual at z = (x, p), and its derivative in x; of a torus over the period in z.
    gap, *slopes = problem.linearise(z[:-1], z[-1])
    return gap, jnp.column_stack(slopes)


def _at_angles(problem, z, angles):
    # The same circle at other angles.
    circle = problem.shooting
    count = circle.segments
    size = count * circle.scale.size
    rows = [z[:size], *np.asarray(circle.conditions) * count / len(angles)]
    Y, *conditions = (_at(row.reshape(count, -1), angles).ravel() for row in rows)
    circle = dataclasses.replace(circle, segments=len(angles), conditions=np.array(conditions))
    return dataclasses.replace(problem, shooting=circle), np.append(Y, z[size:])


def _finer(problem, by):
    return dataclasses.replace(problem, shooting=problem.shooting.finer(by))


def _apart(problem, z, by):
    # The error of the unknowns, from angles between those of z (by = 1), and from more steps.
    count = problem.shooting.segments
    between, z = _at_angles(problem, z, _angles(count, np.pi / count))
    gap, slope = map(np.asarray, _equations(_finer(between, by), z))
    square = len(slope) == slope.shape[1]
    inverse = np.linalg.inv(slope) if square else np.linalg.pinv(slope, rcond=FLAT)
    # Rounding errors of many entries add up like noise.
    largest = np.abs(z[: count * problem.shooting.scale.size]).max()
    rounding = 16 * np.finfo(z.dtype).eps * largest * np.linalg.norm(inverse, axis=1)
    return covering((inverse @ gap)[None], rounding)


@compiled
def _mean_energy(lattice, t0, states):
    return jnp.mean(jax.vmap(lambda y: lattice.energy(t0, y.u, y.v))(states))


@one_thread
def from_neimark_sacker(
    family: Family,
    z: np.ndarray,
    multiplier: complex,
    **settings: Any,
) -> TorusBranch:
    """Follow the tori that leave a Neimark-Sacker point z = (x, q) of a family of forced orbits."""
    shooting = family.shooting
    q = jnp.asarray(z[-1])
    n = 2 * shooting.count
    count = FIRST
    steps = 1
    x0 = z[:n]
    fixed = shooting.like, shooting.scale, shooting.moves
    circle = _Circle(shooting.whole, *fixed, t0=jnp.asarray(shooting.t0))
    maps = _maps(circle.flow, _states(circle, x0), circle.t0, family.scene(q), circle.scale)
    values, vectors = np.linalg.eig(maps[0])
    v = vectors[:, np.argmin(np.abs(values - multiplier))]

    def too_few(x, _):
        # Where the highest harmonic counts, the rest of the branch needs more angles too.
        waves = np.abs(np.fft.rfft(x[:-1].reshape(-1, n), axis=0)).max(1)
        return "too few angles" if waves[-1] > ENOUGH * waves.max() else None

    while True:
        finer = 2 * count + 1 <= MOST // n
        wave = np.exp(1j * _angles(count))[:, None] * v
        along, phase = (x.ravel() / np.linalg.norm(x) for x in (wave.real, (1j * wave).real))
        # The norm of the unknowns is then that of the mean state over the circle.
        own = dataclasses.replace(
            circle.finer(steps),
            scale=circle.scale * math.sqrt(count),
            segments=count,
            conditions=phase[None],
            values=np.zeros(1),
        )
        problem = dataclasses.replace(family, shooting=own)
        curve = problem.follow(
            np.append(np.tile(x0, count) / math.sqrt(count), float(np.angle(multiplier))),
            float(q),
            direction=np.append(along, [0.0, 0.0]),
            find=(),
            stop=too_few if finer else None,
            **settings,
        )
        if curve.end == "stop":
            count = 2 * count + 1
            continue
        last = np.argmax(np.ptp(curve.x[:, :-1].reshape(len(curve.p), count, n), axis=1).max(1))
        z = np.append(curve.x[last], curve.p[last])
        off = [_apart(problem, z, by)[:-1].max() for by in (1, 2)]
        least = ENOUGH * np.abs(curve.x[last, :-1]).max()
        if off[0] > least and finer:
            count = 2 * count + 1
        elif off[1] > least and 2 * steps <= FINEST and off[1] > 2 * off[0]:
            steps *= 2
        else:
            return _torus_branch(problem, curve)


def _torus_of(problem, z, off):
    # The torus of the unknowns z = (Y, rho, p), which are known up to `off`. An autonomous lattice
    # has the period as p.
    circle = problem.shooting
    size = circle.segments * circle.scale.size
    lattice, period = problem.scene(jnp.asarray(z[-1]))
    states = _states(circle, z[:size])
    rotation_error, *about = off[size:]
    return Torus(
        states,
        float(period),
        float(z[size]),
        _worst(circle, off[:size]),
        float(sum(about) * problem.span),
        float(rotation_error),
        float(_mean_energy(lattice, circle.t0, states)),
        lattice,
        circle.flow,
        float(circle.t0),
        **lattice.origin,
    )


def _torus_branch(problem, curve):
    points = np.column_stack([curve.x, curve.p])
    tori = tuple(_torus_of(problem, z, _apart(problem, z, 2)) for z in points)
    told = [(x.period, x.rotation, x.rotation_error, x.states, x.error) for x in tori]
    exponents, about = stacked(x.exponents() for x in tori)
    p = np.asarray(problem.value(curve.p))
    return TorusBranch(
        p,
        *stacked(told),
        exponents,
        about,
        np.array([_verdict(x, e) for x, e in zip(exponents, about)]),
        _lockings(p, curve.x[:, -1] / (2 * np.pi)),
        curve,
        tori,
        **tori[0].lattice.origin,
    )


def _verdict(exponents, error):
    # The exponent nearest to zero is that along the circle.
    rest = np.argsort(np.abs(exponents))[1:]
    about = SURE * error[rest]
    if (exponents[rest] > about).any():
        return "unstable"
    return "stable" if (exponents[rest] < -about).all() else "undecided"


def _lockings(p, rotation):
    # By linear interpolation of the rotation number.
    found = []
    for i, (a, b) in enumerate(zip(rotation[:-1], rotation[1:])):
        low, high = sorted((a, b))
        for bottom in range(1, STRONG + 1):
            for top in range(math.ceil(low * bottom), math.floor(high * bottom) + 1):
                if math.gcd(top, bottom) == 1 and low < high:
                    share = (top / bottom - a) / (b - a)
                    found.append((float(p[i] + share * (p[i + 1] - p[i])), f"{top}/{bottom}"))
    return tuple(found)


def _slopes(Y):
    # dy/dtheta over the circle, (K, 2n), a direction that the motion maps to itself.
    k = np.fft.fftfreq(len(Y), 1 / len(Y))
    return np.fft.ifft(1j * k[:, None] * np.fft.fft(Y, axis=0), axis=0).real


def _cocycle(maps, rotation, period, iterates, own):
    # Lyapunov exponents, with errors, of maps (K, 2n, 2n) over a circle that each rotate it by an
    # angle. `own`: fields of directions over the circle (K, 2n) that the motion maps to themselves,
    # so that their exponents are zero. From a random start they would be found slowly if the next
    # exponent is near, and rounding would lead away from them where others grow.
    maps = np.asarray(maps)
    n = maps.shape[1]
    thetas = rotation * np.arange(IDLE + iterates + 1)
    known = np.stack([_at(x, thetas) for x in own], -1)
    Q = np.random.default_rng(0).normal(size=(n, n))
    logs = []
    for map_, before, after in zip(_at(maps, thetas), known[:-1], known[1:]):
        Q[:, : len(own)] = before
        Q, R = np.linalg.qr(map_ @ np.linalg.qr(Q)[0])
        logs.append(np.log(np.abs(np.diag(R))))
        # The growth of the known directions over the circle.
        gained = np.linalg.norm(map_ @ before, axis=0) / np.linalg.norm(after, axis=0)
        logs[-1][: len(own)] = np.log(gained)
    found = birkhoff(np.stack(logs[IDLE:]) / period)
    values = np.asarray(found.value)
    error = SAFETY * np.asarray(found.error)
    # The others may be off by as much as the known directions are from zero.
    error = (
        error + SAFETY * np.abs(values[: len(own)]).max() + 10 * n * np.finfo(float).eps / period
    )
    # Directions whose exponents are not told apart mix, so each may be off by as much as the others,
    # though both halves of its own average may agree by chance.
    rest = values[len(own) :]
    alike = np.abs(rest[:, None] - rest) <= error[len(own) :]
    error[len(own) :] = np.where(alike, error[len(own) :], 0).max(1)
    order = np.argsort(-values)
    return values[order], error[order]
