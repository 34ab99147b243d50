"""Periodic orbits: guesses that fall to rest, folds, tangents on an adaptive mesh, long products, multipliers at +1."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import granjax as gx
from granjax.continuation.newton import newton
from granjax.floquet import floquet
from granjax.forced import forced_branch, forced_orbit
from granjax.orbits import Shooting

# a guess that falls to rest -----------------------------------------------------------------------------------------

N = 5
DIMER = gx.scenes.dimer(N, ratio=0.5, precompression=1.0, boundary="free")


@pytest.fixture(scope="module")
def breather():
    """Below the highest mode by two per cent, by its family, which has an amplitude at every point."""
    top = float(gx.linear.normal_modes(DIMER).omega[-1])
    return gx.breathers.family(DIMER, until=0.98 * top, stability=False).orbit(-1)


@pytest.mark.slow
def test_newton_at_a_given_frequency_falls_to_rest_from_a_small_guess(breather):
    half = Shooting.half(DIMER, gx.Flow(jnp.asarray(20), gx.KahanLi8()))
    shape = np.asarray(gx.linear.normal_modes(DIMER).modes)[:, -1]

    def found(amplitude):
        guess = half.guess(
            gx.State(jnp.asarray(amplitude * shape / np.abs(shape).max()), DIMER.zeros())
        )
        root = newton(
            half.residual,
            guess,
            (DIMER, breather.period),
            linearise=half.linearise,
            tolerance=1e-11,
        )
        return float(np.abs(root.x[:N]).max())

    # the shape is right and Newton converges, to the orbit of amplitude zero
    assert max(found(0.1), found(0.2)) < 1e-12
    assert found(0.4) == pytest.approx(0.487690114, abs=1e-8)
    # the family begins at zero, and leaves it
    assert (
        np.abs(breather.state.u).max() == pytest.approx(0.487690114, abs=1e-8)
        and breather.residual < 1e-11
    )


# a fold -------------------------------------------------------------------------------------------------------------


def duffing(omega):
    """Two sites that move alike: x'' + x'/20 + x + x^3/10 = cos(omega t)/10."""
    drive = gx.Harmonic(0.1, omega)
    return gx.Lattice(
        jnp.ones(2),
        (
            gx.Bond(gx.Shift(1, "free"), gx.Linear(0.3)),
            gx.OnSite(gx.Polynomial(1.0, 0.0, 0.1)),
            gx.Damping(0.05),
            gx.Drive(drive, 0),
            gx.Drive(drive, 1),
        ),
    )


def period_of(omega):
    return 2 * jnp.pi / omega


@pytest.mark.study
def test_natural_continuation_ends_at_a_fold():
    omegas, guess, converged = 0.7 + 0.02 * np.arange(36), None, []
    for omega in omegas:
        orbit = forced_orbit(duffing(jnp.asarray(omega)), period_of(omega), guess, throw=False)
        guess = orbit.state
        converged.append(bool(orbit.converged))
    # up to the fold at 1.116 every orbit is found from the one before, from there on none
    assert np.array_equal(converged, omegas < 1.11)
    # by the length along the branch: over that fold, down and over the next, up to the end
    branch = forced_branch(duffing, 0.7, 1.4, period=period_of)
    assert_allclose(branch.folds, [1.11614, 1.07613], rtol=0, atol=1e-5)
    assert branch.p[-1] == 1.4 and np.abs(np.diff(branch.response)).max() < 0.1
    middle = (branch.p > branch.folds[1]) & (branch.p < branch.folds[0])
    assert set(branch.verdict[middle]) == {"stable", "unstable"}


# multipliers through an adaptive mesh -------------------------------------------------------------------------------


@pytest.mark.study
def test_multipliers_through_an_adaptive_mesh_are_garbage():
    # all beads swing together with frequency 1; contacts, up to 77 times as fast, stay at rest
    ring = gx.Lattice(
        1.0,
        (gx.Bond(gx.Shift(1, "periodic"), gx.Hertz(1000.0, 1.0)), gx.OnSite(gx.Linear(1.0))),
        sites=4,
    )
    start, period = np.array([0.5] * 4 + [0.0] * 4), 2 * np.pi
    omega = np.asarray(gx.linear.normal_modes(ring).omega)

    def end(z):
        state, how = gx.State(z[:4], z[4:]), diffrax.ForwardMode()
        run = gx.simulate(ring, state, period, solver=diffrax.Dopri8(), tolerance=1e-8, adjoint=how)
        return jnp.concatenate([run.final.u, run.final.v])

    # the orbit closes to nine digits, and every multiplier is on the unit circle
    assert np.abs(end(start) - start).max() < 1e-8
    naive = np.linalg.eigvals(np.asarray(jax.jacfwd(end)(jnp.asarray(start))))
    assert not np.abs(naive).max() < 1e6
    # a fixed symplectic step tied to the highest linear frequency
    fl = floquet(ring, gx.State(start[:4], start[4:]), period, tolerance=1e-11)
    assert fl.verdict == "stable" and np.abs(np.abs(fl.multipliers) - 1).max() < 1e-6
    exact = np.concatenate([np.exp(1j * omega * period), np.exp(-1j * omega * period)])
    assert np.abs(fl.multipliers[:, None] - exact).min(1).max() < 1e-6


# a product that loses what is small ---------------------------------------------------------------------------------


def test_the_monodromy_matrix_of_a_long_unstable_orbit_loses_its_small_multipliers():
    sites, period = 4, 32.0
    pendula = gx.Lattice(
        1.0,
        (gx.Bond(gx.Shift(1, "free"), gx.Linear(0.2)), gx.OnSite(gx.Sine(1.0, 1.0))),
        sites=sites,
    )
    upright = gx.State(jnp.full(sites, jnp.pi), jnp.zeros(sites))
    growth = np.sqrt(1 - 0.4 * (1 - np.cos(np.pi * np.arange(sites) / sites)))
    exact = np.exp(period * np.sort([*growth, *-growth]))
    assert exact[-1] > 7e13

    whole = floquet(pendula, upright, period)
    naive = np.sort(np.abs(np.linalg.eigvals(whole.monodromy)))
    # by eleven orders of magnitude; the pairs rho rho' = 1 are as wrong
    assert naive[0] / exact[0] > 1e10 and naive[0] * naive[-1] > 1e10
    assert_allclose(naive[-2:], exact[-2:], rtol=1e-9)

    rho = np.sort(np.abs(floquet(pendula, upright, period, segments=16).multipliers))
    assert_allclose(rho, exact, rtol=1e-11)
    assert_allclose(rho * rho[::-1], 1, rtol=0, atol=1e-11)


# multipliers at +1 --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_fixed_threshold_calls_the_multipliers_of_symmetry_unstable(breather):
    # phase and energy are a double multiplier, which splits like the square root of the error of the step
    by_steps = {steps: breather.floquet(steps=steps) for steps in (8, 10, 12, 16)}
    for steps, fl in by_steps.items():
        outside = np.flatnonzero(np.abs(fl.multipliers) > 1 + 1e-6)
        assert len(outside) and np.abs(fl.multipliers[outside] - 1).max() < 1e-3
        # nor do other step sizes know it better than that
        assert np.all(np.abs(fl.multipliers[outside] - 1) < fl.error[outside]) and not len(
            fl.unstable
        )
    split = [np.abs(fl.multipliers).max() - 1 for fl in by_steps.values()]
    assert split[0] > 5e-4 and split[-1] < 5e-5
    # three step sizes know the others to the resolution from twelve steps on
    assert [fl.verdict for fl in by_steps.values()] == [
        "undecided",
        "undecided",
        "stable",
        "stable",
    ]
    fine = breather.floquet()
    assert fine.verdict == "stable" and np.abs(np.abs(fine.multipliers) - 1).max() < 1e-6
