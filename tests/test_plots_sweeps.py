"""Pictures of sweeps: one to three parameters, failed lanes, units; made by hand."""

import numpy as np
import pytest
import xarray
from cases import legend
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx

RATIOS = np.linspace(0.1, 1.0, 7)
LOADS = np.geomspace(1.0, 1000.0, 4)
FAILED = "The motion left the law's domain."


def one():
    reason = np.where(np.arange(7) == 2, FAILED, "")
    force = np.where(reason == "", 1e-3 * np.arange(1.0, 8), np.nan)
    verdict = np.array(["stable", "stable", "", "unstable", "unstable", "undecided", "stable"])
    return xarray.Dataset(
        {
            "verdict": ("ratio", verdict),
            "peak_force": ("ratio", force, {"units": "N"}),
            "reason": ("ratio", reason),
            "multipliers": (("ratio", "multipliers_0"), np.exp(1j * np.outer(RATIOS, [1, 2]))),
        },
        {"ratio": RATIOS},
    )


def two(units="N"):
    reason = np.full((7, 4), "", dtype="U40")
    reason[1, 2] = FAILED
    rate = np.where(reason == "", np.outer(RATIOS - 0.5, LOADS), np.nan)
    coords = {"ratio": RATIOS, "load": ("load", LOADS, {"units": units})}
    return xarray.Dataset(
        {
            "rate": (("ratio", "load"), rate, {"units": "1/s"}),
            "reason": (("ratio", "load"), reason),
        },
        coords,
    )


def test_one_parameter_is_a_line_with_gaps_and_bands():
    ax = gx.plots.sweep(one(), bands="verdict")
    x, y = ax.lines[0].get_data()
    assert_allclose(x, RATIOS)
    assert np.isnan(y[2]) and y[3] == pytest.approx(4.0)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("ratio", "peak force (mN)")
    assert {"stable", "unstable", "undecided", "failed: 1 of 7"} == set(legend(ax))
    assert_allclose(ax.lines[-1].get_xdata(), RATIOS[2])
    ends = [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in ax.patches]
    assert_allclose(ends[1], [0.475, 0.775])


def test_words_of_a_second_call_have_labels_of_their_own():
    """Colours follow the words of one call."""
    halves = one().assign(verdict=("ratio", np.array(list("ppppqqq"))))
    ax = gx.plots.sweep(halves, bands="verdict")
    others = halves.assign(verdict=("ratio", np.array(list("qqqqrrr"))))
    gx.plots.sweep(others, ax=ax, bands="verdict")
    assert [patch.get_label() for patch in ax.patches] == ["p", "q", "q", "r"]


def test_errors_are_bars():
    data = one().assign(peak_force_error=("ratio", np.full(7, 2e-4)))
    ax = gx.plots.sweep(data, "peak_force")
    bars = ax.collections[0].get_segments()
    assert_allclose(bars[0][:, 1], [0.8, 1.2])


def test_two_parameters_are_a_map_and_log_spaced_ones_a_log_axis():
    ax = gx.plots.sweep(two("lb"))
    mesh = ax.collections[0]
    assert_allclose(np.ma.filled(mesh.get_array(), np.nan).reshape(4, 7), two().rate.values.T)
    assert (ax.get_xscale(), ax.get_yscale()) == ("linear", "log")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("ratio", "load (lb)")
    edges = mesh.get_coordinates()[:, 0, 1]
    assert_allclose(np.sqrt(edges[1:] * edges[:-1]), LOADS)
    assert mesh.norm.vmin == -mesh.norm.vmax and mesh.colorbar.ax.get_ylabel() == "rate (1/s)"
    assert legend(ax) == ["failed: 1 of 28"]
    assert_allclose(np.ravel(ax.lines[0].get_data()), [RATIOS[1], LOADS[2]])


def test_values_of_a_parameter_as_lines():
    ax = gx.plots.sweep(two(), lines="load")
    assert_allclose(ax.lines[1].get_ydata(), two().rate.values[:, 1])
    assert legend(ax)[:2] == ["load 1 N", "load 10 N"]
    turned = gx.plots.sweep(two(), lines="ratio")
    assert_allclose(turned.lines[3].get_ydata(), two().rate.values[3])
    assert turned.get_xscale() == "log"


BAD = [
    (
        lambda: gx.plots.sweep(one(), "peak_forc"),
        "name: expected one of .* Did you mean 'peak_force'",
    ),
    (
        lambda: gx.plots.sweep(one(), lines="ratio"),
        "lines: expected None, except for a grid of two",
    ),
    (lambda: gx.plots.sweep(two(), bands="verdict"), "bands: expected None"),
    (lambda: gx.plots.sweep(two().expand_dims(mass=[1.0, 2.0])), "data: expected one or two"),
    (
        lambda: gx.plots.sweep(one().peak_force),
        "data: expected a dataset, such as from gx.sweep, got a DataArray. Give the dataset and a",
    ),
]


@pytest.mark.parametrize(("call", "sentence"), BAD, ids=range(len(BAD)))
def test_what_cannot_be_drawn_meets_a_sentence(call, sentence):
    with refused(sentence):
        call()
