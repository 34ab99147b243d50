"""Chains with several sites per cell (SSH, sawtooth, stub, diamond); Aubry-Andre; beads that turn."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp

from ...base.checks import non_negative, parameter, positive, whole
from ...base.types import Count, Parameter, Scalar
from ...base.units import SCALED
from ...lattice import Lattice
from ...laws import Law, Linear
from ..chains import a_chain, chain
from .build import crystal
from .cells import CHAIN, DIAMOND, SAWTOOTH, SSH, STUB


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


def rotating_chain(
    sites: Count,
    *,
    stiffness: Parameter = 1.0,
    exponent: Parameter = 1.5,
    precompression: Scalar = 0.01,
    **bonds: Any,
) -> Lattice:
    r"""Build a straight chain of beads that turn: u = (u_x, u_y, s), s = R theta, R = L/2.

    theta is anticlockwise. Between neighbours act

    - the normal force F along the line of centres (`gx.Stretch`);
    - a tangential spring k_t on the slip s_n + s_{n+1} - L phi, phi the angle of that line
      (`gx.strains.Slip`);
    - a bending stiffness k_b, the resistance to rolling, on s_n - s_{n+1} (`gx.strains.Along`).

    Longitudinal waves are those of `monomer`; for transverse waves, with J = `inertia`, f =
    (F0 - T)/L and c = cos k:

        m omega^2 (u_y, J^{1/2} s) = [[a, i b], [-i b, d]] (u_y, J^{1/2} s),
        a = 2 (k_t - f)(1 - c),  b = 2 k_t sin(k)/J^{1/2},  d = (2 k_t (1 + c) + 2 k_b (1 - c))/J,
        m omega^2 = (a + d)/2 +- (((a - d)/2)^2 + b^2)^{1/2}.

    The upper branch begins at m omega^2 = 4 k_t/J, where beads turn in place; at k = pi the two are
    4 (k_t - f) and 4 k_b/J. With f = 0 the lower branch begins as k^2, and the upper one has a
    maximum of zero group velocity for (1 - J) k_t < k_b < (1 + J) k_t, at 1 - c = 4 k_t
    D/(4 J k_t k_b - D^2), D = k_b - (1 - J) k_t. With k_b = 0 the lower branch is zero for every k:
    beads roll on each other like gears. With f > 0 the chain buckles at about k^2 < 4 f/k_b, unless
    guides or an attraction (magnets, a stretched string) hold it.

    **Arguments:**

    - `sites`: N >= 2. `stiffness` (A, or one per contact), `exponent`, `precompression` F0: of the
      contacts as in `monomer`; `exponent=1`: springs. `bonds`, by name: `mass`: m, a number or one
      per bead; `law`: in place of the power law; and those below.
    - `tangential`: k_t or a law of the slip; `None` for Mindlin's 0.82 K2 of nu = 0.3. `bending`:
      k_b or a law of s_n - s_{n+1}; a moment of k_b R^2 per radian. A contact of radius a has at
      most (a/R)^2 K2, far below k_t.
    - `attraction`: T >= 0 [N], a constant pull between neighbours.
    - `inertia`: J in m R^2, 2/5 for a sphere, 1/2 for a disk. `spacing`: L = 2R.
    - `boundary`: `"fixed"` (at both ends beads that neither move nor turn), `"free"` (F0 - T held
      at the ends), `"periodic"`.

    A contact that opens loses both springs (`gx.terms.Grip`). Sliding is not modelled: check that
    `gx.measures.slip_ratio`, |T|/N, stays below the friction coefficient.

    **Returns:** a `Lattice`, u of shape (sites, 3), with positions (n L, 0).
    **Raises** ValueError for an unknown boundary, or contacts with neither a static load nor
    `tangential`.
    Source: Merkel, Tournat, Gusev, Phys. Rev. E 82, 031305 (2010); Allein, Tournat, Gusev,
    Theocharis, Appl. Phys. Lett. 108, 161903 (2016).

    **Example:**

    >>> chain = gx.scenes.rotating_chain(8, tangential=0.5, bending=0.1, attraction=0.01, boundary="periodic")
    >>> bands = gx.linear.dispersion(chain, jnp.pi).omega_squared
    >>> [round(float(x), 6) for x in bands]   # 4 k_b/J, 4 K2, 4 k_t
    [1.0, 1.292661, 2.0]
    """
    # A tuple of one entry per bond of the cell: that entry may be an array, one per contact.
    return crystal(
        CHAIN,
        a_chain(sites),
        stiffness=(stiffness,),
        exponent=exponent,
        precompression=precompression,
        rotation=True,
        **bonds,
    )
