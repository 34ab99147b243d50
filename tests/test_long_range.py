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

N, M = 14, 30
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
    e = (x[tail] - x[head]) / (m if takes == "strain" else 1)
    push = KERNEL[m - 1] * np.asarray(law.force(jnp.asarray(e)))
    f = np.zeros(N + 1)
    np.add.at(f, tail, -push)
    np.add.at(f, head, push)
    stored = (
        KERNEL[m - 1] * np.asarray(law.energy(jnp.asarray(e))) * (m if takes == "strain" else 1)
    )
    return f[:N], stored.sum()


def lattice_of(law, boundary, takes="displacement", kernel=KERNEL):
    return gx.Lattice(1.0, gx.LongRange(kernel, law, boundary, takes=takes), sites=N)


@pytest.mark.parametrize("boundary", ["free", "fixed", "periodic"])
@pytest.mark.parametrize(
    "name, takes", [("polynomial", "displacement"), ("polynomial", "strain"), ("magnets", "strain")]
)
def test_as_the_direct_sum_with_gradient_and_tangents(name, takes, boundary):
    lattice, random = lattice_of(LAWS[name], boundary, takes), np.random.default_rng(3)
    u, W = jnp.asarray(0.02 * random.normal(size=N)), jnp.asarray(random.normal(size=(N, 2)))

    @jax.jit
    def found(u):
        force = lambda u: lattice.force(0.0, u, 0 * u)
        energy, slope = jax.value_and_grad(lambda u: lattice.potential_energy(0.0, u))(u)
        return (
            energy,
            slope,
            force(u),
            jax.jacfwd(force)(u),
            linearised(lattice, 0.0, u).force(0.0, W, 0 * W),
        )

    energy, slope, own, K, tangents = found(u)
    force, stored = direct(LAWS[name], np.asarray(u), boundary, takes)
    size = np.abs(force).max()
    assert np.abs(own - force).max() < 1e-13 * size
    assert np.abs(slope + force).max() < 1e-13 * size
    assert abs(energy - stored) < 1e-13 * stored
    assert_allclose(tangents, K @ W, rtol=0, atol=1e-13 * np.abs(K @ W).max())


@pytest.mark.parametrize("boundary", ["free", "fixed", "periodic"])
def test_lapack_in_the_same_program_as_the_transforms(boundary):
    """XLA lets LAPACK's columns decide the layout of what its transforms then refuse."""
    lattice, random = lattice_of(LAWS["polynomial"], boundary), np.random.default_rng(5)
    u, W = jnp.asarray(0.02 * random.normal(size=N)), jnp.asarray(0.02 * random.normal(size=(N, N)))
    force = lambda u: lattice.force(0.0, u, 0 * u)
    forces = lambda W: jnp.linalg.eigvals(jax.vmap(force, -1, -1)(W) / 0.02)

    @jax.jit
    def found(u, W):
        forward, reverse = jax.jacfwd(force)(u), jax.jacrev(force)(u)
        hessian = jax.hessian(lambda u: lattice.potential_energy(0.0, u))(u)
        spectra = [jnp.linalg.eigvalsh((K + K.T) / 2) for K in (-forward, -reverse, hessian)]
        return forward, spectra, jnp.linalg.solve(reverse - jnp.eye(N), u), forces(W)

    K, spectra, solved, lanes = found(u, W)
    columns = [
        direct(LAWS["polynomial"], np.asarray(u) + 1e-6 * e, boundary, "displacement")[0]
        - direct(LAWS["polynomial"], np.asarray(u) - 1e-6 * e, boundary, "displacement")[0]
        for e in np.eye(N)
    ]
    dense = np.stack(columns, -1) / 2e-6
    assert_allclose(K, dense, rtol=0, atol=1e-8 * np.abs(dense).max())
    for squares in spectra:
        assert_allclose(
            squares, np.linalg.eigvalsh(-dense), rtol=0, atol=1e-8 * np.abs(dense).max()
        )
    assert_allclose(solved, np.linalg.solve(dense - np.eye(N), u), rtol=0, atol=1e-9)
    pushed = [direct(LAWS["polynomial"], w, boundary, "displacement")[0] for w in np.asarray(W).T]
    wanted = np.linalg.eigvals(np.stack(pushed, -1) / 0.02)
    assert np.abs(np.asarray(lanes)[:, None] - wanted).min(1).max() < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("name", ["phases of light", "packet"])
def test_lapack_beside_other_transforms(name):
    if name == "phases of light":
        coupling = of_order(12, jnp.asarray(0.6), "free")
        function, x = lambda x: coupling(x + 0j).real, jnp.linspace(0, 1, 12)
    else:
        ring = gx.scenes.fput(12, boundary="periodic")
        function = lambda p: gx.states.wave_packet(ring, k=1.0, width=3.0, amplitude=p[0]).v * p
        x = jnp.linspace(1, 2, 12)
    # the same in two programs, of which the second has no transform
    J = np.asarray(jax.jacfwd(function)(x))
    squares = jax.jit(
        lambda x: jnp.linalg.eigvalsh(jax.jacfwd(function)(x) + jax.jacfwd(function)(x).T)
    )(x)
    assert_allclose(squares, np.linalg.eigvalsh(J + J.T), rtol=0, atol=1e-12 * np.abs(J).max())


@pytest.mark.slow
def test_orbits_of_a_fractional_chain_against_dense_matrices():
    chain = gx.scenes.fractional_sine_gordon(12, 0.7, 0.3, boundary="free")
    m = np.arange(1, 12)
    weights = (
        0.3
        * 4**0.7
        * gamma(1.2)
        / np.sqrt(np.pi)
        / abs(gamma(-0.7))
        * gamma(m - 0.7)
        / gamma(m + 1.7)
    )
    K = -np.concatenate([[0.0], weights])[np.abs(np.subtract.outer(range(12), range(12)))]
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


UNIFORM = {
    "quartic": lambda n: gx.Lattice(
        1.0, gx.LongRange(KERNEL, gx.Polynomial(1.0, 0.3, 0.2), "periodic"), sites=n
    ),
    "odd": lambda n: gx.Lattice(
        0.7, gx.LongRange(KERNEL, gx.Polynomial(1.0, 0.0, 0.5), "periodic"), sites=n
    ),
    "free": lambda n: gx.scenes.fractional(n, 0.8, boundary="free"),
    "fractional": lambda n: gx.scenes.fractional_fput(n, 0.6, boundary="periodic"),
}


class Circling(gx.Term):
    """Springs from each site to the one before it alone, which no energy has, with one all the same."""

    def force(self, t, u, v, mass):
        return jnp.roll(u, 1, 0) - u

    def energy(self, t, u):
        return (jnp.roll(u, 1, 0) - u) ** 2 / 2


@pytest.mark.parametrize("case", UNIFORM)
def test_uniform_motion_is_not_taken_for_a_force_without_energy(case):
    """What is left of a force is its rounding there; a force that has no energy is found all the same, far away too."""
    lattice = UNIFORM[case](37)
    gap = jax.jit(lambda u: energy_gap(lattice.terms[0], lattice, 0.0, u))
    assert max(float(gap(jnp.full(37, x))) for x in np.linspace(0.1, 9.0, 23)) < 1e-9
    with_waves = 3.0 + 0.1 * jnp.cos(jnp.arange(37.0))
    assert (
        float(gap(with_waves)) < 1e-9
        and float(energy_gap(Circling(), lattice, 0.0, with_waves)) > 1e-3
    )


def test_the_bands_of_an_algebraic_kernel():
    kernel = np.arange(1.0, 10) ** -3
    lattice = gx.Lattice(1.0, gx.LongRange(kernel, gx.Linear(1.3), "periodic"), sites=20)
    k = np.linspace(0.1, 3.0, 7)
    m = np.arange(1, 10)
    squared = 2 * 1.3 * np.sum(kernel * (1 - np.cos(np.multiply.outer(k, m))), -1)
    assert_allclose(gx.linear.dispersion(lattice, k).omega_squared[:, 0], squared, rtol=1e-13)


def test_one_neighbour_is_a_chain():
    lattice = gx.Lattice(1.0, gx.LongRange([0.7], gx.Hertz(1.2, 0.3), "free"), sites=N)
    plain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), gx.Hertz(0.7 * 1.2, 0.7 * 0.3)), sites=N)
    u = jnp.asarray(0.05 * np.random.default_rng(4).normal(size=N))
    assert_allclose(lattice.force(0.0, u, u), plain.force(0.0, u, u), rtol=1e-12, atol=1e-15)
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
@pytest.mark.parametrize("boundary", ["free", "periodic"])
def test_what_a_run_keeps_gives_the_same_forces_lane_by_lane(boundary):
    u = jnp.asarray(0.02 * np.random.default_rng(5).normal(size=(N, 2)))

    def made(s):
        return lattice_of(
            gx.Polynomial(1.1, -0.4, 0.3), boundary, kernel=jnp.arange(1.0, M + 1) ** -s
        )

    lanes, other = jnp.asarray([2.5, 3.5]), jnp.asarray([3.0, 2.0])
    batch = jax.vmap(made, out_axes=-1)(lanes)
    force = batch.force(0.0, u, u)
    assert_allclose(
        batch.for_run().force(0.0, u, u), force, rtol=0, atol=1e-14 * jnp.abs(force).max()
    )
    for lane, s in enumerate(lanes):
        alone = made(s).force(0.0, u[:, lane], u[:, lane])
        assert_allclose(force[:, lane], alone, rtol=0, atol=1e-13 * jnp.abs(alone).max())
    # another kernel in place of the first is that which counts: in a run, and in its derivative
    new = eqx.tree_at(lambda x: x.terms[0].kernel, batch, jnp.arange(1.0, M + 1)[:, None] ** -other)

    def end(kernel, u):
        lattice = eqx.tree_at(lambda x: x.terms[0].kernel, batch, kernel)
        return gx.simulate(lattice, gx.State(u, 0 * u), 0.5, step=0.1).final.u

    kernel = new.terms[0].kernel
    fresh = jax.vmap(made, out_axes=-1)(other)
    np.testing.assert_array_equal(
        end(kernel, u), gx.simulate(fresh, gx.State(u, 0 * u), 0.5, step=0.1).final.u
    )
    way, h = jnp.zeros_like(kernel).at[2].set(1.0), 1e-5
    slope = jax.jvp(lambda k: end(k, u), (kernel,), (way,))[1]
    assert_allclose(
        slope,
        (end(kernel + h * way, u) - end(kernel - h * way, u)) / (2 * h),
        rtol=0,
        atol=1e-8 * jnp.abs(slope).max(),
    )


def tail_of_a_breather(s, sites, first, last, reach=None):
    """(orbit, log-log slope of its tail) of a breather of hardening springs m^-s about a light mass."""
    centre = sites // 2
    chain = gx.scenes.long_range(
        sites, s, mass=np.where(np.arange(sites) == centre, 0.4, 1.0), beta=1.0, reach=reach
    )
    modes = gx.linear.normal_modes(chain)
    start = gx.State(0.3 * modes.modes[:, -1] / modes.modes[centre, -1], chain.zeros())
    orbit = gx.breathers.breather(chain, 1.02 * float(modes.omega[-1]), start, steps=32)
    n = np.arange(first, last + 1)
    return orbit, np.polyfit(np.log(n), np.log(np.abs(np.asarray(orbit.state.u))[centre + n]), 1)[0]


@pytest.mark.slow
def test_a_nonlinear_breather_has_the_tail_of_its_springs():
    orbit, slope = tail_of_a_breather(3.0, 101, 20, 45)
    assert abs(slope + 3) < 0.05
    assert orbit.residual < 1e-11
    # two per cent above the mode of small displacements
    assert np.max(np.abs(orbit.state.u)) > 0.15
    cut, steep = tail_of_a_breather(3.0, 101, 20, 25, reach=1)
    u = np.abs(np.asarray(cut.state.u))[50:]
    assert np.ptp(np.log(u[3:13:2] / u[5:15:2])) < 0.05 and u[15] < 1e-6 * u[0]


@pytest.mark.study
@pytest.mark.slow
@pytest.mark.parametrize("s", [2.5, 3.0, 4.0])
def test_a_breather_has_the_tail_of_its_springs_from_20_to_200_sites(s):
    orbit, slope = tail_of_a_breather(s, 451, 20, 200)
    assert abs(slope + s) < 0.05 and orbit.residual < 1e-11


def light_magnet(sites, mass=0.4):
    """A chain of dipoles with a light one in the middle; the frequency and shape of its mode."""
    chain = gx.scenes.magnets(sites, -4.0, mass=np.where(np.arange(sites) == sites // 2, mass, 1.0))
    modes = gx.linear.normal_modes(chain)
    return chain, float(modes.omega[-1]), modes


@pytest.mark.study
def test_a_light_magnet_that_is_driven_carries_a_breather():
    chain, omega, modes = light_magnet(11)
    driven = gx.Lattice(
        chain.mass, (*chain.terms, gx.Damping(0.02), gx.Drive(gx.Harmonic(0.004, 1.01 * omega), 5))
    )
    orbit = gx.forced.forced_orbit(driven, 2 * np.pi / (1.01 * omega), steps=48)
    v = np.abs(np.asarray(orbit.run(8).vs)).max(0)
    assert float(modes.omega[-2]) < 0.85 * omega and orbit.floquet().verdict == "stable"
    # each magnet moves by less than a third of the one before, to the ends
    assert (v[1:6] > 3 * v[:5]).all() and float(np.max(orbit.error.state.u)) < 1e-6 * v[5]


@pytest.mark.study
@pytest.mark.slow
def test_a_breather_of_magnets_has_the_tail_of_their_stiffness():
    """A r^-4 has the stiffness 4 A r^-5; what does not oscillate, the stretch of the chain, falls more slowly."""
    chain, omega, _ = light_magnet(161)
    family = gx.breathers.family(chain, amplitude=0.02, steps=32, stability=False)
    v, n = np.abs(np.asarray(family.orbit(-1).run(8).vs)[2]), np.arange(15, 50)
    assert abs(np.polyfit(np.log(n), np.log(v[80 + n]), 1)[0] + 5) < 0.05
    assert float(family.omega[-1]) < omega


@pytest.mark.study
@pytest.mark.parametrize("reach", [1, pytest.param(None, marks=pytest.mark.slow)])
def test_magnets_that_meet_are_named(reach):
    chain = gx.scenes.magnets(6, -4.0, reach=reach)
    hit = gx.states.impact(chain, velocity=40.0, site=3)
    run = gx.simulate(chain, hit, 1.0, step=0.2, throw=False)
    # bond 0 is that at the left end; site 3 flies to the right
    assert run.met[:2] == (4, 0) and 0 <= run.met[2] <= 0.2 and run.met[3] == ()
    assert "Magnets met in bond 4 of terms[0]" in run.outcome
    with pytest.raises(RuntimeError, match="Magnets met in bond 4"):
        gx.simulate(chain, hit, 1.0, step=0.2)


@pytest.mark.study
def test_magnets_that_meet_in_a_lane_in_si_and_by_adaptive_steps():
    lanes = jnp.asarray([1e3, 1.0, 1e-3])
    batch = jax.vmap(lambda A: gx.scenes.magnets(8, -0.5, stiffness=A, reach=1), out_axes=-1)(lanes)
    start = gx.State(batch.zeros(), batch.zeros().at[3].set(2.0))
    run = gx.simulate(batch, start, 1.0, step=0.01, throw=False)
    assert (
        run.met[0] == 4
        and run.met[3] == (2,)
        and abs(run.met[2] - 0.5) < 0.01
        and "of lane 2" in run.outcome
    )
    run = gx.simulate(batch, start, 1.0, tolerance=1e-6, throw=False)
    assert run.met[0] == 4 and abs(run.met[2] - 0.5) < 0.01 and "Lane 2: Magnets met" in run.outcome
    small = gx.scenes.magnets(8, -0.5, stiffness=1e-6, spacing=0.02, mass=1e-3, units="SI", reach=1)
    run = gx.simulate(
        small, gx.states.impact(small, velocity=2.0, site=3), 1.0, step=1e-4, throw=False
    )
    assert run.met[0] == 4 and abs(run.met[2] - 0.01) < 1e-4
