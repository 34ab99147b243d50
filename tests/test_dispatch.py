"""What a call costs beside the run: nothing is compiled again, and facts are found once."""

import gc

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx
from granjax import programs
from granjax.flow import dispatch

# other tests of the same process must not have compiled these shapes
N = 7


def _force(t, y, lattice):
    return gx.measures.contact_force(lattice, y)


CALLS = {
    "step": dict(step=0.1),
    "default": {},
    "tolerance": dict(tolerance=1e-6),
    "frames": dict(step=0.1, save_at=5),
    "record": dict(step=0.1, record={"peak": gx.Peak(_force)}),
}


@pytest.fixture
def compilations():
    """A list that grows by one with every program that XLA compiles."""
    seen = []

    def listen(event, duration, **_):
        if event.endswith("backend_compile_duration"):
            seen.append(duration)

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield seen
    # JAX offers no public way to take one listener away; it only sees its own list
    seen.append(None)


def _scene(stiffness, velocity):
    chain = gx.scenes.monomer(N, stiffness=stiffness, precompression=0.3)
    return chain, gx.states.impact(chain, velocity=velocity)


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(x, marks=() if x == "default" else pytest.mark.slow) for x in CALLS])
def test_equal_shapes_compile_once(name, compilations):
    options = CALLS[name]
    scenes = [_scene(1.0, 1.0), _scene(1.3, 0.7)]
    gx.simulate(*scenes[0], 2.0, **options)
    first = len(compilations)
    assert first > 0, "the listener counts nothing"
    other = {key: 0.7 * value if key in ("step", "tolerance") else value for key, value in options.items()}
    for scene in scenes:
        for t1 in (2.0, 3.1):
            for keywords in (options, other):
                gx.simulate(*scene, t1, **keywords)
    assert len(compilations) == first, "a call of equal shapes compiled again"


def test_compiled_takes_any_pytree_and_traces_once():
    traces = []

    @programs.compiled
    def scaled(tree, factor, name):
        traces.append(name)
        return {name: tree["x"] * factor}

    x = np.arange(3.0)
    for value in (x, jnp.asarray(x) + 1):
        np.testing.assert_array_equal(scaled({"x": value}, np.float64(2.0), "y")["y"], 2 * np.asarray(value))
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
    found = dispatch.facts(chain)
    assert dispatch.facts(chain) is found
    assert found.template.shape == (N,) and not found.traced and not found.reads_velocity
    known = len(dispatch._FACTS)
    del chain
    gc.collect()
    assert len(dispatch._FACTS) == known - 1


def test_facts_tell_traced_lattices():
    seen = []

    @jax.jit
    def f(stiffness):
        seen.append(dispatch.facts(gx.scenes.monomer(N, stiffness=stiffness)).traced)
        return stiffness

    f(1.0)
    assert seen == [True]


def test_another_lattice_in_the_same_place_has_its_own_facts():
    for sites in (5, 6, 7, 8):
        assert dispatch.facts(gx.scenes.monomer(sites)).template.shape == (sites,)
