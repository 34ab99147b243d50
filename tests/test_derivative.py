"""The derivative of a run with its error: smooth forces, kinks, what cannot be meant."""

import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx


def struck(p, step):
    """Where the end of three beads is, by stiffness: contacts without preload that are straight lines, with a kink."""
    chain = gx.scenes.monomer(3, stiffness=p["stiffness"], exponent=1.0, boundary="free")
    return gx.simulate(chain, gx.states.impact(chain), 6.0, step=step).final.u[1:]


def shaken(stiffness, step):
    chain = gx.scenes.monomer(3, stiffness=stiffness, precompression=1.0)
    return gx.simulate(chain, gx.states.impact(chain, velocity=0.1), 6.0, step=step).final.u[1]


@pytest.mark.study
def test_a_kink_shows():
    """Against differences of runs at a fine step, whose error is of second order: within the error, which is large."""
    largest = 0.0
    for A in np.linspace(0.7, 1.4, 8):
        found = gx.derivative(struck, {"stiffness": A}, 0.3)
        ends = [struck({"stiffness": jnp.asarray(A + d)}, 0.002) for d in (1e-3, -1e-3)]
        missed = np.abs(found.value["stiffness"] - (ends[0] - ends[1]) / 2e-3)
        assert (missed <= found.error["stiffness"]).all()
        largest = max(largest, float(np.max(missed / np.abs(found.value["stiffness"]))))
        assert found.slopes["stiffness"].shape == (6, 2) and "kink" in found.outcome
    assert largest > 0.02


@pytest.mark.slow
def test_a_smooth_derivative_is_known():
    found = gx.derivative(shaken, 1.3, 0.2)
    fine = gx.derivative(shaken, 1.3, 0.02)
    assert abs(float(found.value - fine.value)) <= float(found.error) < 1e-7
    assert found.relative < 1e-5 and found.outcome.startswith("The derivative is known to")
    assert "kink" not in repr(found) and float(fine.error) < 1e-12


def test_what_has_no_derivative_is_refused():
    with pytest.raises(ValueError, match="function: expected a function"):
        gx.derivative(3.0, 1.0, 0.1)
    with pytest.raises(ValueError, match="step: expected numbers above zero"):
        gx.derivative(shaken, 1.0, 0.0)


FACTOR = 1.0


def test_what_the_function_reads_counts_as_it_stands(monkeypatch):
    function = lambda x, step: FACTOR * x**2 * step**0
    assert gx.derivative(function, 3.0, 0.1).value == pytest.approx(6.0)
    monkeypatch.setitem(globals(), "FACTOR", 2.0)
    assert gx.derivative(function, 3.0, 0.1).value == pytest.approx(12.0)
