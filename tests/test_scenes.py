import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ended
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

import granjax as gx
from granjax import scenes
from granjax.materials import Material, bead_mass, hertz_coefficient

BALANCED = {
    "monomer": lambda: scenes.monomer(6),
    "monomer, loaded ring": lambda: scenes.monomer(6, precompression=2.0, boundary="periodic"),
    "monomer, loaded, p = 2.3": lambda: scenes.monomer(6, exponent=2.3, precompression=2.0),
    "magnets": lambda: scenes.monomer(6, exponent=-3, precompression=1.0),
    "dimer": lambda: scenes.dimer(7, ratio=0.3),
    "dimer, loaded": lambda: scenes.dimer(7, ratio=0.3, precompression=1.0),
    "trimer": lambda: scenes.trimer(7, precompression=1.0),
    "n_to_one": lambda: scenes.n_to_one(9, 3, 0.4),
    "defects": lambda: scenes.defects(9, {3: 0.5, -1: 2.0}, precompression=1.0),
    "taper": lambda: scenes.taper(9, 0.1, precompression=1.0),
    "disordered": lambda: scenes.disordered(9, 0.3, precompression=1.0),
    "fput": lambda: scenes.fput(7),
    "fput, beta": lambda: scenes.fput(7, alpha=0.0, beta=1.0),
    "toda": lambda: scenes.toda(7, boundary="fixed"),
    "cradle": lambda: scenes.cradle(7, precompression=0.5, boundary="periodic"),
    "fractional": lambda: scenes.fractional(7, 0.5, boundary="fixed"),
    "fractional_fput": lambda: scenes.fractional_fput(7, 0.5),
    "fractional_sine_gordon": lambda: scenes.fractional_sine_gordon(7, 0.5),
    "klein_gordon": lambda: scenes.klein_gordon(7, 0.2),
    "sine_gordon": lambda: scenes.sine_gordon(7, boundary="fixed"),
    "beads": lambda: scenes.beads(["brass", "PTFE"], [2e-3, 1e-3], 3.0, cells=3, damping_time=1e-3),
    "scaled beads": lambda: scenes.scaled(scenes.beads("brass", 2e-3, 3.0, cells=5)).lattice,
}
FREE = {
    "toda": lambda: scenes.toda(7),
    "monomer": lambda: scenes.monomer(7, precompression=2.0, boundary="free"),
    "beads": lambda: scenes.beads("brass", 2e-3, 2.0, cells=7, boundary="free"),
}


def random_state(lattice, scale=0.3, seed=0):
    u, v = scale * np.random.default_rng(seed).standard_normal((2, *lattice.zeros().shape))
    return jnp.asarray(u), jnp.asarray(v)


def same_acceleration(first, second, rtol=1e-14):
    u, v = random_state(first)
    a, b = first.acceleration(0.0, u, v), second.acceleration(0.0, u, v)
    assert_allclose(a, b, rtol=rtol, atol=rtol * float(jnp.abs(a).max()))


@pytest.mark.slow
@pytest.mark.parametrize("make", BALANCED.values(), ids=BALANCED.keys())
def test_rest_is_an_equilibrium(make):
    lattice = make()
    z = lattice.zeros()
    assert_array_equal(lattice.force(0.0, z, z), 0.0)
    # the preloads of neighbouring contacts balance
    assert_allclose(lattice.unbalanced(), 0.0, atol=1e-15)
    u, v = random_state(lattice, 1e-7)
    assert jnp.abs(lattice.force(0.0, u, v)).max() > 0


@pytest.mark.parametrize("make", FREE.values(), ids=FREE.keys())
def test_free_ends_are_held_by_the_preload(make):
    lattice = make()
    z = lattice.zeros()
    assert_array_equal(lattice.force(0.0, z, z), 0.0)
    F0 = float(lattice.terms[0].law.preload)
    assert_allclose(lattice.unbalanced(), [-F0] + [0] * 5 + [F0], atol=1e-15)


def test_monomer_acceleration_is_the_equation():
    # u_n'' = [d0 + u_{n-1} - u_n]_+^{3/2} - [d0 + u_n - u_{n+1}]_+^{3/2}, Nesterenko (1983)
    lattice = scenes.monomer(8, mass=2.0, stiffness=3.0, precompression=0.5)
    u, v = random_state(lattice)
    padded = np.concatenate([[0], np.asarray(u), [0]])
    F = 3 * np.maximum((0.5 / 3) ** (2 / 3) - np.diff(padded), 0) ** 1.5
    assert_allclose(lattice.acceleration(0.0, u, v), (F[:-1] - F[1:]) / 2, rtol=1e-12)


def test_a_chain_of_a_law_is_its_equation():
    lattice = scenes.chain(
        8, 2.0, gx.Toda(0.7, 1.2), on_site=gx.Sine(0.3, 2.0), damping=0.1, units="SI"
    )
    u, v = random_state(lattice)
    F = 0.7 * np.expm1(-1.2 * np.diff(np.concatenate([[0], np.asarray(u), [0]])))
    a = (F[:-1] - F[1:] - 0.3 / 2 * np.sin(2 * u)) / 2 - 0.1 * v
    assert_allclose(lattice.acceleration(0.0, u, v), a, rtol=1e-12)
    assert lattice.units == "SI"


def test_a_crystal_of_a_cell_of_ones_own():
    diagonals = [scenes.Tie("a", "a", offset) for offset in ((1, 1), (1, -1))]
    cell = scenes.CrystalCell(((1.0, 0.0), (0.0, 1.0)), {"a": (0.0, 0.0)}, tuple(diagonals))
    lattice = scenes.crystal(cell, 3, 4, stiffness=(2.0, 3.0), spacing=0.5, boundary="free")
    assert lattice.shape == (3, 4, 2)
    u = np.zeros((3, 4, 2))
    u[1, 1] = 1e-7, 0.0
    force = lattice.force(0.0, jnp.asarray(u), jnp.zeros(u.shape))
    # the springs make angles of 45 degrees with the displacement
    assert_allclose(force[1, 1], [-5e-7, 1e-7], atol=1e-12)
    assert_allclose(force[2, 2], [1e-7, 1e-7], atol=1e-12)
    with refused("n, m: expected 1 numbers of cells"):
        scenes.crystal(cell._replace(vectors=cell.vectors[:1]), 3, 4)


def test_what_a_scene_passes_on_is_named_where_it_is_wrong():
    for scene in (
        lambda **k: scenes.dimer(9, **k),
        lambda **k: scenes.origami(9, **k),
        lambda **k: scenes.woodpile(9, **k),
        lambda **k: scenes.cradle(9, **k),
        lambda **k: scenes.kagome(3, **k),
        lambda **k: scenes.stub(3, **k),
    ):
        with pytest.raises(TypeError, match="stifness"):
            scene(stifness=1.0)
    with refused("outline: expected one of 'cells'"):
        scenes.ssh(4, outline="rectangle")


def test_fput_and_toda_accelerations_are_their_equations():
    alone, asked = scenes.fput(8, beta=8.0).terms[0].law, scenes.fput(8).terms[0].law
    assert (
        alone.K3 is None and float(alone.K4) == 8 and float(asked.K3) == 0.25 and asked.K4 is None
    )
    lattice = scenes.fput(8, alpha=0.25, beta=0.7)
    u, v = random_state(lattice)
    e = -np.diff(np.concatenate([[0], np.asarray(u), [0]]))
    F = e + 0.25 * e**2 + 0.7 * e**3
    assert_allclose(lattice.acceleration(0.0, u, v), F[:-1] - F[1:], rtol=1e-12)
    F = np.concatenate([[1], np.exp(-np.diff(np.asarray(u))), [1]])
    assert_allclose(scenes.toda(8).acceleration(0.0, u, v), F[:-1] - F[1:], rtol=1e-12)


def test_a_mass_that_is_one_number_stays_one_and_is_spread_on_request():
    for scene, count in (
        (scenes.monomer(4, 2.0), (4,)),
        (scenes.fput(4, mass=2.0), (4,)),
        (scenes.square(2, mass=2.0), (2, 2, 2)),
    ):
        assert scene.mass.shape[:1] in ((), (1,)) and float(scene.mass.max()) == 2.0
        assert_array_equal(gx.lattice.spread_mass(scene), np.full(count, 2.0))
    assert_array_equal(gx.lattice.spread_mass(scenes.dimer(3, 0.5)), [1, 0.5, 1])


def test_masses_of_the_patterns():
    assert_array_equal(scenes.dimer(5, 0.25).mass, [1, 0.25, 1, 0.25, 1])
    assert_array_equal(scenes.trimer(5, (0.5, 0.25)).mass, [1, 0.5, 0.25, 1, 0.5])
    assert_array_equal(scenes.n_to_one(5, 2, 0.5).mass, [1, 1, 0.5, 1, 1])
    assert_array_equal(scenes.defects(5, {1: 3.0, -1: 4.0}, mass=2.0).mass, [2, 3, 2, 2, 4])
    assert_array_equal(scenes.pattern(4, np.array([3.0, 2.0])).mass, [3, 2, 3, 2])


def test_a_uniform_chain_keeps_its_numbers_as_numbers():
    for lattice in (
        scenes.monomer(50, precompression=1.0),
        scenes.beads("brass", 1e-3, cells=50, boundary="free"),
    ):
        assert lattice.mass.shape == () and lattice.terms[0].law.stiffness.shape == ()
    assert scenes.monomer(50).terms[0].law.precompression is None


@pytest.mark.slow
def test_exponents():
    assert isinstance(scenes.dimer(5, exponent=1.5).terms[0].law, gx.Hertz)
    assert isinstance(scenes.dimer(5, exponent=2).terms[0].law, gx.PowerLaw)
    same_acceleration(scenes.monomer(6, exponent=jnp.asarray(1.5)), scenes.monomer(6), rtol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize(
    "special",
    [
        lambda **k: scenes.dimer(12, ratio=1.0, **k),
        lambda **k: scenes.trimer(12, (1.0, 1.0), **k),
        lambda **k: scenes.n_to_one(12, 5, ratio=1.0, **k),
        lambda **k: scenes.defects(12, {4: 1.0}, **k),
        lambda **k: scenes.disordered(12, 0.0, **k),
        lambda **k: scenes.taper(12, 0.0, **k),
    ],
)
@pytest.mark.parametrize("boundary", ["fixed", "free"])
def test_special_cases_are_the_monomer(special, boundary):
    common = {"stiffness": 2.0, "precompression": 0.7, "boundary": boundary}
    same_acceleration(special(**common), scenes.monomer(12, **common))


def test_one_to_one_is_the_dimer():
    same_acceleration(scenes.n_to_one(9, 1, 0.3), scenes.dimer(9, 0.3))


def test_a_taper_is_a_chain_of_spheres_of_one_material():
    q, R0 = 0.1, 5e-3
    radii = R0 * (1 - q) ** np.arange(7)
    real = scenes.beads("PTFE", radii, boundary="free")
    ideal = scenes.taper(7, q, boundary="free")
    assert_allclose(real.mass / bead_mass("PTFE", R0), ideal.mass, rtol=1e-14)
    A = real.terms[0].law.stiffness
    assert_allclose(A / A[0], ideal.terms[0].law.stiffness, rtol=1e-14)


def test_disorder_is_seeded_and_bounded():
    first = scenes.disordered(4000, 0.3, 7).mass
    assert_array_equal(first, scenes.disordered(4000, 0.3, jax.random.key(7)).mass)
    assert not np.array_equal(first, scenes.disordered(4000, 0.3, 8).mass)
    assert first.min() >= 0.7 and first.max() <= 1.3
    # four standard errors of 4000 uniform draws: 4 * 0.3/sqrt(3)/sqrt(4000) = 0.011
    assert_allclose(first.mean(), 1.0, atol=0.011)
    assert_allclose(first.std(), 0.3 / np.sqrt(3), rtol=0.04)
    binary = scenes.disordered(200, 0.3, distribution="binary").mass
    assert_allclose(np.unique(binary), [0.7, 1.3], rtol=1e-15)


SWEPT = {
    "dimer": (lambda r: scenes.dimer(6, ratio=r, precompression=0.5), jnp.linspace(0.2, 1.0, 3)),
    "trimer": (lambda r: scenes.trimer(6, ratios=(r, 0.5)), jnp.linspace(0.2, 1.0, 3)),
    "n_to_one": (
        lambda r: scenes.n_to_one(6, 2, r, boundary="periodic"),
        jnp.linspace(0.2, 1.0, 3),
    ),
    "defects": (lambda m: scenes.defects(6, {2: m}), jnp.linspace(0.2, 1.0, 3)),
    "taper": (lambda q: scenes.taper(6, q, precompression=0.5), jnp.linspace(-0.2, 0.2, 3)),
    "disordered": (lambda n: scenes.disordered(6, 0.3, n), jnp.arange(3)),
    "monomer, load": (lambda f: scenes.monomer(6, precompression=f), jnp.linspace(0.2, 1.0, 3)),
    "monomer, exponent": (lambda p: scenes.monomer(6, exponent=p), jnp.linspace(1.2, 3.0, 3)),
    "fput": (lambda a: scenes.fput(6, alpha=a), jnp.linspace(0.2, 1.0, 3)),
    "beads": (
        lambda r: scenes.beads(["brass", "PTFE"], [r, 2e-3], 2.0, cells=3),
        jnp.linspace(1e-3, 3e-3, 3),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("make, values", SWEPT.values(), ids=SWEPT.keys())
def test_a_batch_equals_a_loop_and_its_lanes_are_trailing(make, values):
    batch = jax.vmap(make, out_axes=-1)(values)
    assert batch.lanes == (3,) and batch.shape == (6,)
    u, v = random_state(batch)
    together = batch.acceleration(0.0, u, v)
    single = jnp.stack(
        [make(x).acceleration(0.0, u[:, i], v[:, i]) for i, x in enumerate(values)], -1
    )
    assert_allclose(together, single, rtol=1e-12, atol=1e-12 * float(jnp.abs(single).max()))


def test_gradient_with_respect_to_the_ratio():
    lattice = scenes.dimer(6, 0.4)
    u, v = random_state(lattice)
    slope = jax.jit(jax.jacfwd(lambda r: scenes.dimer(6, r).acceleration(0.0, u, v)))(0.4)
    # a = F/r on the light beads
    expected = -lattice.force(0.0, u, v) / 0.4**2 * jnp.array([0, 1, 0, 1, 0, 1])
    assert_allclose(slope, expected, rtol=1e-14)


def test_gradient_with_respect_to_a_radius_and_a_modulus():
    u, v = random_state(scenes.dimer(4), 1e-6)

    def loss(x):
        mine = Material("mine", x[0] * 1e9, 0.3, 2000.0)
        chain = scenes.beads([mine, "steel 316"], [x[1] * 1e-3, 1e-3], cells=2)
        return jnp.sum(chain.acceleration(0.0, u, v) ** 2) / 1e10

    x, step = jnp.array([3.0, 2.0]), 1e-5
    at = jax.jit(jax.vmap(loss))
    central = (at(x + step * jnp.eye(2)) - at(x - step * jnp.eye(2))) / (2 * step)
    assert_allclose(jax.jit(jax.grad(loss))(x), central, rtol=1e-8)


@pytest.mark.slow
def test_beads_in_si():
    R, F0, tau = np.array([2e-3, 3e-3, 1e-3]), 5.0, 2e-3
    names = ["brass", "PTFE", "steel 316"]
    chain = scenes.beads(names, R, F0, wall=("rigid", "nylon"), damping_time=tau)
    u, v = random_state(chain, 1e-5)
    m = np.array([float(bead_mass(n, r)) for n, r in zip(names, R)])
    A = np.array(
        [
            hertz_coefficient("brass", R[0], "rigid", np.inf),
            hertz_coefficient("brass", R[0], "PTFE", R[1]),
            hertz_coefficient("PTFE", R[1], "steel 316", R[2]),
            hertz_coefficient("steel 316", R[2], "nylon", np.inf),
        ]
    )
    e = -np.diff(np.concatenate([[0], np.asarray(u), [0]]))
    F = A * np.maximum((F0 / A) ** (2 / 3) + e, 0) ** 1.5
    assert_allclose(
        chain.acceleration(0.0, u, v), (F[:-1] - F[1:]) / m - np.asarray(v) / tau, rtol=1e-11
    )


@pytest.mark.parametrize(
    ("materials", "radii", "striker", "cells"),
    [
        ("PTFE", 2.38e-3, ("steel 316", 2.38e-3), 4),
        (["brass", "PTFE"], [2e-3, 1e-3], ("PTFE", 1e-3), 2),
        ("steel 316", [3e-3, 2e-3, 2e-3], ("steel 316", 5e-3), None),
    ],
)
def test_a_striker_hits_a_chain_before_a_wall(materials, radii, striker, cells):
    """Against DOP853 with forces of its own: contacts of unlike spheres, and the last bead on a plane."""
    R = np.append(striker[1], np.tile(np.ravel(radii), cells or 1))
    kinds = [striker[0], *(np.tile(np.ravel(materials), (R.size - 1) // np.size(materials)))]
    bodies = [gx.materials.material(str(kind)) for kind in kinds]
    m = np.array([4 / 3 * np.pi * r**3 * float(b.density) for r, b in zip(R, bodies)])
    softness = np.array([(1 - float(b.poisson) ** 2) / float(b.young) for b in bodies])
    A = 4 / 3 / (softness[:-1] + softness[1:]) * (1 / R[:-1] + 1 / R[1:]) ** -0.5
    A = np.append(A, 4 / 3 / (2 * softness[-1]) * R[-1] ** 0.5)

    def field(t, y):
        u, v = np.split(y, 2)
        f = A * np.maximum(u - np.append(u[1:], 0), 0) ** 1.5
        return np.concatenate([v, -np.diff(f, prepend=0) / m])

    chain = scenes.struck(materials, radii, striker, cells=cells)
    run = gx.simulate(chain, gx.states.impact(chain, velocity=0.5), 3e-4, tolerance=1e-10)
    start = np.append(np.zeros(R.size), 0.5 * (np.arange(R.size) == 0))
    known = ended(field, 3e-4, start)
    assert chain.units == "SI" and np.abs(known[R.size :]).max() > 0.05
    scale = np.repeat([1e4, 1], R.size)
    assert_allclose(scale * np.append(run.final.u, run.final.v), scale * known, atol=1e-7)
    assert_allclose(chain.mass, m, rtol=1e-13)


def test_cells_and_boundaries_of_beads():
    ring = scenes.beads(["brass", "PTFE"], [2e-3, 1e-3], cells=3, boundary="periodic")
    A = hertz_coefficient("brass", 2e-3, "PTFE", 1e-3)
    assert_allclose(ring.terms[0].law.stiffness, np.full(6, A), rtol=1e-15)
    long = scenes.beads(["brass", "PTFE"] * 3, np.tile([2e-3, 1e-3], 3))
    same_acceleration(scenes.beads(["brass", "PTFE"], [2e-3, 1e-3], cells=3), long)
    alike = scenes.beads("brass", 2e-3, cells=4)
    assert_allclose(
        alike.terms[0].law.stiffness,
        scenes.beads(["brass"] * 4, 2e-3).terms[0].law.stiffness,
        rtol=1e-15,
    )
    assert_allclose(alike.terms[0].law.stiffness[0], hertz_coefficient("brass", 2e-3, None, np.inf))


@pytest.mark.slow
@pytest.mark.parametrize(
    "chain, velocity",
    [
        (lambda: scenes.beads(["brass", "PTFE"], [2e-3, 1e-3], 3.0, cells=3), None),
        (lambda: scenes.beads(["brass", "PTFE"], [2e-3, 1e-3], cells=3, damping_time=1e-3), 0.5),
        (lambda: scenes.monomer(6, 1e-3, 1e-9, -3.0, 2.0), None),
    ],
)
def test_scaled_accelerations_are_those_in_si(chain, velocity):
    chain = chain()
    small, units = scenes.scaled(chain, velocity)
    u, v = random_state(small, 0.1)
    state = units.state_to_si(gx.State(u, v))
    a = small.acceleration(0.0, u, v) * units.acceleration
    scale = float(jnp.abs(a).max())
    assert_allclose(chain.acceleration(0.0, *state), a, rtol=1e-11, atol=1e-13 * scale)
    assert_allclose(chain.energy(0.0, *state), small.energy(0.0, u, v) * units.energy, rtol=1e-11)
    back = units.state_from_si(state)
    assert_allclose(back.u, u, rtol=1e-14)
    assert_allclose(back.v, v, rtol=1e-14)


def test_scaled_numbers_are_of_order_one():
    chain, units = scenes.scaled(
        scenes.beads("steel 316", 9.53e-3, 20.0, cells=10, boundary="free")
    )
    law = chain.terms[0].law
    assert_allclose(
        [chain.mass, law.stiffness, law.precompression, law.rest_overlap], 1.0, rtol=1e-13
    )
    chain, units = scenes.scaled(scenes.beads("steel 316", 9.53e-3, cells=10, boundary="free"), 0.5)
    assert_allclose([chain.mass, chain.terms[0].law.stiffness, units.velocity * 2], 1.0, rtol=1e-13)


def test_units_of_ones_own_and_their_products():
    units = scenes.Units(mass=2.0, length=3.0, time=0.5)
    assert (units.velocity, units.acceleration, units.force, units.energy, units.omega) == (
        6,
        12,
        24,
        72,
        2,
    )
    small = scenes.scaled(scenes.fput(5, stiffness=16.0), units=units).lattice
    assert_allclose(small.terms[0].law.K2, 16 / (24 / 3), rtol=1e-15)


def loaded():
    return scenes.beads("brass", 1e-3, 1.0, cells=3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "call, words",
    [
        (
            lambda: scenes.monomer(1),
            "sites: expected a whole number not below 2, got 1. A chain has",
        ),
        (
            lambda: scenes.monomer(9, boundary="fxed"),
            "boundary: expected one of .* Did you mean 'fixed'",
        ),
        (
            lambda: scenes.monomer(9, precompression=-1.0),
            "precompression: expected numbers not below zero",
        ),
        (
            lambda: scenes.monomer(9, stiffness=[1.0, 2.0]),
            "stiffness: expected one number, or one per contact, shape .10,",
        ),
        (
            lambda: scenes.dimer(9, ratio=1.2),
            r"ratio: expected numbers in \(0, 1\], got 1.2. The ratio",
        ),
        (lambda: scenes.dimer(9, ratio=[0.2, 0.3]), "^ratio: expected one number, .* jax.vmap"),
        (lambda: scenes.dimer(7, boundary="periodic"), "sites: expected a multiple of 2"),
        (lambda: scenes.trimer(9, (0.5, 2.0)), r"ratios\[1\]: expected numbers in \(0, 1\]"),
        (lambda: scenes.defects(9, {0: 0.5, -9: 0.7}), "masses: expected each site once"),
        (lambda: scenes.defects(9, {9: 1.0}), r"masses\[9\]: expected a site from 0 to 8"),
        (lambda: scenes.taper(9, 1.0), r"q: expected numbers in \(-1, 1\)"),
        (
            lambda: scenes.taper(9, boundary="periodic"),
            "boundary: expected 'fixed' or 'free' for a taper",
        ),
        (lambda: scenes.pattern(9, ()), "masses: expected"),
        (lambda: scenes.disordered(9, 1.0), r"spread: expected numbers in \[0, 1\)"),
        (lambda: scenes.disordered(9, 0.1, distribution="normal"), "distribution: expected one of"),
        (
            lambda: scenes.beads("stel 316", 1e-3, cells=4),
            "materials: expected one of .* Did you mean 'steel 316'",
        ),
        (lambda: scenes.beads("brass", 1e-3), "cells: expected at least two beads"),
        (
            lambda: scenes.beads(["brass"] * 3, [1e-3] * 2),
            "radii: expected as many radii as materials",
        ),
        (lambda: scenes.beads("brass", [1e-3, -1e-3]), "radii: expected numbers above zero"),
        (
            lambda: scenes.beads(["brass", "rigid"], 1e-3),
            "material: expected a material with a density",
        ),
        (
            lambda: scenes.beads("brass", 1e-3, cells=3, wall="brass", boundary="free"),
            "wall: expected None",
        ),
        (
            lambda: scenes.scaled(scenes.beads("brass", 1e-3, cells=3)),
            "velocity: expected the impact's speed",
        ),
        (lambda: scenes.scaled(scenes.toda(5)), "lattice: expected a Hertz or PowerLaw contact"),
        (lambda: scenes.scaled(loaded(), 1.0, units=scenes.Units()), "units: expected Units"),
        (
            lambda: gx.Lattice(np.ones(9), gx.Bond(gx.Shift(1), gx.Hertz([1.0, 2.0]))),
            "parameters that fit a lattice",
        ),
    ],
)
def test_bad_input_gets_a_sentence(call, words):
    with refused(words):
        call()


def test_float32():
    chain = scenes.dimer(6, 0.4, precompression=1.0).astype(jnp.float32)
    assert chain.mass.dtype == jnp.float32
    assert chain.acceleration(0.0, chain.zeros(), chain.zeros()).dtype == jnp.float32


def test_scaled_vectors_turn_with_their_bonds():
    chain = gx.Lattice(
        2e-3,
        (gx.Bond(gx.Stretch(gx.Shift(1, "periodic"), [3e-3, 0]), gx.Hertz(1e9, 2.0)),),
        sites=5,
        dimension=2,
    )
    small, units = scenes.scaled(chain)
    u, v = random_state(small, 0.5)
    a = chain.acceleration(0.0, *units.state_to_si(gx.State(u, v)))
    scaled_a = small.acceleration(0.0, u, v)
    assert_allclose(a / units.acceleration, scaled_a, atol=1e-11 * float(jnp.abs(scaled_a).max()))


def test_a_law_of_several_parts_fits_a_chain():
    law = gx.PowerLaw(1.0, 1.0, 0.0) + gx.PowerLaw(2.0, 3.0, 0.0)
    chain = gx.scenes.chain(6, 1.0, law, boundary="free")
    assert_allclose(chain.force(0.0, jnp.zeros(6).at[0].set(0.5), chain.zeros())[1], 0.75)
    each = gx.Hertz(np.ones(5)) + gx.Linear(1.0)
    assert gx.scenes.chain(6, 1.0, each, boundary="free").shape == (6,)
    with refused("Hertz.stiffness"):
        gx.scenes.chain(7, 1.0, each, boundary="free")
