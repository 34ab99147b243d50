"""A Taylor integrator where contacts open, by heyoka (pip install granjax[bench]). By hand, as all of this folder."""

import numpy as np
import pytest

import granjax as gx

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
