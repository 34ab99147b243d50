"""Plots of fits show the numbers of the record that they were given."""

from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

from granjax.plots import COLOURS, fits

SENSORS = ["velocity of site 2", "velocity of site 5"], ["force of contact 0"]


def result(**other):
    """A record of two velocities and a force; deviations 0.2 and 3e8, correlation 0.5."""
    draw = np.random.default_rng(0).standard_normal
    data, signals = ([draw((30, len(own))) for own in SENSORS] for _ in range(2))
    data[0][4, 1] = np.nan
    traces = [
        SimpleNamespace(times=np.linspace(0.0, 1e-3, 30), data=d, sensors=own, unit=unit)
        for d, own, unit in zip(data, SENSORS, ("m/s", "N"))
    ]
    known = dict(
        traces=traces,
        signals=signals,
        residuals=[np.where(np.isfinite(d), (s - d) / 0.1, 0.0) for s, d in zip(signals, data)],
        parameters={"stiffness": 9.8e9, "damping": 1.7},
        covariance=[[0.04, 3e7], [3e7, 9e16]],
        names=("damping", "stiffness"),
        units="SI",
    )
    return SimpleNamespace(**known | other)


def test_every_sensor_has_its_data_its_fit_and_its_residuals():
    record = result()
    axes = fits.fit(record)
    assert axes.shape == (2, 3)
    for (upper, lower), (k, s) in zip(axes.T, [(0, 0), (0, 1), (1, 0)]):
        trace = record.traces[k]
        data, fitted = upper.lines
        assert_allclose(data.get_xdata(), 1e3 * trace.times)
        assert_allclose(data.get_ydata(), trace.data[:, s])
        assert_allclose(fitted.get_ydata(), record.signals[k][:, s])
        known = np.isfinite(trace.data[:, s])
        assert_array_equal(lower.lines[0].get_ydata(), record.residuals[k][known, s])
        assert upper.get_title() == trace.sensors[s] and lower.get_xlabel() == "time (ms)"
    assert len(axes[1, 1].lines[0].get_xdata()) == 29
    assert (axes[0, 0].get_ylabel(), axes[0, 2].get_ylabel()) == ("velocity (m/s)", "force (N)")
    assert axes[1, 0].get_ylabel() == r"residual / $\sigma$"


def test_chosen_sensors_go_into_given_axes():
    given = plt.figure().subplots(2, 1)
    axes = fits.fit(result(), given, sensors=[2])
    assert axes.shape == (2, 1) and axes[0, 0] is given[0] and axes[1, 0] is given[1]
    assert given[0].get_title() == "force of contact 0"


STIFFNESS = r"(9.80 $\pm$ 0.30)$\,10^{9}$"
DAMPING = r"1.70 $\pm$ 0.20"


def titles(axes):
    return [axes[i, i].get_title(loc="center") for i in (0, 1)]


def test_corner_finds_parameters_by_their_names():
    turned = dict(names=("stiffness", "damping"), covariance=[[9e16, 3e7], [3e7, 0.04]])
    assert titles(fits.corner(result(**turned))) == [STIFFNESS, DAMPING]
    assert titles(fits.corner(result())) == [DAMPING, STIFFNESS]


def test_corner_draws_the_contours_of_the_covariance():
    axes = fits.corner(result(), truths={"stiffness": 9.9e9})
    assert axes.shape == (2, 2) and not axes[0, 1].get_visible()
    below = axes[1, 0]
    assert (below.get_xlabel(), below.get_ylabel()) == ("damping", r"stiffness ($10^{9}$)")
    inverse = np.linalg.inv([[0.04, 0.03], [0.03, 0.09]])
    ellipses = [patch for patch in below.patches if isinstance(patch, Ellipse)]
    for patch, sigma in zip(ellipses, (2, 1), strict=True):
        points = patch.get_patch_transform().transform(patch.get_path().interpolated(1).vertices)
        # vertices on the curve: every third of the cubic Bezier path
        offsets = points[:-1:3] - [1.7, 9.8]
        assert_allclose(np.sum(offsets @ inverse * offsets, 1), sigma**2, rtol=1e-9)
    (truth,) = [line for line in below.lines if line.get_color() == COLOURS[1]]
    assert_allclose(truth.get_ydata(), 9.9)
    curve = axes[0, 0].lines[0]
    assert_allclose(curve.get_ydata(), np.exp(-0.5 * ((curve.get_xdata() - 1.7) / 0.2) ** 2))


def test_corner_refuses_what_it_cannot_draw():
    with refused("result: expected parameters that the data determine, .* of damping"):
        fits.corner(result(covariance=[[np.inf, 0.0], [0.0, 1.0]]))
