"""Pictures of dispersive shocks: edges, waves, modulation, maps, in scaled numbers and in SI."""

from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose

import granjax as gx
from granjax import plots
from granjax.theory import kdv, toda

C, TIME = 0.3, 60.0
NAN = float("nan")


class Seen(NamedTuple):
    """As much of a `Shock` as pictures need, in SI."""

    s: np.ndarray = np.array([0.8e5, 1.0e5])
    m: np.ndarray = np.array([0.2, 0.7])
    means: np.ndarray = np.array([5e-7, 4e-7])
    amplitudes: np.ndarray = np.array([2e-7, NAN])
    wavelengths: np.ndarray = np.array([5.0, 7.0])
    speeds_of_m: np.ndarray = np.array([0.79e5, 1.02e5])
    theory: str = "toda"
    trailing_speed: float = 0.7e5
    leading_speed: float = 1.2e5
    mean: float = 5e-7
    amplitude: float = 9e-7
    ahead: float = 1e-7
    units: str = "SI"


@pytest.fixture(scope="module")
def places():
    return np.arange(100) + 0.5


@pytest.fixture(scope="module")
def strain(places):
    return np.asarray(toda.shock_wave(places, TIME, C).strain)


@pytest.fixture(scope="module")
def run():
    problem = gx.shocks.velocity_shock(gx.scenes.toda(61, boundary="free"), C)
    return problem, problem.run(20.0)


def written(ax):
    return " | ".join(text.get_text().strip() for text in ax.texts)


def test_a_run_knows_its_places_and_its_time(run):
    problem, known = run
    ax = plots.shock(known)
    n, y = ax.lines[0].get_data()
    assert_allclose(y, problem.strain(known.final.u))
    assert_allclose(n, -n[::-1])
    assert ax.get_xlabel().startswith("bond") and ax.get_ylabel() == "strain (scaled)"
    over = plots.shock(known, over="speed").lines[0].get_xdata()
    assert_allclose(over, n / 20.0)
    bare = gx.simulate(*problem, 20.0)
    assert_allclose(plots.shock(bare, problem=problem).lines[0].get_ydata(), y, atol=1e-12)


@pytest.mark.parametrize("over", ["place", "speed"])
def test_edges_mean_and_amplitude_are_where_the_theory_has_them(strain, places, over):
    edges = toda.velocity_shock(C)
    ax = plots.shock(strain, edges, places=places, time=TIME, over=over)
    unit = TIME if over == "place" else 1.0
    assert sorted(line.get_xdata()[0] for line in ax.lines[1:]) == pytest.approx(
        [unit * float(edges.trailing_speed), unit * float(edges.leading_speed)]
    )
    assert written(ax) == "trailing edge | leading edge | mean 0.5247 |  | amplitude 0.94"
    (plateau,) = ax.collections
    assert_allclose(plateau.get_segments()[0][:, 1], float(edges.mean))


def test_a_rarefaction_shock_has_its_crest_below(strain, places):
    ax = plots.shock(-strain, toda.ShockEdges(0.7, 1.2, -0.5, 0.9), places=places, time=TIME)
    arrow = next(text for text in ax.texts if text.arrow_patch is not None)
    assert arrow.xyann[1] == pytest.approx(-0.9)
    # a crest between bonds lies beyond every bond
    ax = plots.shock(-0.5 * strain, toda.ShockEdges(0.7, 1.2, -0.5, 0.9), places=places, time=TIME)
    assert ax.get_ylim()[0] <= -0.9


@pytest.mark.parametrize("quantity", ["m", "mean", "amplitude", "wavelength"])
def test_modulation_beside_a_theory(quantity):
    m = np.linspace(0.0, 1.0, 7)
    theory = kdv.modulation(m, 3e-3, 1e8, 2e13, 1e-2)
    beside = {"KdV": (theory.speed, m) if quantity == "m" else theory}
    ax = plots.modulation(Seen(), quantity=quantity, beside=beside)
    assert len(ax.lines) == 2 + (quantity == "m") and ax.get_xlabel().endswith("(1/ms)")
    assert ("µm" in ax.get_ylabel() or "nm" in ax.get_ylabel()) == (
        quantity in ("mean", "amplitude")
    )
    assert np.all(np.diff(ax.lines[-1].get_xdata()) >= 0)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda y, n: plots.shock(y, over="time"), "over: expected one of"),
        (lambda y, n: plots.shock(y, over="speed"), "time: expected that of the strains"),
        (lambda y, n: plots.shock(y, places=n[:5]), "places: expected 100 rising numbers"),
    ],
)
def test_what_is_refused(strain, places, call, said):
    with pytest.raises(ValueError, match=said):
        call(strain, places)
