"""The regularised long-wave equation in a periodic box: a lattice of places whose strain is a spectral derivative."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete, parameter, positive, refuse, show
from ..lattice import Lattice, State
from ..laws import Law, Scaled
from ..printing import told
from ..programs import by_rows
from ..strains import StrainMap
from ..terms import Bond
from ..types import Displacements, Number, Numbers, Parameter, Scalar, StateLike

# places of a box, and what a mean rate may be
LEAST, STILL = 8, 1e-9


class LongWave(NamedTuple):
    """A scene of the regularised equation: `places` (X,) [sites], the `lattice` of them and a `state` to start from.

    `gx.measures.strain(lattice, y)` is the strain at the places, `lattice.terms[0].strain_map.rate(u, v)` its rate.
    """

    lattice: Lattice
    state: State
    places: jax.Array
    __repr__ = told

    def unresolved(self, y: StateLike | None = None) -> Number:
        """How large the shortest eighth of the waves is in the strain, over the largest wave: what so many places miss.

        Above 1e-8 or so take more places; it grows along a run in which the strain steepens. `y`: a state of a run,
        `None` the one to start from.
        """
        strain = self.lattice.terms[0].strain_map.strain((self.state if y is None else y)[0])
        waves = jnp.abs(jnp.fft.rfft(strain - jnp.mean(strain)))
        return jnp.max(waves[7 * len(waves) // 8 :]) / jnp.max(waves)


class SpectralStrain(StrainMap):
    r"""y = mean - (1 - d_x^2/12)^{-1/2} d_x w, by Fourier transform over the places of a periodic box.

    What moves, w, is (1 - d_x^2/12)^{1/2} times the displacement: m w_tt = -(de/dw)^T F(y) is m y_tt = d_x^2 F(y) +
    (m/12) d_x^2 y_tt. A wave number k pulls with k^2/(1 + k^2/12), never more than 12, where the chain has
    4 sin^2(k/2). `spacing` [sites] of the places; `mean` strain [m], which a box of one length keeps.
    """

    dimensions = {"spacing": (0, 0, 0), "mean": (0, 1, 0)}
    linear = True
    spacing: Number
    mean: Number

    def _derivative(self, w):
        waves = _symbol(w, self.spacing) * by_rows(jnp.fft.rfft, w, axis=0)
        return by_rows(jnp.fft.irfft, waves, len(w), axis=0).astype(w.dtype)

    def strain(self, u: Displacements) -> Numbers:
        return self.mean - self._derivative(u)

    def rate(self, u: Displacements, v: Displacements) -> Numbers:
        return -self._derivative(v)

    def pull(self, u: Displacements, f: Numbers) -> Displacements:
        # the derivative is antisymmetric
        return self._derivative(f)

    def load(self, u: Displacements, law: Law) -> Displacements:
        return self._derivative(law.force(self.strain(u)))

    def energy(self, u: Displacements, law: Law) -> Numbers:
        return law.energy(self.strain(u))

    def split(self, bonds: Numbers, u: Displacements) -> Displacements:
        return bonds

    def stiffness_bound(self, lattice: Lattice, k: Numbers) -> Numbers:
        return 12 * jnp.max(k) / jnp.min(lattice.mass)


def _symbol(w, spacing):
    """i k/(1 + k^2/12)^{1/2}, zero for the shortest wave, which has no slope at the places."""
    k = 2 * np.pi * np.fft.rfftfreq(len(w))
    if len(w) % 2 == 0:
        k[-1] = 0.0
    k = k.reshape(-1, *[1] * (w.ndim - 1)) / spacing
    return 1j * k / jnp.sqrt(1 + k**2 / 12)


def long_wave(
    law: Law,
    strain: Parameter,
    rate: Parameter | None = None,
    *,
    spacing: Scalar,
    speed: Scalar | None = None,
    mass: Scalar = 1.0,
) -> LongWave:
    r"""The equation m y_tt = d_x^2 F(y) + (m/12) d_x^2 y_tt in a periodic box, ready for `gx.simulate`.

    Written as a lattice whose sites are places and whose strain map is a Fourier transform, it takes all that lattices
    take: every solver, tolerance, derivative, record, measure and picture; its energy is int [m (u_t^2 + u_xt^2/12)/2 +
    W(y)] dx.

        import numpy as np
        x = np.arange(-12, 12, 0.25)
        scene = gx.travelling.long_wave(
            gx.Hertz(), gx.theory.long_wave.regularised_wave(x).strain, spacing=0.25, speed=1.0)
        run = gx.simulate(scene.lattice, scene.state, 8.0, step=0.05, save_at=21)
        strain = gx.measures.along(gx.measures.strain, scene.lattice, run)
        gx.plots.space_time(strain, ts=run.ts, sites=scene.places, label="strain")

    **Arguments:**

    - `law`: F and its energy W, of single numbers; `mass` of a site.
    - `strain` (X,), at places `spacing` apart [sites], X >= 8; `rate` (X,), dy/dt there, of mean zero, as a box has one
      length. Or `speed`: that with which the strain travels, rate = -speed dy/dx. Neither: at rest.

    The linear branch of the other two long-wave equations of `theory.long_wave` turns negative beyond k = sqrt(12),
    omega^2 = (K2/m) k^2 (1 - k^2/12): their short waves grow, the finer the grid the faster. They cannot be run.

    **Returns:** `LongWave(lattice, state, places)`. What a box of X places does not resolve `LongWave.unresolved`
    tells, of the start and of a run's end: an F that is not smooth at zero (Hertz in tension) costs digits there.
    **Raises** ValueError for arrays that do not fit, a rate of another mean.
    Typical: 60 sites in 512 places, a wave of a few sites.

    **Example:**

    >>> x = jnp.arange(-12, 12, 0.25)
    >>> wave = gx.theory.long_wave.regularised_wave(x).strain
    >>> scene = gx.travelling.long_wave(gx.Hertz(), wave, spacing=0.25, speed=1.0)
    >>> scene.state.u.shape  # of 96 places on 24 sites
    (96,)
    """
    y, spacing, mass = (
        parameter("strain", strain),
        positive("spacing", spacing),
        positive("mass", mass),
    )
    if y.ndim != 1 or len(y) < LEAST:
        refuse("strain", f"an array over {LEAST} places or more", f"shape {y.shape}")
    for leaf in jax.tree.leaves(eqx.filter(law, eqx.is_inexact_array)):
        if jnp.ndim(leaf):
            refuse(
                "law",
                "one of single numbers",
                f"a parameter of shape {jnp.shape(leaf)}",
                "All places are alike.",
            )
    rate = _rate(y, rate, speed, spacing)
    mean = jnp.mean(y)
    strain_map = SpectralStrain(spacing, mean)
    lattice = Lattice(mass * spacing, Bond(strain_map, Scaled(law, spacing)), sites=len(y))
    return LongWave(
        lattice,
        State(_moved(y - mean, spacing), _moved(rate, spacing)),
        spacing * jnp.arange(len(y)),
    )


def _rate(y, rate, speed, spacing):
    if rate is not None and speed is not None:
        refuse("rate, speed", "one of the two, or none", "both")
    if speed is not None:
        k = 2 * np.pi * np.fft.rfftfreq(len(y))
        k[-1] *= len(y) % 2
        return -parameter("speed", speed) * jnp.fft.irfft(
            1j * k / spacing * jnp.fft.rfft(y), len(y)
        )
    if rate is None:
        return jnp.zeros_like(y)
    rate = jnp.broadcast_to(jnp.asarray(rate, float), y.shape)
    value = concrete(rate)
    if value is not None and abs(value.mean()) > STILL * np.abs(value).max():
        refuse(
            "rate",
            "one of mean zero",
            show(value.mean()),
            "A periodic box keeps its length. Take off the mean.",
        )
    return rate


def _moved(y, spacing):
    """What moves, of a strain without mean."""
    symbol = _symbol(y, spacing)
    some = symbol != 0
    return jnp.fft.irfft(jnp.where(some, -jnp.fft.rfft(y) / jnp.where(some, symbol, 1), 0), len(y))
