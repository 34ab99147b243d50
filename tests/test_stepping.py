"""`Flow`: fixed steps with the derivative of the flow, of lattices and of any field."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx

slow = pytest.mark.slow

N = 12
RNG = np.random.default_rng(3)
STATE = gx.State(*(jnp.asarray(x) for x in RNG.normal(0, 0.1, (2, N))))
HERTZ = gx.Hertz(1.0, 1.0)
MASS = jnp.asarray(RNG.uniform(0.3, 1, N))
EVERYTHING = gx.Lattice(
    MASS,
    (
        gx.Bond(gx.Shift(1, "free"), HERTZ),
        gx.Damping(jnp.linspace(0.1, 0.2, N)),
        gx.OnSite(gx.Sine(0.4)),
        gx.Wall(HERTZ, "left", motion=gx.Harmonic(0.1, 1.3)),
        gx.Wall(HERTZ, "right"),
        gx.Drive(gx.Harmonic(0.1, 2.0), 3),
        gx.Modulated(
            gx.Bond(gx.Pairs([0, 4], [7, 9], sites=N), gx.Polynomial(1.0, 0.3, 0.2)),
            gx.Harmonic(0.1, 2.0, mean=1.0),
        ),
    ),
)
BOND = gx.Bond(gx.Shift(1, "fixed"), HERTZ)


def dimer(ratio):
    return gx.scenes.dimer(N, ratio=ratio, precompression=1.0, boundary="free")


CASES = {
    "fast form": (dimer(0.4), gx.SRKN14a()),
    "every term": (EVERYTHING, gx.SRKN11b()),
    "dashpot": (gx.Lattice(MASS, (BOND, gx.Dashpot(BOND.strain_map, 0.1))), diffrax.Tsit5()),
    "pair": (dimer(0.4), gx.RKN86()),
    "open contacts": (gx.scenes.monomer(N), gx.VelocityVerlet()),
}


def flat(y):
    return jnp.concatenate([y.u, y.v])


@slow
@pytest.mark.parametrize("case", CASES)
def test_tangents_are_the_derivative_of_the_flow(case):
    lattice, solver = CASES[case]
    flow = gx.Flow(5, solver)
    end, matrix = jax.jit(lambda y: flow.derivative(y, 0.3, 1.4, lattice))(STATE)
    ends = lambda x: flat(flow(gx.State(x[:N], x[N:]), 0.3, 1.4, lattice))
    assert_allclose(flat(end), ends(flat(STATE)), rtol=0, atol=1e-14)
    assert_allclose(matrix, jax.jit(jax.jacfwd(ends))(flat(STATE)), rtol=0, atol=1e-13)


@slow
def test_a_flow_takes_the_steps_of_simulate():
    run = gx.simulate(dimer(0.4), STATE, 3.0, step=0.1, solver=gx.SRKN14a())
    flow = gx.Flow(30)(STATE, 0.0, 3.0, dimer(0.4))
    assert_allclose(flat(flow), flat(run.final), rtol=0, atol=1e-13)


@slow
def test_a_complex_field_of_first_order():
    def dnls(t, y, args):  # i y' = -(y_{n+1} + y_{n-1}) - |y|^2 y, as its real and imaginary parts
        z = y[0] + 1j * y[1]
        d = 1j * (jnp.roll(z, 1) + jnp.roll(z, -1) + jnp.abs(z) ** 2 * z)
        return jnp.stack([d.real, d.imag])

    y = jnp.asarray(RNG.normal(0, 1, (2, 5)))
    flow = gx.Flow(40, diffrax.Dopri8(), dnls)
    end, matrix = flow.derivative(y, 0.0, 1.0, None)
    assert float(jnp.sum(end**2)) == pytest.approx(float(jnp.sum(y**2)), rel=1e-8)
    expected = jax.jacfwd(lambda x: flow(x.reshape(2, 5), 0.0, 1.0, None).ravel())(y.ravel())
    assert_allclose(matrix, expected, rtol=0, atol=1e-12)


@slow
def test_batches_of_lattices_have_their_own_tangents():
    lattices = jax.vmap(dimer, out_axes=-1)(jnp.array([0.4, 0.7]))
    tangents = lambda lattice: gx.Flow(6, gx.SRKN6b()).derivative(STATE, 0.0, 1.0, lattice)[1]
    many = jax.vmap(tangents, in_axes=-1)(lattices)
    assert_allclose(many[1], tangents(dimer(0.7)), rtol=0, atol=1e-13)


@slow
def test_a_field_may_ask_what_a_number_is():
    """A plain number is an input of the compiled flow where the field lets it."""

    def field(t, y, args):
        return sum(-y for _ in range(args["times"])) if args["falls"] > 0.5 else y

    flow = gx.Flow(8, diffrax.Dopri8(), field)
    for times, falls, power in ((2, 1.0, -2), (2, 0.0, 1)):
        end, slope = flow.derivative(1.0, 0, 1, {"times": times, "falls": falls})
        assert_allclose([float(end), float(slope.item())], np.exp(power), rtol=1e-8)


@pytest.mark.parametrize("steps", [-3, jnp.array(0)])
def test_a_number_of_steps_is_one(steps):
    with refused("steps: expected a whole number"):
        gx.Flow(steps)
    with refused("steps: expected a whole number"):
        gx.flow.return_error(dimer(0.4), STATE, 0.0, 1.0, steps, gx.SRKN6b())
