"""Equations of motion of the canonical scenes, written out once more in NumPy for extended precision.

An equation is called as `f(t, u, v)` and returns the acceleration; `u`, `v` have the shape (..., sites, lanes).
"""

import numpy as np


def hertz(e):
    """[e]_+^{3/2}: no precompression."""
    s = np.maximum(e, 0)
    return s * np.sqrt(s)


def loaded_hertz(e):
    """[1 + e]_+^{3/2} - 1."""
    return hertz(1 + e) - 1


def softening(e):
    """[1 + e]_+^{1/2} - 1."""
    return np.sqrt(np.maximum(1 + e, 0)) - 1


def magnets(e):
    """(1 - e)^{-3} - 1."""
    s = 1 - e
    return 1 / (s * s * s) - 1


def toda(e):
    """exp(e) - 1."""
    return np.expm1(e)


def fput(e):
    """e + e^2/4."""
    return e + e * e / 4


class Chain:
    """m a_n = F(u_{n-1} - u_n) - F(u_n - u_{n+1}), between free ends or given neighbours.

    `law(e)`; `mass` (sites, lanes or 1); `ends(t, u)`: the displacements (left, right) of the neighbours of the two
    end sites, `None` for free ends.
    """

    def __init__(self, law, mass, ends=None):
        self.law = law
        self.ends = ends
        mass = np.asarray(mass, np.longdouble)
        self.inverse = 1 / (mass if mass.ndim == 2 else mass[:, None])

    def of_lanes(self, lanes):
        """The same for some of the lanes."""
        if self.inverse.shape[1] == 1:
            return self
        return Chain(self.law, 1 / self.inverse[:, lanes], self.ends)

    def force(self, t, u, v):
        """Force on every site."""
        if self.ends is None:
            F = self.law(u[..., :-1, :] - u[..., 1:, :])
            out = np.zeros_like(u)
            out[..., 1:, :] += F
            out[..., :-1, :] -= F
            return out
        e = np.empty(u.shape[:-2] + (u.shape[-2] + 1, u.shape[-1]), u.dtype)
        np.subtract(u[..., :-1, :], u[..., 1:, :], out=e[..., 1:-1, :])
        left, right = self.ends(t, u)
        e[..., 0, :], e[..., -1, :] = left - u[..., 0, :], u[..., -1, :] - right
        F = self.law(e)
        return F[..., :-1, :] - F[..., 1:, :]

    def __call__(self, t, u, v):
        return self.force(t, u, v) * self.inverse


class Tangents:
    """A precompressed Hertz chain with free ends in lane 0, and its tangents in all others."""

    def __init__(self, mass):
        self.chain = Chain(None, mass)
        self.chain.law = self._law

    def _law(self, e):
        root = np.sqrt(np.maximum(1 + e[..., :1], 0))
        return np.concatenate([root**3 - 1, 1.5 * root * e[..., 1:]], -1)

    def __call__(self, t, u, v):
        return self.chain(t, u, v)


class Modulated(Chain):
    """A chain whose forces all have the factor 1 + a cos(omega t)."""

    def __init__(self, law, mass, ends, a, omega):
        super().__init__(law, mass, ends)
        self.a = np.longdouble(a)
        self.omega = np.longdouble(omega)

    def force(self, t, u, v):
        return (1 + self.a * np.cos(self.omega * t)) * super().force(t, u, v)


class Damped(Chain):
    """A chain with damping -gamma m v of each site and dashpots c between neighbours, none at the walls."""

    def __init__(self, law, mass, ends, gamma, c):
        super().__init__(law, mass, ends)
        self.gamma = np.longdouble(gamma)
        self.c = np.longdouble(c)

    def force(self, t, u, v):
        flow = self.c * (v[..., :-1, :] - v[..., 1:, :])
        out = super().force(t, u, v) - self.gamma * v / self.inverse
        out[..., 1:, :] += flow
        out[..., :-1, :] -= flow
        return out


def walls(t, u):
    """Rigid walls at rest."""
    return 0, 0


def driven_wall(a, omega, phase):
    """A left wall at a cos(omega t + phase), a right one at rest."""
    a, omega, phase = (np.longdouble(x) for x in (a, omega, phase))
    return lambda t, u: (
        np.reshape(a * np.cos(omega * t + phase), np.shape(t)[:-2] + np.shape(t)[-1:]),
        0,
    )


def mirror(speed):
    """Right half of an odd motion, with its own rest frame, which moves with -speed: u_{-1} = -u_0 in the chain's.

    In the moving frame w = u + speed t that is w_{-1} = 2 speed t - w_0; ahead all is at rest.
    """
    return lambda t, u: (
        2 * speed * np.reshape(t, np.shape(t)[:-2] + np.shape(t)[-1:]) - u[..., 0, :],
        0,
    )
