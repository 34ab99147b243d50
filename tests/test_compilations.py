"""Nothing is compiled twice: not by an identical call, nor with other numbers of the same shapes.

Thirteen functions of the face are called with a scene, with an equal one that is built anew, and with one of other
parameters. A new program is one that JAX says it compiles, be it a single operation of a new shape. What is compiled
does not depend on what other tests have left behind.
"""

from contextlib import contextmanager

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from cases import heard as _heard
from test_exports import MAKERS, blank, kinds, known_alone, made

import granjax as gx


@contextmanager
def compiled():
    """A list of the programs that are compiled inside."""
    found = []
    begin = len(_heard)
    try:
        yield found
    finally:
        found += _heard[begin:]


def test_programs_are_counted():
    with compiled() as first:
        jax.jit(lambda x: jnp.cos(x) + 3)(jnp.ones(5)).block_until_ready()
    with compiled() as again:
        jnp.ones(5).block_until_ready()
    assert len(first) >= 1 and not again


def factor(seed):
    return 1 + 0.05 * seed


def chain(seed):
    mass = factor(seed) * np.linspace(0.8, 1.2, 6)
    return gx.Lattice(mass, gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(1.3, 0.7 * factor(seed))))


def moving(seed):
    rng = np.random.default_rng(seed)
    return gx.State(*0.1 * rng.uniform(-1, 1, (2, 6)))


def velocities(t, y, lattice):
    return y.v


def with_a_step(seed):
    record = {"peak": gx.Peak(velocities)}
    for step in (0.1, 0.037 * factor(seed)):
        run = gx.simulate(
            chain(seed), moving(seed), 2.0 + seed, step=step, save_at=7, record=record
        )
        assert run.completed and repr(run)


def with_the_default_step(seed):
    return repr(gx.simulate(chain(seed), moving(seed), 4.3))


def with_a_tolerance(seed):
    return gx.simulate(chain(seed), moving(seed), 4.3, tolerance=1e-8)


def normal_modes(seed):
    found = gx.linear.normal_modes(chain(seed))
    return repr(found), gx.measures.contact_force(chain(seed), moving(seed))


def breather(seed):
    mass = jnp.where(jnp.arange(9) % 2 == 0, 1.0, 2.9 * factor(seed))
    lattice = gx.Lattice(mass, gx.Bond(gx.Shift(1, "free"), gx.Hertz(1.0, 1.0)))
    # of the optical band, which begins at K2/m
    edge = 3**0.5
    found = gx.breathers.breather(lattice, 0.99 * edge, check=False)
    return found.floquet(), repr(found)


def floquet(seed):
    return gx.floquet.floquet(chain(seed), gx.states.rest(chain(seed)), 5.0 * factor(seed))


def solitary_wave(seed):
    wave = gx.travelling.solitary_wave(gx.Hertz(1.0 + 0.1 * seed), speed=1.3 + 0.01 * seed)
    return wave.strain(0.3 + seed), wave.state(9, 4.0 + seed), repr(wave)


class Damped(eqx.Module):
    """A chain as a function of its parameters: equal structures compile once."""

    mass: jax.Array

    def __call__(self, p):
        bond = gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(p["stiffness"], 0.7))
        return gx.Lattice(self.mass, (bond, gx.Damping(p["damping"])))


def fit(seed):
    scene = Damped(chain(seed).mass)
    truth = {"stiffness": 1.1, "damping": 0.06}
    times = np.linspace(0.2, 6.0, 40)
    y0 = gx.states.impact(scene(truth), 0.3, 1)
    run = gx.simulate(scene(truth), y0, 6.0, save_at=times, step=0.02)
    traces = gx.Traces(times, velocity=np.asarray(run.vs)[:, [2, 4]], sites=[2, 4], sigma=1e-3)
    return repr(gx.fit(scene, {"stiffness": 1.3, "damping": 0.03}, traces, state=y0))


class Shaken(eqx.Module):
    """A chain between shaken walls over the frequency."""

    lattice: gx.Lattice

    def __call__(self, omega):
        return gx.driven.driven_chain(self.lattice, 0.05, omega, damping=0.25)


def over_period(omega):
    return 2 * jnp.pi / omega


def forced_orbit(seed):
    orbit = gx.forced.forced_orbit(Shaken(chain(seed))(0.8), over_period(0.8), steps=32)
    return orbit.floquet(), orbit.amplitude, repr(orbit)


def attractors(seed):
    gx.driven.response(Shaken(chain(seed)), [0.8, 0.82], over_period, periods=400)


def site_energies(seed):
    return gx.measures.site_energy(chain(seed), moving(seed), 0.1 * seed)


def forces_in_the_plane(seed):
    crystal = gx.scenes.square(3, precompression=factor(seed), exponent=1.5)
    state = gx.State(*np.random.default_rng(seed).uniform(-0.1, 0.1, (2, 3, 3, 2)))
    forces = [gx.measures.contact_force(crystal, state, bond=i) for i in range(2)]
    return forces, gx.measures.energy(crystal, state)


def wall_force(ratio, site):
    lattice = gx.scenes.dimer(5, ratio=ratio)
    run = gx.simulate(
        lattice,
        gx.states.impact(lattice),
        4.0,
        record={"force": gx.Peak(gx.measures.contact_force)},
        confirm=True,
    )
    return {"force": run.recorded["force"][site], "error": run.error.records["force"][site]}


def sweep(seed):
    gx.sweep(
        wall_force, {"ratio": [0.3, 0.5 + 0.1 * seed, 0.9], "site": [2, 4 - seed]}, progress=False
    )


FAST = with_a_step, normal_modes, floquet, site_energies, forces_in_the_plane
SLOW = (
    with_the_default_step,
    with_a_tolerance,
    breather,
    fit,
    forced_orbit,
    solitary_wave,
    attractors,
    sweep,
)
CALLS = [*FAST, *(pytest.param(call, marks=pytest.mark.slow) for call in SLOW)]
# programs of a first call, at most, that of a scene included
MOST = {
    with_a_step: 8,
    with_the_default_step: 6,
    with_a_tolerance: 8,
    fit: 15,
    forces_in_the_plane: 10,
}
# where a contact comes near opening, two more runs look between the steps; a wave's own numbers say how finely it is
# resolved
OTHERWISE = {with_a_tolerance, solitary_wave}


@pytest.mark.parametrize("call", CALLS)
def test_a_first_call_compiles_little_and_nothing_is_compiled_twice(call):
    jax.clear_caches()
    with compiled() as first:
        call(0)
    assert len(first) <= MOST.get(call, np.inf), first
    with compiled() as again:
        call(0)
    assert not again, f"an identical call compiles {again}"
    if call not in OTHERWISE:
        with compiled() as other:
            call(1)
        assert not other, f"other numbers compile {other}"


def read(result):
    """Print a result, export it, and export it in other units."""
    said = () if result.units else ("SI",)
    units = (gx.Units(2.0, 3.0, 5.0),) if result.units == "scaled" else ()
    return result.outcome, repr(result), result.to_xarray(), result.in_units(*said, *units)


@pytest.mark.parametrize("kind", kinds(), ids=lambda kind: kind.__name__)
def test_reading_any_kind_of_result_compiles_nothing(kind):
    if known_alone(kind) or "__repr__" in vars(kind):
        pytest.skip("what is read of it is no list of its fields")
    known = lambda x: isinstance(x, np.ndarray) and x.dtype.kind in "fci"
    result = jax.tree.map(lambda x: jnp.asarray(x) if known(x) else x, blank(kind))
    with compiled() as found:
        read(result)
    assert not found


DRAWN = {
    "Run": (gx.plots.space_time, gx.plots.traces),
    "Fit": (gx.plots.fit, gx.plots.corner),
    "WorkPrecision": (gx.plots.work_precision,),
    "Floquet": (gx.plots.floquet_circle,),
    "Dispersion": (gx.plots.dispersion,),
    "ZoneMap": (gx.plots.zone,),
    "DensityOfStates": (gx.plots.density_of_states,),
    "ComplexBands": (gx.plots.complex_bands,),
    "PathBands": (gx.plots.bands,),
    "FloquetBands": (gx.plots.floquet_bands,),
}
MORE = {
    "PathBands": lambda: gx.linear.path(gx.scenes.square(5, boundary="periodic"), "GXMG", 20),
    "FloquetBands": lambda: gx.linear.floquet_bands(
        gx.scenes.monomer(6, precompression=1.0, boundary="periodic"), np.linspace(0.1, 3, 5), 2.0
    ),
    "Bands": lambda: gx.linear.bands(gx.scenes.dimer(6, ratio=0.5, precompression=1.0)),
    "Equilibrium": lambda: gx.equilibrium(gx.scenes.monomer(6, precompression=1.0)),
    "Evolution": lambda: gx.first_order.evolve(
        gx.first_order.DNLS(8, coupling=1.0, nonlinearity=0.3), np.eye(8)[4], 0.5, save_at=3
    ),
    "Confirmed": lambda: gx.simulate(chain(0), moving(0), 2.0, step=0.1, save_at=7, confirm=True),
}
SLOWLY = {"Run", "Fit", "Floquet", "FloquetBands", "PathBands", "Evolution", "Confirmed", "Orbit"}


@pytest.mark.parametrize(
    "name",
    [pytest.param(x, marks=[pytest.mark.slow] * (x in SLOWLY)) for x in sorted(MAKERS | MORE)],
)
def test_reading_and_drawing_a_result_compiles_nothing(name):
    result = MORE[name]() if name in MORE else made(name)
    jax.clear_caches()
    with compiled() as found:
        read(result)
        for draw in DRAWN.get(name, ()):
            draw(result)
    plt.close("all")
    assert not found
