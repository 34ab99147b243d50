"""The solitons of Toda and of Korteweg and de Vries for a given chain."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import concrete, per_lane, positive, refuse, show
from ..base.derivatives import with_slope
from ..base.programs import compiled
from ..base.types import Parameter
from ..lattice import Lattice, State, spread_mass
from ..theory import kdv, toda
from .places import chain_only, crest, numbers, state_of

# the largest deviation from a uniform chain, over K2, and the stiffness above which an end is held
UNIFORM = 1e-6
# the largest wave at the ends, over its crest
OUTSIDE = 0.01
# the fewest sites
LEAST = 8


class Chain(NamedTuple):
    """A uniform chain: K2 and K3 of its bonds, the mass of a site, and what holds its ends."""

    K2: jax.Array
    K3: jax.Array
    mass: jax.Array
    left: jax.Array
    right: jax.Array
    ring: jax.Array
    differs: jax.Array


def toda_soliton(
    lattice: Lattice,
    k: Parameter | None = None,
    *,
    speed: Parameter | None = None,
    amplitude: Parameter | None = None,
    centre: Parameter | None = None,
    direction: str = "right",
) -> State:
    """Return the soliton of the Toda chain with the same K2, K3 and mass.

    It is exact in a Toda chain and approximate in any other; `states.solitary_wave` is exact for
    any law.

    **Arguments:**

    - `lattice`: a uniform chain of next neighbours, of any law with K2 > 0 and nonzero K3, in any
      units.
    - One of `k` [1/site], `speed` [sites/s], `amplitude`, the largest strain [m], of the sign of
      K3; as in `theory.toda`. A number or one per lane.
    - `centre`: bond of the crest (bond n joins n and n + 1), `None` for a quarter of the chain from
      where it starts; `direction`: "right" or "left".

    Meant for free ends. Between walls or on a ring the length is fixed: every bond is stretched by
    the wave's total strain over the number of bonds, and the wave is accurate up to that share.
    **Raises** ValueError for any other lattice, one without K2 (a sonic vacuum) or K3, a wave that
    is not faster than sound, or one that does not fit into the chain.

    **Example:**

    >>> chain = gx.scenes.toda(40)
    >>> state = gx.states.toda_soliton(chain, k=1.0, centre=20)
    >>> round(float(gx.measures.energy(chain, state)), 6)  # sinh 2k - 2k
    1.62686
    """
    chain, n, centre = _places("toda_soliton", lattice, centre, direction)
    strength, rate = toda.matched(chain.K2, chain.K3)
    constants = dict(strength=strength, rate=rate, mass=chain.mass)
    given = [x is not None for x in (k, speed, amplitude)]
    if sum(given) != 1:
        refuse("k, speed, amplitude", "one of the three", "several" if any(given) else "none")
    if k is None:
        k = toda.wavenumber(
            speed=_one(lattice, "speed", speed),
            amplitude=_one(lattice, "amplitude", amplitude),
            **constants,
        )
    k = per_lane("k", k, lattice.lanes, positive)
    y, v, u = toda.soliton(n, 0.0, k=k, centre=centre, direction=direction, **constants)
    return _held(lattice, chain, y, u, v)


def kdv_soliton(
    lattice: Lattice,
    *,
    speed: Parameter | None = None,
    amplitude: Parameter | None = None,
    centre: Parameter | None = None,
    direction: str = "right",
) -> State:
    """Return the soliton of the chain's Korteweg-de Vries equation.

    It is accurate just above the speed of sound. The bonds have the strains of
    `theory.kdv.soliton`, and the velocities are those with which it travels.
    **Arguments**, ends, **Raises**: as `toda_soliton`, with `speed` or `amplitude`.
    """
    chain, n, centre = _places("kdv_soliton", lattice, centre, direction)
    given = dict(
        speed=_one(lattice, "speed", speed), amplitude=_one(lattice, "amplitude", amplitude)
    )

    def wave(t):
        how = {"mass": chain.mass, "centre": centre, "direction": direction, **given}
        return tuple(kdv.soliton(n, t, chain.K2, chain.K3, **how))

    # u and v follow from the strains and their rates, summed from the last site
    (y, v, u), (rate, *_) = with_slope(wave, jnp.zeros(()))
    u, v = (
        x[-1:] + jnp.concatenate([jnp.cumsum(part[-2::-1], 0)[::-1], jnp.zeros_like(x[-1:])])
        for x, part in ((u, y), (v, rate))
    )
    return _held(lattice, chain, y, u, v)


def _one(lattice, name, x):
    return None if x is None else per_lane(name, x, lattice.lanes)


def _places(what, lattice, centre, direction):
    size = chain_only(lattice, what)
    if size < LEAST:
        refuse("lattice", f"a chain of {LEAST} sites or more, for {what}", f"{size}")
    chain = _uniform(lattice)
    differs, K2, K3 = (concrete(x) for x in (chain.differs, chain.K2, chain.K3))
    if differs is not None:
        if np.any(K2 <= 0):
            refuse(
                "lattice",
                "a linear stiffness",
                "none" if np.all(K2 == 0) else "one below zero",
                "Give its contacts a precompression; in a sonic vacuum there is no speed of sound.",
            )
        # The rounding of a ramp grows with the length of the chain.
        if np.any(differs > (UNIFORM + 8 * size * np.finfo(lattice.dtype).eps) * K2):
            refuse(
                "lattice",
                f"a uniform chain of next neighbours alone, for {what}",
                "another",
                "Springs on the sites, bonds of longer reach, patterns and disorder have other waves.",
            )
        if np.any(K3 == 0):
            refuse(
                "lattice",
                "a force with a quadratic part, K3 other than zero",
                "K3 = 0",
                "Neither equation describes such a chain; see states.solitary_wave.",
            )
    return chain, numbers(lattice), crest(lattice, centre, direction)


@compiled
def _uniform(lattice):
    # Measure the chain by its force on a step in its middle, a ramp and a translation.
    zeros = lattice.zeros()
    size = zeros.shape[0]
    mid = size // 2
    n = numbers(lattice).astype(zeros.dtype) + 0 * zeros
    force = lambda u: lattice.force(jnp.zeros((), zeros.dtype), u, zeros)

    def derivatives(shape):
        along = lambda e: with_slope(lambda e: force(e * shape), e)[1]
        return with_slope(along, jnp.zeros((), zeros.dtype))

    first, second = derivatives(jnp.where(n < mid, 1.0, 0.0))
    K2 = first[mid]
    K3 = second[mid] / 2
    inner = slice(size // 4, size - size // 4)
    # In a uniform chain a step acts only on the two sites beside it, a ramp or a translation on
    # none.
    expected = jnp.where(n == mid, 1.0, jnp.where(n == mid - 1, -1.0, 0.0))
    ramp, bent = derivatives(-n)
    moved, _ = derivatives(jnp.ones_like(n))
    mass = spread_mass(lattice)
    wrong = [first - expected * K2, ramp, moved, (mass / mass[mid] - 1) * K2]
    # K3 is compared with K2 at the strain K2/K3.
    size_2 = jnp.where(K3 == 0, 1.0, K2 / jnp.where(K3 == 0, 1.0, K3))
    wrong += [(second / 2 - expected * K3) * size_2, bent * size_2]
    differs = jnp.stack([jnp.abs(x[inner]).max(0) for x in wrong]).max(0)
    basis = jnp.where(n == 0, jnp.ones_like(n), 0.0)
    around = jnp.abs(jax.jvp(force, (zeros,), (basis,))[1][-1])
    floor = UNIFORM * K2
    return Chain(
        K2,
        K3,
        mass[mid],
        jnp.abs(moved[0]) > floor,
        jnp.abs(moved[-1]) > floor,
        around > floor,
        differs,
    )


def _held(lattice, chain, y, u, v):
    crest = concrete(jnp.abs(y).max(0))
    edge = concrete(jnp.maximum(jnp.abs(y[0]), jnp.abs(y[-1])))
    if crest is not None and np.any(edge > OUTSIDE * crest):
        refuse(
            "lattice",
            "a chain that is longer than the wave",
            f"one with {show(np.max(edge / crest))} of its crest at an end",
            "Take a longer chain, another centre, or a larger wave, which is shorter.",
        )
    size = len(u)
    total = u[0] - u[-1]
    n = numbers(lattice)
    walls = jnp.where(chain.left & chain.right, total * (n + 1) / (size + 1), 0.0)
    ring = jnp.where(chain.ring, total * n / size, 0.0)
    return state_of(lattice, u - jnp.where(chain.left, u[0], 0.0) + walls + ring, v)
