"""Derivatives of runs: forward mode, checkpoints, integrating backwards; against differences."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DISTINCT, random_like
from jax.flatten_util import ravel_pytree
from refusals import refused

import granjax as gx

slow = pytest.mark.slow

# of order 6: the error of the difference is 1e-12 of the function's size at this width
WIDTH = 1e-2
CENTRAL = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
CHECKPOINTS = diffrax.RecursiveCheckpointAdjoint()


def difference(f, width):
    """The slope of f at zero."""
    return sum(w * (f(k * width) - f(-k * width)) for k, w in CENTRAL.items()) / width


def observed(lattice, solver):
    """f(z, adjoint): a number in which all that a run saves has a part, between steps too; and z, all numbers of it."""
    state = gx.State(*(random_like(lattice.template(), seed, 0.02) for seed in (1, 2)))
    free, fixed = eqx.partition((lattice, state), eqx.is_inexact_array)
    flat, unravel = ravel_pytree(free)
    how = dict(solver=solver, step=0.05, save_at=jnp.array([0.0, 0.31, 0.32, 0.5, 1.0]))

    def f(z, adjoint):
        scene = eqx.combine(unravel(z), fixed)
        run = gx.simulate(*scene, 1.0, adjoint=adjoint, throw=False, **how)
        saved = jax.tree.leaves([run.us, run.vs, run.final])
        return sum(jnp.sum(jnp.sin(x + 0.3 * k)) for k, x in enumerate(saved))

    return f, flat


# of fields, by a method that drifts first, and with a wall that moves, by one that kicks first
SCENES = {"mass_in_mass": gx.SRKN14a(), "wall_driven_right": gx.SRKN11b()}


@slow
@pytest.mark.parametrize("name", SCENES)
def test_scenes_that_are_undone_have_derivatives_in_both_modes(name):
    lattice = next(case.lattice for case in DISTINCT if case.name == name)
    f, z = observed(lattice, SCENES[name])
    d = 0.02 * z * np.random.default_rng(3).uniform(-1, 1, z.shape)
    both = jax.jit(lambda z: jax.jvp(lambda z: f(z, diffrax.ForwardMode()), (z,), (d,)))
    forward = float(both(z)[1])
    gradient, back = jax.jit(jax.grad(f, (0, 1)))(z, gx.Reversible())
    assert back.return_error < 1e-12
    assert float(gradient @ d) == pytest.approx(forward, rel=1e-9, abs=1e-13)
    change = difference(lambda s: both(z + s * d)[0], WIDTH)
    assert forward == pytest.approx(float(change), rel=1e-6, abs=1e-9)


@slow
def test_integrating_backwards_in_a_batch_and_the_return_error():
    make = lambda r: gx.scenes.dimer(6, ratio=r, precompression=1.0)
    chains = jax.vmap(make, out_axes=-1)(jnp.array([0.5, 0.8]))

    def loss(scale, adjoint):
        state = gx.State(chains.zeros(), chains.zeros().at[0].set(scale))
        run = gx.simulate(chains, state, 4.0, step=0.05, adjoint=adjoint, throw=False)
        return jnp.sum(run.final.u**2 * jnp.array([1.0, 2.0]))

    scale = jnp.array([0.1, 0.2])
    gradient, back = jax.grad(loss, (0, 1))(scale, gx.Reversible())
    forward = jax.jacfwd(lambda x: loss(x, diffrax.ForwardMode()))(scale)
    assert np.allclose(gradient, forward, rtol=1e-11)
    assert 0 < back.return_error < 1e-13
    # the same number asked for directly
    chain = make(0.5)
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


@slow
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


@slow
def test_checkpoints_of_a_sonic_vacuum_grow_like_the_square_root_of_the_steps():
    def kept(steps):
        def struck(stiffness):
            chain = gx.scenes.monomer(20, stiffness=stiffness)
            how = dict(step=0.1, adjoint=CHECKPOINTS, throw=False)
            run = gx.simulate(chain, gx.states.impact(chain), 0.1 * steps, **how)
            return jnp.sum(run.final.v[::2])

        return memory(jax.grad(struck), 1.0)

    assert kept(10_000) < 10 * kept(100)
    assert kept(10_000) < 200 * 20 * 3 * 8 * 2


@slow
def test_a_gradient_through_contact_loss_is_that_of_differences():
    chain = gx.scenes.monomer(20)
    frames = jax.vmap(lambda *y: gx.measures.contact_force(chain, y))
    assert bool(gx.simulate(chain, gx.states.impact(chain), 12.0).contact_opened)

    def force(velocity, adjoint=None):
        how = dict(step=0.01, save_at=13, adjoint=adjoint, throw=False)
        run = gx.simulate(chain, gx.states.impact(chain, velocity), 12.0, **how)
        return jnp.sum(frames(run.us, run.vs)[:, 3:9] ** 2)

    plain = jax.jit(force)
    change = float(difference(lambda s: plain(1 + s), 1e-3))
    for adjoint in (CHECKPOINTS, gx.Reversible()):
        assert float(jax.jit(jax.grad(force))(1.0, adjoint)) == pytest.approx(change, rel=1e-6)


@slow
def test_the_end_that_is_saved_has_a_derivative_and_the_energy_error_none():
    def run(stiffness, adjoint):
        chain = gx.scenes.monomer(4, stiffness=stiffness, precompression=1.0)
        state = gx.states.impact(chain, 0.1)
        return gx.simulate(chain, state, 1.0, step=0.1, adjoint=adjoint, throw=False)

    end = lambda A, adjoint: jnp.sum(run(A, adjoint).us[-1] ** 2 + run(A, adjoint).vs[-1])
    forward = float(jax.jacfwd(lambda A: end(A, None))(1.0))
    assert float(jax.grad(end)(1.0, gx.Reversible())) == pytest.approx(forward, rel=1e-11)
    assert np.isnan(jax.grad(lambda A: run(A, gx.Reversible()).energy_error)(1.0))


def test_what_cannot_be_undone_is_refused():
    chain = gx.scenes.monomer(4, precompression=1.0)
    for how in (
        {"tolerance": 1e-8},
        {"solver": diffrax.Tsit5(), "step": 0.1},
        {"save_at": "steps"},
        {"record": {"peak": gx.Peak(gx.measures.contact_force)}},
    ):
        with refused("adjoint: expected"):
            gx.simulate(chain, gx.states.impact(chain), 1.0, adjoint=gx.Reversible(), **how)
    with refused("tolerance"):
        gx.Reversible(tolerance=0.0)


@pytest.mark.parametrize("jit", [lambda f: f, jax.jit])
def test_derivatives_by_times_are_refused_in_a_sentence(jit):
    chain = gx.scenes.monomer(3, precompression=1.0)
    state = gx.states.impact(chain)
    how = dict(step=0.1, adjoint=gx.Reversible(), max_steps=8)
    ends = lambda t1: gx.simulate(chain, state, t1, **how).final.u[0]
    saved = lambda t: gx.simulate(chain, state, 0.4, save_at=t[None], **how).us[0, 0]
    for function in (ends, saved):
        with refused("adjoint: expected derivatives by the lattice and the state"):
            jax.grad(jit(function))(0.35)


@slow
@pytest.mark.parametrize("adjoint", [gx.Reversible(), CHECKPOINTS], ids=["own", "diffrax"])
def test_forward_mode_is_refused_in_a_sentence(adjoint):
    chain = gx.scenes.monomer(3, precompression=1.0)

    def last(speed):
        state = gx.states.impact(chain, speed)
        how = dict(step=0.1, adjoint=adjoint, max_steps=4)
        return gx.simulate(chain, state, 0.2, **how).final.v[0]

    with refused(f"adjoint: expected reverse mode with {type(adjoint).__name__}.*ForwardMode"):
        jax.jacfwd(last)(1.0)
