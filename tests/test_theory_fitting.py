"""Dispersive-shock fitting, simple waves, the shock of a linear chain: closed forms, published numbers, simulations."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
from cases import Mirrored
from numpy.testing import assert_allclose
from pytest import mark
from refusals import refused

import granjax as gx
from granjax.laws import Strained
from granjax.shocks.riemann import simple_wave_velocity
from granjax.theory import linear_shock, shock_edges, simple_wave

# sound 1 and K3 = 1/2, as KdV and Toda have them
STIFFNESS = 2 * 2**0.5 / 3
REST = 0.5
GRANULAR = gx.Hertz(STIFFNESS, STIFFNESS * REST**1.5)
SOFT = gx.PowerLaw(1.0, 0.5, 1.0)


class Kinked(gx.Law):
    """F(e) = e + a (e - s) |e - s|, a law of one's own whose second derivative jumps at s."""

    a: jax.Array
    s: jax.Array

    def force(self, e):
        grown = e - self.s
        return e + self.a * (grown * jnp.abs(grown) + self.s * jnp.abs(self.s))

    def energy(self, e):
        raise NotImplementedError


def differences(f, x, h=1e-4):
    """The Jacobian of f at x by central differences of fourth order."""
    along = np.eye(len(x)) * h
    near, far = (jnp.stack([f(x + k * e) - f(x - k * e) for e in along], -1) for k in (1, 2))
    return (8 * near - far) / (12 * h)


def toda_front(c):
    """s_+ over sound, less 1."""
    x = 2 * np.arcsinh(np.sqrt(c))
    return x**2 / 6 + x**4 / 120 + x**6 / 5040 if x < 0.1 else np.sinh(x) / x - 1


@mark.parametrize("c", [1e-12, 0.1, 0.99])
def test_fitting_is_exact_of_toda(c):
    a = 0.7
    b = 1.3
    m = 2.1
    sound = (a * b / m) ** 0.5
    found = shock_edges(gx.Toda(a, b), c * sound / b, m)
    assert_allclose(found.trailing_excess, -c, rtol=1e-12)
    assert_allclose(found.leading_excess, toda_front(c), rtol=1e-12)
    assert_allclose(found.mean, 2 * np.log1p(c) / b, rtol=1e-12)
    assert_allclose(found.trailing_speed, sound * (1 - c), rtol=1e-12)
    assert_allclose(found.leading_speed, sound * (1 + toda_front(c)), rtol=1e-12)
    assert found.error < 1e-13


@mark.parametrize(
    "c, trailing, leading",
    [(0.1, 0.9155282, 1.0557045), (0.3, 0.7988756, 1.1307943), (0.5, 0.7152649, 1.1834512)],
)
def test_numbers_of_a_granular_shock(c, trailing, leading):
    found = shock_edges(GRANULAR, c)
    edges = found.trailing_speed, found.leading_speed
    assert_allclose(edges, [trailing, leading], rtol=0, atol=1e-6)
    assert_allclose(found.mean, ((1 + 5 * c) ** 0.8 - 1) / 2, rtol=1e-12)


@mark.slow
def test_the_solitary_wave_of_a_toda_front_has_the_speed_of_its_edge():
    own = shock_edges(gx.Toda(), 0.5, wave=True)
    assert_allclose(own.wave_speed, own.leading_speed, rtol=1e-9)
    assert_allclose(own.amplitude, 2 * np.log(2), rtol=1e-8)


@mark.slow
def test_a_strong_shock_has_no_trailing_edge():
    found = shock_edges(gx.Toda(), 1.5)
    assert np.isnan(found.trailing_speed) and "twofold or more" in found.outcome
    assert_allclose(found.leading_speed, 1 + toda_front(1.5), rtol=1e-9)


@mark.slow
def test_the_front_of_a_strained_chain_is_that_of_one_compressed_by_as_much_more():
    one = shock_edges(gx.Hertz(1.0, 1.0), 0.3, ahead=0.05, wave=True)
    other = shock_edges(gx.Hertz(1.0, 1.05**1.5), 0.3, wave=True)
    assert_allclose(one.wave_speed, other.wave_speed, rtol=1e-9)
    assert_allclose(one.amplitude, other.amplitude, rtol=1e-9)


@mark.slow
def test_edges_beside_a_simulated_granular_shock():
    """Leading crests until t = 1000, extrapolated by 1/t, and the plateau at t = 8000 (test_whitham)."""
    found = shock_edges(GRANULAR, 0.5, wave=True)
    speed = 1.1933
    # the solitary wave is nearer to the front
    assert_allclose(found.wave_speed, 1.19286468, rtol=0, atol=1e-6)
    assert_allclose(found.wave_speed, speed, rtol=1e-3)
    apart = found.wave_speed - found.leading_speed
    assert_allclose(speed - found.leading_speed, apart, rtol=0.1)
    assert_allclose(found.mean, 0.86141893, rtol=1e-3)
    assert "wave" in found.outcome


@mark.slow
def test_a_shock_of_a_power_law_ahead_of_which_there_is_no_sound():
    def front(x):
        found = shock_edges(gx.Hertz(x[0]), x[1], x[2])
        return jnp.log(jnp.stack([found.leading_speed, found.mean, found.amplitude]))

    x = jnp.array([1.0, 0.5, 1.0])
    logarithms, pull = jax.vjp(front, x)
    speed, mean, _ = np.exp(logarithms)
    assert_allclose(speed, 1.04241, rtol=0, atol=1e-5)
    assert_allclose(mean, (1.25 / 1.5**0.5) ** 0.8, rtol=1e-12)
    # speeds as c^{1/5} (A/m)^{2/5}, strains as c^{4/5} (A/m)^{-2/5}
    strains = [-0.4, 0.8, 0.4]
    slopes = jnp.stack([pull(row)[0] for row in jnp.eye(3)])
    assert_allclose(slopes * x, [[0.4, 0.2, -0.4], strains, strains], atol=1e-7)
    # in SI as well
    small = shock_edges(gx.Hertz(3e9), 0.5e-3, 2e-4)
    scale = 1e-3 * (2e-4 / 3e9) ** 0.5
    assert np.isnan(small.trailing_speed) and small.leading_speed == small.wave_speed
    assert "no sound" in small.outcome
    assert_allclose(small.mean, mean * scale**0.8, rtol=1e-12)
    assert_allclose(small.leading_speed, speed * 1e-3 * scale**-0.8, rtol=1e-9)


@mark.slow
@mark.parametrize("law, c", [(gx.PowerLaw(1.0, -3.0, 1.0), 0.2), (gx.Toda(), 1e-9)])
def test_the_mirrored_law_has_the_mirrored_shock(law, c):
    one = shock_edges(law, c)
    other = shock_edges(Mirrored(law), -c)
    assert other.mean == -one.mean
    for name in ("trailing_speed", "leading_speed", "sound", "trailing_excess", "leading_excess"):
        assert getattr(one, name) == getattr(other, name)


def test_shocks_of_rarefaction():
    found = shock_edges(SOFT, -0.1)
    # V = (A/2)^{1/2} s^{-1/4}: int V dy = (8/9)^{1/2} (s^{3/4} - 1)
    s = (1 - 0.2 * (9 / 8) ** 0.5) ** (4 / 3)
    ahead = 0.5**0.5
    behind = ahead * s**-0.25
    assert_allclose(found.mean, s - 1, rtol=1e-12)
    assert_allclose(found.trailing_speed, 2 * ahead - behind)
    q = np.arccosh(np.sqrt(behind / ahead))
    assert_allclose(found.leading_speed, ahead * np.sinh(2 * q) / (2 * q), rtol=1e-12)


@mark.slow
def test_the_law_may_be_of_ones_own_and_have_a_kink():
    a = 0.8
    s = 0.1
    c = 0.3
    found = shock_edges(Kinked(jnp.asarray(a), jnp.asarray(s)), c, ahead=s)
    # V = (1 + 2 a x)^{1/2}, x = y - s
    behind = (1 + 6 * a * c) ** (1 / 3)
    assert_allclose(found.trailing_excess, 1 - behind, rtol=1e-12)
    assert_allclose(found.mean, s + (behind**2 - 1) / (2 * a), rtol=1e-12)
    spline = gx.Spline([-1.0, 0.3, 1.0], [0.2, 0.3, 0.5, 0.9])
    assert shock_edges(gx.Hertz() + gx.Linear(0.5) + spline, 0.4).error < 1e-12


def test_the_chain_may_be_a_lattice_or_strained_before():
    chain = gx.scenes.monomer(9, mass=0.3, stiffness=2.0, precompression=0.7)
    law = gx.Hertz(2.0, 0.7)
    one = shock_edges(chain, 0.2)
    other = shock_edges(law, 0.2, 0.3)
    assert one.leading_speed == other.leading_speed and one.units == "scaled"
    before = shock_edges(law, 0.2, 0.3, ahead=0.1)
    again = shock_edges(Strained(law, 0.1), 0.2, 0.3)
    assert_allclose(before.leading_speed, again.leading_speed, rtol=1e-12)
    assert_allclose(before.mean, again.mean + 0.1, rtol=1e-12)


@mark.slow
def test_edges_and_simple_waves_differentiate_in_all_their_numbers():
    def edges(x):
        found = shock_edges(gx.Hertz(x[0], x[1]), x[2], x[3], ahead=x[4])
        return jnp.stack(
            [found.trailing_speed, found.leading_speed, found.mean, found.leading_excess]
        )

    def waves(x):
        law = gx.Hertz(x[0], x[1])
        inside = simple_wave.fan(0.85, law, x[2], x[3], ahead=x[4])
        return jnp.stack([inside, simple_wave.mean(law, x[2], x[3], ahead=x[4])])

    granular = STIFFNESS, STIFFNESS * REST**1.5
    for f, x, zero in (
        (edges, [1.1, 0.6, 0.3, 0.8, 0.05], 0),
        (waves, [*granular, -0.15, 1.0, 0.02], 1e-13),
    ):
        x = jnp.array(x)
        forward = jax.jacfwd(f)(x)
        assert_allclose(forward, differences(f, x), rtol=1e-9, atol=1e-10)
        assert_allclose(jax.jacrev(f)(x), forward, rtol=1e-12, atol=zero)


@mark.slow
def test_edges_in_short_numbers():
    code = (
        "import granjax as gx; f = gx.theory.shock_edges(gx.Toda(), 0.5); print(float(f.leading_speed), "
        "float(f.error), float(gx.theory.linear_shock.velocity_step(0, 5.0, 1.0)))"
    )
    told = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"JAX_ENABLE_X64": "0"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    speed, error, y = map(float, told.split())
    assert_allclose([speed, y], [1.31519072, 2.0470771], rtol=1e-6)
    assert 1e-7 < error < 1e-5


# -------------------------------------------------------------------------------------------------------- linear shocks


def bessel(x):
    """J_0(x), J_1(x), ... by Miller's recurrence, in extended precision."""
    count = int(x + 20 * x ** (1 / 3)) + 60
    J = np.zeros(count + 2, np.longdouble)
    J[count] = 1e-300
    for k in range(count, 0, -1):
        J[k - 1] = 2 * k / np.longdouble(x) * J[k] - J[k + 1]
        if abs(J[k - 1]) > 1e200:
            J[k - 1 :] *= np.longdouble(1e-250)
    return J / (J[0] + 2 * J[2::2].sum())


@mark.parametrize("t", [0.3, 1e4])
def test_linear_shocks_are_sums_of_bessel_functions(t):
    J = bessel(2 * t)
    front = int(t)
    n = np.array([0, 1, 2, 7, front // 2, front - 3, front, front + 2, front + 40])
    n = n[(n >= 0) & (2 * n + 4 < len(J))]
    # int_0^t J_{2n}(2s) ds = sum_k J_{2n+1+2k}(2t)
    step = np.array([2 * (J[2 * k + 1 :: 2].sum() + J[2 * k + 3 :: 2].sum()) for k in n], float)
    strain = np.array([J[2 * k :: 2].sum() for k in n], float)
    for bonds in (n, -1 - n):
        assert_allclose(linear_shock.velocity_step(bonds, t, 1.0), step, atol=1e-12)
    assert_allclose(linear_shock.strain_step(n, t, 1.0), strain, atol=1e-12)
    assert_allclose(linear_shock.strain_step(1 - n, t, 1.0), 1 - strain, atol=1e-12)


@mark.slow
def test_linear_shocks_are_those_of_a_simulated_chain():
    sites = 81
    c = 0.3
    K = 2.0
    m = 0.7
    t = 6.0
    n = np.arange(sites) - 40
    u = np.zeros(sites)
    chain = gx.Lattice(m, gx.Bond(gx.Shift(1, "free"), gx.Linear(K)), sites=sites)
    ramp = np.append(0.0, -np.cumsum(np.where(n[:-1] <= 0, c, 0.0)))
    kept = slice(28, -28)  # what the ends have not reached
    for state, step in (
        ((u, -2 * c * np.sign(n)), linear_shock.velocity_step),
        ((ramp, u), linear_shock.strain_step),
    ):
        run = gx.simulate(chain, state, t, solver=gx.KahanLi8(), step=0.05)
        found = step(n[:-1], t, c, K, m)
        assert_allclose(-np.diff(run.final.u)[kept], found[kept], atol=1e-12)


@mark.slow
def test_linear_shocks_broadcast_and_differentiate():
    n = np.arange(-6, 6)[:, None, None]
    t = np.array([0.0, 1.0, 5.0])[:, None]
    whole = linear_shock.velocity_step(n, t, 0.3, np.array([1.0, 2.0]))
    assert whole.shape == (12, 3, 2) and not np.any(whole[:, 0])
    assert linear_shock.strain_step(n, [], 1.0).shape == (12, 1, 0)
    assert linear_shock.velocity_step([], 2.0, 1.0).size == 0
    one = linear_shock.velocity_step(n[:, 0, 0], 5.0, 0.3, 2.0)
    assert_allclose(whole[:, 2, 1], one, atol=1e-15)

    def both(x):
        return linear_shock.velocity_step(3, *x) + linear_shock.strain_step(-1, *x)

    x = jnp.array([4.0, 0.5, 1.3, 0.8])
    assert_allclose(jax.grad(both)(x), differences(both, x), atol=1e-10)
    assert_allclose(jax.jacfwd(both)(x), jax.grad(both)(x), atol=1e-14)


# --------------------------------------------------------------------------------------------------------- simple waves


def test_the_mean_of_a_power_law_in_closed_form():
    for c in (-0.15, 1e-13, 0.5):
        assert_allclose(
            simple_wave.mean(GRANULAR, c), np.expm1(0.8 * np.log1p(5 * c)) / 2, rtol=1e-12
        )
    # (2 r c)^{1/r} (m/(p A))^{1/(2r)}, 2r = p + 1
    vacuum = 1.75 ** (1 / 1.75) * (0.7 / (2.5 * 1.3)) ** (1 / 3.5)
    assert_allclose(simple_wave.mean(gx.PowerLaw(1.3, 2.5), 0.5, 0.7), vacuum, rtol=1e-12)


def test_the_velocity_of_a_simple_wave_between_two_strains():
    # Toda's sqrt(F'/m) is exp(y/2)/sqrt(m), here of three pairs of strains at once
    low = np.array([0.1, 0.4, -0.5])
    high = np.array([0.7, -0.2, 0.0])
    found = simple_wave_velocity(gx.Toda(), 0.7, jnp.asarray(low), jnp.asarray(high))
    assert_allclose(found, 2 * (np.exp(high / 2) - np.exp(low / 2)) / 0.7**0.5, rtol=1e-12)


@mark.slow
def test_fans_of_rarefaction():
    s = np.linspace(-1.2, 1.2, 49)
    y = simple_wave.fan(s, gx.Toda(), -0.3)
    assert_allclose(np.exp(y / 2), np.clip(np.abs(s), 0.7, 1), atol=1e-15)
    # of one's own law, the same by a law that is mirrored
    other = simple_wave.fan(s, Mirrored(GRANULAR), 0.15)
    np.testing.assert_array_equal(other, -simple_wave.fan(s, GRANULAR, -0.15))
    # V = (1 + 2y)^{1/4}
    behind = 1 + 2 * simple_wave.mean(GRANULAR, -0.15)
    assert_allclose(1 - 2 * other, np.clip(s**4, behind, 1), atol=1e-14)


@mark.slow
def test_the_fan_of_a_simulated_chain():
    sites = 400
    t = 150.0
    n = np.arange(sites) - sites // 2
    chain = gx.scenes.toda(sites, boundary="free")
    run = gx.simulate(chain, (np.zeros(sites), 0.4 * np.sign(n)), t)
    s = (n[:-1] + 0.5) / t
    # away from the edges, where a lattice rings
    within = (np.abs(s) > 0.86) & (np.abs(s) < 0.94)
    gap = -np.diff(run.final.u) - simple_wave.fan(s, gx.Toda(), -0.2)
    assert np.abs(gap[within]).max() < 1.1e-2 and np.abs(gap[np.abs(s) < 0.5]).max() < 2e-2


@mark.parametrize(
    "call, said",
    [
        (lambda: shock_edges(GRANULAR, 0.0), "^c: expected a number other than zero"),
        (lambda: shock_edges(GRANULAR, -0.1), "^c: .*above zero.*softens in tension"),
        (lambda: shock_edges(SOFT, 0.1), "^c: .*below zero.*softens in compression"),
        (lambda: shock_edges(SOFT, -3.0), "^c: expected a number above -0.4714.*, got -3."),
        (lambda: shock_edges(gx.Linear(1.0), 0.1), "^law: .*linear_shock"),
        (lambda: shock_edges(gx.Polynomial(1.0, 1.0, -1.0), 0.3), "^law: .*inflection near 0.3"),
        (lambda: shock_edges(gx.Hertz(), 0.1, ahead=-0.1), "^ahead: .*contacts are closed"),
        (lambda: shock_edges(gx.Hertz(), -0.1), "without stiffness in tension"),
        (lambda: simple_wave.mean(gx.Hertz(), -0.1), "^law: .*without stiffness in tension"),
        (lambda: simple_wave.mean(gx.Linear(0.0), 0.1), "^law: .*without stiffness in compress"),
        (lambda: shock_edges(gx.scenes.dimer(8, precompression=1.0), 0.1), "^law: .*uniform"),
        (lambda: jax.jit(lambda c: shock_edges(GRANULAR, c).mean)(0.1), "known"),
        (lambda: simple_wave.fan(1.0, GRANULAR, 0.1), "^c: .*below zero.*shock_edges"),
        (lambda: simple_wave.mean(GRANULAR, -5.0), "^c: expected a number above -0.2"),
        (lambda: linear_shock.velocity_step(0.5, 1.0, 1.0), "^n: expected whole numbers"),
        (lambda: linear_shock.velocity_step(0, -1.0, 1.0), "^t: .*not below zero"),
        (lambda: jax.jit(lambda t: linear_shock.strain_step(0, t, 1.0))(1.0), "^t: .*known"),
    ],
)
def test_what_makes_no_such_shock_or_wave_is_refused(call, said):
    with refused(said):
        call()


@mark.slow
def test_a_second_derivative_of_the_leading_solitary_wave_is_refused():
    speed = lambda c: gx.theory.shock_edges(gx.Toda(), c, wave=True).wave_speed
    with refused("c: expected one derivative of the wave whose beads reach 4c, got a second"):
        jax.hessian(speed)(0.5)
