"""Long-wave equations: each solitary wave in its own and in no other, and the regularised one in time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

import granjax as gx
from granjax import measures
from granjax.theory import compacton, long_wave

SPEED, STIFFNESS, MASS = 1.3, 2.0, 0.7
UNITS = dict(speed=SPEED, stiffness=STIFFNESS, mass=MASS)
WAVES = {
    "displacement": compacton.nesterenko,
    "strain": compacton.ahnert_pikovsky,
    "regularised": long_wave.regularised_wave,
}


def residual(profile, x, force, form):
    """What a wave y = profile(n - c t) leaves of an equation, integrated twice: m c^2 y - F(y) - R/12."""

    def left(x):
        y, slope, bend = profile(x), jax.grad(profile)(x), jax.grad(jax.grad(profile))(x)
        F1, F2, inertia = jax.grad(force)(y), jax.grad(jax.grad(force))(y), MASS * SPEED**2
        second = {
            "displacement": F1 * bend + F2 * slope**2 / 2,
            "strain": F1 * bend + F2 * slope**2,
            "regularised": inertia * bend,
        }[form]
        return inertia * y - force(y) - second / 12

    return jax.vmap(left)(jnp.asarray(x))


@pytest.mark.slow
@pytest.mark.parametrize(
    "p", [1.5, 3.0, *(pytest.param(p, marks=pytest.mark.slow) for p in (1.1, 2.0, 5.5))]
)
def test_each_wave_solves_its_own_equation_and_no_other(p):
    x = np.linspace(-0.95, 0.95, 9) * float(compacton.nesterenko(0.0, p).half_width)
    # at p = 1 all three are one
    force, apart = lambda y: STIFFNESS * y**p, min(0.0125, 0.05 * (p - 1) ** 2)
    for own, wave in WAVES.items():
        size = MASS * SPEED**2 * float(wave(0.0, p, **UNITS).strain)
        for form in WAVES:
            left = residual(lambda x: wave(x, p, **UNITS).strain, x, force, form) / size
            assert np.abs(left).max() < 1e-13 if form == own else np.abs(left).max() > apart, (
                own,
                form,
            )


def test_the_regularised_wave():
    x = np.linspace(-6, 6, 7)
    want = 25 / 16 / np.cosh(np.sqrt(3) / 2 * x) ** 4
    np.testing.assert_allclose(long_wave.regularised_wave(x).strain, want, rtol=1e-13)
    assert long_wave.regularised_wave(0.0, 2.0, speed=2.0).strain == pytest.approx(6.0)
    # far out it neither overflows nor is cut off
    assert long_wave.regularised_wave(-300.0).strain == pytest.approx(
        25 * np.exp(-600 * np.sqrt(3)), rel=1e-11
    )


def test_linear_waves_of_the_ill_posed_equations_grow_beyond_root_twelve():
    k = np.array([1e-3, 1.0, np.sqrt(12) * 0.999, np.sqrt(12) * 1.001, 50.0])
    for form in ("displacement", "strain"):
        assert (np.sign(long_wave.omega_squared(k, form)) == [1, 1, 1, -1, -1]).all()
    found = long_wave.omega_squared(k, "regularised", K2=2.0, mass=0.5)
    assert (found > 0).all() and (found < 48).all()
    for form in long_wave.FORMS:
        assert long_wave.omega_squared(0.1, form) == pytest.approx(4 * np.sin(0.05) ** 2, rel=1e-5)


X, BOX = 360, 30.0
PLACES = (np.arange(X) - X // 2) * BOX / X


@pytest.fixture(scope="module")
def scene():
    start = long_wave.regularised_wave(PLACES, **UNITS).strain
    return gx.travelling.long_wave(
        gx.Hertz(STIFFNESS), start, spacing=BOX / X, speed=SPEED, mass=MASS
    )


def test_how_much_so_many_places_miss(scene):
    coarse = gx.travelling.long_wave(
        gx.Hertz(STIFFNESS),
        long_wave.regularised_wave(PLACES[::4], **UNITS).strain,
        spacing=4 * BOX / X,
        speed=SPEED,
        mass=MASS,
    )
    assert float(scene.unresolved()) < 1e-9 < 1e-4 < float(coarse.unresolved(coarse.state)) < 0.1


@pytest.mark.slow
def test_the_regularised_wave_travels(scene):
    """Over a third of the box, to 1e-10 of its crest; it keeps its shape, and the box its energy and length."""
    run = gx.simulate(scene.lattice, scene.state, 10.0, step=0.03, solver=gx.SRKN11b(), save_at=3)
    want = long_wave.regularised_wave(
        (PLACES - 10 * SPEED + BOX / 2) % BOX - BOX / 2, **UNITS
    ).strain
    y = measures.strain(scene.lattice, run.final)
    np.testing.assert_allclose(y, want, atol=1e-10 * want.max())
    assert run.energy_error < 1e-12 and y.mean() == pytest.approx(float(want.mean()), rel=1e-13)
    assert run.completed


def test_energy_and_rate_are_those_of_the_field(scene):
    start = long_wave.regularised_wave(PLACES, **UNITS).strain
    np.testing.assert_allclose(measures.strain(scene.lattice, scene.state), start, atol=1e-13)
    strain_map = scene.lattice.terms[0].strain_map
    slope = jax.vmap(jax.grad(lambda x: long_wave.regularised_wave(x, **UNITS).strain))(PLACES)
    np.testing.assert_allclose(strain_map.rate(*scene.state), -SPEED * slope, atol=1e-11)
    # int m (u_t^2 + u_xt^2/12)/2 + W, u_t = c y
    density = MASS * SPEED**2 * (start**2 + slope**2 / 12) / 2 + gx.Hertz(STIFFNESS).energy(start)
    mean = start.mean()
    frame = MASS * SPEED**2 * mean**2 * BOX / 2
    energy = float(density.sum() * BOX / X - frame)
    assert measures.energy(scene.lattice, scene.state) == pytest.approx(energy, rel=1e-11)
    # the transpose that makes it a lattice like any other
    u, f = scene.state.u, jnp.asarray(np.random.default_rng(0).normal(size=X))
    transpose = jax.linear_transpose(lambda u: strain_map.rate(u, u), u)
    np.testing.assert_allclose(strain_map.pull(u, f), transpose(f)[0], atol=1e-12)


@pytest.mark.slow
def test_small_waves_run_as_the_linear_branch_says():
    n, mean = 64, 1.0
    k = 2 * np.pi * 3 / 20
    y = mean + 1e-6 * np.cos(k * np.arange(n) * 20 / n)
    law = gx.Toda(0.8, 1.1)
    K2 = 0.8 * 1.1 * np.exp(1.1)
    period = 2 * np.pi / np.sqrt(float(long_wave.omega_squared(k, "regularised", K2=K2, mass=MASS)))
    scene = gx.travelling.long_wave(law, y, spacing=20 / n, mass=MASS)
    final = gx.simulate(
        scene.lattice, scene.state, period, step=period / 100, solver=gx.SRKN11b()
    ).final
    np.testing.assert_allclose(measures.strain(scene.lattice, final), y, atol=1e-10)


def box(*fields, law=gx.Hertz(), **named):
    return gx.travelling.long_wave(law, *fields, spacing=0.1, **named)


@pytest.mark.parametrize(
    "call, said",
    [
        (lambda: box(np.ones(8), np.ones(8)), "rate: expected one of mean zero"),
        (lambda: box(np.ones(8), np.ones(8), speed=1.0), "rate, speed: expected"),
        (lambda: box(np.ones(8), law=gx.Hertz(np.ones(8))), "law: expected one of single"),
    ],
)
def test_what_makes_no_field_is_refused(call, said):
    with refused(said):
        call()
