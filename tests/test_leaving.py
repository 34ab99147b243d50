"""What leaves a branch: pitchforks, doublings, tori, and their curves in two parameters, against SciPy's shooting."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ended
from known_orbits import MODES, duffing, flowed, pair, period_of, shaken, shaken_bond, shooting
from numpy.testing import assert_allclose
from refusals import refused
from scipy.optimize import fsolve, root
from scipy.special import ellipk

import granjax as gx
from granjax.breathers import bifurcations, family
from granjax.forced import forced_branch
from granjax.orbits import leaving, torus
from granjax.orbits.tori import _lockings

pytestmark = pytest.mark.slow


def start_of(states, i=None):
    """u and v of the first site."""
    return np.array([x[0] if i is None else x[i, 0] for x in (states.u, states.v)])


# period doublings -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def well():
    beside = gx.State(jnp.ones(2), jnp.zeros(2))
    return forced_branch(duffing, 0.2, 0.29, period=2 * np.pi / 1.2, guess=beside, transient=60)


def test_a_doubled_orbit_is_that_of_scipy(well):
    (event,) = well.bifurcations
    assert event.kind == "period doubling"
    _, multipliers = shooting(start_of(event.state), 1, event.p)
    assert abs(multipliers.real.min() + 1) < 1e-6
    doubled = well.switch(0, points=12)
    assert (doubled.verdict == "stable").all()
    assert_allclose(doubled.periods, 4 * np.pi / 1.2)
    for i in (2, 11):
        start = start_of(doubled.states, i)
        p = doubled.p[i]
        orbit, multipliers = shooting(start, 2, p)
        error = max(np.max(doubled.state_error.u[i]), np.max(doubled.state_error.v[i]))
        assert_allclose(start, orbit, atol=1e-6)
        assert_allclose(start, orbit, atol=error)
        assert np.abs(multipliers).max() < 1
        # no orbit of one period
        assert np.abs(flowed(orbit, 1, p)[0] - orbit).max() > 1e-3
    # the other side is the same orbit a period later
    other = well.switch(0, side=-1, points=4)
    start = start_of(other.states, 3)
    p = other.p[3]
    assert_allclose(start, shooting(start, 2, p)[0], atol=1e-6)
    later = [np.interp(p, doubled.p, x[:, 0]) for x in (doubled.states.u, doubled.states.v)]
    assert_allclose(flowed(start, 1, p)[0], later, atol=1e-3)


def test_the_normal_form_predicts_the_doubled_orbit(well):
    # x -> -(1 + a dp) x + c x^3: x^2 = a dp/c beyond the doubling
    form = well.normal_form(0)
    event = well.bifurcations[0]
    assert form.criticality == "supercritical" and form.error < 1e-5 * form.coefficient
    doubled = well.switch(0, points=2, arclength=0.003)
    before, behind = (
        shooting(start_of(event.state), 1, event.p + step)[1].real.min() for step in (-1e-4, 1e-4)
    )
    growth = (before - behind) / 2e-4
    x = np.sqrt(growth * (doubled.p[0] - event.p) / form.coefficient)
    # the eigenvector has unit norm, the state in units of displacement and of displacement times 2 pi/T
    size = lambda u, v: np.sqrt(np.sum(u**2) + np.sum((v / 1.2) ** 2))
    u, v = (np.asarray(y) for y in event.state)
    away = size(doubled.states.u[0] - u, doubled.states.v[0] - v)
    assert_allclose(away, x * size(u, v), rtol=0.02)


def test_a_doubling_is_followed_in_the_frequency(well):
    period = lambda f, w: 2 * jnp.pi / w
    found = well.locus(0, duffing, 1.2, 1.1, period=period, arclength=0.1)
    assert found.other[-1] == 1.1
    start = start_of(found.states, -1)
    orbit, multipliers = shooting(start, 1, found.p[-1], omega=1.1)
    assert_allclose(start, orbit, atol=1e-7)
    assert abs(multipliers.real.min() + 1) < 5e-8
    assert found.p_error.max() < 1e-8
    with refused("make: expected lattices that at `start`"):
        well.locus(0, duffing, 1.25, 1.1, period=period)


def test_a_diagram_of_branches_and_a_branch_in_another_parameter(well):
    found = gx.orbits.diagram(well, points=3)
    assert len(found.branches) == 2 and found.parents == ((-1, -1), (0, 0)) and not found.failed
    assert found.outcome == "2 branches."
    alone = gx.orbits.diagram(well, most=1)
    assert len(alone.branches) == 1 and "More leave them: give most=" in alone.outcome
    ax = gx.plots.diagram(found)
    assert ax.get_ylabel() and len(ax.lines) >= 3
    other = lambda w: duffing(well.p[3], w)
    further = well.continue_in(3, other, 1.2, 1.3, period=period_of)
    assert_allclose(further.states.u[0], well.states.u[3], atol=1e-6)


def test_sides_and_depths_that_do_not_exist_are_refused(well):
    for call, words in (
        (lambda: well.switch(0, side=0), "side: expected 1 or -1, got 0"),
        (lambda: well.switch(9), "i: expected the index of one of . bifurcations, got 9"),
        (lambda: gx.orbits.diagram(well, 1.5), "depth: expected a whole number"),
        (lambda: gx.orbits.diagram(well, most=0), "most: expected a whole number not below 1"),
    ):
        with refused(words):
            call()


# pitchforks and folds -------------------------------------------------------------------------------------------------


def twofold(force, damping=0.1):
    return duffing(force, 1.0, 0.2, 1.0, damping)


@pytest.fixture(scope="module")
def symmetric():
    guess = gx.State(jnp.array([1.8, 0]), jnp.zeros(2))
    return forced_branch(twofold, 2.0, 2.6, period=2 * np.pi, guess=guess, transient=40)


def test_both_sides_of_a_pitchfork_are_orbits_of_scipy(symmetric):
    (event,) = symmetric.bifurcations
    form = symmetric.normal_form(0)
    assert event.kind == "branch point"
    assert form.kind == "pitchfork" and form.criticality == "supercritical"
    others = dict(omega=1.0, K2=0.2, K4=1.0, damping=0.1)
    for sign in (1, -1):
        side = symmetric.switch(0, side=sign, points=8)
        assert (side.verdict == "stable").all() and side.p[-1] > event.p
        start = start_of(side.states, 5)
        p = side.p[5]
        orbit, _ = shooting(start, 1, p, **others)
        assert_allclose(start, orbit, atol=1e-6)
        # the mirror image half a period later is another orbit, that of the other side
        assert np.abs(flowed(orbit, 0.5, p, **others)[0] + orbit).max() > 1e-2
    _, multipliers = shooting(start_of(event.state), 1, event.p, **others)
    assert abs(multipliers.real.max() - 1) < 1e-6


def test_a_pitchfork_is_followed_in_the_damping(symmetric):
    found = symmetric.locus(0, twofold, 0.1, 0.2, arclength=0.1)
    assert found.other[-1] == 0.2 and np.all(np.diff(found.p) > 0)

    # a symmetric orbit of SciPy with a multiplier 1: half a period later it is its mirror image
    def equations(x):
        end, M = flowed(x[:2], 0.5, x[2], omega=1.0, K2=0.2, K4=1.0, damping=0.2)
        return np.append(end + x[:2], np.linalg.det(M - np.eye(2)))

    start = np.append(start_of(found.states, -1), found.p[-1])
    assert_allclose(root(equations, start, tol=1e-12).x, start, atol=1e-7)


def test_folds_of_a_duffing_pair_and_their_cusp():
    found = forced_branch(pair, 0.7, 1.4, period=period_of).locus(
        0, pair, 0.1, 0.0, period=period_of, points=70
    )
    for i in (0, 20, 65):

        def equations(x):
            how = dict(omega=x[2], K2=1.0, K4=0.1, damping=0.05)
            end, M = flowed(x[:2], 1, found.other[i], **how)
            return np.append(end - x[:2], np.linalg.det(M - np.eye(2)))

        start = np.append(start_of(found.states, i), found.p[i])
        assert_allclose(found.p[i], root(equations, start, tol=1e-12).x[2], atol=1e-8)
    (cusp,) = found.special
    assert cusp.kind == "cusp" and found.other.min() >= cusp.other - 1e-9
    # both folds come to it: the branch in omega is single-valued below, and has two folds above
    for factor, folds in ((0.995, 0), (1.005, 2)):
        make = lambda w: pair(w, factor * cusp.other)
        there = forced_branch(make, 0.9, 1.06, period=period_of, longest_arclength=0.02)
        assert len(there.folds) == folds
    assert_allclose([cusp.p, cusp.other], [1.04417, 0.05393], rtol=1e-4)


def test_what_leaves_a_branch_at_rest_is_the_same_in_every_unit_of_length():
    def branch_of(length):
        def make(strength):
            own = gx.OnSite(gx.Polynomial(jnp.array([1.0, 1.7]), 0.5 / length))
            own = gx.Modulated(own, gx.Harmonic(strength, 1.0, mean=1.0))
            return gx.Lattice(jnp.ones(2), (own, gx.Damping(0.1)))

        still = gx.states.rest(make(0.0))
        return forced_branch(make, 0.7, 0.8, period=2 * np.pi, guess=still, steps=64)

    scaled = branch_of(1.0)
    micro = branch_of(2.0**-20)
    forms = [branch.normal_form(0) for branch in (scaled, micro)]
    assert forms[0].kind == "transcritical" and forms[0] == forms[1]
    for sign in (1, -1):
        side = micro.switch(0, side=sign, points=2)
        assert_allclose(side.u * 2.0**20, scaled.switch(0, side=sign, points=2).u, rtol=1e-12)

        def field(t, y):
            u, v = y
            return [v, -0.1 * v - (1 + side.p[0] * np.cos(t)) * (u + 0.5 * u**2)]

        start = start_of(side.states, 0) * 2.0**20
        assert_allclose(ended(field, 2 * np.pi, start), start, atol=1e-8 * np.abs(start).max())


def test_a_branch_from_rest_is_the_same_in_every_unit_of_length():
    def branch_of(length):
        law = gx.Polynomial(1.0, 0.3 / length, 0.2 / length**2)
        chain = gx.Lattice(jnp.ones(3), gx.Bond(gx.Shift(1, "fixed"), law))
        make = lambda amplitude: gx.driven.driven_chain(chain, amplitude * length, 0.5, damping=0.2)
        return forced_branch(make, 0.0, 0.02, period=4 * np.pi, steps=64)

    scaled = branch_of(1.0)
    micro = branch_of(2.0**-20)
    assert_allclose(micro.p, scaled.p, rtol=1e-12)
    assert_allclose(micro.u * 2.0**20, scaled.u, rtol=1e-9, atol=1e-12)


# tori -----------------------------------------------------------------------------------------------------------------


def test_a_torus_beyond_a_neimark_sacker_point_is_where_a_run_settles():
    # two beads between walls of which the left one shakes
    make = lambda amplitude: shaken(2, amplitude, 3.346, 0.05, ends="left")
    branch = forced_branch(make, 0.3, 0.385, period=2 * np.pi / 3.346)
    (event,) = branch.bifurcations
    form = branch.normal_form(0)
    assert event.kind == "Neimark-Sacker" and form.criticality == "supercritical"
    assert event.p == pytest.approx(0.3657490, rel=1e-6) and abs(abs(event.multiplier) - 1) < 1e-8
    tori = branch.switch(0, points=40, longest_arclength=0.3)
    assert_allclose(tori.rotation[0], np.angle(event.multiplier), atol=1e-5)
    assert tori.outcome == "p reached 0.385." and (tori.verdict[1:] == "stable").all()
    # one exponent along the circle, and damping takes the volume
    assert np.all(np.abs(tori.exponents[:, 0]) <= tori.exponents_error[:, 0] + 1e-14)
    assert_allclose(tori.exponents.sum(1), -0.1, atol=1e-9)
    last = tori.torus(-1)
    lattice = make(tori.p[-1])
    start = gx.State(*map(jnp.asarray, last.state(0.3)))
    end = gx.Flow(100 * 500)(start, 0.0, 500 * last.period, lattice)
    error = 500 * last.rotation_error * 0.1 + np.max(last.error.u)
    assert_allclose(end.u, last.state(0.3, 500).u, atol=max(error, 1e-10))
    # a long run comes to the circle: every point of its section is a state of the torus
    off = gx.State(start.u * 1.05, start.v)
    y = np.concatenate(gx.Flow(60 * 3000)(off, 0.0, 3000 * last.period, lattice))
    circle = [np.concatenate(last.state(a)) for a in np.linspace(0, 2 * np.pi, 4001)]
    # half the distance of two of the 4001 states
    away = np.linalg.norm(circle - y, axis=1).min()
    assert away < 1e-3 * np.ptp(circle, axis=0).max()


@pytest.mark.slow
def test_tori_that_need_more_angles_than_there_are_say_so(monkeypatch):
    monkeypatch.setattr("granjax.orbits.tori.MOST", 60)
    make = lambda amplitude: shaken(2, amplitude, 3.346, 0.05, ends="left")
    branch = forced_branch(make, 0.355, 0.385, period=2 * np.pi / 3.346)
    tori = branch.switch(0, points=4, longest_arclength=0.3)
    worst = np.max(tori.error.u)
    assert worst > 1e-6 * tori.amplitude.max()
    assert f"known to {worst:.1e} only, from 15 angles" in tori.outcome


def test_lockings_are_where_the_rotation_passes_a_fraction():
    # up, down to a quarter, where it stays; denominators up to eight in their lowest terms
    p = np.array([0.0, 1.0, 3.0, 4.0])
    rotation = np.array([0.32, 0.36, 0.25, 0.25])
    third = 1 / 3
    want = [
        ((third - 0.32) / 0.04, "1/3"),
        (1 + 2 * (0.36 - third) / 0.11, "1/3"),
        (3.0, "1/4"),
        (1 + 2 * (0.36 - 2 / 7) / 0.11, "2/7"),
    ]
    found, fractions = zip(*_lockings(p, rotation))
    assert fractions == tuple(name for _, name in want)
    assert_allclose(found, [x for x, _ in want], rtol=1e-12)


def test_a_torus_of_two_oscillators_by_themselves_has_their_frequencies():
    masses = np.array([1.0, 2.0])
    own = gx.OnSite(gx.Polynomial(1.0, 0.0, 1.0))
    found = torus(gx.Lattice(jnp.asarray(masses), own), (0, 1), (0.5, 0.3), tolerance=1e-12)
    u, v = (np.asarray(x) for x in found.states)
    E = masses * v**2 / 2 + u**2 / 2 + u**4 / 4
    assert np.ptp(E, axis=0).max() < 1e-12
    # m x'' + x + x^3 = 0 at the energy E
    root = np.sqrt(1 + 4 * E[0])
    exact = np.pi * np.sqrt(root / masses) / (2 * ellipk((root - 1) / (2 * root)))
    # the first mode is that of the heavy site
    assert_allclose(found.omega, exact[::-1], rtol=1e-12)
    exponents, error = found.exponents()
    assert np.all(np.abs(exponents) <= error)


@pytest.mark.slow
def test_errors_of_exponents_that_are_all_zero_cover_them():
    found = torus(gx.scenes.fput(8, alpha=0.25, beta=0.0), (0, 1), (0.3, 0.1), tolerance=1e-6)
    exponents, error = found.exponents()
    assert np.all(np.abs(exponents) <= error) and error.max() < 1e-5


def test_a_torus_in_si_is_that_in_scaled_numbers():
    def of(mass, stiffness, length):
        law = gx.Polynomial(stiffness, 0.0, stiffness / length**2)
        bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(0.3 * stiffness))
        chain = gx.Lattice(mass * jnp.array([1.0, 2.0]), (gx.OnSite(law), bond))
        return torus(chain, (0, 1), (0.5 * length, 0.3 * length))

    scaled = of(1.0, 1.0, 1.0)
    si = of(3e-3, 2e6, 1e-6)
    assert_allclose(np.array(si.omega) / np.sqrt(2e6 / 3e-3), scaled.omega, rtol=1e-9)
    assert_allclose(np.asarray(si.states.u) / 1e-6, scaled.states.u, atol=1e-9)


def test_what_has_no_torus_is_refused():
    for chain, modes, words in (
        (duffing(0.1), (0, 1), "conserv|positions alone"),
        (two(0.1), (0, 0), "two modes"),
    ):
        with refused(words):
            torus(chain, modes, (0.1, 0.1))
    with refused("known numbers"):
        jax.jit(lambda k: torus(two(k), (0, 1), (0.1, 0.1)).period)(0.1)


def test_torus_points_over_the_drive_meet_a_resonance():
    omega = MODES.sum()
    period = lambda p, w: 2 * jnp.pi / w
    branch = forced_branch(lambda p: shaken_bond(p, omega), 0.0, 0.9, period=2 * np.pi / omega)
    assert branch.bifurcations[0].kind == "Neimark-Sacker"
    found = branch.locus(0, shaken_bond, omega, 1.05 * omega, period=period, arclength=0.05)
    assert [s.kind for s in found.special] == ["1:3"]
    where = found.special[0]
    lattice = shaken_bond(where.p, where.other)
    rest = gx.states.rest(lattice)
    M = gx.Flow(400).derivative(rest, 0.0, 2 * np.pi / where.other, lattice)[1]
    multipliers = np.linalg.eigvals(np.asarray(M))
    assert_allclose(np.abs(multipliers).max(), 1, atol=1e-9)
    assert np.abs(np.abs(np.angle(multipliers)) - 2 * np.pi / 3).min() < 1e-8


def test_a_curve_of_torus_points_passes_where_its_vector_is_real_along_one_direction():
    masses = jnp.array([1.0, 2.3, 0.6])
    K = np.array([[2.0, -1.0, 0.0], [-1.0, 2.7, -0.7], [0.0, -0.7, 1.7]])
    omega = np.sqrt(np.sort(np.linalg.eigvals(K / masses[:, None]).real))[:2].sum()

    def make(strength, omega):
        bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(jnp.array([1.0, 0.7])))
        shaken = gx.Bond(gx.Shift(1, "free"), gx.Linear(jnp.array([1.0, 0.0])))
        shaken = gx.Modulated(shaken, gx.Harmonic(strength, omega, mean=0.0))
        return gx.Lattice(masses, (bond, shaken, gx.OnSite(gx.Linear(1.0)), gx.Damping(0.02)))

    branch = forced_branch(lambda p: make(p, omega), 0.0, 0.9, period=2 * np.pi / omega)
    period = lambda p, w: 2 * jnp.pi / w
    # it turns, and comes back to where it began
    found = branch.locus(0, make, omega, 0.8 * omega, period=period, arclength=0.1)
    assert "reached" in found.outcome and len(found.p) < 70
    lattice = make(found.p[-2], found.other[-2])
    flow = gx.Flow(800).derivative(
        gx.states.rest(lattice), 0.0, 2 * np.pi / found.other[-2], lattice
    )
    multipliers = np.linalg.eigvals(np.asarray(flow[1]))
    assert np.abs(multipliers - np.exp(1j * found.angle[-2])).min() < 1e-6


class VanDerPol(gx.Term):
    mu: jax.Array

    def force(self, t, u, v, mass):
        return self.mu * (1 - u * u) * v


def test_torus_points_end_where_two_multipliers_are_one_or_minus_one():
    # fold and doubling curves touch the curve there: it must not turn into them
    quadratic = 0.15
    period = lambda f, w: 2 * jnp.pi / w

    def make(f, w):
        forces = VanDerPol(jnp.array([0.4, -0.4])), gx.Drive(gx.Harmonic(f, w), 0)
        return gx.Lattice(jnp.ones(2), (gx.OnSite(gx.Polynomial(1.0, quadratic, 0.0)), *forces))

    def monodromy(start, f, w):
        def field(t, y):
            x, v = y[:2]
            force = -x - quadratic * x**2 + 0.4 * (1 - x**2) * v + f * np.cos(w * t)
            slope = [[0, 1], [-1 - 2 * quadratic * x - 0.8 * x * v, 0.4 * (1 - x**2)]]
            return [v, force, *(slope @ y[2:].reshape(2, 2)).ravel()]

        return ended(field, 2 * np.pi / w, [*start, 1, 0, 0, 1])[2:].reshape(2, 2)

    branch = forced_branch(
        lambda f: make(f, 1.08),
        0.5,
        0.4,
        period=2 * np.pi / 1.08,
        transient=60,
        arclength=0.3,
        steps=300,
        solver=diffrax.Tsit5(),
    )
    for until, kind, both in ((1.05, "1:1", 1), (1.75, "1:2", -1)):
        found = branch.locus(0, make, 1.08, until, period=period, arclength=0.3, points=60)
        assert 0 <= found.angle.min() and found.angle.max() <= np.pi
        where = found.special[-1]
        assert where.kind == kind
        M = monodromy(start_of(where.state), where.p, where.other)
        assert_allclose([np.trace(M), np.linalg.det(M)], [2 * both, 1], atol=1e-8)
        # no multiple of the identity, at which fold and doubling curves would not touch
        assert np.abs(M - both * np.eye(2)).max() > 0.1


# breathers ------------------------------------------------------------------------------------------------------------


def two(coupling):
    bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(coupling))
    return gx.Lattice(jnp.ones(2), (bond, gx.OnSite(gx.Polynomial(1.0, 0.0, 1.0))))


def test_breathers_leave_the_mode_of_opposite_phase():
    # x1 = -x2 is a Duffing oscillator; one site moves more than the other beyond its pitchfork
    branch = family(two(0.1), mode=1, points=40, amplitude=2.0)
    (event,) = branch.bifurcations
    sides = [branch.switch(0, side=side, points=8) for side in (1, -1)]
    for side in sides:
        assert (side.verdict == "stable").all()
        assert np.all(np.diff(np.abs(np.abs(side.u[:, 0]) - np.abs(side.u[:, 1]))) > 0)
    assert_allclose(sides[0].u, -sides[1].u[:, ::-1], atol=1e-7)
    # by itself: a breather of SciPy
    u = sides[0].u[6]
    omega = float(sides[0].omega[6])

    def field(t, y):
        push = 0.1 * (y[0] - y[1]) * np.array([1, -1])
        return np.concatenate([y[2:], -y[:2] - y[:2] ** 3 - push])

    half = lambda u: ended(field, np.pi / omega, [*u, 0, 0])[2:]
    assert_allclose(u, fsolve(half, u, xtol=1e-13), atol=1e-6)
    found = branch.locus(0, two, 0.1, 0.2, arclength=0.2)
    again = family(two(0.2), mode=1, points=60, amplitude=2.0)
    assert_allclose(found.p[-1], again.bifurcations[0].p, rtol=1e-8)
    with refused("branch of forced orbits"):
        branch.normal_form(0)


def uneven(quadratic):
    """A light oscillator that drives a heavy one of half its frequency."""
    bond = gx.Bond(gx.Shift(1, "free"), gx.Polynomial(0.1, quadratic, 0.1))
    return gx.Lattice(jnp.array([1.0, 4.4]), (gx.OnSite(gx.Linear(1.0)), bond))


def test_a_breather_doubles_its_period():
    over = lambda quadratic: family(
        uneven(quadratic), points=40, longest_arclength=0.3, amplitude=1.0, mode=1
    )
    branch = over(0.3)
    (event,) = bifurcations(branch)
    assert event.kind == "period doubling"
    doubled = branch.switch(event, points=8)
    assert (doubled.verdict == "stable").all()
    # the heavy one's share begins at zero, at half the frequency
    assert_allclose(2 * doubled.omega[0], event.p, rtol=1e-4)
    assert np.all(np.diff(np.abs(doubled.u[:, 1])) > 0)
    ends = []
    for sign in (1, -1):  # whichever way the law counts its strain

        def field(t, y):
            r = y[1] - y[0]
            push = 0.1 * r + sign * 0.3 * r**2 + 0.1 * r**3
            return [*y[2:], push - y[0], (-y[1] - push) / 4.4]

        end = ended(field, np.pi / doubled.omega[-1], [*doubled.u[-1], 0, 0])
        ends.append(np.abs(end[2:]).max())
    assert min(ends) < 1e-8 and max(ends) > 1e-2
    found = branch.locus(event, uneven, 0.3, 0.35, arclength=0.2)
    assert_allclose(found.p[-1], bifurcations(over(0.35))[0].p, rtol=1e-7)


def test_a_krein_collision_stays_where_scaling_says():
    # beta u^2 is all that a beta-FPUT chain knows: its collisions are at one frequency
    make = lambda beta: gx.scenes.fput(6, beta=beta)
    branch = family(make(1.0), mode=1, points=60, longest_arclength=0.4, amplitude=1.5)
    event = next(b for b in bifurcations(branch) if b.kind == "Krein collision")
    found = branch.locus(event, make, 1.0, 1.3, arclength=0.1)
    assert_allclose(found.p, event.p, rtol=1e-8)
    assert_allclose(found.p, found.p[0], rtol=1e-10)
    assert_allclose(found.angle, found.angle[0], rtol=1e-8)
    amplitude = np.abs(found.states.u).max(1) * np.sqrt(found.other)
    assert_allclose(amplitude, amplitude[0], rtol=1e-7)


# normal forms of maps -------------------------------------------------------------------------------------------------


def test_the_neimark_sacker_coefficient_of_the_delayed_logistic_map_is_how_its_radius_decays(
    monkeypatch,
):
    """x' = 2 x (1 - y), y' = x about (1/2, 1/2), with multipliers exp(+-i pi/3): c = -1 for a unit eigenvector.

    Kuznetsov, Elements of Applied Bifurcation Theory, example 4.2.
    """
    of = lambda x: jnp.array([x[0] - x[1] - 2 * x[0] * x[1], x[0]])

    def derivative(family, z, steps, along):
        mapped = of
        for direction in along:
            mapped = leaving._slope(mapped, direction)
        return mapped(z) if along else jax.jacfwd(of)(z)

    monkeypatch.setattr(leaving, "_derivative", derivative)
    turn = np.exp(1j * np.pi / 3)
    _, found = leaving._coefficients(None, np.zeros(2), turn, 1)
    _, p, q = leaving._eigenvectors(np.array([[1.0, -1.0], [1.0, 0.0]]), turn)
    p = p / np.vdot(p, q).conj()
    count = 60_000
    radii = []
    x = 2 * np.real(0.01 * q)
    for _ in range(count + 6):
        radii.append(abs(np.vdot(p, x)))
        x = np.array([x[0] - x[1] - 2 * x[0] * x[1], x[0]])
    # r' = r + c r^3, over whole turns
    first = np.mean(radii[:6])
    last = np.mean(radii[-6:])
    assert found == pytest.approx((first**-2 - last**-2) / (2 * count), rel=1e-3)
    assert found == pytest.approx(-1, rel=1e-12)
