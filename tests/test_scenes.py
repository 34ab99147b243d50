import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

import granjax as gx
from granjax import scenes
from granjax.materials import Material, bead_mass, hertz_coefficient

TWO = ["brass", "PTFE"], [2e-3, 1e-3]


def random_state(lattice, scale=0.3):
    u, v = scale * np.random.default_rng(0).standard_normal((2, *lattice.zeros().shape))
    return jnp.asarray(u), jnp.asarray(v)


def accelerated(lattice, scale=0.3):
    """The acceleration of a random state."""
    return lattice.acceleration(0.0, *random_state(lattice, scale))


def compressions(u):
    """Those of a chain between walls."""
    return -np.diff(np.concatenate([[0], np.asarray(u), [0]]))


def same_acceleration(first, second, rtol=1e-14):
    a = accelerated(first)
    b = accelerated(second)
    assert_allclose(a, b, rtol=rtol, atol=rtol * float(jnp.abs(a).max()))


@pytest.mark.slow
def test_preloads_of_neighbouring_contacts_balance():
    for lattice in (
        scenes.monomer(6, exponent=2.3, precompression=2.0, boundary="periodic"),
        scenes.monomer(6, exponent=-3, precompression=1.0),
        scenes.taper(9, 0.1, precompression=1.0),
        scenes.cradle(7, precompression=0.5, boundary="periodic"),
        scenes.fractional(7, 0.5, boundary="fixed"),
        scenes.beads(*TWO, 3.0, cells=3, damping_time=1e-3),
        scenes.scaled(scenes.beads("brass", 2e-3, 3.0, cells=5)).lattice,
    ):
        assert_array_equal(lattice.force(0.0, lattice.zeros(), lattice.zeros()), 0.0)
        assert_allclose(lattice.unbalanced(), 0.0, atol=1e-15)
        assert jnp.abs(accelerated(lattice, 1e-7)).max() > 0


def test_accelerations_are_the_equations_of_motion():
    for lattice, force, mass in (
        # u_n'' = [d0 + u_{n-1} - u_n]_+^{3/2} - [d0 + u_n - u_{n+1}]_+^{3/2}, Nesterenko (1983)
        (
            scenes.monomer(8, mass=2.0, stiffness=3.0, precompression=0.5),
            lambda e: 3 * np.maximum((0.5 / 3) ** (2 / 3) + e, 0) ** 1.5,
            2,
        ),
        (scenes.fput(8, alpha=0.25, beta=0.7), lambda e: e + 0.25 * e**2 + 0.7 * e**3, 1),
        (scenes.fput(8, beta=8.0), lambda e: e + 8 * e**3, 1),
        (scenes.toda(8, boundary="fixed"), np.exp, 1),
    ):
        F = force(compressions(random_state(lattice)[0]))
        assert_allclose(accelerated(lattice), (F[:-1] - F[1:]) / mass, rtol=1e-12)


def test_a_chain_of_a_law_is_its_equation():
    lattice = scenes.chain(
        8, 2.0, gx.Toda(0.7, 1.2), on_site=gx.Sine(0.3, 2.0), damping=0.1, units="SI"
    )
    u, v = random_state(lattice)
    F = 0.7 * np.expm1(1.2 * compressions(u))
    a = (F[:-1] - F[1:] - 0.3 / 2 * np.sin(2 * u)) / 2 - 0.1 * v
    assert_allclose(accelerated(lattice), a, rtol=1e-12)
    assert lattice.units == "SI"


def test_a_crystal_of_a_cell_of_ones_own():
    diagonals = tuple(scenes.Tie("a", "a", offset) for offset in ((1, 1), (1, -1)))
    cell = scenes.CrystalCell(((1.0, 0.0), (0.0, 1.0)), {"a": (0.0, 0.0)}, diagonals)
    lattice = scenes.crystal(cell, 3, 4, stiffness=(2.0, 3.0), spacing=0.5, boundary="free")
    assert lattice.shape == (3, 4, 2)
    u = jnp.zeros((3, 4, 2)).at[1, 1, 0].set(1e-7)
    force = lattice.force(0.0, u, 0 * u)
    # the springs make angles of 45 degrees with the displacement
    assert_allclose(force[1, 1], [-5e-7, 1e-7], atol=1e-12)
    assert_allclose(force[2, 2], [1e-7, 1e-7], atol=1e-12)
    with refused("n, m: expected 1 numbers of cells"):
        scenes.crystal(cell._replace(vectors=cell.vectors[:1]), 3, 4)


def test_what_a_scene_passes_on_is_named_where_it_is_wrong():
    for scene in (scenes.dimer, scenes.origami, scenes.woodpile, scenes.kagome, scenes.stub):
        with pytest.raises(TypeError, match="stifness"):
            scene(9, stifness=1.0)


def test_a_mass_that_is_one_number_stays_one_and_is_spread_on_request():
    square = scenes.square(2, mass=2.0)
    assert square.mass.size == 1
    assert_array_equal(gx.lattice.spread_mass(square), np.full((2, 2, 2), 2.0))
    assert_array_equal(gx.lattice.spread_mass(scenes.dimer(3, 0.5)), [1, 0.5, 1])
    beads = scenes.beads("brass", 1e-3, cells=50, boundary="free")
    for lattice in scenes.monomer(50, precompression=1.0), beads:
        assert lattice.mass.shape == () and lattice.terms[0].law.stiffness.shape == ()
    assert scenes.monomer(50).terms[0].law.precompression is None


def test_masses_of_the_patterns():
    for lattice, masses in (
        (scenes.dimer(5, 0.25), [1, 0.25, 1, 0.25, 1]),
        (scenes.trimer(5, (0.5, 0.25)), [1, 0.5, 0.25, 1, 0.5]),
        (scenes.n_to_one(5, 2, 0.5), [1, 1, 0.5, 1, 1]),
        (scenes.defects(5, {1: 3.0, -1: 4.0}, mass=2.0), [2, 3, 2, 2, 4]),
        (scenes.pattern(4, np.array([3.0, 2.0])), [3, 2, 3, 2]),
    ):
        assert_array_equal(lattice.mass, masses)


@pytest.mark.slow
def test_exponents():
    assert isinstance(scenes.dimer(5, exponent=1.5).terms[0].law, gx.Hertz)
    same_acceleration(scenes.monomer(6, exponent=jnp.asarray(1.5)), scenes.monomer(6), rtol=1e-13)


def test_a_taper_is_a_chain_of_spheres_of_one_material():
    q = 0.1
    R0 = 5e-3
    real = scenes.beads("PTFE", R0 * (1 - q) ** np.arange(7), boundary="free")
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


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [
        lambda x: scenes.defects(6, {2: x}),
        lambda x: scenes.taper(6, x - 0.5, precompression=0.5),
        lambda x: scenes.disordered(6, 0.3, (10 * x).astype(int)),
        lambda x: scenes.monomer(6, exponent=3 * x),
        lambda x: scenes.klein_gordon(6, x),
        lambda x: scenes.beads(TWO[0], [1e-3 * x, 2e-3], 2.0, cells=3),
    ],
    ids=["defect", "taper", "seed", "exponent", "coupling", "beads"],
)
def test_a_batch_equals_a_loop_and_its_lanes_are_trailing(make):
    values = jnp.array([0.2, 0.6, 0.9])
    batch = jax.vmap(make, out_axes=-1)(values)
    assert batch.lanes == (3,) and batch.shape == (6,)
    u, v = random_state(batch)
    single = [make(x).acceleration(0.0, u[:, i], v[:, i]) for i, x in enumerate(values)]
    largest = float(jnp.abs(jnp.array(single)).max())
    assert_allclose(accelerated(batch), jnp.stack(single, -1), rtol=1e-12, atol=1e-12 * largest)


def test_gradient_with_respect_to_a_radius_and_a_modulus():
    def loss(x):
        mine = Material("mine", x[0] * 1e9, 0.3, 2000.0)
        chain = scenes.beads([mine, "steel 316"], [x[1] * 1e-3, 1e-3], cells=2)
        return jnp.sum(accelerated(chain, 1e-6) ** 2) / 1e10

    x = jnp.array([3.0, 2.0])
    step = 1e-5
    at = jax.jit(jax.vmap(loss))
    central = (at(x + step * jnp.eye(2)) - at(x - step * jnp.eye(2))) / (2 * step)
    for slope in jax.grad(loss), jax.jacfwd(loss):
        assert_allclose(jax.jit(slope)(x), central, rtol=1e-8)


def contacts(bodies, radii):
    """Coefficients of the contacts of neighbours."""
    beads = list(zip(bodies, radii))
    return np.array([float(hertz_coefficient(*a, *b)) for a, b in zip(beads, beads[1:])])


@pytest.mark.slow
def test_beads_in_si():
    R = np.array([2e-3, 3e-3, 1e-3])
    F0 = 5.0
    tau = 2e-3
    names = ["brass", "PTFE", "steel 316"]
    chain = scenes.beads(names, R, F0, wall=("rigid", "nylon"), damping_time=tau)
    u, v = random_state(chain, 1e-5)
    m = np.array([float(bead_mass(n, r)) for n, r in zip(names, R)])
    A = contacts(["rigid", *names, "nylon"], [np.inf, *R, np.inf])
    F = A * np.maximum((F0 / A) ** (2 / 3) + compressions(u), 0) ** 1.5
    assert_allclose(accelerated(chain, 1e-5), (F[:-1] - F[1:]) / m - v / tau, rtol=1e-11)


@pytest.mark.slow
def test_a_striker_hits_a_chain_before_a_wall():
    """Forces of contacts of unlike spheres, and of the last bead on a plane, by their closed form."""
    R = np.array([5e-3, 2e-3, 1e-3, 2e-3, 1e-3])
    kinds = ["steel 316", "brass", "PTFE", "brass", "PTFE"]
    m = np.array([float(bead_mass(*bead)) for bead in zip(kinds, R)])
    A = contacts([*kinds, "PTFE"], [*R, np.inf])

    def field(u):
        f = A * np.maximum(u - np.append(u[1:], 0), 0) ** 1.5
        return -np.diff(f, prepend=0) / m

    chain = scenes.struck(*TWO, ("steel 316", 5e-3), cells=2)
    u, v = random_state(chain, 1e-5)
    assert chain.units == "SI"
    # every contact, that at the wall too, closes in one of the two
    for u in u, -u:
        assert_allclose(chain.acceleration(0.0, u, v), field(u), rtol=1e-11)
    assert_allclose(chain.mass, m, rtol=1e-13)


def test_cells_and_boundaries_of_beads():
    A = hertz_coefficient("brass", 2e-3, "PTFE", 1e-3)
    ring = scenes.beads(*TWO, cells=3, boundary="periodic")
    assert_allclose(ring.terms[0].law.stiffness, np.full(6, A), rtol=1e-15)
    long = scenes.beads(3 * TWO[0], 3 * TWO[1])
    same_acceleration(scenes.beads(*TWO, cells=3), long)


@pytest.mark.slow
def test_scaled_accelerations_are_those_in_si():
    chain = scenes.beads(*TWO, 3.0, cells=3, damping_time=1e-3)
    small, units = scenes.scaled(chain)
    state = gx.State(*random_state(small, 0.1))
    si = units.state_to_si(state)
    a = accelerated(small, 0.1) * units.acceleration
    atol = 1e-13 * float(jnp.abs(a).max())
    assert_allclose(chain.acceleration(0.0, *si), a, rtol=1e-11, atol=atol)
    assert_allclose(chain.energy(0.0, *si), small.energy(0.0, *state) * units.energy, rtol=1e-11)
    assert_allclose(units.state_from_si(si), state, rtol=1e-14)


def test_scaled_numbers_are_of_order_one():
    steel = dict(materials="steel 316", radii=9.53e-3, cells=10, boundary="free")
    for chain in (
        scenes.beads(**steel, precompression=20.0),
        scenes.monomer(6, 1e-3, 1e-9, exponent=-3.0, precompression=2.0),
    ):
        small = scenes.scaled(chain).lattice
        law = small.terms[0].law
        numbers = [small.mass, law.stiffness, law.precompression, law.rest_overlap]
        assert_allclose(numbers, 1.0, rtol=1e-13)
    small, units = scenes.scaled(scenes.beads(**steel), 0.5)
    assert_allclose([small.mass, small.terms[0].law.stiffness, units.velocity * 2], 1.0, rtol=1e-13)


def test_units_of_ones_own_and_their_products():
    units = scenes.Units(mass=2.0, length=3.0, time=0.5)
    products = units.velocity, units.acceleration, units.force, units.energy, units.omega
    assert products == (6, 12, 24, 72, 2)
    small = scenes.scaled(scenes.fput(5, stiffness=16.0), units=units).lattice
    assert_allclose(small.terms[0].law.K2, 16 / (24 / 3), rtol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: scenes.monomer(1), "sites: expected a whole number not below 2, got 1"),
        (lambda: scenes.monomer(9, stiffness=[1.0, 2.0]), "one per contact, shape .10,"),
        (lambda: scenes.dimer(9, ratio=1.2), r"ratio: expected numbers in \(0, 1\], got 1.2"),
        (lambda: scenes.dimer(9, ratio=[0.2, 0.3]), "^ratio: expected one number, .* jax.vmap"),
        (lambda: scenes.dimer(7, boundary="periodic"), "sites: expected a multiple of 2"),
        (lambda: scenes.defects(9, {0: 0.5, -9: 0.7}), "masses: expected each site once"),
        (lambda: scenes.defects(9, {9: 1.0}), r"masses\[9\]: expected a site from 0 to 8"),
        (lambda: scenes.taper(9, boundary="periodic"), "boundary: expected 'fixed' or 'free'"),
        (lambda: scenes.pattern(9, ()), "masses: expected"),
        (lambda: scenes.disordered(9, 1.0), r"spread: expected numbers in \[0, 1\)"),
        (lambda: scenes.beads("brass", 1e-3), "cells: expected at least two beads"),
        (lambda: scenes.beads(["brass"] * 3, TWO[1]), "radii: expected as many radii as materials"),
        (lambda: scenes.beads(*TWO, wall="brass", boundary="free"), "wall: expected None"),
        (lambda: scenes.scaled(scenes.beads(*TWO)), "velocity: expected the impact's speed"),
        (lambda: scenes.scaled(scenes.toda(5)), "lattice: expected a Hertz or PowerLaw contact"),
        (
            lambda: scenes.scaled(scenes.beads(*TWO, 1.0), 1.0, units=scenes.Units()),
            "units: expected Units",
        ),
    ],
)
def test_bad_input_gets_a_sentence(call, words):
    with refused(words):
        call()


def test_a_law_of_several_parts_fits_a_chain():
    law = gx.PowerLaw(1.0, 1.0, 0.0) + gx.PowerLaw(2.0, 3.0, 0.0)
    chain = scenes.chain(6, 1.0, law, boundary="free")
    assert_allclose(chain.force(0.0, jnp.zeros(6).at[0].set(0.5), chain.zeros())[1], 0.75)
    each = gx.Hertz(np.ones(5)) + gx.Linear(1.0)
    assert scenes.chain(6, 1.0, each, boundary="free").shape == (6,)
    with refused("Hertz.stiffness"):
        scenes.chain(7, 1.0, each, boundary="free")
