from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import (
    ALL_STRAIN_MAPS,
    BOUNDARIES,
    EPS,
    LINEAR_MAPS,
    STRETCHES,
    assert_ulps,
    over,
    random_like,
)

import granjax as gx
from granjax.strains import StrainMap

LAW = gx.Hertz(1.3, 0.6) + gx.Linear(0.4)


class Forms(NamedTuple):
    """Everything about one map at one place, from one compilation."""

    strain: object
    gather: object
    transposed: object
    reach: object
    absolute: object
    split: object
    shares: object
    load: object
    base_load: object
    gradient: object
    energy: object
    base_energy: object


def touched(u, parts):
    """The fields that a map acts on, of an array or a dict over all fields."""
    return {name: u[name] for name in parts} if isinstance(parts, dict) else u


def forms(case):
    return _forms_of(case.name)[:3]


@cache
def _forms_of(name):
    case = next(case for case in ALL_STRAIN_MAPS if case.name == name)
    u = random_like(case.shape, 0)
    f = 0.1 + jnp.abs(random_like(jax.eval_shape(case.map.strain, u), 1))
    program = jax.jit(lambda u, f: _forms(case.map, u, f))
    return u, f, program(u, f), program(jax.tree.map(np.zeros_like, u), f)


def _forms(strain_map, u, f):
    linear = hasattr(strain_map, "gather")
    joined = getattr(strain_map, "pairs", strain_map)
    # one component of the vectors stands for the sites of a distance
    w = u if joined is strain_map else jnp.take(u, 0, axis=joined.axes)
    own, x = (strain_map, u) if linear else (joined, w)
    jacobian = jax.tree.map(jnp.abs, jax.jacobian(own.strain)(x))
    rows = [
        jnp.tensordot(j, y, y.ndim) for j, y in zip(jax.tree.leaves(jacobian), jax.tree.leaves(x))
    ]
    sites = jacobian if own is joined else jax.tree.map(jnp.abs, jax.jacobian(joined.strain)(w))
    ends = sum(j.sum(tuple(range(f.ndim, j.ndim))) for j in jax.tree.leaves(sites))
    shares = jax.tree.map(
        lambda j: jnp.tensordot(f / jnp.where(ends > 0, ends, 1), j, f.ndim), sites
    )
    return Forms(
        strain=strain_map.strain(u),
        gather=strain_map.gather(f) if linear else None,
        transposed=jax.linear_transpose(strain_map.strain, u)(f)[0] if linear else None,
        reach=strain_map.reach(u) if linear else None,
        absolute=sum(rows),
        split=strain_map.split(f, u),
        shares=shares,
        load=strain_map.load(u, LAW),
        base_load=StrainMap.load(strain_map, u, LAW),
        gradient=jax.grad(lambda u: strain_map.energy(u, LAW).sum())(u),
        energy=strain_map.energy(u, LAW),
        base_energy=StrainMap.energy(strain_map, u, LAW),
    )


@pytest.mark.slow
@over(LINEAR_MAPS)
def test_gather_is_the_transpose_of_strain(case):
    _, _, x = forms(case)
    assert_ulps(x.gather, touched(x.transposed, x.gather), 8)
    for name in set(x.transposed) - set(x.gather) if isinstance(x.gather, dict) else ():
        assert np.all(np.asarray(x.transposed[name]) == 0)


@pytest.mark.slow
@over(LINEAR_MAPS)
def test_reach_is_the_absolute_values(case):
    _, _, x = forms(case)
    assert_ulps(x.reach, x.absolute, 16)


@pytest.mark.slow
@over(ALL_STRAIN_MAPS)
def test_load_and_energy_are_the_forms_of_the_base_class(case):
    """The hand-written transpose and energies against `jax.vjp` of the strain alone."""
    _, _, x = forms(case)
    assert_ulps(x.load, touched(x.base_load, x.load), 64, 4.0)
    assert_ulps(x.energy, x.base_energy, 64, 1.0)


@pytest.mark.slow
@over(ALL_STRAIN_MAPS)
def test_load_is_the_gradient_of_the_energy(case):
    _, _, x = forms(case)
    assert_ulps(x.load, touched(x.gradient, x.load), 128, 4.0)


@pytest.mark.slow
@over(ALL_STRAIN_MAPS)
def test_rest_has_no_strain_no_load_and_no_energy(case):
    at_rest = _forms_of(case.name)[3]
    for x in (at_rest.strain, *jax.tree.leaves(at_rest.load), at_rest.energy):
        np.testing.assert_allclose(x, 0, atol=16 * EPS)


@pytest.mark.slow
@over(ALL_STRAIN_MAPS)
def test_split_shares_every_bond_out_to_its_ends(case):
    """By the rows of |de/du| (of the joined sites, for a distance); a wall gets nothing."""
    _, _, x = forms(case)
    assert_ulps(x.split, touched(x.shares, x.split), 16)


# its corners join wall to wall
@over([case for case in ALL_STRAIN_MAPS if case.name != "shift_grid_fixed_fixed"])
def test_split_loses_nothing(case):
    _, f, x = forms(case)
    total = sum(float(s.sum()) for s in jax.tree.leaves(x.split))
    np.testing.assert_allclose(total, float(f.sum()), rtol=16 * EPS)


def pairs_like(boundary, n, offset):
    """The bonds of a Shift written one by one."""
    if boundary == "periodic":
        return [i for i in range(n)], [(i + offset) % n for i in range(n)]
    starts = range(-offset, n) if boundary == "fixed" else range(n - offset)
    sites = [(i, i + offset) for i in starts]
    return [i if i >= 0 else -1 for i, _ in sites], [j if j < n else -1 for _, j in sites]


@pytest.mark.slow
@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("offset", [1, 2])
def test_pairs_are_a_shift_written_one_by_one(boundary, offset):
    shift, pairs = gx.Shift(offset, boundary), gx.Pairs(*pairs_like(boundary, 7, offset))
    u = random_like((7, 2), 10)
    assert np.array_equal(shift.strain(u), pairs.strain(u))
    f = random_like(shift.strain(u), 11)
    assert_ulps(pairs.gather(f), shift.gather(f), 2)
    assert_ulps(pairs.load(u, LAW), shift.load(u, LAW), 8)


def test_shift_of_a_chain_by_hand():
    u = jnp.array([1.0, 3.0, 6.0, 10.0])
    assert np.array_equal(gx.Shift(1, "free").strain(u), [-2, -3, -4])
    assert np.array_equal(gx.Shift(1, "fixed").strain(u), [-1, -2, -3, -4, 10])
    assert np.array_equal(gx.Shift(1, "periodic").strain(u), [-2, -3, -4, 9])
    assert np.array_equal(gx.Shift(-1, "free").strain(u), [2, 3, 4])
    assert np.array_equal(gx.Shift(2, "free").strain(u), [-5, -7])
    assert np.array_equal(gx.Shift(2, "fixed").strain(u), [-1, -3, -5, -7, 6, 10])
    cell = {"a": u, "b": 2 * u}
    assert np.array_equal(gx.Shift(0, "free", ("a", "b")).strain(cell), -u)
    assert np.array_equal(gx.Shift(1, "free", ("b", "a")).strain(cell), [-1, 0, 2])
    assert np.array_equal(gx.Shift((1, 0), ("free", "fixed")).strain(u.reshape(2, 2)), [[-5, -7]])


def test_unequal_ends_share_a_bond_as_their_weights():
    pairs = gx.Pairs([0, 1], [1, 2], weights=([1.0, 3.0], 1.0))
    np.testing.assert_allclose(
        pairs.split(jnp.array([2.0, 8.0]), jnp.zeros(3)), [1.0, 1.0 + 6.0, 2.0], rtol=4 * EPS
    )


@pytest.mark.slow
@over(STRETCHES)
def test_small_displacements_are_the_projection_on_the_bond(case):
    u = random_like(case.shape, 12)
    axis = case.map.pairs.axes
    D = jax.lax.slice_in_dim(case.map.pairs.strain(u), 0, case.map.components, axis=axis)
    R = case.map.vector / jnp.linalg.norm(case.map.vector, axis=-1, keepdims=True)
    if R.ndim == 1:
        projected = jnp.tensordot(jnp.moveaxis(D, axis, -1), R, 1)
    else:
        projected = jnp.sum(D * R, axis)
    strain = jax.jit(lambda u: case.map.strain(u))
    for small in (1e-4, 1e-8, 1e-12):
        e = strain(small * u)
        # the next term is of second order in the displacements
        np.testing.assert_allclose(e / small, projected, rtol=0, atol=2 * small + 16 * EPS)


def rotation(dimension, angle):
    """A rotation about an axis that is none of the coordinates' in space."""
    if dimension == 2:
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    x, y, z = np.array([1.0, -2.0, 0.5]) / np.linalg.norm([1.0, -2.0, 0.5])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


@pytest.mark.parametrize("vector", [[0.8, 0.6], [1.0, 0.0], [0.3, -0.5, 1.1]])
@pytest.mark.parametrize("angle", [1e-6, 0.3, 2.5])
def test_a_rigid_rotation_strains_no_bond(vector, angle):
    vector = np.array(vector)
    sites = np.arange(5)[:, None] * vector
    turn = rotation(len(vector), angle)
    u = jnp.array(sites @ turn.T - sites)
    stretch = gx.Stretch(gx.Shift(1, "free"), vector)
    np.testing.assert_allclose(stretch.strain(u), 0, atol=16 * EPS)
    np.testing.assert_allclose(stretch.load(u, gx.Linear(2.0)), 0, atol=64 * EPS)
    # with a preload the ends feel F0 along the turned bond less F0 along the one at rest; inner sites nothing
    load = np.asarray(stretch.load(u, gx.Hertz(1.0, 0.7)))
    unit = vector / np.linalg.norm(vector)
    np.testing.assert_allclose(load[1:-1], 0, atol=64 * EPS)
    np.testing.assert_allclose(load[0], 0.7 * (turn @ unit - unit), atol=64 * EPS)
    np.testing.assert_allclose(load[-1], -load[0], atol=64 * EPS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "law", [gx.Hertz(1.0, 0.7), gx.Linear(2.0), gx.Toda(0.8, 1.3)], ids=lambda x: type(x).__name__
)
def test_second_variation_of_a_prestressed_bond(law):
    """Along the bond F'(0); across it -F0/L, for every transverse direction."""
    L = 1.7
    vector = L * np.array([0.6, 0.0, 0.8])
    stretch = gx.Stretch(gx.Shift(1, "free"), vector)
    hessian = jax.jit(jax.hessian(lambda u: stretch.energy(u, law).sum()))(jnp.zeros((2, 3)))
    n = vector / L
    K, T = float(jax.grad(law.force)(0.0)), -float(law.preload) / L
    want = K * np.outer(n, n) + T * (np.eye(3) - np.outer(n, n))
    np.testing.assert_allclose(hessian[0, :, 0, :], want, atol=1e-14)
    np.testing.assert_allclose(hessian[0, :, 1, :], -want, atol=1e-14)


def test_stretch_is_the_distance():
    # tail at 0, head at (3, 4): the head moves to (0, 1); 5 - 1 of compression
    stretch = gx.Stretch(gx.Shift(1, "free"), [3.0, 4.0])
    u = jnp.array([[0.0, 0.0], [-3.0, -3.0]])
    np.testing.assert_allclose(stretch.strain(u), [4.0], rtol=4 * EPS)
    np.testing.assert_allclose(stretch.load(u, gx.Linear(2.0)), [[0, 8], [0, -8]], atol=32 * EPS)


@over(ALL_STRAIN_MAPS)
def test_float32_stays_float32(case):
    u = jax.tree.map(lambda x: x.astype(jnp.float32), random_like(case.shape, 13))
    strain_map = jax.tree.map(lambda x: x.astype(jnp.float32), case.map)
    law = jax.tree.map(lambda x: x.astype(jnp.float32), LAW)
    got = jax.eval_shape(
        lambda u: [strain_map.strain(u), strain_map.load(u, law), strain_map.energy(u, law)], u
    )
    assert all(x.dtype == jnp.float32 for x in jax.tree.leaves(got))
