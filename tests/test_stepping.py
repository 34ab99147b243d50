import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx

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
DASHPOT = gx.Lattice(
    MASS, (gx.Bond(gx.Shift(1, "fixed"), HERTZ), gx.Dashpot(gx.Shift(1, "fixed"), 0.1))
)
PLAIN = gx.scenes.dimer(N, ratio=0.4, precompression=1.0, boundary="free")
CASES = {
    "fast form": (PLAIN, gx.SRKN14a()),
    "walls": (gx.scenes.monomer(N, precompression=0.3), gx.KahanLi8()),
    "every term": (EVERYTHING, gx.SRKN11b()),
    "dashpot": (DASHPOT, diffrax.Tsit5()),
    "pair": (PLAIN, gx.RKN86()),
    "ring": (gx.scenes.monomer(N, boundary="periodic"), gx.VelocityVerlet()),
}


def flat(y):
    return jnp.concatenate([y.u, y.v])


@pytest.mark.study
@pytest.mark.parametrize("case", CASES)
def test_tangents_are_the_derivative_of_the_flow(case):
    lattice, solver = CASES[case]
    flow = gx.Flow(5, solver)
    end, matrix = jax.jit(lambda y: flow.derivative(y, 0.3, 1.4, lattice))(STATE)
    ends = lambda x: flat(flow(gx.State(x[:N], x[N:]), 0.3, 1.4, lattice))
    assert_allclose(flat(end), ends(flat(STATE)), rtol=0, atol=1e-14)
    assert_allclose(matrix, jax.jit(jax.jacfwd(ends))(flat(STATE)), rtol=0, atol=1e-13)


@pytest.mark.slow
def test_tangents_of_an_open_contact_and_of_vectors():
    lattice = gx.scenes.monomer(N, precompression=0.0)
    flow = gx.Flow(20)
    ends = lambda x: flat(flow(gx.State(x[:N], x[N:]), 0.0, 2.0, lattice))
    _, matrix = flow.derivative(STATE, 0.0, 2.0, lattice)
    assert gx.measures.overlap(lattice, STATE).min() < 0
    assert_allclose(matrix, jax.jacfwd(ends)(flat(STATE)), rtol=0, atol=1e-12)


@pytest.mark.slow
def test_a_step_is_that_of_simulate():
    run = gx.simulate(PLAIN, STATE, 3.0, step=0.1, solver=gx.SRKN14a())
    assert_allclose(flat(gx.Flow(30)(STATE, 0.0, 3.0, PLAIN)), flat(run.final), rtol=0, atol=1e-13)


@pytest.mark.slow
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


@pytest.mark.slow
def test_batches_of_lattices_have_their_own_tangents():
    lattices = jax.vmap(lambda r: gx.scenes.dimer(N, ratio=r, precompression=1.0), out_axes=-1)(
        jnp.array([0.4, 0.7])
    )
    flow = gx.Flow(6, gx.SRKN6b())
    many = jax.vmap(lambda c: flow.derivative(STATE, 0.0, 1.0, c)[1], in_axes=-1)(lattices)
    one = flow.derivative(STATE, 0.0, 1.0, gx.scenes.dimer(N, ratio=0.7, precompression=1.0))[1]
    assert_allclose(many[1], one, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_a_field_may_ask_what_a_number_is():
    """A plain number is an input of the compiled flow where the field lets it."""

    def field(t, y, args):
        return sum(-y for _ in range(args["times"])) if args["falls"] > 0.5 else y

    flow = gx.Flow(8, diffrax.Dopri8(), field)
    end, slope = flow.derivative(jnp.ones(2, int), 0, 1, {"times": 1, "falls": 1.0})
    assert_allclose([np.diag(end), slope], [np.exp(-1) * np.eye(2)] * 2, rtol=1e-8, atol=1e-15)
    for times, falls, power in ((1, 1.0, -1), (2, 1.0, -2), (2, 0.0, 1)):
        assert float(flow(1, 0.0, 1.0, {"times": times, "falls": falls})) == pytest.approx(
            np.exp(power), rel=1e-8
        )


@pytest.mark.parametrize("steps", [0, -3, np.array(0), jnp.array(0)])
def test_a_number_of_steps_is_one(steps):
    with refused("steps: expected a whole number"):
        gx.Flow(steps)
    with refused("steps: expected a whole number"):
        gx.flow.return_error(PLAIN, STATE, 0.0, 1.0, steps, gx.SRKN6b())
