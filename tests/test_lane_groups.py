"""Batches with a fixed step: some lanes at a time give what all of them together give."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx

SITES, LANES, END = 6, 11, 3.0
# a program of its own each time: the same scene, and another bound on the steps
BOUNDS = {0: 900, 4: 901}


def scene(ratio, precompression=0.3):
    chain = gx.scenes.dimer(SITES, ratio=ratio, precompression=precompression, boundary="free")
    return more(
        chain, gx.Damping(0.01), gx.Wall(gx.Hertz(precompression=precompression), side="left")
    )


def more(chain, *terms):
    return gx.Lattice(chain.mass, (*chain.terms, *terms))


@pytest.fixture
def by(monkeypatch):
    """A run with so many lanes at a time, 0 for all of them together."""

    def run(width, lattice, state, **how):
        monkeypatch.setattr("granjax.flow.lanes.lanes_abreast", lambda: width)
        monkeypatch.setattr("granjax.flow.lanes.FILLING", 1.0)
        return gx.simulate(lattice, state, END, step=0.05, max_steps=BOUNDS[width], **how)

    return run


def batch(make=scene, lanes=LANES):
    ratios = jnp.linspace(0.3, 1.0, np.prod(lanes)).reshape(lanes)
    for _ in ratios.shape:
        make = jax.vmap(make, out_axes=-1)
    lattice = make(ratios)
    u = jnp.asarray(np.random.default_rng(1).uniform(-0.2, 0.2, lattice.zeros().shape))
    return lattice, gx.State(u, 0.1 * u[::-1])


FROM_LANE_TO_LANE = {"p": gx.Peak(lambda t, y, lattice: y.u - y.u.mean(-1, keepdims=True))}


@pytest.mark.study
@pytest.mark.parametrize(
    ("lanes", "how"),
    [
        pytest.param(LANES, {"save_at": 4}, id="frames as many as lanes at a time"),
        pytest.param(
            (3, 4), {"save_at": jnp.array([1.0, 2.2])}, id="two axes", marks=pytest.mark.study
        ),
        pytest.param(
            LANES, {"record": FROM_LANE_TO_LANE}, id="from lane to lane", marks=pytest.mark.slow
        ),
    ],
)
def test_groups_are_all_lanes_together(by, lanes, how):
    lattice, state = batch(lanes=lanes)
    together, grouped = (by(width, lattice, state, **how) for width in BOUNDS)
    for a, b in zip(*map(jax.tree.leaves, (together, grouped)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14)
    assert together.outcome == grouped.outcome and together.opening == grouped.opening


@pytest.mark.slow
@pytest.mark.parametrize("mode", [jax.jvp, jax.vjp])
def test_derivatives_in_both_modes(by, mode):
    def end(width, u, precompression):
        lattice = jax.vmap(lambda r: scene(r, precompression), out_axes=-1)(
            jnp.linspace(0.3, 1.0, LANES)
        )
        return by(width, lattice, gx.State(u, 0 * u)).final.u

    _, state = batch()
    at, found = (state.u, 0.3), []
    for width in BOUNDS:
        function = lambda *x, width=width: end(width, *x)
        along = (
            jax.jvp(function, at, (state.v, 1.0))[1]
            if mode is jax.jvp
            else jax.vjp(function, *at)[1](state.v)
        )
        found.append(along)
    for a, b in zip(*map(jax.tree.leaves, found), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12 * np.abs(a).max())


@pytest.mark.study
def test_a_lane_that_fails_says_so_for_all(by):
    magnets = lambda r: gx.Lattice(
        jnp.full(SITES, r), (gx.Bond(gx.Shift(1, "fixed"), gx.PowerLaw(1.0, -3.0, 1.0)),)
    )
    lattice, state = batch(magnets)
    u = state.u.at[2, 5].set(3.0)
    runs = [by(width, lattice, gx.State(u, state.v), throw=False) for width in BOUNDS]
    assert runs[0].outcome == runs[1].outcome
    assert "Magnets met in bond 3 of terms[0] near t = 0 of lane 5" in runs[0].outcome
    np.testing.assert_allclose(runs[0].final.u, runs[1].final.u, rtol=1e-12)


def test_terms_of_the_users_own_see_all_lanes(by):
    class Mean(gx.terms.Term):
        """A force towards the mean of all lanes: what no lane knows alone."""

        strength: jax.Array = eqx.field(converter=jnp.asarray)

        def force(self, t, u, v, mass):
            return self.strength * (u.mean(-1, keepdims=True) - u)

        def energy(self, t, u):
            return jnp.zeros(u.shape[1:])

    lattice, state = batch(lambda r: more(scene(r), Mean(0.2)))
    a, b = (by(width, lattice, state).final.u for width in BOUNDS)
    np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14)
