"""Units by their names, what a lattice and its results are counted in, and the same in every picture."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402
import xarray as xr  # noqa: E402

import granjax as gx  # noqa: E402
from granjax.units.names import family, known_unit, readable  # noqa: E402

plots = gx.plots


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


# ---------------------------------------------------------------------------------------------------------------- names


@pytest.mark.parametrize("word, size, dimension", [
    ("us", 1e-6, (0, 0, 1, 0, 0)), ("µs", 1e-6, (0, 0, 1, 0, 0)), ("mm/s", 1e-3, (0, 1, -1, 0, 0)),
    ("m/s²", 1.0, (0, 1, -2, 0, 0)), ("N/m^{3/2}", 1.0, (1, -1.5, 0, 0, 0)), ("kg", 1.0, (1, -1, 2, 0, 0)),
    ("kHz", 2e3 * np.pi, (0, 0, -1, 1, 0)), ("rad/s", 1.0, (0, 0, -1, 1, 0)), ("1/ms", 1e3, (0, 0, -1, 0, 0)),
    ("m s^-1", 1.0, (0, 1, -1, 0, 0)), ("mV", 1e-3, (0, 0, 0, 0, 1)), ("MN/m", 1e6, (1, -1, 0, 0, 0)),
    ("m·s⁻¹", 1.0, (0, 1, -1, 0, 0)), ("GPa", 1e9, (1, -2, 0, 0, 0)), ("rad^2/s^2", 1.0, (0, 0, -2, 2, 0)),
])
def test_a_unit_is_read_by_its_name(word, size, dimension):
    unit = known_unit(word)
    assert unit.size == pytest.approx(size, rel=1e-15) and tuple(map(float, unit.dimension)) == dimension


@pytest.mark.parametrize("word", ["", "sec", "furlong", "m//s", "/s", "m^x", "site", "m^{1/0}", "5 m", "a.u.",
                                  "km^9999", "mm^9999"])
def test_what_is_no_unit_is_none(word):
    assert known_unit(word) is None


@pytest.mark.parametrize("largest, name", [(3e-5, "us"), (1.0, "s"), (1e-6, "us"), (999e-6, "us"), (2e4, "s"),
                                           (1e-15, "ns"), (0.0, "s"), (np.nan, "s")])
def test_the_prefix_makes_numbers_from_1_to_1000(largest, name):
    assert readable(family(known_unit("s").dimension), largest).name == name


# ------------------------------------------------------------------------------------------------ lattices and results


def steel(**options):
    return gx.scenes.beads("steel 316", 9.53e-3, 10.0, cells=8, **options)


def test_a_lattice_knows_what_it_is_counted_in():
    chain = steel()
    scaled, units = gx.scenes.scaled(chain)
    own = gx.Lattice(1.0, chain.terms, sites=8, units="SI")
    driven = gx.driven.driven_chain(chain, 1e-7, 3e4, damping=10.0)
    batch = jax.vmap(lambda F0: gx.scenes.beads("steel 316", 9.53e-3, F0, cells=8), out_axes=-1)(jnp.ones(3))
    said = [x.units for x in (chain, driven, own, batch, chain.astype(np.float32), gx.studies.steel_chain(5),
                              jax.jit(lambda F0: steel().counted_in("SI"))(1.0))]
    assert said == ["SI"] * 7
    assert [x.units for x in (scaled, gx.scenes.monomer(5), chain.counted_in("scaled"))] == ["scaled"] * 3
    with pytest.raises(ValueError, match="units: expected one of"):
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
    np.testing.assert_allclose(data.time, 1e6 * si.ts, rtol=1e-15)
    np.testing.assert_allclose(data.v, 1e3 * si.vs, rtol=1e-15)
    np.testing.assert_array_equal(data.u, si.us)
    assert [data[name].attrs["units"] for name in ("time", "v", "u")] == ["us", "mm/s", "m"]
    size = float(np.abs(data.v).max())
    np.testing.assert_allclose(scaled.in_units(units, "us", "mm/s").v, data.v, atol=1e-9 * size)
    np.testing.assert_allclose(scaled.in_units(units).time, si.ts, rtol=1e-12)
    back = si.in_units(units)
    np.testing.assert_allclose(back.v, scaled.vs, atol=1e-9 * float(np.abs(scaled.vs).max()))
    assert back.attrs["units"] == back.v.attrs["units"] == "scaled" and back.v.attrs["si_units"] == "m/s"


def test_si_beside_the_units_of_a_scaled_run_is_where_it_goes(runs):
    si, scaled, units = runs
    for asked in ((units, "SI"), ("SI", units), ("SI", units, "us")):
        data = scaled.in_units(*asked)
        np.testing.assert_allclose(data.time, (1e6 if "us" in asked else 1) * si.ts, rtol=1e-12)
        assert data.attrs["units"] == "SI" and data.time.attrs["units"] == ("us" if "us" in asked else "s")
    waves = gx.linear.dispersion(gx.scenes.scaled(steel())[0], np.linspace(0, np.pi, 5))
    drawn = [plots.dispersion(waves, units=x) for x in (units, ("SI", units))]
    assert drawn[0].get_ylabel() == drawn[1].get_ylabel() == "frequency (kHz)"
    np.testing.assert_array_equal(drawn[0].lines[0].get_ydata(), drawn[1].lines[0].get_ydata())


def test_units_of_what_nobody_has_said_are_refused_or_said():
    spectrum = gx.measures.spectrum(np.eye(8), 0.1)
    for asked in (("kHz",), (gx.Units(time=1e-3),), (gx.Units(time=1e-3), "kHz")):
        with pytest.raises(ValueError, match=r"units: expected units of a result that says .*units=run.units"):
            spectrum.in_units(*asked)
    data = spectrum.in_units("SI", "kHz")
    np.testing.assert_allclose(data.omega, np.asarray(spectrum.omega) / 2e3 / np.pi, rtol=1e-15)
    assert (data.attrs["units"], data.omega.attrs["units"]) == ("SI", "kHz")
    data = spectrum.in_units("scaled", gx.Units(time=1e-3))
    np.testing.assert_allclose(data.omega, 1e3 * np.asarray(spectrum.omega), rtol=1e-15)
    assert (data.attrs["units"], data.omega.attrs["units"]) == ("SI", "rad/s")


@pytest.mark.slow
def test_what_a_transformation_returns_knows_it_too():
    chain = steel()
    run = lambda v: gx.simulate(chain, gx.states.impact(chain, velocity=v), 1e-5, solver=gx.VelocityVerlet(), step=2e-6)
    assert [jax.jit(run)(0.1).units, jax.vmap(run)(jnp.ones(2)).units] == ["SI", "SI"]


@pytest.mark.parametrize("units, message", [
    (("kHz",), "units of m, m/s, s, got 'kHz'"), (("usec",), "name of a unit, got 'usec'. Nearest: 'us'"),
    (("s", "ms"), "one word for each dimension"), (("scaled",), "units of numbers in SI"),
    ((gx.Units(), "us"), "words, or a Units"),
])
def test_units_that_a_run_has_not_are_refused(runs, units, message):
    with pytest.raises(ValueError, match=f"units.*: expected .*({message})"):
        runs[0].in_units(*units)
    with pytest.raises(ValueError, match=r"scaled numbers, got .*Give the Units .*gx.Units\(\).*counted_in\('SI'\)"):
        runs[1].in_units("us")


def test_files_and_prints_say_what_numbers_are_counted_in(tmp_path):
    orbit = gx.linear.normal_modes(steel()), gx.linear.normal_modes(gx.scenes.monomer(4, precompression=1.0))
    pair = steel(), gx.scenes.dimer(8, precompression=1.0)
    waves = [gx.linear.dispersion(x, np.linspace(0, np.pi, 5)) for x in pair]
    for si, scaled in (orbit, waves):
        data, other = (xr.load_dataset(x.save(tmp_path / f"{i}.nc")) for i, x in enumerate((si, scaled)))
        assert (data.units, data.omega.attrs["units"]) == ("SI", "rad/s")
        assert (other.units, other.omega.attrs["units"], other.omega.attrs["si_units"]) == ("scaled", "scaled", "rad/s")
        np.testing.assert_allclose(si.in_units("kHz").omega, np.asarray(si.omega) / 2e3 / np.pi, rtol=1e-15)
    spectrum = gx.measures.spectrum(np.eye(8), 0.1), gx.measures.spectrum(np.eye(8), 0.1, units="SI")
    assert [x.units for x in spectrum] == [None, "SI"] and not spectrum[0].to_xarray().omega.attrs


@pytest.mark.slow
def test_numbers_of_scaled_lattices_are_called_so():
    family = gx.breathers.family(gx.scenes.fput(4, beta=1.0), points=3, stability=False)
    orbit = family.orbit(1)
    assert [x.units for x in (family, orbit, orbit.error)] == ["scaled"] * 3
    assert orbit.error.to_xarray().attrs["period_units"] == "scaled"
    event = gx.orbits.Bifurcation("fold", 1.0, 0, orbit.state, **orbit.lattice.origin).to_xarray()
    assert (event.state_u.attrs["si_units"], event.state_v.attrs["si_units"]) == ("m", "m/s")
    modes, waves = gx.linear.normal_modes(gx.scenes.fput(4)), gx.linear.dispersion(gx.scenes.fput(4), np.ones(3))
    spectra = [gx.measures.spectrum(np.eye(8), 0.1, units=x) for x in (None, "scaled", "SI")]
    assert not any("rad/s" in x.outcome for x in (modes, waves, *spectra[:2])) and "rad/s" in spectra[2].outcome
    assert all("rad/s" in x.outcome for x in (gx.linear.normal_modes(steel()), gx.linear.dispersion(steel(), 1.0)))
    assert " s\n" not in repr(gx.Traces([0.0, 1.0], velocity=[0.0, 1.0], sites=0))
    root = gx.newton.newton(lambda x, _: x**2 - 2, jnp.ones(1))
    assert root.units is None and "units" not in root.to_xarray().attrs


@pytest.mark.slow
def test_what_has_no_unit_says_that_it_stays(runs):
    units = runs[2]
    chain = gx.scenes.scaled(steel(boundary="free"))[0]
    parts = gx.Peak(lambda t, y, lattice: y.v), gx.Peak(lambda t, y, lattice: (y.u, y.v[:2]))
    run = gx.simulate(chain, gx.states.impact(chain, velocity=1e-3), 1.0, step=0.1,
                      record=dict(zip(("both", "pair"), parts)))
    data = run.in_units(units, "us")
    assert data.attrs["units"] == "SI" and data.both.attrs["units"] == "scaled"
    assert data.attrs["stats_step"] == pytest.approx(0.1e6 * float(units.time))
    assert data.attrs["stats_step_units"] == "us"


# ------------------------------------------------------------------------------------------------------------- pictures


def labels(ax):
    bars = [image.colorbar.ax.get_ylabel() for image in ax.images if image.colorbar]
    return [ax.get_xlabel(), ax.get_ylabel(), *bars]


@pytest.mark.parametrize("asked, time, velocity", [
    (None, "time (µs)", "velocity (mm/s)"), ("ms", "time (ms)", "velocity (mm/s)"),
    (("s", "m/s"), "time (s)", "velocity (m/s)"), ("SI", "time (µs)", "velocity (mm/s)"),
    ("units", "time (scaled)", "velocity (scaled)"),
])
def test_a_map_in_units(runs, asked, time, velocity):
    si, scaled, units = runs
    asked = units if asked == "units" else asked
    ax = plots.space_time(si, units=asked)
    assert labels(ax) == ["site", time, velocity]
    assert labels(plots.traces(si, units=asked, offset=0))[:2] == [time, velocity]
    # the same picture of scaled numbers, by what leads back
    both = (units,) if asked in (None, "SI") else (units, *np.atleast_1d(asked)) if asked is not units else None
    other = plots.space_time(scaled, units=both)
    assert labels(other) == labels(ax)
    size = np.abs(ax.images[0].get_array()).max()
    np.testing.assert_allclose(other.images[0].get_array(), ax.images[0].get_array(), atol=1e-9 * size)
    np.testing.assert_allclose(other.images[0].get_extent(), ax.images[0].get_extent(), rtol=1e-9)


def test_frequency_in_cycles_and_in_radians():
    waves = gx.linear.dispersion(steel(), np.linspace(0, np.pi, 9))
    for asked, label, size in ((None, "frequency (kHz)", 2e3 * np.pi), ("Hz", "frequency (Hz)", 2 * np.pi),
                               ("rad/s", r"angular frequency $\omega$ (rad/s)", 1.0)):
        ax = plots.dispersion(waves, units=asked)
        assert ax.get_ylabel() == label
        np.testing.assert_allclose(ax.lines[0].get_ydata(), np.asarray(waves.omega)[:, 0] / size, rtol=1e-12)
    with pytest.raises(ValueError, match=r"spectrum: expected one in SI numbers, as the dispersion, got scaled"):
        plots.dispersion(waves, spectrum=gx.measures.spectrum(np.eye(8), 0.1, units="scaled"))


def test_a_family_and_a_hysteresis_in_units():
    family = SimpleNamespace(omega=2 * np.pi * np.array([7e3, 6e3]), energy=np.array([1e-9, 4e-8]), units="SI",
                             amplitude=np.array([1e-8, 1e-7]), verdict=np.array(["stable", "stable"]))
    left, right = plots.branch(family, bands=2 * np.pi * np.array([[0.0, 6.5e3]]))
    assert [labels(left), labels(right)] == [["frequency (kHz)", "energy (nJ)"],
                                             ["frequency (kHz)", r"amplitude $\max_n |u_n|$ (nm)"]]
    assert left.patches[0].get_width() == pytest.approx(6.5)
    ax = plots.hysteresis(([7e3, 8e3], [1e-3, 2e-3], None), units="SI", x_label="frequency", y_label="rms velocity")
    assert labels(ax) == ["frequency (kHz)", "rms velocity (mm/s)"]
    np.testing.assert_allclose(ax.lines[0].get_xydata(), [[7.0, 1.0], [8.0, 2.0]])
    # a label with a unit of its own is drawn as it stands
    ax = plots.hysteresis(([7.0, 8.0], [1.0, 2.0], None), units="SI", x_label="drive (dB)", y_label="response")
    assert labels(ax) == ["drive (dB)", "response"] and ax.lines[0].get_xdata()[0] == 7.0


def test_curves_and_laws_in_units():
    x, y = np.arange(4.0), 1e-6 * np.arange(4.0)
    assert labels(plots.profile(x, y)) == ["site", "strain"]
    assert labels(plots.profile(x, y, units="scaled")) == ["site", "strain (scaled)"]
    ax = plots.profile(x, y, units="SI", points=(x, y))
    assert labels(ax) == ["site", "strain (µm)"]
    for line in ax.lines:
        np.testing.assert_allclose(line.get_ydata(), 1e6 * y)
    ax = plots.law(y, 1e9 * y**1.5, 0 * y, 2e9 * y**1.5, units="SI")
    assert labels(ax) == ["compression (µm)", "force (N)"] and ax.get_xlim() == pytest.approx((0.0, 3.0))
    assert labels(plots.transmission([0.3, 0.6], [1.0, 2.0], y_label="peak force", units="SI"))[1] == "peak force (N)"


@pytest.mark.parametrize("draw, message", [
    (lambda: plots.transmission([0.3, 0.6], [1.0, 2.0], units="us"),
     "None: no label here names a quantity with units, got 'us'"),
    (lambda: plots.profile(np.arange(3), np.arange(3.0), units="kHz"), r"units of strain \(m\), got 'kHz'"),
    (lambda: plots.space_time(np.ones((3, 3)), units="uss"), "the name of a unit, got 'uss'. Nearest: 'us'"),
])
def test_words_that_no_axis_takes_are_refused(draw, message):
    with pytest.raises(ValueError, match=f"units: expected {message}"):
        draw()


def test_an_axis_that_nobody_knows_takes_the_word_that_is_left():
    ax = plots.space_time(np.ones((3, 3)), ts=1e-3 * np.arange(3.0), units=("ms", "mV"), label="signal")
    assert labels(ax) == ["site", "time (ms)", "signal (mV)"] and ax.images[0].get_array()[0, 0] == 1e3


def test_cycles_and_radians_are_not_guessed():
    ways = [7e3, 8e3], [1.0, 2.0], None
    for asked in ("kHz", "rad/s"):
        with pytest.raises(ValueError, match=r"units: expected a label that says what 'parameter' counts, got .*Hz"):
            plots.hysteresis(ways, units=asked, y_label="rms velocity")
    for name, size in (("frequency", 1e3), ("angular frequency", 2e3 * np.pi)):
        ax = plots.hysteresis(ways, units="kHz", x_label=name, y_label="rms velocity")
        np.testing.assert_allclose(ax.lines[0].get_xdata(), np.array(ways[0]) / size)
    family = SimpleNamespace(p=np.array([7e3, 8e3]), response=np.ones(2), verdict=np.array([""] * 2), units="scaled")
    way = SimpleNamespace(response=np.ones(2))
    sweep = SimpleNamespace(values=np.array([7e3, 8e3]), up=way, down=None, hysteresis=[], units="SI")
    with pytest.raises(ValueError, match="orbits: expected one in SI numbers, as the sweep, got scaled"):
        plots.hysteresis(sweep, orbits=family)


def test_labels_of_arrays_and_of_speeds_and_periods(runs):
    si = runs[0]
    assert labels(plots.space_time(si.us, ts=si.ts, units="SI")) == ["site", "time (µs)", "quantity"]
    assert labels(plots.space_time(si, quantity="u"))[2].startswith("displacement (")
    assert labels(plots.traces(si.ts, si.us, offset=0, units=("us", "nm"))) == ["time (µs)", "quantity (nm)"]
    ax = plots.profile([1e-3, 2e-3], [2e3, 3e3], x_label="period", y_label="group velocity", units="SI")
    assert labels(ax) == ["period (ms)", "group velocity (1/ms)"]


def test_an_orbit_takes_the_same_words_whether_it_is_stable():
    vectors = np.array([[0.5], [1.0], [2e3], [4e3]])
    fl = SimpleNamespace(multipliers=np.array([1.5]), vectors=vectors, krein=np.zeros(1), error=np.zeros(1),
                         expected=0, rate=0.0, period=1e-3)
    orbit = SimpleNamespace(state=(np.array([1e-6, 2e-6]), np.zeros(2)), units="SI")
    axes = plots.breather(orbit, fl, units=("um", "us", "mm/s")).ravel()
    assert [ax.get_ylabel() for ax in axes[2:]] == ["displacement of the mode", "velocity of the mode (1/ms)"]
    np.testing.assert_allclose(axes[3].lines[-1].get_ydata(), [2.0, 4.0])
    orbit.units = "scaled"
    assert plots.breather(orbit, fl).ravel()[3].get_ylabel() == "velocity of the mode (scaled)"


def test_data_beside_a_fitted_gain_have_no_unit():
    raw = gx.Traces([0.0, 1e-3], velocity=np.array([0.5, 1.0]), sites=0, gain="sensitivity")
    known = gx.Traces([0.0, 1e-3], velocity=np.array([0.5, 1.0]), sites=0)
    other = gx.Traces([0.0, 1.0], force=[0.0, 1.0], contacts=0, gain=8.0)
    assert [x.unit for x in (raw, known, other)] == ["", "m/s", ""]
    both = raw.data, known.data
    fit = SimpleNamespace(traces=(raw, known), signals=both, residuals=both, units="SI")
    axes = plots.fit(fit)
    assert [ax.get_ylabel() for ax in axes[0]] == ["velocity signal", "velocity (m/s)"]
    assert axes[0, 0].lines[0].get_ydata().tolist() == [0.5, 1.0]
    assert plots.fit(fit, units=("us", "mV", "mm/s"))[0, 0].get_ylabel() == "velocity signal (mV)"


def test_what_is_a_pure_number_takes_no_words_and_parameters_those_that_are_asked_for():
    fl = SimpleNamespace(multipliers=np.array([1.0]), krein=np.zeros(1), error=np.zeros(1), expected=1, rate=0.0,
                         period=1.0)
    assert labels(plots.floquet_circle(fl, units="SI")) == [r"Re $\rho$", r"Im $\rho$"]
    with pytest.raises(ValueError, match="units: expected None"):
        plots.floquet_circle(fl, units="us")
    fit = SimpleNamespace(parameters={"damping_time": 2e-3, "k": 3.0}, names=("damping_time", "k"),
                          covariance=np.diag([1e-8, 0.01]), units="SI")
    assert plots.corner(fit)[1, 0].get_xlabel() == r"damping_time ($10^{-3}$)"
    axes = plots.corner(fit, units="ms", truths={"damping_time": 2.1e-3})
    assert (axes[1, 0].get_xlabel(), axes[1, 0].get_ylabel()) == ("damping_time (ms)", "k")
    assert axes[0, 0].get_title(loc="center") == r"2.00 $\pm$ 0.10" and axes[0, 0].lines[-1].get_xdata()[0] == 2.1


def test_sites_and_frames_have_whole_ticks():
    ax = plots.space_time(np.ones((4, 5)))
    ticks = np.concatenate([ax.get_xticks(), ax.get_yticks()])
    np.testing.assert_array_equal(ticks, np.round(ticks))
