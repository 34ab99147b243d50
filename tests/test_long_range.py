"""Bonds to all neighbours: by FFT as by the direct sum, in every boundary; magnets."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from scipy.optimize import fsolve
from scipy.special import gamma

import granjax as gx
from granjax.first_order.coupling import of_order
from granjax.lattice import linearised
from granjax.terms.energies import energy_gap

N = 14
M = 30
KERNEL = np.arange(1.0, M + 1) ** -2.5
LAWS = {"polynomial": gx.Polynomial(1.1, -0.4, 0.3), "magnets": gx.PowerLaw(1.0, -3.0, 200.0)}


def pairs(boundary):
    """(tail, head, offset) of every bond of the term; -1 for a site at rest beyond the chain."""
    for m in range(1, M + 1):
        for n in range(-m, N):
            ends = [(n, n + m), (n, (n + m) % N)][boundary == "periodic"]
            inside = [0 <= i < N for i in ends]
            if all(inside) or boundary == "fixed" and any(inside):
                yield *(i if here else -1 for i, here in zip(ends, inside)), m


def direct(law, u, boundary, takes):
    """Forces and energy, bond by bond."""
    tail, head, m = np.array(list(pairs(boundary))).T
    x = np.append(u, 0.0)
    share = m if takes == "strain" else 1
    e = jnp.asarray((x[tail] - x[head]) / share)
    push = KERNEL[m - 1] * np.asarray(law.force(e))
    f = np.zeros(N + 1)
    np.add.at(f, tail, -push)
    np.add.at(f, head, push)
    return f[:N], np.sum(KERNEL[m - 1] * np.asarray(law.energy(e)) * share)


def lattice_of(law, boundary, takes="displacement", kernel=KERNEL):
    return gx.Lattice(1.0, gx.LongRange(kernel, law, boundary, takes=takes), sites=N)


@pytest.mark.slow
@pytest.mark.parametrize("boundary", ["free", "fixed", "periodic"])
@pytest.mark.parametrize("name, takes", [("polynomial", "displacement"), ("magnets", "strain")])
def test_as_the_direct_sum_with_gradient_and_tangents(name, takes, boundary):
    lattice = lattice_of(LAWS[name], boundary, takes)
    random = np.random.default_rng(3)
    u = jnp.asarray(0.02 * random.normal(size=N))
    W = jnp.asarray(random.normal(size=(N, 2)))

    @jax.jit
    def found(u):
        force = lambda u: lattice.force(0.0, u, 0 * u)
        tangents = linearised(lattice, 0.0, u).force(0.0, W, 0 * W)
        energy = jax.value_and_grad(lambda u: lattice.potential_energy(0.0, u))(u)
        kept = lattice.for_run().force(0.0, u, 0 * u)
        return *energy, force(u), kept, jax.jacfwd(force)(u), tangents

    energy, slope, own, kept, K, tangents = found(u)
    sums = lambda u: direct(LAWS[name], np.asarray(u), boundary, takes)
    force, stored = sums(u)
    size = np.abs(force).max()
    assert max(np.abs(own - force).max(), np.abs(kept - force).max()) < 1e-13 * size
    assert np.abs(slope + force).max() < 1e-13 * size
    assert abs(energy - stored) < 1e-13 * stored
    assert_allclose(tangents, K @ W, rtol=0, atol=1e-13 * np.abs(K @ W).max())
    columns = [(sums(u + 1e-6 * e)[0] - sums(u - 1e-6 * e)[0]) / 2e-6 for e in np.eye(N)]
    assert_allclose(K, np.stack(columns, -1), rtol=0, atol=1e-8 * np.abs(K).max())


@pytest.mark.slow
def test_a_factor_of_the_kernel_or_of_the_law_is_one_chain_with_one_step():
    steps = set()
    for c in 1.0, 0.01:
        chain = lattice_of(gx.Polynomial(1 / c, 0.0, 1 / c), "fixed", "strain", c * KERNEL)
        run = gx.simulate(chain, gx.states.impact(chain, velocity=5.0), 1.0)
        steps.add(int(run.stats["steps"]))
    assert len(steps) == 1


def long_range_force(boundary):
    lattice = lattice_of(LAWS["polynomial"], boundary)
    return lambda u: lattice.force(0.0, u, 0 * u)


def energy_gradient(u):
    return jax.grad(lambda u: lattice_of(LAWS["polynomial"], "free").potential_energy(0.0, u))(u)


def phases_of_light(x):
    return of_order(N, jnp.asarray(0.6), "free")(x + 0j).real


def packet(p):
    ring = gx.scenes.fput(N, boundary="periodic")
    return gx.states.wave_packet(ring, k=1.0, width=3.0, amplitude=1 + p[0]).v * (1 + p)


@pytest.mark.slow
@pytest.mark.parametrize(
    "function",
    [*map(long_range_force, ("free", "fixed", "periodic")), energy_gradient]
    + [pytest.param(f, marks=pytest.mark.slow) for f in (phases_of_light, packet)],
)
def test_lapack_in_the_same_program_as_transforms(function):
    """XLA lets LAPACK's columns decide the layout of what its transforms then refuse."""
    x, W = 0.02 * np.random.default_rng(5).normal(size=(2, N, N))
    x = jnp.asarray(x[0])
    over_lanes = jax.vmap(function, -1, -1)

    @jax.jit
    def found(x, W):
        forward = jax.jacfwd(function)(x)
        reverse = jax.jacrev(function)(x)
        spectra = [jnp.linalg.eigvalsh(K + K.T) for K in (forward, reverse)]
        solved = jnp.linalg.solve(reverse - 9 * jnp.eye(N), x)
        return spectra, solved, jnp.linalg.eigvals(over_lanes(W) / 0.02)

    # the same in two programs, of which the second has no transform
    J = np.asarray(jax.jit(jax.jacfwd(function))(x))
    pushed = np.asarray(jax.jit(over_lanes)(W))
    spectra, solved, values = found(x, W)
    for squares in spectra:
        true = np.linalg.eigvalsh(J + J.T)
        assert_allclose(squares, true, rtol=0, atol=1e-12 * np.abs(J).max())
    assert_allclose(solved, np.linalg.solve(J - 9 * np.eye(N), x), rtol=0, atol=1e-12)
    true = np.linalg.eigvals(pushed / 0.02)
    assert np.abs(np.asarray(values)[:, None] - true).min(1).max() < 1e-10


@pytest.mark.slow
def test_orbits_of_a_fractional_chain_against_dense_matrices():
    chain = gx.scenes.fractional_sine_gordon(12, 0.7, 0.3, boundary="free")
    m = np.arange(1, 12)
    size = 0.3 * 4**0.7 * gamma(1.2) / np.sqrt(np.pi) / abs(gamma(-0.7))
    weights = np.append(0.0, size * gamma(m - 0.7) / gamma(m + 1.7))
    K = -weights[np.abs(np.subtract.outer(range(12), range(12)))]
    K += np.eye(12) - np.diag(K.sum(1))
    omega = np.sqrt(np.linalg.eigvalsh(K))
    assert_allclose(gx.linear.normal_modes(chain).omega, omega, rtol=1e-12)
    angles = np.angle(gx.floquet.floquet(chain, gx.states.rest(chain), period=1.0).multipliers)
    assert_allclose(np.sort(np.abs(angles))[::2], omega, rtol=1e-8)
    loads = 0.1 * np.sin(np.arange(12))
    u = fsolve(lambda u: K @ u - u + np.sin(u) - loads, np.zeros(12), xtol=1e-13)
    assert_allclose(gx.equilibrium(chain, loads=loads).state.u, u, rtol=0, atol=1e-11)
    scene = lambda s: gx.scenes.fractional_sine_gordon(12, s, 0.3, boundary="free")
    lanes = jax.vmap(scene, out_axes=-1)(jnp.array([0.7, 0.9]))
    x = 0.3 * np.cos(np.arange(12.0))
    pushed = lanes.force(0.0, jnp.stack([x, x], -1), jnp.zeros((12, 2)))
    assert_allclose(pushed[:, 0], -(K @ x - x + np.sin(x)), rtol=0, atol=1e-13)


def test_a_uniform_displacement_costs_no_accuracy():
    u = jnp.round(2.0**26 * np.random.default_rng(4).normal(size=N)) / 2.0**30
    lattice = lattice_of(LAWS["polynomial"], "free")
    far = lattice.force(0.0, u + 2.0**20, 0 * u)
    assert_allclose(far, lattice.force(0.0, u, 0 * u), rtol=0, atol=1e-13 * np.abs(far).max())


class Circling(gx.Term):
    """Springs from each site to the one before it alone, which no energy has, with one all the same."""

    def force(self, t, u, v, mass):
        return jnp.roll(u, 1, 0) - u

    def energy(self, t, u):
        return (jnp.roll(u, 1, 0) - u) ** 2 / 2


@pytest.mark.parametrize(
    "lattice",
    [
        gx.Lattice(1.0, gx.LongRange(KERNEL, LAWS["polynomial"], "periodic"), sites=37),
        gx.scenes.fractional(37, 0.8, boundary="free"),
    ],
)
def test_uniform_motion_is_not_taken_for_a_force_without_energy(lattice):
    """What is left of a force is its rounding there; a force that has no energy is found all the same, far away too."""
    gap = jax.jit(lambda u: energy_gap(lattice.terms[0], lattice, 0.0, u))
    assert max(float(gap(jnp.full(37, x))) for x in np.linspace(0.1, 9.0, 23)) < 1e-9
    waves = 3.0 + 0.1 * jnp.cos(jnp.arange(37.0))
    assert gap(waves) < 1e-9 and energy_gap(Circling(), lattice, 0.0, waves) > 1e-3


def test_the_bands_of_an_algebraic_kernel():
    kernel = np.arange(1.0, 10) ** -3
    lattice = gx.Lattice(1.0, gx.LongRange(kernel, gx.Linear(1.3), "periodic"), sites=20)
    k = np.linspace(0.1, 3.0, 7)
    m = np.arange(1, 10)
    squared = 2 * 1.3 * np.sum(kernel * (1 - np.cos(np.multiply.outer(k, m))), -1)
    assert_allclose(gx.linear.dispersion(lattice, k).omega_squared[:, 0], squared, rtol=1e-13)


def test_one_neighbour_pushes_the_ends_as_in_a_chain():
    lattice = gx.Lattice(1.0, gx.LongRange([0.7], gx.Hertz(1.2, 0.3), "free"), sites=N)
    plain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), gx.Hertz(0.7 * 1.2, 0.7 * 0.3)), sites=N)
    assert_allclose(lattice.unbalanced(), plain.unbalanced(), rtol=1e-13)


def test_refusals():
    with refused("kernel: expected a row of weights"):
        gx.LongRange(1.0, gx.Linear())
    with refused("boundary: expected one of"):
        gx.LongRange([1.0], gx.Linear(), "open")
    with refused("same for all bonds"):
        gx.Lattice(1.0, gx.LongRange([1.0, 0.5], gx.Linear([1.0, 2.0])), sites=2)
    with refused("a chain"):
        gx.Lattice(1.0, gx.LongRange([1.0, 0.5], gx.Linear()), sites=(3, 3))


@pytest.mark.slow
def test_what_a_run_keeps_gives_the_same_forces_lane_by_lane():
    u = jnp.asarray(0.02 * np.random.default_rng(5).normal(size=(N, 2)))
    kernel = lambda s: jnp.arange(1.0, M + 1) ** -s
    made = lambda s: lattice_of(LAWS["polynomial"], "free", kernel=kernel(s))
    lanes, others = jnp.asarray([[2.5, 3.5], [3.0, 2.0]])
    batch, other = (jax.vmap(made, out_axes=-1)(s) for s in (lanes, others))
    force = batch.force(0.0, u, u)
    kept = batch.for_run().force(0.0, u, u)
    assert_allclose(kept, force, rtol=0, atol=1e-14 * jnp.abs(force).max())
    for lane, s in enumerate(lanes):
        alone = made(s).force(0.0, u[:, lane], u[:, lane])
        assert_allclose(force[:, lane], alone, rtol=0, atol=1e-13 * jnp.abs(alone).max())
    # another kernel in place of the first is that which counts: in a run, and in its derivative
    final = lambda lattice: gx.simulate(lattice, gx.State(u, 0 * u), 0.5, step=0.1).final.u
    end = lambda k: final(eqx.tree_at(lambda x: x.terms[0].kernel, batch, k))
    k = kernel(others[:, None]).T
    np.testing.assert_array_equal(end(k), final(other))
    way = jnp.zeros_like(k).at[2].set(1.0)
    h = 1e-5
    slope = jax.jvp(end, (k,), (way,))[1]
    difference = (end(k + h * way) - end(k - h * way)) / (2 * h)
    assert_allclose(slope, difference, rtol=0, atol=1e-8 * jnp.abs(slope).max())


@pytest.mark.slow
@pytest.mark.parametrize("s", [2.5, 4.0])
def test_a_breather_has_the_tail_of_its_springs(s):
    """Of hardening springs m^-s about a light mass; docs/gallery/long_range.py shows it for m^-3."""
    mass = np.where(np.arange(101) == 50, 0.4, 1.0)
    n = np.arange(20, 46)
    chain = gx.scenes.long_range(101, s, mass=mass, beta=1.0)
    modes = gx.linear.normal_modes(chain)
    start = gx.State(0.3 * modes.modes[:, -1] / modes.modes[50, -1], chain.zeros())
    orbit = gx.breathers.breather(chain, 1.02 * float(modes.omega[-1]), start, steps=32)
    u = np.abs(np.asarray(orbit.state.u))
    # two per cent above the mode of small displacements
    assert orbit.residual < 1e-11 and u.max() > 0.15
    assert abs(np.polyfit(np.log(n), np.log(u[50 + n]), 1)[0] + s) < 0.05


@pytest.mark.slow
def test_magnets_that_meet_are_named():
    chain = gx.scenes.magnets(6, -4.0)
    hit = gx.states.impact(chain, velocity=40.0, site=3)
    run = gx.simulate(chain, hit, 1.0, step=0.2, throw=False)
    # bond 0 is that at the left end; site 3 flies to the right
    assert run.met[:2] == (4, 0) and 0 <= run.met[2] <= 0.2 and run.met[3] == ()
    assert "Magnets met in bond 4 of terms[0]" in run.outcome


@pytest.mark.slow
def test_magnets_that_meet_in_a_lane_in_si_and_by_adaptive_steps():
    magnets = lambda A, **how: gx.scenes.magnets(8, -0.5, stiffness=A, reach=1, **how)
    batch = jax.vmap(magnets, out_axes=-1)(jnp.asarray([1e3, 1.0, 1e-3]))
    start = gx.State(batch.zeros(), batch.zeros().at[3].set(2.0))
    run = gx.simulate(batch, start, 1.0, step=0.01, throw=False)
    assert run.met[0] == 4 and run.met[3] == (2,) and "of lane 2" in run.outcome
    assert abs(run.met[2] - 0.5) < 0.01
    run = gx.simulate(batch, start, 1.0, tolerance=1e-6, throw=False)
    assert run.met[0] == 4 and abs(run.met[2] - 0.5) < 0.01 and "Lane 2: Magnets met" in run.outcome
    small = magnets(1e-6, spacing=0.02, mass=1e-3, units="SI")
    hit = gx.states.impact(small, velocity=2.0, site=3)
    run = gx.simulate(small, hit, 1.0, step=1e-4, throw=False)
    assert run.met[0] == 4 and abs(run.met[2] - 0.01) < 1e-4


@pytest.mark.parametrize("reach", [3, 12])
def test_a_state_in_single_precision_meets_forces_in_double(reach):
    ring = gx.scenes.magnets(30, reach=reach, boundary="periodic")
    state = gx.State(*jnp.zeros((2, 30), "float32").at[0, 4].set(0.125))
    same = gx.State(*(x.astype(float) for x in state))
    found = gx.vector_field(0.0, state, ring)[1]
    assert found.dtype == float
    assert_allclose(found, gx.vector_field(0.0, same, ring)[1], rtol=0, atol=1e-6)
