"""Scenes that mock a rule of thumb: batches of uneven lanes, and chaos."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx


def dimer(ratio, F0):
    return gx.scenes.dimer(8, ratio=ratio, precompression=F0)


@pytest.mark.slow
def test_a_batch_is_paced_by_its_slowest_lane():
    ratios = np.geomspace(0.01, 1.0, 16)
    calls = []

    def field(t, y, ratio):
        jax.debug.callback(lambda: calls.append(1))  # once for all lanes of a loop
        return gx.vector_field(t, y, dimer(ratio, 1.0))

    @jax.jit
    def solve(ratio):
        return diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            gx.RKN86(),
            0.0,
            10.0,
            None,
            gx.states.impact(dimer(ratio, 1.0)),
            args=ratio,
            max_steps=None,
            stepsize_controller=diffrax.PIDController(rtol=1e-7, atol=1e-7),
            adjoint=diffrax.ForwardMode(),
        ).ys

    def work(function, batches):
        """Forces of the whole sweep: what each loop calls, times its lanes."""
        total = 0
        for batch in batches:
            calls.clear()
            jax.block_until_ready(function(jnp.asarray(batch)))
            jax.effects_barrier()
            total += len(calls) * np.size(batch)
        return total

    alone = work(solve, ratios)
    together = jax.vmap(solve)
    assert work(together, [ratios]) > 2.2 * alone
    assert work(together, ratios.reshape(4, 4).T) > 1.6 * alone
    assert work(together, ratios.reshape(4, 4)) < 1.4 * alone


@pytest.mark.slow
def test_lanes_of_one_lattice_have_steps_of_their_own():
    # in a sonic vacuum: where they shared steps, they took more than the worst lane takes alone
    ratios = jnp.array([0.3, 0.6, 1.0])
    chains = jax.vmap(lambda ratio: dimer(ratio, 0.0), out_axes=-1)(ratios)

    def run(chain, **how):
        return gx.simulate(chain, gx.states.impact(chain), 10.0, **how)

    each = run(chains, tolerance=1e-7).stats["steps"]
    assert each.tolist() == [int(run(dimer(r, 0.0), tolerance=1e-7).stats["steps"]) for r in ratios]
    # at a fixed step the lanes cost what they cost alone
    fixed = run(chains, step=0.05)
    assert int(fixed.stats["steps"]) == 200 and fixed.energy_error.max() < 1e-5


@pytest.mark.slow
def test_error_at_a_time_means_nothing_in_chaos_and_an_average_does():
    chain = gx.scenes.monomer(16)
    state = gx.states.random(chain, 3, displacement=0.0, velocity=1.0)
    nudged = gx.State(state.u, state.v.at[3].add(1e-14))
    record = {"kinetic": gx.Integral(lambda t, y, lattice: lattice.kinetic_energy(y.v)[None])}
    t1 = 3000.0
    whole = float(chain.energy(0.0, *state))
    ways = (
        (state, gx.SRKN11b(), 0.1),
        (state, gx.SRKN11b(), 0.05),
        (state, gx.SRKN6b(), 0.05),
        (nudged, gx.SRKN11b(), 0.1),
    )
    runs = [
        gx.simulate(chain, y, t1, solver=solver, step=h, record=record) for y, solver, h in ways
    ]
    assert max(float(run.energy_error) for run in runs) < 2e-4
    first = runs[0].final.u
    apart = [np.abs(run.final.u - first).max() for run in runs[1:]]
    assert min(apart) > 0.3 * np.abs(first).max()
    # virial theorem for walls and forces of degree 3/2: 2 <K> = (5/2) <U>, so <K>/E = 5/9
    shares = np.array([float(run.recorded["kinetic"][0]) / t1 / whole for run in runs])
    assert np.abs(shares - 5 / 9).max() < 1e-3
