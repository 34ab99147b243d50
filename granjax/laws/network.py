"""A small neural network as a force law, with its exact energy."""

import equinox as eqx
import jax
import jax.numpy as jnp

from ..checks import parameter, positive, refuse
from ..types import Count, Parameter
from .base import Law, checked_preload

# below it differences of tanh and of log cosh are summed as series, so that no digits are lost near rest
NEAR, TERMS = 0.02, 8
_LOG2 = 0.6931471805599453


class Network(Law):
    r"""A neural network with one hidden layer of hyperbolic tangents, through the origin.

    F(e) = F_s (c x + sum_j a_j [tanh(w_j x + b_j) - tanh(b_j)]),   x = e/e_s,

    and its integral, energy F_s e_s (c x^2/2 + sum_j a_j/w_j [log cosh(w_j x + b_j) - log cosh b_j - w_j x tanh b_j]).
    The free numbers are p_j, b_j, q_j and r with w_j = softplus(p_j) > 0 and, where the law is monotone by
    construction, a_j = softplus(q_j) > 0, c = softplus(r) > 0; else a_j = q_j and c = r. All may take any value.
    The layer starts with its units side by side on -1 < x < 1 and nearly linear, F = F_s x; beyond that the force goes
    on with slope c. One layer approximates any continuous force on an interval, and is the widest net whose energy
    has a closed form; there is nothing random in it.

    **Arguments:** `width`: number of units; `strain`: e_s > 0 [m] and `force`: F_s > 0 [N], about the largest that
    occur; `monotone`; `parameters`: the free numbers, (3 width + 1,) or (3 width + 1, bonds), in the order p, b, q, r,
    `None` for the start (`Network(...).parameters` reads them); `preload`: F0 >= 0 [N], the force at equilibrium.

    Typical: 4 to 16 units. **Raises** ValueError for e_s, F_s <= 0, F0 < 0, or parameters of another length.
    Source: G. Cybenko, Math. Control Signals Systems 2, 303 (1989).

    **Example:**

    >>> law = gx.Network(width=4, strain=0.1, force=2.0)
    >>> law.parameters.shape, round(float(law.force(0.05)), 3)
    ((13,), 0.973)
    """

    dimensions = {
        "_parameters": (0, 0, 0),
        "strain": (0, 1, 0),
        "scale": (1, 0, 0),
        "_preload": (1, 0, 0),
    }
    held = ("strain", "scale", "preload")
    _shown = {
        "strain": "strain",
        "force": "scale",
        "monotone": "monotone",
        "parameters": "_parameters",
        "preload": "_preload",
    }
    _parameters: tuple[jax.Array, ...]
    strain: jax.Array
    scale: jax.Array
    _preload: jax.Array | None
    monotone: bool = eqx.field(static=True)

    def __init__(
        self,
        width: Count = 8,
        strain: Parameter = 1.0,
        force: Parameter = 1.0,
        monotone: bool = True,
        parameters: Parameter | None = None,
        preload: Parameter = 0.0,
    ):
        self.strain, self.scale = positive("strain", strain), positive("force", force)
        self.monotone = bool(monotone)
        parameters = (
            _start(width, self.monotone)
            if parameters is None
            else parameter("parameters", parameters)
        )
        if parameters.ndim == 0 or parameters.shape[0] != 3 * width + 1:
            refuse(
                "parameters",
                f"{3 * width + 1} numbers for {width} units",
                f"shape {parameters.shape}",
            )
        # a leaf for each: scalars, or arrays over the bonds, as the parameters of any law
        self._parameters = tuple(parameters)
        self._preload = checked_preload("preload", preload, "A contact can only push.")

    @property
    def parameters(self):
        """The free numbers p, b, q, r, (3 width + 1,)."""
        return jnp.stack(self._parameters)

    @property
    def preload(self):
        return 0.0 if self._preload is None else self._preload

    def _units(self):
        """(w, b, a) of every unit, and c."""
        width = len(self._parameters) // 3
        p, b, q = (self._parameters[i * width : (i + 1) * width] for i in range(3))
        sign = jax.nn.softplus if self.monotone else lambda x: x
        return [(jax.nn.softplus(p), b, sign(q)) for p, b, q in zip(p, b, q)], sign(
            self._parameters[-1]
        )

    def force(self, e):
        x = e / self.strain
        units, c = self._units()
        return self.scale * sum((a * _rise(w * x, b) for w, b, a in units), c * x)

    def energy(self, e):
        x = e / self.strain
        units, c = self._units()
        return (
            self.scale
            * self.strain
            * sum((a / w * _work(w * x, b) for w, b, a in units), c / 2 * x * x)
        )


def _rise(y, b):
    """tanh(b + y) - tanh(b)."""
    return jnp.where(jnp.abs(y) < NEAR, _series(y, b, 1), jnp.tanh(b + y) - jnp.tanh(b))


def _work(y, b):
    """Its integral over y, log cosh(b + y) - log cosh(b) - y tanh(b)."""
    return jnp.where(
        jnp.abs(y) < NEAR, y * _series(y, b, 2), _log_cosh(b + y) - _log_cosh(b) - y * jnp.tanh(b)
    )


def _log_cosh(z):
    return z + jax.nn.softplus(-2 * z) - _LOG2


def _series(y, b, first):
    """Sum over n >= 1 of T_n y^n (first = 1), or of T_n y^n/(n + 1) (2), T_n the Taylor coefficients of tanh at b."""
    T = [jnp.tanh(b)]
    for n in range(TERMS):
        T.append(((n == 0) - sum(T[i] * T[n - i] for i in range(n + 1))) / (n + 1))
    total = 0.0
    for n in range(TERMS, 0, -1):
        total = (total + (T[n] if first == 1 else T[n] / (n + 1))) * y
    return total


def _start(width, monotone):
    """Units side by side on (-1, 1), half of the slope theirs and half that of the straight line."""

    def inverse_softplus(x):
        return jnp.log(jnp.expm1(x))

    centres = (2 * jnp.arange(width) + 1.0) / width - 1
    w = jnp.full(width, max(1.0, width / 2))
    # tanh rises by 2 and units are 2/width apart
    a, c = jnp.full(width, 0.5 / width), jnp.asarray(0.5)
    free = (inverse_softplus(a), inverse_softplus(c)) if monotone else (a, c)
    return jnp.concatenate([inverse_softplus(w), -w * centres, free[0], free[1][None]])
