"""Pictures of dispersive shocks and of travelling waves, in scaled numbers and in SI."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx
from granjax import plots
from granjax.theory import kdv, toda

C = 0.3
TIME = 60.0
# as much of a `Shock` as pictures need, in SI
SEEN = SimpleNamespace(
    s=np.array([0.8e5, 1.0e5]),
    m=np.array([0.2, 0.7]),
    means=np.array([5e-7, 4e-7]),
    amplitudes=np.array([2e-7, np.nan]),
    wavelengths=np.array([5.0, 7.0]),
    speeds_of_m=np.array([0.79e5, 1.02e5]),
    theory="toda",
    units="SI",
)
PLACES = np.arange(100) + 0.5
STRAIN = np.asarray(toda.shock_wave(PLACES, TIME, C).strain)


@pytest.mark.slow
def test_a_run_knows_its_places_and_its_time():
    problem = gx.shocks.velocity_shock(gx.scenes.toda(61, boundary="free"), C)
    known = problem.run(20.0)
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
def test_edges_mean_and_amplitude_are_where_the_theory_has_them(over):
    edges = toda.velocity_shock(C)
    ax = plots.shock(STRAIN, edges, places=PLACES, time=TIME, over=over)
    unit = TIME if over == "place" else 1.0
    drawn = sorted(line.get_xdata()[0] for line in ax.lines[1:])
    assert_allclose(drawn, [unit * edges.trailing_speed, unit * edges.leading_speed], rtol=1e-6)
    written = [text.get_text().strip() for text in ax.texts]
    assert written == ["trailing edge", "leading edge", "mean 0.5247", "", "amplitude 0.94"]
    (plateau,) = ax.collections
    assert_allclose(plateau.get_segments()[0][:, 1], float(edges.mean))


def test_a_rarefaction_shock_has_its_crest_below():
    edges = toda.ShockEdges(0.7, 1.2, -0.5, 0.9)
    ax = plots.shock(-STRAIN, edges, places=PLACES, time=TIME)
    arrow = next(text for text in ax.texts if text.arrow_patch is not None)
    assert arrow.xyann[1] == pytest.approx(-0.9)
    # a crest between bonds lies beyond every bond
    ax = plots.shock(-0.5 * STRAIN, edges, places=PLACES, time=TIME)
    assert ax.get_ylim()[0] <= -0.9


@pytest.mark.parametrize("quantity", ["m", "mean", "amplitude", "wavelength"])
def test_modulation_beside_a_theory(quantity):
    m = np.linspace(0.0, 1.0, 7)
    theory = kdv.modulation(m, 3e-3, 1e8, 2e13, 1e-2)
    beside = {"KdV": (theory.speed, m) if quantity == "m" else theory}
    ax = plots.modulation(SEEN, quantity=quantity, beside=beside)
    assert len(ax.lines) == 2 + (quantity == "m") and ax.get_xlabel().endswith("(1/ms)")
    assert ("m)" in ax.get_ylabel()) == (quantity in ("mean", "amplitude"))
    assert np.all(np.diff(ax.lines[-1].get_xdata()) >= 0)


def test_a_modulation_without_the_quantity_is_refused():
    whitham = SimpleNamespace(s=SEEN.s, means=SEEN.means)
    plots.modulation(SEEN, quantity="mean", beside={"Whitham": whitham})
    with refused("Whitham.*expected a result with m,"):
        plots.modulation(SEEN, beside={"Whitham": whitham})
    unknown = SimpleNamespace(s=SEEN.s, m=np.full(len(SEEN.s), np.nan), outcome="Not compared.")
    with refused("shock: expected one with m, got none: Not compared. Draw another quantity"):
        plots.modulation(unknown)


@pytest.mark.slow
def test_a_wave_its_slope_and_its_contacts():
    wave = gx.travelling.solitary_wave(gx.Toda(), speed=np.sinh(1.0))
    other = toda.soliton(wave.xi, 0.0, 1.0).strain
    ax = plots.wave(wave, beside={"Toda": other})
    strain, slope, beside, nodes = ax.lines
    assert_allclose(strain.get_ydata(), beside.get_ydata(), atol=1e-12)
    numeric = np.gradient(strain.get_ydata(), strain.get_xdata())
    assert_allclose(slope.get_ydata(), numeric, atol=2e-2)
    assert_allclose(nodes.get_ydata(), wave.strain(nodes.get_xdata()), rtol=1e-12)
    assert set(np.diff(nodes.get_xdata())) == {1.0} and ax.get_ylabel().startswith("strain")


@pytest.mark.slow
def test_a_wave_in_si_has_units():
    bond = gx.Bond(gx.Shift(1, "free"), gx.Toda(2e-2, 1e5))
    chain = gx.Lattice(3e-3, bond, sites=12, units="SI")
    wave = gx.travelling.solitary_wave(chain, speed=1.1 * float(gx.linear.sound_speed(chain)))
    ax = plots.wave(wave)
    assert wave.units == "SI" and ax.get_ylabel() == "strain (µm)"
    assert_allclose(ax.lines[0].get_ydata().max(), 1e6 * float(wave.amplitude), rtol=1e-6)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: plots.shock(STRAIN, over="time"), "over: expected one of"),
        (lambda: plots.shock(STRAIN, over="speed"), "time: expected that of the strains"),
        (lambda: plots.shock(STRAIN, places=PLACES[:5]), "places: expected 100 rising numbers"),
    ],
)
def test_what_is_refused(call, said):
    with refused(said):
        call()
