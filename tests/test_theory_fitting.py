"""Dispersive-shock fitting, simple waves, the shock of a linear chain: closed forms, published numbers, simulations."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import Mirrored
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax.laws import Strained
from granjax.theory import linear_shock, shock_edges, simple_wave

# sound 1 and K3 = 1/2, as KdV and Toda have them
STIFFNESS, REST = 2 * 2**0.5 / 3, 0.5
GRANULAR = gx.Hertz(STIFFNESS, STIFFNESS * REST**1.5)


class Kinked(gx.Law):
    """F(e) = e + a (e - s) |e - s|, a law of one's own whose second derivative jumps at s."""

    a: jax.Array
    s: jax.Array

    def force(self, e):
        grown = e - self.s
        return e + self.a * (grown * jnp.abs(grown) + self.s * jnp.abs(self.s))

    def energy(self, e):
        raise NotImplementedError


def toda_front(c):
    """s_+ over sound, less 1."""
    x = 2 * np.arcsinh(np.sqrt(c))
    return x**2 / 6 + x**4 / 120 + x**6 / 5040 if x < 0.1 else np.sinh(x) / x - 1


@pytest.mark.parametrize("c", [1e-12, 1e-8, 1e-4, 0.1, 0.5, 0.99])
def test_fitting_is_exact_of_toda(c):
    a, b, m = 0.7, 1.3, 2.1
    sound, scale = (a * b / m) ** 0.5, (a / (b * m)) ** 0.5
    found = shock_edges(gx.Toda(a, b), c * scale, m)
    assert found.trailing_excess == pytest.approx(-c, rel=1e-12)
    assert found.leading_excess == pytest.approx(toda_front(c), rel=1e-12)
    assert found.mean == pytest.approx(2 * np.log1p(c) / b, rel=1e-12)
    assert found.trailing_speed == pytest.approx(sound * (1 - c), rel=1e-12) and found.error < 1e-13
    assert found.leading_speed == pytest.approx(
        sound * np.sqrt(c * (c + 1)) / np.arcsinh(np.sqrt(c)), rel=1e-12
    )


@pytest.mark.parametrize(
    "c, trailing, leading",
    [(0.1, 0.9155282, 1.0557045), (0.3, 0.7988756, 1.1307943), (0.5, 0.7152649, 1.1834512)],
)
def test_numbers_of_a_granular_shock(c, trailing, leading):
    found = shock_edges(GRANULAR, c)
    assert found.trailing_speed == pytest.approx(trailing, abs=1e-6)
    assert found.leading_speed == pytest.approx(leading, abs=1e-6)
    assert found.mean == pytest.approx(((1 + 5 * c) ** 0.8 - 1) / 2, rel=1e-12)


@pytest.mark.slow
def test_a_solitary_wave_tells_how_far_to_trust_the_fit():
    own = shock_edges(gx.Toda(), 0.5, wave=True)
    assert own.wave_speed == pytest.approx(float(own.leading_speed), rel=1e-9)
    assert own.amplitude == pytest.approx(2 * np.log(2), rel=1e-8)


@pytest.mark.study
def test_a_solitary_wave_is_nearer_to_a_granular_front():
    # simulated leading crests at t = 8000: 1.0549, 1.1342, 1.1925
    found = shock_edges(GRANULAR, 0.5, wave=True)
    assert found.wave_speed == pytest.approx(1.19286468, abs=1e-6) and "wave" in found.outcome


@pytest.mark.study
def test_the_front_of_a_strained_chain_and_its_derivative():
    def front(x):
        found = shock_edges(gx.Hertz(1.0, 1.0), x[0], ahead=x[1], wave=True)
        return jnp.stack([found.wave_speed, found.amplitude])

    x, h = jnp.array([0.3, 0.05]), 1e-3
    # the chain that is compressed by as much more
    other = shock_edges(gx.Hertz(1.0, 1.05**1.5), 0.3, wave=True)
    assert_allclose(front(x), [other.wave_speed, other.amplitude], rtol=1e-9)
    central = jnp.stack([front(x + h * e) - front(x - h * e) for e in np.eye(2)], 1) / (2 * h)
    assert_allclose(jax.jacrev(front)(x), central, rtol=1e-4)


@pytest.mark.study
def test_edges_beside_a_simulated_granular_shock():
    chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), GRANULAR), sites=1101)
    problem = gx.shocks.velocity_shock(chain, 0.5)
    seen = [gx.shocks.measure(problem.run(t)) for t in (200.0, 400.0)]
    found = shock_edges(chain, 0.5, wave=True)
    # the crest's speed nears that of the edge like 1/t
    speed, height = (
        2 * getattr(seen[1], x) - getattr(seen[0], x) for x in ("leading_speed", "amplitude")
    )
    assert found.wave_speed == pytest.approx(speed, rel=1e-3) and found.amplitude == pytest.approx(
        height, rel=5e-3
    )
    apart = float(found.wave_speed - found.leading_speed)
    assert abs(found.leading_speed - speed) == pytest.approx(apart, rel=0.1)
    assert found.mean == pytest.approx(seen[1].mean, rel=1e-3)
    assert abs(found.trailing_speed - seen[1].trailing_speed) < seen[1].trailing_speed_error + 0.01


@pytest.mark.slow
def test_a_shock_ahead_of_which_there_is_no_sound():
    found = shock_edges(gx.Hertz(), 0.5)
    assert np.isnan(found.trailing_speed) and found.leading_speed == found.wave_speed
    assert found.leading_speed == pytest.approx(1.04241, abs=1e-5) and "no sound" in found.outcome
    assert found.mean == pytest.approx((1.25 / 1.5**0.5) ** 0.8, rel=1e-12)


@pytest.mark.slow
def test_shocks_of_a_power_law_are_alike():
    found, small = shock_edges(gx.Hertz(), 0.5), shock_edges(gx.Hertz(3e9), 0.5e-3, 2e-4)
    # speeds as c^{1/5}, strains as c^{4/5}, in other units as well
    scale = 1e-3 * (2e-4 / 3e9) ** 0.5
    assert small.mean == pytest.approx(float(found.mean) * scale**0.8, rel=1e-12)
    assert small.leading_speed == pytest.approx(
        float(found.leading_speed) * 1e-3 * scale**-0.8, rel=1e-9
    )


@pytest.mark.study
def test_a_strong_shock_has_no_trailing_edge():
    found = shock_edges(gx.Toda(), 1.5)
    assert np.isnan(found.trailing_speed) and "twofold or more" in found.outcome
    assert found.leading_speed == pytest.approx(np.sqrt(3.75) / np.arcsinh(np.sqrt(1.5)), rel=1e-9)


@pytest.mark.parametrize(
    "law, c", [(GRANULAR, 0.3), (gx.PowerLaw(1.0, -3.0, 1.0), 0.2), (gx.Toda(), 1e-9)]
)
def test_the_mirrored_law_has_the_mirrored_shock(law, c):
    one, other = shock_edges(law, c), shock_edges(Mirrored(law), -c)
    assert other.mean == -one.mean
    for name in ("trailing_speed", "leading_speed", "sound", "trailing_excess", "leading_excess"):
        assert getattr(one, name) == getattr(other, name)


def test_shocks_of_rarefaction():
    soft = shock_edges(gx.PowerLaw(1.0, 0.5, 1.0), -0.1)
    # V = (A/2)^{1/2} s^{-1/4}: int V dy = (8/9)^{1/2} (s^{3/4} - 1)
    s = (1 - 0.2 * (9 / 8) ** 0.5) ** (4 / 3)
    ahead, behind = 0.5**0.5, 0.5**0.5 * s**-0.25
    assert soft.mean == pytest.approx(s - 1, rel=1e-12) and soft.trailing_speed == pytest.approx(
        2 * ahead - behind
    )
    q = np.arccosh(np.sqrt(behind / ahead))
    assert soft.leading_speed == pytest.approx(ahead * np.sinh(2 * q) / (2 * q), rel=1e-12)
    # of cubic stiffness either way
    ways = [shock_edges(gx.Polynomial(1.0, 0.0, 2.0), c) for c in (0.2, -0.2)]
    assert ways[0].leading_speed == ways[1].leading_speed and ways[0].mean == -ways[1].mean


def test_the_law_may_be_of_ones_own_and_have_a_kink():
    a, s, c = 0.8, 0.1, 0.3
    found = shock_edges(Kinked(jnp.asarray(a), jnp.asarray(s)), c, ahead=s)
    # V = (1 + 2 a x)^{1/2}, x = y - s
    behind = (1 + 6 * a * c) ** (1 / 3)
    assert found.trailing_excess == pytest.approx(1 - behind, rel=1e-12)
    assert found.mean == pytest.approx(s + (behind**2 - 1) / (2 * a), rel=1e-12)
    mixed = shock_edges(
        gx.Hertz() + gx.Linear(0.5) + gx.Spline([-1.0, 0.3, 1.0], [0.2, 0.3, 0.5, 0.9]), 0.4
    )
    assert mixed.error < 1e-12


def test_the_chain_may_be_a_lattice_or_strained_before():
    chain = gx.scenes.monomer(9, mass=0.3, stiffness=2.0, precompression=0.7)
    law = gx.Hertz(2.0, 0.7)
    one, other = shock_edges(chain, 0.2), shock_edges(law, 0.2, 0.3)
    assert one.leading_speed == other.leading_speed and one.units == "scaled"
    before = shock_edges(law, 0.2, 0.3, ahead=0.1)
    again = shock_edges(Strained(law, 0.1), 0.2, 0.3)
    assert before.leading_speed == pytest.approx(float(again.leading_speed), rel=1e-12)
    assert before.mean == pytest.approx(float(again.mean) + 0.1, rel=1e-12)


@pytest.mark.study
def test_edges_differentiate_in_all_their_numbers():
    def edges(x):
        found = shock_edges(gx.Hertz(x[0], x[1]), x[2], x[3], ahead=x[4])
        return jnp.stack(
            [found.trailing_speed, found.leading_speed, found.mean, found.leading_excess]
        )

    x, h = jnp.array([1.1, 0.6, 0.3, 0.8, 0.05]), 1e-4
    forward, backward = jax.jacfwd(edges)(x), jax.jacrev(edges)(x)
    apart = [[edges(x + k * h * e) - edges(x - k * h * e) for e in np.eye(5)] for k in (1, 2)]
    central = (8 * jnp.stack(apart[0], 1) - jnp.stack(apart[1], 1)) / (12 * h)
    assert_allclose(forward, central, rtol=1e-9, atol=1e-10)
    assert_allclose(backward, forward, rtol=1e-12)


@pytest.mark.study
def test_the_front_of_a_sonic_vacuum_differentiates():
    # speed = const c^{1/5} (A/m)^{2/5}, mean = const c^{4/5} (A/m)^{-2/5}
    def front(x):
        found = shock_edges(gx.Hertz(x[0]), x[1], x[2])
        return jnp.log(jnp.stack([found.leading_speed, found.mean]))

    x = jnp.array([1.0, 0.5, 1.0])
    powers = np.array([[0.4, 0.2, -0.4], [-0.4, 0.8, 0.4]])
    assert_allclose(jax.jacrev(front)(x) * x, powers, atol=1e-7)


@pytest.mark.parametrize(
    "law, c, more, said",
    [
        (gx.Hertz(1.0, 1.0), 0.0, {}, "^c: expected a number other than zero"),
        (GRANULAR, -0.1, {}, "^c: expected a number above zero.*softens in tension.*fan"),
        (
            gx.PowerLaw(1.0, 0.5, 1.0),
            0.1,
            {},
            "^c: expected a number below zero.*softens in compression",
        ),
        (gx.PowerLaw(1.0, 0.5, 1.0), -3.0, {}, "^c: expected a number above -0.4714"),
        (gx.Linear(1.0), 0.1, {}, "^law: expected one that stiffens or softens.*linear_shock"),
        (
            gx.Polynomial(1.0, 1.0, -1.0),
            0.3,
            {},
            "^law: expected one that bends one way.*inflection near 0.3",
        ),
        (
            gx.Hertz(),
            0.1,
            {"ahead": -0.1},
            "^ahead: expected a strain at which the contacts are closed",
        ),
        (gx.Hertz(), -0.1, {}, "without stiffness in tension"),
        (gx.scenes.dimer(8, precompression=1.0), 0.1, {}, "^law: expected a uniform chain"),
    ],
)
def test_what_makes_no_such_shock_is_refused(law, c, more, said):
    with refused(said):
        shock_edges(law, c, **more)


@pytest.mark.study
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
        timeout=120,
        check=True,
    ).stdout
    speed, error, y = map(float, told.split())
    assert speed == pytest.approx(1.31519072, rel=1e-6) and 1e-7 < error < 1e-5
    assert y == pytest.approx(2.0470771, rel=1e-5)


def test_edges_are_found_outside_of_compiled_functions():
    with refused("known"):
        jax.jit(lambda c: shock_edges(GRANULAR, c).mean)(0.1)


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


@pytest.mark.parametrize("t", [0.3, 41.0, 1e4])
def test_linear_shocks_are_sums_of_bessel_functions(t):
    J = bessel(2 * t)
    front = int(t)
    n = np.array([0, 1, 2, 7, front // 2, front - 3, front, front + 2, front + 40])
    n = n[(n >= 0) & (2 * n + 4 < len(J))]
    # int_0^t J_{2n}(2s) ds = sum_k J_{2n+1+2k}(2t)
    step = np.array([2 * (J[2 * k + 1 :: 2].sum() + J[2 * k + 3 :: 2].sum()) for k in n], float)
    strain = np.array([J[2 * k :: 2].sum() for k in n], float)
    for bonds, of_step, of_strain in (
        (n, step, strain),
        (-1 - n, step, None),
        (1 - n, None, 1 - strain),
    ):
        if of_step is not None:
            assert_allclose(linear_shock.velocity_step(bonds, t, 1.0), of_step, atol=1e-12)
        if of_strain is not None:
            assert_allclose(linear_shock.strain_step(bonds, t, 1.0), of_strain, atol=1e-12)


def test_linear_shocks_are_those_of_a_simulated_chain():
    sites, c, K, m, t = 81, 0.3, 2.0, 0.7, 6.0
    n, u = np.arange(sites) - 40, np.zeros(sites)
    chain = gx.Lattice(m, gx.Bond(gx.Shift(1, "free"), gx.Linear(K)), sites=sites)
    ramp = np.append(0.0, -np.cumsum(np.where(n[:-1] <= 0, c, 0.0)))
    kept = slice(28, -28)  # what the ends have not reached
    for state, step in (
        ((u, -2 * c * np.sign(n)), linear_shock.velocity_step),
        ((ramp, u), linear_shock.strain_step),
    ):
        run = gx.simulate(
            chain, gx.State(*map(jnp.asarray, state)), t, solver=gx.KahanLi8(), step=0.05
        )
        found = step(n[:-1], t, c, K, m)
        assert_allclose(-np.diff(run.final.u)[kept], found[kept], atol=1e-12)


@pytest.mark.slow
def test_linear_shocks_broadcast_and_differentiate():
    n, t, K = (
        np.arange(-6, 6)[:, None, None],
        np.array([0.0, 1.0, 5.0])[:, None],
        np.array([1.0, 2.0]),
    )
    whole = linear_shock.velocity_step(n, t, 0.3, K)
    assert whole.shape == (12, 3, 2) and not np.any(whole[:, 0])
    assert linear_shock.strain_step(n, [], 1.0).shape == (12, 1, 0)
    assert linear_shock.velocity_step([], 2.0, 1.0).size == 0
    one = linear_shock.velocity_step(n[:, 0, 0], 5.0, 0.3, 2.0)
    assert_allclose(whole[:, 2, 1], one, atol=1e-15)

    def both(x):
        return linear_shock.velocity_step(3, *x) + linear_shock.strain_step(-1, *x)

    x, h = jnp.array([4.0, 0.5, 1.3, 0.8]), 1e-4
    apart = [
        jnp.stack([both(x + k * h * e) - both(x - k * h * e) for e in np.eye(4)]) for k in (1, 2)
    ]
    assert_allclose(jax.grad(both)(x), (8 * apart[0] - apart[1]) / (12 * h), atol=1e-10)
    assert_allclose(jax.jacfwd(both)(x), jax.grad(both)(x), atol=1e-14)


@pytest.mark.parametrize(
    "call, said",
    [
        (lambda: linear_shock.velocity_step(0.5, 1.0, 1.0), "^n: expected whole numbers"),
        (lambda: linear_shock.velocity_step(0, -1.0, 1.0), "^t: expected numbers not below zero"),
        (
            lambda: jax.jit(lambda t: linear_shock.strain_step(0, t, 1.0))(1.0),
            "^t: expected times that are known",
        ),
    ],
)
def test_what_no_linear_shock_has_is_refused(call, said):
    with refused(said):
        call()


# --------------------------------------------------------------------------------------------------------- simple waves


def test_the_mean_of_a_power_law_in_closed_form():
    c = np.array([-0.15, 1e-13, 0.1, 0.3, 0.5])
    for x, y in zip(c, 0.5 * np.expm1(0.8 * np.log1p(5 * c))):
        assert simple_wave.mean(GRANULAR, x) == pytest.approx(float(y), rel=1e-12)
    # (2 r c)^{1/r} (m/(p A))^{1/(2r)}, 2r = p + 1
    vacuum = 1.75 ** (1 / 1.75) * (0.7 / (2.5 * 1.3)) ** (1 / 3.5)
    assert simple_wave.mean(gx.PowerLaw(1.3, 2.5), 0.5, 0.7) == pytest.approx(vacuum, rel=1e-12)


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_fan_of_a_simulated_chain():
    sites, t = 400, 150.0
    n = np.arange(sites) - sites // 2
    chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), gx.Toda()), sites=sites)
    run = gx.simulate(chain, gx.State(jnp.zeros(sites), jnp.asarray(0.4 * np.sign(n))), t)
    s = (n[:-1] + 0.5) / t
    # away from the edges, where a lattice rings
    within = (np.abs(s) > 0.86) & (np.abs(s) < 0.94)
    gap = -np.diff(run.final.u) - simple_wave.fan(s, gx.Toda(), -0.2)
    assert np.abs(gap[within]).max() < 1.1e-2 and np.abs(gap[np.abs(s) < 0.5]).max() < 2e-2


@pytest.mark.study
def test_simple_waves_differentiate():
    def both(x):
        law = gx.Hertz(x[1], x[2])
        inside = simple_wave.fan(x[0], law, x[3], x[4], ahead=x[5])
        return jnp.stack([inside, simple_wave.mean(law, x[3], x[4], ahead=x[5])])

    x, h = jnp.array([0.85, STIFFNESS, STIFFNESS * REST**1.5, -0.15, 1.0, 0.02]), 1e-4
    apart = [
        jnp.stack([both(x + k * h * e) - both(x - k * h * e) for e in np.eye(6)], 1) for k in (1, 2)
    ]
    found = jax.jacrev(both)(x)
    assert_allclose(found, (8 * apart[0] - apart[1]) / (12 * h), atol=1e-9)
    assert_allclose(jax.jacfwd(both)(x), found, atol=1e-13)


@pytest.mark.parametrize(
    "call, said",
    [
        (
            lambda: simple_wave.fan(1.0, GRANULAR, 0.1),
            "^c: expected a number below zero.*shock_edges",
        ),
        (lambda: simple_wave.mean(GRANULAR, -5.0), "^c: expected a number above -0.2"),
        (lambda: simple_wave.mean(GRANULAR, 0.0), "^c: expected a number other than zero"),
    ],
)
def test_what_no_simple_wave_has_is_refused(call, said):
    with refused(said):
        call()
