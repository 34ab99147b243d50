import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import granjax as gx
from granjax import materials
from granjax.materials import Material, bead_mass, hertz_coefficient, material

SOLIDS = [name for name in materials.NAMES if name != "rigid"]
R = 9.53e-3


@pytest.mark.parametrize("name", SOLIDS)
def test_every_material_passes_its_own_checks_and_names_its_source(name):
    body = material(name)
    again = Material(body.name, body.young, body.poisson, body.density)
    assert again.young == body.young
    assert len(body.source) > 10


@pytest.mark.parametrize("name", SOLIDS)
def test_equal_beads_have_the_simple_coefficient(name):
    # A = E sqrt(2R)/(3(1 - nu^2)), Nesterenko (2001)
    body = material(name)
    simple = float(body.young) * np.sqrt(2 * R) / (3 * (1 - float(body.poisson) ** 2))
    assert_allclose(hertz_coefficient(name, R, name, R), simple, rtol=1e-15)
    assert_allclose(hertz_coefficient(name, R), simple, rtol=1e-15)


def test_two_materials_and_radii():
    # A = 4 E1 E2 sqrt(R1 R2/(R1 + R2))/(3 E2 (1 - nu1^2) + 3 E1 (1 - nu2^2)), Nesterenko (2001)
    E1, nu1, R1, E2, nu2, R2 = 193e9, 0.3, 9.53e-3, 1.46e9, 0.46, 2.38e-3
    printed = (
        4 * E1 * E2 * np.sqrt(R1 * R2 / (R1 + R2)) / (3 * E2 * (1 - nu1**2) + 3 * E1 * (1 - nu2**2))
    )
    first, second = Material("a", E1, nu1, 1.0), Material("b", E2, nu2, 1.0)
    assert_allclose(hertz_coefficient(first, R1, second, R2), printed, rtol=1e-15)
    assert_allclose(hertz_coefficient(second, R2, first, R1), printed, rtol=1e-15)


def test_a_plane_is_a_sphere_of_infinite_radius():
    pair, plane = hertz_coefficient("brass", R), hertz_coefficient("brass", R, None, jnp.inf)
    assert_allclose(plane, np.sqrt(2) * pair, rtol=1e-15)
    assert_allclose(hertz_coefficient("brass", R, None, 1e20 * R), plane, rtol=1e-15)
    assert_allclose(
        hertz_coefficient("brass", [R, R], None, [R, np.inf]), [pair, plane], rtol=1e-15
    )


def test_a_rigid_plane_doubles_the_modulus():
    plane = hertz_coefficient("brass", R, "brass", jnp.inf)
    assert_allclose(hertz_coefficient("brass", R, "rigid", np.inf), 2 * plane, rtol=1e-15)


def test_mass_of_a_bead():
    # measured mass of a 9.53 mm steel 316 bead 28.84 g, Boechler et al. (2010): the table's density is within 1 %
    assert_allclose(bead_mass("steel 316", R), 4 / 3 * np.pi * R**3 * 8000, rtol=1e-15)
    assert_allclose(bead_mass("steel 316", R), 28.84e-3, rtol=1e-2)


@pytest.mark.parametrize(
    "name, found",
    [
        ("Steel-316", "steel 316"),
        ("STEEL_440c", "steel 440C"),
        ("ptfe", "PTFE"),
        ("teflon", "PTFE"),
        ("aluminum", "aluminium 6061-T6"),
        ("aluminium6061t6", "aluminium 6061-T6"),
        ("rigid", "rigid"),
    ],
)
def test_names_are_tolerant(name, found):
    assert material(name).name == found


def test_a_material_of_ones_own_passes_through():
    mine = Material("mine", 1e9, -0.5, 900.0)
    assert material(mine) is mine


def sphere_on_plane(x):
    return (
        hertz_coefficient(Material("mine", 1e9 * x[0], 0.3, 1.0), 1e-3 * x[1], "steel 316", jnp.inf)
        / 1e7
    )


@pytest.mark.slow
def test_gradients():
    function = sphere_on_plane
    x, step = jnp.array([2.0, 3.0]), 1e-5
    shifts = step * jnp.eye(2)
    at = jax.jit(jax.vmap(function))
    central = (at(x + shifts) - at(x - shifts)) / (2 * step)
    assert_allclose(jax.jit(jax.grad(function))(x), central, rtol=1e-8, atol=1e-9)
    assert_allclose(jax.jit(jax.jacfwd(function))(x), central, rtol=1e-8, atol=1e-9)


def test_radii_may_be_lanes():
    radii = jnp.array([1e-3, 2e-3, 5e-3])
    batch = jax.vmap(lambda r: hertz_coefficient("brass", r, "rigid", jnp.inf))(radii)
    assert_allclose(batch, hertz_coefficient("brass", radii, "rigid", jnp.inf), rtol=1e-15)


def test_stack_places_materials_along_a_chain():
    bodies = materials.stack(["brass", material("PTFE"), "brass"])
    np.testing.assert_array_equal(bodies.young, [97e9, 1.46e9, 97e9])
    assert_allclose(
        hertz_coefficient(bodies, R),
        [hertz_coefficient(m, R) for m in ("brass", "PTFE", "brass")],
        rtol=1e-15,
    )


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: material("stel 316"), "name: expected one of .* Did you mean 'steel 316'"),
        (lambda: Material("x", -1.0, 0.3, 1.0), "young: expected numbers above zero, got -1.0"),
        (lambda: Material("x", 1.0, 0.6, 1.0), r"poisson: expected numbers in \(-1, 0.5\]"),
        (
            lambda: hertz_coefficient("brass", 0.0),
            "radius_1: expected numbers above zero.*infinite for a plane",
        ),
        (
            lambda: hertz_coefficient("brass", np.inf),
            "radius_1 and radius_2: expected at most one plane",
        ),
        (lambda: hertz_coefficient("rigid", 1.0), "material_2: expected at most one rigid body"),
        (
            lambda: hertz_coefficient("brass", np.ones(3), None, np.ones(2)),
            "radius_1 and .* shapes that broadcast",
        ),
        (lambda: bead_mass("rigid", 1.0), "material: expected a material with a density"),
    ],
)
def test_bad_input_gets_a_sentence(call, words):
    with pytest.raises(ValueError, match=words):
        call()


@pytest.mark.parametrize(
    "make",
    [
        lambda: gx.scenes.beads("steel 316", 9.5, cells=3),
        lambda: gx.scenes.beads("PTFE", [9.5e-3, 2.0]),
        lambda: gx.materials.bead_mass("brass", 0.51),
    ],
)
def test_a_bead_of_more_than_a_metre_is_questioned(make):
    with pytest.warns(UserWarning, match="Radii are in metres"):
        make()


def test_beads_of_laboratories_are_not_questioned(recwarn):
    gx.scenes.beads("steel 316", [9.5e-3, 0.4])
    jax.jit(lambda radius: gx.materials.bead_mass("steel 316", radius))(9.5)
    assert not [w for w in recwarn if "metres" in str(w.message)]
