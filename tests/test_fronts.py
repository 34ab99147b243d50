"""Stationary fronts of chains with dashpots: against momentum, energy, the equation of motion and simulations."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused
from scipy.optimize import brentq

import granjax as gx
from granjax.profiles import tails
from granjax.shocks import dissipative_front

VACUUM = (gx.Hertz(), 1.0, 0.0, 0.3)


class Softening(gx.Law):
    """A law of a user's own: F = a tanh(b e)."""

    dimensions = {"strength": (1, 0, 0), "rate": (0, -1, 0)}
    strength: jax.Array
    rate: jax.Array

    def force(self, e):
        return self.strength * jnp.tanh(self.rate * e)

    def energy(self, e):
        return self.strength / self.rate * jnp.log(jnp.cosh(self.rate * e))


class Bump(gx.Law):
    """A law with a steep place."""

    opens = False

    def force(self, e):
        return e + e**2 + 0.5 * jnp.exp(-((e - 0.5) ** 2) / 0.01)

    def energy(self, e):
        return (
            e**2 / 2 + e**3 / 3 + 0.05 * jnp.sqrt(jnp.pi) / 2 * (1 + jax.lax.erf((e - 0.5) / 0.1))
        )


CASES = {
    "sonic vacuum": VACUUM,
    "strongly damped": (gx.Hertz(), 1.0, 0.0, 2.0),
    "precompressed": (gx.Hertz(2.5, 0.3), 1.0, 0.2, 0.15),
    "weak": (gx.Hertz(1.0, 1.0), 0.01, 0.0, 0.02),
    "strong": (gx.Toda(), 3.0, 0.0, 1.0),
    "rarefaction": (gx.Polynomial(1.0, -0.5), -0.3, 0.0, 0.05),
    "softening from compression": (Softening(jnp.asarray(1.0), jnp.asarray(1.0)), 0.2, 0.9, 0.2),
}


@pytest.fixture(scope="module")
def fronts():
    return {
        name: dissipative_front(law, behind, ahead, dashpot=eta, mass=1.3)
        for name, (law, behind, ahead, eta) in CASES.items()
    }


@pytest.mark.parametrize("name", CASES)
def test_speed_beads_and_losses_follow_from_both_states(fronts, name):
    front, (law, behind, ahead, eta) = fronts[name], CASES[name]
    F = [float(law.force(jnp.asarray(e))) for e in (behind, ahead)]
    W = [float(law.energy(jnp.asarray(e))) for e in (behind, ahead)]
    speed = np.sqrt((F[0] - F[1]) / (1.3 * (behind - ahead)))
    assert abs(front.speed / speed - 1) < 1e-12
    assert abs(front.piston / (speed * (behind - ahead)) - 1) < 1e-12
    power = speed * ((F[0] + F[1]) / 2 * (behind - ahead) - (W[0] - W[1]))
    assert abs(front.power / power - 1) < 1e-6 and power > 0
    # what the dashpots take of the profile itself
    x, dx = np.linspace(-500, 500, 100_001, retstep=True)
    rates = np.gradient(np.asarray(front.strain(x)), dx)
    assert abs(eta * speed**2 * np.sum(rates**2) * dx / power - 1) < 3e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_profile_solves_the_equation_of_motion(fronts, name):
    front, (law, behind, ahead, eta) = fronts[name], CASES[name]
    jump, n, h = behind - ahead, np.linspace(-9.3, 5.2, 59), 1e-3
    V, near = (
        front.velocity(n[None] + h * np.array([-1, 0, 1])[:, None]),
        np.asarray(front.strain(n)),
    )
    before = np.asarray(front.strain(n - 1))
    # v' = -s V', and strain rates by the differences of velocities
    force = np.asarray(law.force(jnp.asarray(before)) - law.force(jnp.asarray(near)))
    drag = eta * ((front.velocity(n - 1) - V[1]) - (V[1] - front.velocity(n + 1)))
    scale = 1.3 * front.speed**2 * abs(jump)
    left = -1.3 * front.speed * (V[2] - V[0]) / (2 * h) - force - drag
    assert np.abs(left).max() < 3e-5 * scale
    assert front.error < 1e-10 * abs(jump) or name == "weak" and front.error < 1e-8 * jump
    u, steps = np.asarray(front.displacement(n)), np.asarray(front.displacement(n + 1))
    assert np.abs(u - steps - (near - ahead)).max() < 1e-11 * abs(jump)
    assert abs(front.velocity(1000.0)) < 1e-12 * abs(front.piston)
    assert abs(front.velocity(-9000.0) / front.piston - 1) < 1e-11
    state = front.state(30, 12.5)
    assert np.abs(
        state.u[:-1] - state.u[1:] - front.strain(np.arange(29) - 12.5)
    ).max() < 1e-11 * max(abs(jump), ahead)


@pytest.mark.parametrize("name", CASES)
def test_both_tails_fall_as_their_roots_say(fronts, name):
    front = fronts[name]
    level = 1.3 * front.speed**2
    law, behind, ahead, eta = CASES[name]
    root = complex(front.decay_behind, front.wavenumber_behind)
    for state, one in ((behind, root), (ahead, -front.decay_ahead)):
        K = law.derivative(jnp.asarray(state))
        left = 4 * np.sinh(one / 2) ** 2 * (K - eta * front.speed * one) - level * one**2
        assert abs(left) < 1e-9 * level * abs(one) ** 2
    x = 20 / front.decay_ahead
    d = np.asarray(front.strain(np.array([x, x + 1])) - ahead)
    assert abs(np.log(d[0] / d[1]) / front.decay_ahead - 1) < 1e-3
    x = -14 / front.decay_behind - np.arange(3.0)
    d = np.asarray(front.strain(x)) - behind
    # three numbers of a damped oscillation, one step apart: d0 - 2 Re(q) d1 + |q|^2 d2 = 0
    q = np.exp(root)
    if front.kind == "oscillatory":
        assert abs(d[0] - 2 * q.real * d[1] + abs(q) ** 2 * d[2]) < 2e-3 * np.abs(d).max() * abs(q)
    else:
        assert abs(d[0] / d[1] / q.real - 1) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    "law, behind", [(gx.Hertz(1.0, 1.0), 0.1), (gx.Hertz(), 1.0), (gx.Toda(), 0.5)]
)
def test_a_front_oscillates_below_the_critical_dashpot_and_not_above(law, behind):
    eta = float(dissipative_front(law, behind, dashpot=1.0).critical)
    below, above = (dissipative_front(law, behind, dashpot=share * eta) for share in (0.9, 1.1))
    assert (below.kind, above.kind) == ("oscillatory", "monotone")
    assert abs(below.critical / eta - 1) < 1e-11
    x = np.linspace(-18 / float(below.decay_behind), 3.0, 4000)
    crosses = np.sum(np.diff(np.sign(below.strain(x) - behind)) != 0)
    assert crosses >= 2 and below.overshoot > 2 * below.error
    x = np.linspace(-18 / float(above.decay_behind), 12.0, 4000)
    assert (
        np.diff(above.strain(x)).max() < 1e-12 * behind
        and above.overshoot == 0
        and above.wavenumber_behind == 0
    )


def test_the_critical_dashpot_of_weak_fronts_is_that_of_korteweg_de_vries_and_burgers():
    for excess, more in ((1e-4, 1e-4), (1e-2, 1e-2)):
        found = tails.critical(excess)
        assert found.double and abs(found.zeta / np.sqrt(excess / 3) - 1) < more
        # a double root: both the equation and its slope in lambda vanish
        root = tails.behind(excess, found.zeta * (1 + 1e-12)).real
        assert abs(tails.lack_slope(root) - found.zeta) < 1e-4 * found.zeta
    # where no two real roots meet, both decay alike
    found = tails.critical(0.5)
    pair, real = (
        tails.behind(0.5, found.zeta * (1 - 1e-9)),
        tails.behind(0.5, found.zeta * (1 + 1e-9)),
    )
    assert (
        not found.double
        and abs(pair.real / real.real - 1) < 1e-7
        and pair.imag > 1
        and real.imag == 0
    )


def chain(law, eta, sites, push):
    bonds = gx.Shift(1, "free")
    return gx.Lattice(
        1.0, (gx.Bond(bonds, law), gx.Dashpot(bonds, eta), gx.Drive(lambda t: push)), sites=sites
    )


@pytest.mark.slow
def test_a_front_travels_unchanged():
    law, behind, ahead, eta = VACUUM
    front = dissipative_front(law, behind, ahead, dashpot=eta)
    lattice = chain(law, eta, 100, 1.0)
    run = gx.simulate(
        lattice, front.state(100, 40.0), 30.0, solver=diffrax.Dopri8(), tolerance=1e-11
    )
    strain = run.final.u[:-1] - run.final.u[1:]
    assert np.abs(strain - front.strain(np.arange(99) - 40.0 - 30.0 * front.speed)).max() < 1e-8
    assert (
        np.abs(run.final.v - front.velocity(np.arange(100) - 40.0 - 30.0 * front.speed)).max()
        < 1e-8
    )


@pytest.mark.study
def test_a_velocity_step_becomes_the_front():
    """Waves between the two fronts die out as a power of time, about t^-3/2: so far from where they began."""
    front, sites, end = dissipative_front(gx.Hertz(), piston=1.0, dashpot=0.2), 2200, 1050.0
    assert abs(front.behind - 1) < 1e-14 and abs(front.speed - 1) < 1e-14
    lattice, places = chain(gx.Hertz(), 0.2, sites, 0.0), []
    v = np.where(np.arange(sites) < sites // 2, 2.0, 0.0)
    run = gx.simulate(
        lattice,
        (np.zeros(sites), v),
        end,
        solver=diffrax.Dopri8(),
        tolerance=1e-10,
        save_at=np.array([end - 20, end]),
    )
    for u in run.us:
        strain = np.asarray(u[:-1] - u[1:])
        n = sites // 2 + int(np.argmax(strain[sites // 2 :] < 0.5))
        # where that contact lies on the profile
        places.append(
            n - brentq(lambda x: float(front.strain(x)) - strain[n], -2.0, 4.0, xtol=1e-13)
        )
        beyond = np.arange(n - 300, sites - 1)
        assert np.abs(strain[beyond] - front.strain(beyond - places[-1])).max() < 2e-6
    assert abs((places[1] - places[0]) / 20.0 - 1) < 1e-6


@pytest.mark.slow
def test_numbers_of_a_lattice_and_of_the_mirror():
    law, behind, ahead, eta = CASES["precompressed"]
    front, x = dissipative_front(law, behind, ahead, dashpot=eta, mass=1.3), np.linspace(-20, 8, 57)
    lattice = gx.Lattice(1.3, gx.Bond(gx.Shift(1, "free"), law), sites=5)
    assert dissipative_front(lattice, behind, ahead, dashpot=eta).strain(0.3) == front.strain(0.3)
    damped = gx.Lattice(
        1.3, (*lattice.terms, gx.Dashpot(gx.Shift(1, "fixed"), np.full(6, eta))), sites=5
    )
    assert dissipative_front(damped, behind, ahead).strain(0.3) == front.strain(0.3)
    for wrong, given in ((damped, eta), (lattice, None)):
        with refused("dashpot: expected one, of the lattice or given here"):
            dissipative_front(wrong, behind, ahead, dashpot=given)
    # x -> -x of the law: the same front in tension
    one = dissipative_front(gx.Polynomial(1.0, 0.5), 0.3, dashpot=0.2)
    other = dissipative_front(gx.Polynomial(1.0, -0.5), -0.3, dashpot=0.2)
    assert one.speed == other.speed and np.array_equal(one.strain(x), -other.strain(x))


@pytest.mark.study
def test_a_front_differentiates():
    def numbers(p):
        front = dissipative_front(gx.Hertz(p[0], p[1]), p[2], p[3], dashpot=p[4], mass=p[5])
        return jnp.stack(
            [
                front.speed,
                front.critical,
                front.decay_behind,
                front.wavenumber_behind,
                front.decay_ahead,
                front.overshoot,
                front.power,
                front.strain(-1.3),
                front.velocity(0.4),
            ]
        )

    p, h = np.array([1.2, 0.3, 0.9, 0.1, 0.2, 1.3]), 1e-5
    forward = jax.jacfwd(numbers)(p)
    for way in np.random.default_rng(1).normal(size=(3, len(p))):
        slope = (numbers(p + h * way) - numbers(p - h * way)) / (2 * h)
        assert np.abs(slope - forward @ way).max() < 1e-6

    # in reverse
    def pushed(v):
        front = dissipative_front(gx.Hertz(), piston=v, dashpot=0.5)
        return front.behind + front.strain(-1.0)

    slope = (pushed(0.7 + h) - pushed(0.7 - h)) / (2 * h)
    assert abs(jax.grad(pushed)(0.7) - slope) < 1e-8
    assert abs(dissipative_front(gx.Hertz(), piston=0.7, dashpot=0.5).behind - 0.7**0.8) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize(
    "call, words",
    [
        (
            lambda: dissipative_front(gx.Hertz(), 1.0, dashpot=0.0),
            "dashpot: expected numbers above zero.*dispersive shock",
        ),
        (lambda: dissipative_front(gx.Hertz(), 1.0, piston=1.0, dashpot=1.0), "got both"),
        (
            lambda: dissipative_front(gx.Linear(), 1.0, dashpot=1.0),
            "faster than sound ahead and slower than sound behind",
        ),
        (lambda: dissipative_front(gx.Hertz(), 0.5, 1.0, dashpot=1.0), "spreads out"),
        (lambda: dissipative_front(gx.Hertz(1.0, 1.0), 1e-6, dashpot=1.0), "a part in"),
        (lambda: dissipative_front(Bump(), 1.0, dashpot=1.0), "crosses it"),
        (lambda: dissipative_front(gx.PowerLaw(1.0, 0.5), 1.0, dashpot=1.0), "spreads out"),
        (
            lambda: dissipative_front(gx.PowerLaw(1.0, -3.0, 1.0), 1.5, dashpot=1.0),
            "stiff by finite amounts",
        ),
        (lambda: dissipative_front(gx.Hertz(), piston=-1.0, dashpot=1.0), "piston"),
        (lambda: dissipative_front(gx.Hertz(), 1.0, dashpot=1e-6), "critical"),
        (lambda: dissipative_front(gx.scenes.dimer(5), 1.0, dashpot=1.0), "uniform chain"),
        (
            lambda: jax.jit(lambda b: dissipative_front(gx.Hertz(), b, dashpot=1.0).speed)(1.0),
            "known",
        ),
    ],
)
def test_what_has_no_front(call, words):
    with refused(f"(?s){words}"):
        call()
