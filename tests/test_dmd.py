import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx
from granjax.identify import dmd, hard_threshold, snapshots

DT, FRAMES = 0.3, 401


def _ssh():
    springs = np.where(np.arange(21) % 2 == 0, 2.0, 1.0)
    return gx.Lattice(np.ones(20), (gx.Bond(gx.Shift(1, "fixed"), gx.Linear(springs)),))


def _run(u, v):
    chain = _ssh()
    state = gx.State(jnp.asarray(u), jnp.asarray(v))
    return gx.simulate(
        chain, state, DT * (FRAMES - 1), save_at=FRAMES, solver=gx.SRKN14a(), step=0.05
    )


@pytest.fixture(scope="module")
def modes():
    return gx.linear.normal_modes(_ssh())


@pytest.fixture(scope="module")
def edge(modes):
    phi = np.asarray(modes.modes)
    return snapshots(_run(phi[:, 9] + 0.5 * phi[:, 10], np.zeros(20)))


@pytest.fixture(scope="module")
def every():
    u, v = np.random.default_rng(0).normal(size=(2, 20))
    return snapshots(_run(u, v))


def positive(omega):
    return np.sort(omega.imag[omega.imag > 1e-3])


@pytest.mark.slow
def test_edge_states_of_the_ssh_chain(edge, modes):
    """Two states in the gap, one part in a thousand apart: their frequencies without a model."""
    found = dmd(edge, DT)
    assert found.rank == 4
    np.testing.assert_allclose(
        positive(found.omega), np.asarray(modes.omega)[9:11], rtol=0, atol=1e-11
    )
    np.testing.assert_allclose(
        positive(found.omega) ** 2, [2.99853515, 3.00146485], rtol=0, atol=1e-8
    )
    np.testing.assert_allclose(found.omega.real, 0, atol=1e-11)
    assert found.residual < 1e-12 and found.misfit < 1e-11


def test_all_modes_and_the_reconstruction(every, modes):
    found = dmd(every, DT)
    assert found.rank == 40
    assert found.to_xarray().shapes_real.dims == ("sensor", "mode") and "of their norm" in repr(
        found
    )
    np.testing.assert_allclose(positive(found.omega), modes.omega, rtol=0, atol=1e-10)
    t = DT * np.arange(FRAMES)
    np.testing.assert_allclose(found.reconstruction(t), every, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.reconstruction(0.0), every[0], rtol=0, atol=1e-9)
    sizes = np.abs(found.amplitudes)
    assert (np.diff(sizes) <= 1e-9 * sizes[0]).all()


def test_delays_see_every_mode_with_two_sensors(every, modes):
    found = dmd(every[:, :2], DT, delays=150)
    assert found.rank == 40 and found.modes.shape == (2, 40)
    np.testing.assert_allclose(positive(found.omega), modes.omega, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        found.reconstruction(DT * np.arange(FRAMES)), every[:, :2], rtol=0, atol=1e-8
    )
    # one sensor without delays has room for one real number
    assert dmd(every[:, :1], DT).rank == 1


def test_decay_rate_and_frequency_of_a_damped_mode():
    t = 0.1 * np.arange(60)
    shape = np.array([1.0, 0.5j, 2.0])
    y = (np.exp((-0.03 + 1.7j) * t)[:, None] * shape).real
    found = dmd(y, 0.1)
    np.testing.assert_allclose(
        np.sort_complex(found.omega), [-0.03 - 1.7j, -0.03 + 1.7j], rtol=0, atol=1e-11
    )
    later = (np.exp((-0.03 + 1.7j) * 7.3) * shape).real
    np.testing.assert_allclose(found.reconstruction(7.3), later, rtol=0, atol=1e-10)
    complex_found = dmd(np.exp((-0.03 + 1.7j) * t)[:, None], 0.1)
    np.testing.assert_allclose(complex_found.omega, [-0.03 + 1.7j], rtol=0, atol=1e-12)
    assert np.iscomplexobj(complex_found.reconstruction(t))


def test_hard_threshold_of_singular_values():
    # Gavish, Donoho 2014: 2.858 for a square, and their fit 0.56 beta^3 - 0.95 beta^2 + 1.82 beta + 1.43 within 0.02
    assert abs(hard_threshold((100, 100)) - 2.8582) < 3e-4
    for beta in (0.1, 0.3, 0.5, 0.8):
        fit = 0.56 * beta**3 - 0.95 * beta**2 + 1.82 * beta + 1.43
        assert abs(hard_threshold((10, 10 / beta)) - fit) < 0.02


def test_the_optimal_rank_of_noisy_edge_states(edge, modes):
    noisy = edge[:, :3] + 0.02 * np.random.default_rng(1).normal(size=(FRAMES, 3))
    assert dmd(noisy, DT, delays=40).rank == 120
    found = dmd(noisy, DT, "optimal", delays=40)
    # 12 units of time do not part two frequencies 8e-4 apart: they are one
    assert found.rank == 2
    np.testing.assert_allclose(positive(found.omega), np.sqrt(3), rtol=0, atol=1e-3)


def test_agrees_with_pydmd(every):
    pydmd = pytest.importorskip("pydmd")
    theirs = pydmd.DMD(svd_rank=40, exact=True).fit(every[:300].T.copy())
    ours = dmd(every[:300], DT, 40)
    same = np.abs(ours.eigenvalues[:, None] - theirs.eigs).argmin(0)
    np.testing.assert_allclose(ours.eigenvalues[same], theirs.eigs, rtol=0, atol=1e-11)
    weighted = ours.modes[:, same] * ours.amplitudes[same]
    np.testing.assert_allclose(weighted, theirs.modes * theirs.amplitudes, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "bad, word",
    [
        (dict(snapshots=np.ones(5)), "numbers .T, n."),
        (dict(delays=5), "delays"),
    ],
)
def test_bad_input_is_refused(bad, word):
    t = np.arange(5.0)
    good = dict(snapshots=np.stack([np.cos(t), np.sin(t)], -1), dt=1.0)
    with pytest.raises(ValueError, match=word):
        dmd(**(good | bad))
