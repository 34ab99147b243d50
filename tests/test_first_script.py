"""The first script of a new user: beads of steel and aluminium from radii and a load, in SI from end to end.

No number of it is scaled, and none is a tolerance.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx

RADIUS, LOAD = 9.53e-3, 10.0  # m, N
WAVES = np.linspace(0.1, np.pi, 7)
METALS = ["aluminium 6061-T6", "steel 316"]


def by_hand():
    """Bands in kHz, omega^2 = K (s -+ sqrt(s^2 - 4 sin^2(k/2)/(m M))), s = 1/m + 1/M, K = 3/2 A^(2/3) F0^(1/3)."""
    bodies = [gx.materials.material(name) for name in METALS]
    light, heavy = (4 / 3 * np.pi * RADIUS**3 * float(x.density) for x in bodies)
    compliance = sum((1 - float(x.poisson) ** 2) / float(x.young) for x in bodies)
    stiffness = 1.5 * (4 / 3 / compliance * np.sqrt(RADIUS / 2)) ** (2 / 3) * LOAD ** (1 / 3)
    both = 1 / light + 1 / heavy
    split = np.sqrt(both**2 - 4 * np.sin(WAVES / 2) ** 2 / (light * heavy))
    return np.sqrt(stiffness * np.stack([both - split, both + split], -1)) / (2 * np.pi) / 1e3


@pytest.mark.slow
def test_waves_and_breathers_of_a_dimer_in_si():
    chain = gx.scenes.beads(METALS * 3 + METALS[:1], RADIUS, LOAD, boundary="free")
    kilohertz = np.asarray(gx.linear.dispersion(chain, WAVES).omega) / (2 * np.pi) / 1e3
    np.testing.assert_allclose(kilohertz, by_hand(), rtol=1e-9)
    ((_, high),) = gx.linear.bands(chain).gaps
    family = gx.breathers.family(chain, until=0.99 * high)
    assert "reached" in family.outcome and family.omega[-1] == 0.99 * high
    assert family.verdict[0] == "stable" and family.amplitude.max() > 1e-7
    gx.plots.branch(family)


@pytest.mark.slow
def test_a_shaken_pair_in_si_has_two_folds_and_a_hysteresis():
    pair = gx.scenes.beads(METALS[::-1], RADIUS, LOAD)

    def shaken(frequency):
        return gx.driven.driven_chain(pair, 60e-9, 2 * jnp.pi * frequency, damping=1000.0)

    def period(frequency):
        return 1 / frequency

    branch = gx.forced.forced_branch(shaken, 4480.0, 3950.0, period=period)
    assert [x.kind for x in branch.bifurcations] == ["fold", "fold"]
    assert {"stable", "unstable"} <= set(branch.verdict) and "reached" in branch.outcome
    sweep = gx.driven.response(shaken, [3990.0, 4030.0, 4070.0], period)
    ((low, high),) = sweep.hysteresis
    folds = sorted(x.p for x in branch.bifurcations)
    assert low < folds[1] and high > folds[0] and sweep.up.multiple.all()
    labels = {"x_label": "frequency (Hz)", "y_label": "velocity (m/s)"}
    diagram = gx.plots.hysteresis(sweep, orbits=branch, **labels)
    assert "orbit, unstable" in [line.get_label() for line in diagram.lines]
