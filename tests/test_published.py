"""Numbers of the literature and closed forms, through `simulate`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import expit

import granjax as gx


def contact_force(t, y, lattice):
    return gx.measures.contact_force(lattice, y)


FORCES = gx.Peak(contact_force)


@pytest.mark.study
def test_impact_of_a_monomer_chain():
    # computed with a converged step by two methods: plateau 0.63955423, speed 0.84050877 (A = m = 1, v = 1)
    chain = gx.scenes.monomer(240, boundary="free")
    arrival = gx.Arrival(contact_force, 0.3)
    run = gx.simulate(
        chain,
        gx.states.impact(chain),
        260.0,
        step=0.02,
        record={"peak": FORCES, "arrival": arrival},
    )
    peak, when = run.recorded["peak"], run.recorded["arrival"]
    assert np.max(np.abs(np.asarray(peak[150:200]) - 0.63955423)) < 1e-7
    assert abs(80 / (when[200] - when[120]) - 0.84050877) < 1e-6
    assert run.contact_opened and run.completed


def test_dimer_contact_forces():
    # converged: SRKN11b, RKN 8(6) and scipy's DOP853 at 1e-12 agree on these to 1e-8. A published table has 0.301903
    # at contact 20, which is 1.8e-6 below; 0.257407 and 0.230943 at 40 and 60 agree to its last digit
    chain = gx.scenes.dimer(101, ratio=0.5)
    run = gx.simulate(chain, gx.states.impact(chain), 90.0, step=0.02, record={"peak": FORCES})
    peak = np.asarray(run.recorded["peak"])[[21, 41, 61]]
    assert np.max(np.abs(peak - [0.30190477, 0.25740781, 0.23094347])) < 2e-8


@pytest.mark.slow
def test_fput_energy_and_first_recurrence():
    # H of the first mode, a = 1; first recurrence t = 9376.5 (E1/H = 0.9813), minimum 0.0882 at t = 6275.5
    chain = gx.scenes.fput(31, alpha=0.25)
    j = np.arange(1, 32)
    mode = np.sqrt(2 / 32) * np.sin(np.pi * j / 32)
    u = np.sin(np.pi * j / 32)
    state = gx.State(u, 0 * u)
    assert (
        abs(
            float(gx.measures.energy(chain, gx.State(jnp.asarray(u), jnp.zeros(31))))
            - 0.0770443732448498
        )
        < 1e-14
    )
    times = np.arange(0.0, 10000.25, 0.25)
    run = gx.simulate(chain, state, 10000.0, step=0.125, save_at=len(times))
    a, b = run.us @ mode, run.vs @ mode
    omega = 2 * np.sin(np.pi / 64)
    share = np.asarray((b * b + omega**2 * a * a) / 2 / 0.0770443732448498)
    late = times > 8000
    first = times[late][np.argmax(share[late])]
    assert abs(first - 9376.5) <= 0.5
    assert abs(share[late].max() - 0.9813) < 1e-4
    assert abs(times[np.argmin(share)] - 6275.5) <= 0.5
    assert abs(share.min() - 0.0882) < 1e-4


@pytest.mark.study
@pytest.mark.parametrize("precompression", [0.0, 0.3])
def test_a_rigid_wall_reflects_like_a_mirror_pulse(precompression):
    # a bead on a rigid plane meets its mirror image: the contact with the plane has half the overlap of the pair's,
    # and so 2^{3/2} times the coefficient
    half = 20
    law = gx.Hertz(1.0, precompression)
    mirror = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), law), sites=2 * half)
    wall = gx.Wall(gx.Hertz(2**1.5, precompression), side="right")
    walled = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "free"), law), wall), sites=half)
    v = np.zeros(2 * half)
    v[0], v[-1] = 1.0, -1.0
    both = gx.simulate(mirror, gx.State(0 * v, v), 50.0, step=0.02, save_at=20)
    one = gx.simulate(walled, gx.State(0 * v[:half], v[:half]), 50.0, step=0.02, save_at=20)
    assert np.max(np.abs(both.us[:, :half] - one.us)) < 1e-10
    assert np.max(np.abs(both.vs[:, :half] - one.vs)) < 1e-10
    assert np.max(np.abs(both.us[:, ::-1] + both.us)) < 1e-10
    assert np.min(one.vs) < -0.5


@pytest.mark.study
@pytest.mark.parametrize("step, band", [(0.6 / np.sqrt(6.0), 1e-8), (0.5, 1e-6)])
def test_energy_band_of_a_precompressed_chain(step, band):
    # N = 128, A = d0 = m = 1, displacements uniform in +-0.1, t = 1e5: a band, and no slope beyond it
    chain = gx.scenes.monomer(128, precompression=1.0)
    state = gx.states.random(chain, 0, displacement=0.1)
    run = gx.simulate(chain, state, 1e5, solver=gx.SRKN11b(), step=step, save_at=2001)
    assert not run.contact_opened
    energy = jax.vmap(lambda u, v: chain.energy(0.0, u, v))(run.us, run.vs)
    relative = np.asarray(energy / energy[0] - 1)
    assert np.max(np.abs(relative)) < band
    slope = np.polyfit(np.asarray(run.ts), relative, 1)[0]
    assert abs(slope) * 1e5 < np.ptp(relative)


@pytest.mark.study
def test_toda_soliton_after_500_sites():
    # closed form: exp(y_n) - 1 = sinh^2 k sech^2(k (n - n0) - t sinh k), speed sinh k/k
    k, sites, start = 1.0, 640, 60.5
    chain = gx.scenes.toda(sites, boundary="free")
    n = np.arange(sites)

    def exact(t):
        # u_n = ln(tau_n / tau_{n+1}) up to a constant, tau_n = 1 + exp(2 (k (n - start) - t sinh k))
        phase = k * (n - 0.5 - start) - t * np.sinh(k)
        near, far = np.logaddexp(0, 2 * phase), np.logaddexp(0, 2 * (phase + k))
        return near - far, 2 * np.sinh(k) * (expit(2 * (phase + k)) - expit(2 * phase))

    t1 = 500 * k / np.sinh(k)
    run = gx.simulate(chain, gx.State(*exact(0.0)), t1, step=0.05)
    u, v = exact(t1)
    assert np.max(np.abs(run.final.u - u)) < 1e-9
    assert np.max(np.abs(run.final.v - v)) < 1e-9
    y = run.final.u[:-1] - run.final.u[1:]
    crest = np.sinh(k) / np.cosh(k * (n[:-1] + 0.5 - start) - t1 * np.sinh(k))
    assert np.max(np.abs(jnp.expm1(y) - crest**2)) < 1e-9
