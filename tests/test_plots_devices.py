"""Pictures of devices, states of rest and what evolves show the numbers of their results, with units."""

import dataclasses
from types import SimpleNamespace

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402

import granjax as gx  # noqa: E402
from granjax import plots  # noqa: E402
from granjax.studies import Switch, TruthTable, TwoWay  # noqa: E402
from granjax.units.names import mark_of  # noqa: E402

SI = {"_mark": np.full((), mark_of("SI"))}
ROWS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def gate(output):
    output = np.array(output)
    return TruthTable(ROWS, output, 0.01 * output, np.full(2, 1e-7), np.array([6e4, 5e4]), **SI)


def controlled():
    output, alone = np.array([1e-6, 4e-5, 8e-5, 2e-4]), np.array([0.0, 1e-6, 2e-6, 4e-6])
    return Switch(np.array([0.0, 5e-8, 1e-7, 2e-7]), output, np.full(4, 2e-6), alone, 0.1 * alone, **SI)


def labels(ax):
    return ax.get_xlabel(), ax.get_ylabel()


def test_a_truth_table_shades_the_thresholds_of_each_gate():
    ax = plots.truth_table(gate([0.0, 1e-6, 2e-6, 1e-4]))
    np.testing.assert_allclose([bar.get_height() for bar in ax.containers[0]], [0, 1, 2, 100])
    assert labels(ax) == ("signals that are on (inputs)", "rms velocity (µm/s)")
    assert [tick.get_text() for tick in ax.get_xticklabels()] == ["00", "01", "10", "11"]
    shaded = {text.get_text(): patch.get_bbox() for text, patch in zip(ax.texts, ax.patches[4:])}
    # above the largest of what is off, below the least of what is on, errors off
    assert shaded.keys() == {"OR", "AND"}
    assert (shaded["AND"].y0, shaded["AND"].y1) == pytest.approx((2.02, 99.0))
    assert shaded["OR"].y1 == pytest.approx(0.99)
    ax = plots.truth_table(gate([0.0, 1e-6, 2e-6, 0.5e-6]), units="mm/s")
    assert [text.get_text() for text in ax.texts] == ["OR", "XOR"] and labels(ax)[1] == "rms velocity (mm/s)"


def test_a_switch_has_its_curves_and_the_bracket_of_its_threshold():
    found = controlled()
    ax = plots.switch(found)
    assert labels(ax) == ("control amplitude (nm)", "rms velocity (µm/s)") and ax.get_yscale() == "log"
    (line, _, _), (alone, _, _) = ax.containers
    np.testing.assert_allclose(line.get_ydata(), 1e6 * found.output)
    np.testing.assert_allclose(alone.get_xdata(), [0, 50, 100, 200])
    (band,) = ax.patches
    assert (band.get_bbox().x0, band.get_bbox().x1) == pytest.approx((100, 200))
    # open from the first control on: nothing is shaded
    ax = plots.switch(dataclasses.replace(found, output=np.full(4, 1e-4)))
    assert not ax.patches


def test_a_rectifier_has_rings_where_nothing_repeats_and_the_onset():
    way = lambda power, multiple: SimpleNamespace(up=SimpleNamespace(response=power, multiple=np.array(multiple)))
    near, far = way(np.array([1e-12, 5e-3, 8e-3]), [1, 0, 0]), way(np.full(3, 1e-15), [1, 1, 1])
    found = SimpleNamespace(amplitudes=np.array([1e-7, 2e-7, 3e-7]), near=near, far=far, threshold_near=1.77e-7,
                            threshold_far=np.inf, units="SI")
    onset = SimpleNamespace(kind="Neimark-Sacker", p=1.79e-7)
    orbits = SimpleNamespace(bifurcations=[SimpleNamespace(kind="Fold", p=1e-7), onset], units="SI")
    ax = plots.rectifier(found, orbits=orbits, units=("um", "W"))
    assert labels(ax) == ("drive amplitude (µm)", "transmitted power (W)")
    left, rings, right, none, settled, marked = ax.lines
    np.testing.assert_allclose(left.get_ydata(), near.up.response)
    np.testing.assert_allclose(rings.get_xdata(), [0.2, 0.3])
    assert not len(none.get_xdata()) and right.get_ydata()[0] == 1e-15
    assert settled.get_xdata()[0] == pytest.approx(0.177) and marked.get_xdata()[0] == pytest.approx(0.179)


def test_both_ways_and_the_error_of_their_difference():
    a, left = np.array([1e-10, 1e-9]), np.array([1e-5, 1e-4])
    found = TwoWay(a, 5e4, left, left * (1 - np.array([1e-6, 1e-4])), 1e-9 * left, 1e-9 * left, **SI)
    both, apart = plots.two_way(found)
    assert labels(both) == ("drive amplitude (nm)", "force on the wall at rest (µN)")
    np.testing.assert_allclose(both.lines[1].get_ydata(), 1e6 * found.from_right)
    np.testing.assert_allclose(apart.lines[0].get_ydata(), found.asymmetry)
    np.testing.assert_allclose(apart.collections[0].get_paths()[0].vertices[:, 1].max(), found.asymmetry_error.max())


@pytest.fixture(scope="module")
def kinks():
    chain = gx.scenes.sine_gordon(24, 0.5)
    return gx.kinks.kink(chain, 2 * np.pi), gx.kinks.peierls_nabarro(chain, 2 * np.pi)


@pytest.mark.slow
def test_a_kink_with_its_frequencies_or_its_barrier(kinks):
    found, barrier = kinks
    profile, modes = plots.kink(found)
    np.testing.assert_array_equal(profile.lines[0].get_ydata(), found.state.u)
    assert labels(profile) == ("site $n$", "displacement $u_n$ (scaled)")
    assert profile.get_title(loc="left") == f"stable, energy {float(found.energy):.5g}"
    np.testing.assert_array_equal(modes.lines[0].get_ydata(), found.omega)
    _, wells = plots.kink(found, barrier=barrier)
    site, bond = (container[0].get_ydata()[0] for container in wells.containers)
    assert (site, bond) == pytest.approx((float(barrier.barrier), 0.0))
    assert labels(wells) == ("centre of the kink (sites)", "energy above the lower kink (scaled)")
    units = gx.Units(mass=1e-3, length=1e-2, time=1e-3)
    profile, modes = plots.kink(found, units=units)
    assert (labels(profile)[1], labels(modes)[1]) == ("displacement $u_n$ (mm)", "frequency (Hz)")
    assert profile.get_title(loc="left").endswith(" J") or profile.get_title(loc="left").endswith("mJ")
    np.testing.assert_allclose(modes.lines[0].get_ydata(), 1e3 * np.asarray(found.omega) / (2 * np.pi))


def test_an_equilibrium_with_loads_on_sites_and_ends():
    found = SimpleNamespace(state=(np.array([0.0, 2e-8, 1e-8]), np.zeros(3)), loads=np.array([3.0, 0.0, -2.0]),
                            ends=np.array([3.0, 2.0]), verdict="stable", units="SI")
    rest, held = plots.equilibrium(found)
    assert labels(rest) == ("site $n$", "displacement $u_n$ (nm)") and labels(held)[1] == "load (N)"
    np.testing.assert_allclose(rest.lines[0].get_ydata(), [0, 20, 10])
    assert [bar.get_height() for bar in held.patches] == [3, 0, -2]
    np.testing.assert_allclose(held.lines[0].get_data(), [[-1, 3], [3, 2]])
    plane = SimpleNamespace(state=(np.ones((3, 2)), None), loads=np.ones((3, 2)), ends=None, verdict="stable")
    assert len(plots.equilibrium(plane)[0].get_legend().get_texts()) == 2
    bead = {"bead": np.ones(3)}
    fields = SimpleNamespace(state=(bead, None), loads=bead, ends=None, verdict="saddle")
    np.testing.assert_array_equal(plots.equilibrium(fields, field="bead")[0].lines[0].get_ydata(), 1.0)
    with pytest.raises(ValueError, match="field: expected"):
        plots.equilibrium(fields)
    with pytest.raises(ValueError, match=r"shape \(2, 2, 2\)"):
        plots.equilibrium(SimpleNamespace(state=(np.ones((2, 2, 2)), None), loads=np.ones((2, 2, 2)), ends=None,
                                          verdict="stable"))


def test_an_evolution_shows_densities_and_what_is_kept():
    psi = np.random.default_rng(0).normal(size=(3, 5))
    run = SimpleNamespace(ts=np.array([0.0, 1e-3, 2e-3]), densities=psi**2, norm=np.array([4.0, 4.0, 4.4]),
                          energy=np.array([0.0, 1e-9, -2e-9]), error=np.array([0.0, 1e-6, 4e-6]), norm_error=0.1,
                          energy_error=1e-8)
    for scale in ("linear", "log"):
        shown, known = plots.evolution(run, scale=scale, units="ms")
        assert labels(shown) == ("site", "time (ms)") and labels(known) == ("time (ms)", "relative change, error")
        assert shown.images[0].colorbar.ax.get_ylabel() == r"$|\psi_n|^2$"
    np.testing.assert_allclose(plots.evolution(run)[0].images[0].get_array(), run.densities)
    # relative as the result has them, and psi to the root of the norm
    np.testing.assert_allclose([line.get_ydata()[-1] for line in known.lines], [0.1, 1e-8, 2e-6])
    with pytest.raises(ValueError, match="several times of one lattice"):
        plots.evolution(SimpleNamespace(**{**vars(run), "densities": psi[:1] ** 2}))


def test_a_breather_of_a_k_gap_beside_its_linear_waves():
    ts = np.arange(5.0)
    found = SimpleNamespace(ts=ts, energy=np.exp(-np.abs(ts - 2.0)), growth=0.5, units="SI")
    ax = plots.gap_breather(found, units=("s", "J"))
    energy, up, down = (line.get_ydata() for line in ax.lines)
    np.testing.assert_allclose(energy[:3], up[:3])
    np.testing.assert_allclose(energy[2:], down[2:])
    assert labels(ax) == ("time (s)", "energy (J)")
