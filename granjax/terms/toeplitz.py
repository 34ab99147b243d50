"""Sums over all neighbours of a chain by FFT: y_n = sum over m of c_m (x_{n+m} + s x_{n-m})."""

import jax.numpy as jnp
import numpy as np

FACTORS = (2, 3, 5, 7)


def neighbour_sums(c, x, parity, boundary):
    """sum over m >= 1 of c_m (x_{n+m} + parity x_{n-m}), parity 1 or -1, by FFT.

    `c` (M,), for offsets 1 to M, and `x` (N, ...): lanes last, of which those of `c` are the first. Beyond the ends of
    a chain x is zero; around a ring (`boundary` "periodic") every offset counts, as often as it goes around.
    """
    c = c.reshape(c.shape + (1,) * (x.ndim - c.ndim)).astype(x.dtype)
    # a transform along the last axis alone has a layout that XLA compiles for the CPU
    c, y = jnp.moveaxis(c, 0, -1), jnp.moveaxis(x, 0, -1)
    y = _around(c, y, parity) if boundary == "periodic" else _within(c, y, parity)
    return jnp.moveaxis(y, -1, 0)


def _around(c, x, parity):
    n = x.shape[-1]
    spectrum = jnp.fft.rfft(folded(c, n))
    spectrum = 2 * spectrum.real if parity == 1 else -2j * spectrum.imag
    return jnp.fft.irfft(spectrum * jnp.fft.rfft(x), n)


def folded(c, n):
    """The kernel of a ring of n sites: weights of the offsets 0 ... n - 1, summed over all ways around."""
    count = -(-(c.shape[-1] + 1) // n)
    c = jnp.pad(c, [(0, 0)] * (c.ndim - 1) + [(1, count * n - 1 - c.shape[-1])])
    return c.reshape(c.shape[:-1] + (count, n)).sum(-2)


def _within(c, x, parity):
    """Acyclic, by one complex transform of the chain's own length instead of a real one of twice that.

    With weights w^j, w^n = i, a cyclic convolution gives what has gone around the end times i; the kernel a + i b whose
    imaginary part holds the negative offsets, with the sign changed, brings it back as real numbers.
    """
    n = x.shape[-1]
    length = smooth(n)
    c = c[..., : n - 1]
    idle = jnp.zeros(c.shape[:-1] + (length - 1 - c.shape[-1],), c.dtype)
    zero = jnp.zeros(c.shape[:-1] + (1,), c.dtype)
    after = jnp.concatenate([zero, parity * c, idle], -1)
    before = -jnp.concatenate([zero, idle, c[..., ::-1]], -1)
    turn = np.exp(0.5j * np.pi * np.arange(length) / length).astype(jnp.result_type(x.dtype, np.complex64))
    x = jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, length - n)])
    y = jnp.fft.ifft(jnp.fft.fft(turn * x) * jnp.fft.fft(turn * (after + 1j * before)))
    return (y * turn.conj()).real[..., :n]


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
