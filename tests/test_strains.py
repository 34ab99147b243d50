from functools import cache
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ALL_STRAIN_MAPS, EPS, LINEAR_MAPS, assert_ulps, over, random_like
from numpy.testing import assert_allclose, assert_array_equal

import granjax as gx
from granjax import Linear, Shift, Stretch
from granjax.strains import StrainMap

LAW = gx.Hertz(1.3, 0.6) + Linear(0.4)


def touched(u, parts):
    """The fields that a map acts on, of an array or a dict over all fields."""
    return {name: u[name] for name in parts} if isinstance(parts, dict) else u


@cache
def _forms_of(name):
    """Everything about one map at a random place and at rest, from one compilation."""
    case = next(case for case in ALL_STRAIN_MAPS if case.name == name)
    u = random_like(case.shape, 0)
    f = 0.1 + jnp.abs(random_like(jax.eval_shape(case.map.strain, u), 1))
    program = jax.jit(lambda u: _forms(case.map, u, f))
    return [SimpleNamespace(**program(x)) for x in (u, jax.tree.map(np.zeros_like, u))]


def _forms(strain_map, u, f):
    joined = getattr(strain_map, "pairs", strain_map)
    # one component of the vectors stands for the sites of a distance
    w = u if joined is strain_map else jnp.take(u, 0, axis=joined.axes)
    sites = jax.tree.map(jnp.abs, jax.jacobian(joined.strain)(w))
    ends = sum(j.sum(tuple(range(f.ndim, j.ndim))) for j in jax.tree.leaves(sites))
    found = dict(
        strain=strain_map.strain(u),
        split=strain_map.split(f, u),
        shares=jax.tree.map(
            lambda j: jnp.tensordot(f / jnp.where(ends > 0, ends, 1), j, f.ndim), sites
        ),
        load=strain_map.load(u, LAW),
        gradient=jax.grad(lambda u: StrainMap.energy(strain_map, u, LAW).sum())(u),
        energy=strain_map.energy(u, LAW),
        base_energy=StrainMap.energy(strain_map, u, LAW),
    )
    if hasattr(strain_map, "gather"):
        jacobian = jax.tree.map(jnp.abs, jax.jacobian(strain_map.strain)(u))
        pairs = zip(jax.tree.leaves(jacobian), jax.tree.leaves(u))
        found |= dict(
            gather=strain_map.gather(f),
            transposed=jax.linear_transpose(strain_map.strain, u)(f)[0],
            reach=strain_map.reach(u),
            absolute=sum(jnp.tensordot(j, x, x.ndim) for j, x in pairs),
        )
    return found


@pytest.mark.slow
@over(LINEAR_MAPS)
def test_gather_is_the_transpose_of_strain_and_reach_its_absolute_values(case):
    x, _ = _forms_of(case.name)
    assert_ulps(x.gather, touched(x.transposed, x.gather), 8)
    for name in set(x.transposed) - set(x.gather) if isinstance(x.gather, dict) else ():
        assert np.all(np.asarray(x.transposed[name]) == 0)
    assert_ulps(x.reach, x.absolute, 16)


@pytest.mark.slow
@over(ALL_STRAIN_MAPS)
def test_load_is_the_gradient_of_the_energy_of_the_base_class(case):
    """The hand-written transposes and energies against derivatives of the strain alone; rest has none of them."""
    x, rest = _forms_of(case.name)
    assert_ulps(x.load, touched(x.gradient, x.load), 64, 4.0)
    assert_ulps(x.energy, x.base_energy, 64, 1.0)
    for at_rest in (rest.strain, *jax.tree.leaves(rest.load), rest.energy):
        assert_allclose(at_rest, 0, atol=16 * EPS)


@pytest.mark.slow
@over(ALL_STRAIN_MAPS)
def test_split_shares_every_bond_out_to_its_ends(case):
    """By the rows of |de/du| (of the joined sites, for a distance); a wall gets nothing."""
    x, _ = _forms_of(case.name)
    assert_ulps(x.split, touched(x.shares, x.split), 16)


@pytest.mark.parametrize(
    "boundary, tails, heads",
    [
        ("free", [0, 1, 2], [2, 3, 4]),
        ("fixed", [-1, -1, 0, 1, 2, 3, 4], [0, 1, 2, 3, 4, -1, -1]),
        ("periodic", [0, 1, 2, 3, 4], [2, 3, 4, 0, 1]),
    ],
)
def test_pairs_are_a_shift_written_one_by_one(boundary, tails, heads):
    shift = Shift(2, boundary)
    pairs = gx.Pairs(tails, heads)
    u = random_like((5, 2), 10)
    assert_array_equal(shift.strain(u), pairs.strain(u))


def test_shift_of_a_chain_by_hand():
    u = jnp.array([1.0, 3.0, 6.0, 10.0])
    cell = {"a": u, "b": 2 * u}
    for shift, x, want in (
        (Shift(1, "free"), u, [-2, -3, -4]),
        (Shift(1, "fixed"), u, [-1, -2, -3, -4, 10]),
        (Shift(1, "periodic"), u, [-2, -3, -4, 9]),
        (Shift(-1, "free"), u, [2, 3, 4]),
        (Shift(2, "fixed"), u, [-1, -3, -5, -7, 6, 10]),
        (Shift(0, "free", ("a", "b")), cell, -u),
        (Shift(1, "free", ("b", "a")), cell, [-1, 0, 2]),
        (Shift((1, 0), ("free", "fixed")), u.reshape(2, 2), [[-5, -7]]),
    ):
        assert_array_equal(shift.strain(x), want)


def test_small_displacements_are_the_projection_on_the_bond():
    u = random_like((6, 3), 12)
    vectors = random_like((5, 3), 13, 1.0)
    units = vectors / jnp.linalg.norm(vectors, axis=1, keepdims=True)
    for vector, unit in (vectors, units), (vectors[0], units[0]):
        strain = Stretch(Shift(1, "free"), vector).strain
        projected = jnp.sum((u[:-1] - u[1:]) * unit, 1)
        for small in 1e-4, 1e-8, 1e-12:
            # the next term is of second order in the displacements
            assert_allclose(strain(small * u) / small, projected, rtol=0, atol=2 * small + 16 * EPS)


@pytest.mark.parametrize("vector", [[0.8, 0.6, 0.0], [0.3, -0.5, 1.1]])
@pytest.mark.parametrize("angle", [1e-6, 2.5])
def test_a_rigid_rotation_strains_no_bond(vector, angle):
    # about an axis that is none of the coordinates'
    x, y, z = np.array([1.0, -2.0, 0.5]) / np.linalg.norm([1.0, -2.0, 0.5])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    moved = turn @ vector
    u = jnp.array(np.arange(5)[:, None] * moved)
    stretch = Stretch(Shift(1, "free"), vector)
    assert_allclose(stretch.strain(u), 0, atol=16 * EPS)
    assert_allclose(stretch.load(u, Linear(2.0)), 0, atol=64 * EPS)
    # with a preload the ends feel F0 along the turned bond less F0 along the one at rest; inner sites nothing
    load = np.asarray(stretch.load(u, gx.Hertz(1.0, 0.7)))
    end = 0.7 * moved / np.linalg.norm(vector)
    assert_allclose(load, [end, *np.zeros((3, 3)), -end], atol=64 * EPS)


def test_stretch_is_the_distance():
    # tail at 0, head at (3, 4): the head moves to (0, 1); 5 - 1 of compression
    stretch = Stretch(Shift(1, "free"), [3.0, 4.0])
    u = jnp.array([[0.0, 0.0], [-3.0, -3.0]])
    assert_allclose(stretch.strain(u), [4.0], rtol=4 * EPS)
    assert_allclose(stretch.load(u, Linear(2.0)), [[0, 8], [0, -8]], atol=32 * EPS)
