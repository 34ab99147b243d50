"""The canonical scenes of the benchmarks: their references hold, and granjax's own runs agree with them."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import scenes
from numpy.testing import assert_allclose
from pytest import mark

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


def test_the_scenes_by_name_and_their_small_files():
    assert scenes.names() == NAMES
    files = list(scenes.DATA.iterdir())
    assert sorted(path.stem for path in files) == sorted(NAMES)
    assert sum(path.stat().st_size for path in files) < 1e6


@mark.parametrize("name", NAMES)
def test_every_scene_builds_and_its_reference_fits(name):
    scene = scenes.scene(name)
    shape = tuple(scene.lattice.shape) + scene.lattice.lanes
    assert scene.name == name and scene.title and scene.note
    assert np.shape(scene.state.u) == np.shape(scene.state.v) == shape
    if scene.tangents:
        assert scene.reference.shape == (2 * shape[0],) * 2
    else:
        u, v = scene.reference
        assert u.shape == v.shape == shape
        # velocities at t1 with an error of 1e-3 in one of them
        wrong = v + 1e-3 * np.abs(v).max() * (v == v.max())
        assert_allclose(scene.error(gx.State(u, wrong)), 1e-3, rtol=1e-9)
    found = np.asarray(scene.reference)
    assert found.dtype == np.float64 and np.isfinite(found).all()
    assert scene.error(scene.reference) == 0 and 2.0**-53 <= scene.uncertainty < 1e-13
    assert scene.growth > 0 and scene.t1 > scene.t0 == 0
    assert scenes.read(name).t1 == scene.t1 and scenes.read(name).method


@mark.slow
def test_references_keep_the_energy():
    for name in CONSERVED:
        scene = scenes.scene(name)
        before, after = (
            gx.measures.energy(scene.lattice, gx.State(*map(jnp.asarray, y)))
            for y in (scene.state, scene.reference)
        )
        within = 1e-14 * np.sqrt(scene.lattice.shape[0])
        assert np.max(np.abs(after - before) / before) < within, name


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
    assert_allclose(energy, np.sinh(2) - 2, rtol=1e-14)
    assert_allclose(scene.reference.u[0] - scene.reference.u[-1], 2, rtol=1e-14)


def test_the_map_of_tangents_is_symplectic_and_has_the_breathers_multipliers():
    scene = scenes.scene("monodromy")
    size = scene.lattice.shape[0]
    mass = np.diag(np.asarray(scene.lattice.mass))
    J = np.block([[np.zeros((size, size)), mass], [-mass, np.zeros((size, size))]])
    M = scene.reference
    assert np.abs(M.T @ J @ M - J).max() < 1e-14
    multipliers = np.linalg.eigvals(M)
    # 1.126536 in a chain of 121; four at +1, which split like the root of the error of orbit and map
    assert_allclose(np.abs(multipliers).max(), 1.12662, rtol=0, atol=1e-4)
    nearest = np.sort(np.abs(multipliers - 1))
    assert nearest[3] < 1e-6 < 1e-2 < nearest[4]
    # phase and translation are tangents that come back
    u = np.asarray(scene.state.u)
    strain = -np.diff(scene.state.u)
    force = np.pad((1 + strain) ** 1.5 - 1, 1)
    a = -np.diff(force) / np.diag(mass)
    for tangent in (np.concatenate([0 * u, a]), np.concatenate([np.ones(size), np.zeros(size)])):
        assert np.abs(M @ tangent - tangent).max() < 1e-13
    energy = (0.4 * (1 + strain) ** 2.5 - 0.4 - strain).sum()
    assert_allclose(energy, 2.7015770, rtol=0, atol=3e-6)


# --------------------------------------------------------------------------------------------------- granjax's own runs

ADAPTIVE = lambda tolerance: {"solver": gx.RKN1210(), "tolerance": tolerance}  # noqa: E731

# how granjax runs it, and the error that this must not exceed, a few times what was measured
RUNS = {
    "impact": ({"solver": gx.RKN86(), "tolerance": 1e-12}, 1e-9),
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


@mark.slow
@mark.usefixtures("optimised")
@mark.parametrize("name", RUNS)
def test_an_accurate_run_agrees(name):
    scene = scenes.scene(name)
    how, error = RUNS[name]
    run = gx.simulate(scene.lattice, scene.state, scene.t1, t0=scene.t0, **how)
    assert scene.error(run.final) < error
    assert bool(run.contact_opened) == (not scene.smooth)
    if name in CONSERVED:
        assert run.energy_error < 1e-10
    else:
        assert np.isnan(run.energy_error)


@mark.slow
def test_some_lanes_of_the_sweep_agree_one_by_one():
    scene = scenes.scene("dimer_sweep")
    ratios = np.asarray(scene.lattice.mass)[1]
    for lane in (0, 100, 255):
        chain = gx.scenes.dimer(60, ratio=float(ratios[lane]))
        start = gx.states.impact(chain)
        run = gx.simulate(chain, start, scene.t1, solver=gx.RKN86(), tolerance=1e-13)
        own = np.asarray(scene.reference)[..., lane]
        assert np.abs(np.asarray(run.final) - own).max() < 1e-9 and run.contact_opened


@mark.slow
def test_tangents_of_the_tenth_order_method_agree():
    scene = scenes.scene("monodromy")
    how = dict(solver=gx.SofroniouSpaletta10(), step=scene.t1 / 40)

    def flow(y):
        run = gx.simulate(scene.lattice, tuple(jnp.split(y, 2)), scene.t1, **how)
        return jnp.concatenate(run.final), run.final

    start = jnp.concatenate([jnp.asarray(x) for x in scene.state])
    matrix, end = jax.jacfwd(flow, has_aux=True)(start)
    assert scene.error(np.asarray(matrix)) < 5e-14
    assert np.abs(jnp.concatenate(end) - start).max() < 2e-14
    assert not gx.simulate(scene.lattice, scene.state, scene.t1, **how).contact_opened
