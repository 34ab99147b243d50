"""Where a contact opens the force is only once differentiable: orders and sampled peaks fail there."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx

pytestmark = pytest.mark.slow

# order lost --------------------------------------------------------------------------------------------------------

LANES = 16
T = 12.0
MASSES = np.linspace(1.0, 1.3, LANES)


def beads(F0):
    """Sixteen chains with free ends: one chain's error is irregular, the geometric mean of all is not."""
    F0 = jnp.asarray(F0)
    return jax.vmap(
        lambda m: gx.scenes.monomer(8, m, precompression=F0 * m, boundary="free"), out_axes=-1
    )(MASSES)


def struck(speed):
    first = np.eye(8)[:, :1]
    return gx.State(np.zeros((8, LANES)), speed * np.linspace(0.8, 1.3, LANES) * first)


def end(solver, chains, state, evaluations):
    """Displacements at T by steps that take about so many forces; times are arrays, so that it compiles once."""
    times = (jnp.asarray(t) for t in (0.0, T, T / np.round(evaluations / solver.evaluations())))
    how = dict(args=chains, adjoint=diffrax.ForwardMode(), max_steps=None)
    terms = diffrax.ODETerm(gx.vector_field)
    return np.asarray(diffrax.diffeqsolve(terms, solver(), *times, state, **how).ys.u[0])


def order(solver, chains, state, evaluations):
    """Slope of the mean log error over the log of the number of forces, against 30 times finer steps or more."""
    fine = end(solver, chains, state, 4e5)
    errors = [
        np.log(np.abs(end(solver, chains, state, n) - fine).max(0)).mean() for n in evaluations
    ]
    return -np.polyfit(np.log(evaluations), errors, 1)[0]


# numbers of forces between the limit of stability and rounding
@pytest.mark.parametrize(
    "solver, evaluations",
    [
        (gx.VelocityVerlet, (800, 1600, 3200)),
        (gx.SRKN11b, (440, 620, 880)),
        (gx.SofroniouSpaletta10, (740, 950, 1260)),
    ],
)
def test_order_is_lost_where_contacts_open(solver, evaluations):
    kept = order(solver, beads(1.0), struck(0.2), evaluations)
    assert abs(kept - solver.table().order) < 0.3
    assert 1.9 < order(solver, beads(0.0), struck(1.0), np.geomspace(800, 12000, 9)) < 2.8


def test_adaptive_steps_escape_the_loss_of_order():
    free = beads(0.0)
    state = struck(1.0)
    exact = gx.simulate(free, state, T, tolerance=1e-14).final.u
    adaptive = gx.simulate(free, state, T, tolerance=1e-12)
    # as many forces at a fixed step
    step = T * gx.SRKN11b.evaluations() / float(np.mean(adaptive.stats["force_evaluations"]))
    fixed = gx.simulate(free, state, T, step=step)
    assert np.abs(fixed.final.u - exact).max() > 1e-8
    assert np.abs(adaptive.final.u - exact).max() < 1e-10


# a peak between steps ----------------------------------------------------------------------------------------------


def test_a_peak_seen_at_accepted_steps_is_not_the_peak():
    chain = gx.scenes.monomer(10, boundary="free")
    state = gx.states.impact(chain)
    record = {"peak": gx.Peak(gx.measures.contact_force)}
    run = gx.simulate(chain, state, 8.0, tolerance=1e-8, record=record, save_at="steps")
    fine = gx.simulate(chain, state, 8.0, step=0.002, record=record).recorded["peak"]
    force = jax.vmap(lambda u, v: gx.measures.contact_force(chain, gx.State(u, v)))
    at_steps = np.max(force(run.us, run.vs), axis=0)
    # contacts 1 to 6, which the pulse has passed
    naive, ours = (np.abs(peak - fine)[:6] / fine[:6] for peak in (at_steps, run.recorded["peak"]))
    assert np.median(naive) > 1e-3
    assert ours.max() < 1e-7
