"""The canonical scenes of the benchmarks: their references hold, and granjax's own runs agree with them."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes
from cases import few

import granjax as gx

NAMES = (
    "impact",
    "impact_free",
    "smooth",
    "dimer_sweep",
    "monodromy",
    "toda_soliton",
    "toda_shock_1e4",
    "toda_shock_1e5",
    "fput",
    "driven",
    "light_dimer",
    "softening",
    "magnets",
    "modulated",
)
CONSERVED = tuple(name for name in NAMES if name not in ("driven", "modulated", "monodromy"))


def test_the_scenes_by_name():
    assert scenes.names() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_every_scene_builds_and_its_reference_fits(name):
    scene = scenes.scene(name)
    shape = tuple(scene.lattice.shape) + scene.lattice.lanes
    assert scene.name == name and scene.title and scene.note
    assert np.shape(scene.state.u) == np.shape(scene.state.v) == shape
    if scene.tangents:
        references_found = (scene.reference,)
        assert scene.reference.shape == (2 * shape[0],) * 2
    else:
        references_found = scene.reference
        assert scene.reference.u.shape == scene.reference.v.shape == shape
        # velocities at t1 with an error of 1e-3 in one of them
        size = np.abs(scene.reference.v).max()
        wrong = scene.reference.v + 1e-3 * size * (scene.reference.v == scene.reference.v.max())
        assert scene.error(gx.State(scene.reference.u, wrong)) == pytest.approx(1e-3, rel=1e-9)
    assert all(x.dtype == np.float64 and np.isfinite(x).all() for x in references_found)
    assert scene.error(scene.reference) == 0
    assert 2.0**-53 <= scene.uncertainty < 1e-13
    assert scene.growth > 0 and scene.t1 > scene.t0 == 0
    assert scenes.read(name).t1 == scene.t1 and scenes.read(name).method


def test_the_files_are_small():
    assert sorted(path.stem for path in scenes.DATA.iterdir()) == sorted(NAMES)
    assert sum(path.stat().st_size for path in scenes.DATA.iterdir()) < 1e6


@pytest.mark.study
@pytest.mark.parametrize("name", CONSERVED)
def test_references_keep_the_energy(name):
    scene = scenes.scene(name)
    before, after = (
        gx.measures.energy(scene.lattice, gx.State(*map(jnp.asarray, y)))
        for y in (scene.state, scene.reference)
    )
    assert np.max(np.abs(after - before) / before) < 1e-14 * np.sqrt(scene.lattice.shape[0])


# ----------------------------------------------------------------------------------------------- what is known of them


def _soliton_strain(n, t):
    # exp(y) = 1 + sinh^2 k sech^2(k n - t sinh k); M. Toda, J. Phys. Soc. Japan 22, 431 (1967)
    return np.log1p(np.sinh(1) ** 2 / np.cosh(n - 27 - t * np.sinh(1)) ** 2)


def test_the_soliton_is_the_closed_form():
    scene = scenes.scene("toda_soliton")
    n = np.arange(99)
    for y, t in ((scene.state, 0), (scene.reference, scene.t1)):
        assert np.abs(-np.diff(y.u) - _soliton_strain(n, t)).max() < 2e-14
    # energy sinh 2k - 2k and total strain 2k
    strain = -np.diff(scene.reference.u)
    energy = (scene.reference.v**2).sum() / 2 + (np.expm1(strain) - strain).sum()
    assert energy == pytest.approx(np.sinh(2) - 2, rel=1e-14)
    assert scene.reference.u[0] - scene.reference.u[-1] == pytest.approx(2, rel=1e-14)


@pytest.mark.parametrize("name", ["toda_shock_1e4", "toda_shock_1e5"])
def test_the_shock_is_odd_with_a_uniform_rest(name):
    scene = scenes.scene(name)
    u, v = scene.reference
    half = len(u) // 2
    assert (u == -u[::-1]).all() and (v == -v[::-1]).all()
    # ahead of the front, s_+ = 1.31519 at c = 1/2, the sites move as they started
    ahead = int(1.3152 * scene.t1) + 45
    assert (v[half + ahead :] == -1).all() and (u[half + ahead :] == -scene.t1).all()
    assert abs(v[half + int(1.31 * scene.t1)] + 1) > 1e-3
    # behind it the strain is 2 ln(1 + c) = 0.81093022 on average, and rings
    middle = slice(half - int(0.2 * scene.t1), half + int(0.2 * scene.t1))
    assert -np.diff(u[middle]).mean() == pytest.approx(2 * np.log(1.5), abs=0.02)


def test_the_recurrence_is_the_published_one():
    scene = scenes.scene("fput")
    n = np.arange(1, 32)
    mode = np.sin(np.pi * n / 32)
    assert np.abs(scene.state.u - mode).max() < 1e-15

    def share(y):
        a, b = mode @ y.u / 16, mode @ y.v / 16
        return 8 * (b * b + 4 * np.sin(np.pi / 64) ** 2 * a * a) / 0.0770443732448498

    assert share(scene.reference) == pytest.approx(0.9813, abs=5e-5)


def test_the_map_of_tangents_is_symplectic_and_has_the_breathers_multipliers():
    scene = scenes.scene("monodromy")
    size = scene.lattice.shape[0]
    mass = np.diag(np.asarray(scene.lattice.mass))
    J = np.block([[np.zeros((size, size)), mass], [-mass, np.zeros((size, size))]])
    M = scene.reference
    assert np.abs(M.T @ J @ M - J).max() < 1e-14
    multipliers = np.linalg.eigvals(M)
    # 1.126536 in a chain of 121; four at +1, which split like the root of the error of orbit and map
    assert np.abs(multipliers).max() == pytest.approx(1.12662, abs=1e-4)
    nearest = np.sort(np.abs(multipliers - 1))
    assert nearest[3] < 1e-6 < 1e-2 < nearest[4]
    # phase and translation are tangents that come back
    u, strain = np.asarray(scene.state.u), -np.diff(scene.state.u)
    force = np.pad((1 + strain) ** 1.5 - 1, 1)
    a = -np.diff(force) / np.diag(mass)
    for tangent in (np.concatenate([0 * u, a]), np.concatenate([np.ones(size), np.zeros(size)])):
        assert np.abs(M @ tangent - tangent).max() < 1e-13
    energy = (0.4 * (1 + strain) ** 2.5 - 0.4 - strain).sum()
    assert energy == pytest.approx(2.7015770, abs=3e-6)


def test_the_pulses_of_the_sweep_are_inside():
    scene = scenes.scene("dimer_sweep")
    ratios = np.asarray(scene.lattice.mass)[1]
    assert ratios[0] == 0.2 and ratios[-1] == 1 and (np.diff(ratios) > 0).all()
    # momentum: the wall behind bead 0 has only added to it
    momentum = (np.asarray(scene.lattice.mass) * scene.reference.v).sum(0)
    assert (momentum > 1 - 1e-12).all()
    # the pulse is inside: beyond it all is at rest, before it a wake
    front = 59 - np.argmax(np.abs(scene.reference.v[::-1]) > 0.1, axis=0)
    assert front.min() > 25 and front.max() < 50


# --------------------------------------------------------------------------------------------------- granjax's own runs

ADAPTIVE = lambda tolerance: {"solver": gx.RKN1210(), "tolerance": tolerance}  # noqa: E731

# how granjax runs it, and the error that this must not exceed, a few times what was measured
RUNS = {
    "impact": ({"solver": gx.RKN86(), "tolerance": 1e-12}, 1e-9),
    "impact_free": ({"solver": gx.RKN86(), "tolerance": 1e-14}, 1e-12),
    "smooth": (ADAPTIVE(1e-13), 2e-13),
    "toda_soliton": ({"solver": gx.SofroniouSpaletta10(), "step": 0.1}, 1e-13),
    "toda_shock_1e4": (ADAPTIVE(1e-11), 1e-11),
    "toda_shock_1e5": ({"solver": gx.SRKN14a(), "step": 0.1}, 1e-6),
    "fput": (ADAPTIVE(1e-14), 1e-12),
    "driven": ({"solver": diffrax.Dopri8(), "tolerance": 1e-13}, 2e-13),
    "light_dimer": (ADAPTIVE(1e-14), 2e-12),
    "softening": (ADAPTIVE(1e-13), 5e-14),
    "magnets": (ADAPTIVE(1e-13), 1e-13),
    "modulated": (ADAPTIVE(1e-13), 1e-13),
}


@pytest.mark.study
@pytest.mark.parametrize("name", few(list(RUNS), 0, 4, 7, -1))
def test_an_accurate_run_agrees(name):
    scene = scenes.scene(name)
    how, error = RUNS[name]
    run = gx.simulate(scene.lattice, scene.state, scene.t1, t0=scene.t0, **how)
    assert scene.error(run.final) < error
    assert bool(run.contact_opened) == (not scene.smooth)
    assert (
        np.isnan(run.energy_error) if name in ("driven", "modulated") else run.energy_error < 1e-10
    )


@pytest.mark.slow
def test_some_lanes_of_the_sweep_agree_one_by_one():
    scene = scenes.scene("dimer_sweep")
    for lane in (0, 100, 255):
        chain = gx.scenes.dimer(60, ratio=float(np.asarray(scene.lattice.mass)[1, lane]))
        run = gx.simulate(
            chain, gx.states.impact(chain), scene.t1, solver=gx.RKN86(), tolerance=1e-13
        )
        for found, reference in zip(run.final, scene.reference):
            assert np.abs(found - reference[:, lane]).max() < 1e-9
        assert bool(run.contact_opened)


@pytest.mark.slow
def test_tangents_of_the_tenth_order_method_agree():
    scene = scenes.scene("monodromy")
    size = scene.lattice.shape[0]

    def flow(y):
        run = gx.simulate(
            scene.lattice,
            gx.State(y[:size], y[size:]),
            scene.t1,
            solver=gx.SofroniouSpaletta10(),
            step=scene.t1 / 40,
        )
        return jnp.concatenate(run.final), run

    start = jnp.concatenate([jnp.asarray(x) for x in scene.state])
    matrix, run = jax.jacfwd(flow, has_aux=True)(start)
    assert scene.error(np.asarray(matrix)) < 5e-14
    assert np.abs(jnp.concatenate(run.final) - start).max() < 2e-14
    plain = gx.simulate(
        scene.lattice, scene.state, scene.t1, solver=gx.SofroniouSpaletta10(), step=scene.t1 / 40
    )
    assert not bool(plain.contact_opened)
