"""Normal modes of a finite lattice."""

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from ..base.checks import known_value, refuse, whole
from ..base.derivatives import eigh, once
from ..base.programs import compiled
from ..base.types import AnyArray, Count, Displacements, Number, Numbers
from ..lattice import Lattice, spread_mass
from ..results import Result, array
from ..terms.reach import reads
from . import turning
from .cell import TIGHT, blocks_of, by_lanes, in_lanes
from .stiffness import (
    at_rest,
    each,
    linear_map,
    offsets,
    or_one,
    refuse_one_way,
    turning_at_rest,
    unpack_waves,
)

# omega^2 below this is rounding, in units of eps times the number of modes times the largest |D|
ROUNDING = 8
# the columns of K that are computed at a time, to save memory
AT_ONCE = 512
# the matrix is inverted at minus this part of the largest |D|, so that rigid motions do not make it
# singular
SHIFT = 1e-9
UNSTABLE = (
    "are given: the lattice is not stable at rest (its potential energy has no minimum), and gyroscopic "
    "forces act."
)


def signed_root(squared: Numbers, scale: Number, size: int) -> Numbers:
    """Return sign(omega^2) |omega^2|^{1/2}, zero where omega^2 is rounding on that scale."""
    floor = ROUNDING * size * jnp.finfo(squared.dtype).eps * jax.lax.stop_gradient(scale)
    still = jnp.abs(squared) <= floor
    root = jnp.sqrt(jnp.abs(jnp.where(still, 1, squared)))
    return jnp.where(still, 0, jnp.sign(squared) * root)


class NormalModes(Result):
    """Normal modes of a finite lattice, sorted by omega^2.

    They are normalised with the mass: sum m phi_a phi_b = 1 for a = b, else 0. `omega` is exactly 0
    where omega^2 is rounding.
    """

    omega: Float[AnyArray, " mode"] = array(
        "sign(omega^2) |omega^2|^{1/2}; for an unstable mode minus its growth rate.", "rad/s"
    )
    omega_squared: Float[AnyArray, " mode"] = array(
        "omega^2, negative where the lattice is unstable at u = 0.", "rad^2/s^2"
    )
    modes: Displacements = array("The displacements of the modes.", axes="site ... mode")

    @property
    def outcome(self) -> str:
        """The number of modes, the highest frequency, and the unstable modes."""
        omega = by_lanes(self, self.omega)
        each = in_lanes(self)
        lost = np.isnan(omega).any(1)
        if lost.any():
            lanes = f"in {lost.sum()} of {lost.size} lanes " if lost.size > 1 else ""
            return f"No modes {lanes}{UNSTABLE}"
        return (
            f"{omega.shape[1]} modes{each and each + ','} up to {self._told('omega', omega.max())}, "
            f"{np.count_nonzero(omega < 0) or 'none'} of them unstable."
        )


def normal_modes(lattice: Lattice, count: Count | None = None) -> NormalModes:
    r"""Compute the normal modes of a finite lattice about u = 0: K phi = omega^2 M phi.

    The symmetric problem M^{-1/2} K M^{-1/2} q = omega^2 q, phi = M^{-1/2} q, is solved for any
    boundary, masses and terms. Damping and drives are left out; moving walls stand still. In a
    sonic vacuum K = 0, and so is every frequency. Gyroscopic forces -G v, with an antisymmetric G,
    are included: (K - i omega G) phi = omega^2 M phi, with omega > 0 and complex modes u = Re phi
    exp(-i omega t); omega is NaN where K is not positive.

    **Arguments:** `count`: how many lowest modes to find, `None` for all.
    **Returns:** `NormalModes`. Simple frequencies and their modes are differentiable; of
    equal frequencies that a parameter splits, only the sum, and once.

    Cost: n^2 numbers and n^3 operations for n degrees of freedom; n up to a few thousand. With
    `count` SciPy inverts the sparse matrix (Lanczos' method): six modes of 50 000 sites of the
    plane take about twenty seconds. They are those nearest to omega = 0, which are the lowest where
    the lattice is stable at rest. Frequencies are differentiable once.
    **Raises** ValueError for a batch of lattices (use `jax.vmap(normal_modes, in_axes=-1)`),
    stiffness modulated in time, and forces without an energy (K not symmetric); with `count` also
    for gyroscopic forces, bonds across the whole lattice, and within `jit` and `vmap`.

    **Example:**

    >>> found = gx.linear.normal_modes(gx.scenes.monomer(20, precompression=1.0))
    >>> print(found.omega[:3].round(4))  # 6^{1/2} sin(pi n/42)
    [0.1831 0.3651 0.5451]
    """
    if count is not None:
        return _lowest(at_rest(lattice), whole("count", count, 1))
    lattice, turns = turning_at_rest(lattice)
    result, uneven = _solve(lattice, turns)
    uneven = known_value(uneven)
    if uneven is not None and uneven > TIGHT * np.finfo(lattice.dtype).eps:
        refuse_one_way()
    return result


@compiled
def _solve(lattice, turns):
    # the modes, and the largest asymmetry of K, relative to K
    flat, unravel = ravel_pytree(lattice.zeros())
    unit = jnp.eye(flat.size, dtype=flat.dtype)
    transforms = any(reads(term, lattice).transforms for term in lattice.terms)

    def matrix(product_with):
        column = lambda w: ravel_pytree(product_with(unravel(w)))[0]
        return jax.lax.map(column, unit) if transforms else each(column, unit, AT_ONCE)

    K = matrix(linear_map(lattice))
    scale = jnp.abs(K).max()
    uneven = jnp.abs(K - K.T).max() / or_one(scale)
    mass, _ = ravel_pytree(spread_mass(lattice))
    over = jnp.sqrt(mass[:, None] * mass)
    D = K / over
    if turns:
        # this is the transpose of C; the symmetric part of C damps and is left out
        C = matrix(linear_map(lattice, velocity=True))
        squared, q = turning.waves(D, (C.T - C) / (2 * over), jnp.abs(D).max())
    else:
        squared, q = eigh(D)
    phi = q / jnp.sqrt(mass)[:, None]
    apart = jax.vmap(unravel, -1, -1)
    modes = apart(phi.real)
    if turns:
        modes = jax.tree.map(lambda x, y: x + 1j * y, modes, apart(phi.imag))
    return NormalModes(
        signed_root(squared, jnp.abs(D).max(), flat.size), squared, modes, **lattice.origin
    ), uneven


def _lowest(lattice, count):
    # the modes nearest to omega = 0, from the blocks of K between nearby sites
    try:
        found = blocks_of(lattice)
    except ValueError:
        wanted = "None where bonds reach half of the lattice or more"
        refuse("count", wanted, f"{count}", "Leave it out, and take the modes of lowest frequency.")
    if not found.known:
        refuse("count", "None where masses or laws are traced by jit or vmap", f"{count}")
    sites = found.mass.shape[:-1]
    size = found.mass.size
    if count >= size:
        refuse("count", f"less than {size}, all modes", f"{count}", "Leave it out.")
    number = np.arange(size).reshape(found.mass.shape)
    root = np.sqrt(found.mass.ravel(), dtype=float)
    near = [np.roll(number, [-x for x in way], range(len(sites))) for way in offsets(found.reach)]
    pair = number[..., None, :, None], np.stack(near, -2)[..., None, :]
    at, there = (x.ravel() for x in np.broadcast_arrays(*pair))
    D = scipy.sparse.csc_array(
        (found.found.ravel() / (root[at] * root[there]), (at, there)), (size, size)
    )
    D.eliminate_zeros()
    scale = abs(D).max()
    if abs(D - D.T).max() > TIGHT * np.finfo(lattice.dtype).eps * scale:
        refuse_one_way()
    q = _nearest(D, count, scale)
    phi = jnp.asarray(q / root[:, None], lattice.dtype)
    modes = unpack_waves(phi, sites, lattice.fields, lattice.dimension)
    second = lambda: refuse("count", "None for second derivatives", f"{count}", "Leave it out.")
    squared = _quotients(once(lattice, second), modes)
    rising = jnp.argsort(squared)
    squared = squared[rising]
    modes = jax.tree.map(lambda x: x[..., rising], modes)
    omega = signed_root(squared, scale, count)
    return NormalModes(omega, squared, modes, **lattice.origin)


def _nearest(D, count, scale):
    # the eigenvectors of D nearest to zero
    size = len(D.indptr) - 1
    shift = SHIFT * scale or 1.0
    # Lanczos' basis has twice as many vectors as are wanted
    if 2 * count >= size:
        squared, q = np.linalg.eigh(D.toarray())
        return q[:, np.argsort(np.abs(squared + shift))[:count]]
    order = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
    solve = scipy.sparse.linalg.splu(
        scipy.sparse.csc_array(D + shift * scipy.sparse.eye_array(size)),
        diag_pivot_thresh=0.0,
        **order,
    ).solve
    random = np.random.default_rng(0)
    rounding = ROUNDING * count * np.finfo(float).eps * scale
    distance = lambda q: np.abs(np.sum(q * (D @ q), 0) + shift)
    q = np.zeros((size, 0))
    farthest = np.inf
    wanted = count
    # From one start Lanczos' method may find one alone of the modes of equal frequency: it is
    # repeated on what is orthogonal to those found, from another start, until none is nearer. To
    # look for one mode takes less time than for all.
    while True:
        rest = lambda x: x - q @ (q.T @ x)
        inverse = scipy.sparse.linalg.LinearOperator(
            D.shape, lambda x: rest(solve(rest(x))), dtype=float
        )
        _, new = scipy.sparse.linalg.eigsh(inverse, wanted, v0=rest(random.normal(size=size)))
        if distance(new).min() >= farthest - rounding:
            return q
        wanted = 1 if farthest == np.inf else min(2 * wanted, count)
        q = np.concatenate([q, new], 1)
        q = q[:, np.argsort(distance(q))[:count]]
        farthest = distance(q[:, -1:])[0]


@compiled
def _quotients(lattice, modes):
    # phi K phi/(phi M phi) of constant modes: its error is of second order in that of phi, and it
    # has the first derivatives of omega^2
    product_with = linear_map(lattice)
    mass = spread_mass(lattice)

    def quotient(phi):
        over, under = (
            ravel_pytree(jax.tree.map(jnp.multiply, phi, x))[0].sum()
            for x in (product_with(phi), jax.tree.map(jnp.multiply, mass, phi))
        )
        return over / under

    return jax.vmap(quotient, -1)(modes)
