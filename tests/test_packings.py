"""Packings in space: bands against a hand-made matrix, sound, an impact against SciPy."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases import ended

import granjax as gx
from granjax import linear, scenes

AXES = np.array([[0, 1, 1], [1, 0, 1], [1, 1, 0]]) / 2**0.5
OFFSETS = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, -1, 0], [0, 1, -1], [1, 0, -1]])


def by_hand(k):
    """omega^2 of the face-centred packing of springs 1 at phases k: sum of 2 (1 - cos k.o) R R over half the bonds."""
    R = OFFSETS @ AXES
    weight = 2 * (1 - np.cos(OFFSETS @ k))
    return np.linalg.eigvalsh(np.einsum("b,bi,bj->ij", weight, R, R))


@pytest.mark.slow
def test_bands_of_the_face_centred_packing():
    packing = scenes.fcc(4, boundary="periodic")
    ks = np.random.default_rng(0).uniform(-np.pi, np.pi, (20, 3))
    found = linear.dispersion(packing, ks).omega_squared
    assert np.abs(found - np.array([by_hand(k) for k in ks])).max() < 1e-13
    path = linear.path(packing, "GXWLK", count=20)
    known = [[0, 0, 0], [4, 4, 8], [4, 6, 6], [2, 2, 8], [2 + 2**0.5, 4 + 2**0.5, 4 + 2 * 2**0.5]]
    np.testing.assert_allclose(path.omega_squared[path.marks], known, rtol=0, atol=1e-13)
    # along a cube's edge q = (q, 0, 0)
    slow = linear.dispersion(packing, AXES @ [1e-3, 0, 0]).omega_squared / 1e-6
    np.testing.assert_allclose(slow, [0.5, 0.5, 1], rtol=1e-6)


@pytest.mark.slow
def test_long_waves_of_the_hexagonal_packing_and_what_holds_no_shear():
    hexagonal = scenes.hcp(4, boundary="periodic")
    along = linear.dispersion(hexagonal, [0, 0, 1e-3]).omega_squared[:3] / (3e-6 / 8)
    np.testing.assert_allclose(along, [1 / 3, 1 / 3, 4 / 3], rtol=1e-5)
    cubic = linear.path(scenes.cubic((3, 4, 5), boundary="periodic"), "GXMR", count=9)
    np.testing.assert_allclose(cubic.omega_squared[cubic.marks[1]], [0, 0, 4], atol=1e-13)


@pytest.mark.slow
def test_an_impact_on_a_face_centred_packing_is_scipys():
    shape = (3, 3, 2)
    F0 = 0.1
    packing = scenes.fcc(shape, exponent=1.5, precompression=F0, boundary="free")
    u = jnp.zeros((*shape, 3))
    start = gx.State(u, u.at[0, 0, 0].set(jnp.array([0.3, 0.2, 0.1])))
    d0 = F0 ** (2 / 3)
    places = np.stack(np.indices(shape), -1).reshape(-1, 3)
    index = {tuple(p): i for i, p in enumerate(places)}
    bonds = [
        (i, index[t], o @ AXES)
        for i, p in enumerate(places)
        for o in OFFSETS
        if (t := tuple(p + o)) in index
    ]
    tail, head, R = (np.array(x) for x in zip(*bonds))

    def field(t, y):
        u, v = y.reshape(2, -1, 3)
        line = R + u[head] - u[tail]
        length = np.linalg.norm(line, axis=1, keepdims=True)
        push = np.maximum(d0 + 1 - length, 0) ** 1.5 * line / length - F0 * R
        a = np.zeros_like(u)
        np.add.at(a, head, push)
        np.add.at(a, tail, -push)
        return np.concatenate([v.ravel(), a.ravel()])

    y0 = np.concatenate([np.ravel(x) for x in start])
    exact = ended(field, 5.0, y0)
    run = gx.simulate(packing, start, 5.0, tolerance=1e-11)
    assert np.abs(np.concatenate([np.ravel(x) for x in run.final]) - exact).max() < 1e-8
