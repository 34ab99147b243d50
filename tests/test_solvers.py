"""Solvers: orders, structure, tables, dense output, and the ways in which they can be run."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ALL_SOLVERS, NYSTROM, SPLITTING
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
from granjax.solvers.inner import weights
from granjax.solvers.interpolation import Bootstrapped, QuinticHermite, correction, quintic
from granjax.solvers.nystrom import _stages

splittings = pytest.mark.parametrize("solver", SPLITTING, ids=lambda s: s.__name__)


def some_of(solvers, *some):
    """Solvers, of which some stand for all; the others are slow."""
    marked = [s if s in some else pytest.param(s, marks=pytest.mark.slow) for s in solvers]
    return pytest.mark.parametrize("solver", marked, ids=lambda s: s.__name__)


# one that kicks first, one that drifts first, one pair
each = some_of(ALL_SOLVERS, SRKN11b, SRKN14a, RKN86)
pairs = pytest.mark.parametrize("solver", NYSTROM, ids=lambda s: s.__name__)
pair = some_of(NYSTROM, RKN86)

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
    RKN86: (48, 54, 60, 72, 84, 96),
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


@pytest.mark.slow
@some_of(ALL_SOLVERS, VelocityVerlet, SRKN11b, RKN86)
def test_observed_order(solver, lanes, truth):
    scene, y = lanes
    counts = LADDERS[solver]
    ends = [flat(last(solve(solver(), y, T, T / n, scene))) for n in counts]
    errors = [np.sqrt(np.mean((end - flat(truth)) ** 2)) for end in ends]
    assert min(errors) > 5e-14  # rounding is at 1e-15
    assert abs(slope(T / np.array(counts), errors) - ORDERS[solver]) < 0.3
    assert solver().order(None) == ORDERS[solver]


@pairs
def test_error_estimate_has_the_order_of_the_embedded_method(solver, lanes):
    scene, y = lanes
    method = solver()
    terms = diffrax.ODETerm(gx.vector_field)

    @jax.jit
    def estimate(h):
        kept = method.init(terms, 0.0, h, y, scene)
        return method.step(terms, 0.0, h, y, scene, kept, False)[1]

    steps = np.array({RKN86: (0.2, 0.1, 0.05), RKN1210: (0.8, 0.5, 0.3)}[solver])
    found = [estimate(h) for h in steps]
    expected = {RKN86: 7, RKN1210: 11}[solver]
    assert method.error_order(None) == expected
    for part in ("u", "v"):
        errors = [np.sqrt(np.mean(np.asarray(getattr(e, part)) ** 2)) for e in found]
        order = slope(steps, errors)
        # the displacement's weights gain an order on some forces, never lose one
        assert expected - 0.4 < order < expected + 1.4, (part, order)


# structure ---------------------------------------------------------------------------------------------------------


def symplectic_form(n):
    return np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])


def monodromy(solver, lattice, y, t1, step):
    def flow(z):
        end = last(solve(solver(), gx.State(z[:N], z[N:]), t1, step, lattice))
        return jnp.concatenate([end.u, end.v])

    return np.asarray(jax.jit(jax.jacfwd(flow))(jnp.concatenate(list(y))))


@pytest.mark.study
@some_of(SPLITTING, SRKN11b, SRKN14a, SofroniouSpaletta10)
def test_symplectic(solver):
    M = monodromy(solver, chain(), smooth(), 2.0, 0.25)
    J = symplectic_form(N)
    assert np.abs(M.T @ J @ M - J).max() < 2e-14 * max(1.0, np.abs(M).max() ** 2)


@pytest.mark.slow
def test_a_nystrom_pair_is_not_symplectic():
    M = monodromy(RKN86, chain(), smooth(), 2.0, 0.5)
    J = symplectic_form(N)
    assert np.abs(M.T @ J @ M - J).max() > 1e-8


@pytest.mark.slow
def test_uniform_damping_contracts_the_symplectic_form():
    # exact damping in the drift: M'JM = exp(-gamma T) J whatever the step
    gamma, t1 = 0.3, 2.0
    M = monodromy(SRKN11b, chain(extra=(gx.Damping(gamma),)), smooth(), t1, 0.5)
    J = symplectic_form(N)
    assert np.abs(M.T @ J @ M - np.exp(-gamma * t1) * J).max() < 1e-14


@pytest.mark.slow
def test_damping_keeps_the_order():
    lattice = chain(extra=(gx.Damping(0.2), gx.Drive(gx.Harmonic(0.1, 1.1), 2)))
    reference = flat(last(solve(diffrax.Dopri8(), smooth(), 8.0, 0.01, lattice)))
    counts = np.array([16, 24, 36])
    errors = [
        np.abs(flat(last(solve(SRKN11b(), smooth(), 8.0, 8 / n, lattice))) - reference).max()
        for n in counts
    ]
    assert abs(slope(1 / counts, errors) - 6) < 0.3


@pytest.mark.slow
@splittings
def test_time_reversible(solver):
    start = smooth()
    end = last(solve(solver(), start, 3.0, 0.25, chain()))
    back = last(solve(solver(), end, 0.0, -0.25, chain(), t0=3.0))
    assert np.abs(flat(back) - flat(start)).max() < 1e-14
    assert np.abs(flat(end) - flat(start)).max() > 0.1


@splittings
def test_table_of_a_splitting(solver):
    table = solver.table()
    assert abs(table.a.sum() - 1) < 4e-15 and abs(table.b.sum() - 1) < 4e-15
    assert (
        np.abs(table.a - table.a[::-1]).max() < 4e-15
        and np.abs(table.b - table.b[::-1]).max() < 4e-15
    )


def test_evaluations():
    assert {solver: solver.evaluations() for solver in ALL_SOLVERS} == FORCES


def energy_error(eps, h):
    """Of ABA864 on H = (p^2 + q^2)/2 + eps q^4/4, whose two parts it takes exactly."""
    table, steps, y = ABA864.table(), round(40 / h), 1.0 + 0.3j
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


@pairs
def test_table_of_a_nystrom_pair(solver):
    table = solver.table()
    assert abs(table.b.sum() - 1 / 2) < 1e-14 and abs(table.bp.sum() - 1) < 1e-14
    assert abs(table.be.sum()) < 1e-14 and abs(table.bpe.sum()) < 1e-14
    assert np.abs(table.A.sum(1) - table.c**2 / 2).max() < 1e-14
    assert np.abs(np.triu(table.A)).max() == 0
    for k in range(1, table.order):
        assert abs(table.bp @ table.c**k - 1 / (k + 1)) < 1e-14
    for k in range(1, table.order - 1):
        assert abs(table.b @ table.c**k - 1 / ((k + 1) * (k + 2))) < 1e-14


# vector fields -----------------------------------------------------------------------------------------------------


def plain_chain(t, y, args):
    """The chain of `chain()` without the library's parts."""
    u, v = y
    e = jnp.pad(u, 1)
    force = jnp.maximum(1 + e[:-1] - e[1:], 0) ** 1.5
    return gx.State(v, force[:-1] - force[1:])


@pytest.mark.study
@each
def test_plain_field_equals_lattice(solver):
    ours = flat(last(solve(solver(), smooth(), 2.0, 0.25, chain())))
    plain = flat(last(solve(solver(), smooth(), 2.0, 0.25, None, plain_chain)))
    assert np.abs(ours - plain).max() < 1e-14


@pytest.mark.slow
@pytest.mark.parametrize("solver", (SRKN11b, RKN86), ids=lambda s: s.__name__)
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


@pytest.mark.slow
@pytest.mark.parametrize("solver", (KahanLi8, RKN86), ids=lambda s: s.__name__)
def test_pytrees_and_complex_arrays(solver):
    def field(t, y, args):
        u, v = y
        return v, {"a": [-u["a"][0] + 0.1 * u["b"].real.sum()], "b": -4.0 * u["b"]}

    u = {"a": [jnp.asarray([1.0, 0.2])], "b": jnp.asarray([1.0 + 1.0j])}
    v = {"a": [jnp.zeros(2)], "b": jnp.asarray([0.5 - 2.0j])}
    with pytest.warns(UserWarning, match="[Cc]omplex"):
        saveat = diffrax.SaveAt(ts=jnp.asarray([1.03, 2.0]))
        end = last(solve(solver(), (u, v), 2.0, 0.05, None, field, saveat=saveat))
    exact = u["b"] * np.cos(4.0) + v["b"] * np.sin(4.0) / 2
    assert jnp.abs(end[0]["b"] - exact).max() < 1e-9
    assert end[0]["a"][0].dtype == jnp.float64 and end[0]["b"].dtype == jnp.complex128


@pytest.mark.slow
def test_dict_of_fields_equals_one_array():
    bond = lambda fields: gx.Bond(gx.Shift(1, "fixed", fields), gx.Hertz(precompression=1.0))  # noqa: E731
    cell = gx.Lattice({"bead": jnp.ones(N)}, (bond("bead"),))
    y = smooth()
    for solver in (SRKN11b(), RKN86()):
        plain = last(solve(solver, y, 2.0, 0.25, chain()))
        named = last(solve(solver, gx.State({"bead": y.u}, {"bead": y.v}), 2.0, 0.25, cell))
        assert np.abs(flat(plain) - flat(named)).max() < 1e-14


@pytest.mark.parametrize("solver", (SRKN11b, RKN86, RKN1210), ids=lambda s: s.__name__)
def test_dashpot_is_refused_by_name(solver):
    lattice = chain(extra=(gx.Dashpot(gx.Shift(1, "fixed"), 0.1),))
    with refused(r"terms\[1\] \(Dashpot\)"):
        solve(solver(), smooth(), 1.0, 0.1, lattice)


@pairs
def test_damping_is_refused_by_pairs(solver):
    with refused(r"terms\[1\] \(Damping\)"):
        solve(solver(), smooth(), 1.0, 0.1, chain(extra=(gx.Damping(0.1),)))


@pytest.mark.slow
@pairs
def test_plain_field_that_reads_the_velocity_is_refused(solver):
    field = lambda t, y, args: gx.State(y[1], -y[0] - 0.1 * y[1])
    for own in (field, jax.jit(field)):
        with refused("reads the velocity"):
            solve(solver(), smooth(), 1.0, 0.1, None, own)
    solve(solver(), smooth(), 1.0, 0.1, None, jax.jit(lambda t, y, args: gx.State(y[1], -y[0])))


# dense output ------------------------------------------------------------------------------------------------------


def polynomial(coefficients):
    p = np.polynomial.Polynomial(coefficients)
    return p, p.deriv(), p.deriv(2)


@pytest.mark.parametrize("direction", (1, -1))
def test_quintic_is_exact_on_quintics(direction):
    p, dp, ddp = polynomial([0.3, -1.0, 2.0, 0.7, -0.4, 0.2])
    t0, t1 = 0.4, 1.9
    at = lambda f, t: jnp.asarray([f(t)])  # noqa: E731
    # in diffrax's time, which runs forwards: t = direction * own time
    a, b = (t0, t1) if direction == 1 else (t1, t0)
    inner = QuinticHermite(
        jnp.asarray(direction * a),
        jnp.asarray(direction * b),
        gx.State(at(p, a), at(dp, a)),
        gx.State(at(p, b), at(dp, b)),
        at(ddp, a),
        at(ddp, b),
        direction,
    )
    for t in np.linspace(t0, t1, 7):
        u, v = inner.evaluate(direction * t)
        assert abs(u[0] - p(t)) < 2e-13 and abs(v[0] - dp(t)) < 2e-12
    difference = inner.evaluate(direction * a, direction * b)
    assert abs(difference.u[0] - (p(b) - p(a))) < 1e-13


@pytest.mark.parametrize("m", (2, 3, 7))
def test_bootstrapped_is_exact_to_its_degree(m):
    rng = np.random.default_rng(m)
    fit, h = correction(m), 0.8
    p, dp, ddp = polynomial(rng.standard_normal(m + 6))
    data = h * h * ddp(h * fit.nodes)
    low = quintic(p(h) - p(0) - h * dp(0), h * (dp(h) - dp(0)), h * h * ddp(0), h * h * ddp(h))
    high = fit.take @ data - fit.less @ np.array(low)
    as_arrays = lambda x: tuple(jnp.asarray([c]) for c in x)  # noqa: E731
    inner = Bootstrapped(
        jnp.asarray(0.0), jnp.asarray(h), as_arrays((p(0), dp(0))), as_arrays(low), as_arrays(high)
    )
    size = np.abs(p.coef).sum() * m**3
    for t in np.linspace(0, h, 9):
        u, v = inner.evaluate(jnp.asarray(t))
        assert abs(u[0] - p(t)) < 1e-14 * size and abs(v[0] - dp(t)) < 1e-13 * size


@pairs
def test_inner_places_satisfy_their_order(solver):
    # a free position at c has an error of order h^7 (8(6)) or h^10 (12(10)) on u'' = -u
    stages = _stages(solver)
    nodes = np.array([0.25, 0.6, 0.9])
    w, order = weights(stages.A, stages.c, nodes)
    assert order == {RKN86: 7, RKN1210: 10}[solver]
    assert np.abs(w).sum(1).max() < 3 * 0.5
    errors = []
    steps = np.array([1.0, 0.7, 0.5]) if solver is RKN1210 else np.array([0.4, 0.28, 0.2])
    for h in steps:
        k = np.zeros(len(stages.c))
        for i, c in enumerate(stages.c):
            k[i] = -(1 + c * h * 0.5 + h * h * stages.A[i] @ k)
        errors.append(
            np.abs(
                1 + nodes * h * 0.5 + h * h * w @ k - np.cos(nodes * h) - 0.5 * np.sin(nodes * h)
            ).max()
        )
    assert slope(steps, errors) > order - 0.3


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


@pytest.mark.study
@pytest.mark.parametrize(
    "solver, counts", ((RKN86, (16, 24, 36)), (RKN1210, (6, 8, 9, 12))), ids=("RKN86", "RKN1210")
)
def test_dense_output_is_as_good_as_the_steps(solver, counts, between):
    times, reference = between
    within, at_steps = [], []
    for n in counts:
        errors = dense_errors(solver, n, times, reference)
        within.append(errors.max(1))
        at_steps.append(errors[:, :: 288 // n].max(1))
    # measured ratios: u 1.0 to 1.8, v 1.0 to 5 (12(10) at its smallest steps)
    ratios = np.array(within) / np.array(at_steps)
    assert ratios[:, 0].max() < 2 and ratios[:, 1].max() < {RKN86: 1.2, RKN1210: 6}[solver]
    orders = [slope(1 / np.array(counts), errors) for errors in np.array(within).T]
    assert min(orders) > {RKN86: 7.5, RKN1210: 10.3}[solver]


@pytest.mark.slow
def test_dense_output_of_splittings_has_order_six(between):
    times, reference = between
    counts = np.array([40, 56, 80])
    errors = np.array([dense_errors(KahanLi8, n, times, reference).max(1) for n in counts])
    assert slope(1 / counts, errors[:, 0]) > 5.5 and slope(1 / counts, errors[:, 1]) > 4.7


@pytest.mark.study
@each
def test_dense_output_meets_the_ends_and_runs_backwards(solver):
    method = solver()
    forth = solve(
        method,
        smooth(),
        1.0,
        0.25,
        chain(),
        saveat=diffrax.SaveAt(t1=True, dense=True),
        max_steps=8,
    )
    middle = forth.interpolation.evaluate(0.6)
    for t in (0.5, 0.75):
        end = last(solve(method, smooth(), t, 0.25, chain()))
        assert np.abs(flat(forth.interpolation.evaluate(t)) - flat(end)).max() < 5e-15
    back = solve(
        method,
        last(forth),
        0.0,
        -0.25,
        chain(),
        t0=1.0,
        saveat=diffrax.SaveAt(t1=True, dense=True),
        max_steps=8,
    )
    close = 1e-13 if solver in SPLITTING else 1e-5
    assert np.abs(flat(back.interpolation.evaluate(0.6)) - flat(middle)).max() < close


@pytest.mark.study
@pair
def test_nobody_pays_for_dense_output_that_is_not_read(solver):
    def roots(**options):
        run = jax.jit(lambda y: solve(solver(), y, 2.0, 0.25, chain(), **options).ys)
        program = run.lower(smooth()).compile().as_text()
        return program.count(" shift-right-logical(") + program.count(
            " sqrt("
        )  # the processor chooses the root

    assert 0 < roots() < roots(saveat=diffrax.SaveAt(ts=jnp.linspace(0.0, 2.0, 7)))


# adaptive steps ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pairs
def test_tolerance_is_kept(solver, between):
    times, reference = between
    for tolerance in jnp.asarray([1e-6, 1e-10]):
        found = solve(
            solver(),
            smooth(),
            SHORT,
            None,
            chain(),
            saveat=diffrax.SaveAt(ts=times),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        )
        assert max(np.abs(a - b).max() for a, b in zip(found.ys, reference)) < 30 * tolerance
        assert found.stats["num_rejected_steps"] < 0.3 * found.stats["num_steps"]


@pytest.mark.slow
@pair
def test_a_jump_in_time_drops_the_kept_force(solver):
    # stiffness 1 before t = 1 and 3 after: u = cos(1) cos(w s) - sin(1) sin(w s)/w, w = sqrt 3, s = t - 1
    def switched(t, y, args):
        u, v = y
        return gx.State(v, -jnp.where(t < 1.0, 1.0, 3.0) * u)

    controller = diffrax.ClipStepSizeController(
        diffrax.PIDController(rtol=1e-11, atol=1e-11), jump_ts=jnp.asarray([1.0])
    )
    y = gx.State(jnp.asarray([1.0]), jnp.asarray([0.0]))
    times = jnp.linspace(1.1, 2.5, 8)
    found = solve(
        solver(),
        y,
        2.5,
        None,
        None,
        switched,
        stepsize_controller=controller,
        saveat=diffrax.SaveAt(ts=times),
    )
    w, s = np.sqrt(3.0), np.asarray(times) - 1
    exact = np.cos(1.0) * np.cos(w * s) - np.sin(1.0) * np.sin(w * s) / w
    assert np.abs(found.ys.u[:, 0] - exact).max() < 1e-9
    # 400 steps without the jump would be needed here; with it a smooth solve's few
    assert found.stats["num_steps"] < 60


@pytest.mark.slow
@pair
def test_contact_loss_by_small_steps(solver):
    # uncompressed chain hit at its end: energy is kept to the tolerance although contacts open
    lattice = chain(precompression=0.0, boundary="free")
    y = gx.State(jnp.zeros(N), jnp.zeros(N).at[0].set(1.0))
    end = last(
        solve(
            solver(),
            y,
            20.0,
            None,
            lattice,
            stepsize_controller=diffrax.PIDController(rtol=1e-10, atol=1e-10),
        )
    )
    assert abs(lattice.energy(20.0, *end) - 0.5) < 1e-8


# ways to run -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@each
def test_lanes_and_vmap(solver, lanes):
    scene, y = lanes
    together = last(solve(solver(), y, 1.0, 0.125, scene))

    def alone(mass, u, v):
        return last(solve(solver(), gx.State(u, v), 1.0, 0.125, chain(mass)))

    mapped = jax.vmap(alone, in_axes=(0, -1, -1), out_axes=-1)(jnp.linspace(1.0, 1.3, LANES), *y)
    single = alone(1.0, y.u[:, 0], y.v[:, 0])
    assert together.u.shape == (N, LANES)
    assert np.abs(flat(together) - flat(mapped)).max() < 1e-14
    assert np.abs(flat(jax.tree.map(lambda x: x[:, 0], together)) - flat(single)).max() < 1e-14


@pytest.mark.study
@each
def test_float32_stays_float32(solver):
    y = jax.tree.map(lambda x: x.astype(jnp.float32), smooth())
    times = jnp.asarray([0.6, 2.0], jnp.float32)
    found = solve(
        solver(), y, 2.0, 0.25, chain().astype(jnp.float32), saveat=diffrax.SaveAt(ts=times)
    ).ys
    exact = last(solve(solver(), smooth(), 2.0, 0.25, chain()))
    assert found.u.dtype == found.v.dtype == jnp.float32
    assert np.abs(flat(jax.tree.map(lambda x: x[-1], found)) - flat(exact)).max() < 2e-6


def observed(solver, stiffness, u, adjoint, **options):
    """A number from two times inside a solve."""
    lattice = gx.Lattice(
        jnp.ones(N), (gx.Bond(gx.Shift(1), gx.Hertz(stiffness, precompression=1.0)),)
    )
    found = solve(
        solver,
        gx.State(u, smooth().v),
        1.0,
        0.25,
        lattice,
        adjoint=adjoint,
        max_steps=64 if options else 4,
        saveat=diffrax.SaveAt(ts=jnp.asarray([0.33, 1.0])),
        **options,
    )
    return jnp.sum(found.ys.u * jnp.arange(1.0, N + 1)) + jnp.sum(found.ys.v**2)


PLACE = (jnp.asarray(1.1), smooth().u)
DIRECTION = (jnp.asarray(0.7), jnp.cos(jnp.arange(N) * 1.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    "solver, options",
    (
        (SRKN11b, {}),
        (RKN86, {"stepsize_controller": diffrax.PIDController(rtol=1e-9, atol=1e-9)}),
        (RKN86, {}),
        (RKN1210, {}),
    ),
    ids=("SRKN11b", "RKN86 adaptive", "RKN86", "RKN1210"),
)
def test_derivative_is_that_of_finite_differences(solver, options):
    def along(s):
        k, u = (x + s * d for x, d in zip(PLACE, DIRECTION))
        return observed(solver(), k, u, diffrax.ForwardMode(), **options)

    value = jax.jit(lambda s: jax.jvp(along, (s,), (1.0,)))
    _, slope_here = value(0.0)
    e = 1e-5
    assert abs((value(e)[0] - value(-e)[0]) / (2 * e) - slope_here) < 1e-8 * abs(slope_here)


@pytest.mark.study
@pair
def test_adaptive_vmap(solver):
    # errors of a step well above what rounding, which differs, makes of them
    def alone(mass):
        found = solve(
            solver(),
            smooth(),
            2.0,
            None,
            chain(mass),
            stepsize_controller=diffrax.PIDController(rtol=1e-6, atol=1e-6),
        )
        return last(found)

    masses = jnp.asarray([1.0, 1.5])
    mapped = jax.vmap(alone)(masses)
    for i, mass in enumerate(masses):
        assert np.abs(flat(jax.tree.map(lambda x: x[i], mapped)) - flat(alone(mass))).max() < 1e-13
