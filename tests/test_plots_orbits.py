"""Plots of time-periodic orbits: lines hold the numbers that they were given, colours the signature and verdict."""

from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from cases import legend
from matplotlib.colors import to_hex
from numpy.testing import assert_array_equal

import granjax as gx

plots = gx.plots
BLUE, RED, GREEN = plots.COLOURS[:3]
ROUND = np.exp(0.4j)


@pytest.fixture
def axes():
    return plt.subplots(2, 2)[1]


@pytest.fixture
def fl():
    """A stable pair, an unstable real pair, and a pair at +1 of which rounding has moved one outside."""
    vectors = np.array(
        [
            [0.1, 0, 2, 0, 0, 0],
            [0.2, 0, -4, 0, 0, 0],
            [0.3, 0, 1, 0, 0, 0],
            [0.0, 0, 6, 0, 0, 0],
            [0.5, 0, 8, 0, 0, 0],
            [0.0, 0, -2, 0, 0, 0],
        ],
        complex,
    )
    return SimpleNamespace(
        multipliers=np.array([ROUND, ROUND.conj(), 1.2, 1 / 1.2, 1 + 1e-5, 1 - 1e-5], complex),
        vectors=vectors,
        krein=np.array([1, -1, 0, 0, 0, np.nan]),
        error=np.full(6, 1e-8),
        expected=2,
        rate=0.0,
        period=2.0,
    )


def points(ax, label):
    (line,) = [line for line in ax.lines if line.get_label() == label]
    return line.get_xydata(), to_hex(line.get_color()), line


def labels(ax):
    return [line.get_label() for line in ax.lines if not line.get_label().startswith("_")]


def spans(ax):
    """(low, high) of every shaded interval."""
    return [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in ax.patches]


# -------------------------------------------------------------------------------------------------- Floquet multipliers


def test_multipliers_are_coloured_by_their_signature(ax, fl):
    assert plots.floquet_circle(fl, ax) is ax
    for label, colour, mark, rho in (
        ("Krein +", BLUE, "o", [ROUND]),
        ("Krein $-$", RED, "s", [ROUND.conj()]),
        ("Krein 0", to_hex("0.25"), "^", fl.multipliers[2:]),
    ):
        shown, tone, line = points(ax, label)
        assert_array_equal(shown @ [1, 1j], rho)
        assert (tone, line.get_marker()) == (colour.lower(), mark)
    assert (ax.get_xlabel(), ax.get_ylabel()) == (r"Re $\rho$", r"Im $\rho$")
    assert legend(ax) == labels(ax)


def test_unstable_multipliers_have_rings_and_those_of_symmetry_none(ax, fl):
    plots.floquet_circle(fl, ax, legend=False)
    assert ax.get_legend() is None and ax.lines[-1].get_label() == "unstable"
    assert_array_equal(points(ax, "unstable")[0], [[1.2, 0.0]])
    # without a symmetry the one outside at +1 counts, and an error as large hides it
    fl.expected = 0
    assert_array_equal(plots.orbits.unstable_of(fl), [2, 4])
    fl.error = np.full(6, 1e-4)
    assert_array_equal(plots.orbits.unstable_of(fl), [2])


@pytest.mark.parametrize("rate, radii", [(0.0, [1.0]), (None, [1.0]), (0.3, [1.0, np.exp(-0.3)])])
def test_damping_adds_the_circle_about_which_multipliers_pair(ax, fl, rate, radii):
    fl.rate = rate
    plots.floquet_circle(fl, ax)
    circles = [line for line in ax.lines if len(line.get_xdata()) > 6]
    assert [line.get_linestyle() for line in circles] == ["-", ":"][: len(radii)]
    for circle, radius in zip(circles, radii):
        np.testing.assert_allclose(np.hypot(*circle.get_data()), radius, rtol=1e-15)


# ----------------------------------------------------------------------------------------------------------- a breather


def breather():
    return SimpleNamespace(state=(np.array([0.5, -1.0, 0.25]), np.zeros(3)))


def dots(ax):
    (line,) = [line for line in ax.lines if line.get_marker() == "o"]
    return line.get_xydata()


def test_a_breather_shows_its_sites_and_its_growing_mode(axes, fl):
    assert plots.breather(breather(), fl, axes) is axes
    (a, b), (c, d) = axes
    assert_array_equal(dots(a), [[0, 0.5], [1, -1.0], [2, 0.25]])
    assert "unstable" in labels(b)
    # the eigenvector (2, -4, 1, 6, 8, -2), whose largest displacement becomes 1
    assert_array_equal(dots(c)[:, 1], [-0.5, 1.0, -0.25])
    assert_array_equal(dots(d)[:, 1], [-1.5, -2.0, 0.5])
    assert c.get_title("left") == r"$\rho$ = 1.200000"
    assert [ax.texts[0].get_text() for ax in axes.ravel()] == ["(a)", "(b)", "(c)", "(d)"]


def test_a_complex_mode_has_an_imaginary_part(axes, fl):
    fl.vectors[:, 0] = np.array([1, 2j, 0, 0, 1, 0]) * ROUND
    plots.breather(breather(), fl, axes, mode=0)
    c, d = axes[1]
    np.testing.assert_allclose(dots(c)[:, 1], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(points(c, "imaginary part")[0][:, 1], [-0.5, 0, 0], atol=1e-15)
    np.testing.assert_allclose(points(d, "imaginary part")[0][:, 1], [0, -0.5, 0], atol=1e-15)
    assert c.get_title("left") == r"$\rho$ = 0.921061 + 0.389418i"


def test_a_stable_breather_says_that_nothing_grows(axes, fl):
    fl.multipliers[2:4] = 1j, -1j
    vs = 1e-3 * np.arange(12.0).reshape(4, 3)
    run = SimpleNamespace(ts=1e-6 * np.arange(4.0), vs=vs, units="SI")
    orbit = SimpleNamespace(**vars(breather()), run=lambda: run, units="SI")
    plots.breather(orbit, fl, axes)
    c, d = axes[1]
    np.testing.assert_allclose(dots(c), [[0.5, 1.5], [1.5, -1.25]])
    assert c.get_title("left") == "no mode grows"
    assert c.get_ylabel() == "$u_n - u_{n+1}$ (m)"
    np.testing.assert_allclose(d.images[0].get_array(), 1e3 * run.vs)
    np.testing.assert_allclose(d.images[0].get_extent(), (-0.5, 2.5, -0.5, 3.5))
    assert (
        d.get_ylabel() == "time (µs)" and d.images[0].colorbar.ax.get_ylabel() == "velocity (mm/s)"
    )


# ------------------------------------------------------------------------------------------------------------- a family


@pytest.fixture
def family():
    return SimpleNamespace(
        omega=np.array([1.0, 0.9, 0.8, 0.7, 0.6]),
        energy=np.array([0.0, 1.0, 3.0, 2.0, 4.0]),
        amplitude=np.array([0.0, 0.1, 0.2, 0.3, 0.5]),
        verdict=np.array(["stable", "stable", "unstable", "unstable", "stable"]),
    )


def near(ax, points):
    """The largest distance of points from what the solid and dashed lines draw."""
    drawn = np.concatenate([line.get_xydata() for line in ax.lines])
    return np.abs(np.asarray(points)[:, None] - drawn[None]).sum(-1).min(1).max()


def test_a_family_is_drawn_in_smooth_parts_of_one_verdict(axes, family):
    pair = axes[0]
    assert plots.branch(family, pair)[0] is pair[0]
    for ax, height in zip(pair, (family.energy, family.amplitude)):
        assert near(ax, np.column_stack([family.omega, height])) < 1e-12  # through every point
        # each part ends at the last point of its verdict: what lies between is dotted, since nobody knows
        ends = [tuple(line.get_xdata()[[0, -1]]) for line in ax.lines]
        np.testing.assert_allclose(
            ends, [(1.0, 0.9), (0.9, 0.8), (0.8, 0.7), (0.7, 0.6), (0.6, 0.6)], rtol=1e-12
        )
        assert [line.get_linestyle() for line in ax.lines] == ["-", ":", "--", ":", "-"]
        tones = [to_hex(line.get_color()) for line in ax.lines]
        assert tones[::2] == [BLUE.lower(), RED.lower(), BLUE.lower()] and tones[1] == tones[3]
        assert labels(ax) == ["stable", "unstable"]
        assert min(len(line.get_xdata()) for line in ax.lines[:4]) > 10
    assert [ax.get_ylabel() for ax in pair] == ["energy", r"amplitude $\max|u_n|$"]


def test_an_event_at_the_last_point_of_a_family_is_drawn(axes, family):
    last = SimpleNamespace(kind="Krein collision", p=0.6, after=4)
    plots.branch(family, axes[0], marks=[last])
    assert [0.6, 0.6] in [list(line.get_xdata()) for line in axes[0][0].lines]


@pytest.mark.parametrize("given", ["marks", "bifurcations", "numbers"])
def test_a_part_ends_at_the_bifurcation_that_was_located(axes, family, given):
    event = lambda kind, p, after: SimpleNamespace(kind=kind, p=p, after=after)
    events = [
        event(*x)
        for x in (
            ("real pair at +1", 0.86, 1),
            ("extremum of energy", 0.83, 1),
            ("Krein collision", 0.63, 3),
        )
    ]
    if given == "bifurcations":
        family.bifurcations = tuple(events)
    marks = {"marks": events, "bifurcations": None, "numbers": [0.86, 0.63]}[given]
    plots.branch(family, axes[0], marks=marks)
    for ax in axes[0]:
        parts = [line for line in ax.lines if len(line.get_xdata()) > 2]
        tops = [line for line in ax.lines if line.get_label() == "extremum of energy"]
        assert [line.get_xdata() for line in tops] == [pytest.approx([0.83], abs=2e-4)] * (
            given != "numbers"
        )
        ends = [line.get_xdata()[[0, -1]] for line in parts]
        np.testing.assert_allclose(ends, [(1.0, 0.86), (0.86, 0.63), (0.63, 0.6)], atol=2e-4)
        assert [line.get_linestyle() for line in parts] == ["-", "--", "-"]
    if given == "marks":
        assert [line.get_xdata()[0] for line in axes[0, 0].lines[4:]] == [0.86, 0.63]
    # two in one step: which of them it is nobody knows
    plots.branch(family, axes[1], marks=[0.86, 0.82, 0.63])
    ends = [line.get_xdata()[[0, -1]] for line in axes[1, 0].lines[:3]]
    np.testing.assert_allclose(ends, [(1.0, 0.86), (0.86, 0.82), (0.82, 0.63)], atol=2e-4)


def test_bands_are_shaded_and_bifurcations_marked(axes, family):
    plots.branch(
        family, axes[0], bands=[[0.0, 0.65], [0.95, 1.2]], marks=[0.75, 0.85], omega_label="f (Hz)"
    )
    for ax in axes[0]:
        np.testing.assert_allclose(spans(ax), [(0.0, 0.65), (0.95, 1.2)], rtol=1e-15)
        marks = [
            line
            for line in ax.lines
            if line.get_linestyle() == ":" and to_hex(line.get_color()) == GREEN.lower()
        ]
        assert [line.get_xdata()[0] for line in marks] == [0.75, 0.85]
        assert labels(ax).count("bifurcation") == 1
        np.testing.assert_allclose(ax.get_xlim(), (0.6 - 0.024, 1.0 + 0.024))
        assert ax.get_xlabel() == "f (Hz)"


# ----------------------------------------------------------------------------------------------------------- hysteresis


@pytest.fixture
def sweep():
    way = lambda *response: SimpleNamespace(response=np.array(response))
    return SimpleNamespace(
        values=np.array([1.0, 2.0, 3.0, 4.0]),
        up=way(1.0, 2.0, 5.0, 6.0),
        down=way(1.0, 4.0, 5.0, 6.0),
        hysteresis=[(1.6, 2.4)],
    )


def test_both_ways_and_what_lies_between(ax, sweep):
    assert plots.hysteresis(sweep, ax, x_label="frequency (Hz)", y_label="rms velocity (m/s)") is ax
    for label, way, colour, mark in (("up", sweep.up, BLUE, ">"), ("down", sweep.down, RED, "<")):
        shown, tone, line = points(ax, label)
        assert_array_equal(shown, np.column_stack([sweep.values, way.response]))
        assert (tone, line.get_marker()) == (colour.lower(), mark)
    np.testing.assert_allclose(spans(ax), [(1.6, 2.4)])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("frequency (Hz)", "rms velocity (m/s)")


def test_orbits_lie_behind_with_unstable_parts_dashed(ax, sweep):
    orbits = SimpleNamespace(
        p=np.array([1.0, 2.4, 1.6, 4.0]),
        response=np.array([1.0, 3.0, 4.0, 6.0]),
        verdict=np.array(["stable", "unstable", "undecided", "stable"]),
    )
    orbits.bifurcations = (
        SimpleNamespace(kind="fold", p=2.45, after=0),
        SimpleNamespace(kind="fold", p=1.55, after=2),
    )
    sweep.up.response, sweep.down.response, orbits.response = (
        1e-3 * x for x in (sweep.up.response, sweep.down.response, orbits.response)
    )
    plots.hysteresis(sweep, ax, orbits=orbits, y_label="force (N)")
    parts = ax.lines[:-2]
    assert [line.get_linestyle() for line in parts] == ["-", "--", ":", ":", "-"]
    assert [parts[i].get_label() for i in (0, 1, 3)] == [
        "orbit, stable",
        "orbit, unstable",
        "orbit, undecided",
    ]
    # stable up to where the curve turns, and unstable from there
    turn = parts[0].get_xydata()[-1]
    np.testing.assert_allclose(turn, [2.4, 3], rtol=1e-12)
    assert_array_equal(parts[1].get_xydata()[0], turn)
    np.testing.assert_allclose(parts[2].get_xydata()[[0, -1]], [[2.4, 3], [1.6, 4]])
    assert max(line.get_zorder() for line in parts) <= min(
        line.get_zorder() for line in ax.lines[-2:]
    )


def test_energies_that_are_alike_fill_the_picture(axes, family):
    family.energy = 1 + 1e-3 * np.array([0.0, 1.0, 3.0, 2.0, 1.0])
    plots.branch(family, axes[0])
    low, high = axes[0, 0].get_ylim()
    assert 0.999 < low < 1 and 1.003 < high < 1.004
    assert axes[0, 1].get_ylim()[0] == 0


def test_a_diagram_gives_the_unit_of_its_label_a_prefix():
    event = SimpleNamespace(kind="fold", p=4.5e4, after=0)
    one = SimpleNamespace(
        p=np.array([4e4, 5e4]),
        amplitude=np.array([1e-9, 3e-9]),
        verdict=["stable", "unstable"],
        bifurcations=(event,),
        units="SI",
    )
    ax = plots.diagram(SimpleNamespace(branches=[one]), label="preload (N)")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("preload (kN)", "max |u| (nm)")
    np.testing.assert_allclose(ax.lines[0].get_xdata(), [40, 50])
    np.testing.assert_allclose(ax.lines[-1].get_xydata(), [[45, 2]])
