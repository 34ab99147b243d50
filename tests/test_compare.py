"""Models ranked by what traces of another integrator and right-hand side say."""

import numpy as np
from cases import by_dop853
from pytest import mark
from scipy.stats import chi2

import granjax as gx

N = 20
SPEED = 0.3
SENSORS = [2, 7, 12, 17]
TIMES = np.linspace(0.1, 40, 400)
CONTACTS = gx.Shift(1, "fixed")
STATE = gx.State(np.zeros(N), np.r_[SPEED, np.zeros(N - 1)])


def on_site(parameters):
    contacts = gx.Bond(CONTACTS, gx.Hertz(parameters["stiffness"], 1.0))
    return gx.Lattice(1.0, (contacts, gx.Damping(parameters["damping"])), sites=N)


def dashpot(parameters):
    contacts = gx.Bond(CONTACTS, gx.Hertz(parameters["stiffness"], 1.0))
    return gx.Lattice(1.0, (contacts, gx.Dashpot(CONTACTS, parameters["coefficient"])), sites=N)


MODELS = {
    "on-site": (on_site, {"stiffness": 1.1, "damping": 0.02}),
    "dashpot": (dashpot, {"stiffness": 1.1, "coefficient": 0.02}),
}


def measured(damping=0.0, dashpot=0.0):
    """Velocities (T, sensors) by SciPy's DOP853."""
    path, _ = by_dop853(SPEED, TIMES[-1], damping, dashpot)
    return path(TIMES)[N:][SENSORS].T


def traces(velocity, seed, share=0.01, known=True):
    sigma = share * np.abs(velocity).max()
    made = velocity + sigma * np.random.default_rng(seed).normal(size=velocity.shape)
    return gx.Traces(TIMES, velocity=made, sites=SENSORS, sigma=sigma if known else None)


def ranked(traces):
    """(BIC, name, fit) of both models, the least first."""
    known = traces.sigma is not None
    found = []
    for name, (scene, start) in MODELS.items():
        fit = gx.fit(scene, start, traces, state=STATE, throw=False)
        n = fit.samples
        chi_square = fit.chi_square
        # where the noise is not known it is one more unknown of every model
        deviance = chi_square if known else n * np.log(chi_square * fit.noise**2 / n)
        found.append((deviance + len(fit.names) * np.log(n), name, fit))
    return sorted(found, key=lambda one: one[0])


@mark.slow
@mark.parametrize("truth", MODELS)
def test_dissipation_is_told_apart(truth):
    """Under 1 % of noise, at a rate of 0.005: BIC differs by more than 10 (in all of 20 draws)."""
    clean = measured(damping=0.005) if truth == "on-site" else measured(dashpot=0.005)
    for draw in range(2):
        (bic, best, fit), (other, *_) = ranked(traces(clean, draw))
        assert best == truth and other - bic > 10 and fit.converged
        for name, found in fit.parameters.items():
            off = abs(found - (1.0 if name == "stiffness" else 0.005))
            assert off < 4 * fit.deviations[name]


@mark.slow
def test_where_the_data_do_not_decide_and_where_no_model_describes_them():
    (bic, *_), (other, *_) = ranked(traces(measured(), 0, 0.1))
    assert other - bic < 10
    # neither kind alone describes both together; without sigma that cannot be seen
    both = measured(damping=0.05) + measured(dashpot=0.05) - measured()
    _, best, fit = ranked(traces(both, 0))[0]
    assert chi2.sf(fit.chi_square, fit.samples - 2) < 0.01
    assert ranked(traces(both, 0, known=False))[0][1] == best
