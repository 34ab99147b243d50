"""What leaves a branch: pitchforks, doublings, tori, and their curves in two parameters, against SciPy's shooting."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve, root

import granjax as gx
from granjax.driven import driven_chain
from granjax.forced import forced_branch


def duffing(force, omega=1.2, K2=-1.0, K4=1.0, damping=0.3):
    """x'' + gamma x' + K2 x + K4 x^3 = f cos(omega t) on site 0; site 1 is alone."""
    law = gx.Polynomial(K2, 0.0, K4)
    terms = gx.OnSite(law), gx.Damping(damping), gx.Drive(gx.Harmonic(force, omega), 0)
    return gx.Lattice(jnp.ones(2), terms)


def flowed(y, periods, force, omega=1.2, K2=-1.0, K4=1.0, damping=0.3):
    """One site by SciPy, with the derivative in the start (columns)."""

    def field(t, x):
        u, v, M = x[0], x[1], x[2:].reshape(2, 2)
        slope = np.array([[0.0, 1.0], [-K2 - 3 * K4 * u**2, -damping]])
        return [
            v,
            force * np.cos(omega * t) - damping * v - K2 * u - K4 * u**3,
            *(slope @ M).ravel(),
        ]

    span = 0.0, periods * 2 * np.pi / omega
    end = solve_ivp(field, span, [*y, 1, 0, 0, 1], method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return end[:2], end[2:].reshape(2, 2)


def shooting(y, periods, force, **others):
    """The orbit of SciPy, and its multipliers."""
    for _ in range(6):
        end, M = flowed(y, periods, force, **others)
        y = y - np.linalg.solve(M - np.eye(2), end - y)
    return y, np.linalg.eigvals(M)


@pytest.fixture(scope="module")
def well():
    beside = gx.State(jnp.ones(2), jnp.zeros(2))
    return forced_branch(duffing, 0.2, 0.29, period=2 * np.pi / 1.2, guess=beside, transient=60)


def test_a_doubled_orbit_is_that_of_scipy(well):
    (event,) = well.bifurcations
    assert event.kind == "period doubling"
    at = np.array([event.state.u[0], event.state.v[0]])
    _, multipliers = shooting(at, 1, event.p)
    assert abs(multipliers.real.min() + 1) < 1e-6
    doubled = well.switch(0, points=12)
    assert (doubled.verdict == "stable").all()
    assert_allclose(doubled.periods, 4 * np.pi / 1.2)
    for i in (2, 11):
        start = np.array([doubled.states.u[i, 0], doubled.states.v[i, 0]])
        orbit, multipliers = shooting(start, 2, doubled.p[i])
        assert_allclose(start, orbit, atol=1e-6)
        assert_allclose(
            start,
            orbit,
            atol=max(np.max(doubled.state_error.u[i]), np.max(doubled.state_error.v[i])),
        )
        assert np.abs(multipliers).max() < 1
        # no orbit of one period
        assert np.abs(flowed(orbit, 1, doubled.p[i])[0] - orbit).max() > 1e-3
    # the other side is the same orbit a period later
    other = well.switch(0, side=-1, points=4)
    start = np.array([other.states.u[3, 0], other.states.v[3, 0]])
    assert_allclose(start, shooting(start, 2, other.p[3])[0], atol=1e-6)
    later = flowed(start, 1, other.p[3])[0]
    for x, y in zip(later, (doubled.states.u[:, 0], doubled.states.v[:, 0])):
        assert_allclose(x, np.interp(other.p[3], doubled.p, y), atol=1e-3)


def test_the_normal_form_predicts_the_doubled_orbit(well):
    """x -> -(1 + a dp) x + c x^3: x^2 = a dp/c beyond the doubling."""
    form = well.normal_form(0)
    assert form.criticality == "supercritical" and form.error < 1e-5 * form.coefficient
    event = well.bifurcations[0]
    doubled = well.switch(0, points=2, arclength=0.003)
    dp = doubled.p[0] - event.p
    slope = []
    for step in (-1e-4, 1e-4):
        start = np.array([event.state.u[0], event.state.v[0]])
        slope.append(shooting(start, 1, event.p + step)[1].real.min())
    growth = -(slope[1] - slope[0]) / 2e-4
    x = np.sqrt(growth * dp / form.coefficient)
    # the eigenvector has unit norm, the state in units of displacement and of displacement times 2 pi/T
    size = lambda y: np.sqrt(np.sum(np.asarray(y.u) ** 2) + np.sum((np.asarray(y.v) / 1.2) ** 2))
    first = gx.State(doubled.states.u[0], doubled.states.v[0])
    branch = gx.State(*(np.asarray(x) for x in event.state))
    apart = gx.State(first.u - branch.u, first.v - branch.v)
    assert_allclose(size(apart), x * size(branch), rtol=0.02)


def twofold(force, damping=0.1):
    return duffing(force, omega=1.0, K2=0.2, K4=1.0, damping=damping)


@pytest.fixture(scope="module")
def symmetric():
    return forced_branch(
        twofold,
        2.0,
        2.6,
        period=2 * np.pi,
        guess=gx.State(jnp.array([1.8, 0]), jnp.zeros(2)),
        transient=40,
    )


def test_both_sides_of_a_pitchfork(symmetric):
    (event,) = symmetric.bifurcations
    assert event.kind == "branch point"
    form = symmetric.normal_form(0)
    assert form.kind == "pitchfork" and form.criticality == "supercritical"
    sides = [symmetric.switch(0, side=side, points=8) for side in (1, -1)]
    others = dict(omega=1.0, K2=0.2, K4=1.0, damping=0.1)
    for side in sides:
        assert (side.verdict == "stable").all() and side.p[-1] > event.p
        start = np.array([side.states.u[5, 0], side.states.v[5, 0]])
        orbit, multipliers = shooting(start, 1, side.p[5], **others)
        assert_allclose(start, orbit, atol=1e-6)
        # the mirror image half a period later is another orbit, that of the other side
        half = flowed(orbit, 0.5, side.p[5], **others)[0]
        assert np.abs(half + orbit).max() > 1e-2
    _, multipliers = shooting([event.state.u[0], event.state.v[0]], 1, event.p, **others)
    assert abs(multipliers.real.max() - 1) < 1e-6


@pytest.mark.slow
def test_a_pitchfork_is_followed_in_the_damping(symmetric):
    found = symmetric.locus(0, twofold, 0.1, 0.2, arclength=0.1)
    assert found.other[-1] == 0.2 and np.all(np.diff(found.p) > 0)
    # a symmetric orbit of SciPy with a multiplier 1: half a period later it is its mirror image
    others = dict(omega=1.0, K2=0.2, K4=1.0, damping=0.2)

    def equations(x):
        end, M = flowed(x[:2], 0.5, x[2], **others)
        return np.append(end + x[:2], np.linalg.det(M - np.eye(2)))

    start = [found.states.u[-1, 0], found.states.v[-1, 0], found.p[-1]]
    assert_allclose(root(equations, start, tol=1e-12).x, start, atol=1e-7)


def test_a_doubling_is_followed_in_the_frequency(well):
    found = well.locus(0, duffing, 1.2, 1.1, period=lambda f, w: 2 * jnp.pi / w, arclength=0.1)
    assert found.other[-1] == 1.1
    start = [found.states.u[-1, 0], found.states.v[-1, 0]]
    orbit, multipliers = shooting(start, 1, found.p[-1], omega=1.1)
    assert_allclose(start, orbit, atol=1e-7)
    assert abs(multipliers.real.min() + 1) < 5e-8
    assert found.p_error.max() < 1e-8
    with refused("make: expected lattices that at `start`"):
        well.locus(0, duffing, 1.25, 1.1, period=lambda f, w: 2 * jnp.pi / w)


def hump(omega, force, damping=0.05):
    """Two sites that move alike, as in `test_forced`."""
    drive = gx.Harmonic(force, omega)
    law, bond = gx.Polynomial(1.0, 0.0, 0.1), gx.Bond(gx.Shift(1, "free"), gx.Linear(0.3))
    terms = bond, gx.OnSite(law), gx.Damping(damping), gx.Drive(drive, 0), gx.Drive(drive, 1)
    return gx.Lattice(jnp.ones(2), terms)


def fold_of_scipy(force, start):
    """u, v and omega of a fold by SciPy: an orbit with det(M - 1) = 0."""

    def equations(x):
        end, M = flowed(x[:2], 1, force, omega=x[2], K2=1.0, K4=0.1, damping=0.05)
        return np.append(end - x[:2], np.linalg.det(M - np.eye(2)))

    return root(equations, start, tol=1e-12).x


@pytest.mark.slow
def test_folds_of_a_duffing_pair_and_their_cusp():
    period = lambda omega, *_: 2 * jnp.pi / omega
    branch = forced_branch(lambda w: hump(w, 0.1), 0.7, 1.4, period=period)
    found = branch.locus(0, hump, 0.1, 0.0, period=period, points=70)
    for i in (0, 20, 40, 65):
        start = [found.states.u[i, 0], found.states.v[i, 0], found.p[i]]
        assert_allclose(found.p[i], fold_of_scipy(found.other[i], start)[2], atol=1e-8)
    (cusp,) = found.special
    assert cusp.kind == "cusp" and found.other.min() >= cusp.other - 1e-9
    # both folds come to it: the branch in omega is single-valued below, and has two folds above
    for factor, folds in ((0.995, 0), (1.005, 2)):
        force = factor * cusp.other
        there = forced_branch(
            lambda w: hump(w, force), 0.9, 1.06, period=period, longest_arclength=0.02
        )
        assert len(there.folds) == folds
    assert_allclose([cusp.p, cusp.other], [1.04417, 0.05393], rtol=1e-4)


class OneWall:
    """Two beads between walls of which the left one shakes, as in `test_forced`: a torus beyond 0.36575."""

    omega = 3.346

    def __call__(self, amplitude, damping=0.05):
        chain = gx.scenes.monomer(2, precompression=1.0)
        return driven_chain(chain, amplitude, self.omega, ends="left", damping=damping)


@pytest.fixture(scope="module")
def shaken():
    return forced_branch(OneWall(), 0.3, 0.4, period=2 * np.pi / OneWall.omega)


@pytest.mark.slow
def test_a_torus_beyond_a_neimark_sacker_point(shaken):
    (event,) = shaken.bifurcations
    form = shaken.normal_form(0)
    assert event.kind == "Neimark-Sacker" and form.criticality == "supercritical"
    tori = shaken.switch(0, points=40, longest_arclength=0.3)
    assert_allclose(tori.rotation[0], np.angle(event.multiplier), atol=1e-5)
    assert tori.outcome == "p reached 0.4." and (tori.verdict[1:] == "stable").all()
    # one exponent along the circle, and damping takes the volume
    assert np.all(np.abs(tori.exponents[:, 0]) <= tori.exponents_error[:, 0] + 1e-14)
    assert_allclose(tori.exponents.sum(1), -0.1, atol=1e-9)
    last = tori.torus(-1)
    lattice, start = OneWall()(tori.p[-1]), last.state(0.3)
    start = gx.State(*map(jnp.asarray, start))
    end = gx.Flow(100 * 500)(start, 0.0, 500 * last.period, lattice)
    error = 500 * last.rotation_error * 0.1 + np.max(last.error.u)
    assert_allclose(end.u, last.state(0.3, 500).u, atol=max(error, 1e-10))
    # a long run comes to the circle: every point of its section is a state of the torus
    run = gx.Flow(60 * 3000)
    off = gx.State(start.u * 1.05, start.v)
    y = run(off, 0.0, 3000 * last.period, lattice)
    angles = np.linspace(0, 2 * np.pi, 4001)
    circle = np.array([np.concatenate(last.state(a)) for a in angles])
    away = np.linalg.norm(circle - np.concatenate(y), axis=1).min()
    # half the distance of two of the 4001 states
    assert away < 1e-3 * np.ptp(circle, axis=0).max()


@pytest.mark.slow
def test_a_doubled_orbit_of_beads_is_where_a_run_settles():
    """In SI: two steel beads of 9.5 mm between walls, precompressed, of which the left one shakes at 2.449 omega_0."""
    stiffness, mass, load = 6.0e9, 3.6e-3, 20.0
    d0 = (load / stiffness) ** (2 / 3)
    rate = np.sqrt(stiffness * np.sqrt(d0) / mass)
    chain = gx.scenes.monomer(2, mass=mass, stiffness=stiffness, precompression=load)
    make = lambda a: driven_chain(chain, a * d0, 2.449 * rate, ends="left", damping=0.05 * rate)
    T = 2 * np.pi / (2.449 * rate)
    branch = forced_branch(make, 0.1, 0.18, period=T)
    (event,) = branch.bifurcations
    assert event.kind == "period doubling" and event.p == pytest.approx(0.1628306, rel=1e-6)
    doubled = branch.switch(0, points=60, longest_arclength=0.5)
    assert branch.normal_form(0).criticality == "supercritical" and doubled.verdict[-1] == "stable"
    p, i = doubled.p[-1], -1
    start = gx.State(1.05 * doubled.states.u[i], doubled.states.v[i])
    end = gx.Flow(60 * 20000)(start, 0.0, 20000 * T, make(p))
    later = gx.Flow(60)(end, 0.0, T, make(p))
    away = [np.abs(np.asarray(y.u) - doubled.states.u[i]).max() / d0 for y in (end, later)]
    assert min(away) < 1e-7 < 1e-3 < max(away)


def frequency(E, mass):
    """Of m x'' + x + x^3 = 0 at the energy E."""
    from scipy.special import ellipk

    square = np.sqrt(1 + 4 * E) - 1
    k2 = square / (2 * (1 + square))
    return np.pi * np.sqrt((1 + square) / mass) / (2 * ellipk(k2))


def test_a_torus_of_two_oscillators_by_themselves():
    masses = np.array([1.0, 2.0])
    pair = gx.Lattice(jnp.asarray(masses), (gx.OnSite(gx.Polynomial(1.0, 0.0, 1.0)),))
    found = gx.orbits.torus(pair, (0, 1), (0.5, 0.3), tolerance=1e-12)
    u, v = (np.asarray(x) for x in found.states)
    E = masses * v**2 / 2 + u**2 / 2 + u**4 / 4
    assert np.ptp(E, axis=0).max() < 1e-12
    # the first mode is that of the heavy site
    assert_allclose(found.omega, [frequency(E[0, 1], 2.0), frequency(E[0, 0], 1.0)], rtol=1e-12)


def test_a_torus_in_si_is_that_in_scaled_numbers():
    def pair(mass, stiffness, length):
        law = gx.Polynomial(stiffness, 0.0, stiffness / length**2)
        bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(0.3 * stiffness))
        return gx.Lattice(mass * jnp.array([1.0, 2.0]), (gx.OnSite(law), bond))

    scaled = gx.orbits.torus(pair(1.0, 1.0, 1.0), (0, 1), (0.5, 0.3))
    si = gx.orbits.torus(pair(3e-3, 2e6, 1e-6), (0, 1), (0.5e-6, 0.3e-6))
    rate = np.sqrt(2e6 / 3e-3)
    assert_allclose(np.array(si.omega) / rate, scaled.omega, rtol=1e-9)
    assert_allclose(np.asarray(si.states.u) / 1e-6, scaled.states.u, atol=1e-9)


@pytest.mark.slow
def test_a_torus_of_a_toda_ring_over_ten_thousand_periods():
    ring = gx.scenes.toda(4, boundary="periodic")
    found = gx.orbits.torus(ring, (1, 3), (0.2, 0.1), tolerance=1e-12)
    start = gx.State(*map(jnp.asarray, found.state(0.4)))
    end = gx.Flow(60 * 10000)(start, 0.0, 1e4 * found.period, ring)
    later = found.state(0.4, 10000)
    assert_allclose(end.u, later.u, atol=1e-8)
    assert_allclose(end.v, later.v, atol=1e-8)
    exponents, error = found.exponents()
    assert np.all(np.abs(exponents) <= error)


def pair(coupling):
    bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(coupling))
    return gx.Lattice(jnp.ones(2), (bond, gx.OnSite(gx.Polynomial(1.0, 0.0, 1.0))))


def test_breathers_leave_the_mode_of_opposite_phase():
    """x1 = -x2 is a Duffing oscillator; one site moves more than the other beyond its pitchfork."""
    family = gx.breathers.family(pair(0.1), mode=1, points=40, amplitude=2.0)
    (event,) = family.bifurcations
    sides = [family.switch(0, side=side, points=8) for side in (1, -1)]
    for side in sides:
        assert (side.verdict == "stable").all()
        assert np.all(np.diff(np.abs(np.abs(side.u[:, 0]) - np.abs(side.u[:, 1]))) > 0)
    assert_allclose(sides[0].u, -sides[1].u[:, ::-1], atol=1e-7)
    # by itself: a breather of SciPy
    i, omega = 6, float(sides[0].omega[6])

    def field(t, y):
        u, v = y[:2], y[2:]
        push = 0.1 * (u[0] - u[1]) * np.array([1, -1])
        return np.concatenate([v, -u - u**3 - push])

    def half(u):
        return solve_ivp(
            field, (0, np.pi / omega), [*u, 0, 0], method="DOP853", rtol=1e-12, atol=1e-13
        ).y[2:, -1]

    assert_allclose(sides[0].u[i], fsolve(half, sides[0].u[i], xtol=1e-13), atol=1e-6)
    found = family.locus(0, pair, 0.1, 0.2, arclength=0.2)
    again = gx.breathers.family(pair(0.2), mode=1, points=60, amplitude=2.0)
    assert_allclose(found.p[-1], again.bifurcations[0].p, rtol=1e-8)
    with refused("branch of forced orbits"):
        family.normal_form(0)


def test_a_diagram_and_what_is_refused(well):
    found = gx.orbits.diagram(well, points=3)
    assert len(found.branches) == 2 and found.parents == ((-1, -1), (0, 0)) and not found.failed
    ax = gx.plots.diagram(found)
    assert ax.get_ylabel() and len(ax.lines) >= 3
    with refused("conserv|positions alone"):
        gx.orbits.torus(duffing(0.1), (0, 1), (0.1, 0.1))
    with refused("known numbers"):
        jax.jit(lambda k: gx.orbits.torus(pair(k), (0, 1), (0.1, 0.1)).period)(0.1)
    with refused("two modes"):
        gx.orbits.torus(pair(0.1), (0, 0), (0.1, 0.1))
    further = well.continue_in(
        3, lambda w: duffing(well.p[3], w), 1.2, 1.3, period=lambda w: 2 * jnp.pi / w
    )
    assert_allclose(further.states.u[0], well.states.u[3], atol=1e-6)


def uneven(quadratic):
    """A light oscillator that drives a heavy one of half its frequency."""
    bond = gx.Bond(gx.Shift(1, "free"), gx.Polynomial(0.1, quadratic, 0.1))
    return gx.Lattice(jnp.array([1.0, 4.4]), (gx.OnSite(gx.Linear(1.0)), bond))


@pytest.mark.slow
def test_a_breather_doubles_its_period():
    family = gx.breathers.family(
        uneven(0.3), points=40, longest_arclength=0.3, amplitude=1.0, mode=1
    )
    (event,) = gx.breathers.bifurcations(family)
    assert event.kind == "period doubling"
    doubled = family.switch(event, points=8)
    assert (doubled.verdict == "stable").all()
    # the heavy one's share begins at zero, at half the frequency
    assert_allclose(2 * doubled.omega[0], event.p, rtol=1e-4)
    assert np.all(np.diff(np.abs(doubled.u[:, 1])) > 0)

    def field(t, y):
        r = y[1] - y[0]
        push = 0.1 * r + 0.1 * r**3
        return [
            y[2],
            y[3],
            -y[0] + push + sign * 0.3 * r**2,
            (-y[1] - push - sign * 0.3 * r**2) / 4.4,
        ]

    ends = []
    for sign in (1, -1):  # whichever way the law counts its strain
        span = 0, np.pi / doubled.omega[-1]
        run = solve_ivp(
            field, span, [*doubled.u[-1], 0, 0], method="DOP853", rtol=1e-12, atol=1e-13
        )
        ends.append(np.abs(run.y[2:, -1]).max())
    assert min(ends) < 1e-8 and max(ends) > 1e-2
    found = family.locus(event, uneven, 0.3, 0.35, arclength=0.2)
    again = gx.breathers.family(
        uneven(0.35), points=40, longest_arclength=0.3, amplitude=1.0, mode=1
    )
    assert_allclose(found.p[-1], gx.breathers.bifurcations(again)[0].p, rtol=1e-7)


@pytest.mark.slow
def test_a_krein_collision_stays_where_scaling_says():
    """beta u^2 is all that a beta-FPUT chain knows: its collisions are at one frequency."""
    make = lambda beta: gx.scenes.fput(6, beta=beta)
    family = gx.breathers.family(make(1.0), mode=1, points=60, longest_arclength=0.4, amplitude=1.5)
    event = next(b for b in gx.breathers.bifurcations(family) if b.kind == "Krein collision")
    found = family.locus(event, make, 1.0, 1.3, arclength=0.1)
    assert_allclose(found.p, event.p, rtol=1e-8)
    assert_allclose(found.p, found.p[0], rtol=1e-10)
    assert_allclose(found.angle, found.angle[0], rtol=1e-8)
    amplitude = np.abs(found.states.u).max(1) * np.sqrt(found.other)
    assert_allclose(amplitude, amplitude[0], rtol=1e-7)


def shaken_bond(strength, omega):
    """As `Parametric` in `test_forced`: two modes that a bond excites together near the sum of their frequencies."""
    bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(1.0))
    bond = gx.Modulated(bond, gx.Harmonic(strength, omega, mean=1.0))
    return gx.Lattice(jnp.array([1.0, 2.3]), (bond, gx.OnSite(gx.Linear(1.0)), gx.Damping(0.02)))


@pytest.mark.slow
def test_torus_points_over_the_drive_meet_a_resonance():
    stiffness = np.array([[2.0, -1.0], [-1.0 / 2.3, 2.0 / 2.3]])
    omega = np.sqrt(np.linalg.eigvals(stiffness)).sum()
    period = lambda p, w: 2 * jnp.pi / w
    branch = forced_branch(lambda p: shaken_bond(p, omega), 0.0, 0.9, period=2 * np.pi / omega)
    assert branch.bifurcations[0].kind == "Neimark-Sacker"
    found = branch.locus(0, shaken_bond, omega, 1.05 * omega, period=period, arclength=0.05)
    assert [s.kind for s in found.special] == ["1:3"]
    where = found.special[0]
    rest = gx.State(jnp.zeros(2), jnp.zeros(2))
    lattice = shaken_bond(where.p, where.other)
    map_ = gx.Flow(400).derivative(rest, 0.0, 2 * np.pi / where.other, lattice)[1]
    multipliers = np.linalg.eigvals(np.asarray(map_))
    assert_allclose(np.abs(multipliers).max(), 1, atol=1e-9)
    angles = np.abs(np.angle(multipliers))
    assert np.abs(angles - 2 * np.pi / 3).min() < 1e-8
