"""Periodic orbits: guesses that fall to rest, folds, tangents on an adaptive mesh, long products, multipliers at +1."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from known_orbits import pair, period_of
from numpy.testing import assert_allclose

import granjax as gx
from granjax.continuation.newton import newton
from granjax.floquet import floquet
from granjax.forced import forced_orbit
from granjax.orbits import Shooting

pytestmark = pytest.mark.slow
DIMER = gx.scenes.dimer(5, ratio=0.5, precompression=1.0, boundary="free")


@pytest.fixture(scope="module")
def breather():
    """Below the highest mode by two per cent, by its family, which has an amplitude at every point."""
    top = float(gx.linear.normal_modes(DIMER).omega[-1])
    return gx.breathers.family(DIMER, until=0.98 * top, stability=False).orbit(-1)


def test_newton_at_a_given_frequency_falls_to_rest_from_a_small_guess(breather):
    half = Shooting.half(DIMER, gx.Flow(jnp.asarray(20), gx.KahanLi8()))
    shape = np.asarray(gx.linear.normal_modes(DIMER).modes)[:, -1]

    def found(amplitude):
        u = jnp.asarray(amplitude * shape / np.abs(shape).max())
        guess = half.guess(gx.State(u, DIMER.zeros()))
        scene = (DIMER, breather.period)
        how = dict(linearise=half.linearise, tolerance=1e-11)
        return float(np.abs(newton(half.residual, guess, scene, **how).x[:5]).max())

    # the shape is right and Newton converges, to the orbit of amplitude zero
    assert max(found(0.1), found(0.2)) < 1e-12
    # the family begins at zero, and leaves it
    for amplitude in (found(0.4), np.abs(breather.state.u).max()):
        assert amplitude == pytest.approx(0.487690114, abs=1e-8)
    assert breather.residual < 1e-11


def test_natural_continuation_ends_at_a_fold():
    omegas = 0.9 + 0.02 * np.arange(20)
    guess = None
    converged = []
    for omega in omegas:
        orbit = forced_orbit(pair(jnp.asarray(omega)), period_of(omega), guess, throw=False)
        guess = orbit.state
        converged.append(bool(orbit.converged))
    # up to the fold at 1.11614 every orbit is found from the one before, from there on none; by the length along the
    # branch `test_forced` passes it
    assert np.array_equal(converged, omegas < 1.11)


def test_multipliers_through_an_adaptive_mesh_are_garbage():
    # all beads swing together with frequency 1; contacts, up to 77 times as fast, stay at rest
    bond = gx.Bond(gx.Shift(1, "periodic"), gx.Hertz(1000.0, 1.0))
    ring = gx.Lattice(1.0, (bond, gx.OnSite(gx.Linear(1.0))), sites=4)
    start = np.array([0.5] * 4 + [0.0] * 4)
    period = 2 * np.pi
    omega = np.asarray(gx.linear.normal_modes(ring).omega)

    def end(z):
        state = gx.State(z[:4], z[4:])
        how = diffrax.ForwardMode()
        run = gx.simulate(ring, state, period, solver=diffrax.Dopri8(), tolerance=1e-8, adjoint=how)
        return jnp.concatenate([run.final.u, run.final.v])

    # the orbit closes to nine digits, and every multiplier is on the unit circle
    assert np.abs(end(start) - start).max() < 1e-8
    naive = np.linalg.eigvals(np.asarray(jax.jacfwd(end)(jnp.asarray(start))))
    assert not np.abs(naive).max() < 1e6
    # a fixed symplectic step tied to the highest linear frequency
    fl = floquet(ring, gx.State(start[:4], start[4:]), period, tolerance=1e-11)
    assert fl.verdict == "stable" and np.abs(np.abs(fl.multipliers) - 1).max() < 1e-6
    exact = np.exp(1j * period * np.concatenate([omega, -omega]))
    assert np.abs(fl.multipliers[:, None] - exact).min(1).max() < 1e-6


def test_the_monodromy_matrix_of_a_long_unstable_orbit_loses_its_small_multipliers():
    # coupled pendula on their heads, linear bonds: exponents +-sqrt(1 - kappa_j), kappa_j those of the bonds
    bond = gx.Bond(gx.Shift(1, "free"), gx.Linear(0.2))
    own = gx.OnSite(gx.Sine(1.0, 1.0))
    pendula = gx.Lattice(1.0, (bond, own), sites=4)
    period = 32.0
    upright = gx.State(jnp.full(4, jnp.pi), jnp.zeros(4))
    growth = np.sqrt(1 - 0.4 * (1 - np.cos(np.pi * np.arange(4) / 4)))
    exact = np.exp(period * np.sort([*growth, *-growth]))
    assert exact[-1] > 7e13
    for segments, accuracy in ((1, None), (4, 1e-7), (16, 1e-11)):
        fl = floquet(pendula, upright, period, segments=segments)
        # largest first; signs are not known of those that are lost
        off = np.abs(np.sort(fl.multipliers.real)[:, None] - exact)
        assert np.all(np.diag(off) <= fl.error[::-1]) and fl.verdict == "unstable"
        rho = np.sort(np.abs(fl.multipliers))
        if segments == 1:
            # wrong by eleven orders of magnitude, 4e-3 where 1e-14 is true; the pairs rho rho' = 1 are as wrong
            naive = np.sort(np.abs(np.linalg.eigvals(fl.monodromy)))
            assert min(rho[0], naive[0]) / exact[0] > 1e10 and naive[0] * naive[-1] > 1e10
            assert_allclose(rho[-3:], exact[-3:], rtol=1e-9)
        else:
            assert_allclose(rho, exact, rtol=accuracy)
            assert_allclose(rho * rho[::-1], 1, rtol=0, atol=accuracy)
            # vectors are those of the product: V = M v/rho for the ones that grow
            grown = fl.monodromy @ fl.vectors[:, :3] / fl.multipliers[:3]
            assert_allclose(grown, fl.vectors[:, :3], rtol=0, atol=1e-6)
            assert fl.steps % segments == 0


def test_a_fixed_threshold_calls_the_multipliers_of_symmetry_unstable(breather):
    # phase and energy are a double multiplier, which splits like the square root of the error of the step
    split = []
    verdicts = []
    for steps in (8, 10, 12, 16):
        fl = breather.floquet(steps=steps)
        outside = np.abs(fl.multipliers) > 1 + 1e-6
        away = np.abs(fl.multipliers[outside] - 1)
        # nor do other step sizes know it better than that
        assert 0 < len(away) and away.max() < 1e-3 and np.all(away < fl.error[outside])
        assert not len(fl.unstable)
        split.append(np.abs(fl.multipliers).max() - 1)
        verdicts.append(fl.verdict)
    assert split[0] > 5e-4 and split[-1] < 5e-5
    # three step sizes know the others to the resolution from twelve steps on
    assert verdicts == ["undecided", "undecided", "stable", "stable"]
    fine = breather.floquet()
    assert fine.verdict == "stable" and np.abs(np.abs(fine.multipliers) - 1).max() < 1e-6
