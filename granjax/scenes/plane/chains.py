"""Chains with several sites per cell (SSH, sawtooth, stub, diamond), and the Aubry-Andre chain."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp

from ...base.checks import non_negative, parameter, positive, whole
from ...base.types import Count, Parameter, Scalar
from ...base.units import SCALED
from ...lattice import Lattice
from ...laws import Law, Linear
from ..chains import chain
from .build import crystal
from .cells import DIAMOND, SAWTOOTH, SSH, STUB


def ssh(
    cells: Count,
    k1: Parameter = 1.0,
    k2: Parameter = 2.0,
    **bonds: Any,
) -> Lattice:
    r"""Build the chain of Su, Schrieffer and Heeger: springs k1 within cells and k2 between them.

    The chain has 2N equal masses: omega^2 = (k1 + k2 +- |k1 + k2 exp(ik)|)/m, with a gap 2
    k1/m ... 2 k2/m. Between walls, with springs k2, a chain with k1 < k2 has a state at either end,
    in the gap at about (k1 + k2)/m: 2.99853515 and 3.00146485 for 10 cells and k = 1, 2.

    **Arguments:** `cells`: N; `k1`, `k2` > 0: numbers, or one per bond; `bonds`, as of `crystal`:
    `mass`; `law`: two laws, within and between cells, in place of k1 and k2; `boundary`, `ground`,
    `on_site`, `units`.

    **Returns:** a `Lattice` of the fields `a`, `b`, (N,) each.
    **Raises** ValueError for stiffnesses that are not positive.
    Source: Su, Schrieffer, Heeger, Phys. Rev. Lett. 42, 1698 (1979); Chaunsali, Xu, Yang,
    Kevrekidis, Theocharis, Phys. Rev. B 103, 024106 (2021).

    **Example:**

    >>> modes = gx.linear.normal_modes(gx.scenes.ssh(10, 1.0, 2.0))
    >>> modes.omega_squared[9:11].round(6)   # states of the two ends
    Array([2.998535, 3.001465], dtype=float64)
    """
    stiffness = (positive("k1", k1), positive("k2", k2))
    return _chain(SSH, cells, stiffness=stiffness, **bonds)


# the golden mean, an irrational number
GOLDEN = (5**0.5 - 1) / 2


def aubry_andre(
    sites: Count,
    modulation: Scalar = 1.0,
    *,
    ratio: Scalar = GOLDEN,
    phase: Scalar = 0.0,
    stiffness: Scalar = 1.0,
    ground: Scalar = 2.0,
    mass: Scalar = 1.0,
    law: Law | None = None,
    on_site: Law | None = None,
    boundary: str = "fixed",
    units: str = SCALED,
) -> Lattice:
    r"""Build a quasi-periodic chain of Aubry, Andre and Harper, with cosine on-site springs.

    m u_n'' = K (u_{n-1} - 2 u_n + u_{n+1}) - [g + V cos(2 pi b n + phi)] u_n

    For irrational b all modes are extended if V < 2K, and all decay as exp(-gamma |n|), gamma =
    log(V/2K), if V > 2K. As phi runs over a period, edge modes cross the gaps. For b = p/q the gaps
    have the Chern numbers of a square lattice in a magnetic field (`gx.topology.chern` of
    D(k, phi)).

    **Arguments:** `sites`: N >= 2; `modulation`: V of either sign [N/m]; `ratio`: b, the golden
    mean by default; `phase`: phi [rad]; `stiffness`: K > 0; `ground`: g >= 0, at least |V| for
    stability at any phase; `mass`; `law`: of the bonds in place of K; `on_site`: a further law at
    every site; `boundary`: `"fixed"`, `"free"`, `"periodic"`.

    **Returns:** a `Lattice`, u of shape (N,). All numbers but `sites` are differentiable.
    **Raises** ValueError for numbers outside these ranges.
    Source: Aubry, Andre, Ann. Israel Phys. Soc. 3, 133 (1980); Martinez, Porter, Kevrekidis, Phil.
    Trans. R. Soc. A 376, 20170139 (2018).
    """
    count = whole("sites", sites, 2)
    held = non_negative("ground", ground)
    n = jnp.arange(count)
    wave = jnp.cos(2 * jnp.pi * parameter("ratio", ratio) * n + parameter("phase", phase))
    spring = Linear(held + parameter("modulation", modulation) * wave)
    spring = spring if on_site is None else spring + on_site
    bond = Linear(positive("stiffness", stiffness)) if law is None else law
    return chain(count, mass, bond, boundary=boundary, on_site=spring, units=units)


def sawtooth(
    cells: Count,
    stiffness: Parameter = 1.0,
    *,
    tooth: Scalar | None = None,
    **bonds: Any,
) -> Lattice:
    r"""Build a sawtooth chain: a chain of sites `a` and a site `b` bound to both ends of each bond.

    With teeth 2^{1/2} K and on-site springs that make all sites equal: omega^2 = Omega^2 - K E, E =
    -2 (flat) and 2 + 2 cos k; Omega^2 is the sum of the springs at `a`, 2K (1 + 2^{1/2}), and the
    ground.

    **Arguments:**

    - `cells`: N; `stiffness`: K of the bonds a-a; `tooth`: of the bonds a-b, `None` for 2^{1/2} K.
    - `bonds`, as of `crystal`: `law`: three laws in their place, for a-a, a-b within the cell and
      between cells; `mass`; `units`; `on_site`. By default `boundary` is `"periodic"`, `ground` 0,
      and `equal` True, without which the band is not flat.

    **Returns:** a `Lattice` of the fields `a`, `b`.
    **Raises** ValueError as `ssh` does.
    Source: Leykam, Andreanov, Flach, Advances in Physics: X 3, 1473052 (2018).

    **Example:**

    >>> gx.linear.flat_bands(gx.scenes.sawtooth(8)).omega_squared.round(6)   # 2 K (1 + 2^(1/2)) + 2 K
    array([6.828427])
    """
    K = positive("stiffness", stiffness)
    side = 2**0.5 * K if tooth is None else positive("tooth", tooth)
    return _flat(SAWTOOTH, cells, (K, side, side), **bonds)


def stub(cells: Count, stiffness: Parameter | Sequence[Parameter] = 1.0, **bonds: Any) -> Lattice:
    r"""Build a stub chain: a chain a, b, a, b, ... with a site `c` on each `a`.

    With on-site springs that make all sites equal: omega^2 = Omega^2 - K E, Omega^2 = 3K + ground,
    E = 0 (flat) and +-(3 + 2 cos k)^{1/2}.

    **Arguments:** as of `sawtooth`; `stiffness`: a number, or one each for a-b within the cell,
    between cells, a-c.
    **Returns:** a `Lattice` of the fields `a`, `b`, `c`.
    **Raises** ValueError as `ssh` does.
    """
    return _flat(STUB, cells, stiffness, **bonds)


def diamond(
    cells: Count, stiffness: Parameter | Sequence[Parameter] = 1.0, **bonds: Any
) -> Lattice:
    r"""Build a diamond chain of corner-sharing squares: `a` is bound to `b`, `c` on both sides.

    With on-site springs that make all sites equal: omega^2 = Omega^2 - K E, Omega^2 = 4K + ground,
    E = 0 (flat) and +-8^{1/2} cos(k/2).

    **Arguments:** as of `sawtooth`; `stiffness`: a number, or one each for a-b, a-c, b-a', c-a'.
    **Returns:** a `Lattice` of the fields `a`, `b`, `c`.
    **Raises** ValueError as `ssh` does.
    """
    return _flat(DIAMOND, cells, stiffness, **bonds)


def _flat(cell, cells, stiffness, *, boundary="periodic", ground=0.0, equal=True, **bonds):
    return _chain(
        cell, cells, stiffness=stiffness, boundary=boundary, ground=ground, equal=equal, **bonds
    )


def _chain(cell, cells, **bonds):
    return crystal(cell, whole("cells", cells, 1), out_of_plane=True, **bonds)
