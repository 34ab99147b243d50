"""Transport: heat current, means with errors, correlations in space and time, conductivity."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..base.arrays import padded
from ..base.checks import parameter, per_lane, positive, refuse, whole
from ..base.printing import told
from ..base.programs import compiled
from ..base.types import Count, Number, Numbers, Parameter, Scalar, StateLike
from ..base.units import names
from ..lattice import Lattice
from ..results import Result, array, note
from ..terms.chain import next_neighbours, span
from .states_of import parts

# blocks of a history whose means give the standard error of the whole mean
BLOCKS = 20


class Average(NamedTuple):
    """A mean and its standard error."""

    value: Numbers
    error: Numbers
    __repr__ = told


class Correlation(Result):
    """A correlation in space and time."""

    lag: Numbers = array("The time differences.", "s", "lag")
    offset: Numbers = array("The distances in sites.", axes="offset")
    value: Numbers = array("The correlation.", axes="lag offset")
    error: Numbers = array("Its standard error.", axes="lag offset")

    @property
    def outcome(self) -> str:
        return f"{self.lag.size} lags up to {self._told('lag', self.lag[-1])}, {self.offset.size} sites."


class GreenKubo(Result):
    """A conductivity by the Green-Kubo formula."""

    lag: Numbers = array("The times up to which the correlation is integrated.", "s", "lag")
    correlation: Numbers = array(
        "The autocorrelation of the current, over the sites.", "W^2", "lag"
    )
    conductivity: Numbers = array("The integral up to that time, over (k_B T)^2.", "1/s", "lag")
    error: Numbers = array("Its standard error.", "1/s", "lag")
    blocks: Count = note("The number of independent blocks, or lanes, that give the error.")

    @property
    def outcome(self) -> str:
        value = self.conductivity[-1]
        error = self.error[-1]
        return (
            f"The conductivity over k_B, up to {self._told('lag', self.lag[-1])}, is {value:.4g} "
            f"+- {error:.2g} from {self.blocks} blocks; whether it still grows with the time the curve shows."
        )


def heat_current(lattice: Lattice, y: StateLike, t: Number = 0.0) -> Numbers:
    r"""Return the energy flow through each bond of a chain to the right [W].

    It is j_n = F_n (v_n + v_{n+1})/2. F_n is the force beyond the preload, so that `site_energy`
    obeys de_n/dt = j_{n-1} - j_n exactly, on-site forces included; a preload F0 adds F0
    (v_n + v_{n+1})/2. Walls at rest take no energy.

    **Shapes:** (N - 1,), or (N,) on a ring, whose last bond leads to the first site; then lanes.
    **Raises** ValueError for lattices other than a chain with scalar displacements, and forces
    between sites other than bonds to the next.

    **Example:**

    >>> chain = gx.scenes.monomer(4, precompression=1.0)
    >>> state = gx.State(jnp.array([0.1, 0.0, 0.0, 0.0]), jnp.array([1.0, 0.0, 0.0, 0.0]))
    >>> np.array(gx.measures.heat_current(chain, state)).round(4).tolist()
    [0.0768, 0.0, 0.0]
    """
    return _current(lattice, *parts(lattice, y, t), jnp.asarray(t))


@compiled
def _current(lattice, u, v, t):
    if lattice.axes != 1 or lattice.dimension is not None or lattice.fields is not None:
        refuse("lattice", "a chain with scalar displacements", f"a lattice of {lattice.shape}")
    bonds = [next_neighbours(term) for term in lattice.terms]
    ring = any(found and found[1] == "periodic" for found in bonds)
    size = len(u) - (not ring)
    total = 0.0
    for i, (term, found) in enumerate(zip(lattice.terms, bonds)):
        if found is not None:
            (contact,) = term.compressions(t, u)
            force = contact.law.force(contact.compression)
            force = force[1:-1] if found[1] == "fixed" else force
            total = total + padded(force, 0, size - len(force))
        elif span(term) != ():
            wanted = "bonds to the next site, and forces on single sites"
            refuse(f"terms[{i}]", wanted, type(term).__name__)
    speeds = v + jnp.roll(v, -1, 0) if ring else v[1:] + v[:-1]
    return total * speeds / 2


def time_average(q: Parameter, *, blocks: Count = BLOCKS) -> Average:
    """Return the mean of a history over its frames, with its standard error from means of blocks.

    The error holds where a block is long against the correlation time; where it grows as `blocks`
    falls, the history is too short. Profiles between heat baths: `time_average(mass * run.vs**2)`.

    **Arguments:** `q`: (T,) and trailing axes. `blocks`: 2 or more.
    **Raises** ValueError for fewer frames than blocks.

    **Example:**

    >>> mean = gx.measures.time_average(np.random.default_rng(0).normal(size=10000))
    >>> bool(abs(mean.value) < 4 * mean.error), bool(0.005 < mean.error < 0.02)
    (True, True)
    """
    q = parameter("q", q)
    if q.ndim == 0 or len(q) < whole("blocks", blocks, 2):
        refuse("q", f"a history of {blocks} frames or more, one a block", f"shape {q.shape}")
    return Average(*_mean(_cut(q, blocks).mean(1)))


def _cut(x, blocks):
    # the first frames are left out where the rest can be cut
    size = len(x) // blocks
    return x[len(x) - size * blocks :].reshape((blocks, size) + x.shape[1:])


def _mean(x):
    return x.mean(0), x.std(0, ddof=1) / np.sqrt(len(x))


def correlation(
    a: Parameter,
    b: Parameter | None = None,
    dt: Scalar = 1.0,
    *,
    lags: Count,
    units: str | None = None,
) -> Correlation:
    r"""Compute C(j, t) = <a_{n+j}(s+t) b_n(s)> - <a><b> on a ring in thermal equilibrium.

    All means are over sites n, times s and lanes; the standard error is from the lanes, or for
    one lane from blocks in time. With strain, momentum and `site_energy` as a and b its peaks move
    with the speed of sound.

    **Arguments:** `a`, `b`: (T, N) and lanes, frames spaced by `dt`; `b=None` is `a`. `lags`: the
    number of times, from 0 on. `units`: as in `spectrum`. **Returns:** `Correlation`, with offsets
    from -N/2 to N/2.
    **Raises** ValueError for histories that do not fit, or for one lane are shorter than 4 `lags`.

    **Example:**

    >>> noise = np.random.default_rng(0).normal(size=(400, 8))
    >>> found = gx.measures.correlation(noise, lags=3)
    >>> found.value.shape, bool(abs(found.value[0, 4] - 1.0) < 0.1)  # offset 0
    ((3, 8), True)
    """
    a = parameter("a", a)
    b = a if b is None else parameter("b", b)
    if a.shape != b.shape or a.ndim < 2:
        refuse("a, b", "histories (T, N) and lanes of one shape", f"{a.shape} and {b.shape}")
    lags = whole("lags", lags, 1)
    a, b = (x.reshape(x.shape[:2] + (-1,)) for x in (a, b))
    if a.shape[2] == 1:
        a, b = (_in_blocks(x, lags) for x in (a, b))
    means = _correlated(a - a.mean(), b - b.mean(), lags)
    sites = a.shape[1]
    offset = np.arange(sites) - sites // 2
    value, error = (x[:, offset] for x in _mean(jnp.moveaxis(means, -1, 0)))
    times = positive("dt", dt) * jnp.arange(lags)
    return Correlation(times, jnp.asarray(offset, float), value, error, _mark=names.mark_of(units))


def _in_blocks(x, lags):
    # equal parts of a history as lanes, at least twice as long as the lags
    blocks = min(len(x) // (2 * lags), BLOCKS)
    if blocks < 2:
        refuse("lags", f"at most {len(x) // 4}, a quarter of the history", f"{lags}")
    return jnp.moveaxis(_cut(x[..., 0], blocks), 0, -1)


def _correlated(a, b, lags):
    # (lags, offsets, lanes)
    frames = len(a)
    # XLA's CPU backend fails under a transformation unless the axis of a Fourier transform is last
    a, b = (jnp.moveaxis(x, (0, 1), (-2, -1)) for x in (a, b))
    transform = lambda x: jnp.fft.fftn(x, (2 * frames, x.shape[-1]), axes=(-2, -1))
    product = transform(a) * jnp.conj(transform(b))
    found = jnp.fft.ifftn(product, axes=(-2, -1)).real[..., :lags, :]
    found = found / (frames - jnp.arange(lags))[:, None] / a.shape[-1]
    return jnp.moveaxis(found, (-2, -1), (0, 1))


def green_kubo(
    current: Parameter,
    dt: Scalar,
    *,
    temperature: Parameter,
    sites: Count,
    lags: Count,
    units: str | None = None,
) -> GreenKubo:
    r"""Compute a conductivity from current fluctuations in equilibrium.

    kappa(t)/k_B = int_0^t <J(0) J(s)> ds/((k_B T)^2 N).

    **Arguments:** `current`: J, the sum of `heat_current` over bonds, (T,) and lanes, frames spaced
    by `dt`. `temperature`: k_B T [J]. `sites`: N. `lags`: frames of the correlation. `units`: as in
    `spectrum`.
    **Returns:** `GreenKubo`, by the trapezoidal rule; standard errors as in `correlation`. In
    chains that conserve momentum it grows as a power of time: the conductivity is infinite. Where
    the centre of mass moves, first subtract the flow with it.
    **Raises** ValueError as `correlation`.

    **Example:**

    >>> J = np.random.default_rng(0).normal(size=4000)
    >>> found = gx.measures.green_kubo(J, 0.1, temperature=1.0, sites=1, lags=5)
    >>> bool(abs(found.conductivity[-1] - 0.05) < 4 * found.error[-1])  # dt/2 of white noise
    True
    """
    J = parameter("current", current)
    T = per_lane("temperature", temperature, J.shape[1:], positive)
    # Squares of currents and of T underflow in float32 and SI, those of their ratio do not.
    J = J / T
    J = J.reshape((len(J) if J.ndim else 0, -1))
    J = _in_blocks(J, whole("lags", lags, 2)) if J.shape[1] == 1 else J[:, None, :]
    J = J.reshape(len(J), 1, -1)
    found = _correlated(J, J, lags)[:, 0] / whole("sites", sites, 1)
    dt = positive("dt", dt)
    steps = dt * (found[1:] + found[:-1]) / 2
    integral = jnp.concatenate([jnp.zeros_like(found[:1]), jnp.cumsum(steps, 0)])
    value, error = _mean(integral.T)
    return GreenKubo(
        dt * jnp.arange(lags),
        (found * jnp.ravel(T) * jnp.ravel(T)).mean(1),
        value,
        error,
        blocks=found.shape[1],
        _mark=names.mark_of(units),
    )


def birkhoff(q: Parameter) -> Average:
    """Return a smoothly weighted time average, and the difference of both halves.

    The weight is exp(-1/(s (1 - s))), s = t/T. Along a quasi-periodic orbit it converges faster
    than any power of T, along a chaotic one as T^-1/2: the digits to which both halves agree tell
    them apart.

    **Arguments:** `q`: (T,) and trailing axes, equally spaced. **Returns:**
    `Average(value, error)`.
    **Raises** ValueError for fewer than 16 frames.
    Source: Das, Saiki, Sander, Yorke, Nonlinearity 30, 4111 (2017).

    **Example:**

    >>> t = 0.1 * np.arange(4000)
    >>> found = gx.chaos.birkhoff(np.cos(t) ** 2)
    >>> round(float(found.value), 10), bool(found.error < 1e-8)
    (0.5, True)
    """
    q = parameter("q", q)
    if q.ndim == 0 or len(q) < 16:
        refuse("q", "a history of at least 16 frames", f"shape {q.shape}")
    half = len(q) // 2
    return Average(_smooth_mean(q), jnp.abs(_smooth_mean(q[:half]) - _smooth_mean(q[-half:])))


def _smooth_mean(q):
    s = (np.arange(len(q)) + 0.5) / len(q)
    weight = np.exp(-1 / (s * (1 - s)))
    return jnp.tensordot(weight / weight.sum(), q, 1)
