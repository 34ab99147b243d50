"""Guesses for Newton's method: the envelope's solitons, sites that oscillate alone.

The envelope equation gives bright and dark breathers of chains of next neighbours, and of equal
sites that carry linear resonators. From the anticontinuous side, some sites oscillate while the
others stand still or follow.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.flatten_util import ravel_pytree

from ..base.checks import is_site, positive, refuse
from ..base.printing import told
from ..base.programs import compiled
from ..base.types import Scalar, Site
from ..base.units import SI
from ..continuation.newton import newton
from ..flow import Flow
from ..lattice import Lattice, State
from ..laws import taylor
from ..linear import bands
from ..linear.cell import UnitCell, unit_cell
from ..solvers import KahanLi8
from ..states.places import field_of
from ..terms.chain import next_neighbours
from ..theory import nls
from .asked import checked_lattice, force_at, known_lattice, masses, shifts, stiffness_at
from .scales import nonlinear_length

__all__ = ["bright_guess", "dark_guess", "single_site"]

NEEDS = "The envelope equation needs a periodic chain of bonds alone, or of equal beads with linear resonators."
NO_CELL = "None or a State (such as guesses.single_site gives) for this lattice"
# Relative differences that are rounding: of a frequency from an edge, of coefficients.
ROUNDING = 1e-9
# The number of steps in half a period of a single site.
HALF_STEPS = 128
# The number of parts of this half period, at whose ends the motion is checked.
PARTS = 16
# The code of sites that oscillate in phase, in opposite phase, or not at all.
SIGNS = {"+": 1, "-": -1, "0": 0}
# The number of neighbouring amplitudes at which a force must be linear.
RUN = 4
# Frames of half a period of one harmonic.
FRAMES = 24
# The relative change at which the iteration for one harmonic ends.
SETTLED = 1e-8
# The factor on an amplitude from which the degree of the forces is found.
STRETCH = 1.01


class Chain(NamedTuple):
    """A chain of next neighbours.

    It holds masses and K2, K3, K4 of the P sites and bonds of a unit cell, (P,) each.
    """

    mass: np.ndarray
    K2: np.ndarray
    K3: np.ndarray
    K4: np.ndarray
    boundary: str
    __repr__ = told

    def coefficients(
        self, branch: int, constraint: str = "force", k: float = np.pi
    ) -> nls.Coefficients:
        """Return the envelope's coefficients at the edge of a band at k."""
        return nls.coefficients(*self[:4], k, branch, constraint)

    def state(self, profile: nls.Profile, sites: int) -> State:
        """Return a breather at rest."""
        u = profile.displacement[:sites]
        return State(u, jnp.zeros_like(u))


class Dressed(NamedTuple):
    """A chain of one field with linear resonators: 4 K2 sin^2(k/2) = G(omega^2).

    G(x) is x times an effective mass. With `tie` the stiffness of everything except the chain's own
    bonds, over the fields, and b (the chain) and r (the other fields) its parts, G(x) = x m -
    tie_bb + tie_br (tie_rr - x mu)^{-1} tie_rb. `tops`: the frequencies at k = pi.
    """

    field: str
    fields: tuple[str, ...]
    bare: Chain
    mass: np.ndarray
    tie: np.ndarray
    tops: np.ndarray

    @property
    def boundary(self) -> str:
        return self.bare.boundary

    def _parts(self, x):
        # The response of the other fields to a displacement 1 of the chain's at omega^2 = x, and
        # their indices.
        b = self.fields.index(self.field)
        r = [i for i in range(len(self.fields)) if i != b]
        stiffness = self.tie[np.ix_(r, r)] - x * np.diag(self.mass[r])
        return b, r, -np.linalg.lstsq(stiffness, self.tie[r, b], rcond=None)[0]

    def excess(self, x: float) -> float:
        """Return G at omega^2 = x."""
        b, r, answer = self._parts(x)
        return x * self.mass[b] - self.tie[b, b] - self.tie[b, r] @ answer

    def coefficients(
        self, branch: int, constraint: str = "force", k: float = np.pi
    ) -> nls.Coefficients:
        """Return the envelope's coefficients at k = pi: those of the chain, over dG/d omega.

        The second harmonic strains no bond there.
        """
        c = self.bare.coefficients(0, constraint)
        omega = self.tops[branch]
        b, r, answer = self._parts(omega**2)
        slope = self.mass[b] + answer @ (self.mass[r] * answer)
        ratio = self.mass[b] * c.omega / (omega * slope)
        return dataclasses.replace(
            c,
            omega=jnp.asarray(omega),
            nu2=ratio * c.nu2,
            nu3=ratio * c.nu3,
            nu3_force=ratio * c.nu3_force,
            group_velocity=ratio * c.group_velocity,
        )

    def state(self, profile: nls.Profile, sites: int) -> State:
        """Return a breather of the chain's field with the response of the others, at rest."""
        drift = -jnp.append(0, jnp.cumsum(profile.mean_strain)[:-1])
        mean = drift - jnp.mean(drift)
        _, r, answer = self._parts(float(profile.omega) ** 2)
        swing = profile.displacement - mean
        u = {self.field: profile.displacement}
        u |= {self.fields[i]: mean + a * swing for i, a in zip(r, answer)}
        return State(u, jax.tree.map(jnp.zeros_like, u))


def chain_of(lattice: Lattice) -> Chain | Dressed | None:
    """Return the chain that the envelope equation needs, or `None` if the lattice is none."""
    if lattice.axes != 1 or lattice.dimension:
        return None
    return dressed(lattice) if lattice.fields else cell_of(lattice)


def cell_of(lattice: Lattice) -> Chain | None:
    """Return the unit cell of a chain of next neighbours, or `None`."""
    found = next_neighbours(lattice.terms[0]) if len(lattice.terms) == 1 else None
    cell = found and cell_or_none(lattice)
    if not cell:
        return None
    law, boundary = found
    (size,) = cell.cell
    (sites,) = lattice.sites
    left = 1 if boundary == "fixed" else 0
    mass = np.broadcast_to(np.asarray(lattice.mass), (sites,))[:size]
    parts = [np.asarray(x) for x in taylor(law)]
    if not np.all(parts[0] > 0):
        return None
    parts = [x[left : left + size] if x.ndim else np.full(size, x) for x in parts]
    return Chain(mass, *parts, boundary)


def dressed(lattice: Lattice) -> Dressed | None:
    """Return the uniform chain with free linear resonators of a lattice of fields, or `None`."""
    found = [
        (i, name, *bonds)
        for i, term in enumerate(lattice.terms)
        for name in lattice.fields
        if (bonds := next_neighbours(term, name)) is not None
    ]
    cell = cell_or_none(lattice)
    if len(found) != 1 or not cell or cell.cell != (1,):
        return None
    own, field, law, boundary = found[0]
    fields = tuple(sorted(lattice.fields))
    coefficients = [np.ravel(x) for x in taylor(law)]
    if not np.all(coefficients[0] > 0) or any(
        np.ptp(x) > ROUNDING * np.abs(x).max() for x in coefficients
    ):
        return None
    others = lattice.terms[:own] + lattice.terms[own + 1 :]
    if np.isfinite(nonlinear_length(eqx.tree_at(lambda x: x.terms, lattice, others))):
        return None
    mass = np.asarray(cell.mass)
    b = fields.index(field)
    bare = Chain(mass[[b]], *(x[:1] for x in coefficients), boundary)
    tie = np.asarray(cell.coupling)[cell.shells.index((0,))] * np.sqrt(mass[:, None] * mass)
    tie[b, b] -= 2 * bare.K2[0]
    squares = np.linalg.eigvalsh(np.asarray(cell.dynamical_matrix(np.array([np.pi]))))
    chain = Dressed(field, fields, bare, mass, tie, np.sqrt(np.maximum(squares, 0)))
    return chain if np.abs(chain.excess(0.0)) <= ROUNDING * bare.K2[0] else None


def cell_or_none(lattice: Lattice) -> UnitCell | None:
    """Return the unit cell, if any."""
    try:
        return unit_cell(lattice)
    except ValueError:
        return None


class Edge(NamedTuple):
    """An edge of a band, the envelope's coefficients there, and whether the gap lies above it."""

    omega: float
    above: bool
    coefficients: nls.Coefficients
    __repr__ = told

    @property
    def bright(self) -> bool:
        """Whether a bright breather leaves this edge into the gap.

        That needs focusing and a frequency shift towards the gap.
        """
        c = self.coefficients
        # As plain numbers, so that nothing is compiled.
        nu2 = float(c.nu2)
        nu3 = float(c.nu3_force)
        return nu2 * nu3 > 0 and (nu3 > 0) == self.above


def edges_beside(lattice: Lattice, omega: Scalar) -> list[Edge]:
    """Return the `Edge`s of the gap that holds omega; none inside a band or without a unit cell."""
    chain = chain_of(lattice)
    if chain is None:
        return []
    found = bands(lattice)
    lower = np.asarray(found.lower)
    upper = np.asarray(found.upper)
    if np.any((lower * (1 + ROUNDING) < omega) & (omega < upper * (1 - ROUNDING))):
        return []
    edges = [(b, upper[b], found.upper_k, True) for b in np.flatnonzero(upper <= omega)[-1:]]
    # At k = 0, the lower edges of a dressed chain, no bond is strained.
    if isinstance(chain, Chain):
        beyond = np.flatnonzero((lower >= omega) & (omega > 0))[:1]
        edges += [(b, lower[b], found.lower_k, False) for b in beyond]
    return [
        Edge(float(w), above, chain.coefficients(int(b), k=_at_symmetry(ks, b)))
        for b, w, ks, above in edges
    ]


def _at_symmetry(ks, band):
    # The wave number of an extremum, which lies at 0 or pi, as only neighbours are coupled. It is
    # known only to the square root of rounding.
    return np.pi * round(float(np.ravel(ks)[band]) / np.pi)


def _bright(lattice, omega):
    found = [edge for edge in edges_beside(lattice, omega) if edge.bright]
    return min(found, key=lambda edge: abs(edge.omega - omega), default=None)


def edge_of(lattice: Lattice, omega: Scalar, kind: str) -> Scalar:
    """Return the frequency of the edge from which the bright or dark breathers at omega come."""
    if kind == "dark":
        upper = np.asarray(bands(lattice).upper)
        return float(upper[np.argmin(np.abs(upper - omega))])
    edge = _bright(lattice, omega)
    return edge.omega if edge else omega


def bright_guess(lattice: Lattice, omega: Scalar, centre: Scalar | None = None) -> State:
    """Return the envelope's bright breather at a frequency in a gap, a `State` at rest.

    **Raises** ValueError if no edge of that gap has one.
    """
    chain = _enveloped(lattice, "'bright'")
    edge = _bright(lattice, omega)
    if not edge:
        refuse_bright(lattice, omega)
    return _state(lattice, chain, nls.bright_profile, edge.coefficients, omega, centre)


def dark_guess(lattice: Lattice, omega: Scalar, centre: Scalar | None = None) -> State:
    """Return the envelope's dark breather below the highest edge of a band, a `State` at rest.

    It is N bonds wide. Its ends are at constant force (free) or fixed length (walls, a ring), as
    the chain has them. **Raises** ValueError if the edge above omega has no dark breathers, and for
    a lattice that is not a periodic chain of next neighbours.
    """
    chain = _enveloped(lattice, "'dark'")
    found = bands(lattice)
    branch = int(np.argmin(np.abs(np.asarray(found.upper) - omega)))
    constraint = "force" if chain.boundary == "free" else "length"
    coefficients = chain.coefficients(branch, constraint, _at_symmetry(found.upper_k, branch))
    if constraint == "length":
        coefficients = _held(coefficients, omega, _size(lattice) / len(coefficients.mode))
    return _state(lattice, chain, nls.dark_profile, coefficients, omega, centre)


def _enveloped(lattice, asked):
    chain = chain_of(lattice)
    if chain is None:
        refuse("guess", NO_CELL, asked, NEEDS)
    return chain


def _held(c, omega, cells):
    # Coefficients of a background in a finite chain of fixed length. The mean of |Y|^2 over the
    # chain sets its mean strain. It lacks the dip, and a second one at the walls or where a ring
    # closes: r = 1 - 4/(inverse width * cells) of the background's.
    r = 1.0
    kappa = omega - c.omega
    effective = lambda r: c.nu3_force + r * (c.nu3 - c.nu3_force)
    for _ in range(30):
        width = np.sqrt(np.abs(c.nu3_force * kappa / (2 * c.nu2 * effective(r))))
        r = np.maximum(1 - 4 / (width * cells), 0.0)
    strain = c.mean_strain_force + r * (c.mean_strain - c.mean_strain_force)
    return dataclasses.replace(c, nu3=effective(r), mean_strain=strain)


def _state(lattice, chain, profile, coefficients, omega, centre):
    sites = _size(lattice)
    cells = -(-sites // len(coefficients.mode))
    centre = (sites - 1) / 2 if centre is None else centre
    return chain.state(profile(coefficients, omega, cells, centre), sites)


def _size(lattice):
    return next(iter(lattice.sites.values()))[0] if lattice.fields else lattice.sites[0]


def refuse_bright(lattice: Lattice, omega: Scalar) -> None:
    """Raise the error that explains why a chain has no bright breather at a frequency."""
    said = []
    for edge in edges_beside(lattice, omega):
        c = edge.coefficients
        name = "B" if len(c.mode) == 1 else "nu3"
        nu2 = float(c.nu2)
        nu3 = float(c.nu3_force)
        relation = "<" if nu3 < 0 else ">"
        why = "bright, but on the other side of the edge" if c.focusing else "only dark"
        said.append(
            f"{name} = {nu3:.6g} {relation} 0 with nu2 = {nu2:.6g} at omega = {edge.omega:.6g}: {why}"
        )
    remedy = "; ".join(said) + "." if said else "No gap holds this frequency."
    got = f"{omega:.6g}" + " rad/s" * (lattice.units == SI)
    refuse("omega", "a frequency at which the lattice has bright breathers", got, remedy)


def single_site(
    lattice: Lattice,
    omega: Scalar,
    sites: Site | Sequence[Site] | str | None = None,
    *,
    amplitudes: Sequence[Scalar] | None = None,
    field: str | None = None,
) -> State:
    r"""Return a breather about the named sites, from the anticontinuous limit if that is near.

    In the limit the named sites oscillate at omega and all others stand still: weakly coupled sites
    with an on-site potential, and light beads between heavy ones (mass ratio -> 0). With S the
    named sites,

        m u'' = F(u) in S, u = const elsewhere;  v_S(0) = v_S(pi/omega) = 0,  mean of F over a period = 0 outside S:

    an asymmetric bond of a moving site displaces its neighbours, by an amount that does not vanish
    with the mass ratio. Newton's method starts from each site alone between neighbours at rest.

    Where the others would follow by more than a quarter of the amplitude (strong coupling; Newton's
    cradle, whose beads are all in resonance), all sites take part, each in one harmonic about a
    mean, u_n = x_n + a_n cos(omega t):

        (m omega^2 - K) a = -N(a, x),  mean of F = 0,

    with K the linear stiffness and N the rest of the force's first harmonic, by Petviashvili's
    iteration.

    **Arguments:** `lattice`: of scalar displacements. `omega` [rad/s]. `sites`: an index or several
    (on a grid a pair or several pairs), `None` for the middle. `amplitudes`: signs +-1, one per
    site, for multibreathers (None: all +1, in phase). Or `sites` is a code such as "+-0+", which is
    placed in the middle of a chain. `field`: where a cell holds several.

    **Returns:** a `State` at rest. **Raises** ValueError if no amplitude has that frequency (omega
    is on the wrong side of the site's linear frequency); RuntimeError if neither method converges.
    Source: MacKay, Aubry, Nonlinearity 7, 1623 (1994); Livi, Spicci, MacKay, Nonlinearity 10, 1421
    (1997); for the cradle James, Kevrekidis, Cuevas, Physica D 251, 39 (2013); Pelinovsky,
    Stepanyants, SIAM J. Numer. Anal. 42, 1110 (2004).

    **Example:**

    >>> chain = gx.scenes.klein_gordon(5, 0.02)
    >>> state = gx.breathers.guesses.single_site(chain, 1.4, 2)
    >>> round(float(state.u[2]), 4), float(jnp.abs(state.u[3])) < 1e-12
    (1.1187, True)
    """
    positive("omega", omega)
    checked_lattice(known_lattice(lattice))
    if lattice.dimension is not None:
        refuse("lattice", "scalar displacements", f"vectors of {lattice.dimension} components")
    places, signs = named_sites(lattice, sites, amplitudes, field)
    u = np.zeros(_mass(lattice).shape)
    limit = None
    failed = None
    alone = True
    for place, sign in zip(places, signs):
        size, turns = _amplitude(lattice, omega, int(place), float(sign))
        u[place] = sign * size
        alone = alone and turns
    if alone:
        try:
            limit = _together(lattice, omega, u)
        except RuntimeError as error:
            failed = error
    if limit is None or _followed_by(lattice, omega, u != 0, limit) > 0.25:
        together = _balanced(lattice, jnp.asarray(omega, u.dtype), jnp.asarray(u))
        if _about(together, u):
            limit = sum(together[:2])
    if limit is None:
        if failed is None:
            _refuse_alone(omega)
        raise failed
    zeros = lattice.zeros()
    return State(ravel_pytree(zeros)[1](jnp.asarray(limit, lattice.dtype)), zeros)


def local_guesses(lattice: Lattice, omega: Scalar) -> Iterator[State]:
    """Yield the envelope's breather, if any, then that of `single_site` for each kind of site."""
    if _bright(lattice, omega):
        yield bright_guess(lattice, omega)
    if lattice.dimension is not None:
        return
    stiffness = _stiffness(lattice)
    mass = _mass(lattice)
    seen = []
    for name in lattice.fields or (None,):
        shape = lattice.shape[name] if name else lattice.shape
        # Next to the middle there may be sites of other kinds.
        for beside in range(3):
            site = tuple(min(n // 2 + beside, n - 1) for n in shape)
            sites = [site] if len(shape) > 1 else site[0]
            (place,) = _places(lattice, sites, name)
            kind = np.array([mass[place], stiffness[place, place]])
            if any(np.allclose(kind, other, rtol=1e-6, atol=0) for other in seen):
                continue
            seen.append(kind)
            try:
                yield single_site(lattice, omega, sites, field=name)
            except (ValueError, RuntimeError):
                continue


def named_sites(
    lattice: Lattice,
    sites: Site | Sequence[Site] | str | None,
    amplitudes: Sequence[Scalar] | None,
    field: str | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions of the oscillating sites in the raveled displacements, and their signs.

    The arguments are those of `single_site`.
    """
    name = field_of(lattice, field)
    shape = lattice.sites if name is None else lattice.sites[name]
    if sites is None:
        sites = [tuple(n // 2 for n in shape)] if len(shape) > 1 else shape[0] // 2
    elif isinstance(sites, str):
        code = np.array([SIGNS.get(sign, np.nan) for sign in sites])
        if len(shape) > 1 or len(code) > shape[0] or not np.any(code) or np.isnan(code).any():
            wanted = f'a code of "+", "-" and "0" for at most {shape[0]} sites of a chain'
            refuse("sites", wanted, repr(sites))
        if amplitudes is not None:
            refuse("amplitudes", "None beside a code, which has the signs", repr(amplitudes))
        sites = (shape[0] - len(code)) // 2 + np.flatnonzero(code)
        amplitudes = code[code != 0]
    places = _places(lattice, sites, field)
    signs = np.ones(len(places)) if amplitudes is None else np.sign(amplitudes)
    if np.shape(signs) != (len(places),) or not np.all(signs):
        refuse("amplitudes", f"{len(places)} signs, one for each of the sites", repr(amplitudes))
    return places, signs


def _places(lattice, sites, field):
    index = ravel_pytree(lattice.zeros())[1](np.arange(_mass(lattice).size))
    name = field_of(lattice, field)
    index = np.asarray(index if name is None else index[name])
    named = np.reshape(sites, (-1, index.ndim))
    if not all(is_site(tuple(site), index.shape) for site in named):
        refuse("sites", f"indices within {index.shape}", repr(sites))
    places = index[tuple(named.T)].astype(int)
    if len(set(places)) < len(places):
        refuse("sites", "different sites", repr(sites))
    return places


def _mass(lattice):
    return np.asarray(masses(lattice))


def _forces(lattice, us):
    return jax.vmap(lambda u: force_at(lattice, u))(us)


@compiled
def _stiffness(lattice):
    return stiffness_at(lattice, ravel_pytree(lattice.zeros())[0])


def _others_held(t, y, scene):
    # The motion of the sites where `moving` is 1; the others are held.
    u, v = y
    lattice, moving = scene
    return v, moving * force_at(lattice, u) / masses(lattice)


@compiled
def _path(lattice, moving, u, half):
    # (u, v) from rest at u to half a period, at equal distances, without the start.
    flow = Flow(HALF_STEPS // PARTS, KahanLi8(), _others_held)
    part = half / PARTS

    def go(y, i):
        y = flow(y, i * part, (i + 1) * part, (lattice, moving))
        return y, y

    return jax.lax.scan(go, (u, jnp.zeros_like(u)), jnp.arange(PARTS))[1]


@compiled
def _harmonics_of_forces(lattice, u, us):
    # By the trapezoidal rule over half a period.
    forces = _forces(lattice, jnp.concatenate([u[None], us]))
    weights = jnp.ones(PARTS + 1).at[jnp.array([0, PARTS])].set(0.5) / PARTS
    cosines = jnp.cos(jnp.pi * jnp.arange(PARTS + 1) / PARTS)
    return weights @ forces, 2 * (weights * cosines) @ forces


class _Limit(eqx.Module):
    # The equations for the displacements at rest over `scale`: velocities half a period later and
    # mean forces vanish.

    moving: jax.Array
    scale: jax.Array
    omega: jax.Array
    free: jax.Array

    def __call__(self, x, scene):
        us, vs = _path(scene, self.moving, self.scale * x, jnp.pi / self.omega)
        stiff = jnp.max(masses(scene) * self.moving) * self.omega**2
        means = _harmonics_of_forces(scene, self.scale * x, us)[0]
        rest = jnp.where(self.moving, vs[-1] / self.omega, means / stiff) / self.scale
        # Forces do not determine a uniform displacement, which stays zero.
        return rest + self.free @ (self.free.T @ jnp.where(self.moving, 0, x))


def _together(lattice, omega, u):
    moving, scale, omega = (jnp.asarray(x, u.dtype) for x in (u != 0, np.abs(u).max(), omega))
    problem = _Limit(moving, scale, omega, shifts(lattice))
    return scale * newton(problem, u / scale, lattice, tolerance=1e-11).x


def _followed_by(lattice, omega, moving, u):
    # The largest amplitude with which the resting sites would respond, over that of the others.
    us, _ = _path(lattice, jnp.asarray(moving, u.dtype), u, jnp.asarray(np.pi / omega))
    first = np.asarray(_harmonics_of_forces(lattice, u, us)[1])[~moving]
    if not len(first):
        return 0.0
    stiffness = np.asarray(_stiffness(lattice)) - np.diag(_mass(lattice) * omega**2)
    try:
        answer = np.abs(np.linalg.solve(stiffness[~moving][:, ~moving], first)).max()
    except np.linalg.LinAlgError:
        return np.inf
    return answer / np.abs(np.asarray(u)[moving]).max()


@compiled
def _balanced(lattice, omega, start):
    # Returns (mean, amplitude, last relative change) of one harmonic in which every site takes
    # part.
    mass = masses(lattice)
    stiffness = _stiffness(lattice)
    linear = jax.scipy.linalg.lu_factor(jnp.diag(mass * omega**2) - stiffness)
    free = shifts(lattice)
    cosines = jnp.cos((jnp.arange(FRAMES) + 0.5) * jnp.pi / FRAMES)
    stiff = jnp.max(mass) * omega**2

    def motion(a, x):
        return x + cosines[:, None] * a

    def rest(a, x):
        # The nonlinear part of the first harmonic.
        return 2 / FRAMES * cosines @ _forces(lattice, motion(a, x)) + stiffness @ a

    def centred(a, x):
        # One step of Newton's method to where the mean forces vanish.
        us = motion(a, x)
        mean = _forces(lattice, us).mean(0)
        slope = -jax.vmap(lambda u: stiffness_at(lattice, u))(us).mean(0)
        slope = slope - stiff * (1e-6 * jnp.eye(len(x)) + free @ free.T)
        return x - jnp.linalg.solve(slope, mean)

    def round(carry):
        i, a, x, _ = carry
        x = centred(a, x)
        pull = rest(a, x)
        # N(s a) = s^p N(a), where the mean is of second order.
        degree = 1 + jnp.log(
            (a @ rest(STRETCH * a, STRETCH**2 * x)) / (STRETCH * (a @ pull))
        ) / jnp.log(STRETCH)
        degree = jnp.clip(degree, 1.2, 5.0)
        after = jax.scipy.linalg.lu_solve(linear, -pull)
        size = (a @ (mass * omega**2 * a - stiffness @ a)) / (a @ -pull)
        after = size ** (degree / (degree - 1)) * after
        return i + 1, after, x, jnp.max(jnp.abs(after - a)) / jnp.max(jnp.abs(after))

    begin = 0, start, jnp.zeros_like(start), jnp.ones((), start.dtype)
    goes_on = lambda carry: (carry[0] < 400) & (carry[3] > SETTLED)
    _, a, x, change = jax.lax.while_loop(goes_on, round, begin)
    return x, a, change


def _about(found, u):
    # Whether the iteration has settled about the sites that oscillate in `u`, with their signs.
    x, a, change = (np.asarray(part) for part in found)
    if not (np.isfinite(x).all() and np.isfinite(a).all() and change <= SETTLED):
        return False
    return bool(np.all((a * np.sign(u))[u != 0] > 0.5 * np.abs(a).max()))


@compiled
def _secants(lattice, one, amplitudes):
    # The first harmonic of a site's own force about the place where its mean vanishes, over its
    # amplitude: a stiffness.
    cosines = jnp.cos((jnp.arange(FRAMES) + 0.5) * jnp.pi / FRAMES)

    def forces(x, a):
        return _forces(lattice, (x + a * cosines)[:, None] * one) @ one

    def secant(a):
        def centred(_, x):
            mean, slope = jax.jvp(lambda x: forces(x, a).mean(), (x,), (jnp.ones_like(x),))
            return x - jnp.where(slope < 0, mean / slope, 0)

        x = jax.lax.fori_loop(0, 12, centred, jnp.zeros_like(a))
        return -2 / FRAMES * (cosines @ forces(x, a)) / a

    return jax.lax.map(secant, amplitudes)


def _amplitude(lattice, omega, place, sign):
    # Returns (amplitude of a single site by shooting, True), or (that of one harmonic, False).
    half = jnp.asarray(np.pi / omega)
    mass = _mass(lattice)
    one = jnp.asarray(sign * np.eye(len(mass))[place])

    def velocities(a):
        # Times sign: negative until the first return to rest.
        return sign * np.asarray(_path(lattice, jnp.abs(one), a * one, half)[1])[:, place]

    def highest(low, top):
        # The largest amplitude below a barrier, from beyond which the site does not return.
        while low < (low + top) / 2 < top:
            middle = (low + top) / 2
            low, top = (middle, top) if velocities(middle)[0] < 0 else (low, middle)
        return low

    def between(low, high):
        before = velocities(low)
        while low < high:
            top = 1.25 * low
            now = velocities(top)
            if before[0] < 0 and not now[0] < 0:
                top = high = highest(low, top)
                now = velocities(top)
            if not np.isfinite(now[-1]):
                return None
            if before[-1] * now[-1] <= 0:
                last = lambda a: velocities(a)[-1]
                try:
                    found = scipy.optimize.brentq(last, low, top, xtol=1e-14 * low, rtol=1e-14)
                except ValueError:  # The motion is not finite on the way.
                    return None
                # A later return belongs to a faster motion.
                if np.all(velocities(found)[:-1] < 0):
                    return found
            low = top
            before = now
        return None

    grid = 2.0 ** np.arange(-160, 161)
    above = np.asarray(_secants(lattice, one, jnp.asarray(grid))) / (mass[place] * omega**2) - 1
    # Below the linear range a force may be only rounding.
    small = float(_stiffness(lattice)[place, place]) / (mass[place] * omega**2) - 1
    linear = np.abs(above - small) <= 1e-5 * (1 + abs(small))
    begin = int(np.argmax(np.convolve(linear, np.ones(RUN), "valid") == RUN))
    grid = grid[begin:]
    above = above[begin:]
    now = np.isfinite(above[:-1])
    after = np.isfinite(above[1:])
    # Products of large secants overflow; the signs are enough.
    sides = np.sign(above)
    crosses = sides[:-1] * np.where(after, sides[1:], 1) <= 0
    crosses = np.flatnonzero(now & (~after | crosses))
    for i in crosses:
        found = between(grid[i] / 4, grid[i + 1] * 4)
        if found is not None:
            return found, True
    if not len(crosses):
        _refuse_alone(omega)
    return grid[crosses[0]], False


def _refuse_alone(omega):
    refuse(
        "omega",
        "a frequency that a single uncoupled site can have",
        f"{omega:.6g}",
        "It lies on the wrong side of the site's linear frequency: amplitude shifts it the other way.",
    )
