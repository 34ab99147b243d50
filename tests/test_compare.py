"""Models ranked by what traces of another integrator and right-hand side say."""

import numpy as np
import pytest
from cases import by_dop853

import granjax as gx
from granjax.identify.compare import compare

N, SPEED, SENSORS = 20, 0.3, [2, 7, 12, 17]
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


@pytest.mark.study
def test_dissipation_is_told_apart():
    """Under 1 % of noise in all of 20 draws, half of each kind, at a rate of 0.005."""
    clean = dict(zip(MODELS, (measured(damping=0.005), measured(dashpot=0.005))))
    for draw in range(20):
        truth = list(MODELS)[draw % 2]
        found = compare(MODELS, traces(clean[truth], draw), state=STATE)
        assert found.best == truth and found.decided and found.weights[0] > 0.99
        assert found.outcome.startswith(f"The data speak for '{truth}'")
        parameters, deviations = found.fits[truth].parameters, found.fits[truth].deviations
        assert all(
            abs(parameters[name] - dict(stiffness=1.0).get(name, 0.005)) < 4 * deviations[name]
            for name in parameters
        )


@pytest.mark.study
def test_where_the_data_do_not_decide_and_where_no_model_describes_them():
    lossless = compare(MODELS, traces(measured(), 0, 0.1), state=STATE)
    assert not lossless.decided and lossless.outcome.startswith("The data do not decide")
    # neither kind alone describes both together; without sigma that cannot be seen
    both = measured(damping=0.05) + measured(dashpot=0.05) - measured()
    found = compare(MODELS, traces(both, 0), state=STATE)
    assert (
        found.probability < 0.01
        and f"Even '{found.best}' does not describe the data" in found.outcome
    )
    unknown = compare(MODELS, traces(both, 0, known=False), state=STATE)
    assert (
        np.isnan(unknown.probability)
        and "Even" not in unknown.outcome
        and unknown.best == found.best
    )
    kept = found.to_xarray()
    assert kept.model.values.tolist() == list(found.names) and kept.bic.dims == ("model",)
    # AIC and BIC by hand
    n = TIMES.size * len(SENSORS)
    for name, chi_square, aic, bic in zip(found.names, found.chi_square, found.aic, found.bic):
        np.testing.assert_allclose(
            [chi_square, aic - chi_square, bic - chi_square],
            [found.fits[name].chi_square, 4.0, 2 * np.log(n)],
            rtol=1e-10,
        )
    squares = [
        np.sum(
            (np.asarray(unknown.fits[k].signals[0]) - np.asarray(unknown.fits[k].traces[0].data))
            ** 2
        )
        for k in unknown.names
    ]
    np.testing.assert_allclose(unknown.margin, n * np.log(squares[1] / squares[0]), rtol=1e-8)


@pytest.mark.parametrize(
    "bad, word",
    [
        (dict(options={"c": {}}), "options"),
        (dict(level=0.0), "level"),
    ],
)
def test_bad_input_is_refused(bad, word):
    good = dict(models=MODELS, traces=traces(np.ones((400, 4)), 0), state=STATE)
    with pytest.raises(ValueError, match=word):
        compare(**(good | bad))
