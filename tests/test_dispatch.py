"""What a call costs beside the run: nothing is compiled again, and facts are found once."""

import gc
import weakref

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx
from granjax.base import programs
from granjax.flow.arguments import facts

# other tests of the same process must not have compiled these shapes
N = 7


def test_compiled_takes_any_pytree_and_traces_once():
    traces = []

    @programs.compiled
    def scaled(tree, factor, name):
        traces.append(name)
        return {name: tree["x"] * factor}

    x = np.arange(3.0)
    for value in (x, jnp.asarray(x) + 1):
        np.testing.assert_array_equal(
            scaled({"x": value}, np.float64(2.0), "y")["y"], 2 * np.asarray(value)
        )
    scaled({"x": x}, np.float64(3.0), "z")
    assert traces == ["y", "z"], "what is no array is static, and nothing else"


def test_compiled_differentiates_and_nests():
    @programs.compiled
    def cube(x):
        return x**3

    assert jax.jit(jax.grad(cube))(2.0) == pytest.approx(12.0)
    np.testing.assert_allclose(jax.vmap(cube)(jnp.arange(3.0)), [0, 1, 8])


def test_facts_are_found_once_and_go_with_the_lattice():
    chain = gx.scenes.monomer(N)
    found = facts(chain)
    assert facts(chain) is found
    assert found.template.shape == (N,) and not found.traced and not found.reads_velocity
    found.known["own"] = gx.Hertz()
    kept = weakref.ref(found.known["own"])
    del chain, found
    gc.collect()
    assert kept() is None


def test_facts_tell_traced_lattices():
    seen = []

    @jax.jit
    def f(stiffness):
        seen.append(facts(gx.scenes.monomer(N, stiffness=stiffness)).traced)
        return stiffness

    f(1.0)
    assert seen == [True]


def test_another_lattice_in_the_same_place_has_its_own_facts():
    for sites in (5, 6, 7, 8):
        assert facts(gx.scenes.monomer(sites)).template.shape == (sites,)
