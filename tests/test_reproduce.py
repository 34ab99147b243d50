"""The review's figures: every number within its tolerance, and nothing said to be made that is not."""

import dataclasses
import os
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np  # noqa: E402
import pytest  # noqa: E402
import xarray as xr  # noqa: E402

import granjax as gx  # noqa: E402
from granjax import reproduce  # noqa: E402
from granjax.studies.reproduce import (  # noqa: E402
    breather_figures,
    dimer_pulse,
    dimer_transmission,
    making,
    monomer_pulse,
)

LABELS = [
    "fig1.2", "fig1.3", "fig1.4", "fig1.5", "fig2.2", "fig2.3", "fig2.4", "fig2.5", "breather.1", "breather.2",
    "breather.3", "DSW.1", "DSW.2", "DSW.3", "DSW.4", "DSW.5",
]
_computed = {}


@pytest.fixture
def data_of():
    """The data of a figure with its chosen parameters; figures of one simulation share it.

    The folder GRANJAX_FIGURES holds what `granjax reproduce --all --out FOLDER` has computed already.
    """
    def computed(label):
        figure = reproduce.figure(label)
        if folder := os.environ.get("GRANJAX_FIGURES"):
            return xr.load_dataset(Path(folder) / f"{label}.nc", engine="h5netcdf")
        if figure.compute not in _computed:
            _computed[figure.compute] = figure.compute(**figure.parameters())
        return _computed[figure.compute].copy()

    return computed


@pytest.fixture
def quick(monkeypatch):
    """A figure that costs nothing in the place of every figure."""
    def make(**changes):
        figure = reproduce.Figure(
            label="fig1.3", title="A line", caption="x over x", compute=line, draw=draw_line,
            number=lambda data: data["y"].values[-1], quantity="end of the line", expected=2.0, tolerance=1e-3,
            source="arithmetic", chosen={
                "points": reproduce.Choice(5, "", "points of the line"),
                "slope": reproduce.Choice(2.0, "m", "its slope"),
                "name": reproduce.Choice("red", "", "its colour"),
            }, binding=("slope",),
        )
        figure = dataclasses.replace(figure, **changes)
        monkeypatch.setattr(making, "figure", lambda label: dataclasses.replace(figure, label=label))
        return figure

    return make


def line(points, slope, name):
    x = np.linspace(0, 1, points)
    return xr.Dataset({"y": ("x", slope * x)}, {"x": x})


def draw_line(plots, figure, data):
    plots.profile(data["x"].values, data["y"].values, figure.subplots(), inset="none")


def test_the_registry_has_the_sixteen_figures_in_order():
    assert list(reproduce.figures()) == LABELS
    for label, figure in reproduce.figures().items():
        assert figure.label == label and isinstance(figure, reproduce.Figure)


def test_the_listing_says_what_is_chosen():
    lines = reproduce.listing().splitlines()
    for label in LABELS:
        (own,) = [text for text in lines if text.startswith(label + " ")]
        assert own.endswith(reproduce.figure(label).title)
    assert any("radius = 0.009525 m" in text for text in lines)


@pytest.mark.parametrize("label, message", [
    ("fig1.33", "Did you mean 'fig1.3'"), ("dsw1", "DSW.1"), (3, "label: expected a string"),
])
def test_an_unknown_figure_meets_the_nearest(label, message):
    with pytest.raises(ValueError, match=message):
        reproduce.figure(label)


@pytest.mark.slow
@pytest.mark.parametrize("label", LABELS)
def test_the_number_is_the_expected_one_and_every_axis_of_the_picture_labelled(label, data_of):
    figure = reproduce.figure(label)
    assert figure.number(data_of(label)) == pytest.approx(figure.expected, abs=figure.tolerance, rel=0)
    with gx.plots.style():
        canvas = gx.plots.figure(*figure.size)
        figure.draw(gx.plots, canvas, data_of(label))
        canvas.draw_without_rendering()
    bars = [image.colorbar.ax for ax in canvas.axes for image in ax.images]
    for ax in canvas.axes:
        assert ax.get_ylabel()
        assert ax.get_xlabel() or ax in bars


@pytest.mark.slow
def test_both_compactons_miss_the_exact_wave(data_of):
    data = data_of("fig1.2")
    top = data["strain"].sel(place=0.0)
    assert float(data["nesterenko"].sel(place=0.0) / top - 1) == pytest.approx(0.05052, abs=5e-6)
    assert float(data["ahnert_pikovsky"].sel(place=0.0) / top - 1) == pytest.approx(-0.03184, abs=5e-6)
    assert float(data["strain"].sel(place=5.0)) == pytest.approx(1.66653015582526e-15, rel=1e-12)
    assert float(data["nesterenko"].sel(place=3.0)) == float(data["ahnert_pikovsky"].sel(place=3.0)) == 0
    # the slope is that of the strain
    slope = np.gradient(data["strain"].values, data["place"].values)
    np.testing.assert_allclose(data["slope"].values, slope, atol=3e-3)


@pytest.mark.slow
def test_the_wave_keeps_its_profile(data_of):
    data = data_of("fig1.3")
    crest = data.attrs["start"] + data.attrs["travel"]
    last = data["strain"].values[-1]
    known = [9.79950180919572e-5, 0.0290981220754717273, 0.583929165288747316, 1.48735937434940207]
    np.testing.assert_allclose(last[crest - 3 : crest + 1], known, rtol=0, atol=1e-10)
    np.testing.assert_allclose(last[crest : crest + 4], known[::-1], rtol=0, atol=1e-10)
    # nothing is left behind
    assert np.abs(last[: crest - 5]).max() < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("material, radius, striker", [("PTFE", 2.38e-3, 1.5), ("aluminium", 12.7e-3, 0.05)])
def test_the_striker_experiment_scales(material, radius, striker):
    data = monomer_pulse.compute(material, radius, striker, 32)
    assert monomer_pulse.scaled_peak(data) == pytest.approx(monomer_pulse.PEAK_VELOCITY, abs=2e-5)
    assert monomer_pulse.scaled_speed(data) == pytest.approx(monomer_pulse.SPEED, abs=2e-5)


@pytest.mark.slow
def test_velocities_are_in_metres_per_second(data_of):
    data = data_of("fig1.4")
    assert data["velocity"].units == "m/s" and data["time"].units == "s"
    assert data["velocity"].values[0, 0] == 0.4
    # some 560 m/s for steel of 19 mm at 0.4 m/s: order of the experiments, far below sound in steel
    speed = monomer_pulse.scaled_speed(data) * data.attrs["rate"] * data.attrs["diameter"]
    assert 500 < speed < 620


@pytest.mark.slow
def test_the_wall_feels_what_an_independent_integrator_says():
    # SciPy's DOP853 at rtol 1e-10; 0.2096 at 0.595 is also the literature's minimum
    got = gx.resonance.transmission([0.59, 0.5944, 0.595], 101).transmission
    np.testing.assert_allclose(got, [0.2683193, 0.2086785, 0.2096113], rtol=0, atol=2e-5)


@pytest.mark.slow
def test_the_deepest_minimum_is_at_the_first_resonance(data_of):
    ratio, value = dimer_transmission.deepest(data_of("fig2.2"))
    assert ratio == pytest.approx(0.595, abs=0.005)
    assert value == pytest.approx(0.2096, abs=0.001)


@pytest.mark.slow
def test_the_resonant_chain_has_its_ratio_and_keeps_its_energy(data_of):
    data = data_of("fig2.5")
    assert data.attrs["radius_light"] ** 3 / data.attrs["radius_heavy"] ** 3 == pytest.approx(0.59)
    # no contact pushes harder than one that holds all the energy: (2/5) A x^{5/2} = m v^2/2
    bound = (5 / 4) ** 0.6 * data.attrs["force_unit"]
    assert 0 < data["force"].values[: dimer_pulse.CONTACT + 1].min() and data["force"].values.max() < bound
    # what the pulse has lost it does not gain again, and less than 30 % of the striker's energy makes it through
    share = data["passed"].values[1 : dimer_pulse.CONTACT + 1 : 2] / data.attrs["striker_energy"]
    assert 0 < share.min() and share.max() < 1 and (np.diff(share) < 0).all() and share[-1] < 0.3


@pytest.mark.slow
def test_the_energy_of_a_pulse_that_is_not_scattered_goes_on():
    """Hertz, free ends, equal beads: 99.366 % of the striker's energy runs ahead of every later contact."""
    chain = gx.scenes.monomer(24, boundary="free")
    run = gx.simulate(chain, gx.states.impact(chain), 25.0, save_at=501)
    share = dimer_pulse.passed_energy(chain, run) / 0.5
    np.testing.assert_allclose(share[10:16], 0.99366, rtol=0, atol=2e-5)
    assert np.isnan(share[-1]) or share[-1] > 0.9


@pytest.mark.slow
def test_the_driven_chain_settles_on_newtons_orbit(data_of):
    data = data_of("breather.2")
    assert breather_figures.disagreement(data) < 1e-6 and not breather_figures.swing(data) == 0


@pytest.mark.slow
@pytest.mark.parametrize("label", ["fig1.3", "breather.1"])
def test_check_writes_what_it_says(label, data_of, monkeypatch, tmp_path):
    computed = dataclasses.replace(reproduce.figure(label), compute=lambda **parameters: data_of(label))
    monkeypatch.setattr(making, "figure", lambda label: computed)
    (result,) = reproduce.run(label, tmp_path, True, gx.plots)
    assert result.passed is True and ": agrees" in result.outcome and "chosen here" in result.outcome
    assert result.picture.read_bytes().startswith(b"\x89PNG")
    with xr.open_dataset(result.data, engine="h5netcdf") as data:
        assert reproduce.figure(label).number(data) == pytest.approx(result.number, rel=1e-14)
        assert data.attrs["expected"] == result.expected


def test_a_run_writes_the_picture_and_the_data(quick, tmp_path):
    quick()
    results = reproduce.run(["fig1.3", "fig1.4"], tmp_path / "deep" / "out", True, gx.plots)
    assert [result.label for result in results] == ["fig1.3", "fig1.4"]
    first = results[0]
    assert first.passed is True and first.failure == ""
    assert first.picture == tmp_path / "deep" / "out" / "fig1.3.png"
    assert first.picture.read_bytes().startswith(b"\x89PNG")
    with xr.open_dataset(first.data, engine="h5netcdf") as data:
        np.testing.assert_array_equal(data["y"], [0, 0.5, 1, 1.5, 2])
        assert data.attrs["number"] == data.attrs["expected"] == 2.0
        assert data.attrs["chosen_slope"] == 2.0
    assert "chosen here: points = 5, slope = 2 m, name = red" in str(first)
    assert "end of the line: 2.0000 (expected 2.0000 +- 0.001, arithmetic): agrees" in str(first)


def test_without_a_folder_nothing_is_written(quick, tmp_path, monkeypatch):
    quick()
    monkeypatch.chdir(tmp_path)
    (result,) = reproduce.run("fig1.3", check=True)
    assert result.picture is None and result.data is None and result.passed
    assert list(tmp_path.iterdir()) == []


def test_a_number_that_disagrees_fails(quick):
    quick(expected=2.1)
    (result,) = reproduce.run("fig1.3", check=True)
    assert result.passed is False and ": DISAGREES" in result.outcome


def test_a_simulation_that_fails_stops_no_other(quick, tmp_path):
    def broken(points, slope, name):
        raise RuntimeError("The state is not finite.")

    quick(compute=broken)
    results = reproduce.run(["fig1.3", "fig1.4"], tmp_path, True, gx.plots)
    assert [result.passed for result in results] == [False, False]
    assert all("failed: The state is not finite." in str(result) for result in results)
    assert list(tmp_path.iterdir()) == []


def test_overrides_are_read_as_what_they_replace(quick):
    quick()
    (result,) = reproduce.run("fig1.3", overrides={"points": "9", "slope": "2.0", "name": "blue"})
    assert result.parameters == {"points": 9, "slope": 2.0, "name": "blue"}
    assert result.passed is True


def test_an_expected_value_does_not_hold_for_other_parameters(quick):
    quick()
    (result,) = reproduce.run("fig1.3", check=True, overrides={"slope": 3})
    assert result.number == 3.0 and result.passed is None
    assert "not for those set" in result.outcome and "agrees" not in result.outcome


@pytest.mark.parametrize("overrides, message", [
    ({"slpoe": 1.0}, "Did you mean 'slope'"), ({"points": "many"}, "a whole number such as 5"),
    ({"points": 2.5}, "a whole number"), ({"slope": None}, "a number such as 2.0"), ({"slope": True}, "a number"),
])
def test_bad_overrides_are_refused(quick, overrides, message):
    quick()
    with pytest.raises(ValueError, match=message):
        reproduce.run("fig1.3", overrides=overrides)


def test_an_override_goes_to_the_figures_that_have_it():
    with pytest.raises(ValueError, match="Did you mean 'travel'"):
        reproduce.run(["fig1.3", "fig1.4"], overrides={"travl": 10})
    with pytest.raises(ValueError, match="travel: expected a whole number not below 2"):
        reproduce.run("fig1.3", overrides={"travel": 1})


def test_a_folder_needs_the_module_that_draws(tmp_path):
    with pytest.raises(ValueError, match="granjax.plots"):
        reproduce.run("fig1.3", tmp_path)
    taken = tmp_path / "file"
    taken.write_text("")
    with pytest.raises(ValueError, match="out: expected a folder"):
        reproduce.run("fig1.3", taken, plots=gx.plots)
