"""Units by their names, what a lattice and its results are counted in, and the same in every picture."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

import granjax as gx
from granjax.base.units.names import known_unit, readable

plots = gx.plots


# ---------------------------------------------------------------------------------------------------------------- names


def test_a_unit_is_read_by_its_name():
    """Its size in SI, and its dimension, that of a product of the base units."""
    for place, base in enumerate(("N", "m", "s", "rad", "V")):
        assert known_unit(base) == (base, 1.0, tuple(i == place for i in range(5)))
    assert known_unit("N/m^{3/2}")[1:] == (1.0, (1, -1.5, 0, 0, 0))
    for word, size, product in (
        ("µs", 1e-6, "s"),
        ("mm/s", 1e-3, "m s^-1"),
        ("kg", 1.0, "N s^2/m"),
        ("kHz", 2e3 * np.pi, "rad/s"),
        ("1/ms", 1e3, "s^-1"),
        ("mV", 1e-3, "V"),
        ("GPa", 1e9, "N/m^2"),
        ("rad²/s^2", 1.0, "rad^2 s^-2"),
    ):
        unit = known_unit(word)
        assert unit.size == pytest.approx(size, rel=1e-15), word
        assert unit.dimension == known_unit(product).dimension, word
    for word in ("", "sec", "/s", "m^x", "site", "m^{1/0}", "a.u.", "km^9999"):
        assert known_unit(word) is None, word


def test_the_prefix_makes_numbers_from_1_to_1000():
    for largest, name in ((3e-5, "us"), (1e-6, "us"), (999e-6, "us"), (1.0, "s"), (2e4, "s")):
        assert readable(known_unit("s"), largest).name == name
    for largest, name in ((1e-15, "ns"), (0.0, "s"), (np.nan, "s")):
        assert readable(known_unit("s"), largest).name == name


# ------------------------------------------------------------------------------------------------ lattices and results


def steel(F0=10.0, **options):
    return gx.scenes.beads("steel 316", 9.53e-3, F0, cells=8, **options)


def test_a_lattice_knows_what_it_is_counted_in():
    chain = steel()
    si = (
        chain,
        gx.driven.driven_chain(chain, 1e-7, 3e4, damping=10.0),
        gx.Lattice(1.0, chain.terms, sites=8, units="SI"),
        jax.vmap(steel, out_axes=-1)(jnp.ones(3)),
        chain.astype(np.float32),
        jax.jit(lambda F0: steel().counted_in("SI"))(1.0),
    )
    assert {x.units for x in si} == {"SI"}
    without = chain.counted_in("scaled")
    scaled = gx.scenes.scaled(chain).lattice, gx.scenes.monomer(5), without
    assert {x.units for x in scaled} == {"scaled"}
    with refused("units: expected one of"):
        gx.Lattice(1.0, chain.terms, sites=8, units="cgs")
    # one program serves both
    assert jax.tree.structure(chain) == jax.tree.structure(without)


def test_baths_and_sites_keep_their_kind_in_other_units():
    units = gx.Units(mass=2.0, length=0.01, time=1e-3)
    bath = gx.Langevin(0.5, temperature=2.0, seed=jnp.arange(3)).in_units(units)
    assert_allclose(bath.temperature, 2.0 / units.energy, rtol=1e-14)
    assert_allclose(bath.rate, 0.5 * units.time, rtol=1e-14)
    assert bath.seed.dtype == int and bath.seed.tolist() == [0, 1, 2]
    on_site = gx.OnSite(gx.Linear(3.0)).in_units(units)
    assert type(on_site) is gx.OnSite
    assert_allclose(on_site.law.stiffness, 3.0 * units.length / units.force, rtol=1e-14)


@pytest.fixture(scope="module")
def runs():
    """The same run in SI and in scaled numbers, and the units between them."""
    chain = steel(boundary="free")
    scaled, units = gx.scenes.scaled(chain)
    ts = jnp.linspace(0.0, 1e-4, 12)

    def run(chain, velocity, time):
        state = gx.states.impact(chain, velocity=0.05 / velocity)
        how = dict(solver=gx.VelocityVerlet(), save_at=ts / time, step=2e-6 / time)
        return gx.simulate(chain, state, ts[-1] / time, **how)

    return run(chain, 1.0, 1.0), run(scaled, units.velocity, units.time), units


@pytest.mark.slow
def test_a_run_counted_in_other_units(runs):
    si, scaled, units = runs
    assert (si.units, scaled.units) == ("SI", "scaled")
    data = si.in_units("us", "mm/s")
    assert_allclose(data.time, 1e6 * si.ts, rtol=1e-15)
    assert_allclose(data.v, 1e3 * si.vs, rtol=1e-15)
    assert_array_equal(data.u, si.us)
    assert [data[name].attrs["units"] for name in ("time", "v", "u")] == ["us", "mm/s", "m"]
    size = float(np.abs(data.v).max())
    assert_allclose(scaled.in_units(units, "us", "mm/s").v, data.v, atol=1e-9 * size)
    assert_allclose(scaled.in_units(units).time, si.ts, rtol=1e-12)
    back = si.in_units(units)
    assert_allclose(back.v, scaled.vs, atol=1e-9 * float(np.abs(scaled.vs).max()))
    assert back.attrs["units"] == back.v.attrs["units"] == "scaled"
    assert back.v.attrs["si_units"] == "m/s"


@pytest.mark.slow
def test_a_state_is_read_in_the_units_in_which_it_was_written(runs):
    chain = steel(boundary="free")
    for words in (("mm",), ("um", "mm/s"), ("us",)):
        data = runs[0].in_units(*words)
        state = gx.states.stored(chain, data)
        assert_allclose(state.u, runs[0].us[-1], rtol=1e-14)
        assert_allclose(state.v, runs[0].vs[-1], rtol=1e-14)
    for word in ("mm", "furlong/s", "scaled"):
        with refused(f"data.v: expected numbers in m/s, .* got numbers in '{word}'"):
            gx.states.stored(chain, data.assign(v=data.v.assign_attrs(units=word)))
    scaled = gx.scenes.scaled(chain)[0]
    assert_array_equal(gx.states.stored(scaled, runs[1].to_xarray()).u, runs[1].us[-1])


def test_units_of_what_nobody_has_said_are_refused_or_said():
    spectrum = gx.measures.spectrum(np.eye(8), 0.1)
    to_ms = gx.Units(time=1e-3)
    assert spectrum.units is None and "units" not in spectrum.to_xarray().omega.attrs
    for asked in (("kHz",), (to_ms,), (to_ms, "kHz")):
        with refused(r"units: expected units of a result that says .*units=run.units"):
            spectrum.in_units(*asked)
    for asked, size, word in (
        (("SI", "kHz"), 5e-4 / np.pi, "kHz"),
        (("scaled", to_ms), 1e3, "rad/s"),
    ):
        data = spectrum.in_units(*asked)
        assert_allclose(data.omega, size * np.asarray(spectrum.omega), rtol=1e-15)
        assert (data.attrs["units"], data.omega.attrs["units"]) == ("SI", word)


@pytest.mark.slow
def test_what_a_transformation_returns_knows_it_too():
    chain = steel()
    start = lambda v: gx.states.impact(chain, velocity=v)
    run = lambda v: gx.simulate(chain, start(v), 1e-5, solver=gx.VelocityVerlet(), step=2e-6)
    assert jax.jit(jax.vmap(run))(jnp.ones(2)).units == "SI"


def test_units_that_a_run_has_not_are_refused(runs):
    for units, message in (
        (("kHz",), "units of m, m/s, s, got 'kHz'"),
        (("usec",), "name of a unit, got 'usec'. Did you mean 'us"),
        (("s", "ms"), "one word for each dimension"),
        (("scaled",), "units of numbers in SI"),
        ((gx.Units(), "us"), "words, or a Units"),
    ):
        with refused(f"units.*: expected .*({message})"):
            runs[0].in_units(*units)
    with refused(r"scaled numbers, got .*Give the Units .*gx.Units\(\).*counted_in\('SI'\)"):
        runs[1].in_units("us")


@pytest.mark.slow
def test_files_and_prints_say_what_numbers_are_counted_in(tmp_path):
    modes = gx.linear.normal_modes
    waves = lambda x: gx.linear.dispersion(x, np.ones(5))
    for k, of in enumerate((modes, waves)):
        si = of(steel())
        scaled = of(gx.scenes.dimer(8, precompression=1.0))
        files = [x.save(tmp_path / f"{k}{x.units}.nc") for x in (si, scaled)]
        data, other = map(xr.load_dataset, files)
        assert (data.units, data.omega.attrs["units"]) == ("SI", "rad/s")
        assert other.units == other.omega.attrs["units"] == "scaled"
        assert other.omega.attrs["si_units"] == "rad/s"
        assert_allclose(si.in_units("kHz").omega, np.asarray(si.omega) / 2e3 / np.pi, rtol=1e-15)
        assert "rad/s" in si.outcome and "rad/s" not in scaled.outcome
    for units in (None, "scaled", "SI"):
        spectrum = gx.measures.spectrum(np.eye(8), 0.1, units=units)
        assert spectrum.units == units and ("rad/s" in spectrum.outcome) == (units == "SI")
    assert " s\n" not in repr(gx.Traces([0.0, 1.0], velocity=[0.0, 1.0], sites=0))
    root = gx.newton.newton(lambda x, _: x**2 - 2, jnp.ones(1))
    assert root.units is None and "units" not in root.to_xarray().attrs


@pytest.mark.slow
def test_an_orbit_and_its_bifurcation_are_counted_as_their_lattice():
    family = gx.breathers.family(gx.scenes.fput(4, beta=1.0), points=3, stability=False)
    orbit = family.orbit(1)
    assert {x.units for x in (family, orbit, orbit.error)} == {"scaled"}
    assert orbit.error.to_xarray().attrs["period_units"] == "scaled"
    assert family.to_xarray().attrs["t0_units"] == "scaled"
    event = gx.orbits.Bifurcation("fold", 1.0, 0, orbit.state, **orbit.lattice.origin).to_xarray()
    assert (event.state_u.attrs["si_units"], event.state_v.attrs["si_units"]) == ("m", "m/s")


@pytest.mark.slow
def test_what_has_no_unit_says_that_it_stays(runs):
    units = runs[2]
    chain = gx.scenes.scaled(steel(boundary="free"))[0]
    parts = lambda t, y, lattice: (y.u, y.v[:2])
    record = {"both": gx.Peak(lambda t, y, lattice: y.v), "pair": gx.Peak(parts)}
    state = gx.states.impact(chain, velocity=1e-3)
    data = gx.simulate(chain, state, 1.0, step=0.1, record=record).in_units(units, "us")
    assert data.attrs["units"] == "SI" and data.both.attrs["units"] == "scaled"
    assert data.attrs["stats_step"] == pytest.approx(0.1e6 * float(units.time))
    assert data.attrs["stats_step_units"] == "us"


# ------------------------------------------------------------------------------------------------------------- pictures


def labels(ax):
    bars = [image.colorbar.ax.get_ylabel() for image in ax.images if image.colorbar]
    return [ax.get_xlabel(), ax.get_ylabel(), *bars]


def test_a_map_in_si(runs):
    si, scaled, units = runs
    assert labels(plots.space_time(si)) == ["site", "time (µs)", "velocity (mm/s)"]
    assert labels(plots.traces(si, offset=0))[:2] == ["time (µs)", "velocity (mm/s)"]
    assert labels(plots.space_time(scaled)) == ["site", "time (scaled)", "velocity (scaled)"]
    asked = plots.space_time(si.in_units("ms", "um/s"))
    assert labels(asked) == ["site", "time (ms)", "velocity (µm/s)"]
    assert_allclose(asked.images[0].get_array(), 1e6 * si.vs, rtol=1e-12)


def states_times_width(omega, density):
    return float(np.sum(np.asarray(density)) * np.diff(np.asarray(omega))[0])


@pytest.mark.parametrize(
    ("word", "per"), [("Hz", "1/Hz"), ("kHz", "1/kHz"), ("krad/s", "s/krad"), ("rad/s", "s/rad")]
)
def test_a_density_of_states_counts_the_bands_in_any_unit(word, per):
    si = gx.linear.density_of_states(steel(), bins=20)
    data = si.in_units(word)
    assert (data.omega.units, data.density.units, data.error.units) == (word, per, per)
    for found in (si, data):
        assert states_times_width(found.omega, found.density) == pytest.approx(1)
        ax = plots.density_of_states(found)
        assert states_times_width(*ax.lines[0].get_data()) == pytest.approx(1)
        if "k" in word:
            unit = ("krad/s", "s/krad") if found is data and word == "krad/s" else ("kHz", "1/kHz")
            assert [text.partition("(")[2][:-1] for text in labels(ax)] == [*unit]


def test_a_scaled_density_of_states_stays_until_it_is_converted():
    scaled = gx.linear.density_of_states(gx.scenes.dimer(8, precompression=1.0), bins=20)
    assert_array_equal(scaled.to_xarray().density, scaled.density)
    ax = plots.density_of_states(scaled)
    assert_array_equal(ax.lines[0].get_ydata(), scaled.density)
    assert labels(ax)[1] == "density of states (scaled)"
    units = gx.Units(2.0, 3.0, 5.0)
    assert_allclose(scaled.in_units(units).density, 5 * scaled.density)
    data = scaled.in_units(units, "Hz")
    bands = states_times_width(scaled.omega, scaled.density)
    assert states_times_width(data.omega, data.density) == pytest.approx(bands)


def test_frequency_in_cycles():
    waves = gx.linear.dispersion(steel(), np.linspace(0, np.pi, 9))
    ax = plots.dispersion(waves)
    assert ax.get_ylabel() == "frequency (kHz)"
    cycles = np.asarray(waves.omega)[:, 0] / (2e3 * np.pi)
    assert_allclose(ax.lines[0].get_ydata(), cycles, rtol=1e-12)


def test_sites_and_frames_have_whole_ticks():
    ax = plots.space_time(np.ones((4, 5)))
    ticks = np.concatenate([ax.get_xticks(), ax.get_yticks()])
    assert_array_equal(ticks, np.round(ticks))


def test_contacts_of_a_user_are_the_same_in_other_units():
    """Forces, preloads and overlaps of a bond that the library does not know, by those that it does."""

    class Foreign(gx.Bond):
        linear_in = None

    units = gx.Units(mass=0.7, length=2.0, time=3.0)
    state = gx.State(0.1 * jnp.sin(jnp.arange(6.0)), jnp.zeros(6))
    there = units.state_from_si(state)
    change = lambda t: 1 + 0.3 * jnp.sin(2 * t)
    plain, foreign = (
        gx.Lattice(
            1.0, gx.Modulated(kind(gx.Shift(1, "free"), gx.Hertz(0.3, 0.1)), change), sites=6
        )
        for kind in (gx.Bond, Foreign)
    )
    foreign = foreign.counted_in("SI")
    scaled, _ = gx.scenes.scaled(foreign, units=units)
    t = 0.4
    want = gx.measures.contact_force(plain, state, t)
    load = plain.terms[0].at(t).preload_force(state.u)
    for lattice, size, when, y in ((foreign, 1, t, state), (scaled, units.force, t / 3, there)):
        assert_allclose(gx.measures.contact_force(lattice, y, when) * size, want, atol=1e-16)
        assert_allclose(lattice.terms[0].at(when).preload_force(y.u) * size, load, atol=1e-16)
    assert_allclose(
        2 * gx.measures.strain(scaled, there), gx.measures.strain(plain, state), atol=1e-16
    )
