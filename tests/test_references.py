"""The maker of the canonical scenes' references, benchmarks/make_references.py."""

import ast
from pathlib import Path

import make_references
import numpy as np
import pytest
import scenes
from pytest import mark
from references import equations, integrators

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"

EXTENDED = np.finfo(np.longdouble).precision >= integrators.FEWEST_DIGITS
extended_only = mark.skipif(not EXTENDED, reason="numpy.longdouble has no more than 15 digits here")


def test_the_makers_numbers_know_nothing_of_the_library():
    for name in ("equations.py", "integrators.py"):
        for node in ast.walk(ast.parse((BENCHMARKS / "references" / name).read_text())):
            if isinstance(node, ast.ImportFrom):
                assert (node.level, node.module) in {(0, "functools"), (0, "granjax.base.checks")}
            if isinstance(node, ast.Import):
                assert [alias.name for alias in node.names] == ["numpy"]


@extended_only
@mark.parametrize("method", [integrators.extrapolation, integrators.collocation])
def test_both_integrators_hold_an_oscillator(method):
    lanes = np.array([[1.0, 3.0]], np.longdouble)

    class Oscillators:
        def __init__(self, omega):
            self.omega = omega

        def of_lanes(self, chosen):
            return Oscillators(self.omega[:, chosen])

        def __call__(self, t, u, v):
            return -(self.omega**2) * u

    u, v = method(Oscillators(lanes), 0, 20, np.ones((1, 2)), np.zeros((1, 2)), 1e-17)
    assert np.abs(u - np.cos(20 * lanes)).max() < 1e-15
    assert np.abs(v / lanes + np.sin(20 * lanes)).max() < 1e-15


@extended_only
@mark.parametrize("method", [integrators.extrapolation, integrators.collocation])
def test_both_integrators_pass_an_opening_contact(method):
    # two equal beads exchange their velocities, whatever the contact
    pair = equations.Chain(equations.hertz, np.ones(2))
    rest = np.zeros((2, 1))
    u, v = method(pair, 0, 10, rest, np.array([[1.0], [0.0]]), 1e-17)
    assert np.abs(v[:, 0] - [0, 1]).max() < 1e-16
    gap = u[1] - u[0]
    _, v = method(pair, 0, gap[0] + 10, u, v[::-1], 1e-17)
    assert np.abs(v[:, 0] - [0, 1]).max() < 1e-16


@extended_only
def test_a_tolerance_below_rounding_is_an_error():
    with pytest.raises(RuntimeError, match="the steps of lane 0 fell to"):
        integrators.collocation(lambda t, u, v: -u, 0, 1, np.ones((1, 1)), np.zeros((1, 1)), 1e-30)


@mark.slow
@extended_only
@mark.parametrize("name", ["toda_soliton", "magnets", "modulated"])
def test_the_cheapest_references_are_made_again(name):
    made = make_references.make(name)
    kept = scenes.read(name)
    for x, y in zip(made, kept):
        if isinstance(x, np.ndarray):
            assert np.abs(x - y).max() <= 4e-16 * np.abs(y).max()
    assert made.uncertainty < 10 * kept.uncertainty and made.t1 == kept.t1


def test_the_maker_writes_what_is_read(tmp_path):
    data = scenes.Stored(
        u=np.arange(3.0), v=np.ones(3), t1=2.0, uncertainty=1e-15, growth=3.0, method="x", date="y"
    )
    path = make_references.write(tmp_path, "one", data)
    with np.load(path) as file:
        assert set(file.files) == {"u", "v", "t1", "uncertainty", "growth", "method", "date"}
    u, v = scenes.unfolded(data, 10)
    assert (u == [-2, -2, -2, -1, 0, 0, 1, 2, 2, 2]).all()
    assert (v == [-1] * 5 + [1] * 5).all()
