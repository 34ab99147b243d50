"""Where a contact opens the force is only once differentiable: orders, Taylor series and sampled peaks fail there."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import SPLITTING

import granjax as gx


def force_of(t, y, lattice):
    return gx.measures.contact_force(lattice, y)


# order lost --------------------------------------------------------------------------------------------------------

LANES, T = 16, 12.0
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
    t0, t1, h = (jnp.asarray(t) for t in (0.0, T, T / np.round(evaluations / solver.evaluations())))
    how = dict(args=chains, adjoint=diffrax.ForwardMode(), max_steps=None)
    return np.asarray(
        diffrax.diffeqsolve(
            diffrax.ODETerm(gx.vector_field), solver(), t0, t1, h, state, **how
        ).ys.u[0]
    )


def order(solver, chains, state, evaluations):
    """Slope of the mean log error over the log of the number of forces, against 30 times finer steps or more."""
    fine = end(solver, chains, state, 4e5)
    errors = [
        np.log(np.abs(end(solver, chains, state, n) - fine).max(0)).mean() for n in evaluations
    ]
    return -np.polyfit(np.log(evaluations), errors, 1)[0]


NOMINAL = {s: s.table().order for s in SPLITTING}
IMPACT = np.geomspace(800, 12000, 9)
# between the limit of stability and rounding
SMOOTH = {
    gx.VelocityVerlet: (800, 1600, 3200),
    gx.SRKN6b: (600, 900, 1400),
    gx.ABA864: (600, 900, 1400),
    gx.SRKN11b: (440, 620, 880),
    gx.SRKN14a: (420, 600, 840),
    gx.KahanLi8: (700, 900, 1200),
    gx.SofroniouSpaletta10: (740, 950, 1260),
}


@pytest.mark.study
@pytest.mark.parametrize(
    "solver",
    [s if s is gx.SRKN11b else pytest.param(s, marks=pytest.mark.slow) for s in SPLITTING],
    ids=lambda s: s.__name__,
)
def test_order_is_lost_where_contacts_open(solver):
    kept = order(solver, beads(1.0), struck(0.2), SMOOTH[solver])
    lost = order(solver, beads(0.0), struck(1.0), IMPACT)
    assert abs(kept - NOMINAL[solver]) < 0.3
    assert 1.9 < lost < 2.8


@pytest.mark.study
def test_adaptive_steps_escape_the_loss_of_order():
    free, state = beads(0.0), struck(1.0)
    exact = gx.simulate(free, state, T, tolerance=1e-14).final.u
    adaptive = gx.simulate(free, state, T, tolerance=1e-12)
    # as many forces at a fixed step
    step = T * gx.SRKN11b.evaluations() / float(np.mean(adaptive.stats["force_evaluations"]))
    fixed = gx.simulate(free, state, T, step=step)
    assert np.abs(fixed.final.u - exact).max() > 1e-8
    assert np.abs(adaptive.final.u - exact).max() < 1e-10


# a peak between steps ----------------------------------------------------------------------------------------------


@pytest.mark.study
def test_a_peak_seen_at_accepted_steps_is_not_the_peak():
    chain = gx.scenes.monomer(10, boundary="free")
    state, record = gx.states.impact(chain), {"peak": gx.Peak(force_of)}
    run = gx.simulate(chain, state, 8.0, tolerance=1e-8, record=record, save_at="steps")
    fine = gx.simulate(chain, state, 8.0, step=0.002, record=record).recorded["peak"]
    at_steps = np.max(
        [force_of(t, gx.State(u, v), chain) for t, u, v in zip(run.ts, run.us, run.vs)], axis=0
    )
    # contacts 1 to 6, which the pulse has passed
    naive, ours = (np.abs(peak - fine)[:6] / fine[:6] for peak in (at_steps, run.recorded["peak"]))
    assert np.median(naive) > 1e-3
    assert ours.max() < 1e-7


# Taylor series -----------------------------------------------------------------------------------------------------

BEADS = 4


def taylor(hy, state, t1):
    """Heyoka's Taylor integrator on the precompressed chain between walls: state, outcome, energy error."""
    u, v = (hy.make_vars(*[f"{name}{i}" for i in range(BEADS)]) for name in "uv")
    overlaps = [
        1.0 + (u[i - 1] if i else 0.0) - (u[i] if i < BEADS else 0.0) for i in range(BEADS + 1)
    ]
    forces = [hy.select(hy.gt(s, 0.0), s**1.5, 0.0) for s in overlaps]
    equations = [(u[i], v[i]) for i in range(BEADS)] + [
        (v[i], forces[i] - forces[i + 1]) for i in range(BEADS)
    ]
    integrator = hy.taylor_adaptive(equations, np.concatenate(state).tolist(), tol=1e-15)
    outcome = integrator.propagate_until(t1)[0]
    return np.array(integrator.state[:BEADS]), outcome


@pytest.mark.study
def test_a_taylor_integrator_is_silently_wrong_at_contact_loss():
    hy = pytest.importorskip("heyoka")
    chain = gx.scenes.monomer(BEADS, precompression=1.0)
    errors = {}
    for velocity in (0.5, 3.0):
        state = gx.states.impact(chain, velocity=velocity)
        run = gx.simulate(chain, state, 10.0, tolerance=1e-13)
        # another method, at steps of 1/2000
        exact = gx.simulate(chain, state, 10.0, step=5e-4)
        found, outcome = taylor(hy, state, 10.0)
        assert outcome == hy.taylor_outcome.time_limit  # no complaint
        assert bool(run.contact_opened) == (velocity > 1)
        errors[velocity] = [np.abs(u - exact.final.u).max() for u in (found, run.final.u)]
    assert max(errors[0.5]) < 1e-13
    assert errors[3.0][0] > 1e-4 and errors[3.0][1] < 1e-10
