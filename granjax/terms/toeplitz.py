"""Sums over all neighbours of a chain by FFT: y_n = sum over m of c_m (x_{n+m} + s x_{n-m})."""

import jax
import jax.numpy as jnp
import numpy as np

from ..programs import by_rows

FACTORS = (2, 3, 5, 7)


def neighbour_sums(c, x, parity, around):
    """sum over m >= 1 of c_m (x_{n+m} + parity x_{n-m}), parity 1 or -1, by FFT.

    `c` (M,), for offsets 1 to M, and `x` (N, ...): lanes last, of which those of `c` are the first. Beyond the ends of
    a chain x is zero; `around` a ring every offset counts, as often as it goes around.
    """
    return back(
        behind(spectrum(c, x.shape[0], parity, around, x.dtype), x.ndim) * forth(x, around),
        x.shape[0],
        around,
    )


def spectrum(c, n, parity, around, dtype):
    """The transform of the weights `c` (M, lanes...) on n sites: its real and its imaginary part, lanes last."""
    c = jnp.moveaxis(c.astype(dtype), 0, -1)
    if around:
        found = by_rows(jnp.fft.rfft, folded(c, n))
        real, imag = (2 * found.real, None) if parity == 1 else (None, -2 * found.imag)
    else:
        found = by_rows(jnp.fft.fft, _turn(n, dtype) * _laid_out(c, n, parity))
        real, imag = found.real, found.imag
    return tuple(None if x is None else jnp.moveaxis(x, -1, 0) for x in (real, imag))


def behind(spectrum, ndim):
    """A spectrum as complex numbers for arrays of so many axes, frequencies last as `forth` has them."""
    real, imag = (
        None if x is None else jnp.moveaxis(x.reshape(x.shape + (1,) * (ndim - x.ndim)), 0, -1)
        for x in spectrum
    )
    return real if imag is None else 1j * imag if real is None else jax.lax.complex(real, imag)


def forth(x, around):
    """The transform of `x` (N, lanes...), its frequencies last."""
    x, n = jnp.moveaxis(x, 0, -1), x.shape[0]
    if around:
        return by_rows(jnp.fft.rfft, x)
    turn = _turn(n, x.dtype)
    return by_rows(jnp.fft.fft, turn * jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, len(turn) - n)]))


def back(y, n, around):
    """Inverse of `forth`, n sites first."""
    if around:
        return jnp.moveaxis(by_rows(jnp.fft.irfft, y, n), -1, 0)
    y = by_rows(jnp.fft.ifft, y)
    return jnp.moveaxis((y * _turn(n, y.real.dtype).conj()).real[..., :n], -1, 0)


def folded(c, n):
    """The kernel of a ring of n sites: weights of the offsets 0 ... n - 1, summed over all ways around."""
    count = -(-(c.shape[-1] + 1) // n)
    c = jnp.pad(c, [(0, 0)] * (c.ndim - 1) + [(1, count * n - 1 - c.shape[-1])])
    return c.reshape(c.shape[:-1] + (count, n)).sum(-2)


def _laid_out(c, n, parity):
    """The kernel of an acyclic convolution by one complex transform of the chain's own length, not a real one of twice.

    With weights w^j, w^n = i, a cyclic convolution gives what has gone around the end times i; the kernel a + i b whose
    imaginary part holds the negative offsets, with the sign changed, brings it back as real numbers.
    """
    c = c[..., : n - 1]
    idle = jnp.zeros(c.shape[:-1] + (smooth(n) - 1 - c.shape[-1],), c.dtype)
    zero = jnp.zeros(c.shape[:-1] + (1,), c.dtype)
    after = jnp.concatenate([zero, parity * c, idle], -1)
    before = -jnp.concatenate([zero, idle, c[..., ::-1]], -1)
    return jax.lax.complex(after, before)


def _turn(n, dtype):
    """The weights w^j."""
    length = smooth(n)
    return np.exp(0.5j * np.pi * np.arange(length) / length).astype(
        jnp.result_type(dtype, np.complex64)
    )


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
