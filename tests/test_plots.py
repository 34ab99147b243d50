"""Plots return the Axes that they were given, and show the numbers that they were given."""

from types import SimpleNamespace
from typing import NamedTuple

import jax.numpy as jnp
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray
from cases import legend
from matplotlib.animation import FuncAnimation
from PIL import Image
from refusals import refused

import granjax as gx
from granjax.plots.style import shown, units_of

plots = gx.plots
# of beads in a rectangle
PLACES = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0), indexing="ij"), -1)


class Record(NamedTuple):
    ts: object
    us: object
    vs: object


class Curve(NamedTuple):
    k: object
    omega: object
    cell: object


@pytest.fixture
def record():
    draw = np.random.default_rng(0).standard_normal
    return Record(jnp.linspace(0.0, 3.0, 7), jnp.asarray(draw((7, 5))), jnp.asarray(draw((7, 5))))


def colour_bar(ax):
    return next(other for other in ax.figure.axes if other is not ax)


def test_a_map_of_a_run_shows_its_array(ax, record):
    assert plots.space_time(record, ax) is ax
    image = ax.images[0]
    np.testing.assert_array_equal(image.get_array(), record.vs)
    # a pixel is centred on its site and time
    np.testing.assert_allclose(image.get_extent(), (-0.5, 4.5, -0.25, 3.25))
    assert image.origin == "lower"
    # of a record that does not say what it is counted in nothing is said
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("site", "time")
    assert colour_bar(ax).get_ylabel() == "velocity"


@pytest.mark.slow
def test_a_real_run_and_its_displacements(ax):
    chain = gx.scenes.monomer(6)
    run = gx.simulate(
        chain, gx.states.impact(chain), 2.0, save_at=5, solver=gx.VelocityVerlet(), step=0.1
    )
    plots.space_time(run, ax, quantity="u")
    np.testing.assert_array_equal(ax.images[0].get_array(), run.us)
    assert colour_bar(ax).get_ylabel() == "displacement (scaled)"


@pytest.mark.slow
@pytest.mark.parametrize("draw", [gx.plots.space_time, gx.plots.traces])
def test_the_end_alone_is_no_history(ax, draw):
    chain = gx.scenes.monomer(6)
    run = gx.simulate(chain, gx.states.impact(chain), 1.0, step=0.1)
    with refused("a run with several frames, got one .* save_at=401"):
        draw(run, ax=ax)


def test_a_quantity_beside_a_run(ax, record):
    strain = record.us[:, :-1] - record.us[:, 1:]
    plots.space_time(record, ax, quantity=strain, label="strain")
    np.testing.assert_array_equal(ax.images[0].get_array(), strain)


def test_both_signs_are_shown_about_zero(ax, record):
    plots.space_time(record, ax)
    norm = ax.images[0].norm
    assert norm.vmin == -norm.vmax == -np.abs(record.vs).max()
    # zero is white
    np.testing.assert_allclose(ax.images[0].cmap(norm(0.0))[:3], 1.0, atol=0.05)


def test_a_logarithmic_map_is_cut_at_its_floor(ax):
    data = np.array([[1.0, -0.1, 1e-3], [1e-9, 0.0, 2.0]])
    plots.space_time(data, ax, scale="log", floor=1e-2)
    shown = np.asarray(ax.images[0].get_array())
    np.testing.assert_allclose(shown, [[1.0, 0.1, 0.02], [0.02, 0.02, 2.0]])
    assert (ax.images[0].norm.vmin, ax.images[0].norm.vmax) == (0.02, 2.0)
    assert colour_bar(ax).get_ylabel() == "|quantity|"


def test_uneven_times_keep_their_places(ax):
    data = np.arange(12.0).reshape(4, 3)
    plots.space_time(data, ax, ts=[0.0, 1.0, 10.0, 11.0])
    mesh = ax.collections[0]
    np.testing.assert_array_equal(np.asarray(mesh.get_array()).reshape(4, 3), data)
    edges = mesh.get_coordinates()[:, 0, 1]
    np.testing.assert_allclose(edges, [-0.5, 0.5, 5.5, 10.5, 11.5])


def test_a_limit_cuts_the_colours_and_says_so(ax):
    plots.space_time(np.array([[0.0, 1.0], [2.0, 5.0]]), ax, limit=2.0)
    assert ax.images[0].norm.vmax == 2.0
    assert ax.images[0].colorbar.extend == "max"


def test_a_map_of_zeros_and_one_of_gaps(ax):
    plots.space_time(np.zeros((3, 2)), ax, scale="log")
    assert np.all(ax.images[0].get_array() == 1e-4)
    plots.space_time(np.array([[np.nan, 1.0], [0.0, 0.5]]), ax)
    assert ax.images[1].norm.vmax == 1.0


def test_a_word_in_the_place_of_axes_is_refused():
    with refused("ax: expected Axes of matplotlib to draw into, got 'u'.*quantity='u'"):
        gx.plots.space_time(np.ones((4, 5)), "u")


BAD_MAPS = [
    (dict(quantity="w"), "quantity.*'u', 'v'"),
    (dict(quantity=np.zeros((7, 5, 2))), "frames of sites"),
    (dict(ts=[0.0, 1.0]), "ts.*7 rising numbers"),
    (dict(sites=np.arange(4.0)), "sites.*5 rising numbers"),
]


@pytest.mark.parametrize("options, message", BAD_MAPS, ids=[str(list(o)) for o, _ in BAD_MAPS])
def test_bad_maps_are_refused(ax, record, options, message):
    with refused(message):
        plots.space_time(record, ax, **options)


def test_named_fields_are_refused_by_name(ax, record):
    cell = Record(
        record.ts,
        {"bead": record.us, "resonator": record.us},
        {"bead": record.vs, "resonator": record.vs},
    )
    with refused("'bead', 'resonator'"):
        plots.space_time(cell, ax)


def test_traces_are_stacked_by_their_span(ax, record):
    assert plots.traces(record.ts, record.vs, [1, -1], ax) is ax
    spans = np.ptp(np.asarray(record.vs)[:, [1, 4]], axis=0)
    np.testing.assert_allclose(ax.lines[0].get_ydata(), record.vs[:, 1])
    np.testing.assert_allclose(ax.lines[1].get_ydata(), record.vs[:, 4] + spans.max())
    assert [text.get_text() for text in ax.get_yticklabels()] == ["1", "4"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time", "site")


def test_the_scale_bar_has_the_height_that_it_names(ax):
    ts = np.linspace(0, 1, 5)
    plots.traces(ts, np.outer(np.sin(np.pi * ts), [0.0, 3.7]), None, ax, label="velocity (m/s)")
    bottom, top = ax.lines[-1].get_ydata()
    assert top - bottom == pytest.approx(2.0)
    assert ax.texts[0].get_text() == "velocity 2 m/s"


def test_a_trace_of_one_site_and_of_none(ax, record):
    plots.traces(record.ts, record.vs, 2, ax)
    np.testing.assert_allclose(ax.lines[0].get_ydata(), record.vs[:, 2])
    with refused("sites: expected whole numbers within"):
        plots.traces(record.ts, record.vs, 1000, ax)


def test_traces_laid_over_each_other_have_a_legend(ax, record):
    plots.traces(
        record.ts,
        record.vs,
        [0, 2],
        ax,
        offset=0,
        labels=["first", "third"],
        label="velocity (m/s)",
    )
    np.testing.assert_array_equal(ax.lines[1].get_ydata(), record.vs[:, 2])
    assert legend(ax) == ["site first", "site third"]
    assert ax.get_ylabel() == "velocity (m/s)"


def test_transmission_is_drawn_over_rising_ratios(ax):
    got = plots.transmission(
        [1.0, 0.3, 0.6], [1.0, 0.9, 0.2], ax, resonances=0.6, anti_resonances=[0.3, 1.0]
    )
    assert got is ax
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), [0.3, 0.6, 1.0])
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), [0.9, 0.2, 1.0])
    marks = [line.get_xdata()[0] for line in ax.lines[1:4]]
    assert marks == [0.6, 0.3, 1.0]
    assert legend(ax) == ["resonance", "anti-resonance"]
    assert "mass ratio" in ax.get_xlabel()


@pytest.mark.slow
def test_dispersion_shades_the_gap(ax):
    chain = gx.scenes.dimer(20, ratio=0.5, precompression=1.0, boundary="periodic")
    curve = gx.linear.dispersion(chain, jnp.linspace(0.0, jnp.pi, 33))
    assert plots.dispersion(curve, ax) is ax
    np.testing.assert_array_equal(ax.lines[1].get_ydata(), curve.omega[:, 1])
    patch = ax.patches[0]
    # K2 = 3/2: edges sqrt(2 K2) and sqrt(2 K2/ratio)
    assert patch.get_y() == pytest.approx(np.sqrt(3.0))
    assert patch.get_y() + patch.get_height() == pytest.approx(np.sqrt(6.0))
    assert len(ax.patches) == 1
    assert ax.get_xlabel() == "wave number $k$ (rad/cell of 2 sites)"


@pytest.mark.slow
def test_a_spectrum_lies_under_its_dispersion(ax):
    k = 2 * np.pi * 5 / 32
    n = np.arange(32)
    t = np.linspace(0, 60, 512)
    omega = 2 * abs(np.sin(k / 2))
    wave = np.cos(k * n - omega * t[:, None])
    spectrum = gx.measures.spectrum(wave, t[1] - t[0], space_window="none")
    zone = np.linspace(0, np.pi, 65)
    plots.dispersion(
        Curve(zone, 2 * np.sin(zone / 2)[:, None], (1,)), ax, spectrum=spectrum, floor=1e-3
    )
    shown = np.asarray(ax.collections[0].get_array()).reshape(len(spectrum.omega), len(spectrum.k))
    assert shown.max() == 1.0 and shown.min() == 1e-3
    w, place = np.unravel_index(shown.argmax(), shown.shape)
    at = spectrum.k[place]
    # the brightest cell is on the band that is drawn over both signs of k
    assert np.interp(at, *ax.lines[0].get_data()) == pytest.approx(
        float(spectrum.omega[w]), abs=2 * np.pi / 60
    )
    assert ax.get_xlabel() == "wave number $k$ (rad/site)"
    assert not ax.patches


def test_every_wave_that_travels_is_drawn(ax):
    """The imaginary part of a real wave number is rounding, of either sign."""
    omega = np.linspace(0.05, 2.4, 200)  # below the end of the band, 6**0.5
    found = gx.linear.complex_bands(gx.scenes.monomer(20, precompression=1.0), omega)
    real = gx.plots.complex_bands(found, ax).collections[0]
    assert len(np.unique(real.get_offsets()[:, 1])) == 200


def test_bands_of_a_larger_cell_are_repeated_over_the_zone_of_the_sites(ax):
    zone = np.linspace(-np.pi, np.pi, 65)
    omega = np.stack([np.abs(np.sin(zone / 2)), 2 + 0.1 * np.cos(zone)], 1)
    k = np.linspace(-np.pi, np.pi, 8, endpoint=False)
    power = np.ones((8, 4))
    plots.dispersion(
        Curve(zone, omega, 2), ax, spectrum=gx.measures.spectra.Spectrum(k, np.arange(4.0), power)
    )
    covered = np.concatenate([line.get_xdata() for line in ax.lines])
    assert covered.min() <= -np.pi and covered.max() >= np.pi
    # at k = pi per site the phase per cell is 2 pi: the acoustic band is back at zero
    edge = [line.get_ydata()[np.isclose(line.get_xdata(), np.pi)] for line in ax.lines[::2]]
    np.testing.assert_allclose(np.concatenate([e for e in edge if e.size]), 0.0, atol=1e-12)


def test_without_axes_a_figure_of_the_house_style_is_made(record):
    before = dict(matplotlib.rcParams)
    ax = plots.space_time(record)
    assert ax.figure.number in plt.get_fignums()
    assert ax.xaxis.label.get_size() == 10.0
    assert dict(matplotlib.rcParams) == before


def test_a_figure_is_saved_without_pyplot(tmp_path):
    figure = plots.figure(3.0, 2.0)
    figure.subplots().plot([0, 1])
    path = plots.save(figure, tmp_path / "a.png", dpi=100)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert plt.imread(path).shape[:2] == (200, 300)
    with refused("width"):
        plots.figure(0.0)


@pytest.mark.slow
def test_whatever_a_plot_returns_is_saved(tmp_path):
    with plots.style():
        figure = plots.figure(2.0, 1.5)
        axes = figure.subplots(1, 2)
        inner = plots.figure(2.0, 1.5)
        part = inner.subfigures(1, 2)[1].subplots()
    axes[0].plot([0, 1])
    for k, made in enumerate(
        (
            figure,
            axes,
            axes[0],
            [*axes],
            ([axes[0]], [axes[1]]),
            {"left": axes[0]},
            part,
            axes[0].lines,
        )
    ):
        assert plots.save(made, tmp_path / f"{k}.pdf", dpi=50).read_bytes().startswith(b"%PDF")
    with refused("made: expected Axes of one figure"):
        plots.save([axes[0], part], tmp_path / "none.png")
    with refused("dpi: expected"):
        plots.save(figure, tmp_path / "none.png", dpi=0)
    film = FuncAnimation(figure, lambda k: axes[0].plot([0, k]), frames=2)
    assert plots.save(film, tmp_path / "film.gif", dpi=20).read_bytes().startswith(b"GIF8")
    with refused("ending: expected one of '.gif'"):
        plots.save(film, tmp_path / "film.png")


@pytest.mark.slow
def test_a_wave_as_each_contact_of_its_cell_sees_it():
    wave = gx.travelling.tail_free(lambda ratio: (gx.Hertz(), [1.0, ratio]), 0.33, 0.36, speed=1.0)
    ax = gx.plots.wave(wave)
    assert len(ax.lines) == 2 and ax.get_ylabel().startswith("strain") and len(ax.child_axes) == 1
    assert ax.lines[0].get_ydata().max() == pytest.approx(wave.amplitude, rel=1e-2)
    assert legend(ax) == ["contact 0", "contact 1"]


# --------------------------------------------------------------------------------------------------------------- units


TURNED = r"angular frequency $\omega$"


@pytest.mark.parametrize(
    "label, x, unit, units, want",
    [
        ("time", [0.0, 2e-4, np.nan], "s", "SI", (1e6, "time (µs)", "µs")),
        ("time", [0.0, 2e-4], "s", "scaled", (1.0, "time (scaled)", "")),
        ("time", [0.0, 2e-4], "s", None, (1.0, "time", "")),
        (TURNED, [1e5], "rad/s", "SI", (1e-3 / (2 * np.pi), "frequency (kHz)", "kHz")),
        (TURNED, [1e5], "rad/s", "scaled", (1.0, f"{TURNED} (scaled)", "")),
        ("m", [0.5], "", "SI", (1.0, "m", "")),
        ("force (N)", [2e-3], None, None, (1e3, "force (mN)", "mN")),
        ("force (N)", [2e-3], None, "scaled", (1.0, "force (scaled)", "")),
        ("force (lb)", [2e-3], None, "scaled", (1.0, "force (lb)", "lb")),
        ("force (mN)", [2e-3], None, "SI", (1.0, "force (mN)", "mN")),
    ],
)
def test_an_axis_has_one_prefix(label, x, unit, units, want):
    got = shown(label, np.array(x), unit, units)
    assert got[1:] == want[1:] and got.factor == pytest.approx(want[0], rel=1e-12)


def test_a_variable_of_a_dataset_says_its_unit(ax):
    data = xarray.Dataset(
        {
            "v": (("time", "site"), [[0.0, 1.0], [2.0, 3.0]], {"units": "mm/s"}),
            "force": (
                ("time", "site"),
                [[0.0, 0.1], [0.2, 0.3]],
                {"units": "N", "long_name": "contact force"},
            ),
        },
        {"time": ("time", [0.0, 5.0], {"units": "us"})},
        {"units": "SI"},
    )
    plots.space_time(data, ax)
    assert ax.get_ylabel() == "time (µs)" and colour_bar(ax).get_ylabel() == "velocity (mm/s)"
    np.testing.assert_array_equal(ax.images[0].get_array(), data.v)
    np.testing.assert_array_equal(ax.images[0].get_extent()[2:], [-2.5, 7.5])
    force = plots.space_time(data, quantity="force").images[0]
    assert force.colorbar.ax.get_ylabel() == "contact force (mN)"
    np.testing.assert_allclose(force.get_array(), 1e3 * data.force)
    lines = plots.traces(data, "force", [1]).lines
    np.testing.assert_allclose(lines[0].get_ydata(), [100.0, 300.0])


def test_results_in_si_and_scaled_make_no_picture_together():
    with refused("all in SI or all scaled"):
        units_of(SimpleNamespace(units="SI"), None, SimpleNamespace(units="scaled"))


# ---------------------------------------------------------------------------------------------------- beads and films


def test_a_network_of_forces_has_a_key_and_hides_no_bead(ax):
    # one bond that pushes, one that pulls, one to a wall outside of the beads
    segments = np.array([[[0, 0], [1, 0]], [[1, 1], [2, 1]], [[3, 2], [4.5, 2]]], float)
    network = SimpleNamespace(segments=segments, force=np.array([2.0, -1.0, 0.5]))
    plots.beads(PLACES, np.ones((4, 3)), ax, network=network)
    lines = ax.collections[1]
    circle = ax.transData.transform([[0, 0], [1, 0]])
    across = (circle[1] - circle[0])[0] * 72 / ax.figure.dpi
    assert max(lines.get_linewidths()) < 0.4 * across
    np.testing.assert_allclose(lines.get_linewidths() / lines.get_linewidths()[0], [1, 0.5, 0.25])
    assert legend(ax) == ["force 2", "pull 1"]
    assert ax.get_xlim()[1] > 4.5  # the wall's bond is seen whole


@pytest.mark.slow
def test_every_frame_of_a_film_is_as_bright_as_the_first(tmp_path):
    ts = np.linspace(0, 1, 4)
    run = Record(ts, None, np.sin(ts[:, None] + np.arange(12.0)))
    for name, film in (
        ("chain", plots.film(run)),
        ("plane", plots.film(run, PLACES, quantity=np.reshape(run.vs, (4, 4, 3)))),
    ):
        with Image.open(plots.save(film, tmp_path / f"{name}.gif", dpi=50)) as made:
            light = []
            for i in range(made.n_frames):
                made.seek(i)
                light.append(np.asarray(made.convert("RGB")).mean())
        assert made.n_frames == 4 and np.ptp(light) < 3 < 200 < min(light)
