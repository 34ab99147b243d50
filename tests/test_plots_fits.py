"""Plots of fits show the numbers of the record that they were given."""

from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import Ellipse
from numpy.testing import assert_allclose

from granjax.plots import COLOURS, fits


class Trace(NamedTuple):
    times: object
    data: object
    sensors: object
    unit: str


class Result(NamedTuple):
    traces: tuple
    signals: tuple
    residuals: tuple
    parameters: dict
    covariance: object
    names: tuple
    units: str = "SI"


def record():
    draw = np.random.default_rng(0).standard_normal
    times = np.linspace(0.0, 1e-3, 30)
    shapes = (30, 2), (30, 1)
    data, signals = [draw(s) for s in shapes], [draw(s) for s in shapes]
    data[0][4, 1] = np.nan
    residuals = [np.where(np.isfinite(d), (s - d) / 0.1, 0.0) for s, d in zip(signals, data)]
    traces = (
        Trace(times, data[0], ["velocity of site 2", "velocity of site 5"], "m/s"),
        Trace(times, data[1], ["force of contact 0"], "N"),
    )
    # deviations 0.2 and 3e8, correlation 0.5
    covariance = [[0.04, 3e7], [3e7, 9e16]]
    return Result(
        traces,
        tuple(signals),
        tuple(residuals),
        {"stiffness": 9.8e9, "damping": 1.7},
        covariance,
        ("damping", "stiffness"),
    )


def test_every_sensor_has_its_data_its_fit_and_its_residuals():
    result = record()
    axes = fits.fit(result)
    assert axes.shape == (2, 3)
    sensors = [(0, 0), (0, 1), (1, 0)]
    for (upper, lower), (k, s) in zip(axes.T, sensors):
        data, fitted = upper.lines
        assert_allclose(data.get_xdata(), 1e3 * result.traces[k].times)
        assert_allclose(data.get_ydata(), result.traces[k].data[:, s])
        assert_allclose(fitted.get_ydata(), result.signals[k][:, s])
        known = np.isfinite(result.traces[k].data[:, s])
        np.testing.assert_array_equal(lower.lines[0].get_ydata(), result.residuals[k][known, s])
        assert (
            upper.get_title() == result.traces[k].sensors[s] and lower.get_xlabel() == "time (ms)"
        )
    assert len(axes[1, 1].lines[0].get_xdata()) == 29
    assert (axes[0, 0].get_ylabel(), axes[0, 2].get_ylabel()) == ("velocity (m/s)", "force (N)")
    assert axes[1, 0].get_ylabel() == r"residual / $\sigma$"


def test_chosen_sensors_go_into_given_axes():
    given = plt.figure().subplots(2, 1)
    axes = fits.fit(record(), given, sensors=[2])
    assert axes.shape == (2, 1) and axes[0, 0] is given[0] and axes[1, 0] is given[1]
    assert given[0].get_title() == "force of contact 0" and given[0].get_ylabel() == "force (N)"


def test_corner_finds_parameters_by_their_names():
    result = record()
    turned = result._replace(names=("stiffness", "damping"), covariance=[[9e16, 3e7], [3e7, 0.04]])
    for parameters in (result.parameters, dict(sorted(result.parameters.items()))):
        axes = fits.corner(turned._replace(parameters=parameters))
        assert axes[0, 0].get_title(loc="center") == r"(9.80 $\pm$ 0.30)$\,10^{9}$"
        assert axes[1, 1].get_title(loc="center") == r"1.70 $\pm$ 0.20"


def test_corner_draws_the_contours_of_the_covariance():
    axes = fits.corner(record(), truths={"stiffness": 9.9e9})
    assert axes.shape == (2, 2) and not axes[0, 1].get_visible()
    assert axes[0, 0].get_title(loc="center") == r"1.70 $\pm$ 0.20"
    assert axes[1, 1].get_title(loc="center") == r"(9.80 $\pm$ 0.30)$\,10^{9}$"
    assert (axes[1, 0].get_xlabel(), axes[1, 0].get_ylabel()) == (
        "damping",
        r"stiffness ($10^{9}$)",
    )
    matrix = np.array([[0.04, 0.03], [0.03, 0.09]])
    outlines = [p for p in axes[1, 0].patches if isinstance(p, Ellipse) and not p.get_fill()]
    for patch, sigma in zip(outlines, (2, 1)):
        points = patch.get_patch_transform().transform(patch.get_path().interpolated(1).vertices)
        # vertices on the curve: every third of the cubic Bezier path
        offsets = points[:-1:3] - [1.7, 9.8]
        assert_allclose(
            np.einsum("ki,ij,kj->k", offsets, np.linalg.inv(matrix), offsets), sigma**2, rtol=1e-9
        )
    (truth,) = [line for line in axes[1, 0].lines if line.get_color() == COLOURS[1]]
    assert_allclose(truth.get_ydata(), 9.9)
    curve = axes[0, 0].lines[0]
    assert_allclose(curve.get_ydata(), np.exp(-0.5 * ((curve.get_xdata() - 1.7) / 0.2) ** 2))


def test_corner_refuses_what_it_cannot_draw():
    blind = record()._replace(covariance=[[np.inf, 0.0], [0.0, 1.0]])
    with pytest.raises(
        ValueError, match="result: expected parameters that the data determine, .* of damping"
    ):
        fits.corner(blind)
