r"""Long-wave equations of a chain with a force F(y) of the strain: three, which agree for waves that are long enough.

Sites at x = n, mass m, strain y, compression positive; to the fourth derivative in x the chain

    m y_n'' = F(y_{n-1}) - 2 F(y_n) + F(y_{n+1})

becomes one of

- `"displacement"`: m y_tt = d_x^2 [F + (1/12)(d_x^2 F - F''(y) y_x^2/2)], from the displacements u, y = -u_x
  (Nesterenko; for F = A y^p the last term is A p (p - 1) y^{p-2} y_x^2/2 = A p (p - 1) (-u_x)^{p-2} (u_xx)^2/2);
- `"strain"`: m y_tt = d_x^2 F + (1/12) d_x^4 F, from the strains (Ahnert and Pikovsky);
- `"regularised"`: m y_tt = d_x^2 F + (m/12) d_x^2 y_tt (Rosenau).

Each has its own solitary wave: `compacton.nesterenko`, `compacton.ahnert_pikovsky`, `regularised_wave`. Only the last
equation may be integrated in time: the linear waves of the others have omega^2 = (K2/m) k^2 (1 - k^2/12), below zero
beyond k = 12^{1/2}, so that the shortest of them grow fastest without bound (`omega_squared`).

Source: V. F. Nesterenko, Dynamics of Heterogeneous Materials (Springer, 2001); K. Ahnert, A. Pikovsky, Phys. Rev. E 79,
026209 (2009); P. Rosenau, Phys. Lett. A 118, 222 (1986).
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import one_of, parameter, positive
from ..programs import by_rows
from ..types import Numbers, Parameter, Scalar
from . import compacton
from .chain_wave import _numbers, _sech

__all__ = ["FORMS", "omega_squared", "regularised_wave", "residual", "travelling_residual"]

FORMS = ("displacement", "strain", "regularised")


def omega_squared(
    k: Parameter, form: str, *, K2: Parameter = 1.0, mass: Parameter = 1.0
) -> Numbers:
    """Square of the frequency of a linear wave: (K2/m) k^2 (1 - k^2/12), of `"regularised"` (K2/m) k^2/(1 + k^2/12).

    That of the chain is (4 K2/m) sin^2(k/2). **Arguments:** `k` [rad/site]; `form`: of `FORMS`; `K2` = F'(0).
    **Returns:** omega^2 [1/s^2], below zero where a wave grows. **Raises** ValueError for another form, mass <= 0.

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
    r"""The solitary wave of the regularised equation, a sech^{2/(p-1)}(3^{1/2} (p-1) x), a^{p-1} = m c^2 (p + 1)/(2 A).

    F = A y^p, p > 1, x = n - c t [sites]; Hertz: (25/16) c^4 sech^4(3^{1/2} x/2). It has tails exp(-12^{1/2} |x|), no
    edge: `half_width` is infinite. **Arguments**, **Returns**, **Raises**: as `compacton.nesterenko`.

    **Example:**

    >>> float(gx.theory.long_wave.regularised_wave(0.0).strain)  # 25/16
    1.5625
    """
    p = compacton._exponent("p", p)
    speed, ratio = (
        positive("speed", speed),
        positive("mass", mass) / positive("stiffness", stiffness),
    )
    return compacton.Compacton(*_regularised(parameter("x", x), p, speed, ratio))


@jax.jit
def _regularised(x, p, c, ratio):
    height = (ratio * c**2 * (p + 1) / 2) ** (1 / (p - 1))
    profile = lambda x: height * _sech(jnp.sqrt(3.0) * (p - 1) * x) ** (2 / (p - 1))
    return profile(x), c * profile(x - 0.5), jnp.full_like(x * p, jnp.inf)


def travelling_residual(
    profile: Callable,
    x: Parameter,
    force: Callable,
    speed: Parameter,
    form: str,
    *,
    mass: Parameter = 1.0,
) -> Numbers:
    r"""What a wave y = profile(n - c t) leaves of an equation, integrated twice: m c^2 y - F(y) - R/12 [N].

    R = d_x^2 F - F'' y_x^2/2, d_x^2 F, or m c^2 y_xx, by automatic differentiation; zero for a solitary wave of the
    equation, whose strain is zero far away.

    **Arguments:** `profile`: a function of one place, such as `lambda x: compacton.nesterenko(x).strain`; `x`: places
    (...,), inside of a compacton; `force`: F, a function of the strain, such as `law.force`; `speed` c; `form`: of
    `FORMS`; `mass`. **Returns:** (...,). **Raises** ValueError for another form, functions that give no numbers.

    **Example:**

    >>> wave = lambda x: 25 / 16 / jnp.cosh(3**0.5 * x / 2) ** 4  # that of `regularised_wave`
    >>> left = gx.theory.long_wave.travelling_residual(wave, 1.0, gx.Hertz().force, 1.0, "regularised")
    >>> abs(float(left)) < 1e-12
    True
    """
    one_of("form", form, FORMS)
    x, speed, mass = _numbers(x=x, speed=speed, mass=positive("mass", mass))
    place, speed, mass = jnp.broadcast_arrays(x, speed, mass)

    def left(x, c, m):
        y, slope, bend = profile(x), jax.grad(profile)(x), jax.grad(jax.grad(profile))(x)
        F1, F2 = jax.grad(force)(y), jax.grad(jax.grad(force))(y)
        second = {
            "displacement": F1 * bend + F2 * slope**2 / 2,
            "strain": F1 * bend + F2 * slope**2,
            "regularised": m * c**2 * bend,
        }[form]
        return m * c**2 * y - force(y) - second / 12

    if not place.size:
        return place
    found = jax.vmap(left)(place.ravel(), speed.ravel(), mass.ravel())
    return found.reshape(place.shape)


def residual(
    y: Parameter,
    y_tt: Parameter,
    force: Callable,
    form: str,
    *,
    spacing: Scalar,
    mass: Parameter = 1.0,
) -> Numbers:
    r"""What a field leaves of an equation, m y_tt - d_x^2 [F + R/12] [N], by spectral derivatives in a periodic box.

    **Arguments:** `y`, `y_tt`: strain and its second derivative in time on X places (X, *lanes), `spacing` > 0 apart
    [sites]; `force`: F, elementwise; `form`: of `FORMS`; `mass`. **Returns:** (X, *lanes).
    **Raises** ValueError for another form, shapes that differ, fewer than four places.

    **Example:**

    >>> x, k = jnp.linspace(0.0, 20.0, 64, endpoint=False), 2 * jnp.pi / 20.0
    >>> y, square = jnp.cos(k * x), gx.theory.long_wave.omega_squared(k, "strain")
    >>> left = gx.theory.long_wave.residual(y, -square * y, lambda y: y, "strain", spacing=20.0 / 64)
    >>> float(abs(left).max()) < 1e-12  # a linear wave solves the equation
    True
    """
    one_of("form", form, FORMS)
    y, y_tt, mass, spacing = (
        parameter("y", y),
        parameter("y_tt", y_tt),
        positive("mass", mass),
        positive("spacing", spacing),
    )
    k = (2 * np.pi * np.fft.rfftfreq(len(y))).reshape(-1, *[1] * (y.ndim - 1)) / spacing
    # the shortest wave has no slope
    odd = jnp.asarray(1j * k).at[-1 if len(y) % 2 == 0 else len(k) :].set(0)
    derivative = lambda f, symbol: by_rows(
        jnp.fft.irfft, symbol * by_rows(jnp.fft.rfft, f, axis=0), len(y), axis=0
    )
    F = force(y)
    if form == "regularised":
        return mass * y_tt - derivative(F, -(k**2)) - mass / 12 * derivative(y_tt, -(k**2))
    inner = derivative(F, -(k**2))
    if form == "displacement":
        one = jnp.ones_like(y)
        bend = jax.jvp(lambda y: jax.jvp(force, (y,), (one,))[1], (y,), (one,))[1]
        inner = inner - bend * derivative(y, odd) ** 2 / 2
    return mass * y_tt - derivative(F + inner / 12, -(k**2))
