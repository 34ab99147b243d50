"""A straight chain of beads that also move sideways and turn."""

from typing import Any

from ...base.types import Count, Parameter, Scalar
from ...lattice import Lattice
from ..chains import a_chain
from .build import crystal
from .cells import CHAIN


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
