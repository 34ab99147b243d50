"""Disordered chains, how far their waves reach, and how their energy spreads."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx

N = 8
disordered = gx.scenes.disordered


def noise(**keywords):
    return np.asarray(disordered(4000, 0.5, 1, **keywords).mass) - 1


@pytest.mark.parametrize("correlation, neighbours", [("none", 0.0), ("alike", 0.5), ("opposite", -0.5)])
def test_dimers_are_correlated_as_they_say(correlation, neighbours):
    x = noise(correlation=correlation)
    assert np.abs(x).max() <= 0.5 and abs(x.mean()) < 0.02
    assert np.mean(x[1:] * x[:-1]) / x.var() == pytest.approx(neighbours, abs=0.04)
    assert abs(np.mean(x[2:] * x[:-2])) < 0.04 * x.var()


def test_random_dimers_hold_two_beads_that_are_alike_or_one_of_either():
    pairs = noise(distribution="binary", correlation="alike").reshape(-1, 2)
    np.testing.assert_array_equal(pairs[:, 0], pairs[:, 1])
    pairs = noise(distribution="binary", correlation="opposite").reshape(-1, 2)
    np.testing.assert_array_equal(pairs[:, 0], -pairs[:, 1])
    assert disordered(9, 0.5, correlation="alike").mass.shape == (9,)


@pytest.mark.parametrize("boundary", ["fixed", "free", "periodic"])
def test_what_is_random(boundary):
    common = dict(seed=3, precompression=2.0, boundary=boundary)
    mass = disordered(N, 0.4, mass=2.0, **common)
    R = np.asarray(disordered(N, 0.4, **common).mass)
    np.testing.assert_allclose(mass.mass, 2 * R)
    # the same numbers as radii: masses by the cube, contacts by 1/R* = 1/R + 1/R'
    spheres = disordered(N, 0.4, of="radius", **common)
    np.testing.assert_allclose(spheres.mass, R**3)
    A = np.asarray(spheres.terms[0].law.stiffness)
    first = {"fixed": 1, "free": 0, "periodic": 0}[boundary]
    np.testing.assert_allclose(A[first], np.sqrt(2 / (1 / R[0] + 1 / R[1])))
    assert len(A) == N + {"fixed": 1, "free": -1, "periodic": 0}[boundary]
    soft = disordered(N, 0.4, of="stiffness", **common)
    assert np.ptp(soft.terms[0].law.stiffness) > 0.1 and soft.terms[0].law.stiffness.shape == A.shape
    # overlaps follow from where the beads lie; between walls they add up to that of the regular chain
    moved = disordered(N, 0.4, of="position", **common).terms[0].law
    d0 = 2 ** (2 / 3)
    np.testing.assert_allclose(np.diff(moved.rest_overlap)[first], 0.5 * d0 * (2 * R[1] - R[0] - R[2]), rtol=1e-10)
    if boundary != "free":
        assert moved.rest_overlap.mean() == pytest.approx(d0, rel=1e-12)


def test_a_law_of_ones_own_and_units():
    chain = disordered(N, 0.4, of="stiffness", law=lambda A: gx.Polynomial(A, 0.0, A), units="SI")
    assert chain.terms[0].law.K2.shape == (N + 1,) and "1 kg" in repr(chain)
    magnets = disordered(N, 0.4, of="position", exponent=-3.0, precompression=1.0).terms[0].law
    assert (magnets.rest_overlap > 0).all() and np.ptp(magnets.rest_overlap) > 0.1


@pytest.mark.parametrize("keywords, sentence", [
    (dict(of="colour"), "of: expected one of"),
    (dict(correlation="some"), "correlation: expected one of"),
    (dict(of="position"), "precompression: expected a static force above zero"),
    (dict(of="position", law=gx.Linear), "law: expected None with of='position'"),
    (dict(of="radius", exponent=2.0), "exponent: expected 3/2"),
    (dict(law=gx.Linear, precompression=1.0), "precompression: expected 0 with a law"),
    (dict(law=lambda A: 1.0), "law: expected a law"),
    (dict(mass=0.0), "mass: expected numbers above zero"),
    (dict(units="m"), "units"),
])
def test_scenes_refused(keywords, sentence):
    with pytest.raises(ValueError, match=sentence):
        disordered(N, 0.3, **keywords)


def test_realisations_are_lanes():
    chains = jax.vmap(lambda n: disordered(N, 0.3, n, of="radius"), out_axes=-1)(jnp.arange(3))
    assert chains.lanes == (3,)
    np.testing.assert_array_equal(chains.mass[:, 1], disordered(N, 0.3, 1, of="radius").mass)
