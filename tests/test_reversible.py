"""Derivatives of runs: forward mode, checkpoints, integrating backwards; against differences on every scene."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DISTINCT, SPLITTING, few, random_like
from jax.flatten_util import ravel_pytree
from refusals import refused

import granjax as gx
from granjax.terms.reach import reads

STEP = 0.05
# of order 6: the error of the difference is 1e-12 of the function's size at this width
WIDTH = 1e-2
CENTRAL = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}


def splits(lattice):
    return all(
        isinstance(term, gx.Damping) for term in lattice.terms if reads(term, lattice).velocity
    )


def seen(run):
    """A number in which everything that was saved has a part, between steps too."""
    parts = [run.us, run.vs, run.final]
    return sum(jnp.sum(jnp.sin(x + 0.3 * k)) for k, x in enumerate(jax.tree.leaves(parts)))


def function(lattice, state, solver=None, steps=40, **how):
    """f(z) of one run, z all floating parameters and the state; and the z of the scene."""
    free, fixed = eqx.partition((lattice, state), eqx.is_inexact_array)
    flat, unravel = ravel_pytree(free)

    def f(z, adjoint=None):
        chain, start = eqx.combine(unravel(z), fixed)
        t1 = steps * STEP
        save_at = jnp.asarray([0.0, 0.31, 0.32, 0.5, 1.0]) * t1
        own = solver or (gx.SRKN11b() if splits(lattice) else diffrax.Tsit5())
        return seen(
            gx.simulate(
                chain,
                start,
                t1,
                solver=own,
                step=STEP,
                save_at=save_at,
                adjoint=adjoint,
                throw=False,
                **how,
            )
        )

    return f, flat


def moving(lattice, size=0.02):
    return gx.State(*(random_like(lattice.template(), seed, size) for seed in (1, 2)))


def differences(both, z, d):
    """The derivative along d of a function that gives its value and that derivative."""
    return (
        sum(
            w * (both(z + k * WIDTH * d, d)[0] - both(z - k * WIDTH * d, d)[0])
            for k, w in CENTRAL.items()
        )
        / WIDTH
    )


@pytest.mark.study
@pytest.mark.parametrize(
    "case", few(DISTINCT, *range(0, len(DISTINCT), 4)), ids=lambda case: case.name
)
def test_every_scene_has_derivatives_in_both_modes(case):
    f, z = function(case.lattice, moving(case.lattice), steps=20)
    d = 0.02 * z * np.random.default_rng(3).uniform(-1, 1, z.shape)
    both = jax.jit(lambda z, d: jax.jvp(lambda z: f(z, diffrax.ForwardMode()), (z,), (d,)))
    _, forward = both(z, d)
    adjoint = gx.Reversible() if splits(case.lattice) else diffrax.RecursiveCheckpointAdjoint()
    gradient, back = eqx.filter_jit(eqx.filter_grad(lambda both: f(*both)))((z, adjoint))
    if splits(case.lattice):
        assert back.return_error < 1e-12
    assert float(gradient @ d) == pytest.approx(float(forward), rel=1e-9, abs=1e-13)
    assert float(forward) == pytest.approx(float(differences(both, z, d)), rel=1e-6, abs=1e-9)


@pytest.mark.study
@pytest.mark.parametrize("solver", few(SPLITTING, 0, 2), ids=lambda s: s.__name__)
def test_every_splitting_method_is_undone(solver):
    chain = gx.scenes.dimer(6, ratio=0.5, precompression=1.0)
    f, z = function(chain, moving(chain), solver=solver(), steps=20)
    gradient = jax.grad(f)(z, gx.Reversible())
    forward = jax.jit(jax.jacfwd(lambda z: f(z, diffrax.ForwardMode())))(z)
    assert np.allclose(gradient, forward, rtol=1e-9, atol=1e-12)


@pytest.mark.study
def test_integrating_backwards_in_a_batch_and_the_return_error():
    chains = jax.vmap(lambda r: gx.scenes.dimer(6, ratio=r, precompression=1.0), out_axes=-1)(
        jnp.array([0.5, 0.8])
    )

    def f(scale, adjoint):
        state = gx.State(chains.zeros(), chains.zeros().at[0].set(scale))
        return jnp.sum(
            gx.simulate(chains, state, 4.0, step=STEP, adjoint=adjoint, throw=False).final.u ** 2,
            axis=0,
        )

    def loss(scale, adjoint):
        return jnp.sum(f(scale, adjoint) * jnp.array([1.0, 2.0]))

    scale = jnp.array([0.1, 0.2])
    gradient, back = jax.grad(loss, (0, 1))(scale, gx.Reversible())
    forward = jax.jacfwd(lambda x: loss(x, diffrax.ForwardMode()))(scale)
    assert np.allclose(gradient, forward, rtol=1e-11)
    assert 0 < back.return_error < 1e-13
    # the same number asked for directly
    chain, state = gx.scenes.dimer(6, ratio=0.5, precompression=1.0), None
    state = gx.states.impact(chain, 0.1)
    assert 0 < gx.flow.return_error(chain, state, 0.0, 4.0, 80, gx.SRKN11b()) < 1e-13


def precompressed(stiffness, adjoint, steps):
    chain = gx.scenes.monomer(30, stiffness=stiffness, precompression=1.0)
    run = gx.simulate(
        chain, gx.states.impact(chain, 0.3), 0.15 * steps, step=0.15, adjoint=adjoint, throw=False
    )
    return jnp.sum(run.final.u**2) + jnp.sum(run.final.v[::2])


def memory(function, *arguments):
    """Bytes of working memory of a compiled function, beside what it is given and returns."""
    return jax.jit(function).lower(*arguments).compile().memory_analysis().temp_size_in_bytes


@pytest.mark.study
def test_integrating_backwards_keeps_nothing_of_a_long_run():
    gradients = {
        n: jax.grad(lambda A, adjoint, n=n: precompressed(A, adjoint, n), (0, 1))
        for n in (1000, 100_000)
    }
    kept = {n: memory(gradient, 1.0, gx.Reversible()) for n, gradient in gradients.items()}
    assert kept[100_000] == kept[1000] < 64 * 1024
    value, back = jax.jit(gradients[100_000])(1.0, gx.Reversible())
    forward = jax.jit(jax.jacfwd(lambda A: precompressed(A, diffrax.ForwardMode(), 100_000)))(1.0)
    assert float(value) == pytest.approx(float(forward), rel=1e-9)
    assert back.return_error < 1e-10


def struck(stiffness, adjoint, steps):
    chain = gx.scenes.monomer(20, stiffness=stiffness)
    run = gx.simulate(
        chain, gx.states.impact(chain), 0.1 * steps, step=0.1, adjoint=adjoint, throw=False
    )
    return jnp.sum(run.final.v[::2])


@pytest.mark.study
def test_checkpoints_of_a_sonic_vacuum_grow_like_the_square_root_of_the_steps():
    def kept(steps):
        return memory(
            jax.grad(lambda A: struck(A, diffrax.RecursiveCheckpointAdjoint(), steps)), 1.0
        )

    assert kept(10_000) < 10 * kept(100)
    assert kept(10_000) < 200 * 20 * 3 * 8 * 2


@pytest.mark.slow
def test_a_gradient_through_contact_loss_is_that_of_differences():
    def force(velocity, adjoint=None):
        chain = gx.scenes.monomer(20)
        state = gx.states.impact(chain, velocity)
        run = gx.simulate(chain, state, 12.0, step=0.01, save_at=13, adjoint=adjoint, throw=False)
        return jnp.sum(
            jax.vmap(lambda u, v: gx.measures.contact_force(chain, (u, v)))(run.us, run.vs)[:, 3:9]
            ** 2
        )

    run = gx.simulate(gx.scenes.monomer(20), gx.states.impact(gx.scenes.monomer(20)), 12.0)
    assert bool(run.contact_opened)
    plain = jax.jit(force)
    difference = (
        sum(w * (plain(1 + k * 1e-3) - plain(1 - k * 1e-3)) for k, w in CENTRAL.items()) / 1e-3
    )
    for adjoint in (diffrax.RecursiveCheckpointAdjoint(), gx.Reversible()):
        assert float(jax.jit(jax.grad(force))(1.0, adjoint)) == pytest.approx(
            float(difference), rel=1e-6
        )


@pytest.mark.study
def test_the_end_that_is_saved_and_the_energy_error():
    def f(stiffness, adjoint, read):
        chain = gx.scenes.monomer(4, stiffness=stiffness, precompression=1.0)
        return read(
            gx.simulate(
                chain, gx.states.impact(chain, 0.1), 1.0, step=0.1, adjoint=adjoint, throw=False
            )
        )

    last = lambda run: jnp.sum(run.us[-1] ** 2 + run.vs[-1])
    gradient = jax.jit(jax.grad(lambda A: f(A, gx.Reversible(), last)))(1.0)
    forward = jax.jit(jax.jacfwd(lambda A: f(A, None, last)))(1.0)
    assert float(gradient) == pytest.approx(float(forward), rel=1e-11)
    assert np.isnan(
        jax.jit(jax.grad(lambda A: f(A, gx.Reversible(), lambda run: run.energy_error)))(1.0)
    )


def test_what_cannot_be_undone_is_refused():
    chain = gx.scenes.monomer(4, precompression=1.0)
    state = gx.states.impact(chain)
    for how in (
        {"tolerance": 1e-8},
        {"solver": diffrax.Tsit5(), "step": 0.1},
        {"save_at": "steps"},
        {"record": {"peak": gx.Peak(lambda t, y, lattice: gx.measures.contact_force(lattice, y))}},
    ):
        with refused("adjoint: expected"):
            gx.simulate(chain, state, 1.0, adjoint=gx.Reversible(), **how)
    with refused("tolerance"):
        gx.Reversible(tolerance=0.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "adjoint", [gx.Reversible(), diffrax.RecursiveCheckpointAdjoint()], ids=["own", "diffrax"]
)
def test_forward_mode_is_refused_in_a_sentence(adjoint):
    chain = gx.scenes.monomer(3, precompression=1.0)

    def last(speed):
        state = gx.states.impact(chain, speed)
        return gx.simulate(chain, state, 0.2, step=0.1, adjoint=adjoint, max_steps=4).final.v[0]

    with refused(
        f"adjoint: expected reverse mode with {type(adjoint).__name__}.*ForwardMode",
    ):
        jax.jacfwd(last)(1.0)
