"""Solvers: orders, structure, tables, dense output, and the ways in which they can be run."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import NYSTROM, SPLITTING
from refusals import refused

import granjax as gx
from granjax.solvers import (
    ABA864,
    RKN86,
    RKN1210,
    KahanLi8,
    SofroniouSpaletta10,
    SRKN6b,
    SRKN11b,
    SRKN14a,
    VelocityVerlet,
)

slow = pytest.mark.slow


def over(*solvers):
    return pytest.mark.parametrize("solver", solvers, ids=lambda s: s.__name__)


pairs = over(*NYSTROM)

N = 10


def chain(mass=1.0, precompression=1.0, extra=(), boundary="fixed"):
    bond = gx.Bond(gx.Shift(1, boundary), gx.Hertz(precompression=precompression))
    return gx.Lattice(mass * jnp.ones(N), (bond, *extra))


def smooth(shift=0.0, size=0.3):
    """Waves well below d0 = 1, so that every contact stays closed."""
    n = np.arange(1, N + 1)
    return gx.State(
        jnp.asarray(size * np.sin(1.3 * n + shift)), jnp.asarray(size * np.cos(2.1 * n - shift))
    )


def solve(solver, y, t1, step, args, field=gx.vector_field, t0=0.0, **options):
    """`diffeqsolve` at a fixed step, or at the controller in `options`; times are arrays, so that it compiles once."""
    dtype = jax.tree.leaves(y)[0].real.dtype
    t0, t1, step = (None if t is None else jnp.asarray(t, dtype) for t in (t0, t1, step))
    options = {"adjoint": diffrax.ForwardMode(), "max_steps": 100_000, **options}
    return diffrax.diffeqsolve(
        diffrax.ODETerm(field), solver, t0, t1, step, y, args=args, **options
    )


def last(solution):
    return jax.tree.map(lambda x: x[-1], solution.ys)


def flat(y):
    return np.concatenate([np.ravel(x) for x in jax.tree.leaves(y)])


def slope(steps, errors):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


# orders ------------------------------------------------------------------------------------------------------------

LANES = 6
T = 24.0
# numbers of steps: ladders between the limit of stability (omega_max < 2.5) and rounding
LADDERS = {
    VelocityVerlet: (480, 960, 1920),
    SRKN6b: (120, 180, 270),
    ABA864: (120, 180, 270),
    SRKN11b: (60, 84, 120),
    SRKN14a: (48, 72, 108),
    KahanLi8: (84, 108, 144),
    SofroniouSpaletta10: (42, 54, 72, 90),
    RKN86: (48, 60, 72, 96),
    RKN1210: (29, 31, 34, 37, 40, 44, 48, 52),
}
ORDERS = dict(zip(LADDERS, (2, 4, 4, 6, 6, 8, 10, 8, 12)))
FORCES = dict(zip(LADDERS, (1, 6, 7, 11, 14, 17, 35, 8, 17)))


@pytest.fixture(scope="module")
def lanes():
    scene = jax.vmap(chain, out_axes=-1)(jnp.linspace(1.0, 1.3, LANES))
    states = [smooth(shift) for shift in np.linspace(0.0, 5.0, LANES)]
    y = jax.tree.map(lambda *x: jnp.stack(x, -1), *states)
    return scene, y


@pytest.fixture(scope="module")
def truth(lanes):
    scene, y = lanes
    saved = solve(
        RKN1210(), y, T, T / 960, scene, saveat=diffrax.SaveAt(ts=jnp.linspace(0.0, T, 97))
    ).ys
    u = np.pad(np.asarray(saved.u), ((0, 0), (1, 1), (0, 0)))
    assert (1.0 + u[:, :-1] - u[:, 1:]).min() > 0.05  # contacts stay closed
    return jax.tree.map(lambda x: x[-1], saved)


@slow
@over(*LADDERS)
def test_observed_order(solver, lanes, truth):
    scene, y = lanes
    counts = LADDERS[solver]
    ends = [flat(last(solve(solver(), y, T, T / n, scene))) for n in counts]
    errors = [np.sqrt(np.mean((end - flat(truth)) ** 2)) for end in ends]
    assert min(errors) > 5e-14  # rounding is at 1e-15
    assert abs(slope(T / np.array(counts), errors) - ORDERS[solver]) < 0.3
    assert solver().order(None) == ORDERS[solver]


@pytest.mark.parametrize(
    "solver, order, steps", [(RKN86, 7, (0.2, 0.1, 0.05)), (RKN1210, 11, (0.8, 0.5, 0.3))]
)
def test_error_estimate_has_the_order_of_the_embedded_method(solver, order, steps, lanes):
    scene, y = lanes
    method = solver()
    terms = diffrax.ODETerm(gx.vector_field)

    @jax.jit
    def estimate(h):
        kept = method.init(terms, 0.0, h, y, scene)
        return method.step(terms, 0.0, h, y, scene, kept, False)[1]

    found = [estimate(h) for h in steps]
    assert method.error_order(None) == order
    for part in range(2):
        errors = [np.sqrt(np.mean(np.asarray(error[part]) ** 2)) for error in found]
        # the displacement's weights gain an order on some forces, never lose one
        assert order - 0.4 < slope(steps, errors) < order + 1.4, part


# structure ---------------------------------------------------------------------------------------------------------


def symplectic_defect(solver, step, gamma=0.0, t1=2.0):
    """|M'JM - exp(-gamma t1) J| of the derivative M of the flow, for beads with damping gamma."""
    lattice = chain(extra=(gx.Damping(gamma),) if gamma else ())

    def flow(z):
        end = last(solve(solver(), gx.State(z[:N], z[N:]), t1, step, lattice))
        return jnp.concatenate([end.u, end.v])

    M = np.asarray(jax.jit(jax.jacfwd(flow))(jnp.concatenate(list(smooth()))))
    J = np.kron([[0, 1], [-1, 0]], np.eye(N))
    return np.abs(M.T @ J @ M - np.exp(-gamma * t1) * J).max()


@slow
def test_splittings_are_symplectic_also_with_uniform_damping_and_a_nystrom_pair_is_not():
    assert symplectic_defect(SRKN11b, 0.25) < 2e-14
    assert symplectic_defect(SRKN14a, 0.25) < 2e-14
    assert symplectic_defect(SRKN11b, 0.5, gamma=0.3) < 1e-14
    assert symplectic_defect(RKN86, 0.5) > 1e-8


@slow
def test_damping_keeps_the_order():
    lattice = chain(extra=(gx.Damping(0.2), gx.Drive(gx.Harmonic(0.1, 1.1), 2)))
    reference = flat(last(solve(diffrax.Dopri8(), smooth(), 8.0, 0.01, lattice)))
    counts = np.array([16, 24, 36])
    errors = [
        np.abs(flat(last(solve(SRKN11b(), smooth(), 8.0, 8 / n, lattice))) - reference).max()
        for n in counts
    ]
    assert abs(slope(1 / counts, errors) - 6) < 0.3


@over(*SPLITTING)
def test_table_of_a_splitting_is_consistent_and_symmetric(solver):
    table = solver.table()
    for row in (table.a, table.b):
        assert abs(row.sum() - 1) < 4e-15 and np.abs(row - row[::-1]).max() < 4e-15


def test_evaluations_are_those_of_the_tables():
    assert {solver: solver.evaluations() for solver in LADDERS} == FORCES


def energy_error(eps, h):
    """Of ABA864 on H = (p^2 + q^2)/2 + eps q^4/4, whose two parts it takes exactly."""
    table = ABA864.table()
    steps = round(40 / h)
    y = 1.0 + 0.3j
    energies = []
    for _ in range(steps):
        for a, b in zip(table.a, table.b):
            y = (y - 1j * b * h * eps * y.real**3) * np.exp(-1j * a * h)
        energies.append(abs(y) ** 2 / 2 + eps * y.real**4 / 4)
    return np.ptp(energies)


def test_a_perturbation_of_aba864_has_order_eight():
    coarse, fine, small = (energy_error(*each) for each in ((1e-3, 0.5), (1e-3, 0.4), (1e-4, 0.5)))
    assert np.log(coarse / fine) / np.log(5 / 4) == pytest.approx(8, abs=0.7)
    assert coarse / small == pytest.approx(10, rel=0.1)


# vector fields -----------------------------------------------------------------------------------------------------


@slow
@over(SRKN11b, RKN86)
def test_pendulum_as_a_plain_pair(solver):
    # energy v^2/2 - cos u; the period at amplitude 2 is 4 K(sin 1)
    def pendulum(t, y, length):
        return y[1], -jnp.sin(y[0]) / length

    from scipy.special import ellipk

    period = 4 * ellipk(np.sin(1.0) ** 2)
    u, v = last(
        solve(solver(), (jnp.asarray(2.0), jnp.asarray(0.0)), period, period / 200, 1.0, pendulum)
    )
    assert abs(u - 2.0) < 1e-9 and abs(v) < 1e-9


@slow
@over(KahanLi8, RKN86)
def test_pytrees_and_complex_arrays(solver):
    def field(t, y, args):
        return y[1], jax.tree.map(lambda u: -4.0 * u, y[0])

    u = {"real": [jnp.asarray([1.0, 0.2])], "other": jnp.asarray([1.0 + 1.0j])}
    v = {"real": [jnp.zeros(2)], "other": jnp.asarray([0.5 - 2.0j])}
    with pytest.warns(UserWarning, match="[Cc]omplex"):
        saveat = diffrax.SaveAt(ts=jnp.asarray([1.03, 2.0]))
        end, _ = last(solve(solver(), (u, v), 2.0, 0.05, None, field, saveat=saveat))
    exact = jax.tree.map(lambda u, v: u * np.cos(4.0) + v * np.sin(4.0) / 2, u, v)
    assert np.abs(flat(end) - flat(exact)).max() < 1e-9
    assert end["real"][0].dtype == jnp.float64 and end["other"].dtype == jnp.complex128


@pytest.mark.parametrize(
    "solver, term",
    [
        (SRKN11b, gx.Dashpot(gx.Shift(1, "fixed"), 0.1)),
        (RKN1210, gx.Damping(0.1)),
    ],
)
def test_a_force_that_a_method_cannot_take_is_refused_by_name(solver, term):
    with refused(rf"terms\[1\] \({type(term).__name__}\)"):
        solve(solver(), smooth(), 1.0, 0.1, chain(extra=(term,)))


@slow
def test_pairs_refuse_a_plain_field_that_reads_the_velocity():
    field = lambda t, y, args: gx.State(y[1], -y[0] - args * y[1])
    for own in (field, jax.jit(field)):
        with refused("reads the velocity"):
            solve(RKN86(), smooth(), 1.0, 0.1, 0.1, own)
    solve(RKN86(), smooth(), 1.0, 0.1, None, jax.jit(lambda t, y, args: gx.State(y[1], -y[0])))


# dense output ------------------------------------------------------------------------------------------------------


@over(SRKN11b, RKN86)
def test_an_increment_of_dense_output_is_a_difference(solver):
    method = solver()
    terms = diffrax.ODETerm(gx.vector_field)
    y = smooth()
    kept = method.init(terms, 0.0, 0.25, y, chain())
    dense = method.step(terms, 0.0, jnp.asarray(0.25), y, chain(), kept, False)[2]
    path = method.interpolation_cls(t0=0.0, t1=0.25, **dense)
    difference = flat(path.evaluate(0.2)) - flat(path.evaluate(0.1))
    assert np.abs(flat(path.evaluate(0.1, 0.2)) - difference).max() < 1e-15


SHORT = 8.0


def dense_errors(solver, count, times, reference):
    """Errors in u and v by time, steps and places between them."""
    found = solve(
        solver(), smooth(), SHORT, SHORT / count, chain(), saveat=diffrax.SaveAt(ts=times)
    ).ys
    return np.array([np.abs(a - b).max(1) for a, b in zip(found, reference)])


@pytest.fixture(scope="module")
def between():
    """288 steps of 1/36, and so the ends of 12, 16, 24, 36 and other numbers of steps, and places between them."""
    times = jnp.linspace(0.0, SHORT, 289)
    ys = solve(RKN1210(), smooth(), SHORT, SHORT / 288, chain(), saveat=diffrax.SaveAt(ts=times)).ys
    return times, ys


@slow
@pytest.mark.parametrize("solver, counts", ((RKN86, (16, 24, 36)), (RKN1210, (6, 8, 9, 12))))
def test_dense_output_is_as_good_as_the_steps(solver, counts, between):
    times, reference = between
    within = []
    at_steps = []
    for n in counts:
        errors = dense_errors(solver, n, times, reference)
        within.append(errors.max(1))
        at_steps.append(errors[:, :: 288 // n].max(1))
    # measured ratios: u 1.0 to 1.8, v 1.0 to 5 (12(10) at its smallest steps)
    ratios = np.array(within) / np.array(at_steps)
    assert ratios[:, 0].max() < 2 and ratios[:, 1].max() < {RKN86: 1.2, RKN1210: 6}[solver]
    orders = [slope(1 / np.array(counts), errors) for errors in np.array(within).T]
    assert min(orders) > {RKN86: 7.5, RKN1210: 10.3}[solver]


@slow
def test_dense_output_of_splittings_has_order_six(between):
    times, reference = between
    counts = np.array([40, 56, 80])
    errors = np.array([dense_errors(KahanLi8, n, times, reference).max(1) for n in counts])
    assert slope(1 / counts, errors[:, 0]) > 5.5 and slope(1 / counts, errors[:, 1]) > 4.7


@slow
@pytest.mark.parametrize("solver, close", [(SRKN14a, 1e-13), (RKN86, 1e-5)])
def test_dense_output_runs_backwards(solver, close):
    how = {"saveat": diffrax.SaveAt(t1=True, dense=True), "max_steps": 8}
    forth = solve(solver(), smooth(), 1.0, 0.25, chain(), **how)
    back = solve(solver(), last(forth), 0.0, -0.25, chain(), t0=1.0, **how)
    middle, again = (flat(way.interpolation.evaluate(0.6)) for way in (forth, back))
    assert np.abs(again - middle).max() < close


# adaptive steps ----------------------------------------------------------------------------------------------------


def adaptive(solver, y, t1, tolerance, *args, **options):
    controller = diffrax.PIDController(rtol=tolerance, atol=tolerance)
    return solve(solver(), y, t1, None, *args, **{"stepsize_controller": controller, **options})


@slow
@pairs
def test_tolerance_is_kept(solver, between):
    times, reference = between
    for tolerance in jnp.asarray([1e-6, 1e-10]):
        saveat = diffrax.SaveAt(ts=times)
        found = adaptive(solver, smooth(), SHORT, tolerance, chain(), saveat=saveat)
        assert max(np.abs(a - b).max() for a, b in zip(found.ys, reference)) < 30 * tolerance
        assert found.stats["num_rejected_steps"] < 0.3 * found.stats["num_steps"]


@slow
def test_a_jump_in_time_drops_the_kept_force():
    # stiffness 1 before t = 1 and 3 after: u = cos(1) cos(w s) - sin(1) sin(w s)/w, w = sqrt 3, s = t - 1
    def switched(t, y, args):
        u, v = y
        return gx.State(v, -jnp.where(t < 1.0, 1.0, 3.0) * u)

    controller = diffrax.ClipStepSizeController(
        diffrax.PIDController(rtol=1e-11, atol=1e-11), jump_ts=jnp.asarray([1.0])
    )
    times = jnp.linspace(1.1, 2.5, 8)
    y = gx.State(jnp.ones(1), jnp.zeros(1))
    how = {"stepsize_controller": controller, "saveat": diffrax.SaveAt(ts=times)}
    found = solve(RKN86(), y, 2.5, None, None, switched, **how)
    w = np.sqrt(3.0)
    s = np.asarray(times) - 1
    exact = np.cos(1.0) * np.cos(w * s) - np.sin(1.0) * np.sin(w * s) / w
    assert np.abs(found.ys.u[:, 0] - exact).max() < 1e-9
    # 400 steps without the jump would be needed here; with it a smooth solve's few
    assert found.stats["num_steps"] < 60


@slow
def test_adaptive_lanes_of_vmap_are_those_alone():
    # errors of a step well above what rounding, which differs, makes of them
    alone = lambda mass: last(adaptive(RKN86, smooth(), 2.0, 1e-6, chain(mass)))
    masses = jnp.asarray([1.0, 1.5])
    mapped = jax.vmap(alone)(masses)
    for i, mass in enumerate(masses):
        assert np.abs(flat(jax.tree.map(lambda x: x[i], mapped)) - flat(alone(mass))).max() < 1e-13
