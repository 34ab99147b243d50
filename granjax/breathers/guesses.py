"""Guesses at the anticontinuous limit: named sites oscillate, all others stand still."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

from ..checks import refuse
from ..flow import Flow
from ..lattice import State
from ..newton import newton
from ..orbits import shifts
from ..solvers import KahanLi8
from .problem import checked_lattice

HALF_STEPS, PARTS, GROW, LARGEST = 128, 16, 1.25, 1e4


def single_site(lattice, omega, sites, *, amplitudes=None, least=1e-3):
    r"""The breather of the anticontinuous limit: the named sites oscillate at omega, all others stand still.

    For weakly coupled sites with an on-site potential, and for light beads between heavy ones (mass ratio -> 0), where
    it is the orbit itself. With S the named sites,

        m u'' = F(u) in S, u = const elsewhere;  v_S(0) = v_S(pi/omega) = 0,  mean of F over a period = 0 outside S:

    an asymmetric bond of a moving site pushes its neighbours to another place, by an amount that does not vanish with
    the mass ratio. Each site alone between neighbours at rest is the first guess; Newton's method does the rest.

    **Arguments:** `lattice`: a chain with scalar displacements. `omega`. `sites`: an index or several. `amplitudes`:
    signs +-1, one a site, for multibreathers (None: all +1, in phase). `least`: smallest amplitude tried, in the unit
    of u.

    **Returns:** a `State` at rest. **Raises** ValueError where no amplitude has that frequency (omega is on the wrong
    side of the site's linear frequency); RuntimeError where Newton's method does not converge.
    Source: MacKay, Aubry, Nonlinearity 7, 1623 (1994); Livi, Spicci, MacKay, Nonlinearity 10, 1421 (1997).
    """
    checked_lattice(lattice)
    if isinstance(lattice.shape, dict) or len(lattice.shape) != 1:
        refuse("lattice", "a chain with scalar displacements", f"shape {lattice.shape}")
    sites = np.atleast_1d(sites)
    signs = np.ones(len(sites)) if amplitudes is None else np.sign(amplitudes)
    u, moving = np.zeros(lattice.shape), np.zeros(lattice.shape)
    for site, sign in zip(sites, signs):
        u[site], moving[site] = sign * _amplitude(lattice, omega, int(site), float(sign), least), 1
    return State(_together(lattice, omega, u, moving), jnp.zeros(lattice.shape))


def _held(t, y, scene):
    """The motion of the sites where `moving` is 1, the others held."""
    (u, v), (lattice, moving) = y, scene
    return v, moving * lattice.acceleration(t, u, jnp.zeros_like(u))


@eqx.filter_jit
def _path(lattice, moving, u, half):
    """(u, v) from rest at u to the half period, at equal distances, the beginning left out."""
    flow, part = Flow(HALF_STEPS // PARTS, KahanLi8(), _held), half / PARTS

    def go(y, i):
        y = flow(y, i * part, (i + 1) * part, (lattice, moving))
        return y, y

    return jax.lax.scan(go, (u, jnp.zeros_like(u)), jnp.arange(PARTS))[1]


def _mean_forces(us, u, scene):
    """Of every site over a period, by the trapezoidal rule over half of it: exact but for high harmonics."""
    still = jnp.zeros_like(u)
    forces = jax.vmap(lambda u: scene.mass * scene.acceleration(0.0, u, still))(jnp.concatenate([u[None], us]))
    return (forces[0] / 2 + forces[1:-1].sum(0) + forces[-1] / 2) / PARTS


def _together(lattice, omega, u, moving):
    """Displacements at rest of the whole limit, from each site alone."""
    free, half = np.asarray(shifts(lattice)), np.pi / omega
    stiff = float(np.max(np.asarray(lattice.mass) * moving)) * omega**2

    def residual(x, scene):
        us, vs = _path(scene, jnp.asarray(moving), x, half)
        rest = jnp.where(moving, vs[-1] / omega, _mean_forces(us, x, scene) / stiff)
        # forces say nothing of a uniform displacement: it stays zero
        return rest + free @ (free.T @ jnp.where(moving, 0, x))

    scale = np.abs(u).max()
    return newton(residual, jnp.asarray(u), lattice, tolerance=1e-11 * scale).x


def _amplitude(lattice, omega, site, sign, least):
    half, one = np.pi / omega, np.eye(lattice.shape[0])[site]

    def velocities(a):
        """On the way, negative until the first return to rest."""
        return sign * np.asarray(_path(lattice, jnp.asarray(one), jnp.asarray(sign * a * one), half)[1])[:, site]

    gap = lambda a: velocities(a)[-1]
    low, before = least, gap(least)
    while low < LARGEST:
        high = low * GROW
        now = gap(high)
        if not np.isfinite(now):
            break
        if before * now <= 0:
            try:
                found = brentq(gap, low, high, xtol=1e-14, rtol=1e-14)
            except ValueError:  # not finite on the way
                break
            # a later return belongs to a faster motion
            if np.all(velocities(found)[:-1] < 0):
                return found
        low, before = high, now
    refuse("omega", "a frequency that the site alone can have", f"{omega:.6g}",
           "It lies on the wrong side of the site's linear frequency: amplitude shifts it the other way.")


def at_rest(state):
    """A simulated state with its velocities dropped, as `breather` would; near a turning point it is a fair guess."""
    return State(state.u, jax.tree.map(jnp.zeros_like, state.v))
