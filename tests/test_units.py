"""Units by their names, what a lattice and its results are counted in, and the same in every picture."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax.base.units.names import known_unit, readable

plots = gx.plots


# ---------------------------------------------------------------------------------------------------------------- names


@pytest.mark.parametrize(
    "word, size, dimension",
    [
        ("us", 1e-6, (0, 0, 1, 0, 0)),
        ("µs", 1e-6, (0, 0, 1, 0, 0)),
        ("mm/s", 1e-3, (0, 1, -1, 0, 0)),
        ("N/m^{3/2}", 1.0, (1, -1.5, 0, 0, 0)),
        ("kg", 1.0, (1, -1, 2, 0, 0)),
        ("kHz", 2e3 * np.pi, (0, 0, -1, 1, 0)),
        ("rad/s", 1.0, (0, 0, -1, 1, 0)),
        ("1/ms", 1e3, (0, 0, -1, 0, 0)),
        ("m s^-1", 1.0, (0, 1, -1, 0, 0)),
        ("mV", 1e-3, (0, 0, 0, 0, 1)),
        ("GPa", 1e9, (1, -2, 0, 0, 0)),
        ("rad^2/s^2", 1.0, (0, 0, -2, 2, 0)),
    ],
)
def test_a_unit_is_read_by_its_name(word, size, dimension):
    unit = known_unit(word)
    assert (
        unit.size == pytest.approx(size, rel=1e-15)
        and tuple(map(float, unit.dimension)) == dimension
    )


@pytest.mark.parametrize(
    "word",
    [
        "",
        "sec",
        "/s",
        "m^x",
        "site",
        "m^{1/0}",
        "a.u.",
        "km^9999",
    ],
)
def test_what_is_no_unit_is_none(word):
    assert known_unit(word) is None


@pytest.mark.parametrize(
    "largest, name",
    [
        (3e-5, "us"),
        (1.0, "s"),
        (1e-6, "us"),
        (999e-6, "us"),
        (2e4, "s"),
        (1e-15, "ns"),
        (0.0, "s"),
        (np.nan, "s"),
    ],
)
def test_the_prefix_makes_numbers_from_1_to_1000(largest, name):
    assert readable(known_unit("s"), largest).name == name


# ------------------------------------------------------------------------------------------------ lattices and results


def steel(**options):
    return gx.scenes.beads("steel 316", 9.53e-3, 10.0, cells=8, **options)


def test_a_lattice_knows_what_it_is_counted_in():
    chain = steel()
    scaled, units = gx.scenes.scaled(chain)
    own = gx.Lattice(1.0, chain.terms, sites=8, units="SI")
    driven = gx.driven.driven_chain(chain, 1e-7, 3e4, damping=10.0)
    batch = jax.vmap(lambda F0: gx.scenes.beads("steel 316", 9.53e-3, F0, cells=8), out_axes=-1)(
        jnp.ones(3)
    )
    said = [
        x.units
        for x in (
            chain,
            driven,
            own,
            batch,
            chain.astype(np.float32),
            jax.jit(lambda F0: steel().counted_in("SI"))(1.0),
        )
    ]
    assert said == ["SI"] * 6
    assert [x.units for x in (scaled, gx.scenes.monomer(5), chain.counted_in("scaled"))] == [
        "scaled"
    ] * 3
    with refused("units: expected one of"):
        gx.Lattice(1.0, chain.terms, sites=8, units="cgs")
    # one program serves both
    assert jax.tree.structure(chain) == jax.tree.structure(chain.counted_in("scaled"))


@pytest.fixture(scope="module")
def runs():
    """The same run in SI and in scaled numbers, and the units between them."""
    chain = steel(boundary="free")
    scaled, units = gx.scenes.scaled(chain)
    ts = jnp.linspace(0.0, 1e-4, 12)
    si = gx.simulate(chain, gx.states.impact(chain, velocity=0.05), ts[-1], save_at=ts, step=2e-6)
    state = gx.states.impact(scaled, velocity=0.05 / units.velocity)
    ts = ts / units.time
    return si, gx.simulate(scaled, state, ts[-1], save_at=ts, step=2e-6 / units.time), units


def test_a_run_counted_in_other_units(runs):
    si, scaled, units = runs
    assert (si.units, scaled.units) == ("SI", "scaled")
    data = si.in_units("us", "mm/s")
    assert_allclose(data.time, 1e6 * si.ts, rtol=1e-15)
    assert_allclose(data.v, 1e3 * si.vs, rtol=1e-15)
    np.testing.assert_array_equal(data.u, si.us)
    assert [data[name].attrs["units"] for name in ("time", "v", "u")] == ["us", "mm/s", "m"]
    size = float(np.abs(data.v).max())
    assert_allclose(scaled.in_units(units, "us", "mm/s").v, data.v, atol=1e-9 * size)
    assert_allclose(scaled.in_units(units).time, si.ts, rtol=1e-12)
    back = si.in_units(units)
    assert_allclose(back.v, scaled.vs, atol=1e-9 * float(np.abs(scaled.vs).max()))
    assert (
        back.attrs["units"] == back.v.attrs["units"] == "scaled"
        and back.v.attrs["si_units"] == "m/s"
    )


def test_units_of_what_nobody_has_said_are_refused_or_said():
    spectrum = gx.measures.spectrum(np.eye(8), 0.1)
    for asked in (("kHz",), (gx.Units(time=1e-3),), (gx.Units(time=1e-3), "kHz")):
        with refused(r"units: expected units of a result that says .*units=run.units"):
            spectrum.in_units(*asked)
    data = spectrum.in_units("SI", "kHz")
    assert_allclose(data.omega, np.asarray(spectrum.omega) / 2e3 / np.pi, rtol=1e-15)
    assert (data.attrs["units"], data.omega.attrs["units"]) == ("SI", "kHz")
    data = spectrum.in_units("scaled", gx.Units(time=1e-3))
    assert_allclose(data.omega, 1e3 * np.asarray(spectrum.omega), rtol=1e-15)
    assert (data.attrs["units"], data.omega.attrs["units"]) == ("SI", "rad/s")


@pytest.mark.slow
def test_what_a_transformation_returns_knows_it_too():
    chain = steel()
    run = lambda v: gx.simulate(
        chain, gx.states.impact(chain, velocity=v), 1e-5, solver=gx.VelocityVerlet(), step=2e-6
    )
    assert [jax.jit(run)(0.1).units, jax.vmap(run)(jnp.ones(2)).units] == ["SI", "SI"]


@pytest.mark.parametrize(
    "units, message",
    [
        (("kHz",), "units of m, m/s, s, got 'kHz'"),
        (("usec",), "name of a unit, got 'usec'. Did you mean 'us"),
        (("s", "ms"), "one word for each dimension"),
        (("scaled",), "units of numbers in SI"),
        ((gx.Units(), "us"), "words, or a Units"),
    ],
)
def test_units_that_a_run_has_not_are_refused(runs, units, message):
    with refused(f"units.*: expected .*({message})"):
        runs[0].in_units(*units)
    with refused(r"scaled numbers, got .*Give the Units .*gx.Units\(\).*counted_in\('SI'\)"):
        runs[1].in_units("us")


def test_files_and_prints_say_what_numbers_are_counted_in(tmp_path):
    orbit = (
        gx.linear.normal_modes(steel()),
        gx.linear.normal_modes(gx.scenes.monomer(4, precompression=1.0)),
    )
    pair = steel(), gx.scenes.dimer(8, precompression=1.0)
    waves = [gx.linear.dispersion(x, np.linspace(0, np.pi, 5)) for x in pair]
    for si, scaled in (orbit, waves):
        data, other = (
            xr.load_dataset(x.save(tmp_path / f"{i}.nc")) for i, x in enumerate((si, scaled))
        )
        assert (data.units, data.omega.attrs["units"]) == ("SI", "rad/s")
        assert (other.units, other.omega.attrs["units"], other.omega.attrs["si_units"]) == (
            "scaled",
            "scaled",
            "rad/s",
        )
        assert_allclose(si.in_units("kHz").omega, np.asarray(si.omega) / 2e3 / np.pi, rtol=1e-15)
    spectrum = (
        gx.measures.spectrum(np.eye(8), 0.1),
        gx.measures.spectrum(np.eye(8), 0.1, units="SI"),
    )
    assert [x.units for x in spectrum] == [None, "SI"] and "units" not in spectrum[
        0
    ].to_xarray().omega.attrs


@pytest.mark.slow
def test_numbers_of_scaled_lattices_are_called_so():
    family = gx.breathers.family(gx.scenes.fput(4, beta=1.0), points=3, stability=False)
    orbit = family.orbit(1)
    assert [x.units for x in (family, orbit, orbit.error)] == ["scaled"] * 3
    assert orbit.error.to_xarray().attrs["period_units"] == "scaled"
    event = gx.orbits.Bifurcation("fold", 1.0, 0, orbit.state, **orbit.lattice.origin).to_xarray()
    assert (event.state_u.attrs["si_units"], event.state_v.attrs["si_units"]) == ("m", "m/s")
    modes, waves = (
        gx.linear.normal_modes(gx.scenes.fput(4)),
        gx.linear.dispersion(gx.scenes.fput(4), np.ones(3)),
    )
    spectra = [gx.measures.spectrum(np.eye(8), 0.1, units=x) for x in (None, "scaled", "SI")]
    assert (
        not any("rad/s" in x.outcome for x in (modes, waves, *spectra[:2]))
        and "rad/s" in spectra[2].outcome
    )
    assert all(
        "rad/s" in x.outcome
        for x in (gx.linear.normal_modes(steel()), gx.linear.dispersion(steel(), 1.0))
    )
    assert " s\n" not in repr(gx.Traces([0.0, 1.0], velocity=[0.0, 1.0], sites=0))
    root = gx.newton.newton(lambda x, _: x**2 - 2, jnp.ones(1))
    assert root.units is None and "units" not in root.to_xarray().attrs


@pytest.mark.slow
def test_what_has_no_unit_says_that_it_stays(runs):
    units = runs[2]
    chain = gx.scenes.scaled(steel(boundary="free"))[0]
    parts = gx.Peak(lambda t, y, lattice: y.v), gx.Peak(lambda t, y, lattice: (y.u, y.v[:2]))
    run = gx.simulate(
        chain,
        gx.states.impact(chain, velocity=1e-3),
        1.0,
        step=0.1,
        record=dict(zip(("both", "pair"), parts)),
    )
    data = run.in_units(units, "us")
    assert data.attrs["units"] == "SI" and data.both.attrs["units"] == "scaled"
    assert data.attrs["stats_step"] == pytest.approx(0.1e6 * float(units.time))
    assert data.attrs["stats_step_units"] == "us"


# ------------------------------------------------------------------------------------------------------------- pictures


def labels(ax):
    bars = [image.colorbar.ax.get_ylabel() for image in ax.images if image.colorbar]
    return [ax.get_xlabel(), ax.get_ylabel(), *bars]


def test_a_map_in_si(runs):
    si, scaled, units = runs
    ax = plots.space_time(si)
    assert labels(ax) == ["site", "time (µs)", "velocity (mm/s)"]
    assert labels(plots.traces(si, offset=0))[:2] == ["time (µs)", "velocity (mm/s)"]
    assert labels(plots.space_time(scaled)) == ["site", "time (scaled)", "velocity (scaled)"]
    asked = plots.space_time(si.in_units("ms", "um/s"))
    assert labels(asked) == ["site", "time (ms)", "velocity (µm/s)"]
    assert_allclose(asked.images[0].get_array(), 1e6 * si.vs, rtol=1e-12)


def test_frequency_in_cycles():
    waves = gx.linear.dispersion(steel(), np.linspace(0, np.pi, 9))
    ax = plots.dispersion(waves)
    assert ax.get_ylabel() == "frequency (kHz)"
    assert_allclose(
        ax.lines[0].get_ydata(), np.asarray(waves.omega)[:, 0] / (2e3 * np.pi), rtol=1e-12
    )
    with refused("all in SI or all scaled"):
        plots.dispersion(waves, spectrum=gx.measures.spectrum(np.eye(8), 0.1, units="scaled"))


def test_sites_and_frames_have_whole_ticks():
    ax = plots.space_time(np.ones((4, 5)))
    ticks = np.concatenate([ax.get_xticks(), ax.get_yticks()])
    np.testing.assert_array_equal(ticks, np.round(ticks))
