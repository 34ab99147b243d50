"""Pictures of states of rest and what evolves show the numbers of their results, with units."""

from types import SimpleNamespace

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402

import granjax as gx  # noqa: E402
from granjax import plots  # noqa: E402


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def labels(ax):
    return ax.get_xlabel(), ax.get_ylabel()


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


def test_an_equilibrium_with_loads_on_sites_and_ends():
    found = SimpleNamespace(
        state=(np.array([0.0, 2e-8, 1e-8]), np.zeros(3)),
        loads=np.array([3.0, 0.0, -2.0]),
        ends=np.array([3.0, 2.0]),
        verdict="stable",
        units="SI",
    )
    rest, held = plots.equilibrium(found)
    assert labels(rest) == ("site $n$", "displacement $u_n$ (nm)") and labels(held)[1] == "load (N)"
    np.testing.assert_allclose(rest.lines[0].get_ydata(), [0, 20, 10])
    assert [bar.get_height() for bar in held.patches] == [3, 0, -2]
    np.testing.assert_allclose(held.lines[0].get_data(), [[-1, 3], [3, 2]])
    plane = SimpleNamespace(
        state=(np.ones((3, 2)), None), loads=np.ones((3, 2)), ends=None, verdict="stable"
    )
    assert len(plots.equilibrium(plane)[0].get_legend().get_texts()) == 2
    bead = {"bead": np.ones(3)}
    fields = SimpleNamespace(state=(bead, None), loads=bead, ends=None, verdict="saddle")
    np.testing.assert_array_equal(
        plots.equilibrium(fields, field="bead")[0].lines[0].get_ydata(), 1.0
    )


def test_an_evolution_shows_densities_and_what_is_kept():
    psi = np.random.default_rng(0).normal(size=(3, 5))
    run = SimpleNamespace(
        ts=np.array([0.0, 1e-3, 2e-3]),
        densities=psi**2,
        norm=np.array([4.0, 4.0, 4.4]),
        energy=np.array([0.0, 1e-9, -2e-9]),
        error=np.array([0.0, 1e-6, 4e-6]),
        norm_error=0.1,
        energy_error=1e-8,
    )
    for scale in ("linear", "log"):
        shown, known = plots.evolution(run, scale=scale, units="ms")
        assert labels(shown) == ("site", "time (ms)") and labels(known) == (
            "time (ms)",
            "relative change, error",
        )
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
