r"""Long-wave equations of a chain with a force F(y): three, which agree for long enough waves.

Sites at x = n have mass m and strain y, compression positive. To the fourth derivative in x the
chain

    m y_n'' = F(y_{n-1}) - 2 F(y_n) + F(y_{n+1})

becomes one of

- `"displacement"`: m y_tt = d_x^2 [F + (1/12)(d_x^2 F - F''(y) y_x^2/2)], from the displacements u,
  y = -u_x (Nesterenko). For F = A y^p the last term is A p (p - 1) y^{p-2} y_x^2/2 = A p (p - 1)
  (-u_x)^{p-2} (u_xx)^2/2.
- `"strain"`: m y_tt = d_x^2 F + (1/12) d_x^4 F, from the strains (Ahnert and Pikovsky).
- `"regularised"`: m y_tt = d_x^2 F + (m/12) d_x^2 y_tt (Rosenau).

Their solitary waves are `compacton.nesterenko`, `compacton.ahnert_pikovsky` and `regularised_wave`.
Only the last equation can be integrated in time. Linear waves of the others have omega^2 = (K2/m)
k^2 (1 - k^2/12), negative for k > 12^{1/2}: the shortest waves grow fastest, without bound
(`omega_squared`).

Source: V. F. Nesterenko, Dynamics of Heterogeneous Materials (Springer, 2001); K. Ahnert, A.
Pikovsky, Phys. Rev. E 79, 026209 (2009); P. Rosenau, Phys. Lett. A 118, 222 (1986).
"""

import jax.numpy as jnp
import numpy as np

from ..base.checks import one_of, positive
from ..base.types import Numbers, Parameter
from . import compacton
from .chain_wave import _numbers, _sech

__all__ = ["FORMS", "omega_squared", "regularised_wave"]

FORMS = ("displacement", "strain", "regularised")


def omega_squared(
    k: Parameter, form: str, *, K2: Parameter = 1.0, mass: Parameter = 1.0
) -> Numbers:
    """Return the square of the frequency of a linear wave.

    It is (K2/m) k^2 (1 - k^2/12), for `"regularised"` (K2/m) k^2/(1 + k^2/12); the chain itself has
    (4 K2/m) sin^2(k/2).

    **Arguments:** `k` [rad/site]; `form`: one of `FORMS`; `K2` = F'(0). **Returns:**
    omega^2 [1/s^2], negative where a wave grows. **Raises** ValueError for another form, mass <= 0.

    **Example:**

    >>> round(float(gx.theory.long_wave.omega_squared(1.0, "regularised")), 6)  # 12/13
    0.923077
    """
    k, K2, mass = _numbers(k=k, K2=K2, mass=positive("mass", mass))
    less = 1 / (1 + k**2 / 12) if one_of("form", form, FORMS) == "regularised" else 1 - k**2 / 12
    return K2 / mass * k**2 * less


def regularised_wave(
    x: Parameter,
    p: Parameter = 1.5,
    *,
    speed: Parameter = 1.0,
    stiffness: Parameter = 1.0,
    mass: Parameter = 1.0,
) -> compacton.Compacton:
    r"""Return the solitary wave of the regularised equation.

        a sech^{2/(p-1)}(3^{1/2} (p-1) x),   a^{p-1} = m c^2 (p + 1)/(2 A)

    for F = A y^p, p > 1, x = n - c t [sites]; Hertz: (25/16) c^4 sech^4(3^{1/2} x/2). Its tails
    fall as exp(-12^{1/2} |x|), so `half_width` is infinite.

    **Arguments**, **Returns**, **Raises**: as `compacton.nesterenko`.

    **Example:**

    >>> float(gx.theory.long_wave.regularised_wave(0.0).strain)  # 25/16
    1.5625
    """
    top = lambda p: (p + 1) / 2
    rate = lambda p: jnp.sqrt(3.0) * (p - 1)
    return compacton._wave(_sech, np.inf, x, p, speed, stiffness, mass, top, rate)
