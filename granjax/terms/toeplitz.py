"""Sums over all neighbours of a chain by FFT: y_n = sum over m of c_m (x_{n+m} + s x_{n-m})."""

import jax.numpy as jnp

from ..programs import by_rows

FACTORS = (2, 3, 5, 7)


def neighbour_sums(c, x, parity, boundary):
    """sum over m >= 1 of c_m (x_{n+m} + parity x_{n-m}), parity 1 or -1, by FFT.

    `c` (M,), for offsets 1 to M, and `x` (N, ...): lanes last, of which those of `c` are the first. Beyond the ends of
    a chain x is zero; around a ring (`boundary` "periodic") every offset counts, as often as it goes around.
    """
    weights = behind(spectrum(c, x.shape[0], parity, boundary, x.dtype), parity, x.ndim)
    return back(weights * forth(x, boundary), x.shape[0], boundary)


def spectrum(c, n, parity, boundary, dtype):
    """The transform of the weights `c` (M, lanes...) on n sites, lanes last; for parity -1 its imaginary part."""
    c = jnp.moveaxis(c.astype(dtype), 0, -1)
    # beyond the ends of a chain nothing moves
    c = c if boundary == "periodic" else c[..., : n - 1]
    found = by_rows(jnp.fft.rfft, folded(c, _around(n, boundary)))
    return jnp.moveaxis(2 * found.real if parity == 1 else -2 * found.imag, -1, 0)


def behind(spectrum, parity, ndim):
    """A spectrum for arrays of so many axes, frequencies last as `forth` has them."""
    spectrum = spectrum.reshape(spectrum.shape + (1,) * (ndim - spectrum.ndim))
    return jnp.moveaxis(spectrum if parity == 1 else 1j * spectrum, 0, -1)


def forth(x, boundary):
    """The transform of `x` (N, lanes...), its frequencies last."""
    return by_rows(jnp.fft.rfft, jnp.moveaxis(x, 0, -1), _around(len(x), boundary))


def back(y, n, boundary):
    """Inverse of `forth`, n sites first."""
    return jnp.moveaxis(by_rows(jnp.fft.irfft, y, _around(n, boundary))[..., :n], -1, 0)


def folded(c, n):
    """The kernel of a ring of n sites: weights of the offsets 0 ... n - 1, summed over all ways around."""
    count = -(-(c.shape[-1] + 1) // n)
    c = jnp.pad(c, [(0, 0)] * (c.ndim - 1) + [(1, count * n - 1 - c.shape[-1])])
    return c.reshape(c.shape[:-1] + (count, n)).sum(-2)


def _around(n, boundary):
    """The sites of a ring: those of a chain and as many at rest, so that nothing comes back around its ends."""
    return n if boundary == "periodic" else smooth(2 * n - 1)


def smooth(n):
    """The least whole number from n on that has small prime factors alone."""
    while True:
        rest = n
        for factor in FACTORS:
            while rest % factor == 0:
                rest //= factor
        if rest == 1:
            return n
        n += 1
