"""Seeds at the anticontinuous limit: one site oscillates, all others rest."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

from ..checks import refuse
from ..flow import Flow
from ..lattice import State
from ..solvers import KahanLi8
from .problem import checked_lattice

STEPS, GROW, LARGEST = 64, 1.25, 1e4


def single_site(lattice, omega, sites, *, amplitudes=None, least=1e-3):
    r"""The breather of the anticontinuous limit: each named site oscillates at omega alone, all others held at rest.

    For weakly coupled sites with an on-site potential, and for light beads between heavy ones (mass ratio -> 0), where
    it is the orbit itself. The amplitude a > 0 at which m u'' = F(u; others at rest) has the frequency omega is found
    by its half period: u(0) = a, v(pi/omega) = 0.

    **Arguments:** `lattice`: a chain with scalar displacements. `omega`. `sites`: an index or several. `amplitudes`:
    signs +-1, one a site, for multibreathers (None: all +1, in phase). `least`: smallest amplitude tried, in the unit
    of u.

    **Returns:** a `State` at rest. **Raises** ValueError where no amplitude has that frequency (omega is on the wrong
    side of the site's linear frequency). Source: MacKay, Aubry, Nonlinearity 7, 1623 (1994).
    """
    checked_lattice(lattice)
    if isinstance(lattice.shape, dict) or len(lattice.shape) != 1:
        refuse("lattice", "a chain with scalar displacements", f"shape {lattice.shape}")
    sites = np.atleast_1d(sites)
    signs = np.ones(len(sites)) if amplitudes is None else np.sign(amplitudes)
    u = np.zeros(lattice.shape)
    for site, sign in zip(sites, signs):
        u[site] = sign * _amplitude(lattice, omega, int(site), float(sign), least)
    return State(jnp.asarray(u), jnp.zeros(lattice.shape))


class _Alone(eqx.Module):
    """The motion of one site, the others at rest."""

    site: int

    def __call__(self, t, y, lattice):
        u, v = y
        everywhere = jnp.zeros(lattice.shape, u.dtype).at[self.site].set(u)
        return v, lattice.acceleration(t, everywhere, jnp.zeros_like(everywhere))[self.site]


@eqx.filter_jit
def _velocity(lattice, site, amplitude, half):
    """v at the half period, from rest at an amplitude."""
    flow = Flow(STEPS, KahanLi8(), _Alone(site))
    return flow((amplitude, jnp.zeros_like(amplitude)), 0.0, half, lattice)[1]


def _amplitude(lattice, omega, site, sign, least):
    gap = lambda a: float(sign * _velocity(lattice, site, jnp.asarray(sign * a), jnp.asarray(np.pi / omega)))
    low, before = least, gap(least)
    while low < LARGEST:
        high = low * GROW
        now = gap(high)
        if before * now <= 0 and np.isfinite(now):
            return brentq(gap, low, high, xtol=1e-14, rtol=1e-14)
        low, before = high, now
    refuse("omega", "a frequency that the site alone can have", f"{omega:.6g}",
           "It lies on the side of the site's linear frequency away from which the amplitude shifts it.")


def at_rest(state):
    """A simulated state with its velocities dropped, as `breather` would; near a turning point it is a fair seed."""
    return State(state.u, jax.tree.map(jnp.zeros_like, state.v))
