"""Linear coupling that depends on the distance of two sites alone, over any distance, by FFT."""

import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.arrays import padded, trailing
from ..base.checks import refuse
from ..base.programs import by_rows
from ..base.types import Amplitudes, Numbers
from ..terms.fractional import kernel, symbol, total, wave_numbers

# the most sites of a finite chain for which the modes of its coupling are kept
MOST_MODES = 512


class Coupling(eqx.Module):
    r"""(L psi)_n = sum_{m != 0} c_|m| (psi_n - psi_{n+m}), by FFT.

    The FFT is on the ring of the sites, or for a finite chain on one of twice the length.

    - `values` (P, *lanes): the symbol on P >= N wave numbers.
    - `diagonal` (N, *lanes): added at each site of a finite chain; `None` on a ring.
    - `modes` (N, N, *lanes), `rates` (N, *lanes): modes and eigenvalues of a short finite chain,
      else `None`.
    """

    sites: int = eqx.field(static=True)
    values: jax.Array
    diagonal: jax.Array | None = None
    modes: jax.Array | None = None
    rates: jax.Array | None = None

    def __call__(self, psi: Amplitudes) -> Amplitudes:
        """Return L psi for psi (N, *lanes)."""
        moved = self._filtered(psi, trailing(self.values, psi.ndim))
        return moved if self.diagonal is None else moved + trailing(self.diagonal, psi.ndim) * psi

    def flow(self, psi: Amplitudes, time: Numbers) -> Amplitudes:
        """Return exp(-i L time) psi, as psi plus a change, whose rounding falls with the time."""
        if self.diagonal is not None and self.rates is None:
            wanted = f"a ring, or at most {MOST_MODES} sites"
            refuse("sites", wanted, f"a chain of {self.sites}", "Take diffrax.Dopri8().")
        angle = time * trailing(self.values if self.diagonal is None else self.rates, psi.ndim)
        turn = -2 * jnp.sin(angle / 2) ** 2 - 1j * jnp.sin(angle)
        if self.diagonal is None:
            return psi + self._filtered(psi, turn)
        along = jnp.einsum("nk...,n...->k...", self.modes, psi)
        return psi + jnp.einsum("nk...,k...->n...", self.modes, turn * along)

    def _filtered(self, psi, values):
        moved = values * by_rows(jnp.fft.fft, psi, len(values), axis=0)
        return by_rows(jnp.fft.ifft, moved, axis=0)[: self.sites]


def of_order(sites: int, order: jax.Array, boundary: str) -> Coupling:
    """Return the fractional Laplacian of order s, on a ring or a finite chain."""
    if boundary == "periodic":
        return Coupling(sites, symbol(order, wave_numbers(sites)))
    return _finite(sites, kernel(order, sites - 1), total(order), boundary)


def of_weights(sites: int, weights: jax.Array, boundary: str) -> Coupling:
    """Return the coupling with weights (M, *lanes) of the offsets 1, ..., M."""
    if boundary == "periodic":
        k = trailing(wave_numbers(sites), 1 + weights.ndim)
        m = trailing(jnp.arange(1, len(weights) + 1), weights.ndim)
        return Coupling(sites, jnp.sum(4 * weights * jnp.sin(k * m / 2) ** 2, axis=1))
    own = weights[: sites - 1]
    own = padded(own, 0, sites - 1 - len(own))
    return _finite(sites, own, 2 * jnp.sum(weights, axis=0), boundary)


def _finite(sites, weights, whole, boundary):
    zero = jnp.zeros_like(weights[:1])
    if boundary == "fixed":
        diagonal = jnp.broadcast_to(whole, (sites, *weights.shape[1:]))
    else:
        reach = jnp.concatenate([zero, jnp.cumsum(weights, axis=0)])
        diagonal = reach + reach[::-1]
    row = jnp.concatenate([zero, weights, zero, weights[::-1]])
    values = -by_rows(jnp.fft.fft, row, axis=0).real
    modes = rates = None
    if sites <= MOST_MODES:
        n = jnp.arange(sites)
        matrix = -jnp.concatenate([zero, weights])[abs(n[:, None] - n)]
        matrix = matrix.at[n, n].add(diagonal)
        rates, modes = jnp.linalg.eigh(jnp.moveaxis(matrix, (0, 1), (-2, -1)))
        rates = jnp.moveaxis(rates, -1, 0)
        modes = jnp.moveaxis(modes, (-2, -1), (0, 1))
    return Coupling(sites, values, diagonal, modes, rates)
