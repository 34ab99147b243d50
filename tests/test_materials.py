"""Materials and Hertz's coefficient: published formulas, limits, derivatives, and what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax import materials
from granjax.materials import Material, bead_mass, hertz_coefficient, material

SOLIDS = [name for name in materials.NAMES if name != "rigid"]
R = 9.53e-3


@pytest.mark.parametrize("name", SOLIDS)
def test_every_material_is_checked_names_its_source_and_has_the_coefficient_of_equal_beads(name):
    # A = E sqrt(2R)/(3(1 - nu^2)), Nesterenko (2001)
    body = material(name)
    E = float(body.young)
    nu = float(body.poisson)
    assert Material(body.name, E, nu, body.density).young == E and len(body.source) > 10
    pair = hertz_coefficient(name, R, name, R), hertz_coefficient(name, R)
    assert_allclose(pair, E * np.sqrt(2 * R) / (3 * (1 - nu**2)), rtol=1e-15)


def test_two_materials_and_radii_have_the_published_coefficient():
    # A = 4 E1 E2 sqrt(R1 R2/(R1 + R2))/(3 E2 (1 - nu1^2) + 3 E1 (1 - nu2^2)), Nesterenko (2001)
    E1 = 193e9
    nu1 = 0.3
    R1 = 9.53e-3
    E2 = 1.46e9
    nu2 = 0.46
    R2 = 2.38e-3
    root = np.sqrt(R1 * R2 / (R1 + R2))
    below = E2 * (1 - nu1**2) + E1 * (1 - nu2**2)
    ends = (Material("a", E1, nu1, 1.0), R1), (Material("b", E2, nu2, 1.0), R2)
    for first, second in (ends, ends[::-1]):
        printed = 4 * E1 * E2 * root / (3 * below)
        assert_allclose(hertz_coefficient(*first, *second), printed, rtol=1e-15)


def test_a_plane_is_a_sphere_of_infinite_radius_and_a_rigid_one_doubles_the_modulus():
    on = lambda radius, other=None: hertz_coefficient("brass", R, other, radius)
    pair = hertz_coefficient("brass", R)
    plane = on(jnp.inf)
    assert_allclose([plane, on(1e20 * R)], np.sqrt(2) * pair, rtol=1e-15)
    both = hertz_coefficient("brass", [R, R], None, [R, np.inf])
    assert_allclose(both, [pair, plane], rtol=1e-15)
    assert_allclose(on(np.inf, "rigid"), 2 * plane, rtol=1e-15)


def test_mass_of_a_bead():
    # measured mass of a 9.53 mm steel 316 bead 28.84 g, Boechler et al. (2010): the table's density is within 1 %
    assert_allclose(bead_mass("steel 316", R), 4 / 3 * np.pi * R**3 * 8000, rtol=1e-15)
    assert_allclose(bead_mass("steel 316", R), 28.84e-3, rtol=1e-2)


@pytest.mark.parametrize(
    "name, found",
    [
        ("STEEL_440c", "steel 440C"),
        ("teflon", "PTFE"),
        ("aluminum", "aluminium 6061-T6"),
        ("rigid", "rigid"),
    ],
)
def test_names_are_tolerant_and_a_material_of_ones_own_passes_through(name, found):
    body = material(name)
    assert body.name == found and material(body) is body


@pytest.mark.slow
def test_the_coefficient_has_derivatives_and_takes_lanes_and_stacks():
    def function(x):
        body = Material("mine", 1e9 * x[0], 0.3, 1.0)
        return hertz_coefficient(body, 1e-3 * x[1], "steel 316", jnp.inf) / 1e7

    x = jnp.array([2.0, 3.0])
    shifts = 1e-5 * jnp.eye(2)
    at = jax.jit(jax.vmap(function))
    central = (at(x + shifts) - at(x - shifts)) / 2e-5
    for derivative in (jax.grad, jax.jacfwd):
        assert_allclose(jax.jit(derivative(function))(x), central, rtol=1e-8, atol=1e-9)
    wall = lambda radius: hertz_coefficient("brass", radius, "rigid", jnp.inf)
    radii = jnp.array([1e-3, 2e-3, 5e-3])
    assert_allclose(jax.vmap(wall)(radii), wall(radii), rtol=1e-15)
    bodies = materials.stack(["brass", material("PTFE"), "brass"])
    np.testing.assert_array_equal(bodies.young, [97e9, 1.46e9, 97e9])
    each = [hertz_coefficient(name, R) for name in ("brass", "PTFE", "brass")]
    assert_allclose(hertz_coefficient(bodies, R), each, rtol=1e-15)


REFUSALS = {
    "name: expected one of .* Did you mean 'steel 316'": lambda: material("stel 316"),
    "young: expected numbers above zero": lambda: Material("x", -1.0, 0.3, 1.0),
    r"poisson: expected numbers in \(-1, 0.5\]": lambda: Material("x", 1.0, 0.6, 1.0),
    "radius_1: .*infinite for a plane": lambda: hertz_coefficient("brass", 0.0),
    "at most one plane": lambda: hertz_coefficient("brass", np.inf),
    "material_2: expected at most one rigid body": lambda: hertz_coefficient("rigid", 1.0),
    "radius_1 and .* shapes that broadcast": lambda: hertz_coefficient(
        "brass", np.ones(3), None, np.ones(2)
    ),
    "material: expected a material with a density": lambda: bead_mass("rigid", 1.0),
}


@pytest.mark.parametrize("words", REFUSALS)
def test_bad_input_is_refused(words):
    with refused(words):
        REFUSALS[words]()


def test_a_bead_of_more_than_a_metre_is_questioned(recwarn):
    gx.scenes.beads("steel 316", [9.5e-3, 0.4])
    jax.jit(lambda radius: bead_mass("steel 316", radius))(9.5)
    assert not [w for w in recwarn if "metres" in str(w.message)]
    for make in (
        lambda: gx.scenes.beads("PTFE", [9.5e-3, 2.0]),
        lambda: bead_mass("brass", 0.51),
    ):
        with pytest.warns(UserWarning, match="Radii are in metres"):
            make()
