r"""Simple waves of any law: the state behind a velocity step, and the rarefaction fan.

Long waves obey m y_tt = F(y)_nn. Along a wave that runs one way, v - int V dy is constant, where
V(y) = (F'(y)/m)^{1/2} is the speed of sound [sites/s]. Two halves of a chain with v_n = -2c sign(n)
therefore meet at the strain y_- with

    int_ahead^{y_-} V dy = 2c.

If V falls from the strain ahead to y_-, the wave is a fan, V(y(n/t)) = |n|/t for V_- < |n|/t < V_+.
If V rises, the wave is a dispersive shock (`shock_edges`). Its plateau is exactly y_- for the Toda
chain and nearly so for other laws: for precompressed Hertz (d0 = 1/2, sound 1) and c = 0.1, 0.3,
0.5, y_- is 9e-6, 2e-4, 7e-4 above the simulated plateau.

    import matplotlib.pyplot as plt
    import numpy as np
    n, t = np.arange(-100, 100), 80.0
    y = gx.theory.simple_wave.fan(n / t, gx.Toda(), -0.2)
    plt.plot(n, y)

Source: G. B. Whitham, Linear and Nonlinear Waves (Wiley, 1974).
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..base.checks import known_value, parameter, refuse
from ..base.derivatives import with_slope
from ..base.programs import compiled
from ..base.types import Numbers, Parameter, Scalar
from ..lattice import Lattice
from ..laws import Law
from ..profiles import medium_of
from ..profiles.medium import CHUNK, in_chunks, one_number

# the nodes of a panel
FINE = 16
# the nodes of the coarser rule that checks it
COARSE = 11
# panels that shorten towards the two ends of a path
GRADED = (60, 50)
# how often a panel that has not converged may be halved
HALVINGS = 40
# how many panels are halved at a time
MOST = 64
# the binary orders of magnitude of the strain, below and above 1, that are scanned
ORDERS = 400
# the orders left out below the largest number
SHORT = 12
# the strains per order
EACH = 2
# steps of the search for a width: Newton's method, or bisection where Newton's leaves the bracket
STEPS = 100
# relative error of the integral, in units of rounding, above which the search has failed
UNSOLVED = 1e6
# F'' of the other sign counts as an inflection from this part of the largest |F''| on
BENT = 1e-9
_RULES = [np.polynomial.legendre.leggauss(count) for count in (FINE, COARSE)]


def mean(law: Law | Lattice, c: Scalar, mass: Scalar = 1.0, *, ahead: Scalar = 0.0) -> Numbers:
    """Return the strain behind the waves of v_n = -2c sign(n), with an error of about 1e-12.

    It solves int_ahead^mean (F'/m)^{1/2} dy = 2c.

    **Arguments:**

    - `law`, `mass`: any law and its mass, or a uniform chain `Lattice`, which has both.
    - `c` [m/s]: positive compresses, negative stretches.
    - `ahead`: strain before the step [m].

    **Returns:** a strain [m], differentiable in all numbers (`jax.grad`, `jax.jvp`; not under
    `jax.jit` or `jax.vmap`).

    **Raises** ValueError for c = 0, a negative or infinite stiffness ahead, open contacts ahead,
    and a law that ends before the state: contacts open, magnets meet.

    Typical: Hertz without precompression, A = m = 1, c = 1/2: 1.01646, 1.2 % above the simulated
    mean: the wave is not simple there.

    **Example:**

    >>> round(float(gx.theory.simple_wave.mean(gx.Toda(), 0.5)), 6)  # 2 ln 1.5
    0.81093
    """
    _, given, path = _path_to(law, mass, c, ahead)
    return _mean(*given, *path.arrays[:3])


@compiled
def _mean(law, mass, c, ahead, *path):
    return ahead + _width_of(law, mass, c, ahead, *path)


def fan(
    speed: Parameter,
    law: Law | Lattice,
    c: Scalar,
    mass: Scalar = 1.0,
    *,
    ahead: Scalar = 0.0,
) -> Numbers:
    """Return the strain at n = speed t in the two rarefactions of v_n = -2c sign(n).

    The strain is `ahead` for |speed| > V_+, solves V(y) = |speed| in the fan, and is `mean` for
    |speed| < V_-. This holds for long waves: at the edges a lattice rings over t^{1/3} sites.

    **Arguments:** as `mean`; `speed`: n/t [sites/s], any shape.

    **Returns:** strains of that shape [m], differentiable as `mean` is. At the two kinks the
    derivative is that of the fan.

    **Raises** ValueError as `mean`, where c makes a shock, and where the law has an inflection
    between the states.

    **Example:**

    >>> y = gx.theory.simple_wave.fan(np.array([0.5, 0.8, 1.5]), gx.Toda(), -0.5)
    >>> print(y.round(6))  # the middle, 2 ln 0.8 in the fan, rest ahead
    [-1.386294 -0.446287  0.      ]
    """
    speed = parameter("speed", speed)
    known = known_value(speed)
    if known is None:
        refuse(
            "speed",
            "speeds that are known",
            "ones that jax.jit or jax.vmap traces",
            "jax.grad may go through it.",
        )
    medium, given, path = _path_to(law, mass, c, ahead, "fan")
    # the stiffness falls along the path
    rising = np.argsort(path.stiffness)
    square = float(medium.known.mass) * known**2
    share = np.interp(square, path.stiffness[rising], path.nodes[rising])
    inside = (np.abs(known) <= path.sound) & (np.abs(known) >= path.behind)
    behind = jnp.asarray(np.abs(known) < path.behind)
    further = jnp.asarray(path.width * share)
    return _fan(*given, speed, further, jnp.asarray(inside), behind, *path.arrays[:3])


@compiled
def _fan(law, mass, c, ahead, speed, further, inside, behind, *path):
    width = _width_of(law, mass, c, ahead, *path)
    # Newton's method from between two nodes, which also gives the derivatives
    for _ in range(4):
        stiff, bend = with_slope(law.derivative, ahead + further)
        usable = inside & (bend != 0)
        further = further - jnp.where(
            usable, (stiff - mass * speed**2) / jnp.where(usable, bend, 1.0), 0.0
        )
    return ahead + jnp.where(inside, further, jnp.where(behind, width, 0.0))


# --------------------------------------------------------------------- the state behind a wave, by adaptive quadrature


class _Path(NamedTuple):
    """The path from the strain `ahead` to the strain behind, which is `width` further.

    - `nodes`, `weights`: of a quadrature on (0, 1); `stiffness`: F' there.
    - `sound`, `behind`: V_+ and V_- [1/s]; `growth`: V_-/V_+ - 1, accurate when small.
    - `close`: whether these accurate values need an integral of F''.
    - `error`: relative error of `width` and `growth`.
    """

    c: float
    ahead: float
    width: float
    nodes: np.ndarray
    weights: np.ndarray
    stiffness: np.ndarray
    sound: float
    behind: float
    growth: float
    close: bool
    error: float

    @property
    def arrays(self) -> tuple[Numbers, ...]:
        """Width, padded nodes and weights, and 1 if F'' is needed, for a compiled program."""
        count = -(-len(self.nodes) // CHUNK) * CHUNK
        nodes = np.full(count, 0.5)
        weights = np.zeros(count)
        nodes[: len(self.nodes)] = self.nodes
        weights[: len(self.nodes)] = self.weights
        return tuple(jnp.asarray(x, float) for x in (self.width, nodes, weights, self.close))


def _rounding():
    return float(jnp.finfo(jnp.result_type(float)).eps)


@compiled
def _slopes(law, e):
    first, second = with_slope(law.derivative, e)
    overlap = law.overlap(e)
    return (
        first,
        second,
        jnp.ones(e.shape) if overlap is None else jnp.broadcast_to(overlap, e.shape),
    )


# F' and F'' at known strains; NaN where a contact is open, two magnets have met, or the law has no
# stiffness
def _slopes_at(law, e):
    first, second, overlap = in_chunks(_slopes, law, e)
    with np.errstate(invalid="ignore"):
        there = (overlap > 0) & (first > 0) & np.isfinite(first)
    return np.where(there, first, np.nan), np.where(there, second, np.nan)


# Nodes, weights, F' and F'' over a path, and relative errors of the means of (F'/m)^{1/2} and F''.
# Panels that shorten towards the ends resolve singularities there; where two rules disagree a panel
# is halved.
def _quadrature(law, mass, ahead, width):
    low, high = (2.0 ** -np.arange(count, 0, -1.0) for count in GRADED)
    edges = np.concatenate([[0.0], low, 1 - high[::-1][1:], [1.0]])
    rounding = _rounding()
    ends = np.stack([edges[:-1], edges[1:]], 1)
    kept = []
    apart = np.zeros(2)
    for level in range(HALVINGS):
        low = ends[:, :1]
        high = ends[:, 1:]
        nodes = np.concatenate([low + (high - low) / 2 * (1 + t) for t, _ in _RULES], 1)
        weights = np.concatenate([(high - low) / 2 * w for _, w in _RULES], 1)
        first, second = _slopes_at(law, ahead + width * nodes)
        with np.errstate(over="ignore", invalid="ignore"):
            sums = np.stack([np.sqrt(first / mass) * weights, second * weights])
        fine = sums[..., :FINE].sum(-1)
        off = np.abs(fine - sums[..., FINE:].sum(-1))
        if level == 0:
            whole = np.abs(fine).sum(-1)
        bad = (off > 8 * rounding * whole[:, None]).any(0) & np.isfinite(off).all(0)
        bad &= (high - low > 8 * rounding * high)[:, 0] & (level < HALVINGS - 1)
        # only the worst panels, so that the work for a law that is rough everywhere is bounded
        worst = np.argsort(-(off / np.maximum(whole, 1e-300)[:, None]).max(0) * bad)
        bad[worst[MOST:]] = False
        kept.append(np.stack([nodes, weights, first, second])[:, ~bad, :FINE].reshape(4, -1))
        apart += off[:, ~bad].sum(1)
        if not bad.any():
            break
        middle = ends[bad].mean(1)
        ends = np.concatenate(
            [np.stack([ends[bad, 0], middle], 1), np.stack([middle, ends[bad, 1]], 1)]
        )
    with np.errstate(invalid="ignore", divide="ignore"):
        return *np.concatenate(kept, 1), apart / whole + 4 * rounding


# The medium, its law and mass with c and the strain ahead, and the path of a velocity 2c, for a
# `kind` of "shock", "fan" or either. ValueError where the law has no such state, makes the other
# kind, or has an inflection.
def _path_to(law, mass, c, ahead, kind=None):
    medium = medium_of(law, mass)
    given = medium.law, medium.mass, parameter("c", c), parameter("ahead", ahead)
    law, mass, _ = medium.known
    mass = float(mass)
    c = one_number("c", c)
    ahead = one_number("ahead", ahead)
    side = 1 if c > 0 else -1
    if c == 0:
        refuse(
            "c",
            "a number other than zero",
            "0",
            "Without a jump of the velocity the chain stays at rest.",
        )
    low = _at_rest(law, ahead)
    strains, first, second = _scan(law, ahead, side)
    way = "compression" if c > 0 else "tension"
    if not len(first):
        refuse("law", f"one that resists {way}", f"one without stiffness in {way}")
    if kind is not None:
        _refuse_other(kind, side * second, c, way)
    if low == 0 and (side * second[second != 0][:1] < 0).any():
        refuse(
            "law",
            "one of finite stiffness ahead",
            f"one that is infinitely stiff at a strain of {ahead:g}",
        )
    width, (nodes, weights, stiffness, bend, errors) = _width(
        law, mass, ahead, side, 2 * abs(c), strains, first
    )
    bends = side * bend * {"shock": 1, "fan": -1, None: 0}[kind]
    if not bends.min() >= -BENT * np.abs(bends).max():
        order = np.argsort(nodes)
        turn = ahead + width * nodes[order][np.argmax(bends[order] < -BENT * np.abs(bends).max())]
        refuse(
            "law",
            f"one that bends one way between the states {ahead:g} and {ahead + width:g}",
            f"an inflection near {turn:.4g}",
            f"What starts there is no single {kind}, but several waves.",
        )
    high = float(_slopes_at(law, np.array([ahead + width]))[0][0])
    direct = high - low
    summed = width * weights @ bend
    rough = 2 * _rounding() * (high + low) / abs(direct) if direct else np.inf
    close = bool(low > 0 and not rough < errors[1])
    with np.errstate(divide="ignore"):
        growth = np.expm1(np.log1p(np.divide(summed if close else direct, low)) / 2)
    error = max(errors[0], errors[1] if close else rough, 8 * _rounding())
    path = _Path(
        c,
        ahead,
        width,
        nodes,
        weights,
        stiffness,
        np.sqrt(low / mass),
        np.sqrt(high / mass),
        growth,
        close,
        float(error),
    )
    return medium, given, path


def _at_rest(law, ahead):
    first, _, overlap = (float(x[0]) for x in _slopes(law, jnp.full(CHUNK, ahead)))
    if overlap < 0:
        refuse(
            "ahead",
            "a strain at which the contacts are closed",
            f"{ahead:g}",
            "Sound does not cross a gap.",
        )
    if not 0 <= first < np.inf:
        refuse(
            "law",
            "one of finite stiffness ahead",
            f"one with a stiffness of {first:g} at a strain of {ahead:g}",
        )
    return first


# distances from the strain ahead, over all orders of magnitude that the law has; F' and F'' there
def _scan(law, ahead, side):
    orders = min(ORDERS, jnp.finfo(jnp.result_type(float)).maxexp - SHORT)
    strains = 2.0 ** (np.arange(-orders * EACH, orders * EACH + 1) / EACH)
    first, second = _slopes_at(law, ahead + side * strains)
    begin = int(np.argmax(np.isfinite(first)))
    end = begin + int(np.argmax(np.append(~np.isfinite(first[begin:]), True)))
    # a stiffness that underflows adds nothing
    first[:begin] = 0.0
    second[:begin] = 0.0
    return strains[: end + 1], first[:end], second[:end]


def _refuse_other(kind, bends, c, way):
    bent = bends[np.isfinite(bends) & (bends != 0)]
    if not len(bent):
        refuse(
            "law",
            f"one that stiffens or softens in {way}",
            "one that is linear",
            "A linear chain: gx.theory.linear_shock.",
        )
    if (bent[0] > 0) != (kind == "shock"):
        made = (
            "a rarefaction: the law softens in "
            if kind == "shock"
            else "a shock: the law stiffens in "
        ) + way
        other = "gx.theory.simple_wave.fan" if kind == "shock" else "gx.theory.shock_edges"
        wanted = f"a number {'below' if c > 0 else 'above'} zero, which makes a {kind}"
        refuse("c", wanted, f"{c:g}, which makes {made}", f"Or ask {other} for that.")


# the signed distance over which |int V dy| is the jump, and the quadrature over it
def _width(law, mass, ahead, side, jump, strains, first):
    covered = np.cumsum(np.sqrt(first / mass) * np.diff(strains[: len(first)], prepend=0.0))
    at = strains[min(np.searchsorted(covered, jump), len(strains) - 1)]
    low = 0.0
    high = strains[-1]
    for _ in range(STEPS):
        found = _quadrature(law, mass, ahead, side * at)
        speed = np.sqrt(found[2] / mass)
        gap = at * (found[1] @ speed) - jump
        if abs(gap) <= 2 * _rounding() * jump or high - low <= 2 * _rounding() * high:
            break
        # `gap` is NaN where the law has ended
        low, high = (at, high) if gap < 0 else (low, at)
        newton = at - gap / speed[np.argmax(found[0])]
        at = newton if low < newton < high else (low + high) / 2
    if not abs(gap) <= UNSOLVED * _rounding() * jump:
        last = _quadrature(law, mass, ahead, side * low)
        reached = low * (last[1] @ np.sqrt(last[2] / mass)) / 2 * side
        refuse(
            "c",
            f"a number {'below' if side > 0 else 'above'} {reached:.6g}",
            f"{side * jump / 2:g}",
            f"At a strain of {ahead + side * low:.6g} the law ends: a contact opens, magnets meet, or it is soft.",
        )
    return side * at, found


# (F'/m)^{1/2}; zero, with zero derivatives, where the stiffness is not positive
def _speed_of(square):
    stiff = square > 0
    return jnp.where(stiff, jnp.sqrt(jnp.where(stiff, square, 1.0)), 0.0)


# Newton's method repeated from `width`, so that the result has the derivatives of the solution
def _width_of(law, mass, c, ahead, width, nodes, weights):
    for _ in range(2):
        whole = width * (weights @ _speed_of(law.derivative(ahead + width * nodes) / mass))
        width = width - (whole - 2 * c) / _speed_of(law.derivative(ahead + width) / mass)
    return width
