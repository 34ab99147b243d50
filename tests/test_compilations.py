"""Nothing is compiled twice: not by an identical call, nor with other numbers of the same shapes.

Every row of the table of tests/test_covariance.py is called with a scene, with an equal one that is built anew, and
with ones of other parameters; so are functions that take no lattice. A new program is one that JAX says it compiles,
be it a single operation of a new shape. What is compiled does not depend on what other tests have left behind.
"""

from collections.abc import Callable
from contextlib import contextmanager
from types import CodeType
from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_covariance import LONGER, PLAIN, TABLE, Scene, Shaken, closed, hertz, masses, over_period, velocities
from test_vocabulary import ALL

import granjax as gx

_heard = []


def _hear(event, seconds, **named):
    if event == "/jax/core/compile/backend_compile_duration":
        _heard.append(named.get("fun_name", "a program"))


jax.monitoring.register_event_duration_secs_listener(_hear)


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


# ---------------------------------------------------------------------------------------------------------------- rows


class Call(NamedTuple):
    """A public function called with numbers of a seed, which arrays of the same shapes hold."""

    name: str
    call: Callable
    marks: tuple = ()
    # whether other numbers are of the same shapes
    others: bool = True


SLOW, STUDY = pytest.mark.slow, pytest.mark.study


# rows whose other numbers are another computation, and why
ANOTHER = {
    "sweep": "its time steps follow from its frequencies, and a response reads them all: below with equal ones",
    "simulate_tolerance": "where a contact comes near opening, two more runs look between the steps",
}


# of the table, the rows that every run of the tests looks at
ALWAYS = {"normal_modes", "contact_force", "regression", "floquet", "plots"}


def of_row(r):
    """A row of the table, on its first scene."""
    marks = (STUDY,) if r.name in LONGER else () if r.name in ALWAYS else (SLOW,)
    return Call(r.name, lambda seed: r.call(Scene((*r.scenes, *r.slow)[0], seed)), marks, r.name not in ANOTHER)


CALLS = [of_row(r) for r in TABLE]


def also(name, *marks):
    def add(call):
        CALLS.append(Call(name, call, marks))
        return call

    return add


def rng_of(seed):
    return np.random.default_rng(seed)


def chain(seed, sites=6):
    rng = rng_of(seed)
    return gx.Lattice(masses(rng, PLAIN, sites), gx.Bond(gx.Shift(1, "fixed"), hertz(rng, PLAIN)))


def moving(seed):
    return Scene(closed, seed).state


@also("Flow", SLOW)
def _(seed):
    flow, end = gx.Flow(16), 1.0 + 0.1 * seed
    flow(moving(seed), 0.0, end, chain(seed))
    flow.derivative(moving(seed), 0.0, end, chain(seed))


def oscillator(t, y, args):
    return -args * y


@also("Flow of a field", SLOW)
def _(seed):
    flow = gx.Flow(8, diffrax.Dopri8(), oscillator)
    flow(jnp.ones(3) * (seed + 1), 0.0, 1.0 + seed, 0.5 + seed)
    flow(1.0 + seed, 0, 1 + seed, 2 + seed)


def phi4(coupling):
    return gx.scenes.klein_gordon(5, coupling)


@also("anticontinuous", STUDY)
def _(seed):
    gx.breathers.anticontinuous(phi4, 0.02 + 0.001 * seed, 1.5 + 0.05 * seed, points=4)


@also("simulate at every step", SLOW)
def _(seed):
    run = gx.simulate(chain(seed), moving(seed), 3.9 + 0.01 * seed, step=0.05 - 0.001 * seed, save_at="steps")
    assert len(run.ts) == 79 + 2 * seed


@also("simulate at a step")
def _(seed):
    for step in (0.1, 0.037 + 0.001 * seed):
        assert gx.simulate(chain(seed), moving(seed), 2.0 + seed, step=step).completed


@also("record_error", SLOW)
def _(seed):
    run = gx.simulate(chain(seed), moving(seed), 2.0, step=0.05, record={"peak": gx.Peak(velocities)})
    return run.record_error


@also("opening", SLOW)
def _(seed):
    u, v = moving(seed)
    run = gx.simulate(chain(seed), (2 * u, 2 * v), 2.0, step=0.05)
    return run.opening, repr(run)


def final(x, step):
    lattice = gx.Lattice(x["mass"], gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(1.0, 0.7)))
    return gx.simulate(lattice, (0 * x["v"], x["v"]), 1.0, step=step, throw=False).final.u


@also("return_error", SLOW)
def _(seed):
    gx.flow.return_error(chain(seed), moving(seed), 0.0, 1.0 + 0.1 * seed, 40 + seed, gx.SRKN6b())


@also("adaptive lanes", SLOW)
def _(seed):
    chains = jax.vmap(chain_of, out_axes=-1)(jnp.linspace(0.5, 0.8 + 0.01 * seed, 3))
    u, v = (jnp.stack([x] * 3, -1) for x in moving(seed))
    gx.simulate(chains, (u, v), 1.0 + 0.01 * seed, tolerance=1e-6)


def chain_of(load):
    return gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(1.0, load)), sites=6)


@also("points and bifurcations of a family", SLOW)
def _(seed):
    site = gx.Polynomial(1.0 + 0.02 * seed, 0.0, 1.0)
    lattice = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "periodic"), gx.Linear(0.03)), gx.OnSite(site)), sites=6)
    branch = gx.breathers.family(lattice, until=1.1 * np.sqrt(1 + 0.02 * seed), mode=0)
    return branch.orbit(-1).floquet(), gx.breathers.bifurcations(branch)


@also("kinks", SLOW)
def _(seed):
    lattice = gx.scenes.sine_gordon(30, 0.5 + 0.02 * seed)
    return gx.kinks.peierls_nabarro(lattice, 2 * np.pi), gx.kinks.moving(lattice, 0.1 + 0.01 * seed, 2 * np.pi)


@also("derivative", SLOW)
def _(seed):
    gx.derivative(final, {"mass": masses(rng_of(seed), PLAIN), "v": moving(seed).v}, 0.05 + 0.01 * seed)


@also("taylor", SLOW)
def _(seed):
    gx.laws.taylor(hertz(rng_of(seed), PLAIN))


@also("Spline.fitted", SLOW)
def _(seed):
    rng = rng_of(seed)
    e = np.sort(rng.uniform(-1, 1, 20))
    gx.laws.Spline.fitted([-1.0, -0.3 - 0.01 * seed, 0.2, 1.0], e, np.sinh(e) * (1 + seed))


@also("newton")
def _(seed):
    gx.newton.newton(cubic, np.array([1.0, 2.0]), {"a": 1.0 + 0.1 * seed})


def cubic(x, args):
    return x**3 + args["a"] * x - jnp.array([1.0, 2.0])


def circle(x, p, args):
    return x**2 + p**2 - args


@also("continuation", SLOW)
def _(seed):
    gx.continuation.continuation(circle, [1.0 + 0.1 * seed], 0.0, args=(1.0 + 0.1 * seed) ** 2, points=6)


@also("multipliers", SLOW)
def _(seed):
    gx.floquet.multipliers(gx.Flow(16), moving(seed), 0.0, 1.0 + 0.1 * seed, chain(seed))


@also("what an orbit tells", STUDY)
def _(seed):
    lattice = gx.driven.driven_chain(chain(seed), 0.05, 0.8, damping=0.25)
    orbit = gx.forced.forced_orbit(lattice, 2 * np.pi / 0.8, steps=32)
    return orbit.run(16), orbit.harmonics(2), orbit.amplitude, orbit.rms_velocity, orbit.energy_input, repr(orbit)


def wall_force(ratio, site):
    chain = gx.scenes.dimer(5, ratio=ratio)
    run = gx.simulate(chain, gx.states.impact(chain), 4.0, record={"force": gx.Peak(gx.measures.contact_force)})
    return {"force": run.recorded["force"][site], "error": run.record_error["force"][site]}


@also("sweep of a function", STUDY)
def _(seed):
    gx.sweep(wall_force, {"ratio": [0.3, 0.5 + 0.1 * seed, 0.9], "site": [2, 4 - seed]}, progress=False)


@also("sweep of amplitudes", SLOW)
def _(seed):
    make = Shaken(chain(0), jnp.asarray(0.05 + 0.01 * seed), jnp.asarray(0.25 + 0.01 * seed))
    gx.driven.sweep(make, [0.8, 0.82], over_period, periods=400)


@also("sweep by a function of one's own", SLOW)
def _(seed):
    gx.driven.sweep(own_make, [0.8 + 0.01 * seed, 0.9], own_period, periods=400)


OWN = chain(0)


def own_make(omega):
    return gx.driven.driven_chain(OWN, 0.05, omega, damping=0.25)


own_period = lambda omega: 2 * jnp.pi / omega


@also("spectra", SLOW)
def _(seed):
    rng = rng_of(seed)
    gx.measures.spectrum(rng.normal(size=(32, 6)), 0.1 + 0.01 * seed)
    gx.measures.participation(rng.uniform(size=6))
    gx.measures.arrival_times(np.arange(32.0), rng.normal(size=(32, 6)), 0.3 + 0.1 * seed)
    gx.measures.peak_times(np.arange(32.0), rng.normal(size=(32, 6)))


@also("smooth_peak", SLOW)
def _(seed):
    gx.smooth_peak(rng_of(seed).uniform(size=(4, 5)), power=20 + seed)


@also("envelopes", SLOW)
def _(seed):
    f = 1 + 0.1 * seed
    found = gx.theory.nls.coefficients(1.0, 1.5 * f, 0.375 * f, -0.0625 * f, np.pi, 0)
    gx.theory.nls.dark_profile(found, 0.99 * float(found.omega), 12)


@also("elliptic", SLOW)
def _(seed):
    el, x = gx.theory.elliptic, 0.3 + 0.1 * seed
    el.jacobi(x, 0.5 + x), el.zeta(x, m1=x), el.K(x), el.E(m1=x), el.Pi(-x, x), el.F(x, x)
    el.incomplete_E(x, x), el.incomplete_Pi(x, x, x)


@also("solitary_wave", STUDY)
def _(seed):
    for law in (gx.Hertz(1.0 + 0.1 * seed), gx.Toda(1.0 + 0.1 * seed)):
        wave = gx.travelling.solitary_wave(law, speed=1.3 + 0.01 * seed)
        wave.strain(0.3 + seed), wave.velocity(0.2), wave.displacement(0.2), wave.state(9, 4.0 + seed), repr(wave)
    wave.floquet(14, "held")
    gx.states.solitary_wave(gx.scenes.monomer(9, stiffness=1.0 + seed), 4.0 + seed, speed=1.3)


@also("Toda's and KdV's waves, compactons", STUDY)
def _(seed):
    f, n, t = 1 + 0.1 * seed, np.arange(5.0), 0.3 + seed
    toda, kdv, compacton = gx.theory.toda, gx.theory.kdv, gx.theory.compacton
    toda.soliton(n, t, f), toda.two_solitons(n, t, f, 0.5, centre1=0.0, centre2=f), toda.matched(f, 0.4)
    toda.phase_shifts(f, 0.5), toda.wavenumber(speed=1 + f), toda.wavenumber(amplitude=f), toda.wavenumber(energy=f)
    toda.speed(f), toda.amplitude(f), toda.energy(f), toda.lax_eigenvalues(n[:-1] * f, n)
    toda.periodic_wave(n, t, -f, 0.1, 0.4, f), toda.periodic_numbers(-f, 0.1, 0.4, f)
    toda.velocity_shock(0.5 * f), toda.modulation(0.2 * f, 0.5), toda.modulus(f, 0.5), toda.shock_wave(n, t, 0.5 * f)
    kdv.soliton(n, t, f, 0.5, amplitude=0.1 * f), kdv.cnoidal(n, t, 0.0, 0.01, 0.02, f, 0.5), kdv.scales(f, 0.5)
    kdv.velocity_shock(0.1 * f, f, 0.5), kdv.modulation(0.2 * f, 0.1, f, 0.5), kdv.modulus(f, 0.1, f, 0.5)
    kdv.shock_wave(n, t, 0.1 * f, f, 0.5)
    kdv.speed(0.1 * f, f, 0.5), kdv.amplitude(2 * f, f, 0.5)
    compacton.nesterenko(n, 1.5 * f), compacton.ahnert_pikovsky(n, 1.5 * f), compacton.rosenau_hyman(n, 2 * f)


@also("cell_wave", STUDY)
def _(seed):
    travelling, f = gx.travelling, 1 + 0.01 * seed
    stiffness = travelling.tail_free_stiffness(f, 0.1)
    wave = travelling.cell_wave(gx.Hertz(f), [f], speed=f, resonator=gx.Resonator(0.1, 1.1 * stiffness))
    wave.strain(0.3 + seed), wave.velocity(9.0), wave.state(9, 4.0 + seed), repr(wave), wave.resonator.tail_free(f)
    travelling.tail_free(lambda ratio: (gx.Hertz(f), [1.0, ratio]), 0.33, 0.36, speed=1.0).state(9)


@also("collide and reflect", STUDY)
def _(seed):
    law, f = gx.Toda(1.0 + 0.1 * seed), (1.0 + 0.1 * seed) ** 0.5
    one, two = (gx.travelling.solitary_wave(law, speed=c * f) for c in (1.5, -1.4))
    repr(gx.travelling.collide(one, two)), repr(gx.travelling.reflect(one, gx.Toda(jnp.array([0.3, 3.0]) * f)))


@also("measure a shock", STUDY)
def _(seed):
    f = 1 + 0.1 * seed
    chain = gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "free"), gx.Toda(f)),), sites=200)
    repr(gx.shocks.measure(gx.shocks.piston(chain, 0.6 * f**0.5).run(110.0 / f**0.5)))


def bump(x):
    return jnp.exp(-(x**2))


@also("long_wave", STUDY)
def _(seed):
    own, f = gx.theory.long_wave, 1 + 0.1 * seed
    own.omega_squared(f, "strain"), own.regularised_wave(np.arange(3.0), 1.4 + 0.1 * seed, speed=f)
    own.residual(f * np.arange(8.0), np.ones(8), jnp.square, "displacement", spacing=f)
    own.travelling_residual(bump, np.arange(3.0), jnp.square, f, "strain")
    scene = gx.travelling.long_wave(gx.Hertz(f, 1.0), 0.1 * f * np.cos(np.arange(8) * np.pi / 4), spacing=f, speed=f)
    gx.simulate(*scene[:2], 1.0, step=0.05)


@also("shock_edges", SLOW)
def _(seed):
    for law in (gx.Toda(1.0 + 0.1 * seed), gx.Hertz(1.0 + 0.1 * seed, 0.3)):
        repr(gx.theory.shock_edges(law, 0.1 + 0.1 * seed, ahead=0.01 * seed))
        gx.theory.simple_wave.mean(law, 0.1 + 0.1 * seed), gx.theory.simple_wave.fan([0.9, 1.0], law, -0.1)
    own, n = gx.theory.linear_shock, np.arange(-5, 5)
    own.velocity_step(n, 3.0 + seed, 0.1, 1.0 + 0.1 * seed), own.strain_step(n, 3.0 + seed, 0.1 * seed)
    gx.theory.localisation.lyapunov_exponent(0.5 + 0.1 * seed, mass_deviation=0.1, correlations=[0.5])


@also("dissipative_front", STUDY)
def _(seed):
    for law in (gx.Hertz(1.0 + 0.1 * seed), gx.Toda(1.0 + 0.1 * seed)):
        front = gx.shocks.dissipative_front(law, 1.0 + 0.01 * seed, dashpot=0.5 + 0.01 * seed)
        front.strain(0.3 + seed), front.velocity(0.2), front.displacement(0.2), front.state(9, 4.0 + seed), repr(front)


@also("periodic_wave", STUDY)
def _(seed):
    law = gx.Toda(1.0 + 0.1 * seed)
    wave = gx.travelling.periodic_wave(law, 8.0 + seed, amplitude=0.2 + 0.1 * seed)
    wave.state(9), wave.averages()
    gx.theory.stokes.wave([1.0, 2.0 + 0.1 * seed], 0.1, 1.0, 0.5 + 0.1 * seed, 0.1).strain(0.3)
    gx.travelling.family(law, speed=[1.5 + 0.1 * seed])


@also("first_order", STUDY)
def _(seed):
    chi = 3.0 + 0.1 * seed
    equation = gx.first_order.DNLS(8, 1.0, chi, order=0.5 + 0.1 * seed)
    gx.first_order.evolve(equation, np.eye(8)[0], 1.0 + 0.01 * seed, save_at=3)
    gx.first_order.soliton(gx.first_order.DNLS(41, 1.0, chi), -2.0 - 0.1 * seed)
    gx.first_order.electrical(8, inductance=chi).norm(np.ones(8)), gx.first_order.tau_0(1.5 + 0.1 * seed)
    gx.fractional.kernel(0.5 + 0.1 * seed, 9), gx.fractional.ring_kernel(0.5 + 0.1 * seed, 9)
    gx.fractional.to_the_right(0.5 + 0.1 * seed, 9)


@also("self_trapping", STUDY)
def _(seed):
    gx.first_order.self_trapping(dimer, 3.0 + 0.1 * seed, 5.0, 12.0 + seed, tolerance=0.05, frames=20)


def dimer(chi):
    return gx.first_order.DNLS(2, 1.0, chi, boundary="fixed")


@also("caputo", SLOW)
def _(seed):
    f = 1 + 0.1 * seed
    gx.caputo(relaxing, f, 2.0 * f, order=0.5 + 0.1 * seed, args=f, steps=40)
    gx.theory.mittag_leffler(-np.linspace(0.1, 2.0 * f, 5), 0.5 + 0.1 * seed)


def relaxing(t, y, args):
    return -args * y


@also("smooth_gauge")
def _(seed):
    gx.linear.smooth_gauge(np.random.default_rng(seed).normal(size=(8, 2, 2)), 1.0 + seed)


@also("restitution")
def _(seed):
    own, speed = gx.theory.restitution, np.linspace(0.1, 1.0 + seed, 4)
    own.thornton(speed, 0.2 + 0.1 * seed), own.walton_braun(1.0, 2.0 + seed)
    own.viscoelastic(speed, 1.0, 0.01 * (1 + seed))


# public functions that no row calls by name, by their modules, and why
WITHIN = {
    **dict.fromkeys(("checks", "entry.checked", "entry.kinds", "printing", "programs", "variables", "cli.commands",
                     "outside", "tuning", "materials", "scenes.chains",
                     "scenes.long_range", "scenes.resonators", "scenes.softening",
                     "scenes.bead_chain", "scenes.disorder", "scenes.fractional", "scenes.modulated",
                     "scenes.on_site", "scenes.yielding",
                     "scenes.plane.chains", "scenes.plane.lattices", "scenes.plane.networks", "scenes.plane.packing",
                     "scenes.plane.rotating",
                     "work_precision.measuring", "orbits.symmetry", "laws.power"),
                    "numbers, words and Python: no program of their own"),
    **dict.fromkeys(("files",),
                    "files, read and written by NumPy"),
    **dict.fromkeys(("plots.cells", "plots.evolutions", "plots.style", "plots.curves", "plots.fits", "plots.orbits",
                     "plots.films", "plots.plane", "plots.shocks", "plots.travelling"),
                    "drawn by NumPy; `plots`"),
    **dict.fromkeys(("lattice.split", "lattice.tangents", "lattice.blocks", "split_system"), "`simulate`"),
    **dict.fromkeys(("resonance.decay", "resonance.finite", "resonance.maps",
                     "resonance.oscillations"),
                    "studies of minutes, made of what is called here"),
}
UNCALLED = {
    "chern": "`berry_curvature`", "winding": "`zak`", "quadrupole": "`berry_curvature`",
    "checked_order": "`kernel`", "total": "`kernel`", "symbol": "`ring_kernel`", "wave_numbers": "NumPy",
    "field": "`evolve`",
    "paired": "NumPy", "read": "a file", "table": "NumPy",
    "explore": "in tests/test_explore.py, as a notebook does",
    "cell_of": "`bright_guess`", "edge_of": "`breather`", "edges_beside": "`bright_guess`",
    "supports_bright": "`bright_guess`", "checked_optimiser": "`fit`", "descend": "`fit`", "design": "`design_bounds`",
    "prepared": "`fit`", "decide": "`floquet`", "product_multipliers": "`floquet`, NumPy",
    "reversible_multipliers": "NumPy", "hard_threshold": "NumPy", "front_speed": "sums over `arrival_times`",
    "velocity_trace": "a filter of SciPy's", "spectrogram": "`spectrum`, NumPy", "evaluated": "`newton`",
    "nearby": "`newton`", "history": "its own row, compiled by the caller", "B": "`coefficients`",
    "band_edges": "`coefficients`", "bright": "`coefficients`", "dark": "`coefficients`",
    "growth_rate": "`coefficients`", "bright_profile": "`dark_profile`",
    "closed_forms": "`solitary_wave`, formulas", "distance": "`compare`", "stability": "`Wave.floquet`",
    "medium_of": "`solitary_wave`", "wave_of": "`solitary_wave`",
    "planar_ode": "NumPy and SciPy", "power_law_mean": "a formula",
    "linearised": "`fit`; of lattices `linear_frequency`",
}


def names_in(code):
    """The names that a function reads, and what is defined in it."""
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from names_in(inner)


def test_what_is_public_is_called():
    """Every public function, by a row or for a reason."""
    called = {name for each in (*TABLE, *CALLS) for name in names_in(each.call.__code__)}
    own = [s for s in ALL if s.result is not None and "." not in s.name and s.name not in called]
    modules = {s.module.removeprefix("granjax.") for s in own}
    assert WITHIN.keys() <= modules, "a reason that is no more needed"
    assert {s.name for s in own if s.module.removeprefix("granjax.") not in WITHIN} == UNCALLED.keys()


@pytest.mark.parametrize("call", [pytest.param(call, id=call.name, marks=call.marks) for call in CALLS])
def test_nothing_is_compiled_twice(call):
    call.call(0)
    with compiled() as again:
        call.call(0)
    assert not again, f"an identical call compiles {again}"
    if call.others:
        with compiled() as other:
            call.call(1)
        assert not other, f"other numbers compile {other}"
