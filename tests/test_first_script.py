"""The first script of a new user: beads of steel and aluminium from radii and a load, in SI from end to end.

No number of it is scaled, and none is a tolerance.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx

pytestmark = pytest.mark.study
RADIUS, LOAD = 9.53e-3, 10.0  # m, N
WAVES = np.linspace(0.1, np.pi, 7)


class Study(NamedTuple):
    """What the script finds."""

    waves: object
    gap: tuple
    family: object
    branch: object
    sweep: object


def script():
    chain = gx.scenes.beads(
        ["aluminium 6061-T6", "steel 316"] * 3 + ["aluminium 6061-T6"],
        RADIUS,
        LOAD,
        boundary="free",
    )
    waves = gx.linear.dispersion(chain, WAVES)
    (gap,) = gx.linear.bands(chain).gaps
    family = gx.breathers.family(chain, until=0.99 * gap[1])

    pair = gx.scenes.beads(["steel 316", "aluminium 6061-T6"], RADIUS, LOAD)

    def shaken(frequency):
        return gx.driven.driven_chain(pair, 60e-9, 2 * jnp.pi * frequency, damping=1000.0)

    def period(frequency):
        return 1 / frequency

    branch = gx.forced.forced_branch(shaken, 4480.0, 3950.0, period=period)
    sweep = gx.driven.response(shaken, [3990.0, 4030.0, 4070.0], period)
    return Study(waves, gap, family, branch, sweep)


def by_hand():
    """Bands in kHz, omega^2 = K (s -+ sqrt(s^2 - 4 sin^2(k/2)/(m M))), s = 1/m + 1/M, K = 3/2 A^(2/3) F0^(1/3)."""
    bodies = [gx.materials.material(name) for name in ("aluminium 6061-T6", "steel 316")]
    light, heavy = (4 / 3 * np.pi * RADIUS**3 * float(x.density) for x in bodies)
    compliance = sum((1 - float(x.poisson) ** 2) / float(x.young) for x in bodies)
    stiffness = 1.5 * (4 / 3 / compliance * np.sqrt(RADIUS / 2)) ** (2 / 3) * LOAD ** (1 / 3)
    both = 1 / light + 1 / heavy
    split = np.sqrt(both**2 - 4 * np.sin(WAVES / 2) ** 2 / (light * heavy))
    return np.sqrt(stiffness * np.stack([both - split, both + split], -1)) / (2 * np.pi) / 1e3


@pytest.fixture(scope="module")
def si():
    return script()


def test_a_new_user_s_script_in_si(si):
    kilohertz = np.asarray(si.waves.omega) / (2 * np.pi) / 1e3
    np.testing.assert_allclose(kilohertz, by_hand(), rtol=1e-9)
    assert "reached" in si.family.outcome and si.family.omega[-1] == 0.99 * si.gap[1]
    assert si.family.verdict[0] == "stable" and si.family.amplitude.max() > 1e-7
    assert [x.kind for x in si.branch.bifurcations] == ["fold", "fold"]
    assert {"stable", "unstable"} <= set(si.branch.verdict) and "reached" in si.branch.outcome
    ((low, high),) = si.sweep.hysteresis
    folds = sorted(x.p for x in si.branch.bifurcations)
    assert low < folds[1] and high > folds[0] and si.sweep.up.multiple.all()
    diagram = gx.plots.hysteresis(
        si.sweep, orbits=si.branch, x_label="frequency (Hz)", y_label="velocity (m/s)"
    )
    assert "orbit, unstable" in [line.get_label() for line in diagram.lines]
    gx.plots.branch(si.family)
