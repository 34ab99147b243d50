"""Stationary fronts of chains with dashpots: against momentum, energy, the equation of motion and simulations."""

from decimal import Decimal, localcontext

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from scipy.optimize import brentq

import granjax as gx
from granjax.profiles import tails
from granjax.shocks import dissipative_front

VACUUM = (gx.Hertz(), 1.0, 0.0, 0.3)


class Bump(gx.Law):
    """A law with a steep place."""

    opens = False

    def force(self, e):
        return e + e**2 + 0.5 * jnp.exp(-((e - 0.5) ** 2) / 0.01)

    def energy(self, e):
        return (
            e**2 / 2 + e**3 / 3 + 0.05 * jnp.sqrt(jnp.pi) / 2 * (1 + jax.lax.erf((e - 0.5) / 0.1))
        )


class Softening(gx.Law):
    """F = tanh(e)."""

    def force(self, e):
        return jnp.tanh(e)

    def energy(self, e):
        return jnp.log(jnp.cosh(e))


CASES = {
    "sonic vacuum": VACUUM,
    "strongly damped": (gx.Hertz(), 1.0, 0.0, 2.0),
    "precompressed": (gx.Hertz(2.5, 0.3), 1.0, 0.2, 0.15),
    "weak": (gx.Hertz(1.0, 1.0), 0.01, 0.0, 0.02),
    "strong": (gx.Toda(), 3.0, 0.0, 1.0),
    "rarefaction": (gx.Polynomial(1.0, -0.5), -0.3, 0.0, 0.05),
    "softening from compression": (Softening(), 0.2, 0.9, 0.2),
}


@pytest.fixture(scope="module")
def fronts():
    return {
        name: dissipative_front(law, behind, ahead, dashpot=eta, mass=1.3)
        for name, (law, behind, ahead, eta) in CASES.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_speed_beads_and_losses_follow_from_both_states(fronts, name):
    front = fronts[name]
    law, behind, ahead, eta = CASES[name]
    states = jnp.array([behind, ahead])
    jump = behind - ahead
    F, W = (np.asarray(f(states)) for f in (law.force, law.energy))
    speed = np.sqrt((F[0] - F[1]) / (1.3 * jump))
    assert_allclose([front.speed, front.piston], [speed, speed * jump], rtol=1e-12)
    power = speed * (F.mean() * jump - (W[0] - W[1]))
    assert_allclose(front.power, power, rtol=1e-6)
    # what the dashpots take of the profile itself
    x, dx = np.linspace(-500, 500, 100_001, retstep=True)
    rates = np.gradient(np.asarray(front.strain(x)), dx)
    assert_allclose(eta * speed**2 * np.sum(rates**2) * dx, power, rtol=3e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_profile_solves_the_equation_of_motion(fronts, name):
    front = fronts[name]
    law, behind, ahead, eta = CASES[name]
    jump = abs(behind - ahead)
    n = np.linspace(-9.3, 5.2, 59)
    h = 1e-3
    before = np.asarray(front.strain(n - 1))
    near = np.asarray(front.strain(n))
    v = front.velocity
    # v' = -s V', and strain rates by the differences of velocities
    force = law.force(jnp.asarray(before)) - law.force(jnp.asarray(near))
    drag = eta * (v(n - 1) - 2 * v(n) + v(n + 1))
    inertia = -1.3 * front.speed * (v(n + h) - v(n - h)) / (2 * h)
    assert np.abs(inertia - force - drag).max() < 3e-5 * 1.3 * front.speed**2 * jump
    assert front.error < (1e-8 if name == "weak" else 1e-10) * jump
    moved = front.displacement(n) - front.displacement(n + 1)
    assert np.abs(moved - (near - ahead)).max() < 1e-11 * jump
    assert abs(v(1000.0)) < 1e-12 * abs(front.piston)
    assert abs(v(-9000.0) / front.piston - 1) < 1e-11
    off = np.diff(front.state(30, 12.5).u) + front.strain(np.arange(29) - 12.5)
    assert np.abs(off).max() < 1e-11 * max(jump, ahead)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_both_tails_fall_as_their_roots_say(fronts, name):
    front = fronts[name]
    law, behind, ahead, eta = CASES[name]
    level = 1.3 * front.speed**2
    root = complex(front.decay_behind, front.wavenumber_behind)
    for state, one in ((behind, root), (ahead, -front.decay_ahead)):
        K = law.derivative(jnp.asarray(state))
        left = 4 * np.sinh(one / 2) ** 2 * (K - eta * front.speed * one) - level * one**2
        assert abs(left) < 1e-9 * level * abs(one) ** 2
    x = 20 / front.decay_ahead
    d = np.asarray(front.strain(np.array([x, x + 1])) - ahead)
    assert_allclose(np.log(d[0] / d[1]), front.decay_ahead, rtol=1e-3)
    d = np.asarray(front.strain(-14 / front.decay_behind - np.arange(3.0))) - behind
    # three numbers of a damped oscillation, one step apart: d0 - 2 Re(q) d1 + |q|^2 d2 = 0
    q = np.exp(root)
    if front.kind == "oscillatory":
        assert abs(d[0] - 2 * q.real * d[1] + abs(q) ** 2 * d[2]) < 2e-3 * np.abs(d).max() * abs(q)
    else:
        assert_allclose(d[0] / d[1], q.real, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("law, behind", [(gx.Hertz(1.0, 1.0), 0.02), (gx.Hertz(), 1.0)])
def test_a_front_oscillates_below_the_critical_dashpot_and_not_above(law, behind):
    eta = float(dissipative_front(law, behind, dashpot=1.0).critical)
    below, above = (dissipative_front(law, behind, dashpot=share * eta) for share in (0.9, 1.1))
    assert (below.kind, above.kind) == ("oscillatory", "monotone")
    excess = float(law.derivative(behind)) / below.speed**2 - 1
    # of weak fronts it is that of Korteweg, de Vries and Burgers
    assert excess > 0.4 or abs(eta / below.speed / np.sqrt(excess / 3) - 1) < excess < 0.01
    assert abs(below.critical / eta - 1) < 1e-11
    x = np.linspace(-18 / float(below.decay_behind), 12.0, 5000)
    crosses = np.sum(np.diff(np.sign(below.strain(x) - behind)) != 0)
    assert crosses >= 2 and below.overshoot > 2 * below.error
    assert np.diff(above.strain(x)).max() < 1e-12 * behind
    assert above.overshoot == 0 and above.wavenumber_behind == 0


def chain(eta, sites, push):
    bonds = gx.Shift(1, "free")
    terms = gx.Bond(bonds, gx.Hertz()), gx.Dashpot(bonds, eta), gx.Drive(lambda t: push)
    return gx.Lattice(1.0, terms, sites=sites)


@pytest.mark.slow
def test_a_front_travels_unchanged():
    law, behind, ahead, eta = VACUUM
    front = dissipative_front(law, behind, ahead, dashpot=eta)
    n = np.arange(100)
    lattice = chain(eta, 100, 1.0)
    start = front.state(100, 40.0)
    run = gx.simulate(lattice, start, 30.0, solver=diffrax.Dopri8(), tolerance=1e-11)
    there = n - 40.0 - 30.0 * front.speed
    assert_allclose(-np.diff(run.final.u), front.strain(there[:-1]), rtol=0, atol=1e-8)
    assert_allclose(run.final.v, front.velocity(there), rtol=0, atol=1e-8)


@pytest.mark.slow
def test_a_velocity_step_becomes_the_front():
    """Waves between the two fronts die out as a power of time, about t^-3/2: so far from where they began."""
    front = dissipative_front(gx.Hertz(), piston=1.0, dashpot=0.2)
    sites = 2200
    end = 1050.0
    assert abs(front.behind - 1) < 1e-14 and abs(front.speed - 1) < 1e-14
    v = np.where(np.arange(sites) < sites // 2, 2.0, 0.0)
    places = []
    how = dict(solver=diffrax.Dopri8(), tolerance=1e-10, save_at=np.array([end - 20, end]))
    run = gx.simulate(chain(0.2, sites, 0.0), (np.zeros(sites), v), end, **how)
    for u in run.us:
        strain = -np.diff(u)
        n = sites // 2 + int(np.argmax(strain[sites // 2 :] < 0.5))
        # where that contact lies on the profile
        off = brentq(lambda x: float(front.strain(x)) - strain[n], -2.0, 4.0, xtol=1e-13)
        places.append(n - off)
        beyond = np.arange(n - 300, sites - 1)
        assert np.abs(strain[beyond] - front.strain(beyond - places[-1])).max() < 2e-6
    assert abs((places[1] - places[0]) / 20.0 - 1) < 1e-6


@pytest.mark.slow
def test_a_front_of_a_lattice_and_its_mirror_image(fronts):
    law, behind, ahead, eta = CASES["precompressed"]
    place = fronts["precompressed"].strain(0.3)
    lattice = gx.Lattice(1.3, gx.Bond(gx.Shift(1, "free"), law), sites=5)
    dashpots = gx.Dashpot(gx.Shift(1, "fixed"), np.full(6, eta))
    damped = gx.Lattice(1.3, (*lattice.terms, dashpots), sites=5)
    assert dissipative_front(lattice, behind, ahead, dashpot=eta).strain(0.3) == place
    assert dissipative_front(damped, behind, ahead).strain(0.3) == place
    for wrong, given in ((damped, eta), (lattice, None)):
        with refused("dashpot: expected one"):
            dissipative_front(wrong, behind, ahead, dashpot=given)
    # x -> -x of the law: the same front in tension
    one, other = (
        dissipative_front(gx.Polynomial(1.0, side * 0.5), side * 0.3, dashpot=0.2)
        for side in (1, -1)
    )
    assert one.speed == other.speed and np.array_equal(one.strains, -other.strains)


@pytest.mark.slow
def test_a_front_differentiates_in_both_modes():
    def numbers(p):
        front = dissipative_front(gx.Hertz(p[0], p[1]), p[2], p[3], dashpot=p[4], mass=p[5])
        rates = front.decay_behind, front.wavenumber_behind, front.decay_ahead
        others = front.speed, front.critical, front.overshoot, front.power
        return jnp.stack([*rates, *others, front.strain(-1.3), front.velocity(0.4)])

    p = np.array([1.2, 0.3, 0.9, 0.1, 0.2, 1.3])
    h = 1e-5
    way = np.random.default_rng(1).normal(size=len(p))
    slope = (numbers(p + h * way) - numbers(p - h * way)) / (2 * h)
    assert np.abs(slope - jax.jvp(numbers, (p,), (way,))[1]).max() < 1e-6

    def pushed(v):
        front = dissipative_front(gx.Hertz(), piston=v, dashpot=0.5)
        return front.behind + front.strain(-1.0)

    slope = (pushed(0.7 + h) - pushed(0.7 - h)) / (2 * h)
    assert abs(jax.grad(pushed)(0.7) - slope) < 1e-8
    assert abs(dissipative_front(gx.Hertz(), piston=0.7, dashpot=0.5).behind - 0.7**0.8) < 1e-12


def test_a_second_derivative_of_a_front_is_refused():
    front = lambda v: dissipative_front(gx.Toda(), piston=v, dashpot=0.3)
    for number in (lambda v: front(v).behind, lambda v: front(v).strain(0.7)):
        with refused("law: expected one derivative of a front, got a second one"):
            jax.hessian(number)(0.5)


@pytest.mark.slow
@pytest.mark.parametrize("behind, ahead", [(1.0001, 1.0), (1.01, 1.0), (3.0, 1.0), (1.0, 0.0)])
def test_the_power_keeps_its_digits(behind, ahead):
    front = dissipative_front(gx.Hertz(), behind, ahead, dashpot=5 * (behind - ahead))
    with localcontext(prec=50):
        low, high = Decimal(ahead), Decimal(behind)
        y = high - low
        F = high ** Decimal("1.5") - low ** Decimal("1.5")
        W = (high ** Decimal("2.5") - low ** Decimal("2.5")) * 2 / 5 - low ** Decimal("1.5") * y
        want = (F / y).sqrt() * (F * y / 2 - W)
        off = abs(Decimal(float(front.power)) / want - 1)
    assert off < 1e-14 and off < float(front.error) / float(y)


def front(law=gx.Hertz(), behind=1.0, ahead=0.0, dashpot=1.0):
    return dissipative_front(law, behind, ahead, dashpot=dashpot)


@pytest.mark.slow
@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: front(dashpot=0.0), "dashpot: expected numbers above zero.*dispersive shock"),
        (lambda: dissipative_front(gx.Hertz(), 1.0, piston=1.0, dashpot=1.0), "got both"),
        (lambda: front(gx.Linear()), "faster than sound ahead and slower than sound behind"),
        (lambda: front(behind=0.5, ahead=1.0), "spreads out"),
        (lambda: front(gx.Hertz(1.0, 1.0), 1e-6), "a part in"),
        (lambda: front(Bump()), "crosses it"),
        (lambda: front(gx.PowerLaw(1.0, -3.0, 1.0), 1.5), "stiff by finite amounts"),
        (lambda: dissipative_front(gx.Hertz(), piston=-1.0, dashpot=1.0), "piston"),
        (lambda: front(dashpot=1e-6), "critical"),
        (lambda: front(gx.scenes.dimer(5)), "uniform chain"),
        (lambda: jax.jit(lambda b: front(behind=b).speed)(1.0), "known"),
    ],
)
def test_what_has_no_front_is_refused(call, words):
    with refused(f"(?s){words}"):
        call()


def test_the_critical_dashpot_of_weak_fronts_is_that_of_korteweg_de_vries_and_burgers():
    for excess in (1e-4, 1e-2):
        found = tails.critical(excess)
        assert found.double and abs(found.zeta / np.sqrt(excess / 3) - 1) < excess
        # a double root: both the equation and its slope in lambda vanish
        root = tails.behind(excess, found.zeta * (1 + 1e-12)).real
        assert abs(tails.lack_slope(root) - found.zeta) < 1e-4 * found.zeta
    # where no two real roots meet, both decay alike
    found = tails.critical(0.5)
    pair, real = (tails.behind(0.5, found.zeta * (1 + x)) for x in (-1e-9, 1e-9))
    assert not found.double and pair.imag > 1 and real.imag == 0
    assert abs(pair.real / real.real - 1) < 1e-7
