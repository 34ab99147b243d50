"""Force laws from traces, against traces of another integrator and right-hand side."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import by_dop853, few

import granjax as gx
from granjax.fit import prepared
from granjax.identify.families import Series, law_scene, starting_law
from granjax.identify.law import _acting, _visited, law
from granjax.laws import Network, Spline

N, DAMPING, SPEED, SENSORS = 20, 0.02, 1.5, [1, 4, 7, 10, 13, 16]
TIMES = np.linspace(0.1, 40, 400)
CONTACTS = gx.Shift(1, "fixed")
STATE = gx.State(np.zeros(N), np.r_[SPEED, np.zeros(N - 1)])


def chain(law):
    return gx.Lattice(1.0, (gx.Bond(CONTACTS, law), gx.Damping(DAMPING)), sites=N)


def damped_chain(law, others):
    return gx.Lattice(1.0, (gx.Bond(CONTACTS, law), gx.Damping(others["damping"])), sites=N)


def true_force(e):
    return np.maximum(1 + e, 0) ** 1.5 - 1


@pytest.fixture(scope="module")
def measured():
    """Velocities (T, sensors) by SciPy's DOP853, and the least and largest strain: -0.890, 0.694 of d0 = 1."""
    path, strains = by_dop853(SPEED, TIMES[-1], DAMPING)
    e = strains(path(np.linspace(0, TIMES[-1], 8001))[:N])
    return path(TIMES)[N:][SENSORS].T, (e.min(), e.max())


def traces(velocity, noise, seed=0):
    """Traces with noise of a share of the largest velocity; without it a sigma of 1e-4."""
    sigma = max(noise, 1e-4) * np.abs(velocity).max()
    made = velocity + (noise > 0) * sigma * np.random.default_rng(seed).normal(size=velocity.shape)
    return gx.Traces(TIMES, velocity=made, sites=SENSORS, sigma=sigma)


@pytest.mark.study
@pytest.mark.parametrize("family", few(["power law", "polynomial", "spline", "network"], 2))
def test_every_family_finds_the_force_over_the_strains_visited(measured, family):
    """To 1 % of the largest force, from a stiffness 20 % off, with 1 % of noise (5e-9 without for the true family)."""
    velocity, (low, high) = measured
    for noise in (0.0, 0.01):
        found = law(chain, family, traces(velocity, noise), state=STATE, stiffness=1.2 * 1.5)
        np.testing.assert_allclose(found.strain_range, (low, high), rtol=0, atol=2e-3)
        e, force, bottom, top = found.band(points=301)
        error = np.abs(force - true_force(e)).max() / np.abs(true_force(e)).max()
        assert error < (0.01 if noise or family != "power law" else 1e-7)
        assert np.isfinite(found.force(e)[1]).all()
        assert np.isnan(found.force([low - 0.01, high + 0.01])).all()
        if noise:
            # the bias of a family adds to the noise
            assert ((bottom < true_force(e)) & (true_force(e) < top)).mean() > 0.9
            assert abs(found.fit.reduced_chi_square - 1) < 0.1 and "is known to" in found.outcome
        if family == "power law":
            deviation = float(found.fit.deviations["exponent"])
            assert (
                abs(float(found.law.exponent) - 1.5) < (3 * deviation if noise else 1e-7)
                and deviation < 0.02
            )


@pytest.mark.study
def test_damping_is_found_beside_the_law_and_a_known_precompression_held(measured):
    found = law(
        damped_chain,
        gx.PowerLaw(1.2, jnp.asarray(1.4), 1.0),
        traces(measured[0], 0.01),
        state=STATE,
        others={"damping": 0.03},
        hold=("precompression",),
    )
    assert set(found.fit.parameters) == {"damping", "exponent", "stiffness"}
    kept = found.to_xarray()
    assert kept.force.dims == kept.low.dims == ("strain",) and kept.force.attrs["si_units"] == "N"
    for name, value in (("damping", DAMPING), ("exponent", 1.5), ("stiffness", 1.0)):
        assert abs(found.fit.parameters[name] - value) < 3 * found.fit.deviations[name]
    # the delta method against the law of moved parameters
    gradient = [
        (float(_moved(found, name, 1e-6).force(0.5)) - float(_moved(found, name, -1e-6).force(0.5)))
        / 2e-6
        for name in found.fit.names
    ]
    deviation = np.sqrt(np.array(gradient) @ np.asarray(found.fit.covariance) @ np.array(gradient))
    np.testing.assert_allclose(found.force(0.5)[1], deviation, rtol=1e-5)


def _moved(found, name, change):
    return found.scene.law({**found.fit.parameters, name: found.fit.parameters[name] + change})


def push(t):
    return jnp.where(t < 1.3, 0.2, 0.0)


@pytest.mark.slow
def test_strains_are_visited_across_a_jump_of_the_force():
    """u = F (1 - cos t) until the force ends at T, of amplitude 2 F sin(T/2) from then on."""

    def scene(law):
        return gx.Lattice(1.0, (gx.OnSite(law), gx.Drive(push, 0, breaks=[1.3])), sites=2)

    of_law, start, _ = law_scene(scene, gx.Linear(1.0), {}, ())
    seen = gx.Traces(np.linspace(0.5, 9, 9), velocity=np.zeros((9, 1)), sites=[0], sigma=0.1)
    problem = prepared(of_law, start, seen, state=gx.State(np.zeros(2), np.zeros(2)), step=0.4)
    most = 0.4 * np.sin(0.65)
    np.testing.assert_allclose(
        _visited(_acting(of_law, start), problem, start), (-most, most), rtol=1e-6
    )


def test_a_series_is_the_polynomial():
    series, K = Series([2.0, -0.5, 0.3, 0.1], 2.0, 3.0), [3.0, -0.375, 0.1125, 0.01875]
    e = np.linspace(-2, 2, 9)
    np.testing.assert_allclose(
        series.force(e), sum(k * e**n for n, k in enumerate(K, 1)), rtol=1e-14, atol=1e-15
    )
    np.testing.assert_allclose(
        series.energy(e),
        sum(k * e ** (n + 1) / (n + 1) for n, k in enumerate(K, 1)),
        rtol=1e-14,
        atol=1e-15,
    )
    np.testing.assert_array_equal(series.coefficients, [2.0, -0.5, 0.3, 0.1])


@pytest.mark.parametrize("family", ["power law", "polynomial", "spline", "network"])
def test_families_begin_with_the_linear_stiffness(family):
    """The network's start to 2 %, since its units are not quite linear; the others to rounding."""
    first, _, _ = starting_law(family, 2e7, (-3e-6, 2e-6))
    slope = (first.force(1e-10) - first.force(-1e-10)) / 2e-10
    np.testing.assert_allclose(slope, 2e7, rtol=0.02 if family == "network" else 1e-6)


@pytest.mark.parametrize(
    "first, names, bounded",
    [
        (gx.Hertz(1.0, 1.0), ["precompression", "stiffness"], 2),
        (gx.Hertz(1.0), ["stiffness"], 1),
        (gx.PowerLaw(1.0, jnp.asarray(-3.0), 1.0), ["exponent", "precompression", "stiffness"], 3),
        (
            gx.PowerLaw(1.0, 1.5, 1.0) + gx.Linear(0.1),
            ["parts[0].precompression", "parts[0].stiffness", "parts[1].stiffness"],
            2,
        ),
        (
            Spline([-1.0, 0.0, 1.0], [1.0, 1.0, 1.0, 2.0], 0.5),
            [f"coefficients[{i}]" for i in range(4)],
            4,
        ),
        (Network(2, 1.0, 1.0), [f"parameters[{i}]" for i in range(7)], 0),
    ],
)
def test_what_moves_of_a_law(first, names, bounded):
    scene, start, bounds = law_scene(chain, first, {}, ())
    assert sorted(start) == sorted(names) and len(bounds) == bounded
    again = scene.law(start)
    np.testing.assert_array_equal(again.force(0.3), first.force(0.3))
    # what it holds are arrays, so that others of its kind are no program of their own
    other = jax.tree.map(lambda x: 1.1 * x, first)
    assert jax.tree.structure(law_scene(chain, other, {}, ())[0]) == jax.tree.structure(scene)


def _refused(**changes):
    good = dict(
        scene=chain,
        family="spline",
        traces=traces(np.ones((400, 6)), 0.0),
        state=STATE,
        stiffness=1.0,
        reach=(-1.0, 1.0),
    )
    law(**(good | changes))


@pytest.mark.parametrize(
    "bad, word",
    [
        (dict(family="splines"), "Did you mean 'spline'"),
        (dict(stiffness=None), "stiffness"),
        (dict(family=gx.Linear(1.0), others={"stiffness": 1.0}), "others"),
        (
            dict(
                scene=lambda law: gx.Lattice(
                    1.0, (gx.Bond(CONTACTS, gx.Hertz(1.0, 1.0)),), sites=N
                ),
                reach=None,
            ),
            "acts on",
        ),
    ],
)
def test_bad_input_is_refused(bad, word):
    with pytest.raises(ValueError, match=word):
        _refused(**bad)
